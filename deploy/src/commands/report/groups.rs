//! The table of groups in one evaluation, as Markdown and as comma-separated values.

use blueprints::Group;
use proto::ActionMode;
use proto::metrics::EvalOutcome;
use proto::wilson::SuccessRate;
use runlog::Evaluation;
use runlog::series::{group_of, outcome_of};

/// Results of a group with one action mode.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct GroupRow {
    /// `train 2-6` and so on, `validation`, `all`, or `reset-free`.
    pub(super) name: String,
    /// Number of blueprints, or of goals in a reset-free run.
    pub(super) n_blueprints: usize,
    /// The action mode.
    pub(super) acting: ActionMode,
    /// Success rate with its interval.
    pub(super) success: SuccessRate,
    /// Stable success rate.
    pub(super) stable: SuccessRate,
    /// Mean steps of the successful episodes, if there are any.
    pub(super) mean_steps_to_success: Option<f64>,
    /// Mean undiscounted return.
    pub(super) mean_return: f64,
    /// Episodes whose physics diverged.
    pub(super) n_diverged: u64,
}

/// Returns the rows of an evaluation: the paper's groups in its order, the validation split, all blueprints, and the
/// reset-free runs; those that were not evaluated are left out.
pub(super) fn rows(evaluation: &Evaluation) -> Vec<GroupRow> {
    let mut rows = Vec::new();
    for group in Group::ALL.map(Some).into_iter().chain([None]) {
        for acting in [ActionMode::Greedy, ActionMode::Sampled] {
            let members = evaluation.blueprints.iter().filter(|score| group.is_none() || group_of(score) == group);
            let outcomes: Vec<&EvalOutcome> = members.filter_map(|score| outcome_of(score, acting)).collect();
            rows.extend(row(group.map_or("all", Group::name), acting, outcomes.len(), &outcomes));
        }
    }
    if let Some(runs) = &evaluation.reset_free {
        let n_goals = usize::try_from(runs.n_goals).unwrap_or(usize::MAX);
        for (acting, runs) in [(ActionMode::Greedy, &runs.greedy), (ActionMode::Sampled, &runs.sampled)] {
            if runs.outcome.success.n_episodes > 0 {
                rows.extend(row("reset-free", acting, n_goals, &[&runs.outcome]));
            }
        }
    }
    rows
}

fn row(name: &str, acting: ActionMode, n_blueprints: usize, outcomes: &[&EvalOutcome]) -> Option<GroupRow> {
    let sum = |count: fn(&EvalOutcome) -> u64| outcomes.iter().map(|outcome| count(outcome)).sum::<u64>();
    let n_episodes = sum(|outcome| outcome.success.n_episodes);
    let n_successes = sum(|outcome| outcome.success.n_successes);
    let steps =
        outcomes.iter().filter_map(|outcome| Some(outcome.mean_steps_to_success? * outcome.success.n_successes as f64));
    let returns =
        outcomes.iter().map(|outcome| f64::from(outcome.mean_return.total()) * outcome.success.n_episodes as f64);
    (n_episodes > 0).then(|| GroupRow {
        name: name.to_owned(),
        n_blueprints,
        acting,
        success: SuccessRate::new(n_successes, n_episodes),
        stable: SuccessRate::new(sum(|outcome| outcome.stable_success.n_successes), n_episodes),
        mean_steps_to_success: (n_successes > 0).then(|| steps.sum::<f64>() / n_successes as f64),
        mean_return: returns.sum::<f64>() / n_episodes as f64,
        n_diverged: sum(|outcome| outcome.n_diverged),
    })
}

/// Formats the rows as a Markdown table, rates in percent with the 95 % interval.
pub(super) fn markdown(rows: &[GroupRow]) -> String {
    let mut text = "| group | blueprints | actions | episodes | success | 95 % interval | stable | steps to success | \
                    return | diverged |\n|---|---|---|---|---|---|---|---|---|---|\n"
        .to_owned();
    for row in rows {
        let [success, low, high, stable] =
            [row.success.rate, row.success.wilson_low, row.success.wilson_high, row.stable.rate].map(|x| 100.0 * x);
        let steps = row.mean_steps_to_success.map_or_else(|| "-".to_owned(), |steps| format!("{steps:.1}"));
        text += &format!(
            "| {} | {} | {} | {} | {success:.1} % | {low:.1} to {high:.1} | {stable:.1} % | {steps} | {:.2} | {} |\n",
            row.name, row.n_blueprints, row.acting, row.success.n_episodes, row.mean_return, row.n_diverged
        );
    }
    text
}

/// Formats the rows as comma-separated values with a header; rates from 0 to 1, missing numbers empty.
pub(super) fn csv(rows: &[GroupRow]) -> String {
    let mut text =
        "group,n_blueprints,acting,n_episodes,n_successes,success,wilson_low,wilson_high,n_stable_successes,\
                    mean_steps_to_success,mean_return,n_diverged\n"
            .to_owned();
    for row in rows {
        let steps = row.mean_steps_to_success.map(|steps| steps.to_string()).unwrap_or_default();
        let SuccessRate { n_successes, n_episodes, rate, wilson_low, wilson_high } = row.success;
        text += &format!(
            "{},{},{},{n_episodes},{n_successes},{rate},{wilson_low},{wilson_high},{},{steps},{},{}\n",
            row.name, row.n_blueprints, row.acting, row.stable.n_successes, row.mean_return, row.n_diverged
        );
    }
    text
}
