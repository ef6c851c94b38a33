//! Summarizes finished episodes per blueprint and group.

use std::collections::{BTreeMap, BTreeSet};

use blueprints::{BlueprintId, Group, Split};
use proto::metrics::{
    BusCounts, EvalBlueprint, EvalGroup, EvalOutcome, EvalReport, EvalSummary, METRICS_SCHEMA_VERSION,
};
use proto::wilson::SuccessRate;
use proto::{ActionMode, RewardTerms, WeightsVersion};

/// The end of an episode.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// The blueprint is complete.
    Success {
        /// Whether it was still complete some steps later.
        stable: bool,
    },
    /// The episode reached the time limit.
    TimeLimit,
    /// The physics diverged.
    Diverged,
}

/// Result of an episode.
#[derive(Clone, Debug, PartialEq)]
pub struct EpisodeResult {
    /// The goal.
    pub blueprint: BlueprintId,
    /// The goal's split.
    pub split: Split,
    /// The goal's number of blocks.
    pub n_blocks: usize,
    /// Action mode.
    pub acting: ActionMode,
    /// How the episode ended.
    pub end: End,
    /// Number of steps, at least 1.
    pub n_steps: u32,
    /// Undiscounted return by term.
    pub episode_return: RewardTerms,
    /// Whether the world was reset because it had diverged, although the episode should have started without a reset.
    pub forced_reset: bool,
}

/// Groups the episodes of weights trained on `n_env_steps` by blueprint and group. The report is marked complete.
/// Fields that do not follow from the episodes stay 0: the seed, the plan, the duration, and all counts.
pub(crate) fn summarize(weights_version: WeightsVersion, n_env_steps: u64, episodes: &[EpisodeResult]) -> EvalReport {
    let mut by_blueprint: BTreeMap<(Split, usize, &BlueprintId), Vec<&EpisodeResult>> = BTreeMap::new();
    let mut by_group: BTreeMap<Group, Vec<&EpisodeResult>> = BTreeMap::new();
    for episode in episodes {
        let key = (episode.split, episode.n_blocks, &episode.blueprint);
        by_blueprint.entry(key).or_default().push(episode);
        if let Some(group) = Group::of(episode.split, episode.n_blocks) {
            by_group.entry(group).or_default().push(episode);
        }
    }
    let blueprints = by_blueprint.into_iter().map(|((split, n_blocks, id), episodes)| EvalBlueprint {
        schema_version: METRICS_SCHEMA_VERSION,
        weights_version,
        n_env_steps,
        blueprint: id.clone(),
        split,
        n_blocks: n_blocks as u64,
        sampled: outcome(&episodes, ActionMode::Sampled),
        greedy: outcome(&episodes, ActionMode::Greedy),
    });
    let summary = EvalSummary {
        schema_version: METRICS_SCHEMA_VERSION,
        weights_version,
        n_env_steps,
        elapsed_s: 0.0,
        is_complete: true,
        n_planned: 0,
        seed: 0,
        all: score_group("all", &episodes.iter().collect::<Vec<_>>()),
        groups: by_group.iter().map(|(group, episodes)| score_group(group.name(), episodes)).collect(),
        reset_free: None,
        bus: BusCounts::default(),
        videos: None,
    };
    EvalReport { summary, blueprints: blueprints.collect() }
}

/// Returns success, steps, and return of the episodes with the action mode `acting`.
pub(crate) fn outcome(episodes: &[&EpisodeResult], acting: ActionMode) -> EvalOutcome {
    let (mut n_episodes, mut n_successes, mut n_stable, mut n_diverged) = (0_u64, 0_u64, 0_u64, 0_u64);
    let (mut n_steps, mut n_steps_to_success) = (0_u64, 0_u64);
    let mut sum = [0.0_f64; 5];
    for episode in episodes.iter().filter(|episode| episode.acting == acting) {
        n_episodes += 1;
        n_steps += u64::from(episode.n_steps);
        match episode.end {
            End::Success { stable } => {
                n_successes += 1;
                n_stable += u64::from(stable);
                n_steps_to_success += u64::from(episode.n_steps);
            }
            End::TimeLimit => {}
            End::Diverged => n_diverged += 1,
        }
        sum.iter_mut().zip(episode.episode_return.to_array()).for_each(|(s, x)| *s += f64::from(x));
    }
    let n = n_episodes.max(1) as f64;
    EvalOutcome {
        success: SuccessRate::new(n_successes, n_episodes),
        stable_success: SuccessRate::new(n_stable, n_episodes),
        mean_steps: n_steps as f64 / n,
        mean_steps_to_success: (n_successes > 0).then(|| n_steps_to_success as f64 / n_successes as f64),
        mean_return: RewardTerms::from_array(sum.map(|s| (s / n) as f32)),
        n_diverged,
    }
}

fn score_group(name: &str, episodes: &[&EpisodeResult]) -> EvalGroup {
    let ids: BTreeSet<&BlueprintId> = episodes.iter().map(|episode| &episode.blueprint).collect();
    EvalGroup {
        name: name.to_owned(),
        n_blueprints: ids.len() as u64,
        sampled: outcome(episodes, ActionMode::Sampled),
        greedy: outcome(episodes, ActionMode::Greedy),
    }
}

#[cfg(test)]
pub(crate) mod tests;
