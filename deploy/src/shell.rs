//! Quotes paths in printed commands, so that a shell reads them as they are.

use std::path::Path;

/// Quotes a word for a shell, if it needs that.
pub(crate) fn quoted(word: &str) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "/._-+,:@%=".contains(c);
    if !word.is_empty() && word.chars().all(is_plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', r"'\''"))
    }
}

/// Quotes a path as an argument of a command, which must not look like a flag.
pub(crate) fn path(path: &Path) -> String {
    let text = path.to_string_lossy();
    if text.starts_with('-') { quoted(&format!("./{text}")) } else { quoted(&text) }
}

/// The program as it was invoked.
pub(crate) fn program() -> String {
    std::env::args_os().next().map_or_else(|| "lodestone".to_owned(), |name| quoted(&name.to_string_lossy()))
}

#[cfg(test)]
mod tests {
    use std::process::Command;

    use super::*;

    #[test]
    fn a_shell_reads_back_what_was_quoted() {
        for word in ["runs/2026-01-31T0805-a", "", "my run", "it's \"$HOME\" `x` \\ !", "é\n1"] {
            let printed = Command::new("sh").args(["-c", &format!("printf %s {}", quoted(word))]).output().unwrap();
            assert_eq!(printed.stdout, word.as_bytes(), "{}", quoted(word));
        }
        assert_eq!((quoted("runs/a_b-1"), path(Path::new("-x y"))), ("runs/a_b-1".to_owned(), "'./-x y'".to_owned()));
    }
}
