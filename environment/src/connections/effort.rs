//! Reduces the solver's work per substep.

use blueprints::{BlockIdx, N_BLOCKS};
use proto::N_GRIPPERS;

use super::{Connection, Connections};
use crate::engine::Engine;

/// Minimum number of blocks of a structure that can sag or slide.
const STRUCTURE_BLOCKS: usize = 4;
/// Minimum number of blocks of a structure that does so in substeps of 20 ms: `3_013` would move by 2.7 cm in two
/// seconds.
const MERGED_BLOCKS: usize = 3;
/// Clearance around a carried component, beyond all motion in a substep, that keeps its joints out of the solver, m.
const ROOM_M: f32 = 0.01;
/// Clearance at which the joints leave the solver, m; larger, so that they do not toggle in every substep.
const ROOM_TO_LEAVE_M: f32 = 0.03;
/// Maximum distance of a joint's second block from its target relative to the first while the joint is out of the
/// solver, m.
const FIT_M: f32 = 0.001;
/// Maximum angle from the target orientation while the joint is out of the solver, rad.
const FIT_RAD: f32 = 0.01;

impl Connections {
    /// Leaves joints that carry no load out of the solver and sets the solver's effort. Call this before a substep,
    /// after the grippers have set the held blocks in motion.
    ///
    /// Each block in `carried` moves with its whole component as one weightless rigid body. Until something touches
    /// such a body, its joints would only confirm its motion.
    pub(crate) fn spare(&mut self, engine: &mut Engine, carried: [Option<BlockIdx>; N_GRIPPERS]) {
        let mut is_spared = [false; N_BLOCKS];
        for block in carried.into_iter().flatten() {
            let component = self.components[block.get()];
            is_spared[component] = self.carries_nothing(engine, component);
        }
        for connection in &mut self.live {
            let wanted = is_spared[self.components[connection.joint.a.get()]];
            if connection.is_spared != wanted {
                connection.is_spared = wanted;
                engine.set_joint_enabled(connection.handle, !wanted);
            }
        }
        engine.set_structures(self.largest_structure(engine) >= STRUCTURE_BLOCKS);
    }

    /// Returns whether substeps may be merged because no structure would sag in long ones.
    pub(crate) fn may_merge(&self, engine: &Engine) -> bool {
        self.largest_structure(engine) < MERGED_BLOCKS
    }

    /// Returns the number of blocks in the largest structure that is awake and has joints in the solver, or 0 without
    /// any.
    fn largest_structure(&self, engine: &Engine) -> usize {
        let mut n_blocks = [0; N_BLOCKS];
        self.components.iter().for_each(|&component| n_blocks[component] += 1);
        let stands = |c: &&Connection| !(c.is_spared || engine.is_asleep(c.joint.a) && engine.is_asleep(c.joint.b));
        let sizes = self.live.iter().filter(stands).map(|c| n_blocks[self.components[c.joint.a.get()]]);
        sizes.max().unwrap_or(0)
    }

    fn carries_nothing(&self, engine: &Engine, component: usize) -> bool {
        let mut connections = self.live.iter().filter(|c| self.components[c.joint.a.get()] == component).peekable();
        let Some(first) = connections.peek() else { return false };
        let was_spared = first.is_spared;
        connections.all(|c| c.is_spared == was_spared && c.snap_left == 0)
            && self.has_room(engine, component, if was_spared { ROOM_M } else { ROOM_TO_LEAVE_M })
            && self.fits(engine, component, if was_spared { 1.0 } else { 0.5 })
    }

    /// Returns whether nothing can touch the component in the coming substep.
    fn has_room(&self, engine: &Engine, component: usize, room: f32) -> bool {
        let reach = BlockIdx::array(|block| {
            let velocity = engine.velocity(block);
            (velocity.linear.norm() + velocity.angular.norm() * self.table.radius(block)) * engine.substep_s()
        });
        let is_member = |block: &BlockIdx| self.components[block.get()] == component;
        BlockIdx::all().filter(is_member).all(|a| {
            let i = a.get();
            let frame = &self.frames[i];
            self.table.bottom(a, frame) > room + reach[i]
                && BlockIdx::all().filter(|b| !is_member(b)).all(|b| {
                    let j = b.get();
                    !self.table.may_touch((a, frame), (b, &self.frames[j]), room + reach[i] + reach[j])
                })
        })
    }

    /// Returns whether the component's blocks are at their joints' targets to within a `share` of the limits.
    fn fits(&self, engine: &Engine, component: usize, share: f32) -> bool {
        self.live.iter().filter(|c| self.components[c.joint.a.get()] == component).all(|c| {
            let seen = engine.pose(c.joint.a).inv_mul(&engine.pose(c.joint.b));
            let turn = c.b_in_a.rotation.inverse() * seen.rotation;
            (seen.translation.vector - c.b_in_a.translation.vector).norm() < share * FIT_M
                // The norm is the sine of half the angle.
                && turn.imag().norm() < 0.5 * share * FIT_RAD
        })
    }
}
