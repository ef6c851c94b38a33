//! Takes connections apart: two grippers pull at two blocks.

use blueprints::assembly::Parts;
use blueprints::{BlockIdx, Inventory};
use nalgebra::{UnitQuaternion, Vector3};
use proto::Joint;

use super::motion::{Twist, lowest};
use super::view::View;
use super::{Command, Expert};

/// Height from which a structure is thrown onto the ground, m.
const SLAM_HEIGHT_M: f32 = 0.17;
/// Share of the speed limit at which a connection is pulled apart while it is bent and twisted. Bending breaks it,
/// because a gripped block is a lever. Pulling alone would need the full speed, and the ends would fly 2 m.
const PULL: f32 = 0.4;
/// Share of the pull that also lifts the looser end off the ground.
const LIFT: f32 = 0.3;
/// Maximum angle from vertical of a connection that counts as upright, rad.
const UPRIGHT_RAD: f32 = 0.5;
/// Height below which a structure touches the ground, m.
const GROUND_M: f32 = 0.03;

impl Expert {
    /// Pulls a piece off its wrong connections; `None` if no connection is wrong.
    pub(super) fn take_down(&self, view: &View) -> Option<Vec<Command>> {
        let wrong = &view.wrong;
        // A piece is identified by its first block.
        let node = |block: BlockIdx| {
            view.part_of[block.get()]
                .and_then(|part| view.piece(part).iter().next())
                .map_or(block, |first| self.block(first))
        };
        let mut nodes: Vec<BlockIdx> = wrong.iter().flat_map(|joint| [node(joint.a), node(joint.b)]).collect();
        nodes.sort_unstable();
        nodes.dedup();
        let strength = |at: BlockIdx| -> usize {
            wrong.iter().filter(|j| node(j.a) == at || node(j.b) == at).map(|j| n_pairs(j).min(3)).sum()
        };
        let size = |at: BlockIdx| view.part_of[at.get()].map_or(1, |part| view.piece(part).len());
        let loose = nodes.into_iter().min_by_key(|&at| (strength(at), size(at), at))?;
        let sides = wrong.iter().filter_map(|joint| match (node(joint.a) == loose, node(joint.b) == loose) {
            (true, false) => Some((joint, joint.a)),
            (false, true) => Some((joint, joint.b)),
            _ => None,
        });
        self.pull_at(view, sides)
    }

    /// Takes a part off a piece that cannot be completed.
    pub(super) fn shrink(&mut self, view: &View, piece: Parts) -> Vec<Command> {
        let safe = |expert: &mut Self, rest: Parts| {
            (0..expert.assembly.n_sides()).any(|side| expert.assembly.is_safe(side, rest))
        };
        let off =
            piece.iter().find(|&part| safe(self, piece.without(Parts::one(part)))).or_else(|| piece.iter().last());
        off.map_or_else(Vec::new, |part| self.split_off(view, part))
    }

    /// Pulls one part off the correctly connected piece that it belongs to.
    pub(super) fn split_off(&self, view: &View, part: usize) -> Vec<Command> {
        let block = self.block(part);
        let joints = view.joints.iter().filter(|j| j.a == block || j.b == block);
        self.pull_at(view, joints.map(|joint| (joint, block))).unwrap_or_default()
    }

    /// Pulls a piece off at its connections, each given with its block of that piece: at the one with the most magnets,
    /// in the direction of all. Returns `None` without connections.
    fn pull_at<'a>(&self, view: &View, joints: impl Iterator<Item = (&'a Joint, BlockIdx)>) -> Option<Vec<Command>> {
        let mut pull = Vector3::zeros();
        let mut grips: Option<(usize, BlockIdx, BlockIdx)> = None;
        for (joint, own) in joints {
            let outward = view.pose(joint.a).rotation * normal(joint);
            let n = n_pairs(joint).min(3);
            pull += (if own == joint.b { outward } else { -outward }) * n as f32;
            if grips.is_none_or(|(most, ..)| n > most) {
                grips = Some((n, own, if own == joint.a { joint.b } else { joint.a }));
            }
        }
        let (_, own, other) = grips?;
        Some(self.pull(view, own, other, pull))
    }

    /// Bends, twists, and pulls two connected blocks apart.
    fn pull(&self, view: &View, own: BlockIdx, other: BlockIdx, direction: Vector3<f32>) -> Vec<Command> {
        let direction = direction.try_normalize(0.1).unwrap_or_else(Vector3::z);
        if self.n_grippers < 2 {
            return vec![self.slam(view, own, direction)];
        }
        let hinge = direction.cross(&Vector3::z()).try_normalize(0.1).unwrap_or_else(Vector3::x);
        let linear = direction * (PULL * self.limits.max_speed_mps);
        let lift = Vector3::z() * (LIFT * PULL * self.limits.max_speed_mps);
        let angular = (hinge + direction) * self.limits.max_turn_radps;
        vec![
            Command { block: own, twist: Twist { linear: linear + lift, angular } },
            Command { block: other, twist: Twist { linear: -linear, angular: -angular } },
        ]
    }

    /// Turns the connection upright, lifts it, and throws it onto the ground, because one gripper alone cannot pull.
    fn slam(&self, view: &View, own: BlockIdx, direction: Vector3<f32>) -> Command {
        let blocks = BlockIdx::all().filter(|&block| view.together(block, own));
        let low = blocks.map(|b| lowest(view.pose(b), &view.half_extents[b.get()])).fold(f32::INFINITY, f32::min);
        let from = view.pose(own);
        let mut to = *from;
        // The upper side loads the connection with its weight, so the heavier side goes on top.
        let volume = |b: BlockIdx| view.half_extents[b.get()].product();
        let rest: f32 = BlockIdx::all().filter(|&b| b != own && view.together(b, own)).map(volume).sum();
        let up = if volume(own) > rest { direction } else { -direction };
        let turn = UnitQuaternion::rotation_between(&up, &Vector3::z());
        let turn = turn.filter(|turn| turn.angle() > UPRIGHT_RAD);
        if let Some(turn) = turn {
            to.rotation = turn * to.rotation;
        }
        // No whole number of steps covers this height, so the gripper still pushes when it arrives.
        to.translation.z += if turn.is_some() || low < GROUND_M { (SLAM_HEIGHT_M - low).max(0.0) } else { -1.0 };
        Command { block: own, twist: self.limits.toward(from, &to) }
    }
}

/// Returns the number of magnet pairs of a connection.
fn n_pairs(joint: &Joint) -> usize {
    Inventory::standard().magnet_pairs(joint.a, joint.b, joint.relative).len()
}

/// Returns the direction from `a` to `b` across the connected faces, in `a`'s frame.
fn normal(joint: &Joint) -> Vector3<f32> {
    let inventory = Inventory::standard();
    let pairs = inventory.magnet_pairs(joint.a, joint.b, joint.relative);
    let Some(&(i, _)) = pairs.first() else { return Vector3::zeros() };
    Vector3::from(inventory.magnets(joint.a)[i].normal.map(|x| x as f32))
}
