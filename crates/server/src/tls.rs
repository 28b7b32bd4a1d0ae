//! TLS by rustls, with a certificate that can be renewed while the service runs.

use std::path::Path;
use std::sync::{Arc, PoisonError, RwLock};

use rustls::ServerConfig;
use rustls::pki_types::pem::PemObject as _;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tokio_rustls::TlsAcceptor;

use crate::error::ServerError;
use crate::maps::Stamp;
use crate::options::TlsFiles;

/// The certificate as it is now.
pub(crate) struct Tls {
    files: TlsFiles,
    current: RwLock<Arc<ServerConfig>>,
    seen: RwLock<[Option<Stamp>; 2]>,
}

impl Tls {
    pub(crate) fn open(files: TlsFiles) -> Result<Self, ServerError> {
        let seen = RwLock::new(stamps(&files));
        let current = RwLock::new(Arc::new(config(&files)?));
        Ok(Self { files, current, seen })
    }

    /// For the next connection.
    pub(crate) fn acceptor(&self) -> TlsAcceptor {
        self.current.read().unwrap_or_else(PoisonError::into_inner).clone().into()
    }

    /// Whether both files are there and one is another than before.
    pub(crate) fn is_stale(&self) -> bool {
        let now = stamps(&self.files);
        now.iter().all(Option::is_some) && now != *self.seen.read().unwrap_or_else(PoisonError::into_inner)
    }

    /// Reads both files again; when they do not fit together, what was there stays.
    pub(crate) fn reload(&self) -> Result<(), ServerError> {
        *self.seen.write().unwrap_or_else(PoisonError::into_inner) = stamps(&self.files);
        let config = Arc::new(config(&self.files)?);
        *self.current.write().unwrap_or_else(PoisonError::into_inner) = config;
        Ok(())
    }
}

fn stamps(files: &TlsFiles) -> [Option<Stamp>; 2] {
    [Stamp::of(&files.cert), Stamp::of(&files.key)]
}

fn config(files: &TlsFiles) -> Result<ServerConfig, ServerError> {
    let wrong = |path: &Path, reason: String| ServerError::Tls { path: path.to_owned(), reason };
    let chain: Vec<CertificateDer<'static>> = CertificateDer::pem_file_iter(&files.cert)
        .and_then(Iterator::collect)
        .map_err(|e| wrong(&files.cert, e.to_string()))?;
    if chain.is_empty() {
        return Err(wrong(&files.cert, "holds no certificate".to_owned()));
    }
    let key = PrivateKeyDer::from_pem_file(&files.key).map_err(|e| wrong(&files.key, e.to_string()))?;
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
