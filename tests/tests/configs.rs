//! Every preset parses, is valid, survives a round trip, and is embedded in the binary.

use std::collections::BTreeSet;

use deploy::config::{Config, PRESETS, check_variables};

use crate::repository::{files, read, root, shown};

#[test]
fn presets_and_defaults_are_valid_and_round_trip() {
    let presets = PRESETS.iter().map(|preset| (preset.name, Config::parse(preset.text, preset.name).unwrap()));
    for (name, config) in presets.chain([("the defaults", Config::default())]) {
        config.clone().checked().unwrap_or_else(|error| panic!("{name}: {error}"));
        assert_eq!(Config::parse(&config.to_toml(), "written again").unwrap(), config, "{name}");
    }
}

#[test]
fn the_binary_embeds_every_preset() {
    let in_folder: BTreeSet<String> = files(&root().join("deploy/config"), &["toml"])
        .iter()
        .map(|path| path.file_stem().unwrap().to_string_lossy().into_owned())
        .collect();
    let embedded: BTreeSet<String> = PRESETS.iter().map(|preset| preset.name.to_owned()).collect();
    assert_eq!(embedded, in_folder);
}

#[test]
fn every_variable_of_scripts_and_manifests_exists() {
    let mut paths = files(root(), &["sh", "sbatch", "yaml", "yml", "py", "example"]);
    paths.extend([".ci/run", "deploy/slurm/lodestone-slurm", "deploy/Dockerfile"].map(|path| root().join(path)));
    let program = deploy::cli::program();
    let mut n_names = 0;
    for path in paths {
        let text = read(&path);
        for rest in text.split("LODESTONE_").skip(1) {
            let end = rest.find(|c: char| !(c.is_ascii_uppercase() || c.is_ascii_digit() || c == '_'));
            let name = format!("LODESTONE_{}", &rest[..end.unwrap_or(rest.len())]);
            if name.ends_with('_') {
                continue;
            }
            n_names += 1;
            let known = check_variables([name.as_str()], &program);
            assert!(known.is_ok(), "{}: {}", shown(&path), known.unwrap_err());
        }
    }
    assert!(n_names > 100, "{n_names} names were found");
}
