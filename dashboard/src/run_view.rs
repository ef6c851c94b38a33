//! What is known of a run: the newest metrics of each part, and who is alive. Page and terminal both show it.

mod trends;

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use blueprints::BlueprintId;
use bus::MetricsSample;
use proto::metrics::{
    ActorMetrics, BusCounts, EvalBlueprint, EvalOutcome, EvalSummary, LearnerMetrics, METRICS_SCHEMA_VERSION,
};
use proto::wilson::SuccessRate;
use proto::{ActorId, WeightsVersion, keys};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};

pub(crate) use trends::Trends;

/// Actors that are remembered, the lost ones included; whoever invents names must not fill the memory.
pub(crate) const MAX_ACTORS: usize = 10_000;

/// Blueprints that are remembered.
pub(crate) const MAX_BLUEPRINTS: usize = 10_000;

/// A run as its messages tell it. It reads no clock: times are given by the caller, as the time since the watch began.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct RunView {
    link: Link,
    link_since: Duration,
    learner: Option<Newest<LearnerMetrics>>,
    evaluation: Option<Newest<EvalSummary>>,
    blueprints: BTreeMap<BlueprintId, EvalBlueprint>,
    actors: BTreeMap<ActorId, Actor>,
    roster: Roster,
    unread: Unread,
    bus: BusCounts,
    trends: Trends,
    others: BTreeSet<String>,
}

/// How the watch stands to the bus.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Link {
    /// No router was reached so far.
    #[default]
    Joining,
    /// The others are reached.
    Connected,
    /// They were reached once, and are not now, for lack of a router.
    Lost,
}

/// A value and when it came.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Newest<T> {
    /// What was said.
    pub(crate) value: T,
    /// When it came, time since the watch began.
    pub(crate) at: Duration,
}

/// One actor of the roster.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Actor {
    /// Whether its liveliness token is there; once known and not alive is lost.
    pub(crate) is_alive: bool,
    /// Its newest metrics.
    pub(crate) metrics: Option<Newest<ActorMetrics>>,
}

/// Metrics that came and are not shown, by reason. What was not even JSON is counted by the bus.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub(crate) struct Unread {
    /// Of another schema version, or without any.
    pub(crate) schema_unknown_total: u64,
    /// Not what their key promises.
    pub(crate) metrics_unreadable_total: u64,
    /// Under a key that this version does not know.
    pub(crate) keys_unknown_total: u64,
    /// Of one more actor or blueprint than are remembered.
    pub(crate) over_limit_total: u64,
}

/// Who is alive, by the names of the liveliness tokens.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub(crate) struct Roster {
    /// Names of the actors.
    pub(crate) actors: BTreeSet<String>,
    /// Names of the learners.
    pub(crate) learners: BTreeSet<String>,
    /// Names of the evaluators.
    pub(crate) evaluators: BTreeSet<String>,
}

/// What the watch's own session knows at some time.
#[derive(Clone, Debug, Default)]
pub(crate) struct SessionState {
    /// Whether it reaches the others.
    pub(crate) is_connected: bool,
    /// Who is alive, if it does.
    pub(crate) roster: Roster,
    /// What it dropped so far.
    pub(crate) counts: BusCounts,
}

/// Why a sample is not shown.
enum Refusal {
    Schema,
    Unreadable,
    Key,
    Limit,
}

impl RunView {
    /// Takes one sample of metrics; what cannot be shown is counted and changes nothing else. Returns whether it is news:
    /// shown now, and not as it was before.
    pub(crate) fn take(&mut self, sample: &MetricsSample, now: Duration) -> bool {
        let refusal = match self.read(&sample.suffix, &sample.value, now) {
            Ok(is_news) => return is_news,
            Err(refusal) => refusal,
        };
        let unread = &mut self.unread;
        let count = match refusal {
            Refusal::Schema => &mut unread.schema_unknown_total,
            Refusal::Unreadable => &mut unread.metrics_unreadable_total,
            Refusal::Key => &mut unread.keys_unknown_total,
            Refusal::Limit => &mut unread.over_limit_total,
        };
        *count = count.saturating_add(1);
        false
    }

