//! Batches of scene features.

use blueprints::{BlockIdx, N_BLOCKS};
use proto::Observation;

use crate::config::{BlockMask, FeatureConfig, MoveHead, PolicyConfig};
use crate::features::{FeatureSizes, N_EDGES, write_features};
use crate::proposals::Proposals;

/// Features of `n` scenes, row-major.
#[derive(Clone, Debug, PartialEq)]
pub struct FeatureBatch {
    /// Number of scenes.
    pub n: usize,
    /// `[n, 16, nd]`
    pub nodes: Vec<f32>,
    /// `[n, 240, ed]`, sender-major.
    pub edges: Vec<f32>,
    /// `[n, gd]`
    pub globals: Vec<f32>,
    /// `[n]`: the blocks that [`BlockMask::Blueprint`] allows.
    pub allowed: Vec<[bool; N_BLOCKS]>,
    /// `[n]`: what the mixture head chooses among; empty for the Gaussian head.
    pub proposals: Vec<Proposals>,
    /// nd, ed, and gd.
    pub sizes: FeatureSizes,
    config: FeatureConfig,
    with_proposals: bool,
}

impl FeatureBatch {
    /// Creates an empty batch.
    pub fn new(config: &FeatureConfig) -> Self {
        Self {
            n: 0,
            nodes: Vec::new(),
            edges: Vec::new(),
            globals: Vec::new(),
            allowed: Vec::new(),
            proposals: Vec::new(),
            sizes: FeatureSizes::new(config),
            config: *config,
            with_proposals: false,
        }
    }

    /// Creates an empty batch of what a policy reads: features, and proposals if it draws from them.
    pub fn of_policy(config: &PolicyConfig) -> Self {
        let with_proposals = config.network.move_head == MoveHead::Mixture;
        Self { with_proposals, ..Self::new(&config.features) }
    }

    /// Replaces the contents with these scenes.
    pub fn fill(&mut self, observations: &[Observation<'_>]) {
        self.clear();
        observations.iter().for_each(|seen| self.push(seen));
    }

    /// Appends a scene.
    pub fn push(&mut self, observation: &Observation<'_>) {
        let FeatureSizes { node, edge, global, .. } = self.sizes;
        let (nodes_at, edges_at, globals_at) = (self.nodes.len(), self.edges.len(), self.globals.len());
        self.nodes.resize(nodes_at + N_BLOCKS * node, 0.0);
        self.edges.resize(edges_at + N_EDGES * edge, 0.0);
        self.globals.resize(globals_at + global, 0.0);
        write_features(
            observation,
            &self.config,
            &mut self.nodes[nodes_at..],
            &mut self.edges[edges_at..],
            &mut self.globals[globals_at..],
        );
        self.allowed.push(allowed(observation));
        if self.with_proposals {
            self.proposals.push(Proposals::new(observation));
        }
        self.n += 1;
    }

    /// Removes all scenes from the `n`th on.
    pub fn truncate(&mut self, n: usize) {
        let n = n.min(self.n);
        self.n = n;
        self.nodes.truncate(n * N_BLOCKS * self.sizes.node);
        self.edges.truncate(n * N_EDGES * self.sizes.edge);
        self.globals.truncate(n * self.sizes.global);
        self.allowed.truncate(n);
        self.proposals.truncate(n);
    }

    /// Removes all scenes and keeps the memory.
    pub fn clear(&mut self) {
        self.truncate(0);
    }

    /// Returns the given rows in the given order; a row may appear more than once.
    ///
    /// # Panics
    /// If a row is not below `n`.
    pub fn select(&self, rows: &[usize]) -> Self {
        Self {
            n: rows.len(),
            nodes: pick(&self.nodes, N_BLOCKS * self.sizes.node, rows),
            edges: pick(&self.edges, N_EDGES * self.sizes.edge, rows),
            globals: pick(&self.globals, self.sizes.global, rows),
            allowed: pick(&self.allowed, 1, rows),
            proposals: rows.iter().filter_map(|&row| self.proposals.get(row).cloned()).collect(),
            sizes: self.sizes,
            config: self.config,
            with_proposals: self.with_proposals,
        }
    }
}

impl PolicyConfig {
    /// Returns the blocks that a gripper may choose in a row of a batch; `None` if all.
    ///
    /// # Panics
    /// If the batch has no such row.
    pub fn choosable(&self, batch: &FeatureBatch, row: usize) -> Option<[bool; N_BLOCKS]> {
        (self.mask == BlockMask::Blueprint).then(|| batch.allowed[row])
    }
}

/// Returns the blocks that a gripper may choose with [`BlockMask::Blueprint`]: those of the blueprint, and connected
/// ones. Wrong connections must be broken, and two blocks come apart only if a gripper holds each of them.
pub fn allowed(observation: &Observation<'_>) -> [bool; N_BLOCKS] {
    let mut allowed = BlockIdx::array(|block| observation.blueprint.contains(block));
    for joint in &observation.scene.joints {
        allowed[joint.a.get()] = true;
        allowed[joint.b.get()] = true;
    }
    allowed
}

fn pick<T: Copy>(values: &[T], stride: usize, rows: &[usize]) -> Vec<T> {
    rows.iter().flat_map(|row| values[row * stride..(row + 1) * stride].iter().copied()).collect()
}
