//! Keys of a run: its own certificate authority, and a certificate and a password for each role.

use std::fmt::Display;
use std::fs::{self, DirBuilder, OpenOptions};
use std::io::{self, Write};
use std::net::IpAddr;
use std::ops::Range;
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt};
use std::path::Path;
use std::time::SystemTime;

use anyhow::anyhow;
use blueprints::outside;
use bus::security::{AUTHORITY_FILE, CERTIFICATE_FILE, KEY_FILE, PASSWORD_FILE, ROLES, USERS_FILE};
use rcgen::{
    BasicConstraints, CertificateParams, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair, KeyUsagePurpose,
};
use time::{Duration, OffsetDateTime};

use crate::exit::Failure;
use crate::names::random_text;

/// Folder of the authority, whose key signs certificates. The processes of a run do not need it.
pub const AUTHORITY: &str = "ca";

/// The role whose certificate may act as a server.
const ROUTER: &str = "router";

/// File that marks keys that are not complete.
const UNFINISHED: &str = ".unfinished";

/// A function that durably writes a new file.
type WriteFile<'w> = &'w mut dyn FnMut(&Path, &str) -> Result<(), Failure>;

/// Certificates are valid from this long before they are made, because clocks differ between machines.
const CLOCK_SLACK: Duration = Duration::hours(1);

/// Length of a password: 32 characters out of 62 carry 190 bits.
const N_PASSWORD_CHARACTERS: usize = 32;

/// Maximum size of a key file in bytes; they have a few hundred.
const MAX_BYTES: u64 = 1 << 20;

/// Whether `folder` holds keys that [`create`] made.
pub fn exist(folder: &Path) -> bool {
    !folder.join(UNFINISHED).exists() && ROLES.iter().all(|role| folder.join(role).join(PASSWORD_FILE).is_file())
}

/// Creates the authority and the folders of all roles, valid for `n_days`.
///
/// The router's certificate covers the names and addresses in `hosts`; clients reject a router that they reach under
/// any other. Folders are accessible to their owner only. A mark stays until all files are written, so that a call that
/// fails, or is interrupted, can be repeated.
///
/// # Errors
/// When `folder` already holds keys, a host is not valid, or nothing can be written.
pub fn create(folder: &Path, hosts: &[String], n_days: u32) -> Result<(), Failure> {
    create_with(folder, hosts, n_days, &mut write)
}

/// Like [`create`], but writes each file with `write`.
fn create_with(folder: &Path, hosts: &[String], n_days: u32, write: WriteFile<'_>) -> Result<(), Failure> {
    let unfinished = folder.join(UNFINISHED);
    if unfinished.exists() {
        remove_made(folder)?;
    }
    if folder.join(AUTHORITY).exists() || ROLES.iter().any(|role| folder.join(role).join(CERTIFICATE_FILE).exists()) {
        let shown = folder.display();
        return Err(Failure::Usage(format!("{shown} holds keys already; remove it, or choose another folder")));
    }
    check_hosts(hosts)?;
    make_folder(folder)?;
    self::write(&unfinished, "")?;
    match write_all(folder, hosts, n_days, write) {
        Ok(()) => remove_if_there(&unfinished),
        // The first error counts; what cannot be removed now is removed by the next call.
        Err(error) => remove_made(folder).and(Err(error)),
    }
}

/// The folders of a run's keys.
fn folders() -> impl Iterator<Item = &'static str> {
    ROLES.into_iter().chain([AUTHORITY])
}

/// Removes what a call left behind that was interrupted. A role's folder may be a volume of its own, which can neither be
/// removed nor get another name.
fn remove_made(folder: &Path) -> Result<(), Failure> {
    for name in folders() {
        let path = folder.join(name);
        for file in [AUTHORITY_FILE, KEY_FILE, CERTIFICATE_FILE, PASSWORD_FILE, USERS_FILE] {
            remove_if_there(&path.join(file))?;
        }
        // It fails for a volume, and for a folder that holds anything else.
        let _ = fs::remove_dir(&path);
    }
    remove_if_there(&folder.join(UNFINISHED))
}

