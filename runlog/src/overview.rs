//! An overview of a run's evaluations, small enough to keep in memory and to send to the page and over the bus.

use std::collections::BTreeMap;

use proto::wilson::SuccessRate;
use serde::Serialize;

use crate::Evaluation;
use crate::series::{Row, push_newer};
use blueprints::Group;
use proto::ActionMode;

/// Version of the overview's schema. Within a version, fields are only added.
const SCHEMA_VERSION: u32 = 2;

/// Maximum number of evaluations kept. Above it, every other one is dropped; the newest always stays.
const MAX_PASSES: usize = 400;

/// The evaluations of a run, with increasing environment steps.
#[derive(Debug, Default)]
pub struct Evaluations {
    kept: Vec<Kept>,
    n_left_out: u64,
}

/// Number of successes and of episodes.
type Counts = [u64; 2];

/// The parts of an evaluation that the overview shows.
#[derive(Debug)]
struct Kept {
    head: Head,
    rates: BTreeMap<Row, [Option<Counts>; 2]>,
}

/// Metadata and group results of an evaluation.
#[derive(Clone, Debug, Serialize)]
pub struct Head {
    ended_unix_ms: u64,
    elapsed_s: f64,
    /// Version of the evaluated weights.
    pub weights_version: u64,
    /// Environment steps that the learner had consumed when it published the weights.
    pub n_env_steps: u64,
    seed: u64,
    /// Results by group: the paper's in its order, then validation.
    pub groups: Vec<GroupView>,
    /// Results of all blueprints.
    pub all: GroupView,
}

/// Results of a group of blueprints in one evaluation.
#[derive(Clone, Debug, Serialize)]
pub struct GroupView {
    /// `all`, or the group's name.
    pub name: &'static str,
    n_blueprints: usize,
    /// Success rate with greedy actions; `None` if not evaluated.
    pub greedy: Option<SuccessRate>,
    /// Success rate with sampled actions; `None` if not evaluated.
    pub sampled: Option<SuccessRate>,
}

/// An evaluation as serialized; the counts are in the order of the blueprint table.
#[derive(Debug, Serialize)]
struct EvaluationView<'p> {
    #[serde(flatten)]
    head: &'p Head,
    greedy: Vec<Option<Counts>>,
    sampled: Vec<Option<Counts>>,
}

/// All evaluations as serialized: the reply to a history query on the bus, and most of the one to the page.
#[derive(Debug, Serialize)]
pub struct Overview<'p> {
    schema_version: u32,
    blueprints: Vec<&'p Row>,
    n_left_out: u64,
    evaluations: Vec<EvaluationView<'p>>,
}

impl Evaluations {
    /// Adds an evaluation and removes those that it makes obsolete, as in [`lineage`](crate::series::lineage): a run
    /// resumed from an older checkpoint repeats some steps.
    pub fn push(&mut self, evaluation: &Evaluation) {
        push_newer(&mut self.kept, Kept::new(evaluation), |kept| kept.head.n_env_steps);
        if self.kept.len() > MAX_PASSES {
            let n_before = self.kept.len();
            let mut place = n_before;
            self.kept.retain(|_| {
                place -= 1;
                place.is_multiple_of(2)
            });
            self.n_left_out += (n_before - self.kept.len()) as u64;
        }
    }

    /// Returns the newest evaluation.
    pub fn last(&self) -> Option<&Head> {
        Some(&self.kept.last()?.head)
    }

    /// Returns successes and episodes of the newest evaluation, as `(blueprint, action mode, counts)`.
    pub fn newest(&self) -> impl Iterator<Item = (&Row, ActionMode, Counts)> {
        let rates = self.kept.last().into_iter().flat_map(|evaluation| &evaluation.rates);
        rates.flat_map(|(row, [greedy, sampled])| {
            let both = [(ActionMode::Greedy, *greedy), (ActionMode::Sampled, *sampled)];
            both.into_iter().filter_map(move |(acting, counts)| Some((row, acting, counts?)))
        })
    }

    /// Returns the overview.
    pub fn overview(&self) -> Overview<'_> {
        let mut rows: Vec<&Row> = self.kept.iter().flat_map(|evaluation| evaluation.rates.keys()).collect();
        rows.sort();
        rows.dedup();
        let counts = |evaluation: &Kept, place: usize| -> Vec<Option<Counts>> {
            rows.iter().map(|row| evaluation.rates.get(*row)?[place]).collect()
        };
        let evaluations = self.kept.iter().map(|evaluation| EvaluationView {
            head: &evaluation.head,
            greedy: counts(evaluation, 0),
            sampled: counts(evaluation, 1),
        });
        let evaluations = evaluations.collect();
        Overview { schema_version: SCHEMA_VERSION, blueprints: rows, n_left_out: self.n_left_out, evaluations }
    }
}

