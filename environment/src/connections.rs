//! Connections between blocks: attraction, snapping, load, and breaking.

use blueprints::pieces::pieces;
use blueprints::strength::MAX_STRONG_PAIRS;
use blueprints::{BlockIdx, Inventory, N_BLOCKS, Placement, RelativePlacement};
use nalgebra::{Isometry3, Vector3};
use proto::Joint;

use crate::config::MagnetConfig;
use crate::engine::{Engine, JointHandle, SUBSTEP_S};
use crate::magnets::{ATTRACTION_RANGE_M, Frame, MagnetTable, magnet_position_m};

mod effort;

/// Time for which a new joint cannot break and, after a snap, is soft, ms.
const SNAP_MS: f32 = 200.0;
/// Stiffness of the joint during the snap, Hz.
const SNAP_FREQUENCY_HZ: f32 = 20.0;
/// Stiffness of the joint afterwards, Hz.
const HOLD_FREQUENCY_HZ: f32 = 60.0;
/// Weight of the past in the running mean of a joint's load, per substep.
const LOAD_SMOOTHING: f32 = 0.5;
/// Time after a break during which the two blocks neither attract nor snap, ms.
const COOLDOWN_MS: f32 = 200.0;
/// Time before a new connection becomes breakable during which its load is already measured, ms.
const MEASURED_MS: f32 = 50.0;

/// A live connection.
#[derive(Clone)]
pub(crate) struct Connection {
    joint: Joint,
    /// Target pose of its second block relative to the first.
    b_in_a: Isometry3<f32>,
    pub(crate) handle: JointHandle,
    /// Number of magnet pairs that count toward its strength.
    n_strong_pairs: f32,
    /// Substeps left of the initial unbreakable period, during which a joint is soft after a snap.
    snap_left: u16,
    /// Running mean of its load; the connection breaks above 1.
    load: f32,
    /// Whether its joint is left out of the solver because it carries no load.
    pub(crate) is_spared: bool,
}

/// All connections of a world.
#[derive(Clone)]
pub(crate) struct Connections {
    pub(crate) table: MagnetTable,
    config: MagnetConfig,
    pub(crate) live: Vec<Connection>,
    /// Substeps for which a pair of blocks stays inert after a break, indexed `[lower][higher]`.
    cooldown: [[u16; N_BLOCKS]; N_BLOCKS],
    linked: [[bool; N_BLOCKS]; N_BLOCKS],
    /// Lowest block index in each block's component.
    components: Vec<usize>,
    /// Poses of the blocks before the substep.
    frames: [Frame; N_BLOCKS],
}

impl Connections {
    pub(crate) fn new(config: &MagnetConfig, inventory: &Inventory) -> Self {
        Self {
            table: MagnetTable::new(inventory),
            config: config.clone(),
            live: vec![],
            cooldown: [[0; N_BLOCKS]; N_BLOCKS],
            linked: [[false; N_BLOCKS]; N_BLOCKS],
            components: (0..N_BLOCKS).collect(),
            frames: [Frame::new(&Isometry3::identity()); N_BLOCKS],
        }
    }

    /// Removes all connections. The engine's joints must already be gone.
    pub(crate) fn clear(&mut self) {
        self.live.clear();
        self.cooldown = [[0; N_BLOCKS]; N_BLOCKS];
        self.regroup();
    }

    /// Connects two blocks that are placed as `joint` specifies. The joint is stiff at once but, as after a snap,
    /// unbreakable until the structure has settled under its own weight.
    pub(crate) fn insert_built(&mut self, engine: &mut Engine, joint: Joint) {
        self.insert(engine, joint, HOLD_FREQUENCY_HZ);
    }

    /// Returns the connections, sorted.
    pub(crate) fn joints(&self) -> Vec<Joint> {
        let mut joints: Vec<_> = self.live.iter().map(|c| c.joint).collect();
        joints.sort_unstable();
        joints
    }

    /// Returns whether connections join the two blocks, directly or through others.
    pub(crate) fn same_component(&self, a: BlockIdx, b: BlockIdx) -> bool {
        self.components[a.get()] == self.components[b.get()]
    }

