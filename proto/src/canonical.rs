//! Settings in canonical form, which two processes compare before they work together, and its hash.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use blueprints::hash::fnv1a;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::setting::schema::json_of;

/// Maximum length of the text, in bytes. All settings of a policy and a world take about 4 kB.
const MAX_BYTES: usize = 1 << 16;

/// Maximum number of characters of a value shown in an error.
const MAX_SHOWN_CHARS: usize = 80;

/// Settings by full key, such as `policy.mask`; a value is JSON. Settings that are not set are absent.
///
/// The text form is one line `key = value` per setting, sorted by key.
///
/// # Example
/// ```
/// use proto::CanonicalSettings;
/// use serde_json::json;
///
/// let learner = CanonicalSettings::default().with("policy", &json!({ "mask": "none", "grip": { "steps": 5 } }));
/// let actor = CanonicalSettings::default().with("policy", &json!({ "mask": "none" }));
/// assert_eq!(learner.to_string(), "policy.grip.steps = 5\npolicy.mask = \"none\"\n");
/// let difference = learner.difference(&actor).unwrap();
/// assert_eq!(difference.to_string(), "policy.grip.steps is 5 there and not set here");
/// ```
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "Vec<String>", into = "Vec<String>")]
pub struct CanonicalSettings(BTreeMap<String, String>);

/// The first setting, in the order of keys, that two processes have differently.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{}", self.between("there", "here"))]
pub struct SettingsDifference {
    key: String,
    /// The other process's value; `None` if it is not set there.
    theirs: Option<String>,
    own: Option<String>,
}

/// A text that is not in canonical form.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("settings are not in canonical form, which has one line `key = value` for each, sorted by key")]
pub struct NotCanonical;

impl CanonicalSettings {
    /// Returns the settings that determine what a trajectory means.
    pub fn of_run(policy: &impl Serialize, environment: &impl Serialize) -> Self {
        Self::default().with("policy", policy).with("environment", environment)
    }

    /// Adds all settings of the section at `path`.
    ///
    /// # Panics
    /// If `section` has no JSON form. Every configuration has one.
    #[must_use]
    pub fn with(mut self, path: &str, section: &impl Serialize) -> Self {
        self.insert(path, &json_of(section).expect("a configuration is JSON"));
        self
    }

    fn insert(&mut self, path: &str, value: &Value) {
        match value {
            Value::Object(fields) => {
                fields.iter().for_each(|(key, value)| self.insert(&format!("{path}.{key}"), value));
            }
            Value::Null => {}
            leaf => drop(self.0.insert(path.to_owned(), canonical(leaf))),
        }
    }

    /// Returns only the settings of the section at `path`.
    #[must_use]
    pub fn section(&self, path: &str) -> Self {
        let is_inside = |key: &str| key.strip_prefix(path).is_some_and(|rest| rest.starts_with('.'));
        Self(self.0.iter().filter(|(key, _)| is_inside(key)).map(|(key, value)| (key.clone(), value.clone())).collect())
    }

    /// Returns whether there are no settings.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Returns the hash of the text form.
    pub fn hash(&self) -> u64 {
        fnv1a(self.to_string().into_bytes())
    }

    /// Returns the first difference of these settings, another process's, from this process's `own`.
    pub fn difference(&self, own: &Self) -> Option<SettingsDifference> {
        let keys: BTreeSet<&String> = self.0.keys().chain(own.0.keys()).collect();
        let key = keys.into_iter().find(|key| self.0.get(*key) != own.0.get(*key))?;
        let value = |settings: &Self| settings.0.get(key).cloned();
        Some(SettingsDifference { key: key.clone(), theirs: value(self), own: value(own) })
    }

    /// Parses the text form.
    ///
    /// # Errors
    /// If it is not in canonical form, too long, or not printable.
    pub fn parse(text: &str) -> Result<Self, NotCanonical> {
        if text.len() > MAX_BYTES {
            return Err(NotCanonical);
        }
        let settings = Self::from_lines(text.lines())?;
        if settings.to_string() == text { Ok(settings) } else { Err(NotCanonical) }
    }

    fn from_lines<'l>(lines: impl Iterator<Item = &'l str>) -> Result<Self, NotCanonical> {
        let pair = |line: &'l str| {
            let (key, value) = line.split_once(" = ").filter(|(key, _)| !key.is_empty())?;
            (!line.contains(char::is_control)).then(|| (key.to_owned(), value.to_owned()))
        };
        lines.map(pair).collect::<Option<_>>().map(Self).ok_or(NotCanonical)
    }
}

impl SettingsDifference {
    /// Describes the difference with words for the other process and this one.
    pub fn between(&self, there: &str, here: &str) -> String {
        let shown = |value: &Option<String>| match value {
            Some(value) => value.chars().take(MAX_SHOWN_CHARS).collect(),
            None => "not set".to_owned(),
        };
        format!("{} is {} {there} and {} {here}", self.key, shown(&self.theirs), shown(&self.own))
    }
}

