//! Evaluator settings.

use blueprints::{Blueprint, BlueprintId, Catalog, Group, N_BLOCKS, Split};
use proto::setting::schema::{self, Schema};
use proto::setting::{Section, Setting, key};
use proto::{ActionMode, InvalidSetting, settings};
use serde::{Deserialize, Serialize};

/// Minimum number of blocks of a reset-free goal (paper).
pub(crate) const MIN_BLOCKS: usize = 12;

settings! {
    /// When, on which blueprints, and how weights are evaluated.
    pub struct EvaluatorConfig in "evaluator" {
        /// Time between evaluations. Default: 10 minutes (paper, "Performance Evaluation").
        pub every: Every;
        /// Whether the last weights are evaluated, regardless of [`Self::every`]: by `train` before it ends, and by an
        /// evaluator on a bus once the learner is gone.
        pub evaluate_last: bool = false;
        /// Blueprints to evaluate. Default: the paper's splits.
        pub selection: Selection;
        /// Additional splits for the evaluation of the last weights, such as splits that must not influence training.
        /// They need `evaluate_last`.
        pub last_splits: Vec<Split> = Vec::new(),
            where |c| are_distinct(&c.last_splits) => "names of splits, none twice";
        /// How episodes are run.
        pub episodes: EpisodeConfig;
        /// By which success the best weights of a run are chosen.
        pub best: BestConfig;
        /// Several goals in a row without a reset, after the episodes. Default: none.
        pub reset_free: Option<ResetFreeConfig>;
        /// Videos of some episodes. Default: one success and one failure per group.
        pub videos: VideosConfig;
    }

    /// A choice of blueprints from the catalog.
    #[derive(Eq)]
    pub struct Selection {
        /// The splits, without duplicates.
        pub splits: Vec<Split> = Split::PAPER.to_vec();
        /// Minimum and maximum number of blocks.
        pub sizes: [usize; 2] = [1, N_BLOCKS], in 1..=N_BLOCKS,
            where |c| c.sizes.is_sorted() => "two ascending numbers";
        /// If not empty, restricts the selection to these blueprints.
        pub blueprints: Vec<BlueprintId> = Vec::new();
    }

    /// How the episodes of an evaluation are run.
    #[derive(Eq)]
    pub struct EpisodeConfig {
        /// Episodes per blueprint and action mode; the default is the paper's.
        pub n_episodes: u32 = 40, in 1..=10_000;
        /// How the episodes begin.
        pub starts: Starts = Starts::Scattered;
        /// Whether each world draws its settings from `environment.randomization`, as in training. By default, all
        /// worlds use the settings of the environment itself, so that runs can be compared.
        pub randomization: bool = false;
        /// Action modes.
        pub acting: Vec<ActionMode> = vec![ActionMode::Greedy, ActionMode::Sampled],
            where |c| !c.acting.is_empty() && are_distinct(&c.acting) => "\"greedy\", \"sampled\" or both";
        /// Number of threads. By default, training loses at most one core while an evaluation runs.
        pub n_threads: usize = 1, in 1..=64;
    }

    /// The success by which the best weights of a run are chosen: the share of episodes on the goals of one split in
    /// [`EvaluatorConfig::selection`], with one action mode. Of two equal ones, the later one is better.
    #[derive(Eq)]
    pub struct BestConfig {
        /// The split. If the selection has no such goals, its training goals count; if it has none of these either, all
        /// of its goals.
        pub split: Split = Split::Validation;
        /// The action mode. If episodes are not run with it, the other one counts.
        pub acting: ActionMode = ActionMode::Sampled;
    }

    /// Runs of several goals in a world that is never reset. Goals are training blueprints of at least 12 blocks. The
    /// defaults are from the paper, "Reset-Free Evaluation".
    #[derive(Eq)]
    pub struct ResetFreeConfig {
        /// Number of runs.
        pub n_runs: u32 = 50, in 1..=10_000;
        /// Goals per run.
        pub n_goals: u32 = 10, in 1..=1000;
    }

    /// Which episodes of an evaluation become videos: the first success and the first failure of each group and blueprint,
    /// in the first action mode. Only an evaluator that keeps records makes videos.
    ///
    /// Videos are on by default because numbers do not show what a policy does wrong. They cost little: two videos per
    /// group and evaluation, each about a second on one core.
    #[derive(Eq)]
    pub struct VideosConfig {
        /// Groups of blueprints to record, by their names in reports.
        pub groups: Vec<Group> = Group::ALL.to_vec(),
            where |c| are_distinct(&c.groups) => "names of groups, none twice";
        /// Blueprints to record in addition to the groups.
        pub blueprints: Vec<BlueprintId> = Vec::new(),
            where |c| are_distinct(&c.blueprints) => "names of blueprints, none twice";
    }
}

