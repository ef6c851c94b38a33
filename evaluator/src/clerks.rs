//! Gives the lanes of a pass to assistants: a task for each, which lives as long as the assistant.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context;
use proto::Role;
use proto::bus::{AliveWatch, AssistantCaller, Bus, CallError, process_epoch_ms};
use proto::unit::{EvalAnswer, EvalEpisode, EvalUnit, PassId};
use tokio::sync::watch;
use tokio_util::task::AbortOnDropHandle;

use crate::desk::{Assisting, Desk, Lent};
use crate::lanes::Played;
use crate::report::Acting;

/// Most assistants that are made use of.
const MAX_ASSISTANTS: usize = 256;

/// Pause after an assistant gave no answer.
const PAUSE: Duration = Duration::from_secs(1);

/// The desk of the pass under way.
#[derive(Clone, Debug)]
struct Open {
    pass: PassId,
    desk: Arc<Desk>,
}

/// Keeps assistants busy.
#[derive(Debug)]
pub(crate) struct Clerks {
    open: watch::Sender<Option<Open>>,
    pass: PassId,
    _manager: AbortOnDropHandle<()>,
}

impl Clerks {
    /// Looks for assistants from now on; `setup_hash` must be theirs.
    pub(crate) async fn hire(bus: &Bus, setup_hash: u64) -> anyhow::Result<Self> {
        let (open, passes) = watch::channel(None);
        let assistants = bus.alive(Role::Assistant).await.context("looking for assistants")?;
        let manager = Manager { bus: bus.clone(), setup_hash, passes };
        Ok(Self {
            open,
            pass: PassId { epoch: process_epoch_ms(), number: 0 },
            _manager: AbortOnDropHandle::new(tokio::spawn(manager.run(assistants))),
        })
    }

    /// Lets assistants work at this desk.
    pub(crate) fn open(&mut self, desk: Arc<Desk>) {
        self.open.send_replace(Some(Open { pass: self.pass, desk }));
        self.pass.number += 1;
    }

    /// Sends them away.
    pub(crate) fn close(&self) {
        self.open.send_replace(None);
    }
}

struct Manager {
    bus: Bus,
    setup_hash: u64,
    passes: watch::Receiver<Option<Open>>,
}

impl Manager {
    async fn run(self, assistants: AliveWatch) {
        let mut names = assistants.watch();
        let mut clerks: BTreeMap<String, AbortOnDropHandle<()>> = BTreeMap::new();
        loop {
            let alive = names.borrow_and_update().clone();
            // Whoever is gone and comes back is somebody new.
            clerks.retain(|name, clerk| alive.contains(name) && !clerk.is_finished());
            for name in alive {
                if clerks.len() >= MAX_ASSISTANTS || clerks.contains_key(&name) {
                    continue;
                }
                let (bus, hash, passes) = (self.bus.clone(), self.setup_hash, self.passes.clone());
                let clerk = tokio::spawn({
                    let name = name.clone();
                    async move {
                        match bus.assistant_caller(&name).await {
                            Ok(caller) => Clerk { name, hash, caller, passes }.run().await,
                            Err(error) => tracing::warn!(assistant = name, %error, "an assistant cannot be reached"),
                        }
                    }
                });
                clerks.insert(name, AbortOnDropHandle::new(clerk));
            }
            if names.changed().await.is_err() {
                return;
            }
        }
    }
}

/// Works with one assistant.
struct Clerk {
    name: String,
    hash: u64,
    caller: AssistantCaller,
    passes: watch::Receiver<Option<Open>>,
}

impl Clerk {
    /// Until the evaluator ends or the assistant refuses.
    async fn run(mut self) {
        loop {
            let Ok(open) = self.passes.wait_for(Option::is_some).await.map(|open| open.clone()) else { return };
            let Some(open) = open else { continue };
            let mut passes = self.passes.clone();
            passes.mark_unchanged();
            tokio::select! {
                // Lanes that were lent go back to the desk with the future that holds them.
                changed = passes.changed() => if changed.is_err() { return },
                refusal = self.serve(&open) => {
                    tracing::warn!(assistant = self.name, refusal, "an assistant is of no use");
                    return;
                }
            }
        }
    }

    /// Serves one pass; returns why the assistant will not work.
    async fn serve(&self, open: &Open) -> String {
        let assisting = Assisting::new(open.desk.clone());
        let mut posted = open.desk.watch();
        loop {
            posted.mark_unchanged();
            let Some(lent) = assisting.take() else {
                // Lanes that come back at the end of a round are for the evaluator's own threads.
                if posted.changed().await.is_err() {
                    std::future::pending::<()>().await;
                }
                continue;
            };
            match self.call(open, &lent).await {
                Ok(EvalAnswer::Episodes(episodes)) => match fit(&lent, &episodes) {
                    Some(played) => lent.bring(played),
                    None => return "its answer has another shape than its unit".to_owned(),
                },
                Ok(EvalAnswer::Refused(why)) => return why,
                Ok(EvalAnswer::NeedsWeights) => return "it has no use for the weights that it asked for".to_owned(),
                Err(CallError::NoAnswer) => {
                    drop(lent);
                    tokio::time::sleep(PAUSE).await;
                }
                Err(error) => return error.to_string(),
            }
        }
    }

    async fn call(&self, open: &Open, lent: &Lent) -> Result<EvalAnswer, CallError> {
        let mut unit = EvalUnit {
            setup_hash: self.hash,
            pass: open.pass,
            weights: None,
            is_sampled: lent.acting == Acting::Sampled,
            lanes: lent.jobs().map(|jobs| jobs.iter().map(|job| job.task().clone()).collect()).collect(),
        };
        let answer = self.caller.run(&unit).await?;
        if answer != EvalAnswer::NeedsWeights {
            return Ok(answer);
        }
        unit.weights = Some(open.desk.weights().as_ref().clone());
        self.caller.run(&unit).await
    }
}

/// The episodes as those of the lanes, if there is one for each.
fn fit(lent: &Lent, lanes: &[Vec<EvalEpisode>]) -> Option<Vec<Vec<Played>>> {
    if lanes.len() != lent.jobs().count() || lent.jobs().zip(lanes).any(|(jobs, episodes)| jobs.len() != episodes.len())
    {
        return None;
    }
    let played = |(job, episode): (&crate::lanes::Job, &EvalEpisode)| {
        let EvalEpisode { end, n_steps, episode_return, forced_reset } = *episode;
        job.played(lent.acting, end, n_steps.into(), episode_return, forced_reset)
    };
    Some(lent.jobs().zip(lanes).map(|(jobs, episodes)| jobs.iter().zip(episodes).map(played).collect()).collect())
}

#[cfg(test)]
mod tests;
