//! HTTP/2: the same answers, and the same limits, as on HTTP/1.1.

use super::common;

use std::collections::BTreeSet;
use std::future::Future;
use std::io;
use std::net::SocketAddr;
use std::num::NonZeroUsize;
use std::pin::Pin;
use std::sync::{Arc, Mutex};
use std::task::{Context, Poll};

use bytes::Bytes;
use common::gate::{Gate, all_are_in};
use common::{Files, HOUR, OPERATOR, PHONE, Running, SECOND, eventually, tokens_file, truth};
use h2::client::SendRequest;
use http::{Request, StatusCode};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;
use tokio::task::JoinHandle;

/// A connection as a client has it.
struct Client {
    send: SendRequest<Bytes>,
    /// Ends with the connection.
    connection: JoinHandle<Result<(), h2::Error>>,
    /// All bytes that came.
    seen: Arc<Mutex<Vec<u8>>>,
}

struct Reply {
    status: StatusCode,
    body: Vec<u8>,
}

impl Client {
    /// With prior knowledge, on a plain connection.
    async fn connect(address: SocketAddr) -> Self {
        let seen = Arc::new(Mutex::new(Vec::new()));
        let stream = TcpStream::connect(address).await.expect("the server listens");
        let stream = Tapped { stream, seen: seen.clone() };
        let (send, connection) = h2::client::handshake(stream).await.expect("HTTP/2");
        let connection = tokio::spawn(connection);
        Self { send: send.ready().await.expect("ready"), connection, seen }
    }

    fn start(
        &mut self,
        request: Request<()>,
        body: &[u8],
    ) -> Result<(h2::client::ResponseFuture, h2::SendStream<Bytes>), h2::Error> {
        let (response, mut stream) = self.send.send_request(request, body.is_empty())?;
        if !body.is_empty() {
            stream.send_data(Bytes::copy_from_slice(body), true)?;
        }
        Ok((response, stream))
    }

    async fn ask(&mut self, request: Request<()>, body: &[u8]) -> Result<Reply, h2::Error> {
        self.send = self.send.clone().ready().await?;
        let (response, _stream) = self.start(request, body)?;
        whole(response).await
    }

    async fn localize(&mut self, query: &[u8], token: &str) -> Result<Reply, h2::Error> {
        self.ask(localize(token), query).await
    }

    async fn get(&mut self, path: &str) -> Result<Reply, h2::Error> {
        self.ask(Request::get(format!("http://here{path}")).body(()).expect("a request"), b"").await
    }
}

async fn whole(response: h2::client::ResponseFuture) -> Result<Reply, h2::Error> {
    let (head, mut stream) = response.await?.into_parts();
    let mut body = Vec::new();
    while let Some(data) = stream.data().await {
        let data = data?;
        stream.flow_control().release_capacity(data.len())?;
        body.extend_from_slice(&data);
    }
    Ok(Reply { status: head.status, body })
}

fn localize(token: &str) -> Request<()> {
    let request =
        Request::post("http://here/v1/maps/place/localize").header("content-type", "application/x-protobuf");
    request.header("authorization", format!("Bearer {token}")).body(()).expect("a request")
}

/// Keeps what comes.
struct Tapped {
    stream: TcpStream,
    seen: Arc<Mutex<Vec<u8>>>,
}

impl AsyncRead for Tapped {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let before = buffer.filled().len();
        let polled = Pin::new(&mut self.stream).poll_read(context, buffer);
        self.seen.lock().expect("not poisoned").extend_from_slice(&buffer.filled()[before..]);
        polled
    }
}

impl AsyncWrite for Tapped {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.stream).poll_write(context, bytes)
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }
}

/// Types and lengths of the frames among these bytes.
fn frames(mut bytes: &[u8]) -> Vec<(u8, usize)> {
    let mut frames = Vec::new();
    while let [a, b, c, kind, _, _, _, _, _, rest @ ..] = bytes {
        let length = usize::from(*a) << 16 | usize::from(*b) << 8 | usize::from(*c);
        frames.push((*kind, length));
        bytes = rest.get(length..).unwrap_or_default();
    }
    frames
}

const DATA: u8 = 0;
const HEADERS: u8 = 1;
const GOAWAY: u8 = 7;

fn run(test: impl Future<Output = ()>) {
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build();
    runtime.expect("a runtime").block_on(async {
        tokio::time::timeout(HOUR, test).await.expect("an end");
    });
}

#[test]
fn one_port_answers_both_versions_with_the_same() {
    run(async {
        let files = Files::new();
        let server = Running::start(files.options());
        let query = files.place.sealed(&truth());
        let mut client = Client::connect(server.address).await;
        let new = client.localize(&query, PHONE).await.expect("an answer");
        let old = server.localize(&query, PHONE);
        let pose = |body: &[u8]| {
            let mut document: serde_json::Value = serde_json::from_slice(body).expect("JSON");
            document["ms"].take();
            document
        };
        assert_eq!((new.status.as_u16(), pose(&new.body)), (old.status, pose(&old.body)));
        assert_eq!(client.localize(&query, "guess").await.expect("an answer").status, 401);
        assert_eq!(client.get("/nowhere").await.expect("an answer").status, 404);
        let most = client.send.current_max_send_streams();
        assert_eq!(most, 8, "streams at a time, as the service says it");
    });
}

