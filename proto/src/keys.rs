//! Key expressions, relative to the namespace `lodestone/<run>` of the session.
//!
//! A client without a namespace, such as a monitoring script, prefixes them with [`namespace`] and a slash.

use crate::ActorId;

/// The prefix of all keys of all runs.
pub const ROOT: &str = "lodestone";

/// Key expression of the liveliness tokens of all runs, relative to [`ROOT`].
pub const LIVE_IN_ALL_RUNS: &str = "*/live/**";

/// Returns the prefix of all keys in a run.
pub fn namespace(run: &str) -> String {
    format!("{ROOT}/{run}")
}

/// Returns the key of an actor's trajectories, sent as queries to the learner.
pub fn ingest(actor: &ActorId) -> String {
    format!("ingest/{actor}")
}

/// Key expression of the learner's trajectory queryable.
pub const INGEST_ALL: &str = "ingest/*";

/// The prefix of an ingest key.
pub const INGEST_PREFIX: &str = "ingest/";

/// Returns the key of the copies of an actor's trajectories for viewers.
pub fn trajectories(actor: &ActorId) -> String {
    format!("trajectories/{actor}")
}

/// Key expression of the trajectories of all actors, for viewers.
pub const TRAJECTORIES_ALL: &str = "trajectories/*";

/// The learner's queryable for the newest weights.
pub const WEIGHTS_LATEST: &str = "weights/latest";

/// Key expression on which the learner publishes notices of newer weights; it matches every key of [`weights_version`].
pub const WEIGHTS_VERSION_ALL: &str = "weights/version/*";

/// Returns the key on which the session `session` subscribes to notices of newer weights.
///
/// Each session has its own key, because the time that a zenoh router takes to add subscribers to a key grows with the
/// square of their number; with 3000 on one key, it does not finish.
pub fn weights_version(session: &str) -> String {
    format!("weights/version/{session}")
}

/// The evaluator's queryable for all evaluations.
pub const HISTORY_EVAL: &str = "history/eval";

/// Key suffix of the learner's metrics.
pub const METRICS_LEARNER: &str = "learner";

/// Key suffix of the evaluator's summary.
pub const METRICS_EVAL_SUMMARY: &str = "eval/summary";

/// Returns the key suffix of an actor's metrics.
pub fn metrics_actor(actor: &ActorId) -> String {
    format!("actor/{actor}")
}

/// Returns the key suffix of one blueprint's evaluation.
pub fn metrics_eval(split: blueprints::Split, blueprint: &blueprints::BlueprintId) -> String {
    format!("eval/{split}/{blueprint}")
}

/// Returns the key of the metrics with this suffix; `**` matches all.
pub fn metrics(suffix: &str) -> String {
    format!("metrics/{suffix}")
}

/// A kind of process with a liveliness token.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Role {
    /// Steps worlds.
    Actor,
    /// Trains.
    Learner,
    /// Evaluates.
    Evaluator,
}

impl Role {
    /// Returns the role's name in keys.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Actor => "actor",
            Self::Learner => "learner",
            Self::Evaluator => "evaluator",
        }
    }
}

/// Returns the key of a liveliness token; the id `*` matches all of a role.
pub fn live(role: Role, id: &str) -> String {
    format!("live/{}/{id}", role.as_str())
}
