//! Limits that the system sets on this process.

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

use crate::exit::Failure;

/// Files that a process must be allowed to open: `train` with a page has 26 open, and browsers, videos, and actors that
/// join need more. Libraries panic where a file cannot be opened, so this is checked before they start.
const MIN_FILES: u64 = 64;

/// Raises the limit on open files as far as the system allows: each process that joins a router costs the router one
/// file, and the usual limit of 1024 is less than the number of sessions that a router may have.
///
/// # Errors
/// [`Failure::FewFiles`] if the limit is too low to work at all.
pub(crate) fn allow_many_files() -> Result<(), Failure> {
    let Rlimit { current, maximum } = getrlimit(Resource::Nofile);
    if current != maximum
        && let Err(error) = setrlimit(Resource::Nofile, Rlimit { current: maximum, maximum })
    {
        tracing::debug!(%error, "the limit of open files stays at {current:?}");
    }
    match getrlimit(Resource::Nofile).current {
        Some(limit) if limit < MIN_FILES => Err(Failure::FewFiles { limit, needed: MIN_FILES }),
        _ => Ok(()),
    }
}

/// Threads that step worlds: as many as requested, or one per core available to this process.
pub(crate) fn n_threads(asked: Option<u16>) -> usize {
    let n_cores = || std::thread::available_parallelism().map_or(1, usize::from);
    asked.map_or_else(n_cores, usize::from)
}
