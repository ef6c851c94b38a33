//! A scripted controller that builds blueprints through the policy's action space, from privileged state.
//!
//! It is memoryless: its action depends only on the scene, including what the grippers hold, and the blueprint, so that
//! a policy can learn to imitate it. The assembly order is computed once per blueprint and cached.
//!
//! In order, it takes wrong connections apart, sets the base (the piece to build on) down where there is room, and lets
//! each gripper fetch a block and bring it in along a free path. Meanwhile, the structure stands on the ground on its
//! own.

mod agent;
mod jobs;
mod motion;
mod site;
mod takedown;
mod view;

use blueprints::assembly::Parts;
use blueprints::{Assembly, BlockIdx, Blueprint, NoAssembly, UNIT_M};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use proto::{Action, Scene};

use crate::config::EnvironmentConfig;
use motion::{Limits, Load, Twist};
use view::View;

pub use agent::ExpertAgent;

/// Maximum tilt that counts as upright, rad.
const MAX_TILT_RAD: f32 = 0.15;
/// Maximum distance from the ground at which a structure counts as standing on it, m.
const MAX_LIFT_M: f32 = 0.03;

/// How far ahead the base is carried at a time when there is no room, m; farther than one step.
const STRIDE_M: f32 = 0.6;
/// Depth to which a single block is pressed into the ground, m.
const PRESS_M: f32 = 0.02;

/// The scripted expert for one blueprint.
#[derive(Clone, Debug)]
pub struct Expert {
    blueprint: Blueprint,
    assembly: Assembly,
    limits: Limits,
    n_grippers: usize,
}

/// Command to one gripper for a step.
#[derive(Clone, Copy, Debug)]
struct Command {
    block: BlockIdx,
    twist: Twist,
}

/// The piece to which everything else is added.
struct Base {
    side: usize,
    parts: Parts,
    /// Pose of the blueprint's frame implied by this piece.
    frame: Isometry3<f32>,
}

impl Expert {
    /// Creates an expert for `blueprint`, with the blocks of the episode's assignment, in worlds of this configuration.
    ///
    /// # Errors
    /// If the blueprint has no assembly order.
    pub fn new(config: &EnvironmentConfig, blueprint: &Blueprint) -> Result<Self, NoAssembly> {
        Ok(Self {
            assembly: Assembly::new(blueprint)?,
            blueprint: blueprint.clone(),
            limits: Limits::new(config),
            n_grippers: usize::from(config.n_grippers),
        })
    }

    /// Returns the action for `scene`.
    pub fn act(&mut self, scene: &Scene) -> Action {
        let view = View::new(scene, &self.blueprint, self.assembly.blocks());
        let commands = self.commands(&view);
        self.action(&view, &commands)
    }

    fn commands(&mut self, view: &View) -> Vec<Command> {
        if let Some(commands) = self.take_down(view) {
            return commands;
        }
        match self.base(view) {
            Err(piece) => self.shrink(view, piece),
            Ok(base) => match self.settle(view, &base) {
                Some(command) => vec![command],
                None => self.add(view, &base),
            },
        }
    }

    /// Returns the piece to build on: the largest that can be completed, or the first block if no two are connected.
    ///
    /// The error is the largest piece if none can be completed on any side.
    fn base(&mut self, view: &View) -> Result<Base, Parts> {
        let mut pieces: Vec<Parts> = view.pieces().filter(|piece| piece.len() > 1).collect();
        // Among equals, the piece with the lowest part comes first.
        pieces.sort_by_key(|piece| std::cmp::Reverse(piece.len()));
        for &parts in &pieces {
            let mut sides = 0..self.assembly.n_sides();
            if let Some(side) = sides.find(|&side| self.assembly.is_safe(side, parts)) {
                return Ok(Base { side, parts, frame: self.frame(view, side, parts) });
            }
        }
        if let Some(&piece) = pieces.first() {
            return Err(piece);
        }
        let first = self.assembly.next(0, Parts::default()).unwrap_or(0);
        let parts = Parts::one(first);
        Ok(Base { side: 0, parts, frame: self.frame(view, 0, parts) })
    }

    /// Returns the pose of the blueprint's frame implied by the bottom part that lies best; others may sag.
    fn frame(&self, view: &View, side: usize, parts: Parts) -> Isometry3<f32> {
        let bottom = parts.iter().filter(|&part| self.assembly.is_at_bottom(side, part));
        let frames = bottom.map(|part| self.frame_of(view, part));
        let best = frames.min_by(|a, b| self.unrest(a, side).total_cmp(&self.unrest(b, side)));
        best.or_else(|| parts.iter().next().map(|part| self.frame_of(view, part))).unwrap_or_else(Isometry3::identity)
    }

    /// Returns how far a frame is from lying on its side: 1 at the limit of tilt or height.
    fn unrest(&self, frame: &Isometry3<f32>, side: usize) -> f32 {
        let tilt = (frame.rotation * self.up(side)).angle(&Vector3::z());
        (tilt / MAX_TILT_RAD).max(self.lift_m(frame, side).abs() / MAX_LIFT_M)
    }