    /// Takes what the session knows now. Returns whether that changed anything.
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
        // All tokens vanish with the router; that says nothing about who is alive.
        if session.is_connected {
            has_changed |= self.set_roster(&session.roster);
        }
        has_changed
    }

    fn set_roster(&mut self, roster: &Roster) -> bool {
        let mut has_changed = self.roster != *roster;
        self.roster.clone_from(roster);
        for (id, actor) in &mut self.actors {
            let is_alive = roster.actors.contains(id.as_str());
            has_changed |= actor.is_alive != is_alive;
            actor.is_alive = is_alive;
        }
        for id in roster.actors.iter().filter_map(|name| ActorId::try_from(name.clone()).ok()) {
            if !self.actors.contains_key(&id) && self.make_room_for_actor() {
                self.actors.insert(id, Actor { is_alive: true, metrics: None });
                has_changed = true;
            }
        }
        has_changed
    }

    /// How the watch stands to the bus, and since when.
    pub(crate) fn link(&self) -> (Link, Duration) {
        (self.link, self.link_since)
    }

    /// The learner's newest metrics.
    pub(crate) fn learner(&self) -> Option<&Newest<LearnerMetrics>> {
        self.learner.as_ref()
    }

    /// The newest evaluation.
    pub(crate) fn evaluation(&self) -> Option<&Newest<EvalSummary>> {
        self.evaluation.as_ref()
    }

    /// The newest result of each blueprint with the weights of the newest evaluation; without an evaluation, with the
    /// newest weights that any blueprint was judged with.
    pub(crate) fn judged_blueprints(&self) -> Vec<&EvalBlueprint> {
        let newest = || self.blueprints.values().map(|blueprint| blueprint.weights_version).max();
        let version: Option<WeightsVersion> =
            self.evaluation.as_ref().map(|summary| summary.value.weights_version).or_else(newest);
        self.blueprints.values().filter(|blueprint| Some(blueprint.weights_version) == version).collect()
    }

    /// All actors that were seen, by name.
    pub(crate) fn actors(&self) -> &BTreeMap<ActorId, Actor> {
        &self.actors
    }

    /// Who is alive; while the link is lost, who was.
    pub(crate) fn roster(&self) -> &Roster {
        &self.roster
    }

    /// What came and is not shown.
    pub(crate) fn unread(&self) -> Unread {
        self.unread
    }

    /// What the watch's own session dropped.
    pub(crate) fn bus(&self) -> BusCounts {
        self.bus
    }

    /// How numbers went since the watch began.
    pub(crate) fn trends(&self) -> &Trends {
        &self.trends
    }

    /// Takes the names of the other runs on the router.
    pub(crate) fn set_others(&mut self, others: BTreeSet<String>) {
        self.others = others;
    }

    /// The other runs on the router, as far as somebody has looked.
    pub(crate) fn others(&self) -> &BTreeSet<String> {
        &self.others
    }

    /// Whether nobody is there and nothing was said.
    pub(crate) fn is_empty(&self) -> bool {
        let Roster { actors, learners, evaluators } = &self.roster;
        let is_nobody = learners.is_empty() && evaluators.is_empty() && actors.is_empty();
        !self.has_summary() && is_nobody && self.actors.is_empty()
    }

    /// All that is known of the run of this name, for programs.
    pub(crate) fn to_json(&self, run: &str) -> Value {
        json!({
            "run": run,
            "is_connected": self.link == Link::Connected,
            "learner": self.learner.as_ref().map(|heard| &heard.value),
            "evaluation": self.evaluation.as_ref().map(|heard| &heard.value),
            "blueprints": self.judged_blueprints(),
            "actors": self.actors.values().filter_map(|actor| actor.metrics.as_ref()).map(|heard| &heard.value).collect::<Vec<_>>(),
            "alive": &self.roster,
        })
    }

    /// Whether the learner or the evaluator has said anything.
    pub(crate) fn has_summary(&self) -> bool {
        self.learner.is_some() || self.evaluation.is_some()
    }

    fn read(&mut self, suffix: &str, value: &Value, at: Duration) -> Result<bool, Refusal> {
        Ok(match suffix {
            keys::METRICS_LEARNER => {
                let value: LearnerMetrics = parse(value)?;
                let episodes = &value.episodes;
                believe([&episodes.success].into_iter().chain(episodes.success_by_blueprint.values()))?;
                let is_news = update(&mut self.learner, value, at);
                if let Some(heard) = self.learner.as_ref().filter(|_| is_news) {
                    self.trends.learned(&heard.value);
                }
                is_news
            }
            keys::METRICS_EVAL_SUMMARY => {
                let value: EvalSummary = parse(value)?;
                for group in value.groups.iter().chain([&value.all]) {
                    believe(rates(&group.sampled).into_iter().chain(rates(&group.mode)))?;
                }
                let is_news = update(&mut self.evaluation, value, at);
                if let Some(heard) = self.evaluation.as_ref().filter(|_| is_news) {
                    self.trends.evaluated(&heard.value);
                }
                is_news
            }
            _ if suffix.starts_with("actor/") => {
                let value: ActorMetrics = parse(value)?;
                is_key(suffix, &keys::metrics_actor(&value.actor))?;
                if !self.actors.contains_key(&value.actor) && !self.make_room_for_actor() {
                    return Err(Refusal::Limit);
                }
                // Alive or not is for the tokens to say; metrics may overtake theirs, and the next roster corrects it.
                let actor = self.actors.entry(value.actor.clone()).or_insert(Actor { is_alive: true, metrics: None });
                update(&mut actor.metrics, value, at)
            }
            _ if suffix.starts_with("eval/") => {
                let value: EvalBlueprint = parse(value)?;
                is_key(suffix, &keys::metrics_eval(value.split, &value.blueprint))?;
                believe(rates(&value.sampled).into_iter().chain(rates(&value.mode)))?;
                if !self.blueprints.contains_key(&value.blueprint) && self.blueprints.len() >= MAX_BLUEPRINTS {
                    return Err(Refusal::Limit);
                }
                let is_news = self.blueprints.get(&value.blueprint) != Some(&value);
                self.blueprints.insert(value.blueprint.clone(), value);
                is_news
            }
            _ => return Err(Refusal::Key),
        })
    }

    /// Forgets the lost actor that was heard longest ago if there are as many as are remembered. Returns whether there
    /// is room.
    fn make_room_for_actor(&mut self) -> bool {
        if self.actors.len() < MAX_ACTORS {
            return true;
        }
        let lost = self.actors.iter().filter(|(_, actor)| !actor.is_alive);
        let oldest =
            lost.min_by_key(|(_, actor)| actor.metrics.as_ref().map(|heard| heard.at)).map(|(id, _)| id.clone());
        oldest.is_some_and(|id| self.actors.remove(&id).is_some())
    }
}

