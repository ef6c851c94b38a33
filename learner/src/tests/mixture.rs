//! Updates of the mixture head.

use policy::MoveHead;
use policy::proposals::{Kind, Slot};
use proto::{ActionMode, Agent, Observation, Status};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::learning::{bandit, feed, small_setup};
use crate::config::{FixedRate, ImitationConfig, RateRule};
use crate::{Learner, LearnerSetup};

pub(super) fn mixture_setup(seed: u64) -> LearnerSetup {
    let mut setup = small_setup(seed);
    setup.policy.network.move_head = MoveHead::Mixture;
    setup
}

#[test]
fn a_rewarded_proposal_becomes_more_likely_for_both_grippers() {
    let mut setup = mixture_setup(1);
    setup.config.optimizer.learning_rate = 1e-2;
    setup.config.optimizer.rate_rule = RateRule::Fixed(FixedRate {});
    let mut learner = Learner::new(setup.clone()).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let hold = Some(Slot::alone(Kind::Hold).index());
    let mut rates = Vec::new();
    for _ in 0..12 {
        let mut trajectories = bandit(&setup, &learner.weights(), 256, &mut rng);
        let mut n_holds = 0;
        for trajectory in &mut trajectories {
            let step = &mut trajectory.transitions[0];
            // Both grippers hold, or the second goes to the first one's block.
            let held = step.proposals[0] == hold && (step.proposals[1].is_none() || step.proposals[1] == hold);
            step.reward.connected = f32::from(u8::from(held));
            trajectory.status = Status::TimeLimit;
            trajectory.outcome.as_mut().unwrap().success = false;
            n_holds += u32::from(held);
        }
        rates.push(f64::from(n_holds) / 256.0);
        feed(&learner, trajectories);
        let metrics = learner.update().unwrap();
        assert!((metrics.ppo.effective_sample_size - 1.0).abs() < 1e-3, "{metrics:?}");
    }
    assert!(rates[0] < 0.3 && rates[11] > 0.9, "{rates:?}");
}

#[test]
fn actions_that_their_scenes_do_not_offer_are_refused_and_counted() {
    let setup = mixture_setup(1);
    let mut learner = Learner::new(setup.clone()).unwrap();
    let mut trajectories = bandit(&setup, &learner.weights(), 256, &mut ChaCha8Rng::seed_from_u64(2));
    let scene = trajectories[0].transitions[0].scene.clone();
    assert!(scene.joints.is_empty());
    // There is nothing to detach, no such slot, and no slot at all.
    let proposals =
        [Some(Slot::paired(Kind::Detach, blueprints::BlockIdx::all().next().unwrap()).index()), Some(200), None];
    for (trajectory, first) in trajectories.iter_mut().zip(proposals) {
        trajectory.transitions[0].proposals[0] = first;
    }
    feed(&learner, trajectories);
    let update = learner.update().unwrap();
    assert_eq!((update.n_steps, update.unmade_total), (256, 3));
    assert_eq!(update.ppo.n_samples, 253);
}

#[test]
fn a_mixture_cannot_imitate() {
    let mut setup = mixture_setup(1);
    setup.config.imitation = Some(ImitationConfig::default());
    let error = Learner::new(setup).unwrap_err().to_string();
    assert!(error.starts_with("policy.network.move_head = mixture: expected gaussian"), "{error}");
}

#[test]
fn a_learner_of_the_mixture_acts_like_its_weights() {
    let setup = mixture_setup(3);
    let learner = Learner::new(setup.clone()).unwrap();
    let blueprint = setup.catalog.get(&crate::fixtures::blueprint_id()).unwrap();
    let scene = crate::fixtures::scene(&mut ChaCha8Rng::seed_from_u64(5));
    let mut policy = policy::Policy::with_weights(&setup.policy, &learner.weights()).unwrap();
    let seen = Observation { scene: &scene, blueprint, n_steps: 0 };
    let mut act =
        |seed| policy.act(&[seen], &[ActionMode::Sampled], &mut [ChaCha8Rng::seed_from_u64(seed)]).unwrap().remove(0);
    assert_eq!(act(1), act(1));
    assert!((0..20).any(|seed| act(seed).action != act(20).action));
    // Only what was chosen moves.
    let decision = act(1);
    let chosen = decision.action.choices.map(|block| block.unwrap().get());
    assert!((0..16).all(|block| chosen.contains(&block) || decision.action.moves[block] == [0.0; 6]));
}
