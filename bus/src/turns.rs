//! Which queries may wait for an answer. Askers take turns, so that one of them cannot use up what the others need.
//!
//! Zenoh does not say which session sent a query, so askers name themselves. Whoever gives no name shares a small
//! allowance with all others without one. Invented names get no more than newcomers do.

use std::collections::BTreeMap;

use tokio::time::{Duration, Instant};

/// Allowance of an asker for a value that it had before, which it needs only if an answer was lost: answers at once, and
/// answers per second.
const REPEATS: (u32, u32) = (4, 1);

/// Time after which an asker is forgotten.
const MEMORY: Duration = Duration::from_secs(60);

/// Maximum number of askers remembered: twice as many as a router has sessions.
const MAX_ASKERS: usize = 16_384;

/// Allowance of all askers without a name: answers at once, and answers per second.
const NAMELESS: (u32, u32) = (16, 10);

/// Allowance of names that are new. All actors are new to a learner that has just started.
const NEWCOMERS: (u32, u32) = (1024, 50);

/// The askers of one key.
#[derive(Debug)]
pub(super) struct Turns {
    askers: BTreeMap<String, Asker>,
    nameless: Bucket,
    newcomers: Bucket,
}

#[derive(Debug)]
struct Asker {
    is_waiting: bool,
    /// Number of the value in its last answer.
    had: Option<u64>,
    repeats: Bucket,
    last: Instant,
}

impl Turns {
    pub(super) fn new(now: Instant) -> Self {
        Self { askers: BTreeMap::new(), nameless: Bucket::new(NAMELESS, now), newcomers: Bucket::new(NEWCOMERS, now) }
    }

    /// Returns whether a query may wait for an answer. The newest value has the number `newest`.
    pub(super) fn admit(&mut self, name: Option<&str>, newest: u64, now: Instant) -> bool {
        let Some(name) = name else { return self.nameless.take(now) };
        if let Some(asker) = self.askers.get_mut(name) {
            let is_admitted = !asker.is_waiting && (asker.had != Some(newest) || asker.repeats.take(now));
            asker.is_waiting |= is_admitted;
            return is_admitted;
        }
        // Checked first, so that a flood of names does not make it look for room each time.
        if !self.newcomers.take(now) {
            return false;
        }
        if self.askers.len() >= MAX_ASKERS {
            self.askers.retain(|_, asker| asker.is_waiting || now < asker.last + MEMORY);
        }
        let is_admitted = self.askers.len() < MAX_ASKERS;
        if is_admitted {
            let repeats = Bucket::new(REPEATS, now);
            self.askers.insert(name.to_owned(), Asker { is_waiting: true, had: None, repeats, last: now });
        }
        is_admitted
    }

    /// Ends the wait of an admitted query, which now gets the value with the number `had`, or none.
    pub(super) fn end(&mut self, name: Option<&str>, had: Option<u64>, now: Instant) {
        if let Some(asker) = name.and_then(|name| self.askers.get_mut(name)) {
            (asker.is_waiting, asker.had, asker.last) = (false, had, now);
        }
    }
}

/// Lets some through at once, and then a number per second.
#[derive(Debug)]
pub(super) struct Bucket {
    burst: f64,
    per_s: f64,
    left: f64,
    at: Instant,
}

impl Bucket {
    pub(super) fn new((burst, per_s): (u32, u32), now: Instant) -> Self {
        Self { burst: burst.into(), per_s: per_s.into(), left: burst.into(), at: now }
    }

    /// Returns whether one more may pass.
    pub(super) fn take(&mut self, now: Instant) -> bool {
        self.left = (self.left + self.per_s * (now - self.at).as_secs_f64()).min(self.burst);
        self.at = now;
        let passes = self.left >= 1.0;
        self.left -= f64::from(u8::from(passes));
        passes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The number of `n` queries that are admitted, by `name` of the query's number.
    fn admitted(turns: &mut Turns, n: u32, name: impl Fn(u32) -> Option<String>, now: Instant) -> usize {
        (0..n).filter(|&i| turns.admit(name(i).as_deref(), 1, now)).count()
    }

    #[test]
    fn one_asker_waits_once_and_gets_a_value_a_few_times() {
        let now = Instant::now();
        let mut turns = Turns::new(now);
        let a = |_| Some("a".to_owned());
        // Of 10,000 at once, one waits; four more after each has its answer.
        for n_admitted in [1, 1, 1, 1, 1, 0] {
            assert_eq!(admitted(&mut turns, 10_000, a, now), n_admitted);
            turns.end(Some("a"), Some(1), now);
        }
        assert_eq!(admitted(&mut turns, 10_000, a, now + Duration::from_secs(1)), 1);
        turns.end(Some("a"), Some(1), now);
        // Another value at once, and a query again that found none.
        assert!(turns.admit(Some("a"), 2, now));
        turns.end(Some("a"), None, now);
        assert!(turns.admit(Some("a"), 2, now));
    }

    #[test]
    fn a_flood_does_not_delay_askers_that_are_known() {
        let now = Instant::now();
        let mut turns = Turns::new(now);
        assert!(turns.admit(Some("honest"), 1, now));
        turns.end(Some("honest"), Some(1), now);
        assert_eq!(admitted(&mut turns, 10_000, |_| None, now), 16);
        assert_eq!(admitted(&mut turns, 10_000, |i| Some(format!("invented-{i}")), now), 1023);
        assert!(turns.admit(Some("honest"), 2, now));
        // In a second, 10 more without a name and 50 more with new ones.
        let later = now + Duration::from_secs(1);
        assert_eq!(admitted(&mut turns, 10_000, |_| None, later), 10);
        assert_eq!(admitted(&mut turns, 10_000, |i| Some(format!("more-{i}")), later), 50);
    }

    #[test]
    fn number_of_askers_is_bounded() {
        let mut now = Instant::now();
        let mut turns = Turns::new(now);
        // 50 new ones a second, none of which ends its wait.
        for second in 0..400 {
            admitted(&mut turns, 1024, |i| Some(format!("{second}-{i}")), now);
            now += Duration::from_secs(1);
        }
        assert_eq!(turns.askers.len(), MAX_ASKERS);
        // One that got its answer is forgotten after a minute and makes room.
        turns.end(Some("0-0"), Some(1), now);
        assert!(!turns.admit(Some("late"), 1, now));
        assert!(turns.admit(Some("late"), 1, now + MEMORY));
        assert_eq!(turns.askers.len(), MAX_ASKERS);
    }
}
