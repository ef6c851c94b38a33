//! The ring in one thread, without the bus: worlds, rollouts, updates, evaluation.

use std::path::Path;

use actor::{Identity, Rollout, RolloutSetup};
use blueprints::Catalogue;
use deploy::config::{Config, PRESETS};
use environment::World;
use evaluator::{EvalSetup, evaluate};
use learner::checkpoint::Checkpoint;
use learner::{Learner, LearnerSetup};
use proto::ActorId;

/// The preset of the smallest task, learned in lockstep: worlds stand still while the learner updates.
struct Ring {
    config: Config,
    learner: Learner,
    rollout: Rollout<'static, World>,
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
        Self::around(learner, config)
    }

    fn resumed(dir: &Path, config: Config) -> Self {
        let found = Checkpoint::read_latest(dir).unwrap();
        let learner = Learner::resume(Self::setup(&config), found.checkpoint).unwrap();
        Self::around(learner, config)
    }

    fn around(learner: Learner, config: Config) -> Self {
        let setup = RolloutSetup {
            catalogue: Catalogue::builtin(),
            policy: config.policy.clone(),
            tasks: config.actor.tasks.clone(),
            segment_len: config.actor.segment_len,
            lead_in: config.actor.lead_in,
            identity: Identity {
                actor: ActorId::try_from("test".to_owned()).unwrap(),
                epoch: 1,
                first_seq: 1000 * learner.n_updates(),
                seq_step: 1,
            },
            seed: learner.n_updates(),
        };
        let worlds = (0..config.actor.n_worlds).map(|_| World::new(&config.environment).unwrap()).collect();
        let rollout = Rollout::new(setup, worlds, &learner.weights()).unwrap();
        Self { config, learner, rollout }
    }

    fn update(&mut self) {
        while !self.learner.ready() {
            for segment in self.rollout.step().unwrap() {
                self.learner.ingest(segment).unwrap();
            }
        }
        self.learner.update().unwrap();
        self.rollout.set_weights(&self.learner.weights()).unwrap();
    }

    /// Worlds are not part of a checkpoint, so whoever saves begins new episodes, as whoever resumes does.
    fn save(&mut self, dir: &Path) {
        self.learner.save(dir).unwrap();
        self.rollout.restart(self.learner.n_updates()).unwrap();
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

#[test]
fn a_resumed_ring_goes_on_bit_by_bit() {
    let dir = tempfile::tempdir().unwrap();
    let mut config = Ring::config();
    config.learner.steps_per_update = 256;
    config.learner.minibatch_size = 64;
    config.actor.n_worlds = 4;
    let mut ring = Ring::new(config.clone());
    (0..2).for_each(|_| ring.update());
    ring.save(dir.path());
    let mut resumed = Ring::resumed(dir.path(), config);
    for ring in [&mut ring, &mut resumed] {
        (0..2).for_each(|_| ring.update());
    }
    assert_eq!(resumed.learner.weights(), ring.learner.weights());
}