    /// Attracts and snaps blocks. Call this before a substep.
    pub(crate) fn attract(&mut self, engine: &mut Engine) {
        let n_merged = u16::from(engine.n_merged());
        for row in &mut self.cooldown {
            row.iter_mut().for_each(|left| *left = left.saturating_sub(n_merged));
        }
        let poses: [Isometry3<f32>; N_BLOCKS] = BlockIdx::array(|block| engine.pose(block));
        let frames = poses.each_ref().map(Frame::new);
        self.frames = frames;
        let asleep = BlockIdx::array(|block| engine.is_asleep(block));
        let reach = ATTRACTION_RANGE_M.max(self.config.snap_gap_m);
        for a in BlockIdx::all() {
            for b in BlockIdx::all().skip(a.get() + 1) {
                let (i, j) = (a.get(), b.get());
                if (asleep[i] && asleep[j]) || self.linked[i][j] || self.cooldown[i][j] > 0 {
                    continue;
                }
                if self.table.may_touch((a, &frames[i]), (b, &frames[j]), reach) {
                    self.attract_pair(engine, (a, &poses[i], &frames[i]), (b, &poses[j], &frames[j]), reach);
                }
            }
        }
    }

    /// Measures loads and breaks at most one connection. Call this after a substep.
    ///
    /// A broken connection's load shifts to the others, so the rest of its component starts over. Otherwise, whole
    /// chains would burst at once.
    pub(crate) fn strain(&mut self, engine: &mut Engine) {
        let break_torque_per_n = blueprints::UNIT_M;
        // Blocks that come to rest at once may be asleep when their connection first becomes breakable.
        let n_measured = substeps(MEASURED_MS);
        let n_merged = engine.n_merged();
        let news = 1.0 - LOAD_SMOOTHING.powi(i32::from(n_merged));
        let mut worst: Option<(usize, f32)> = None;
        for (i, connection) in self.live.iter_mut().enumerate() {
            let is_settling = connection.snap_left > 0;
            if is_settling {
                connection.snap_left = connection.snap_left.saturating_sub(n_merged.into());
                if connection.snap_left == 0 {
                    engine.set_joint_frequency(connection.handle, HOLD_FREQUENCY_HZ);
                }
                if connection.snap_left >= n_measured {
                    continue;
                }
            }
            let is_asleep = engine.is_asleep(connection.joint.a) && engine.is_asleep(connection.joint.b);
            if is_asleep && !is_settling {
                continue;
            }
            if !is_asleep {
                let load = if connection.is_spared {
                    0.0
                } else {
                    let (force, torque) = engine.joint_load(connection.handle);
                    let strength = connection.n_strong_pairs * self.config.break_force_n;
                    (force / strength).max(torque / (strength * break_torque_per_n))
                };
                connection.load += news * (load - connection.load);
            }
            let can_break = connection.snap_left == 0;
            if can_break && connection.load > 1.0 && worst.is_none_or(|(_, most)| connection.load > most) {
                worst = Some((i, connection.load));
            }
        }
        if let Some((i, _)) = worst {
            self.break_connection(engine, i);
        }
    }

    /// Breaks all connections of a block.
    pub(crate) fn detach(&mut self, engine: &mut Engine, block: BlockIdx) {
        while let Some(i) = self.live.iter().position(|c| c.joint.a == block || c.joint.b == block) {
            self.break_connection(engine, i);
        }
    }

    fn break_connection(&mut self, engine: &mut Engine, index: usize) {
        let component = self.components[self.live[index].joint.a.get()];
        for connection in &mut self.live {
            if self.components[connection.joint.a.get()] == component {
                connection.load = 0.0;
            }
        }
        let broken = self.live.remove(index);
        engine.remove_joint(broken.handle);
        self.cooldown[broken.joint.a.get()][broken.joint.b.get()] = substeps(COOLDOWN_MS);
        self.regroup();
    }

