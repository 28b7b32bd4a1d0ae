//! Gateway and workers in one process: the poses are the same as without a cluster, also when machines die, reply
//! invalidly or are slow.

use super::common;

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;

use common::service::{Running, truth};
use common::{
    Announcements, MAP, POLL_INTERVAL, PublishedMap, STEP_TIMEOUT, TestCluster, eventually, fake_member,
    localize_locally, region, reply, subject_of, without_times, worker_options,
};
use tokio::runtime::Handle;
use tokio::task::JoinHandle;
use veiloc_cluster::bus::Bus;
use veiloc_cluster::message::{RejectReason, Reply, ReplyOutcome, Request, Task};
use veiloc_cluster::{Gateway, GatewayOptions, ObjectStoreSource, VERSION, Worker, WorkerOptions};
use veiloc_service::auth::{Lane, TokenKey};
use veiloc_service::worker_api::HealthProbe as _;
use veiloc_service::{
    BodyKind, DecodedRequest, LocalizeFailure, NoPose, RemoteBackend as _, RemoteMap, RemoteRequest,
    ServerOptions,
};

/// Share of a worker that holds only the index.
const INDEX_ONLY: &str = "999";

/// While the returned sender exists, a paused clock does not advance by itself.
fn hold_clock() -> std::sync::mpsc::Sender<()> {
    let (held, released) = std::sync::mpsc::channel();
    tokio::task::spawn_blocking(move || released.recv());
    held
}

/// Advances the paused clock in steps until a condition holds.
async fn pass_until(step: Duration, what: &str, mut is_so: impl FnMut() -> bool) {
    for _ in 0..6000 {
        if is_so() {
            return;
        }
        tokio::time::advance(step).await;
        // Threads that localize and read files need real time.
        let pause = || std::thread::sleep(Duration::from_millis(10));
        tokio::task::spawn_blocking(pause).await.expect("it only sleeps");
    }
    panic!("timed out waiting for {what}");
}

/// Sends a request about region 0 directly to the first worker.
fn ask_worker(
    published: &PublishedMap,
    cluster: &TestCluster,
    name: u8,
    body: &[u8],
) -> JoinHandle<ReplyOutcome> {
    ask_worker_for(published, cluster, name, body, None)
}

fn ask_worker_for(
    published: &PublishedMap,
    cluster: &TestCluster,
    name: u8,
    body: &[u8],
    lane: Option<Lane>,
) -> JoinHandle<ReplyOutcome> {
    let task = Task::Pose { kind: BodyKind::Query, body: body.to_vec().into(), near: None };
    let (object, within) = (published.region(0), STEP_TIMEOUT);
    let request =
        Request { version: VERSION, name: [name; 16], object, lane, rows: 100, within, span: None, task };
    let (bus, subject) = (cluster.bus.clone(), subject_of(&cluster.handle().member()));
    tokio::spawn(async move {
        let reply = bus.request_cancellable(&subject, request.encode(), STEP_TIMEOUT).await;
        Reply::decode(reply.expect("a reply"), &request.name).expect("a reply").outcome
    })
}

fn decode_request(incoming: &veiloc_cluster::bus::Incoming) -> Request {
    Request::decode(incoming.payload.clone()).expect("a request of the gateway's")
}

