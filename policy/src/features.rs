//! The policy's observations: node, edge, and global features of `(Scene, Blueprint)` (paper, appendix "Observation
//! Space").
//!
//! The features are independent of the scene's horizontal position and yaw: vectors are in block frames, and heights
//! are the only absolute positions. Unless noted, positions and distances are divided by 0.5 m, linear velocities by 3
//! m/s, angular velocities by 2π rad/s, and angles by π. Flags are the fields of [`FeatureConfig`]; an absent group
//! shifts the indices after it down.
//!
//! **Node** of block i:
//!
//! | index | meaning | frame, unit | flag |
//! |---|---|---|---|
//! | 0 | height of its center above the ground | world z, m / 0.5 | base |
//! | 1, 2 | held by gripper 0, by gripper 1 in the last step | 0 or 1 | base |
//! | 3–5 | the world's up axis | i, unit vector | `up_axis` |
//! | 6 | belongs to the blueprint | 0 or 1 | `membership` |
//! | 7–9 | half extents | i, m / 0.2 | `block_shape` |
//!
//! **Edge** from sender j to receiver i, all in i's frame. C and D are the orientations of j relative to i in the scene
//! and in the blueprint. Entries 0–17 and 24–35 are 0 if the blueprint lacks i or j, and entries 0–8 also if it does
//! not connect the two. 6-D orientations are the first two columns of a rotation matrix, first column first.
//!
//! | index | meaning | unit | flag |
//! |---|---|---|---|
//! | 0–2 | shift of j's magnets that would align them with i's (mean over the pairs) | m / 0.5 | base |
//! | 3–8 | rotation that would align them: D Cᵀ | 6-D | base |
//! | 9–11 | current minus target position of j relative to i | m / 0.5 | base |
//! | 12–17 | current relative to target orientation: C Dᵀ | 6-D | base |
//! | 18–20 | center of j minus center of i | m / 0.5 | base |
//! | 21 | the two should be connected | 0 or 1 | base |
//! | 22 | the two are connected (correctly or not) | 0 or 1 | base |
//! | 23 | both belong to the blueprint | 0 or 1 | base |
//! | 24–26 | move that i needs if j stays | m / 0.5 | `needed_moves` |
//! | 27–29 | the same, each entry tanh(x / 6 cm) | – | `needed_moves` |
//! | 30–32 | turn that i needs if j stays, rotation vector | rad / π | `needed_moves` |
//! | 33–35 | the same, each entry tanh(x / 0.25 rad) | – | `needed_moves` |
//!
//! Edges are ordered sender-major without self-edges: `for j in 0..16 { for i in 0..16 { if i != j } }`, 240 in all.
//! The receiver gathers the messages and outputs its move in the same frame.
//!
//! **Globals**, one group of 25 per gripper, in the order of the grippers; all 0 for a gripper that the scene lacks:
//!
//! | index | meaning | frame, unit | flag |
//! |---|---|---|---|
//! | 0–2 | the world's up axis (orientation without its yaw) | gripper, unit vector | base |
//! | 3–5 | commanded linear velocity of the last step | gripper, (m/s) / 3 | base |
//! | 6–8 | commanded angular velocity of the last step | gripper, (rad/s) / 2π | base |
//! | 9–24 | one-hot of the block held in the last step, all 0 if none | 0 or 1 | base |
//!
//! The network reads the one-hot from the last 16 entries of each group.

use blueprints::{BlockIdx, Inventory, N_BLOCKS};
use nalgebra::{Matrix3, Vector3};
use proto::{Gripper, Observation};

use crate::config::{FeatureConfig, PolicyConfig};
use crate::geometry::{Frame, matrix, rotation, rotation_vector};

/// Number of directed edges between different blocks.
pub const N_EDGES: usize = N_BLOCKS * (N_BLOCKS - 1);

/// Scale of positions and distances, m.
const POSITION_SCALE_M: f32 = 0.5;
/// Scale of half extents, m.
const EXTENT_SCALE_M: f32 = 0.2;
/// Scale of linear velocities, m/s.
const LINEAR_SCALE_MPS: f32 = 3.0;
/// Scale of angular velocities, rad/s.
const ANGULAR_SCALE_RADPS: f32 = std::f32::consts::TAU;
/// Fine scale of needed moves, m.
const FINE_MOVE_M: f32 = 0.06;
/// Fine scale of needed turns, rad.
const FINE_TURN_RAD: f32 = 0.25;