/// L12 on HTTP/2: heads and bodies of all replies to queries are of one length each, the first time and again.
#[test]
fn all_replies_to_queries_have_one_length() {
    run(async {
        let files = Files::new();
        let server = Running::start(files.options());
        let mut client = Client::connect(server.address).await;
        let query = files.place.sealed(&truth());
        let doubtful = files.place.sealed_doubtfully();
        let negative = files.place.sealed_without_features();
        let elsewhere = Request::post("http://here/v1/maps/x/localize")
            .header("content-type", "application/x-protobuf")
            .header("authorization", format!("Bearer {PHONE}"))
            .body(())
            .expect("a request");
        let option = |name: &str, value: &str| {
            let mut request = localize(PHONE);
            request.headers_mut().insert(
                http::HeaderName::from_bytes(name.as_bytes()).expect("a name"),
                value.parse().expect("a value"),
            );
            request
        };
        let mut lengths: BTreeSet<Vec<(u8, usize)>> = BTreeSet::new();
        let mut statuses = BTreeSet::new();
        for _ in 0..2 {
            for (request, body) in [
                (localize(PHONE), &query[..]),
                (localize(PHONE), &doubtful),
                (option("veiloc-trusted-only", "true"), &doubtful),
                (localize(PHONE), &negative),
                (localize(PHONE), &query[..query.len() / 2]),
                (localize("guess"), &query),
                (elsewhere.clone(), &query),
                (option("content-type", "a/b"), &query),
                (option("veiloc-near", "x"), &query),
                (option("accept", "application/x-protobuf"), &query),
            ] {
                client.seen.lock().expect("not poisoned").clear();
                let reply = client.ask(request, body).await.expect("an answer");
                statuses.insert(reply.status.as_u16());
                let seen = client.seen.lock().expect("not poisoned").clone();
                let mut told: Vec<_> =
                    frames(&seen).into_iter().filter(|(kind, _)| [DATA, HEADERS].contains(kind)).collect();
                // A last frame without content says only that this was all.
                told.retain(|(_, length)| *length > 0);
                lengths.insert(told);
            }
        }
        assert_eq!(statuses, [200, 400, 401, 404, 415, 422].into(), "every kind of reply was there");
        assert_eq!(lengths.len(), 1, "{lengths:?}");
    });
}

/// As soon as the service says that it will stop, its clients are told to go elsewhere, and what they asked is answered.
#[test]
fn clients_are_told_to_leave_and_answered_first() {
    run(async {
        let files = Files::new();
        let mut options = files.open_options();
        options.workers = NonZeroUsize::MIN;
        let gate = Gate::before_the_map_of(&files, &mut options);
        options.timeouts.drain = HOUR;
        let server = Running::start(options);
        let query = files.place.sealed(&truth());
        let mut idle = Client::connect(server.address).await;
        assert_eq!(idle.get("/readyz").await.expect("an answer").status, 200);
        let mut busy = Client::connect(server.address).await;
        let (first, _one) = busy.start(localize("none"), &query).expect("sent");
        let (second, _two) = busy.start(localize("none"), &query).expect("sent");
        all_are_in(&server, 1, 1);
        server.handle.stop();
        idle.connection.await.expect("ends").expect("in order");
        assert!(frames(&idle.seen.lock().expect("not poisoned")).iter().any(|(kind, _)| *kind == GOAWAY));
        gate.open();
        for response in [first, second] {
            assert_eq!(whole(response).await.expect("an answer").status, 200);
        }
        busy.connection.await.expect("ends").expect("in order");
        // Who comes now is still answered: balancers need their time.
        let mut late = Client::connect(server.address).await;
        assert_eq!(late.get("/readyz").await.expect("an answer").status, 503);
        server.handle.stop_now();
        assert_eq!(tokio::task::spawn_blocking(|| server.stop()).await.expect("joined").answered, 3);
    });
}

#[test]
fn a_connection_ends_at_its_age_and_when_nothing_goes_on() {
    run(async {
        let files = Files::new();
        // Without a token it is unknown; with one it lives longer; idle it ends in any case.
        for (token, unknown, life, write) in [
            ("none", 5 * SECOND, HOUR, HOUR),
            (PHONE, 5 * SECOND, 10 * SECOND, HOUR),
            (PHONE, HOUR, HOUR, 5 * SECOND),
        ] {
            let mut options = files.options();
            options.timeouts.unknown_life = unknown;
            options.timeouts.life = life;
            options.timeouts.write = write;
            let server = Running::start_paused(options);
            let mut client = Client::connect(server.address).await;
            let list = Request::get("http://here/v1/maps").header("authorization", format!("Bearer {token}"));
            let reply = client.ask(list.body(()).expect("a request"), b"").await.expect("an answer");
            assert_eq!(reply.status, if token == PHONE { 200 } else { 401 });
            let Client { send, connection, seen } = client;
            server.pass_until(SECOND, "the end of the connection", || connection.is_finished());
            connection.await.expect("ends").expect("in order");
            assert!(frames(&seen.lock().expect("not poisoned")).iter().any(|(kind, _)| *kind == GOAWAY));
            drop(send);
        }
    });
}

