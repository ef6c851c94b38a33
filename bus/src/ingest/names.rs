//! Ownership of actor names: if two live processes share a name, it belongs to the one whose trajectory was taken
//! first.

use std::collections::BTreeMap;
use std::sync::Arc;

use parking_lot::{Mutex, MutexGuard};
use zenoh::pubsub::Subscriber;

use crate::alive::MAX_NAMES;
use crate::{Bus, BusError};
use proto::{ActorId, Role};

/// The owners of names, for as long as the name's liveliness token exists.
#[derive(Debug)]
pub(super) struct Names {
    register: Arc<Mutex<Register>>,
    _subscriber: Subscriber<()>,
}

#[derive(Debug, Default)]
pub(super) struct Register {
    /// Live names, each with the start time of its owner once it has one. At most [`MAX_NAMES`]; further names are
    /// always accepted.
    owners: BTreeMap<String, Option<u64>>,
}

impl Names {
    /// Follows the actors' tokens, including the existing ones.
    pub(super) async fn follow(bus: &Bus) -> Result<Self, BusError> {
        let register: Arc<Mutex<Register>> = Arc::default();
        let shared = register.clone();
        let told = move |name: Option<&str>, is_alive: bool| match name {
            Some(name) if is_alive => shared.lock().add(name),
            Some(name) => shared.lock().remove(name),
            // The watch on live processes counts invalid names.
            None => {}
        };
        let followed = bus.follow_tokens(Role::Actor, told).await;
        let subscriber = followed.map_err(BusError::during("watching the actors' names"))?;
        Ok(Self { register, _subscriber: subscriber })
    }

    pub(super) fn lock(&self) -> MutexGuard<'_, Register> {
        self.register.lock()
    }
}

impl Register {
    fn add(&mut self, name: &str) {
        if self.owners.len() < MAX_NAMES {
            self.owners.entry(name.to_owned()).or_default();
        }
    }

    fn remove(&mut self, name: &str) {
        self.owners.remove(name);
    }

    /// Returns whether another live process owns the name.
    pub(super) fn is_taken(&self, actor: &ActorId, epoch: u64) -> bool {
        self.owners.get(actor.as_str()).is_some_and(|owner| owner.is_some_and(|owner| owner != epoch))
    }

    /// Assigns the name to the process if it has no owner.
    pub(super) fn claim(&mut self, actor: &ActorId, epoch: u64) {
        if let Some(owner) = self.owners.get_mut(actor.as_str()) {
            owner.get_or_insert(epoch);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn number_of_names_is_bounded() {
        let mut register = Register::default();
        for i in 0..=MAX_NAMES {
            let name = format!("a-{i}");
            register.add(&name);
            register.claim(&name.parse().unwrap(), 1);
        }
        assert_eq!(register.owners.values().flatten().count(), MAX_NAMES);
    }
}
