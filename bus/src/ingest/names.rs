//! Which process a name belongs to: of two live ones that call themselves alike, the one whose trajectory was taken first.

use parking_lot::{Mutex, MutexGuard};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use zenoh::pubsub::Subscriber;
use zenoh::sample::SampleKind;

use crate::{Bus, BusError};
use proto::ActorId;
use proto::keys::{self, Role};

/// Names that are followed; more than a router has sessions. Those beyond are nobody's, so whoever has one is taken.
const MAX_NAMES: usize = 16_384;

/// Who has which name, for as long as the name's liveliness token stands.
#[derive(Debug)]
pub(super) struct Names {
    register: Arc<Mutex<Register>>,
    _subscriber: Subscriber<()>,
}

#[derive(Debug, Default)]
struct Register {
    alive: BTreeSet<String>,
    /// Start time of the process that has the name; only names that are alive.
    owners: BTreeMap<String, u64>,
}

impl Names {
    /// Follows the actors' tokens from now on, those included that are there.
    pub(super) async fn follow(bus: &Bus) -> Result<Self, BusError> {
        let register: Arc<Mutex<Register>> = Arc::default();
        let (prefix, shared) = (keys::live(Role::Actor, ""), register.clone());
        let tokens = bus.session.liveliness().declare_subscriber(keys::live_all(Role::Actor)).history(true);
        let subscriber = tokens
            .callback(move |sample| {
                let name = sample.key_expr().as_str().strip_prefix(&prefix).filter(|name| keys::is_valid_run(name));
                // Who follows the living counts what is no name.
                let Some(name) = name else { return };
                match sample.kind() {
                    SampleKind::Put => lock(&shared).appear(name),
                    SampleKind::Delete => lock(&shared).vanish(name),
                }
            })
            .await
            .map_err(BusError::during("watching the actors' names"))?;
        Ok(Self { register, _subscriber: subscriber })
    }

    /// Whether another live process has the name.
    pub(super) fn is_taken(&self, actor: &ActorId, epoch: u64) -> bool {
        lock(&self.register).is_taken(actor, epoch)
    }

    /// The process has the name from now on, if nobody has it.
    pub(super) fn claim(&self, actor: &ActorId, epoch: u64) {
        lock(&self.register).claim(actor, epoch);
    }
}

impl Register {
    fn appear(&mut self, name: &str) {
        if self.alive.len() < MAX_NAMES {
            self.alive.insert(name.to_owned());
        }
    }

    fn vanish(&mut self, name: &str) {
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

fn lock(register: &Mutex<Register>) -> MutexGuard<'_, Register> {
    // Every statement leaves it consistent, so a panic elsewhere does not spoil it.
    register.lock()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn actor(name: &str) -> ActorId {
        name.parse().unwrap()
    }

    #[test]
    fn a_name_is_the_first_one_s_until_its_token_vanishes() {
        let mut register = Register::default();
        register.appear("a");
        register.claim(&actor("a"), 1);
        register.claim(&actor("a"), 2);
        assert_eq!([1, 2].map(|epoch| register.is_taken(&actor("a"), epoch)), [false, true]);
        assert!(!register.is_taken(&actor("b"), 2));
        register.vanish("a");
        register.appear("a");
        assert!(!register.is_taken(&actor("a"), 2));
        register.claim(&actor("a"), 2);
        assert!(register.is_taken(&actor("a"), 1));
    }

    #[test]
    fn a_name_without_a_token_is_nobody_s() {
        let mut register = Register::default();
        register.claim(&actor("a"), 1);
        assert!(!register.is_taken(&actor("a"), 2));
        assert!(register.owners.is_empty());
    }

    #[test]
    fn there_is_room_for_a_bounded_number_of_names() {
        let mut register = Register::default();
        for i in 0..=MAX_NAMES {
            register.appear(&format!("a-{i}"));
            register.claim(&actor(&format!("a-{i}")), 1);
        }
        assert_eq!((register.alive.len(), register.owners.len()), (MAX_NAMES, MAX_NAMES));
    }
}
