//! The page of all settings is what the source says.

use std::collections::BTreeMap;
use std::path::Path;

use deploy::config::{Config, DEFAULTS, Key, PRESETS, keys, merge};

use crate::repository::{read, root};

/// The units of settings, by how their names end.
const UNITS: [(&str, &str); 11] = [
    ("_mb_per_s", "MB/s"),
    ("_mps", "m/s"),
    ("_radps", "rad/s"),
    ("_mps2", "m/s²"),
    ("_kgpm3", "kg/m³"),
    ("_deg", "degrees"),
    ("_steps", "steps"),
    ("minutes", "minutes"),
    ("_entropy", "nats"),
    ("_m", "m"),
    ("_n", "N"),
];

/// The values of a configuration by key.
fn flat(config: &Config) -> BTreeMap<String, toml::Value> {
    fn put(before: &str, value: toml::Value, into: &mut BTreeMap<String, toml::Value>) {
        match value {
            toml::Value::Table(inside) => {
                inside.into_iter().for_each(|(key, value)| put(&proto::setting::key(before, &key), value, into));
            }
            value => drop(into.insert(before.to_owned(), value)),
        }
    }
    let mut values = BTreeMap::new();
    put("", toml::Value::Table(config.to_toml().parse().unwrap()), &mut values);
    values
}

/// The page `docs/settings.md`.
fn page() -> String {
    let presets: Vec<_> =
        PRESETS.iter().map(|preset| (preset.name, flat(&merge("", "", preset, &[]).unwrap()))).collect();
    let mut page =
        "<!-- Generated from the source by tests/tests/settings.rs; do not edit. -->\n\n# Settings\n".to_owned();
    let keys = keys();
    let (sections, top): (Vec<&Key>, Vec<&Key>) =
        keys.iter().filter(|key| !key.name.contains('.')).partition(|key| key.is_section());
    page += &table(&top, &presets);
    for section in sections {
        let inside = format!("{}.", section.name);
        let rows: Vec<&Key> = keys.iter().filter(|key| key.name.starts_with(&inside) && !key.is_section()).collect();
        page += &format!("\n## {}\n\n{}.\n{}", section.name, section.sentence(), table(&rows, &presets));
    }
    page
}

fn table(rows: &[&Key], presets: &[(&str, BTreeMap<String, toml::Value>)]) -> String {
    let defaults = flat(&Config::default());
    let mut table = "\n| key | default | values | unit | meaning | presets |\n|---|---|---|---|---|---|\n".to_owned();
    for key in rows {
        // What a file says, for a key of a variant that is not the default one.
        let default = defaults.get(&key.name).map(ToString::to_string).or_else(|| key.default()).unwrap_or_default();
        let default = if default.is_empty() { default } else { format!("`{default}`") };
        let changed = presets.iter().filter(|(_, values)| values.get(&key.name) != defaults.get(&key.name));
        let changed = changed.filter_map(|(name, values)| Some(format!("{name} `{}`", values.get(&key.name)?)));
        let unit = UNITS.iter().find(|(end, _)| key.name.ends_with(end)).map_or("", |(_, unit)| unit);
        let kind = key.kind.as_ref().map(|kind| format!(" (kind {kind})")).unwrap_or_default();
        let cells = [
            format!("`{}`{kind}", key.name),
            default,
            key.values(),
            unit.to_owned(),
            key.sentence().to_owned(),
            changed.collect::<Vec<_>>().join(", "),
        ];
        table += &format!("| {} |\n", cells.join(" | ").replace("| |", "|  |"));
    }
    table
}

#[test]
fn the_page_of_settings_is_true() {
    let now = page();
    if read(&root().join("docs/settings.md")) != now {
        let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join("settings.md");
        std::fs::write(&file, now).unwrap();
        panic!("docs/settings.md is not what the source says: copy {} over it", file.display());
    }
}

#[test]
fn a_file_of_changes_gives_the_same_configuration() {
    for preset in PRESETS {
        let whole = Config::parse(preset.text, preset.name).unwrap();
        for base in PRESETS.iter().chain([&DEFAULTS]) {
            let text = whole.changes(base).unwrap();
            assert_eq!(
                Config::parse(&text, "the changes").unwrap(),
                whole,
                "{} over {}: {text}",
                preset.name,
                base.name
            );
        }
        let own = whole.changes(preset).unwrap();
        assert_eq!(own.trim(), format!("base = \"{}\"", preset.name));
    }
}
