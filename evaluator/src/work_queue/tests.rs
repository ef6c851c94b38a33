//! Sequences that are taken, returned, lost, and returned too late.

use blueprints::{Catalog, Split};
use proto::unit::End;
use proto::{RewardTerms, Start};

use super::*;

fn queue() -> Arc<WorkQueue> {
    Arc::default()
}

fn sequences(n: u64) -> Vec<Vec<EpisodeSpec>> {
    let goal = Catalog::builtin().of_split(Split::Train)[0];
    (0..n).map(|idx| vec![EpisodeSpec::new(goal, Start::Scattered, 1, idx)]).collect()
}

/// A result of a sequence; `n_steps` identifies the worker.
fn result(specs: &[EpisodeSpec], n_steps: u32) -> Vec<EpisodeResult> {
    specs
        .iter()
        .map(|spec| spec.result(ActionMode::Greedy, End::TimeLimit, n_steps, RewardTerms::default(), false))
        .collect()
}

fn bring(lease: Lease, n_steps: u32) {
    let results = lease.specs().map(|specs| result(specs, n_steps)).collect();
    lease.bring(results);
}

/// Returns the worker that ran each sequence.
fn runners(queue: &WorkQueue) -> Vec<u32> {
    queue.clear().iter().map(|sequence| sequence[0].n_steps).collect()
}

#[test]
fn every_sequence_is_given_to_one() {
    let queue = queue();
    queue.post(&sequences(20), ActionMode::Greedy);
    let (first, second) = (WorkerGuard::new(queue.clone()), WorkerGuard::new(queue.clone()));
    // With two remote workers and the evaluator: 20 / 6 and (20 - 3) / 6 sequences.
    let (some, more) = (first.take(MAX_LEASED).unwrap(), second.take(MAX_LEASED).unwrap());
    assert_eq!((some.specs().count(), more.specs().count()), (3, 2));
    bring(some, 1);
    while let Some((sequence_idx, specs)) = queue.take() {
        queue.bring(sequence_idx, result(&specs, 9));
    }
    assert!(!queue.is_done() && first.take(MAX_LEASED).is_none());
    bring(more, 2);
    assert!(queue.is_done());
    assert_eq!(queue.n_assisted(), 5);
    assert_eq!(runners(&queue), [[1, 1, 1, 2, 2].as_slice(), &[9; 15]].concat());
}

#[test]
fn what_is_not_brought_is_for_others() {
    let queue = queue();
    queue.post(&sequences(4), ActionMode::Greedy);
    let lost = WorkerGuard::new(queue.clone()).take(MAX_LEASED).unwrap();
    assert_eq!((lost.specs().count(), queue.take().map(|(sequence_idx, _)| sequence_idx)), (1, Some(1)));
    drop(lost);
    assert_eq!(queue.take().map(|(sequence_idx, _)| sequence_idx), Some(0));
}

#[test]
fn what_comes_too_late_changes_nothing() {
    let queue = queue();
    let guard = WorkerGuard::new(queue.clone());
    queue.post(&sequences(1), ActionMode::Greedy);
    let (late, lost) = (guard.take(MAX_LEASED).unwrap(), sequences(1));
    queue.post(&lost, ActionMode::Sampled);
    bring(late, 1);
    assert!(!queue.is_done());
    let (sequence_idx, specs) = queue.take().unwrap();
    queue.bring(sequence_idx, result(&specs, 2));
    queue.bring(sequence_idx, result(&specs, 3));
    assert_eq!((queue.n_assisted(), runners(&queue)), (0, vec![2]));
}
