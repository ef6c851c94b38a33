//! The mixture head: which block each gripper chooses, and which [proposal](crate::proposals) moves it.
//!
//! The draws follow one another, so that the second gripper knows what the first does:
//!
//! ```text
//!   p(b₁) · p(k₁ | b₁) · p(b₂ | b₁, k₁) · p(k₂ | b₂, b₁, k₁)
//! ```
//!
//! b₁ and b₂ are the grippers' blocks, k₁ and k₂ slots of proposals. p(b₁) and the first part of p(b₂ | …) are the
//! paper's choices of blocks. If b₂ = b₁, the block moves once, and there is no k₂. Around the drawn proposal, the move
//! has Gaussian noise without parameters. An action carries its slots, so its probability is that of its own draws:
//! the noise cancels in every ratio of two policies.
//!
//! All other logits are read out of the final node vectors: a linear layer gives each block [`N_READOUTS`] numbers, and
//! each logit is a sum of some of them, with coefficients from the [relation](Proposals::relation) of two blocks, plus
//! for a partner the product of a query and a key. [`Row`] is the one description of these sums. It is evaluated here
//! on slices, forward and backward, and in [`crate::loss_terms`] as a matrix product on any device.

mod distribution;
mod tensors;

use std::ops::Range;

use blueprints::{BlockIdx, N_BLOCKS as N};

use crate::proposals::{Kind, N_RELATION, Proposals, Slot};

pub use distribution::{DrawnAction, MixtureDistribution};
pub use tensors::DrawLogits;
pub(crate) use tensors::DrawNumbers;

/// Length of queries and keys.
const D: usize = 16;
const N_KINDS: usize = Kind::ALL.len();
const N_PAIRED: usize = Kind::PAIRED.len();

/// Positions of a block's read-outs.
mod at {
    use super::{D, N_KINDS, N_PAIRED, N_RELATION};

    /// A query and a key of proposals.
    pub(super) const PROPOSAL_QUERY: usize = 0;
    /// For each kind with a partner: the coefficients of the relation, and a bias.
    pub(super) const PAIRED: usize = PROPOSAL_QUERY + 2 * D;
    /// To hold: a bias.
    pub(super) const HOLD: usize = PAIRED + N_PAIRED * (N_RELATION + 1);
    /// For each kind of the first gripper and each kind: a bias of the second gripper's proposal.
    pub(super) const AFTER: usize = HOLD + 1;
    /// The same, if the partner is the first gripper's block.
    pub(super) const TOWARD_FIRST: usize = AFTER + N_KINDS * N_KINDS;
    /// The same, if in addition the first gripper's partner is this block.
    pub(super) const MUTUAL: usize = TOWARD_FIRST + N_KINDS * N_PAIRED;
    /// A query and a key of the second gripper's block.
    pub(super) const BLOCK_QUERY: usize = MUTUAL + N_KINDS * N_PAIRED;
    /// Coefficients of the relation of the first gripper's block to the second's.
    pub(super) const BLOCK_RELATION: usize = BLOCK_QUERY + 2 * D;
    /// For each kind of the first gripper: a bias of the same block, of the first one's partner, and of a block of the
    /// same piece.
    pub(super) const BLOCK_AFTER: usize = BLOCK_RELATION + N_RELATION;
    pub(super) const END: usize = BLOCK_AFTER + N_KINDS * 3;
}

/// Number of read-outs of a block.
pub const N_READOUTS: usize = at::END;

/// What one gripper drew.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Draw {
    /// The block.
    pub block: BlockIdx,
    /// The proposal that moves it.
    pub slot: Slot,
}

/// The logits of one choice, as sums of the read-outs of one block.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Row {
    /// The block whose read-outs are summed.
    pub(crate) block: usize,
    /// Position of the query; the key of the partner follows it by [`D`].
    pub(crate) query: usize,
    pub(crate) options: Vec<RowOption>,
    /// Read-outs and their coefficients, by option.
    terms: Vec<(u16, f32)>,
}

