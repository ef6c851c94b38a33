//! The expert as an agent for many worlds.

use std::convert::Infallible;

use blueprints::Blueprint;
use proto::{Action, ActionMode, Agent, Decision, Observation};
use rand::rngs::ChaCha8Rng;

use super::Expert;
use crate::config::EnvironmentConfig;

/// An [`Expert`] for each world, recreated when the blueprint changes. It idles if there is no assembly order.
#[derive(Clone, Debug)]
pub struct ExpertAgent {
    config: EnvironmentConfig,
    /// The last blueprint of each world, and its expert if there is an assembly order.
    rows: Vec<Option<(Blueprint, Option<Expert>)>>,
}

impl ExpertAgent {
    /// Creates an agent for worlds of this configuration.
    pub fn new(config: &EnvironmentConfig) -> Self {
        Self { config: config.clone(), rows: Vec::new() }
    }
}

impl Agent for ExpertAgent {
    type Error = Infallible;

    fn act(
        &mut self,
        observations: &[Observation<'_>],
        _: &[ActionMode],
        _: &mut [ChaCha8Rng],
    ) -> Result<Vec<Decision>, Infallible> {
        self.rows.resize(observations.len(), None);
        let decide = |(row, seen): (&mut Option<(Blueprint, Option<Expert>)>, &Observation<'_>)| {
            row.take_if(|(blueprint, _)| *blueprint != *seen.blueprint);
            let expert = || Expert::new(&self.config, seen.blueprint).ok();
            let (_, expert) = row.get_or_insert_with(|| (seen.blueprint.clone(), expert()));
            let action = expert.as_mut().map_or(Action::IDLE, |expert| expert.act(seen.scene));
            Decision { action, proposals: [None; 2], log_prob: 0.0, value: 0.0 }
        };
        Ok(self.rows.iter_mut().zip(observations).map(decide).collect())
    }
}
