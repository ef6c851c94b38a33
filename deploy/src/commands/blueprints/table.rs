//! Output of `blueprints check`: a table of files, followed by the problems found.

use blueprints::checks::{Check, CheckResult, Outcome, Report};

/// Renders one line per file with its id and how many checks it passed, and the names of those that it failed or that
/// could not run; then one line for each thing that was inferred because the file leaves it open, one for each failure,
/// and a summary.
pub(super) fn render(reports: &[Report]) -> String {
    let header = ["file", "id", "checks"].map(str::to_owned);
    let rows: Vec<[String; 3]> = std::iter::once(header).chain(reports.iter().map(cells)).collect();
    let widest = |column: usize| rows.iter().map(|row| row[column].chars().count()).max().unwrap_or(0);
    let (file_width, id_width) = (widest(0), widest(1));
    let line = |[file, id, checks]: &[String; 3]| format!("{file:<file_width$}  {id:<id_width$}  {checks}");
    let mut lines: Vec<String> = rows.iter().map(line).collect();
    for Report { file, inferred, .. } in reports {
        lines.extend(inferred.iter().map(|found| format!("{file}: {found}")));
    }
    for Report { file, results, .. } in reports {
        lines.extend(results.iter().filter_map(|CheckResult { check, outcome }| match outcome {
            Outcome::Failed { error } => Some(format!("{file}, {check}: {error}")),
            Outcome::Passed | Outcome::Skipped => None,
        }));
    }
    let n_passed = reports.iter().filter(|report| report.passed()).count();
    lines.push(format!("{n_passed} of {} blueprints passed all checks", reports.len()));
    lines.join("\n")
}

/// The file, the id, and the outcomes: `-` for an id that cannot be read.
fn cells(report: &Report) -> [String; 3] {
    let id = report.id.as_ref().map_or_else(|| "-".to_owned(), ToString::to_string);
    let mut n_passed = 0;
    let mut n_skipped = 0;
    let mut failed = Vec::new();
    for check in Check::ALL.into_iter().chain(Check::PHYSICAL) {
        let result = report.results.iter().find(|result| result.check == check);
        match result.map(|result| &result.outcome) {
            Some(Outcome::Passed) => n_passed += 1,
            Some(Outcome::Failed { .. }) => failed.push(check.to_string()),
            Some(Outcome::Skipped) | None => n_skipped += 1,
        }
    }
    let mut checks = Vec::new();
    if !failed.is_empty() {
        checks.push(format!("FAILED {}", failed.join(", ")));
    }
    checks.push(format!("{n_passed} passed"));
    if n_skipped > 0 {
        checks.push(format!("{n_skipped} not run"));
    }
    [report.file.clone(), id, checks.join("; ")]
}

#[cfg(test)]
mod tests {
    use blueprints::catalog::BUILTIN_FILES;
    use blueprints::checks::check_all;

    use super::*;

    #[test]
    fn the_table_counts_every_check_and_the_errors_are_below() {
        let (_, good) = BUILTIN_FILES.iter().find(|(file, _)| *file == "2_000.toml").unwrap();
        let reports = check_all([("good.toml", *good), ("same.toml", *good), ("bad.toml", "id = 3")]);
        let text = render(&reports);
        let lines: Vec<&str> = text.lines().collect();
        let expected = [
            "file       id     checks",
            "good.toml  2_000  11 passed; 2 not run",
            "same.toml  2_000  FAILED unique; 10 passed; 2 not run",
            "bad.toml   -      FAILED format; 0 passed; 12 not run",
            "same.toml, unique: good.toml has the same id",
        ];
        assert_eq!(lines[..5], expected, "{text}");
        assert!(lines[5].starts_with("bad.toml, format: line 1"), "{text}");
        assert_eq!(lines[6..], ["1 of 3 blueprints passed all checks"]);
    }
}
