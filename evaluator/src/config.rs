//! Settings of an evaluator.

mod films;

use blueprints::{Blueprint, BlueprintId, Catalog, N_BLOCKS, Split};
use serde::{Deserialize, Serialize};

use proto::{ActionMode, InvalidSetting};

pub use films::FilmsConfig;

/// When, on what and how weights are evaluated.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EvaluatorConfig {
    /// How far apart evaluations are. Default: 10 minutes (paper, "Performance Evaluation").
    pub every: Every,
    /// Whether `train` evaluates the last weights before it ends, whatever [`Self::every`] says. Default false.
    pub evaluate_last: bool,
    /// Which blueprints.
    pub selection: Selection,
    /// How episodes are run.
    pub episodes: EpisodeConfig,
    /// Goals in a row without a reset, after the episodes; absent means none. Default: absent.
    pub reset_free: Option<ResetFreeConfig>,
    /// How far the evaluation's threads stand back when others want the processor, 0 to 19 as for the command `nice`; Linux
    /// only. Default 10, so that training is not held up.
    pub nice: i32,
    /// Films of some episodes. Default: a success and a failure of every group.
    pub films: FilmsConfig,
}

/// The distance between the starts of two evaluations; an evaluation that takes longer is followed by the next at once.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Every {
    /// Minutes of wall time, 0 to 10 000.
    Minutes(f64),
    /// Environment steps that the learner consumed, at least 1.
    Steps(u64),
    /// Weights versions, at least 1.
    Versions(u64),
}

/// A choice of blueprints from the catalog.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Selection {
    /// The splits, none twice. Default: all.
    pub splits: Vec<Split>,
    /// Fewest and most blocks, 1 to 16. Default 1 and 16.
    pub sizes: [usize; 2],
    /// These only, when it is not empty. Default: empty.
    pub blueprints: Vec<BlueprintId>,
}

/// How the episodes of an evaluation begin.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Starts {
    /// All blocks scattered.
    #[default]
    Scattered,
    /// Another training blueprint stands, drawn for each episode.
    Prebuilt,
    /// Every fifth episode prebuilt, the others scattered: the mixture that the paper trains on ("Initial State").
    Mixed,
    /// The goal stands but for one block; for goals that training meets in this way.
    NearGoal,
}

/// How the episodes of an evaluation are run.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EpisodeConfig {
    /// Episodes for each blueprint and way of acting, 1 to 10 000. Default 40 (paper).
    pub n_episodes: u32,
    /// How they begin. Default: scattered.
    pub starts: Starts,
    /// Ways of acting, none twice, at least one. Default: both.
    pub acting: Vec<ActionMode>,
    /// Threads, 1 to 64. Default 1, so that training loses at most one core while an evaluation runs.
    pub n_threads: usize,
    /// Worlds of a thread; each step is one forward pass over them. 1 to 1024. Default 20.
    pub n_worlds: usize,
}

/// Runs over several goals in a world that is never reset (paper, "Reset-Free Evaluation").
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ResetFreeConfig {
    /// Number of runs, 1 to 10 000. Default 50 (paper).
    pub n_runs: u32,
    /// Goals of a run, 1 to 1000. Default 10 (paper).
    pub n_goals: u32,
    /// Fewest blocks of a goal, 1 to 16; goals are training blueprints. Default 12 (paper).
    pub min_blocks: usize,
}

/// A setting that cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum EvaluatorConfigError {
    /// Outside its range.
    #[error(transparent)]
    Setting(#[from] InvalidSetting),
    /// A blueprint that the catalog does not have.
    #[error("the catalog has no blueprint {0}")]
    UnknownBlueprint(BlueprintId),
    /// No blueprint is left to evaluate.
    #[error("the selection of splits, sizes and blueprints leaves nothing to evaluate")]
    NothingSelected,
}

impl Default for EvaluatorConfig {
    fn default() -> Self {
        Self {
            every: Every::Minutes(10.0),
            evaluate_last: false,
            selection: Selection::default(),
            episodes: EpisodeConfig::default(),
            reset_free: None,
            nice: 10,
            films: FilmsConfig::default(),
        }
    }
}

impl Default for Selection {
    fn default() -> Self {
        Self { splits: Split::ALL.to_vec(), sizes: [1, N_BLOCKS], blueprints: Vec::new() }
    }
}

impl Default for EpisodeConfig {
    fn default() -> Self {
        let acting = vec![ActionMode::Greedy, ActionMode::Sampled];
        Self { n_episodes: 40, starts: Starts::default(), acting, n_threads: 1, n_worlds: 20 }
    }
}

