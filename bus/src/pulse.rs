//! Whether the work of a service goes on, for whoever asks about its health.

use parking_lot::{Mutex, MutexGuard};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

/// Beats with every turn of a service's main loop; clones share it.
///
/// A loop that waits for somebody else says so with [`Pulse::waiting`], so that a learner without actors is not taken for one
/// that hangs.
#[derive(Clone, Debug)]
pub struct Pulse(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    last: Mutex<Instant>,
    n_waiting: AtomicUsize,
}

/// The service waits for others until this is dropped.
#[derive(Debug)]
pub struct Waiting(Pulse);

impl Default for Pulse {
    fn default() -> Self {
        Self(Arc::new(Inner { last: Mutex::new(Instant::now()), n_waiting: AtomicUsize::new(0) }))
    }
}

impl Pulse {
    /// The loop has turned.
    pub fn beat(&self) {
        *self.last() = Instant::now();
    }

    /// From now on the loop waits for others.
    pub fn waiting(&self) -> Waiting {
        self.0.n_waiting.fetch_add(1, Ordering::Relaxed);
        Waiting(self.clone())
    }

    /// Time since the last beat; zero while the loop waits for others.
    pub fn age(&self) -> Duration {
        if self.0.n_waiting.load(Ordering::Relaxed) > 0 { Duration::ZERO } else { self.last().elapsed() }
    }

    fn last(&self) -> MutexGuard<'_, Instant> {
        // A time is whole after every statement.
        self.0.last.lock()
    }
}

impl Drop for Waiting {
    fn drop(&mut self) {
        self.0.beat();
        self.0.0.n_waiting.fetch_sub(1, Ordering::Relaxed);
    }
}
