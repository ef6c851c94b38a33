//! Who is there: liveliness tokens.

use std::collections::BTreeSet;
use std::time::{Duration, Instant};

use tokio::sync::watch;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Subscriber;
use zenoh::sample::SampleKind;

use super::{Bus, BusError};
use proto::keys::{self, Role};

/// Names of a role that are followed; more than a router has sessions.
const MAX_NAMES: usize = 16_384;

/// Pause before it is asked again whether somebody of a name is still there.
const LOOK_PERIOD: Duration = Duration::from_millis(250);

/// Time that the answer may take.
const LOOK_TIMEOUT: Duration = Duration::from_secs(5);

/// Says that a process is alive until it is dropped, the session is closed or the process is gone.
#[derive(Debug)]
pub struct AliveToken {
    _token: LivelinessToken,
    _open: Bus,
}

/// Follows who of a role is alive.
#[derive(Debug)]
pub struct AliveWatch {
    names: watch::Receiver<BTreeSet<String>>,
    _subscriber: Subscriber<()>,
    _open: Bus,
}

impl Bus {
    /// Says from now on that the process `id` (1 to 64 characters of `a-z`, `0-9`, `-`) is alive in `role`.
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

    /// As [`Self::declare_alive`], after nobody else of the name is there any more: a process that was killed seems to be for up
    /// to 6 s, so this waits for up to `patience`. Two that begin at the same moment may both succeed; of actors the
    /// learner then takes one.
    ///
    /// # Errors
    /// [`BusError::NameTaken`] if the other stays, or as for [`Self::declare_alive`].
    pub async fn declare_alive_alone(&self, role: Role, id: &str, patience: Duration) -> Result<AliveToken, BusError> {
        let deadline = Instant::now() + patience;
        let mut told = false;
        while self.is_alive(role, id).await? {
            if Instant::now() >= deadline {
                let advice = match role {
                    Role::Learner => "there can be one only: end it, or choose another --run",
                    _ => "choose another --id",
                };
                return Err(BusError::NameTaken { role: role.as_str(), name: id.to_owned(), advice });
            }
            if !std::mem::replace(&mut told, true) {
                tracing::warn!(role = role.as_str(), id, ?patience, "one of this name is there; waiting for it to go");
            }
            tokio::time::sleep(LOOK_PERIOD).await;
        }
        self.declare_alive(role, id).await
    }

    /// Whether somebody of this name is there.
    async fn is_alive(&self, role: Role, id: &str) -> Result<bool, BusError> {
        if !keys::is_valid_run(id) {
            return Err(BusError::Name(id.to_owned()));
        }
        let key = keys::live(role, id);
        let asked = self.session.liveliness().get(&key).timeout(LOOK_TIMEOUT).await;
        let replies = asked.map_err(BusError::during(format!("looking for {key}")))?;
        // All who answer have the token; zenoh's own errors say that nobody could be asked in time.
        while let Ok(reply) = replies.recv_async().await {
            if reply.result().is_ok() {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Follows who is alive in `role`, those included who were there before.
    ///
    /// # Errors
    /// If the session is closed.
    pub async fn alive(&self, role: Role) -> Result<AliveWatch, BusError> {
        let (sender, names) = watch::channel(BTreeSet::new());
        let prefix = keys::live(role, "");
        let counters = self.counters.clone();
        let subscriber = self
            .session
            .liveliness()
            .declare_subscriber(keys::live_all(role))
            .history(true)
            .callback(move |sample| {
                let name = sample.key_expr().as_str().strip_prefix(&prefix).filter(|name| keys::is_valid_run(name));
                let Some(name) = name else {
                    counters.tokens_invalid.add_one();
                    return;
                };
                let is_put = sample.kind() == SampleKind::Put;
                if is_put && sender.borrow().len() >= MAX_NAMES {
                    counters.tokens_invalid.add_one();
                    return;
                }
                sender
                    .send_if_modified(|names| if is_put { names.insert(name.to_owned()) } else { names.remove(name) });
            })
            .await
            .map_err(BusError::during(format!("watching {}", keys::live_all(role))))?;
        Ok(AliveWatch { names, _subscriber: subscriber, _open: self.clone() })
    }
}

impl AliveWatch {
    /// The names alive now, and every change of them.
    pub fn watch(&self) -> watch::Receiver<BTreeSet<String>> {
        self.names.clone()
    }
}
