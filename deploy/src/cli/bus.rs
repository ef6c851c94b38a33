//! Arguments of whoever joins a bus: endpoints, keys, health.

use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};

use super::values::endpoint;
use crate::config::Override;

/// Endpoints of a process that joins others.
#[derive(Clone, Debug, Default, Args)]
pub struct EndpointArgs {
    /// Endpoint of the router, for example tcp/127.0.0.1:7447, quic/HOST:7447 or unixsock-stream//tmp/bus.sock; may be
    /// repeated.
    #[arg(long, value_name = "ENDPOINT", env = "LODESTONE_CONNECT", value_delimiter = ',', value_parser = endpoint)]
    pub connect: Vec<String>,
    /// Be a router as well and listen here; may be repeated. An address that other machines reach needs --keys.
    #[arg(long, value_name = "ENDPOINT", env = "LODESTONE_LISTEN", value_delimiter = ',', value_parser = endpoint)]
    pub listen: Vec<String>,
    /// Keys.
    #[command(flatten)]
    pub keys: KeysArgs,
}

/// Which keys a process shows.
#[derive(Clone, Debug, Default, Args)]
pub struct KeysArgs {
    /// Folder of keys made by `lodestone keys new`: all of them, or those of this process's role.
    #[arg(long, value_name = "DIR", env = "LODESTONE_KEYS")]
    pub keys: Option<PathBuf>,
}

/// Arguments of `router`.
#[derive(Debug, Args)]
pub struct RouterArgs {
    /// Where processes find it, for example tcp/127.0.0.1:7447, or quic/0.0.0.0:7447 with --keys; may be repeated.
    #[arg(long, value_name = "ENDPOINT", required = true, env = "LODESTONE_LISTEN", value_delimiter = ',', value_parser = endpoint)]
    pub listen: Vec<String>,
    /// Other routers to connect to; may be repeated.
    #[arg(long, value_name = "ENDPOINT", env = "LODESTONE_CONNECT", value_delimiter = ',', value_parser = endpoint)]
    pub connect: Vec<String>,
    /// Keys.
    #[command(flatten)]
    pub keys: KeysArgs,
    /// Health.
    #[command(flatten)]
    pub health: HealthArgs,
}

/// Where a service reports its health.
#[derive(Clone, Debug, Default, Args)]
pub struct HealthArgs {
    /// Write the state of this process here every 2 s, for `lodestone healthcheck`.
    #[arg(long, value_name = "FILE", env = "LODESTONE_HEALTH_FILE")]
    pub health_file: Option<PathBuf>,
}

/// Arguments of `healthcheck`.
#[derive(Debug, Args)]
pub struct HealthcheckArgs {
    /// The file that the service was given with --health-file.
    #[arg(long, value_name = "FILE", env = "LODESTONE_HEALTH_FILE")]
    pub file: PathBuf,
    /// Ask only whether the process lives and its work goes on, not whether it reaches a router.
    #[arg(long)]
    pub alive: bool,
}

/// Subcommands of `keys`.
#[derive(Debug, Subcommand)]
pub enum KeysCommand {
    /// Make an authority, and for each role a certificate and a password.
    New(KeysNewArgs),
    /// Give the router a new certificate, for other hosts or a longer time. Everybody else's keys stay as they are.
    Router(KeysRouterArgs),
}

/// Arguments of `keys new`.
#[derive(Debug, Args)]
pub struct KeysNewArgs {
    /// Folder for the keys.
    #[arg(value_name = "DIR")]
    pub dir: PathBuf,
    /// What the certificate is for.
    #[command(flatten)]
    pub certificate: CertificateArgs,
    /// Do nothing when the folder holds keys already.
    #[arg(long)]
    pub keep: bool,
}

/// Arguments of `keys router`.
#[derive(Debug, Args)]
pub struct KeysRouterArgs {
    /// Folder that `keys new` made, with the authority in it.
    #[arg(value_name = "DIR")]
    pub dir: PathBuf,
    /// What the certificate is for.
    #[command(flatten)]
    pub certificate: CertificateArgs,
}

/// What the router's certificate is for.
#[derive(Clone, Debug, Args)]
pub struct CertificateArgs {
    /// Name or address under which processes reach the router; may be repeated. Always among them: localhost, 127.0.0.1
    /// and ::1.
    #[arg(long, value_name = "HOST", value_delimiter = ',')]
    pub host: Vec<String>,
    /// Days until the keys expire.
    #[arg(long, value_name = "N", default_value_t = 365, value_parser = clap::value_parser!(u32).range(1..=3650))]
    pub days: u32,
}

impl CertificateArgs {
    /// All names and addresses of the router.
    pub fn hosts(&self) -> Vec<String> {
        let local = ["localhost", "127.0.0.1", "::1"].map(str::to_owned);
        local.into_iter().chain(self.host.clone()).collect()
    }
}

impl KeysArgs {
    /// The folder of `role`, which may lie in the folder given.
    pub fn folder(&self, role: &str) -> Option<PathBuf> {
        let of_role = |keys: &Path| {
            let inside = keys.join(role);
            if inside.is_dir() { inside } else { keys.to_owned() }
        };
        self.keys.as_deref().map(of_role)
    }

    /// The flag that changes the configuration.
    pub fn overrides(&self, role: &str) -> Option<Override> {
        let folder = self.folder(role)?;
        Some(Override::flag("--keys", "bus.security.keys", folder.display().to_string()))
    }
}

impl EndpointArgs {
    /// The flags that change the configuration: whoever listens is a router, everyone else a client in `role`.
    pub fn overrides(&self, role: &str) -> Vec<Override> {
        let (mode, role) = if self.listen.is_empty() { ("client", role) } else { ("router", "router") };
        let mut overrides = vec![Override::flag("--listen", "bus.mode", mode)];
        if !self.connect.is_empty() {
            overrides.push(Override::flag("--connect", "bus.connect", self.connect.clone()));
        }
        // Also where there are none: the run that goes on may have listened itself.
        overrides.push(Override::flag("--listen", "bus.listen", self.listen.clone()));
        overrides.extend(self.keys.overrides(role));
        overrides
    }
}
