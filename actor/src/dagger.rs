//! Mixes expert and policy: which one acts in an episode, with how much noise, and what the expert would have done.
//!
//! This is DAgger (Ross, Gordon & Bagnell, "A reduction of imitation learning and structured prediction to no-regret
//! online learning"): scenes come from a mixture of both, labels from the expert alone.

use blueprints::{BlockIdx, Blueprint, N_BLOCKS};
use environment::EnvironmentConfig;
use environment::expert::Expert;
use proto::{Action, Driver, Label, Scene, WeightsVersion, settings};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, StandardNormal};

settings! {
    /// The DAgger mixture: whether the expert or the policy acts in an episode. Either way, every scene gets the
    /// expert's label.
    pub struct DaggerConfig {
        /// Share of the episodes in which the expert acts: the first at weights version 0, the second from version
        /// `mixing_versions` on, linear in between.
        pub expert_share: [f64; 2] = [1.0, 0.1], in 0.0..=1.0;
        /// Weights version from which the second share applies.
        pub mixing_versions: u64 = 100, in 1..;
        /// Share of the other episodes in which actions are sampled from the policy, so that PPO can learn from them.
        /// In the rest, the policy acts greedily.
        pub sampled_share: f64 = 0.0, in 0.0..=1.0;
        /// Noise on the expert's actions.
        pub expert_noise: NoiseConfig;
        /// Noise on the policy's greedy actions.
        pub policy_noise: NoiseConfig;
    }

    /// Noise that drives an episode into unfamiliar states.
    pub struct NoiseConfig {
        /// Standard deviations of the noise on each entry of a move; each episode draws one of them.
        pub sigmas: Vec<f32> = vec![0.0], in 0.0..=1.0, where |c| !c.sigmas.is_empty() => "at least one number";
        /// Probability per step that a gripper chooses a random one of the 16 blocks.
        pub random_block: f64 = 0.0, in 0.0..=1.0;
    }
}

/// The settings, and the environment configuration for the expert.
#[derive(Clone, Debug)]
pub struct DaggerMixture {
    config: DaggerConfig,
    environment: EnvironmentConfig,
}

/// The mixture in one episode: the driver, and the expert that labels it.
#[derive(Debug)]
pub struct DaggerEpisode {
    /// `None` if the blueprint has no assembly order.
    expert: Option<Expert>,
    driver: Driver,
    sigma: f32,
    random_block: f64,
    n_grippers: usize,
}

impl DaggerConfig {
    /// Returns the probability that the expert acts in an episode begun with weights `version`.
    fn expert_share_at(&self, version: WeightsVersion) -> f64 {
        let [first, last] = self.expert_share;
        let part = version.0.min(self.mixing_versions) as f64 / self.mixing_versions as f64;
        first + (last - first) * part
    }
}

impl DaggerMixture {
    /// Creates a mixture for worlds of this configuration.
    pub fn new(config: DaggerConfig, environment: EnvironmentConfig) -> Self {
        Self { config, environment }
    }

    /// Chooses the driver of a new episode.
    pub(crate) fn begin(&self, blueprint: &Blueprint, version: WeightsVersion, rng: &mut ChaCha8Rng) -> DaggerEpisode {
        let expert = Expert::new(&self.environment, blueprint).ok();
        let config = &self.config;
        let by_expert = rng.random_bool(config.expert_share_at(version)) && expert.is_some();
        let driver = if by_expert {
            Driver::Expert
        } else if rng.random_bool(config.sampled_share) {
            Driver::Sampled
        } else {
            Driver::Greedy
        };
        let noise = if by_expert { &config.expert_noise } else { &config.policy_noise };
        let sigma = noise.sigmas[rng.random_range(0..noise.sigmas.len())];
        let n_grippers = usize::from(self.environment.n_grippers);
        DaggerEpisode { expert, driver, sigma, random_block: noise.random_block, n_grippers }
    }
}

impl DaggerEpisode {
    /// Returns the driver.
    pub(crate) fn driver(&self) -> Driver {
        self.driver
    }

    /// Returns the action to take and the expert's label. The action is the policy's own or the expert's, with the
    /// episode's noise unless it is sampled.
    pub(crate) fn step(&mut self, scene: &Scene, own: Action, rng: &mut ChaCha8Rng) -> (Action, Option<Label>) {
        let right = self.expert.as_mut().map(|expert| expert.act(scene));
        let label = right.as_ref().and_then(|action| Label::new(action, self.n_grippers));
        let action = match (self.driver, right) {
            (Driver::Sampled, _) => return (own, label),
            (Driver::Expert, Some(right)) => right,
            (Driver::Expert | Driver::Greedy, _) => own,
        };
        (self.blurred(action, rng), label)
    }

