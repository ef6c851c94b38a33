//! The grippers: what each holds, and how it moves its load.

use blueprints::BlockIdx;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use proto::{Action, Gripper, N_GRIPPERS};

use crate::config::EnvironmentConfig;
use crate::connections::Connections;
use crate::engine::{Engine, JointHandle, Velocity};

/// One gripper.
#[derive(Clone, Default)]
struct State {
    /// The last chosen block; choosing another one is a switch.
    target: Option<BlockIdx>,
    /// Steps for which the last switch still disables the gripper.
    delay_left: u8,
    held: Option<BlockIdx>,
    command: Velocity,
    orientation: UnitQuaternion<f32>,
    motor: Option<JointHandle>,
}

/// The grippers of a world.
#[derive(Clone)]
pub(crate) struct Grippers {
    states: Vec<State>,
    max_speed_mps: f32,
    max_turn_radps: f32,
    delay_steps: u8,
}

impl Grippers {
    pub(crate) fn new(config: &EnvironmentConfig) -> Self {
        Self {
            states: vec![State::default(); usize::from(config.n_grippers).min(N_GRIPPERS)],
            max_speed_mps: config.max_speed_mps,
            max_turn_radps: config.max_turn_radps,
            delay_steps: config.transition_delay_steps,
        }
    }

    /// Releases all blocks and resets all state. The engine's joints must already be gone.
    pub(crate) fn clear(&mut self) {
        self.states.fill(State::default());
    }

    /// Releases all blocks in a world that continues.
    pub(crate) fn release(&mut self, engine: &mut Engine) {
        self.remove_motors(engine);
        self.clear();
        BlockIdx::all().for_each(|block| engine.set_gravity(block, true));
    }

    /// Releases a block for the rest of the step.
    pub(crate) fn let_go(&mut self, block: BlockIdx) {
        for state in self.states.iter_mut().filter(|state| state.held == Some(block)) {
            (state.held, state.command) = (None, Velocity::default());
        }
    }

    /// Applies the choices and converts the moves of the chosen blocks to world-frame velocities, which hold for the
    /// whole step.
    pub(crate) fn begin_step(&mut self, engine: &mut Engine, action: &Action) {
        // The motors still have the velocities of the last step.
        self.remove_motors(engine);
        for (state, &choice) in self.states.iter_mut().zip(&action.choices) {
            if choice != state.target {
                // The first grip of an episode is not a switch.
                state.delay_left = if state.target.is_some() { self.delay_steps } else { 0 };
                state.target = choice;
            }
            state.held = if state.delay_left == 0 { choice } else { None };
            state.delay_left = state.delay_left.saturating_sub(1);
            state.command = Velocity::default();
            if let Some(block) = state.held {
                let entry = |i: usize| action.moves[block.get()][i].clamp(-1.0, 1.0);
                let rotation = engine.pose(block).rotation;
                state.command = Velocity {
                    linear: rotation * Vector3::new(entry(0), entry(1), entry(2)) * self.max_speed_mps,
                    angular: rotation * Vector3::new(entry(3), entry(4), entry(5)) * self.max_turn_radps,
                };
            }
        }
        BlockIdx::all().for_each(|block| engine.set_gravity(block, true));
    }

    /// Sets the held blocks in motion. Call this before a substep, after the magnets' forces. Returns the blocks that
    /// move with their whole component as one rigid body.
    pub(crate) fn drive(&mut self, engine: &mut Engine, connections: &Connections) -> [Option<BlockIdx>; N_GRIPPERS] {
        let held = |i: usize| self.states.get(i).and_then(|s| s.held);
        match (held(0), held(1)) {
            (Some(a), Some(b)) if a != b && connections.same_component(a, b) => {
                // Two velocities for one rigid body contradict each other, so each becomes a limited force.
                weightless(engine, connections, a);
                for state in &mut self.states {
                    if let (Some(block), None) = (state.held, state.motor) {
                        state.motor = Some(engine.insert_motor(block, state.command));
                    }
                }
                [None, None]
            }
            (first, second) => {
                self.remove_motors(engine);
                // Two grippers on one block use the same row of the action.
                let second = second.filter(|_| first != second);
                for (block, state) in [first, second].into_iter().zip(&self.states) {
                    if let Some(block) = block {
                        carry(engine, connections, block, state.command);
                    }
                }
                [first, second]
            }
        }
    }

    /// Returns the state to report after a step.
    pub(crate) fn snapshot(&mut self, engine: &Engine) -> [Option<Gripper>; N_GRIPPERS] {
        for state in &mut self.states {
            if let Some(block) = state.held {
                state.orientation = engine.pose(block).rotation;
            }
        }
        std::array::from_fn(|i| {
            self.states.get(i).map(|state| Gripper {
                held: state.held,
                orientation: state.orientation.coords.into(),
                linear_velocity: state.command.linear.into(),
                angular_velocity: state.command.angular.into(),
            })
        })
    }

    fn remove_motors(&mut self, engine: &mut Engine) {
        for motor in self.states.iter_mut().filter_map(|state| state.motor.take()) {
            engine.remove_joint(motor);
        }
    }
}

/// Moves the whole component of `held` as one rigid body, in which `held` has velocity `command`.
///
/// Every block gets its own velocity. Driving only the held one drags the rest along on its joints, which bent a
/// 16-block chain by 1.5 cm and 0.3 rad.
fn carry(engine: &mut Engine, connections: &Connections, held: BlockIdx, command: Velocity) {
    let substep_s = engine.substep_s();
    weightless(engine, connections, held);
    let pivot = engine.pose(held).translation.vector;
    // Turn exactly as the engine turns a body in a substep, which is not quite by ω·dt.
    let half_turn = command.angular * (0.5 * substep_s);
    let turn = UnitQuaternion::new_normalize(Quaternion::from_parts(1.0, half_turn));
    for block in BlockIdx::all().filter(|&block| connections.same_component(block, held)) {
        let arm = engine.pose(block).translation.vector - pivot;
        // The chord of the arc, not its tangent: tangents stretch the structure by (ω·dt)²/2 in every substep.
        let linear = command.linear + (turn * arm - arm) / substep_s;
        engine.set_velocity(block, Velocity { linear, angular: command.angular });
    }
}

fn weightless(engine: &mut Engine, connections: &Connections, held: BlockIdx) {
    for block in BlockIdx::all().filter(|&block| connections.same_component(block, held)) {
        engine.set_gravity(block, false);
    }
}
