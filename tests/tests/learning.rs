//! The ring in one thread, without the bus: worlds, rollouts, updates, evaluation.

use actor::Lockstep;
use blueprints::Catalogue;
use deploy::config::{Config, PRESETS};
use evaluator::{EvalSetup, evaluate};
use learner::{Learner, LearnerSetup};

/// The preset of the smallest task, learned in lockstep: worlds stand still while the learner updates.
struct Ring {
    config: Config,
    learner: Learner,
    worlds: Lockstep,
}

impl Ring {
    fn config() -> Config {
        let preset = PRESETS.iter().find(|preset| preset.name == "near-goal").unwrap();
        let mut config = Config::parse(preset.text, preset.name).unwrap();
        // All segments of a step arrive at once, and nobody sends again what found no room.
        config.learner.mailbox.capacity_steps *= 2;
        config
    }

    fn setup(config: &Config) -> LearnerSetup {
        LearnerSetup {
            config: config.learner.clone(),
            policy: config.policy.clone(),
            catalogue: Catalogue::builtin().clone().into(),
            tasks: config.actor.tasks.filter.select(Catalogue::builtin()).unwrap(),
            seed: config.seed,
            device: config.device,
        }
    }

    fn new(config: Config) -> Self {
        let learner = Learner::new(Self::setup(&config)).unwrap();
        let (actor, policy, environment) = (config.actor.clone(), config.policy.clone(), config.environment.clone());
        let worlds = Lockstep::new(actor, policy, environment, config.seed);
        Self { config, learner, worlds }
    }

    fn update(&mut self) {
        let weights = self.learner.weights();
        while !self.learner.ready() {
            for segment in self.worlds.step(&weights, false).unwrap() {
                self.learner.ingest(segment).unwrap();
            }
        }
        self.learner.update().unwrap();
    }

    /// Of mode actions from starts near the goal.
    fn success_rate(&self) -> f64 {
        let setup = EvalSetup {
            catalogue: Catalogue::builtin(),
            policy: self.config.policy.clone(),
            environment: self.config.environment.clone(),
            episodes: self.config.evaluator.episodes.clone(),
            reset_free: None,
            seed: self.config.seed,
        };
        let blueprints = self.config.evaluator.selection.select(Catalogue::builtin()).unwrap();
        let report = evaluate(&setup, &self.learner.weights(), &blueprints, &|| true).unwrap();
        report.summary.all.mode.success.rate
    }
}

#[test]
fn ppo_learns_to_finish_a_blueprint() {
    let mut ring = Ring::new(Ring::config());
    let untrained = ring.success_rate();
    let mut trained = untrained;
    while trained < 0.9 && ring.learner.n_env_steps() < ring.config.n_env_steps {
        (0..5).for_each(|_| ring.update());
        trained = ring.success_rate();
    }
    assert!(untrained < 0.5, "{untrained}");
    assert!(trained >= 0.9, "{untrained} before, {trained} after {} steps", ring.learner.n_env_steps());
}