/// One logit of a row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct RowOption {
    /// The block or slot that is chosen.
    pub(crate) index: u8,
    /// The block whose key is multiplied with the query.
    pub(crate) partner: Option<u8>,
    /// End of its terms.
    end: u32,
}

impl Row {
    /// Describes the proposals of the first gripper's block.
    pub fn first_proposal(&mut self, proposals: &Proposals, block: BlockIdx) {
        self.begin(block, at::PROPOSAL_QUERY);
        for &slot in proposals.slots(block) {
            self.proposal(proposals, block, slot);
            self.end(slot.index(), slot.partner());
        }
    }

    /// Describes what is added to the logits of the second gripper's block, for all 16.
    pub fn second_block(&mut self, proposals: &Proposals, first: Draw) {
        self.begin(first.block, at::BLOCK_QUERY);
        let after = at::BLOCK_AFTER + first.slot.kind() as usize * 3;
        for block in BlockIdx::all() {
            if block == first.block {
                self.term(after, 1.0);
                self.end(block.into(), None);
                continue;
            }
            let relation = proposals.relation(first.block, block);
            self.relation(at::BLOCK_RELATION, relation);
            if first.slot.partner() == Some(block) {
                self.term(after + 1, 1.0);
            }
            // Entry 1: in one piece.
            if relation[1] != 0.0 {
                self.term(after + 2, 1.0);
            }
            self.end(block.into(), Some(block));
        }
    }

    /// Describes the proposals of the second gripper's block, which is not the first's.
    pub fn second_proposal(&mut self, proposals: &Proposals, first: Draw, block: BlockIdx) {
        self.begin(block, at::PROPOSAL_QUERY);
        let kind = first.slot.kind() as usize;
        for &slot in proposals.slots(block) {
            self.proposal(proposals, block, slot);
            self.term(at::AFTER + kind * N_KINDS + slot.kind() as usize, 1.0);
            if slot.partner() == Some(first.block) {
                let at = kind * N_PAIRED + slot.kind() as usize;
                self.term(at::TOWARD_FIRST + at, 1.0);
                if first.slot.partner() == Some(block) {
                    self.term(at::MUTUAL + at, 1.0);
                }
            }
            self.end(slot.index(), slot.partner());
        }
    }

    /// Appends the logits of all options, from the read-outs of the scene `[16, N_READOUTS]`.
    pub fn logits(&self, readouts: &[f32], to: &mut Vec<f32>) {
        let own = &readouts[self.block * N_READOUTS..][..N_READOUTS];
        let query = &own[self.query..self.query + D];
        to.extend(self.each().map(|(option, terms)| {
            let linear: f32 = terms.iter().map(|&(k, coefficient)| own[usize::from(k)] * coefficient).sum();
            linear + option.partner.map_or(0.0, |partner| dot(query, &readouts[self.key_range(partner)]) * ROOT)
        }));
    }

    /// Adds to the gradient of the read-outs, given that of the logits.
    pub(crate) fn add_gradient(&self, readouts: &[f32], by_logit: &[f32], to: &mut [f32]) {
        let own = self.block * N_READOUTS;
        let query = own + self.query..own + self.query + D;
        for ((option, terms), &d) in self.each().zip(by_logit) {
            terms.iter().for_each(|&(k, coefficient)| to[own + usize::from(k)] += d * coefficient);
            if let Some(partner) = option.partner {
                let key = self.key_range(partner);
                for (q, k) in query.clone().zip(key) {
                    to[q] += d * ROOT * readouts[k];
                    to[k] += d * ROOT * readouts[q];
                }
            }
        }
    }

    /// Returns the number of options.
    pub fn len(&self) -> usize {
        self.options.len()
    }

    /// Whether there are no options: a choice that was not made.
    pub fn is_empty(&self) -> bool {
        self.options.is_empty()
    }

