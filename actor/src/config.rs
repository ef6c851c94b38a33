//! Settings of an actor process.

use proto::settings;
use serde::{Deserialize, Serialize};

use crate::{DaggerConfig, TaskConfig};

settings! {
    /// How many worlds an actor steps, how it cuts episodes, and how it deals with a slow or absent learner.
    pub struct ActorConfig in "actor" {
        /// Threads that step worlds.
        pub n_threads: usize = 1, in 1..=64;
        /// Worlds per thread; each step is one forward pass over all of them.
        pub n_worlds: usize = 32, in 1..=1024;
        /// Steps after which an episode's segment is cut and sent.
        pub segment_len: usize = 32, in 1..=1000;
        /// Which tasks are rolled out and how their episodes begin.
        pub tasks: TaskConfig;
        /// Steps before an episode is learned from.
        pub burn_in: BurnInConfig;
        /// The expert, who labels every scene and acts in some episodes; absent, as by default, means none.
        pub dagger: Option<DaggerConfig>;
        /// Segments that may wait for the learner's answer at once.
        pub n_outstanding: usize = 2, in 1..=16;
        /// Segments kept while the learner does not take them.
        pub backlog_limit: usize = 512, in 1..=100_000;
        /// What happens when the backlog is full.
        pub full_backlog: FullBacklog = FullBacklog::DropOldest;
        /// Time between two publications of the actor's metrics in milliseconds.
        pub metrics_period_ms: u64 = 2000, in 50..=3_600_000;
        /// Longest time that shutting down waits for the backlog to be sent, in milliseconds.
        pub drain_timeout_ms: u64 = 2000, in 0..=60_000;
    }

    /// Episodes whose first steps are acted by the policy's mode and not learned from (an extension).
    ///
    /// Noise carries a sampled policy out of states in which its mode would stay forever, so it hardly meets them;
    /// learning from there on teaches the mode to leave them.
    #[derive(Copy)]
    pub struct BurnInConfig {
        /// Share of the episodes.
        pub probability: f64 = 0.0, in 0.0..=1.0;
        /// Longest burn-in in steps; the length is uniform from 1.
        pub max_steps: u16 = 60, in 1..=1000;
    }
}

/// What an actor does when its backlog of unsent segments is full.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FullBacklog {
    /// Step on, drop the oldest segment and count it: what is kept is as near to the newest weights as can be.
    #[default]
    DropOldest,
    /// Stop stepping until there is room: no step is wasted where actor and learner share the same cores.
    Pause,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_valid() {
        assert_eq!(ActorConfig::default().validate(), Ok(()));
    }

    #[test]
    fn an_error_names_field_value_and_range() {
        let table: [(ActorConfig, &str); 5] = [
            (ActorConfig { n_threads: 0, ..Default::default() }, "actor.n_threads = 0: expected 1..=64"),
            (ActorConfig { n_worlds: 2000, ..Default::default() }, "actor.n_worlds = 2000: expected 1..=1024"),
            (ActorConfig { segment_len: 0, ..Default::default() }, "actor.segment_len = 0: expected 1..=1000"),
            (ActorConfig { n_outstanding: 17, ..Default::default() }, "actor.n_outstanding = 17: expected 1..=16"),
            (ActorConfig { backlog_limit: 0, ..Default::default() }, "actor.backlog_limit = 0: expected 1..=100000"),
        ];
        for (config, message) in table {
            assert_eq!(config.validate().unwrap_err().to_string(), message);
        }
    }
}
