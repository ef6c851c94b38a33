//! What the page knows: the run as the bus tells it, what else it is given, and the browsers that listen.

use parking_lot::{Mutex, MutexGuard};
use std::collections::BTreeMap;
use std::time::Duration;

use bus::MetricsSample;
use proto::ActorId;
use proto::keys::METRICS_LEARNER;
use proto::metrics::{ActorMetrics, LearnerMetrics};
use serde::Serialize;
use serde_json::json;
use tokio_util::sync::CancellationToken;

use super::events::{Events, Viewers, event};
use crate::follow::News;
use crate::run_view::{Link, Roster, RunView, SessionState};
use runlog::Pass;
use runlog::overview::{Passes, PassesView, SCHEMA_VERSION};

/// Most keys of metrics that are remembered; the whole catalog and hundreds of actors fit.
const MAX_KEYS: usize = 1024;

/// Largest value of metrics that is passed on, bytes. A learner's is below 20 KB.
const MAX_SAMPLE_BYTES: usize = 256 << 10;

/// Most points of learning that are kept; beyond, every second one goes.
const MAX_POINTS: usize = 600;

/// Shared by the evaluator, the bus and all connections. Every method returns at once.
#[derive(Debug, Default)]
pub(super) struct Board(Mutex<State>);

/// What a board knows.
#[derive(Debug, Default)]
pub(super) struct State {
    pub(super) run: RunView,
    pub(super) passes: Passes,
    points: Points,
    /// The newest event of each key.
    latest: BTreeMap<String, axum::body::Bytes>,
    pub(super) viewers: Viewers,
    pub(super) counts: PageCounts,
}

/// What the page dropped or refused so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct PageCounts {
    /// Metrics that were too large, or one key too many.
    pub(super) samples_dropped_total: u64,
    /// Browsers that did not take events in time.
    pub(super) viewers_dropped_total: u64,
    /// Connections closed at once because there were too many, or that failed to be accepted.
    pub(super) connections_refused_total: u64,
    /// Connections that were not done in time.
    pub(super) connections_expired_total: u64,
    /// Requests without the token, or to a name that is not this machine's.
    pub(super) requests_refused_total: u64,
}

/// Learning over time, thinned out.
#[derive(Debug, Default)]
struct Points {
    kept: Vec<Point>,
    /// One of how many is kept, less one.
    n_skipped: usize,
    n_seen: usize,
}

/// One update of the learner, as far as it is drawn.
#[derive(Clone, Debug, Serialize)]
struct Point {
    elapsed_s: f64,
    n_env_steps: u64,
    weights_version: u64,
    env_steps_per_s: f64,
    policy_lag_mean: f64,
    policy_loss: f64,
    value_loss: f64,
    entropy: f64,
    approx_kl: f64,
    explained_variance: f64,
    /// What labels teach; nothing where they do not.
    #[serde(flatten)]
    labels: Option<Labels>,
}

/// What the expert's labels teach.
#[derive(Clone, Debug, Serialize)]
struct Labels {
    block_accuracy: f64,
    block_loss: f64,
    move_loss: f64,
}

/// The answer to `/api/history`.
#[derive(Debug, Serialize)]
struct HistoryView<'b> {
    schema_version: u32,
    #[serde(flatten)]
    passes: PassesView<'b>,
    learner: &'b [Point],
}

impl Board {
    /// What is known, for a short look.
    pub(super) fn state(&self) -> MutexGuard<'_, State> {
        self.0.lock()
    }

    /// Remembers a pass and tells browsers to ask for it.
    pub(super) fn judged(&self, pass: &Pass) {
        let mut state = self.state();
        state.passes.push(pass);
        let news = json!({ "weights_version": pass.weights_version, "n_env_steps": pass.n_env_steps });
        state.publish(&event("pass", &news));
    }

    /// Remembers an update of a learner that has ended.
    pub(super) fn learned(&self, learner: &LearnerMetrics) {
        self.state().points.push(learner);
    }

    /// Remembers what the bus tells and passes it on.
    pub(super) fn told(&self, news: News, now: Duration) {
        match news {
            News::Metrics(samples) => samples.into_iter().for_each(|sample| self.measured(sample, now)),
            News::Session(session) => self.joined(&session, now),
        }
    }

    /// What the run's view refuses is still passed on; it only does not get into the page's own numbers.
    fn measured(&self, sample: MetricsSample, now: Duration) {
        let text = event("metrics", &json!({ "key": sample.suffix, "payload": sample.value }));
        let state = &mut *self.state();
        if state.run.take(&sample, now)
            && sample.suffix == METRICS_LEARNER
            && let Some(learner) = state.run.learner()
        {
            state.points.push(&learner.value);
        }
        let is_new = !state.latest.contains_key(&sample.suffix);
        if text.len() > MAX_SAMPLE_BYTES || (is_new && state.latest.len() >= MAX_KEYS) {
            state.counts.samples_dropped_total += 1;
            return;
        }
        state.publish(&text);
        state.latest.insert(sample.suffix, text);
    }

    /// Tells who is alive if that has changed; the events of actors that have gone are forgotten.
    fn joined(&self, session: &SessionState, now: Duration) {
        let mut state = self.state();
        let before = state.roster();
        state.run.set_session(session, now);
        let roster = state.roster();
        if roster == before {
            return;
        }
        for gone in before.actors.difference(&roster.actors) {
            state.latest.remove(&format!("actor/{gone}"));
        }
        state.publish(&event("roster", &json!(roster)));
    }

    /// Sends what keeps proxies from closing a quiet connection, and finds those that have gone.
    pub(super) fn beat(&self) {
        self.state().publish(&axum::body::Bytes::from_static(b": still here\n\n"));
    }

    /// A new listener, who gets what is known first; `None` if there are too many. `close` ends its connection.
    pub(super) fn listen(&self, close: CancellationToken) -> Option<Events> {
        let mut state = self.state();
        let mut first = b"retry: 2000\n\n".to_vec();
        first.extend_from_slice(&event("roster", &json!(state.roster())));
        // Blueprints are in the history that the page asks for.
        let latest = state.latest.iter().filter(|(key, _)| !key.starts_with("eval/"));
        latest.for_each(|(_, text)| first.extend_from_slice(text));
        state.viewers.add(first.into(), close)
    }

    /// Whether there is anything to see.
    pub(super) fn is_ready(&self) -> bool {
        let state = self.state();
        state.passes.last().is_some() || !state.latest.is_empty()
    }

    /// The answer to `/api/history`.
    pub(super) fn history(&self) -> serde_json::Result<Vec<u8>> {
        let state = self.state();
        serde_json::to_vec(&HistoryView {
            schema_version: SCHEMA_VERSION,
            passes: state.passes.view(),
            learner: &state.points.kept,
        })
    }
}