impl Kept {
    fn new(evaluation: &Evaluation) -> Self {
        let mut rates = BTreeMap::new();
        let mut by_group: BTreeMap<Group, Vec<[Option<Counts>; 2]>> = BTreeMap::new();
        for score in &evaluation.blueprints {
            let counts = [ActionMode::Greedy, ActionMode::Sampled].map(|acting| {
                let success = score.outcome(acting)?.success;
                Some([success.n_successes, success.n_episodes])
            });
            rates.insert(Row::of(score), counts);
            if let Some(group) = score.group() {
                by_group.entry(group).or_default().push(counts);
            }
        }
        let all: Vec<_> = rates.values().copied().collect();
        let head = Head {
            ended_unix_ms: evaluation.ended_unix_ms,
            elapsed_s: evaluation.elapsed_s,
            weights_version: evaluation.weights_version.0,
            n_env_steps: evaluation.n_env_steps,
            seed: evaluation.seed,
            groups: by_group.iter().map(|(group, counts)| GroupView::new(group.name(), counts)).collect(),
            all: GroupView::new("all", &all),
        };
        Self { head, rates }
    }
}

impl GroupView {
    /// Sums the counts of blueprints, each with greedy and with sampled actions.
    fn new(name: &'static str, counts: &[[Option<Counts>; 2]]) -> Self {
        let sum = |place: usize| {
            let evaluated = counts.iter().filter_map(|both| both[place]);
            let total = evaluated.reduce(|[hits, n], [more_hits, more]| [hits + more_hits, n + more]);
            total.map(|[hits, n]| SuccessRate::new(hits, n))
        };
        Self { name, n_blueprints: counts.len(), greedy: sum(0), sampled: sum(1) }
    }
}

#[cfg(test)]
mod tests {
    use blueprints::Split;
    use serde_json::json;

    use super::*;
    use crate::history::tests::samples::evaluation;

    #[test]
    fn overview_matches_a_hand_worked_history() {
        let mut evaluations = Evaluations::default();
        evaluations.push(&evaluation(100, &[("2_003", Split::Train, 2, 0)]));
        // Abandoned: the run goes on from the checkpoint at 100.
        evaluations.push(&evaluation(200, &[]));
        evaluations.push(&evaluation(300, &[]));
        evaluations.push(&evaluation(
            200,
            &[("2_003", Split::Train, 2, 4), ("3_001", Split::Train, 3, 5), ("7_000", Split::Train, 7, 10)],
        ));
        let view = serde_json::to_value(evaluations.overview()).unwrap();
        assert_eq!(
            view["blueprints"],
            json!([
                { "id": "2_003", "split": "train", "n_blocks": 2, "group": "train 2-6" },
                { "id": "3_001", "split": "train", "n_blocks": 3, "group": "train 2-6" },
                { "id": "7_000", "split": "train", "n_blocks": 7, "group": "train 7-11" },
            ])
        );
        assert_eq!(view["evaluations"].as_array().unwrap().len(), 2);
        assert_eq!(view["evaluations"][0]["greedy"], json!([[0, 10], null, null]));
        assert_eq!(view["evaluations"][1]["greedy"], json!([[4, 10], [5, 10], [10, 10]]));
        assert_eq!(view["evaluations"][1]["sampled"], json!([null, null, null]));
        // 9 of 20: z² = 3.8415, center (0.45 + z²/40) / (1 + z²/20) = 0.4581, half width 0.2003.
        let group = &view["evaluations"][1]["groups"][0];
        assert_eq!(
            (&group["name"], &group["n_blueprints"], &group["sampled"]),
            (&json!("train 2-6"), &json!(2), &json!(null))
        );
        assert_eq!((&group["greedy"]["n_successes"], &group["greedy"]["n_episodes"]), (&json!(9), &json!(20)));
        let low = group["greedy"]["wilson_low"].as_f64().unwrap();
        assert!((low - 0.2582).abs() < 5e-4, "{low}");
        let all = &view["evaluations"][1]["all"];
        assert_eq!((&all["n_blueprints"], &all["greedy"]["n_successes"]), (&json!(3), &json!(19)));
    }

    #[test]
    fn many_evaluations_are_thinned_and_the_newest_stays() {
        let mut evaluations = Evaluations::default();
        for steps in 0..=MAX_PASSES as u64 {
            evaluations.push(&evaluation(steps, &[]));
        }
        // Of 401 evaluations, every other one stays, counted from the newest: 400, 398, and so on to 0, 201 in total.
        assert_eq!((evaluations.kept.len(), evaluations.n_left_out), (201, 200));
        assert_eq!(evaluations.last().map(|head| head.n_env_steps), Some(400));
    }
}
