//! Lists the runs on a router.

use std::collections::BTreeSet;
use std::time::Duration;

use super::{Bus, BusConfig, BusError};
use proto::{Valid, keys};

/// Maximum number of names returned.
const MAX_RUNS: usize = 100;

/// Timeout of the query.
const ASK_TIMEOUT: Duration = Duration::from_secs(3);

/// Returns the names of all runs with a live process, except that of `config`; at most the first hundred that answer.
///
/// This opens a separate session, because the sessions of a run see no other run.
///
/// # Errors
/// Those of [`Bus::open`], or if the session fails.
pub async fn runs(config: &Valid<BusConfig>) -> Result<BTreeSet<String>, BusError> {
    let bus = Bus::open_within(keys::ROOT, config).await?;
    let names = ask(&bus).await;
    bus.close().await;
    names.map(|names| names.into_iter().filter(|name| *name != config.run).collect())
}

async fn ask(bus: &Bus) -> Result<BTreeSet<String>, BusError> {
    let asked = bus.session.liveliness().get(keys::LIVE_IN_ALL_RUNS).timeout(ASK_TIMEOUT).await;
    let replies = asked.map_err(BusError::during("looking for runs"))?;
    let mut names = BTreeSet::new();
    while let Ok(reply) = replies.recv_async().await {
        let name = reply.result().ok().and_then(|sample| sample.key_expr().as_str().split('/').next());
        // Any process may have declared the key.
        names.extend(name.filter(|name| keys::is_valid_run(name) && names.len() < MAX_RUNS).map(str::to_owned));
    }
    Ok(names)
}
