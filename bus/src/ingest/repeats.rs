//! Distinguishes retries from first attempts.

use std::collections::{BTreeMap, BTreeSet};

use proto::ActorId;

/// One process of an actor: its name and start time.
pub(super) type Sender = (ActorId, u64);

/// Sequence numbers remembered per sender. An actor has few messages in flight, so a retry is never this far behind.
const WINDOW: u64 = 1024;

/// Senders remembered; far more than a router's sessions, so that only processes that ended long ago are forgotten.
const MAX_SENDERS: usize = 16_384;

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
#[derive(Debug, Default)]
pub(super) struct Repeats {
    senders: BTreeMap<Sender, Recent>,
    n_taken: u64,
}

#[derive(Debug, Default)]
struct Recent {
    numbers: BTreeSet<u64>,
    /// How many were taken from all senders when the last one was taken from this one.
    last: u64,
}

impl Repeats {
    pub(super) fn look_up(&self, sender: &Sender, seq: u64) -> Seen {
        let Some(Recent { numbers, .. }) = self.senders.get(sender) else { return Seen::New };
        if numbers.contains(&seq) {
            return Seen::Taken;
        }
        let newest = numbers.last().copied().unwrap_or_default();
        if newest.saturating_sub(seq) >= WINDOW { Seen::Forgotten } else { Seen::New }
    }

    pub(super) fn remember(&mut self, sender: Sender, seq: u64) {
        self.n_taken += 1;
        let Recent { numbers, last } = self.senders.entry(sender).or_default();
        *last = self.n_taken;
        numbers.insert(seq);
        let newest = numbers.last().copied().unwrap_or(seq);
        // Keeps the numbers newest − WINDOW + 1 ..= newest.
        *numbers = numbers.split_off(&newest.saturating_sub(WINDOW - 1));
        if self.senders.len() > MAX_SENDERS
            && let Some((silent, _)) = self.senders.iter().min_by_key(|(_, recent)| recent.last)
        {
            let silent = silent.clone();
            self.senders.remove(&silent);
        }
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
        for epoch in 0..MAX_SENDERS as u64 {
            repeats.remember(sender("a", epoch), 0);
        }
        // Only what is taken counts as use: a stranger's questions keep nobody remembered.
        repeats.remember(sender("a", 0), 1);
        assert_eq!(repeats.look_up(&sender("a", 1), 0), Seen::Taken);
        repeats.remember(sender("b", 0), 0);
        assert_eq!(repeats.senders.len(), MAX_SENDERS);
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
