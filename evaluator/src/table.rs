//! Formats a report as plain text for a terminal.

use proto::ActionMode;
use proto::metrics::{EvalBlueprint, EvalOutcome, EvalReport};

/// Minimum width of the name column.
const NAME_WIDTH: usize = 24;

/// Number of blueprints that are named if not all are.
const N_WORST: usize = 5;

/// A name, whose column is as wide as the longest one, and the text of the other columns.
type Row = (String, String);

/// Formats the report as lines of at most 80 characters (unless a name is long), each ending with a line break: the
/// groups, and every blueprint if `verbose`, or else the worst that do not always succeed. What would be the same row
/// again is left out: a group of one blueprint, and all of one group.
///
/// `of` is the number of episodes. Rates are in percent, with Wilson's 95 % interval for success. `stable` is the rate
/// of stable success, `steps` the mean number of steps of successful episodes, and `return` the mean undiscounted return
/// of all episodes.
pub fn render(report: &EvalReport, verbose: bool) -> String {
    let summary = &report.summary;
    let mut text = String::new();
    // The expert has no weights.
    if summary.weights_version.0 > 0 {
        let (version, n_env_steps) = (summary.weights_version.0, summary.n_env_steps);
        text += &format!("weights {version} after {n_env_steps} environment steps\n");
    }
    if !summary.is_complete {
        text += "interrupted: only the episodes that had ended count\n";
    }
    let mut rows = Vec::new();
    if let [one] = &report.blueprints[..] {
        rows.push(header("blueprint"));
        rows.extend(blueprint(one));
    } else {
        rows.push(header("group (blueprints)"));
        let all = (summary.groups.len() != 1).then_some(&summary.all);
        for group in summary.groups.iter().chain(all) {
            let name = format!("{} ({})", group.name, group.n_blueprints);
            rows.extend(group.outcomes().map(|(acting, outcome)| row(&name, acting, outcome)));
        }
    }
    if let Some(runs) = &summary.reset_free {
        let name = format!("reset-free ({} x {})", runs.n_runs, runs.n_goals);
        rows.extend(runs.outcomes().map(|(acting, runs)| row(&name, acting, &runs.outcome)));
    }
    if report.blueprints.len() != 1 {
        rows.extend(blueprints(&report.blueprints, verbose));
    }
    aligned(text, rows)
}

fn aligned(mut text: String, rows: Vec<Row>) -> String {
    let width = rows.iter().map(|(name, _)| name.chars().count()).fold(NAME_WIDTH, usize::max);
    for (name, columns) in rows {
        text += &format!("{name:<width$} {columns}\n");
    }
    text
}

/// Returns the section about single blueprints.
fn blueprints(all: &[EvalBlueprint], verbose: bool) -> Vec<Row> {
    let rate = |score: &EvalBlueprint| score.outcomes().next().map_or(0.0, |(_, outcome)| outcome.success.rate);
    let mut shown: Vec<&EvalBlueprint> = all.iter().collect();
    let mut title = "blueprint".to_owned();
    if !verbose {
        shown.retain(|one| rate(one) < 1.0);
        shown.sort_by(|a, b| rate(a).total_cmp(&rate(b)));
        title = format!("worst {} of {} below 100 %", N_WORST.min(shown.len()), shown.len());
        shown.truncate(N_WORST);
    }
    let title = (!shown.is_empty()).then(|| header(&title));
    title.into_iter().chain(shown.into_iter().flat_map(blueprint)).collect()
}

fn header(what: &str) -> Row {
    (what.to_owned(), "actions     of     %    interval stable steps return".to_owned())
}

/// Returns a row for each evaluated action mode.
fn blueprint(score: &EvalBlueprint) -> impl Iterator<Item = Row> {
    let name = format!("{} {}", score.split, score.blueprint);
    score.outcomes().map(move |(acting, outcome)| row(&name, acting, outcome))
}

fn row(name: &str, acting: ActionMode, outcome: &EvalOutcome) -> Row {
    let n_episodes = outcome.success.n_episodes;
    let rate = 100.0 * outcome.success.rate;
    let (low, high) = (100.0 * outcome.success.wilson_low, 100.0 * outcome.success.wilson_high);
    let stable = 100.0 * outcome.stable_success.rate;
    let steps = outcome.mean_steps_to_success.map_or_else(|| "-".to_owned(), |steps| format!("{steps:.1}"));
    let mean_return = outcome.mean_return.total();
    let interval = format!("{low:.1}-{high:.1}");
    let acting = acting.name();
    let columns =
        format!("{acting:<7} {n_episodes:>6} {rate:>5.1} {interval:>11} {stable:>6.1} {steps:>5} {mean_return:>6.2}");
    (name.to_owned(), columns)
}

