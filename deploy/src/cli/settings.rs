//! Sources of a process's settings.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use clap::Args;
use clap::builder::{PossibleValue, PossibleValuesParser};
use learner::config::LrSchedule;
use proto::Valid;
use runlog::RunPaths;

use crate::config::{
    ABLATIONS, Ablation, Config, ConfigError, DEFAULT_PRESET, DEFAULTS, Override, PRESETS, Preset, explain, merge,
    read, schema,
};

/// Sources of the configuration.
#[derive(Clone, Debug, Default, Args)]
pub struct ConfigArgs {
    /// Configuration file; its keys override the preset that it names as `base`, or else --preset.
    #[arg(long, value_name = "FILE", env = "LODESTONE_CONFIG")]
    pub config: Option<PathBuf>,
    /// Built-in configuration; --config overrides it if both are given [default: quickstart].
    #[arg(long, value_name = "NAME", env = "LODESTONE_PRESET", value_parser = PossibleValuesParser::new(PRESETS.iter().map(of_preset)))]
    pub preset: Option<String>,
    /// One of the paper's ablations; overrides the preset and the file.
    #[arg(long, value_name = "NAME", value_parser = PossibleValuesParser::new(ABLATIONS.iter().map(of_ablation)))]
    pub ablation: Option<String>,
    /// Set one configuration key, for example actor.n_worlds=16; may be repeated.
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Seed for all randomness.
    #[arg(long, value_name = "S", value_parser = clap::value_parser!(i64).range(0..), allow_negative_numbers = true)]
    pub seed: Option<i64>,
    /// Device that runs the network: cpu or gpu.
    #[arg(long, value_name = "DEVICE", value_parser = PossibleValuesParser::new(["cpu", "gpu"]))]
    pub device: Option<String>,
    /// Name of the run; processes with the same run name and router work together.
    #[arg(long, value_name = "NAME")]
    pub run: Option<String>,
    /// Print the resulting configuration and exit.
    #[arg(long)]
    pub print_config: bool,
    /// With --print-config: a comment for each key, with its meaning, values, and default.
    #[arg(long, requires = "print_config")]
    pub explain: bool,
    /// With --print-config: only what differs from the preset, as a file for --config.
    #[arg(long, requires = "print_config")]
    pub changed: bool,
    /// With --print-config: the JSON Schema of a configuration file, for editors.
    #[arg(long, requires = "print_config", conflicts_with_all = ["explain", "changed"])]
    pub schema: bool,
}

/// A configuration and where it came from.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// The configuration, merged from all layers and checked.
    pub config: Valid<Config>,
    /// The file and its base in words, for example "my.toml over the preset `quickstart`".
    pub source: String,
    /// The preset, unless a file or an ablation overrides it.
    pub preset: Option<&'static Preset>,
    /// What the file and the flags change.
    pub base: &'static Preset,
}

impl ConfigArgs {
    /// Merges all layers of the configuration.
    ///
    /// With `resume`, the settings of the run in that folder replace the file and the preset; `flags` come last.
    ///
    /// # Errors
    /// Names the file, variable, or flag, or the setting, and what would be valid.
    pub fn load(&self, resume: Option<&PathBuf>, flags: Vec<Override>) -> Result<Settings, ConfigError> {
        let overrides = self.overrides(flags)?;
        let mut settings = self.merged(resume, &overrides)?;
        has_effect(&overrides, &settings.config)?;
        if let Some(name) = &self.ablation {
            write!(settings.source, ", with the ablation `{name}`").expect("a string takes all");
            // The preset's duration no longer applies.
            settings.preset = None;
        }
        Ok(settings)
    }

