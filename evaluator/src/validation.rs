//! Filters out weights that a policy cannot act with.

use std::sync::Arc;

use bus::Bus;
use policy::{Policy, PolicyConfig};
use proto::{Valid, Weights};
use tokio::sync::watch;
use tokio_util::task::AbortOnDropHandle;

/// The newest weights received.
type Arrivals = watch::Receiver<Option<Arc<Weights>>>;

/// Forwards the newest weights with which a policy can act to `usable` while the returned handle lives. Others are
/// dropped and counted by the bus. Weights of another network pass, because waiting does not help: the evaluation then
/// reports the error.
pub(crate) fn validated(
    mut arrivals: Arrivals,
    usable: watch::Sender<Option<Arc<Weights>>>,
    config: Valid<PolicyConfig>,
    bus: Bus,
) -> (Arrivals, AbortOnDropHandle<()>) {
    let validated = usable.subscribe();
    let task = tokio::spawn(async move {
        loop {
            let newest = arrivals.borrow_and_update().clone();
            if let Some(newest) = newest
                && passes(&config, &newest, &bus).await
            {
                usable.send_replace(Some(newest));
            }
            if arrivals.changed().await.is_err() {
                return;
            }
        }
    });
    (validated, AbortOnDropHandle::new(task))
}

async fn passes(config: &Valid<PolicyConfig>, weights: &Arc<Weights>, bus: &Bus) -> bool {
    let (config, tried) = (config.clone(), weights.clone());
    // Off the async runtime, because a forward pass blocks the thread.
    let trial = tokio::task::spawn_blocking(move || Policy::with_weights(&config, &tried));
    let error = match trial.await {
        Ok(Ok(_)) => return true,
        Ok(Err(error)) if !error.is_of_weights() => return true,
        Ok(Err(error)) => error.to_string(),
        Err(panic) => panic.to_string(),
    };
    bus.count_refused_weights();
    tracing::warn!(version = weights.version.0, error, "weights refused, those before them stay in force");
    false
}
