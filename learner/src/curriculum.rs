//! The curriculum: the probability of each training blueprint to be the next goal.

use std::collections::BTreeMap;

use blueprints::BlueprintId;
use proto::InvalidSetting;
use serde::{Deserialize, Serialize};

use crate::config::CurriculumConfig;

/// Finished episodes between updates of the probabilities. With the paper's rule, it sets the strength of the decay.
const EPISODES_PER_BATCH: usize = 64;

/// Weight of one episode in a blueprint's success rate.
const TAU: f64 = 0.2;

/// The paper's rule: factor applied to all success rates once per batch, so that no blueprint is forgotten.
const PAPER_DECAY: f64 = 0.99;

/// Success rates and probabilities of the training blueprints.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Curriculum {
    /// Not saved: a resumed run has its own.
    #[serde(skip)]
    config: CurriculumConfig,
    tasks: BTreeMap<BlueprintId, TaskState>,
    waiting: Vec<(BlueprintId, bool)>,
}

/// The curriculum's state for one blueprint.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TaskState {
    /// Running success rate, 0 if never tried.
    pub success_rate: f64,
    /// Probability of being the next goal.
    pub probability: f64,
}

impl Curriculum {
    /// Creates a curriculum for `tasks`, all equally likely and with a success rate of 0.
    pub fn new(config: CurriculumConfig, tasks: impl IntoIterator<Item = BlueprintId>) -> Self {
        let start = TaskState { success_rate: 0.0, probability: 0.0 };
        let mut tasks: BTreeMap<_, _> = tasks.into_iter().map(|id| (id, start)).collect();
        set_probabilities(&mut tasks, |_| 1.0);
        Self { config, tasks, waiting: Vec::new() }
    }

    /// Returns this curriculum with the state of a saved run, whose settings may differ. The probabilities change with
    /// the next batch.
    #[must_use]
    pub fn with_state_of(self, saved: Self) -> Self {
        Self { config: self.config, ..saved }
    }

    /// Checks the numbers of a saved run; `path` is the key of this curriculum.
    pub(crate) fn check(&self, path: &str) -> Result<(), InvalidSetting> {
        for (id, task) in &self.tasks {
            for (key, share) in [("success_rate", task.success_rate), ("probability", task.probability)] {
                // Both are quotients, and rounding may put them just above 1.
                let is_share = (0.0..=1.001).contains(&share);
                InvalidSetting::check(format_args!("{path}.tasks.{id}.{key}"), share, is_share, "0..=1")?;
            }
        }
        let sum: f64 = self.tasks.values().map(|task| task.probability).sum();
        let (key, found) = (format_args!("{path}.tasks"), format_args!("a sum of {sum}"));
        InvalidSetting::check(key, found, (sum - 1.0).abs() < 1e-3, "probabilities that sum to 1")
    }

    /// Records one finished episode; every full batch updates the probabilities. Blueprints outside the training set
    /// (such as those of an evaluation) are ignored.
    pub fn record(&mut self, blueprint: &BlueprintId, success: bool) {
        if self.tasks.contains_key(blueprint) {
            self.waiting.push((blueprint.clone(), success));
        }
        let n_enough = if matches!(self.config, CurriculumConfig::Uniform(_)) { 1 } else { EPISODES_PER_BATCH };
        if self.waiting.len() >= n_enough {
            let batch = std::mem::take(&mut self.waiting);
            self.update(batch.iter().map(|(id, success)| (id, *success)));
        }
    }

