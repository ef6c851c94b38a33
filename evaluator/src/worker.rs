//! A remote worker: runs episodes for an evaluator of the same run.

use std::sync::Arc;

use anyhow::Context;
use blueprints::Catalog;
use bus::{Bus, Pulse};
use policy::Policy;
use proto::unit::{EvalAnswer, EvalEpisode, EvalUnit, PassId};
use proto::{ActionMode, CanonicalSettings, Role, Weights};
use tokio_util::sync::CancellationToken;

use crate::config::EpisodeConfig;
use crate::films::EpisodeSelector;
use crate::nice::on_thread;
use crate::pool::EvaluationPool;
use crate::report::EpisodeResult;
use crate::sequences::EpisodeSpec;
use crate::setup::{EvalError, EvalSetup, EvaluatorSetup};
use crate::work_queue::WorkQueue;

/// Runs units of evaluators under the name `setup.id` until `shutdown`; returns how many. Uses the setup's number of
/// threads, worlds per thread, and niceness. Its policy and environment must be those of the evaluator, whose units are
/// refused otherwise. Keeps no records.
///
/// # Errors
/// If the configuration is invalid or the session fails. If an episode cannot be run, the evaluator receives the error.
pub async fn run_worker(setup: EvaluatorSetup, bus: &Bus, shutdown: CancellationToken) -> anyhow::Result<u64> {
    setup.config.validate().context("invalid evaluator configuration")?;
    let mut units = bus.serve_units(&setup.id).await?;
    // Only after `serve_units`, because an evaluator sends units to all workers that are alive.
    let _alive = bus.declare_alive(Role::Worker, &setup.id).await?;
    let pulse = bus.pulse().clone();
    let mut worker = RemoteWorker { settings: setup.settings(), setup, held: None, pulse };
    let mut n_units = 0;
    loop {
        let waiting = bus.pulse().waiting();
        let call = tokio::select! {
            () = shutdown.cancelled() => return Ok(n_units),
            call = units.recv() => call.context("the bus closed")?,
        };
        drop(waiting);
        let answer = worker.answer(&call.unit, &shutdown).await?;
        n_units += u64::from(matches!(answer, Some(EvalAnswer::Episodes(_))));
        match answer {
            Some(answer) => call.answer(answer).await,
            None => return Ok(n_units),
        }
    }
}

struct RemoteWorker {
    setup: EvaluatorSetup,
    settings: CanonicalSettings,
    held: Option<(PassId, Arc<Weights>)>,
    pulse: Pulse,
}

impl RemoteWorker {
    /// Returns `None` if `shutdown` was canceled before the unit was done.
    async fn answer(&mut self, unit: &EvalUnit, shutdown: &CancellationToken) -> anyhow::Result<Option<EvalAnswer>> {
        if let Some(difference) = unit.settings.difference(&self.settings) {
            let difference = difference.between("at the evaluator", "at the worker");
            tracing::warn!(difference, "refused a unit of an evaluator with other settings");
            let refusal = format!("{difference}: start the worker with the evaluator's settings");
            return Ok(Some(EvalAnswer::Refused(refusal)));
        }
        if let Some(weights) = &unit.weights {
            self.held = Some((unit.pass, Arc::new(weights.clone())));
        }
        let weights = match &self.held {
            Some((pass, weights)) if *pass == unit.pass => weights.clone(),
            _ => return Ok(Some(EvalAnswer::NeedsWeights)),
        };
        let Some(sequences) = sequences(unit, self.setup.catalog) else {
            return Ok(Some(EvalAnswer::Refused("a goal is not in the worker's catalog".to_owned())));
        };
        let acting = if unit.is_sampled { ActionMode::Sampled } else { ActionMode::Greedy };
        let (setup, shutdown, pulse) = (self.setup.clone(), shutdown.clone(), self.pulse.clone());
        let ran = on_thread(self.setup.config.nice, move || {
            let EpisodeConfig { n_threads, n_worlds, .. } = setup.config.episodes;
            let policy = setup.policy;
            let agent = || Policy::with_weights(&policy, &weights).map_err(EvalError::from);
            let setup = EvalSetup {
                catalog: setup.catalog,
                environment: setup.environment,
                episodes: EpisodeConfig { n_threads, n_worlds, ..EpisodeConfig::default() },
                reset_free: None,
                seed: setup.seed,
            };
            let keep_going = || {
                pulse.beat();
                !shutdown.is_cancelled()
            };
            let (queue, observer) = (&WorkQueue::default(), None::<&EpisodeSelector>);
            EvaluationPool { setup: &setup, agent: &agent, queue, observer, keep_going: &keep_going }
                .run(&sequences, acting)
        });
        Ok(match ran.await? {
            (results, Ok(())) => Some(to_answer(&results)),
            (_, Err(EvalError::Interrupted)) => None,
            (_, Err(error)) => Some(EvalAnswer::Refused(error.to_string())),
        })
    }
}

/// Returns the unit's sequences; `None` if the catalog lacks one of their goals.
fn sequences(unit: &EvalUnit, catalog: &Catalog) -> Option<Vec<Vec<EpisodeSpec>>> {
    let spec = |task: &proto::Task| EpisodeSpec::of_task(catalog, task.clone());
    unit.sequences.iter().map(|tasks| tasks.iter().map(spec).collect()).collect()
}

fn to_answer(sequences: &[Vec<EpisodeResult>]) -> EvalAnswer {
    let to_wire = |result: &EpisodeResult| EvalEpisode {
        end: result.end,
        // Episodes are far shorter; the message has the limit of trajectories.
        n_steps: u16::try_from(result.n_steps).unwrap_or(u16::MAX),
        episode_return: result.episode_return,
        forced_reset: result.forced_reset,
    };
    EvalAnswer::Episodes(sequences.iter().map(|sequence| sequence.iter().map(to_wire).collect()).collect())
}
