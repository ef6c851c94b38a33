//! The layers over a file: variables and flags, each of which sets one key.

use std::ffi::OsString;

use super::{Config, ConfigError, DEFAULTS, Preset, file};

/// Settings that are variables without a section.
pub(super) const SETTINGS: [&str; 3] = ["DEVICE", "RUN", "SEED"];

pub(super) const PREFIX: &str = "LODESTONE_";

/// A key that is set from outside the file.
#[derive(Clone, Debug, PartialEq)]
pub struct Override {
    /// The variable or flag, for error messages.
    pub origin: String,
    /// The key with its sections, for example `["learner", "gamma"]`.
    pub path: Vec<String>,
    /// The value.
    pub value: toml::Value,
}

impl Override {
    /// An override by a flag that stands for the dotted key `path`.
    pub fn flag(flag: &str, path: &str, value: impl Into<toml::Value>) -> Self {
        Self { origin: flag.to_owned(), path: path.split('.').map(str::to_owned).collect(), value: value.into() }
    }

    /// Parses `KEY=VALUE` as given to `--set`; the value is TOML, or a string if it is not valid TOML.
    ///
    /// # Errors
    /// When there is no `=` or no key before it.
    pub fn parse(text: &str) -> Result<Self, ConfigError> {
        let origin = format!("--set {text}");
        match text.split_once('=') {
            Some((key, value)) if !key.trim().is_empty() => {
                Ok(Self { value: parse_value(value), ..Self::flag(&origin, key.trim(), "") })
            }
            _ => Err(ConfigError::at(origin, "expected KEY=VALUE, for example seed=7")),
        }
    }

    /// The overrides among these variables, ordered by variable name.
    ///
    /// `LODESTONE_LEARNER__GAMMA` sets `learner.gamma`. Only names with two underscores between section and key count,
    /// plus `LODESTONE_SEED`, `LODESTONE_RUN`, and `LODESTONE_DEVICE`. [`check_variables`](super::check_variables)
    /// refuses what is no variable of ours.
    ///
    /// # Errors
    /// Names a setting whose value is not Unicode. Other variables may hold anything.
    pub fn from_variables(variables: impl IntoIterator<Item = (OsString, OsString)>) -> Result<Vec<Self>, ConfigError> {
        let of_variable = |(name, value): (OsString, OsString)| {
            let name = name.to_string_lossy().into_owned();
            let key = name.strip_prefix(PREFIX)?.to_ascii_lowercase();
            let counts = key.contains("__") || SETTINGS.iter().any(|name| name.eq_ignore_ascii_case(&key));
            // The run's name is a setting of the bus, but every process may set it.
            let key = if key == "run" { "bus__run".to_owned() } else { key };
            // A name is text, whatever TOML would make of it: 7 and 2026-11-23 are names, too.
            let is_text = key == "bus__run";
            counts.then(|| match value.into_string() {
                Ok(value) => Ok(Self {
                    path: key.split("__").map(str::to_owned).collect(),
                    value: if is_text { toml::Value::String(value.trim().to_owned()) } else { parse_value(&value) },
                    origin: name,
                }),
                Err(_) => Err(ConfigError::at(name, "the value is not Unicode")),
            })
        };
        let mut overrides: Vec<Self> = variables.into_iter().filter_map(of_variable).collect::<Result<_, _>>()?;
        overrides.sort_by(|a, b| a.origin.cmp(&b.origin));
        Ok(overrides)
    }

    /// Refuses overrides of keys outside these sections, which the command would ignore.
    ///
    /// # Errors
    /// Names the first such override and the sections.
    pub fn only_in(sections: &[&str], overrides: &[Self]) -> Result<(), ConfigError> {
        match overrides.iter().find(|given| !sections.contains(&given.path[0].as_str())) {
            None => Ok(()),
            Some(given) => {
                let read = sections.join(" and ");
                Err(ConfigError::at(
                    &given.origin,
                    format_args!("this command reads {read} alone; see its flags for the rest"),
                ))
            }
        }
    }

