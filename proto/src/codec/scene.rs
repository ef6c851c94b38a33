//! Scenes, actions and rewards.

use blueprints::{CubeRotation, N_BLOCKS, RelativePlacement};

use super::DecodeError;
use super::check::{
    LARGEST_MAGNITUDE, array, block, ensure, invalid, narrow, number, numbers, present, unit_quaternion,
};
use crate::{Action, Gripper, Joint, N_GRIPPERS, Pose, RewardTerms, Scene, wire};

/// Number of values in a pose: position and orientation.
const POSE_LEN: usize = 7;
/// Number of values in a move: linear and angular velocity.
const MOVE_LEN: usize = 6;
/// Maximum offset along an axis between two touching blocks of at most 4 units, in half units.
const MAX_OFFSET_HALF_UNITS: i32 = 8;

pub(super) fn scene_to_wire(scene: &Scene) -> wire::Scene {
    let mut poses = Vec::with_capacity(N_BLOCKS * POSE_LEN);
    for pose in &scene.blocks {
        poses.extend_from_slice(&pose.position);
        poses.extend_from_slice(&pose.orientation);
    }
    let [gripper_0, gripper_1] = scene.grippers.each_ref().map(|g| g.as_ref().map(gripper_to_wire));
    wire::Scene {
        poses,
        speeds: scene.speeds_mps.to_vec(),
        joints: scene.joints.iter().map(joint_to_wire).collect(),
        gripper_0,
        gripper_1,
        n_heavy_contacts: scene.n_heavy_contacts.into(),
    }
}

pub(super) fn scene_from_wire(scene: wire::Scene) -> Result<Scene, DecodeError> {
    let poses: [f32; N_BLOCKS * POSE_LEN] = numbers("scene.poses", &scene.poses)?;
    let mut blocks = [Pose { position: [0.0; 3], orientation: [0.0, 0.0, 0.0, 1.0] }; N_BLOCKS];
    for (pose, values) in blocks.iter_mut().zip(poses.chunks_exact(POSE_LEN)) {
        pose.position = numbers("scene.poses", &values[..3])?;
        pose.orientation = unit_quaternion("scene.poses", &values[3..])?;
    }
    let speeds_mps: [f32; N_BLOCKS] = array("scene.speeds", &scene.speeds)?;
    for speed in speeds_mps {
        ensure((0.0..=LARGEST_MAGNITUDE).contains(&speed), "scene.speeds", speed, "a number in 0..=1e6")?;
    }
    let joints = scene.joints.into_iter().map(joint_from_wire).collect::<Result<Vec<_>, _>>()?;
    for [first, second] in joints.array_windows() {
        let [(a, b), (c, d)] = [first, second].map(|joint| (joint.a.get(), joint.b.get()));
        let pairs = format_args!("({a}, {b}) before ({c}, {d})");
        ensure((a, b) < (c, d), "scene.joints", pairs, "block pairs in rising order, each once")?;
    }
    let first = gripper_from_wire(present("scene.gripper_0", scene.gripper_0)?)?;
    Ok(Scene {
        blocks,
        speeds_mps,
        joints,
        grippers: [Some(first), scene.gripper_1.map(gripper_from_wire).transpose()?],
        n_heavy_contacts: narrow("scene.n_heavy_contacts", scene.n_heavy_contacts, "a number in 0..=255")?,
    })
}

fn joint_to_wire(joint: &Joint) -> wire::Joint {
    wire::Joint {
        a: u8::from(joint.a).into(),
        b: u8::from(joint.b).into(),
        offset: joint.relative.offset_half_units.to_vec(),
        rotation: u8::from(joint.relative.rotation).into(),
    }
}

fn joint_from_wire(joint: wire::Joint) -> Result<Joint, DecodeError> {
    let (a, b) = (block("joint.a", joint.a)?, block("joint.b", joint.b)?);
    ensure(a < b, "joint.b", joint.b, "a block index above joint.a")?;
    let offset_half_units: [i32; 3] = array("joint.offset", &joint.offset)?;
    for offset in offset_half_units {
        let is_near = (-MAX_OFFSET_HALF_UNITS..=MAX_OFFSET_HALF_UNITS).contains(&offset);
        ensure(is_near, "joint.offset", offset, "a number in −8..=8")?;
    }
    let rotation = u8::try_from(joint.rotation).ok().and_then(|rotation| CubeRotation::try_from(rotation).ok());
    let rotation = rotation.ok_or_else(|| invalid("joint.rotation", joint.rotation, "a number in 0..24"))?;
    Ok(Joint { a, b, relative: RelativePlacement { offset_half_units, rotation } })
}

fn gripper_to_wire(gripper: &Gripper) -> wire::Gripper {
    wire::Gripper {
        held: gripper.held.map(|block| u8::from(block).into()),
        orientation: gripper.orientation.to_vec(),
        linear_velocity: gripper.linear_velocity.to_vec(),
        angular_velocity: gripper.angular_velocity.to_vec(),
    }
}

fn gripper_from_wire(gripper: wire::Gripper) -> Result<Gripper, DecodeError> {
    Ok(Gripper {
        held: gripper.held.map(|index| block("gripper.held", index)).transpose()?,
        orientation: unit_quaternion("gripper.orientation", &gripper.orientation)?,
        linear_velocity: numbers("gripper.linear_velocity", &gripper.linear_velocity)?,
        angular_velocity: numbers("gripper.angular_velocity", &gripper.angular_velocity)?,
    })
}

pub(super) fn action_to_wire(action: &Action) -> wire::Action {
    let [choice_0, choice_1] = action.choices.map(|choice| choice.map(|block| u8::from(block).into()));
    wire::Action { choice_0, choice_1, moves: action.moves.as_flattened().to_vec() }
}

pub(super) fn action_from_wire(action: wire::Action) -> Result<Action, DecodeError> {
    let choice = |index: Option<u32>| index.map(|i| block("action.choice", i)).transpose();
    let choices: [_; N_GRIPPERS] = [choice(action.choice_0)?, choice(action.choice_1)?];
    let values: [f32; N_BLOCKS * MOVE_LEN] = numbers("action.moves", &action.moves)?;
    let mut moves = [[0.0; MOVE_LEN]; N_BLOCKS];
    moves.as_flattened_mut().copy_from_slice(&values);
    Ok(Action { choices, moves })
}

pub(super) fn reward_to_wire(reward: &RewardTerms) -> wire::Reward {
    let &RewardTerms { connected, wrong, magnets, blocks, force } = reward;
    wire::Reward { connected, wrong, magnets, blocks, force }
}

pub(super) fn reward_from_wire(reward: wire::Reward) -> Result<RewardTerms, DecodeError> {
    Ok(RewardTerms {
        connected: number("reward.connected", reward.connected)?,
        wrong: number("reward.wrong", reward.wrong)?,
        magnets: number("reward.magnets", reward.magnets)?,
        blocks: number("reward.blocks", reward.blocks)?,
        force: number("reward.force", reward.force)?,
    })
}
