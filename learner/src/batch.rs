//! The trajectories of one update as network inputs. Features are computed once for all epochs.

use std::ops::Range;

use blueprints::{Blueprint, Catalog};
use policy::mixture::ActionRows;
use policy::proposals::Slot;
use policy::{FeatureBatch, MoveHead, PolicyConfig};
use proto::{Action, Observation, Scene, Status, Trajectory, Transition, WeightsVersion};

use crate::advantages::{Estimator, Steps};
use crate::draws::{self, Draws};
use crate::gae;
use crate::mailbox::policy_lag;

/// All samples of an update.
///
/// Rows `0..n_samples` of `features` are the scenes before the actions, in segment order. The remaining rows are the
/// last scenes of the segments.
#[derive(Debug)]
pub struct Batch {
    /// Features of `n_samples + n_segments` scenes.
    pub features: FeatureBatch,
    /// Actions, one per sample.
    pub actions: Vec<Action>,
    /// Draws from the mixture head, one per sample; `None` for the Gaussian head.
    pub draws: Option<Vec<Draws>>,
    /// Number of trajectories that were left out: their actions are not among what their scenes offer, or
    /// [`Self::refuse`] removed them.
    pub n_refused: usize,
    /// Log-probabilities under the acting weights, one per sample.
    pub behavior_log_probs: Vec<f32>,
    /// Rewards, one per sample.
    pub rewards: Vec<f32>,
    /// Ranges of samples, each from one episode.
    pub segments: Vec<Segment>,
}

/// Consecutive samples of one episode.
#[derive(Clone, Debug, PartialEq)]
pub struct Segment {
    /// The range of samples.
    pub samples: Range<usize>,
    /// The episode's status after the last sample.
    pub status: Status,
    /// Number of versions between the acting and the newest weights.
    pub policy_lag: u64,
    /// The scene after the last sample.
    pub last_scene: Scene,
    /// The goal, permuted by the episode's assignment.
    pub blueprint: Blueprint,
}

impl Batch {
    /// Computes the features of `trajectories` for an update of weights `version`. Skips trajectories with a blueprint
    /// outside the catalog, which the mailbox refuses.
    pub fn new(
        trajectories: Vec<Trajectory>,
        version: WeightsVersion,
        catalog: &Catalog,
        policy: &PolicyConfig,
    ) -> Self {
        let mut batch = Self {
            features: FeatureBatch::of_policy(policy),
            actions: Vec::new(),
            draws: (policy.network.move_head == MoveHead::Mixture).then(Vec::new),
            n_refused: 0,
            behavior_log_probs: Vec::new(),
            rewards: Vec::new(),
            segments: Vec::new(),
        };
        for trajectory in trajectories {
            let Some(blueprint) = catalog.get(&trajectory.task.blueprint) else { continue };
            let blueprint = blueprint.permuted(&trajectory.task.assignment);
            let policy_lag = policy_lag(version, &trajectory);
            let first = batch.actions.len();
            let is_offered = trajectory.transitions.iter().enumerate().all(|(t, transition)| {
                batch.features.push(&Observation { scene: &transition.scene, blueprint: &blueprint });
                batch.actions.push(transition.action.clone());
                batch.behavior_log_probs.push(transition.behavior_log_prob);
                batch.rewards.push(transition.reward.total());
                let after = trajectory.transitions.get(t + 1).map_or(&trajectory.last_scene, |next| &next.scene);
                batch.push_draws(transition, after, &blueprint)
            });
            if !is_offered {
                batch.truncate(first);
                batch.n_refused += 1;
                continue;
            }
            let samples = first..batch.actions.len();
            let Trajectory { status, last_scene, .. } = trajectory;
            batch.segments.push(Segment { samples, status, policy_lag, last_scene, blueprint });
        }
        for segment in &batch.segments {
            batch.features.push(&segment.last_observation());
        }
        batch
    }

    /// Appends the draws of a transition whose scene was pushed last; returns whether that scene offers them.
    fn push_draws(&mut self, transition: &Transition, after: &Scene, blueprint: &Blueprint) -> bool {
        let Some(draws) = &mut self.draws else { return true };
        let Some(proposals) = self.features.proposals.last() else { return false };
        let slots = transition.proposals.map(|slot| slot.and_then(Slot::from_index));
        let rows = ActionRows::new(proposals, &transition.action.choices, &slots);
        let did = draws::did(transition, &slots, after, blueprint);
        draws.extend(rows.map(|rows| Draws { slots, rows, did }));
        draws.len() == self.features.n
    }

    /// Removes all samples from the `n`th on.
    fn truncate(&mut self, n: usize) {
        self.features.truncate(n);
        self.actions.truncate(n);
        self.behavior_log_probs.truncate(n);
        self.rewards.truncate(n);
        if let Some(draws) = &mut self.draws {
            draws.truncate(n);
        }
    }

