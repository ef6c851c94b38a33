//! Trajectories.

use blueprints::hash::fnv1a;
use blueprints::{BlockIdx, Inventory, N_BLOCKS};
use prost::Message;
use prost::encoding::{WireType, decode_key, decode_varint};

use super::check::{array, block, blueprint_id, ensure, invalid, narrow, number, numbers, present};
use super::scene::{
    action_from_wire, action_to_wire, reward_from_wire, reward_to_wire, scene_from_wire, scene_to_wire,
};
use super::{DecodeError, PROTOCOL_VERSION, check_count, check_size, check_version, parse};
use crate::{
    ActorId, BehaviorPolicy, Disturbance, EpisodeStats, N_GRIPPERS, Scene, Start, Status, Task, Trajectory, Transition,
    WeightsVersion, wire,
};

/// Maximum length of a segment, in steps.
pub const MAX_SEGMENT_STEPS: usize = 1000;

/// Maximum size of an encoded trajectory, in bytes: 1001 scenes with all possible joints.
pub const MAX_TRAJECTORY_BYTES: usize = 8 << 20;

/// Maximum size of a recorded trajectory, in bytes: the same and its checksum.
pub const MAX_RECORDING_BYTES: usize = MAX_TRAJECTORY_BYTES + 9;

/// Number of bytes that hold the beginning of every valid trajectory: two tags, a version, a length, and a name.
pub const TRAJECTORY_HEADER_BYTES: usize = 96;

/// The name in errors.
const MESSAGE: &str = "Trajectory";

/// Number of the field `transitions` of `Trajectory`.
const TRANSITIONS: u32 = 8;

/// The byte before a checksum: number 15 and wire type 1 (64 bits) of the field `checksum` of `Trajectory`.
const CHECKSUM_KEY: u8 = 15 << 3 | 1;

/// The first bytes of a recording of protocol version 1.
const FIRST_VERSION: [u8; 2] = [0x08, 0x01];

/// Encodes a trajectory.
pub fn encode_trajectory(trajectory: &Trajectory) -> Vec<u8> {
    wire::Trajectory {
        protocol_version: PROTOCOL_VERSION,
        actor: trajectory.actor.as_str().to_owned(),
        epoch: trajectory.epoch,
        seq: trajectory.seq,
        weights_version: trajectory.weights_version.0,
        settings_hash: trajectory.settings_hash,
        task: Some(task_to_wire(&trajectory.task)),
        first_step: trajectory.first_step.into(),
        transitions: trajectory.transitions.iter().map(transition_to_wire).collect(),
        last_scene: Some(scene_to_wire(&trajectory.last_scene)),
        status: status_to_wire(trajectory.status).into(),
        episode_stats: trajectory.episode_stats.as_ref().map(|stats| wire::EpisodeStats {
            success: stats.success,
            n_steps: stats.n_steps.into(),
            episode_return: Some(reward_to_wire(&stats.episode_return)),
        }),
        behavior_policy: match trajectory.behavior_policy {
            BehaviorPolicy::Sampled => wire::BehaviorPolicy::Sampled,
            BehaviorPolicy::Greedy => wire::BehaviorPolicy::Greedy,
            BehaviorPolicy::Expert => wire::BehaviorPolicy::Expert,
        }
        .into(),
        checksum: None,
    }
    .encode_to_vec()
}

/// Encodes a trajectory for a file: as for the bus, and the field `checksum` last.
pub fn encode_recording(trajectory: &Trajectory) -> Vec<u8> {
    let mut bytes = encode_trajectory(trajectory);
    let checksum = fnv1a(bytes.iter().copied());
    bytes.push(CHECKSUM_KEY);
    bytes.extend(checksum.to_le_bytes());
    bytes
}

/// Decodes a trajectory and checks every rule that [`Trajectory`] documents.
///
/// # Errors
/// The error names the first field that breaks a rule, and its value.
pub fn decode_trajectory(bytes: &[u8]) -> Result<Trajectory, DecodeError> {
    let message = message(bytes, MAX_TRAJECTORY_BYTES)?;
    check_version(message.protocol_version)?;
    from_wire(message)
}

