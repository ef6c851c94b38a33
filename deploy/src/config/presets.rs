//! The presets, embedded so that the binary needs no files beside it.

use super::{ConfigError, error::nearest};

/// A named configuration file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Preset {
    /// Name on the command line, and of the file without its extension.
    pub name: &'static str,
    /// The file.
    pub text: &'static str,
}

macro_rules! presets {
    ($($name:literal),+ $(,)?) => {
        &[$(Preset { name: $name, text: include_str!(concat!("../../config/", $name, ".toml")) }),+]
    };
}

/// What `train` uses when nothing else is said.
pub const DEFAULT_PRESET: &str = "quickstart";

/// All presets, the default first.
pub const PRESETS: &[Preset] = presets![
    "quickstart",
    "two-blocks",
    "taught",
    "near-goal",
    "laptop",
    "paper",
    "no-attention",
    "resnet",
    "single-gripper",
    "no-curriculum",
    "no-blueprint-resets",
    "transition-delay",
    "single-blueprint",
];

impl Preset {
    /// The preset of this name.
    ///
    /// # Errors
    /// Names the presets that exist.
    pub fn find(name: &str) -> Result<&'static Self, ConfigError> {
        PRESETS.iter().find(|preset| preset.name == name).ok_or_else(|| ConfigError::Preset {
            name: name.to_owned(),
            nearest: nearest(name, PRESETS.iter().map(|preset| preset.name)),
            known: PRESETS.iter().map(|preset| preset.name).collect(),
        })
    }
}
