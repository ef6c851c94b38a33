//! Updates of the mixture head.

use std::collections::BTreeMap;
use std::sync::Arc;

use blueprints::BlockIdx;
use policy::MoveHead;
use policy::proposals::{Kind, Slot};
use proto::{Joint, Status};
use rand::SeedableRng;
use rand::rngs::ChaCha8Rng;

use super::learning::{bandit, learn, small_setup};
use crate::{Learner, LearnerSetup, Model};

pub(super) fn mixture_setup(seed: u64) -> LearnerSetup {
    small_setup(seed).with_policy(|c| c.network.move_head = MoveHead::Mixture)
}

#[test]
fn a_rewarded_proposal_becomes_more_likely_for_both_grippers() {
    let setup = mixture_setup(1).at_rate(1e-2);
    let mut learner = Learner::new(setup.clone()).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let is_join = |slot: u8| Slot::from_index(slot).unwrap().kind() == Kind::Join;
    let mut rates = Vec::new();
    for _ in 0..12 {
        let mut trajectories = bandit(&setup, &learner.weights(), 256, &mut rng);
        let mut n_joins = 0;
        for trajectory in &mut trajectories {
            let step = &mut trajectory.transitions[0];
            // The second gripper's counts only if it has a block of its own.
            let joins = step.proposals.map(|slot| slot.is_some_and(is_join));
            step.reward.connected = joins.map(|joins| f32::from(u8::from(joins))).iter().sum();
            trajectory.status = Status::TimeLimit;
            trajectory.episode_stats.as_mut().unwrap().success = false;
            n_joins += u32::from(joins == [true, true]);
        }
        rates.push(f64::from(n_joins) / 256.0);
        let metrics = learn(&mut learner, trajectories).metrics;
        assert!((metrics.ppo.effective_sample_size - 1.0).abs() < 1e-3, "{metrics:?}");
    }
    assert!(rates[0] < 0.1 && rates[11] > 0.9, "{rates:?}");
}

#[test]
fn an_update_tells_what_was_drawn_and_what_came_of_it() {
    // One gradient step, whose losses are those before it.
    let setup = mixture_setup(1).with(|c| (c.minibatch_size, c.n_epochs) = (256, 1));
    let mut learner = Learner::new(setup.clone()).unwrap();
    let mut trajectories = bandit(&setup, &learner.weights(), 256, &mut ChaCha8Rng::seed_from_u64(2));
    let mut counts = BTreeMap::new();
    let (mut n_tries, mut n_successes, mut n_second) = (0, 0, 0);
    for trajectory in &mut trajectories {
        let blueprint = setup.catalog.get(&trajectory.task.blueprint).unwrap();
        let link = blueprint.links()[0];
        let step = &trajectory.transitions[0];
        n_second += u32::from(step.proposals[1].is_some());
        let mut n_joins = 0;
        for slot in step.proposals.iter().flatten().map(|&slot| Slot::from_index(slot).unwrap()) {
            *counts.entry(slot.kind().name()).or_insert(0_u64) += 1;
            // In an empty scene, a join of two blocks of the goal of two is one of its only link.
            n_joins += u64::from(slot.kind() == Kind::Join);
        }
        // Every other step that could connect the two does.
        if n_joins > 0 && n_tries % 2 == 0 {
            trajectory.last_scene.joints.push(Joint { a: link.a, b: link.b, relative: link.relative });
            n_successes += n_joins;
        }
        n_tries += n_joins;
    }
    let update = learn(&mut learner, trajectories).metrics;
    let found = update.proposals.unwrap();
    let n_draws: u64 = counts.values().sum();
    assert_eq!(found.kinds.len(), 3);
    for (kind, of) in &found.kinds {
        let n = counts.get(kind.as_str()).copied().unwrap_or(0);
        assert_eq!((of.n_draws, of.share), (n, n as f64 / n_draws as f64), "{kind}");
    }
    let join = found.kinds["join"];
    assert!(n_successes > 0 && n_successes < n_tries);
    assert_eq!((join.n_tries, join.success), (n_tries, Some(n_successes as f64 / n_tries as f64)));
    assert_eq!((found.kinds["hold"].n_tries, found.kinds["hold"].success), (0, None));
    let moves = found.first_proposal_entropy + found.second_proposal_entropy * f64::from(n_second) / 256.0;
    assert!((moves - update.ppo.entropy_moves).abs() < 1e-4, "{moves} {:?}", update.ppo);
    assert!(found.second_block_entropy > 0.0 && found.second_block_entropy < update.ppo.entropy_blocks);
}

#[test]
fn actions_that_their_scenes_do_not_offer_are_refused_and_counted() {
    let setup = mixture_setup(1);
    let mut learner = Learner::new(setup.clone()).unwrap();
    let mut trajectories = bandit(&setup, &learner.weights(), 256, &mut ChaCha8Rng::seed_from_u64(2));
    let scene = trajectories[0].transitions[0].scene.clone();
    assert!(scene.joints.is_empty());
    // There is nothing to detach, and no block comes to itself.
    let block = trajectories[1].transitions[0].action.choices[0].unwrap();
    let proposals = [(Kind::Detach, BlockIdx::all().next().unwrap()), (Kind::Join, block)];
    let proposals = proposals.map(|(kind, partner)| Some(Slot::paired(kind, partner).index()));
    for (trajectory, first) in trajectories.iter_mut().zip(proposals) {
        trajectory.transitions[0].proposals[0] = first;
    }
    let update = learn(&mut learner, trajectories).metrics;
    assert_eq!((update.n_update_steps, update.unmade_total), (256, 2));
    assert_eq!(update.ppo.n_samples, 254);
}

#[test]
fn a_policy_of_one_head_is_none_for_a_run_of_the_other() {
    for (own, theirs, there, here) in [
        (small_setup(1), mixture_setup(1), r#""mixture" there"#, "not set in this run"),
        (mixture_setup(1), small_setup(1), "not set there", r#""mixture" in this run"#),
    ] {
        let expected = format!("policy.network.move_head is {there} and {here}");
        let checkpoint = Learner::new(theirs).unwrap().checkpoint();
        let model = Model::from(&checkpoint);
        let resumed = Learner::resume(own.clone(), checkpoint).unwrap_err().to_string();
        assert_eq!(resumed, format!("the checkpoint does not fit this learner: {expected}"));
        let started = Learner::new(LearnerSetup { init: Some(Arc::new(model)), ..own }).unwrap_err().to_string();
        assert_eq!(started, format!("the policy to start from does not fit: {expected}"));
    }
}

#[test]
fn nobody_acts_with_a_file_whose_parameters_are_of_another_head() {
    let n_parameters = |setup| Learner::new(setup).unwrap().weights().parameters.len();
    let [gaussian, mixture] = [small_setup(1), mixture_setup(1)].map(n_parameters);
    for (theirs, claimed, given, expected) in [
        (small_setup(1), MoveHead::Mixture, gaussian, mixture),
        (mixture_setup(1), MoveHead::Gaussian, mixture, gaussian),
    ] {
        let mut model = Model::from(&Learner::new(theirs).unwrap().checkpoint());
        model.policy = model.policy.with(|policy| policy.network.move_head = claimed).unwrap();
        let read = Model::from_bytes(&model.to_bytes().unwrap()).unwrap();
        let error = policy::Policy::with_weights(&read.policy, &read.weights).unwrap_err();
        assert_eq!(
            error.to_string(),
            format!("weights 0 do not fit: {given} parameters given, the network has {expected}")
        );
    }
}
