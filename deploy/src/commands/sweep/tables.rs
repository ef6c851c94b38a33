//! The tables of a sweep, as Markdown and as comma-separated values.

use proto::ActionMode;

use super::results::{FailedRun, PointResult, Results};
use super::scores::GroupResult;
use super::statistics::Aggregate;
use crate::commands::files::File;
use crate::commands::report::tables::{csv, quoted};

/// A rate with its interval, if there is one.
type Rate = (f64, Option<[f64; 2]>);

/// A group and its number of goals.
type Column = (String, usize);

impl Results {
    /// Renders the success of every point by group, in percent, and below it the runs that are missing.
    pub(in crate::commands) fn markdown(&self) -> String {
        let mut text = String::new();
        self.table(&mut text, "mean", |of| (of.mean, of.mean_interval));
        self.table(&mut text, "interquartile mean", |of| (of.iqm, of.iqm_interval));
        for PointResult { name, failed, unfinished, .. } in &self.points {
            for FailedRun { seed, status, log } in failed {
                text += &format!("failed: {name}, seed {seed} ({status}); see {}\n", log.display());
            }
            if !unfinished.is_empty() {
                text += &format!("not finished: {name}, seeds {unfinished:?}\n");
            }
        }
        text
    }

    /// One row for each point and action mode, and one column for each group and number of goals: points that were
    /// evaluated on other goals are not compared.
    fn table(&self, text: &mut String, what: &str, rate: fn(&Aggregate) -> Rate) {
        let column = |of: &GroupResult| (of.group.clone(), of.n_goals);
        let mut columns: Vec<Column> = Vec::new();
        for group in self.points.iter().flat_map(|point| &point.groups).map(column) {
            columns.extend((!columns.contains(&group)).then_some(group));
        }
        let heads: String = columns.iter().map(|(group, n_goals)| format!(" {group} ({n_goals}) |")).collect();
        *text += &format!("Success by group (goals), in %: {what} over seeds and goals, with its 95 % interval\n\n");
        *text += &format!("| point | actions | seeds |{heads}\n|{}\n", "---|".repeat(3 + columns.len()));
        for PointResult { name, groups, failed, .. } in &self.points {
            for acting in [ActionMode::Greedy, ActionMode::Sampled] {
                let found = || groups.iter().filter(move |of| of.acting == acting);
                let Some(n_runs) = found().map(|of| of.n_runs).max() else { continue };
                let cell =
                    |wanted: &Column| found().find(|of| column(of) == *wanted).map(|of| percent(rate(&of.aggregate)));
                let cells = columns.iter().map(|column| format!(" {} |", cell(column).as_deref().unwrap_or("-")));
                *text += &format!("| {name} | {acting} | {n_runs} |{}\n", cells.collect::<String>());
            }
            if groups.is_empty() {
                let state = if failed.is_empty() { "not finished" } else { "failed" };
                *text += &format!("| {name} | {state} | 0 |{}\n", " |".repeat(columns.len()));
            }
        }
        text.push('\n');
    }

    /// The files of a report: the tables, and the curves of one action mode.
    pub(in crate::commands) fn files(&self, acting: ActionMode) -> Vec<File> {
        let of_point = |point: &PointResult| {
            let name = vec![quoted(&point.name)];
            point.groups.iter().map(|of| row(&name, of)).collect::<Vec<_>>()
        };
        let of_curve = |point: &PointResult| {
            let moments = point.curve.iter().flat_map(|moment| {
                let lead = [quoted(&point.name), moment.n_env_steps.to_string()];
                moment.groups.iter().filter(move |of| of.acting == acting).map(move |of| row(&lead, of))
            });
            moments.collect::<Vec<_>>()
        };
        let head = "group,acting,n_runs,n_goals,mean,mean_low,mean_high,iqm,iqm_low,iqm_high\n";
        let groups = format!("point,{head}{}", csv(self.points.iter().flat_map(of_point)));
        let curves = format!("point,n_env_steps,{head}{}", csv(self.points.iter().flat_map(of_curve)));
        let files = [("groups.md", self.markdown()), ("groups.csv", groups), ("curves.csv", curves)];
        files.map(|(name, text)| (name.to_owned(), text.into_bytes())).into()
    }
}

fn percent((rate, interval): Rate) -> String {
    let range = |[low, high]: [f64; 2]| format!(" ({:.1}–{:.1})", 100.0 * low, 100.0 * high);
    format!("{:.1}{}", 100.0 * rate, interval.map(range).unwrap_or_default())
}

/// Rates from 0 to 1; an interval that does not exist is empty.
fn row(lead: &[String], of: &GroupResult) -> Vec<String> {
    let ends = |of: Option<[f64; 2]>| of.map_or_else(Default::default, |ends| ends.map(|end| end.to_string()));
    let ([mean_low, mean_high], [iqm_low, iqm_high]) =
        (ends(of.aggregate.mean_interval), ends(of.aggregate.iqm_interval));
    let [n_runs, n_goals] = [of.n_runs, of.n_goals].map(|n| n.to_string());
    let [mean, iqm] = [of.aggregate.mean, of.aggregate.iqm].map(|rate| rate.to_string());
    let numbers = [n_runs, n_goals, mean, mean_low, mean_high, iqm, iqm_low, iqm_high];
    [lead, &[of.group.clone(), of.acting.to_string()], &numbers].concat()
}

