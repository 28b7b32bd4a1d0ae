//! TLS: service over TLS, client certificates, and unusable certificates.

use super::common;

use std::io::Write as _;
use std::net::SocketAddr;
use std::sync::Arc;

use common::http::{Request, Response, connect};
use common::{Files, PHONE, Running, data, truth};
use rustls::pki_types::pem::PemObject as _;
use rustls::pki_types::{CertificateDer, ServerName};
use rustls::{ClientConfig, ClientConnection, RootCertStore, StreamOwned};
use veiloc_service::{Server, ServerError, ServerOptions, TlsFiles};

fn with_tls(mut options: ServerOptions, key: &str) -> ServerOptions {
    options.tls = Some(TlsFiles { cert: data("cert.pem"), key: data(key), client_ca: None });
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
fn service_over_tls() {
    let files = Files::new();
    let server = Running::start(with_tls(files.options(), "key.pem"));
    let query = files.scene.sealed(&truth());
    let request = Request::localize(&query).token(PHONE);
    let response = send(server.address, &request, true).expect("an answer");
    assert_eq!((response.status, &response.json()["state"]), (200, &"trusted".into()));
    send(server.address, &request, false).expect_err("a certificate without a trusted issuer");

    // Plain HTTP on the same port gets no response.
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
    no_chain.tls = Some(TlsFiles { cert: data("key.pem"), key: data("key.pem"), client_ca: None });
    assert!(refused(no_chain).contains("no certificate"));
}

/// Sends a request with an optional client certificate.
fn as_client(
    address: SocketAddr,
    client: Option<(&str, &str)>,
    alpn: &[&[u8]],
) -> Result<(Vec<u8>, Response), std::io::Error> {
    let mut roots = RootCertStore::empty();
    roots.add(CertificateDer::from_pem_file(data("cert.pem")).expect("a certificate")).expect("a root");
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let builder = ClientConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()
        .expect("versions")
        .with_root_certificates(roots);
    let mut config = match client {
        None => builder.with_no_client_auth(),
        Some((cert, key)) => {
            let chain = vec![CertificateDer::from_pem_file(data(cert)).expect("a certificate")];
            let key = rustls::pki_types::PrivateKeyDer::from_pem_file(data(key)).expect("a key");
            builder.with_client_auth_cert(chain, key).expect("a certificate of a client")
        }
    };
    config.alpn_protocols = alpn.iter().map(|name| name.to_vec()).collect();
    let name = ServerName::try_from("localhost").expect("a name");
    let connection = ClientConnection::new(Arc::new(config), name).expect("a connection");
    let mut stream = StreamOwned::new(connection, connect(address));
    stream.write_all(&Request::get("/v1/maps").token(PHONE).bytes())?;
    stream.flush()?;
    // A refusal of TLS 1.3 arrives with the first read.
    let mut first = [0];
    std::io::Read::read_exact(&mut stream, &mut first)?;
    let protocol = stream.conn.alpn_protocol().unwrap_or_default().to_vec();
    let mut all = std::io::Read::chain(&first[..], stream);
    Ok((protocol, Response::read(&mut all)))
}

/// With client authorities, a client without a valid certificate is refused; one with a certificate still needs a
/// token. Replaced authorities apply to the next connection.
#[test]
fn client_certificates_are_required_if_configured() {
    let files = Files::new();
    let authorities = files.path("clients.pem");
    std::fs::copy(data("client-ca.pem"), &authorities).expect("copied");
    let mut options = with_tls(files.options(), "key.pem");
    options.tls.as_mut().expect("TLS").client_ca = Some(authorities.clone());
    let server = Running::start(options);
    let known = Some(("client.pem", "client-key.pem"));
    assert_eq!(as_client(server.address, known, &[]).expect("an answer").1.status, 200);
    as_client(server.address, None, &[]).expect_err("no certificate");
    as_client(server.address, Some(("cert.pem", "key.pem")), &[])
        .expect_err("a certificate of another issuer");

    std::fs::copy(data("cert.pem"), &authorities).expect("copied");
    server.handle.reload();
    as_client(server.address, known, &[]).expect_err("its authority is not trusted any more");
    std::fs::write(&authorities, "no certificate").expect("written");
    server.handle.reload();
    as_client(server.address, known, &[]).expect_err("a wrong file changes nothing");
    std::fs::copy(data("client-ca.pem"), &authorities).expect("copied");
    server.handle.reload();
    assert_eq!(as_client(server.address, known, &[]).expect("an answer").1.status, 200);
}

#[test]
fn alpn_selects_http_1_1() {
    let files = Files::new();
    let server = Running::start(with_tls(files.options(), "key.pem"));
    let both: [&[u8]; 2] = [b"h2", b"http/1.1"];
    for names in [&both[..], &both[1..]] {
        let (protocol, response) = as_client(server.address, None, names).expect("an answer");
        assert_eq!((protocol.as_slice(), response.status), (both[1], 200));
    }
    let (protocol, response) = as_client(server.address, None, &[]).expect("an answer");
    assert_eq!((protocol.is_empty(), response.status), (true, 200), "HTTP/1.1 without ALPN");
}
