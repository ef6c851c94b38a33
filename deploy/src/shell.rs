//! Quotes paths and names in printed commands, so that a shell reads them as they are.

use std::ffi::OsStr;
use std::fmt::Write;
use std::path::Path;

/// Quotes a word for a shell, if it needs that. A word that is not text, or has controls, needs a shell that knows
/// `$'…'`, as all common ones do.
pub(crate) fn quoted(word: impl AsRef<OsStr>) -> String {
    let bytes = word.as_ref().as_encoded_bytes();
    let is_plain = |c: &u8| c.is_ascii_alphanumeric() || b"/._-+,:@%=".contains(c);
    match word.as_ref().to_str() {
        Some(text) if !bytes.is_empty() && bytes.iter().all(is_plain) => text.to_owned(),
        Some(text) if blueprints::outside::printable(text) == text => format!("'{}'", text.replace('\'', r"'\''")),
        _ => {
            let mut quoted = "$'".to_owned();
            for &byte in bytes {
                match byte {
                    b'\'' | b'\\' => quoted.extend(['\\', char::from(byte)]),
                    b' '..=b'~' => quoted.push(char::from(byte)),
                    // Three digits, because a fourth one would belong to the next character.
                    _ => write!(quoted, "\\{byte:03o}").expect("a string takes all"),
                }
            }
            quoted + "'"
        }
    }
}

/// Quotes a path as an argument of a command, which must not look like a flag.
pub(crate) fn path(path: &Path) -> String {
    if path.as_os_str().as_encoded_bytes().starts_with(b"-") { quoted(Path::new(".").join(path)) } else { quoted(path) }
}

/// The program as it was invoked.
pub(crate) fn program() -> String {
    std::env::args_os().next().map_or_else(|| "lodestone".to_owned(), quoted)
}

/// A command of this program, of words that are already quoted.
pub(crate) fn command(name: &str, words: impl IntoIterator<Item = String>) -> String {
    [program(), name.to_owned()].into_iter().chain(words).collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use std::os::unix::ffi::OsStrExt;
    use std::process::Command;

    use super::*;

    #[test]
    fn a_shell_reads_back_every_byte() {
        let words = [
            &b"runs/2026-01-31T0805-a"[..],
            b"",
            b"my run",
            b"it's \"$HOME\" `x` \\ !",
            b"a\n1\x1b[2J\xff9",
            "é\u{202e}".as_bytes(),
        ];
        for bytes in words {
            let quoted = quoted(OsStr::from_bytes(bytes));
            let printed = Command::new("bash").args(["-c", &format!("printf %s {quoted}")]).output().unwrap().stdout;
            assert_eq!(printed, bytes, "{quoted}");
            assert_eq!(blueprints::outside::printable(&quoted), quoted, "it is printed as it is");
        }
        assert_eq!(quoted("runs/a_b-1"), "runs/a_b-1");
        assert_eq!(path(Path::new("-x y")), "'./-x y'");
        assert_eq!(path(Path::new(OsStr::from_bytes(b"a\xe9"))), "$'a\\351'");
    }
}
