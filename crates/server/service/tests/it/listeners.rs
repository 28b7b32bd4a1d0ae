//! Several listeners at once, including a Unix socket.
#![cfg(unix)]

use super::common;

use std::io::Write as _;
use std::num::NonZeroUsize;
use std::os::unix::fs::PermissionsExt as _;
use std::os::unix::net::UnixStream;

use common::http::{Request, Response, connect};
use common::{Files, PHONE, Running, truth};
use veiloc_service::{ListenAddress, Server, ServerError, TlsFiles};

fn ask(stream: &mut UnixStream, request: &Request) -> Option<Response> {
    stream.write_all(&request.bytes()).ok()?;
    Response::try_read(stream)
}

#[test]
fn all_listeners_answer_and_the_socket_is_removed() {
    let files = Files::new();
    let path = files.path("veiloc.sock");
    let mut options = files.options();
    options.listen.push("127.0.0.1:0".parse().expect("an address"));
    options.listen.push(ListenAddress::Unix(path.clone()));
    options.socket_mode = 0o600;
    let server = Running::start(options);
    let [ListenAddress::Tcp(one), ListenAddress::Tcp(two), ListenAddress::Unix(socket)] =
        &server.listening.addresses[..]
    else {
        panic!("{:?}", server.listening)
    };
    assert_eq!((socket, one.port() == two.port()), (&path, false));
    let request = Request::localize(&files.scene.sealed(&truth())).token(PHONE);
    for address in [one, two] {
        let mut stream = connect(*address);
        stream.write_all(&request.bytes()).expect("written");
        assert_eq!(Response::read(&mut stream).status, 200);
    }
    let mut stream = UnixStream::connect(&path).expect("it listens");
    assert_eq!(ask(&mut stream, &request).expect("an answer").status, 200);
    assert_eq!(std::fs::metadata(&path).expect("a socket").permissions().mode() & 0o777, 0o600);
    assert_eq!(server.stop().given_up, 0);
    assert!(ask(&mut stream, &request).is_none() && !path.exists());
}

/// A Unix socket is for a proxy: it uses no TLS, and the limit per address does not apply.
#[test]
fn unix_socket_is_plain_and_without_limit_per_address() {
    let files = Files::new();
    let path = files.path("veiloc.sock");
    let mut options = files.open_options();
    options.listen.push(ListenAddress::Unix(path.clone()));
    options.connections = NonZeroUsize::new(20).expect("not zero");
    options.connections_per_address = NonZeroUsize::MIN;
    options.tls =
        Some(TlsFiles { cert: common::data("cert.pem"), key: common::data("key.pem"), client_ca: None });
    let server = Running::start(options);
    let mut streams: Vec<_> = (0..10).map(|_| UnixStream::connect(&path).expect("it listens")).collect();
    for _ in 0..2 {
        for stream in &mut streams {
            assert_eq!(ask(stream, &Request::get("/healthz")).expect("still there").status, 200);
        }
    }
    drop(server);
}

#[test]
fn unusable_addresses_are_named() {
    let files = Files::new();
    std::fs::write(files.path("file"), "kept").expect("written");
    let taken = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = taken.local_addr().expect("an address");
    let runtime = tokio::runtime::Runtime::new().expect("a runtime");
    for (listen, part) in [
        (ListenAddress::Tcp(address), "in use"),
        (ListenAddress::Unix(files.path("file")), "no socket"),
        (ListenAddress::Unix(files.path("none/v.sock")), "none/v.sock"),
        (ListenAddress::Unix(files.path(&"x".repeat(200))), "xxx"),
    ] {
        let mut options = files.options();
        options.listen.push(listen);
        let error = runtime.block_on(Server::bind(options)).err().expect("refused");
        assert!(matches!(error, ServerError::Listen { .. }), "{error:?}");
        assert!(error.to_string().contains(part) && error.to_string().contains("--listen"), "{error}");
    }
    assert_eq!(std::fs::read_to_string(files.path("file")).expect("a file"), "kept");
    let mut options = files.options();
    options.listen.clear();
    assert!(matches!(runtime.block_on(Server::bind(options)), Err(ServerError::NoListener)));
}