    /// Sets the key in `table`. Other keys stay, except those of an alternative that this key replaces.
    fn apply(&self, table: &mut toml::Table) -> Result<(), ConfigError> {
        let Some((key, sections)) = self.path.split_last() else { return Ok(()) };
        let mut table = table;
        for (section, next) in sections.iter().zip(&self.path[1..]) {
            let empty = || toml::Value::Table(toml::Table::new());
            let entry = table.entry(section).or_insert_with(empty);
            if CHOICES.contains(&section.as_str()) && entry.get(next).is_none() {
                *entry = empty();
            }
            let no_section = || ConfigError::at(&self.origin, format_args!("`{section}` is a value, not a section"));
            table = entry.as_table_mut().ok_or_else(no_section)?;
        }
        if key == "kind" && table.get(key) != Some(&self.value) {
            table.clear();
        }
        table.insert(key.clone(), self.value.clone());
        Ok(())
    }
}

impl Config {
    /// Parses a file's text and applies it to the defaults, unless it names another base. `origin` names the file in
    /// errors.
    ///
    /// # Errors
    /// Names the line of an unknown key, with the nearest known one, or of a value of the wrong type.
    pub fn parse(text: &str, origin: &str) -> Result<Self, ConfigError> {
        merge(text, origin, &DEFAULTS, &[])
    }

    /// A file of the keys that differ from those of `base`; the whole tree, if keys of the base are absent here.
    ///
    /// # Errors
    /// Never for the bases of this program.
    ///
    /// # Panics
    /// As [`Self::to_toml`].
    pub fn changes(&self, base: &'static Preset) -> Result<String, ConfigError> {
        let before = merge("", "", base, &[])?.to_table();
        let text = file(base, &changed(&before, self.to_table()));
        Ok(if Self::parse(&text, "")? == *self { text } else { self.to_toml() })
    }
}

/// Applies `overrides` in their order to the file `text`, and the file to the base that it names, or else to `base`.
///
/// # Errors
/// Names the file and line, the variable, or the flag with an unknown key or a value of the wrong type.
pub fn merge(text: &str, origin: &str, base: &'static Preset, overrides: &[Override]) -> Result<Config, ConfigError> {
    let mut config = to_config(&with_base(text, origin, base)?, origin)?;
    for layer in overrides {
        // Apply each layer to the whole tree, so that it can set a single key of a choice, and apply layers one at a
        // time, so that an error names the layer that caused it.
        let mut table = config.to_table();
        layer.apply(&mut table)?;
        config = to_config(&table, &layer.origin)?;
    }
    Ok(config)
}

/// The keys of the base that the file `text` names, or else of `base`, with the file's keys applied.
fn with_base(text: &str, origin: &str, base: &'static Preset) -> Result<toml::Table, ConfigError> {
    let refused = |error: toml::de::Error| ConfigError::from_toml(&error, Some(text), origin);
    let mut keys: toml::Table = toml::from_str(text).map_err(refused)?;
    // Deserialize the text rather than the table, because only then does an error know its line.
    let file: Config = toml::from_str(text).map_err(refused)?;
    keys.remove("base");
    let base = file.base.as_deref().map_or(Ok(base), Preset::find)?;
    let is_empty = base.text.is_empty();
    let mut table = if is_empty { toml::Table::new() } else { with_base(base.text, base.name, &DEFAULTS)? };
    put_over(&mut table, keys);
    Ok(table)
}

/// Sections that hold one of several alternative keys.
const CHOICES: [&str; 2] = ["every", "filter"];

/// Whether the section `key` is no choice, or the same one in both.
fn is_same_choice(key: &str, old: &toml::Table, new: &toml::Table) -> bool {
    old.get("kind") == new.get("kind") && !CHOICES.contains(&key)
}

