//! The verdict on weights, by which the best weights of a run are found.

use std::fmt;
use std::sync::Arc;

use blueprints::{Blueprint, Split};
use proto::metrics::{EvalBlueprint, EvalReport};
use proto::wilson::SuccessRate;
use proto::{ActionMode, Weights};
use serde::{Deserialize, Serialize};

use crate::config::BestConfig;

/// Weights and the verdict of their complete evaluation.
#[derive(Clone, Debug)]
pub struct Scored {
    /// The weights.
    pub weights: Arc<Weights>,
    /// The verdict.
    pub verdict: Verdict,
}

/// The success of an evaluation that [`BestConfig`] asks for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Verdict {
    /// The goals that count: the name of a split, or `all`.
    pub goals: String,
    /// Number of these goals.
    pub n_goals: u64,
    /// How the policy acted.
    pub acting: ActionMode,
    /// Success over all episodes of these goals.
    pub success: SuccessRate,
}

impl Verdict {
    /// Computes the verdict of a report. Of its blueprints, only `usual` ones count: the last evaluation of a run has
    /// more, which must not influence training.
    pub(crate) fn of(config: &BestConfig, usual: &[Blueprint], report: &EvalReport) -> Self {
        let is_usual = |score: &&EvalBlueprint| usual.iter().any(|goal| *goal.id() == score.blueprint);
        let usual: Vec<&EvalBlueprint> = report.blueprints.iter().filter(is_usual).collect();
        let of_split = |split| usual.iter().filter(|score| score.split == split).copied().collect::<Vec<_>>();
        let of_splits = [config.split, Split::Train].map(|split| (split.to_string(), of_split(split)));
        let (name, goals) = of_splits
            .into_iter()
            .find(|(_, goals)| !goals.is_empty())
            .unwrap_or_else(|| ("all".to_owned(), usual.clone()));
        let success = |acting| -> SuccessRate {
            goals.iter().filter_map(|score| score.outcome(acting)).map(|outcome| outcome.success).sum()
        };
        let was_run = |acting: &ActionMode| success(*acting).n_episodes > 0;
        let acting = [config.acting, config.acting.other()].into_iter().find(was_run).unwrap_or(config.acting);
        Self { goals: name, n_goals: goals.len() as u64, acting, success: success(acting) }
    }

    /// Whether weights with this verdict take the place of earlier ones with the verdict `before`. A verdict on other
    /// goals, or on another way of acting, cannot be compared, so the newer one counts.
    pub fn beats(&self, before: &Self) -> bool {
        let asks = |verdict: &Self| (verdict.goals.clone(), verdict.n_goals, verdict.acting);
        asks(self) != asks(before) || self.success.rate >= before.success.rate
    }
}

/// For example `91.7 % of 240 sampled episodes of 24 goals (validation)`.
impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { goals, n_goals, acting, success } = self;
        let percent = 100.0 * success.rate;
        write!(f, "{percent:.1} % of {} {acting} episodes of {n_goals} goals ({goals})", success.n_episodes)
    }
}

#[cfg(test)]
mod tests {
    use blueprints::Catalog;
    use proto::WeightsVersion;

    use super::*;
    use crate::report::tests::{episode, goal};
    use crate::report::{End, summarize};

    /// A report of one episode for each of these goals and outcomes.
    fn report(episodes: &[(&str, ActionMode, bool)]) -> EvalReport {
        let result = |&(id, acting, is_success): &(&str, ActionMode, bool)| {
            let end = if is_success { End::Success { stable: true } } else { End::TimeLimit };
            episode(id, acting, end, 9)
        };
        summarize(WeightsVersion(3), 300, &episodes.iter().map(result).collect::<Vec<_>>())
    }

    #[test]
    fn the_verdict_is_on_the_split_and_the_actions_that_are_asked_for_as_far_as_there_are_any() {
        use ActionMode::{Greedy, Sampled};
        let summary = |usual: &[&str], episodes: &[(&str, ActionMode, bool)]| {
            let usual: Vec<_> = usual.iter().map(|id| goal(id).clone()).collect();
            Verdict::of(&BestConfig::default(), &usual, &report(episodes)).to_string()
        };
        let test = Catalog::builtin().iter().find(|goal| goal.split() == Split::Test).unwrap().id().as_str();
        let all = ["validation_7_000", "2_000", test];
        let episodes = [
            (all[0], Sampled, true),
            (all[0], Sampled, false),
            (all[0], Greedy, true),
            (all[1], Sampled, true),
            (all[2], Sampled, false),
        ];
        assert_eq!(summary(&all, &episodes), "50.0 % of 2 sampled episodes of 1 goals (validation)");
        assert_eq!(summary(&all[1..], &episodes), "100.0 % of 1 sampled episodes of 1 goals (train)");
        // Goals of the last evaluation alone do not count.
        assert_eq!(summary(&all[2..], &episodes), "0.0 % of 1 sampled episodes of 1 goals (all)");
        assert_eq!(summary(&all, &episodes[2..3]), "100.0 % of 1 greedy episodes of 1 goals (validation)");
    }

    #[test]
    fn the_better_one_stays_and_of_equal_ones_the_later() {
        let verdict = |n_successes, goals: &str| Verdict {
            goals: goals.to_owned(),
            n_goals: 2,
            acting: ActionMode::Sampled,
            success: SuccessRate::new(n_successes, 10),
        };
        let beats = |new, before| verdict(new, "train").beats(&verdict(before, "train"));
        assert!(beats(6, 5) && beats(5, 5) && !beats(4, 5));
        assert!(verdict(1, "validation").beats(&verdict(9, "train")), "it cannot be compared");
    }
}