impl State {
    fn publish(&mut self, text: &axum::body::Bytes) {
        self.counts.viewers_dropped_total += self.viewers.send(text);
    }

    /// Who is alive, as far as can be seen: nobody while the router is gone.
    pub(super) fn roster(&self) -> Roster {
        match self.run.link().0 {
            Link::Connected => self.run.roster().clone(),
            Link::Joining | Link::Lost => Roster::default(),
        }
    }

    /// The newest metrics of the actors that are alive, as far as can be seen; unlike the terminal, the page shows no
    /// lost ones.
    pub(super) fn actors(&self) -> impl Iterator<Item = (&ActorId, &ActorMetrics)> {
        let is_connected = self.run.link().0 == Link::Connected;
        let alive = self.run.actors().iter().filter(move |(_, actor)| is_connected && actor.is_alive);
        alive.filter_map(|(id, actor)| Some((id, &actor.metrics.as_ref()?.value)))
    }
}

impl Points {
    fn push(&mut self, learner: &LearnerMetrics) {
        // A learner that began anew, from an older checkpoint or nothing: what came of the other is left out.
        self.kept.retain(|point| point.n_env_steps < learner.n_env_steps);
        self.n_seen += 1;
        if !self.n_seen.is_multiple_of(self.n_skipped + 1) {
            return;
        }
        self.kept.push(Point {
            elapsed_s: learner.elapsed_s.max(learner.run_elapsed_s),
            n_env_steps: learner.n_env_steps,
            weights_version: learner.weights_version.0,
            env_steps_per_s: learner.env_steps_per_s,
            policy_lag_mean: learner.policy_lag_mean,
            policy_loss: learner.ppo.policy_loss,
            value_loss: learner.ppo.value_loss,
            entropy: learner.ppo.entropy,
            approx_kl: learner.ppo.approx_kl,
            explained_variance: learner.ppo.explained_variance,
            labels: learner.imitation.filter(|imitation| imitation.weight > 0.0).map(|imitation| Labels {
                block_accuracy: imitation.block_accuracy,
                block_loss: imitation.block_loss,
                move_loss: imitation.move_loss,
            }),
        });
        if self.kept.len() > MAX_POINTS {
            let mut place = 0;
            self.kept.retain(|_| {
                place += 1;
                place % 2 == 0
            });
            self.n_skipped = 2 * self.n_skipped + 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::samples;

    #[test]
    fn history_has_what_labels_teach_and_the_time_before_a_resume() {
        let board = Board::default();
        let mut learner = samples::learner();
        board.told(News::Metrics(vec![learner.clone()]), Duration::ZERO);
        learner.value["n_env_steps"] = 4_000_000.into();
        learner.value["run_elapsed_s"] = 5000.into();
        learner.value["imitation"] = json!({
            "weight": 1.0, "block_loss": 0.25, "move_loss": 0.5, "block_accuracy": 0.75, "n_gradient_steps": 8,
            "n_replay": 100,
        });
        board.told(News::Metrics(vec![learner]), Duration::ZERO);
        let history: serde_json::Value = serde_json::from_slice(&board.history().unwrap()).unwrap();
        let points = &history["learner"];
        let labels = ["block_accuracy", "block_loss", "move_loss"];
        assert_eq!(labels.map(|name| points[0].get(name)), [None; 3]);
        assert_eq!(labels.map(|name| points[1][name].as_f64()), [0.75, 0.25, 0.5].map(Some));
        assert_eq!([&points[0]["elapsed_s"], &points[1]["elapsed_s"]], [&json!(2520.5), &json!(5000.0)]);
    }
}