/// Replaces single keys. If a choice changes, by `kind` or by key, the keys of the other alternatives are dropped.
fn put_over(table: &mut toml::Table, keys: toml::Table) {
    for (key, value) in keys {
        match (table.get_mut(&key), value) {
            (Some(toml::Value::Table(old)), toml::Value::Table(new)) if is_same_choice(&key, old, &new) => {
                put_over(old, new);
            }
            (_, value) => {
                table.insert(key, value);
            }
        }
    }
}

/// The keys of `now` that [`put_over`] has to put over `before` to get `now`.
fn changed(before: &toml::Table, now: toml::Table) -> toml::Table {
    let mut changes = toml::Table::new();
    for (key, value) in now {
        match (before.get(&key), value) {
            (Some(old), new) if *old == new => {}
            (Some(toml::Value::Table(old)), toml::Value::Table(new)) if is_same_choice(&key, old, &new) => {
                let kind = new.get("kind").map(|kind| ("kind".to_owned(), kind.clone()));
                let inside = kind.into_iter().chain(changed(old, new)).collect();
                changes.insert(key, toml::Value::Table(inside));
            }
            (_, new) => drop(changes.insert(key, new)),
        }
    }
    changes
}

fn to_config(table: &toml::Table, origin: &str) -> Result<Config, ConfigError> {
    table.clone().try_into().map_err(|error| ConfigError::from_toml(&error, None, origin))
}

fn parse_value(text: &str) -> toml::Value {
    let parsed: Result<toml::Table, _> = toml::from_str(&format!("value = {text}"));
    match parsed.ok().and_then(|mut table| table.remove("value")) {
        // People write counts as `1e6`, and a whole number is also valid for a setting that may have a fraction.
        Some(toml::Value::Float(number)) if text.contains(['e', 'E']) && is_whole(number) => (number as i64).into(),
        Some(value) => value,
        None => toml::Value::String(text.trim().to_owned()),
    }
}

/// Whether a float is a whole number, within the range where floats represent every whole number.
pub(crate) fn is_whole(number: f64) -> bool {
    const MAX_EXACT: f64 = 9e15;
    number.fract() == 0.0 && number.abs() <= MAX_EXACT
}

#[cfg(test)]
mod tests {
    use std::os::unix::ffi::OsStringExt;

    use super::*;

    /// Merges over the defaults, unless the text names another base.
    fn merge(text: &str, origin: &str, overrides: &[Override]) -> Result<Config, ConfigError> {
        super::merge(text, origin, &DEFAULTS, overrides)
    }

    #[test]
    fn values_are_toml_or_else_strings() {
        for (text, expected) in [
            ("3", toml::Value::Integer(3)),
            ("1e-3", toml::Value::Float(1e-3)),
            ("true", toml::Value::Boolean(true)),
            ("\"3\"", toml::Value::String("3".into())),
            ("tcp/127.0.0.1:7447", toml::Value::String("tcp/127.0.0.1:7447".into())),
            // A count may have an exponent.
            ("1e6", 1_000_000.into()),
            ("2.5e3", 2500.into()),
            ("1.0", 1.0.into()),
        ] {
            assert_eq!(Override::parse(&format!("key={text}")).unwrap().value, expected, "{text}");
        }
    }

    #[test]
    fn a_file_changes_a_choice_of_its_base_which_must_exist() {
        let other = merge("base = \"quickstart\"\n[evaluator]\nevery = { versions = 3 }", "file", &[]).unwrap();
        assert_eq!(other.evaluator.every, evaluator::Every::Versions(3));
        let unknown = merge("base = \"papr\"", "file", &[]).unwrap_err().to_string();
        assert!(unknown.starts_with("there is no preset `papr`; did you mean `paper`?"), "{unknown}");
    }

    #[test]
    fn keys_that_a_command_does_not_read_are_refused() {
        let only = |text: &str| {
            let given = Override::parse(text).unwrap();
            Override::only_in(&["environment", "evaluator"], &[given]).map_err(|error| error.to_string())
        };
        for text in ["environment.episode_steps=50", "evaluator.reset_free.n_runs=5", "environment={n_grippers=1}"] {
            assert_eq!(only(text), Ok(()));
        }
        for text in ["learner.gamma=0.9", "seed=5", "environments.x=1", "evaluate=1"] {
            let expected =
                format!("--set {text}: this command reads environment and evaluator alone; see its flags for the rest");
            assert_eq!(only(text), Err(expected));
        }
    }

