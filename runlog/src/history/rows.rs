//! Evaluations as rows.

use std::collections::BTreeMap;

use blueprints::{BlueprintId, Split};
use proto::metrics::{EvalBlueprint, EvalOutcome, EvalReport, EvalResetFree, EvalRuns, METRICS_SCHEMA_VERSION};
use proto::wilson::SuccessRate;
use proto::{ActionMode, RewardTerms, WeightsVersion};
use rusqlite::types::Type;
use rusqlite::{Connection, Error, Result, Row, ToSql, TransactionBehavior, params, params_from_iter};

/// One evaluation of frozen weights, as stored in the history.
#[derive(Clone, Debug, PartialEq)]
pub struct Evaluation {
    /// End time, milliseconds since 1970.
    pub ended_unix_ms: u64,
    /// Duration, seconds.
    pub elapsed_s: f64,
    /// Version of the evaluated weights.
    pub weights_version: WeightsVersion,
    /// Environment steps that the learner had consumed when it published the weights.
    pub n_env_steps: u64,
    /// Seed of the start states.
    pub seed: u64,
    /// Results by blueprint, ordered by split, size, and id.
    pub blueprints: Vec<EvalBlueprint>,
    /// Reset-free runs, if there were any.
    pub reset_free: Option<EvalResetFree>,
}

impl Evaluation {
    /// Selects the stored parts of a report; `ended_unix_ms` is in milliseconds since 1970.
    pub fn new(report: &EvalReport, ended_unix_ms: u64) -> Self {
        Self {
            ended_unix_ms,
            elapsed_s: report.summary.elapsed_s,
            weights_version: report.summary.weights_version,
            n_env_steps: report.summary.n_env_steps,
            seed: report.summary.seed,
            blueprints: report.blueprints.clone(),
            reset_free: report.summary.reset_free.clone(),
        }
    }
}

const INSERT_EVALUATION: &str = "INSERT INTO pass (ended_unix_ms, elapsed_s, weights_version, n_env_steps, seed)
    VALUES (?1, ?2, ?3, ?4, ?5)";
const INSERT_BLUEPRINT: &str = "INSERT OR IGNORE INTO blueprint (name, split, n_blocks) VALUES (?1, ?2, ?3)";
const SELECT_BLUEPRINT: &str = "SELECT blueprint_id FROM blueprint WHERE name = ?1 AND split = ?2 AND n_blocks = ?3";
const INSERT_OUTCOME: &str = "INSERT INTO outcome (pass_id, blueprint_id, acting, n_episodes, n_successes,
    n_stable_successes, n_diverged, mean_steps, mean_steps_to_success,
    return_connected, return_wrong, return_magnets, return_blocks, return_force)
    VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12, ?13, ?14)";
const INSERT_RUNS: &str = "INSERT INTO reset_free (pass_id, acting, n_runs, n_goals, n_episodes, n_successes,
    n_stable_successes, n_diverged, mean_steps, mean_steps_to_success,
    return_connected, return_wrong, return_magnets, return_blocks, return_force,
    n_successes_by_goal, run_rate_std, n_forced_resets)
    VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12, ?13, ?14, ?15, ?16, ?17, ?18)";
const SELECT_PASSES: &str =
    "SELECT pass_id, ended_unix_ms, elapsed_s, weights_version, n_env_steps, seed FROM pass ORDER BY pass_id";
const SELECT_OUTCOMES: &str = "SELECT outcome.*, blueprint.name, blueprint.split, blueprint.n_blocks
    FROM outcome JOIN blueprint USING (blueprint_id)";

