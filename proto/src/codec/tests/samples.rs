//! Sample values for tests and the golden bytes; most fields differ from their defaults.

use blueprints::{BlockIdx, CubeRotation, N_BLOCKS, RelativePlacement};
use proto::{
    Action, BehaviorPolicy, CanonicalSettings, EpisodeStats, Gripper, Joint, Normalization, Pose, RewardTerms, Scene,
    Start, Status, Task, Trajectory, Transition, Weights, WeightsVersion,
};

pub(crate) fn block(index: u8) -> BlockIdx {
    BlockIdx::try_from(index).unwrap()
}

pub(crate) fn scene(height: f32) -> Scene {
    let gripper = |held: Option<u8>| Gripper {
        held: held.map(block),
        orientation: [0.0, 0.0, 0.6, 0.8],
        linear_velocity: [0.25, -0.5, 1.0],
        angular_velocity: [0.0, 2.0, -3.0],
    };
    Scene {
        blocks: std::array::from_fn(|i| Pose {
            position: [0.125 * i as f32, -0.5, height],
            orientation: [0.0, 0.6, 0.0, 0.8],
        }),
        speeds_mps: std::array::from_fn(|i| 0.0625 * i as f32),
        joints: vec![joint(0, 4, 1), joint(0, 5, 23), joint(3, 15, 0)],
        grippers: [Some(gripper(Some(4))), Some(gripper(None))],
        n_heavy_contacts: 3,
    }
}

fn joint(a: u8, b: u8, rotation: u8) -> Joint {
    let rotation = CubeRotation::try_from(rotation).unwrap();
    Joint { a: block(a), b: block(b), relative: RelativePlacement { offset_half_units: [2, -1, 0], rotation } }
}

/// Returns two steps, cut before the episode's end.
pub(crate) fn running(actor: &str, seq: u64) -> Trajectory {
    let transition = |height: f32| Transition {
        scene: scene(height),
        action: Action {
            choices: [Some(block(4)), Some(block(0))],
            moves: std::array::from_fn(|i| [i as f32, -1.5, 0.25, 0.0, 0.5, -0.75]),
        },
        proposals: [Some(3), None],
        behavior_log_prob: -7.5,
        reward: RewardTerms { connected: 1.0, wrong: -1.0, magnets: 0.5, blocks: -0.25, force: -0.125 },
        disturbance: None,
    };
    Trajectory {
        actor: actor.parse().unwrap(),
        epoch: 1_700_000_000_000,
        seq,
        weights_version: WeightsVersion(12),
        settings_hash: settings().hash(),
        task: Task {
            blueprint: "3_001".parse().unwrap(),
            // Swaps blocks 0 and 1, which have the same type.
            assignment: std::array::from_fn(|i| block([1, 0].get(i).copied().unwrap_or(i as u8))),
            start: Start::Prebuilt("2_004".parse().unwrap()),
            seed: 99,
        },
        behavior_policy: proto::BehaviorPolicy::Sampled,
        first_step: 40,
        transitions: vec![transition(0.5), transition(0.75)],
        last_scene: scene(1.0),
        status: Status::Running,
        episode_stats: None,
    }
}

/// Returns the same trajectory, ended by success.
pub(crate) fn successful(actor: &str, seq: u64) -> Trajectory {
    Trajectory {
        status: Status::Success,
        episode_stats: Some(EpisodeStats {
            success: true,
            n_steps: 42,
            episode_return: RewardTerms { connected: 2.0, wrong: -3.0, magnets: 0.5, blocks: 0.25, force: -1.0 },
        }),
        ..running(actor, seq)
    }
}

/// Returns the same trajectory in a world with one gripper.
pub(crate) fn one_gripper(actor: &str, seq: u64) -> Trajectory {
    let mut trajectory = running(actor, seq);
    trajectory.last_scene.grippers[1] = None;
    for transition in &mut trajectory.transitions {
        transition.scene.grippers[1] = None;
        transition.action.choices[1] = None;
    }
    trajectory
}

/// Returns the same trajectory, driven by the expert.
pub(crate) fn of_expert(actor: &str, seq: u64) -> Trajectory {
    Trajectory { behavior_policy: BehaviorPolicy::Expert, ..running(actor, seq) }
}

pub(crate) fn settings() -> CanonicalSettings {
    CanonicalSettings::parse("environment.episode_steps = 100\npolicy.mask = \"none\"\n").unwrap()
}

pub(crate) fn weights(version: u64) -> Weights {
    let probabilities = [("2_001", 0.25), ("2_002", 0.5), ("16_001", 0.25)];
    Weights {
        version: WeightsVersion(version),
        n_env_steps: 4096,
        network_hash: 0xfeed_beef,
        settings: settings(),
        parameters: (0..N_BLOCKS).map(|i| i as f32 - 7.5).collect(),
        normalization: Normalization {
            feature_mean: [vec![1.0, 2.0], vec![-1.0], vec![]],
            feature_std: [vec![0.5, 0.25], vec![4.0], vec![]],
            value_mean: -2.0,
            value_std: 3.0,
        },
        task_probabilities: probabilities.map(|(id, p)| (id.parse().unwrap(), p)).into(),
    }
}
