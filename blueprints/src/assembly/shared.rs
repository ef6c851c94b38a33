//! A blueprint's assembly and its preferred order, computed once and shared by all its copies.

use std::sync::{Arc, OnceLock};

use super::{Assembly, NoAssembly, Parts};
use crate::{BlockIdx, Placement};

#[derive(Debug)]
struct Computed {
    assembly: Assembly,
    /// For each part, the number of parts placed before it on the best side.
    ranks: Vec<usize>,
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

    /// Returns the number of blocks placed before `block`; `None` if the block is not used or there is no assembly
    /// order.
    pub(crate) fn rank(&self, placements: &[Placement], block: BlockIdx) -> Option<usize> {
        let part = self.parts.iter().position(|&part| part == block)?;
        self.computed(placements)?.ranks.get(part).copied()
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
        let mut ranks = vec![0; placements.len()];
        while let Some(part) = assembly.next(0, placed) {
            ranks[part] = placed.len();
            placed = placed.with(part);
        }
        Ok(Self { assembly, ranks })
    }
}
