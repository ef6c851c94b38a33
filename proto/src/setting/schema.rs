//! The JSON Schema of settings: for editors, and for the page that lists all settings.
//!
//! [`settings!`](crate::settings) writes it from the lines that it checks values with.

use std::ops::{Bound, RangeBounds};

use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value, json};

use super::range::Setting;

/// A JSON Schema.
pub type Schema = Value;

/// Returns the schema of a section with these fields, documented by these lines.
pub fn section<const N: usize>(lines: &[&str], fields: [(&str, Schema); N]) -> Schema {
    described(closed(fields.map(|(name, schema)| (name.to_owned(), schema)).into_iter().collect()), lines)
}

/// Returns the schema of a choice by `kind`, with the name, section, and documentation of each variant.
pub fn choice<const N: usize>(lines: &[&str], default: &str, variants: [(&str, Schema, &[&str]); N]) -> Schema {
    let sections = variants.map(|(name, mut section, lines)| {
        section["properties"]["kind"] = json!({"const": kebab(name)});
        section["required"] = json!(["kind"]);
        described(section, lines)
    });
    described(json!({"oneOf": sections.to_vec(), "default": {"kind": kebab(default)}}), lines)
}

/// Returns the schema of a single value with this default; `rule` is what is expected of it beyond its range.
pub fn value<T: DeserializeOwned + Serialize>(lines: &[&str], default: &T, rule: Option<&str>) -> Schema {
    let mut schema = described(of::<T>(), lines);
    schema["default"] = json_of(default).unwrap_or_default();
    if let Some(rule) = rule {
        schema["$comment"] = rule.into();
    }
    schema
}

/// Returns the JSON form of a value, by way of text, so that an f32 such as 0.1 does not become 0.10000000149011612.
pub(crate) fn json_of(value: &impl Serialize) -> serde_json::Result<Value> {
    serde_json::from_str(&serde_json::to_string(value)?)
}

/// Limits the numbers in `schema` to a range.
pub fn within<T: Setting>(mut schema: Schema, range: &impl RangeBounds<T::Number>) -> Schema {
    let numbers = if schema["items"].is_object() { &mut schema["items"] } else { &mut schema };
    let mut limit =
        |key: &str, number: &T::Number| numbers[key] = serde_json::from_str(&number.to_string()).unwrap_or_default();
    match range.start_bound() {
        Bound::Included(low) => limit("minimum", low),
        Bound::Excluded(low) => limit("exclusiveMinimum", low),
        Bound::Unbounded => {}
    }
    match range.end_bound() {
        Bound::Included(high) => limit("maximum", high),
        Bound::Excluded(high) => limit("exclusiveMaximum", high),
        Bound::Unbounded => {}
    }
    schema
}

/// Documents a schema with the lines of a comment, unless all are empty.
pub fn described(mut schema: Schema, lines: &[&str]) -> Schema {
    let lines: Vec<&str> = lines.iter().map(|line| line.trim()).filter(|line| !line.is_empty()).collect();
    if !lines.is_empty() {
        // Links are for readers of the source.
        let text = lines.join(" ").replace("[`Self::", "`").replace("[`", "`").replace("`]", "`");
        schema["description"] = text.into();
    }
    schema
}

/// Returns the schema of what `T` reads, by what it says that it expects.
pub fn of<T: DeserializeOwned>() -> Schema {
    expected(&|json| serde_json::from_str::<T>(json).err().map(|error| error.to_string()))
}

/// Returns the schema of a type that answers JSON with an error, or with `None`. Serde has no structured form of its
/// errors: they quote known names in backticks, and end with what is expected.
fn expected(answer: &dyn Fn(&str) -> Option<String>) -> Schema {
    let [to_text, to_table] = [r#""?""#, r#"{"?": 0}"#].map(|json| answer(json).unwrap_or_default());
    let names = |message: &str| message.split('`').skip(3).step_by(2).map(str::to_owned).collect::<Vec<_>>();
    if to_text.starts_with("unknown variant") {
        let is_word = |name: &String| answer(&json!(name).to_string()).is_none();
        let (words, tables): (Vec<_>, Vec<_>) = names(&to_text).into_iter().partition(is_word);
        let mut table = closed(tables.iter().map(|name| (name.clone(), json!({}))).collect());
        (table["minProperties"], table["maxProperties"]) = (1.into(), 1.into());
        return match (words.is_empty(), tables.is_empty()) {
            (_, true) => json!({"enum": words}),
            (true, _) => table,
            _ => json!({"anyOf": [{"enum": words}, table]}),
        };
    }
    if to_table.starts_with("unknown field") {
        return closed(names(&to_table).into_iter().map(|name| (name, json!({}))).collect());
    }
    let wanted = to_table.split("expected ").nth(1).and_then(|rest| rest.split(" at line").next());
    match wanted.unwrap_or_default() {
        "a boolean" => json!({"type": "boolean"}),
        "f32" | "f64" => json!({"type": "number"}),
        "u8" | "u16" | "u32" | "u64" | "usize" => json!({"type": "integer", "minimum": 0}),
        text if text == "a sequence" || text.starts_with("an array") => {
            json!({"type": "array", "items": expected(&|json| answer(&format!("[{json}]")))})
        }
        text if text.contains("string") || text == "socket address" => json!({"type": "string"}),
        _ => json!({}),
    }
}

/// An object with these properties alone.
fn closed(properties: Map<String, Value>) -> Schema {
    json!({"type": "object", "properties": properties, "additionalProperties": false})
}

/// The name of a variant as serde writes it in kebab-case.
fn kebab(name: &str) -> String {
    let dash = |(at, c): (usize, char)| (at > 0 && c.is_uppercase()).then_some('-').into_iter().chain(c.to_lowercase());
    name.char_indices().flat_map(dash).collect()
}
