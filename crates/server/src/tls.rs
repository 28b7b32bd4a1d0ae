//! TLS by rustls, with a certificate that can be renewed while the service runs.

use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock};
use std::time::Instant;

use rustls::ServerConfig;
use rustls::pki_types::pem::PemObject as _;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tokio_rustls::TlsAcceptor;

use crate::attempts::Attempts;
use crate::error::ServerError;
use crate::options::TlsFiles;
use crate::reload::hash;

/// The certificate as it is now.
pub(crate) struct Tls {
    files: TlsFiles,
    current: RwLock<Arc<ServerConfig>>,
    /// By the hash of both files, or of why they cannot be read: they are small, and are read to be looked at.
    attempts: Mutex<Attempts<[u8; 32]>>,
}

impl Tls {
    pub(crate) fn open(files: TlsFiles) -> Result<Self, ServerError> {
        let pair = Pair::read(&files)?;
        let current = RwLock::new(Arc::new(pair.config(&files)?));
        let mut attempts = Attempts::default();
        attempts.took(pair.hash());
        Ok(Self { files, current, attempts: Mutex::new(attempts) })
    }

    /// For the next connection.
    pub(crate) fn acceptor(&self) -> TlsAcceptor {
        self.current.read().unwrap_or_else(PoisonError::into_inner).clone().into()
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
            Ok(config) => {
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

    fn config(&self, files: &TlsFiles) -> Result<ServerConfig, ServerError> {
        let wrong = |path: &Path, reason: String| ServerError::Tls { path: path.to_owned(), reason };
        let chain: Vec<CertificateDer<'static>> = CertificateDer::pem_slice_iter(&self.cert)
            .collect::<Result<_, _>>()
            .map_err(|e| wrong(&files.cert, e.to_string()))?;
        if chain.is_empty() {
            return Err(wrong(&files.cert, "holds no certificate".to_owned()));
        }
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
        Ok(config)
    }
}