    fn blurred(&self, mut action: Action, rng: &mut ChaCha8Rng) -> Action {
        for choice in action.choices.iter_mut().flatten() {
            if self.random_block > 0.0 && rng.random_bool(self.random_block) {
                *choice = BlockIdx::all().nth(rng.random_range(0..N_BLOCKS)).unwrap_or(*choice);
            }
        }
        if self.sigma > 0.0 {
            for block in BlockIdx::all().filter(|&block| action.choices.contains(&Some(block))) {
                for entry in &mut action.moves[block.get()] {
                    let noise: f32 = StandardNormal.sample(rng);
                    *entry += self.sigma * noise;
                }
            }
        }
        action
    }
}

#[cfg(test)]
mod tests {
    use blueprints::{Catalog, Split};
    use environment::{Env, World};
    use proto::{Start, Task};
    use rand::SeedableRng;

    use super::*;

    fn world() -> (World, Blueprint) {
        let goal = Catalog::builtin().of_split(Split::Train)[0];
        let mut world = World::new(&EnvironmentConfig::default()).unwrap();
        let assignment = environment::sample_assignment(&mut ChaCha8Rng::seed_from_u64(3));
        let task = Task { blueprint: goal.id().clone(), assignment, start: Start::Scattered, seed: 5 };
        world.reset(&task, Catalog::builtin()).unwrap();
        let blueprint = world.blueprint().clone();
        (world, blueprint)
    }

    fn nothing() -> Action {
        let block = BlockIdx::all().last();
        Action { choices: [block; 2], moves: [[0.0; 6]; N_BLOCKS] }
    }

    #[test]
    fn the_share_of_the_expert_falls_on_a_line() {
        let config = DaggerConfig { expert_share: [1.0, 0.2], mixing_versions: 10, ..Default::default() };
        let shares = [0, 5, 10, 99].map(|version| config.expert_share_at(WeightsVersion(version)));
        for (share, expected) in shares.iter().zip([1.0, 0.6, 0.2, 0.2]) {
            assert!((share - expected).abs() < 1e-12, "{shares:?}");
        }
    }

    #[test]
    fn whoever_acts_the_label_is_the_expert_s() {
        let (world, blueprint) = world();
        let environment = EnvironmentConfig::default();
        let right = Expert::new(&environment, &blueprint).unwrap().act(world.scene());
        let label = Label::new(&right, 2);
        for (expert_share, sampled_share, driver, action) in [
            (1.0, 0.0, Driver::Expert, &right),
            (0.0, 1.0, Driver::Sampled, &nothing()),
            (0.0, 0.0, Driver::Greedy, &nothing()),
        ] {
            let config = DaggerConfig { expert_share: [expert_share; 2], sampled_share, ..Default::default() };
            let mut rng = ChaCha8Rng::seed_from_u64(1);
            let mixture = DaggerMixture::new(config, environment.clone());
            let mut dagger = mixture.begin(&blueprint, WeightsVersion(0), &mut rng);
            assert_eq!(dagger.driver(), driver);
            assert_eq!(dagger.step(world.scene(), nothing(), &mut rng), (action.clone(), label));
        }
    }

    #[test]
    fn noise_changes_chosen_moves_and_never_the_label() {
        let (world, blueprint) = world();
        let expert_noise = NoiseConfig { sigmas: vec![0.5], random_block: 1.0 };
        let config = DaggerConfig { expert_noise, ..Default::default() };
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mixture = DaggerMixture::new(config, EnvironmentConfig::default());
        let mut dagger = mixture.begin(&blueprint, WeightsVersion(0), &mut rng);
        let clean = Expert::new(&EnvironmentConfig::default(), &blueprint).unwrap().act(world.scene());
        let mut chosen = std::collections::BTreeSet::new();
        for _ in 0..100 {
            let (action, label) = dagger.step(world.scene(), nothing(), &mut rng);
            assert_eq!(label, Label::new(&clean, 2));
            for block in BlockIdx::all() {
                let is_chosen = action.choices.contains(&Some(block));
                assert_eq!(action.moves[block.get()] != clean.moves[block.get()], is_chosen);
                chosen.extend(is_chosen.then(|| block.get()));
            }
        }
        // 200 draws from 16 blocks miss one of them with a probability below 1e-4.
        assert_eq!(chosen.len(), N_BLOCKS);
    }
}
