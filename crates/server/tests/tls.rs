//! TLS: what is served over it, what is not, and certificates that cannot be used.

mod common;

use std::io::Write as _;
use std::net::SocketAddr;
use std::sync::Arc;

use common::http::{Request, Response, connect};
use common::{Files, PHONE, Running, data, truth};
use rustls::pki_types::pem::PemObject as _;
use rustls::pki_types::{CertificateDer, ServerName};
use rustls::{ClientConfig, ClientConnection, RootCertStore, StreamOwned};
use veiloc_server::{Server, ServerError, ServerOptions, TlsFiles};

fn with_tls(mut options: ServerOptions, key: &str) -> ServerOptions {
    options.tls = Some(TlsFiles { cert: data("cert.pem"), key: data(key) });
    options
}

fn send(address: SocketAddr, request: &Request, trusted: bool) -> Result<Response, std::io::Error> {
    let mut roots = RootCertStore::empty();
    if trusted {
        let certificate = CertificateDer::from_pem_file(data("cert.pem")).expect("a certificate");
        roots.add(certificate).expect("a root");
    }
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let config = ClientConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()
        .expect("versions")
        .with_root_certificates(roots)
        .with_no_client_auth();
    let name = ServerName::try_from("localhost").expect("a name");
    let connection = ClientConnection::new(Arc::new(config), name).expect("a connection");
    let mut stream = StreamOwned::new(connection, connect(address));
    stream.write_all(&request.bytes())?;
    Ok(Response::read(&mut stream))
}

#[test]
fn poses_are_told_over_tls() {
    let files = Files::new();
    let server = Running::start(with_tls(files.options(), "key.pem"));
    let query = files.place.sealed(&truth());
    let request = Request::localize(&query).token(PHONE);
    let response = send(server.address, &request, true).expect("an answer");
    assert_eq!((response.status, &response.json()["trusted"]), (200, &true.into()));
    send(server.address, &request, false).expect_err("a certificate nobody vouches for is no certificate");

    // Plain HTTP on the same port gets nothing, least of all an answer.
    let mut plain = connect(server.address);
    let _ = plain.write_all(&request.bytes());
    let mut answer = Vec::new();
    let _ = std::io::Read::read_to_end(&mut plain, &mut answer);
    assert!(!answer.starts_with(b"HTTP"), "{answer:?}");
    assert_eq!(send(server.address, &request, true).expect("an answer").status, 200);
}

#[test]
fn unusable_certificates_are_named() {
    let files = Files::new();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("runtime");
    let refused = |options: ServerOptions| match runtime.block_on(Server::bind(options)) {
        Err(error @ ServerError::Tls { .. }) => error.to_string(),
        Err(error) => panic!("{error}"),
        Ok(_) => panic!("accepted"),
    };
    let error = refused(with_tls(files.options(), "other-key.pem"));
    assert!(error.contains("other-key.pem"), "{error}");
    let error = refused(with_tls(files.options(), "cert.pem"));
    assert!(error.contains("cert.pem"), "{error}");
    let error = refused(with_tls(files.options(), "missing.pem"));
    assert!(error.contains("missing.pem"), "{error}");
    let mut no_chain = files.options();
    no_chain.tls = Some(TlsFiles { cert: data("key.pem"), key: data("key.pem") });
    assert!(refused(no_chain).contains("no certificate"));
}
