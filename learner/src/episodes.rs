//! Statistics of the episodes that end in a batch.

use std::collections::BTreeMap;

use blueprints::BlueprintId;
use proto::metrics::EpisodeMetrics;
use proto::wilson::SuccessRate;
use proto::{RewardTerms, Trajectory};

/// Returns means and rates over the episodes that end in these segments.
pub fn episode_metrics(trajectories: &[Trajectory]) -> EpisodeMetrics {
    let (mut n_steps, mut sum) = (0, RewardTerms::default());
    let mut by_blueprint: BTreeMap<BlueprintId, (u64, u64)> = BTreeMap::new();
    for trajectory in trajectories {
        let Some(stats) = &trajectory.episode_stats else { continue };
        n_steps += u64::from(stats.n_steps);
        sum = sum + stats.episode_return;
        let (n_successes, n_episodes) = by_blueprint.entry(trajectory.task.blueprint.clone()).or_default();
        *n_successes += u64::from(stats.success);
        *n_episodes += 1;
    }
    let (n_successes, n_episodes) =
        by_blueprint.values().fold((0, 0), |(successes, episodes), (s, e)| (successes + s, episodes + e));
    let n = n_episodes.max(1);
    EpisodeMetrics {
        success: SuccessRate::new(n_successes, n_episodes),
        mean_steps: n_steps as f64 / n as f64,
        mean_return: RewardTerms::from_array(sum.to_array().map(|term| term / n as f32)),
        success_by_blueprint: by_blueprint.into_iter().map(|(id, (s, e))| (id, SuccessRate::new(s, e))).collect(),
    }
}

#[cfg(test)]
mod tests {
    use proto::EpisodeStats;

    use super::*;
    use crate::tests::fixtures::{blueprint_id, trajectory};

    #[test]
    fn only_finished_episodes_count() {
        let mut ended = trajectory(2, 0);
        let episode_return = RewardTerms { connected: 1.0, wrong: -0.5, ..RewardTerms::default() };
        ended.episode_stats = Some(EpisodeStats { success: true, n_steps: 30, episode_return });
        let mut failed = ended.clone();
        failed.episode_stats =
            Some(EpisodeStats { success: false, n_steps: 50, episode_return: RewardTerms::default() });
        let metrics = episode_metrics(&[ended, trajectory(3, 0), failed]);
        assert_eq!((metrics.success.n_successes, metrics.success.n_episodes), (1, 2));
        assert_eq!(metrics.mean_steps, 40.0);
        assert_eq!((metrics.mean_return.connected, metrics.mean_return.wrong), (0.5, -0.25));
        assert_eq!(metrics.success_by_blueprint[&blueprint_id()].n_episodes, 2);
    }
}
