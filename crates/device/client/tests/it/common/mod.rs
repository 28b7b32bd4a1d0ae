//! A service with scripted responses, which records its requests.
#![allow(dead_code, unreachable_pub)] // each test program uses its own part

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::TcpListener;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use veiloc_client::{Client, ClientOptions, SealedQuery};

/// A recorded request.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedRequest {
    /// First line and headers, lower case.
    pub head: String,
    pub body: Vec<u8>,
}

/// Answers one connection after another with the next response; an empty one closes the connection.
pub struct Service {
    pub url: String,
    requests: Arc<Mutex<Vec<RecordedRequest>>>,
}

impl Service {
    pub fn replying(replies: Vec<Vec<u8>>) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let url = format!("http://{}", listener.local_addr().expect("an address"));
        let requests = Arc::new(Mutex::new(Vec::new()));
        let recorded = requests.clone();
        std::thread::spawn(move || {
            for reply in replies {
                let (mut stream, _) = listener.accept().expect("a client");
                let mut reader = BufReader::new(stream.try_clone().expect("a clone"));
                let (mut head, mut length, mut line) = (String::new(), 0, String::new());
                while reader.read_line(&mut line).expect("a line") > 2 {
                    let lower = line.to_ascii_lowercase();
                    if let Some(n) = lower.strip_prefix("content-length:") {
                        length = n.trim().parse().expect("a number");
                    }
                    head += &lower;
                    line.clear();
                }
                let mut body = vec![0; length];
                reader.read_exact(&mut body).expect("a body");
                recorded.lock().expect("not poisoned").push(RecordedRequest { head, body });
                // A client that has read enough may close the connection; this is not an error.
                let _ = stream.write_all(&reply);
            }
        });
        Self { url, requests }
    }

    /// All requests so far.
    pub fn requests(&self) -> Vec<RecordedRequest> {
        self.requests.lock().expect("not poisoned").clone()
    }

    pub fn client(&self) -> Client {
        Client::new(&self.url, Some("the-token"), quick()).expect("a client")
    }
}

/// Options without pauses between retries and with generous limits.
pub fn quick() -> ClientOptions {
    let mut options = ClientOptions::default();
    options.sleep = Arc::new(|_| ());
    options.timeout = Duration::from_secs(600);
    options.connect_timeout = options.timeout;
    options
}

/// The same options, with the list of requested pauses.
pub fn recording() -> (ClientOptions, Arc<Mutex<Vec<Duration>>>) {
    let mut options = quick();
    let pauses = Arc::new(Mutex::new(Vec::new()));
    let recorded = pauses.clone();
    options.sleep = Arc::new(move |pause| recorded.lock().expect("not poisoned").push(pause));
    (options, pauses)
}

/// A response with these headers and this body, closed after it.
pub fn reply(status: &str, headers: &[(&str, &str)], body: &[u8]) -> Vec<u8> {
    let mut head = format!("HTTP/1.1 {status}\r\nconnection: close\r\ncontent-length: {}\r\n", body.len());
    for (name, value) in headers {
        head = head + name + ": " + value + "\r\n";
    }
    [head.as_bytes(), b"\r\n", body].concat()
}

pub fn protobuf(body: &[u8]) -> Vec<u8> {
    reply("200 OK", &[("content-type", "application/x-protobuf")], body)
}

/// An error response in the service's format.
pub fn problem(status: &str, name: &str, headers: &[(&str, &str)]) -> Vec<u8> {
    let number = status.split(' ').next().unwrap_or_default();
    let body = format!(
        r#"{{"type":"urn:veiloc:problem:{name}","title":"Title of {name}","status":{number},"detail":"why"}}"#
    );
    reply(status, headers, (body + &" ".repeat(500)).as_bytes())
}

/// A known-answer file of the wire format.
pub fn known(name: &str) -> Vec<u8> {
    let path = format!("{}/../../core/protocol/tests/data/{name}", env!("CARGO_MANIFEST_DIR"));
    std::fs::read(path).expect("the known answer")
}

pub fn query() -> SealedQuery {
    SealedQuery::decode(&known("dcl.vquery")).expect("a known answer")
}
