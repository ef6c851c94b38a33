//! The configuration: a tree shaped like the crates. Each crate defines, documents, and validates its own section.
//!
//! Layers, from lowest to highest precedence: defaults, a preset, a file, an ablation, `LODESTONE_*` variables,
//! `--set`, other flags. Unknown keys are errors.

mod ablations;
mod error;
mod keys;
mod layers;
mod presets;
mod variables;

use std::path::Path;

use actor::{ActorConfig, EnvironmentConfig, PolicyConfig};
use blueprints::outside;
use bus::BusConfig;
use dashboard::DashboardConfig;
use evaluator::EvaluatorConfig;
use learner::{ActingLimits, DeviceKind, LearnerConfig};
use proto::setting::key;
use proto::{CanonicalSettings, InvalidSetting, Valid, settings};

pub use ablations::{ABLATIONS, Ablation};
pub use error::ConfigError;
pub(crate) use error::{nearest, suggestion_or};
pub use keys::{Key, explain, keys, schema};
pub(crate) use layers::is_whole;
pub use layers::{Override, merge};
pub use presets::{DEFAULT_PRESET, DEFAULTS, PRESETS, Preset};
pub use variables::check_variables;

/// Maximum size of a configuration file in bytes; one with every setting has about 10 000.
const MAX_FILE_BYTES: u64 = 1 << 20;

pub(crate) fn read(path: &Path) -> Result<String, ConfigError> {
    outside::read_text(path, MAX_FILE_BYTES)
        .map_err(|error| ConfigError::Text(format!("cannot read the configuration {}: {error}", path.display())))
}

/// Largest seed, because TOML's integers are signed.
pub(crate) const MAX_SEED: u64 = i64::MAX as u64;

settings! {
    /// Everything that determines a run, except endpoints and folders on the machine.
    pub struct Config in "", check grippers {
        /// In a file: the preset that the file's keys override, or `none` for the plain defaults. Without it, a file
        /// given with `--config` overrides `--preset`, by default `quickstart`, and a preset overrides the defaults.
        #[serde(skip_serializing)]
        pub base: Option<String> = None;
        /// Determines weights, tasks, actions, and evaluation episodes.
        pub seed: u64 = 1, in 0..=MAX_SEED;
        /// `train` and `learner` stop once they have consumed this many environment steps.
        pub n_env_steps: u64 = 10_000_000, in 1..;
        /// Device that runs the network.
        pub device: DeviceKind = DeviceKind::default();
        /// Whether `train` alternates between stepping worlds and learning, so that equal seeds produce equal bytes.
        pub lockstep: bool = false;
        /// How the processes of a run find each other.
        pub bus: BusConfig;
        /// The simulated world.
        pub environment: EnvironmentConfig;
        /// Features, network, and action distribution.
        pub policy: PolicyConfig;
        /// Rollouts.
        pub actor: ActorConfig;
        /// Training.
        pub learner: LearnerConfig;
        /// Evaluation.
        pub evaluator: EvaluatorConfig;
        /// Where a run is shown.
        pub dashboard: DashboardConfig;
    }
}

impl Config {
    /// The whole tree as a file, including defaults. The file names `none` as its base, because anything that it lacks,
    /// such as the table of a disabled feature, is absent on purpose.
    ///
    /// # Panics
    /// If a section has a type that TOML cannot express, which the tests rule out.
    pub fn to_toml(&self) -> String {
        file(&DEFAULTS, &self.to_table())
    }

    /// The settings that anyone may read: all but how the processes find each other, and the token of the page.
    pub fn shown(&self) -> serde_json::Value {
        let settings = self.to_table().into_iter().filter(|(name, _)| !["bus", "dashboard"].contains(&name.as_str()));
        let settings: toml::Table = settings.collect();
        serde_json::to_value(settings).expect("settings are numbers, words, and lists of them")
    }

