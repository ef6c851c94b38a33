//! Distributes the sequences of an evaluation to remote workers. Each worker has its own task, which lives as long as
//! the worker.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context;
use bus::{AliveWatch, Bus, CallError, WorkerCaller, process_epoch_ms};
use proto::unit::{EvalAnswer, EvalEpisode, EvalUnit, PassId};
use proto::{ActionMode, CanonicalSettings, Role, Weights};
use tokio::sync::watch;
use tokio_util::task::AbortOnDropHandle;

use crate::report::EpisodeResult;
use crate::sequences::EpisodeSpec;
use crate::work_queue::{Lease, MAX_LEASED, WorkQueue, WorkerGuard};

/// Maximum number of remote workers used.
const MAX_WORKERS: usize = 256;

/// How long a remote worker may take for a unit. A worker that ends is noticed at once.
pub(crate) const UNIT_PATIENCE: Duration = Duration::from_secs(300);

/// Number of units in a row that a remote worker may leave unanswered before the evaluation goes on without it.
const MAX_TOO_LATE: u32 = 3;

/// Pause after a remote worker did not answer.
const PAUSE: Duration = Duration::from_secs(1);

/// The evaluation in progress.
#[derive(Clone, Debug)]
struct Open {
    pass: PassId,
    queue: Arc<WorkQueue>,
    weights: Arc<Weights>,
}

/// Keeps remote workers busy.
#[derive(Debug)]
pub(crate) struct Dispatcher {
    open: watch::Sender<Option<Open>>,
    pass: PassId,
    _manager: AbortOnDropHandle<()>,
}

impl Dispatcher {
    /// Starts watching for remote workers, which must have the same `settings` and may take `patience` for a unit.
    pub(crate) async fn start(bus: &Bus, settings: CanonicalSettings, patience: Duration) -> anyhow::Result<Self> {
        let (open, evaluations) = watch::channel(None);
        let workers = bus.alive(Role::Worker).await.context("looking for remote workers")?;
        let manager = Manager { bus: bus.clone(), settings, patience, evaluations };
        Ok(Self {
            open,
            pass: PassId { epoch: process_epoch_ms(), number: 0 },
            _manager: AbortOnDropHandle::new(tokio::spawn(manager.run(workers))),
        })
    }

    /// Offers the sequences of `queue` to remote workers, which act with `weights`.
    pub(crate) fn open(&mut self, queue: Arc<WorkQueue>, weights: Arc<Weights>) {
        self.open.send_replace(Some(Open { pass: self.pass, queue, weights }));
        self.pass.number += 1;
    }

    /// Stops offering sequences.
    pub(crate) fn close(&self) {
        self.open.send_replace(None);
    }
}

struct Manager {
    bus: Bus,
    settings: CanonicalSettings,
    patience: Duration,
    evaluations: watch::Receiver<Option<Open>>,
}

impl Manager {
    async fn run(self, workers: AliveWatch) {
        let mut names = workers.watch();
        let mut workers: BTreeMap<String, AbortOnDropHandle<()>> = BTreeMap::new();
        loop {
            let alive = names.borrow_and_update().clone();
            // A worker that disconnects and returns is treated as new.
            workers.retain(|name, worker| alive.contains(name) && !worker.is_finished());
            for name in alive {
                if workers.len() >= MAX_WORKERS || workers.contains_key(&name) {
                    continue;
                }
                let (bus, settings, patience) = (self.bus.clone(), self.settings.clone(), self.patience);
                let evaluations = self.evaluations.clone();
                let worker = tokio::spawn({
                    let name = name.clone();
                    async move {
                        match bus.worker_caller(&name, patience).await {
                            Ok(caller) => WorkerClient { name, settings, caller, evaluations }.run().await,
                            Err(error) => tracing::warn!(worker = name, %error, "a remote worker cannot be reached"),
                        }
                    }
                });
                workers.insert(name, AbortOnDropHandle::new(worker));
            }
            if names.changed().await.is_err() {
                return;
            }
        }
    }
}

/// Serves one remote worker.
struct WorkerClient {
    name: String,
    settings: CanonicalSettings,
    caller: WorkerCaller,
    evaluations: watch::Receiver<Option<Open>>,
}

