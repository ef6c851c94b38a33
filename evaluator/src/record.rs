//! Records episodes of one agent, in the planned order.

use std::collections::BTreeMap;

use blueprints::Blueprint;
use environment::ExpertAgent;
use parking_lot::Mutex;
use policy::Policy;
use proto::{ActionMode, Agent, Trajectory};

use crate::performance::Performer;
use crate::pool::EvaluationPool;
use crate::recording::{Credits, Recorder};
use crate::report::{End, EpisodeResult};
use crate::sequences::EpisodeSpec;
use crate::setup::{EvalError, EvalSetup};

/// A completed episode.
#[derive(Clone, Debug)]
pub struct Recorded {
    /// The episode's steps; the actor is `expert` or `policy`.
    pub trajectory: Trajectory,
    /// Result of the episode. A diverged episode has [`Status::Running`](proto::Status::Running) in its trajectory.
    pub result: EpisodeResult,
}

/// Callbacks of [`record`]. Both are called by the threads that run the episodes, `on_episode` by one thread at a time.
pub struct Callbacks<'s> {
    /// Called at every step; returning false stops the recording.
    pub keep_going: &'s (dyn Fn() -> bool + Sync),
    /// Receives completed episodes in the planned order: the first episode of every blueprint, then the second of every
    /// blueprint, and so on. If the recording is stopped, some episodes may be missing in between.
    pub on_episode: &'s (dyn Fn(Recorded) + Sync),
}

/// Plays the setup's `n_episodes` for each blueprint; ignores the setup's action modes and reset-free runs. Returns
/// whether all episodes ended, which is false if `keep_going` returned false.
///
/// # Errors
/// If the weights do not fit or an episode cannot be started.
pub fn record(
    setup: &EvalSetup<'_>,
    performer: Performer<'_>,
    acting: ActionMode,
    blueprints: &[&Blueprint],
    callbacks: &Callbacks<'_>,
) -> Result<bool, EvalError> {
    let credits = performer.credits(acting);
    match performer {
        Performer::Expert => {
            let agent = || Ok::<_, EvalError>(ExpertAgent::new(&setup.environment));
            play(setup, &agent, credits, acting, blueprints, callbacks)
        }
        Performer::Policy(config, weights) => {
            let agent = || Policy::with_weights(config, weights).map_err(EvalError::from);
            play(setup, &agent, credits, acting, blueprints, callbacks)
        }
    }
}

fn play<A: Agent>(
    setup: &EvalSetup<'_>,
    agent: &(dyn Fn() -> Result<A, EvalError> + Sync),
    credits: Credits,
    acting: ActionMode,
    blueprints: &[&Blueprint],
    callbacks: &Callbacks<'_>,
) -> Result<bool, EvalError>
where
    EvalError: From<A::Error>,
{
    let (catalog, starts, seed) = (setup.catalog, setup.episodes.starts, setup.seed);
    let rounds = 0..u64::from(setup.episodes.n_episodes);
    let plan = rounds.flat_map(|idx| blueprints.iter().map(move |&blueprint| (blueprint, idx)));
    let sequences: Vec<_> =
        plan.map(|(blueprint, idx)| vec![EpisodeSpec::one_of(catalog, blueprint, starts, seed, idx)]).collect();
    let in_order = Mutex::new(InOrder::new(callbacks.on_episode));
    let keep = |idx: usize, trajectory: Option<Trajectory>, result: &EpisodeResult| {
        let recorded = trajectory.map(|trajectory| Recorded { trajectory, result: result.clone() });
        in_order.lock().put(idx, recorded);
    };
    let recorder = Recorder { credits, keep: &keep };
    let keep_going = callbacks.keep_going;
    let pool = EvaluationPool { setup, agent, observer: Some(&recorder), progress: None, keep_going };
    let (_, played) = pool.run(&sequences, acting);
    in_order.into_inner().clear();
    match played {
        Ok(()) => Ok(true),
        Err(EvalError::Interrupted) => Ok(false),
        Err(error) => Err(error),
    }
}

/// Holds back items that arrive too early, and passes all items on in order.
struct InOrder<'s, T> {
    /// The next index to pass on.
    next: usize,
    /// Early items by index; `None` marks an index without an item.
    early: BTreeMap<usize, Option<T>>,
    take: &'s (dyn Fn(T) + Sync),
}

