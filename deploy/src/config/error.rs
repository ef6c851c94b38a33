//! Why a configuration is refused.

use std::path::PathBuf;

/// A configuration that cannot be used; the message names the culprit and what would be valid.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("cannot read the configuration {}: {source}", path.display())]
    Read {
        /// Which file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A preset that does not exist.
    #[error("there is no preset `{name}`{} The presets are {}", ended(nearest), known.join(", "))]
    Preset {
        /// The name given.
        name: String,
        /// The existing name that looks most like it.
        nearest: Option<String>,
        /// All names.
        known: Vec<&'static str>,
    },
    /// A key that does not exist.
    #[error(
        "{origin}: unknown key `{key}`{}",
        suggestion_or(nearest, "; `lodestone train --print-config` lists all keys")
    )]
    UnknownKey {
        /// File and line, variable or flag.
        origin: String,
        /// The key given.
        key: String,
        /// The existing key that looks most like it.
        nearest: Option<String>,
    },
    /// Text that is not TOML, or a value of the wrong type.
    #[error("{origin}: {message}")]
    Value {
        /// File and line, variable or flag.
        origin: String,
        /// What is wrong, with what was expected.
        message: String,
    },
    /// A value outside its range, or values that contradict each other.
    #[error("{origin}: {message}")]
    Invalid {
        /// Where the configuration comes from.
        origin: String,
        /// Field, value and valid range.
        message: String,
    },
}

/// The question after a message, or nothing.
fn suggestion(nearest: &Option<String>) -> String {
    nearest.as_ref().map(|name| format!("; did you mean `{name}`?")).unwrap_or_default()
}

/// The question after a message, or else `otherwise`.
pub(crate) fn suggestion_or(nearest: &Option<String>, otherwise: &str) -> String {
    if nearest.is_some() { suggestion(nearest) } else { otherwise.to_owned() }
}

/// The question after a message that goes on, or its end.
fn ended(nearest: &Option<String>) -> String {
    suggestion_or(nearest, ".")
}

/// The known name that is most like `name`, unless none is alike.
pub(crate) fn nearest<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> Option<String> {
    /// Below this Jaro-Winkler similarity two names have little in common.
    const ALIKE: f64 = 0.7;
    known
        .into_iter()
        .map(|candidate| (strsim::jaro_winkler(name, candidate), candidate))
        .filter(|(similarity, _)| *similarity >= ALIKE)
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, candidate)| candidate.to_owned())
}

impl ConfigError {
    /// Reads an error of the TOML reader, adding the line where `source` is the text that it came from.
    pub(super) fn from_toml(error: &toml::de::Error, source: Option<&str>, origin: &str) -> Self {
        let line = error.span().zip(source).map(|(span, text)| 1 + text[..span.start].matches('\n').count());
        let origin = line.map_or_else(|| origin.to_owned(), |line| format!("{origin}:{line}"));
        // Serde has no structured form of this error; its text puts the unknown name and the known ones into backticks.
        let message = error.message();
        if !message.starts_with("unknown field") {
            // Names of Rust's types say nothing to others.
            let message = message.trim().replace('\n', ", ").replace("expected f32", "expected a number");
            return Self::Value { origin, message: message.replace("expected f64", "expected a number") };
        }
        let mut names = message.split('`').skip(1).step_by(2);
        let key = names.next().unwrap_or_default().to_owned();
        let nearest = nearest(&key, names);
        Self::UnknownKey { origin, key, nearest }
    }
}

#[cfg(test)]
mod tests {
    use super::nearest;

    #[test]
    fn the_nearest_name_is_suggested_only_when_it_is_alike() {
        let known = ["gamma", "lambda", "clip_ratio"];
        assert_eq!(nearest("gama", known).as_deref(), Some("gamma"));
        assert_eq!(nearest("clip", known).as_deref(), Some("clip_ratio"));
        assert_eq!(nearest("xyz", known), None);
    }
}
