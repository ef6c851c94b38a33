//! Cuts episodes into segments to learn from.

use proto::{
    ActorId, BehaviorPolicy, EpisodeStats, RewardTerms, Scene, Status, Task, Trajectory, Transition, WeightsVersion,
};

/// Origin of segments.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Identity {
    /// Name of the actor.
    pub actor: ActorId,
    /// Start time of the actor process, ms since 1970.
    pub epoch: u64,
    /// Hash of the settings of policy and world.
    pub settings_hash: u64,
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

/// Result of adding a step.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Cut {
    /// No segment is complete yet.
    None,
    /// A segment, which gets its number where those of all threads meet.
    Segment(Box<Trajectory>),
    /// The episode diverged, and steps of it were dropped.
    Diverged {
        /// Steps since the last cut, at least 1.
        n_dropped_steps: u64,
    },
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

    /// Adds a step that led to `after` with `status`, acted with weights `version`.
    ///
    /// A segment that this completes is of `identity` and has number 0.
    pub(crate) fn push(
        &mut self,
        transition: Transition,
        version: WeightsVersion,
        after: &Scene,
        status: Status,
        identity: &Identity,
    ) -> Cut {
        self.episode_return = self.episode_return + transition.reward;
        self.transitions.push(transition);
        let oldest = self.oldest_version.map_or(version, |oldest| oldest.min(version));
        self.oldest_version = Some(oldest);
        let n_collected = self.transitions.len();
        match status {
            Status::Diverged => {
                self.transitions.clear();
                return Cut::Diverged { n_dropped_steps: n_collected as u64 };
            }
            Status::Running if n_collected < self.segment_len => return Cut::None,
            Status::Running | Status::Success | Status::TimeLimit => {}
        }
        let first_step = self.first_step;
        let n_steps = first_step.saturating_add(u16::try_from(n_collected).unwrap_or(u16::MAX));
        let ended = status != Status::Running;
        let stats = EpisodeStats { success: status == Status::Success, n_steps, episode_return: self.episode_return };
        let transitions = std::mem::replace(&mut self.transitions, Vec::with_capacity(self.segment_len));
        self.oldest_version = None;
        self.first_step = n_steps;
        Cut::Segment(Box::new(Trajectory {
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
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::toy;

    fn transition(connected: f32) -> Transition {
        let mut transition = toy::trajectory().transitions.remove(0);
        transition.reward.connected = connected;
        transition
    }

    /// Pushes steps `(reward, version, status)` into segments of 3 and returns what they complete.
    fn cuts(steps: &[(f32, u64, Status)]) -> Vec<Cut> {
        let mut builder = SegmentBuilder::new(3, toy::task());
        let push = |&(reward, version, status): &(f32, u64, Status)| {
            let version = WeightsVersion(version);
            let cut = builder.push(transition(reward), version, &toy::scene(), status, &toy::identity());
            if status != Status::Running {
                builder = SegmentBuilder::new(3, toy::task());
            }
            cut
        };
        steps.iter().map(push).filter(|cut| *cut != Cut::None).collect()
    }

    #[test]
    fn an_episode_of_four_steps_in_segments_of_three() {
        use Status::{Running, Success};
        let cuts =
            cuts(&[(1.0, 5, Running), (2.0, 4, Running), (3.0, 6, Running), (4.0, 7, Success), (8.0, 8, Success)]);
        let [Cut::Segment(first), Cut::Segment(second), Cut::Segment(third)] = &cuts[..] else { panic!("{cuts:?}") };
        assert_eq!((first.first_step, first.transitions.len(), first.status), (0, 3, Running));
        assert_eq!((first.episode_stats, first.weights_version), (None, WeightsVersion(4)));
        assert_eq!((second.first_step, second.transitions.len(), second.status), (3, 1, Success));
        assert_eq!(second.weights_version, WeightsVersion(7));
        // The return of the whole episode: 1 + 2 + 3 + 4.
        let stats = second.episode_stats.unwrap();
        assert_eq!((stats.success, stats.n_steps, stats.episode_return.connected), (true, 4, 10.0));
        // Nothing of one episode carries over to the next.
        let stats = third.episode_stats.unwrap();
        assert_eq!((third.first_step, stats.n_steps, stats.episode_return.connected), (0, 1, 8.0));
    }

    #[test]
    fn a_diverged_episode_loses_what_was_not_cut_yet() {
        use Status::{Diverged, Running};
        let running = (1.0, 0, Running);
        let cuts = cuts(&[running, running, running, running, (0.0, 0, Diverged)]);
        assert!(matches!(&cuts[0], Cut::Segment(first) if first.transitions.len() == 3));
        assert_eq!(cuts[1], Cut::Diverged { n_dropped_steps: 2 });
    }
}