/// Writes an evaluation in one transaction.
pub(super) fn append(db: &mut Connection, evaluation: &Evaluation) -> Result<()> {
    let transaction = db.transaction_with_behavior(TransactionBehavior::Immediate)?;
    let (version, n_steps) = (evaluation.weights_version.0, evaluation.n_env_steps);
    transaction.execute(
        INSERT_EVALUATION,
        params![evaluation.ended_unix_ms, evaluation.elapsed_s, version, n_steps, evaluation.seed],
    )?;
    let pass_id = transaction.last_insert_rowid();
    {
        let mut insert_blueprint = transaction.prepare(INSERT_BLUEPRINT)?;
        let mut select_blueprint = transaction.prepare(SELECT_BLUEPRINT)?;
        let mut insert_outcome = transaction.prepare(INSERT_OUTCOME)?;
        for score in &evaluation.blueprints {
            let key = params![score.blueprint.as_str(), score.split.to_string(), score.n_blocks];
            insert_blueprint.execute(key)?;
            let blueprint_id: i64 = select_blueprint.query_row(key, |row| row.get(0))?;
            for (acting, outcome) in score.outcomes() {
                let key: [&dyn ToSql; 3] = [&pass_id, &blueprint_id, &stored(acting)];
                insert_outcome.execute(params_from_iter(key.into_iter().chain(columns(outcome))))?;
            }
        }
        if let Some(reset_free) = &evaluation.reset_free {
            append_reset_free(&transaction, pass_id, reset_free)?;
        }
    }
    transaction.commit()
}

fn append_reset_free(db: &Connection, pass_id: i64, reset_free: &EvalResetFree) -> Result<()> {
    for (acting, runs) in reset_free.outcomes() {
        let by_goal = serde_json::to_string(&runs.n_successes_by_goal)
            .map_err(|error| Error::ToSqlConversionFailure(error.into()))?;
        let before: [&dyn ToSql; 4] = [&pass_id, &stored(acting), &reset_free.n_runs, &reset_free.n_goals];
        let after: [&dyn ToSql; 3] = [&by_goal, &runs.run_rate_std, &runs.n_forced_resets];
        db.execute(INSERT_RUNS, params_from_iter(before.into_iter().chain(columns(&runs.outcome)).chain(after)))?;
    }
    Ok(())
}

/// Returns what both tables store of an outcome, in the order of their columns.
fn columns(outcome: &EvalOutcome) -> [&dyn ToSql; 11] {
    let RewardTerms { connected, wrong, magnets, blocks, force } = &outcome.mean_return;
    [
        &outcome.success.n_episodes,
        &outcome.success.n_successes,
        &outcome.stable_success.n_successes,
        &outcome.n_diverged,
        &outcome.mean_steps,
        &outcome.mean_steps_to_success,
        connected,
        wrong,
        magnets,
        blocks,
        force,
    ]
}

/// Reads all evaluations in writing order.
pub(super) fn read(db: &Connection) -> Result<Vec<Evaluation>> {
    // One transaction, so that no query sees a later write.
    let transaction = db.unchecked_transaction()?;
    let mut evaluations: BTreeMap<i64, Evaluation> = BTreeMap::new();
    let mut select_passes = transaction.prepare(SELECT_PASSES)?;
    let mut rows = select_passes.query([])?;
    while let Some(row) = rows.next()? {
        evaluations.insert(row.get("pass_id")?, evaluation(row)?);
    }
    let mut scores: BTreeMap<(i64, Split, u64, BlueprintId), [EvalOutcome; 2]> = BTreeMap::new();
    let mut select_outcomes = transaction.prepare(SELECT_OUTCOMES)?;
    let mut rows = select_outcomes.query([])?;
    while let Some(row) = rows.next()? {
        let name: BlueprintId = parsed(row, "name", |text| BlueprintId::try_from(text.to_owned()))?;
        let key = (row.get("pass_id")?, parsed(row, "split", str::parse)?, row.get("n_blocks")?, name);
        scores.entry(key).or_default()[acting(row)? as usize] = outcome(row)?;
    }
    for ((pass_id, split, n_blocks, blueprint), [greedy, sampled]) in scores {
        // The database enforces that every outcome has its evaluation.
        let Some(evaluation) = evaluations.get_mut(&pass_id) else { continue };
        evaluation.blueprints.push(EvalBlueprint {
            schema_version: METRICS_SCHEMA_VERSION,
            weights_version: evaluation.weights_version,
            n_env_steps: evaluation.n_env_steps,
            blueprint,
            split,
            n_blocks,
            sampled,
            greedy,
        });
    }
    let mut select_runs = transaction.prepare("SELECT * FROM reset_free")?;
    let mut rows = select_runs.query([])?;
    while let Some(row) = rows.next()? {
        let Some(evaluation) = evaluations.get_mut(&row.get("pass_id")?) else { continue };
        let reset_free = evaluation.reset_free.get_or_insert_default();
        (reset_free.n_runs, reset_free.n_goals) = (row.get("n_runs")?, row.get("n_goals")?);
        match acting(row)? {
            ActionMode::Greedy => reset_free.greedy = runs(row)?,
            ActionMode::Sampled => reset_free.sampled = runs(row)?,
        }
    }
    Ok(evaluations.into_values().collect())
}

