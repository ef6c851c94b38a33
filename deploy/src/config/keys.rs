//! What is known about each key: its meaning, its values, and its default.

use proto::setting::Section;
use proto::setting::schema::Schema;
use serde_json::{Value, json};

use super::{Config, DEFAULTS, PRESETS};

/// A key or a section of the configuration.
#[derive(Clone, Debug, PartialEq)]
pub struct Key {
    /// The name with its sections, for example `learner.gamma`.
    pub name: String,
    /// What it means; the first sentence says the most.
    pub meaning: String,
    /// The `kind` that has this key, for a key of one variant of a choice.
    pub kind: Option<String>,
    schema: Schema,
}

/// The JSON Schema of a configuration file.
pub fn schema() -> Schema {
    let mut schema = Config::schema();
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema".into();
    schema["title"] = "Lodestone configuration".into();
    let bases: Vec<&str> = PRESETS.iter().chain([&DEFAULTS]).map(|preset| preset.name).collect();
    schema["properties"]["base"]["enum"] = json!(bases);
    schema
}

/// All keys and sections in alphabetical order, a section before its keys. A key that several variants of a choice have
/// is there once for each.
pub fn keys() -> Vec<Key> {
    let mut found = Vec::new();
    walk(&Key { name: String::new(), meaning: String::new(), kind: None, schema: schema() }, &mut found);
    found.sort_by(|a, b| a.name.cmp(&b.name));
    found
}

fn walk(key: &Key, found: &mut Vec<Key>) {
    let variants = key.schema["oneOf"].as_array();
    if let Some(variants) = variants {
        let kind = |variant: &Schema| variant["properties"]["kind"]["const"].clone();
        let kinds: Vec<Value> = variants.iter().map(kind).collect();
        let schema = json!({"enum": kinds, "default": key.schema["default"]["kind"]});
        found.push(Key { name: format!("{}.kind", key.name), schema, ..key.clone() });
    }
    for section in variants.map_or(std::slice::from_ref(&key.schema), Vec::as_slice) {
        let kind = section["properties"]["kind"]["const"].as_str();
        let properties = section["properties"].as_object().into_iter().flatten();
        for (name, schema) in properties.filter(|(name, _)| kind.is_none() || *name != "kind") {
            let own = schema["description"].as_str().or(section["description"].as_str());
            let inside = Key {
                name: proto::setting::key(&key.name, name),
                meaning: own.map_or_else(|| key.meaning.clone(), str::to_owned),
                kind: kind.map(str::to_owned),
                schema: schema.clone(),
            };
            found.push(inside.clone());
            walk(&inside, found);
        }
    }
}

impl Key {
    /// Whether it has keys of its own instead of a value.
    pub fn is_section(&self) -> bool {
        self.schema["properties"].is_object() || self.schema["oneOf"].is_array()
    }

    /// The first sentence of the meaning.
    pub fn sentence(&self) -> &str {
        let end = self.meaning.find(". ").unwrap_or_else(|| self.meaning.trim_end_matches('.').len());
        &self.meaning[..end]
    }

    /// The valid values in words, empty for any text.
    pub fn values(&self) -> String {
        let rule = self.schema["$comment"].as_str().map(str::to_owned);
        let of_type = Some(values(&self.schema)).filter(|text| !text.is_empty());
        of_type.into_iter().chain(rule).collect::<Vec<_>>().join("; ")
    }

    /// The default as it is written in a file, if there is one.
    pub fn default(&self) -> Option<String> {
        Some(&self.schema["default"]).filter(|value| !value.is_null()).map(proto::setting::shown)
    }
}

/// The values of a schema in words, empty for any text.
fn values(schema: &Schema) -> String {
    let all =
        |list: &Value, of: fn(&Value) -> String| list.as_array().into_iter().flatten().map(of).collect::<Vec<_>>();
    if let (Value::Number(low), Value::Number(high)) = (&schema["minimum"], &schema["maximum"]) {
        return format!("{low} to {high}");
    }
    match (schema["type"].as_str(), &schema["enum"], &schema["anyOf"]) {
        (_, words @ Value::Array(_), _) => all(words, Value::to_string).join(", "),
        (_, _, forms @ Value::Array(_)) => all(forms, values).join(", or "),
        (Some("boolean"), ..) => "true, false".to_owned(),
        (Some("array"), ..) => format!("list of {}", values(&schema["items"])).trim_end_matches(" of ").to_owned(),
        (Some("object"), ..) => {
            let names = schema["properties"].as_object().into_iter().flatten();
            names.map(|(name, _)| format!("{{ {name} = … }}")).collect::<Vec<_>>().join(" or ")
        }
        _ => {
            let limits = [
                ("minimum", "at least"),
                ("exclusiveMinimum", "above"),
                ("maximum", "at most"),
                ("exclusiveMaximum", "below"),
            ];
            let given = limits.iter().filter(|(key, _)| schema[key].is_number());
            given.map(|(key, words)| format!("{words} {}", schema[key])).collect::<Vec<_>>().join(", ")
        }
    }
}

/// Puts a comment with the meaning, the values, and the default before each key and section of a configuration.
pub fn explain(text: &str) -> String {
    let keys = keys();
    let mut section = String::new();
    let mut kind = None;
    let mut explained = String::new();
    for line in text.lines() {
        let header = line.strip_prefix('[').and_then(|rest| rest.strip_suffix(']'));
        let name = match (header, line.split_once(" = ")) {
            (Some(header), _) => {
                (section, kind) = (header.to_owned(), None);
                Some(section.clone())
            }
            (None, Some((key, _))) => Some(proto::setting::key(&section, key)),
            (None, None) => None,
        };
        if let Some(value) = line.strip_prefix("kind = ") {
            kind = Some(value.trim_matches('"').to_owned());
        }
        let is_it = |key: &&Key| Some(&key.name) == name.as_ref() && (key.kind.is_none() || key.kind == kind);
        if let Some(key) = keys.iter().find(is_it) {
            let default = key.default().map(|default| format!("default {default}")).filter(|_| !key.is_section());
            let more = [Some(key.values()).filter(|text| !text.is_empty() && !key.is_section()), default];
            let more = more.into_iter().flatten().collect::<Vec<_>>().join("; ");
            let more = if more.is_empty() { ".".to_owned() } else { format!(" ({more}).") };
            explained += &format!("# {}{more}\n", key.sentence());
        }
        explained += &format!("{line}\n");
    }
    explained
}
