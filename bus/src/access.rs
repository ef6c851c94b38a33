//! The access rules of each role on a router with keys.

use serde_json::{Value, json};

use super::security::ROLES;
use proto::codec::{MAX_TRAJECTORY_BYTES, MAX_WEIGHTS_BYTES};

/// Maximum size of metrics and history, in bytes; a history of 400 evaluations of all blueprints has 2 MB.
const MAX_METRICS_BYTES: usize = 8 << 20;

/// Maximum size of a notice, in bytes.
const MAX_NOTICE_BYTES: usize = 4096;

/// The grants of a role: the messages it may send (`sends`) and receive (`gets`), each with the keys after
/// `lodestone/<run>/`.
struct Grants {
    role: &'static str,
    sends: &'static [(&'static str, &'static [&'static str])],
    gets: &'static [(&'static str, &'static [&'static str])],
}

/// The table of grants. A publisher or querier detects its counterpart through declarations that it receives, so these
/// are granted to every role that waits for a learner or sends copies only to present viewers.
const GRANTS: [Grants; 4] = [
    Grants {
        role: "learner",
        sends: &[
            ("declare_queryable", &["ingest/*", "weights/latest", "metrics/learner"]),
            ("reply", &["ingest/*", "weights/latest", "metrics/learner"]),
            ("put", &["weights/version/*", "metrics/learner"]),
            ("liveliness_token", &["live/learner/*"]),
            ("declare_liveliness_subscriber", &["live/actor/*"]),
            ("liveliness_query", &["live/actor/*", "live/learner/*"]),
        ],
        gets: &[
            ("query", &["ingest/*", "weights/latest", "metrics/**"]),
            ("declare_subscriber", &["weights/version/*", "metrics/**"]),
            ("liveliness_token", &["live/actor/*", "live/learner/*"]),
        ],
    },
    Grants {
        role: "actor",
        sends: &[
            ("query", &["ingest/*", "weights/latest"]),
            ("declare_subscriber", &["weights/version/*"]),
            ("put", &["trajectories/*", "metrics/actor/*"]),
            ("declare_queryable", &["metrics/actor/*"]),
            ("reply", &["metrics/actor/*"]),
            ("liveliness_token", &["live/actor/*"]),
            ("liveliness_query", &["live/actor/*"]),
        ],
        gets: &[
            ("reply", &["ingest/*", "weights/latest"]),
            ("put", &["weights/version/*"]),
            ("query", &["metrics/**"]),
            ("declare_queryable", &["ingest/*", "weights/latest"]),
            ("declare_subscriber", &["trajectories/*", "metrics/**"]),
            ("liveliness_token", &["live/actor/*"]),
        ],
    },
    Grants {
        role: "evaluator",
        sends: &[
            ("query", &["weights/latest", "metrics/**"]),
            ("declare_subscriber", &["weights/version/*", "metrics/**", "trajectories/*"]),
            ("put", &["metrics/eval/**"]),
            ("declare_queryable", &["metrics/eval/**", "history/eval"]),
            ("reply", &["metrics/eval/**", "history/eval"]),
            ("liveliness_token", &["live/evaluator/*"]),
            ("declare_liveliness_subscriber", &["live/**"]),
            ("liveliness_query", &["live/**"]),
        ],
        gets: &[
            ("reply", &["weights/latest", "metrics/**"]),
            ("put", &["weights/version/*", "metrics/**", "trajectories/*"]),
            ("query", &["metrics/**", "history/eval"]),
            ("declare_queryable", &["weights/latest"]),
            ("declare_subscriber", &["metrics/**"]),
            ("liveliness_token", &["live/**"]),
        ],
    },
    Grants {
        role: "viewer",
        sends: &[
            ("query", &["metrics/**", "history/eval"]),
            ("declare_subscriber", &["metrics/**"]),
            ("declare_liveliness_subscriber", &["live/**"]),
            ("liveliness_query", &["live/**"]),
        ],
        gets: &[
            ("reply", &["metrics/**", "history/eval"]),
            ("put", &["metrics/**"]),
            ("liveliness_token", &["live/**"]),
        ],
    },
];

