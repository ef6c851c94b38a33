//! The checks of a blueprint that need a simulated world.

use blueprints::checks::{Check, CheckResult, Outcome, Report};
use evaluator::trials::{MAX_DRIFT_M, MAX_TURN_RAD, settle, try_building};
use proto::Valid;

use crate::exit::Failure;

/// Adds the physical checks to a report; they are skipped if another check failed.
pub(super) fn check(report: &mut Report) -> Result<(), Failure> {
    let environment = Valid::default();
    let [settles, expert] = match &report.blueprint {
        Err(_) => [Outcome::Skipped, Outcome::Skipped],
        Ok(blueprint) => {
            let found = settle(&environment, blueprint).map_err(anyhow::Error::from)?;
            let settles = outcome(found.is_calm(), || {
                format!(
                    "within two seconds a block moves by {:.1} cm (limit {:.1}) and turns by {:.2} rad (limit {MAX_TURN_RAD}), \
                     and {} connections break",
                    100.0 * found.drift_m,
                    100.0 * MAX_DRIFT_M,
                    found.turn_rad,
                    found.n_lost,
                )
            });
            let (n_built, n_tries) = try_building(&environment, blueprint).map_err(anyhow::Error::from)?;
            let expert = outcome(n_built > 0, || {
                format!(
                    "the expert built it in none of {n_tries} episodes of {} steps; `eval --expert --blueprint FILE \
                     --endings` says how",
                    environment.episode_steps,
                )
            });
            [settles, expert]
        }
    };
    report.results.push(CheckResult { check: Check::Settles, outcome: settles });
    report.results.push(CheckResult { check: Check::Expert, outcome: expert });
    Ok(())
}

fn outcome(holds: bool, error: impl FnOnce() -> String) -> Outcome {
    if holds { Outcome::Passed } else { Outcome::Failed { error: error() } }
}