    fn frame_of(&self, view: &View, part: usize) -> Isometry3<f32> {
        view.pose(self.block(part)) * self.place(part).inverse()
    }

    /// Returns the pose of a part in the blueprint's frame.
    fn place(&self, part: usize) -> Isometry3<f32> {
        let placement = self.blueprint.placement(self.block(part)).expect("every part is a block of the blueprint");
        Isometry3::from_parts(placement.position_m().into(), placement.rotation.quaternion())
    }

    fn block(&self, part: usize) -> BlockIdx {
        self.assembly.blocks()[part]
    }

    fn up(&self, side: usize) -> Vector3<f32> {
        Vector3::from(self.assembly.up(side).map(|x| x as f32))
    }

    /// Returns the height above the ground of the plane on which the structure should lie, m.
    fn lift_m(&self, frame: &Isometry3<f32>, side: usize) -> f32 {
        let plane = self.up(side) * (self.assembly.ground_half_units(side) as f32 * UNIT_M / 2.0);
        // The point of the plane below the frame's origin, if the tilt is small.
        (frame * nalgebra::Point3::from(plane)).z
    }

    /// Returns the frame turned upright by the smallest rotation and set on the ground with its origin at `xy`.
    fn set_down(&self, frame: &Isometry3<f32>, side: usize, xy: [f32; 2]) -> Isometry3<f32> {
        let up = frame.rotation * self.up(side);
        let level = UnitQuaternion::rotation_between(&up, &Vector3::z())
            .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f32::consts::PI));
        let rotation = level * frame.rotation;
        let z = -(self.assembly.ground_half_units(side) as f32) * UNIT_M / 2.0;
        Isometry3::from_parts(Translation3::new(xy[0], xy[1], z), rotation)
    }

    /// Carries the base to free ground and sets it down on its side, unless it already lies there.
    fn settle(&self, view: &View, base: &Base) -> Option<Command> {
        let lies = self.unrest(&base.frame, base.side) <= 1.0;
        let gripped = self.gripped(view, base.parts);
        let is_fetched = |block: &BlockIdx| view.part_of[block.get()].is_some_and(|part| !base.parts.contains(part));
        let fetching = view.held.iter().flatten().any(is_fetched);
        // Once blocks are on their way, the base stays, or it would flee from them.
        if lies && (fetching || base.parts.len() > 2) {
            return None;
        }
        let push = self.push(view, base);
        if lies && push.is_none() {
            return None;
        }
        let [x, y] = self.middle(&base.frame, base.side);
        let step = push.unwrap_or_default() * STRIDE_M;
        let frame = self.frame_at(&base.frame, base.side, [x + step.x, y + step.y]);
        let part = view.part_of[gripped.get()]?;
        let load = Load::new(view, gripped);
        let mut target = frame * self.place(part);
        // A sagging structure would go into the ground. A single block is pressed into it to make sure that it lies
        // flat.
        target.translation.z += (-load.lowest_m(view, &target)).max(0.0);
        if base.parts.len() == 1 {
            target.translation.z -= PRESS_M;
        }
        // Lift a base that is turned over, or the ground would be in its way.
        let tilt = (base.frame.rotation * self.up(base.side)).angle(&Vector3::z());
        target.translation.z += load.radius_m(view) * tilt.min(1.0);
        let twist = if push.is_some() {
            load.go(view, &self.limits, &target)
        } else {
            self.limits.toward(view.pose(gripped), &target)
        };
        Some(Command { block: gripped, twist })
    }

    /// Returns the block by which to grip a piece: one that is already held, or else its first.
    fn gripped(&self, view: &View, parts: Parts) -> BlockIdx {
        let mut blocks = parts.iter().map(|part| self.block(part));
        let first = blocks.next().expect("a piece is not empty");
        std::iter::once(first).chain(blocks).find(|&block| view.is_held(block)).unwrap_or(first)
    }

    /// Assigns the commands: a gripper that holds a commanded block keeps it, and a spare gripper joins the first
    /// command.
    fn action(&self, view: &View, commands: &[Command]) -> Action {
        let mut action = Action::IDLE;
        let mut open: Vec<&Command> = commands.iter().take(self.n_grippers).collect();
        for gripper in 0..self.n_grippers {
            if let Some(i) = open.iter().position(|c| view.held[gripper] == Some(c.block)) {
                action.choices[gripper] = Some(open.remove(i).block);
            }
        }
        let any_block = || BlockIdx::all().next().expect("there are blocks");
        let shared = commands.first().map_or_else(any_block, |c| c.block);
        let mut open = open.into_iter();
        for choice in action.choices.iter_mut().take(self.n_grippers).filter(|choice| choice.is_none()) {
            *choice = Some(open.next().map_or(shared, |command| command.block));
        }
        for command in commands {
            let frame = &view.pose(command.block).rotation;
            let twist = self.limits.clipped(frame, command.twist);
            action.moves[command.block.get()] = self.limits.entry(frame, twist);
        }
        action
    }
}

#[cfg(test)]
mod tests;
