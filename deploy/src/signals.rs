//! SIGINT and SIGTERM: the first signal shuts down gracefully, the second exits at once.

use std::time::Duration;

use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio_util::sync::CancellationToken;

use crate::exit::{Failure, INTERRUPTED};

/// Signals that arrive this soon after the first belong to it: programs such as `timeout` signal the process and then
/// its process group.
const ECHO: Duration = Duration::from_millis(500);

/// Cancels `shutdown` at the first signal from now on, and exits at the second.
///
/// # Errors
/// When a signal handler cannot be installed.
pub fn cancel_on_signal(shutdown: CancellationToken) -> Result<(), Failure> {
    let handler = |kind| signal(kind).map_err(|error| Failure::Service(anyhow::Error::from(error)));
    let (mut interrupt, mut terminate) = (handler(SignalKind::interrupt())?, handler(SignalKind::terminate())?);
    tokio::spawn(async move {
        any(&mut interrupt, &mut terminate).await;
        shutdown.cancel();
        tracing::info!("stopping; press Ctrl-C again to end at once");
        let echoes = async {
            loop {
                any(&mut interrupt, &mut terminate).await;
            }
        };
        let _: Result<(), _> = tokio::time::timeout(ECHO, echoes).await;
        any(&mut interrupt, &mut terminate).await;
        tracing::warn!("ended by a second signal");
        #[expect(clippy::disallowed_methods, reason = "this is the way out when draining hangs")]
        std::process::exit(INTERRUPTED.into());
    });
    Ok(())
}

async fn any(interrupt: &mut Signal, terminate: &mut Signal) {
    tokio::select! {
        _ = interrupt.recv() => {}
        _ = terminate.recv() => {}
    }
}