const BASE_NODE: usize = 3;
const BASE_EDGE: usize = 24;
const GRIPPER_PART: usize = 9 + N_BLOCKS;

/// Lengths of the feature vectors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FeatureSizes {
    /// Features of a node.
    pub node: usize,
    /// Features of an edge.
    pub edge: usize,
    /// Features of the whole scene.
    pub global: usize,
    /// Grippers, each of which has an equal part of the features of the scene.
    pub n_grippers: usize,
}

impl FeatureSizes {
    /// Returns the lengths for a configuration; (3, 24, 50) for [`FeatureConfig::paper`].
    pub fn new(config: &FeatureConfig) -> Self {
        let on = |flag: bool, n: usize| if flag { n } else { 0 };
        let n_grippers = usize::from(config.n_grippers);
        Self {
            node: BASE_NODE + on(config.up_axis, 3) + on(config.membership, 1) + on(config.block_shape, 3),
            edge: BASE_EDGE + on(config.needed_moves, 12),
            global: n_grippers * GRIPPER_PART,
            n_grippers,
        }
    }
}

impl PolicyConfig {
    /// Returns the lengths of the feature vectors.
    pub fn sizes(&self) -> FeatureSizes {
        FeatureSizes::new(&self.features)
    }
}

/// Writes the features of a scene, as listed in the module documentation.
///
/// # Shapes
/// nodes `[16, nd]`, edges `[240, ed]`, globals `[gd]`, row-major, with the sizes of [`FeatureSizes::new`].
///
/// # Panics
/// If a slice has another length.
pub fn write_features(
    observation: &Observation<'_>,
    config: &FeatureConfig,
    nodes: &mut [f32],
    edges: &mut [f32],
    globals: &mut [f32],
) {
    let scene = observation.scene;
    let sizes = FeatureSizes::new(config);
    assert_eq!(nodes.len(), N_BLOCKS * sizes.node, "length of the node features");
    assert_eq!(edges.len(), N_EDGES * sizes.edge, "length of the edge features");
    assert_eq!(globals.len(), sizes.global, "length of the global features");
    nodes.fill(0.0);
    edges.fill(0.0);
    let frames = scene.blocks.each_ref().map(Frame::new);
    for (block, node) in BlockIdx::all().zip(nodes.chunks_exact_mut(sizes.node)) {
        write_node(observation, config, block, &frames[block.get()], &mut Writer::new(node));
    }
    write_edges(observation, config, &frames, edges);
    for (gripper, part) in scene.grippers.iter().zip(globals.chunks_exact_mut(GRIPPER_PART)) {
        write_gripper(gripper.as_ref(), part);
    }
}

fn write_node(seen: &Observation<'_>, config: &FeatureConfig, block: BlockIdx, frame: &Frame, to: &mut Writer<'_>) {
    to.number(frame.position.z / POSITION_SCALE_M);
    for gripper in &seen.scene.grippers {
        let held = gripper.as_ref().and_then(|gripper| gripper.held);
        to.bit(held == Some(block));
    }
    if config.up_axis {
        to.vector(&up_axis(&frame.axes));
    }
    if config.membership {
        to.bit(seen.blueprint.contains(block));
    }
    if config.block_shape {
        to.vector(&(Vector3::from(Inventory::standard().half_extents_m(block)) / EXTENT_SCALE_M));
    }
}

/// Iterates over the sender and receiver of every edge.
fn pairs() -> impl Iterator<Item = (BlockIdx, BlockIdx)> {
    BlockIdx::all().flat_map(|j| BlockIdx::all().filter(move |i| *i != j).map(move |i| (j, i)))
}

