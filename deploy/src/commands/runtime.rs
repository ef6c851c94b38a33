//! The runtime of a command.

use std::time::Duration;

use tokio_util::sync::CancellationToken;

use crate::exit::Failure;
use crate::{limits, signals};

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
    limits::allow_many_files()?;
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
