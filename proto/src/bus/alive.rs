//! Who is there: liveliness tokens.

use std::collections::BTreeSet;

use tokio::sync::watch;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Subscriber;
use zenoh::sample::SampleKind;

use super::{Bus, BusError};
use crate::keys::{self, Role};

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
                sender.send_if_modified(|names| match sample.kind() {
                    SampleKind::Put => names.insert(name.to_owned()),
                    SampleKind::Delete => names.remove(name),
                });
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