/// Decodes a trajectory from a file and checks that its bytes are those that [`encode_recording`] wrote. Recordings of
/// protocol version 1, which have no checksum, are read as well.
///
/// # Errors
/// As for [`decode_trajectory`], and if the checksum is missing or wrong.
pub fn decode_recording(bytes: &[u8]) -> Result<Trajectory, DecodeError> {
    let is_first_version = bytes.starts_with(&FIRST_VERSION);
    let verify = |found: u64, expected: u64| match found == expected {
        true => Ok(()),
        false => Err(DecodeError::Checksum(found, expected)),
    };
    let sums = checksums(bytes);
    // The end of a recording of version 1 may look like a checksum by chance.
    if let Some((found, expected)) = sums.filter(|_| !is_first_version) {
        verify(found, expected)?;
    }
    let message = message(bytes, MAX_RECORDING_BYTES)?;
    if is_first_version && message.protocol_version == 1 && message.checksum.is_none() {
        return from_wire(message);
    }
    let (found, expected) = sums.ok_or(DecodeError::Missing("checksum"))?;
    verify(found, expected)?;
    check_version(message.protocol_version)?;
    from_wire(message)
}

/// Returns the actor that a trajectory names, from its first [`TRAJECTORY_HEADER_BYTES`] or more. Looks at nothing
/// else, so it takes the same few nanoseconds for every message, and most garbage fails here.
///
/// # Errors
/// If the bytes do not begin with this protocol's version and a name, as [`encode_trajectory`] and every other
/// protobuf encoder write them.
pub fn trajectory_actor(mut bytes: &[u8]) -> Result<&str, DecodeError> {
    let malformed = |error| DecodeError::Malformed(MESSAGE, error);
    let tag = |bytes: &mut &[u8], wanted: (u32, WireType), field: &'static str| {
        if bytes.is_empty() || decode_key(bytes).map_err(malformed)? != wanted {
            return Err(DecodeError::Missing(field));
        }
        decode_varint(bytes).map_err(malformed)
    };
    let version = tag(&mut bytes, (1, WireType::Varint), "protocol_version")?;
    check_version(u32::try_from(version).unwrap_or(u32::MAX))?;
    let length = tag(&mut bytes, (2, WireType::LengthDelimited), "actor")?;
    let name = usize::try_from(length).ok().and_then(|length| bytes.get(..length));
    name.and_then(|name| str::from_utf8(name).ok()).ok_or(DecodeError::Missing("actor"))
}

/// Returns the checksum at the end of a recording and that of the bytes before; `None` if it does not end with one.
fn checksums(bytes: &[u8]) -> Option<(u64, u64)> {
    let (rest, found) = bytes.split_last_chunk::<8>()?;
    let (&key, rest) = rest.split_last()?;
    (key == CHECKSUM_KEY).then(|| (u64::from_le_bytes(*found), fnv1a(rest.iter().copied())))
}

fn message(bytes: &[u8], limit: usize) -> Result<wire::Trajectory, DecodeError> {
    check_size(MESSAGE, bytes.len(), limit)?;
    check_count(MESSAGE, ("transitions", TRANSITIONS), bytes, (MAX_SEGMENT_STEPS, "1 to 1000 steps"))?;
    parse(MESSAGE, bytes, limit)
}

fn from_wire(message: wire::Trajectory) -> Result<Trajectory, DecodeError> {
    let n_transitions = message.transitions.len();
    let has_steps = (1..=MAX_SEGMENT_STEPS).contains(&n_transitions);
    ensure(has_steps, "transitions", format_args!("{n_transitions} steps"), "1 to 1000 steps")?;
    let trajectory = Trajectory {
        actor: ActorId::try_from(message.actor).map_err(|e| invalid("actor", e.0, "1 to 64 of a-z, 0-9 and -"))?,
        epoch: message.epoch,
        seq: message.seq,
        weights_version: WeightsVersion(message.weights_version),
        settings_hash: message.settings_hash,
        task: task_from_wire(present("task", message.task)?)?,
        first_step: narrow("first_step", message.first_step, "a number in 0..=65535")?,
        transitions: message.transitions.into_iter().map(transition_from_wire).collect::<Result<_, _>>()?,
        last_scene: scene_from_wire(present("last_scene", message.last_scene)?)?,
        status: status_from_wire(message.status)?,
        episode_stats: message.episode_stats.map(stats_from_wire).transpose()?,
        behavior_policy: match wire::BehaviorPolicy::try_from(message.behavior_policy) {
            Ok(wire::BehaviorPolicy::Sampled) => BehaviorPolicy::Sampled,
            Ok(wire::BehaviorPolicy::Greedy) => BehaviorPolicy::Greedy,
            Ok(wire::BehaviorPolicy::Expert) => BehaviorPolicy::Expert,
            Err(_) => return Err(invalid("behavior_policy", message.behavior_policy, "sampled, greedy or expert")),
        },
    };
    check_grippers(&trajectory)?;
    check_ending(&trajectory)?;
    Ok(trajectory)
}

