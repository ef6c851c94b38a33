//! The rigid-body engine: 16 blocks and the ground in rapier, with only what the world needs.

use blueprints::{BlockIdx, Inventory, N_BLOCKS};
use nalgebra::{Isometry3, Vector3};
use rapier3d::dynamics::{
    CCDSolver, GenericJointBuilder, ImpulseJointHandle, ImpulseJointSet, IntegrationParameters, IslandManager,
    JointAxesMask, JointAxis, MotorModel, MultibodyJointSet, RigidBody, RigidBodyBuilder, RigidBodyHandle,
    RigidBodySet, SoftBodySet, SpringCoefficients,
};
use rapier3d::geometry::{BroadPhaseBvh, BvhOptimizationStrategy, ColliderBuilder, ColliderSet, NarrowPhase};
use rapier3d::pipeline::PhysicsPipeline;

use crate::config::PhysicsConfig;
use crate::convert::{from_rapier, pose_from_rapier, pose_to_rapier, to_rapier};

/// Length of a substep, s.
pub(crate) const SUBSTEP_S: f32 = 0.01;

/// Linear and angular damping of blocks, 1/s.
const DAMPING_HZ: f32 = 0.5;
/// Damping of the motor on each held block when two grippers hold one structure, N·s/m.
const MOTOR_DAMPING_NSPM: f32 = 60.0;
/// Maximum force of that motor, N.
const MOTOR_FORCE_N: f32 = 200.0;
/// Angular damping of that motor, N·m·s/rad.
const MOTOR_ANGULAR_DAMPING_NMSPRAD: f32 = 6.0;
/// Maximum torque of that motor, N·m.
const MOTOR_TORQUE_NM: f32 = 20.0;

/// Half extents of the ground in meters. Blocks end their episode before they can reach its edge.
const GROUND_HALF_EXTENTS_M: [f32; 3] = [60.0, 60.0, 0.5];

/// Time at rest after which a block sleeps and costs nothing until it is touched, s; the engine's default is 0.5. With
/// 0.1, the expert breaks more of the special blueprints.
const SLEEP_AFTER_S: f32 = 0.2;
/// Half the speed of a block's fastest point below which it is at rest, m/s; the engine's default would be 0.005.
const SLEEP_BELOW_MPS: f32 = 0.1;

/// Solver iterations while structures stand. With 4, towers and long bridges sag and sway until they come apart; more
/// than 8 cost time and gain little.
const STRUCTURE_ITERATIONS: usize = 8;
/// Solver iterations while there are only loose blocks, small structures, and carried ones.
const LOOSE_ITERATIONS: usize = 4;

/// A joint of the engine.
pub(crate) type JointHandle = ImpulseJointHandle;

/// State that a step reads and writes.
#[derive(Clone)]
struct Bodies {
    islands: IslandManager,
    broad_phase: BroadPhaseBvh,
    narrow_phase: NarrowPhase,
    bodies: RigidBodySet,
    colliders: ColliderSet,
    joints: ImpulseJointSet,
    multibody_joints: MultibodyJointSet,
    soft_bodies: SoftBodySet,
}

/// The engine's buffers, which every step fills anew. A clone gets empty ones.
struct Workspace(PhysicsPipeline);

impl Clone for Workspace {
    fn clone(&self) -> Self {
        Self(PhysicsPipeline::new())
    }
}

/// 16 blocks, the ground, and joints.
#[derive(Clone)]
pub(crate) struct Engine {
    parameters: IntegrationParameters,
    gravity: Vector3<f32>,
    workspace: Workspace,
    ccd: CCDSolver,
    now: Bodies,
    template: Bodies,
    handles: [RigidBodyHandle; N_BLOCKS],
    ground: RigidBodyHandle,
    /// Number of substeps computed as one.
    n_merged: u8,
    /// Substeps since the reset.
    n_substeps: u32,
    /// The last substep that computed each block, and that substep's length in seconds. Sleeping blocks keep the
    /// impulses of theirs.
    solved: [(u32, f32); N_BLOCKS],
}

/// Velocity of a rigid body in the world frame: linear (of its center) and angular.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Velocity {
    pub(crate) linear: Vector3<f32>,
    pub(crate) angular: Vector3<f32>,
}

