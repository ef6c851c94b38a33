//! Single owner of the terminal, so that log lines, results, and a progress bar do not overwrite each other.

use parking_lot::Mutex;
use std::ffi::OsString;
use std::io::{self, IsTerminal, Write};
use std::sync::Arc;

use blueprints::outside::{printable_lines, printable_log};
use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressStyle};
use tracing_subscriber::fmt::MakeWriter;

use crate::exit::Failure;

/// Maximum number of bytes of log lines held back.
const MAX_HELD: usize = 1 << 16;

/// The terminal, or the streams that replace it; clones share it.
#[derive(Clone, Debug)]
pub struct Terminal {
    /// The progress bars below the lines.
    drawn: MultiProgress,
    /// The bars that are not finished; locked by whoever writes lines or changes a bar.
    bars: Arc<Mutex<Vec<ProgressBar>>>,
    held: Arc<Mutex<Option<Held>>>,
    prints_to_stderr: bool,
    /// The first reason why something is missing from stdout.
    unwritten: Arc<Mutex<Option<io::Error>>>,
}

/// Log lines that wait until the screen is free.
#[derive(Debug, Default)]
struct Held {
    lines: Vec<u8>,
    n_left_out: u64,
}

/// Guard that holds log lines back until it is dropped.
#[derive(Debug)]
pub struct HeldLog(Option<Terminal>);

/// A progress bar, drawn only on a terminal.
#[derive(Debug)]
pub(super) struct Progress {
    bar: ProgressBar,
    terminal: Terminal,
}

/// Writes log lines to stderr, above the bar. It never fails: if stderr is closed, lines are lost. Otherwise the logger
/// would print the error to stderr and panic in the thread that logs.
#[derive(Debug)]
pub struct LogWriter(Terminal);

impl Default for Terminal {
    fn default() -> Self {
        // A bar makes sense only if both results and bar are visible, and the terminal can move its cursor.
        let is_terminal =
            io::stdout().is_terminal() && io::stderr().is_terminal() && !is_dumb(&std::env::var_os("TERM"));
        let target = if is_terminal { ProgressDrawTarget::stderr() } else { ProgressDrawTarget::hidden() };
        Self::with_bars_on(target)
    }
}

/// A row of at most `width` characters; a longer one ends in an ellipsis.
fn cut(row: &str, width: usize) -> String {
    let end = row.char_indices().nth(width).and_then(|_| row.char_indices().nth(width.saturating_sub(1)));
    end.map_or_else(|| row.to_owned(), |(end, _)| format!("{}…", &row[..end]))
}

/// Whether a terminal of this type, the value of `TERM`, knows no control sequences.
fn is_dumb(term: &Option<OsString>) -> bool {
    term.as_ref().is_some_and(|term| term == "dumb")
}

/// Whether log lines on a terminal have colors: not if `NO_COLOR` is set to anything, or on a terminal without control
/// sequences.
pub(crate) fn has_colors(variable: impl Fn(&str) -> Option<OsString>) -> bool {
    variable("NO_COLOR").is_none_or(|value| value.is_empty()) && !is_dumb(&variable("TERM"))
}

impl Terminal {
    fn with_bars_on(target: ProgressDrawTarget) -> Self {
        let drawn = MultiProgress::with_draw_target(target);
        let (bars, held, unwritten) = Default::default();
        Self { drawn, bars, held, prints_to_stderr: false, unwritten }
    }

    /// Writes lines above the bars. A terminal that is gone, for example because its window was closed, hides the bars.
    ///
    /// `MultiProgress::suspend` would panic when the terminal is gone, and again in each later thread that logs.
    fn write_above<T>(&self, write: impl FnOnce() -> io::Result<T>) -> io::Result<T> {
        let bars = self.bars.lock();
        if self.drawn.clear().is_err() {
            self.drawn.set_draw_target(ProgressDrawTarget::hidden());
        }
        let written = write();
        bars.iter().for_each(ProgressBar::force_draw);
        written
    }

