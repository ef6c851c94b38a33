//! The known state of a run: the newest metrics of each part and which processes are alive. Shown by the page and the
//! terminal.

mod points;
pub(crate) mod proposals;
mod sizes;

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use blueprints::BlueprintId;
use bus::MetricsSample;
use proto::metrics::{
    ActorMetrics, BusCounts, EvalBlueprint, EvalOutcome, EvalSummary, LearnerMetrics, METRICS_SCHEMA_VERSION, NotSaved,
};
use proto::wilson::SuccessRate;
use proto::{ActorId, WeightsVersion, keys};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use time::OffsetDateTime;

pub(crate) use points::Points;
pub use sizes::Sizes;

/// Maximum number of remembered actors, including lost ones, so that invented names cannot exhaust memory.
pub(crate) const MAX_ACTORS: usize = 10_000;

/// Maximum number of remembered blueprints.
pub(crate) const MAX_BLUEPRINTS: usize = 10_000;

/// Maximum number of remembered evaluations.
const MAX_EVALUATIONS: usize = 200;

/// State of a run, built from its messages. Reads no clock: callers pass times, measured from the start of the watch.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct RunView {
    /// The connection to the bus.
    pub(crate) link: Link,
    /// Since when the connection is in this state.
    pub(crate) link_since: Duration,
    /// The learner's newest metrics.
    pub(crate) learner: Option<Newest<LearnerMetrics>>,
    /// The newest evaluation.
    pub(crate) evaluation: Option<Newest<EvalSummary>>,
    blueprints: BTreeMap<BlueprintId, EvalBlueprint>,
    /// All actors seen so far, with their newest metrics.
    pub(crate) actors: BTreeMap<ActorId, Option<Newest<ActorMetrics>>>,
    /// The processes that are alive; while the connection is lost, those that were alive before.
    pub(crate) roster: Roster,
    /// Counts of received metrics that are not shown.
    pub(crate) unread: Unread,
    /// Counts of messages dropped by the watch's own session.
    pub(crate) bus: BusCounts,
    /// The learner's updates since the watch began.
    pub(crate) points: Points,
    /// Success rates of the newest complete evaluations, oldest first.
    pub(crate) evaluated: Vec<f64>,
    /// Success of the newest training episodes by size.
    pub(crate) sizes: Sizes,
    /// The other runs on the router, as of the last lookup.
    pub(crate) others: BTreeSet<String>,
}

/// State of the connection to the bus.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Link {
    /// No router has been reached yet.
    #[default]
    Joining,
    /// A router is connected.
    Connected,
    /// A router was connected before but is not now.
    Lost,
}

/// A value and its time of arrival.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Newest<T> {
    pub(crate) value: T,
    /// Time of arrival since the watch began.
    pub(crate) at: Duration,
}

/// Counts of received metrics that are not shown, by reason. The bus counts messages that are not JSON.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub(crate) struct Unread {
    /// The schema version is missing or different.
    pub(crate) schema_unknown_total: u64,
    /// The content does not match the key.
    pub(crate) metrics_unreadable_total: u64,
    /// The key is unknown to this version.
    pub(crate) keys_unknown_total: u64,
    /// The limit on remembered actors or blueprints was reached.
    pub(crate) over_limit_total: u64,
}

/// Processes that are alive, by the names of their liveliness tokens.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub(crate) struct Roster {
    pub(crate) actors: BTreeSet<String>,
    pub(crate) learners: BTreeSet<String>,
    pub(crate) evaluators: BTreeSet<String>,
}

/// State of the watch's own session at one point in time.
#[derive(Clone, Debug, Default)]
pub(crate) struct SessionState {
    /// Whether a router is connected.
    pub(crate) is_connected: bool,
    /// Processes that are alive, if connected.
    pub(crate) roster: Roster,
    /// Messages that the session has dropped so far.
    pub(crate) counts: BusCounts,
}

/// Why a sample is rejected: the count of those that are rejected for this reason.
type Refusal = fn(&mut Unread) -> &mut u64;

const SCHEMA: Refusal = |unread| &mut unread.schema_unknown_total;
const UNREADABLE: Refusal = |unread| &mut unread.metrics_unreadable_total;
const KEY: Refusal = |unread| &mut unread.keys_unknown_total;
const LIMIT: Refusal = |unread| &mut unread.over_limit_total;

impl RunView {
    /// Processes one metrics sample. Samples that cannot be shown are counted and change nothing else. Returns whether
    /// the shown state changed.
    pub(crate) fn take(&mut self, sample: &MetricsSample, now: Duration) -> bool {
        self.read(&sample.suffix, &sample.value, now).unwrap_or_else(|refusal| {
            let count = refusal(&mut self.unread);
            *count = count.saturating_add(1);
            false
        })
    }