/// Keeps `value`; one that comes a second time stays as old as it is. Returns whether it is another.
fn update<T: PartialEq>(slot: &mut Option<Newest<T>>, value: T, at: Duration) -> bool {
    let is_news = slot.as_ref().is_none_or(|heard| heard.value != value);
    if is_news {
        *slot = Some(Newest { value, at });
    }
    is_news
}

fn parse<T: DeserializeOwned>(value: &Value) -> Result<T, Refusal> {
    if value.get("schema_version").and_then(Value::as_u64) != Some(METRICS_SCHEMA_VERSION.into()) {
        return Err(Refusal::Schema);
    }
    T::deserialize(value).map_err(|_| Refusal::Unreadable)
}

fn is_key(suffix: &str, expected: &str) -> Result<(), Refusal> {
    if suffix == expected { Ok(()) } else { Err(Refusal::Unreadable) }
}

fn rates(outcome: &EvalOutcome) -> [&SuccessRate; 2] {
    [&outcome.success, &outcome.stable_success]
}

/// Refuses rates that no counts can have.
fn believe<'a>(rates: impl IntoIterator<Item = &'a SuccessRate>) -> Result<(), Refusal> {
    let is_share = |share: f64| (0.0..=1.0).contains(&share);
    let are_fine = rates.into_iter().all(|success| {
        success.n_successes <= success.n_episodes
            && [success.rate, success.wilson_low, success.wilson_high].into_iter().all(is_share)
    });
    if are_fine { Ok(()) } else { Err(Refusal::Unreadable) }
}

/// The numbers of a struct of counters under the names of its fields, so that one that is added later is shown too.
pub(crate) fn counters(counters: &impl Serialize) -> Vec<(String, u64)> {
    let Ok(Value::Object(fields)) = serde_json::to_value(counters) else { return Vec::new() };
    fields.into_iter().filter_map(|(name, n)| Some((name, n.as_u64()?))).collect()
}

#[cfg(test)]
mod tests;
