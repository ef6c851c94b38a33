//! Logs: always on stderr, so that stdout holds results only.

use std::io::IsTerminal;

use tracing_subscriber::EnvFilter;

use crate::live::Terminal;

/// How log lines look.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum LogFormat {
    /// `pretty` on a terminal, plain lines elsewhere.
    #[default]
    Auto,
    /// Colored lines.
    Pretty,
    /// One JSON object a line.
    Json,
}

/// zenoh logs each lost connection at several levels; its own errors are enough. That an answer came when nobody waited for it
/// any more, as when a process ends, is an error to its handlers and none to us.
const DEFAULT_FILTER: &str = "info,zenoh=error,zenoh::api::handlers=off";

/// Installs the logger; `RUST_LOG` overrides what is logged.
///
/// A second call in one process changes nothing.
pub fn init(format: LogFormat, terminal: &Terminal) {
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(DEFAULT_FILTER));
    let lines = tracing_subscriber::fmt().with_env_filter(filter).with_writer(terminal.clone()).with_target(false);
    let installed = match format {
        LogFormat::Auto => lines.with_ansi(std::io::stderr().is_terminal()).compact().try_init(),
        LogFormat::Pretty => lines.with_ansi(true).compact().try_init(),
        LogFormat::Json => lines.with_ansi(false).json().try_init(),
    };
    if let Err(error) = installed {
        tracing::debug!(%error, "the logger was there already");
    }
}
