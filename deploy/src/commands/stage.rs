//! Episodes that the web page requests, run in this process.

use std::sync::Arc;

use dashboard::{Builder, Order, Stage, StageError};
use evaluator::{EnvironmentConfig, EvalError, Performance, Performer, PolicyConfig, perform};
use proto::{Valid, Weights};
use tokio::sync::watch;

/// Runs episodes in worlds with this configuration; a policy acts with the newest of `weights`.
pub(super) fn stage(
    environment: Valid<EnvironmentConfig>,
    policy: Valid<PolicyConfig>,
    weights: watch::Receiver<Option<Arc<Weights>>>,
) -> Stage {
    Stage::new(move |order: &Order, keep_going| {
        let Order { blueprint, before, builder, acting, seed } = order;
        let performance = Performance { environment: &environment, blueprint, before, acting: *acting, seed: *seed };
        let newest = weights.borrow().clone();
        let performer = match (builder, &newest) {
            (Builder::Expert, _) => Performer::Expert,
            (Builder::Policy, Some(weights)) => Performer::Policy(&policy, weights),
            (Builder::Policy, None) => return Err(StageError::NoWeights),
        };
        let failed = |error: EvalError| match error {
            EvalError::Interrupted => StageError::Unwanted,
            error => StageError::Failed(error.to_string()),
        };
        let episode = perform(performance, performer, keep_going).map_err(failed)?;
        episode.ok_or_else(|| StageError::Failed("it was over before its first step".to_owned()))
    })
}
