//! Evaluations read back whole or not at all.

use blueprints::Split;
use proto::metrics::{EvalOutcome, EvalResetFree, EvalRuns};

use super::*;
use samples::{evaluation, outcome};

pub(crate) mod samples;

fn small(n_env_steps: u64) -> Evaluation {
    evaluation(n_env_steps, &[("2_003", Split::Train, 2, 4), ("10_000", Split::Train, 10, 0)])
}

/// Returns an evaluation of a hundred blueprints, which fill several pages of the database.
fn large(n_env_steps: u64) -> Evaluation {
    let ids: Vec<String> = (0..100).map(|i| format!("3_{i:03}")).collect();
    let scores: Vec<_> = ids.iter().map(|id| (id.as_str(), Split::Train, 3, 5)).collect();
    evaluation(n_env_steps, &scores)
}

/// Returns the path of a history in a new temporary folder.
fn place() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("new/run").join("eval.db");
    (folder, path)
}

#[test]
fn evaluations_round_trip() {
    let (_folder, path) = place();
    let mut first = small(0);
    first.blueprints[1].sampled = outcome(10);
    first.blueprints[1].greedy = EvalOutcome::default();
    first.reset_free = Some(EvalResetFree {
        n_runs: 5,
        n_goals: 2,
        sampled: EvalRuns::default(),
        greedy: EvalRuns {
            outcome: outcome(7),
            n_successes_by_goal: vec![4, 3],
            run_rate_std: 0.4,
            n_forced_resets: 1,
        },
    });
    let second = evaluation(500, &[("2_000", Split::Train, 2, 1), ("test_12_000", Split::Test, 12, 10)]);
    let mut history = History::open(&path).unwrap();
    assert_eq!(History::read(&path).unwrap(), []);
    history.append(&first).unwrap();
    history.append(&second).unwrap();
    // Read while the writer is open, after it closed, and after a restart that appends.
    assert_eq!(History::read(&path).unwrap(), [first.clone(), second.clone()]);
    drop(history);
    assert_eq!(History::read(&path).unwrap(), [first.clone(), second.clone()]);
    let third = small(0);
    History::open(&path).unwrap().append(&third).unwrap();
    assert_eq!(History::read(&path).unwrap(), [first, second, third]);
}

#[test]
fn nan_returns_round_trip() {
    let (_folder, path) = place();
    let mut evaluation = small(0);
    evaluation.blueprints[0].greedy.mean_return.force = f32::NAN;
    History::open(&path).unwrap().append(&evaluation).unwrap();
    let found = History::read(&path).unwrap();
    let terms = found[0].blueprints[0].greedy.mean_return;
    assert!(terms.force.is_nan() && terms.connected == 1.3, "{terms:?}");
}

#[test]
fn second_writer_is_refused() {
    let (_folder, path) = place();
    let first = History::open(&path).unwrap();
    assert!(matches!(History::open(&path), Err(HistoryError::Taken(_))));
    drop(first);
    History::open(&path).unwrap();
}

/// Copies the database and its journal from the disk while an evaluation is half written, with some pages in the file.
#[test]
fn torn_write_keeps_earlier_evaluations() {
    let (folder, path) = place();
    let mut history = History::open(&path).unwrap();
    history.append(&large(0)).unwrap();
    let journal = |path: &Path| PathBuf::from(format!("{}-journal", path.display()));
    let whole = std::fs::read(&path).unwrap();

    let mut writer = Connection::open(&path).unwrap();
    // A cache of one page: changed pages reach the file long before the commit.
    writer.pragma_update(None, "cache_size", 1).unwrap();
    let transaction = writer.transaction().unwrap();
    transaction.execute("UPDATE outcome SET n_successes = 10, mean_steps = 0.0", []).unwrap();
    transaction.execute("UPDATE pass SET n_env_steps = 77", []).unwrap();
    let torn = folder.path().join("torn.db");
    std::fs::copy(&path, &torn).unwrap();
    std::fs::copy(journal(&path), journal(&torn)).unwrap();
    assert_ne!(std::fs::read(&torn).unwrap(), whole, "nothing was torn");

    assert_eq!(History::read(&torn).unwrap(), [large(0)]);
    let mut reopened = History::open(&torn).unwrap();
    reopened.append(&large(10)).unwrap();
    assert_eq!(History::read(&torn).unwrap(), [large(0), large(10)]);
}

#[test]
fn other_databases_and_versions_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name);
    drop(History::open(&file("newer.db")).unwrap());
    Connection::open(file("newer.db")).unwrap().pragma_update(None, "user_version", SCHEMA_VERSION + 1).unwrap();
    Connection::open(file("foreign.db")).unwrap().execute_batch("CREATE TABLE pass (x)").unwrap();
    std::fs::write(file("text.db"), "no database, but longer than the header of one ".repeat(9)).unwrap();
    for (name, words) in [
        ("newer.db", &["newer.db", "schema version 2", "knows 1"][..]),
        ("foreign.db", &["foreign.db", "something else"]),
        ("text.db", &["text.db", "not a database"]),
    ] {
        let before = std::fs::read(file(name)).unwrap();
        for refused in [History::read(&file(name)).unwrap_err(), History::open(&file(name)).unwrap_err()] {
            let message = refused.to_string();
            for word in words {
                assert!(message.contains(word), "no {word:?} in {message}");
            }
        }
        assert_eq!(std::fs::read(file(name)).unwrap(), before, "{name} was changed");
    }
    assert!(matches!(History::read(&file("gone.db")), Err(HistoryError::Missing(_))));
    assert!(!file("gone.db").exists());
}

#[test]
fn inconsistent_counts_are_refused() {
    let (_folder, path) = place();
    History::open(&path).unwrap().append(&small(0)).unwrap();
    Connection::open(&path).unwrap().execute("UPDATE outcome SET n_successes = 11", []).unwrap();
    let message = History::read(&path).unwrap_err().to_string();
    assert!(message.contains("11 n_successes in 10 episodes"), "{message}");
}
