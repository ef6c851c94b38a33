//! Plays one episode on demand and records it for display.

use blueprints::{Blueprint, Catalog};
use environment::{EnvironmentConfig, ExpertAgent, Step, World};
use parking_lot::Mutex;
use policy::{Policy, PolicyConfig};
use proto::{
    ActionMode, ActorId, Agent, BehaviorPolicy, Observation, Scene, Start, Trajectory, Valid, Weights, WeightsVersion,
};

use crate::recording::Recording;
use crate::report::EpisodeResult;
use crate::sequences::{EpisodeObserver, EpisodeSpec, Place, Rules, run_sequences};
use crate::setup::EvalError;

/// The agent that acts in an episode.
#[derive(Clone, Copy, Debug)]
pub enum Performer<'p> {
    /// The scripted expert.
    Expert,
    /// A policy with this configuration and these weights.
    Policy(&'p Valid<PolicyConfig>, &'p Weights),
}

/// The requested episode.
#[derive(Clone, Copy, Debug)]
pub struct Performance<'p> {
    /// The world.
    pub environment: &'p Valid<EnvironmentConfig>,
    /// The goal, which may be missing from the catalog.
    pub blueprint: &'p Blueprint,
    /// Goals built before it in the same world, without a reset. If empty, the blocks are scattered.
    pub before: &'p [Blueprint],
    /// Action mode of a policy. The expert has only one.
    pub acting: ActionMode,
    /// Seed of the scattered start and of sampled actions.
    pub seed: u64,
}

/// Plays the goals of `before`, then the episode, to its end. Equal arguments give an equal episode. Returns the
/// episode, whose actor is `expert` or `policy`, or `None` if it has no steps. `keep_going` is called at every step.
///
/// # Errors
/// If the weights do not fit, the episode cannot be started, or `keep_going` returns false.
pub fn perform(
    performance: Performance<'_>,
    performer: Performer<'_>,
    keep_going: &(dyn Fn() -> bool + Sync),
) -> Result<Option<Trajectory>, EvalError> {
    let witness = Witness { credits: Credits::of(performer, performance.acting), seen: Mutex::default() };
    match performer {
        Performer::Expert => run(performance, ExpertAgent::new(performance.environment), witness, keep_going),
        Performer::Policy(config, weights) => {
            run(performance, Policy::with_weights(config, weights)?, witness, keep_going)
        }
    }
}

fn run<A: Agent>(
    performance: Performance<'_>,
    mut agent: A,
    witness: Witness,
    keep_going: &(dyn Fn() -> bool + Sync),
) -> Result<Option<Trajectory>, EvalError>
where
    EvalError: From<A::Error>,
{
    let Performance { environment, blueprint, before, acting, seed } = performance;
    let mut catalog = Catalog::of_one(blueprint.clone());
    for other in before.iter().filter(|other| other.id() != blueprint.id()) {
        catalog = catalog.with(&Catalog::of_one(other.clone()));
    }
    let rules =
        Rules { catalog: &catalog, acting, success: &environment.success, keep_going, observer: Some(&witness) };
    let goals = before.iter().chain([blueprint]).zip(0..);
    let specs: Vec<_> = goals
        .map(|(goal, idx)| {
            let start = if idx == 0 { Start::Scattered } else { Start::AsItIs };
            EpisodeSpec::new(goal, start, seed, idx)
        })
        .collect();
    let mut sequences = std::iter::once((0, specs.as_slice()));
    run_sequences(&rules, &mut agent, vec![World::new(environment)], || sequences.next(), |_, _| {})?;
    Ok(witness.seen.into_inner())
}

/// The actor, behavior policy, and weights version named in a recording.
#[derive(Clone, Debug)]
pub(crate) struct Credits {
    pub(crate) actor: ActorId,
    pub(crate) behavior_policy: BehaviorPolicy,
    pub(crate) weights_version: WeightsVersion,
}

