//! Synthetic trajectories for the unit tests.

use blueprints::{BlockIdx, BlueprintId, N_BLOCKS};
use proto::{
    Action, ActorId, CanonicalSettings, Pose, RewardTerms, Scene, Start, Status, Task, Trajectory, Transition,
    WeightsVersion,
};
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};

/// Returns the id of a blueprint in the built-in catalog.
pub(crate) fn blueprint_id() -> BlueprintId {
    BlueprintId::try_from("2_000".to_owned()).unwrap()
}

/// Returns a segment of `n_steps` steps from weights `version`, with varying scenes and no reward.
pub(crate) fn trajectory(n_steps: usize, version: u64) -> Trajectory {
    random_trajectory(n_steps, version, &mut ChaCha8Rng::seed_from_u64(version))
}

/// Like [`trajectory`], but draws scenes and actions from `rng`.
pub(crate) fn random_trajectory(n_steps: usize, version: u64, rng: &mut ChaCha8Rng) -> Trajectory {
    let transitions = (0..n_steps)
        .map(|_| Transition {
            scene: scene(rng),
            action: action(rng),
            proposals: [None; 2],
            behavior_log_prob: -10.0,
            reward: RewardTerms::default(),
            disturbance: None,
        })
        .collect();
    Trajectory {
        actor: ActorId::try_from("fixture".to_owned()).unwrap(),
        epoch: 0,
        seq: rng.random(),
        weights_version: WeightsVersion(version),
        settings_hash: CanonicalSettings::default().hash(),
        task: Task {
            blueprint: blueprint_id(),
            assignment: BlockIdx::array(|block| block),
            start: Start::Scattered,
            seed: 1,
        },
        behavior_policy: proto::BehaviorPolicy::Sampled,
        first_step: 0,
        transitions,
        last_scene: scene(rng),
        status: Status::Running,
        episode_stats: None,
    }
}

/// Returns a scene with blocks at random positions on the ground, none of them held.
pub(crate) fn scene(rng: &mut ChaCha8Rng) -> Scene {
    Scene::at_rest(std::array::from_fn(|_| Pose {
        position: [rng.random_range(-1.0..1.0), rng.random_range(-1.0..1.0), 0.05],
        orientation: [0.0, 0.0, 0.0, 1.0],
    }))
}

fn action(rng: &mut ChaCha8Rng) -> Action {
    let mut choice = || BlockIdx::try_from(rng.random_range(0..N_BLOCKS as u8)).ok();
    let choices = [choice(), choice()];
    Action { choices, moves: std::array::from_fn(|_| std::array::from_fn(|_| rng.random_range(-1.0..1.0))) }
}
