//! Arguments of processes that join a bus: endpoints, keys, health.

use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};

use super::values::{self, endpoint};
use crate::config::Override;

/// Endpoints of a process that joins a run.
#[derive(Clone, Debug, Default, Args)]
pub struct EndpointArgs {
    /// Endpoint of the router, for example tcp/127.0.0.1:7447, quic/HOST:7447, tls/HOST:7447, or
    /// unixsock-stream//tmp/bus.sock; may be repeated.
    #[arg(long, value_name = "ENDPOINT", env = "LODESTONE_CONNECT", value_delimiter = ',', value_parser = endpoint)]
    pub(crate) connect: Vec<String>,
    /// Act as a router too, and listen here; may be repeated. An address that other machines can reach needs --keys.
    #[arg(long, value_name = "ENDPOINT", env = "LODESTONE_LISTEN", value_delimiter = ',', value_parser = endpoint)]
    pub(crate) listen: Vec<String>,
    #[command(flatten)]
    pub(crate) keys: KeysArgs,
}

/// The keys that a process authenticates with.
#[derive(Clone, Debug, Default, Args)]
pub struct KeysArgs {
    /// Folder of keys made by `lodestone keys new`: the whole folder, or that of this process's role (`watch` has the
    /// role viewer).
    #[arg(long, value_name = "DIR", env = "LODESTONE_KEYS", value_parser = values::text_path())]
    pub(crate) keys: Option<PathBuf>,
}

/// Arguments of `router`.
#[derive(Debug, Args)]
pub struct RouterArgs {
    /// Endpoint to listen on, for example tcp/127.0.0.1:7447, or, with --keys, quic/0.0.0.0:7447 (UDP) or
    /// tls/0.0.0.0:7447 (TCP); may be repeated.
    #[arg(long, value_name = "ENDPOINT", required = true, env = "LODESTONE_LISTEN", value_delimiter = ',', value_parser = endpoint)]
    pub(crate) listen: Vec<String>,
    /// Endpoint of another router to connect to; may be repeated.
    #[arg(long, value_name = "ENDPOINT", env = "LODESTONE_CONNECT", value_delimiter = ',', value_parser = endpoint)]
    pub(crate) connect: Vec<String>,
    #[command(flatten)]
    pub(crate) keys: KeysArgs,
    #[command(flatten)]
    pub(crate) health: HealthArgs,
}

/// Where a service reports its health.
#[derive(Clone, Debug, Default, Args)]
pub struct HealthArgs {
    /// Write this process's state to this file every 2 s, for `lodestone healthcheck`.
    #[arg(long, value_name = "FILE", env = "LODESTONE_HEALTH_FILE")]
    pub(crate) health_file: Option<PathBuf>,
}

/// Subcommands of `keys`.
#[derive(Debug, Subcommand)]
pub enum KeysCommand {
    /// Create a certificate authority, and a certificate and password for each role.
    New {
        /// Folder for the keys.
        #[arg(value_name = "DIR")]
        dir: PathBuf,
        /// The router's certificate.
        #[command(flatten)]
        certificate: CertificateArgs,
        /// Do nothing if the folder already holds keys.
        #[arg(long)]
        keep: bool,
    },
    /// Issue a new certificate for the router, for other hosts or a later expiry. All other keys stay valid.
    Router {
        /// Folder made by `keys new`, with the authority in it.
        #[arg(value_name = "DIR")]
        dir: PathBuf,
        /// The new certificate.
        #[command(flatten)]
        certificate: CertificateArgs,
    },
}

/// Hosts and lifetime of the router's certificate.
#[derive(Clone, Debug, Args)]
pub struct CertificateArgs {
    /// Name or address at which processes reach the router; may be repeated. localhost, 127.0.0.1, and ::1 are always
    /// included.
    #[arg(long, value_name = "HOST", value_delimiter = ',')]
    pub(crate) host: Vec<String>,
    /// Days until expiry.
    #[arg(long, value_name = "N", default_value_t = 365, value_parser = clap::value_parser!(u32).range(1..=3650))]
    pub(crate) days: u32,
}

impl CertificateArgs {
    /// All names and addresses of the router.
    pub(crate) fn hosts(&self) -> Vec<String> {
        let local = ["localhost", "127.0.0.1", "::1"].map(str::to_owned);
        local.into_iter().chain(self.host.clone()).collect()
    }
}

impl KeysArgs {
    /// The key folder of `role`: a subfolder of the given folder, or the given folder itself.
    pub fn folder(&self, role: &str) -> Option<PathBuf> {
        let of_role = |keys: &Path| {
            let inside = keys.join(role);
            if inside.is_dir() { inside } else { keys.to_owned() }
        };
        self.keys.as_deref().map(of_role)
    }

    /// The configuration override of this flag.
    pub fn overrides(&self, role: &str) -> Option<Override> {
        let folder = self.folder(role)?;
        Some(Override::flag("--keys", "bus.security.keys", folder.display().to_string()))
    }
}

impl EndpointArgs {
    /// The configuration overrides of these flags: a process that listens is a router, any other a client with the role
    /// `role`.
    pub fn overrides(&self, role: &str) -> Vec<Override> {
        let (mode, role) = if self.listen.is_empty() { ("client", role) } else { ("router", "router") };
        let mut overrides = vec![Override::flag("--listen", "bus.mode", mode)];
        if !self.connect.is_empty() {
            overrides.push(Override::flag("--connect", "bus.connect", self.connect.clone()));
        }
        // Even if there are none, because a resumed run's own configuration may listen.
        overrides.push(Override::flag("--listen", "bus.listen", self.listen.clone()));
        overrides.extend(self.keys.overrides(role));
        overrides
    }
}
