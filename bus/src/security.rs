//! Who may join a bus that others can reach, and what each role may do there.
//!
//! A router with keys takes QUIC connections only, which are encrypted by TLS 1.3. A client shows a certificate of the run's own authority and a password, both
//! of one role, and may then do what `access` grants that role. Everything else is denied.

use std::fs;
use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use proto::settings;
use serde_json::{Value, json};
use x509_parser::parse_x509_certificate;
use x509_parser::pem::parse_x509_pem;

/// The roles that have keys; each is the common name of a certificate and the name of a user.
pub const ROLES: [&str; 5] = ["router", "learner", "actor", "evaluator", "viewer"];

/// The authority's certificate, which both ends trust.
pub const AUTHORITY_FILE: &str = "ca.pem";
/// The role's certificate.
pub const CERTIFICATE_FILE: &str = "cert.pem";
/// The private key of that certificate.
pub const KEY_FILE: &str = "key.pem";
/// The role and its password, as `role:password` in one line.
pub const PASSWORD_FILE: &str = "password";
/// A router's list of all roles and their passwords, one `role:password` a line.
pub const USERS_FILE: &str = "users";

settings! {
    /// Keys of a process on the bus.
    #[derive(Eq)]
    pub struct SecurityConfig {
        /// Folder with the keys of this process's role, as `lodestone keys new` makes it. Without keys the process
        /// joins without credentials and may listen on loopback addresses and unix sockets only.
        pub keys: Option<PathBuf> = None;
    }
}

/// Keys that cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum KeysError {
    /// A file is missing or cannot be read.
    #[error("cannot read the key file {}: {reason}; `lodestone keys new DIR` makes a folder of keys for each role", path.display())]
    Unreadable {
        /// Which file.
        path: PathBuf,
        /// What the system says.
        reason: String,
    },
    /// A file is not what its name says.
    #[error("the key file {} {reason}", path.display())]
    Malformed {
        /// Which file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// A certificate whose time is over, or has not come.
    #[error("the certificate {} is valid {validity}, which is not now; make new keys with `lodestone keys new`, or check the clock", path.display())]
    Expired {
        /// Which file.
        path: PathBuf,
        /// From when to when.
        validity: String,
    },
    /// A router needs the passwords of all roles, and this is another role's folder.
    #[error("{} has no file `users`: a process that others connect to needs the keys of the role `router`", .0.display())]
    NotARouter(PathBuf),
}

/// The keys of one role, found to be complete and in date.
#[derive(Clone, Debug)]
pub(super) struct Keys {
    folder: PathBuf,
    user: String,
    password: String,
}

impl Keys {
    /// Reads and checks the folder of a role; `listens` asks for what a router needs besides.
    pub(super) fn read(folder: &Path, listens: bool) -> Result<Self, KeysError> {
        for name in [AUTHORITY_FILE, CERTIFICATE_FILE] {
            check_validity(&folder.join(name))?;
        }
        read(&folder.join(KEY_FILE))?;
        if listens && !folder.join(USERS_FILE).is_file() {
            return Err(KeysError::NotARouter(folder.to_owned()));
        }
        let path = folder.join(PASSWORD_FILE);
        let text = read(&path)?;
        let Some((user, password)) =
            text.trim().split_once(':').filter(|(user, word)| !user.is_empty() && !word.is_empty())
        else {
            return Err(KeysError::Malformed { path, reason: "does not hold `role:password`".to_owned() });
        };
        Ok(Self { folder: folder.to_owned(), user: user.to_owned(), password: password.to_owned() })
    }

    fn path(&self, name: &str) -> String {
        self.folder.join(name).display().to_string()
    }

    /// Zenoh's settings of `transport.link.tls`, which QUIC shares.
    pub(super) fn tls(&self) -> Value {
        let (certificate, key) = (self.path(CERTIFICATE_FILE), self.path(KEY_FILE));
        json!({
            "root_ca_certificate": self.path(AUTHORITY_FILE),
            "enable_mtls": true,
            // Zenoh trusts public authorities besides ours, so only the name tells our router from anybody's server.
            "verify_name_on_connect": true,
            "close_link_on_expiration": true,
            "listen_certificate": certificate,
            "listen_private_key": key,
            "connect_certificate": certificate,
            "connect_private_key": key,
        })
    }

    /// Zenoh's settings of `transport.auth.usrpwd`; a router knows everybody's password.
    pub(super) fn passwords(&self, listens: bool) -> Value {
        let users = listens.then(|| self.path(USERS_FILE));
        json!({ "user": self.user, "password": self.password, "dictionary_file": users })
    }
}

/// Whether others than this machine's processes can reach the endpoint, for example `tcp/0.0.0.0:7447`.
pub(super) fn is_reachable(endpoint: &str) -> bool {
    let (protocol, address) = endpoint.split_once('/').unwrap_or((endpoint, ""));
    if protocol == "unixsock-stream" {
        return false;
    }
    let address = address.split(['?', '#']).next().unwrap_or_default();
    let host = address.rsplit_once(':').map_or(address, |(host, _)| host);
    let host = host.trim_start_matches('[').trim_end_matches(']');
    let is_loopback = host.eq_ignore_ascii_case("localhost") || host.parse::<IpAddr>().is_ok_and(|ip| ip.is_loopback());
    !is_loopback
}

/// Whether the text is an endpoint of a kind that is built in.
pub(super) fn is_endpoint(text: &str) -> bool {
    match text.split_once('/') {
        Some(("tcp" | "quic", address)) => address.contains(':'),
        Some(("unixsock-stream", path)) => !path.is_empty(),
        _ => false,
    }
}

/// Whether the endpoint is encrypted.
///
/// Zenoh's TLS over TCP is left out: it reads and writes one stream from two tasks at once (zenoh issue 2557), and under load
/// connections broke every few seconds.
pub(super) fn is_quic(endpoint: &str) -> bool {
    endpoint.starts_with("quic/")
}

fn read(path: &Path) -> Result<String, KeysError> {
    fs::read_to_string(path).map_err(|error| KeysError::Unreadable { path: path.to_owned(), reason: error.to_string() })
}

/// Zenoh would retry for ever, and silently, with a certificate that nobody accepts.
fn check_validity(path: &Path) -> Result<(), KeysError> {
    let malformed = |reason: &str| KeysError::Malformed { path: path.to_owned(), reason: reason.to_owned() };
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
    let validity = format!("from {} to {}", validity.not_before, validity.not_after);
    Err(KeysError::Expired { path: path.to_owned(), validity })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_loopback_and_unix_sockets_are_out_of_reach() {
        for endpoint in [
            "tcp/127.0.0.1:7447",
            "tcp/127.8.0.1:0",
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
    fn a_folder_without_keys_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let message = Keys::read(folder.path(), false).unwrap_err().to_string();
        assert!(message.contains("ca.pem") && message.contains("lodestone keys new"), "{message}");
        fs::write(folder.path().join(AUTHORITY_FILE), "nonsense").unwrap();
        let message = Keys::read(folder.path(), false).unwrap_err().to_string();
        assert!(message.contains("ca.pem") && message.contains("PEM"), "{message}");
    }
}