#[tokio::test(flavor = "multi_thread")]
async fn pose_equals_that_of_the_map_bit_for_bit() {
    let published = PublishedMap::new(10);
    let folder = published.folder();
    assert_eq!(folder.manifest().regions.len(), 1);
    let cluster = TestCluster::start(&published, Bus::in_process(), &["all"]).await;
    let (whole, only) = (published.map(10), region(&folder, 0));
    for query in published.queries(6) {
        let answer = without_times(cluster.ask(&query).await.expect("a pose"));
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
    let cluster = TestCluster::start(&published, Bus::in_process(), &["1/2", "2/2"]).await;
    for query in published.queries(6) {
        let answer = without_times(cluster.ask(&query).await.expect("a pose"));
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
    let cluster = TestCluster::start(&published, Bus::in_process(), &["all"]).await;
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
    let mut request = cluster.request(&published.query(&truth()), STEP_TIMEOUT);
    (request.decoded, request.bytes) = (decoded(), bytes.clone());
    assert_eq!(
        without_times(cluster.gateway.localize(request).await.expect("a pose")),
        without_times(expected)
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn http_answers_equal_those_of_a_local_map() {
    let published = PublishedMap::new(10);
    let cluster = TestCluster::start(&published, Bus::in_process(), &["all"]).await;
    let mut options = ServerOptions::new(Vec::new());
    options.listen = vec!["127.0.0.1:0".parse().expect("an address")];
    options.answer_quantum = Duration::ZERO;
    let backend = Arc::new(cluster.gateway.clone());
    options.remote_maps = vec![RemoteMap { name: MAP.to_owned(), backend }];
    let (query, other) = (published.query(&truth()), common::service::TestScene::new(5).sealed(&truth()));
    let featureless = published.scene.sealed_without_features();
    // The server blocks its own thread, not those of the cluster.
    let statuses = tokio::task::spawn_blocking(move || {
        let server = Running::start(options);
        let path = format!("/v1/maps/{MAP}/localize");
        let ask = |query: &[u8]| {
            let request = common::service::http::Request::post(&path, query);
            request.header("content-type", "application/x-protobuf").send(server.address)
        };
        let answers = [&query, &other, &featureless, &b"no query".to_vec()].map(|query| ask(query));
        assert_eq!(server.get("/v1/maps", "").status, 200);
        answers.map(|answer| (answer.status, answer.body.len()))
    });
    let statuses = statuses.await.expect("it ends");
    assert_eq!(statuses.map(|(status, _)| status), [200, 409, 422, 400]);
    assert!(statuses.iter().all(|(_, length)| *length == 4096), "{statuses:?}: lengths must be equal");
}

/// An incomplete new map is not activated: the old one stays in use until the new one is complete.
#[tokio::test(flavor = "multi_thread")]
async fn missing_object_delays_the_new_map_but_no_query() {
    let published = PublishedMap::new(5);
    let old = published.folder().manifest().id();
    let cluster = TestCluster::start(&published, Bus::in_process(), &["all"]).await;
    let worker = cluster.handle();
    let moved = published.regions().join("moved");
    let new = published.publish_spoilt(9, 4, |objects, manifest| {
        let region = objects.join(manifest.regions[0].sha256.to_string());
        std::fs::rename(region, &moved).expect("it was there");
    });
    let failing = || common::value(&worker.metrics(), "veiloc_reload_failing");
    eventually("the failure gauge", || failing() == 1).await;
    for query in published.queries(6) {
        assert!(cluster.ask(&query).await.expect("a pose").trusted());
    }
    assert_eq!(cluster.gateway.manifest(), Some(old));
    let region = published.regions().join("objects").join(new.regions[0].sha256.to_string());
    std::fs::rename(&moved, region).expect("back");
    eventually("the new manifest", || cluster.gateway.manifest() == Some(new.id())).await;
    eventually("the failure gauge", || failing() == 0).await;
    assert!(cluster.ask(&published.query(&truth())).await.expect("a pose").trusted());
}

/// A worker that starts serves what it can when an object is damaged, and the rest as soon as it is mended.
#[tokio::test(flavor = "multi_thread")]
async fn damaged_object_at_start_costs_only_its_region() {
    let published = PublishedMap::new(4);
    let damaged = published.region(1);
    let path = published.folder().path_of(&damaged);
    let good = std::fs::read(&path).expect("an object");
    let mut bad = good.clone();
    bad[good.len() / 2] ^= 1;
    std::fs::write(&path, &bad).expect("written");

    let bus = Bus::in_process();
    let announced = Announcements::listen(&bus).await;
    let mut options = worker_options("all");
    options.watch = Duration::from_secs(1);
    let cluster = TestCluster::start_with(&published, bus, vec![options]).await;
    let worker = cluster.handle();
    let others = published.folder().manifest().regions.len() - 1;
    assert!(others >= 2);
    let regions = (0..=others).map(|number| published.region(number));
    let others: Vec<_> = regions.filter(|object| *object != damaged).chain([published.index()]).collect();
    eventually("the others", || others.iter().all(|object| announced.holders(object) == 1)).await;
    assert_eq!(announced.holders(&damaged), 0);
    worker.ready().expect("it serves the others");
    let is = |what: &str, count: u64| common::value(&worker.metrics(), what) == count;
    assert!(is("veiloc_objects_missing", 1) && is("veiloc_reload_failing", 1));
    assert!(!cluster.gateway.is_complete(), "the gateway knows that a region is missing");

    std::fs::write(&path, &good).expect("mended");
    cluster.knows(1).await;
    eventually("the metrics", || is("veiloc_objects_missing", 0) && is("veiloc_reload_failing", 0)).await;
    assert!(cluster.ask(&published.query(&truth())).await.expect("a pose").trusted());
}

/// If storage is unreachable, a machine starts with the map in its cache, and fails only if it has none.
#[cfg(unix)]
#[tokio::test(flavor = "multi_thread")]
async fn machines_start_from_the_cache_without_storage() {
    let published = PublishedMap::new(4);
    let folder = tempfile::tempdir().expect("temporary folder");
    let (store, cache) = (folder.path().join("store"), folder.path().join("cache"));
    let url = store.to_str().expect("text");
    let storage = || {
        veiloc_cluster::object_store::Storage::open(url).expect("a folder").with_retry_policy(
            1,
            Duration::from_millis(1),
            Duration::from_secs(3600),
        )
    };
    tokio::task::block_in_place(|| {
        let storage = veiloc_cluster::object_store::Storage::create(url).expect("a folder");
        Handle::current().block_on(storage.publish(&published.folder(), &|_, _| ())).expect("published");
    });
    let source = |cache: &Path| Arc::new(ObjectStoreSource::of(storage(), cache, 1 << 30).expect("a cache"));
    let bus = Bus::in_process();
    let worker = async |cache: &Path| {
        let counts = veiloc_service::telemetry::WorkerCounts::new("test", 2, 32);
        Worker::start(bus.clone(), source(cache), WorkerOptions::new(MAP), counts).await
    };
    let held = worker(&cache).await.expect("a worker").held_count();
    let pointer = store.join(format!("{MAP}.json"));
    std::fs::remove_file(&pointer).expect("it was there");
    // A removed map is an error: a withdrawn map must not be used any more.
    let gone = worker(&cache).await.err().expect("nothing is published").to_string();
    assert!(gone.contains("not there"), "{gone}");
    // A link to itself: neither found nor not found.
    std::os::unix::fs::symlink(&pointer, &pointer).expect("a link");
    let again = worker(&cache).await.expect("a worker");
    assert_eq!(again.held_count(), held);
    let counts = veiloc_service::telemetry::GatewayCounts::default();
    let gateway = Gateway::start(bus.clone(), source(&cache), GatewayOptions::new(MAP), counts).await;
    let gateway = gateway.expect("a gateway");
    let id = published.folder().manifest().id();
    eventually("the members", || gateway.manifest() == Some(id)).await;
    assert!(worker(&folder.path().join("another cache")).await.is_err(), "a machine without a cache");
    // A drive that is not mounted: a folder that is empty, or not there at all.
    std::fs::remove_dir_all(&store).expect("a folder");
    std::fs::create_dir(&store).expect("a folder");
    assert_eq!(worker(&cache).await.expect("a worker").held_count(), held);
    std::fs::remove_dir(&store).expect("an empty folder");
    let lazily = ObjectStoreSource::open(url, &cache, 1 << 30).expect("a cache");
    let counts = veiloc_service::telemetry::WorkerCounts::new("test", 2, 32);
    let away = Worker::start(bus.clone(), Arc::new(lazily), WorkerOptions::new(MAP), counts).await;
    assert_eq!(away.expect("a worker").held_count(), held);
}

/// Abandoned jobs are skipped or stopped; others are answered.
#[tokio::test(flavor = "multi_thread")]
async fn abandoned_work_is_dropped_and_counted() {
    const WAITING: u8 = 20;
    let published = PublishedMap::new(10);
    let mut options = worker_options("all");
    // A query without consensus occupies its thread for ever; others end by confidence.
    options.localize.pose.max_hypotheses = usize::MAX;
    let cluster = TestCluster::start_with(&published, Bus::in_process(), vec![options]).await;
    let worker = cluster.handle();
    let ask = |name: u8, body: &[u8]| ask_worker(&published, &cluster, name, body);
    let metric = |what: &str| common::value(&worker.metrics(), what);
    let is = |busy: u64, queued: u64| {
        metric("veiloc_workers_busy") == busy && metric("veiloc_queue_length") == queued
    };
    let cancelled = || {
        ["queued", "running"]
            .map(|state| metric(&format!("veiloc_worker_cancellations_total{{state=\"{state}\"}}")))
    };
    let answered = || metric("veiloc_worker_replies_total{outcome=\"answered\"}");
    let before = answered();
    let (endless, query) = (published.scene.sealed_without_consensus(), published.query(&truth()));
    let at_work = [ask(1, &endless), ask(2, &endless)];
    eventually("work on both threads", || is(2, 0)).await;
    let mut waiting: Vec<_> = (0..WAITING).map(|i| ask(3 + i, &query)).collect();
    eventually("a queue", || is(2, u64::from(WAITING))).await;
    let awaited = waiting.pop().expect("the last");
    waiting.iter().for_each(JoinHandle::abort);
    eventually("an end of those that wait", || cancelled() == [u64::from(WAITING) - 1, 0]).await;
    at_work.iter().for_each(JoinHandle::abort);
    assert!(matches!(awaited.await.expect("it ends"), ReplyOutcome::Pose(_)));
    eventually("an end of those at work", || cancelled() == [u64::from(WAITING) - 1, 2] && is(0, 0)).await;
    assert_eq!(answered(), before + 1);
    // Later requests are answered normally.
    assert!(matches!(ask(99, &query).await.expect("it ends"), ReplyOutcome::Pose(_)));
}

/// Every member receives exactly the bytes that the device sent.
#[tokio::test(flavor = "multi_thread")]
async fn all_messages_contain_the_same_sealed_bytes() {
    let published = PublishedMap::new(10);
    let bus = Bus::in_process();
    let cluster = TestCluster::start(&published, bus.clone(), &["all"]).await;
    let seen = Arc::new(std::sync::Mutex::new(Vec::new()));
    let keep = seen.clone();
    let _listener = fake_member(&bus, &[published.region(0)], move |incoming| {
        let request = decode_request(&incoming);
        if let Task::Pose { body, .. } = &request.task {
            keep.lock().expect("whole").push(body.to_vec());
        }
        async move {
            // The requester may have its answer already.
            let _ = incoming.answer(reply(request.name, ReplyOutcome::Rejected(RejectReason::Broken))).await;
        }
    })
    .await;
    cluster.knows(2).await;
    let query = published.query(&truth());
    for _ in 0..6 {
        cluster.ask(&query).await.expect("a pose");
    }
    let seen = seen.lock().expect("whole");
    assert!(!seen.is_empty() && seen.iter().all(|body| *body == query), "{} messages", seen.len());
}

#[tokio::test(flavor = "multi_thread")]
async fn invalid_replies_are_retried_and_never_used() {
    let published = PublishedMap::new(10);
    let query = published.query(&truth());
    type InvalidReply = fn(&Request) -> bytes::Bytes;
    let all: [(&str, InvalidReply); 6] = [
        ("garbage", |_| b"\xff\xff garbage".to_vec().into()),
        ("nothing", |_| bytes::Bytes::new()),
        ("much", |_| vec![0; 8 << 20].into()),
        ("another request's", |_| {
            reply([9; 16], ReplyOutcome::Failed(LocalizeFailure::NoPose(NoPose::TooFew)))
        }),
        ("an unexpected outcome", |request| reply(request.name, ReplyOutcome::Here { unknown: Vec::new() })),
        ("regions", |request| reply(request.name, ReplyOutcome::Regions(Vec::new()))),
    ];
    for (what, invalid_reply) in all {
        let bus = Bus::in_process();
        let cluster = TestCluster::start(&published, bus.clone(), &["all", INDEX_ONLY]).await;
        let invalid_replies = Arc::new(AtomicUsize::new(0));
        let count = invalid_replies.clone();
        let _faulty = fake_member(&bus, &[published.region(0)], move |incoming| {
            let count = count.clone();
            async move {
                let request = decode_request(&incoming);
                // The requester may have its answer already.
                let _ = incoming.answer(invalid_reply(&request)).await;
                count.fetch_add(1, Ordering::Relaxed);
            }
        })
        .await;
        cluster.knows(3).await;
        for _ in 0..4 {
            assert!(cluster.ask(&query).await.expect(what).trusted(), "{what}");
        }
        assert!(cluster.leave().await, "{what}");
        let without_worker = cluster.ask(&query).await;
        assert!(
            matches!(without_worker, Err(LocalizeFailure::Unreached { .. })),
            "{what}: {without_worker:?}"
        );
        assert!(invalid_replies.load(Ordering::Relaxed) > 0, "{what}");
        assert!(cluster.metric("veiloc_cluster_messages_total{outcome=\"invalid-reply\"}") > 0, "{what}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn rejected_requests_are_retried_and_the_reason_reported() {
    let published = PublishedMap::new(10);
    let query = published.query(&truth());
    let seven = 7.try_into().expect("not zero");
    let cases = [
        (RejectReason::Busy { retry_after: seven }, LocalizeFailure::Busy { retry_after: seven }),
        (RejectReason::Leaving, LocalizeFailure::Unreached { retry_after: 1.try_into().expect("not zero") }),
        (RejectReason::Broken, LocalizeFailure::Broken),
    ];
    for (why, expected) in cases {
        let bus = Bus::in_process();
        let cluster = TestCluster::start(&published, bus.clone(), &["all", INDEX_ONLY]).await;
        let _busy = fake_member(&bus, &[published.region(0)], move |incoming| async move {
            let request = decode_request(&incoming);
            incoming.answer(reply(request.name, ReplyOutcome::Rejected(why))).await.expect("sent");
        })
        .await;
        cluster.knows(3).await;
        for _ in 0..4 {
            assert!(cluster.ask(&query).await.expect("a pose").trusted());
        }
        assert!(cluster.leave().await);
        assert_eq!(cluster.ask(&query).await.expect_err("no other worker"), expected);
    }
}

/// A stopped worker answers its requests first; a dropped one does not, and another is tried.
#[tokio::test(flavor = "multi_thread")]
async fn joining_and_leaving_workers_lose_no_query() {
    let published = Arc::new(PublishedMap::new(4));
    let bus = Bus::in_process();
    let cluster = Arc::new(TestCluster::start(&published, bus, &["all", "all"]).await);
    let (stop, answered) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicUsize::new(0)));
    let clients: Vec<_> = (0..3)
        .map(|client| {
            let (cluster, published) = (cluster.clone(), published.clone());
            let (stop, answered) = (stop.clone(), answered.clone());
            tokio::spawn(async move {
                let queries = published.queries(5);
                for query in queries.iter().cycle().skip(client) {
                    if stop.load(Ordering::Relaxed) {
                        return;
                    }
                    assert!(cluster.ask(query).await.expect("a pose").trusted());
                    answered.fetch_add(1, Ordering::Relaxed);
                }
            })
        })
        .collect();
    for _ in 0..4 {
        cluster.add(&published, "all").await;
        let before = answered.load(Ordering::Relaxed);
        assert!(cluster.leave().await, "it finishes its requests");
        eventually("more answers", || answered.load(Ordering::Relaxed) > before + 3).await;
    }
    stop.store(true, Ordering::Relaxed);
    for client in clients {
        client.await.expect("no query was lost");
    }
}

/// In this test the grace period of workers ends after the gateway activated the new manifest.
#[tokio::test(start_paused = true)]
async fn new_manifest_is_activated_without_a_lost_query() {
    const DAY: Duration = Duration::from_secs(86_400);
    let published = Arc::new(PublishedMap::new(5));
    let bus = Bus::in_process();
    let workers = ["1/2", "2/2"].map(|share| {
        let mut options = worker_options(share);
        options.grace = Duration::from_secs(3600);
        options
    });
    let cluster = Arc::new(TestCluster::start_with(&published, bus.clone(), workers.into()).await);
    cluster.knows(2).await;
    let _held = hold_clock();
    let announced = Announcements::listen(&bus).await;
    let stop = Arc::new(AtomicBool::new(false));
    let clients: Vec<_> = (0..3)
        .map(|client| {
            let (cluster, published, stop) = (cluster.clone(), published.clone(), stop.clone());
            tokio::spawn(async move {
                let (queries, mut answered) = (published.queries(5), 0);
                for query in queries.iter().cycle().skip(client) {
                    if stop.load(Ordering::Relaxed) {
                        break;
                    }
                    let request = cluster.request(query, DAY);
                    assert!(cluster.gateway.localize(request).await.expect("a pose").trusted());
                    answered += 1;
                }
                answered
            })
        })
        .collect();
    for (images, of_region) in [(9, 4), (10, 3), (8, 8)] {
        let old = published.region(0);
        let manifest = published.publish(images, of_region);
        pass_until(POLL_INTERVAL, "the new manifest", || cluster.gateway.manifest() == Some(manifest.id()))
            .await;
        let description = cluster.gateway.describe().expect("held");
        assert_eq!(description.images, images as usize);
        // Unused regions are finally left.
        assert!(announced.holders(&old) > 0, "not before the grace period");
        pass_until(Duration::from_secs(60), "no holder", || announced.holders(&old) == 0).await;
    }
    stop.store(true, Ordering::Relaxed);
    for client in clients {
        assert!(client.await.expect("no query was lost") > 0);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn manifest_is_activated_when_all_regions_are_reachable() {
    let published = PublishedMap::new(4);
    let query = published.query(&truth());
    let bus = Bus::in_process();
    let cluster = TestCluster::start_with(&published, bus, vec![worker_options("1/2")]).await;
    assert!(cluster.gateway.describe().is_none() && !cluster.gateway.is_complete());
    assert!(matches!(cluster.ask(&query).await, Err(LocalizeFailure::Unreached { .. })));
    cluster.add(&published, "2/2").await;
    eventually("all regions", || cluster.gateway.describe().is_some()).await;
    assert!(cluster.ask(&query).await.expect("a pose").trusted());
}

#[tokio::test(flavor = "multi_thread")]
async fn queries_for_another_map_reach_no_worker() {
    let published = PublishedMap::new(10);
    let cluster = TestCluster::start(&published, Bus::in_process(), &["all"]).await;
    let other = common::service::TestScene::new(5).sealed(&truth());
    assert_eq!(cluster.ask(&other).await.expect_err("refused"), LocalizeFailure::WrongProfile);
    assert_eq!(cluster.metric("veiloc_cluster_messages_total{outcome=\"answered\"}"), 0);
}

/// The same request three times to one worker: the first is queued, the later ones are rejected and do not disturb
/// it.
#[tokio::test(flavor = "multi_thread")]
async fn duplicate_requests_are_rejected_while_in_progress() {
    let published = PublishedMap::new(10);
    let mut options = worker_options("all");
    options.localize.pose.max_hypotheses = usize::MAX;
    let cluster = TestCluster::start_with(&published, Bus::in_process(), vec![options]).await;
    let worker = cluster.handle();
    let ask = |name: u8, body: &[u8]| ask_worker(&published, &cluster, name, body);
    let endless = published.scene.sealed_without_consensus();
    let at_work = [ask(1, &endless), ask(2, &endless)];
    let is = |what: &str, count: u64| common::value(&worker.metrics(), what) == count;
    eventually("work on both threads", || is("veiloc_workers_busy", 2)).await;
    let query = published.query(&truth());
    let first = ask(5, &query);
    eventually("a queue", || is("veiloc_queue_length", 1)).await;
    for _ in 0..2 {
        let twin = ask(5, &query).await.expect("it ends");
        assert!(matches!(twin, ReplyOutcome::Rejected(RejectReason::InProgress)), "{twin:?}");
    }
    at_work.iter().for_each(JoinHandle::abort);
    assert!(matches!(first.await.expect("it ends"), ReplyOutcome::Pose(_)));
    assert!(
        matches!(ask(5, &query).await.expect("it ends"), ReplyOutcome::Pose(_)),
        "not in progress any more"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn request_times_out() {
    let published = PublishedMap::new(10);
    let bus = Bus::in_process();
    let cluster = TestCluster::start(&published, bus.clone(), &["all"]).await;
    assert!(cluster.leave().await);
    let objects = [published.region(0), published.index()];
    let _silent = fake_member(&bus, &objects, |incoming| async move {
        // Its reply channel stays, as over NATS.
        std::mem::forget(incoming);
    })
    .await;
    cluster.knows(1).await;
    let request: RemoteRequest = cluster.request(&published.query(&truth()), Duration::from_millis(200));
    assert_eq!(cluster.gateway.localize(request).await.expect_err("no reply"), LocalizeFailure::TimedOut);
}

/// A gateway says that a region has no worker, and still answers what it can.
#[tokio::test(flavor = "multi_thread")]
async fn gateway_is_ready_while_every_region_has_a_worker() {
    let published = PublishedMap::new(4);
    let cluster = TestCluster::start(&published, Bus::in_process(), &["1/2", "2/2"]).await;
    let complete = format!("veiloc_cluster_complete{{map=\"{MAP}\"}}");
    let copies = format!("veiloc_cluster_copies{{map=\"{MAP}\"}}");
    assert_eq!((cluster.metric(&complete), cluster.metric(&copies)), (1, 1));
    let manifest = cluster.gateway.manifest();
    assert!(cluster.leave().await);
    eventually("a region without worker", || !cluster.gateway.is_complete()).await;
    eventually("the metrics", || cluster.metric(&complete) == 0 && cluster.metric(&copies) == 0).await;
    assert_eq!(cluster.gateway.manifest(), manifest, "the map is still described");
    cluster.add(&published, "1/2").await;
    cluster.add(&published, "all").await;
    cluster.knows(3).await;
    eventually("the metrics", || cluster.metric(&complete) == 1).await;
    assert!(cluster.ask(&published.query(&truth())).await.expect("a pose").trusted());
}

/// A gateway's `/readyz` follows its workers.
#[tokio::test(flavor = "multi_thread")]
async fn readyz_follows_the_workers() {
    let published = PublishedMap::new(10);
    let cluster = TestCluster::start(&published, Bus::in_process(), &["all"]).await;
    let mut options = ServerOptions::new(Vec::new());
    options.listen = vec!["127.0.0.1:0".parse().expect("an address")];
    let backend = Arc::new(cluster.gateway.clone());
    options.remote_maps = vec![RemoteMap { name: MAP.to_owned(), backend }];
    let server = tokio::task::block_in_place(|| Running::start(options));
    let status = || tokio::task::block_in_place(|| server.get("/readyz", "").status);
    assert_eq!(status(), 200);
    assert!(cluster.leave().await);
    eventually("not ready", || status() == 503).await;
    cluster.add(&published, "all").await;
    eventually("ready", || status() == 200).await;
}

/// The queue of a worker is fair between the clients of its gateways.
#[tokio::test(flavor = "multi_thread")]
async fn queue_of_a_worker_serves_two_clients_fairly() {
    let published = PublishedMap::new(10);
    let mut options = worker_options("all");
    options.threads = 1.try_into().expect("not zero");
    options.localize.pose.max_hypotheses = usize::MAX;
    let cluster = TestCluster::start_with(&published, Bus::in_process(), vec![options]).await;
    let worker = cluster.handle();
    let is = |what: &str, count: u64| common::value(&worker.metrics(), what) == count;
    let lane = |n: u8| Some(Lane::of(&TokenKey::of_digest([n; 32])));
    let endless = ask_worker(&published, &cluster, 1, &published.scene.sealed_without_consensus());
    eventually("work", || is("veiloc_workers_busy", 1)).await;
    let query = published.query(&truth());
    let (ended, mut order) = tokio::sync::mpsc::unbounded_channel();
    // Twelve queries of one client, then one of another.
    for n in 0..13_u8 {
        let client = if n < 12 { 1 } else { 2 };
        let (answer, ended) =
            (ask_worker_for(&published, &cluster, 10 + n, &query, lane(client)), ended.clone());
        eventually("a queue", || is("veiloc_queue_length", u64::from(n) + 1)).await;
        tokio::spawn(async move {
            assert!(matches!(answer.await.expect("it ends"), ReplyOutcome::Pose(_)));
            ended.send(client).expect("the test receives");
        });
    }
    endless.abort();
    let mut clients = Vec::new();
    while clients.len() < 13 {
        clients.push(order.recv().await.expect("all end"));
    }
    let position = clients.iter().position(|client| *client == 2).expect("it was answered");
    assert!(position <= 3, "the other client came after {position} of the first: {clients:?}");
}

/// The client of a query reaches the workers, by a hash of what the file of tokens holds.
#[tokio::test(flavor = "multi_thread")]
async fn lane_of_a_client_reaches_workers() {
    let published = PublishedMap::new(10);
    let bus = Bus::in_process();
    let cluster = TestCluster::start_with(&published, bus.clone(), vec![worker_options(INDEX_ONLY)]).await;
    let (lanes, mut received) = tokio::sync::mpsc::unbounded_channel();
    let _member = fake_member(&bus, &[published.region(0)], move |incoming| {
        let request = decode_request(&incoming);
        lanes.send((request.lane, request.rows)).expect("the test receives");
        async move {
            let outcome = ReplyOutcome::Failed(LocalizeFailure::NoPose(NoPose::TooFew));
            incoming.answer(reply(request.name, outcome)).await.expect("sent");
        }
    })
    .await;
    cluster.knows(2).await;
    let key = TokenKey::of_token(b"a token");
    for client in [Some(key), None] {
        let mut request = cluster.request(&published.query(&truth()), STEP_TIMEOUT);
        request.client = client;
        let rows = request.decoded.rows();
        cluster.gateway.localize(request).await.expect_err("no pose");
        let (lane, sent_rows) = received.recv().await.expect("asked");
        assert_eq!((lane, sent_rows as usize), (client.as_ref().map(Lane::of), rows));
        assert!(lane.is_none_or(|lane| lane.key() != key));
    }
}
