//! State of the page: the run as seen on the bus, its evaluations, and the connected browsers.

use parking_lot::{Mutex, MutexGuard};
use std::collections::BTreeMap;
use std::time::Duration;

use bus::MetricsSample;
use proto::ActorId;
use proto::keys::{METRICS_EVAL_SUMMARY, METRICS_LEARNER};
use proto::metrics::{ActorMetrics, LearnerMetrics};
use serde::Serialize;
use serde_json::{Value, json};
use tokio::sync::OwnedSemaphorePermit;
use tokio_util::sync::CancellationToken;

use super::about::Farewell;
use super::events::{Events, Viewers, event};
use crate::follow::News;
use crate::run_view::proposals::CHARTED;
use crate::run_view::{Link, Roster, RunView, SessionState};
use runlog::Evaluation;
use runlog::overview::{Evaluations, Overview};

/// Maximum number of remembered metrics keys; enough for the whole catalog and hundreds of actors.
const MAX_KEYS: usize = 1024;

/// Keys for which there is always room, because the page cannot show a run without them.
const VITAL_KEYS: [&str; 2] = [METRICS_LEARNER, METRICS_EVAL_SUMMARY];

/// Maximum size of a forwarded metrics sample in bytes. A learner's is below 20 KB.
const MAX_SAMPLE_BYTES: usize = 256 << 10;

/// Maximum number of kept learning points. Beyond it, every second one is removed.
const MAX_POINTS: usize = 600;

/// State shared by the evaluator, the bus and all connections. No method blocks for long.
#[derive(Debug, Default)]
pub(super) struct Board(Mutex<State>);

/// Contents of a [`Board`].
#[derive(Debug, Default)]
pub(super) struct State {
    pub(super) run: RunView,
    pub(super) evaluations: Evaluations,
    points: Points,
    /// The newest event of each key.
    latest: BTreeMap<String, axum::body::Bytes>,
    pub(super) viewers: Viewers,
    pub(super) counts: PageCounts,
}

/// Counts of what the page has dropped or refused so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub(super) struct PageCounts {
    /// Metrics samples that were too large or exceeded the limit on keys.
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

/// Learning metrics over time, thinned out.
#[derive(Debug, Default)]
struct Points {
    kept: Vec<Point>,
    /// The newest, kept or not.
    newest: Option<Point>,
    /// Number of updates skipped between two kept ones.
    n_skipped: usize,
    n_seen: usize,
}

/// A learner update: its environment steps, and the charted values.
#[derive(Clone, Debug)]
struct Point(u64, Value);

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
        self.state().points.push(learner);
    }

    /// Records news from the bus and forwards it to browsers.
    pub(super) fn receive(&self, news: News, now: Duration) {
        match news {
            News::Metrics(samples) => samples.into_iter().for_each(|sample| self.measured(sample, now)),
            News::Session(session) => self.joined(&session, now),
        }
    }

    /// Records a metrics sample. Samples that the run view rejects are still forwarded to browsers, but do not enter
    /// the page's own numbers.
    fn measured(&self, sample: MetricsSample, now: Duration) {
        let text = event("metrics", &json!({ "key": sample.suffix, "payload": sample.value }));
        let state = &mut *self.state();
        if state.run.take(&sample, now)
            && sample.suffix == METRICS_LEARNER
            && let Some(learner) = &state.run.learner
        {
            state.points.push(&learner.value);
        }
        let has_room = state.latest.len() < MAX_KEYS
            || state.latest.contains_key(&sample.suffix)
            || VITAL_KEYS.contains(&sample.suffix.as_str());
        if text.len() > MAX_SAMPLE_BYTES || !has_room {
            state.counts.sample_too_large_or_many_total += 1;
            return;
        }
        state.publish(&text);
        state.latest.insert(sample.suffix, text);
    }

    /// Publishes the roster if it changed and forgets the events of actors that disconnected.
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

    /// Tells browsers that nothing more will come, and what to do then.
    pub(super) fn ended(&self, farewell: &Farewell) {
        self.state().publish(&event("ended", &json!(farewell)));
    }

    /// Sends a heartbeat, which keeps proxies from closing quiet connections and detects closed ones.
    pub(super) fn beat(&self) {
        self.state().publish(&axum::body::Bytes::from_static(b": still here\n\n"));
    }

    /// Adds a listener, which keeps its `place` and first receives the known state. `close` ends its connection.
    pub(super) fn listen(&self, close: CancellationToken, place: OwnedSemaphorePermit) -> Events {
        let mut state = self.state();
        let mut first = b"retry: 2000\n\n".to_vec();
        first.extend_from_slice(&event("roster", &json!(state.roster())));
        // Omit results by blueprint: they are part of the history that the page requests.
        let latest = state.latest.iter().filter(|(key, _)| !key.starts_with("eval/"));
        latest.for_each(|(_, text)| first.extend_from_slice(text));
        state.viewers.add(first.into(), close, place)
    }

    /// Returns whether there is anything to show.
    pub(super) fn is_ready(&self) -> bool {
        let state = self.state();
        state.evaluations.last().is_some() || !state.latest.is_empty()
    }

    /// Returns the response to `/api/history`.
    pub(super) fn history(&self) -> serde_json::Result<Vec<u8>> {
        let state = self.state();
        serde_json::to_vec(&HistoryView { evaluations: state.evaluations.overview(), learner: state.points.all() })
    }
}

