//! Sequences of toy worlds whose endings are scripted.

use blueprints::{Blueprint, Split};

use super::*;
use crate::config::Starts;
use crate::episodes::tests::performer;

#[path = "../../../environment/tests/toy/mod.rs"]
mod toy;

use toy::Toy;
pub(crate) use toy::scene;

pub(crate) fn goal() -> &'static Blueprint {
    Catalog::builtin().of_split(Split::Train)[0]
}

fn run(worlds: Vec<Toy>, sequences: &[Vec<EpisodeSpec>]) -> Vec<Vec<EpisodeResult>> {
    let rules = Rules {
        catalog: Catalog::builtin(),
        environment: &EnvironmentConfig::default(),
        performer: performer(),
        acting: ActionMode::Sampled,
        keep_going: &|| true,
        recorder: None,
    };
    let mut waiting = sequences.iter().map(Vec::as_slice).enumerate();
    let mut all = vec![Vec::new(); sequences.len()];
    let done = |sequence_idx: usize, results| all[sequence_idx] = results;
    run_sequences(&rules, worlds, || waiting.next(), done).unwrap();
    all
}

fn sequence(starts: &[Start]) -> Vec<EpisodeSpec> {
    starts.iter().zip(0..).map(|(start, idx)| EpisodeSpec::new(goal(), start.clone(), 1, idx)).collect()
}

#[test]
fn worlds_share_more_sequences_than_there_are_worlds() {
    use Status::{Running, Success, TimeLimit};
    let worlds = vec![Toy::new(&[Success]), Toy::new(&[Running, Running, TimeLimit])];
    let sequences = vec![sequence(&[Start::Scattered]); 5];
    let results = run(worlds, &sequences);
    let steps: Vec<u32> = results.iter().map(|sequence| sequence[0].n_steps).collect();
    // The first world ends an episode at every step, the second at its third, when the last sequence is already taken.
    assert_eq!(steps, [1, 3, 1, 1, 1]);
    // Nothing is connected in the toy's scene, so its success proves unstable.
    assert_eq!(results[0][0].end, End::Success { stable: false });
    assert_eq!((results[1][0].end, results[1][0].episode_return.connected), (End::TimeLimit, 6.0));
}

#[test]
fn a_sequence_keeps_its_world_until_that_diverges() {
    use Status::{Diverged, Success, TimeLimit};
    let sequences = [sequence(&[Start::Scattered, Start::AsItIs, Start::AsItIs, Start::AsItIs])];
    let results = run(vec![Toy::new(&[Success, TimeLimit, Diverged, Success])], &sequences);
    let ends: Vec<(End, bool)> = results[0].iter().map(|result| (result.end, result.forced_reset)).collect();
    let success = End::Success { stable: false };
    assert_eq!(ends, [(success, false), (End::TimeLimit, false), (End::Diverged, false), (success, true)]);
}

#[test]
fn start_states_depend_on_seed_goal_and_number_only() {
    let spec = |seed, idx| EpisodeSpec::new(goal(), Start::Scattered, seed, idx).task;
    assert_eq!(spec(1, 2), spec(1, 2));
    assert_ne!(spec(1, 2).seed, spec(1, 3).seed);
    assert_ne!(spec(1, 2).seed, spec(2, 2).seed);
    let other = EpisodeSpec::new(Catalog::builtin().of_split(Split::Train)[1], Start::Scattered, 1, 2).task;
    assert_ne!(spec(1, 2).seed, other.seed);
}

#[test]
fn the_kind_of_start_leaves_the_rest_of_a_task_alone() {
    let catalog = Catalog::builtin();
    let specs =
        |starts| (0..40).map(|idx| EpisodeSpec::one_of(catalog, goal(), starts, 1, idx).task).collect::<Vec<_>>();
    let scattered = specs(Starts::Scattered);
    assert!(scattered.iter().all(|task| task.start == Start::Scattered));
    for (starts, n_prebuilt) in [(Starts::Prebuilt, 40), (Starts::Mixed, 8)] {
        let tasks = specs(starts);
        let others = tasks.iter().filter(|task| matches!(&task.start, Start::Prebuilt(other) if other != goal().id()));
        assert_eq!(others.count(), n_prebuilt);
        assert!(tasks.iter().zip(&scattered).all(|(task, plain)| task.seed == plain.seed));
    }
}
