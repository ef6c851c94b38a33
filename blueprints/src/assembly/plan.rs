//! The assembly that goes with a blueprint, worked out once for all its copies.

use std::sync::{Arc, OnceLock};

use super::{Assembly, NoAssembly, Parts};
use crate::{BlockIdx, Placement, UNIT_M};

/// How a blueprint is built: on which side and in which order. It depends on the structure alone, not on which of several
/// blocks of one type play its parts.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// The direction of the blueprint's frame that points up.
    pub up: [i32; 3],
    /// Height in half units, along `up`, of the plane on which the structure lies.
    pub ground_half_units: i32,
    /// The middle of all blocks, m, blueprint frame, and the distance from it, across `up`, of the block that is furthest.
    pub middle_m: [f32; 3],
    /// See `middle_m`.
    pub radius_m: f32,
    /// By part.
    steps: Vec<PlanStep>,
}

/// What a plan has for one block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PlanStep {
    /// How many blocks are placed before it.
    pub rank: usize,
    /// From its place to the beginning of its way in, half units, blueprint frame; zeros for the first block.
    pub way_half_units: [i32; 3],
}

/// The middle of a structure's blocks, m, blueprint frame, and the distance from it, across `up`, of the block that is
/// furthest, m.
pub fn extent_m(placements: &[Placement], up: [i32; 3]) -> ([f32; 3], f32) {
    let n = placements.len().max(1) as f32;
    let half_unit_m = UNIT_M / 2.0;
    let at = |placement: &Placement, axis: usize| placement.center_half_units[axis] as f32 * half_unit_m;
    let middle: [f32; 3] = std::array::from_fn(|axis| placements.iter().map(|p| at(p, axis)).sum::<f32>() / n);
    let across = |placement: &Placement| {
        let squares = (0..3).filter(|&axis| up[axis] == 0).map(|axis| (at(placement, axis) - middle[axis]).powi(2));
        squares.sum::<f32>().sqrt()
    };
    (middle, placements.iter().map(across).fold(0.0, f32::max))
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

    /// The plan; `None` without an order of assembly.
    pub(crate) fn plan(&self, placements: &[Placement]) -> Option<&Plan> {
        Some(&self.worked(placements)?.plan)
    }

    /// What the plan has for `block`; `None` if that plays no part.
    pub(crate) fn step(&self, plan: &Plan, block: BlockIdx) -> Option<PlanStep> {
        plan.steps.get(self.parts.iter().position(|&part| part == block)?).copied()
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
        let (mut placed, mut rank) = (Parts::default(), 0);
        let mut steps = vec![PlanStep { rank: placements.len(), way_half_units: [0; 3] }; placements.len()];
        while let Some(part) = assembly.next(0, placed) {
            let way = assembly.approach(0, placed, Parts::one(part));
            let way_half_units = way.map_or([0; 3], |way| way.direction.map(|d| d * way.length_half_units));
            steps[part] = PlanStep { rank, way_half_units };
            placed = placed.with(part);
            rank += 1;
        }
        let (up, ground_half_units) = (assembly.up(0), assembly.ground_half_units(0));
        let (middle_m, radius_m) = extent_m(placements, up);
        Ok(Self { assembly, plan: Plan { up, ground_half_units, middle_m, radius_m, steps } })
    }
}