#[cfg(test)]
mod tests {
    use super::super::plan::{Plan, PlannedPoint};
    use super::super::results::RunResult;
    use super::super::scores::{Moment, Score};
    use super::*;

    /// Four goals with a mean of 0.375 and, without the lowest and the highest, 0.25.
    const TRAIN: [(&str, &str, f64); 4] = [
        ("train 2-6", "2_000", 0.0),
        ("train 2-6", "2_001", 0.25),
        ("train 2-6", "2_002", 0.25),
        ("train 2-6", "2_003", 1.0),
    ];

    #[test]
    fn the_tables_have_every_point_and_say_what_is_missing() {
        let folder = tempfile::tempdir().unwrap();
        let point = |gamma: &str| PlannedPoint {
            settings: vec![("learner.gamma".to_owned(), gamma.to_owned())],
            config: String::new(),
        };
        let plan = Plan {
            lodestone_version: String::new(),
            command: Vec::new(),
            seeds: vec![1, 2],
            points: ["0.9", "0.95", "0.99"].map(point).to_vec(),
        };
        let keep = |point: usize, seed: u64, result: RunResult| {
            let runs = plan.runs(folder.path());
            let run = runs.iter().find(|run| (run.point, run.seed) == (point, seed)).unwrap();
            result.keep(run).unwrap();
            assert_eq!(RunResult::read(run).unwrap(), Some(result));
        };
        let done = |rates: &[(&str, &str, f64)]| {
            let score = |&(group, goal, rate): &(&str, &str, f64)| Score {
                group: group.to_owned(),
                goal: goal.to_owned(),
                acting: ActionMode::Sampled,
                rate,
            };
            RunResult::Done { n_env_steps: 9, scores: rates.iter().map(score).collect() }
        };
        keep(0, 1, done(&TRAIN));
        keep(0, 2, done(&TRAIN));
        // Validation comes first in an evaluation, and last in the table.
        keep(1, 1, done(&[&[("validation", "7_000", 0.5)], &TRAIN[..]].concat()));
        keep(2, 1, RunResult::Failed { status: "exit status: 64".to_owned() });
        let mut results = Results::of(&plan, folder.path()).unwrap();
        let log = folder.path().join("point-3/seed-1.log");
        let expected = format!(
            "Success by group (goals), in %: mean over seeds and goals, with its 95 % interval\n\
             \n\
             | point | actions | seeds | train 2-6 (4) | validation (1) |\n\
             |---|---|---|---|---|\n\
             | learner.gamma=0.9 | sampled | 2 | 37.5 (37.5–37.5) | - |\n\
             | learner.gamma=0.95 | sampled | 1 | 37.5 | 50.0 |\n\
             | learner.gamma=0.99 | failed | 0 | | |\n\
             \n\
             Success by group (goals), in %: interquartile mean over seeds and goals, with its 95 % interval\n\
             \n\
             | point | actions | seeds | train 2-6 (4) | validation (1) |\n\
             |---|---|---|---|---|\n\
             | learner.gamma=0.9 | sampled | 2 | 25.0 (25.0–25.0) | - |\n\
             | learner.gamma=0.95 | sampled | 1 | 25.0 | 50.0 |\n\
             | learner.gamma=0.99 | failed | 0 | | |\n\
             \n\
             not finished: learner.gamma=0.95, seeds [2]\n\
             failed: learner.gamma=0.99, seed 1 (exit status: 64); see {}\n\
             not finished: learner.gamma=0.99, seeds [2]\n",
            log.display()
        );
        assert_eq!((results.markdown(), results.n_missing()), (expected, (1, 2)));
        let json = serde_json::to_value(&results).unwrap();
        assert_eq!(json["points"][0]["groups"][0]["iqm_interval"], serde_json::json!([0.25, 0.25]));
        assert_eq!(json["points"][2]["failed"][0]["seed"], 1);
        assert_eq!(json["done"][2], serde_json::json!({ "point": 0, "seed": 2 }));

        let moment = Moment { n_env_steps: 500, groups: std::mem::take(&mut results.points[1].groups) };
        results.points[1].curve.push(moment);
        let files = results.files(ActionMode::Sampled).into_iter().map(|(_, bytes)| String::from_utf8(bytes).unwrap());
        let files: Vec<String> = files.collect();
        let head = "group,acting,n_runs,n_goals,mean,mean_low,mean_high,iqm,iqm_low,iqm_high";
        let rows = "learner.gamma=0.9,train 2-6,sampled,2,4,0.375,0.375,0.375,0.25,0.25,0.25";
        assert_eq!(files[1], format!("point,{head}\n{rows}\n"));
        let [train, validation] = ["train 2-6,sampled,1,4,0.375,,,0.25,,", "validation,sampled,1,1,0.5,,,0.5,,"]
            .map(|row| format!("learner.gamma=0.95,500,{row}"));
        assert_eq!(files[2], format!("point,n_env_steps,{head}\n{train}\n{validation}\n"));
    }
}