    /// Returns the position of the option with this index; `None` if it is not offered.
    pub fn position(&self, index: u8) -> Option<usize> {
        self.options.iter().position(|option| option.index == index)
    }

    /// Returns the index of the option at this position.
    ///
    /// # Panics
    /// If there is none.
    pub fn index(&self, position: usize) -> u8 {
        self.options[position].index
    }

    /// Iterates over the options with their terms.
    pub(crate) fn each(&self) -> impl Iterator<Item = (&RowOption, &[(u16, f32)])> {
        let mut start = 0;
        self.options.iter().map(move |option| {
            let terms = &self.terms[start..option.end as usize];
            start = option.end as usize;
            (option, terms)
        })
    }

    /// Positions of a partner's key in the read-outs of a scene.
    fn key_range(&self, partner: u8) -> Range<usize> {
        let start = usize::from(partner) * N_READOUTS + self.query + D;
        start..start + D
    }

    fn begin(&mut self, block: BlockIdx, query: usize) {
        self.options.clear();
        self.terms.clear();
        (self.block, self.query) = (block.get(), query);
    }

    fn term(&mut self, readout: usize, coefficient: f32) {
        self.terms.push((readout as u16, coefficient));
    }

    fn relation(&mut self, start: usize, relation: &[f32; N_RELATION]) {
        for (k, &coefficient) in relation.iter().enumerate().filter(|(_, x)| **x != 0.0) {
            self.term(start + k, coefficient);
        }
    }

    fn end(&mut self, index: u8, partner: Option<BlockIdx>) {
        self.options.push(RowOption { index, partner: partner.map(u8::from), end: self.terms.len() as u32 });
    }

    /// The terms of a proposal that do not depend on the other gripper.
    fn proposal(&mut self, proposals: &Proposals, block: BlockIdx, slot: Slot) {
        let Some(partner) = slot.partner() else { return self.term(at::HOLD, 1.0) };
        let start = at::PAIRED + slot.kind() as usize * (N_RELATION + 1);
        self.relation(start, proposals.relation(block, partner));
        self.term(start + N_RELATION, 1.0);
    }
}

/// The rows of one action, in the order of the draws.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ActionRows {
    /// The first gripper's proposals.
    pub first: Row,
    /// What is added to the logits of the second gripper's blocks; empty with one gripper.
    pub blocks: Row,
    /// The second gripper's proposals; empty if it chose the first's block, or there is none.
    pub second: Row,
}

impl ActionRows {
    /// Describes the choices of an action with the given blocks and slots.
    ///
    /// Returns `None` if the scene does not offer them: a gripper's block or slot is missing, a slot is not among its
    /// block's proposals, or there are slots of grippers that moved nothing.
    pub fn new(proposals: &Proposals, blocks: &[Option<BlockIdx>], slots: &[Option<Slot>]) -> Option<Self> {
        let mut rows = Self::default();
        let first = Draw { block: blocks.first().copied()??, slot: slots.first().copied()?? };
        let is_offered = |draw: Draw| proposals.slots(draw.block).contains(&draw.slot);
        if !is_offered(first) {
            return None;
        }
        rows.first.first_proposal(proposals, first.block);
        let Some(block) = blocks.get(1).copied().flatten() else {
            return slots[1..].iter().all(Option::is_none).then_some(rows);
        };
        rows.blocks.second_block(proposals, first);
        match slots.get(1).copied().flatten() {
            None if block == first.block => Some(rows),
            Some(slot) if block != first.block && is_offered(Draw { block, slot }) => {
                rows.second.second_proposal(proposals, first, block);
                Some(rows)
            }
            _ => None,
        }
    }

    /// Returns the three rows in order.
    pub fn all(&self) -> [&Row; 3] {
        [&self.first, &self.blocks, &self.second]
    }
}

/// Factor of the product of a query and a key, 1/√16.
pub(crate) const ROOT: f32 = 0.25;

fn dot(a: &[f32], b: &[f32]) -> f32 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
