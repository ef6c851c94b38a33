//! A world without physics for the tests of other crates: nothing moves, and a script determines how each step ends.

use blueprints::{Blueprint, Catalog, N_BLOCKS};
use environment::{Env, ResetError, StepResult};
use proto::{Action, Pose, RewardTerms, Scene, Start, Status, Task};

/// Ends each step as scripted, over and over. Step `k` of the script gives the reward `k + 1` for connections.
#[derive(Clone)]
pub(crate) struct Toy {
    script: Vec<Status>,
    n_steps: usize,
    n_idle_steps: usize,
    diverged: bool,
    scene: Scene,
    blueprint: Blueprint,
}

impl Toy {
    pub(crate) fn new(script: &[Status]) -> Self {
        let blueprint = Catalog::builtin().iter().next().unwrap().clone();
        let script = script.to_vec();
        Self { script, n_steps: 0, n_idle_steps: 0, diverged: false, scene: scene(), blueprint }
    }
}

impl Env for Toy {
    fn reset(&mut self, task: &Task, catalog: &Catalog) -> Result<(), ResetError> {
        if task.start == Start::AsItIs && self.diverged {
            return Err(ResetError::NothingToKeep);
        }
        assert_eq!(self.n_idle_steps, 0, "nothing is let go between goals");
        let unknown = || ResetError::UnknownBlueprint(task.blueprint.clone());
        self.blueprint = catalog.get(&task.blueprint).ok_or_else(unknown)?.permuted(&task.assignment);
        self.diverged = false;
        Ok(())
    }

    fn step(&mut self, action: &Action) -> StepResult {
        // Idle steps, which test whether a success is stable, do not count as steps of an episode.
        if action.moves == [[0.0; 6]; N_BLOCKS] {
            self.n_idle_steps += 1;
            return StepResult { reward: RewardTerms::default(), status: Status::Running };
        }
        let at = self.n_steps % self.script.len();
        self.n_steps += 1;
        self.diverged = self.script[at] == Status::Diverged;
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

/// Returns a scene with the blocks in a row, one meter apart.
pub(crate) fn scene() -> Scene {
    let orientation = [0.0, 0.0, 0.0, 1.0];
    Scene::at_rest(std::array::from_fn(|i| Pose { position: [i as f32, 0.0, 0.05], orientation }))
}