#[cfg(test)]
mod tests {
    use proto::wilson::SuccessRate;
    use proto::{RewardTerms, WeightsVersion};

    use super::*;
    use crate::report::tests::episode;
    use crate::report::{End, EpisodeResult, summarize};

    const SUCCESS: End = End::Success { stable: true };

    fn four_episodes(id: &str, n_successes: usize) -> impl Iterator<Item = EpisodeResult> {
        let end = move |i| if i < n_successes { SUCCESS } else { End::TimeLimit };
        (0..4).map(move |i| episode(id, ActionMode::Greedy, end(i), 10))
    }

    #[test]
    fn the_worst_blueprints_are_named_worst_first() {
        let goals = [("2_000", 4), ("2_001", 2), ("2_002", 0), ("2_003", 3), ("3_000", 1), ("3_001", 3), ("3_002", 2)];
        let episodes: Vec<EpisodeResult> = goals.into_iter().flat_map(|(id, n)| four_episodes(id, n)).collect();
        let mut report = summarize(WeightsVersion(4), 8192, &episodes);
        let named = |report: &EvalReport, verbose| -> Vec<String> {
            let text = render(report, verbose);
            let of_goals = text.lines().filter(|line| line.starts_with("train ") && line.contains('_'));
            of_goals.map(|line| line[6..11].to_owned()).collect()
        };
        assert_eq!(named(&report, false), ["2_002", "3_000", "2_001", "3_002", "2_003"]);
        assert_eq!(named(&report, true), goals.map(|(id, _)| id));
        assert!(render(&report, false).contains("worst 5 of 6 below 100 %"));
        let perfect = summarize(WeightsVersion(4), 8192, &four_episodes("2_000", 4).collect::<Vec<_>>());
        assert!(!render(&perfect, false).contains("worst"));
        report.summary.is_complete = false;
        assert!(render(&report, false).contains("interrupted"));
    }

    #[test]
    fn long_names_widen_their_column() {
        let greedy = row("test-tallest tallest_16_000", ActionMode::Greedy, &EvalOutcome::default());
        let text = aligned(
            "words of any length do not count, however long they may be\n".to_owned(),
            vec![header("group"), greedy],
        );
        let columns = |word: &str| text.lines().find_map(|line| line.find(word)).unwrap();
        assert_eq!((columns("actions"), columns("greedy")), (28, 28), "{text}");
    }

    #[test]
    fn the_table_shows_what_was_evaluated() {
        // 1 of 2: the interval is 1/2 ± z/2 / √(2 + z²) = 1/2 ± 0.979982 / √5.841459 = 0.0945 to 0.9055.
        let ends = [(SUCCESS, 8), (End::TimeLimit, 100)];
        let of = |id| ends.map(|(end, n_steps)| episode(id, ActionMode::Greedy, end, n_steps));
        // The same row is not printed three times.
        let one = render(&summarize(WeightsVersion(4), 8192, &of("2_003")), false);
        let expected = "\
weights 4 after 8192 environment steps
blueprint                actions     of     %    interval stable steps return
train 2_003              greedy       2  50.0    9.5-90.5   50.0   8.0   0.75
";
        assert_eq!(one, expected);
        let two = [of("2_003"), of("2_004")].concat();
        let expected = "\
weights 4 after 8192 environment steps
group (blueprints)       actions     of     %    interval stable steps return
train 2-6 (2)            greedy       4  50.0   15.0-85.0   50.0   8.0   0.75
blueprint                actions     of     %    interval stable steps return
train 2_003              greedy       2  50.0    9.5-90.5   50.0   8.0   0.75
train 2_004              greedy       2  50.0    9.5-90.5   50.0   8.0   0.75
";
        assert_eq!(render(&summarize(WeightsVersion(4), 8192, &two), true), expected);
    }

    #[test]
    fn the_longest_row_fits_into_80_columns() {
        let all = EvalOutcome {
            success: SuccessRate::new(380_000, 380_000),
            stable_success: SuccessRate::new(380_000, 380_000),
            mean_steps_to_success: Some(100.0),
            mean_return: RewardTerms { wrong: -12.34, ..RewardTerms::default() },
            ..EvalOutcome::default()
        };
        let longest = row("test-longest longest_16_000", ActionMode::Sampled, &all);
        assert_eq!(aligned(String::new(), vec![longest]).trim_end().chars().count(), 80);
    }
}
