//! A blueprint's assembly, computed once and shared by all its copies.

use std::sync::{Arc, OnceLock};

use super::{Assembly, NoAssembly};
use crate::{BlockIdx, Placement};

/// The assembly of a blueprint, shared by all its copies.
#[derive(Clone, Debug)]
pub(crate) struct Shared {
    computed: Arc<OnceLock<Option<Assembly>>>,
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
    pub(crate) fn assembly(&self, placements: &[Placement]) -> Result<Assembly, NoAssembly> {
        let search = || Assembly::of_placements(&self.ordered(placements));
        match self.computed.get_or_init(|| search().ok()) {
            Some(assembly) => Ok(Assembly { blocks: self.parts.clone(), ..assembly.clone() }),
            // Search again, so that the error names these blocks.
            None => search(),
        }
    }

    /// Returns the placements by part.
    fn ordered(&self, placements: &[Placement]) -> Vec<Placement> {
        let of = |block: &BlockIdx| placements.iter().find(|placement| placement.block == *block).copied();
        self.parts.iter().filter_map(of).collect()
    }
}