impl Credits {
    /// Returns the credits of a performer; the actor is `expert` or `policy`.
    pub(crate) fn of(performer: Performer<'_>, acting: ActionMode) -> Self {
        let (actor, behavior_policy, weights_version) = match (performer, acting) {
            (Performer::Expert, _) => ("expert", BehaviorPolicy::Expert, WeightsVersion(0)),
            (Performer::Policy(_, weights), ActionMode::Greedy) => ("policy", BehaviorPolicy::Greedy, weights.version),
            (Performer::Policy(_, weights), ActionMode::Sampled) => {
                ("policy", BehaviorPolicy::Sampled, weights.version)
            }
        };
        let actor = ActorId::try_from(actor.to_owned()).expect("the name is lower case");
        Self { actor, behavior_policy, weights_version }
    }
}

/// Records the last episode.
struct Witness {
    credits: Credits,
    seen: Mutex<Option<Trajectory>>,
}

impl<A> EpisodeObserver<A> for Witness {
    type Record = Recording;

    fn begin(&self, _: Place, _: &EpisodeSpec, _: ActionMode, _: Observation<'_>) -> Option<Recording> {
        Some(Recording::default())
    }

    fn observe(&self, recording: &mut Recording, step: Step, _: &A, _: usize, _: Observation<'_>) {
        recording.push(step);
    }

    fn end(&self, recording: Recording, spec: &EpisodeSpec, last: &Scene, result: &EpisodeResult) {
        let Credits { actor, behavior_policy, weights_version } = self.credits.clone();
        *self.seen.lock() =
            recording.into_trajectory(actor, behavior_policy, weights_version, spec.task(), last, result);
    }
}

#[cfg(test)]
mod tests {
    use proto::Status;

    use super::*;

    #[test]
    fn the_expert_builds_two_blocks_and_equal_seeds_give_equal_episodes() {
        let environment = Valid::default();
        let blueprint = Catalog::builtin().get(&"2_000".parse().unwrap()).unwrap();
        let play = |seed| {
            let performance =
                Performance { environment: &environment, blueprint, before: &[], acting: ActionMode::Greedy, seed };
            perform(performance, Performer::Expert, &|| true).unwrap().unwrap()
        };
        let first = play(1);
        assert_eq!((first.status, first.actor.as_str()), (Status::Success, "expert"));
        assert_eq!(first, play(1));
        assert_ne!(first.transitions[0].scene, play(2).transitions[0].scene);
    }

    #[test]
    fn a_goal_can_begin_with_what_is_left_of_those_before() {
        let environment = Valid::default();
        let goals = ["2_000", "2_001"].map(|id| Catalog::builtin().get(&id.parse().unwrap()).unwrap().clone());
        let play = |blueprint, before| {
            let performance =
                Performance { environment: &environment, blueprint, before, acting: ActionMode::Greedy, seed: 1 };
            perform(performance, Performer::Expert, &|| true).unwrap().unwrap()
        };
        let (alone, second) = (play(&goals[0], &[]), play(&goals[1], &goals[..1]));
        assert_eq!((second.status, &second.task.blueprint), (Status::Success, goals[1].id()));
        assert_eq!((&second.task.start, second.transitions[0].scene.joints.len()), (&Start::AsItIs, 1));
        assert!(alone.transitions[0].scene.joints.is_empty());
        assert_eq!(second, play(&goals[1], &goals[..1]));
    }

    #[test]
    fn nobody_waits_for_an_episode_that_is_no_longer_wanted() {
        let environment = Valid::default();
        let blueprint = Catalog::builtin().get(&"2_000".parse().unwrap()).unwrap();
        let performance =
            Performance { environment: &environment, blueprint, before: &[], acting: ActionMode::Greedy, seed: 1 };
        let ended = perform(performance, Performer::Expert, &|| false);
        assert!(matches!(ended, Err(EvalError::Interrupted)), "{ended:?}");
    }
}
