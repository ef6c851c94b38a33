//! Logs: always on stderr, so that stdout holds results only.

use std::io::IsTerminal;

use tracing_subscriber::EnvFilter;

use crate::live::{Terminal, has_colors};

/// Format of log lines.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum LogFormat {
    /// Like `pretty` on a terminal, unless NO_COLOR is set or TERM is dumb; plain lines elsewhere.
    #[default]
    Auto,
    /// Colored lines.
    Pretty,
    /// One JSON object per line.
    Json,
}

/// zenoh logs each lost connection at several levels, of which errors are enough. Its handlers also log an error for
/// each reply that arrives after its receiver is gone, and its routing for each message of a process that ends; both are
/// harmless here.
const DEFAULT_FILTER: &str = "info,zenoh=error,zenoh::api::handlers=off,zenoh::net::routing=off";

/// Installs the logger; `RUST_LOG` overrides the default filter.
///
/// Further calls in one process do nothing.
pub fn init(format: LogFormat, terminal: &Terminal) {
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(DEFAULT_FILTER));
    let lines = tracing_subscriber::fmt().with_env_filter(filter).with_writer(terminal.clone()).with_target(false);
    let installed = match format {
        LogFormat::Auto => {
            let has_colors = std::io::stderr().is_terminal() && has_colors(|name| std::env::var_os(name));
            lines.with_ansi(has_colors).compact().try_init()
        }
        LogFormat::Pretty => lines.with_ansi(true).compact().try_init(),
        LogFormat::Json => lines.with_ansi(false).json().try_init(),
    };
    if let Err(error) = installed {
        tracing::debug!(%error, "the logger was there already");
    }
}
