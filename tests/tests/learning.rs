//! The training loop in one thread, without the bus: worlds, rollouts, updates, evaluation.

use actor::{Lockstep, TaskFilter};
use blueprints::Catalog;
use deploy::commands::{actor_setup, learner_setup};
use deploy::config::{Config, PRESETS};
use evaluator::{EvalSetup, Follower, N_WORLDS, Performer, Selection, evaluate};
use learner::Learner;
use proto::Valid;

/// A training in lockstep: worlds pause while the learner updates.
struct Ring {
    config: Valid<Config>,
    learner: Learner,
    worlds: Lockstep,
}

impl Ring {
    /// Starts a training with the preset `quickstart` after `change`.
    fn new(change: impl FnOnce(&mut Config)) -> Self {
        let preset = PRESETS.iter().find(|known| known.name == "quickstart").unwrap();
        let mut config = Config::parse(preset.text, preset.name).unwrap();
        change(&mut config);
        let config = config.checked().unwrap();
        let learner = Learner::new(learner_setup(&config, None, Catalog::builtin()).unwrap()).unwrap();
        let worlds = Lockstep::new(actor_setup(&config, "lockstep".parse().unwrap(), Catalog::builtin()));
        Self { config, learner, worlds }
    }

    fn update(&mut self) {
        let weights = self.learner.weights();
        while self.learner.mailbox().n_steps() < self.config.learner.batch_size {
            for segment in self.worlds.step(&weights, false).unwrap() {
                self.learner.mailbox().push_beyond_capacity(segment).unwrap();
            }
        }
        self.learner.update_from_mailbox().unwrap();
    }

    /// Success rate, with the settings of the preset's evaluator.
    fn success_rate(&self) -> f64 {
        let setup = EvalSetup {
            catalog: Catalog::builtin(),
            environment: self.config.part(|config| &config.environment),
            episodes: self.config.evaluator.episodes.clone(),
            reset_free: None,
            n_worlds: N_WORLDS,
            seed: self.config.seed,
        };
        let blueprints = self.config.evaluator.selection.select(Catalog::builtin()).unwrap();
        let policy = self.config.part(|config| &config.policy);
        let weights = self.learner.weights();
        let performer = Performer::Policy(&policy, &weights);
        let report = evaluate(&setup, performer, &blueprints, &Follower::default()).unwrap();
        let all = report.summary.all;
        if all.greedy.success.n_episodes > 0 { all.greedy.success.rate } else { all.sampled.success.rate }
    }
}

#[test]
fn rewards_alone_teach_five_blocks_from_scattered_starts() {
    let ids = ["5_001", "5_003"].map(|id| id.parse().unwrap()).to_vec();
    let mut ring = Ring::new(|config| {
        config.actor.tasks.filter = TaskFilter::Blueprints(ids.clone());
        config.evaluator.selection =
            Selection { splits: vec![blueprints::Split::Train], sizes: [5, 5], blueprints: ids };
        config.evaluator.episodes.n_episodes = 20;
    });
    let untrained = ring.success_rate();
    let mut trained = untrained;
    // With a Gaussian head, two blocks alone take a hundred times as many steps.
    while trained < 0.95 && ring.learner.n_env_steps() < 60_000 {
        (0..4).for_each(|_| ring.update());
        trained = ring.success_rate();
    }
    assert!(untrained < 0.6 && trained >= 0.95, "{untrained} before, {trained} after {}", ring.learner.n_env_steps());
}
