//! Plays one episode on demand and records it for display.

use blueprints::{Blueprint, Catalog};
use environment::{EnvironmentConfig, World};
use parking_lot::Mutex;
use proto::{ActionMode, Disturbance, Start, Trajectory, Valid};

use crate::recording::Recorder;
use crate::report::EpisodeResult;
use crate::sequences::{Rules, run_sequences};
use crate::setup::{EvalError, Performer};
use crate::spec::EpisodeSpec;

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
    /// What somebody outside does to the blocks, by the steps from 0; nothing while `before` is built.
    pub disturbances: &'p [(u16, Disturbance)],
}

/// Plays the goals of `before`, then the episode, to its end. Equal arguments give an equal episode. Returns the
/// episode, whose actor is `expert` or `policy`. `keep_going` is called at every step.
///
/// # Errors
/// If the weights do not fit, the episode cannot be started, or `keep_going` returns false.
pub fn perform(
    performance: Performance<'_>,
    performer: Performer<'_>,
    keep_going: &(dyn Fn() -> bool + Sync),
) -> Result<Trajectory, EvalError> {
    let Performance { environment, blueprint, before, acting, seed, disturbances } = performance;
    let mut catalog = Catalog::of_one(blueprint.clone());
    for other in before.iter().filter(|other| other.id() != blueprint.id()) {
        catalog = catalog.with(&Catalog::of_one(other.clone()));
    }
    // Of all episodes, the last one stays.
    let seen = Mutex::new(None);
    let keep = |_: usize, episode: Trajectory, _: &EpisodeResult| *seen.lock() = Some(episode);
    let recorder = Some(&keep as &dyn Recorder);
    let rules = Rules { catalog: &catalog, environment, performer, acting, keep_going, recorder };
    let goals = before.iter().chain([blueprint]).zip(0..);
    let specs: Vec<_> = goals
        .map(|(goal, idx)| {
            let start = if idx == 0 { Start::Scattered } else { Start::AsItIs };
            EpisodeSpec::new(goal, start, seed, idx)
        })
        .collect();
    let mut sequences = std::iter::once((0, specs.as_slice()));
    let mut world = World::new(environment);
    world.disturb(before.len(), disturbances);
    run_sequences(&rules, vec![world], || sequences.next(), |_, _| {})?;
    let mut episode = seen.into_inner().expect("every episode has ended");
    for (step, disturbance) in disturbances {
        // The episode may have ended before.
        if let Some(step) = episode.transitions.get_mut(usize::from(*step)) {
            step.disturbance = Some(*disturbance);
        }
    }
    Ok(episode)
}

#[cfg(test)]
mod tests {
    use environment::Env;
    use proto::Status;

    use super::*;
    use crate::report::tests::goal;

    fn calm<'p>(environment: &'p Valid<EnvironmentConfig>, blueprint: &'p Blueprint, seed: u64) -> Performance<'p> {
        let acting = ActionMode::Greedy;
        Performance { environment, blueprint, before: &[], acting, seed, disturbances: &[] }
    }

    #[test]
    fn equal_seeds_give_equal_episodes_and_a_goal_can_begin_with_what_is_left_of_those_before() {
        let environment = Valid::default();
        let goals = ["2_000", "2_001"].map(|id| goal(id).clone());
        let play = |blueprint, before, seed| {
            let performance = Performance { before, ..calm(&environment, blueprint, seed) };
            perform(performance, Performer::Expert, &|| true).unwrap()
        };
        let alone = play(&goals[0], &[], 1);
        assert_eq!((alone.status, alone.actor.as_str()), (Status::Success, "expert"));
        assert_ne!(alone.transitions[0].scene, play(&goals[0], &[], 2).transitions[0].scene);
        let second = play(&goals[1], &goals[..1], 1);
        assert_eq!((second.status, &second.task.blueprint), (Status::Success, goals[1].id()));
        assert_eq!((&second.task.start, second.transitions[0].scene.joints.len()), (&Start::AsItIs, 1));
        assert!(alone.transitions[0].scene.joints.is_empty());
        assert_eq!(second, play(&goals[1], &goals[..1], 1));
    }

    #[test]
    fn a_disturbed_episode_is_recorded_goes_on_and_replays_exactly() {
        let environment = Valid::default();
        let goals = ["3_000", "2_000"].map(|id| goal(id).clone());
        let play = |before, disturbances| {
            let performance = Performance { before, disturbances, ..calm(&environment, &goals[0], 1) };
            perform(performance, Performer::Expert, &|| true).unwrap()
        };
        let quiet = play(&[], &[]);
        let joined = |episode: &Trajectory, step: usize| episode.transitions[step].scene.joints.len();
        let step = (0..quiet.transitions.len()).find(|&step| joined(&quiet, step) == 1).unwrap();
        let block = quiet.transitions[step].scene.joints[0].b;
        let moved = Disturbance::new(block, [1.0, 0.0, -0.5], [0.0; 3]).unwrap();
        let pushed = Disturbance::new(block, [0.0; 3], [1.0, 0.0, 2.0]).unwrap();
        let disturbances = [(step as u16, moved), (step as u16 + 5, pushed), (999, pushed)];
        let disturbed = play(&[], &disturbances);
        // It comes off the others and out of the ground, and the expert builds the goal all the same.
        let scenes =
            |episode: &Trajectory| episode.transitions[..=step].iter().map(|t| t.scene.clone()).collect::<Vec<_>>();
        assert_eq!(scenes(&disturbed), scenes(&quiet), "the step's effect shows after it");
        assert_eq!(joined(&disturbed, step + 1), 0);
        assert!(disturbed.transitions[step + 1].scene.blocks[block.get()].position[2] > 0.0);
        assert_eq!(disturbed.status, Status::Success);
        let recorded = |episode: &Trajectory| -> Vec<(u16, Disturbance)> {
            let steps = episode.transitions.iter().zip(0..);
            steps.filter_map(|(transition, step)| Some((step, transition.disturbance?))).collect()
        };
        assert_eq!(recorded(&disturbed), disturbances[..2], "the last would come after the end");
        // The recording has all that it takes to see the same again.
        let bytes = proto::codec::encode_recording(&disturbed);
        let read = proto::codec::decode_recording(&bytes).unwrap();
        let mut world = World::new(&environment);
        world.disturb(0, &recorded(&read));
        world.reset(&read.task, Catalog::builtin()).unwrap();
        for transition in &read.transitions {
            assert_eq!(world.scene(), &transition.scene);
            world.step(&transition.action);
        }
        assert_eq!(world.scene(), &read.last_scene);
        // What was built before stays as it was.
        let early = [(0, moved)];
        let [second, calm] = [&early[..], &[]].map(|disturbances| play(&goals[1..], disturbances));
        assert_eq!(second.transitions[0].scene, calm.transitions[0].scene);
        assert_ne!(second.transitions[1].scene, calm.transitions[1].scene);
        assert_eq!(recorded(&second), early);
    }

    #[test]
    fn nobody_waits_for_an_episode_that_is_no_longer_wanted() {
        let environment = Valid::default();
        let ended = perform(calm(&environment, goal("2_000"), 1), Performer::Expert, &|| false);
        assert!(matches!(ended, Err(EvalError::Interrupted)), "{ended:?}");
    }
}
