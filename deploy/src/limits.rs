//! What the system allows this process.

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

/// Allows as many open files as the system lets this process have: every process that joins a router costs it one, and the
/// usual limit of 1024 is less than a router's sessions.
pub fn allow_many_files() {
    let Rlimit { current, maximum } = getrlimit(Resource::Nofile);
    if current == maximum {
        return;
    }
    if let Err(error) = setrlimit(Resource::Nofile, Rlimit { current: maximum, maximum }) {
        tracing::debug!(%error, "the limit of open files stays at {current:?}");
    }
}

/// Threads that step worlds: as many as asked for, otherwise as many as the cores that this process may use.
pub fn n_threads(asked: Option<u16>) -> usize {
    let n_cores = || std::thread::available_parallelism().map_or(1, usize::from);
    asked.map_or_else(n_cores, usize::from)
}

/// Open files that this process may have; `None` for any number.
pub fn max_files() -> Option<u64> {
    getrlimit(Resource::Nofile).maximum
}
