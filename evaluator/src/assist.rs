//! An assistant: runs episodes for whoever evaluates in the same run.

use std::sync::Arc;

use anyhow::Context;
use blueprints::Catalogue;
use proto::bus::{Bus, Pulse};
use proto::unit::{EvalAnswer, EvalEpisode, EvalUnit, PassId};
use proto::{Role, Weights};
use tokio_util::sync::CancellationToken;

use crate::config::EpisodeConfig;
use crate::desk::Desk;
use crate::episodes::{EvalError, EvalSetup, Workshop};
use crate::lanes::{Job, Played, fnv1a};
use crate::nice::on_thread;
use crate::report::Acting;
use crate::run::EvaluatorSetup;

/// Runs units of evaluators under the name `setup.id` until `shutdown`; returns how many. Of the setup, its threads, its
/// worlds side by side and its niceness are used, and its policy and environment must be those of the evaluator, whose
/// units are refused otherwise. It keeps no records.
///
/// # Errors
/// When the configuration is invalid or the session fails. An episode that cannot be run is told to the evaluator.
pub async fn assist(setup: EvaluatorSetup, bus: &Bus, shutdown: CancellationToken) -> anyhow::Result<u64> {
    setup.config.validate().context("invalid evaluator configuration")?;
    let mut units = bus.serve_units(&setup.id).await?;
    // After that, because an evaluator sends units to all who are alive.
    let _alive = bus.declare_alive(Role::Assistant, &setup.id).await?;
    let pulse = bus.pulse().clone();
    let mut assistant = Assistant { hash: setup_hash(&setup), setup, held: None, pulse };
    let mut n_units = 0;
    loop {
        let waiting = bus.pulse().waiting();
        let call = tokio::select! {
            () = shutdown.cancelled() => return Ok(n_units),
            call = units.recv() => call.context("the bus closed")?,
        };
        drop(waiting);
        let answer = assistant.answer(&call.unit, &shutdown).await?;
        n_units += u64::from(matches!(answer, Some(EvalAnswer::Episodes(_))));
        match answer {
            Some(answer) => call.answer(answer).await,
            None => return Ok(n_units),
        }
    }
}

/// Hash of everything besides weights and tasks that decides what comes of an episode.
pub(crate) fn setup_hash(setup: &EvaluatorSetup) -> u64 {
    let catalogue = Catalogue::builtin().iter().map(|blueprint| (blueprint.id().as_str(), blueprint.canonical_hash()));
    let catalogue: Vec<_> = catalogue.collect();
    let version = env!("CARGO_PKG_VERSION");
    let text = format!("{version} {:?} {} {catalogue:?}", setup.environment, setup.policy.hash());
    fnv1a(text.bytes())
}

struct Assistant {
    setup: EvaluatorSetup,
    hash: u64,
    held: Option<(PassId, Arc<Weights>)>,
    pulse: Pulse,
}

impl Assistant {
    /// `None` if `shutdown` came before the unit was done.
    async fn answer(&mut self, unit: &EvalUnit, shutdown: &CancellationToken) -> anyhow::Result<Option<EvalAnswer>> {
        if unit.setup_hash != self.hash {
            let refusal = "the assistant has another version, network or world: start it with the evaluator's settings";
            tracing::warn!("refused a unit of an evaluator with another version, network or world");
            return Ok(Some(EvalAnswer::Refused(refusal.to_owned())));
        }
        if let Some(weights) = &unit.weights {
            self.held = Some((unit.pass, Arc::new(weights.clone())));
        }
        let weights = match &self.held {
            Some((pass, weights)) if *pass == unit.pass => weights.clone(),
            _ => return Ok(Some(EvalAnswer::NeedsWeights)),
        };
        let Some(lanes) = lanes(unit) else {
            return Ok(Some(EvalAnswer::Refused("a goal is not in the assistant's catalogue".to_owned())));
        };
        let acting = if unit.is_sampled { Acting::Sampled } else { Acting::Mode };
        let (setup, shutdown, pulse) = (self.setup.clone(), shutdown.clone(), self.pulse.clone());
        let ran = on_thread(self.setup.config.nice, move || {
            let EpisodeConfig { n_threads, n_worlds, .. } = setup.config.episodes;
            let setup = EvalSetup {
                catalogue: Catalogue::builtin(),
                policy: setup.policy,
                environment: setup.environment,
                episodes: EpisodeConfig { n_threads, n_worlds, ..EpisodeConfig::default() },
                reset_free: None,
                seed: setup.seed,
            };
            let keep_going = || {
                pulse.beat();
                !shutdown.is_cancelled()
            };
            Workshop { setup: &setup, desk: &Desk::new(weights), films: None, keep_going: &keep_going }
                .run(&lanes, acting)
        });
        Ok(match ran.await? {
            Ok(played) => Some(told(&played)),
            Err(EvalError::Interrupted) => None,
            Err(error) => Some(EvalAnswer::Refused(error.to_string())),
        })
    }
}

/// The unit's lanes, if the catalogue has all of their goals.
fn lanes(unit: &EvalUnit) -> Option<Vec<Vec<Job>>> {
    let job = |task: &proto::Task| Job::of_task(Catalogue::builtin(), task.clone());
    unit.lanes.iter().map(|tasks| tasks.iter().map(job).collect()).collect()
}

fn told(lanes: &[Vec<Played>]) -> EvalAnswer {
    let told = |played: &Played| EvalEpisode {
        end: played.episode.end,
        // Episodes are far shorter; the limit of the message is that of trajectories.
        n_steps: u16::try_from(played.episode.n_steps).unwrap_or(u16::MAX),
        episode_return: played.episode.episode_return,
        forced_reset: played.forced_reset,
    };
    EvalAnswer::Episodes(lanes.iter().map(|lane| lane.iter().map(told).collect()).collect())
}