impl Bodies {
    fn add_block(&mut self, block: BlockIdx, half_extents_m: [f32; 3], physics: &PhysicsConfig) -> RigidBodyHandle {
        let body = RigidBodyBuilder::dynamic()
            .linear_damping(DAMPING_HZ)
            .angular_damping(DAMPING_HZ)
            // Apart from each other and above the ground until a reset places them.
            .translation(to_rapier(Vector3::new(block.get() as f32, 0.0, 1.0)));
        let handle = self.bodies.insert(body);
        let activation = self.bodies[handle].activation_mut();
        activation.time_until_sleep = SLEEP_AFTER_S;
        activation.normalized_linear_threshold = SLEEP_BELOW_MPS / blueprints::UNIT_M;
        let [x, y, z] = half_extents_m;
        let collider = ColliderBuilder::cuboid(x, y, z).density(physics.density_kgpm3).friction(physics.friction);
        self.colliders.insert_with_parent(collider, handle, &mut self.bodies);
        handle
    }
}

impl Engine {
    pub(crate) fn new(physics: &PhysicsConfig, inventory: &Inventory) -> Self {
        let mut template = Bodies {
            islands: IslandManager::new(),
            // Maintaining the tree costs a twelfth of a step and gains nothing with 17 leaves.
            broad_phase: BroadPhaseBvh::with_optimization_strategy(BvhOptimizationStrategy::None),
            narrow_phase: NarrowPhase::new(),
            bodies: RigidBodySet::new(),
            colliders: ColliderSet::new(),
            joints: ImpulseJointSet::new(),
            multibody_joints: MultibodyJointSet::new(),
            soft_bodies: SoftBodySet::new(),
        };
        let [x, y, z] = GROUND_HALF_EXTENTS_M;
        // A cuboid, not a half-space: contacts with it cost a third less.
        let ground =
            template.bodies.insert(RigidBodyBuilder::fixed().translation(to_rapier(Vector3::new(0.0, 0.0, -z))));
        let collider = ColliderBuilder::cuboid(x, y, z).friction(physics.friction);
        template.colliders.insert_with_parent(collider, ground, &mut template.bodies);
        let handles = BlockIdx::array(|block| template.add_block(block, inventory.half_extents_m(block), physics));
        let parameters = IntegrationParameters {
            dt: SUBSTEP_S,
            // The engine's tolerances are fractions of this length; at 1, they are huge for a 10 cm block.
            length_unit: blueprints::UNIT_M,
            // One solver iteration, because a joint reports only the impulse of its last iteration; the inner ones add
            // up.
            num_solver_iterations: 1,
            num_internal_pgs_iterations: STRUCTURE_ITERATIONS,
            friction_in_bias_pass: true,
            // Sweeping fast blocks against the ground costs an eighth of a step. Without it, a block at full speed
            // sinks in by 3 cm for a moment, but the ground is too thick to pass through.
            max_ccd_substeps: 0,
            ..IntegrationParameters::default()
        };
        Self {
            parameters,
            gravity: Vector3::new(0.0, 0.0, -physics.gravity_mps2),
            workspace: Workspace(PhysicsPipeline::new()),
            ccd: CCDSolver::new(),
            now: template.clone(),
            template,
            handles,
            ground,
            n_merged: 1,
            n_substeps: 0,
            solved: [(0, 0.0); N_BLOCKS],
        }
    }

    /// Places the blocks at rest at `poses`, without joints.
    ///
    /// This replaces all state that a step can read: bodies that are only moved keep caches that change the last bits
    /// of later results.
    pub(crate) fn reset(&mut self, poses: &[Isometry3<f32>; N_BLOCKS]) {
        self.now.clone_from(&self.template);
        self.workspace = Workspace(PhysicsPipeline::new());
        self.ccd = CCDSolver::new();
        (self.n_substeps, self.solved) = (0, [(0, 0.0); N_BLOCKS]);
        for (block, pose) in BlockIdx::all().zip(poses) {
            self.set_pose(block, pose);
        }
    }

