//! A gateway and workers: the poses are the same as without them, also when workers die, reply invalidly or are silent.

use super::common;

use std::io::{Read as _, Write as _};
use std::net::TcpListener;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use common::service::http::Request;
use common::service::{Running, truth};
use common::{
    GATEWAY, MAP, PublishedMap, STEP_TIMEOUT, TestGateway, eventually, localize_locally, region, url_of,
    without_times,
};
use tokio::task::block_in_place;
use veiloc_cluster::{ClusterError, WorkerAccess, Workers};
use veiloc_service::auth::{Lane, TokenKey};
use veiloc_service::telemetry::GatewayCounts;
use veiloc_service::{
    BodyKind, DecodedRequest, LocalizeFailure, RemoteBackend as _, RemoteMap, ServerOptions,
};

/// A worker that is always ready, and whose response to queries the test defines; `None`: it stays silent.
struct FakeWorker {
    url: String,
    requests: Arc<Mutex<Vec<Received>>>,
}

/// A request to a fake worker.
#[derive(Clone)]
struct Received {
    head: String,
    body: Vec<u8>,
}

impl FakeWorker {
    fn start(respond: impl Fn() -> Option<Vec<u8>> + Send + Sync + 'static) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let url = format!("http://{}", listener.local_addr().expect("bound"));
        let requests = Arc::new(Mutex::new(Vec::new()));
        let (seen, respond) = (requests.clone(), Arc::new(respond));
        std::thread::spawn(move || {
            for stream in listener.incoming() {
                let (mut stream, seen, respond) = (stream.expect("a client"), seen.clone(), respond.clone());
                std::thread::spawn(move || {
                    let (mut head, mut byte) = (Vec::new(), [0]);
                    while !head.ends_with(b"\r\n\r\n") {
                        match stream.read(&mut byte) {
                            Ok(1) => head.push(byte[0]),
                            _ => return,
                        }
                    }
                    let head = String::from_utf8(head).expect("a head").to_lowercase();
                    let length = head.lines().find_map(|line| line.strip_prefix("content-length: "));
                    let mut body = vec![0; length.map_or(0, |length| length.parse().expect("a number"))];
                    stream.read_exact(&mut body).expect("a body");
                    let response = if head.starts_with("get /readyz") {
                        Some(http(200, "text/plain", b"ready\n"))
                    } else {
                        seen.lock().expect("whole").push(Received { head, body });
                        respond()
                    };
                    match response {
                        Some(response) => drop(stream.write_all(&response)),
                        // Until the gateway closes the connection.
                        None => drop(stream.read(&mut byte)),
                    }
                });
            }
        });
        Self { url, requests }
    }

    fn received(&self) -> Vec<Received> {
        self.requests.lock().expect("whole").clone()
    }
}

fn http(status: u16, media: &str, body: &[u8]) -> Vec<u8> {
    let length = body.len();
    let head = format!(
        "HTTP/1.1 {status} X\r\ncontent-type: {media}\r\ncontent-length: {length}\r\nconnection: close\r\n\r\n"
    );
    [head.as_bytes(), body].concat()
}

fn refusal(status: u16, kind: &str) -> Vec<u8> {
    let body = format!(
        "{{\"type\":\"urn:veiloc:problem:{kind}\",\"title\":\"\",\"status\":{status},\"detail\":\"\",\"retry_after\":7}}"
    );
    http(status, "application/problem+json", body.as_bytes())
}

