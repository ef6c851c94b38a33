//! The world, simulated with rapier.

use blueprints::{BlockIdx, Blueprint, Catalog, Inventory, N_BLOCKS};
use nalgebra::Vector3;
use proto::{Action, Disturbance, RewardTerms, Scene, Start, Status, Task, Valid};
use rand::SeedableRng;
use rand::rngs::ChaCha8Rng;

use crate::arrangement::{Arrangement, ArrangementError, RUNAWAY_M, raised};
use crate::config::{EnvironmentConfig, PhysicsConfig};
use crate::connections::Connections;
use crate::convert::to_pose;
use crate::engine::{Engine, SUBSTEP_S, Velocity};
use crate::env::{Env, ResetError, StepResult};
use crate::grippers::Grippers;
use crate::randomization;
use crate::reset::{self, Layout};
use crate::reward::{potential, reward};
use crate::success::is_success;

/// Physics substeps per control step.
pub(crate) const N_SUBSTEPS: u8 = 10;

/// Length of a control step, s.
pub const CONTROL_DT_S: f32 = SUBSTEP_S * N_SUBSTEPS as f32;

/// Maximum number of substeps computed as one, while the solver handles no awake structure of three or more blocks.
/// Larger structures sag unless substeps are short.
const MAX_MERGED: u8 = 2;

/// Force above which a contact is heavy, in weights of a unit cube.
const HEAVY_CONTACT_CUBE_WEIGHTS: f32 = 10.0;

/// One world. Steps are cheap, so that one thread can drive many worlds. A clone goes on bit for bit as the original.
///
/// # Example
/// ```
/// use blueprints::{BlockIdx, Catalog};
/// use environment::{Env, EnvironmentConfig, Expert, World};
/// use proto::{Start, Status, Task};
///
/// let config = proto::Valid::<EnvironmentConfig>::default();
/// let mut world = World::new(&config);
/// let assignment = BlockIdx::array(|block| block);
/// let task = Task { blueprint: "2_000".parse()?, assignment, start: Start::Scattered, seed: 1 };
/// world.reset(&task, Catalog::builtin())?;
/// let mut expert = Expert::new(&config, world.blueprint())?;
/// let result = world.step(&expert.act(world.scene()));
/// assert_eq!(result.status, Status::Running);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone)]
pub struct World {
    config: Valid<EnvironmentConfig>,
    pub(crate) engine: Engine,
    pub(crate) connections: Connections,
    pub(crate) grippers: Grippers,
    blueprint: Blueprint,
    scene: Scene,
    potential: RewardTerms,
    n_steps: u16,
    /// Whether there is a valid state to continue from.
    alive: bool,
    /// Force above which a contact is heavy in this episode, N.
    heavy_contact_n: f32,
    /// What somebody outside does to the blocks, by the steps of an episode.
    disturbances: Vec<(u16, Disturbance)>,
    /// Number of episodes to begin before they apply.
    n_calm: usize,
}

impl World {
    /// Creates a world. Until its first [`Env::reset`], its scene is a placeholder and its steps are `Diverged`.
    pub fn new(config: &Valid<EnvironmentConfig>) -> Self {
        let inventory = Inventory::standard();
        let engine = Engine::new(&config.physics, inventory);
        let mut world = Self {
            scene: Scene::at_rest(BlockIdx::array(|block| to_pose(&engine.pose(block)))),
            engine,
            connections: Connections::new(&config.magnets, inventory),
            grippers: Grippers::new(config),
            blueprint: Catalog::builtin().iter().next().expect("the built-in catalog is not empty").clone(),
            potential: RewardTerms::default(),
            n_steps: 0,
            alive: false,
            heavy_contact_n: heavy_contact_n(&config.physics),
            disturbances: Vec::new(),
            n_calm: 0,
            config: config.clone(),
        };
        world.observe(0);
        world
    }

    /// Begins the episode anew in an arrangement, with the goal and the drawn settings that it has. What follows depends
    /// only on these, the arrangement, and the actions.
    ///
    /// # Errors
    /// Returns an error if the arrangement is illegal. The world is then unchanged.
    pub fn set_scene(&mut self, scene: &Arrangement) -> Result<(), ArrangementError> {
        self.place(&scene.layout()?);
        self.begin();
        Ok(())
    }

