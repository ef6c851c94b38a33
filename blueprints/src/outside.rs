//! Files and texts that come from outside: read up to a limit, and printed without their control characters.

use std::borrow::Cow;
use std::fs::File;
use std::io::{self, ErrorKind, Read};
use std::path::Path;

use serde::Serializer;

/// Reads a file that has at most `max_bytes` bytes. Devices and pipes that never end are given up at the limit.
///
/// # Errors
/// If the file cannot be read, in words that need no knowledge of the system's numbers, or has more bytes.
pub fn read(path: &Path, max_bytes: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let read = File::open(path).and_then(|file| file.take(max_bytes.saturating_add(1)).read_to_end(&mut bytes));
    read.map_err(|error| io::Error::new(error.kind(), reason(&error)))?;
    if bytes.len() as u64 > max_bytes {
        let reason = format!("it has more than {max_bytes} bytes, the most that are read");
        return Err(io::Error::new(ErrorKind::InvalidData, reason));
    }
    Ok(bytes)
}

/// Reads a text file that has at most `max_bytes` bytes.
///
/// # Errors
/// As for [`read`]; also if the file is not UTF-8 text.
pub fn read_text(path: &Path, max_bytes: u64) -> io::Result<String> {
    String::from_utf8(read(path, max_bytes)?)
        .map_err(|_| io::Error::new(ErrorKind::InvalidData, "it is not UTF-8 text"))
}

/// Serializes a path as text, for JSON; a path that is not text is an error of serde's own form.
///
/// # Errors
/// If the serializer returns an error.
pub fn as_text<S: Serializer>(path: &Path, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_str(&path.display())
}

/// Says why the system refused something, without the system's number for it.
pub fn reason(error: &io::Error) -> String {
    match error.kind() {
        ErrorKind::NotFound => "there is no such file or folder".to_owned(),
        _ => {
            let text = error.to_string();
            text.split_once(" (os error").map_or(text.clone(), |(words, _)| words.to_owned())
        }
    }
}

/// Shows the characters of a text that a terminal would act on as escapes such as `\u001b`: controls, and those that
/// turn the direction of writing. JSON stays the same JSON.
pub fn printable(text: &str) -> Cow<'_, str> {
    escaped(text, is_active)
}

/// Like [`printable`], for a text of several lines: line feeds and tabs stay.
pub fn printable_lines(text: &str) -> Cow<'_, str> {
    escaped(text, |c| is_active(c) && c != '\n' && c != '\t')
}

/// Like [`printable`], for a line of a log, which may have colors: its writer has already escaped ESC in what it shows.
pub fn printable_log(line: &str) -> String {
    let (text, end) = line.strip_suffix('\n').map_or((line, ""), |text| (text, "\n"));
    escaped(text, |c| is_active(c) && c != '\t' && c != '\u{1b}').into_owned() + end
}

fn is_active(c: char) -> bool {
    c.is_control()
        || matches!(c, '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

fn escaped(text: &str, is_escaped: impl Fn(char) -> bool) -> Cow<'_, str> {
    if !text.chars().any(&is_escaped) {
        return Cow::Borrowed(text);
    }
    let mut shown = String::with_capacity(text.len() + 8);
    for c in text.chars() {
        match c {
            '\n' if is_escaped(c) => shown.push_str("\\n"),
            c if is_escaped(c) => shown.push_str(&format!("\\u{:04x}", u32::from(c))),
            c => shown.push(c),
        }
    }
    Cow::Owned(shown)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_endless_file_is_refused_at_the_limit() {
        let error = read(Path::new("/dev/zero"), 1000).unwrap_err();
        assert_eq!(error.to_string(), "it has more than 1000 bytes, the most that are read");
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("text");
        std::fs::write(&file, "abc").unwrap();
        assert_eq!((read(&file, 3).unwrap().len(), read(&file, 2).is_err()), (3, true));
        std::fs::write(&file, b"a\xff").unwrap();
        assert_eq!(read_text(&file, 3).unwrap_err().to_string(), "it is not UTF-8 text");
        for (path, words) in [("gone", "there is no such file or folder"), (".", "Is a directory")] {
            assert_eq!(read(&folder.path().join(path), 3).unwrap_err().to_string(), words);
        }
    }

    #[test]
    fn what_a_terminal_would_act_on_is_shown() {
        let title = "a\u{1b}[2J\u{7}b\r\n\tc\u{9b}\u{202e}d\u{2066}é";
        assert_eq!(printable(title), "a\\u001b[2J\\u0007b\\u000d\\n\\u0009c\\u009b\\u202ed\\u2066é");
        assert_eq!(printable_lines("a\tb\n\u{1b}[1m"), "a\tb\n\\u001b[1m");
        assert_eq!(printable_log("\u{1b}[2mINFO\u{1b}[0m a\n\u{202e}b\n"), "\u{1b}[2mINFO\u{1b}[0m a\\n\\u202eb\n");
        assert!(matches!(printable("plain"), Cow::Borrowed(_)));
    }
}
