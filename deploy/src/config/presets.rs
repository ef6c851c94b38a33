//! The presets, embedded so that the binary needs no other files.

use super::{ConfigError, Override, error::nearest};

/// A named configuration file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Preset {
    /// Name on the command line; also the file name without its extension.
    pub name: &'static str,
    /// What a training takes, on two cores unless the text says otherwise.
    pub takes: &'static str,
    /// The text of the file.
    pub text: &'static str,
}

macro_rules! presets {
    ($($name:literal: $takes:expr),+ $(,)?) => {
        &[$(Preset { name: $name, takes: $takes, text: include_str!(concat!("../../config/", $name, ".toml")) }),+]
    };
}

/// The preset that `train` uses by default.
pub const DEFAULT_PRESET: &str = "quickstart";

/// Cost of a billion environment steps.
const PAPER: &str = "months on two cores: meant for hundreds of actors and a GPU, and for weeks with them";

/// All presets, the default first.
pub const PRESETS: &[Preset] = presets![
    "quickstart": "about a minute on two cores, 0.3 GB of memory and 0.1 GB of disk",
    "laptop": "about 35 minutes on two cores, 0.5 GB of memory and 0.5 GB of disk; it may be ended and resumed at any time",
    "near-goal": "one to two minutes on two cores",
    "paper": PAPER,
    "no-attention": PAPER,
    "resnet": PAPER,
    "single-gripper": PAPER,
    "no-curriculum": PAPER,
    "no-blueprint-resets": PAPER,
    "transition-delay": PAPER,
    "single-blueprint": PAPER,
];

impl Preset {
    /// The paper's ablations: presets whose base is `paper`.
    pub fn ablations() -> impl Iterator<Item = &'static Self> {
        PRESETS.iter().filter(|preset| preset.text.lines().any(|line| line == "base = \"paper\""))
    }

    /// The settings in the file itself, without its base.
    ///
    /// # Errors
    /// When the file is not TOML.
    pub fn overrides(&self) -> Result<Vec<Override>, ConfigError> {
        let mut keys: toml::Table =
            toml::from_str(self.text).map_err(|error| ConfigError::from_toml(&error, Some(self.text), self.name))?;
        keys.remove("base");
        Ok(Override::of_table(self.name, keys))
    }

    /// Finds a preset by name.
    ///
    /// # Errors
    /// Names the existing presets.
    pub fn find(name: &str) -> Result<&'static Self, ConfigError> {
        PRESETS.iter().find(|preset| preset.name == name).ok_or_else(|| ConfigError::Preset {
            name: name.to_owned(),
            nearest: nearest(name, PRESETS.iter().map(|preset| preset.name)),
            known: PRESETS.iter().map(|preset| preset.name).collect(),
        })
    }
}
