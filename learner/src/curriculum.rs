//! The curriculum: the probability of each training blueprint to be the next goal.

use std::collections::BTreeMap;

use blueprints::BlueprintId;
use proto::InvalidSetting;
use proto::setting::Section;
use serde::{Deserialize, Serialize};

use crate::config::{CurriculumConfig, WideningConfig};
use crate::numbers::share;

/// Finished episodes between updates of the probabilities. With the paper's rule, it sets the strength of the decay.
const EPISODES_PER_BATCH: usize = 64;

/// Weight of one episode in a blueprint's success rate, with the paper's rule and the widening one.
const TAU: f64 = 0.2;

/// The same with the other rules.
const SLOW_TAU: f64 = 0.05;

/// The paper's rule: factor applied to all success rates once per batch, so that no blueprint is forgotten.
const PAPER_DECAY: f64 = 0.99;

/// Success rates and probabilities of the training blueprints.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Curriculum {
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
    /// Number of blocks; 0 in checkpoints of earlier versions, which a resumed run replaces.
    #[serde(default)]
    pub n_blocks: usize,
}

impl Curriculum {
    /// Creates a curriculum for `tasks`, each with its number of blocks and a success rate of 0. All are equally
    /// likely, except with [`CurriculumConfig::Widening`].
    pub fn new(config: CurriculumConfig, tasks: impl IntoIterator<Item = (BlueprintId, usize)>) -> Self {
        let start = |n_blocks| TaskState { success_rate: 0.0, probability: 0.0, n_blocks };
        let mut tasks: BTreeMap<_, _> = tasks.into_iter().map(|(id, n_blocks)| (id, start(n_blocks))).collect();
        match &config {
            CurriculumConfig::Widening(widening) => widen(&mut tasks, widening),
            _ => set_probabilities(&mut tasks, |_| 1.0),
        }
        Self { config, tasks, waiting: Vec::new() }
    }

    /// Returns this curriculum with the state of a saved run, whose settings may differ. The probabilities change with
    /// the next batch.
    #[must_use]
    pub fn with_state_of(self, saved: Self) -> Self {
        let n_blocks = |id: &BlueprintId| self.tasks.get(id).map_or(0, |task| task.n_blocks);
        let tasks = saved.tasks.into_iter().map(|(id, task)| {
            let n_blocks = n_blocks(&id);
            (id, TaskState { n_blocks, ..task })
        });
        Self { config: self.config.clone(), tasks: tasks.collect(), waiting: saved.waiting }
    }

