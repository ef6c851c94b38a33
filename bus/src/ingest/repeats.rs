//! Distinguishes retries from first attempts.

use std::collections::BTreeSet;
use std::num::NonZeroUsize;

use lru::LruCache;
use proto::ActorId;

/// One process of an actor: its name and start time.
pub(super) type Sender = (ActorId, u64);

/// Sequence numbers remembered per sender. An actor has few messages in flight, so a retry is never this far behind.
const WINDOW: u64 = 1024;

/// Senders remembered; far more than a router's sessions, so that only processes that ended long ago are forgotten.
const MAX_SENDERS: NonZeroUsize = NonZeroUsize::new(16_384).expect("above 0");

/// The state of a sequence number.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Seen {
    /// It was not taken before.
    New,
    /// It was taken.
    Taken,
    /// It is too far behind the sender's newest number to be remembered.
    Forgotten,
}

/// The sequence numbers recently taken from each sender, in bounded memory.
#[derive(Debug)]
pub(super) struct Repeats(LruCache<Sender, BTreeSet<u64>>);

impl Default for Repeats {
    fn default() -> Self {
        Self(LruCache::new(MAX_SENDERS))
    }
}

impl Repeats {
    pub(super) fn look_up(&self, sender: &Sender, seq: u64) -> Seen {
        let Some(numbers) = self.0.peek(sender) else { return Seen::New };
        if numbers.contains(&seq) {
            return Seen::Taken;
        }
        let newest = numbers.last().copied().unwrap_or_default();
        if newest.saturating_sub(seq) >= WINDOW { Seen::Forgotten } else { Seen::New }
    }

    pub(super) fn remember(&mut self, sender: Sender, seq: u64) {
        let numbers = self.0.get_or_insert_mut(sender, BTreeSet::new);
        numbers.insert(seq);
        let newest = numbers.last().copied().unwrap_or(seq);
        // Keeps the numbers newest − WINDOW + 1 ..= newest.
        *numbers = numbers.split_off(&newest.saturating_sub(WINDOW - 1));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sender(name: &str, epoch: u64) -> Sender {
        (name.parse().unwrap(), epoch)
    }

    #[test]
    fn numbers_out_of_order_are_accepted_within_the_window() {
        let mut repeats = Repeats::default();
        repeats.remember(sender("a", 1), 2000);
        // The window holds 2000 − 1023 = 977 and everything after it.
        assert_eq!(repeats.look_up(&sender("a", 1), 977), Seen::New);
        assert_eq!(repeats.look_up(&sender("a", 1), 976), Seen::Forgotten);
        repeats.remember(sender("a", 1), 977);
        assert_eq!(repeats.look_up(&sender("a", 1), 977), Seen::Taken);
        repeats.remember(sender("a", 1), 2001);
        assert_eq!(repeats.look_up(&sender("a", 1), 977), Seen::Forgotten);
    }

    #[test]
    fn least_recently_used_sender_is_forgotten() {
        let mut repeats = Repeats::default();
        for epoch in 0..MAX_SENDERS.get() as u64 {
            repeats.remember(sender("a", epoch), 0);
        }
        // Only what is taken counts as use: a stranger's questions keep nobody remembered.
        repeats.remember(sender("a", 0), 1);
        assert_eq!(repeats.look_up(&sender("a", 1), 0), Seen::Taken);
        repeats.remember(sender("b", 0), 0);
        assert_eq!(repeats.0.len(), MAX_SENDERS.get());
        assert_eq!(repeats.look_up(&sender("a", 0), 0), Seen::Taken);
        assert_eq!(repeats.look_up(&sender("a", 1), 0), Seen::New);
    }

    #[test]
    fn largest_sequence_number_does_not_overflow() {
        let mut repeats = Repeats::default();
        repeats.remember(sender("a", 1), u64::MAX);
        assert_eq!(repeats.look_up(&sender("a", 1), u64::MAX), Seen::Taken);
    }
}