    /// The same terminal, for messages to people while stdout carries data for a program.
    pub fn on_stderr(&self) -> Self {
        Self { prints_to_stderr: true, ..self.clone() }
    }

    /// Prints lines to stdout, or to stderr after [`Self::on_stderr`], with their control characters escaped. A failure
    /// does not end a run; [`Self::check_written`] returns it.
    pub fn print(&self, text: &str) {
        let text = printable_lines(text.trim_end());
        let written = self.write_above(|| match self.prints_to_stderr {
            false => writeln!(io::stdout(), "{text}"),
            true => writeln!(io::stderr(), "{text}"),
        });
        if let Err(error) = written {
            tracing::debug!(%error, "nobody reads what is printed");
            if !self.prints_to_stderr {
                self.unwritten.lock().get_or_insert(error);
            }
        }
    }

    /// Prints the rows of a table, each cut at the width of the terminal, if stdout is one: a row that goes on in the
    /// next line hides the columns.
    pub fn print_rows(&self, rows: &[String]) {
        let size = rustix::termios::tcgetwinsize(io::stdout()).ok();
        let width = size.map(|size| usize::from(size.ws_col)).filter(|width| *width > 0);
        let rows: Vec<String> = rows.iter().map(|row| cut(row, width.unwrap_or(usize::MAX))).collect();
        self.print(&rows.join("\n"));
    }

    /// Checks that all lines so far have been written to stdout, as a command whose result they are must do before it
    /// ends.
    ///
    /// # Errors
    /// The first failure since the last call, unless the reader of a pipe went away: it has read what it wanted.
    pub fn check_written(&self) -> Result<(), Failure> {
        match self.unwritten.lock().take() {
            Some(error) if error.kind() != io::ErrorKind::BrokenPipe => Err(Failure::Output(error)),
            _ => Ok(()),
        }
    }

    /// Holds log lines back from now on if they would go to a terminal, where they would disturb what is drawn.
    pub fn hold_log(&self) -> HeldLog {
        if !io::stderr().is_terminal() {
            return HeldLog(None);
        }
        *self.held.lock() = Some(Held::default());
        HeldLog(Some(self.clone()))
    }

    /// A progress bar with a total of `n` of `what`.
    pub(super) fn progress(&self, n: u64, what: &str) -> Progress {
        let style = ProgressStyle::with_template(&format!(
            "{{bar:24}} {{human_pos}}/{{human_len}} {what}, {{elapsed}}\n{{msg}}"
        ))
        .unwrap_or_else(|_| ProgressStyle::default_bar());
        let mut bars = self.bars.lock();
        let bar = self.drawn.add(ProgressBar::new(n).with_style(style));
        bars.push(bar.clone());
        Progress { bar, terminal: self.clone() }
    }
}

impl Progress {
    pub(super) fn is_drawn(&self) -> bool {
        !self.bar.is_hidden()
    }

    pub(super) fn set(&self, n: u64, message: &str) {
        let _bars = self.terminal.bars.lock();
        // What goes on beyond its end has no longer that end: an update takes whole segments.
        if self.bar.length().is_some_and(|planned| n > planned) {
            self.bar.set_length(n);
        }
        self.bar.set_position(n);
        self.bar.set_message(message.to_owned());
    }

    pub(super) fn finish(&self) {
        let mut bars = self.terminal.bars.lock();
        self.bar.finish_and_clear();
        bars.retain(|bar| !bar.is_finished());
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.finish();
    }
}

impl Drop for HeldLog {
    fn drop(&mut self) {
        let Some(terminal) = &self.0 else { return };
        let held = terminal.held.lock().take().unwrap_or_default();
        let mut stderr = io::stderr();
        let left_out = match held.n_left_out {
            0 => Ok(()),
            n => writeln!(stderr, "{n} more log lines were left out"),
        };
        if let Err(error) = stderr.write_all(&held.lines).and(left_out) {
            tracing::debug!(%error, "stderr is closed");
        }
    }
}

