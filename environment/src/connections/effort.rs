//! How little the solver has to do in a substep.

use blueprints::{BlockIdx, N_BLOCKS};
use proto::N_GRIPPERS;

use super::{Connection, Connections, block_array};
use crate::engine::Engine;

/// Blocks from which on a structure can sag or slide.
const STRUCTURE_BLOCKS: usize = 4;
/// Blocks from which on it does so in substeps of 20 ms: `3_013` would move by 2.7 cm in two seconds.
const MERGED_BLOCKS: usize = 3;
/// Room around what is carried, beyond what all move in a substep, up to which its joints stay out of the solver, m.
const ROOM_M: f32 = 0.01;
/// Room that lets them leave it; more, so that they do not come and go in every substep, m.
const ROOM_TO_LEAVE_M: f32 = 0.03;
/// Distance of a joint's second block from its place, as seen from the first, up to which the joint stays out of the
/// solver, m.
const FIT_M: f32 = 0.001;
/// The same for the angle, rad.
const FIT_RAD: f32 = 0.01;

impl Connections {
    /// Leaves joints that carry nothing out of the solver and tells it how hard to work; to be called before a substep,
    /// after the grippers have set what they hold in motion.
    ///
    /// `carried` are blocks that move as one rigid body with all that hangs on them, without weight. Until something
    /// touches such a body, its joints would only confirm what it does already.
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

    /// Whether substeps may be merged: nothing stands that long ones let sag.
    pub(crate) fn may_merge(&self, engine: &Engine) -> bool {
        self.largest_structure(engine) < MERGED_BLOCKS
    }

    /// Most blocks that hang together, awake and by joints that the solver works on; 0 if none do.
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

    /// Whether nothing can touch the component in the coming substep.
    fn has_room(&self, engine: &Engine, component: usize, room: f32) -> bool {
        let reach = block_array(|block| {
            let velocity = engine.velocity(block);
            (velocity.linear.norm() + velocity.angular.norm() * self.table.radius(block)) * engine.substep_s()
        });
        let is_member = |block: &BlockIdx| self.components[block.get()] == component;
        BlockIdx::all().filter(is_member).all(|a| {
            let (i, frame) = (a.get(), &self.frames[a.get()]);
            self.table.bottom(a, frame) > room + reach[i]
                && BlockIdx::all().filter(|b| !is_member(b)).all(|b| {
                    let j = b.get();
                    !self.table.may_touch((a, frame), (b, &self.frames[j]), room + reach[i] + reach[j])
                })
        })
    }

    /// Whether the component's blocks are where its joints want them, to within a `share` of the limits.
    fn fits(&self, engine: &Engine, component: usize, share: f32) -> bool {
        self.live.iter().filter(|c| self.components[c.joint.a.get()] == component).all(|c| {
            let seen = engine.pose(c.joint.a).inv_mul(&engine.pose(c.joint.b));
            let turn = c.b_in_a.rotation.inverse() * seen.rotation;
            (seen.translation.vector - c.b_in_a.translation.vector).norm() < share * FIT_M
                // The sine of half the angle.
                && turn.imag().norm() < 0.5 * share * FIT_RAD
        })
    }
}
