//! TLS by rustls, with a certificate that can be renewed while the service runs.

use std::path::Path;
use std::sync::atomic::{AtomicI64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock};
use std::time::Instant;

use rustls::ServerConfig;
use rustls::pki_types::pem::PemObject as _;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tokio_rustls::TlsAcceptor;

use crate::attempts::Attempts;
use crate::error::ServerError;
use crate::expiry::not_after;
use crate::options::TlsFiles;
use crate::tokens_file::hash;

/// The certificate as it is now.
pub(crate) struct Tls {
    files: TlsFiles,
    current: RwLock<Arc<ServerConfig>>,
    /// When the certificate ends, seconds since 1970.
    ends: AtomicI64,
    /// Days left that were told last.
    told: AtomicI64,
    /// By the hash of both files, or of why they cannot be read: they are small, and are read to be looked at.
    attempts: Mutex<Attempts<[u8; 32]>>,
}

impl Tls {
    pub(crate) fn open(files: TlsFiles) -> Result<Self, ServerError> {
        let pair = Pair::read(&files)?;
        let (config, ends) = pair.config(&files)?;
        let current = RwLock::new(Arc::new(config));
        let mut attempts = Attempts::default();
        attempts.took(pair.hash());
        let (ends, told) = (AtomicI64::new(ends), AtomicI64::new(i64::MAX));
        Ok(Self { files, current, ends, told, attempts: Mutex::new(attempts) })
    }

    /// For the next connection.
    pub(crate) fn acceptor(&self) -> TlsAcceptor {
        self.current.read().unwrap_or_else(PoisonError::into_inner).clone().into()
    }

    /// When the certificate ends, seconds since 1970.
    pub(crate) fn ends(&self) -> i64 {
        self.ends.load(Ordering::Relaxed)
    }

    /// Whole days that are left at `now`, below zero when it has expired; once a day, from two weeks before the end on.
    pub(crate) fn days_to_tell(&self, now: i64) -> Option<i64> {
        let left = (self.ends() - now).div_euclid(86_400);
        (left < WARN_DAYS && self.told.swap(left, Ordering::Relaxed) != left).then_some(left)
    }

    /// Whether the newest state of the files cannot be used.
    pub(crate) fn is_failing(&self) -> bool {
        self.attempts().is_failing()
    }

    fn attempts(&self) -> MutexGuard<'_, Attempts<[u8; 32]>> {
        self.attempts.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Reads both files again, and uses them if they are others than before or `all` is wished; when they do not fit
    /// together, what was there stays, and they are tried again.
    pub(crate) fn reload(&self, all: bool, now: Instant) -> Option<Result<(), ServerError>> {
        let mut attempts = self.attempts();
        let pair = Pair::read(&self.files);
        let state = match &pair {
            Ok(pair) => pair.hash(),
            Err(error) => hash(error.to_string().as_bytes()),
        };
        if !all && !attempts.is_due(&state, now) {
            return None;
        }
        Some(match pair.and_then(|pair| pair.config(&self.files)) {
            Ok((config, ends)) => {
                self.ends.store(ends, Ordering::Relaxed);
                self.told.store(i64::MAX, Ordering::Relaxed);
                *self.current.write().unwrap_or_else(PoisonError::into_inner) = Arc::new(config);
                attempts.took(state);
                Ok(())
            }
            Err(error) => {
                attempts.failed(state, now);
                Err(error)
            }
        })
    }
}

/// So many days before its end a certificate is told of.
const WARN_DAYS: i64 = 14;

/// What the files hold.
struct Pair {
    cert: Vec<u8>,
    key: Vec<u8>,
}

impl Pair {
    fn read(files: &TlsFiles) -> Result<Self, ServerError> {
        let read = |path: &Path| {
            std::fs::read(path).map_err(|e| ServerError::Tls { path: path.to_owned(), reason: e.to_string() })
        };
        Ok(Self { cert: read(&files.cert)?, key: read(&files.key)? })
    }

    fn hash(&self) -> [u8; 32] {
        hash(&[hash(&self.cert), hash(&self.key)].concat())
    }

    /// How to speak TLS with them, and when that ends.
    fn config(&self, files: &TlsFiles) -> Result<(ServerConfig, i64), ServerError> {
        let wrong = |path: &Path, reason: String| ServerError::Tls { path: path.to_owned(), reason };
        let chain: Vec<CertificateDer<'static>> = CertificateDer::pem_slice_iter(&self.cert)
            .collect::<Result<_, _>>()
            .map_err(|e| wrong(&files.cert, e.to_string()))?;
        let Some(first) = chain.first() else {
            return Err(wrong(&files.cert, "holds no certificate".to_owned()));
        };
        let ends =
            not_after(first).ok_or_else(|| wrong(&files.cert, "holds no certificate of X.509".to_owned()))?;
        let key = PrivateKeyDer::from_pem_slice(&self.key).map_err(|e| wrong(&files.key, e.to_string()))?;
        // Named on purpose: nothing in the process may choose another provider by being linked in.
        let provider = Arc::new(rustls::crypto::ring::default_provider());
        let mut config = ServerConfig::builder_with_provider(provider)
            .with_safe_default_protocol_versions()
            .map_err(|e| wrong(&files.cert, e.to_string()))?
            .with_no_client_auth()
            .with_single_cert(chain, key)
            .map_err(|e| wrong(&files.key, e.to_string()))?;
        config.alpn_protocols = vec![b"http/1.1".to_vec()];
        Ok((config, ends))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_end_of_a_certificate_is_told_once_a_day() {
        let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data");
        let tls =
            Tls::open(TlsFiles { cert: data.join("cert.pem"), key: data.join("key.pem") }).expect("TLS");
        let day = |n: i64| tls.ends() + n * 86_400;
        for (now, told) in [
            (day(-300), None),
            (day(-14), None),
            (day(-13), Some(13)),
            (day(-13) + 5, Some(12)),
            (day(-13) + 60, None),
            (day(0) + 1, Some(-1)),
            (day(0) + 2, None),
            (day(1) + 1, Some(-2)),
        ] {
            assert_eq!(tls.days_to_tell(now), told, "{}", now - tls.ends());
        }
        assert!(tls.reload(true, Instant::now()).is_some_and(|read| read.is_ok()));
        assert_eq!(tls.days_to_tell(day(1) + 2), Some(-2), "read anew, told anew");
    }
}
