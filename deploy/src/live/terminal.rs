//! One owner of the terminal, so that log lines, results and a progress bar do not overwrite each other.

use std::io::{self, IsTerminal, Write};

use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressStyle};
use tracing_subscriber::fmt::MakeWriter;

/// The terminal or whatever stands in its place; clones share it.
#[derive(Clone, Debug)]
pub struct Terminal {
    bars: MultiProgress,
}

/// A progress bar, drawn only on a terminal.
#[derive(Debug)]
pub(super) struct Progress {
    bar: ProgressBar,
}

/// Writes log lines to stderr, above the bar.
#[derive(Debug)]
pub struct LogWriter(MultiProgress);

impl Default for Terminal {
    fn default() -> Self {
        // Results and bar must both be seen for a bar to make sense.
        let is_terminal = io::stdout().is_terminal() && io::stderr().is_terminal();
        let target = if is_terminal { ProgressDrawTarget::stderr() } else { ProgressDrawTarget::hidden() };
        Self { bars: MultiProgress::with_draw_target(target) }
    }
}

impl Terminal {
    /// Prints lines to stdout; a closed pipe is no reason to end a run.
    pub fn print(&self, text: &str) {
        let written = self.bars.suspend(|| writeln!(io::stdout(), "{}", text.trim_end()));
        if let Err(error) = written {
            tracing::debug!(%error, "stdout is closed");
        }
    }

    /// A bar that is full at `n_env_steps`.
    pub(super) fn progress(&self, n_env_steps: u64) -> Progress {
        let style = ProgressStyle::with_template("{bar:24} {human_pos}/{human_len} steps, {elapsed}\n{msg}")
            .unwrap_or_else(|_| ProgressStyle::default_bar());
        Progress { bar: self.bars.add(ProgressBar::new(n_env_steps).with_style(style)) }
    }
}

impl Progress {
    pub(super) fn is_drawn(&self) -> bool {
        !self.bar.is_hidden()
    }

    pub(super) fn set(&self, n_env_steps: u64, message: &str) {
        self.bar.set_position(n_env_steps);
        self.bar.set_message(message.to_owned());
    }

    pub(super) fn finish(&self) {
        self.bar.finish_and_clear();
    }
}

impl<'a> MakeWriter<'a> for Terminal {
    type Writer = LogWriter;

    fn make_writer(&'a self) -> LogWriter {
        LogWriter(self.bars.clone())
    }
}

impl Write for LogWriter {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.suspend(|| io::stderr().write(bytes))
    }

    fn flush(&mut self) -> io::Result<()> {
        io::stderr().flush()
    }
}
