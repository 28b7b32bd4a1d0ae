//! L12: the length of a response to a query is independent of its content, measured on the wire, within TLS and
//! outside.

use super::common;

use std::collections::{BTreeMap, BTreeSet};
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::num::{NonZeroU32, NonZeroUsize};
use std::sync::{Arc, Mutex};

use common::gate::Gate;
use common::http::{Request, connect, has_data};
use common::{Files, ManualClock, PHONE, Running, SECOND, TestScene, data, eventually, truth};
use rustls::pki_types::pem::PemObject as _;
use rustls::pki_types::{CertificateDer, ServerName};
use rustls::{ClientConfig, ClientConnection, RootCertStore, StreamOwned};
use veiloc_protocol::Answer;
use veiloc_service::{ServerOptions, TlsFiles};

/// All formats of answers.
const FORMS: [&str; 2] = ["application/json", "application/x-protobuf"];

/// Requests that get a trusted pose, a doubtful one, and each refusal that a query can get.
struct Cases {
    files: Files,
    requests: Vec<(&'static str, Request)>,
}

impl Cases {
    fn new(accept: &str) -> Self {
        let files = Files::new();
        let query = files.scene.sealed(&truth());
        let localize = |body: &[u8]| Request::localize(body).token(PHONE).header("accept", accept);
        let mut version = query.clone();
        version[1] = 9;
        let other_type =
            Request::post("/v1/maps/place/localize", &query).token(PHONE).header("content-type", "a/b");
        let other_map = Request::post("/v1/maps/x/localize", &query).token(PHONE);
        let requests = vec![
            ("trusted", localize(&query)),
            ("withheld", localize(&files.scene.sealed_with_doubts()).header("veiloc-trusted-only", "true")),
            ("doubtful", localize(&files.scene.sealed_with_doubts())),
            ("not-localized", localize(&files.scene.sealed_without_features())),
            ("bad-option", localize(&query).header("veiloc-near", "x")),
            ("malformed-query", localize(&query[..query.len() / 2])),
            ("unsupported-version", localize(&version)),
            ("wrong-profile", localize(&TestScene::new(2).sealed(&truth()))),
            ("too-large", localize(&vec![0; 600_000])),
            ("unauthenticated", Request::localize(&query).header("accept", accept)),
            ("media-type", other_type),
            ("unknown-map", other_map.header("content-type", "application/x-protobuf")),
        ];
        Self { files, requests }
    }

    fn options(&self) -> ServerOptions {
        self.files.options()
    }
}

/// Sends a request on a connection that closes after it.
fn send(address: SocketAddr, request: Request) -> TcpStream {
    let mut stream = connect(address);
    let _ = stream.write_all(&request.header("connection", "close").bytes());
    stream
}

/// All bytes of the response, head and body.
fn bytes_of(address: SocketAddr, request: Request) -> Vec<u8> {
    rest(&mut send(address, request))
}

fn rest(stream: &mut TcpStream) -> Vec<u8> {
    let mut bytes = Vec::new();
    stream.read_to_end(&mut bytes).expect("a whole reply");
    bytes
}

/// The kind of the response.
fn kind_of(bytes: &[u8]) -> String {
    let (head, body) = split(bytes);
    if !head.starts_with("HTTP/1.1 200") {
        let document: serde_json::Value = serde_json::from_slice(body).expect("a refusal is JSON");
        return document["type"].as_str().expect("a type").replace("urn:veiloc:problem:", "");
    }
    let (trusted, has_pose) = if head.contains("protobuf") {
        let answer = Answer::decode(body).expect("an answer");
        (answer.trusted(), answer.pose.is_some())
    } else {
        let document = serde_json::from_slice::<serde_json::Value>(body).expect("JSON");
        let pose = ["center", "position"].iter().any(|field| document.get(field).is_some());
        (document["state"] == "trusted" || document.get("geopose").is_some(), pose)
    };
    match (trusted, has_pose) {
        (true, true) => "trusted",
        (false, true) => "doubtful",
        (false, false) => "withheld",
        (true, false) => panic!("a trusted pose was withheld"),
    }
    .to_owned()
}

fn split(bytes: &[u8]) -> (&str, &[u8]) {
    let end = bytes.windows(4).position(|w| w == b"\r\n\r\n").expect("a head") + 4;
    (std::str::from_utf8(&bytes[..end]).expect("ASCII"), &bytes[end..])
}

#[test]
fn responses_to_queries_have_equal_length() {
    for form in FORMS {
        let cases = Cases::new(form);
        let server = Running::start(cases.options());
        let mut ids = BTreeSet::new();
        let mut lengths: BTreeMap<usize, Vec<String>> = BTreeMap::new();
        for (what, request) in cases.requests {
            let bytes = bytes_of(server.address, request);
            assert_eq!(kind_of(&bytes), what, "{form}");
            let (head, body) = split(&bytes);
            assert!(head.contains("no-transform"), "{head}");
            let id = head.split("veiloc-request-id: ").nth(1).and_then(|rest| rest.get(..32)).expect("an id");
            assert!(ids.insert(id.to_owned()), "{id} comes twice");
            assert_eq!(body.len(), Answer::PADDED_BYTES, "{form}, {what}");
            lengths.entry(bytes.len()).or_default().push(what.to_owned());
        }
        assert_eq!(lengths.len(), 1, "{form}: {lengths:?}");
    }
}

/// Refusals that depend on load and time.
#[test]
fn refusals_under_load_have_equal_length() {
    let files = Files::new();
    let query = files.scene.sealed(&truth());
    let ask = |server: &Running| bytes_of(server.address, Request::localize(&query).token(PHONE));
    let mut options = files.options();
    options.rate.per_second = NonZeroU32::MIN;
    options.rate.burst = NonZeroU32::MIN;
    options.clock = ManualClock::new().clock();
    let server = Running::start(options);
    let answered = ask(&server);
    assert_eq!(kind_of(&answered), "trusted");
    let limited = ask(&server);
    assert_eq!(kind_of(&limited), "rate-limited");

    let mut options = files.options();
    options.timeouts.localize = 10 * SECOND;
    options.localize.pose.fixed_hypotheses = Some(usize::MAX);
    let server = Running::start_paused(options);
    let mut stream = send(server.address, Request::localize(&query).token(PHONE));
    server.pass_until(SECOND, "an answer", || has_data(&stream));
    let late = rest(&mut stream);
    assert_eq!(kind_of(&late), "timed-out");

    let mut options = files.options();
    options.threads = NonZeroUsize::MIN;
    options.queue = NonZeroUsize::MIN;
    let gate = Gate::install(&mut options);
    let server = Running::start(options);
    let mut streams: Vec<TcpStream> =
        (0..12).map(|_| send(server.address, Request::localize(&query).token(PHONE))).collect();
    // One query is running and one is queued.
    eventually("refusals", || streams.iter().filter(|stream| has_data(stream)).count() >= 10);
    gate.open();
    let replies: Vec<Vec<u8>> = streams.iter_mut().map(rest).collect();
    assert!(replies.iter().any(|bytes| kind_of(bytes) == "queue-full"));
    for bytes in replies.iter().chain([&limited, &late]) {
        assert_eq!(bytes.len(), answered.len(), "{}", kind_of(bytes));
    }
}

/// A socket that records incoming bytes: the view of an observer of the network.
struct RecordingSocket {
    stream: TcpStream,
    seen: Arc<Mutex<Vec<u8>>>,
}

impl Read for RecordingSocket {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let count = self.stream.read(buffer)?;
        self.seen.lock().expect("not poisoned").extend_from_slice(&buffer[..count]);
        Ok(count)
    }
}

