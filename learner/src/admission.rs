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
        if trajectory
            .episode_stats
            .as_ref()
            .is_some_and(|stats| stats.success != (trajectory.status == Status::Success))
        {
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
        let odd = action.moves.as_flattened().iter().find(|entry| !within(**entry, MAX_MOVE));
        odd.map_or(Ok(()), |entry| Err(format!("has a move of {entry}")))
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
    let odd = coordinates.into_iter().find(|x| !within(*x, MAX_POSITION_M));
    odd.map_or(Ok(()), |x| Err(format!("has a block at {x} m, where no episode goes on")))?;
    let orientations = scene.blocks.iter().map(|block| block.orientation);
    let orientations = orientations.chain(scene.grippers.iter().flatten().map(|gripper| gripper.orientation));
    if let Some(x) = orientations.flatten().find(|x| !within(*x, MAX_ORIENTATION)) {
        return Err(format!("has an orientation with an entry of {x}, which no unit quaternion has"));
    }
    if let Some(x) = scene.speeds_mps.into_iter().find(|x| !x.is_finite()) {
        return Err(format!("has a block with a speed of {x} m/s"));
    }
    for gripper in scene.grippers.iter().flatten() {
        let faster = |velocity: [f32; 3], max: f32| velocity.into_iter().find(|x| !within(*x, max));
        if let Some(x) = faster(gripper.linear_velocity, MAX_GRIPPER_MPS) {
            return Err(format!("has a gripper that moves at {x} m/s, which none does"));
        }
        if let Some(x) = faster(gripper.angular_velocity, MAX_GRIPPER_RADPS) {
            return Err(format!("has a gripper that turns at {x} rad/s, which none does"));
        }
    }
    Ok(())
}

fn check_reward(reward: &RewardTerms) -> Result<(), String> {
    let &RewardTerms { connected, wrong, magnets, blocks, force } = reward;
    let odd = [connected, wrong, magnets, blocks, force].into_iter().find(|term| !within(*term, MAX_REWARD));
    odd.map_or(Ok(()), |term| Err(format!("has a reward of {term}, which no world gives")))
}

/// Returns whether `|x| ≤ limit`; false for NaN.
fn within(x: f32, limit: f32) -> bool {
    x.abs() <= limit
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use proto::EpisodeStats;

    use super::*;
    use crate::LearnerSetup;
    use crate::fixtures::trajectory;
    use crate::tests::learning::small_setup;

    fn admission() -> Admission {
        let text = Catalog::builtin().get(&"6_005".parse().unwrap()).unwrap().to_toml("a test");
        let own = Catalog::from_files([("my-tower.toml", text.replace("\"6_005\"", "\"my-tower\"").as_str())]).unwrap();
        let catalog = Arc::new(Catalog::builtin().with(&own));
        LearnerSetup { catalog, ..small_setup(1) }.admission()
    }

    fn of_goal(goal: &str, start: Start) -> Trajectory {
        let mut trajectory = trajectory(2, 5);
        (trajectory.task.blueprint, trajectory.task.start) = (goal.parse().unwrap(), start);
        trajectory
    }

    #[test]
    fn only_training_goals_are_admitted() {
        let held_out = Catalog::builtin().iter().find(|blueprint| blueprint.split() != Split::Train).unwrap();
        for (goal, is_admitted) in [
            ("2_000", true),
            // A goal that the run was given.
            ("my-tower", true),
            ("16_404", false),
            (held_out.id().as_str(), false),
            ("validation_7_000", false),
        ] {
            let trajectory = of_goal(goal, Start::Scattered);
            assert_eq!(admission().check(&trajectory).is_ok(), is_admitted, "{goal}");
        }
    }

    #[test]
    fn only_starts_that_actors_draw_are_admitted() {
        let prebuilt = |id: &str| Start::Prebuilt(id.parse().unwrap());
        let held_out = Catalog::builtin().iter().find(|blueprint| blueprint.split() != Split::Train).unwrap();
        for (start, is_admitted) in [
            (prebuilt("2_001"), true),
            (prebuilt(held_out.id().as_str()), false),
            (prebuilt("validation_7_000"), false),
            (prebuilt("my-tower"), true),
            (Start::NearGoal { undone: 1 }, false),
            (Start::AsItIs, false),
        ] {
            let check = admission().check(&of_goal("3_000", start.clone()));
            assert_eq!(check.is_ok(), is_admitted, "{start:?}: {check:?}");
        }
    }

    #[test]
    fn implausible_numbers_are_refused() {
        type Spoil = fn(&mut Trajectory);
        let cases: [(Spoil, &str); 19] = [
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
        ];
        let rules = admission();
        assert_eq!(rules.check(&trajectory(2, 5)), Ok(()));
        for (spoil, message) in cases {
            let mut spoilt = trajectory(2, 5);
            spoil(&mut spoilt);
            let reason = rules.check(&spoilt).unwrap_err();
            assert!(reason.contains(message), "{reason}");
        }
    }

    #[test]
    fn draws_that_the_move_head_does_not_make_are_refused() {
        let hold = Some(Slot::alone(policy::proposals::Kind::Hold).index());
        let check = |move_head, proposals| {
            let mut setup = small_setup(1);
            setup.policy = setup.policy.with(|c| c.network.move_head = move_head).unwrap();
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

    #[test]
    fn what_the_settings_of_the_run_exclude_is_refused() {
        type Spoil = fn(&mut Trajectory);
        let mut setup = small_setup(1);
        setup.acting = ActingLimits { episode_steps: 100, has_prebuilt_starts: false };
        let rules = setup.admission();
        let cases: [(Spoil, &str); 5] = [
            (|t| t.first_step = 99, "101 steps are more than an episode of this run has, 100"),
            (|t| t.behavior_policy = BehaviorPolicy::Greedy, "no greedy policy acts in a training run"),
            (|t| t.behavior_policy = BehaviorPolicy::Expert, "no expert acts in a training run"),
            (
                |t| t.task.start = Start::Prebuilt("2_001".parse().unwrap()),
                "no episode of this run begins with another blueprint built",
            ),
            (|t| t.task.start = Start::NearGoal { undone: 1 }, "no episode of training begins near its goal"),
        ];
        for (spoil, message) in cases {
            let mut spoilt = trajectory(2, 5);
            spoil(&mut spoilt);
            assert_eq!(rules.check(&spoilt), Err(message.to_owned()));
        }
    }
}
