//! The assembly that goes with a blueprint, worked out once for all its copies.

use std::sync::{Arc, OnceLock};

use super::{Assembly, NoAssembly};
use crate::{BlockIdx, Placement};

/// How a blueprint is built: on which side and in which order. It depends on the structure alone, not on which of several
/// blocks of one type play its parts.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Plan {
    /// The direction of the blueprint's frame that points up.
    pub up: [i32; 3],
    /// Height in half units, along `up`, of the plane on which the structure lies.
    pub ground_half_units: i32,
    /// For each part, how many are placed before it.
    ranks: Vec<usize>,
}

#[derive(Debug)]
struct Worked {
    assembly: Assembly,
    plan: Plan,
}

/// The assembly of a blueprint, shared by all copies on whatever blocks.
#[derive(Clone, Debug)]
pub(crate) struct Shared {
    worked: Arc<OnceLock<Option<Worked>>>,
    /// The block that plays each part.
    parts: Vec<BlockIdx>,
}

/// What is worked out from a blueprint is not part of it.
impl PartialEq for Shared {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

impl Eq for Shared {}

impl Shared {
    /// Nothing worked out yet.
    pub(crate) fn new(placements: &[Placement]) -> Self {
        Self { worked: Arc::default(), parts: placements.iter().map(|placement| placement.block).collect() }
    }

    /// The same with other blocks of the same types.
    pub(crate) fn replaced(&self, new: impl Fn(BlockIdx) -> BlockIdx) -> Self {
        Self { worked: self.worked.clone(), parts: self.parts.iter().map(|&block| new(block)).collect() }
    }

    /// A copy to work with; `placements` are those of the blueprint, in any order.
    ///
    /// # Errors
    /// When the blueprint has no order of assembly.
    pub(crate) fn assembly(&self, placements: &[Placement]) -> Result<Assembly, NoAssembly> {
        match self.worked(placements) {
            Some(worked) => Ok(Assembly { blocks: self.parts.clone(), ..worked.assembly.clone() }),
            // Worked out again, so that the error names these blocks.
            None => Assembly::of_placements(&self.ordered(placements)),
        }
    }

    /// The plan, and how many blocks are placed before each one; `None` without an order of assembly.
    pub(crate) fn plan(&self, placements: &[Placement]) -> Option<&Plan> {
        Some(&self.worked(placements)?.plan)
    }

    /// How many parts are placed before that of `block`; `None` if it has none.
    pub(crate) fn rank(&self, plan: &Plan, block: BlockIdx) -> Option<usize> {
        plan.ranks.get(self.parts.iter().position(|&part| part == block)?).copied()
    }

    fn worked(&self, placements: &[Placement]) -> Option<&Worked> {
        self.worked.get_or_init(|| Worked::new(&self.ordered(placements)).ok()).as_ref()
    }

    /// The placements by part.
    fn ordered(&self, placements: &[Placement]) -> Vec<Placement> {
        let of = |block: &BlockIdx| placements.iter().find(|placement| placement.block == *block).copied();
        self.parts.iter().filter_map(of).collect()
    }
}

impl Worked {
    fn new(placements: &[Placement]) -> Result<Self, NoAssembly> {
        let mut assembly = Assembly::of_placements(placements)?;
        let order = assembly.order();
        let rank = |block: &BlockIdx| order.iter().position(|other| other == block).unwrap_or(order.len());
        let ranks = assembly.blocks.iter().map(rank).collect();
        let plan = Plan { up: assembly.up(0), ground_half_units: assembly.ground_half_units(0), ranks };
        Ok(Self { assembly, plan })
    }
}
