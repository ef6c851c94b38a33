//! Output of `blueprints check`: a table of files and checks, followed by the problems found.

use blueprints::checks::{Check, Outcome, Report};

/// Renders one line per file with its id and the outcome of each check, `-` for a check that could not run; then one
/// line for each thing that was inferred because the file leaves it open, one for each failure, and a summary.
pub(super) fn render(reports: &[Report]) -> String {
    let header = ["file".to_owned(), "id".to_owned()].into_iter().chain(checks().map(|check| check.to_string()));
    let rows: Vec<Vec<String>> = std::iter::once(header.collect()).chain(reports.iter().map(cells)).collect();
    let n_columns = rows[0].len();
    let widest = |column: usize| rows.iter().map(|row| row[column].chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..n_columns).map(widest).collect();
    let mut lines: Vec<String> = rows.iter().map(|row| line(row, &widths)).collect();
    lines.extend(reports.iter().flat_map(findings));
    lines.extend(reports.iter().flat_map(failures));
    let n_passed = reports.iter().filter(|report| report.passed()).count();
    lines.push(format!("{n_passed} of {} blueprints passed all checks", reports.len()));
    lines.join("\n")
}

fn checks() -> impl Iterator<Item = Check> {
    Check::ALL.into_iter().chain(Check::PHYSICAL)
}

fn cells(report: &Report) -> Vec<String> {
    let id = report.id.as_ref().map_or_else(|| "-".to_owned(), ToString::to_string);
    let outcome = |check: Check| {
        let result = report.results.iter().find(|result| result.check == check);
        match result.map(|result| &result.outcome) {
            Some(Outcome::Passed) => "ok",
            Some(Outcome::Failed { .. }) => "FAILED",
            Some(Outcome::Skipped) | None => "-",
        }
    };
    [report.file.clone(), id].into_iter().chain(checks().map(|check| outcome(check).to_owned())).collect()
}

fn line(row: &[String], widths: &[usize]) -> String {
    let padded: Vec<String> = row.iter().zip(widths).map(|(cell, width)| format!("{cell:<width$}")).collect();
    padded.join("  ").trim_end().to_owned()
}

fn findings(report: &Report) -> Vec<String> {
    report.inferred.iter().map(|found| format!("{}: {found}", report.file)).collect()
}

/// One line per failed check: file, check, and error.
fn failures(report: &Report) -> Vec<String> {
    let failed = report.results.iter().filter_map(|result| match &result.outcome {
        Outcome::Failed { error } => Some(format!("{}, {}: {error}", report.file, result.check)),
        Outcome::Passed | Outcome::Skipped => None,
    });
    failed.collect()
}

#[cfg(test)]
mod tests {
    use blueprints::catalog::BUILTIN_FILES;
    use blueprints::checks::check_all;

    use super::*;

    #[test]
    fn the_table_shows_every_check_and_the_errors_below() {
        let (_, good) = BUILTIN_FILES.iter().find(|(file, _)| *file == "2_000.toml").unwrap();
        let reports = check_all([("good.toml", *good), ("same.toml", *good), ("bad.toml", "id = 3")]);
        let text = render(&reports);
        let lines: Vec<&str> = text.lines().collect();
        let expected = [
            "file       id     format  inventory  turns  overlap  polarity  connections  connected  stands  strength  assembly  \
             unique  settles  expert",
            "good.toml  2_000  ok      ok         ok     ok       ok        ok           ok         ok      ok        ok        \
             ok      -        -",
            "same.toml  2_000  ok      ok         ok     ok       ok        ok           ok         ok      ok        ok        \
             FAILED  -        -",
            "bad.toml   -      FAILED  -          -      -        -         -            -          -       -         -         \
             -       -        -",
            "same.toml, unique: good.toml has the same id",
        ];
        assert_eq!(lines[..5], expected, "{text}");
        assert!(lines[5].starts_with("bad.toml, format: line 1"), "{text}");
        assert_eq!(lines[6..], ["1 of 3 blueprints passed all checks"]);
    }
}
