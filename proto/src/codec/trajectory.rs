//! Trajectories.

use blueprints::{BlockIdx, Inventory, N_BLOCKS};
use prost::Message;

use super::check::{array, block, blueprint_id, invalid, narrow, number, present};
use super::scene::{
    action_from_wire, action_to_wire, reward_from_wire, reward_to_wire, scene_from_wire, scene_to_wire,
};
use super::scene::{label_from_wire, label_to_wire};
use super::{DecodeError, PROTOCOL_VERSION, check_size, check_version, elements, parse};
use crate::{ActorId, Driver, Outcome, Scene, Start, Status, Task, Trajectory, Transition, WeightsVersion, wire};

/// Maximum length of a segment, in steps.
pub const MAX_SEGMENT_STEPS: usize = 1000;

/// Maximum size of an encoded trajectory, in bytes: 1001 scenes with all possible joints.
pub const MAX_TRAJECTORY_BYTES: usize = 8 << 20;

/// Number of the field `transitions` of `Trajectory`.
const TRANSITIONS: u32 = 8;

/// Encodes a trajectory.
pub fn encode_trajectory(trajectory: &Trajectory) -> Vec<u8> {
    wire::Trajectory {
        protocol_version: PROTOCOL_VERSION,
        actor: trajectory.actor.as_str().to_owned(),
        epoch: trajectory.epoch,
        seq: trajectory.seq,
        weights_version: trajectory.weights_version.0,
        task: Some(task_to_wire(&trajectory.task)),
        first_step: trajectory.first_step.into(),
        transitions: trajectory.transitions.iter().map(transition_to_wire).collect(),
        last_scene: Some(scene_to_wire(&trajectory.last_scene)),
        status: status_to_wire(trajectory.status).into(),
        bootstrap_value: trajectory.bootstrap_value,
        outcome: trajectory.outcome.as_ref().map(|outcome| wire::Outcome {
            success: outcome.success,
            n_steps: outcome.n_steps.into(),
            episode_return: Some(reward_to_wire(&outcome.episode_return)),
        }),
        driver: match trajectory.driver {
            Driver::Sampled => wire::Driver::Sample,
            Driver::Greedy => wire::Driver::Mode,
            Driver::Expert => wire::Driver::Expert,
        }
        .into(),
        n_burn_in_steps: trajectory.n_burn_in_steps.into(),
    }
    .encode_to_vec()
}

/// Decodes a trajectory and checks every rule that [`Trajectory`] documents.
///
/// # Errors
/// The error names the first field that breaks a rule, and its value.
pub fn decode_trajectory(bytes: &[u8]) -> Result<Trajectory, DecodeError> {
    check_size("Trajectory", bytes.len(), MAX_TRAJECTORY_BYTES)?;
    elements("Trajectory", ("transitions", TRANSITIONS), bytes, (MAX_SEGMENT_STEPS, "1 to 1000 steps"))?;
    let message: wire::Trajectory = parse("Trajectory", bytes, MAX_TRAJECTORY_BYTES)?;
    check_version(message.protocol_version)?;
    let n_transitions = message.transitions.len();
    if !(1..=MAX_SEGMENT_STEPS).contains(&n_transitions) {
        return Err(invalid("transitions", format!("{n_transitions} steps"), "1 to 1000 steps"));
    }
    let trajectory = Trajectory {
        actor: ActorId::try_from(message.actor).map_err(|e| invalid("actor", e.0, "1 to 64 of a-z, 0-9 and -"))?,
        epoch: message.epoch,
        seq: message.seq,
        weights_version: WeightsVersion(message.weights_version),
        task: task_from_wire(present("task", message.task)?)?,
        first_step: narrow("first_step", message.first_step, "a number in 0..=65535")?,
        n_burn_in_steps: narrow("n_burn_in_steps", message.n_burn_in_steps, "a number in 0..=65535")?,
        transitions: message.transitions.into_iter().map(transition_from_wire).collect::<Result<_, _>>()?,
        last_scene: scene_from_wire(present("last_scene", message.last_scene)?)?,
        status: status_from_wire(message.status)?,
        bootstrap_value: number("bootstrap_value", message.bootstrap_value)?,
        outcome: message.outcome.map(outcome_from_wire).transpose()?,
        driver: match wire::Driver::try_from(message.driver) {
            Ok(wire::Driver::Sample) => Driver::Sampled,
            Ok(wire::Driver::Mode) => Driver::Greedy,
            Ok(wire::Driver::Expert) => Driver::Expert,
            Err(_) => return Err(invalid("driver", message.driver, "sample, mode or expert")),
        },
    };
    check_grippers(&trajectory)?;
    check_ending(&trajectory)?;
    Ok(trajectory)
}

