//! Random choices that depend only on a request.

use rand::rngs::ChaCha8Rng;
use rand::{Rng, SeedableRng};

/// A random stream; the same seed gives the same stream on every machine and in every release.
pub(super) struct Dice(ChaCha8Rng);

impl Dice {
    pub(super) fn new(seed: [u8; 32]) -> Self {
        Self(ChaCha8Rng::from_seed(seed))
    }

    /// Draws a number in `0..n`; 0 if `n` is 0.
    pub(super) fn below(&mut self, n: usize) -> usize {
        // The bias of 2⁻⁶⁴·n is negligible, and the simple rule can stay unchanged in all releases.
        ((u128::from(self.0.next_u64()) * n as u128) >> 64) as usize
    }

    /// Draws a number in `low..=high`; `low` if `high` is less.
    pub(super) fn between(&mut self, low: i32, high: i32) -> i32 {
        low + self.below(usize::try_from(high - low + 1).unwrap_or(0)) as i32
    }

    /// Returns `true` with a probability of `percent` %.
    pub(super) fn chance(&mut self, percent: usize) -> bool {
        self.below(100) < percent
    }

    /// Draws one of the items, which must not be empty.
    pub(super) fn pick<T: Copy>(&mut self, items: &[T]) -> T {
        items[self.below(items.len())]
    }

    pub(super) fn shuffle<T>(&mut self, items: &mut [T]) {
        for i in (1..items.len()).rev() {
            items.swap(i, self.below(i + 1));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn random_stream_is_pinned() {
        let mut dice = Dice::new([7; 32]);
        let numbers: Vec<usize> = (0..8).map(|_| dice.below(1000)).collect();
        assert_eq!(numbers, [223, 831, 290, 353, 704, 110, 649, 587]);
    }

    #[test]
    fn choices_stay_in_range() {
        let mut dice = Dice::new([0; 32]);
        let mut seen = [0; 6];
        for _ in 0..600 {
            seen[usize::try_from(dice.between(-2, 3) + 2).unwrap()] += 1;
        }
        assert!(seen.iter().all(|&n| n > 60), "{seen:?}");
        assert_eq!((dice.below(0), dice.between(4, 3)), (0, 4));
        let mut items = [0, 1, 2, 3, 4];
        dice.shuffle(&mut items);
        let chosen = dice.pick(&items);
        items.sort_unstable();
        assert_eq!(items, [0, 1, 2, 3, 4]);
        assert!(items.contains(&chosen));
    }
}