    /// Updates the state of the session. Returns whether anything changed.
    pub(crate) fn set_session(&mut self, session: &SessionState, now: Duration) -> bool {
        let link = match (session.is_connected, self.link) {
            (true, _) => Link::Connected,
            (false, Link::Joining) => Link::Joining,
            (false, Link::Connected | Link::Lost) => Link::Lost,
        };
        let mut has_changed = link != self.link || session.counts != self.bus;
        if link != self.link {
            (self.link, self.link_since) = (link, now);
        }
        self.bus = session.counts;
        // All tokens vanish along with the router, so the roster is kept while disconnected.
        if session.is_connected && session.roster != self.roster {
            self.roster.clone_from(&session.roster);
            for id in session.roster.actors.iter().filter_map(|name| ActorId::try_from(name.clone()).ok()) {
                if !self.actors.contains_key(&id) && self.make_room_for_actor() {
                    self.actors.insert(id, None);
                }
            }
            has_changed = true;
        }
        has_changed
    }

    /// Returns whether the actor's liveliness token exists. A known actor that is not alive is lost.
    pub(crate) fn is_alive(&self, actor: &ActorId) -> bool {
        self.roster.actors.contains(actor.as_str())
    }

    /// Returns the newest result of each blueprint for the weights of the newest evaluation. Before the first
    /// evaluation, for the newest weights that any blueprint was evaluated with.
    pub(crate) fn evaluated_blueprints(&self) -> Vec<&EvalBlueprint> {
        let newest = || self.blueprints.values().map(|blueprint| blueprint.weights_version).max();
        let version: Option<WeightsVersion> =
            self.evaluation.as_ref().map(|summary| summary.value.weights_version).or_else(newest);
        self.blueprints.values().filter(|blueprint| Some(blueprint.weights_version) == version).collect()
    }

    /// Returns the names and values, oldest first, of all numbers over time that have values.
    pub(crate) fn trends(&self) -> impl Iterator<Item = (&'static str, Vec<f64>)> {
        let evaluated = ("success, evaluated", self.evaluated.clone());
        [evaluated].into_iter().chain(self.points.charted()).filter(|(_, values)| !values.is_empty())
    }

    /// Returns whether no process is alive and no metrics have arrived.
    pub(crate) fn is_empty(&self) -> bool {
        let Roster { actors, learners, evaluators } = &self.roster;
        let is_nobody = learners.is_empty() && evaluators.is_empty() && actors.is_empty();
        !self.has_summary() && is_nobody && self.actors.is_empty()
    }

    /// Returns the full known state of the run named `run`, for programs.
    pub(crate) fn to_json(&self, run: &str) -> Value {
        json!({
            "run": run,
            "is_connected": self.link == Link::Connected,
            "learner": self.learner.as_ref().map(|heard| &heard.value),
            "evaluation": self.evaluation.as_ref().map(|heard| &heard.value),
            "blueprints": self.evaluated_blueprints(),
            "actors": self.actors.values().flatten().map(|heard| &heard.value).collect::<Vec<_>>(),
            "alive": &self.roster,
        })
    }

    /// Returns whether metrics from the learner or the evaluator have arrived.
    pub(crate) fn has_summary(&self) -> bool {
        self.learner.is_some() || self.evaluation.is_some()
    }

    fn read(&mut self, suffix: &str, value: &Value, at: Duration) -> Result<bool, Refusal> {
        Ok(match suffix {
            keys::METRICS_LEARNER => {
                let value: LearnerMetrics = parse(value)?;
                let episodes = &value.episodes;
                believe([&episodes.success].into_iter().chain(episodes.success_by_blueprint.values()))?;
                readable_if(value.proposals.as_ref().is_none_or(proposals::are_believable))?;
                let is_news = update(&mut self.learner, value, at);
                if let Some(heard) = self.learner.as_ref().filter(|_| is_news) {
                    self.points.push(&heard.value);
                    self.sizes.add(&heard.value);
                }
                is_news
            }
            keys::METRICS_EVAL_SUMMARY => {
                let value: EvalSummary = parse(value)?;
                for group in value.groups.iter().chain([&value.all]) {
                    believe(rates(&group.sampled).into_iter().chain(rates(&group.greedy)))?;
                }
                let is_news = update(&mut self.evaluation, value, at);
                // The first episodes of an evaluation say little.
                if let Some(heard) = self.evaluation.as_ref().filter(|heard| is_news && heard.value.is_complete) {
                    self.evaluated.extend(success_rate(&heard.value.all.greedy, &heard.value.all.sampled));
                    self.evaluated.drain(..self.evaluated.len().saturating_sub(MAX_EVALUATIONS));
                }
                is_news
            }
            _ if suffix.starts_with("actor/") => {
                let value: ActorMetrics = parse(value)?;
                readable_if(suffix == keys::metrics_actor(&value.actor))?;
                if !self.actors.contains_key(&value.actor) && !self.make_room_for_actor() {
                    return Err(LIMIT);
                }
                update(self.actors.entry(value.actor.clone()).or_default(), value, at)
            }
            _ if suffix.starts_with("eval/") => {
                let value: EvalBlueprint = parse(value)?;
                readable_if(suffix == keys::metrics_eval(value.split, &value.blueprint))?;
                believe(rates(&value.sampled).into_iter().chain(rates(&value.greedy)))?;
                if !self.blueprints.contains_key(&value.blueprint) && self.blueprints.len() >= MAX_BLUEPRINTS {
                    return Err(LIMIT);
                }
                let is_news = self.blueprints.get(&value.blueprint) != Some(&value);
                self.blueprints.insert(value.blueprint.clone(), value);
                is_news
            }
            _ => return Err(KEY),
        })
    }

