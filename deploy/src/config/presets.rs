//! The presets, embedded so that the binary needs no other files.

use super::{ConfigError, nearest, suggestion_or};

/// A named configuration file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Preset {
    /// Name on the command line; also the file name without its extension.
    pub name: &'static str,
    /// What it is for.
    pub about: &'static str,
    /// What a training takes, on two cores unless the text says otherwise.
    pub takes: &'static str,
    /// The text of the file.
    pub text: &'static str,
}

macro_rules! presets {
    ($($name:literal: $about:expr, $takes:expr;)+) => {
        &[$(Preset { name: $name, about: $about, takes: $takes, text: include_str!(concat!("../../config/", $name, ".toml")) }),+]
    };
}

/// The base of a file that overrides the plain defaults.
pub static DEFAULTS: Preset = Preset { name: "none", about: "the plain defaults", takes: "", text: "" };

/// The preset that `train` uses by default.
pub const DEFAULT_PRESET: &str = "quickstart";

/// All presets, the default first.
pub const PRESETS: &[Preset] = presets![
    "quickstart": "a first look, at blueprints of two to four blocks",
        "about a minute on two cores, 0.3 GB of memory and 0.1 GB of disk";
    "laptop": "all training blueprints",
        "about an hour on one core, 0.5 GB of memory and 0.5 GB of disk; it may be ended and resumed at any time";
    "smoke": "for checks of the whole system: one goal of five blocks", "a minute on two cores";
    "paper": "the paper's protocol, for comparisons with it",
        "months on two cores, and weeks on hundreds of actors, for which it is meant";
];

impl Preset {
    /// Finds a preset, or [`DEFAULTS`], by name.
    ///
    /// # Errors
    /// Names the existing presets.
    pub fn find(name: &str) -> Result<&'static Self, ConfigError> {
        PRESETS.iter().chain([&DEFAULTS]).find(|preset| preset.name == name).ok_or_else(|| {
            let known: Vec<&str> = PRESETS.iter().map(|preset| preset.name).collect();
            let suggestion = suggestion_or(&nearest(name, known.iter().copied()), ".");
            let known = known.join(", ");
            ConfigError::Text(format!("there is no preset `{name}`{suggestion} The presets are {known}"))
        })
    }

    /// Its name in sentences.
    pub fn words(&self) -> String {
        if *self == DEFAULTS { self.about.to_owned() } else { format!("the preset `{}`", self.name) }
    }
}
