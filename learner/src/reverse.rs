//! The reverse curriculum: episodes begin next to the goal, and farther from it as they succeed (Florensa et al.,
//! "Reverse curriculum generation for reinforcement learning", 2017).

use std::collections::BTreeMap;

use blueprints::N_BLOCKS;
use proto::{InvalidSetting, Start};
use serde::{Deserialize, Serialize};

use crate::config::ReverseConfig;
use crate::numbers::share;

/// Weight of one episode in the success rate.
const TAU: f64 = 0.05;

/// How far from the goal episodes begin, by the goal's number of blocks.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct ReverseCurriculum(BTreeMap<u8, Frontier>);

/// The farthest starts in use for goals of one size.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Frontier {
    /// Maximum number of blocks removed; all of them means scattered starts.
    pub reach: u8,
    /// Running success rate of the episodes that begin with `reach` blocks removed.
    pub success_rate: f64,
}

impl ReverseCurriculum {
    /// Creates a curriculum that removes one block from goals of each of these `sizes`.
    pub fn new(sizes: impl IntoIterator<Item = usize>) -> Self {
        Self(sizes.into_iter().map(|size| (size as u8, Frontier { reach: 1, success_rate: 0.0 })).collect())
    }

    /// Checks the numbers of a saved run; `path` is the key of this curriculum.
    ///
    /// # Errors
    /// Returns the first size, reach, or rate that no run has.
    pub(crate) fn check(&self, path: &str) -> Result<(), InvalidSetting> {
        for (&size, frontier) in &self.0 {
            let (key, is_size) = (format!("{path}.{size}"), (2..=N_BLOCKS).contains(&usize::from(size)));
            InvalidSetting::check(&key, "a number of blocks", is_size, format_args!("2..={N_BLOCKS}"))?;
            let Frontier { reach, success_rate } = *frontier;
            InvalidSetting::check(
                format_args!("{key}.reach"),
                reach,
                (1..=size).contains(&reach),
                format_args!("1..={size}"),
            )?;
            share(&format!("{key}.success_rate"), success_rate)?;
        }
        Ok(())
    }

    /// Records one finished episode with a goal of `n_blocks` blocks. Only episodes that begin at the frontier count.
    pub fn record(&mut self, start: &Start, n_blocks: usize, success: bool, config: &ReverseConfig) {
        let n_blocks = n_blocks as u8;
        let undone = match *start {
            Start::NearGoal { undone } => undone,
            Start::Scattered => n_blocks,
            Start::Prebuilt(_) | Start::AsItIs => return,
        };
        let Some(frontier) = self.0.get_mut(&n_blocks).filter(|frontier| frontier.reach == undone) else { return };
        let hit = f64::from(u8::from(success));
        frontier.success_rate += TAU * (hit - frontier.success_rate);
        if frontier.success_rate >= config.gate && frontier.reach < n_blocks {
            *frontier = Frontier { reach: frontier.reach + 1, success_rate: 0.0 };
        }
    }

    /// Returns the maximum number of blocks removed, by the goal's number of blocks, as sent with the weights.
    pub fn reach(&self) -> BTreeMap<u8, u8> {
        self.0.iter().map(|(&n_blocks, frontier)| (n_blocks, frontier.reach)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn near(undone: u8) -> Start {
        Start::NearGoal { undone }
    }

    #[test]
    fn the_frontier_moves_by_its_own_successes_up_to_scattered_starts() {
        let config = ReverseConfig { gate: 0.1 };
        let mut curriculum = ReverseCurriculum::new([2, 3]);
        assert_eq!(curriculum.reach(), [(2, 1), (3, 1)].into());
        // Success rates 0.05, 0.0975, then 0.142625.
        curriculum.record(&near(1), 3, true, &config);
        curriculum.record(&near(1), 3, true, &config);
        curriculum.record(&near(2), 3, true, &config);
        assert_eq!(curriculum.reach(), [(2, 1), (3, 1)].into(), "an episode beyond the frontier does not count");
        curriculum.record(&near(1), 3, true, &config);
        assert_eq!(curriculum.reach(), [(2, 1), (3, 2)].into());
        // Success rates 0.05, 0.0475, 0.095125, 0.14036875.
        for success in [true, false, true, true] {
            assert_eq!(curriculum.reach()[&3], 2);
            curriculum.record(&near(2), 3, success, &config);
        }
        (0..9).for_each(|_| curriculum.record(&Start::Scattered, 3, true, &config));
        assert_eq!(curriculum.reach(), [(2, 1), (3, 3)].into(), "three of three blocks is as far as it goes");
    }
}