    /// Computes `n_substeps` substeps as one from now on.
    pub(crate) fn merge(&mut self, n_substeps: u8) {
        self.n_merged = n_substeps;
        self.parameters.dt = f32::from(n_substeps) * SUBSTEP_S;
    }

    /// Returns how many substeps the next one covers.
    pub(crate) fn n_merged(&self) -> u8 {
        self.n_merged
    }

    /// Returns the length of the next substep, s.
    pub(crate) fn substep_s(&self) -> f32 {
        self.parameters.dt
    }

    /// Advances by one substep.
    pub(crate) fn substep(&mut self) {
        let were_asleep = self.asleep();
        self.workspace.0.step(
            to_rapier(self.gravity),
            &self.parameters,
            &mut self.now.islands,
            &mut self.now.broad_phase,
            &mut self.now.narrow_phase,
            &mut self.now.bodies,
            &mut self.now.colliders,
            &mut self.now.joints,
            &mut self.now.multibody_joints,
            &mut self.now.soft_bodies,
            &mut self.ccd,
            &(),
            &(),
        );
        self.n_substeps += 1;
        let are_asleep = self.asleep();
        for (i, solved) in self.solved.iter_mut().enumerate() {
            if !(were_asleep[i] && are_asleep[i]) {
                *solved = (self.n_substeps, self.parameters.dt);
            }
        }
    }

    fn asleep(&self) -> [bool; N_BLOCKS] {
        self.handles.map(|handle| self.now.bodies[handle].is_sleeping())
    }

    pub(crate) fn pose(&self, block: BlockIdx) -> Isometry3<f32> {
        pose_from_rapier(self.body(block).position())
    }

    pub(crate) fn velocity(&self, block: BlockIdx) -> Velocity {
        let body = self.body(block);
        Velocity { linear: from_rapier(body.linvel()), angular: from_rapier(body.angvel()) }
    }

    #[cfg(test)]
    pub(crate) fn kinetic_energy_j(&self, block: BlockIdx) -> f32 {
        self.body(block).kinetic_energy()
    }

    pub(crate) fn is_asleep(&self, block: BlockIdx) -> bool {
        self.body(block).is_sleeping()
    }

    pub(crate) fn set_velocity(&mut self, block: BlockIdx, velocity: Velocity) {
        let body = self.body_mut(block);
        body.set_linvel(to_rapier(velocity.linear), true);
        body.set_angvel(to_rapier(velocity.angular), true);
    }

    pub(crate) fn set_pose(&mut self, block: BlockIdx, pose: &Isometry3<f32>) {
        self.body_mut(block).set_position(pose_to_rapier(pose), true);
    }

    pub(crate) fn set_gravity(&mut self, block: BlockIdx, on: bool) {
        let scale = if on { 1.0 } else { 0.0 };
        if self.body(block).gravity_scale() != scale {
            self.body_mut(block).set_gravity_scale(scale, true);
        }
    }

    /// Applies an impulse in N·s at `point`, both in the world frame.
    pub(crate) fn apply_impulse(&mut self, block: BlockIdx, impulse: Vector3<f32>, point: Vector3<f32>) {
        self.body_mut(block).apply_impulse_at_point(to_rapier(impulse), to_rapier(point), true);
    }

    /// Inserts a joint that holds `frame_a` of `a` and `frame_b` of `b` together.
    pub(crate) fn insert_fixed_joint(
        &mut self,
        (a, frame_a): (BlockIdx, Isometry3<f32>),
        (b, frame_b): (BlockIdx, Isometry3<f32>),
        frequency_hz: f32,
    ) -> JointHandle {
        let joint = GenericJointBuilder::new(JointAxesMask::LOCKED_FIXED_AXES)
            .local_frame1(pose_to_rapier(&frame_a))
            .local_frame2(pose_to_rapier(&frame_b))
            // The joint alone determines the pose; contacts between the two blocks would fight it.
            .contacts_enabled(false)
            .softness(SpringCoefficients::new(frequency_hz, 1.0));
        self.now.joints.insert(self.handles[a.get()], self.handles[b.get()], joint, true)
    }

    pub(crate) fn set_joint_frequency(&mut self, joint: JointHandle, frequency_hz: f32) {
        if let Some(joint) = self.now.joints.get_mut(joint, false) {
            joint.data.softness = SpringCoefficients::new(frequency_hz, 1.0);
        }
    }

