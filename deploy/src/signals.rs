//! SIGINT, SIGTERM, and SIGHUP: the first signal shuts down gracefully, the second exits at once.

use std::io;
use std::time::Duration;

use tokio::signal::unix::{SignalKind, signal};
use tokio_util::sync::CancellationToken;

use crate::exit::{Failure, INTERRUPTED};

/// Signals that arrive this soon after the first belong to it: programs such as `timeout` signal the process and then
/// its process group.
const ECHO: Duration = Duration::from_millis(500);

/// How long the last line may take before the process exits. Only a terminal that nobody reads takes longer.
const LAST_LINE: Duration = Duration::from_millis(200);

/// Cancels `shutdown` at the first signal from now on, and exits at the second. SIGHUP, which says that the terminal is
/// gone, counts unless the process was started to ignore it (`nohup`).
pub(crate) fn cancel_on_signal(shutdown: CancellationToken) -> Result<(), Failure> {
    let handler = |kind| signal(kind).map_err(|error| Failure::Service(anyhow::Error::from(error)));
    let (mut interrupt, mut terminate) = (handler(SignalKind::interrupt())?, handler(SignalKind::terminate())?);
    let mut hangup = if ignores_hangup() { None } else { Some(handler(SignalKind::hangup())?) };
    tokio::spawn(async move {
        let mut next = async || {
            tokio::select! {
                _ = interrupt.recv() => {}
                _ = terminate.recv() => {}
                Some(_) = async { hangup.as_mut()?.recv().await } => {}
            }
        };
        next().await;
        shutdown.cancel();
        // On threads of their own, because a terminal that nobody reads (Ctrl-S) blocks whoever writes to it.
        drop(tokio::task::spawn_blocking(|| tracing::info!("stopping; press Ctrl-C again to end at once")));
        let echoes = async {
            loop {
                next().await;
            }
        };
        let _: Result<(), _> = tokio::time::timeout(ECHO, echoes).await;
        next().await;
        let last_line = tokio::task::spawn_blocking(|| tracing::warn!("ended by a second signal"));
        drop(tokio::time::timeout(LAST_LINE, last_line).await);
        #[expect(clippy::disallowed_methods, reason = "this is the way out when draining hangs")]
        std::process::exit(INTERRUPTED.into());
    });
    Ok(())
}

/// Cancels `shutdown` when stdin is closed, as it is when the process at its other end is gone.
pub(crate) fn cancel_with_stdin(shutdown: CancellationToken) {
    // The thread ends with the process.
    std::thread::spawn(move || {
        drop(io::copy(&mut io::stdin(), &mut io::sink()));
        shutdown.cancel();
    });
}

/// Whether the process was started to ignore SIGHUP. Where this is unknown (no `/proc`), the signal is left as it is.
fn ignores_hangup() -> bool {
    std::fs::read_to_string("/proc/self/status").map_or(true, |status| ignores(&status, SignalKind::hangup()))
}

/// Whether a process with this status file ignores the signal.
fn ignores(status: &str, signal: SignalKind) -> bool {
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    mask.is_none_or(|mask| (mask >> (signal.as_raw_value() - 1)) & 1 == 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ignored_signals_are_read_from_the_status_file() {
        let status = |mask: &str| format!("Name:\tlodestone\nSigBlk:\t0000000000000000\nSigIgn:\t{mask}\n");
        // SIGHUP is signal 1, SIGPIPE 13, and Rust's runtime always ignores the latter.
        assert!(!ignores(&status("0000000000001000"), SignalKind::hangup()));
        assert!(ignores(&status("0000000000001001"), SignalKind::hangup()));
        assert!(ignores(&status("0000000000001000"), SignalKind::pipe()));
    }
}
