//! Errors of configurations.

use std::path::PathBuf;

use proto::InvalidSetting;

/// A configuration that cannot be used. The message names what is wrong and what would be valid.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("cannot read the configuration {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// An unknown preset.
    #[error("there is no preset {0}")]
    Preset(String),
    /// Text that is not TOML, an unknown key or variable, or a value of the wrong type.
    #[error("{origin}: {message}")]
    Value {
        /// File and line, variable, or flag.
        origin: String,
        /// What is wrong and what was expected.
        message: String,
    },
    /// A value outside its range, or values that contradict each other.
    #[error("{origin}: {message}")]
    Invalid {
        /// Where the configuration comes from.
        origin: String,
        /// The field, its value, and the valid range.
        message: String,
    },
}

impl From<InvalidSetting> for ConfigError {
    fn from(error: InvalidSetting) -> Self {
        Self::Invalid { origin: "configuration".to_owned(), message: error.to_string() }
    }
}

/// The suggestion appended to a message, or else `otherwise`.
pub(crate) fn suggestion_or(nearest: &Option<String>, otherwise: &str) -> String {
    nearest.as_ref().map_or_else(|| otherwise.to_owned(), |name| format!("; did you mean `{name}`?"))
}

/// The known name most similar to `name`, if any is similar enough.
pub(crate) fn nearest<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> Option<String> {
    /// Names with a lower Jaro-Winkler similarity have little in common.
    const ALIKE: f64 = 0.7;
    known
        .into_iter()
        .map(|candidate| (strsim::jaro_winkler(name, candidate), candidate))
        .filter(|(similarity, _)| *similarity >= ALIKE)
        // Of equals, the first.
        .min_by(|a, b| b.0.total_cmp(&a.0))
        .map(|(_, candidate)| candidate.to_owned())
}

impl ConfigError {
    /// Converts an error of the TOML parser; adds the line if `source` is the text that it came from.
    pub(super) fn from_toml(error: &toml::de::Error, source: Option<&str>, origin: &str) -> Self {
        let line = error.span().zip(source).map(|(span, text)| 1 + text[..span.start].matches('\n').count());
        let origin = line.map_or_else(|| origin.to_owned(), |line| format!("{origin}:{line}"));
        // Serde has no structured form of this error. Its text quotes the unknown name and the known names in
        // backticks.
        let message = error.message();
        if !message.starts_with("unknown field") {
            // Users do not know the names of Rust's types.
            let message = message.trim().replace('\n', ", ").replace("expected f32", "expected a number");
            return Self::Value { origin, message: message.replace("expected f64", "expected a number") };
        }
        let mut names = message.split('`').skip(1).step_by(2);
        let key = names.next().unwrap_or_default();
        let suggestion =
            suggestion_or(&nearest(key, names), "; `lodestone train --print-config --schema` lists all keys");
        Self::Value { origin, message: format!("unknown key `{key}`{suggestion}") }
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
