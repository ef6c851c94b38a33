//! The action distribution of one scene, on slices: sampling, mode, and log-probability.
//!
//! Each gripper chooses one of 16 blocks; each block has a Gaussian move with a diagonal covariance. The joint
//! log-probability is Σ_g log π_g(b_g) + Σ over the *distinct* chosen blocks of log N_b: a block chosen by both grippers
//! counts its move once. [`crate::loss_terms`] has the tensor version.

use blueprints::{BlockIdx, N_BLOCKS};
use burn::tensor::Distribution;
use proto::{Action, Move, N_GRIPPERS};
use rand::RngExt;
use rand::rngs::ChaCha8Rng;

/// Logit of a block that may not be chosen.
pub const MASKED_LOGIT: f32 = -1e9;

/// Entries of a move.
pub(crate) const MOVE: usize = 6;

/// ln(2π) / 2
pub(crate) const HALF_LN_2PI: f32 = 0.918_938_5;

/// The distribution for one scene with G grippers; borrows one row of the network's output.
#[derive(Clone, Copy, Debug)]
pub struct ActionDistribution<'a> {
    logits: &'a [f32],
    locs: &'a [f32],
    scales: &'a [f32],
}

impl<'a> ActionDistribution<'a> {
    /// Borrows one row of the network's output.
    ///
    /// # Shapes
    /// logits `[G, 16]` with masked blocks at [`MASKED_LOGIT`], locs and scales `[16, 6]`, scales above 0.
    ///
    /// # Panics
    /// If a slice has another length, or G is not 1 or 2.
    pub fn new(logits: &'a [f32], locs: &'a [f32], scales: &'a [f32]) -> Self {
        let n_grippers = logits.len() / N_BLOCKS;
        assert!(logits.len() == n_grippers * N_BLOCKS && (1..=N_GRIPPERS).contains(&n_grippers), "length of logits");
        assert!(locs.len() == N_BLOCKS * MOVE && scales.len() == N_BLOCKS * MOVE, "length of locs and scales");
        Self { logits, locs, scales }
    }

    /// Samples the blocks and the moves of all 16 blocks, chosen or not. Returns `None` if a gripper's logits are not a
    /// distribution, because one of them is not finite.
    pub fn sample(&self, rng: &mut ChaCha8Rng) -> Option<Action> {
        let mut choices = [None; N_GRIPPERS];
        for (choice, logits) in choices.iter_mut().zip(self.logits.chunks_exact(N_BLOCKS)) {
            *choice = Some(draw(&log_softmax(logits), rng.random())?);
        }
        let moves = self.moves(|loc, scale| loc + scale * unit_normal(rng));
        Some(Action { choices, moves })
    }

    /// Returns the most probable block of each gripper (the first of equals) and the mean moves.
    pub fn mode(&self) -> Action {
        let mut choices = [None; N_GRIPPERS];
        for (choice, logits) in choices.iter_mut().zip(self.logits.chunks_exact(N_BLOCKS)) {
            let better = |best: BlockIdx, b: BlockIdx| if logits[b.get()] > logits[best.get()] { b } else { best };
            *choice = BlockIdx::all().reduce(better);
        }
        Action { choices, moves: self.moves(|loc, _| loc) }
    }

    /// Returns the log-probability (density) of an action.
    ///
    /// Grippers beyond G are ignored; a missing choice of a gripper within G gives −∞.
    pub fn log_prob(&self, action: &Action) -> f32 {
        let mut total = 0.0;
        let mut is_chosen = [false; N_BLOCKS];
        for (choice, logits) in action.choices.iter().zip(self.logits.chunks_exact(N_BLOCKS)) {
            let Some(block) = choice else { return f32::NEG_INFINITY };
            total += log_softmax(logits)[block.get()];
            is_chosen[block.get()] = true;
        }
        for b in (0..N_BLOCKS).filter(|&b| is_chosen[b]) {
            total += self.move_log_prob(b, &action.moves[b]);
        }
        total
    }

    fn move_log_prob(&self, block: usize, value: &Move) -> f32 {
        let at = block * MOVE;
        let one = |k: usize| {
            let scale = self.scales[at + k];
            let z = (value[k] - self.locs[at + k]) / scale;
            -0.5 * z * z - scale.ln() - HALF_LN_2PI
        };
        (0..MOVE).map(one).sum()
    }

    fn moves(&self, mut entry: impl FnMut(f32, f32) -> f32) -> [Move; N_BLOCKS] {
        let mut entry_at = |at: usize| entry(self.locs[at], self.scales[at]);
        std::array::from_fn(|b| std::array::from_fn(|k| entry_at(b * MOVE + k)))
    }
}

/// Draws from the normal distribution with mean 0 and standard deviation 1.
pub fn unit_normal(rng: &mut ChaCha8Rng) -> f32 {
    Distribution::Normal(0.0, 1.0).sampler(rng).sample()
}

/// Masks the logits of blocks that may not be chosen.
///
/// # Shapes
/// logits `[G, 16]`
pub fn mask_logits(logits: &mut [f32], allowed: &[bool; N_BLOCKS]) {
    for row in logits.chunks_exact_mut(N_BLOCKS) {
        for (logit, allowed) in row.iter_mut().zip(allowed) {
            if !allowed {
                *logit = MASKED_LOGIT;
            }
        }
    }
}

/// Returns the softmax of the logits of 16 blocks.
pub(crate) fn probabilities(logits: &[f32]) -> [f32; N_BLOCKS] {
    log_softmax(logits).map(f32::exp)
}

fn log_softmax(logits: &[f32]) -> [f32; N_BLOCKS] {
    let max = logits.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let log_sum = logits.iter().map(|x| (x - max).exp()).sum::<f32>().ln();
    std::array::from_fn(|b| logits[b] - max - log_sum)
}

/// Returns the block whose interval in [0, 1) contains `u`. If rounding leaves `u` above all intervals, returns the
/// last block with nonzero probability; `None` if no block has any.
fn draw(log_probs: &[f32; N_BLOCKS], u: f32) -> Option<BlockIdx> {
    let mut below = 0.0;
    let mut last = None;
    for block in BlockIdx::all() {
        let p = log_probs[block.get()].exp();
        below += p;
        if p > 0.0 {
            last = Some(block);
            if u < below {
                break;
            }
        }
    }
    last
}