    /// Disturbs every episode after the next `n_calm` ones, each time as the action of the given step, from 0, begins.
    pub fn disturb(&mut self, n_calm: usize, disturbances: &[(u16, Disturbance)]) {
        (self.n_calm, self.disturbances) = (n_calm + 1, disturbances.to_vec());
    }

    /// Takes the block out of the grippers. If it is moved, it comes off everything that it was connected to, and ends
    /// up above what is in its place.
    fn apply(&mut self, disturbance: &Disturbance) {
        let block = disturbance.block();
        let push = Vector3::from(disturbance.push_mps());
        let mut velocity = self.engine.velocity(block);
        self.grippers.let_go(block);
        if disturbance.displacement_m() != [0.0; 3] {
            self.connections.detach(&mut self.engine, block);
            let mut poses = BlockIdx::array(|block| self.engine.pose(block));
            poses[block.get()].translation.vector += Vector3::from(disturbance.displacement_m());
            self.engine.set_pose(block, &raised(&poses, block));
            velocity = Velocity::default();
        }
        self.engine.set_velocity(block, Velocity { linear: velocity.linear + push, ..velocity });
    }

    /// Recreates the bodies, magnets, and grippers for an episode with its own settings.
    fn refit(&mut self, config: &EnvironmentConfig) {
        let inventory = Inventory::standard();
        self.engine = Engine::new(&config.physics, inventory);
        self.connections = Connections::new(&config.magnets, inventory);
        self.grippers = Grippers::new(config);
        self.heavy_contact_n = heavy_contact_n(&config.physics);
    }

    pub(crate) fn place(&mut self, layout: &Layout) {
        self.engine.reset(&layout.poses);
        self.connections.clear();
        self.grippers.clear();
        for &joint in &layout.joints {
            self.connections.insert_built(&mut self.engine, joint);
        }
    }

    /// Begins an episode in the present state.
    fn begin(&mut self) {
        (self.n_steps, self.alive) = (0, true);
        self.n_calm = self.n_calm.saturating_sub(1);
        self.observe(0);
        self.potential = potential(&self.scene, &self.blueprint, &self.config.reward);
    }

    /// Runs the substeps of a control step and returns its number of heavy contacts.
    fn run_substeps(&mut self) -> u8 {
        let mut heavy = [0_u32; N_BLOCKS + 1];
        let mut n_left = N_SUBSTEPS;
        while n_left > 0 {
            let n_merged = if self.connections.may_merge(&self.engine) { MAX_MERGED.min(n_left) } else { 1 };
            n_left -= n_merged;
            self.engine.merge(n_merged);
            self.substep();
            self.engine.for_each_contact(self.heavy_contact_n, |bodies| {
                let [low, high] = bodies.map(|body| body.map_or(N_BLOCKS, BlockIdx::get));
                heavy[low.min(high)] |= 1 << low.max(high);
            });
        }
        heavy.iter().map(|row| row.count_ones() as u8).sum()
    }

    /// Runs one substep, of the length that the engine is set to.
    pub(crate) fn substep(&mut self) {
        self.connections.attract(&mut self.engine);
        let carried = self.grippers.drive(&mut self.engine, &self.connections);
        self.connections.spare(&mut self.engine, carried);
        self.engine.substep();
        self.connections.strain(&mut self.engine);
    }

    /// Updates the scene.
    fn observe(&mut self, n_heavy_contacts: u8) {
        for block in BlockIdx::all() {
            let i = block.get();
            let Velocity { linear, angular } = self.engine.velocity(block);
            self.scene.blocks[i] = to_pose(&self.engine.pose(block));
            self.scene.speeds_mps[i] = linear.norm() + angular.norm() * self.connections.table.radius(block);
        }
        self.scene.joints = self.connections.joints();
        self.scene.grippers = self.grippers.snapshot(&self.engine);
        self.scene.n_heavy_contacts = n_heavy_contacts;
    }

