//! Liveliness tokens: which processes are alive.

use std::collections::BTreeSet;
use std::time::{Duration, Instant};

use tokio::sync::watch;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Subscriber;
use zenoh::sample::SampleKind;

use super::{Bus, BusError};
use proto::keys::{self, Role};

/// Maximum number of names followed per role; more than a router has sessions.
const MAX_NAMES: usize = 16_384;

/// Interval between checks of whether a name is still alive.
const LOOK_PERIOD: Duration = Duration::from_millis(250);

/// Timeout of one check.
const LOOK_TIMEOUT: Duration = Duration::from_secs(5);

/// Declares a process alive until the token is dropped, the session closes, or the process ends.
#[derive(Debug)]
pub struct AliveToken {
    _token: LivelinessToken,
    _open: Bus,
}

/// Follows the live processes of a role.
#[derive(Debug)]
pub struct AliveWatch {
    names: watch::Receiver<BTreeSet<String>>,
    _subscriber: Subscriber<()>,
    _open: Bus,
}

impl Bus {
    /// Declares that the process `id` (1 to 64 characters of `a-z`, `0-9`, `-`) is alive in `role`.
    ///
    /// # Errors
    /// If the name breaks the rule or the session is closed.
    pub async fn declare_alive(&self, role: Role, id: &str) -> Result<AliveToken, BusError> {
        if !keys::is_valid_run(id) {
            return Err(BusError::Name(id.to_owned()));
        }
        let declared = self.session.liveliness().declare_token(keys::live(role, id)).await;
        let token = declared.map_err(BusError::during(format!("declaring {}", keys::live(role, id))))?;
        Ok(AliveToken { _token: token, _open: self.clone() })
    }

    /// Like [`Self::declare_alive`], but first waits until no other process has the name. A killed process still
    /// appears alive for up to 6 s, so this waits for up to `patience`. Two processes that start at the same moment may
    /// both succeed; of two actors, the learner then accepts one.
    ///
    /// # Errors
    /// [`BusError::NameTaken`] if the other process stays, and the errors of [`Self::declare_alive`].
    pub async fn declare_alive_alone(&self, role: Role, id: &str, patience: Duration) -> Result<AliveToken, BusError> {
        let deadline = Instant::now() + patience;
        let mut has_warned = false;
        // Under load, a router was seen to answer without a token that it had, so a free name is checked twice.
        while self.is_alive(role, id).await? || self.is_alive(role, id).await? {
            if Instant::now() >= deadline {
                let advice = match role {
                    Role::Learner => "there can be one only: end it, or choose another --run",
                    _ => "choose another --id",
                };
                return Err(BusError::NameTaken { role: role.as_str(), name: id.to_owned(), advice });
            }
            if !std::mem::replace(&mut has_warned, true) {
                tracing::warn!(
                    role = role.as_str(),
                    id,
                    ?patience,
                    "the name is in use; waiting for the other process to end"
                );
            }
            tokio::time::sleep(LOOK_PERIOD).await;
        }
        self.declare_alive(role, id).await
    }

    /// Returns whether a process with this name is alive.
    async fn is_alive(&self, role: Role, id: &str) -> Result<bool, BusError> {
        if !keys::is_valid_run(id) {
            return Err(BusError::Name(id.to_owned()));
        }
        let key = keys::live(role, id);
        let asked = self.session.liveliness().get(&key).timeout(LOOK_TIMEOUT).await;
        let replies = asked.map_err(BusError::during(format!("looking for {key}")))?;
        // Every process that answers has the token; zenoh's error replies mean a timeout.
        while let Ok(reply) = replies.recv_async().await {
            if reply.result().is_ok() {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Follows the live processes of `role`, including those that were alive before.
    ///
    /// # Errors
    /// If the session is closed.
    pub async fn alive(&self, role: Role) -> Result<AliveWatch, BusError> {
        let (sender, names) = watch::channel(BTreeSet::new());
        let prefix = keys::live(role, "");
        let counts = self.counts.clone();
        let subscriber = self
            .session
            .liveliness()
            .declare_subscriber(keys::live_all(role))
            .history(true)
            .callback(move |sample| {
                let is_put = sample.kind() == SampleKind::Put;
                let has_room = !is_put || sender.borrow().len() < MAX_NAMES;
                let name = sample.key_expr().as_str().strip_prefix(&prefix);
                let Some(name) = name.filter(|name| has_room && keys::is_valid_run(name)) else {
                    counts.lock().tokens_invalid_total += 1;
                    return;
                };
                sender
                    .send_if_modified(|names| if is_put { names.insert(name.to_owned()) } else { names.remove(name) });
            })
            .await
            .map_err(BusError::during(format!("watching {}", keys::live_all(role))))?;
        Ok(AliveWatch { names, _subscriber: subscriber, _open: self.clone() })
    }
}

impl AliveWatch {
    /// Returns a receiver of the live names and of every change.
    pub fn watch(&self) -> watch::Receiver<BTreeSet<String>> {
        self.names.clone()
    }
}
