//! Settings of an actor process.

use proto::InvalidSetting;
use serde::{Deserialize, Serialize};

use crate::{DaggerConfig, TaskConfig};

/// How many worlds an actor steps, how it cuts episodes, and how it deals with a slow or absent learner.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ActorConfig {
    /// Threads that step worlds, 1 to 64. Default 1.
    pub n_threads: usize,
    /// Worlds per thread; each step is one forward pass over all of them. 1 to 1024. Default 32.
    pub n_worlds: usize,
    /// Steps after which an episode's segment is cut and sent, 1 to 1000. Default 32.
    pub segment_len: usize,
    /// Which tasks are rolled out and how their episodes begin.
    pub tasks: TaskConfig,
    /// Steps before an episode is learned from.
    pub burn_in: BurnInConfig,
    /// The expert, who labels every scene and acts in some episodes; absent means none. Default: absent.
    pub dagger: Option<DaggerConfig>,
    /// Segments that may wait for the learner's answer at once, 1 to 16. Default 2.
    pub n_outstanding: usize,
    /// Segments kept while the learner does not take them, 1 to 100 000. Default 512.
    pub backlog_limit: usize,
    /// What happens when the backlog is full. Default: drop the oldest.
    pub full_backlog: FullBacklog,
    /// Time between two publications of the actor's metrics in milliseconds, 50 to 3 600 000. Default 2000.
    pub metrics_period_ms: u64,
    /// Longest time that shutting down waits for the backlog to be sent, in milliseconds, at most 60 000. Default 2000.
    pub drain_timeout_ms: u64,
}

/// Episodes whose first steps are acted by the policy's mode and not learned from (an extension).
///
/// Noise carries a sampled policy out of states in which its mode would stay for ever, so it hardly meets them; learning
/// from there on teaches the mode to leave them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BurnInConfig {
    /// Share of the episodes, 0 to 1. Default 0.
    pub probability: f64,
    /// Longest burn-in in steps, 1 to 1000; the length is uniform from 1. Default 60.
    pub max_steps: u16,
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

impl Default for ActorConfig {
    fn default() -> Self {
        Self {
            n_threads: 1,
            n_worlds: 32,
            segment_len: 32,
            tasks: TaskConfig::default(),
            burn_in: BurnInConfig::default(),
            dagger: None,
            n_outstanding: 2,
            backlog_limit: 512,
            full_backlog: FullBacklog::DropOldest,
            metrics_period_ms: 2000,
            drain_timeout_ms: 2000,
        }
    }
}

impl Default for BurnInConfig {
    fn default() -> Self {
        Self { probability: 0.0, max_steps: 60 }
    }
}

impl ActorConfig {
    /// Checks every field against its documented range.
    ///
    /// # Errors
    /// Names the first field that is out of range.
    pub fn validate(&self) -> Result<(), InvalidSetting> {
        check("n_threads", self.n_threads, (1..=64).contains(&self.n_threads), "1..=64")?;
        check("n_worlds", self.n_worlds, (1..=1024).contains(&self.n_worlds), "1..=1024")?;
        check("segment_len", self.segment_len, (1..=1000).contains(&self.segment_len), "1..=1000")?;
        let BurnInConfig { probability, max_steps } = self.burn_in;
        check("burn_in.probability", probability, (0.0..=1.0).contains(&probability), "0..=1")?;
        check("burn_in.max_steps", max_steps, (1..=1000).contains(&max_steps), "1..=1000")?;
        check("n_outstanding", self.n_outstanding, (1..=16).contains(&self.n_outstanding), "1..=16")?;
        check("backlog_limit", self.backlog_limit, (1..=100_000).contains(&self.backlog_limit), "1..=100000")?;
        let metrics = self.metrics_period_ms;
        check("metrics_period_ms", metrics, (50..=3_600_000).contains(&metrics), "50..=3600000")?;
        check("drain_timeout_ms", self.drain_timeout_ms, self.drain_timeout_ms <= 60_000, "0..=60000")?;
        self.dagger.as_ref().map_or(Ok(()), DaggerConfig::validate)?;
        self.tasks.validate()
    }
}

/// `Err` with the field's name, value and valid range unless `ok`.
pub(crate) fn check(
    field: &'static str,
    value: impl std::fmt::Debug,
    ok: bool,
    expected: &'static str,
) -> Result<(), InvalidSetting> {
    InvalidSetting::check(format_args!("actor.{field}"), format_args!("{value:?}"), ok, expected)
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
