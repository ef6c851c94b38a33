//! What simulated actors send, and when.

use std::time::Duration;

use proto::Trajectory;
use proto::codec::encode_trajectory;

/// The segments of all actors of a process, and their times.
#[derive(Debug)]
pub(super) struct Script {
    segments: Vec<Trajectory>,
    /// Encoded size of each segment, with a name and numbers of typical length.
    n_bytes: Vec<usize>,
    /// Number of steps before each segment; `n_steps` is the total.
    steps_before: Vec<u64>,
    n_steps: u64,
    steps_per_s: f64,
}

impl Script {
    pub(super) fn new(segments: Vec<Trajectory>, steps_per_s: f64) -> anyhow::Result<Self> {
        anyhow::ensure!(!segments.is_empty(), "there are no segments to send");
        let mut n_steps = 0;
        let mut steps_before = Vec::with_capacity(segments.len());
        for segment in &segments {
            steps_before.push(n_steps);
            n_steps += segment.transitions.len() as u64;
        }
        let n_bytes = segments.iter().map(|segment| encode_trajectory(segment).len()).collect();
        Ok(Self { segments, n_bytes, steps_before, n_steps, steps_per_s })
    }

    pub(super) fn n_bytes(&self, seq: u64) -> usize {
        self.n_bytes[(seq % self.n_bytes.len() as u64) as usize]
    }

    /// Returns the segment with this sequence number; segments repeat in order.
    pub(super) fn segment(&self, seq: u64) -> &Trajectory {
        &self.segments[(seq % self.segments.len() as u64) as usize]
    }

    /// Returns the time from the start until an actor has stepped the segment with this number; `None` at full speed.
    pub(super) fn due(&self, seq: u64) -> Option<Duration> {
        let n_segments = self.segments.len() as u64;
        let index = (seq % n_segments) as usize;
        let steps =
            seq / n_segments * self.n_steps + self.steps_before[index] + self.segments[index].transitions.len() as u64;
        (self.steps_per_s > 0.0).then(|| Duration::from_secs_f64(steps as f64 / self.steps_per_s))
    }

    /// Returns how much later than others an actor starts, which spreads the actors evenly over the time of one
    /// segment.
    pub(super) fn phase(&self, number: usize) -> Duration {
        const GOLDEN_RATIO: f64 = 0.618_033_988_749_894_9;
        let mean_period = self.n_steps as f64 / self.segments.len() as f64 / self.steps_per_s;
        let share = (number as f64 * GOLDEN_RATIO).fract();
        if self.steps_per_s > 0.0 { Duration::from_secs_f64(share * mean_period) } else { Duration::ZERO }
    }
}
