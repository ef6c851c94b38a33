//! The runtime of a command.

use std::time::Duration;

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use tokio_util::sync::CancellationToken;

use crate::exit::{Failure, MIN_FILES};
use crate::signals;

/// Threads for the bus and for services that wait; stepping and training use their own threads.
const N_RUNTIME_THREADS: usize = 2;

/// Time limit for threads outside the runtime to end after everything else has ended. What they still compute or print
/// is of no use to anybody by then.
const LAST_THREADS: Duration = Duration::from_millis(250);

/// Runs `command` on a runtime, with a token that the first signal cancels.
///
/// # Errors
/// Those of the command, [`Failure::FewFiles`] if the system allows too few open files, or [`Failure::Service`] if the
/// runtime cannot be started.
pub fn on_runtime(command: impl AsyncFnOnce(CancellationToken) -> Result<(), Failure>) -> Result<(), Failure> {
    allow_many_files()?;
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(N_RUNTIME_THREADS)
        .enable_all()
        .build()
        .map_err(|error| Failure::Service(error.into()))?;
    let ended = runtime.block_on(async {
        let shutdown = CancellationToken::new();
        signals::cancel_on_signal(shutdown.clone())?;
        command(shutdown).await
    });
    runtime.shutdown_timeout(LAST_THREADS);
    ended
}

/// Raises the limit on open files as far as the system allows: each process that joins a router costs the router one
/// file, and the usual limit of 1024 is less than the number of sessions that a router may have.
///
/// # Errors
/// [`Failure::FewFiles`] if the limit is too low to work at all.
fn allow_many_files() -> Result<(), Failure> {
    let Rlimit { current, maximum } = getrlimit(Resource::Nofile);
    if current != maximum
        && let Err(error) = setrlimit(Resource::Nofile, Rlimit { current: maximum, maximum })
    {
        tracing::debug!(%error, "the limit of open files stays at {current:?}");
    }
    match getrlimit(Resource::Nofile).current {
        Some(limit) if limit < MIN_FILES => Err(Failure::FewFiles(limit)),
        _ => Ok(()),
    }
}
