//! What happened in an episode of the expert, so that a failure has a cause and a replay.

use std::fmt;

use blueprints::Blueprint;
use environment::{Activity, Decision};
use proto::{Action, ActorId, Driver, Joint, N_GRIPPERS, RewardTerms, Scene, Status, Task, Trajectory, WeightsVersion};
use serde::{Deserialize, Serialize};

use crate::recording::Recording;
use crate::report::Episode;

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
    recording: Recording,
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
        Self { recording: Recording::default(), trouble, has_fetched: false, n_right, steps_since_gain: 0 }
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
        self.recording.note(before, decision.action, reward);
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

    /// The episode as a trajectory of no weights.
    pub(super) fn into_replay(self, task: &Task, last: &Scene, end: &Episode) -> Option<Trajectory> {
        let actor = ActorId::try_from("expert".to_owned()).ok()?;
        self.recording.into_trajectory(actor, Driver::Expert, WeightsVersion(0), task, last, end)
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
