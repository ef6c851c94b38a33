//! Every preset parses, is valid, survives a round trip, and is embedded in the binary.

use std::collections::BTreeSet;

use deploy::config::{Config, PRESETS};

use crate::repository::{files, read, root};

#[test]
fn every_preset_parses_and_round_trips() {
    for path in files(&root().join("deploy/config"), &["toml"]) {
        let config = Config::parse(&read(&path), &path.display().to_string()).unwrap();
        config.validate().unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        let written = config.to_toml();
        assert_eq!(Config::parse(&written, "written again").unwrap(), config, "{}", path.display());
    }
}

#[test]
fn the_defaults_are_valid_and_round_trip() {
    let config = Config::default();
    config.validate().unwrap();
    assert_eq!(Config::parse(&config.to_toml(), "the defaults").unwrap(), config);
}

#[test]
fn the_binary_embeds_every_preset() {
    let in_folder: BTreeSet<String> = files(&root().join("deploy/config"), &["toml"])
        .iter()
        .map(|path| path.file_stem().unwrap().to_string_lossy().into_owned())
        .collect();
    let embedded: BTreeSet<String> = PRESETS.iter().map(|preset| preset.name.to_owned()).collect();
    assert_eq!(embedded, in_folder);
    for preset in PRESETS {
        assert_eq!(preset.text, read(&root().join(format!("deploy/config/{}.toml", preset.name))), "{}", preset.name);
    }
}
