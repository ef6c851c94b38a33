//! Arguments of `serve`.

use std::ffi::OsString;
use std::path::PathBuf;

use clap::Args;

use super::values;

/// Arguments of `serve`.
#[derive(Debug, Args)]
pub struct ServeArgs {
    /// Folders of one or more runs, or of a sweep.
    #[arg(required = true, value_name = "RUN")]
    pub(crate) runs: Vec<PathBuf>,
    /// Address of the web page [default: 127.0.0.1 with a free port].
    #[arg(long, value_name = "ADDRESS:PORT", value_parser = values::address)]
    pub(crate) web: Option<std::net::SocketAddr>,
    /// Token that browsers must present; required for an address that other machines can reach.
    #[arg(long, value_name = "TOKEN")]
    pub(crate) token: Option<String>,
    /// Instead of serving, write a static copy of the page, with recorded episodes, to this new folder, for any web
    /// server.
    #[arg(long, value_name = "DIR", conflicts_with_all = ["web", "token"])]
    pub(crate) export: Option<PathBuf>,
    /// Record this blueprint in the copy: an id, a file, or a folder of files; may be repeated [default: one of each
    /// group].
    #[arg(long, value_name = "FILE|ID", requires = "export")]
    pub(crate) blueprint: Vec<OsString>,
}
