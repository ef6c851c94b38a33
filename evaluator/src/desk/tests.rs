//! Lanes that are taken, brought, lost and brought too late.

use blueprints::{Catalogue, Split};
use proto::{RewardTerms, Start};

use super::*;
use crate::episodes::tests::{small_setup, weights};
use crate::report::End;

fn desk() -> Arc<Desk> {
    Arc::new(Desk::new(Arc::new(weights(&small_setup(Default::default())))))
}

fn lanes(n: u64) -> Vec<Vec<Job>> {
    let goal = Catalogue::builtin().of_split(Split::Train)[0];
    (0..n).map(|idx| vec![Job::new(goal, Start::Scattered, 1, idx)]).collect()
}

/// What a lane came to; `n_steps` tells who ran it.
fn played(jobs: &[Job], n_steps: u32) -> Vec<Played> {
    jobs.iter().map(|job| job.played(Acting::Mode, End::TimeLimit, n_steps, RewardTerms::default(), false)).collect()
}

fn bring(lent: Lent, n_steps: u32) {
    let results = lent.jobs().map(|jobs| played(jobs, n_steps)).collect();
    lent.bring(results);
}

/// Who ran each lane.
fn runners(desk: &Desk) -> Vec<u32> {
    desk.clear().iter().map(|lane| lane[0].episode.n_steps).collect()
}

#[test]
fn every_lane_is_given_to_one() {
    let desk = desk();
    desk.post(&lanes(20), Acting::Mode);
    let (first, second) = (Assisting::new(desk.clone()), Assisting::new(desk.clone()));
    // With two assistants beside the evaluator: 20 / 6 and (20 - 3) / 6 lanes.
    let (some, more) = (first.take().unwrap(), second.take().unwrap());
    assert_eq!((some.jobs().count(), more.jobs().count()), (3, 2));
    bring(some, 1);
    while let Some((lane_idx, jobs)) = desk.take() {
        desk.bring(lane_idx, played(&jobs, 9));
    }
    assert!(!desk.is_done() && first.take().is_none());
    bring(more, 2);
    assert!(desk.is_done());
    assert_eq!(desk.n_assisted(), 5);
    assert_eq!(runners(&desk), [[1, 1, 1, 2, 2].as_slice(), &[9; 15]].concat());
}

#[test]
fn what_is_not_brought_is_for_others() {
    let desk = desk();
    desk.post(&lanes(4), Acting::Mode);
    let lost = Assisting::new(desk.clone()).take().unwrap();
    assert_eq!((lost.jobs().count(), desk.take().map(|(lane_idx, _)| lane_idx)), (1, Some(1)));
    drop(lost);
    assert_eq!(desk.take().map(|(lane_idx, _)| lane_idx), Some(0));
}

#[test]
fn what_comes_too_late_changes_nothing() {
    let desk = desk();
    let assisting = Assisting::new(desk.clone());
    desk.post(&lanes(1), Acting::Mode);
    let (late, lost) = (assisting.take().unwrap(), lanes(1));
    desk.post(&lost, Acting::Sampled);
    bring(late, 1);
    assert!(!desk.is_done());
    let (lane_idx, jobs) = desk.take().unwrap();
    desk.bring(lane_idx, played(&jobs, 2));
    desk.bring(lane_idx, played(&jobs, 3));
    assert_eq!((desk.n_assisted(), runners(&desk)), (0, vec![2]));
}