    /// Checks the numbers of a saved run; `path` is the key of this curriculum.
    ///
    /// # Errors
    /// Returns the first rate or probability outside 0..=1, or the sum of the probabilities if it is not 1.
    pub(crate) fn check(&self, path: &str) -> Result<(), InvalidSetting> {
        self.config.validate_at(&format!("{path}.config"))?;
        for (id, task) in &self.tasks {
            share(&format!("{path}.tasks.{id}.success_rate"), task.success_rate)?;
            share(&format!("{path}.tasks.{id}.probability"), task.probability)?;
        }
        let sum: f64 = self.tasks.values().map(|task| task.probability).sum();
        let key = format_args!("{path}.tasks");
        InvalidSetting::check(
            key,
            format_args!("a sum of {sum}"),
            (sum - 1.0).abs() < 1e-3,
            "probabilities that sum to 1",
        )
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
        let tau = match &self.config {
            CurriculumConfig::Uniform(_) | CurriculumConfig::Learnability(_) => SLOW_TAU,
            CurriculumConfig::Paper(_) | CurriculumConfig::Widening(_) => TAU,
        };
        for (id, success) in batch {
            if let Some(task) = self.tasks.get_mut(id) {
                // The paper's listing has success_rates[i] with an undefined i, which must be the blueprint's own rate.
                task.success_rate = (1.0 - tau) * task.success_rate + tau * f64::from(u8::from(success));
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
            CurriculumConfig::Learnability(learnability) => {
                let total: f64 = self.tasks.values().map(|t| t.success_rate * (1.0 - t.success_rate)).sum();
                let uniform = learnability.uniform / self.tasks.len().max(1) as f64;
                // If nothing is learnable yet, all blueprints are equally likely.
                let share = |rate: f64| if total > 1e-9 { rate * (1.0 - rate) / total } else { 1.0 };
                let weight = if total > 1e-9 { 1.0 - learnability.uniform } else { 0.0 };
                set_probabilities(&mut self.tasks, |rate| uniform + weight * share(rate));
            }
            CurriculumConfig::Widening(widening) => widen(&mut self.tasks, widening),
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

/// Splits the probability evenly over the numbers of blocks in use, and each share over its blueprints.
fn widen(tasks: &mut BTreeMap<BlueprintId, TaskState>, config: &WideningConfig) {
    // Sum of the success rates, and number of blueprints, by number of blocks.
    let mut sizes: BTreeMap<usize, (f64, usize)> = BTreeMap::new();
    for task in tasks.values() {
        let (sum, n) = sizes.entry(task.n_blocks).or_default();
        *sum += task.success_rate;
        *n += 1;
    }
    let is_gate =
        |(size, (sum, n)): (&usize, &(f64, usize))| *size >= config.first_size && sum / (*n as f64) < config.gate;
    if let Some(largest) = sizes.iter().find(|entry| is_gate(*entry)).map(|(&size, _)| size) {
        sizes.retain(|&size, _| size <= largest);
    }
    for task in tasks.values_mut() {
        task.probability = sizes.get(&task.n_blocks).map_or(0.0, |&(sum, n)| {
            let (n_failures, n) = (n as f64 - sum, n as f64);
            // If nothing fails, all blueprints are equally likely.
            let by_failures = if n_failures > 1e-9 { (1.0 - task.success_rate) / n_failures } else { 1.0 / n };
            let share = (1.0 - config.failures) / n + config.failures * by_failures;
            share / sizes.len() as f64
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{LearnabilityConfig, PaperConfig, UniformConfig};

    fn of_two(ids: &[BlueprintId]) -> impl Iterator<Item = (BlueprintId, usize)> {
        ids.iter().map(|id| (id.clone(), 2))
    }

    fn ids(n: usize) -> Vec<BlueprintId> {
        (0..n).map(|i| BlueprintId::try_from(format!("2_{i:03}")).unwrap()).collect()
    }

    fn probabilities(curriculum: &Curriculum) -> Vec<f64> {
        curriculum.tasks().values().map(|t| t.probability).collect()
    }

    #[test]
    fn learnability_prefers_medium_success_rates() {
        let ids = ids(3);
        let config = LearnabilityConfig { uniform: 0.3 };
        let mut curriculum = Curriculum::new(CurriculumConfig::Learnability(config), of_two(&ids));
        curriculum.update([]);
        assert_eq!(probabilities(&curriculum), [1.0 / 3.0; 3]);
        // Rates 0.05, 0, and 0: only the first blueprint is learnable, so it gets 0.1 + 0.7.
        curriculum.update([(&ids[0], true), (&ids[1], false)]);
        for (p, expected) in probabilities(&curriculum).iter().zip([0.8, 0.1, 0.1]) {
            assert!((p - expected).abs() < 1e-12);
        }
    }

    #[test]
    fn sizes_widen_with_success_and_share_equally() {
        let ids: Vec<BlueprintId> =
            ["2_000", "2_001", "3_000", "5_000"].map(|id| id.to_owned().try_into().unwrap()).into();
        let config = WideningConfig { first_size: 2, gate: 0.6, failures: 0.0 };
        let sizes = [2, 2, 3, 5];
        let mut curriculum = Curriculum::new(CurriculumConfig::Widening(config), ids.iter().cloned().zip(sizes));
        assert_eq!(probabilities(&curriculum), [0.5, 0.5, 0.0, 0.0]);
        let mut both = |n: usize, success: bool| {
            curriculum.update(ids[..2].iter().flat_map(|id| std::iter::repeat_n((id, success), n)));
            probabilities(&curriculum)
        };
        // Rates of 1 − 0.8⁴ = 0.59 and then of 1 − 0.8⁵ = 0.67.
        assert_eq!(both(4, true), [0.5, 0.5, 0.0, 0.0]);
        assert_eq!(both(1, true), [0.25, 0.25, 0.5, 0.0]);
        // Lower rates narrow the range again: 0.54.
        assert_eq!(both(1, false), [0.5, 0.5, 0.0, 0.0]);
    }

    #[test]
    fn what_fails_may_be_drawn_more_often() {
        let ids = ids(3);
        let config = WideningConfig { failures: 0.6, ..WideningConfig::default() };
        let mut curriculum = Curriculum::new(CurriculumConfig::Widening(config), of_two(&ids));
        curriculum.update(ids.iter().zip([true, false, false]));
        // Rates 0.2, 0, and 0 are 4, 5, and 5 of 14 failures, which determine 0.6 of the draws; the other 0.4 is
        // uniform.
        for (p, expected) in probabilities(&curriculum).iter().zip([4.0 / 14.0, 5.0 / 14.0, 5.0 / 14.0]) {
            assert!((p - (0.4 / 3.0 + 0.6 * expected)).abs() < 1e-12);
        }
    }

    #[test]
    fn a_small_temperature_gives_all_to_the_lowest_rate() {
        let ids = ids(2);
        let config = PaperConfig { temperature: 1e-6 };
        let mut curriculum = Curriculum::new(CurriculumConfig::Paper(config), of_two(&ids));
        curriculum.update([(&ids[0], true), (&ids[1], true)]);
        assert_eq!(probabilities(&curriculum), [0.5, 0.5]);
        curriculum.update([(&ids[0], true), (&ids[1], false)]);
        assert_eq!(probabilities(&curriculum), [0.0, 1.0]);
    }

    #[test]
    fn a_run_that_goes_on_without_a_curriculum_draws_all_equally() {
        let ids = ids(2);
        let tasks = [(ids[0].clone(), 2), (ids[1].clone(), 5)];
        let widening = CurriculumConfig::Widening(WideningConfig { first_size: 2, ..WideningConfig::default() });
        let saved = Curriculum::new(widening, tasks.clone());
        assert_eq!(probabilities(&saved), [1.0, 0.0]);
        let uniform = CurriculumConfig::Uniform(UniformConfig {});
        let mut curriculum = Curriculum::new(uniform, tasks).with_state_of(saved);
        curriculum.update([(&ids[0], true)]);
        assert_eq!(probabilities(&curriculum), [0.5, 0.5]);
    }

    #[test]
    fn only_full_batches_of_known_blueprints_count() {
        let ids = ids(2);
        let mut curriculum = Curriculum::new(CurriculumConfig::Paper(PaperConfig::default()), of_two(&ids));
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

    #[test]
    fn every_kind_deserializes() {
        for (text, expected) in [
            (r#"{"kind":"uniform"}"#, CurriculumConfig::Uniform(UniformConfig {})),
            (r#"{"kind":"paper","temperature":0.1}"#, CurriculumConfig::Paper(PaperConfig { temperature: 0.1 })),
            (r#"{"kind":"learnability"}"#, CurriculumConfig::Learnability(LearnabilityConfig::default())),
        ] {
            assert_eq!(serde_json::from_str::<CurriculumConfig>(text).unwrap(), expected);
        }
        assert!(serde_json::from_str::<CurriculumConfig>(r#"{"kind":"paper","uniform":0.1}"#).is_err());
    }
}
