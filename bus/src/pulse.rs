//! Heartbeat of a service's main loop, for health checks.

use parking_lot::Mutex;
use proto::metrics::NotSaved;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// A heartbeat for every iteration of a service's main loop; clones share it.
///
/// A loop that waits for another process declares it with [`Pulse::waiting`], so that a learner without actors does not
/// look like one that hangs.
#[derive(Clone, Debug)]
pub struct Pulse(Arc<Mutex<State>>);

#[derive(Debug)]
struct State {
    last: Instant,
    n_waiting: usize,
    not_saved: Option<NotSaved>,
}

/// Marks the service as waiting for others until dropped.
#[derive(Debug)]
pub struct Waiting(Pulse);

impl Default for Pulse {
    fn default() -> Self {
        Self(Arc::new(Mutex::new(State { last: Instant::now(), n_waiting: 0, not_saved: None })))
    }
}

impl Pulse {
    /// Records an iteration of the loop.
    pub fn beat(&self) {
        self.0.lock().last = Instant::now();
    }

    /// Marks the loop as waiting for others from now on.
    pub fn waiting(&self) -> Waiting {
        self.0.lock().n_waiting += 1;
        Waiting(self.clone())
    }

    /// Returns the time since the last beat; zero while the loop waits for others.
    pub fn age(&self) -> Duration {
        let state = self.0.lock();
        if state.n_waiting > 0 { Duration::ZERO } else { state.last.elapsed() }
    }

    /// Records that the service waits because nothing can be saved, or no longer does.
    pub fn set_not_saved(&self, not_saved: Option<NotSaved>) {
        self.0.lock().not_saved = not_saved;
    }

    /// Returns why the service waits, if nothing can be saved.
    pub fn not_saved(&self) -> Option<NotSaved> {
        self.0.lock().not_saved.clone()
    }
}

impl Drop for Waiting {
    fn drop(&mut self) {
        let mut state = self.0.0.lock();
        state.last = Instant::now();
        state.n_waiting -= 1;
    }
}