/// Checks that the grippers stay the same in all scenes, and that actions have choices for exactly those.
fn check_grippers(trajectory: &Trajectory) -> Result<(), DecodeError> {
    let grippers = |scene: &Scene| scene.grippers.map(|g| g.is_some());
    let expected = grippers(&trajectory.last_scene);
    for transition in &trajectory.transitions {
        let found = grippers(&transition.scene);
        ensure(found == expected, "scene.grippers", named(found), "the same grippers in every scene")?;
        let chosen = transition.action.choices.map(|c| c.is_some());
        let rule = "a choice for exactly the grippers of the world";
        ensure(chosen == expected, "action.choice", named(chosen), rule)?;
    }
    Ok(())
}

/// Names the grippers that are there.
fn named(grippers: [bool; N_GRIPPERS]) -> &'static str {
    match grippers {
        [true, true] => "both grippers",
        [true, false] => "gripper 0 alone",
        [false, true] => "gripper 1 alone",
        [false, false] => "no gripper",
    }
}

fn check_ending(trajectory: &Trajectory) -> Result<(), DecodeError> {
    let ended = trajectory.status != Status::Running;
    let Some(stats) = trajectory.episode_stats else {
        return if ended { Err(DecodeError::Missing("episode_stats")) } else { Ok(()) };
    };
    ensure(ended, "episode_stats", "present", "none before the episode's end")?;
    let are_all = usize::from(stats.n_steps) == usize::from(trajectory.first_step) + trajectory.transitions.len();
    ensure(are_all, "episode_stats.n_steps", stats.n_steps, "first_step plus the number of transitions")?;
    let agree = trajectory.status != Status::Success || stats.success;
    ensure(agree, "episode_stats.success", stats.success, "true when the status is success")
}

fn task_to_wire(task: &Task) -> wire::Task {
    use wire::task::Start as WireStart;
    wire::Task {
        blueprint: task.blueprint.to_string(),
        assignment: task.assignment.iter().map(|&block| u8::from(block)).collect(),
        start: Some(match &task.start {
            Start::Scattered => WireStart::Scattered(wire::Scattered {}),
            Start::Prebuilt(id) => WireStart::Prebuilt(wire::Prebuilt { blueprint: id.to_string() }),
            Start::NearGoal { undone } => WireStart::NearGoal(wire::NearGoal { undone: (*undone).into() }),
            Start::AsItIs => WireStart::AsItIs(wire::AsItIs {}),
        }),
        seed: task.seed,
    }
}

fn task_from_wire(task: wire::Task) -> Result<Task, DecodeError> {
    use wire::task::Start as WireStart;
    let start = match present("task.start", task.start)? {
        WireStart::Scattered(wire::Scattered {}) => Start::Scattered,
        WireStart::Prebuilt(prebuilt) => Start::Prebuilt(blueprint_id("task.start.blueprint", prebuilt.blueprint)?),
        WireStart::NearGoal(wire::NearGoal { undone: 0 }) => {
            return Err(invalid("task.start.undone", 0, "a number in 1..=255"));
        }
        WireStart::NearGoal(wire::NearGoal { undone }) => {
            Start::NearGoal { undone: narrow("task.start.undone", undone, "a number in 1..=255")? }
        }
        WireStart::AsItIs(wire::AsItIs {}) => Start::AsItIs,
    };
    Ok(Task {
        blueprint: blueprint_id("task.blueprint", task.blueprint)?,
        assignment: assignment_from_wire(&task.assignment)?,
        start,
        seed: task.seed,
    })
}