    /// Removes the segments for which the network gives a value or a log-probability that is not finite: a single one
    /// would spoil every advantage and every gradient of the update. Returns how many there were. If all are such, the
    /// weights are at fault, and the batch stays as it is.
    pub fn refuse(&mut self, values: &[f32], log_probs: &[f32]) -> usize {
        let n_samples = self.n_samples();
        let is_sound = |at: usize, segment: &Segment| {
            let own = segment.samples.clone();
            let numbers = log_probs[own.clone()].iter().chain(&values[own]).chain(&values[n_samples + at..][..1]);
            numbers.copied().all(f32::is_finite)
        };
        let sound: Vec<bool> = self.segments.iter().enumerate().map(|(at, segment)| is_sound(at, segment)).collect();
        let n_refused = sound.iter().filter(|is_sound| !**is_sound).count();
        if n_refused == 0 || n_refused == sound.len() {
            return 0;
        }
        let (mut rows, mut last) = (Vec::new(), Vec::new());
        for (at, (segment, is_sound)) in std::mem::take(&mut self.segments).into_iter().zip(sound).enumerate() {
            if !is_sound {
                self.n_refused += 1;
                continue;
            }
            let first = rows.len();
            rows.extend(segment.samples.clone());
            last.push(n_samples + at);
            self.segments.push(Segment { samples: first..rows.len(), ..segment });
        }
        self.actions = picked(&self.actions, &rows);
        self.draws = self.draws.as_ref().map(|draws| picked(draws, &rows));
        self.behavior_log_probs = picked(&self.behavior_log_probs, &rows);
        self.rewards = picked(&self.rewards, &rows);
        self.features = self.features.select(&[rows, last].concat());
        n_refused
    }

    /// Returns the number of samples.
    pub fn n_samples(&self) -> usize {
        self.actions.len()
    }

    /// Estimates the advantages of all samples from the `values` of all rows, both in reward units, and the importance
    /// `ratios` of all samples.
    pub fn advantages(&self, estimator: &dyn Estimator, values: &[f32], ratios: &[f32]) -> Vec<f32> {
        let n_samples = self.n_samples();
        let mut advantages = vec![0.0; n_samples];
        for (segment, &last_value) in self.segments.iter().zip(&values[n_samples..]) {
            let samples = segment.samples.clone();
            let bootstrap = gae::bootstrap_value(segment.status, last_value);
            let steps = Steps {
                rewards: &self.rewards[samples.clone()],
                values: &values[samples.clone()],
                bootstrap,
                ratios: &ratios[samples.clone()],
            };
            estimator.advantages(&steps, &mut advantages[samples]);
        }
        advantages
    }

    /// Returns the number of samples by policy lag: entry `i` counts the samples with lag `i`.
    pub fn lag_histogram(&self) -> Vec<u64> {
        let longest = self.segments.iter().map(|s| s.policy_lag).max().unwrap_or(0);
        let mut histogram = vec![0; longest as usize + 1];
        for segment in &self.segments {
            histogram[segment.policy_lag as usize] += segment.samples.len() as u64;
        }
        histogram
    }
}

impl Segment {
    /// Returns what a policy sees after the last sample.
    pub fn last_observation(&self) -> Observation<'_> {
        Observation { scene: &self.last_scene, blueprint: &self.blueprint }
    }
}

fn picked<T: Clone>(all: &[T], rows: &[usize]) -> Vec<T> {
    rows.iter().map(|&row| all[row].clone()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gae::Gae;
    use crate::tests::fixtures::trajectory;

    const SUMS: Gae = Gae { gamma: 1.0, lambda: 1.0 };

    fn batch_of(trajectories: Vec<Trajectory>) -> Batch {
        Batch::new(trajectories, WeightsVersion(5), Catalog::builtin(), &PolicyConfig::default())
    }

    #[test]
    fn a_segment_with_a_number_that_is_not_finite_is_removed_whole() {
        let segments = [trajectory(2, 3), trajectory(3, 4), trajectory(1, 5)];
        let of = |kept: &[usize]| batch_of(kept.iter().map(|&at| segments[at].clone()).collect());
        // Rows are the six samples, and then the three last scenes.
        for (row, is_value, removed) in [(0, false, 0), (4, false, 1), (4, true, 1), (5, true, 2), (7, true, 1)] {
            let mut values = vec![0.5; 9];
            let mut log_probs = vec![-1.0; 6];
            *(if is_value { &mut values[row] } else { &mut log_probs[row] }) = f32::NAN;
            let mut batch = of(&[0, 1, 2]);
            assert_eq!(batch.refuse(&values, &log_probs), 1);
            assert_eq!(batch.n_refused, 1);
            let kept: Vec<usize> = (0..3).filter(|at| *at != removed).collect();
            let expected = of(&kept);
            assert_eq!((&batch.segments, &batch.actions), (&expected.segments, &expected.actions));
            assert_eq!((&batch.rewards, batch.draws.is_none()), (&expected.rewards, true));
            assert_eq!((batch.features.n, &batch.features.nodes), (expected.features.n, &expected.features.nodes));
        }
        let mut batch = of(&[0, 1, 2]);
        assert_eq!(batch.refuse(&[0.5; 9], &[f32::NAN; 6]), 0, "where all are such, the weights are at fault");
        assert_eq!((batch.n_samples(), batch.n_refused), (6, 0));
    }

    #[test]
    fn advantages_do_not_cross_segments() {
        let mut ended = trajectory(2, 3);
        ended.status = Status::Success;
        ended.transitions[1].reward.connected = 1.0;
        let batch = batch_of(vec![ended, trajectory(3, 5)]);
        assert_eq!((batch.n_samples(), batch.features.n), (5, 7));
        assert_eq!(batch.lag_histogram(), [3, 0, 2]);
        // γ = λ = 1; all values are 0 except those of the last scenes, 7 (ignored: success) and 4.
        let values = [0.0, 0.0, 0.0, 0.0, 0.0, 7.0, 4.0];
        assert_eq!(batch.advantages(&SUMS, &values, &[1.0; 5]), [1.0, 1.0, 4.0, 4.0, 4.0]);
    }
}