/// Checks that the grippers stay the same in all scenes, and that actions and labels have choices for exactly those.
fn check_grippers(trajectory: &Trajectory) -> Result<(), DecodeError> {
    let grippers = |scene: &Scene| scene.grippers.map(|g| g.is_some());
    let expected = grippers(&trajectory.last_scene);
    for transition in &trajectory.transitions {
        let found = grippers(&transition.scene);
        if found != expected {
            return Err(invalid("scene.gripper_1", format!("{found:?}"), "the same grippers in every scene"));
        }
        let chosen = transition.action.choices.map(|c| c.is_some());
        if chosen != expected {
            return Err(invalid(
                "action.choice",
                format!("{chosen:?}"),
                "a choice for exactly the grippers of the world",
            ));
        }
        let labeled = transition.label.map(|label| label.choices.map(|c| c.is_some()));
        if labeled.is_some_and(|labeled| labeled != expected) {
            let labeled = format!("{labeled:?}");
            return Err(invalid("label.choice", labeled, "a choice for exactly the grippers of the world"));
        }
    }
    Ok(())
}

fn check_ending(trajectory: &Trajectory) -> Result<(), DecodeError> {
    if ![0, trajectory.first_step].contains(&trajectory.n_burn_in_steps) {
        return Err(invalid("n_burn_in_steps", trajectory.n_burn_in_steps, "0, or first_step on the first segment"));
    }
    let ended = trajectory.status != Status::Running;
    let Some(outcome) = trajectory.outcome else {
        return if ended { Err(DecodeError::Missing { field: "outcome" }) } else { Ok(()) };
    };
    if !ended {
        return Err(invalid("outcome", "present", "none before the episode's end"));
    }
    let n_steps = usize::from(trajectory.first_step) + trajectory.transitions.len();
    if usize::from(outcome.n_steps) != n_steps {
        return Err(invalid("outcome.n_steps", outcome.n_steps, "first_step plus the number of transitions"));
    }
    if trajectory.status == Status::Success && !outcome.success {
        return Err(invalid("outcome.success", false, "true when the status is success"));
    }
    if trajectory.status == Status::Success && trajectory.bootstrap_value != 0.0 {
        return Err(invalid("bootstrap_value", trajectory.bootstrap_value, "0 after success"));
    }
    Ok(())
}

pub(super) fn task_to_wire(task: &Task) -> wire::Task {
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

pub(super) fn task_from_wire(task: wire::Task) -> Result<Task, DecodeError> {
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
        if std::mem::replace(&mut seen[block.get()], true) {
            return Err(invalid(field, format!("block {index} twice"), "a permutation of 0..16"));
        }
        if !Inventory::standard().same_type(role).any(|other| other == block) {
            return Err(invalid(field, format!("block {index} for block {}", role.get()), "a block of the same type"));
        }
        assignment.push(block);
    }
    array(field, &assignment)
}

fn transition_to_wire(transition: &Transition) -> wire::Transition {
    wire::Transition {
        scene: Some(scene_to_wire(&transition.scene)),
        action: Some(action_to_wire(&transition.action)),
        behavior_log_prob: transition.behavior_log_prob,
        value: transition.value,
        reward: Some(reward_to_wire(&transition.reward)),
        label: transition.label.as_ref().map(label_to_wire),
    }
}

fn transition_from_wire(transition: wire::Transition) -> Result<Transition, DecodeError> {
    Ok(Transition {
        scene: scene_from_wire(present("transition.scene", transition.scene)?)?,
        action: action_from_wire(present("transition.action", transition.action)?)?,
        behavior_log_prob: number("transition.behavior_log_prob", transition.behavior_log_prob)?,
        value: number("transition.value", transition.value)?,
        reward: reward_from_wire(present("transition.reward", transition.reward)?)?,
        label: transition.label.map(label_from_wire).transpose()?,
    })
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

fn outcome_from_wire(outcome: wire::Outcome) -> Result<Outcome, DecodeError> {
    Ok(Outcome {
        success: outcome.success,
        n_steps: narrow("outcome.n_steps", outcome.n_steps, "a number in 0..=65535")?,
        episode_return: reward_from_wire(present("outcome.episode_return", outcome.episode_return)?)?,
    })
}
