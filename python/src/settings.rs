//! Parses settings in JSON. An error names the key, its value, and what is allowed.

use proto::InvalidSetting;
use proto::setting::{Section, key};
use pyo3::PyResult;
use pyo3::exceptions::PyValueError;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value, json};

use crate::error::refused;

/// Numbers of which every range leaves one out.
const PROBES: [f64; 4] = [-1.0, 0.0, 255.0, 1e30];

/// Parses and checks a section; `name` is the argument that it came from.
pub(crate) fn parsed<T: DeserializeOwned + Section>(name: &str, text: &str) -> PyResult<T> {
    let config = match serde_json::from_str::<T>(text) {
        Ok(config) => config,
        Err(error) => return Err(explained::<T>(name, text).unwrap_or_else(|| refused_text(name, &error.to_string()))),
    };
    config.validate_at(name).map_err(refused)?;
    Ok(config)
}

fn refused_text(name: &str, text: &str) -> pyo3::PyErr {
    PyValueError::new_err(format!("{name}: {text}"))
}

/// Finds the entry that serde refuses. All other keys have defaults, so that it is refused alone, too.
fn explained<T: DeserializeOwned + Section>(name: &str, text: &str) -> Option<pyo3::PyErr> {
    let whole: Value = serde_json::from_str(text).ok()?;
    let (mut path, mut value): (Vec<&str>, &Value) = (Vec::new(), &whole);
    let refusal = |path: &[&str], value: &Value| serde_json::from_value::<T>(nested(path, value.clone())).err();
    while let Value::Object(entries) = value {
        let entry =
            entries.iter().find(|(field, entry)| refusal(&[&path[..], &[field.as_str()]].concat(), entry).is_some());
        let Some((field, entry)) = entry else { break };
        path.push(field);
        value = entry;
        // It is no section, whatever is in it.
        if refusal(&path, &Value::Object(Map::new())).is_some() {
            break;
        }
    }
    let error = refusal(&path, value)?.to_string();
    if error.starts_with("unknown field") {
        path.pop();
        return Some(refused_text(&dotted(name, &path), &error));
    }
    let words = || error.rsplit_once("expected ").map_or(error.as_str(), |(_, expected)| expected).to_owned();
    let expected = range::<T>(name, &path).unwrap_or_else(words);
    let error = InvalidSetting::check(dotted(name, &path), value, false, expected).err()?;
    Some(refused(error))
}

/// Returns the range of a number or a pair of numbers. Only a check states it, so this tries what may lie outside.
fn range<T: DeserializeOwned + Section>(name: &str, path: &[&str]) -> Option<String> {
    let field = dotted(name, path);
    let whole = |number: f64| if number.abs() < 1e3 { json!(number as i64) } else { json!(number) };
    let probes = PROBES.iter().flat_map(|number| [whole(*number), json!([whole(*number), whole(*number)])]);
    let outside = |probe| serde_json::from_value::<T>(nested(path, probe)).ok()?.validate_at(name).err();
    // An error reads `KEY = VALUE: expected RANGE`.
    let expected = |error: InvalidSetting| {
        let text = error.to_string();
        let (_, expected) = text.strip_prefix(&format!("{field} = "))?.split_once(": expected ")?;
        Some(expected.to_owned())
    };
    probes.filter_map(outside).find_map(expected)
}

/// Returns sections with `value` at `path` as their only entry.
fn nested(path: &[&str], value: Value) -> Value {
    path.iter().rev().fold(value, |value, field| json!({ *field: value }))
}

fn dotted(name: &str, path: &[&str]) -> String {
    path.iter().fold(name.to_owned(), |path, field| key(&path, field))
}