impl Write for RecordingSocket {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.stream.write(bytes)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.stream.flush()
    }
}

/// Lengths of the TLS records of a response, without those of the handshake.
fn records(address: SocketAddr, request: Request) -> (Vec<usize>, String) {
    let mut roots = RootCertStore::empty();
    roots.add(CertificateDer::from_pem_file(data("cert.pem")).expect("a certificate")).expect("a root");
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let config = ClientConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()
        .expect("versions")
        .with_root_certificates(roots)
        .with_no_client_auth();
    let name = ServerName::try_from("localhost").expect("a name");
    let connection = ClientConnection::new(Arc::new(config), name).expect("a connection");
    let seen = Arc::new(Mutex::new(Vec::new()));
    let mut stream =
        StreamOwned::new(connection, RecordingSocket { stream: connect(address), seen: seen.clone() });
    let mut ask = |request: Request| {
        let _ = stream.write_all(&request.bytes());
        common::http::Response::read(&mut stream)
    };
    // A first response, after the handshake and its session tickets.
    assert_eq!(ask(Request::get("/healthz")).status, 200);
    seen.lock().expect("not poisoned").clear();
    let response = ask(request);
    let kind = match response.status {
        200 => response.json()["state"].as_str().expect("a state").to_owned(),
        _ => response.problem(),
    };
    let bytes = seen.lock().expect("not poisoned").clone();
    let mut lengths = Vec::new();
    let mut rest = &bytes[..];
    while let [_, _, _, high, low, ..] = rest {
        let length = usize::from(u16::from_be_bytes([*high, *low]));
        lengths.push(length);
        rest = rest.get(5 + length..).expect("whole records");
    }
    (lengths, kind)
}

#[test]
fn tls_records_of_responses_have_equal_lengths() {
    let cases = Cases::new("application/json");
    let mut options = cases.options();
    options.tls = Some(TlsFiles { cert: data("cert.pem"), key: data("key.pem"), client_ca: None });
    let server = Running::start(options);
    let mut first = None;
    for (what, request) in cases.requests {
        let (lengths, kind) = records(server.address, request);
        let expected = match what {
            "withheld" => "doubtful",
            other => other,
        };
        assert_eq!(kind, expected);
        assert!(lengths.iter().sum::<usize>() > Answer::PADDED_BYTES, "{lengths:?}");
        let first = first.get_or_insert_with(|| lengths.clone());
        assert_eq!(*first, lengths, "{what}");
    }
}