impl State {
    fn publish(&mut self, text: &axum::body::Bytes) {
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
        let alive = self.run.actors.iter().filter(move |(_, actor)| is_connected && actor.is_alive);
        alive.filter_map(|(id, actor)| Some((id, &actor.metrics.as_ref()?.value)))
    }
}

impl Points {
    /// Returns the points that are kept, and the newest one, which is how a finished run ended.
    fn all(&self) -> Vec<&Value> {
        let is_new = |newest: &&Point| self.kept.last().is_none_or(|last| last.0 < newest.0);
        self.kept.iter().chain(self.newest.iter().filter(is_new)).map(|point| &point.1).collect()
    }

    fn push(&mut self, learner: &LearnerMetrics) {
        // After a restart from an older checkpoint or from scratch, drop the points that the learner repeats.
        self.kept.retain(|point| point.0 < learner.n_env_steps);
        self.n_seen += 1;
        let episodes = &learner.episodes;
        let mut value = json!({
            "elapsed_s": learner.elapsed_s.max(learner.run_elapsed_s),
            "n_env_steps": learner.n_env_steps,
            "n_episodes": learner.n_episodes,
            "weights_version": learner.weights_version.0,
            "success": (episodes.success.n_episodes > 0).then_some(episodes.success.rate),
            "return": (episodes.success.n_episodes > 0).then(|| episodes.mean_return.total()),
            "env_steps_per_s": learner.env_steps_per_s,
            "policy_lag_mean": learner.policy_lag_mean,
            "policy_loss": learner.ppo.policy_loss,
            "value_loss": learner.ppo.value_loss,
            "entropy": learner.ppo.entropy,
            "approx_kl": learner.ppo.approx_kl,
            "explained_variance": learner.ppo.explained_variance,
        });
        // Only the mixture head has draws.
        for (name, draws) in CHARTED.iter().filter_map(|&(name, _, look)| Some((name, look(learner)?))) {
            value[name] = draws.into();
        }
        let point = Point(learner.n_env_steps, value);
        self.newest = Some(point.clone());
        if !self.n_seen.is_multiple_of(self.n_skipped + 1) {
            return;
        }
        self.kept.push(point);
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
    use crate::tests::samples;

    fn learned(board: &Board) -> Value {
        serde_json::from_slice::<Value>(&board.history().unwrap()).unwrap()["learner"].take()
    }

    #[test]
    fn history_counts_the_time_before_a_resume() {
        let board = Board::default();
        let mut learner = samples::learner();
        board.receive(News::Metrics(vec![learner.clone()]), Duration::ZERO);
        learner.value["n_env_steps"] = 4_000_000.into();
        learner.value["run_elapsed_s"] = 5000.into();
        board.receive(News::Metrics(vec![learner]), Duration::ZERO);
        let points = learned(&board);
        assert_eq!([&points[0]["elapsed_s"], &points[1]["elapsed_s"]], [&json!(2520.5), &json!(5000.0)]);
    }

    #[test]
    fn history_has_the_draws_of_the_mixture_head() {
        let board = Board::default();
        board.receive(News::Metrics(vec![samples::mixture_learner()]), Duration::ZERO);
        let point = &learned(&board)[0];
        assert_eq!([&point["success"], &point["return"]], [0.5, 3.25]);
        for (name, value) in [("share_hold", 0.2), ("success_join", 0.125), ("second_proposal_entropy", 0.75)] {
            assert_eq!(point[name], json!(value), "{point}");
        }
        assert_eq!(point.get("success_hold"), None);
    }

    #[test]
    fn history_of_many_updates_ends_with_the_last_one() {
        let board = Board::default();
        let mut learner = samples::learner();
        let n_updates = 2 * MAX_POINTS as u64 + 7;
        for update in 1..=n_updates {
            learner.value["n_env_steps"] = (100 * update).into();
            board.receive(News::Metrics(vec![learner.clone()]), Duration::ZERO);
        }
        let points = learned(&board);
        let points = points.as_array().unwrap();
        assert!(points.len() <= MAX_POINTS + 1);
        assert!(points.is_sorted_by_key(|point| point["n_env_steps"].as_u64()));
        assert_eq!(points.last().unwrap()["n_env_steps"], json!(100 * n_updates));
    }

    #[test]
    fn many_actors_leave_room_for_the_learner_and_the_evaluator() {
        let board = Board::default();
        let tell = |sample| board.receive(News::Metrics(vec![sample]), Duration::ZERO);
        (0..MAX_KEYS).for_each(|i| tell(samples::actor(&format!("a-{i}"))));
        let known = |key: &str| board.state().latest.get(key).cloned();
        let n_dropped = || board.state().counts.sample_too_large_or_many_total;
        for sample in [samples::learner(), samples::evaluation()] {
            tell(sample.clone());
            assert!(known(&sample.suffix).is_some(), "{}", sample.suffix);
        }
        assert_eq!(n_dropped(), 0);
        // A known actor may still report, another one may not.
        tell(samples::actor("a-0"));
        assert_eq!(n_dropped(), 0);
        tell(samples::actor("late"));
        assert_eq!((n_dropped(), known("actor/late")), (1, None));
    }
}
