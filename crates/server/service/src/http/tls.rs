//! TLS by rustls, with files that can be renewed while the service runs: certificate, key, and certificate
//! authorities of clients.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicI64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock};
use std::time::Instant;

use rustls::pki_types::pem::PemObject as _;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use rustls::server::WebPkiClientVerifier;
use rustls::{RootCertStore, ServerConfig};
use sha2::{Digest as _, Sha256};
use tokio_rustls::TlsAcceptor;

use crate::auth::small_file::read_small_file;
use crate::http::attempts::ReloadAttempts;
use crate::http::expiry::not_after;

/// Certificate chain, private key and client authorities, in PEM form.
#[derive(Debug, Clone)]
pub struct TlsFiles {
    /// The certificate of the server, then its issuers.
    pub cert: PathBuf,
    /// Its private key.
    pub key: PathBuf,
    /// Authorities of client certificates. If given, a client without such a certificate is refused in the handshake.
    pub client_ca: Option<PathBuf>,
}

/// A file cannot be used.
#[derive(Debug, thiserror::Error)]
#[error(
    "{}: {reason}; PEM files with the certificate chain, with its private key, and, if clients need certificates, with \
     those of their authorities are needed",
    path.display()
)]
pub struct TlsError {
    /// Which file.
    pub path: PathBuf,
    /// What is wrong with it.
    pub reason: String,
}

/// The TLS configuration, reloadable.
pub struct Tls {
    files: TlsFiles,
    current: RwLock<Arc<ServerConfig>>,
    /// End of the certificate, seconds since 1970.
    ends: AtomicI64,
    /// Remaining days of the last warning.
    warned: AtomicI64,
    /// Versions by hash of all files, or of the read error: the files are small, so comparing content is cheap.
    attempts: Mutex<ReloadAttempts<[u8; 32]>>,
}

impl Tls {
    /// Reads the files for the first time.
    ///
    /// # Errors
    /// [`TlsError`]
    pub fn open(files: TlsFiles) -> Result<Self, TlsError> {
        let contents = Contents::read(&files)?;
        let (config, ends) = contents.config(&files)?;
        let current = RwLock::new(Arc::new(config));
        let mut attempts = ReloadAttempts::default();
        attempts.succeeded(contents.hash());
        let (ends, warned) = (AtomicI64::new(ends), AtomicI64::new(i64::MAX));
        Ok(Self { files, current, ends, warned, attempts: Mutex::new(attempts) })
    }

    /// The acceptor for the next connection.
    pub fn acceptor(&self) -> TlsAcceptor {
        self.current.read().unwrap_or_else(PoisonError::into_inner).clone().into()
    }

    /// End of the certificate, seconds since 1970.
    pub fn ends(&self) -> i64 {
        self.ends.load(Ordering::Relaxed)
    }

    /// Whole days left at `now` (negative after expiry), if a warning is due: once per day, from two weeks before the
    /// end.
    pub fn expiry_warning_days(&self, now: i64) -> Option<i64> {
        let left = (self.ends() - now).div_euclid(86_400);
        (left < WARN_DAYS && self.warned.swap(left, Ordering::Relaxed) != left).then_some(left)
    }

    /// Whether the newest version of the files cannot be used.
    pub fn is_failing(&self) -> bool {
        self.attempts().is_failing()
    }

    fn attempts(&self) -> MutexGuard<'_, ReloadAttempts<[u8; 32]>> {
        self.attempts.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Reloads the files if they changed or if `all` is set. If they are invalid, the previous ones stay in force and
    /// the reload is retried.
    pub fn reload(&self, all: bool, now: Instant) -> Option<Result<(), TlsError>> {
        let mut attempts = self.attempts();
        let contents = Contents::read(&self.files);
        let state = match &contents {
            Ok(contents) => contents.hash(),
            Err(error) => hash(error.to_string().as_bytes()),
        };
        if !all && !attempts.is_due(&state, now) {
            return None;
        }
        Some(match contents.and_then(|contents| contents.config(&self.files)) {
            Ok((config, ends)) => {
                self.ends.store(ends, Ordering::Relaxed);
                self.warned.store(i64::MAX, Ordering::Relaxed);
                *self.current.write().unwrap_or_else(PoisonError::into_inner) = Arc::new(config);
                attempts.succeeded(state);
                Ok(())
            }
            Err(error) => {
                attempts.failed(state, now);
                Err(error)
            }
        })
    }
}

