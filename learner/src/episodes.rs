//! Statistics of finished episodes between two reports.

use std::collections::BTreeMap;

use blueprints::BlueprintId;
use proto::metrics::EpisodeMetrics;
use proto::wilson::SuccessRate;
use proto::{RewardTerms, Trajectory};

/// Sums over finished episodes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct EpisodeTally {
    n_steps: u64,
    episode_return: RewardTerms,
    by_blueprint: BTreeMap<BlueprintId, (u64, u64)>,
}

impl EpisodeTally {
    /// Counts the episodes that end in these segments.
    pub fn of(trajectories: &[Trajectory]) -> Self {
        let mut tally = Self::default();
        for trajectory in trajectories {
            let Some(stats) = &trajectory.episode_stats else { continue };
            tally.n_steps += u64::from(stats.n_steps);
            tally.episode_return = tally.episode_return + stats.episode_return;
            let (n_successes, n_episodes) = tally.by_blueprint.entry(trajectory.task.blueprint.clone()).or_default();
            *n_successes += u64::from(stats.success);
            *n_episodes += 1;
        }
        tally
    }

    /// Returns the number of episodes.
    pub fn n_episodes(&self) -> u64 {
        self.by_blueprint.values().map(|(_, n)| n).sum()
    }

    /// Returns the means and rates as metrics.
    pub fn metrics(&self) -> EpisodeMetrics {
        let n_episodes = self.n_episodes();
        let n_successes = self.by_blueprint.values().map(|(n, _)| n).sum();
        let n = n_episodes.max(1) as f32;
        let sum = &self.episode_return;
        EpisodeMetrics {
            success: SuccessRate::new(n_successes, n_episodes),
            mean_steps: self.n_steps as f64 / n_episodes.max(1) as f64,
            mean_return: RewardTerms {
                connected: sum.connected / n,
                wrong: sum.wrong / n,
                magnets: sum.magnets / n,
                blocks: sum.blocks / n,
                force: sum.force / n,
            },
            success_by_blueprint: self
                .by_blueprint
                .iter()
                .map(|(id, &(n_successes, n_episodes))| (id.clone(), SuccessRate::new(n_successes, n_episodes)))
                .collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use proto::EpisodeStats;

    use super::*;
    use crate::fixtures::{blueprint_id, trajectory};

    #[test]
    fn only_finished_episodes_count() {
        let mut ended = trajectory(2, 0);
        let episode_return = RewardTerms { connected: 1.0, wrong: -0.5, ..RewardTerms::default() };
        ended.episode_stats = Some(EpisodeStats { success: true, n_steps: 30, episode_return });
        let mut failed = ended.clone();
        failed.episode_stats =
            Some(EpisodeStats { success: false, n_steps: 50, episode_return: RewardTerms::default() });
        let metrics = EpisodeTally::of(&[ended, trajectory(3, 0), failed]).metrics();
        assert_eq!((metrics.success.n_successes, metrics.success.n_episodes), (1, 2));
        assert_eq!(metrics.mean_steps, 40.0);
        assert_eq!((metrics.mean_return.connected, metrics.mean_return.wrong), (0.5, -0.25));
        assert_eq!(metrics.success_by_blueprint[&blueprint_id()].n_episodes, 2);
    }
}
