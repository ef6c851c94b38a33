//! Threads that give way to training.

use anyhow::Context;
use tokio::sync::oneshot;

/// Runs `work` on a thread of its own, whose processor time comes after that of others by `nice` (0 to 19); so does that
/// of threads which it starts. On systems without per-thread niceness it runs like any other.
pub(crate) async fn on_thread<T: Send + 'static>(
    nice: i32,
    work: impl FnOnce() -> T + Send + 'static,
) -> anyhow::Result<T> {
    let (sender, done) = oneshot::channel();
    let run = move || {
        give_way(nice);
        // Whoever no longer waits has no use for the result.
        let _result = sender.send(work());
    };
    std::thread::Builder::new().name("evaluation".to_owned()).spawn(run).context("starting a thread")?;
    done.await.context("the evaluating thread panicked")
}

#[cfg(target_os = "linux")]
fn give_way(nice: i32) {
    // On Linux the call is about one thread, named like a process. A failure leaves it as it is, which is harmless.
    if let Err(error) = rustix::process::setpriority_process(Some(rustix::thread::gettid()), nice) {
        tracing::debug!(%error, nice, "the niceness of a thread was not set");
    }
}

#[cfg(not(target_os = "linux"))]
fn give_way(_: i32) {}
