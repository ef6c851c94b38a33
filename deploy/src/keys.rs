//! Keys of a run: its own certificate authority, and a certificate and a password for each role.

use std::fs::{self, DirBuilder, OpenOptions};
use std::io::{self, Write};
use std::net::IpAddr;
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use bus::security::{AUTHORITY_FILE, CERTIFICATE_FILE, KEY_FILE, PASSWORD_FILE, ROLES, USERS_FILE};
use rand::TryRng;
use rand::rngs::SysRng;
use rcgen::{
    BasicConstraints, CertificateParams, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair, KeyUsagePurpose,
};
use time::{Duration, OffsetDateTime};

/// Folder of the authority, whose key signs certificates. The processes of a run do not need it.
pub const AUTHORITY: &str = "ca";

/// The role whose certificate may act as a server.
const ROUTER: &str = "router";

/// Certificates are valid from this long before they are made, because clocks differ between machines.
const CLOCK_SLACK: Duration = Duration::hours(1);

/// Length of a password: 32 characters out of 62 carry 190 bits.
const N_PASSWORD_CHARACTERS: usize = 32;

/// Reasons why keys cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum MakeKeysError {
    /// The folder already holds keys.
    #[error("{} holds keys already; remove it, or choose another folder", .0.display())]
    Exists(PathBuf),
    /// There is no authority that can sign.
    #[error("{} holds no authority that could sign: {reason}", folder.display())]
    NoAuthority {
        /// Where the authority was expected.
        folder: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// A host name that is not valid.
    #[error("`{0}` is neither an address nor a name of letters, digits, hyphens and dots")]
    Host(String),
    /// The system's random number generator or the cryptography failed.
    #[error("making a key: {0}")]
    Crypto(String),
    /// A file or folder cannot be read or written.
    #[error("cannot use {}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The error of the file system.
        source: io::Error,
    },
}

impl From<rcgen::Error> for MakeKeysError {
    fn from(error: rcgen::Error) -> Self {
        Self::Crypto(error.to_string())
    }
}

/// Whether `folder` holds keys that [`create`] made.
pub fn exist(folder: &Path) -> bool {
    ROLES.iter().all(|role| folder.join(role).join(PASSWORD_FILE).is_file())
}

/// Creates the authority and the folders of all roles, valid for `n_days`.
///
/// The router's certificate covers the names and addresses in `hosts`; clients reject a router that they reach under
/// any other. Folders are accessible to their owner only. The router's list of users and its password are written last,
/// so that an interrupted call does not leave a folder that passes for complete.
///
/// # Errors
/// When `folder` already holds keys, a host is not valid, or nothing can be written.
pub fn create(folder: &Path, hosts: &[String], n_days: u32) -> Result<(), MakeKeysError> {
    if folder.join(AUTHORITY).exists() || ROLES.iter().any(|role| folder.join(role).join(CERTIFICATE_FILE).exists()) {
        return Err(MakeKeysError::Exists(folder.to_owned()));
    }
    check_hosts(hosts)?;
    let validity = Validity::from_now(n_days);
    let authority_key = KeyPair::generate()?;
    let mut authority = CertificateParams::default();
    authority.distinguished_name.push(DnType::CommonName, "Lodestone run");
    authority.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
    authority.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
    validity.apply(&mut authority);
    let authority_pem = authority.self_signed(&authority_key)?.pem();
    let authority_key_pem = authority_key.serialize_pem();
    let issuer = Issuer::new(authority, authority_key);

    make_folder(folder)?;
    let mut users = String::new();
    for role in ROLES {
        let password = password()?;
        users.push_str(&format!("{role}:{password}\n"));
        let into = folder.join(role);
        make_folder(&into)?;
        let (certificate, key) = certificate(role, hosts, &validity, &issuer)?;
        write(&into.join(AUTHORITY_FILE), &authority_pem)?;
        write(&into.join(KEY_FILE), &key)?;
        write(&into.join(CERTIFICATE_FILE), &certificate)?;
        if role != ROUTER {
            write(&into.join(PASSWORD_FILE), &format!("{role}:{password}\n"))?;
        }
    }
    let into = folder.join(AUTHORITY);
    make_folder(&into)?;
    write(&into.join(CERTIFICATE_FILE), &authority_pem)?;
    write(&into.join(KEY_FILE), &authority_key_pem)?;
    // Written last and with all roles: without it nothing works, so an incomplete folder is never used.
    write(&folder.join(ROUTER).join(USERS_FILE), &users)?;
    let own = users.lines().find(|line| line.starts_with(ROUTER)).unwrap_or_default();
    write(&folder.join(ROUTER).join(PASSWORD_FILE), &format!("{own}\n"))
}