    /// Includes a joint in the solver or leaves it out. Its two blocks have no contacts either way.
    pub(crate) fn set_joint_enabled(&mut self, joint: JointHandle, is_enabled: bool) {
        if let Some(joint) = self.now.joints.get_mut(joint, false) {
            joint.data.set_enabled(is_enabled);
        }
    }

    /// Sets whether a structure must stand in the coming substep, which takes more solver effort.
    pub(crate) fn set_structures(&mut self, has_structures: bool) {
        self.parameters.num_internal_pgs_iterations =
            if has_structures { STRUCTURE_ITERATIONS } else { LOOSE_ITERATIONS };
        // Without this, resting feet slide by centimeters per second under structures with several legs.
        self.parameters.friction_in_bias_pass = has_structures;
    }

    /// Returns the force (N) and torque (N·m) that the joint carried in the last substep.
    ///
    /// The solver makes the six rows of a joint independent, so the torque is about the point where force and torque
    /// decouple, not about the contact. A weight on a lever reads mostly as force.
    pub(crate) fn joint_load(&self, joint: JointHandle) -> (f32, f32) {
        let Some(joint) = self.now.joints.get(joint) else { return (0.0, 0.0) };
        let [fx, fy, fz, tx, ty, tz] = joint.impulses;
        // The engine measures a joint's angle as the sine of its half, so its angular impulses count twice.
        let torque = 0.5 * Vector3::new(tx, ty, tz).norm();
        (Vector3::new(fx, fy, fz).norm() / self.parameters.dt, torque / self.parameters.dt)
    }

    /// Inserts a force-limited motor between the ground and the block's center.
    pub(crate) fn insert_motor(&mut self, block: BlockIdx, target: Velocity) -> JointHandle {
        let mut joint = GenericJointBuilder::new(JointAxesMask::empty()).build();
        let linear = [JointAxis::LinX, JointAxis::LinY, JointAxis::LinZ];
        let angular = [JointAxis::AngX, JointAxis::AngY, JointAxis::AngZ];
        for (axes, velocity, damping, most) in [
            (linear, target.linear, MOTOR_DAMPING_NSPM, MOTOR_FORCE_N),
            (angular, target.angular, MOTOR_ANGULAR_DAMPING_NMSPRAD, MOTOR_TORQUE_NM),
        ] {
            for (axis, &velocity) in axes.into_iter().zip(&velocity) {
                joint.set_motor_velocity(axis, velocity, damping);
                joint.set_motor_model(axis, MotorModel::ForceBased);
                joint.set_motor_max_force(axis, most);
            }
        }
        self.now.joints.insert(self.ground, self.handles[block.get()], joint, true)
    }

    pub(crate) fn remove_joint(&mut self, joint: JointHandle) {
        self.now.joints.remove(joint, true);
    }

    /// Calls `f` with the two bodies of every contact that carried more than `min_force_n` in the last substep that
    /// computed it: contacts of sleeping blocks carry what they did before. `None` is the ground.
    pub(crate) fn for_each_contact(&self, min_force_n: f32, mut f: impl FnMut([Option<BlockIdx>; 2])) {
        for pair in self.now.narrow_phase.contact_pairs() {
            let impulse = pair.total_impulse_magnitude();
            if impulse <= 0.0 {
                continue;
            }
            let block = |collider| {
                let body = self.now.colliders.get(collider)?.parent()?;
                BlockIdx::all().find(|b| self.handles[b.get()] == body)
            };
            let blocks = [block(pair.collider1), block(pair.collider2)];
            let last = blocks.iter().flatten().map(|b| self.solved[b.get()]).max_by_key(|(substep, _)| *substep);
            if last.is_some_and(|(_, dt)| impulse > min_force_n * dt) {
                f(blocks);
            }
        }
    }

    fn body(&self, block: BlockIdx) -> &RigidBody {
        &self.now.bodies[self.handles[block.get()]]
    }

    fn body_mut(&mut self, block: BlockIdx) -> &mut RigidBody {
        &mut self.now.bodies[self.handles[block.get()]]
    }
}
