//! Collects segments into whole episodes.

use proto::Trajectory;

use super::episode::is_same_episode;

/// Maximum number of unfinished episodes; beyond it, the oldest are dropped.
const MAX_BEGUN: usize = 256;

/// Unfinished episodes with every segment so far.
#[derive(Debug, Default)]
pub struct Collector {
    begun: Vec<Vec<Trajectory>>,
    n_left_out: u64,
}

impl Collector {
    /// Adds a segment to its episode; returns the episode if the segment ends it.
    pub fn add(&mut self, segment: Trajectory) -> Option<Vec<Trajectory>> {
        let follows = |last: &Trajectory| {
            let next = usize::from(last.first_step) + last.transitions.len();
            is_same_episode(last, &segment) && next == usize::from(segment.first_step)
        };
        let place = self.begun.iter().position(|segments| segments.last().is_some_and(follows));
        let mut segments = match place {
            Some(place) => self.begun.remove(place),
            None if segment.first_step == 0 => Vec::new(),
            None => {
                self.n_left_out += 1;
                return None;
            }
        };
        let is_over = segment.episode_stats.is_some();
        segments.push(segment);
        if is_over {
            return Some(segments);
        }
        if self.begun.len() >= MAX_BEGUN {
            self.n_left_out += self.begun.remove(0).len() as u64;
        }
        self.begun.push(segments);
        None
    }

    /// Returns the number of dropped segments, which belong to incomplete episodes.
    pub fn n_left_out(&self) -> u64 {
        self.n_left_out
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::segment;
    use super::*;

    fn of_task(seed: u64, first: u16, last: u16) -> Trajectory {
        let mut segment = segment(first, last);
        segment.task.seed = seed;
        segment
    }

    #[test]
    fn incomplete_episodes_are_dropped() {
        let mut collector = Collector::default();
        // The end of an episode without its beginning, and two interleaved episodes.
        assert_eq!(collector.add(of_task(1, 2, 4)), None);
        assert_eq!(collector.add(of_task(2, 0, 2)), None);
        assert_eq!(collector.add(of_task(3, 0, 2)), None);
        // A missing segment in between.
        assert_eq!(collector.add(of_task(3, 3, 4)), None);
        let episode = collector.add(of_task(2, 2, 4)).unwrap();
        assert_eq!(episode, [of_task(2, 0, 2), of_task(2, 2, 4)]);
        assert_eq!(collector.n_left_out(), 2);
    }

    #[test]
    fn unfinished_episodes_are_bounded() {
        let mut collector = Collector::default();
        for seed in 0..2 * MAX_BEGUN as u64 {
            collector.add(of_task(seed, 0, 1));
        }
        assert_eq!((collector.begun.len(), collector.n_left_out()), (MAX_BEGUN, MAX_BEGUN as u64));
    }
}