    /// Updates the probabilities with a batch of finished episodes, in order.
    pub fn update<'a>(&mut self, batch: impl IntoIterator<Item = (&'a BlueprintId, bool)>) {
        for (id, success) in batch {
            if let Some(task) = self.tasks.get_mut(id) {
                // The paper's listing has success_rates[i] with an undefined i, which must be the blueprint's own rate.
                task.success_rate = (1.0 - TAU) * task.success_rate + TAU * f64::from(u8::from(success));
            }
        }
        match &self.config {
            // A saved run may have had another curriculum.
            CurriculumConfig::Uniform(_) => set_probabilities(&mut self.tasks, |_| 1.0),
            CurriculumConfig::Paper(paper) => {
                self.tasks.values_mut().for_each(|task| task.success_rate *= PAPER_DECAY);
                // The largest exponent is 0, so the sum is at least 1 however small the temperature is.
                let lowest = self.tasks.values().map(|task| task.success_rate).fold(1.0, f64::min);
                set_probabilities(&mut self.tasks, |rate| ((lowest - rate) / paper.temperature).exp());
            }
        }
    }

    /// Returns the state of each training blueprint.
    pub fn tasks(&self) -> &BTreeMap<BlueprintId, TaskState> {
        &self.tasks
    }

    /// Returns the probability of each training blueprint, as sent with the weights.
    pub fn probabilities(&self) -> BTreeMap<BlueprintId, f32> {
        self.tasks.iter().map(|(id, task)| (id.clone(), task.probability as f32)).collect()
    }
}

fn set_probabilities(tasks: &mut BTreeMap<BlueprintId, TaskState>, weight: impl Fn(f64) -> f64) {
    let total: f64 = tasks.values().map(|task| weight(task.success_rate)).sum();
    tasks.values_mut().for_each(|task| task.probability = weight(task.success_rate) / total);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{PaperConfig, UniformConfig};

    fn ids(n: usize) -> Vec<BlueprintId> {
        (0..n).map(|i| BlueprintId::try_from(format!("2_{i:03}")).unwrap()).collect()
    }

    fn probabilities(curriculum: &Curriculum) -> Vec<f64> {
        curriculum.tasks().values().map(|t| t.probability).collect()
    }

    #[test]
    fn a_small_temperature_gives_all_to_the_lowest_rate() {
        let ids = ids(2);
        let config = PaperConfig { temperature: 1e-6 };
        let mut curriculum = Curriculum::new(CurriculumConfig::Paper(config), ids.clone());
        curriculum.update([(&ids[0], true), (&ids[1], true)]);
        assert_eq!(probabilities(&curriculum), [0.5, 0.5]);
        curriculum.update([(&ids[0], true), (&ids[1], false)]);
        assert_eq!(probabilities(&curriculum), [0.0, 1.0]);
    }

    #[test]
    fn a_run_that_goes_on_without_a_curriculum_draws_all_equally() {
        let ids = ids(2);
        let paper = CurriculumConfig::Paper(PaperConfig { temperature: 1e-6 });
        let mut saved = Curriculum::new(paper, ids.clone());
        saved.update([(&ids[0], true)]);
        assert_eq!(probabilities(&saved), [0.0, 1.0]);
        let uniform = CurriculumConfig::Uniform(UniformConfig {});
        let mut curriculum = Curriculum::new(uniform, ids.clone()).with_state_of(saved);
        curriculum.update([(&ids[0], true)]);
        assert_eq!(probabilities(&curriculum), [0.5, 0.5]);
    }

    #[test]
    fn only_full_batches_of_known_blueprints_count() {
        let ids = ids(2);
        let mut curriculum = Curriculum::new(CurriculumConfig::Paper(PaperConfig::default()), ids.clone());
        let before = curriculum.tasks().clone();
        curriculum.record(&ids[0], true);
        (2..EPISODES_PER_BATCH).for_each(|_| curriculum.record(&ids[1], false));
        curriculum.record(&BlueprintId::try_from("9_999".to_owned()).unwrap(), true);
        assert_eq!(curriculum.tasks(), &before);
        curriculum.record(&ids[1], false);
        // 0.2 · 1 · 0.99 for the successful episode.
        assert!((curriculum.tasks()[&ids[0]].success_rate - 0.198).abs() < 1e-12);
        assert!(curriculum.tasks()[&ids[0]].probability < 0.5);
    }
}