fn write_edges(seen: &Observation<'_>, config: &FeatureConfig, frames: &[Frame; N_BLOCKS], edges: &mut [f32]) {
    let Observation { scene, blueprint } = *seen;
    let ed = FeatureSizes::new(config).edge;
    let mut connected = [[false; N_BLOCKS]; N_BLOCKS];
    for joint in &scene.joints {
        let (a, b) = (joint.a.get(), joint.b.get());
        connected[a][b] = true;
        connected[b][a] = true;
    }
    for ((sender, receiver), edge) in pairs().zip(edges.chunks_exact_mut(ed)) {
        let (to, from) = (&frames[receiver.get()], &frames[sender.get()]);
        let offset = to.localize(&(from.position - to.position));
        if let Some(wanted) = blueprint.relative(receiver, sender) {
            let current = to.axes.tr_mul(&from.axes);
            let wanted_rotation = matrix(wanted.rotation.matrix());
            let wanted_offset = wanted.position_m();
            if blueprint.link(receiver, sender).is_some() {
                let magnets = mean_magnet(receiver, sender, wanted);
                // Current position of the same magnets of j in i's frame.
                let now = offset + current * wanted_rotation.tr_mul(&(magnets - wanted_offset));
                let mut writer = Writer::new(&mut edge[0..9]);
                writer.vector(&((magnets - now) / POSITION_SCALE_M));
                writer.two_columns(&(wanted_rotation * current.transpose()));
                edge[21] = 1.0;
            }
            let mut writer = Writer::new(&mut edge[9..18]);
            writer.vector(&((offset - wanted_offset) / POSITION_SCALE_M));
            writer.two_columns(&(current * wanted_rotation.transpose()));
            edge[23] = 1.0;
            if config.needed_moves {
                write_needed_move(&offset, &current, &wanted_offset, &wanted_rotation, &mut edge[24..36]);
            }
        }
        Writer::new(&mut edge[18..21]).vector(&(offset / POSITION_SCALE_M));
        edge[22] = f32::from(u8::from(connected[receiver.get()][sender.get()]));
    }
}

/// Writes the move, in the receiver's frame, that brings the receiver to its target pose relative to a fixed sender.
fn write_needed_move(
    offset: &Vector3<f32>,
    current: &Matrix3<f32>,
    wanted_offset: &Vector3<f32>,
    wanted: &Matrix3<f32>,
    to: &mut [f32],
) {
    // In i's frame, j is at (offset, C). The target (m, T) of i satisfies offset = m + T·wanted_offset and C = T·D.
    let turn = current * wanted.transpose();
    let shift = offset - turn * wanted_offset;
    let turn = rotation_vector(&turn);
    let mut writer = Writer::new(to);
    writer.vector(&(shift / POSITION_SCALE_M));
    writer.vector(&shift.map(|x| (x / FINE_MOVE_M).tanh()));
    writer.vector(&(turn / std::f32::consts::PI));
    writer.vector(&turn.map(|x| (x / FINE_TURN_RAD).tanh()));
}

/// Returns the mean position in i's frame of the magnets of i that a correct connection with j joins, m.
fn mean_magnet(i: BlockIdx, j: BlockIdx, wanted: blueprints::RelativePlacement) -> Vector3<f32> {
    let inventory = Inventory::standard();
    let pairs = inventory.magnet_pairs(i, j, wanted);
    let magnets = pairs.iter().map(|(magnet, _)| inventory.magnets(i)[*magnet].position_half_units);
    let sum: Vector3<f32> = magnets.map(|position| Vector3::from(position.map(|x| x as f32))).sum();
    sum * (blueprints::UNIT_M / 2.0 / pairs.len().max(1) as f32)
}

fn write_gripper(gripper: Option<&Gripper>, part: &mut [f32]) {
    part.fill(0.0);
    let Some(gripper) = gripper else { return };
    let axes = rotation(gripper.orientation);
    let mut writer = Writer::new(part);
    writer.vector(&up_axis(&axes));
    writer.vector(&(axes.tr_mul(&Vector3::from(gripper.linear_velocity)) / LINEAR_SCALE_MPS));
    writer.vector(&(axes.tr_mul(&Vector3::from(gripper.angular_velocity)) / ANGULAR_SCALE_RADPS));
    if let Some(block) = gripper.held {
        part[9 + block.get()] = 1.0;
    }
}

/// Returns the world's z axis in the frame with the given axes: the third row.
fn up_axis(axes: &Matrix3<f32>) -> Vector3<f32> {
    axes.row(2).transpose()
}

/// Fills a slice from the front; the rest stays zero.
struct Writer<'a> {
    rest: std::slice::IterMut<'a, f32>,
}

impl<'a> Writer<'a> {
    fn new(slice: &'a mut [f32]) -> Self {
        Self { rest: slice.iter_mut() }
    }

    fn number(&mut self, value: f32) {
        *self.rest.next().expect("the sizes leave room for every feature") = value;
    }

    fn bit(&mut self, value: bool) {
        self.number(f32::from(u8::from(value)));
    }

    fn vector(&mut self, v: &Vector3<f32>) {
        v.iter().for_each(|x| self.number(*x));
    }

    fn two_columns(&mut self, m: &Matrix3<f32>) {
        m.iter().take(6).for_each(|x| self.number(*x));
    }
}