#[tokio::test(flavor = "multi_thread")]
async fn pose_equals_that_of_the_map_bit_for_bit() {
    let published = PublishedMap::new(10);
    let folder = published.folder();
    assert_eq!(folder.manifest().regions.len(), 1);
    let worker = published.worker("worker");
    let gateway = TestGateway::start(&published, vec![url_of(&worker)]).await;
    let (whole, only) = (published.map(10), region(&folder, 0));
    for query in published.queries(6) {
        let answer = without_times(gateway.ask(&query).await.expect("a pose"));
        assert!(answer.trusted());
        assert_eq!(answer, without_times(localize_locally(&only, &query).expect("a pose")));
        // A region stores rounded covariances of its points; the pose equals that of the whole map.
        let (answer, whole) = (
            answer.pose.expect("answer"),
            localize_locally(&whole, &query).expect("a pose").pose.expect("answer"),
        );
        assert_eq!((answer.rotation, answer.translation), (whole.rotation, whole.translation));
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn trusted_pose_with_highest_evidence_wins() {
    let published = PublishedMap::new(4);
    let folder = published.folder();
    let count = folder.manifest().regions.len();
    assert!(count >= 3, "{count} regions");
    let workers = [published.worker("a"), published.worker("b")];
    let gateway = TestGateway::start(&published, workers.iter().map(url_of).collect()).await;
    for query in published.queries(6) {
        let answer = without_times(gateway.ask(&query).await.expect("a pose"));
        let index = folder.open_index(veiloc_map::MapMemory::Copied).expect("an index");
        let DecodedRequest::Query(sealed) = DecodedRequest::decode(BodyKind::Query, &query).expect("sealed")
        else {
            panic!("one")
        };
        let ranked = index.rank(sealed.global().expect("rows have one"), 10);
        let best = ranked[0].held as f64;
        let searched = ranked.iter().take(3).filter(|region| region.held as f64 >= 0.75 * best);
        let given =
            searched.map(|ranked| localize_locally(&region(&folder, ranked.region), &query).expect("a pose"));
        let expected =
            given.filter(|answer| answer.trusted()).max_by(|a, b| a.log_evidence.total_cmp(&b.log_evidence));
        assert_eq!(answer, without_times(expected.expect("trusted")));
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn sessions_are_localized() {
    let published = PublishedMap::new(10);
    let worker = published.worker("worker");
    let gateway = TestGateway::start(&published, vec![url_of(&worker)]).await;
    let frame = |pose| veiloc_protocol::SealedFrame {
        query: veiloc_protocol::SealedQuery::decode(&published.query(&pose)).expect("sealed"),
        cam_from_rig: veiloc_geometry::CameraFromRig::from_quaternion([1.0, 0.0, 0.0, 0.0], [0.0; 3])
            .expect("a pose"),
        rotation_sd_deg: 0.0,
        translation_sd: 0.0,
    };
    let bytes = veiloc_protocol::RigMessage { frames: vec![frame(truth())] }.encode();
    let decoded = || DecodedRequest::decode(BodyKind::Rig, &bytes).expect("a session");
    let options = veiloc_localization::LocalizeOptions::default();
    let expected = decoded().localize(&region(&published.folder(), 0), &options, 0.0).expect("a pose");
    let mut request = gateway.request(&published.query(&truth()), STEP_TIMEOUT);
    (request.decoded, request.bytes) = (decoded(), bytes.clone());
    assert_eq!(
        without_times(gateway.gateway.localize(request).await.expect("a pose")),
        without_times(expected)
    );
}

/// Options of a service that is a gateway.
fn gateway_options(gateway: &TestGateway) -> ServerOptions {
    let mut options = ServerOptions::new(Vec::new());
    options.listen = vec!["127.0.0.1:0".parse().expect("an address")];
    options.answer_quantum = Duration::ZERO;
    let backend = Arc::new(gateway.gateway.clone());
    options.remote_maps = vec![RemoteMap { name: MAP.to_owned(), backend }];
    options
}

#[tokio::test(flavor = "multi_thread")]
async fn http_answers_equal_those_of_a_local_map() {
    let published = PublishedMap::new(10);
    let worker = published.worker("worker");
    let gateway = TestGateway::start(&published, vec![url_of(&worker)]).await;
    let (query, other) = (published.query(&truth()), common::service::TestScene::new(5).sealed(&truth()));
    let featureless = published.scene.sealed_without_features();
    let server = block_in_place(|| Running::start(gateway_options(&gateway)));
    let path = format!("/v1/maps/{MAP}/localize");
    let ask = |query: &[u8]| {
        let request = Request::post(&path, query).header("content-type", "application/x-protobuf");
        block_in_place(|| request.send(server.address))
    };
    let answers = [&query, &other, &featureless, &b"no query".to_vec()].map(|query| ask(query));
    assert_eq!(answers.each_ref().map(|answer| answer.status), [200, 409, 422, 400]);
    assert!(answers.iter().all(|answer| answer.body.len() == 4096), "lengths must be equal");
}

/// A second request has the bytes that the device sealed (rule L7), and no worker learns a token of a client (L8).
#[tokio::test(flavor = "multi_thread")]
async fn all_requests_contain_the_same_sealed_bytes() {
    let published = PublishedMap::new(10);
    let worker = published.worker("worker");
    let fake = FakeWorker::start(|| Some(refusal(500, "broken")));
    let gateway = TestGateway::start(&published, vec![fake.url.clone(), url_of(&worker)]).await;
    let (query, key) = (published.query(&truth()), TokenKey::of_token(b"a token"));
    while fake.received().is_empty() {
        let mut request = gateway.request(&query, STEP_TIMEOUT);
        request.client = Some(key);
        gateway.gateway.localize(request).await.expect("a pose");
    }
    for Received { head, body } in fake.received() {
        assert_eq!(body, query);
        let region = published.region(0);
        let line = |line: String| assert!(head.contains(&format!("\r\n{line}\r\n")), "{line} in {head}");
        assert!(
            head.starts_with(&format!("post /v1/maps/{MAP}/regions/{region}/localize http/1.1")),
            "{head}"
        );
        line(format!("veiloc-region: {region}"));
        line(format!("veiloc-client: {}", Lane::of(&key).hex()));
        line(format!("authorization: bearer {GATEWAY}"));
        assert!(head.contains("\r\ntraceparent: 00-"), "{head}");
        assert!(Lane::of(&key).key() != key);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn invalid_replies_are_never_used() {
    let published = PublishedMap::new(10);
    let query = published.query(&truth());
    type InvalidReply = fn() -> Option<Vec<u8>>;
    let all: [(&str, InvalidReply); 6] = [
        ("garbage", || Some(b"\xff\xff garbage\r\n\r\n".to_vec())),
        ("nothing", || Some(Vec::new())),
        ("an empty answer", || Some(http(200, "application/x-protobuf", b""))),
        ("much", || Some(http(200, "application/x-protobuf", &vec![0; 8 << 20]))),
        ("a page", || Some(http(502, "text/html", b"<html>"))),
        ("a region that it does not know", || Some(refusal(404, "unknown-map"))),
    ];
    for (what, invalid_reply) in all {
        let fake = FakeWorker::start(invalid_reply);
        let alone = TestGateway::start(&published, vec![fake.url.clone()]).await;
        let request = alone.request(&query, Duration::from_millis(300));
        let ended = alone.gateway.localize(request).await;
        assert!(
            matches!(ended, Err(LocalizeFailure::Unreached { .. } | LocalizeFailure::TimedOut)),
            "{what}: {ended:?}"
        );
        assert!(alone.requests("failed") + alone.requests("refused") > 0.0, "{what}");
        let worker = published.worker("worker");
        let both = TestGateway::start(&published, vec![fake.url.clone(), url_of(&worker)]).await;
        for _ in 0..4 {
            assert!(both.ask(&query).await.expect(what).trusted(), "{what}");
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn busy_workers_are_passed_over_and_the_reason_reported() {
    let published = PublishedMap::new(10);
    let query = published.query(&truth());
    let worker = published.worker("worker");
    for kind in ["queue-full", "overdue", "stopping"] {
        let fake = FakeWorker::start(move || Some(refusal(503, kind)));
        let both = TestGateway::start(&published, vec![fake.url.clone(), url_of(&worker)]).await;
        while fake.received().is_empty() {
            assert!(both.ask(&query).await.expect("a pose").trusted());
        }
        let alone = TestGateway::start(&published, vec![fake.url.clone()]).await;
        let ended = alone.gateway.localize(alone.request(&query, Duration::from_millis(300))).await;
        let seven = 7.try_into().expect("not zero");
        match kind {
            "stopping" => assert!(matches!(ended, Err(LocalizeFailure::Unreached { .. })), "{ended:?}"),
            _ => assert_eq!(ended, Err(LocalizeFailure::Busy { retry_after: seven })),
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn silent_worker_times_out_alone_and_costs_nothing_beside_another() {
    let published = PublishedMap::new(10);
    let query = published.query(&truth());
    let fake = FakeWorker::start(|| None);
    let alone = TestGateway::start(&published, vec![fake.url.clone()]).await;
    let request = alone.request(&query, Duration::from_millis(200));
    assert_eq!(alone.gateway.localize(request).await, Err(LocalizeFailure::TimedOut));
    assert!(!alone.gateway.is_complete(), "it is put aside");
    let worker = published.worker("worker");
    let both = TestGateway::start(&published, vec![fake.url.clone(), url_of(&worker)]).await;
    while both.metric("veiloc_gateway_hedges_total") == 0.0 {
        assert!(both.ask(&query).await.expect("a pose").trusted());
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn coming_and_going_workers_lose_no_query() {
    let published = Arc::new(PublishedMap::new(4));
    let mut workers: Vec<Running> = (0..3).map(|n| published.worker(&format!("worker-{n}"))).collect();
    let gateway = Arc::new(TestGateway::start(&published, workers.iter().map(url_of).collect()).await);
    let (stop, answered) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicUsize::new(0)));
    let clients: Vec<_> = (0..3)
        .map(|client| {
            let (gateway, published) = (gateway.clone(), published.clone());
            let (stop, answered) = (stop.clone(), answered.clone());
            tokio::spawn(async move {
                let queries = published.queries(5);
                for query in queries.iter().cycle().skip(client) {
                    if stop.load(Ordering::Relaxed) {
                        return;
                    }
                    assert!(gateway.ask(query).await.expect("a pose").trusted());
                    answered.fetch_add(1, Ordering::Relaxed);
                }
            })
        })
        .collect();
    for number in 0..3 {
        let stopped = workers.remove(0);
        let address = stopped.address;
        assert_eq!(block_in_place(|| stopped.stop()).given_up, 0, "it finishes its requests");
        let before = answered.load(Ordering::Relaxed);
        eventually("more answers", || answered.load(Ordering::Relaxed) > before + 3).await;
        // The next one at its address, with an empty cache.
        let mut options = published.worker_options(&format!("again-{number}"), 1 << 30);
        options.listen = vec![address.to_string().parse().expect("an address")];
        workers.push(block_in_place(|| Running::start(options)));
    }
    stop.store(true, Ordering::Relaxed);
    for client in clients {
        client.await.expect("no query was lost");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn new_manifest_is_activated_without_a_lost_query() {
    let published = Arc::new(PublishedMap::new(5));
    let workers = [published.worker("a"), published.worker("b")];
    let gateway = Arc::new(TestGateway::start(&published, workers.iter().map(url_of).collect()).await);
    let stop = Arc::new(AtomicBool::new(false));
    let clients: Vec<_> = (0..3)
        .map(|client| {
            let (gateway, published, stop) = (gateway.clone(), published.clone(), stop.clone());
            tokio::spawn(async move {
                let (queries, mut answered) = (published.queries(5), 0);
                for query in queries.iter().cycle().skip(client) {
                    if stop.load(Ordering::Relaxed) {
                        break;
                    }
                    assert!(gateway.ask(query).await.expect("a pose").trusted());
                    answered += 1;
                }
                answered
            })
        })
        .collect();
    for (images, of_region) in [(9, 4), (10, 3), (8, 8)] {
        let manifest = published.publish(images, of_region);
        eventually("the new manifest", || gateway.gateway.manifest() == Some(manifest.id())).await;
        let description = gateway.gateway.describe().expect("active");
        assert_eq!(description.images, images as usize);
    }
    stop.store(true, Ordering::Relaxed);
    for client in clients {
        assert!(client.await.expect("no query was lost") > 0);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn queries_for_another_map_reach_no_worker() {
    let published = PublishedMap::new(10);
    let fake = FakeWorker::start(|| None);
    let gateway = TestGateway::start(&published, vec![fake.url.clone()]).await;
    let other = common::service::TestScene::new(5).sealed(&truth());
    assert_eq!(gateway.ask(&other).await.expect_err("refused"), LocalizeFailure::WrongProfile);
    assert!(fake.received().is_empty());
}

/// A gateway's `/readyz` follows its workers.
#[tokio::test(flavor = "multi_thread")]
async fn readyz_follows_the_workers() {
    let published = PublishedMap::new(10);
    let worker = published.worker("worker");
    let (address, gateway) = (worker.address, TestGateway::start(&published, vec![url_of(&worker)]).await);
    let server = block_in_place(|| Running::start(gateway_options(&gateway)));
    let status = || block_in_place(|| server.get("/readyz", "").status);
    assert_eq!(status(), 200);
    block_in_place(|| worker.stop());
    eventually("not ready", || status() == 503).await;
    let mut options = published.worker_options("again", 1 << 30);
    options.listen = vec![address.to_string().parse().expect("an address")];
    let _again = block_in_place(|| Running::start(options));
    eventually("ready", || status() == 200).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn unusable_settings_are_refused_with_a_remedy() {
    let start = async |access: WorkerAccess| match Workers::start(&access, GatewayCounts::default()).await {
        Err(error @ ClusterError::Workers { .. }) => error.to_string(),
        other => panic!("{:?}", other.map(|_| ())),
    };
    for url in ["", "worker:8080", "ftp://worker", "http://user:secret@worker", "http://", "http://w/?a"] {
        let message = start(WorkerAccess::new(vec![url.to_owned()])).await;
        assert!(message.contains("http://HOST:PORT") && !message.contains("secret"), "{message}");
    }
    let mut access = WorkerAccess::new(vec!["http://127.0.0.1:1".to_owned()]);
    access.token = Some("two\nlines".to_owned());
    assert!(start(access.clone()).await.contains("veiloc token new"));
    access.token = None;
    let folder = tempfile::tempdir().expect("temporary folder");
    let ca = folder.path().join("ca.pem");
    std::fs::write(&ca, "no certificate").expect("written");
    access.ca = Some(ca);
    assert!(start(access).await.contains("PEM"));
}