    /// Applies `overrides` to the resumed run, the file, or the preset.
    fn merged(&self, resume: Option<&PathBuf>, overrides: &[Override]) -> Result<Settings, ConfigError> {
        let settings = |text: &str, origin: &str, base, source, preset| -> Result<Settings, ConfigError> {
            Ok(Settings { config: merge(text, origin, base, overrides)?.checked()?, source, preset, base })
        };
        if let Some(folder) = resume {
            // Runs of earlier versions name no base; like all others, they are merged over the defaults.
            let path = RunPaths::new(folder).config();
            let text = read(&path)?;
            let origin = path.display().to_string();
            let before = Config::parse(&text, &origin)?;
            let settings = settings(&text, &origin, &DEFAULTS, origin.clone(), None)?;
            goes_on(&before, &settings.config, folder)?;
            return Ok(settings);
        }
        if let Some(file) = &self.config {
            let text = read(file)?;
            let origin = file.display().to_string();
            let base = self.base(&text, &origin)?;
            return settings(&text, &origin, base, format!("{origin} over {}", base.words()), None);
        }
        let preset = self.named_preset()?;
        settings("", preset.name, preset, preset.words(), Some(preset))
    }

    /// The configuration as --print-config shows it.
    ///
    /// # Errors
    /// Never for a configuration that was loaded.
    pub fn printed(&self, settings: &Settings) -> Result<String, ConfigError> {
        let Settings { config, base, .. } = settings;
        if self.schema {
            return Ok(format!("{:#}", schema()));
        }
        let text = if self.changed { config.changes(base)? } else { config.to_toml() };
        Ok(if self.explain { explain(&text) } else { text })
    }

    /// The base that the keys of a file override.
    fn base(&self, text: &str, origin: &str) -> Result<&'static Preset, ConfigError> {
        let preset = self.named_preset()?;
        let keys: toml::Table =
            toml::from_str(text).map_err(|error| ConfigError::from_toml(&error, Some(text), origin))?;
        let Some(name) = keys.get("base").and_then(toml::Value::as_str) else { return Ok(preset) };
        let named = Preset::find(name)?;
        if self.preset.is_some() && named != preset {
            let (named, preset) = (named.words(), preset.words());
            let message = format_args!("its `base` is {named}, and --preset is {preset}: give one of them");
            return Err(ConfigError::at(origin, message));
        }
        Ok(named)
    }

    fn named_preset(&self) -> Result<&'static Preset, ConfigError> {
        Preset::find(self.preset.as_deref().unwrap_or(DEFAULT_PRESET))
    }

    /// All overrides in order: the ablation, the variables, the flags of this struct, then `flags`.
    fn overrides(&self, flags: Vec<Override>) -> Result<Vec<Override>, ConfigError> {
        let mut overrides = match self.ablation.as_deref() {
            Some(name) => Ablation::find(name)?.overrides()?,
            None => Vec::new(),
        };
        overrides.extend(Override::from_variables(std::env::vars_os())?);
        for text in &self.set {
            overrides.push(Override::parse(text)?);
        }
        overrides.extend(self.seed.map(|seed| Override::flag("--seed", "seed", seed)));
        overrides.extend(self.device.clone().map(|device| Override::flag("--device", "device", device)));
        overrides.extend(self.run.clone().map(|run| Override::flag("--run", "bus.run", run)));
        overrides.extend(flags);
        Ok(overrides)
    }
}

/// A preset as a value of `--preset`.
fn of_preset(preset: &Preset) -> PossibleValue {
    PossibleValue::new(preset.name).help(format!("{}; takes {}", preset.about, preset.takes))
}

/// An ablation as a value of `--ablation`.
fn of_ablation(ablation: &Ablation) -> PossibleValue {
    PossibleValue::new(ablation.name).help(ablation.about)
}

/// Refuses a learning rate that is given while a schedule sets it.
fn has_effect(overrides: &[Override], config: &Config) -> Result<(), ConfigError> {
    let is_rate = |given: &&Override| given.path == ["learner", "optimizer", "learning_rate"];
    match overrides.iter().find(is_rate) {
        Some(given) if matches!(config.learner.optimizer.lr_schedule, LrSchedule::Line(_)) => Err(ConfigError::at(
            &given.origin,
            "has no effect while learner.optimizer.lr_schedule is a line; change its points, or add \
             learner.optimizer.lr_schedule.kind=fixed",
        )),
        _ => Ok(()),
    }
}

