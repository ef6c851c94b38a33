//! A world without physics for tests: nothing moves, and a script determines how each step ends.

use blueprints::{BlockIdx, Blueprint, BlueprintId, Catalog, N_BLOCKS};
use environment::{Env, ResetError, StepResult};
use policy::{EncoderConfig, GatConfig, Network, NetworkConfig, PolicyConfig};
use proto::{
    Action, ActorId, BehaviorPolicy, Gripper, Normalization, Pose, RewardTerms, Scene, Start, Status, Task, Trajectory,
    Transition, Valid, Weights, WeightsVersion,
};

use crate::segment::Identity;

/// Ends each step as scripted, over and over. Step `k` of the script gives the reward `k + 1` for connections.
pub(crate) struct Toy {
    script: Vec<Status>,
    n_steps: usize,
    scene: Scene,
    blueprint: Blueprint,
}

impl Toy {
    pub(crate) fn new(script: &[Status]) -> Self {
        let blueprint = Catalog::builtin().get(&id("2_000")).unwrap().clone();
        Self { script: script.to_vec(), n_steps: 0, scene: scene(), blueprint }
    }
}

impl Env for Toy {
    fn reset(&mut self, task: &Task, catalog: &Catalog) -> Result<(), ResetError> {
        let unknown = || ResetError::UnknownBlueprint(task.blueprint.clone());
        self.blueprint = catalog.get(&task.blueprint).ok_or_else(unknown)?.permuted(&task.assignment);
        Ok(())
    }

    fn step(&mut self, action: &Action) -> StepResult {
        let at = self.n_steps % self.script.len();
        self.n_steps += 1;
        // The scene records the action, so that different actions show in later scenes.
        self.scene.blocks[0].position[0] = action.moves[0][0];
        let reward = RewardTerms { connected: (at + 1) as f32, ..RewardTerms::default() };
        StepResult { reward, status: self.script[at] }
    }

    fn scene(&self) -> &Scene {
        &self.scene
    }

    fn blueprint(&self) -> &Blueprint {
        &self.blueprint
    }
}

pub(crate) fn id(name: &str) -> BlueprintId {
    BlueprintId::try_from(name.to_owned()).unwrap()
}

/// Returns a scene with the blocks in a row, one meter apart.
pub(crate) fn scene() -> Scene {
    Scene {
        blocks: std::array::from_fn(|i| Pose { position: [i as f32, 0.0, 0.05], orientation: [0.0, 0.0, 0.0, 1.0] }),
        speeds_mps: [0.0; N_BLOCKS],
        joints: Vec::new(),
        grippers: [Some(Gripper::IDLE), Some(Gripper::IDLE)],
        n_heavy_contacts: 0,
    }
}

pub(crate) fn task() -> Task {
    let mut blocks = blueprints::BlockIdx::all();
    let assignment = std::array::from_fn(|_| blocks.next().unwrap());
    Task { blueprint: id("2_000"), assignment, start: Start::Scattered, seed: 5 }
}

/// Returns a one-step segment from a different process than [`identity`]'s.
pub(crate) fn trajectory() -> Trajectory {
    let transition = Transition {
        scene: scene(),
        action: Action { choices: [BlockIdx::all().next(); 2], moves: [[0.0; 6]; N_BLOCKS] },
        proposals: [None; 2],
        behavior_log_prob: -1.0,
        reward: RewardTerms::default(),
        disturbance: None,
    };
    Trajectory {
        actor: identity().actor,
        epoch: 2,
        seq: 0,
        weights_version: WeightsVersion(0),
        settings_hash: 0,
        task: task(),
        behavior_policy: BehaviorPolicy::Sampled,
        first_step: 0,
        transitions: vec![transition],
        last_scene: scene(),
        status: Status::Running,
        episode_stats: None,
    }
}

pub(crate) fn identity() -> Identity {
    Identity { actor: ActorId::try_from("toy".to_owned()).unwrap(), epoch: 1, settings_hash: 0 }
}

/// Returns the configuration of a network small enough for tests.
pub(crate) fn policy() -> Valid<PolicyConfig> {
    let encoder =
        EncoderConfig::Gat(GatConfig { n_layers: 1, n_heads: 1, head_dim: 4, mlp_hidden: 8, ..Default::default() });
    let network = NetworkConfig { encoder, width: 8, value_hidden: vec![8], ..Default::default() };
    Valid::new(PolicyConfig { network, ..Default::default() }).expect("it is valid")
}

/// Returns untrained weights whose values are `value` on average and whose only task is `2_000`.
pub(crate) fn weights(version: u64, value: f32) -> Weights {
    let config = policy();
    let network = Network::init(&config.network, &config.sizes(), 1, &policy::DeviceKind::Cpu.open().unwrap());
    Weights {
        version: WeightsVersion(version),
        n_env_steps: 0,
        network_hash: config.hash(),
        settings: Default::default(),
        parameters: policy::parameters::flatten(&network),
        normalization: Normalization { value_mean: value, value_std: 1e-3, ..Normalization::default() },
        task_probabilities: [(id("2_000"), 1.0)].into(),
    }
}
