//! Features of several scenes side by side.

use blueprints::{BlockIdx, Blueprint, N_BLOCKS};
use proto::{Observation, Scene};

use crate::config::FeatureConfig;
use crate::features::{FeatureSizes, N_EDGES, write_features};

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
    /// `[n, 16]`: whether [`BlockMask::Blueprint`](crate::config::BlockMask) lets a gripper choose the block.
    pub allowed: Vec<bool>,
    /// nd, ed and gd.
    pub sizes: FeatureSizes,
    config: FeatureConfig,
}

impl FeatureBatch {
    /// An empty batch.
    pub fn new(config: &FeatureConfig) -> Self {
        Self {
            n: 0,
            nodes: Vec::new(),
            edges: Vec::new(),
            globals: Vec::new(),
            allowed: Vec::new(),
            sizes: FeatureSizes::new(config),
            config: *config,
        }
    }

    /// Takes these scenes in place of those before.
    pub fn fill(&mut self, observations: &[Observation<'_>]) {
        self.clear();
        observations.iter().for_each(|seen| self.push(seen.scene, seen.blueprint));
    }

    /// Appends a scene.
    pub fn push(&mut self, scene: &Scene, blueprint: &Blueprint) {
        let FeatureSizes { node, edge, global } = self.sizes;
        let (nodes_at, edges_at, globals_at) = (self.nodes.len(), self.edges.len(), self.globals.len());
        self.nodes.resize(nodes_at + N_BLOCKS * node, 0.0);
        self.edges.resize(edges_at + N_EDGES * edge, 0.0);
        self.globals.resize(globals_at + global, 0.0);
        write_features(
            scene,
            blueprint,
            &self.config,
            &mut self.nodes[nodes_at..],
            &mut self.edges[edges_at..],
            &mut self.globals[globals_at..],
        );
        let allowed_at = self.allowed.len();
        self.allowed.extend(BlockIdx::all().map(|block| blueprint.contains(block)));
        for joint in &scene.joints {
            // No connection but the blueprint's may remain, and two blocks come apart only in two grippers' hold.
            self.allowed[allowed_at + joint.a.get()] = true;
            self.allowed[allowed_at + joint.b.get()] = true;
        }
        self.n += 1;
    }

    /// Removes all scenes and keeps the memory.
    pub fn clear(&mut self) {
        self.n = 0;
        self.nodes.clear();
        self.edges.clear();
        self.globals.clear();
        self.allowed.clear();
    }

    /// The given rows, in the given order; a row may appear more than once.
    ///
    /// # Panics
    /// When a row is not below `n`.
    pub fn select(&self, rows: &[usize]) -> Self {
        Self {
            n: rows.len(),
            nodes: pick(&self.nodes, N_BLOCKS * self.sizes.node, rows),
            edges: pick(&self.edges, N_EDGES * self.sizes.edge, rows),
            globals: pick(&self.globals, self.sizes.global, rows),
            allowed: pick(&self.allowed, N_BLOCKS, rows),
            sizes: self.sizes,
            config: self.config,
        }
    }
}

fn pick<T: Copy>(values: &[T], stride: usize, rows: &[usize]) -> Vec<T> {
    rows.iter().flat_map(|row| values[row * stride..(row + 1) * stride].iter().copied()).collect()
}
