//! Episodes that the web page requests, run in this process.

use std::sync::Arc;

use dashboard::{Builder, Order, Stage, StageError};
use evaluator::{EnvironmentConfig, EvalError, Performance, Performer, PolicyConfig, perform};
use learner::{Model, read_model};
use proto::{Valid, Weights};
use runlog::RunPaths;
use tokio::sync::watch;

/// Runs episodes in worlds with this configuration; a policy acts with the newest of `weights`, or a snapshot of `run`.
pub(super) fn stage(
    environment: Valid<EnvironmentConfig>,
    policy: Valid<PolicyConfig>,
    weights: watch::Receiver<Option<Arc<Weights>>>,
    run: Option<RunPaths>,
) -> Stage {
    Stage::new(run.clone(), move |order: &Order, keep_going| {
        let &Order { ref blueprint, ref before, builder, acting, seed, snapshot, ref disturbances } = order;
        let snapshot = snapshot.filter(|_| builder == Builder::Policy).map(|n_env_steps| {
            let path = run.as_ref().and_then(|run| run.snapshots().remove(&n_env_steps));
            let model = read_model(&path.ok_or(StageError::NoSnapshot(n_env_steps))?);
            model.map_err(|error| StageError::Failed(error.to_string()))
        });
        let snapshot = snapshot.transpose()?;
        let performance = Performance { environment: &environment, blueprint, before, acting, seed, disturbances };
        let newest = weights.borrow().clone();
        let performer = match (builder, &snapshot, &newest) {
            (Builder::Expert, ..) => Performer::Expert,
            (Builder::Policy, Some(Model { policy, weights, .. }), _) => Performer::Policy(policy, weights),
            (Builder::Policy, None, Some(weights)) => Performer::Policy(&policy, weights),
            (Builder::Policy, None, None) => return Err(StageError::NoWeights),
        };
        let failed = |error: EvalError| match error {
            EvalError::Interrupted => StageError::Unwanted,
            error => StageError::Failed(error.to_string()),
        };
        perform(performance, performer, keep_going).map_err(failed)
    })
}
