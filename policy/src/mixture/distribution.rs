//! The action distribution of the mixture head in one scene, on slices.

use blueprints::{BlockIdx, N_BLOCKS};
use proto::{Action, ActionMode, Move, N_GRIPPERS};
use rand::RngExt;
use rand::rngs::ChaCha8Rng;

use super::{ActionRows, Draw, Row};
use crate::distribution::{MASKED_LOGIT, unit_normal};
use crate::proposals::{Proposals, Slot};

/// The distribution for one scene with G grippers; borrows one row of the network's output.
#[derive(Clone, Copy, Debug)]
pub struct MixtureDistribution<'a> {
    /// Logits of the grippers' blocks `[G, 16]`, masked.
    pub logits: &'a [f32],
    /// Read-outs `[16, N_READOUTS]`.
    pub readouts: &'a [f32],
    /// Proposals of the scene.
    pub proposals: &'a Proposals,
}

/// An action and the draws that it came from.
#[derive(Clone, Debug, PartialEq)]
pub struct DrawnAction {
    /// The action; the moves of blocks that no gripper chose are zeros.
    pub action: Action,
    /// The slot of each gripper's proposal; `None` for a second gripper on the first's block.
    pub slots: [Option<Slot>; N_GRIPPERS],
    /// Joint log-probability, as [`MixtureDistribution::log_prob`] computes it.
    pub log_prob: f32,
}

/// First blocks that a greedy action tries until something moves.
const GREEDY_TRIES: usize = 3;

/// What counts as a move, in fractions of the speed limits.
const LEAST_MOVE: f32 = 0.05;

impl DrawnAction {
    fn moves_something(&self) -> bool {
        self.action.moves.iter().flatten().any(|x| x.abs() > LEAST_MOVE)
    }
}