    fn to_table(&self) -> toml::Table {
        let mut table = toml::Table::try_from(self).expect("every section consists of what TOML can express");
        table.iter_mut().for_each(|(_, value)| shorten(value));
        table
    }

    /// Checks every value, and the constraints between sections.
    ///
    /// # Errors
    /// Names the section and field, the value, and the valid range.
    pub fn checked(self) -> Result<Valid<Self>, ConfigError> {
        Ok(Valid::new(self)?)
    }

    /// The world in which policies are evaluated and shown.
    pub fn evaluation_environment(config: &Valid<Self>) -> Valid<EnvironmentConfig> {
        let environment = config.part(|config| &config.environment);
        if config.evaluator.episodes.randomization { environment } else { EnvironmentConfig::nominal(&environment) }
    }

    /// The settings that determine what a trajectory means, which all members of a run must have.
    pub fn settings(&self) -> CanonicalSettings {
        CanonicalSettings::of_run(&self.policy, &self.environment)
    }

    /// What actors with these settings do.
    pub fn acting_limits(&self) -> ActingLimits {
        ActingLimits {
            episode_steps: self.environment.episode_steps,
            has_prebuilt_starts: self.actor.tasks.prebuilt_probability > 0.0,
        }
    }

    fn grippers(&self, path: &str) -> Result<(), InvalidSetting> {
        let (worlds, policy) = (self.environment.n_grippers, self.policy.features.n_grippers);
        let expected = format_args!("{policy}, as policy.features.n_grippers");
        InvalidSetting::check(key(path, "environment.n_grippers"), worlds, worlds == policy, expected)
    }
}

/// The file of the keys in `table`, which are put over `base`.
fn file(base: &Preset, table: &toml::Table) -> String {
    format!("base = \"{}\"\n{}", base.name, toml::to_string(table).expect("a table is TOML"))
}

/// Restores numbers to the digits that they were given with: a 32-bit setting is written as 0.04 instead of
/// 0.03999999910593033, which is the same number in 32 bits.
fn shorten(value: &mut toml::Value) {
    match value {
        toml::Value::Float(number) => {
            let narrow = *number as f32;
            if f64::from(narrow) == *number {
                *number = narrow.to_string().parse().unwrap_or(*number);
            }
        }
        toml::Value::Array(values) => values.iter_mut().for_each(shorten),
        toml::Value::Table(table) => table.iter_mut().for_each(|(_, value)| shorten(value)),
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn policies_are_evaluated_in_one_world_unless_asked_otherwise() {
        let parse = |more: &str| {
            let text = format!(
                "[environment.magnets]\nsnap_gap_m = 0.02\n[environment.randomization]\nfriction = [0.5, 2.0]\n{more}"
            );
            Config::parse(&text, "file").unwrap().checked().unwrap()
        };
        let config = parse("");
        let evaluated = Config::evaluation_environment(&config);
        assert_eq!((evaluated.randomization.friction, evaluated.magnets.snap_gap_m), (None, 0.02));
        let drawn = Config::evaluation_environment(&parse("[evaluator.episodes]\nrandomization = true"));
        assert_eq!(*drawn, config.environment);
    }

    #[test]
    fn numbers_are_written_as_they_were_given() {
        // One in 32 bits, and one in 64.
        let file = "[learner.loss]\nclip_range = 0.04\n[learner.curriculum]\nkind = \"paper\"\ntemperature = 0.1";
        let text = Config::parse(file, "file").unwrap().to_toml();
        assert!(text.contains("clip_range = 0.04\n") && text.contains("temperature = 0.1\n"), "{text}");
        // Nine significant digits identify every 32-bit number, so a longer fraction means that one was widened to 64
        // bits.
        let has_many = |line: &&str| line.split_once('.').is_some_and(|(_, rest)| rest.len() > 10);
        assert_eq!(text.lines().filter(|line| line.contains(" = ")).find(has_many), None);
    }
}