impl Default for ResetFreeConfig {
    fn default() -> Self {
        Self { n_runs: 50, n_goals: 10, min_blocks: 12 }
    }
}

impl EvaluatorConfig {
    /// Checks every field against its documented range.
    ///
    /// # Errors
    /// Names the first field that is out of range.
    pub fn validate(&self) -> Result<(), EvaluatorConfigError> {
        match self.every {
            Every::Minutes(minutes) => {
                check("every.minutes", minutes, (0.0..=10_000.0).contains(&minutes), "0..=10000")?;
            }
            Every::Steps(steps) => check("every.steps", steps, steps >= 1, "at least 1")?,
            Every::Versions(versions) => check("every.versions", versions, versions >= 1, "at least 1")?,
        }
        let [low, high] = self.selection.sizes;
        let sizes_ok = 1 <= low && low <= high && high <= N_BLOCKS;
        check("selection.sizes", self.selection.sizes, sizes_ok, "two ascending numbers from 1 to 16")?;
        self.episodes.validate()?;
        check("nice", self.nice, (0..=19).contains(&self.nice), "0..=19")?;
        self.reset_free.as_ref().map_or(Ok(()), ResetFreeConfig::validate)?;
        self.films.validate()
    }
}

impl Selection {
    /// The selected blueprints in the catalog's order.
    ///
    /// # Errors
    /// When a named blueprint is unknown or nothing is selected.
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

impl EpisodeConfig {
    /// Checks every field against its documented range.
    ///
    /// # Errors
    /// Names the first field that is out of range.
    pub fn validate(&self) -> Result<(), EvaluatorConfigError> {
        check("episodes.n_episodes", self.n_episodes, (1..=10_000).contains(&self.n_episodes), "1..=10000")?;
        let distinct = match self.acting[..] {
            [] => false,
            [_] => true,
            [a, b] => a != b,
            _ => false,
        };
        check("episodes.acting", &self.acting, distinct, "\"mode\", \"sampled\" or both")?;
        check("episodes.n_threads", self.n_threads, (1..=64).contains(&self.n_threads), "1..=64")?;
        check("episodes.n_worlds", self.n_worlds, (1..=1024).contains(&self.n_worlds), "1..=1024")
    }
}

impl ResetFreeConfig {
    fn validate(&self) -> Result<(), EvaluatorConfigError> {
        check("reset_free.n_runs", self.n_runs, (1..=10_000).contains(&self.n_runs), "1..=10000")?;
        check("reset_free.n_goals", self.n_goals, (1..=1000).contains(&self.n_goals), "1..=1000")?;
        check("reset_free.min_blocks", self.min_blocks, (1..=N_BLOCKS).contains(&self.min_blocks), "1..=16")
    }
}

pub(crate) fn check(
    field: &'static str,
    value: impl std::fmt::Debug,
    ok: bool,
    expected: &'static str,
) -> Result<(), EvaluatorConfigError> {
    Ok(InvalidSetting::check(format_args!("evaluator.{field}"), format_args!("{value:?}"), ok, expected)?)
}
#[cfg(test)]
mod tests {
    use super::*;
    use blueprints::Group;

    #[test]
    fn the_defaults_are_valid() {
        assert_eq!(EvaluatorConfig::default().validate(), Ok(()));
        assert_eq!(ResetFreeConfig::default().validate(), Ok(()));
    }

    #[test]
    fn an_error_names_field_value_and_range() {
        let twice = EpisodeConfig { acting: vec![ActionMode::Greedy, ActionMode::Greedy], ..Default::default() };
        let table = [
            (
                EvaluatorConfig { every: Every::Steps(0), ..Default::default() },
                "evaluator.every.steps = 0: expected at least 1",
            ),
            (
                EvaluatorConfig { every: Every::Minutes(f64::NAN), ..Default::default() },
                "evaluator.every.minutes = NaN: expected 0..=10000",
            ),
            (
                EvaluatorConfig { episodes: twice, ..Default::default() },
                "evaluator.episodes.acting = [Greedy, Greedy]: expected \"mode\", \"sampled\" or both",
            ),
            (
                EvaluatorConfig {
                    reset_free: Some(ResetFreeConfig { min_blocks: 17, ..Default::default() }),
                    ..Default::default()
                },
                "evaluator.reset_free.min_blocks = 17: expected 1..=16",
            ),
            (
                EvaluatorConfig {
                    films: FilmsConfig { groups: vec![Group::Train2To6; 2], ..Default::default() },
                    ..Default::default()
                },
                "evaluator.films.groups = [Train2To6, Train2To6]: expected names of groups, none twice",
            ),
        ];
        for (config, message) in table {
            assert_eq!(config.validate().unwrap_err().to_string(), message);
        }
    }
}