    #[test]
    fn a_key_of_a_choice_can_be_set() {
        let set = |text: &str| merge("", "defaults", &[Override::parse(text).unwrap()]).unwrap();
        let adaptive = learner::config::AdaptiveRate { high_kl: 0.03, ..Default::default() };
        let rule = |text| set(text).learner.optimizer.lr_schedule;
        assert_eq!(rule("learner.optimizer.lr_schedule.high_kl=0.03"), learner::config::LrSchedule::Adaptive(adaptive));
        assert_eq!(
            rule("learner.optimizer.lr_schedule.kind=fixed"),
            learner::config::LrSchedule::Fixed(learner::config::FixedRate {})
        );
        assert_eq!(set("evaluator.every.versions=3").evaluator.every, evaluator::Every::Versions(3));
        let blueprints = vec!["2_000".to_owned().try_into().unwrap()];
        let filter = set("actor.tasks.filter.blueprints=[\"2_000\"]").actor.tasks.filter;
        assert_eq!(filter, actor::TaskFilter::Blueprints(blueprints));
    }

    #[test]
    fn only_variables_that_look_like_keys_count() {
        let variables = [
            ("LODESTONE_PORT_7447_TCP", "tcp://10.0.0.1:7447"),
            ("LODESTONE_GOLDEN_DIR", "golden"),
            ("LODESTONE_ACTOR__N_WORLDS", "8"),
            ("LODESTONE_RUN", "7"),
            ("LODESTONE_SEED", "2"),
            ("HOME", "/"),
        ];
        let overrides = Override::from_variables(variables.map(|(name, value)| (name.into(), value.into()))).unwrap();
        assert_eq!(overrides.len(), 3);
        assert_eq!(overrides[0].path, ["actor", "n_worlds"]);
        let merged = merge("seed = 1", "file", &overrides).unwrap();
        assert_eq!((merged.actor.n_worlds, merged.bus.run.as_str(), merged.seed), (8, "7", 2));
    }

    #[test]
    fn only_settings_must_be_unicode() {
        let odd = || OsString::from_vec(b"\xff\xfe".to_vec());
        let others = [(odd(), odd()), ("HOME".into(), odd()), ("LODESTONE_RUN_DIR".into(), odd())];
        assert!(Override::from_variables(others).unwrap().is_empty());
        let error = Override::from_variables([("LODESTONE_BUS__RUN".into(), odd())]).unwrap_err().to_string();
        assert_eq!(error, "LODESTONE_BUS__RUN: the value is not Unicode");
    }

    #[test]
    fn errors_name_the_layer_and_the_nearest_key() {
        let message = |text: &str, set: &str| {
            let overrides = Override::parse(set).map(|layer| vec![layer]);
            overrides.and_then(|overrides| merge(text, "my.toml", &overrides)).unwrap_err().to_string()
        };
        for (text, set, expected) in [
            (
                "seed = 1\n\n[actor]\nn_wrlds = 3",
                "seed=1",
                "my.toml:4: unknown key `n_wrlds`; did you mean `n_worlds`?",
            ),
            ("", "actor.n_wrlds=3", "--set actor.n_wrlds=3: unknown key `n_wrlds`; did you mean `n_worlds`?"),
            ("seed = 1", "seed.x=3", "--set seed.x=3: `seed` is a value, not a section"),
            ("", "seed=1.5e0", "--set seed=1.5e0: invalid type: floating point `1.5`, expected u64"),
            ("", "seed", "--set seed: expected KEY=VALUE, for example seed=7"),
        ] {
            assert_eq!(message(text, set), expected);
        }
        let wrong_type = message("", "seed=abc");
        assert!(wrong_type.starts_with("--set seed=abc: invalid type: string \"abc\", expected u64"), "{wrong_type}");
    }
}
