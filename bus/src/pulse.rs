//! Heartbeat of a service's main loop, for health checks.

use parking_lot::Mutex;
use proto::metrics::NotSaved;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

/// A heartbeat for every iteration of a service's main loop; clones share it.
///
/// A loop that waits for another process declares it with [`Pulse::waiting`], so that a learner without actors does not
/// look like one that hangs.
#[derive(Clone, Debug)]
pub struct Pulse(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    last: Mutex<Instant>,
    n_waiting: AtomicUsize,
    not_saved: Mutex<Option<NotSaved>>,
}

/// Marks the service as waiting for others until dropped.
#[derive(Debug)]
pub struct Waiting(Pulse);

impl Default for Pulse {
    fn default() -> Self {
        Self(Arc::new(Inner {
            last: Mutex::new(Instant::now()),
            n_waiting: AtomicUsize::new(0),
            not_saved: Mutex::default(),
        }))
    }
}

impl Pulse {
    /// Records an iteration of the loop.
    pub fn beat(&self) {
        *self.0.last.lock() = Instant::now();
    }

    /// Marks the loop as waiting for others from now on.
    pub fn waiting(&self) -> Waiting {
        self.0.n_waiting.fetch_add(1, Ordering::Relaxed);
        Waiting(self.clone())
    }

    /// Returns the time since the last beat; zero while the loop waits for others.
    pub fn age(&self) -> Duration {
        if self.0.n_waiting.load(Ordering::Relaxed) > 0 { Duration::ZERO } else { self.0.last.lock().elapsed() }
    }

    /// Records that the service waits because nothing can be saved, or no longer does.
    pub fn set_not_saved(&self, not_saved: Option<NotSaved>) {
        *self.0.not_saved.lock() = not_saved;
    }

    /// Returns why the service waits, if nothing can be saved.
    pub fn not_saved(&self) -> Option<NotSaved> {
        self.0.not_saved.lock().clone()
    }
}

impl Drop for Waiting {
    fn drop(&mut self) {
        self.0.beat();
        self.0.0.n_waiting.fetch_sub(1, Ordering::Relaxed);
    }
}
