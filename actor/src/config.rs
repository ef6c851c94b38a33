//! Settings of an actor process.

use proto::settings;
use serde::{Deserialize, Serialize};

use crate::TaskConfig;

settings! {
    /// How many worlds an actor steps, how it cuts episodes, and how it deals with a slow or absent learner.
    pub struct ActorConfig in "actor" {
        /// Threads that step worlds.
        pub n_threads: usize = 1, in 1..=64;
        /// Worlds per thread; each step is one forward pass over all of them.
        pub n_worlds: usize = 32, in 1..=1024;
        /// Steps after which an episode's segment is cut and sent.
        pub segment_len: usize = 32, in 1..=1000;
        /// Tasks to roll out, and how their episodes begin.
        pub tasks: TaskConfig;
        /// Maximum number of segments kept while the learner does not accept them.
        pub backlog_limit: usize = 512, in 1..=100_000;
        /// What happens when the backlog is full.
        pub full_backlog: FullBacklog = FullBacklog::DropOldest;
    }
}

/// What an actor does when its backlog of unsent segments is full.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FullBacklog {
    /// Keep stepping, drop the oldest segment, and count it. The segments kept are as close to the newest weights as
    /// possible.
    #[default]
    DropOldest,
    /// Stop stepping until there is room. No step is wasted if actor and learner share the same cores.
    Pause,
}
