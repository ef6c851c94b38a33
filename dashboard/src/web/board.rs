//! State of the page: the run as seen on the bus, its evaluations, and the connected browsers.

use parking_lot::{Mutex, MutexGuard};
use std::time::Duration;

use axum::body::Bytes;
use bus::MetricsSample;
use proto::ActorId;
use proto::keys::{METRICS_EVAL_SUMMARY, METRICS_LEARNER, metrics_actor};
use proto::metrics::{ActorMetrics, LearnerMetrics};
use serde::Serialize;
use serde_json::{Value, json};
use tokio::sync::OwnedSemaphorePermit;
use tokio_util::sync::CancellationToken;

use super::about::Farewell;
use super::events::{Events, Viewers, event};
use crate::follow::News;
use crate::run_view::{Link, Roster, RunView, SessionState};
use runlog::Evaluation;
use runlog::overview::{Evaluations, Overview};

/// Maximum size of a metrics sample in bytes. A learner's is below 20 KB.
const MAX_SAMPLE_BYTES: usize = 256 << 10;

/// State shared by the evaluator, the bus and all connections. No method blocks for long.
#[derive(Debug, Default)]
pub(super) struct Board(Mutex<State>);

/// Contents of a [`Board`].
#[derive(Debug, Default)]
pub(super) struct State {
    pub(super) run: RunView,
    pub(super) evaluations: Evaluations,
    pub(super) viewers: Viewers,
    pub(super) counts: PageCounts,
}

/// Counts of what the page has dropped or refused so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub(super) struct PageCounts {
    /// Metrics samples that were too large. Too many are counted as [`Unread`](crate::run_view::Unread).
    pub(super) sample_too_large_or_many_total: u64,
    /// Browsers that were too slow to read their events.
    pub(super) browser_too_slow_total: u64,
    /// Connections that could not be accepted.
    pub(super) connection_refused_total: u64,
    /// Connections closed to make room for newer ones.
    pub(super) connection_evicted_total: u64,
    /// Connections that exceeded their time limit.
    pub(super) connection_expired_total: u64,
    /// Requests without the token, with a foreign host name or two, or from another site.
    pub(super) request_refused_total: u64,
}

/// The response to `/api/history`.
#[derive(Debug, Serialize)]
struct HistoryView<'b> {
    #[serde(flatten)]
    evaluations: Overview<'b>,
    learner: Vec<&'b Value>,
}

impl Board {
    /// Locks the state. Callers hold the lock only briefly.
    pub(super) fn state(&self) -> MutexGuard<'_, State> {
        self.0.lock()
    }

    /// Records an evaluation and notifies browsers to fetch it.
    pub(super) fn evaluated(&self, evaluation: &Evaluation) {
        let mut state = self.state();
        state.evaluations.push(evaluation);
        let news = json!({ "weights_version": evaluation.weights_version, "n_env_steps": evaluation.n_env_steps });
        state.publish(&event("evaluation", &news));
    }

    /// Records a learner update of a finished run.
    pub(super) fn learned(&self, learner: &LearnerMetrics) {
        self.state().run.points.push(learner);
    }

    /// Records news from the bus and forwards it to browsers.
    pub(super) fn receive(&self, news: News, now: Duration) {
        match news {
            News::Metrics(sample) => self.measured(&sample, now),
            News::Session(session) => self.joined(&session, now),
        }
    }

    /// Records a metrics sample, and forwards it to browsers if it is news.
    fn measured(&self, sample: &MetricsSample, now: Duration) {
        let text = metrics(&sample.suffix, &sample.value);
        let mut state = self.state();
        if text.len() > MAX_SAMPLE_BYTES {
            state.counts.sample_too_large_or_many_total += 1;
        } else if state.run.take(sample, now) {
            state.publish(&text);
        }
    }

    /// Publishes the roster if it changed.
    fn joined(&self, session: &SessionState, now: Duration) {
        let mut state = self.state();
        let before = state.roster();
        state.run.set_session(session, now);
        let roster = state.roster();
        if roster != before {
            state.publish(&event("roster", &json!(roster)));
        }
    }

    /// Tells browsers that nothing more will come, and what to do then.
    pub(super) fn ended(&self, farewell: &Farewell) {
        self.state().publish(&event("ended", &json!(farewell)));
    }

    /// Sends a heartbeat, which keeps proxies from closing quiet connections and detects closed ones.
    pub(super) fn beat(&self) {
        self.state().publish(&Bytes::from_static(b": still here\n\n"));
    }

    /// Adds a listener, which keeps its `place` and first receives the known state. `close` ends its connection.
    pub(super) fn listen(&self, close: CancellationToken, place: OwnedSemaphorePermit) -> Events {
        let mut state = self.state();
        let mut first = b"retry: 2000\n\n".to_vec();
        first.extend_from_slice(&event("roster", &json!(state.roster())));
        // Results by blueprint are part of the history that the page requests.
        let learner = state.run.learner.iter().map(|heard| metrics(METRICS_LEARNER, &heard.value));
        let evaluation = state.run.evaluation.iter().map(|heard| metrics(METRICS_EVAL_SUMMARY, &heard.value));
        let actors = state.actors().map(|(id, actor)| metrics(&metrics_actor(id), actor));
        learner.chain(evaluation).chain(actors).for_each(|text| first.extend_from_slice(&text));
        state.viewers.add(first.into(), close, place)
    }

    /// Returns whether there is anything to show.
    pub(super) fn is_ready(&self) -> bool {
        let state = self.state();
        state.evaluations.last().is_some() || state.run.has_summary() || state.actors().next().is_some()
    }

    /// Returns the response to `/api/history`.
    pub(super) fn history(&self) -> serde_json::Result<Vec<u8>> {
        let state = self.state();
        let learner = state.run.points.all().collect();
        serde_json::to_vec(&HistoryView { evaluations: state.evaluations.overview(), learner })
    }
}

impl State {
    fn publish(&mut self, text: &Bytes) {
        self.counts.browser_too_slow_total += self.viewers.send(text);
    }

    /// Returns the visible processes that are alive; none while the router is gone.
    pub(super) fn roster(&self) -> Roster {
        match self.run.link {
            Link::Connected => self.run.roster.clone(),
            Link::Joining | Link::Lost => Roster::default(),
        }
    }

    /// Returns the newest metrics of the visible actors that are alive. Unlike the terminal, the page omits lost
    /// actors.
    pub(super) fn actors(&self) -> impl Iterator<Item = (&ActorId, &ActorMetrics)> {
        let is_connected = self.run.link == Link::Connected;
        let alive = self.run.actors.iter().filter(move |(id, _)| is_connected && self.run.is_alive(id));
        alive.filter_map(|(id, heard)| Some((id, &heard.as_ref()?.value)))
    }
}

/// Formats metrics as an event.
fn metrics(key: &str, payload: &impl Serialize) -> Bytes {
    event("metrics", &json!({ "key": key, "payload": payload }))
}