/// Interval between the starts of two evaluations. If an evaluation takes longer, the next one starts at once.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Every {
    /// Minutes of wall-clock time, 0 to 10 000.
    Minutes(f64),
    /// Environment steps that the learner consumed, at least 1.
    Steps(u64),
    /// Weights versions, at least 1.
    Versions(u64),
}

/// How the episodes of an evaluation begin.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Starts {
    /// All blocks are scattered.
    #[default]
    Scattered,
    /// Another training blueprint, drawn for each episode, is already built.
    Prebuilt,
    /// Every fifth episode is prebuilt, the others are scattered: the mixture that the paper trains on ("Initial
    /// State").
    Mixed,
}

/// Why a setting cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum EvaluatorConfigError {
    /// The catalog does not contain the blueprint.
    #[error("the catalog has no blueprint {0}")]
    UnknownBlueprint(BlueprintId),
    /// No blueprint is left to evaluate.
    #[error("the selection of splits, sizes and blueprints leaves nothing to evaluate")]
    NothingSelected,
}

impl Default for Every {
    fn default() -> Self {
        Self::Minutes(10.0)
    }
}

impl Section for Every {
    fn schema() -> Schema {
        schema::of::<Self>()
    }

    fn validate_at(&self, path: &str) -> Result<(), InvalidSetting> {
        match self {
            Self::Minutes(minutes) => minutes.check_in(&key(path, "minutes"), &(0.0..=10_000.0)),
            Self::Steps(steps) => steps.check_in(&key(path, "steps"), &(1..)),
            Self::Versions(versions) => versions.check_in(&key(path, "versions"), &(1..)),
        }
    }
}

impl EvaluatorConfig {
    /// Returns the blueprints for the evaluation of the last weights: the selection plus [`Self::last_splits`].
    pub fn last_selection(&self) -> Selection {
        let mut selection = self.selection.clone();
        selection.splits.extend(self.last_splits.iter().filter(|split| !self.selection.splits.contains(split)));
        selection
    }
}

impl Selection {
    /// Returns the selected blueprints in the catalog's order.
    ///
    /// # Errors
    /// If a named blueprint is unknown or nothing is selected.
    pub fn select<'c>(&self, catalog: &'c Catalog) -> Result<Vec<&'c Blueprint>, EvaluatorConfigError> {
        if let Some(unknown) = self.blueprints.iter().find(|id| catalog.get(id).is_none()) {
            return Err(EvaluatorConfigError::UnknownBlueprint(unknown.clone()));
        }
        let wanted = |blueprint: &&Blueprint| {
            self.splits.contains(&blueprint.split())
                && (self.sizes[0]..=self.sizes[1]).contains(&blueprint.n_blocks())
                && (self.blueprints.is_empty() || self.blueprints.contains(blueprint.id()))
        };
        let selected: Vec<&Blueprint> = catalog.iter().filter(wanted).collect();
        if selected.is_empty() { Err(EvaluatorConfigError::NothingSelected) } else { Ok(selected) }
    }
}

impl ResetFreeConfig {
    /// Total episodes of all runs.
    pub(crate) fn n_episodes(&self) -> u64 {
        u64::from(self.n_runs) * u64::from(self.n_goals)
    }
}

impl VideosConfig {
    /// Checks that the run's catalog contains all blueprints to record.
    ///
    /// # Errors
    /// Names the first missing blueprint.
    pub fn check_in(&self, catalog: &Catalog) -> Result<(), EvaluatorConfigError> {
        let unknown = self.blueprints.iter().find(|id| catalog.get(id).is_none());
        unknown.map_or(Ok(()), |id| Err(EvaluatorConfigError::UnknownBlueprint(id.clone())))
    }

    /// Whether any video is requested.
    pub fn any(&self) -> bool {
        !(self.groups.is_empty() && self.blueprints.is_empty())
    }
}

fn are_distinct<T: PartialEq>(items: &[T]) -> bool {
    (1..items.len()).all(|i| !items[..i].contains(&items[i]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_evaluation_covers_more() {
        let selection = Selection { splits: vec![Split::Train, Split::Validation], ..Default::default() };
        let last_splits = vec![Split::Test, Split::Train];
        let config = EvaluatorConfig { selection, last_splits, ..Default::default() };
        let n = |selection: &Selection| selection.select(Catalog::builtin()).unwrap().len();
        assert_eq!(n(&EvaluatorConfig::default().selection), 142 + 24);
        assert_eq!(n(&EvaluatorConfig::default().last_selection()), 142 + 24);
        assert_eq!(n(&config.selection), 142 + 34);
        assert_eq!(config.last_selection().splits, [Split::Train, Split::Validation, Split::Test]);
        assert_eq!(n(&config.last_selection()), 142 + 34 + 10);
    }
}
