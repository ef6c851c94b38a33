//! Formats a report as plain text for a terminal.

use std::collections::BTreeMap;

use proto::ActionMode;
use proto::metrics::{EvalBlueprint, EvalOutcome, EvalReport};
use runlog::series::outcome_of;

use crate::endings::{Ending, SizeEndings};

/// Level of detail of the text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Detail {
    /// Groups only.
    Groups,
    /// Also this many of the blueprints that do not always succeed, worst first.
    Worst(usize),
    /// Also every blueprint.
    Blueprints,
}

/// Minimum width of the name column.
const NAME_WIDTH: usize = 24;

/// Lines whose first column is as wide as the longest name.
#[derive(Default)]
struct Table(Vec<Row>);

enum Row {
    /// Text outside the columns.
    Words(String),
    /// A name, and the text of the other columns.
    Columns(String, String),
}

/// Formats the report as lines of at most 80 characters (unless a name is long), each ending with a line break. What
/// would be the same row again is left out: a group of one blueprint, and all of one group.
///
/// `of` is the number of episodes. Rates are in percent, with Wilson's 95 % interval for success. `stable` is the rate
/// of stable success, `steps` the mean number of steps of successful episodes, and `return` the mean undiscounted return
/// of all episodes.
pub fn render(report: &EvalReport, detail: Detail) -> String {
    let summary = &report.summary;
    let mut text = Table::default();
    // The expert has no weights.
    if summary.weights_version.0 > 0 {
        text.words(format!("weights {} after {} environment steps", summary.weights_version.0, summary.n_env_steps));
    }
    if !summary.is_complete {
        text.words("interrupted: only the episodes that had ended count".to_owned());
    }
    if let [one] = &report.blueprints[..] {
        text.header("blueprint");
        text.blueprint(one);
    } else {
        text.header("group (blueprints)");
        let all = (summary.groups.len() != 1).then_some(&summary.all);
        for group in summary.groups.iter().chain(all) {
            let name = format!("{} ({})", group.name, group.n_blueprints);
            text.lines(&name, &group.greedy, &group.sampled);
        }
    }
    if let Some(runs) = &summary.reset_free {
        let name = format!("reset-free ({} x {})", runs.n_runs, runs.n_goals);
        text.lines(&name, &runs.greedy.outcome, &runs.sampled.outcome);
    }
    if report.blueprints.len() != 1 {
        blueprints(&mut text, &report.blueprints, detail);
    }
    text.render()
}

/// Writes the section about single blueprints.
fn blueprints(text: &mut Table, all: &[EvalBlueprint], detail: Detail) {
    let rate = |score: &EvalBlueprint| {
        let evaluated =
            [ActionMode::Greedy, ActionMode::Sampled].into_iter().find_map(|acting| outcome_of(score, acting));
        evaluated.map_or(0.0, |outcome| outcome.success.rate)
    };
    let (title, shown): (_, Vec<&EvalBlueprint>) = match detail {
        Detail::Groups => return,
        Detail::Blueprints => ("blueprint".to_owned(), all.iter().collect()),
        Detail::Worst(n) => {
            let mut imperfect: Vec<&EvalBlueprint> = all.iter().filter(|one| rate(one) < 1.0).collect();
            imperfect.sort_by(|a, b| rate(a).total_cmp(&rate(b)));
            let title = format!("worst {} of {} below 100 %", n.min(imperfect.len()), imperfect.len());
            imperfect.truncate(n);
            (title, imperfect)
        }
    };
    if !shown.is_empty() {
        text.header(&title);
        shown.into_iter().for_each(|one| text.blueprint(one));
    }
}

/// Formats how episodes ended as lines, each ending with a line break: the share of each [ending](Ending) in percent;
/// wrong connections, broken ones, and missing ones at the end, per episode; and the shares of draws by kind of
/// proposal, in percent.
pub fn render_endings(sizes: &BTreeMap<(&str, usize), SizeEndings>) -> String {
    let mut text = format!(
        "{:<7} {:>6} {:>6} {:>6} {:>5} {:>5} {:>5} {:>5} {:>5} {:>5} {:>5}  draws, %\n",
        "actions", "blocks", "of", "built", "still", "wrong", "misp.", "stuck", "time", "div.", "w/b/m"
    );
    for ((acting, n_blocks), size) in sizes {
        let n = size.n_episodes().max(1) as f64;
        let share = |ending: Ending| 100.0 * size.endings.get(&ending).copied().unwrap_or(0) as f64 / n;
        let shares = [Ending::Built, Ending::Still, Ending::Wrong, Ending::Misplaced, Ending::Stuck, Ending::Time];
        let shares = shares.map(|ending| format!("{:>5.1}", share(ending))).join(" ");
        let n_draws = size.draws.values().sum::<u64>().max(1) as f64;
        let draw = |(kind, &n): (&String, &u64)| format!("{kind} {:.0}", 100.0 * n as f64 / n_draws);
        let draws: Vec<String> = size.draws.iter().map(draw).collect();
        text += &format!(
            "{acting:<7} {n_blocks:>6} {n:>6}  {shares} {:>5.1} {:.1}/{:.1}/{:.1}  {}\n",
            share(Ending::Diverged),
            size.n_wrong as f64 / n,
            size.n_broken as f64 / n,
            size.n_missing as f64 / n,
            draws.join(" ")
        );
    }
    text
}

