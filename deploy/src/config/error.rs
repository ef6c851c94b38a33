//! Errors of configurations.

use std::fmt::Display;

use proto::InvalidSetting;

/// A configuration that cannot be used. The message names what is wrong and what would be valid.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// A file that cannot be read, text that is not TOML, an unknown name, or a value of the wrong type.
    #[error("{0}")]
    Text(String),
    /// A value outside its range, or values that contradict each other.
    #[error("configuration: {0}")]
    Invalid(#[from] InvalidSetting),
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
    /// An error at `origin`: a file and its line, a variable, or a flag.
    pub(crate) fn at(origin: impl Display, message: impl Display) -> Self {
        Self::Text(format!("{origin}: {message}"))
    }

    /// Converts an error of the TOML parser; adds the line if `source` is the text that it came from.
    pub(crate) fn from_toml(error: &toml::de::Error, source: Option<&str>, origin: &str) -> Self {
        let line = error.span().zip(source).map(|(span, text)| 1 + text[..span.start].matches('\n').count());
        let origin = line.map_or_else(|| origin.to_owned(), |line| format!("{origin}:{line}"));
        // Serde has no structured form of this error. Its text quotes the unknown name and the known names in
        // backticks.
        let message = error.message();
        if !message.starts_with("unknown field") {
            // Users do not know the names of Rust's types.
            let message = message.trim().replace('\n', ", ").replace("expected f32", "expected a number");
            return Self::at(origin, message.replace("expected f64", "expected a number"));
        }
        let mut names = message.split('`').skip(1).step_by(2);
        let key = names.next().unwrap_or_default();
        let suggestion =
            suggestion_or(&nearest(key, names), "; `lodestone train --print-config --schema` lists all keys");
        Self::at(origin, format_args!("unknown key `{key}`{suggestion}"))
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
