//! The command line of `serve`.

use std::path::PathBuf;

use clap::Args;

use super::values;

/// Arguments of `serve`.
#[derive(Debug, Args)]
pub struct ServeArgs {
    /// Folders of runs, one or several.
    #[arg(required = true, value_name = "RUN")]
    pub runs: Vec<PathBuf>,
    /// Where the page is [default: 127.0.0.1 with a free port].
    #[arg(long, value_name = "ADDRESS:PORT", value_parser = values::address)]
    pub web: Option<std::net::SocketAddr>,
    /// What a browser must know, for an address that others can reach.
    #[arg(long, value_name = "TOKEN")]
    pub token: Option<String>,
    /// Serve nothing, and write a copy of the page into this new folder, with recorded episodes, for any web server.
    #[arg(long, value_name = "DIR", conflicts_with_all = ["web", "token"])]
    pub export: Option<PathBuf>,
    /// In the copy, record this blueprint: an id, a file, or a folder of files; may be repeated [default: one of every group].
    #[arg(long, value_name = "FILE|ID", requires = "export")]
    pub blueprint: Vec<String>,
}