    /// At the limit, forgets the lost actor with the oldest metrics. Returns whether there is room for another actor.
    fn make_room_for_actor(&mut self) -> bool {
        if self.actors.len() < MAX_ACTORS {
            return true;
        }
        let lost = self.actors.iter().filter(|(id, _)| !self.is_alive(id));
        let oldest = lost.min_by_key(|(_, metrics)| metrics.as_ref().map(|heard| heard.at)).map(|(id, _)| id.clone());
        oldest.is_some_and(|id| self.actors.remove(&id).is_some())
    }
}

/// Returns the success rate with greedy actions, or with sampled ones if no greedy episodes were run, 0 to 1; `None`
/// without episodes.
pub fn success_rate(greedy: &EvalOutcome, sampled: &EvalOutcome) -> Option<f64> {
    let rates = [&greedy.success, &sampled.success];
    rates.into_iter().find(|success| success.n_episodes > 0).map(|success| success.rate)
}

/// Says in words that a learner waits, since when, and why.
pub fn waits(not_saved: &NotSaved) -> String {
    let NotSaved { since_unix_ms, reason } = not_saved;
    // The time comes from the bus, and may be beyond all dates.
    let seconds = i64::try_from(since_unix_ms / 1000).unwrap_or(i64::MAX);
    let since = OffsetDateTime::from_unix_timestamp(seconds).map_or_else(
        |_| "an unknown time".to_owned(),
        |since| format!("{} {:02}:{:02} UTC", since.date(), since.hour(), since.minute()),
    );
    format!("training waits: not saved since {since}: {reason}")
}

/// Stores `value` unless it equals the current value, which then keeps its time. Returns whether the value changed.
fn update<T: PartialEq>(slot: &mut Option<Newest<T>>, value: T, at: Duration) -> bool {
    let is_news = slot.as_ref().is_none_or(|heard| heard.value != value);
    if is_news {
        *slot = Some(Newest { value, at });
    }
    is_news
}

fn parse<T: DeserializeOwned>(value: &Value) -> Result<T, Refusal> {
    if value.get("schema_version").and_then(Value::as_u64) != Some(METRICS_SCHEMA_VERSION.into()) {
        return Err(SCHEMA);
    }
    T::deserialize(value).map_err(|_| UNREADABLE)
}

/// Refuses content as unreadable unless this holds.
fn readable_if(holds: bool) -> Result<(), Refusal> {
    if holds { Ok(()) } else { Err(UNREADABLE) }
}

fn rates(outcome: &EvalOutcome) -> [&SuccessRate; 2] {
    [&outcome.success, &outcome.stable_success]
}

/// Rejects rates that no counts can produce.
fn believe<'a>(rates: impl IntoIterator<Item = &'a SuccessRate>) -> Result<(), Refusal> {
    let is_share = |share: f64| (0.0..=1.0).contains(&share);
    readable_if(rates.into_iter().all(|success| {
        success.n_successes <= success.n_episodes
            && [success.rate, success.wilson_low, success.wilson_high].into_iter().all(is_share)
    }))
}

/// Returns the counters of a struct by field name. Going through serde includes fields that are added later.
pub(crate) fn counters(counters: &impl Serialize) -> Vec<(String, u64)> {
    let Ok(Value::Object(fields)) = serde_json::to_value(counters) else { return Vec::new() };
    fields.into_iter().filter_map(|(name, n)| Some((name, n.as_u64()?))).collect()
}

#[cfg(test)]
mod tests;