/// Makes all keys in the folder `into`. The router's password comes last: nothing works without it.
fn write_all(into: &Path, hosts: &[String], n_days: u32, write: WriteFile<'_>) -> Result<(), Failure> {
    let valid = valid_from_now(n_days);
    let authority_key = KeyPair::generate().map_err(unmade)?;
    let mut authority = parameters("Lodestone run", &valid);
    authority.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
    authority.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
    let authority_pem = authority.self_signed(&authority_key).map_err(unmade)?.pem();
    let authority_key_pem = authority_key.serialize_pem();
    let issuer = Issuer::new(authority, authority_key);

    folders().try_for_each(|name| make_folder(&into.join(name)))?;
    write(&into.join(AUTHORITY).join(CERTIFICATE_FILE), &authority_pem)?;
    write(&into.join(AUTHORITY).join(KEY_FILE), &authority_key_pem)?;
    let passwords = ROLES.map(|role| Ok(format!("{role}:{}\n", password()?)));
    let passwords = passwords.into_iter().collect::<Result<Vec<String>, Failure>>()?;
    write(&into.join(ROUTER).join(USERS_FILE), &passwords.concat())?;
    for role in ROLES {
        let (certificate, key) = certificate(role, hosts, &valid, &issuer)?;
        write(&into.join(role).join(AUTHORITY_FILE), &authority_pem)?;
        write(&into.join(role).join(KEY_FILE), &key)?;
        write(&into.join(role).join(CERTIFICATE_FILE), &certificate)?;
    }
    let mut passwords: Vec<_> = ROLES.into_iter().zip(passwords).collect();
    passwords.sort_by_key(|(role, _)| *role == ROUTER);
    passwords.iter().try_for_each(|(role, password)| write(&into.join(role).join(PASSWORD_FILE), password))
}

/// Issues a new certificate for the router in `folder` and for `hosts`, signed by the same authority.
///
/// # Errors
/// When there is no authority, a host is not valid, or nothing can be written; the old certificate then stays.
pub fn renew_router(folder: &Path, hosts: &[String], n_days: u32) -> Result<(), Failure> {
    check_hosts(hosts)?;
    let authority = folder.join(AUTHORITY);
    let absent = |reason: String| {
        Failure::Input(format!("{} holds no authority that could sign: {reason}", authority.display()))
    };
    let read = |name: &str| {
        let path = authority.join(name);
        outside::read_text(&path, MAX_BYTES).map_err(|error| match error.kind() {
            io::ErrorKind::NotFound => absent(format!("{}: {error}", path.display())),
            _ => unusable(&path)(error),
        })
    };
    let key = KeyPair::from_pem(&read(KEY_FILE)?).map_err(|error| absent(error.to_string()))?;
    let issuer = Issuer::from_ca_cert_pem(&read(CERTIFICATE_FILE)?, key).map_err(|error| absent(error.to_string()))?;
    let (certificate, key) = certificate(ROUTER, hosts, &valid_from_now(n_days), &issuer)?;
    let new = |name: &str| folder.join(ROUTER).join(format!(".new-{name}"));
    // A key without its certificate is of no use, so neither is replaced before both are written.
    for (name, content) in [(KEY_FILE, key), (CERTIFICATE_FILE, certificate)] {
        remove_if_there(&new(name))?;
        write(&new(name), &content)?;
    }
    [KEY_FILE, CERTIFICATE_FILE].into_iter().try_for_each(|name| {
        let path = folder.join(ROUTER).join(name);
        fs::rename(new(name), &path).map_err(unusable(&path))
    })
}

/// Rejects hosts that rcgen accepts but that no client would ever match.
fn check_hosts(hosts: &[String]) -> Result<(), Failure> {
    let is_label =
        |label: &str| !label.is_empty() && label.bytes().all(|c| c.is_ascii_alphanumeric() || c == b'-' || c == b'_');
    let is_host = |host: &str| host.parse::<IpAddr>().is_ok() || host.split('.').all(is_label);
    match hosts.iter().find(|host| !is_host(host)) {
        Some(host) => Err(Failure::Input(format!(
            "`{host}` is neither an address nor a name of letters, digits, hyphens and dots"
        ))),
        None => Ok(()),
    }
}

/// When certificates that are made now are valid.
fn valid_from_now(n_days: u32) -> Range<OffsetDateTime> {
    let now = OffsetDateTime::from(SystemTime::now());
    now - CLOCK_SLACK..now + Duration::days(i64::from(n_days))
}

fn parameters(name: &str, valid: &Range<OffsetDateTime>) -> CertificateParams {
    let mut params = CertificateParams::default();
    params.distinguished_name.push(DnType::CommonName, name);
    params.not_before = valid.start;
    params.not_after = valid.end;
    params
}