impl<'a> MakeWriter<'a> for Terminal {
    type Writer = LogWriter;

    fn make_writer(&'a self) -> LogWriter {
        LogWriter(self.clone())
    }
}

impl Write for LogWriter {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        // The logger writes each event at once.
        let n_bytes = bytes.len();
        let line = printable_log(&String::from_utf8_lossy(bytes));
        let bytes = line.as_bytes();
        if let Some(held) = self.0.held.lock().as_mut() {
            if held.lines.len() + bytes.len() <= MAX_HELD {
                held.lines.extend_from_slice(bytes);
            } else {
                held.n_left_out += 1;
            }
            return Ok(n_bytes);
        }
        // Its errors are dropped.
        let _ = self.0.write_above(|| io::stderr().write_all(bytes));
        Ok(n_bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        io::stderr().flush().unwrap_or_default();
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use indicatif::TermLike;

    use super::*;

    /// Methods that find nobody at the other end.
    macro_rules! fails {
        ($($name:ident($($argument:ty)?))*) => {
            $(fn $name(&self $(, _: $argument)?) -> io::Result<()> {
                Err(io::ErrorKind::BrokenPipe.into())
            })*
        };
    }

    /// A terminal whose window has been closed.
    #[derive(Debug)]
    struct Gone;

    impl TermLike for Gone {
        fn width(&self) -> u16 {
            80
        }

        fails!(move_cursor_up(usize) move_cursor_down(usize) move_cursor_right(usize) move_cursor_left(usize));
        fails!(write_line(&str) write_str(&str) clear_line() flush());
    }

    #[test]
    fn a_row_is_cut_only_if_it_is_too_long() {
        for (width, expected) in [(1, "…"), (4, "6 ×…"), (5, "6 × 3"), (9, "6 × 3")] {
            assert_eq!(cut("6 × 3", width), expected);
        }
    }

    #[test]
    fn colors_are_left_out_on_request_and_where_no_terminal_shows_them() {
        let has_colors = |no_color: Option<&str>, term: &str| {
            super::has_colors(|name| match name {
                "NO_COLOR" => no_color.map(Into::into),
                "TERM" => Some(term.into()),
                _ => None,
            })
        };
        assert!(has_colors(None, "xterm-256color"));
        assert!(has_colors(Some(""), "xterm"), "an empty value asks for nothing");
        assert!(!has_colors(Some("1"), "xterm"));
        assert!(!has_colors(Some("0"), "xterm"), "any value counts");
        assert!(!has_colors(None, "dumb"));
    }

    #[test]
    fn a_bar_never_says_more_than_all() {
        let progress = Terminal::with_bars_on(ProgressDrawTarget::hidden()).progress(2500, "steps");
        progress.set(1300, "");
        assert_eq!((progress.bar.position(), progress.bar.length()), (1300, Some(2500)));
        progress.set(2512, "");
        assert_eq!((progress.bar.position(), progress.bar.length()), (2512, Some(2512)));
    }

    #[test]
    fn a_terminal_that_is_gone_hides_the_bar_and_ends_no_thread() {
        let terminal = Terminal::with_bars_on(ProgressDrawTarget::term_like(Box::new(Gone))).on_stderr();
        let progress = terminal.progress(10, "episodes");
        progress.set(1, "one");
        assert!(progress.is_drawn());

        terminal.print("the first line finds out");
        assert!(!progress.is_drawn());
        let mut log = terminal.make_writer();
        let lines = b"a thread logs\n";
        let written = std::thread::spawn(move || log.write(lines)).join();
        assert!(matches!(written, Ok(Ok(14))), "{written:?}");
        progress.set(2, "two");
        progress.finish();
    }
}