/// Zenoh's `access_control`: default-deny, by user name, which the gate has compared with the certificate.
pub(super) fn rules() -> Value {
    let mut rules = Vec::new();
    let mut policies = Vec::new();
    for grants in &GRANTS {
        let mut ids = Vec::new();
        for (flow, granted) in [("ingress", grants.sends), ("egress", grants.gets)] {
            for (message, keys) in granted {
                let id = format!("{}-{flow}-{message}", grants.role);
                // `*` for the run: a router serves all runs that share its keys.
                let keys: Vec<String> = keys.iter().map(|key| format!("lodestone/*/{key}")).collect();
                let rule = json!({ "id": id, "messages": [message], "flows": [flow], "permission": "allow", "key_exprs": keys });
                rules.push(rule);
                ids.push(id);
            }
        }
        policies.push(json!({ "rules": ids, "subjects": [grants.role] }));
    }
    // Routers forward messages that were allowed elsewhere; these were checked where they entered.
    rules.push(json!({
        "id": "router-all", "flows": ["ingress", "egress"], "permission": "allow", "key_exprs": ["lodestone/**"],
        "messages": [
            "put", "delete", "declare_subscriber", "query", "declare_queryable", "reply",
            "liveliness_token", "declare_liveliness_subscriber", "liveliness_query",
        ],
    }));
    policies.push(json!({ "rules": ["router-all"], "subjects": ["router"] }));
    let subjects: Vec<Value> = ROLES.iter().map(|role| json!({ "id": role, "usernames": [role] })).collect();
    json!({ "enabled": true, "default_permission": "deny", "rules": rules, "subjects": subjects, "policies": policies })
}

/// Zenoh's `low_pass_filter`: a router forwards no message larger than its receivers accept.
pub(super) fn size_limits() -> Value {
    let limit = |id: &str, messages: &[&str], keys: &[&str], bytes: usize| {
        let keys: Vec<String> = keys.iter().map(|key| format!("lodestone/*/{key}")).collect();
        json!({ "id": id, "messages": messages, "flows": ["ingress"], "key_exprs": keys, "size_limit": bytes })
    };
    json!([
        limit("trajectories", &["query", "put"], &["ingest/*", "trajectories/*"], MAX_TRAJECTORY_BYTES),
        limit("weights", &["reply"], &["weights/latest"], MAX_WEIGHTS_BYTES),
        limit("notices", &["put"], &["weights/version/*"], MAX_NOTICE_BYTES),
        limit("questions", &["query"], &["weights/latest", "metrics/**", "history/eval"], MAX_NOTICE_BYTES),
        limit("metrics", &["put", "reply"], &["metrics/**", "history/eval"], MAX_METRICS_BYTES),
    ])
}

/// Most queries for weights, metrics, or the history that a router takes from one connection, per second. It ends others
/// without a reply. An actor asks once for each version of the weights, and no other process asks often; the processes
/// below another router share its connection and come back for what was dropped.
const QUERIES_PER_S: u32 = 200;

/// Most metrics of actors that a router takes from one connection, per second. It drops others. An actor publishes a few
/// in a second, and newer ones replace those that were dropped.
const ACTOR_METRICS_PER_S: u32 = 5000;

/// Zenoh's `downsampling`: limits of each connection. Trajectories have none, because two of an actor may come at the
/// same moment, and zenoh has no limit that lets both through.
pub(super) fn rate_limits() -> Value {
    let limit = |id: &str, message: &str, keys: &[&str], per_s: u32| {
        let rule = |key: &&str| json!({ "key_expr": format!("lodestone/*/{key}"), "freq": per_s });
        let rules: Vec<Value> = keys.iter().map(rule).collect();
        json!({ "id": id, "messages": [message], "flows": ["ingress"], "rules": rules })
    };
    json!([
        limit("queries", "query", &["weights/latest", "metrics/**", "history/eval"], QUERIES_PER_S),
        limit("actor-metrics", "put", &["metrics/actor/*"], ACTOR_METRICS_PER_S),
    ])
}
