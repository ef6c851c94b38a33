//! Admission rules for trajectories: the run's settings, a goal and a start that its actors draw, and plausible values.
//! Every check is cheap.

use std::collections::BTreeSet;

use blueprints::{BlueprintId, Catalog, Split};
use policy::proposals::{N_SLOTS, Slot};
use policy::{MoveHead, PolicyConfig};
use proto::{
    Action, BehaviorPolicy, CanonicalSettings, N_GRIPPERS, RewardTerms, Scene, Start, Status, Trajectory, Transition,
};

/// Largest coordinate of a block in meters: the limit at which the widest configurable world ends an episode.
const MAX_POSITION_M: f32 = 50.0;

/// Largest entry of a unit quaternion, with some tolerance.
const MAX_ORIENTATION: f32 = 1.01;

/// Largest magnitude of a reward term per step: 120 block pairs with the largest configurable weight, 10. A single
/// larger reward would outweigh the returns of a whole batch.
const MAX_REWARD: f32 = 1200.0;

/// Largest magnitude of a move's entries. The world clips entries to [−1, 1]; the widest distributions have width 10.
const MAX_MOVE: f32 = 1000.0;

/// Range of a sampled action's log-density: from 96 entries at four standard deviations each to 96 entries with the
/// smallest configurable standard deviation, 1e-6.
const LOG_PROBS: std::ops::RangeInclusive<f32> = -2000.0..=2000.0;

/// Largest entry of a gripper's commanded velocity: √3 times the largest configurable speed.
const MAX_GRIPPER_MPS: f32 = 17.4;
/// The same for its angular velocity.
const MAX_GRIPPER_RADPS: f32 = 53.7;

/// What the actors of a run do according to its settings. Everything else comes from somebody else.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ActingLimits {
    /// Longest episode in steps.
    pub episode_steps: u16,
    /// Whether episodes begin with another blueprint built.
    pub has_prebuilt_starts: bool,
}

impl Default for ActingLimits {
    /// Returns the limits of all settings.
    fn default() -> Self {
        Self { episode_steps: 1000, has_prebuilt_starts: true }
    }
}

/// The admission rules of one run.
#[derive(Clone, Debug)]
pub struct Admission {
    settings_hash: u64,
    acting: ActingLimits,
    n_grippers: usize,
    move_head: MoveHead,
    /// Blueprints allowed as goals and start states.
    training: BTreeSet<BlueprintId>,
}

impl Admission {
    /// Creates rules that admit the training split of the catalog, from actors with these settings.
    pub fn new(catalog: &Catalog, policy: &PolicyConfig, settings: &CanonicalSettings, acting: ActingLimits) -> Self {
        let split = catalog.of_split(Split::Train).into_iter().map(|blueprint| blueprint.id().clone());
        Self {
            settings_hash: settings.hash(),
            acting,
            n_grippers: policy.features.n_grippers.into(),
            move_head: policy.network.move_head,
            training: split.collect(),
        }
    }

    /// Checks whether a trajectory can be used for learning, regardless of the acting weights.
    ///
    /// # Errors
    /// Returns a description of the first broken rule.
    pub fn check(&self, trajectory: &Trajectory) -> Result<(), String> {
        if trajectory.settings_hash != self.settings_hash {
            return Err("its actor has other settings of the policy or the world: start it with the run's".to_owned());
        }
        self.check_task(trajectory)?;
        self.check_acting(trajectory)?;
        if trajectory.status == Status::Diverged {
            return Err("the episode diverged".to_owned());
        }
        if trajectory.transitions.is_empty() {
            return Err("a trajectory has at least one step".to_owned());
        }
        let success = trajectory.status == Status::Success;
        if trajectory.episode_stats.as_ref().is_some_and(|stats| stats.success != success) {
            return Err("its outcome contradicts the status of its last step".to_owned());
        }
        for (t, transition) in trajectory.transitions.iter().enumerate() {
            let at = |reason: String| format!("step {t} {reason}");
            self.check_action(&transition.action).map_err(at)?;
            self.check_draws(transition).map_err(at)?;
            check_scene(&transition.scene).map_err(at)?;
            check_reward(&transition.reward).map_err(at)?;
            if transition.disturbance.is_some() {
                return Err(at("was disturbed, as no actor's is".to_owned()));
            }
            let log_prob = transition.behavior_log_prob;
            if !LOG_PROBS.contains(&log_prob) {
                return Err(at(format!("has a log-probability of {log_prob}, which no action has")));
            }
        }
        check_scene(&trajectory.last_scene).map_err(|reason| format!("the end {reason}"))
    }

