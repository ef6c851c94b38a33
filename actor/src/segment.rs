//! Cuts episodes into segments to learn from.

use proto::{
    ActorId, BehaviorPolicy, EpisodeStats, RewardTerms, Scene, Status, Task, Trajectory, Transition, WeightsVersion,
};

/// Origin of segments.
#[derive(Debug)]
pub(crate) struct Identity {
    /// Name of the actor.
    pub(crate) actor: ActorId,
    /// Start time of the actor process, ms since 1970.
    pub(crate) epoch: u64,
    /// Hash of the settings of policy and world.
    pub(crate) settings_hash: u64,
}

/// Collects the steps of one episode.
///
/// A segment ends after `segment_len` steps or with the episode. If the episode diverges, only the steps since the last
/// cut are dropped. Earlier segments may already have been sent; they ended in valid scenes.
#[derive(Clone, Debug)]
pub(crate) struct SegmentBuilder {
    segment_len: usize,
    task: Task,
    transitions: Vec<Transition>,
    /// Oldest weights version among the collected steps.
    oldest_version: Option<WeightsVersion>,
    /// Index of the first collected step in its episode.
    first_step: u16,
    /// Return of the whole episode so far.
    episode_return: RewardTerms,
}

impl SegmentBuilder {
    /// Creates a builder at the start of an episode of `task`; `segment_len` is in steps, at least 1.
    pub(crate) fn new(segment_len: usize, task: Task) -> Self {
        Self {
            segment_len: segment_len.max(1),
            task,
            transitions: Vec::with_capacity(segment_len),
            oldest_version: None,
            first_step: 0,
            episode_return: RewardTerms::default(),
        }
    }

    /// Adds a step that led to `after` with `status`, acted with weights `version`. Returns the segment of `identity` that
    /// this completes; it gets its number where those of all threads meet.
    pub(crate) fn push(
        &mut self,
        transition: Transition,
        version: WeightsVersion,
        after: &Scene,
        status: Status,
        identity: &Identity,
    ) -> Option<Trajectory> {
        self.episode_return = self.episode_return + transition.reward;
        self.transitions.push(transition);
        let oldest = self.oldest_version.map_or(version, |oldest| oldest.min(version));
        self.oldest_version = Some(oldest);
        let n_collected = self.transitions.len();
        match status {
            Status::Diverged => {
                self.transitions.clear();
                return None;
            }
            Status::Running if n_collected < self.segment_len => return None,
            Status::Running | Status::Success | Status::TimeLimit => {}
        }
        let first_step = self.first_step;
        let n_steps = first_step.saturating_add(u16::try_from(n_collected).unwrap_or(u16::MAX));
        let ended = status != Status::Running;
        let stats = EpisodeStats { success: status == Status::Success, n_steps, episode_return: self.episode_return };
        let transitions = std::mem::replace(&mut self.transitions, Vec::with_capacity(self.segment_len));
        self.oldest_version = None;
        self.first_step = n_steps;
        Some(Trajectory {
            actor: identity.actor.clone(),
            epoch: identity.epoch,
            seq: 0,
            weights_version: oldest,
            settings_hash: identity.settings_hash,
            task: self.task.clone(),
            behavior_policy: BehaviorPolicy::Sampled,
            first_step,
            transitions,
            last_scene: after.clone(),
            status,
            episode_stats: ended.then_some(stats),
        })
    }
}
