//! TLS 1.3 with the keys of a role: both ends show a certificate, and trust the run's authority and no other.

use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use quinn::rustls::crypto::{CryptoProvider, ring};
use quinn::rustls::pki_types::pem::PemObject;
use quinn::rustls::pki_types::{CertificateDer, PrivateKeyDer};
use quinn::rustls::server::WebPkiClientVerifier;
use quinn::rustls::version::TLS13;
use quinn::rustls::{ClientConfig, RootCertStore, ServerConfig};
use x509_parser::parse_x509_certificate;

use crate::KeysError;
use crate::security::{AUTHORITY_FILE, CERTIFICATE_FILE, KEY_FILE, Keys};

/// A certificate in its binary form.
pub(super) type Certificate = CertificateDer<'static>;

/// The configuration of a router, and how long its certificate is still valid.
pub(super) fn server(keys: &Keys) -> Result<(ServerConfig, Duration), KeysError> {
    let (chain, key) = identity(keys)?;
    let provider = provider();
    let roots = Arc::new(roots(keys)?);
    let verifier = WebPkiClientVerifier::builder_with_provider(roots, Arc::clone(&provider)).build();
    let verifier = verifier.map_err(|error| unusable(&keys.path(AUTHORITY_FILE), error))?;
    let builder = ServerConfig::builder_with_provider(provider).with_protocol_versions(&[&TLS13]);
    let wrong = |error| unusable(&keys.path(KEY_FILE), error);
    let valid_for = chain.first().and_then(validity).unwrap_or_default();
    let builder = builder.map_err(wrong)?.with_client_cert_verifier(verifier);
    Ok((builder.with_single_cert(chain, key).map_err(wrong)?, valid_for))
}

/// The configuration of a client.
pub(super) fn client(keys: &Keys) -> Result<ClientConfig, KeysError> {
    let (chain, key) = identity(keys)?;
    let builder = ClientConfig::builder_with_provider(provider()).with_protocol_versions(&[&TLS13]);
    let wrong = |error| unusable(&keys.path(KEY_FILE), error);
    let builder = builder.map_err(wrong)?.with_root_certificates(roots(keys)?);
    builder.with_client_auth_cert(chain, key).map_err(wrong)
}

/// The role in a certificate that was verified, and for how long both it and `own` are valid.
pub(super) fn peer(chain: Option<&[Certificate]>, own: Duration) -> Option<(String, Duration)> {
    let first = chain?.first()?;
    let (_, certificate) = parse_x509_certificate(first).ok()?;
    let role = certificate.subject().iter_common_name().next()?.as_str().ok()?.to_owned();
    Some((role, own.min(validity(first)?)))
}

fn validity(certificate: &Certificate) -> Option<Duration> {
    let (_, certificate) = parse_x509_certificate(certificate).ok()?;
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    let until = u64::try_from(certificate.validity().not_after.timestamp()).unwrap_or(0);
    Some(Duration::from_secs(until).saturating_sub(now))
}

fn identity(keys: &Keys) -> Result<(Vec<Certificate>, PrivateKeyDer<'static>), KeysError> {
    let path = keys.path(KEY_FILE);
    let key = PrivateKeyDer::from_pem_file(&path).map_err(|error| unusable(&path, error))?;
    Ok((certificates(&keys.path(CERTIFICATE_FILE))?, key))
}

fn roots(keys: &Keys) -> Result<RootCertStore, KeysError> {
    let path = keys.path(AUTHORITY_FILE);
    let mut roots = RootCertStore::empty();
    for certificate in certificates(&path)? {
        roots.add(certificate).map_err(|error| unusable(&path, error))?;
    }
    Ok(roots)
}

fn certificates(path: &Path) -> Result<Vec<Certificate>, KeysError> {
    let found = CertificateDer::pem_file_iter(path).and_then(Iterator::collect);
    found.map_err(|error| unusable(path, error))
}

fn provider() -> Arc<CryptoProvider> {
    Arc::new(ring::default_provider())
}

fn unusable(path: &Path, error: impl std::fmt::Display) -> KeysError {
    KeysError::of_file(path, format_args!("cannot be used: {error}"))
}