    fn check_task(&self, trajectory: &Trajectory) -> Result<(), String> {
        let goal = &trajectory.task.blueprint;
        if !self.training.contains(goal) {
            return Err(format!("blueprint {goal} is not for training in this run"));
        }
        match &trajectory.task.start {
            Start::Scattered => Ok(()),
            Start::Prebuilt(_) if !self.acting.has_prebuilt_starts => {
                Err("no episode of this run begins with another blueprint built".to_owned())
            }
            Start::Prebuilt(other) if self.training.contains(other) => Ok(()),
            Start::Prebuilt(other) => Err(format!("blueprint {other}, which stands at the start, is not for training")),
            Start::NearGoal { .. } => Err("no episode of training begins near its goal".to_owned()),
            Start::AsItIs => Err("episodes of training begin with a reset".to_owned()),
        }
    }

    /// Checks what the run's actors do: how long episodes are, and who acts.
    fn check_acting(&self, trajectory: &Trajectory) -> Result<(), String> {
        let episode_steps = self.acting.episode_steps;
        let n_steps = usize::from(trajectory.first_step) + trajectory.transitions.len();
        if n_steps > usize::from(episode_steps) {
            return Err(format!("{n_steps} steps are more than an episode of this run has, {episode_steps}"));
        }
        match trajectory.behavior_policy {
            BehaviorPolicy::Sampled => Ok(()),
            BehaviorPolicy::Greedy => Err("no greedy policy acts in a training run".to_owned()),
            BehaviorPolicy::Expert => Err("no expert acts in a training run".to_owned()),
        }
    }

    fn check_action(&self, action: &Action) -> Result<(), String> {
        let n_grippers = action.choices.iter().flatten().count();
        if n_grippers != self.n_grippers {
            return Err(format!("uses {n_grippers} grippers, the network has {}", self.n_grippers));
        }
        check_within(action.moves.into_iter().flatten(), MAX_MOVE, |entry| format!("has a move of {entry}"))
    }

    /// Checks that an action has draws as the move head makes them. Whether the scene offers them is found out when it
    /// is learned from.
    fn check_draws(&self, transition: &Transition) -> Result<(), String> {
        let drawn = transition.proposals;
        if let Some(slot) = drawn.into_iter().flatten().find(|&slot| Slot::from_index(slot).is_none()) {
            return Err(format!("was drawn from proposal {slot}, and the highest is {}", N_SLOTS - 1));
        }
        match self.move_head {
            MoveHead::Gaussian if drawn != [None; N_GRIPPERS] => {
                Err("was drawn from a proposal, and there are none with policy.network.move_head = gaussian".to_owned())
            }
            MoveHead::Mixture if drawn[0].is_none() => {
                Err("names no proposal, as each draw does with policy.network.move_head = mixture".to_owned())
            }
            MoveHead::Gaussian | MoveHead::Mixture => Ok(()),
        }
    }
}

fn check_scene(scene: &Scene) -> Result<(), String> {
    let coordinates = scene.blocks.iter().flat_map(|block| block.position);
    check_within(coordinates, MAX_POSITION_M, |x| format!("has a block at {x} m, where no episode goes on"))?;
    let orientations = scene.blocks.iter().map(|block| block.orientation);
    let orientations = orientations.chain(scene.grippers.iter().flatten().map(|gripper| gripper.orientation));
    check_within(orientations.flatten(), MAX_ORIENTATION, |x| {
        format!("has an orientation with an entry of {x}, which no unit quaternion has")
    })?;
    check_within(scene.speeds_mps, f32::MAX, |x| format!("has a block with a speed of {x} m/s"))?;
    scene.grippers.iter().flatten().try_for_each(|gripper| {
        let (linear, angular) = (gripper.linear_velocity, gripper.angular_velocity);
        check_within(linear, MAX_GRIPPER_MPS, |x| format!("has a gripper that moves at {x} m/s, which none does"))?;
        check_within(angular, MAX_GRIPPER_RADPS, |x| format!("has a gripper that turns at {x} rad/s, which none does"))
    })
}

