//! Key expressions, relative to the namespace `lodestone/<run>` of the session.
//!
//! A client without a namespace, such as a script that only watches, puts [`namespace`] and a slash before them.

use crate::ActorId;

/// Name of a run: 1 to 64 characters of `a-z`, `0-9`, `-`.
pub fn is_valid_run(run: &str) -> bool {
    (1..=64).contains(&run.len()) && run.bytes().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == b'-')
}

/// The prefix of all keys of a run.
pub fn namespace(run: &str) -> String {
    format!("lodestone/{run}")
}

/// Where the actor's trajectories go as queries to the learner.
pub fn ingest(actor: &ActorId) -> String {
    format!("ingest/{actor}")
}

/// What the learner answers.
pub const INGEST_ALL: &str = "ingest/*";

/// The prefix of an ingest key.
pub const INGEST_PREFIX: &str = "ingest/";

/// Where the actor's trajectories are put while somebody watches.
pub fn trajectories(actor: &ActorId) -> String {
    format!("trajectories/{actor}")
}

/// What a viewer of every actor subscribes to.
pub const TRAJECTORIES_ALL: &str = "trajectories/*";

/// The learner's queryable with the newest weights.
pub const WEIGHTS_LATEST: &str = "weights/latest";

/// Where notices of newer weights are put: for everyone who subscribes to a key of [`weights_version`].
pub const WEIGHTS_VERSION_ALL: &str = "weights/version/*";

/// What the session `session` subscribes to for notices of newer weights.
///
/// A key of its own, because the time that a zenoh router takes for one more subscriber to a key grows with the square of
/// their number: with 3000 to the same key it does not get done.
pub fn weights_version(session: &str) -> String {
    format!("weights/version/{session}")
}

/// Where a remote worker of evaluators takes units of work.
pub fn worker(worker: &str) -> String {
    format!("worker/{worker}")
}

/// The evaluator's queryable with all passes.
pub const HISTORY_EVAL: &str = "history/eval";

/// Key suffix of the learner's metrics.
pub const METRICS_LEARNER: &str = "learner";

/// Key suffix of the evaluator's summary.
pub const METRICS_EVAL_SUMMARY: &str = "eval/summary";

/// Key suffix of an actor's metrics.
pub fn metrics_actor(actor: &ActorId) -> String {
    format!("actor/{actor}")
}

/// Key suffix of the evaluation of one blueprint.
pub fn metrics_eval(split: blueprints::Split, blueprint: &blueprints::BlueprintId) -> String {
    format!("eval/{split}/{blueprint}")
}

/// Key of metrics with this suffix; `**` for all.
pub fn metrics(suffix: &str) -> String {
    format!("metrics/{suffix}")
}

/// A part of the system that says it is alive.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Role {
    /// Steps worlds.
    Actor,
    /// Trains.
    Learner,
    /// Judges.
    Evaluator,
    /// Runs episodes for evaluators.
    Worker,
}

impl Role {
    /// The role as it stands in keys.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Actor => "actor",
            Self::Learner => "learner",
            Self::Evaluator => "evaluator",
            Self::Worker => "worker",
        }
    }
}

/// Key of a liveliness token.
pub fn live(role: Role, id: &str) -> String {
    format!("live/{}/{id}", role.as_str())
}

/// All liveliness tokens of a role.
pub fn live_all(role: Role) -> String {
    live(role, "*")
}