impl Table {
    fn words(&mut self, words: String) {
        self.0.push(Row::Words(words));
    }

    fn header(&mut self, what: &str) {
        let columns = "actions     of     %    interval stable steps return";
        self.0.push(Row::Columns(what.to_owned(), columns.to_owned()));
    }

    fn blueprint(&mut self, score: &EvalBlueprint) {
        self.lines(&format!("{} {}", score.split, score.blueprint), &score.greedy, &score.sampled);
    }

    /// Adds a line for each evaluated action mode.
    fn lines(&mut self, name: &str, greedy: &EvalOutcome, sampled: &EvalOutcome) {
        for (acting, outcome) in [("greedy", greedy), ("sampled", sampled)] {
            if outcome.success.n_episodes > 0 {
                self.line(name, acting, outcome);
            }
        }
    }

    fn line(&mut self, name: &str, actions: &str, outcome: &EvalOutcome) {
        let n_episodes = outcome.success.n_episodes;
        let rate = 100.0 * outcome.success.rate;
        let (low, high) = (100.0 * outcome.success.wilson_low, 100.0 * outcome.success.wilson_high);
        let stable = 100.0 * outcome.stable_success.rate;
        let steps = outcome.mean_steps_to_success.map_or_else(|| "-".to_owned(), |steps| format!("{steps:.1}"));
        let mean_return = outcome.mean_return.total();
        let interval = format!("{low:.1}-{high:.1}");
        let columns = format!(
            "{actions:<7} {n_episodes:>6} {rate:>5.1} {interval:>11} {stable:>6.1} {steps:>5} {mean_return:>6.2}"
        );
        self.0.push(Row::Columns(name.to_owned(), columns));
    }

    fn render(self) -> String {
        let name_len = |row: &Row| match row {
            Row::Words(_) => 0,
            Row::Columns(name, _) => name.chars().count(),
        };
        let width = self.0.iter().map(name_len).fold(NAME_WIDTH, usize::max);
        let line = |row: Row| match row {
            Row::Words(words) => format!("{words}\n"),
            Row::Columns(name, columns) => format!("{name:<width$} {columns}\n"),
        };
        self.0.into_iter().map(line).collect()
    }
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
        let goals = [("2_000", 4), ("2_001", 2), ("2_002", 0), ("2_003", 3)];
        let episodes: Vec<EpisodeResult> = goals.into_iter().flat_map(|(id, n)| four_episodes(id, n)).collect();
        let mut report = summarize(WeightsVersion(4), 8192, &episodes);
        let named = |report: &EvalReport, detail| -> Vec<String> {
            let text = render(report, detail);
            text.lines().filter(|line| line.starts_with("train 2_")).map(|line| line[6..11].to_owned()).collect()
        };
        assert_eq!(named(&report, Detail::Worst(2)), ["2_002", "2_001"]);
        assert_eq!(named(&report, Detail::Worst(5)), ["2_002", "2_001", "2_003"]);
        assert_eq!(named(&report, Detail::Groups), Vec::<String>::new());
        assert!(render(&report, Detail::Worst(2)).contains("worst 2 of 3 below 100 %"));
        let perfect = summarize(WeightsVersion(4), 8192, &four_episodes("2_000", 4).collect::<Vec<_>>());
        assert!(!render(&perfect, Detail::Worst(2)).contains("worst"));
        report.summary.is_complete = false;
        assert!(render(&report, Detail::Groups).contains("interrupted"));
    }

    #[test]
    fn long_names_widen_their_column() {
        let mut table = Table::default();
        table.words("words of any length do not count, however long they may be".to_owned());
        table.header("group");
        table.line("test-tallest tallest_16_000", "greedy", &EvalOutcome::default());
        let text = table.render();
        let columns = |word: &str| text.lines().find_map(|line| line.find(word)).unwrap();
        assert_eq!((columns("actions"), columns("greedy")), (28, 28), "{text}");
    }

    #[test]
    fn the_table_shows_what_was_evaluated() {
        // 1 of 2: the interval is 1/2 ± z/2 / √(2 + z²) = 1/2 ± 0.979982 / √5.841459 = 0.0945 to 0.9055.
        let ends = [(SUCCESS, 8), (End::TimeLimit, 100)];
        let of = |id| ends.map(|(end, n_steps)| episode(id, ActionMode::Greedy, end, n_steps));
        // The same row is not printed three times.
        let one = render(&summarize(WeightsVersion(4), 8192, &of("2_003")), Detail::Worst(5));
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
        assert_eq!(render(&summarize(WeightsVersion(4), 8192, &two), Detail::Blueprints), expected);
    }

    #[test]
    fn the_longest_row_fits_into_80_columns() {
        let mut table = Table::default();
        let all = EvalOutcome {
            success: SuccessRate::new(380_000, 380_000),
            stable_success: SuccessRate::new(380_000, 380_000),
            mean_steps_to_success: Some(100.0),
            mean_return: RewardTerms { wrong: -12.34, ..RewardTerms::default() },
            ..EvalOutcome::default()
        };
        table.line("test-longest longest_16_000", "sampled", &all);
        assert_eq!(table.render().trim_end().chars().count(), 80);
    }
}