fn hash(bytes: &[u8]) -> [u8; 32] {
    Sha256::digest(bytes).into()
}

/// Days before the end at which warnings begin.
const WARN_DAYS: i64 = 14;

/// Content of the files.
struct Contents {
    cert: Vec<u8>,
    key: Vec<u8>,
    client_ca: Option<Vec<u8>>,
}

impl Contents {
    fn read(files: &TlsFiles) -> Result<Self, TlsError> {
        let read = |path: &Path| {
            read_small_file(path).map_err(|e| TlsError { path: path.to_owned(), reason: e.to_string() })
        };
        let client_ca = files.client_ca.as_deref().map(read).transpose()?;
        Ok(Self { cert: read(&files.cert)?, key: read(&files.key)?, client_ca })
    }

    fn hash(&self) -> [u8; 32] {
        hash(
            &[hash(&self.cert), hash(&self.key), hash(self.client_ca.as_deref().unwrap_or_default())]
                .concat(),
        )
    }

    /// The TLS configuration, and the end of the certificate.
    fn config(&self, files: &TlsFiles) -> Result<(ServerConfig, i64), TlsError> {
        let wrong = |path: &Path, reason: String| TlsError { path: path.to_owned(), reason };
        let chain: Vec<CertificateDer<'static>> = CertificateDer::pem_slice_iter(&self.cert)
            .collect::<Result<_, _>>()
            .map_err(|e| wrong(&files.cert, e.to_string()))?;
        let Some(first) = chain.first() else {
            return Err(wrong(&files.cert, "holds no certificate".to_owned()));
        };
        let ends =
            not_after(first).ok_or_else(|| wrong(&files.cert, "holds no X.509 certificate".to_owned()))?;
        let key = PrivateKeyDer::from_pem_slice(&self.key).map_err(|e| wrong(&files.key, e.to_string()))?;
        // The provider is explicit, so that no other crate in the process can change it.
        let provider = Arc::new(rustls::crypto::ring::default_provider());
        let builder = ServerConfig::builder_with_provider(provider.clone())
            .with_safe_default_protocol_versions()
            .map_err(|e| wrong(&files.cert, e.to_string()))?;
        let builder = match (&self.client_ca, &files.client_ca) {
            (Some(bytes), Some(path)) => {
                let mut roots = RootCertStore::empty();
                for authority in CertificateDer::pem_slice_iter(bytes) {
                    let authority = authority.map_err(|e| wrong(path, e.to_string()))?;
                    roots.add(authority).map_err(|e| wrong(path, e.to_string()))?;
                }
                let verifier = WebPkiClientVerifier::builder_with_provider(roots.into(), provider).build();
                builder.with_client_cert_verifier(verifier.map_err(|e| wrong(path, e.to_string()))?)
            }
            _ => builder.with_no_client_auth(),
        };
        let mut config =
            builder.with_single_cert(chain, key).map_err(|e| wrong(&files.key, e.to_string()))?;
        config.alpn_protocols = vec![b"http/1.1".to_vec()];
        Ok((config, ends))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn expiry_warning_is_given_once_per_day() {
        let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../server/service/tests/data");
        let tls =
            Tls::open(TlsFiles { cert: data.join("cert.pem"), key: data.join("key.pem"), client_ca: None })
                .expect("TLS");
        let day = |n: i64| tls.ends() + n * 86_400;
        for (now, warned) in [
            (day(-300), None),
            (day(-14), None),
            (day(-13), Some(13)),
            (day(-13) + 5, Some(12)),
            (day(-13) + 60, None),
            (day(0) + 1, Some(-1)),
            (day(0) + 2, None),
            (day(1) + 1, Some(-2)),
        ] {
            assert_eq!(tls.expiry_warning_days(now), warned, "{}", now - tls.ends());
        }
        assert!(tls.reload(true, Instant::now()).is_some_and(|read| read.is_ok()));
        assert_eq!(tls.expiry_warning_days(day(1) + 2), Some(-2), "a reload resets the warning");
    }
}
