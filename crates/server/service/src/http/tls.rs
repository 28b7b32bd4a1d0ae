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
use veiloc_map::text::without_mark;

use crate::auth::small_file::read_small_file;
use crate::http::attempts::ReloadAttempts;
use crate::http::expiry::certificate;

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
    /// Begin of the certificate, seconds since 1970.
    begins: AtomicI64,
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
        let Loaded { config, begins, ends } = contents.config(&files)?;
        let current = RwLock::new(Arc::new(config));
        let mut attempts = ReloadAttempts::default();
        attempts.succeeded(contents.hash());
        Ok(Self {
            files,
            current,
            begins: AtomicI64::new(begins),
            ends: AtomicI64::new(ends),
            warned: AtomicI64::new(i64::MAX),
            attempts: Mutex::new(attempts),
        })
    }

    /// The acceptor for the next connection.
    pub fn acceptor(&self) -> TlsAcceptor {
        self.current.read().unwrap_or_else(PoisonError::into_inner).clone().into()
    }

    /// End of the certificate, seconds since 1970.
    pub fn ends(&self) -> i64 {
        self.ends.load(Ordering::Relaxed)
    }

    /// A warning about the validity at `now`, if one is due: once per day, from two weeks before the end, and before the begin.
    pub fn validity_warning(&self, now: i64) -> Option<Validity> {
        let left = (self.ends() - now).div_euclid(86_400);
        let to_wait = self.begins.load(Ordering::Relaxed) - now;
        let (warning, day) = if to_wait > 0 {
            (Validity::NotYet { seconds: to_wait }, -to_wait.div_euclid(86_400) - 1)
        } else if left < 0 {
            (Validity::Expired { days: -left }, left)
        } else {
            (Validity::ExpiresSoon { days: left }, left)
        };
        let is_due = to_wait > 0 || left < WARN_DAYS;
        (is_due && self.warned.swap(day, Ordering::Relaxed) != day).then_some(warning)
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
            Ok(Loaded { config, begins, ends }) => {
                self.begins.store(begins, Ordering::Relaxed);
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

/// In the head of an encrypted key.
const ENCRYPTED: &[u8] = b"ENCRYPTED";

/// Days before the end at which warnings begin.
const WARN_DAYS: i64 = 14;

/// What a user has to know of the validity of a certificate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Validity {
    /// It begins later: clients refuse it, or the clock of this machine is behind.
    NotYet {
        /// Time until then.
        seconds: i64,
    },
    /// It ends soon.
    ExpiresSoon {
        /// Whole days until then.
        days: i64,
    },
    /// It has ended.
    Expired {
        /// Days since then, begun ones included.
        days: i64,
    },
}

/// The TLS configuration, and begin and end of the certificate.
struct Loaded {
    config: ServerConfig,
    begins: i64,
    ends: i64,
}

/// Content of the files.
struct Contents {
    cert: Vec<u8>,
    key: Vec<u8>,
    client_ca: Option<Vec<u8>>,
}

impl Contents {
    fn read(files: &TlsFiles) -> Result<Self, TlsError> {
        let read = |path: &Path| {
            // Without the mark that editors of Windows put before the text.
            let read = read_small_file(path).map(|bytes| without_mark(&bytes).to_vec());
            read.map_err(|e| TlsError { path: path.to_owned(), reason: e.to_string() })
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

    fn config(&self, files: &TlsFiles) -> Result<Loaded, TlsError> {
        let wrong = |path: &Path, reason: String| TlsError { path: path.to_owned(), reason };
        let chain: Vec<CertificateDer<'static>> = CertificateDer::pem_slice_iter(&self.cert)
            .collect::<Result<_, _>>()
            .map_err(|e| wrong(&files.cert, e.to_string()))?;
        let Some(first) = chain.first() else {
            return Err(wrong(&files.cert, "holds no certificate".to_owned()));
        };
        let own =
            certificate(first).ok_or_else(|| wrong(&files.cert, "holds no X.509 certificate".to_owned()))?;
        let (begins, ends) = (own.begins, own.ends);
        let issuer = chain.get(1).and_then(|next| certificate(next));
        if own.issuer != own.subject && issuer.is_none_or(|issuer| issuer.subject != own.issuer) {
            tracing::warn!(
                file = %files.cert.display(),
                "the certificate of the issuer does not follow the one of this server: clients that do not know that issuer refuse \
                 the connection; append it, as in the chain file of the authority"
            );
        }
        let key = PrivateKeyDer::from_pem_slice(&self.key).map_err(|e| {
            let is_encrypted = self.key.windows(ENCRYPTED.len()).any(|window| window == ENCRYPTED);
            let reason = if is_encrypted {
                "the key is encrypted; decrypt it with `openssl pkey -in KEY -out DECRYPTED`".to_owned()
            } else {
                e.to_string()
            };
            wrong(&files.key, reason)
        })?;
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
        let place = |own: &CertificateDer<'static>| {
            builder.clone().with_single_cert(vec![own.clone()], key.clone_key()).is_ok()
        };
        let mut config = builder.clone().with_single_cert(chain.clone(), key.clone_key()).map_err(|e| {
            match chain.iter().position(place) {
                Some(at) if at > 0 => wrong(
                    &files.cert,
                    format!(
                        "the certificate of the key is number {} in the file; put it first, then its issuers",
                        at + 1
                    ),
                ),
                _ if matches!(e, rustls::Error::InconsistentKeys(_)) => {
                    wrong(&files.key, format!("the key does not belong to {}", files.cert.display()))
                }
                _ => wrong(&files.key, e.to_string()),
            }
        })?;
        config.alpn_protocols = vec![b"http/1.1".to_vec()];
        Ok(Loaded { config, begins, ends })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn usual_faults_of_files_are_named() {
        let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../server/service/tests/data");
        let folder = tempfile::tempdir().expect("temporary folder");
        let read = |name: &str| std::fs::read(data.join(name)).expect(name);
        let open = |cert: Vec<u8>, key: Vec<u8>| {
            let write = |name: &str, bytes| {
                std::fs::write(folder.path().join(name), bytes).expect("written");
                folder.path().join(name)
            };
            let (cert, key) = (write("host.pem", cert), write("host.key", key));
            Tls::open(TlsFiles { cert, key, client_ca: None }).map(drop).map_err(|error| error.to_string())
        };
        let (cert, key) = (read("cert.pem"), read("key.pem"));
        let marked = |bytes: &[u8]| [b"\xEF\xBB\xBF", bytes].concat();
        assert_eq!(open(marked(&cert), marked(&key)), Ok(()), "a mark of a text editor");
        let crlf = String::from_utf8(cert.clone()).expect("text").replace('\n', "\r\n");
        assert_eq!(open(crlf.into_bytes(), key.clone()), Ok(()));
        let refused = |cert, key, part: &str| {
            let error = open(cert, key).expect_err(part);
            assert!(error.contains(part), "{error}");
        };
        let wrong_order = [read("client-ca.pem"), cert.clone()].concat();
        refused(wrong_order, key.clone(), "host.pem: the certificate of the key is number 2 in the file");
        refused(cert.clone(), read("other-key.pem"), "host.key: the key does not belong to ");
        // `openssl pkey -aes256`: its head is enough.
        let encrypted = "-----BEGIN ENCRYPTED PRIVATE KEY-----\nMIGj\n-----END ENCRYPTED PRIVATE KEY-----\n";
        refused(cert, encrypted.into(), "host.key: the key is encrypted");
    }

    #[test]
    fn warning_about_validity_is_given_once_per_day() {
        let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../server/service/tests/data");
        let tls =
            Tls::open(TlsFiles { cert: data.join("cert.pem"), key: data.join("key.pem"), client_ca: None })
                .expect("TLS");
        let day = |n: i64| tls.ends() + n * 86_400;
        let soon = |days| Some(Validity::ExpiresSoon { days });
        let expired = |days| Some(Validity::Expired { days });
        for (now, warned) in [
            (day(-300), None),
            (day(-14), None),
            (day(-13), soon(13)),
            (day(-13) + 5, soon(12)),
            (day(-13) + 60, None),
            (day(0) + 1, expired(1)),
            (day(0) + 2, None),
            (day(1) + 1, expired(2)),
            (day(-36_500) - 5, Some(Validity::NotYet { seconds: 5 })),
            (day(-36_500) - 4, None),
            (day(-36_500) + 1, None),
        ] {
            assert_eq!(tls.validity_warning(now), warned, "{}", now - tls.ends());
        }
        assert!(tls.reload(true, Instant::now()).is_some_and(|read| read.is_ok()));
        assert_eq!(tls.validity_warning(day(1) + 2), expired(2), "a reload resets the warning");
    }
}
