//! A minimal HTTP client that can also send malformed requests, byte by byte over a plain socket.
#![allow(dead_code, unreachable_pub)] // each user takes its own part

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::time::Duration;

use serde_json::Value;

/// A request.
pub struct Request {
    pub head: String,
    pub body: Vec<u8>,
}

impl Request {
    pub fn get(path: &str) -> Self {
        Self { head: format!("GET {path} HTTP/1.1\r\nhost: test\r\n"), body: Vec::new() }
    }

    /// A request with any method and no body.
    pub fn with_method(method: &str, path: &str) -> Self {
        Self { head: format!("{method} {path} HTTP/1.1\r\nhost: test\r\n"), body: Vec::new() }
    }

    /// A request to localize a sealed query in the map `place`.
    pub fn localize(query: &[u8]) -> Self {
        Self::post("/v1/maps/place/localize", query).header("content-type", "application/x-protobuf")
    }

    pub fn post(path: &str, body: &[u8]) -> Self {
        let head = format!("POST {path} HTTP/1.1\r\nhost: test\r\ncontent-length: {}\r\n", body.len());
        Self { head, body: body.to_vec() }
    }

    pub fn header(self, name: &str, value: &str) -> Self {
        let Self { head, body } = self;
        Self { head: format!("{head}{name}: {value}\r\n"), body }
    }

    /// Adds a token, unless it is empty.
    pub fn token(self, token: &str) -> Self {
        if token.is_empty() { self } else { self.header("authorization", &format!("Bearer {token}")) }
    }

    /// Sends the request on a new connection.
    pub fn send(self, address: SocketAddr) -> Response {
        let mut stream = connect(address);
        let request = self.header("connection", "close");
        // A server that refuses may stop reading early; only its response matters.
        let _ = stream.write_all(&request.bytes());
        Response::read(&mut stream)
    }

    pub fn bytes(&self) -> Vec<u8> {
        [self.head.as_bytes(), b"\r\n", &self.body].concat()
    }
}

/// A connection with a read timeout, so that a missing response fails the test.
pub fn connect(address: SocketAddr) -> TcpStream {
    let stream = TcpStream::connect(address).expect("the server listens");
    stream.set_read_timeout(Some(Duration::from_secs(600))).expect("set");
    stream
}

/// Whether a response or the end of the connection has arrived.
pub fn has_data(stream: &TcpStream) -> bool {
    stream.set_nonblocking(true).expect("set");
    let peeked = stream.peek(&mut [0]);
    stream.set_nonblocking(false).expect("set");
    !matches!(peeked, Err(e) if e.kind() == std::io::ErrorKind::WouldBlock)
}

/// A response.
#[derive(Debug, Clone)]
pub struct Response {
    pub status: u16,
    pub head: String,
    pub body: Vec<u8>,
}

impl Response {
    /// Reads exactly one response with a `content-length`.
    pub fn read(stream: &mut impl Read) -> Self {
        Self::try_read(stream).expect("an answer")
    }

    /// `None` when the connection was closed without an answer.
    pub fn try_read(stream: &mut impl Read) -> Option<Self> {
        let mut head = Vec::new();
        let mut byte = [0];
        while !head.ends_with(b"\r\n\r\n") {
            match stream.read(&mut byte) {
                Ok(1) => head.push(byte[0]),
                Ok(_) => return None,
                Err(e) if e.kind() == std::io::ErrorKind::ConnectionReset => return None,
                Err(e) => panic!("no answer: {e}"),
            }
        }
        let head = String::from_utf8(head).expect("a head in ASCII");
        let status = head.get(9..12).and_then(|s| s.parse().ok()).expect("a status line");
        let mut response = Self { status, head, body: Vec::new() };
        let length = response.header("content-length").map_or(0, |n| n.parse().expect("a number"));
        response.body = vec![0; length];
        stream.read_exact(&mut response.body).expect("a whole body");
        Some(response)
    }

    pub fn header(&self, name: &str) -> Option<&str> {
        self.head.lines().skip(1).find_map(|line| {
            let (n, value) = line.split_once(':')?;
            n.eq_ignore_ascii_case(name).then(|| value.trim())
        })
    }

    pub fn json(&self) -> Value {
        serde_json::from_slice(&self.body).unwrap_or_else(|e| panic!("{e}: {self:?}"))
    }

    pub fn text(&self) -> String {
        String::from_utf8(self.body.clone()).expect("text")
    }

    /// Checks that this is a problem document (RFC 9457), and returns its name.
    pub fn problem(&self) -> String {
        assert_eq!(self.header("content-type"), Some("application/problem+json"), "{self:?}");
        let document = self.json();
        assert_eq!(document["status"], self.status, "{document}");
        assert!(document["title"].is_string() && document["detail"].is_string(), "{document}");
        let after = self.header("retry-after").map(|s| s.parse::<u64>().expect("whole seconds"));
        assert_eq!(document.get("retry_after").and_then(Value::as_u64), after, "{document}");
        let kind = document["type"].as_str().and_then(|kind| kind.strip_prefix("urn:veiloc:problem:"));
        kind.expect("a type of ours").to_owned()
    }
}
