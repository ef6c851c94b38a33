//! Low-priority threads, which do not slow down training.

use anyhow::Context;
use tokio::sync::oneshot;

/// Runs `work` on a new thread with niceness `nice` (0 to 19), which the threads that it starts inherit. On systems
/// without per-thread niceness, the thread has normal priority.
pub(crate) async fn on_thread<T: Send + 'static>(
    nice: i32,
    work: impl FnOnce() -> T + Send + 'static,
) -> anyhow::Result<T> {
    let (sender, done) = oneshot::channel();
    let run = move || {
        give_way(nice);
        // The receiver may be gone; the result is then not needed.
        let _result = sender.send(work());
    };
    std::thread::Builder::new().name("evaluation".to_owned()).spawn(run).context("starting a thread")?;
    done.await.context("the evaluating thread panicked")
}

#[cfg(target_os = "linux")]
fn give_way(nice: i32) {
    // On Linux, despite its name, this call applies to one thread. A failure leaves the priority unchanged, which is
    // harmless.
    if let Err(error) = rustix::process::setpriority_process(Some(rustix::thread::gettid()), nice) {
        tracing::debug!(%error, nice, "the niceness of a thread was not set");
    }
}

#[cfg(not(target_os = "linux"))]
fn give_way(_: i32) {}