/// A request that is taken back is not computed any more; the connection and its other requests go on.
#[test]
fn a_request_that_is_taken_back_costs_nothing_more() {
    run(async {
        let files = Files::new();
        let mut options = files.options();
        options.workers = NonZeroUsize::MIN;
        options.localize.pose.fixed_hypotheses = Some(usize::MAX);
        let server = Running::start(options);
        let query = files.place.sealed(&truth());
        let mut client = Client::connect(server.address).await;
        let (response, mut stream) = client.start(localize(PHONE), &query).expect("sent");
        let busy = |n: u32| server.metric("veiloc_workers_busy") == Some(f64::from(n));
        eventually("work", || busy(1));
        assert_eq!(client.get("/healthz").await.expect("beside it").status, 200);
        stream.send_reset(h2::Reason::CANCEL);
        drop(response);
        eventually("an end of it", || busy(0));
        assert_eq!(client.get("/healthz").await.expect("after it").status, 200);
        // Nor is it when the client goes without a word.
        let (_response, _stream) = client.start(localize(PHONE), &query).expect("sent");
        eventually("work", || busy(1));
        client.connection.abort();
        eventually("an end of it", || busy(0));
    });
}

/// Streams that are begun and taken back at once, by the thousand: the connection is closed, and others are answered.
#[test]
fn who_floods_is_closed_and_others_are_answered() {
    run(async {
        let files = Files::new();
        let server = Running::start(files.options());
        let query = files.place.sealed(&truth());
        let mut flood = Client::connect(server.address).await;
        let mut sent = 0;
        let broken = loop {
            match flood.send.clone().ready().await {
                Ok(send) => flood.send = send,
                Err(error) => break error,
            }
            match flood.start(localize("guess"), b"") {
                Ok((_, mut stream)) => stream.send_reset(h2::Reason::CANCEL),
                Err(error) => break error,
            }
            sent += 1;
            assert!(sent < 1_000_000, "nobody minds");
        };
        assert!(broken.is_go_away() || broken.is_io() || broken.is_reset(), "{broken:?}");
        let mut other = Client::connect(server.address).await;
        assert_eq!(other.localize(&query, PHONE).await.expect("an answer").status, 200);
        eventually("no connection but the others'", || server.metric("veiloc_connections") == Some(1.0));
    });
}

#[test]
fn a_head_that_is_too_long_is_refused() {
    run(async {
        let files = Files::new();
        let server = Running::start(files.options());
        let mut client = Client::connect(server.address).await;
        let request =
            Request::get("http://here/healthz").header("x", "y".repeat(100_000)).body(()).expect("a request");
        match client.ask(request, b"").await {
            Ok(reply) => assert_eq!(reply.status, 431),
            Err(error) => assert!(error.is_remote() || error.is_io(), "{error:?}"),
        }
        assert_eq!(server.get("/healthz", "").status, 200);
    });
}

/// Who opens all the streams it may waits longer, and nobody else does.
#[test]
fn turns_are_as_fair_as_between_connections() {
    run(async {
        let files = Files::new();
        std::fs::write(
            files.path("tokens"),
            tokens_file(&[(PHONE, ""), ("other", ""), (OPERATOR, "operator")]),
        )
        .expect("written");
        let mut options = files.options();
        options.workers = NonZeroUsize::MIN;
        options.queue = NonZeroUsize::new(8).expect("not zero");
        let gate = Gate::before_the_map_of(&files, &mut options);
        let server = Running::start(options);
        let query = files.place.sealed(&truth());
        let mut greedy = Client::connect(server.address).await;
        let mut asked = vec![greedy.start(localize(PHONE), &query).expect("sent")];
        all_are_in(&server, 1, 0);
        for _ in 0..7 {
            greedy.send = greedy.send.clone().ready().await.expect("room for a stream");
            asked.push(greedy.start(localize(PHONE), &query).expect("sent"));
        }
        // A lane alone may hold half of the queue.
        all_are_in(&server, 1, 4);
        let mut modest = Client::connect(server.address).await;
        let (answer, _stream) = modest.start(localize("other"), &query).expect("sent");
        all_are_in(&server, 1, 5);
        // The one at work, and one turn of each lane.
        gate.let_through(3);
        assert_eq!(whole(answer).await.expect("an answer").status, 200);
        gate.open();
        let mut statuses = Vec::new();
        for (response, _stream) in asked {
            statuses.push(whole(response).await.expect("an answer").status.as_u16());
        }
        statuses.sort_unstable();
        assert_eq!(statuses, [200, 200, 200, 200, 200, 503, 503, 503]);
    });
}
