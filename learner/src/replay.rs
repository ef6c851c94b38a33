//! The replay buffer of labeled scenes: bounded, and balanced by goal size.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use blueprints::{Blueprint, Catalog};
use policy::FeatureBatch;
use proto::{Label, Observation, Trajectory};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::config::ReplayConfig;

/// A replay buffer of labeled segments, grouped by the number of blocks of their goals.
///
/// When the buffer is full, it evicts the oldest segment of the size with the most scenes, so that no size displaces
/// the others.
#[derive(Clone, Debug)]
pub struct Replay {
    config: ReplayConfig,
    groups: BTreeMap<usize, SizeGroup>,
    n_steps: usize,
}

#[derive(Clone, Debug, Default)]
struct SizeGroup {
    segments: VecDeque<Segment>,
    n_steps: usize,
}

#[derive(Clone, Debug)]
struct Segment {
    /// The goal, permuted by the episode's assignment.
    blueprint: Arc<Blueprint>,
    trajectory: Arc<Trajectory>,
}

impl Replay {
    /// Creates an empty replay buffer.
    pub fn new(config: ReplayConfig) -> Self {
        Self { config, groups: BTreeMap::new(), n_steps: 0 }
    }

    /// Adds the labeled steps of a segment, if it has any and the catalog has its goal.
    pub fn push(&mut self, mut trajectory: Trajectory, catalog: &Catalog) {
        trajectory.transitions.retain(|transition| transition.label.is_some());
        let Some(blueprint) = catalog.find(&trajectory.task.blueprint) else { return };
        let n_steps = trajectory.transitions.len();
        if n_steps == 0 {
            return;
        }
        let blueprint = Arc::new(blueprint.permuted(&trajectory.task.assignment));
        let group = self.groups.entry(blueprint.n_blocks()).or_default();
        group.segments.push_back(Segment { blueprint, trajectory: Arc::new(trajectory) });
        group.n_steps += n_steps;
        self.n_steps += n_steps;
        while self.n_steps > self.config.capacity_steps {
            let Some(fullest) = self.groups.values_mut().max_by_key(|group| group.n_steps) else { break };
            let Some(oldest) = fullest.segments.pop_front() else { break };
            fullest.n_steps -= oldest.trajectory.transitions.len();
            self.n_steps -= oldest.trajectory.transitions.len();
        }
    }

    /// Returns the number of labeled scenes.
    pub fn n_steps(&self) -> usize {
        self.n_steps
    }

    /// Appends `n` random scenes to `features` and returns their labels; empty if there are no scenes.
    pub fn draw(&self, n: usize, rng: &mut ChaCha8Rng, features: &mut FeatureBatch) -> Vec<Label> {
        let groups: Vec<(f64, &SizeGroup, usize)> = self
            .groups
            .iter()
            .filter_map(|(&n_blocks, group)| {
                let longest = group.segments.iter().map(|segment| segment.trajectory.transitions.len()).max()?;
                Some(((n_blocks as f64).powf(self.config.size_power), group, longest))
            })
            .collect();
        let total: f64 = groups.iter().map(|(weight, ..)| weight).sum();
        let mut labels = Vec::with_capacity(n);
        while labels.len() < n {
            let mut rest = rng.random::<f64>() * total;
            let drawn = groups.iter().find(|(weight, ..)| {
                rest -= weight;
                rest < 0.0
            });
            let Some(&(_, group, longest)) = drawn.or(groups.last()) else { break };
            // Sample segments uniformly and reject steps beyond their end, so that all steps are equally likely.
            let (segment, step, at) = loop {
                let segment = &group.segments[rng.random_range(0..group.segments.len())];
                let at = rng.random_range(0..longest);
                if let Some(step) = segment.trajectory.transitions.get(at) {
                    break (segment, step, at);
                }
            };
            if let Some(label) = step.label {
                let at = u16::try_from(at).unwrap_or(u16::MAX);
                let n_steps = segment.trajectory.first_step.saturating_add(at);
                features.push(&Observation { scene: &step.scene, blueprint: &segment.blueprint, n_steps });
                labels.push(label);
            }
        }
        labels
    }

