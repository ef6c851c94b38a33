//! A hash for checking that two processes have the same configuration.

use blueprints::hash::fnv1a;
use serde::Serialize;
use serde_json::Value;

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
pub(crate) fn canonical(value: &Value) -> String {
    let mut text = String::new();
    write(value, &mut text);
    text
}

fn write(value: &Value, text: &mut String) {
    match value {
        Value::Object(map) => {
            let mut entries: Vec<_> = map.iter().filter(|(_, value)| !value.is_null()).collect();
            entries.sort_by_key(|(key, _)| *key);
            text.push('{');
            for (i, (key, value)) in entries.into_iter().enumerate() {
                text.push_str(if i == 0 { "" } else { "," });
                write(&Value::String(key.clone()), text);
                text.push(':');
                write(value, text);
            }
            text.push('}');
        }
        Value::Array(values) => {
            text.push('[');
            for (i, value) in values.iter().enumerate() {
                text.push_str(if i == 0 { "" } else { "," });
                write(value, text);
            }
            text.push(']');
        }
        // Numbers are written with the fewest digits that are exact.
        leaf => text.push_str(&leaf.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn canonical_form_is_sorted_and_omits_nulls() {
        let text = canonical(&json!({ "b": [1, 0.5, null, "x\"y"], "a": { "d": true, "c": null } }));
        assert_eq!(text, r#"{"a":{"d":true},"b":[1,0.5,null,"x\"y"]}"#);
        assert_eq!(config_hash(&json!({ "b": 1, "a": 2 })), config_hash(&json!({ "a": 2, "b": 1, "c": null })));
        assert_ne!(config_hash(&json!({ "a": 1 })), config_hash(&json!({ "a": "1" })));
    }
}