impl fmt::Display for CanonicalSettings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|(key, value)| writeln!(f, "{key} = {value}"))
    }
}

impl From<CanonicalSettings> for Vec<String> {
    fn from(settings: CanonicalSettings) -> Self {
        settings.0.into_iter().map(|(key, value)| format!("{key} = {value}")).collect()
    }
}

impl TryFrom<Vec<String>> for CanonicalSettings {
    type Error = NotCanonical;

    fn try_from(lines: Vec<String>) -> Result<Self, NotCanonical> {
        Self::from_lines(lines.iter().map(String::as_str))
    }
}

/// Returns the hash of the configuration's canonical form: JSON without spaces, with sorted keys and without `null`
/// values.
///
/// Only the keys and values of the configuration file matter, not the names or order of types, variants, and fields in
/// the program. An optional key that is absent does not change the hash. Renaming a key does; tests pin the hashes of
/// the presets to detect it.
///
/// # Panics
/// If `config` has no JSON form, such as a map with non-string keys. Every configuration has a JSON form.
pub fn config_hash(config: &impl Serialize) -> u64 {
    let value = serde_json::to_value(config).expect("a configuration is JSON");
    fnv1a(canonical(&value).into_bytes())
}

/// Returns the canonical form of a value.
fn canonical(value: &Value) -> String {
    match value {
        Value::Object(fields) => {
            let fields: BTreeMap<_, _> = fields.iter().filter(|(_, value)| !value.is_null()).collect();
            let fields = fields.into_iter().map(|(key, value)| format!("{}:{}", json!(key), canonical(value)));
            format!("{{{}}}", fields.collect::<Vec<_>>().join(","))
        }
        Value::Array(values) => format!("[{}]", values.iter().map(canonical).collect::<Vec<_>>().join(",")),
        // Numbers are written with the fewest digits that are exact.
        leaf => leaf.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn canonical_form_is_sorted_and_omits_nulls() {
        let text = canonical(&json!({ "b": [1, 0.5, null, "x\"y"], "a": { "d": true, "c": null } }));
        assert_eq!(text, r#"{"a":{"d":true},"b":[1,0.5,null,"x\"y"]}"#);
        assert_eq!(config_hash(&json!({ "b": 1, "a": 2 })), config_hash(&json!({ "a": 2, "b": 1, "c": null })));
        assert_ne!(config_hash(&json!({ "a": 1 })), config_hash(&json!({ "a": "1" })));
    }

    #[test]
    fn floats_keep_their_shortest_form_and_lists_are_one_value() {
        #[derive(Serialize)]
        struct Section {
            friction: f32,
            range: [f32; 2],
            absent: Option<u8>,
        }
        let section = Section { friction: 0.6, range: [0.1, 1.0], absent: None };
        let settings = CanonicalSettings::default().with("environment.physics", &section);
        let text = "environment.physics.friction = 0.6\nenvironment.physics.range = [0.1,1.0]\n";
        assert_eq!(settings.to_string(), text);
        assert_eq!(CanonicalSettings::parse(text).unwrap(), settings);
        assert_eq!(serde_json::from_str::<CanonicalSettings>(&json!(settings).to_string()).unwrap(), settings);
    }

    #[test]
    fn only_the_canonical_form_is_read() {
        for text in ["b = 1\na = 2\n", "a = 1\na = 1\n", "a = 1", "a: 1\n", " = 1\n", "a = \u{1b}[2J\n", "\n"] {
            assert_eq!(CanonicalSettings::parse(text), Err(NotCanonical), "{text:?}");
        }
        let long = format!("a = {}\n", "1".repeat(MAX_BYTES));
        assert_eq!(CanonicalSettings::parse(&long), Err(NotCanonical));
    }

    #[test]
    fn the_first_different_key_is_named_with_both_values() {
        let settings = |mask, steps: Option<u8>| {
            CanonicalSettings::of_run(&json!({ "mask": mask }), &json!({ "episode": { "steps": steps } }))
        };
        let own = settings("none", Some(100));
        let difference = |theirs: CanonicalSettings| theirs.difference(&own).map(|difference| difference.to_string());
        assert_eq!(difference(own.clone()), None);
        let mask = Some(r#"policy.mask is "blueprint" there and "none" here"#.to_owned());
        assert_eq!(difference(settings("blueprint", Some(100))), mask);
        let steps = Some("environment.episode.steps is not set there and 100 here".to_owned());
        assert_eq!(difference(settings("blueprint", None)), steps);
        assert_eq!(
            settings("blueprint", None).section("policy").difference(&own.section("policy")).unwrap().key,
            "policy.mask"
        );
        assert_ne!(settings("blueprint", Some(100)).hash(), own.hash());
    }
}