    fn attract_pair(
        &mut self,
        engine: &mut Engine,
        (a, pose_a, frame_a): (BlockIdx, &Isometry3<f32>, &Frame),
        (b, pose_b, frame_b): (BlockIdx, &Isometry3<f32>, &Frame),
        reach: f32,
    ) {
        let substep_s = engine.substep_s();
        let nearest = self.table.for_each_pair((a, frame_a), (b, frame_b), reach, |pair| {
            let impulse = pair.attraction() * substep_s;
            engine.apply_impulse(a, -impulse, pair.point_a);
            engine.apply_impulse(b, impulse, pair.point_b);
        });
        let Some(relative) = nearest.and_then(|pair| pair.snap(pose_a, pose_b, &self.config)) else { return };
        // Within a component, the lattice already fixes the relative pose. A snap to another one would strain it
        // forever.
        if self.same_component(a, b) && relative_along(self.live.iter().map(|c| c.joint), a, b) != Some(relative) {
            return;
        }
        self.insert(engine, Joint { a, b, relative }, SNAP_FREQUENCY_HZ);
    }

    fn insert(&mut self, engine: &mut Engine, joint: Joint, frequency_hz: f32) {
        let inventory = Inventory::standard();
        let pairs = inventory.magnet_pairs(joint.a, joint.b, joint.relative);
        if pairs.is_empty() {
            return;
        }
        // The joint acts at the center of the connected magnets.
        let magnets = inventory.magnets(joint.a);
        let sum: Vector3<f32> = pairs.iter().map(|&(m, _)| magnet_position_m(&magnets[m])).sum();
        let middle = sum / pairs.len() as f32;
        let b_in_a = Isometry3::from_parts(joint.relative.position_m().into(), joint.relative.rotation.quaternion());
        let frame_a = Isometry3::translation(middle.x, middle.y, middle.z);
        let frame_b = b_in_a.inverse() * frame_a;
        let snap_left = substeps(SNAP_MS);
        let handle = engine.insert_fixed_joint((joint.a, frame_a), (joint.b, frame_b), frequency_hz);
        let n_strong_pairs = pairs.len().min(MAX_STRONG_PAIRS) as f32;
        self.live.push(Connection { joint, b_in_a, handle, n_strong_pairs, snap_left, load: 0.0, is_spared: false });
        self.regroup();
    }

    fn regroup(&mut self) {
        let pairs = self.live.iter().map(|c| (c.joint.a.get(), c.joint.b.get()));
        self.linked = [[false; N_BLOCKS]; N_BLOCKS];
        pairs.clone().for_each(|(a, b)| self.linked[a][b] = true);
        self.components = pieces(N_BLOCKS, pairs);
    }
}

/// Returns the lattice pose of `b` relative to `a` along the connections, or `None` if no path joins them.
pub(crate) fn relative_along(
    joints: impl Iterator<Item = Joint> + Clone,
    a: BlockIdx,
    b: BlockIdx,
) -> Option<RelativePlacement> {
    let origin = Placement { block: a, center_half_units: [0; 3], rotation: blueprints::CubeRotation::IDENTITY };
    let mut reached = vec![origin];
    let mut next = 0;
    while next < reached.len() {
        let from = reached[next];
        next += 1;
        if from.block == b {
            return Some(RelativePlacement::between(&origin, &from));
        }
        for Joint { a: low, b: high, relative } in joints.clone() {
            let (to, step) = if low == from.block {
                (high, relative)
            } else if high == from.block {
                (low, relative.inverse())
            } else {
                continue;
            };
            if reached.iter().all(|p| p.block != to) {
                let offset = from.rotation.apply(step.offset_half_units);
                reached.push(Placement {
                    block: to,
                    center_half_units: std::array::from_fn(|i| from.center_half_units[i] + offset[i]),
                    rotation: from.rotation.compose(step.rotation),
                });
            }
        }
    }
    None
}

/// Returns the number of substeps in a time.
fn substeps(ms: f32) -> u16 {
    (ms / (SUBSTEP_S * 1000.0)).round() as u16
}