impl MixtureDistribution<'_> {
    /// Draws an action, or in greedy mode takes the most probable option of each draw (the first of equals) and the
    /// mean of its move. Returns `None` if a logit is not finite.
    ///
    /// A greedy action that moves nothing would be taken for ever. The first gripper then takes its next most probable
    /// block, or the one after it, if that leads to a move.
    pub fn act(&self, mode: ActionMode, rng: &mut ChaCha8Rng) -> Option<DrawnAction> {
        let blocks = &self.logits[..N_BLOCKS];
        let drawn = self.act_after(choose(blocks, mode, rng)?, mode, rng)?;
        if mode == ActionMode::Sampled || drawn.moves_something() {
            return Some(drawn);
        }
        let mut order: Vec<usize> = (0..N_BLOCKS).filter(|&at| blocks[at] > MASKED_LOGIT).collect();
        order.sort_by(|&a, &b| blocks[b].total_cmp(&blocks[a]));
        let others = order.into_iter().take(GREEDY_TRIES).skip(1);
        let other = others
            .filter_map(|at| self.act_after((at, log_softmax_at(blocks, at)), mode, rng))
            .find(DrawnAction::moves_something);
        Some(other.unwrap_or(drawn))
    }

    /// Draws the rest of an action, after the first gripper's block and its log-probability.
    fn act_after(&self, first: (usize, f32), mode: ActionMode, rng: &mut ChaCha8Rng) -> Option<DrawnAction> {
        let mut action = Action::IDLE;
        let mut slots = [None; N_GRIPPERS];
        let (block, mut log_prob) = first;
        let mut row = Row::default();
        let mut choose = |logits: &[f32], rng: &mut ChaCha8Rng| {
            let (at, of_choice) = choose(logits, mode, rng)?;
            log_prob += of_choice;
            Some(at)
        };

        let block = BlockIdx::try_from(block as u8).ok()?;
        row.first_proposal(self.proposals, block);
        let first = Draw { block, slot: Slot::from_index(row.index(choose(&self.logits_of(&row, &[]), rng)?))? };
        (action.choices[0], slots[0]) = (Some(block), Some(first.slot));
        let mut second = None;
        if self.logits.len() > N_BLOCKS {
            row.second_block(self.proposals, first);
            let logits = self.logits_of(&row, &self.logits[N_BLOCKS..]);
            let block = BlockIdx::try_from(choose(&logits, rng)? as u8).ok()?;
            action.choices[1] = Some(block);
            if block != first.block {
                row.second_proposal(self.proposals, first, block);
                let draw = Draw { block, slot: Slot::from_index(row.index(choose(&self.logits_of(&row, &[]), rng)?))? };
                slots[1] = Some(draw.slot);
                second = Some(draw);
            }
        }
        for draw in [Some(first), second].into_iter().flatten() {
            action.moves[draw.block.get()] = self.movement(draw, mode, rng)?;
        }
        Some(DrawnAction { action, slots, log_prob })
    }

    /// Returns the joint log-probability of an action whose draws `rows` describes, nats. The noise around a proposal has
    /// no parameters and is left out.
    pub fn log_prob(&self, action: &Action, slots: &[Option<Slot>], rows: &ActionRows) -> f32 {
        let mut total = 0.0;
        let mut of_row = |row: &Row, own: &[f32], choice: Option<u8>| {
            if let Some(at) = choice.and_then(|choice| row.position(choice)) {
                total += log_softmax_at(&self.logits_of(row, own), at);
            }
        };
        let slot = |gripper: usize| slots.get(gripper).copied().flatten();
        of_row(&rows.first, &[], slot(0).map(Slot::index));
        of_row(&rows.blocks, &self.logits[N_BLOCKS..], action.choices[1].map(u8::from));
        of_row(&rows.second, &[], slot(1).map(Slot::index));
        let Some(first) = action.choices[0] else { return f32::NEG_INFINITY };
        total + log_softmax_at(&self.logits[..N_BLOCKS], first.get())
    }

    /// Returns the entropies of the choices that `rows` describes, nats: of the first gripper's proposal, and, given
    /// that draw, of the second's block and proposal. A choice that was not made has 0.
    pub fn entropies(&self, rows: &ActionRows) -> [f32; 3] {
        let own = [&[][..], self.logits.get(N_BLOCKS..).unwrap_or_default(), &[]];
        std::array::from_fn(|part| entropy(&self.logits_of(rows.all()[part], own[part])))
    }

    /// Returns the logits of a row's options, plus `own`: the second gripper's logits of blocks, or nothing if empty.
    fn logits_of(&self, row: &Row, own: &[f32]) -> Vec<f32> {
        let mut logits = Vec::new();
        row.logits(self.readouts, &mut logits);
        logits.iter_mut().zip(own).for_each(|(logit, own)| *logit += own);
        logits
    }

    fn movement(&self, draw: Draw, mode: ActionMode, rng: &mut ChaCha8Rng) -> Option<Move> {
        let mut normal = || -> f32 {
            match mode {
                ActionMode::Greedy => 0.0,
                ActionMode::Sampled => unit_normal(rng),
            }
        };
        let proposal = self.proposals.get(draw.block, draw.slot)?;
        let noise = proposal.noise();
        Some(proposal.movement.map(|mean| mean + noise * normal()))
    }
}

/// Returns the position of the chosen logit and its log-probability; `None` if a logit is not finite.
fn choose(logits: &[f32], mode: ActionMode, rng: &mut ChaCha8Rng) -> Option<(usize, f32)> {
    if !logits.iter().all(|logit| logit.is_finite()) {
        return None;
    }
    let best = (0..logits.len()).reduce(|best, at| if logits[at] > logits[best] { at } else { best })?;
    let chosen = match mode {
        ActionMode::Greedy => best,
        ActionMode::Sampled => {
            let weights = logits.iter().map(|logit| (logit - logits[best]).exp());
            let mut rest = rng.random::<f32>() * weights.clone().sum::<f32>();
            // If rounding leaves a rest above all weights, the most probable option gets it.
            let reached = weights.enumerate().find(|&(_, weight)| {
                rest -= weight;
                rest < 0.0
            });
            reached.map_or(best, |(at, _)| at)
        }
    };
    Some((chosen, log_softmax_at(logits, chosen)))
}

fn log_softmax_at(logits: &[f32], at: usize) -> f32 {
    let max = logits.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    logits[at] - max - logits.iter().map(|logit| (logit - max).exp()).sum::<f32>().ln()
}

/// Returns the entropy of a choice, nats; 0 without options.
fn entropy(logits: &[f32]) -> f32 {
    let max = logits.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let (total, weighted) = logits.iter().fold((0.0, 0.0), |(total, weighted), logit| {
        let weight = (logit - max).exp();
        (total + weight, weighted + weight * (logit - max))
    });
    if total > 0.0 { total.ln() - weighted / total } else { 0.0 }
}
