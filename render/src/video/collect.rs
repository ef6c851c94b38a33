//! Collects segments into whole episodes.

use proto::Trajectory;

/// Maximum number of unfinished episodes; beyond it, the oldest are dropped.
const MAX_BEGUN: usize = 256;

/// Unfinished episodes, each joined from its segments so far.
#[derive(Debug, Default)]
pub struct Collector {
    begun: Vec<Trajectory>,
}

impl Collector {
    /// Adds a segment to its episode; returns the episode if the segment ends it. Drops a segment that does not follow
    /// the one before it.
    pub fn add(&mut self, segment: Trajectory) -> Option<Trajectory> {
        let follows = |begun: &Trajectory| {
            let next = usize::from(begun.first_step) + begun.transitions.len();
            (&begun.actor, begun.epoch, &begun.task) == (&segment.actor, segment.epoch, &segment.task)
                && next == usize::from(segment.first_step)
        };
        let episode = match self.begun.iter().position(follows) {
            Some(place) => {
                let mut episode = self.begun.remove(place);
                episode.transitions.extend(segment.transitions);
                let Trajectory { last_scene, status, episode_stats, .. } = segment;
                Trajectory { last_scene, status, episode_stats, ..episode }
            }
            None if segment.first_step == 0 => segment,
            None => return None,
        };
        if episode.episode_stats.is_some() {
            return Some(episode);
        }
        if self.begun.len() >= MAX_BEGUN {
            self.begun.remove(0);
        }
        self.begun.push(episode);
        None
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
    fn segments_are_joined_and_incomplete_episodes_are_dropped() {
        let mut collector = Collector::default();
        // The end of an episode without its beginning, and two interleaved episodes.
        assert_eq!(collector.add(of_task(1, 2, 4)), None);
        assert_eq!(collector.add(of_task(2, 0, 2)), None);
        assert_eq!(collector.add(of_task(3, 0, 2)), None);
        // A missing segment in between.
        assert_eq!(collector.add(of_task(3, 3, 4)), None);
        assert_eq!(collector.add(of_task(2, 2, 4)), Some(of_task(2, 0, 4)));
        assert_eq!(collector.begun, [of_task(3, 0, 2)]);
    }

    #[test]
    fn unfinished_episodes_are_bounded() {
        let mut collector = Collector::default();
        for seed in 0..2 * MAX_BEGUN as u64 {
            collector.add(of_task(seed, 0, 1));
        }
        assert_eq!(collector.begun.len(), MAX_BEGUN);
    }
}