fn check_reward(reward: &RewardTerms) -> Result<(), String> {
    check_within(reward.to_array(), MAX_REWARD, |term| format!("has a reward of {term}, which no world gives"))
}

/// Checks that `|x| ≤ limit` for every number; NaN never passes. The error is `describe` of the first that fails.
fn check_within(
    numbers: impl IntoIterator<Item = f32>,
    limit: f32,
    describe: impl Fn(f32) -> String,
) -> Result<(), String> {
    let odd = numbers.into_iter().find(|x| !(-limit..=limit).contains(x));
    odd.map_or(Ok(()), |x| Err(describe(x)))
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use proto::EpisodeStats;

    use super::*;
    use crate::LearnerSetup;
    use crate::tests::fixtures::trajectory;
    use crate::tests::learning::small_setup;

    fn admission() -> Admission {
        let text = Catalog::builtin().get(&"6_005".parse().unwrap()).unwrap().to_toml("a test");
        let own = Catalog::from_files([("my-tower.toml", text.replace("\"6_005\"", "\"my-tower\"").as_str())]).unwrap();
        let catalog = Arc::new(Catalog::builtin().with(&own));
        LearnerSetup { catalog, ..small_setup(1) }.admission()
    }

    #[test]
    fn only_training_goals_and_starts_that_actors_draw_are_admitted() {
        let prebuilt = |id: &str| Start::Prebuilt(id.parse().unwrap());
        let held_out = Catalog::builtin().iter().find(|blueprint| blueprint.split() != Split::Train).unwrap();
        let held_out = held_out.id().as_str();
        for (goal, start, is_admitted) in [
            ("2_000", Start::Scattered, true),
            // A goal that the run was given.
            ("my-tower", Start::Scattered, true),
            ("16_404", Start::Scattered, false),
            (held_out, Start::Scattered, false),
            ("validation_7_000", Start::Scattered, false),
            ("3_000", prebuilt("2_001"), true),
            ("3_000", prebuilt(held_out), false),
            ("3_000", prebuilt("validation_7_000"), false),
            ("3_000", prebuilt("my-tower"), true),
            ("3_000", Start::NearGoal { undone: 1 }, false),
            ("3_000", Start::AsItIs, false),
        ] {
            let mut trajectory = trajectory(2, 5);
            (trajectory.task.blueprint, trajectory.task.start) = (goal.parse().unwrap(), start.clone());
            let check = admission().check(&trajectory);
            assert_eq!(check.is_ok(), is_admitted, "{goal} from {start:?}: {check:?}");
        }
    }

    #[test]
    fn what_no_actor_of_the_run_sends_is_refused() {
        type Spoil = fn(&mut Trajectory);
        let cases: [(Spoil, &str); 24] = [
            (|t| t.transitions[1].reward.connected = 1e5, "step 1 has a reward of 100000, which no world gives"),
            (|t| t.transitions[1].reward.force = f32::NAN, "step 1 has a reward of NaN, which no world gives"),
            (|t| t.transitions[0].behavior_log_prob = -1e5, "a log-probability of -100000, which no action has"),
            (|t| t.transitions[0].behavior_log_prob = f32::INFINITY, "a log-probability of inf, which no action has"),
            (|t| t.transitions[1].behavior_log_prob = f32::NAN, "a log-probability of NaN, which no action has"),
            (|t| t.transitions[0].action.moves[3][5] = 1e5, "step 0 has a move of 100000"),
            (|t| t.transitions[0].scene.blocks[7].position[2] = -60.0, "step 0 has a block at -60 m"),
            (|t| t.last_scene.blocks[7].position[0] = f32::NAN, "the end has a block at NaN m"),
            (
                |t| t.transitions[1].scene.blocks[0].orientation[3] = f32::NAN,
                "step 1 has an orientation with an entry of NaN",
            ),
            (
                |t| t.last_scene.grippers[1].as_mut().unwrap().orientation[0] = f32::INFINITY,
                "the end has an orientation with an entry of inf",
            ),
            (|t| t.last_scene.speeds_mps[3] = f32::INFINITY, "the end has a block with a speed of inf m/s"),
            (|t| t.transitions[1].action.choices[1] = None, "step 1 uses 1 grippers, the network has 2"),
            (
                |t| {
                    t.transitions[1].disturbance =
                        proto::Disturbance::new(0_u8.try_into().unwrap(), [0.0; 3], [1.0; 3]).ok()
                },
                "step 1 was disturbed",
            ),
            (|t| t.status = Status::Diverged, "the episode diverged"),
            (|t| t.transitions.clear(), "a trajectory has at least one step"),
            (|t| t.settings_hash ^= 1, "its actor has other settings of the policy or the world"),
            (
                |t| t.last_scene.grippers[1].as_mut().unwrap().linear_velocity[2] = -20.0,
                "the end has a gripper that moves at -20 m/s",
            ),
            (
                |t| t.last_scene.grippers[0].as_mut().unwrap().angular_velocity[0] = f32::NAN,
                "the end has a gripper that turns at NaN rad/s",
            ),
            (
                |t| {
                    t.status = Status::TimeLimit;
                    t.episode_stats =
                        Some(EpisodeStats { success: true, n_steps: 2, episode_return: Default::default() });
                },
                "its outcome contradicts the status",
            ),
            (|t| t.first_step = 99, "=101 steps are more than an episode of this run has, 100"),
            (|t| t.behavior_policy = BehaviorPolicy::Greedy, "=no greedy policy acts in a training run"),
            (|t| t.behavior_policy = BehaviorPolicy::Expert, "=no expert acts in a training run"),
            (
                |t| t.task.start = Start::Prebuilt("2_001".parse().unwrap()),
                "=no episode of this run begins with another blueprint built",
            ),
            (|t| t.task.start = Start::NearGoal { undone: 1 }, "=no episode of training begins near its goal"),
        ];
        let acting = ActingLimits { episode_steps: 100, has_prebuilt_starts: false };
        let rules = LearnerSetup { acting, ..small_setup(1) }.admission();
        assert_eq!(rules.check(&trajectory(2, 5)), Ok(()));
        // A message with `=` is the whole reason.
        for (spoil, message) in cases {
            let mut spoilt = trajectory(2, 5);
            spoil(&mut spoilt);
            let reason = rules.check(&spoilt).unwrap_err();
            let is_expected =
                message.strip_prefix('=').map_or_else(|| reason.contains(message), |whole| reason == whole);
            assert!(is_expected, "{reason}");
        }
    }

    #[test]
    fn draws_that_the_move_head_does_not_make_are_refused() {
        let hold = Some(Slot::HOLD.index());
        let check = |move_head, proposals| {
            let setup = small_setup(1).with_policy(|c| c.network.move_head = move_head);
            let mut drawn = trajectory(2, 5);
            drawn.transitions.iter_mut().for_each(|transition| transition.proposals = [hold, None]);
            drawn.transitions[1].proposals = proposals;
            setup.admission().check(&drawn)
        };
        for (proposals, message) in [
            ([hold, hold], None),
            ([hold, None], None),
            ([Some(32), None], None),
            ([Some(33), None], Some("step 1 was drawn from proposal 33, and the highest is 32")),
            ([hold, Some(255)], Some("step 1 was drawn from proposal 255, and the highest is 32")),
            ([None, hold], Some("step 1 names no proposal, as each draw does with policy.network.move_head = mixture")),
        ] {
            assert_eq!(check(MoveHead::Mixture, proposals).err().as_deref(), message, "{proposals:?}");
        }
        let error = check(MoveHead::Gaussian, [None, None]).unwrap_err();
        let message = "step 0 was drawn from a proposal, and there are none with policy.network.move_head = gaussian";
        assert_eq!(error, message);
    }
}
