//! Domain randomization: draws the settings of an episode.

use rand::RngExt;
use rand::rngs::ChaCha8Rng;

use crate::config::EnvironmentConfig;
use crate::vec_env::generator;

/// Stream of an episode's seed for these draws; the initial state uses stream 0.
const STREAM: u64 = 1;

/// Draws the settings of the episode with this seed; `None` if no setting is randomized.
pub(crate) fn draw(config: &EnvironmentConfig, seed: u64) -> Option<EnvironmentConfig> {
    let ranges = &config.randomization;
    if *ranges == Default::default() {
        return None;
    }
    let mut rng = generator(seed, STREAM);
    let mut drawn = config.clone();
    // Draw every value even if it is off, so that enabling one does not change the others.
    let within = |range: Option<[f32; 2]>, rng: &mut ChaCha8Rng| {
        let share: f32 = rng.random();
        range.map(|[low, high]| low + share * (high - low))
    };
    let (magnets, physics) = (&mut drawn.magnets, &mut drawn.physics);
    magnets.snap_gap_m = within(ranges.snap_gap_m, &mut rng).unwrap_or(magnets.snap_gap_m);
    magnets.snap_angle_deg = within(ranges.snap_angle_deg, &mut rng).unwrap_or(magnets.snap_angle_deg);
    magnets.break_force_n *= within(ranges.break_force, &mut rng).unwrap_or(1.0);
    physics.friction *= within(ranges.friction, &mut rng).unwrap_or(1.0);
    physics.density_kgpm3 *= within(ranges.density, &mut rng).unwrap_or(1.0);
    if let Some([low, high]) = ranges.transition_delay_steps {
        drawn.transition_delay_steps = rng.random_range(low..=high);
    }
    Some(drawn)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::RandomizationConfig;

    fn randomized(ranges: RandomizationConfig) -> EnvironmentConfig {
        EnvironmentConfig { randomization: ranges, ..Default::default() }
    }

    #[test]
    fn without_ranges_nothing_is_drawn() {
        assert_eq!(draw(&EnvironmentConfig::default(), 1), None);
    }

    #[test]
    fn draws_fill_their_ranges_and_change_nothing_else() {
        let config = randomized(RandomizationConfig {
            snap_gap_m: Some([0.01, 0.03]),
            density: Some([0.8, 1.2]),
            transition_delay_steps: Some([0, 2]),
            ..Default::default()
        });
        let drawn: Vec<_> = (0..300).map(|seed| draw(&config, seed).unwrap()).collect();
        assert_eq!(drawn[7], draw(&config, 7).unwrap());
        for (i, (low, high)) in [(0.01, 0.03), (160.0, 240.0), (0.0, 2.0)].into_iter().enumerate() {
            let values: Vec<f32> = drawn
                .iter()
                .map(|c| [c.magnets.snap_gap_m, c.physics.density_kgpm3, f32::from(c.transition_delay_steps)][i])
                .collect();
            let span = high - low;
            assert!(values.iter().all(|x| (low..=high).contains(x)), "{values:?}");
            assert!(values.iter().any(|x| *x < low + 0.1 * span) && values.iter().any(|x| *x > high - 0.1 * span));
            let mean = values.iter().sum::<f32>() / values.len() as f32;
            // The standard deviation of the mean is about 2 % of the span.
            assert!((mean - (low + high) / 2.0).abs() < 0.08 * span, "{mean}");
        }
        assert!(drawn.iter().all(|c| c.magnets.break_force_n == config.magnets.break_force_n));
    }

    #[test]
    fn a_range_that_is_added_leaves_the_other_draws_alone() {
        let alone = RandomizationConfig { friction: Some([0.8, 1.2]), ..Default::default() };
        let both = RandomizationConfig { snap_angle_deg: Some([8.0, 15.0]), ..alone.clone() };
        let friction = |ranges| draw(&randomized(ranges), 3).unwrap().physics.friction;
        assert_eq!(friction(alone), friction(both));
    }
}