impl WorkerClient {
    /// Runs until the evaluator ends. A remote worker that refuses is asked again in the next evaluation: it may have
    /// refused only the weights.
    async fn run(mut self) {
        loop {
            let Ok(open) = self.evaluations.wait_for(Option::is_some).await.map(|open| open.clone()) else { return };
            let Some(open) = open else { continue };
            let mut opened = self.evaluations.clone();
            opened.mark_unchanged();
            let changed = tokio::select! {
                // Dropping the `serve` future returns its leased sequences to the work queue.
                changed = opened.changed() => changed,
                refusal = self.serve(&open) => {
                    tracing::warn!(worker = self.name, refusal, "a remote worker is of no use in this evaluation");
                    opened.changed().await
                }
            };
            if changed.is_err() {
                return;
            }
        }
    }

    /// Serves one evaluation. Returns the reason if the remote worker cannot be used.
    async fn serve(&self, open: &Open) -> String {
        let guard = WorkerGuard::new(open.queue.clone());
        let mut posted = open.queue.watch();
        let (mut at_most, mut n_too_late) = (MAX_LEASED, 0);
        loop {
            posted.mark_unchanged();
            let Some(lease) = guard.take(at_most) else {
                // Sequences returned at the end of a round are left to the evaluator's own threads.
                if posted.changed().await.is_err() {
                    std::future::pending::<()>().await;
                }
                continue;
            };
            match self.call(open, &lease).await {
                Ok(EvalAnswer::Episodes(episodes)) => match fit(&lease, &episodes) {
                    Some(results) => {
                        lease.bring(results);
                        n_too_late = 0;
                    }
                    None => return "its answer has another shape than its unit".to_owned(),
                },
                Ok(EvalAnswer::Refused(why)) => return why,
                Ok(EvalAnswer::NeedsWeights) => return "it has no use for the weights that it asked for".to_owned(),
                Err(CallError::NoAnswer) => {
                    drop(lease);
                    tokio::time::sleep(PAUSE).await;
                }
                Err(CallError::TooLate) => {
                    n_too_late += 1;
                    if n_too_late == MAX_TOO_LATE {
                        return format!("it answered none of {MAX_TOO_LATE} units in time");
                    }
                    let n_sequences = lease.specs().count();
                    tracing::warn!(worker = self.name, n_sequences, "a remote worker did not answer in time");
                    // It may only be slow.
                    at_most = (n_sequences / 2).max(1);
                }
                Err(error) => return error.to_string(),
            }
        }
    }

    async fn call(&self, open: &Open, lease: &Lease) -> Result<EvalAnswer, CallError> {
        let mut unit = EvalUnit {
            settings: self.settings.clone(),
            pass: open.pass,
            weights: None,
            is_sampled: lease.acting == ActionMode::Sampled,
            sequences: lease.specs().map(|specs| specs.iter().map(|spec| spec.task().clone()).collect()).collect(),
        };
        let answer = self.caller.run(&unit).await?;
        if answer != EvalAnswer::NeedsWeights {
            return Ok(answer);
        }
        unit.weights = Some(open.weights.as_ref().clone());
        self.caller.run(&unit).await
    }
}

/// Converts the episodes to results in the shape of the sequences; `None` if the shapes differ.
fn fit(lease: &Lease, sequences: &[Vec<EvalEpisode>]) -> Option<Vec<Vec<EpisodeResult>>> {
    if sequences.len() != lease.specs().count()
        || lease.specs().zip(sequences).any(|(specs, episodes)| specs.len() != episodes.len())
    {
        return None;
    }
    let results = |(spec, episode): (&EpisodeSpec, &EvalEpisode)| {
        let EvalEpisode { end, n_steps, episode_return, forced_reset } = *episode;
        spec.result(lease.acting, end, n_steps.into(), episode_return, forced_reset)
    };
    Some(
        lease
            .specs()
            .zip(sequences)
            .map(|(specs, episodes)| specs.iter().zip(episodes).map(results).collect())
            .collect(),
    )
}

#[cfg(test)]
mod tests;
