//! Records episodes of one agent.

use blueprints::Blueprint;
use proto::{ActionMode, Trajectory};

use crate::episodes::Follower;
use crate::pool::EvaluationPool;
use crate::report::EpisodeResult;
use crate::setup::{EvalError, EvalSetup, Performer};
use crate::spec::EpisodeSpec;

/// Plays the setup's `n_episodes` for each blueprint; ignores the setup's action modes and reset-free runs, and the
/// follower's endings. Returns whether all episodes ended, which is false if `keep_going` returned false.
///
/// `on_episode` is called by the threads that run the episodes when one ends. It gets the episode's place in the plan,
/// from 0: the first episode of every blueprint, then the second of every blueprint, and so on. The trajectory's actor
/// is `expert` or `policy`; that of a diverged episode has [`Status::Running`](proto::Status::Running).
///
/// # Errors
/// If the weights do not fit or an episode cannot be started.
pub fn record(
    setup: &EvalSetup<'_>,
    performer: Performer<'_>,
    acting: ActionMode,
    blueprints: &[&Blueprint],
    follower: &Follower<'_>,
    on_episode: &(dyn Fn(usize, Trajectory, &EpisodeResult) + Sync),
) -> Result<bool, EvalError> {
    let (catalog, starts, seed) = (setup.catalog, setup.episodes.starts, setup.seed);
    let rounds = 0..u64::from(setup.episodes.n_episodes);
    let plan = rounds.flat_map(|idx| blueprints.iter().map(move |&blueprint| (blueprint, idx)));
    let sequences: Vec<_> =
        plan.map(|(blueprint, idx)| vec![EpisodeSpec::one_of(catalog, blueprint, starts, seed, idx)]).collect();
    let &Follower { keep_going, progress, .. } = follower;
    let pool = EvaluationPool { setup, performer, recorder: Some(&on_episode), progress, keep_going };
    pool.plan(sequences.len() as u64);
    let (_, played) = pool.run(&sequences, acting);
    match played {
        Ok(()) => Ok(true),
        Err(EvalError::Interrupted) => Ok(false),
        Err(error) => Err(error),
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::sync::atomic::{AtomicUsize, Ordering};

    use blueprints::Catalog;
    use environment::{Env, World};
    use parking_lot::Mutex;
    use proto::{Status, Valid};

    use super::*;
    use crate::config::EpisodeConfig;
    use crate::episodes::tests::small_setup;
    use crate::report::tests::goal;

    fn setup(n_threads: usize) -> EvalSetup<'static> {
        let episodes = EpisodeConfig { n_episodes: 3, n_threads, ..EpisodeConfig::default() };
        EvalSetup { environment: Valid::default(), n_worlds: 1, seed: 5, ..small_setup(episodes) }
    }

    /// The episodes by their place in the plan.
    type Recorded = BTreeMap<usize, Trajectory>;

    fn recorded(setup: &EvalSetup<'_>, keep_going: &(dyn Fn() -> bool + Sync)) -> (bool, Recorded) {
        let episodes = Mutex::new(Recorded::new());
        let on_episode = |idx: usize, trajectory: Trajectory, result: &EpisodeResult| {
            assert_eq!(trajectory.task.blueprint, result.blueprint);
            assert!(episodes.lock().insert(idx, trajectory).is_none());
        };
        let goals = ["2_000", "3_000"].map(goal);
        let follower = Follower { keep_going, ..Follower::default() };
        let is_complete = record(setup, Performer::Expert, ActionMode::Greedy, &goals, &follower, &on_episode).unwrap();
        (is_complete, episodes.into_inner())
    }

    #[test]
    fn episodes_have_their_place_in_the_plan_and_can_be_played_again() {
        let (is_complete, episodes) = recorded(&setup(1), &|| true);
        assert!(is_complete);
        let goals: Vec<_> = episodes.iter().map(|(idx, episode)| (*idx, episode.task.blueprint.as_str())).collect();
        assert_eq!(goals, [(0, "2_000"), (1, "3_000"), (2, "2_000"), (3, "3_000"), (4, "2_000"), (5, "3_000")]);
        assert_eq!(recorded(&setup(3), &|| true).1, episodes);
        // The recorded actions lead from the start to the recorded end.
        let episode = &episodes[&0];
        let mut world = World::new(&Valid::default());
        world.reset(&episode.task, Catalog::builtin()).unwrap();
        for step in &episode.transitions {
            assert_eq!(world.scene(), &step.scene);
            assert_eq!(world.step(&step.action).reward, step.reward);
        }
        assert_eq!((world.scene(), episode.status), (&episode.last_scene, Status::Success));
    }

    #[test]
    fn whole_episodes_are_kept_when_it_is_not_to_go_on() {
        let n_asked = AtomicUsize::new(0);
        let (is_complete, episodes) = recorded(&setup(1), &|| n_asked.fetch_add(1, Ordering::Relaxed) < 60);
        assert!(!is_complete && !episodes.is_empty() && episodes.len() < 6, "{} episodes", episodes.len());
        let (_, all) = recorded(&setup(1), &|| true);
        assert!(episodes.iter().all(|(idx, episode)| *episode == all[idx]));
    }
}
