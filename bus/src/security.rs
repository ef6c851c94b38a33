//! Authentication and roles on a bus that other machines can reach.
//!
//! A router with keys accepts only connections that are encrypted by TLS 1.3, over UDP as QUIC or over TCP. A client
//! presents a certificate of the run's own authority and a password, both of the same role, and gets the rights that
//! `access` grants that role. Everything else is denied.

use std::fmt::Display;
use std::io;
use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use blueprints::outside;
use proto::settings;
use serde_json::{Value, json};
use x509_parser::parse_x509_certificate;
use x509_parser::pem::parse_x509_pem;

/// The roles that have keys. Each is the common name of a certificate and a user name.
pub const ROLES: [&str; 5] = ["router", "learner", "actor", "evaluator", "viewer"];

/// The authority's certificate, which both ends trust.
pub const AUTHORITY_FILE: &str = "ca.pem";
/// The role's certificate.
pub const CERTIFICATE_FILE: &str = "cert.pem";
/// The private key of that certificate.
pub const KEY_FILE: &str = "key.pem";
/// The role and its password, as one line `role:password`.
pub const PASSWORD_FILE: &str = "password";
/// A router's list of all roles and their passwords, one `role:password` per line.
pub const USERS_FILE: &str = "users";

/// Maximum size of a key file in bytes; they have a few hundred.
const MAX_KEY_BYTES: u64 = 1 << 20;

settings! {
    /// Keys of a process on the bus.
    #[derive(Eq)]
    pub struct SecurityConfig {
        /// Folder with the keys of this process's role, as `lodestone keys new` creates it. Without keys, the process
        /// joins without credentials and may listen on loopback addresses and Unix sockets only.
        pub keys: Option<PathBuf> = None;
    }
}

/// Errors of reading keys.
#[derive(Debug, thiserror::Error)]
pub enum KeysError {
    /// A file is missing or cannot be read.
    #[error("cannot read the key file {0}: {1}; `lodestone keys new DIR` makes a folder of keys for each role")]
    Unreadable(PathBuf, io::Error),
    /// A file does not have the expected content, a certificate is not valid now, or the folder belongs to a role that
    /// others cannot connect to.
    #[error("{0}")]
    Unusable(String),
}

impl KeysError {
    pub(super) fn of_file(path: &Path, reason: impl Display) -> Self {
        Self::Unusable(format!("the key file {} {reason}", path.display()))
    }
}

/// The keys of one role, checked to be complete and valid now.
#[derive(Clone, Debug)]
pub(super) struct Keys {
    folder: PathBuf,
    user: String,
    password: String,
}

impl Keys {
    /// Reads and checks the folder of a role; `listens` requires the files that only a router needs.
    pub(super) fn read(folder: &Path, listens: bool) -> Result<Self, KeysError> {
        for name in [AUTHORITY_FILE, CERTIFICATE_FILE] {
            check_validity(&folder.join(name))?;
        }
        read(&folder.join(KEY_FILE))?;
        if listens && !folder.join(USERS_FILE).is_file() {
            let shown = folder.display();
            return Err(KeysError::Unusable(format!(
                "{shown} has no file `users`: a process that others connect to needs the keys of the role `router`"
            )));
        }
        let path = folder.join(PASSWORD_FILE);
        let text = read(&path)?;
        let Some((user, password)) =
            text.trim().split_once(':').filter(|(user, word)| !user.is_empty() && !word.is_empty())
        else {
            return Err(KeysError::of_file(&path, "does not hold `role:password`"));
        };
        Ok(Self { folder: folder.to_owned(), user: user.to_owned(), password: password.to_owned() })
    }

    /// The path of one of the files.
    pub(super) fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// Returns zenoh's settings for connecting with QUIC, which it keeps under `transport.link.tls`.
    pub(super) fn tls(&self) -> Value {
        let text = |name: &str| self.path(name).display().to_string();
        json!({
            "root_ca_certificate": text(AUTHORITY_FILE),
            "enable_mtls": true,
            // Zenoh also trusts public authorities, so only the name distinguishes the run's router from any other
            // server.
            "verify_name_on_connect": true,
            "close_link_on_expiration": true,
            "connect_certificate": text(CERTIFICATE_FILE),
            "connect_private_key": text(KEY_FILE),
        })
    }

    /// Returns zenoh's settings for `transport.auth.usrpwd`; a router has the passwords of all roles.
    pub(super) fn passwords(&self, listens: bool) -> Value {
        let users = listens.then(|| self.path(USERS_FILE).display().to_string());
        json!({ "user": self.user, "password": self.password, "dictionary_file": users })
    }
}

/// Returns whether other machines can reach the endpoint, for example `tcp/0.0.0.0:7447`.
pub(super) fn is_reachable(endpoint: &str) -> bool {
    let is_loopback =
        |host: &str| host.eq_ignore_ascii_case("localhost") || host.parse::<IpAddr>().is_ok_and(|ip| ip.is_loopback());
    !is_unix(endpoint) && address(endpoint).is_none_or(|(host, _)| !is_loopback(host))
}

