//! What happened in an episode of the expert, so that a failure has a cause and a replay.

use std::fmt;

use blueprints::Blueprint;
use environment::{Activity, Decision};
use proto::{
    Action, ActorId, Joint, N_GRIPPERS, Outcome, RewardTerms, Scene, Status, Task, Trajectory, Transition,
    WeightsVersion,
};
use serde::{Deserialize, Serialize};

use crate::report::{End, Episode};

/// This many steps of one trouble are enough to call it the cause.
const MANY_STEPS: u32 = 15;
/// So many steps in which nothing new connected mean that it was stuck.
const STUCK_STEPS: u32 = 30;

/// Why an episode failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Cause {
    /// The blueprint has no order of assembly.
    NoOrder,
    /// The physics left the rails.
    Diverged,
    /// Blocks snapped together wrongly, and taking them apart took the time or was not over.
    WrongConnection,
    /// Right connections broke.
    Break,
    /// Blocks in the way took the time.
    Clutter,
    /// For a long time nothing new connected.
    Stuck,
    /// It went on well but was not over.
    Time,
}

/// What an episode went through.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Trouble {
    /// Why it failed.
    pub cause: Cause,
    /// Steps of the episode.
    pub n_steps: u32,
    /// Steps spent on taking apart, those before the first block was fetched not counted.
    pub n_repair_steps: u32,
    /// Steps before that, on what stood at the start.
    pub n_takedown_steps: u32,
    /// Steps spent on moving blocks out of the way.
    pub n_clearing_steps: u32,
    /// Wrong connections that came about.
    pub n_wrong_snaps: u32,
    /// Right connections that were lost.
    pub n_breaks: u32,
    /// Wrong connections at the end.
    pub n_wrong_left: u32,
    /// Right connections missing at the end.
    pub n_missing: u32,
}

/// The record of an episode.
pub(super) struct Diary {
    transitions: Vec<Transition>,
    trouble: Trouble,
    has_fetched: bool,
    n_right: u32,
    steps_since_gain: u32,
}

impl Diary {
    pub(super) fn new(scene: &Scene, blueprint: &Blueprint) -> Self {
        let n_right = count(scene, |joint| is_right(blueprint, joint));
        let trouble = Trouble {
            cause: Cause::Time,
            n_steps: 0,
            n_repair_steps: 0,
            n_takedown_steps: 0,
            n_clearing_steps: 0,
            n_wrong_snaps: 0,
            n_breaks: 0,
            n_wrong_left: 0,
            n_missing: 0,
        };
        Self { transitions: Vec::new(), trouble, has_fetched: false, n_right, steps_since_gain: 0 }
    }

    /// Takes a step: the scene before, what was decided, what that earned, the scene after.
    pub(super) fn note(
        &mut self,
        before: Scene,
        decision: Decision,
        reward: RewardTerms,
        after: &Scene,
        blueprint: &Blueprint,
    ) {
        let trouble = &mut self.trouble;
        trouble.n_steps += 1;
        match decision.activity {
            Activity::TakingDown if self.has_fetched => trouble.n_repair_steps += 1,
            Activity::TakingDown => trouble.n_takedown_steps += 1,
            Activity::Clearing => trouble.n_clearing_steps += 1,
            Activity::Adding => self.has_fetched = true,
            Activity::Settling => {}
        }
        let is_new = |joint: &Joint| !before.joints.contains(joint);
        trouble.n_wrong_snaps += count(after, |joint| is_new(joint) && !is_right(blueprint, joint));
        trouble.n_breaks += count(&before, |joint| !after.joints.contains(joint) && is_right(blueprint, joint));
        let n_right = count(after, |joint| is_right(blueprint, joint));
        self.steps_since_gain = if n_right > self.n_right { 0 } else { self.steps_since_gain + 1 };
        self.n_right = n_right;
        trouble.n_wrong_left = after.joints.len() as u32 - n_right;
        trouble.n_missing = blueprint.links().len() as u32 - n_right;
        self.transitions.push(Transition {
            scene: before,
            action: decision.action,
            behavior_log_prob: 0.0,
            value: 0.0,
            reward,
            label: None,
        });
    }

    /// What went wrong in an episode that ended so.
    pub(super) fn trouble(&self, status: Status, has_no_order: bool) -> Trouble {
        let t = &self.trouble;
        let cause = if has_no_order {
            Cause::NoOrder
        } else if status == Status::Diverged {
            Cause::Diverged
        } else if t.n_wrong_left > 0 || t.n_repair_steps >= MANY_STEPS {
            Cause::WrongConnection
        } else if t.n_clearing_steps >= MANY_STEPS {
            Cause::Clutter
        } else if t.n_breaks > 1 {
            Cause::Break
        } else if self.steps_since_gain >= STUCK_STEPS {
            Cause::Stuck
        } else {
            Cause::Time
        };
        Trouble { cause, ..*t }
    }

    /// The episode as a trajectory; without log-probabilities and values, as nobody learns from it.
    pub(super) fn into_replay(self, task: &Task, last: &Scene, end: &Episode) -> Option<Trajectory> {
        let actor = ActorId::try_from("expert".to_owned()).ok()?;
        let status = match end.end {
            End::Success { .. } => Status::Success,
            End::TimeLimit => Status::TimeLimit,
            // A diverged episode has no status of its own on the wire; what was seen of it is cut there.
            End::Diverged => Status::Running,
        };
        let outcome = Outcome {
            success: status == Status::Success,
            n_steps: u16::try_from(end.n_steps).ok()?,
            episode_return: end.episode_return,
        };
        (!self.transitions.is_empty()).then(|| Trajectory {
            actor,
            epoch: 0,
            seq: 0,
            weights_version: WeightsVersion(0),
            task: task.clone(),
            driver: proto::Driver::Sample,
            first_step: 0,
            transitions: self.transitions,
            last_scene: last.clone(),
            status,
            bootstrap_value: 0.0,
            outcome: (status != Status::Running).then_some(outcome),
        })
    }
}

impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::NoOrder => "no order of assembly",
            Self::Diverged => "diverged",
            Self::WrongConnection => "wrong connection",
            Self::Break => "break",
            Self::Clutter => "clutter",
            Self::Stuck => "stuck",
            Self::Time => "time",
        })
    }
}

/// An action that leaves the world alone.
pub(super) fn nothing() -> Decision {
    let action = Action { choices: [None; N_GRIPPERS], moves: [[0.0; 6]; blueprints::N_BLOCKS] };
    Decision { action, activity: Activity::Settling }
}

fn is_right(blueprint: &Blueprint, joint: &Joint) -> bool {
    blueprint.link(joint.a, joint.b).is_some_and(|link| link.relative == joint.relative)
}

fn count(scene: &Scene, wanted: impl Fn(&Joint) -> bool) -> u32 {
    scene.joints.iter().filter(|joint| wanted(joint)).count() as u32
}
