//! A blueprint's assembly plan, computed once and shared by all its copies.

use std::sync::{Arc, OnceLock};

use super::{Assembly, NoAssembly, Parts};
use crate::{BlockIdx, Placement, UNIT_M};

/// The side and order in which a blueprint is built. They depend only on the structure, not on which block of a type is
/// used for a part.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// The direction of the blueprint's frame that points up.
    pub up: [i32; 3],
    /// Height in half units, along `up`, of the plane on which the structure rests.
    pub ground_half_units: i32,
    /// Center of all blocks in meters, blueprint frame.
    pub middle_m: [f32; 3],
    /// Distance from `middle_m` to the farthest block, perpendicular to `up`, in meters.
    pub radius_m: f32,
    /// Steps by part.
    steps: Vec<PlanStep>,
}

/// The plan for one block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PlanStep {
    /// Number of blocks placed before it.
    pub rank: usize,
    /// Vector from its place to the start of its approach path, in half units, blueprint frame; zeros for the first
    /// block.
    pub way_half_units: [i32; 3],
}

/// Returns the center of a structure's blocks in meters, blueprint frame, and the distance in meters, perpendicular to
/// `up`, from it to the farthest block.
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
struct Computed {
    assembly: Assembly,
    plan: Plan,
}

/// The assembly of a blueprint, shared by all its copies.
#[derive(Clone, Debug)]
pub(crate) struct Shared {
    computed: Arc<OnceLock<Option<Computed>>>,
    /// The block used for each part.
    parts: Vec<BlockIdx>,
}

/// The cache is not part of the blueprint's value.
impl PartialEq for Shared {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

impl Eq for Shared {}

impl Shared {
    /// Creates an empty cache.
    pub(crate) fn new(placements: &[Placement]) -> Self {
        Self { computed: Arc::default(), parts: placements.iter().map(|placement| placement.block).collect() }
    }

    /// Returns the same cache with other blocks of the same types.
    pub(crate) fn replaced(&self, new: impl Fn(BlockIdx) -> BlockIdx) -> Self {
        Self { computed: self.computed.clone(), parts: self.parts.iter().map(|&block| new(block)).collect() }
    }

    /// Returns a copy of the assembly to query; `placements` are the blueprint's, in any order.
    ///
    /// # Errors
    /// If the blueprint has no assembly order.
    pub(crate) fn assembly(&self, placements: &[Placement]) -> Result<Assembly, NoAssembly> {
        match self.computed(placements) {
            Some(computed) => Ok(Assembly { blocks: self.parts.clone(), ..computed.assembly.clone() }),
            // Search again, so that the error names these blocks.
            None => Assembly::of_placements(&self.ordered(placements)),
        }
    }

    /// Returns the plan; `None` if there is no assembly order.
    pub(crate) fn plan(&self, placements: &[Placement]) -> Option<&Plan> {
        Some(&self.computed(placements)?.plan)
    }

    /// Returns the plan's step for `block`; `None` if the block is not used.
    pub(crate) fn step(&self, plan: &Plan, block: BlockIdx) -> Option<PlanStep> {
        plan.steps.get(self.parts.iter().position(|&part| part == block)?).copied()
    }

    fn computed(&self, placements: &[Placement]) -> Option<&Computed> {
        self.computed.get_or_init(|| Computed::new(&self.ordered(placements)).ok()).as_ref()
    }

    /// Returns the placements by part.
    fn ordered(&self, placements: &[Placement]) -> Vec<Placement> {
        let of = |block: &BlockIdx| placements.iter().find(|placement| placement.block == *block).copied();
        self.parts.iter().filter_map(of).collect()
    }
}

impl Computed {
    fn new(placements: &[Placement]) -> Result<Self, NoAssembly> {
        let mut assembly = Assembly::of_placements(placements)?;
        let mut placed = Parts::default();
        let mut rank = 0;
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