    /// Returns whether all blocks are where a valid simulation can have them.
    fn is_sound(&self) -> bool {
        self.scene.blocks.iter().zip(&self.scene.speeds_mps).all(|(pose, speed)| {
            let [x, y, z] = pose.position;
            // A NaN fails the comparison.
            x * x + y * y + z * z <= RUNAWAY_M * RUNAWAY_M
                && speed.is_finite()
                && pose.orientation.iter().all(|q| q.is_finite())
        })
    }
}

impl Env for World {
    fn reset(&mut self, task: &Task, catalog: &Catalog) -> Result<(), ResetError> {
        check_assignment(&task.assignment)?;
        let find = |id| catalog.get(id).ok_or_else(|| ResetError::UnknownBlueprint(id.clone()));
        let blueprint = find(&task.blueprint)?.permuted(&task.assignment);
        let mut rng = ChaCha8Rng::seed_from_u64(task.seed);
        let layout = match &task.start {
            Start::Scattered => Some(reset::scattered(&mut rng)?),
            Start::Prebuilt(id) => Some(reset::prebuilt(&find(id)?.permuted(&task.assignment), &mut rng)?),
            Start::NearGoal { undone } => Some(reset::near_goal(&blueprint, *undone, &mut rng)?),
            Start::AsItIs if !self.alive => return Err(ResetError::NothingToKeep),
            Start::AsItIs => None,
        };
        match layout {
            Some(layout) => {
                if let Some(drawn) = randomization::draw(&self.config, task.seed) {
                    self.refit(&drawn);
                }
                self.place(&layout);
            }
            None => self.grippers.release(&mut self.engine),
        }
        self.blueprint = blueprint;
        self.begin();
        Ok(())
    }

    fn step(&mut self, action: &Action) -> StepResult {
        let diverged = StepResult { reward: RewardTerms::default(), status: Status::Diverged };
        self.n_steps = self.n_steps.saturating_add(1);
        let chosen = action.choices.iter().take(self.config.n_grippers.into()).flatten();
        if !self.alive || chosen.copied().any(|b| action.moves[b.get()].iter().any(|x| !x.is_finite())) {
            self.alive = false;
            return diverged;
        }
        self.grippers.begin_step(&mut self.engine, action);
        let due = self.disturbances.iter().find(|(step, _)| self.n_calm == 0 && *step == self.n_steps - 1);
        if let Some((_, disturbance)) = due.copied() {
            self.apply(&disturbance);
        }
        let n_heavy_contacts = self.run_substeps();
        self.observe(n_heavy_contacts);
        if !self.is_sound() {
            self.alive = false;
            return diverged;
        }
        let before =
            std::mem::replace(&mut self.potential, potential(&self.scene, &self.blueprint, &self.config.reward));
        let status = if is_success(&self.scene, &self.blueprint, &self.config.success) {
            Status::Success
        } else if self.n_steps >= self.config.episode_steps {
            Status::TimeLimit
        } else {
            Status::Running
        };
        StepResult { reward: reward(&before, &self.potential), status }
    }

    fn scene(&self) -> &Scene {
        &self.scene
    }

    fn blueprint(&self) -> &Blueprint {
        &self.blueprint
    }
}

/// Returns the force above which a contact is heavy, N.
fn heavy_contact_n(physics: &PhysicsConfig) -> f32 {
    let cube_weight_n = physics.density_kgpm3 * blueprints::UNIT_M.powi(3) * physics.gravity_mps2;
    HEAVY_CONTACT_CUBE_WEIGHTS * cube_weight_n
}

fn check_assignment(assignment: &[BlockIdx; N_BLOCKS]) -> Result<(), ResetError> {
    let inventory = Inventory::standard();
    let mut taken = [false; N_BLOCKS];
    for (block, &player) in BlockIdx::all().zip(assignment) {
        let fits = inventory.type_idx(block) == inventory.type_idx(player);
        if !fits || std::mem::replace(&mut taken[player.get()], true) {
            return Err(ResetError::Unfit(format!(
                "the assignment lets block {} play block {}; it must permute blocks of one type",
                player.get(),
                block.get()
            )));
        }
    }
    Ok(())
}