fn assignment_from_wire(bytes: &[u8]) -> Result<[BlockIdx; N_BLOCKS], DecodeError> {
    let field = "task.assignment";
    let indices: [u8; N_BLOCKS] = array(field, bytes)?;
    let mut seen = [false; N_BLOCKS];
    let mut assignment = Vec::with_capacity(N_BLOCKS);
    for (index, role) in indices.into_iter().zip(BlockIdx::all()) {
        let block = block(field, index.into())?;
        let is_new = !std::mem::replace(&mut seen[block.get()], true);
        ensure(is_new, field, format_args!("block {index} twice"), "a permutation of 0..16")?;
        let fits = Inventory::standard().same_type(role).any(|other| other == block);
        ensure(fits, field, format_args!("block {index} for block {}", role.get()), "a block of the same type")?;
        assignment.push(block);
    }
    array(field, &assignment)
}

fn transition_to_wire(transition: &Transition) -> wire::Transition {
    wire::Transition {
        scene: Some(scene_to_wire(&transition.scene)),
        action: Some(action_to_wire(&transition.action)),
        proposal_0: transition.proposals[0].map(u32::from),
        proposal_1: transition.proposals[1].map(u32::from),
        behavior_log_prob: transition.behavior_log_prob,
        reward: Some(reward_to_wire(&transition.reward)),
        disturbance: transition.disturbance.map(|disturbance| wire::Disturbance {
            block: u8::from(disturbance.block()).into(),
            displacement: disturbance.displacement_m().into(),
            push: disturbance.push_mps().into(),
        }),
    }
}

fn transition_from_wire(transition: wire::Transition) -> Result<Transition, DecodeError> {
    let proposal = |field, slot: Option<u32>| slot.map(|slot| narrow(field, slot, "a number in 0..=255")).transpose();
    Ok(Transition {
        scene: scene_from_wire(present("transition.scene", transition.scene)?)?,
        action: action_from_wire(present("transition.action", transition.action)?)?,
        proposals: [
            proposal("transition.proposal_0", transition.proposal_0)?,
            proposal("transition.proposal_1", transition.proposal_1)?,
        ],
        behavior_log_prob: number("transition.behavior_log_prob", transition.behavior_log_prob)?,
        reward: reward_from_wire(present("transition.reward", transition.reward)?)?,
        disturbance: transition.disturbance.map(disturbance_from_wire).transpose()?,
    })
}

fn disturbance_from_wire(disturbance: wire::Disturbance) -> Result<Disturbance, DecodeError> {
    let displacement_m = numbers("disturbance.displacement", &disturbance.displacement)?;
    let push_mps = numbers("disturbance.push", &disturbance.push)?;
    Disturbance::new(block("disturbance.block", disturbance.block)?, displacement_m, push_mps)
        .map_err(|error| invalid("disturbance", error, "at most 2 m and 5 m/s, and not nothing"))
}

fn status_to_wire(status: Status) -> wire::Status {
    match status {
        Status::Running => wire::Status::Running,
        Status::Success => wire::Status::Success,
        Status::TimeLimit => wire::Status::TimeLimit,
        // A diverged episode is never sent. If a caller sends one, every receiver refuses it.
        Status::Diverged => wire::Status::Unspecified,
    }
}

fn status_from_wire(status: i32) -> Result<Status, DecodeError> {
    match wire::Status::try_from(status) {
        Ok(wire::Status::Running) => Ok(Status::Running),
        Ok(wire::Status::Success) => Ok(Status::Success),
        Ok(wire::Status::TimeLimit) => Ok(Status::TimeLimit),
        Ok(wire::Status::Unspecified) | Err(_) => Err(invalid("status", status, "running, success or time limit")),
    }
}

fn stats_from_wire(stats: wire::EpisodeStats) -> Result<EpisodeStats, DecodeError> {
    Ok(EpisodeStats {
        success: stats.success,
        n_steps: narrow("episode_stats.n_steps", stats.n_steps, "a number in 0..=65535")?,
        episode_return: reward_from_wire(present("episode_stats.episode_return", stats.episode_return)?)?,
    })
}