/// Refuses settings that a run in `folder` cannot change: its network has learned from normalized numbers.
fn goes_on(before: &Config, now: &Config, folder: &Path) -> Result<(), ConfigError> {
    let (was, is) = (&before.learner.normalization, &now.learner.normalization);
    for (name, was, is) in [("features", was.features, is.features), ("values", was.values, is.values)] {
        if was && !is {
            return Err(ConfigError::at(
                folder.display(),
                format_args!("learner.normalization.{name} = false comes too late for this run; start another one"),
            ));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The settings that a file with this text produces together with a preset.
    fn load(text: &str, preset: Option<&str>) -> Result<Settings, ConfigError> {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("my.toml");
        std::fs::write(&file, text).unwrap();
        let args = ConfigArgs { config: Some(file), preset: preset.map(str::to_owned), ..ConfigArgs::default() };
        args.load(None, Vec::new())
    }

    fn preset(name: &str) -> Config {
        Config::parse(Preset::find(name).unwrap().text, name).unwrap()
    }

    #[test]
    fn a_file_is_put_over_quickstart_unless_another_base_is_named() {
        let two_lines = load("[actor]\nn_worlds = 3", None).unwrap();
        assert_eq!((two_lines.config.actor.n_worlds, two_lines.preset), (3, None));
        assert_eq!(two_lines.config.learner, preset("quickstart").learner);
        assert!(two_lines.source.ends_with("my.toml over the preset `quickstart`"), "{}", two_lines.source);
        assert_eq!(*load("", Some("paper")).unwrap().config, preset("paper"));
        assert_eq!(*load("base = \"paper\"", None).unwrap().config, preset("paper"));
        assert_eq!(*load("base = \"none\"", None).unwrap().config, Config::default());
    }

    #[test]
    fn an_ablation_changes_its_own_keys_alone() {
        let load = |ablation: &str, set: &[&str]| {
            let set = set.iter().map(|&text| text.to_owned()).collect();
            let preset = Some("laptop".to_owned());
            let ablation = Some(ablation.to_owned());
            let args = ConfigArgs { preset, ablation, set, ..ConfigArgs::default() };
            args.load(None, Vec::new()).unwrap()
        };
        let settings = load("single-gripper", &[]);
        let mut expected = preset("laptop");
        expected.bus.run = "single-gripper".to_owned();
        expected.environment.n_grippers = 1;
        expected.policy.features.n_grippers = 1;
        assert_eq!((&*settings.config, settings.preset), (&expected, None));
        assert_eq!(settings.source, "the preset `laptop`, with the ablation `single-gripper`");
        let text = load("no-attention", &[]).config.to_toml();
        assert!(text.contains("attention = false") && text.contains("head_dim = 32"), "the rest of the network stays");
        for ablation in ABLATIONS {
            let settings = load(ablation.name, &[]);
            assert_eq!(settings.config.bus.run, ablation.name);
        }
        assert_eq!(load("single-gripper", &["bus.run=one"]).config.bus.run, "one", "flags come last");
    }

    #[test]
    fn settings_that_could_not_take_effect_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let load = |set: &str, resume: Option<&str>| {
            let run = folder.path().to_owned();
            let args = ConfigArgs { set: vec![set.to_owned()], ..ConfigArgs::default() };
            if let Some(name) = resume {
                std::fs::write(RunPaths::new(&run).config(), preset(name).to_toml()).unwrap();
            }
            args.load(resume.map(|_| &run), Vec::new()).err().map(|error| error.to_string())
        };
        // `laptop` has a schedule of rates.
        let message = load("learner.optimizer.learning_rate=1e-4", Some("laptop")).unwrap();
        assert!(message.contains("has no effect while learner.optimizer.lr_schedule is a line"), "{message}");
        for name in ["features", "values"] {
            let set = format!("learner.normalization.{name}=false");
            let message = load(&set, Some("smoke")).unwrap();
            assert!(message.contains(&format!("{name} = false comes too late")), "{message}");
            assert_eq!(load(&set, None), None);
        }
        assert_eq!(load("learner.optimizer.learning_rate=1e-4", Some("smoke")), None);
    }

    #[test]
    fn file_and_flag_may_not_name_different_bases() {
        assert!(load("base = \"paper\"", Some("paper")).is_ok());
        for (base, words) in [("paper", "the preset `paper`"), ("none", "the plain defaults")] {
            let message = load(&format!("base = \"{base}\""), Some("laptop")).unwrap_err().to_string();
            assert!(message.contains(words) && message.contains("--preset is the preset `laptop`"), "{message}");
        }
    }
}
