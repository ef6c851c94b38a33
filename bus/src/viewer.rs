//! Passive viewing of trajectories.

use tokio::sync::mpsc;
use zenoh::pubsub::Subscriber;

use super::{Bus, BusError};
use proto::codec::decode_trajectory;
use proto::{Trajectory, keys};

/// Maximum number of trajectories that wait for a viewer; a slow viewer misses the rest.
const QUEUE: usize = 64;

/// Receives copies of the trajectories that actors send.
#[derive(Debug)]
pub struct TrajectoryViewer {
    trajectories: mpsc::Receiver<Trajectory>,
    _subscriber: Subscriber<()>,
    _open: Bus,
}

impl Bus {
    /// Receives the trajectories of all actors, which send copies only while there are viewers.
    ///
    /// # Errors
    /// If the session is closed.
    pub async fn trajectory_viewer(&self) -> Result<TrajectoryViewer, BusError> {
        let (sender, trajectories) = mpsc::channel(QUEUE);
        let counts = self.counts.clone();
        let declared = self.session.declare_subscriber(keys::TRAJECTORIES_ALL).callback(move |sample| {
            // Reserve a slot first: a trajectory that will be dropped need not be decoded.
            let Ok(slot) = sender.try_reserve() else {
                counts.lock().viewed_dropped_total += 1;
                return;
            };
            match decode_trajectory(&sample.payload().to_bytes()) {
                Ok(trajectory) => slot.send(trajectory),
                Err(_) => counts.lock().viewed_invalid_total += 1,
            }
        });
        let subscriber = declared.await.map_err(BusError::during("watching trajectories"))?;
        Ok(TrajectoryViewer { trajectories, _subscriber: subscriber, _open: self.clone() })
    }
}

impl TrajectoryViewer {
    /// Returns the next trajectory; `None` after the session is closed.
    pub async fn recv(&mut self) -> Option<Trajectory> {
        self.trajectories.recv().await
    }
}