/// Returns whether the text is an endpoint with a supported protocol.
pub(super) fn is_endpoint(text: &str) -> bool {
    match text.split_once('/') {
        Some(("tcp" | "quic" | "tls", _)) => host_and_port(text).is_some_and(|(host, _)| !host.is_empty()),
        Some(("unixsock-stream", path)) => !path.is_empty(),
        _ => false,
    }
}

/// Returns whether the system chooses the endpoint's port.
pub(super) fn has_any_port(endpoint: &str) -> bool {
    is_endpoint(endpoint) && !is_unix(endpoint) && address(endpoint).is_some_and(|(_, port)| port == 0)
}

/// Returns whether the endpoint is encrypted.
pub(super) fn is_encrypted(endpoint: &str) -> bool {
    endpoint.starts_with("quic/") || is_tls(endpoint)
}

/// Returns whether the endpoint is encrypted and uses TCP.
pub(super) fn is_tls(endpoint: &str) -> bool {
    endpoint.starts_with("tls/")
}

fn is_unix(endpoint: &str) -> bool {
    endpoint.starts_with("unixsock-stream/")
}

/// Splits an endpoint into host and port. An IPv6 address has no brackets.
pub(super) fn address(endpoint: &str) -> Option<(&str, u16)> {
    let (host, port) = host_and_port(endpoint)?;
    Some((host.trim_start_matches('[').trim_end_matches(']'), port))
}

fn host_and_port(endpoint: &str) -> Option<(&str, u16)> {
    let (_, address) = endpoint.split_once('/')?;
    let (host, port) = address.split(['?', '#']).next()?.rsplit_once(':')?;
    Some((host, port.parse().ok()?))
}

fn read(path: &Path) -> Result<String, KeysError> {
    outside::read_text(path, MAX_KEY_BYTES).map_err(|error| KeysError::Unreadable(path.to_owned(), error))
}

/// Checks the certificate here because zenoh would silently retry forever with an invalid one.
fn check_validity(path: &Path) -> Result<(), KeysError> {
    let malformed = |reason: &str| KeysError::of_file(path, reason);
    let text = read(path)?;
    let (_, pem) = parse_x509_pem(text.as_bytes()).map_err(|_| malformed("holds no PEM block"))?;
    let (_, certificate) =
        parse_x509_certificate(&pem.contents).map_err(|_| malformed("holds no X.509 certificate"))?;
    let validity = certificate.validity();
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs();
    let now = i64::try_from(now).unwrap_or(i64::MAX);
    if (validity.not_before.timestamp()..=validity.not_after.timestamp()).contains(&now) {
        return Ok(());
    }
    Err(KeysError::Unusable(format!(
        "the certificate {} is valid from {} to {}, which is not now; make new keys with `lodestone keys new`, or check \
         the clock",
        path.display(),
        validity.not_before,
        validity.not_after
    )))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn port_zero_is_any_port() {
        for endpoint in ["tcp/127.0.0.1:0", "tcp/[::]:0", "quic/127.0.0.1:00?prio=1"] {
            assert!(has_any_port(endpoint), "{endpoint}");
        }
        for endpoint in ["tcp/127.0.0.1:70", "tcp/[::0]:1", "unixsock-stream//tmp/bus.sock", "quic/a:7447#a=:0"] {
            assert!(!has_any_port(endpoint), "{endpoint}");
        }
    }

    #[test]
    fn only_loopback_and_unix_sockets_are_unreachable() {
        for endpoint in [
            "tcp/127.0.0.1:7447",
            "tcp/127.8.0.1:7447",
            "tcp/localhost:7447",
            "tcp/[::1]:7447",
            "quic/127.0.0.1:7447?prio=1",
            "unixsock-stream//tmp/bus.sock",
        ] {
            assert!(!is_reachable(endpoint), "{endpoint}");
        }
        for endpoint in [
            "tcp/0.0.0.0:7447",
            "tcp/[::]:7447",
            "quic/10.0.0.1:1",
            "tcp/node-3:7447",
            "tcp/localhost.example:1",
            "tcp",
        ] {
            assert!(is_reachable(endpoint), "{endpoint}");
        }
    }

    #[test]
    fn folder_without_keys_is_named_in_the_error() {
        let folder = tempfile::tempdir().unwrap();
        let message = Keys::read(folder.path(), false).unwrap_err().to_string();
        assert!(message.contains("ca.pem") && message.contains("lodestone keys new"), "{message}");
        std::fs::write(folder.path().join(AUTHORITY_FILE), "nonsense").unwrap();
        let message = Keys::read(folder.path(), false).unwrap_err().to_string();
        assert!(message.contains("ca.pem") && message.contains("PEM"), "{message}");
    }
}
