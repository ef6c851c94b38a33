//! Low-priority threads, which do not slow down training.

use anyhow::Context;
use tokio::sync::oneshot;

/// Niceness of an evaluation's threads, as for the command `nice`. It keeps evaluations from slowing down training.
#[cfg(target_os = "linux")]
const NICE: i32 = 10;

/// Runs `work` on a new nice thread, whose niceness the threads that it starts inherit. On systems without per-thread
/// niceness, the thread has normal priority.
pub(crate) async fn on_thread<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> anyhow::Result<T> {
    let (sender, done) = oneshot::channel();
    let run = move || {
        give_way();
        // The receiver may be gone; the result is then not needed.
        let _result = sender.send(work());
    };
    std::thread::Builder::new().name("evaluation".to_owned()).spawn(run).context("starting a thread")?;
    done.await.context("the evaluating thread panicked")
}

#[cfg(target_os = "linux")]
fn give_way() {
    // On Linux, despite its name, this call applies to one thread. A failure leaves the priority unchanged, which is
    // harmless.
    if let Err(error) = rustix::process::setpriority_process(Some(rustix::thread::gettid()), NICE) {
        tracing::debug!(%error, "the niceness of a thread was not set");
    }
}

#[cfg(not(target_os = "linux"))]
fn give_way() {}