/// Issues a certificate that names a role; returns it and its key, both as PEM.
fn certificate(
    role: &str,
    hosts: &[String],
    valid: &Range<OffsetDateTime>,
    issuer: &Issuer<'_, KeyPair>,
) -> Result<(String, String), Failure> {
    let key = KeyPair::generate().map_err(unmade)?;
    let mut params = parameters(role, valid);
    params.is_ca = IsCa::ExplicitNoCa;
    params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
    params.extended_key_usages = vec![ExtendedKeyUsagePurpose::ClientAuth];
    params.use_authority_key_identifier_extension = true;
    if role == ROUTER {
        params.extended_key_usages.push(ExtendedKeyUsagePurpose::ServerAuth);
        params.subject_alt_names = CertificateParams::new(hosts).map_err(unmade)?.subject_alt_names;
    }
    Ok((params.signed_by(&key, issuer).map_err(unmade)?.pem(), key.serialize_pem()))
}

fn password() -> Result<String, Failure> {
    const CHARACTERS: &[u8; 62] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789";
    random_text(CHARACTERS, N_PASSWORD_CHARACTERS).map_err(unmade)
}

fn make_folder(path: &Path) -> Result<(), Failure> {
    DirBuilder::new().recursive(true).mode(0o700).create(path).map_err(unusable(path))
}

fn write(path: &Path, content: &str) -> Result<(), Failure> {
    let file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(path);
    file.and_then(|mut file| file.write_all(content.as_bytes()).and_then(|()| file.sync_all())).map_err(unusable(path))
}

fn remove_if_there(path: &Path) -> Result<(), Failure> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(unusable(path)(error)),
        _ => Ok(()),
    }
}

/// For `map_err`: names the file or folder that cannot be read or written.
fn unusable(path: &Path) -> impl Fn(io::Error) -> Failure {
    move |error| Failure::Checkpoint(anyhow!("cannot use {}: {error}", path.display()))
}

/// The system's random number generator or the cryptography failed.
fn unmade(error: impl Display) -> Failure {
    Failure::Input(format!("making a key: {error}"))
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::MetadataExt;

    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).unwrap();
        let mut names: Vec<_> = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    /// Makes keys, and fails at the file with this number, as on a full disk. Returns how many were written.
    fn failing(folder: &Path, at: usize) -> (usize, Result<(), Failure>) {
        let mut n_written = 0;
        let made = create_with(folder, &["localhost".to_owned()], 1, &mut |path, content| {
            if n_written == at {
                return Err(unusable(path)(io::ErrorKind::StorageFull.into()));
            }
            n_written += 1;
            write(path, content)
        });
        (n_written, made)
    }

    #[test]
    fn keys_can_be_made_again_after_a_failure_at_any_file() {
        let folder = tempfile::tempdir().unwrap();
        let keys = folder.path().join("keys");
        let n_files = 2 + 1 + 4 * ROLES.len();
        for at in 0..n_files {
            let (n_written, made) = failing(&keys, at);
            assert!(n_written == at && matches!(made, Err(Failure::Checkpoint(_))), "{at}: {made:?}");
            assert!(names(&keys).is_empty(), "{at}: {:?}", names(&keys));
        }
        let (n_written, made) = failing(&keys, n_files);
        assert!(n_written == n_files && made.is_ok() && exist(&keys), "{made:?}");
        assert!(matches!(failing(&keys, n_files).1, Err(Failure::Usage(_))));
    }

    #[test]
    fn keys_can_be_made_again_after_a_kill() {
        let folder = tempfile::tempdir().unwrap();
        let keys = folder.path();
        // A folder that is there stays the same one, as that of a mounted volume must.
        fs::create_dir(keys.join(ROUTER)).unwrap();
        let of_router = || fs::metadata(keys.join(ROUTER)).unwrap().ino();
        let before = of_router();
        create(keys, &[], 1).unwrap();
        let mut complete: Vec<&str> = folders().collect();
        complete.sort_unstable();
        assert_eq!((names(keys), of_router()), (complete.iter().map(|&name| name.to_owned()).collect(), before));
        let password = || fs::read(keys.join(ROUTER).join(PASSWORD_FILE)).unwrap();
        let first = password();
        // Killed while files were written, and just before the end.
        fs::write(keys.join(UNFINISHED), "").unwrap();
        fs::remove_file(keys.join(ROUTER).join(PASSWORD_FILE)).unwrap();
        assert!(!exist(keys));
        create(keys, &[], 1).unwrap();
        let second = password();
        fs::write(keys.join(UNFINISHED), "").unwrap();
        assert!(!exist(keys));
        create(keys, &[], 1).unwrap();
        assert!(exist(keys) && first != second && second != password(), "all keys are new");
        assert_eq!(names(keys), complete);
    }
}