impl<'s, T> InOrder<'s, T> {
    fn new(take: &'s (dyn Fn(T) + Sync)) -> Self {
        Self { next: 0, early: BTreeMap::new(), take }
    }

    /// Accepts the item with this index.
    fn put(&mut self, idx: usize, thing: Option<T>) {
        self.early.insert(idx, thing);
        while let Some(thing) = self.early.remove(&self.next) {
            self.next += 1;
            thing.into_iter().for_each(self.take);
        }
    }

    /// Passes on the remaining items, regardless of gaps.
    fn clear(self) {
        self.early.into_values().flatten().for_each(self.take);
    }
}

impl Recorded {
    /// Whether the physics diverged.
    pub fn is_diverged(&self) -> bool {
        matches!(self.result.end, End::Diverged)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use blueprints::Catalog;
    use environment::{Env, World};
    use proto::{Status, Valid};

    use super::*;
    use crate::config::EpisodeConfig;
    use crate::report::tests::goal;

    #[test]
    fn what_comes_too_early_waits_for_its_turn() {
        let taken = Mutex::new(Vec::new());
        let take = |x: char| taken.lock().push(x);
        let mut in_order = InOrder::new(&take);
        for (idx, thing) in [(1, Some('b')), (0, Some('a')), (3, Some('d')), (2, None), (6, Some('g'))] {
            in_order.put(idx, thing);
        }
        assert_eq!(*taken.lock(), ['a', 'b', 'd']);
        in_order.put(5, Some('f'));
        in_order.clear();
        assert_eq!(*taken.lock(), ['a', 'b', 'd', 'f', 'g']);
    }

    fn setup(n_threads: usize) -> EvalSetup<'static> {
        let episodes = EpisodeConfig { n_episodes: 3, n_threads, ..EpisodeConfig::default() };
        let environment = Valid::default();
        EvalSetup { catalog: Catalog::builtin(), environment, episodes, reset_free: None, n_worlds: 1, seed: 5 }
    }

    fn blueprints() -> Vec<&'static Blueprint> {
        ["2_000", "3_000"].map(goal).to_vec()
    }

    fn recorded(setup: &EvalSetup<'_>, keep_going: &(dyn Fn() -> bool + Sync)) -> (bool, Vec<Recorded>) {
        let episodes = Mutex::new(Vec::new());
        let callbacks = Callbacks { keep_going, on_episode: &|episode| episodes.lock().push(episode) };
        let is_complete = record(setup, Performer::Expert, ActionMode::Greedy, &blueprints(), &callbacks).unwrap();
        (is_complete, episodes.into_inner())
    }

    #[test]
    fn episodes_come_in_the_order_of_the_plan_and_can_be_played_again() {
        let (is_complete, episodes) = recorded(&setup(1), &|| true);
        assert!(is_complete);
        let ids: Vec<&str> = episodes.iter().map(|episode| episode.result.blueprint.as_str()).collect();
        assert_eq!(ids, ["2_000", "3_000", "2_000", "3_000", "2_000", "3_000"]);
        let (_, again) = recorded(&setup(3), &|| true);
        let trajectories = |episodes: &[Recorded]| episodes.iter().map(|e| e.trajectory.clone()).collect::<Vec<_>>();
        assert_eq!(trajectories(&episodes), trajectories(&again));
        // The recorded actions lead from the start to the recorded end.
        let Recorded { trajectory, .. } = &episodes[0];
        let mut world = World::new(&Valid::default());
        world.reset(&trajectory.task, Catalog::builtin()).unwrap();
        for step in &trajectory.transitions {
            assert_eq!(world.scene(), &step.scene);
            assert_eq!(world.step(&step.action).reward, step.reward);
        }
        assert_eq!((world.scene(), trajectory.status), (&trajectory.last_scene, Status::Success));
    }

    #[test]
    fn whole_episodes_are_kept_when_it_is_not_to_go_on() {
        let n_asked = AtomicUsize::new(0);
        let (is_complete, episodes) = recorded(&setup(1), &|| n_asked.fetch_add(1, Ordering::Relaxed) < 60);
        assert!(!is_complete && !episodes.is_empty() && episodes.len() < 6, "{} episodes", episodes.len());
        let (_, all) = recorded(&setup(1), &|| true);
        for (kept, whole) in episodes.iter().zip(&all) {
            assert_eq!(kept.trajectory, whole.trajectory);
        }
    }
}