    /// Returns all segments, grouped by size, oldest first.
    pub(crate) fn segments(&self) -> Vec<Arc<Trajectory>> {
        let segments = self.groups.values().flat_map(|group| &group.segments);
        segments.map(|segment| segment.trajectory.clone()).collect()
    }

    /// Restores the result of [`Self::segments`]; drops segments beyond the capacity.
    pub(crate) fn restore(&mut self, segments: Vec<Arc<Trajectory>>, catalog: &Catalog) {
        for trajectory in segments {
            self.push(Arc::unwrap_or_clone(trajectory), catalog);
        }
    }
}

#[cfg(test)]
mod tests {
    use blueprints::{BlockIdx, Split};
    use policy::PolicyConfig;
    use rand::SeedableRng;

    use super::*;
    use crate::fixtures::random_trajectory;

    fn labeled(goal: &str, n_steps: usize, mark: u8) -> Trajectory {
        let mut trajectory = random_trajectory(n_steps, 0, &mut ChaCha8Rng::seed_from_u64(1));
        trajectory.task.blueprint = goal.parse().unwrap();
        let block = BlockIdx::try_from(mark).ok();
        for transition in &mut trajectory.transitions {
            transition.label = Some(Label { choices: [block; 2], moves: [[0.0; 6]; 2] });
        }
        trajectory
    }

    fn replay(capacity_steps: usize, size_power: f64) -> Replay {
        Replay::new(ReplayConfig { capacity_steps, size_power })
    }

    /// Returns how often each mark is drawn.
    fn counts(replay: &Replay, n: usize) -> [usize; 16] {
        let mut features = FeatureBatch::new(&PolicyConfig::default().features);
        let labels = replay.draw(n, &mut ChaCha8Rng::seed_from_u64(2), &mut features);
        assert_eq!(features.n, labels.len());
        let mut counts = [0; 16];
        labels.iter().for_each(|label| counts[label.choices[0].unwrap().get()] += 1);
        counts
    }

    #[test]
    fn sizes_are_drawn_by_weight_and_steps_uniformly() {
        let catalog = Catalog::builtin();
        let six = catalog.of_split(Split::Train).into_iter().find(|b| b.n_blocks() == 6).unwrap().id().clone();
        let mut replay = replay(100_000, 1.0);
        for (goal, n_steps, mark) in [("2_000", 30, 0), ("2_000", 10, 1), (six.as_str(), 7, 2)] {
            replay.push(labeled(goal, n_steps, mark), catalog);
        }
        let counts = counts(&replay, 8000);
        // Sizes are drawn 2 : 6, and the 30 and 10 steps of the first size uniformly: 1500, 500, and 6000.
        for (count, expected) in counts.into_iter().zip([1500, 500, 6000]) {
            assert!(count.abs_diff(expected) < 150, "{counts:?}");
        }
    }

    #[test]
    fn largest_size_group_is_evicted_first() {
        let catalog = Catalog::builtin();
        let mut replay = replay(50, 0.0);
        replay.push(labeled("3_000", 20, 9), catalog);
        for mark in 0..4 {
            replay.push(labeled("2_000", 15, mark), catalog);
        }
        assert_eq!(replay.n_steps(), 50);
        let counts = counts(&replay, 500);
        assert!(counts[0] == 0 && counts[1] == 0 && counts[2] > 0 && counts[3] > 0 && counts[9] > 0, "{counts:?}");
        let mut again = super::Replay::new(replay.config.clone());
        again.restore(replay.segments(), catalog);
        assert_eq!((again.n_steps(), self::counts(&again, 500)), (50, counts));
    }

    #[test]
    fn scenes_without_labels_are_not_kept() {
        let mut replay = replay(50, 0.0);
        replay.push(random_trajectory(5, 0, &mut ChaCha8Rng::seed_from_u64(1)), Catalog::builtin());
        assert_eq!((replay.n_steps(), counts(&replay, 10)), (0, [0; 16]));
    }
}