/// Issues a new certificate for the router in `folder` and for `hosts`, signed by the same authority.
///
/// # Errors
/// When there is no authority, a host is not valid, or nothing can be written; the old certificate then stays.
pub fn renew_router(folder: &Path, hosts: &[String], n_days: u32) -> Result<(), MakeKeysError> {
    check_hosts(hosts)?;
    let authority = folder.join(AUTHORITY);
    let absent = |reason: String| MakeKeysError::NoAuthority { folder: authority.clone(), reason };
    let read = |name: &str| {
        let path = authority.join(name);
        fs::read_to_string(&path).map_err(|source| match source.kind() {
            io::ErrorKind::NotFound => absent(format!("{}: {source}", path.display())),
            _ => MakeKeysError::Io { path, source },
        })
    };
    let key = KeyPair::from_pem(&read(KEY_FILE)?).map_err(|error| absent(error.to_string()))?;
    let issuer = Issuer::from_ca_cert_pem(&read(CERTIFICATE_FILE)?, key).map_err(|error| absent(error.to_string()))?;
    let (certificate, key) = certificate(ROUTER, hosts, &Validity::from_now(n_days), &issuer)?;
    let into = folder.join(ROUTER);
    for (name, content) in [(KEY_FILE, key), (CERTIFICATE_FILE, certificate)] {
        let (path, new) = (into.join(name), into.join(format!(".new-{name}")));
        remove_if_there(&new)?;
        write(&new, &content)?;
        fs::rename(&new, &path).map_err(|source| MakeKeysError::Io { path, source })?;
    }
    Ok(())
}

/// Rejects hosts that rcgen accepts but that no client would ever match.
fn check_hosts(hosts: &[String]) -> Result<(), MakeKeysError> {
    let is_label =
        |label: &str| !label.is_empty() && label.bytes().all(|c| c.is_ascii_alphanumeric() || c == b'-' || c == b'_');
    let is_host = |host: &str| host.parse::<IpAddr>().is_ok() || host.split('.').all(is_label);
    match hosts.iter().find(|host| !is_host(host)) {
        Some(host) => Err(MakeKeysError::Host(host.clone())),
        None => Ok(()),
    }
}

struct Validity {
    from: OffsetDateTime,
    to: OffsetDateTime,
}

impl Validity {
    fn from_now(n_days: u32) -> Self {
        let now = OffsetDateTime::from(SystemTime::now());
        Self { from: now - CLOCK_SLACK, to: now + Duration::days(i64::from(n_days)) }
    }

    fn apply(&self, params: &mut CertificateParams) {
        (params.not_before, params.not_after) = (self.from, self.to);
    }
}

/// Issues a certificate that names a role; returns it and its key, both as PEM.
fn certificate(
    role: &str,
    hosts: &[String],
    validity: &Validity,
    issuer: &Issuer<'_, KeyPair>,
) -> Result<(String, String), MakeKeysError> {
    let key = KeyPair::generate()?;
    let mut params = CertificateParams::default();
    params.distinguished_name.push(DnType::CommonName, role);
    params.is_ca = IsCa::ExplicitNoCa;
    params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
    params.extended_key_usages = vec![ExtendedKeyUsagePurpose::ClientAuth];
    params.use_authority_key_identifier_extension = true;
    validity.apply(&mut params);
    if role == ROUTER {
        params.extended_key_usages.push(ExtendedKeyUsagePurpose::ServerAuth);
        params.subject_alt_names = CertificateParams::new(hosts)?.subject_alt_names;
    }
    Ok((params.signed_by(&key, issuer)?.pem(), key.serialize_pem()))
}

fn password() -> Result<String, MakeKeysError> {
    const CHARACTERS: &[u8; 62] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789";
    let mut password = String::new();
    while password.len() < N_PASSWORD_CHARACTERS {
        let word = SysRng.try_next_u32().map_err(|error| MakeKeysError::Crypto(error.to_string()))?;
        // Six bits at a time. The two values beyond the table are redrawn, so that all characters are equally likely.
        password.extend(CHARACTERS.get((word & 63) as usize).map(|&character| char::from(character)));
    }
    Ok(password)
}

fn make_folder(path: &Path) -> Result<(), MakeKeysError> {
    let made = DirBuilder::new().recursive(true).mode(0o700).create(path);
    made.map_err(|source| MakeKeysError::Io { path: path.to_owned(), source })
}

fn write(path: &Path, content: &str) -> Result<(), MakeKeysError> {
    let file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(path);
    file.and_then(|mut file| file.write_all(content.as_bytes()).and_then(|()| file.sync_all()))
        .map_err(|source| MakeKeysError::Io { path: path.to_owned(), source })
}

fn remove_if_there(path: &Path) -> Result<(), MakeKeysError> {
    match fs::remove_file(path) {
        Err(source) if source.kind() != io::ErrorKind::NotFound => {
            Err(MakeKeysError::Io { path: path.to_owned(), source })
        }
        _ => Ok(()),
    }
}
