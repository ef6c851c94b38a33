//! Ownership of actor names: if two live processes share a name, it belongs to the one whose trajectory was taken
//! first.

use parking_lot::Mutex;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use zenoh::pubsub::Subscriber;
use zenoh::sample::SampleKind;

use crate::{Bus, BusError};
use proto::ActorId;
use proto::keys::{self, Role};

/// Maximum number of names followed; more than a router has sessions. Further names are always accepted.
const MAX_NAMES: usize = 16_384;

/// The owners of names, for as long as the name's liveliness token exists.
#[derive(Debug)]
pub(super) struct Names {
    register: Arc<Mutex<Register>>,
    _subscriber: Subscriber<()>,
}

#[derive(Debug, Default)]
struct Register {
    alive: BTreeSet<String>,
    /// Start time of the process that owns each live name.
    owners: BTreeMap<String, u64>,
}

impl Names {
    /// Follows the actors' tokens, including the existing ones.
    pub(super) async fn follow(bus: &Bus) -> Result<Self, BusError> {
        let register: Arc<Mutex<Register>> = Arc::default();
        let prefix = keys::live(Role::Actor, "");
        let shared = register.clone();
        let tokens = bus.session.liveliness().declare_subscriber(keys::live_all(Role::Actor)).history(true);
        let subscriber = tokens
            .callback(move |sample| {
                let name = sample.key_expr().as_str().strip_prefix(&prefix).filter(|name| keys::is_valid_run(name));
                // The watch on live processes counts invalid names.
                let Some(name) = name else { return };
                match sample.kind() {
                    SampleKind::Put => shared.lock().add(name),
                    SampleKind::Delete => shared.lock().remove(name),
                }
            })
            .await
            .map_err(BusError::during("watching the actors' names"))?;
        Ok(Self { register, _subscriber: subscriber })
    }

    /// Returns whether another live process owns the name.
    pub(super) fn is_taken(&self, actor: &ActorId, epoch: u64) -> bool {
        self.register.lock().is_taken(actor, epoch)
    }

    /// Assigns the name to the process if it has no owner.
    pub(super) fn claim(&self, actor: &ActorId, epoch: u64) {
        self.register.lock().claim(actor, epoch);
    }
}

impl Register {
    fn add(&mut self, name: &str) {
        if self.alive.len() < MAX_NAMES {
            self.alive.insert(name.to_owned());
        }
    }

    fn remove(&mut self, name: &str) {
        self.alive.remove(name);
        self.owners.remove(name);
    }

    fn is_taken(&self, actor: &ActorId, epoch: u64) -> bool {
        self.owners.get(actor.as_str()).is_some_and(|&owner| owner != epoch)
    }

    fn claim(&mut self, actor: &ActorId, epoch: u64) {
        if self.alive.contains(actor.as_str()) {
            self.owners.entry(actor.as_str().to_owned()).or_insert(epoch);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn actor(name: &str) -> ActorId {
        name.parse().unwrap()
    }

    #[test]
    fn name_belongs_to_the_first_process_until_its_token_is_removed() {
        let mut register = Register::default();
        register.add("a");
        register.claim(&actor("a"), 1);
        register.claim(&actor("a"), 2);
        assert_eq!([1, 2].map(|epoch| register.is_taken(&actor("a"), epoch)), [false, true]);
        assert!(!register.is_taken(&actor("b"), 2));
        register.remove("a");
        register.add("a");
        assert!(!register.is_taken(&actor("a"), 2));
        register.claim(&actor("a"), 2);
        assert!(register.is_taken(&actor("a"), 1));
    }

    #[test]
    fn name_without_a_token_has_no_owner() {
        let mut register = Register::default();
        register.claim(&actor("a"), 1);
        assert!(!register.is_taken(&actor("a"), 2));
        assert!(register.owners.is_empty());
    }

    #[test]
    fn number_of_names_is_bounded() {
        let mut register = Register::default();
        for i in 0..=MAX_NAMES {
            register.add(&format!("a-{i}"));
            register.claim(&actor(&format!("a-{i}")), 1);
        }
        assert_eq!((register.alive.len(), register.owners.len()), (MAX_NAMES, MAX_NAMES));
    }
}