fn evaluation(row: &Row<'_>) -> Result<Evaluation> {
    Ok(Evaluation {
        ended_unix_ms: row.get("ended_unix_ms")?,
        elapsed_s: row.get("elapsed_s")?,
        weights_version: WeightsVersion(row.get("weights_version")?),
        n_env_steps: row.get("n_env_steps")?,
        seed: row.get("seed")?,
        blueprints: Vec::new(),
        reset_free: None,
    })
}

fn runs(row: &Row<'_>) -> Result<EvalRuns> {
    Ok(EvalRuns {
        outcome: outcome(row)?,
        n_successes_by_goal: parsed(row, "n_successes_by_goal", |text| serde_json::from_str(text))?,
        run_rate_std: row.get("run_rate_std")?,
        n_forced_resets: row.get("n_forced_resets")?,
    })
}

fn outcome(row: &Row<'_>) -> Result<EvalOutcome> {
    let n_episodes: u64 = row.get("n_episodes")?;
    let rate = |column: &str| -> Result<SuccessRate> {
        let n_successes: u64 = row.get(column)?;
        if n_successes > n_episodes {
            return Err(invalid(row, column, format!("{n_successes} {column} in {n_episodes} episodes")));
        }
        Ok(SuccessRate::new(n_successes, n_episodes))
    };
    let term = |column: &str| -> Result<f32> { Ok(row.get::<_, Option<f32>>(column)?.unwrap_or(f32::NAN)) };
    Ok(EvalOutcome {
        success: rate("n_successes")?,
        stable_success: rate("n_stable_successes")?,
        mean_steps: row.get("mean_steps")?,
        mean_steps_to_success: row.get("mean_steps_to_success")?,
        mean_return: RewardTerms {
            connected: term("return_connected")?,
            wrong: term("return_wrong")?,
            magnets: term("return_magnets")?,
            blocks: term("return_blocks")?,
            force: term("return_force")?,
        },
        n_diverged: row.get("n_diverged")?,
    })
}

/// Returns the word for an action mode in the tables, which call greedy actions by the mode of the distribution.
fn stored(acting: ActionMode) -> &'static str {
    match acting {
        ActionMode::Greedy => "mode",
        ActionMode::Sampled => "sampled",
    }
}

fn acting(row: &Row<'_>) -> Result<ActionMode> {
    parsed(row, "acting", |text| if text == stored(ActionMode::Greedy) { Ok(ActionMode::Greedy) } else { text.parse() })
}

/// Parses a text column.
fn parsed<T, E: std::fmt::Display>(row: &Row<'_>, column: &str, parse: impl Fn(&str) -> Result<T, E>) -> Result<T> {
    let text: String = row.get(column)?;
    parse(&text).map_err(|error| invalid(row, column, error.to_string()))
}

fn invalid(row: &Row<'_>, column: &str, message: String) -> Error {
    let column_idx = row.as_ref().column_index(column).unwrap_or_default();
    Error::FromSqlConversionFailure(column_idx, Type::Text, message.into())
}
