//! The whole road in one process: the same poses as without it, whoever dies, lies or is slow on the way.

use super::common;

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;

use common::service::{Running, truth};
use common::{
    LONG, MAP, Machines, OFTEN, Town, directly, eventually, impostor, region, timeless, worker_options,
};
use tokio::runtime::Handle;
use tokio::task::JoinHandle;
use veiloc_cluster::bus::Bus;
use veiloc_cluster::message::{Outcome, Reply, Request, Wanted, Why};
use veiloc_cluster::{Gateway, GatewayOptions, ObjectStoreSource, Worker, WorkerOptions};
use veiloc_service::labour::HealthProbe as _;
use veiloc_service::{
    DecodedRequest, RemoteBackend as _, BodyKind, MapElsewhere, NoPose, RemoteRequest, ServerOptions, LocalizeFailure,
};

/// The share of a worker that holds the index and no region.
const INDEX_ALONE: &str = "999";

/// While this is held, a clock that is paused stands still, though there be nothing to do.
fn hold_the_clock() -> std::sync::mpsc::Sender<()> {
    let (held, released) = std::sync::mpsc::channel();
    tokio::task::spawn_blocking(move || released.recv());
    held
}

/// A worker's reply to this request.
fn reply(request: &Request, outcome: Outcome) -> bytes::Bytes {
    Reply { name: request.name, outcome, worked: Duration::ZERO, waited: Duration::ZERO }.encode()
}

/// Lets time pass, one step after another, until something is so.
async fn pass_until(step: Duration, what: &str, mut is_so: impl FnMut() -> bool) {
    for _ in 0..6000 {
        if is_so() {
            return;
        }
        tokio::time::advance(step).await;
        // Threads that localize and read files take what they take.
        let pause = || std::thread::sleep(Duration::from_millis(10));
        tokio::task::spawn_blocking(pause).await.expect("it only sleeps");
    }
    panic!("{what} never came about");
}

/// Asks the worker that holds region 0, beside the gateway.
fn ask_worker(town: &Town, machines: &Machines, name: u8, body: &[u8]) -> JoinHandle<Outcome> {
    let wanted = Wanted::Pose { kind: BodyKind::Query, body: body.to_vec().into(), near: None };
    let object = town.folder().manifest().regions[0].sha256;
    let request = Request { name: [name; 16], object, within: LONG, wanted };
    let (bus, subject) = (machines.bus.clone(), town.subject(0));
    tokio::spawn(async move {
        let reply = bus.request_cancellable(&subject, request.encode(), LONG).await;
        Reply::decode(reply.expect("a reply"), &request.name).expect("understood").outcome
    })
}

fn understood(incoming: &veiloc_cluster::bus::Incoming) -> Request {
    Request::decode(incoming.payload.clone()).expect("a request of the gateway's")
}

#[tokio::test(flavor = "multi_thread")]
async fn the_pose_is_that_of_the_map_itself_to_the_bit() {
    let town = Town::new(10);
    let folder = town.folder();
    assert_eq!(folder.manifest().regions.len(), 1);
    let machines = Machines::start(&town, Bus::in_process(), &["all"]).await;
    let (whole, only) = (town.map(10), region(&folder, 0));
    for query in town.queries(6) {
        let told = timeless(machines.ask(&query).await.expect("a pose"));
        assert!(told.trusted);
        assert_eq!(told, timeless(directly(&only, &query).expect("a pose")));
        // A region remembers the covariances of its points rounded; the pose is the whole map's.
        let (told, whole) =
            (told.pose.expect("told"), directly(&whole, &query).expect("a pose").pose.expect("told"));
        assert_eq!((told.rotation, told.translation), (whole.rotation, whole.translation));
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn of_several_regions_the_trusted_pose_with_most_evidence_is_told() {
    let town = Town::new(4);
    let folder = town.folder();
    let count = folder.manifest().regions.len();
    assert!(count >= 3, "{count} regions");
    let machines = Machines::start(&town, Bus::in_process(), &["1/2", "2/2"]).await;
    for query in town.queries(6) {
        let told = timeless(machines.ask(&query).await.expect("a pose"));
        let index = folder.open_index(veiloc_map::MapMemory::Copied).expect("an index");
        let DecodedRequest::Query(sealed) = DecodedRequest::decode(BodyKind::Query, &query).expect("sealed") else { panic!("one") };
        let ranked = index.rank(sealed.global(), 10);
        let best = ranked[0].held as f64;
        let asked = ranked.iter().take(3).filter(|region| region.held as f64 >= 0.75 * best);
        let given = asked.map(|ranked| directly(&region(&folder, ranked.region), &query).expect("a pose"));
        let expected =
            given.filter(|answer| answer.trusted).max_by(|a, b| a.log_evidence.total_cmp(&b.log_evidence));
        assert_eq!(told, timeless(expected.expect("trusted")));
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_session_goes_the_same_road() {
    let town = Town::new(10);
    let machines = Machines::start(&town, Bus::in_process(), &["all"]).await;
    let frame = |pose| veiloc_protocol::SealedFrame {
        query: veiloc_protocol::SealedQuery::decode(&town.query(&pose)).expect("sealed"),
        cam_from_rig: veiloc_geometry::CameraFromRig::from_quaternion([1.0, 0.0, 0.0, 0.0], [0.0; 3])
            .expect("a pose"),
        rotation_sd_deg: 0.0,
        translation_sd: 0.0,
    };
    let bytes = veiloc_protocol::RigMessage { frames: vec![frame(truth())] }.encode();
    let asked = || DecodedRequest::decode(BodyKind::Rig, &bytes).expect("a session");
    let options = veiloc_localization::LocalizeOptions::default();
    let expected = asked().localize(&region(&town.folder(), 0), &options, 0.0).expect("a pose").answer;
    let mut question = machines.question(&town.query(&truth()), LONG);
    (question.asked, question.bytes) = (asked(), bytes.clone());
    assert_eq!(timeless(machines.gateway.localize(question).await.expect("a pose")), timeless(expected));
}

#[tokio::test(flavor = "multi_thread")]
async fn over_http_a_cluster_answers_as_a_map_in_memory_does() {
    let town = Town::new(10);
    let machines = Machines::start(&town, Bus::in_process(), &["all"]).await;
    let mut options = ServerOptions::new(Vec::new());
    options.listen = vec!["127.0.0.1:0".parse().expect("an address")];
    let held_by = Arc::new(machines.gateway.clone());
    options.elsewhere = vec![MapElsewhere { name: MAP.to_owned(), held_by }];
    let (query, other) = (town.query(&truth()), common::service::Place::new(5).sealed(&truth()));
    let featureless = town.place.sealed_without_features();
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
    assert!(statuses.iter().all(|(_, length)| *length == 4096), "{statuses:?}: lengths tell nothing");
}

/// One that takes what it is asked and never says a word, as a machine does that hangs or is cut off. Time passes only when it
/// was asked, so that nobody else is slow; how long is waited is tested in `gateway/ask.rs`.
#[tokio::test(start_paused = true)]
async fn a_silent_member_is_asked_around() {
    let _held = hold_the_clock();
    let town = Town::new(10);
    let bus = Bus::in_process();
    let machines = Machines::start(&town, bus.clone(), &["all"]).await;
    let (ask, mut heard) = tokio::sync::mpsc::unbounded_channel();
    let cancelled = Arc::new(AtomicUsize::new(0));
    let count = cancelled.clone();
    let _silent = impostor(&bus, &town.subject(0), move |mut incoming| {
        ask.send(()).expect("the test listens");
        let cancelled = count.clone();
        tokio::spawn(async move {
            incoming.cancelled().await;
            cancelled.fetch_add(1, Ordering::Relaxed);
        });
        std::future::ready(())
    })
    .await;
    let mut silences = 0;
    for query in town.queries(8) {
        let mut answer = std::pin::pin!(machines.ask(&query));
        loop {
            tokio::select! {
                answer = &mut answer => {
                    assert!(answer.expect("a pose").trusted);
                    break;
                }
                Some(()) = heard.recv() => {
                    silences += 1;
                    tokio::time::advance(Duration::from_secs(10)).await;
                }
            }
        }
    }
    assert!(silences >= 4, "members take turns, and it was asked {silences} times");
    assert_eq!(machines.counted("veiloc_cluster_hedges_total"), silences);
    while cancelled.load(Ordering::Relaxed) < silences as usize {
        tokio::task::yield_now().await;
    }
}

/// A new map of which something is gone is not taken by half: all goes by the old one, which is outcome, until it is whole.
#[tokio::test(flavor = "multi_thread")]
async fn an_object_that_vanishes_holds_up_the_new_map_and_no_query() {
    let town = Town::new(5);
    let old = town.folder().manifest().id();
    let machines = Machines::start(&town, Bus::in_process(), &["all"]).await;
    let worker = machines.handle();
    let kept = town.regions().join("kept");
    let new = town.publish_spoilt(9, 4, |objects, manifest| {
        let region = objects.join(manifest.regions[0].sha256.to_string());
        std::fs::rename(region, &kept).expect("it was there");
    });
    let failing = || common::value(&worker.metrics(), "veiloc_reload_failing");
    eventually("word of it", || failing() == 1).await;
    for query in town.queries(6) {
        assert!(machines.ask(&query).await.expect("a pose").trusted);
    }
    assert_eq!(machines.gateway.manifest(), Some(old));
    let region = town.regions().join("objects").join(new.regions[0].sha256.to_string());
    std::fs::rename(&kept, region).expect("back");
    eventually("the new manifest", || machines.gateway.manifest() == Some(new.id())).await;
    eventually("word of it", || failing() == 0).await;
    assert!(machines.ask(&town.query(&truth())).await.expect("a pose").trusted);
}

/// Storage that is away when a machine starts holds it up only when it never had the map: it begins with what its cache has.
#[cfg(unix)]
#[tokio::test(flavor = "multi_thread")]
async fn machines_start_with_what_they_had_while_the_storage_is_away() {
    let town = Town::new(4);
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
        let published = veiloc_cluster::object_store::Storage::create(url).expect("a folder");
        Handle::current().block_on(published.publish(&town.folder(), &|_, _| ())).expect("published");
    });
    let source = |cache: &Path| Arc::new(ObjectStoreSource::of(storage(), cache, 1 << 30).expect("a cache"));
    let bus = Bus::in_process();
    let worker = async |cache: &Path| {
        let counts = veiloc_service::telemetry::WorkerCounts::new("test", 2, 32);
        Worker::start(bus.clone(), source(cache), WorkerOptions::new(MAP), counts).await
    };
    let held = worker(&cache).await.expect("a worker").held();
    let pointer = store.join(format!("{MAP}.json"));
    std::fs::remove_file(&pointer).expect("it was there");
    // What is removed is told: nobody goes on with a map that was taken back.
    let gone = worker(&cache).await.err().expect("nothing is published").to_string();
    assert!(gone.contains("not there"), "{gone}");
    // A name that leads to itself: neither there nor not there.
    std::os::unix::fs::symlink(&pointer, &pointer).expect("a link");
    let again = worker(&cache).await.expect("a worker");
    assert_eq!(again.held(), held);
    let counts = veiloc_service::telemetry::GatewayCounts::default();
    let gateway = Gateway::start(bus.clone(), source(&cache), GatewayOptions::new(MAP), counts).await;
    assert_eq!(gateway.expect("a gateway").manifest(), Some(town.folder().manifest().id()));
    assert!(worker(&folder.path().join("another cache")).await.is_err(), "who never had it");
}

/// What nobody waits for any more is not begun, or stopped; what somebody waits for is answered.
#[tokio::test(flavor = "multi_thread")]
async fn abandoned_work_is_dropped_and_counted() {
    const WAITING: u8 = 20;
    let town = Town::new(10);
    let mut options = worker_options("all");
    // A query without consensus keeps its thread for ever; others end by confidence.
    options.localize.pose.max_hypotheses = usize::MAX;
    let machines = Machines::start_with(&town, Bus::in_process(), vec![options]).await;
    let worker = machines.handle();
    let ask = |name: u8, body: &[u8]| ask_worker(&town, &machines, name, body);
    let counted = |what: &str| common::value(&worker.metrics(), what);
    let is = |busy: u64, queued: u64| {
        counted("veiloc_workers_busy") == busy && counted("veiloc_queue_length") == queued
    };
    let cancelled =
        || ["waiting", "working"].map(|when| counted(&format!("veiloc_cancelled_total{{when=\"{when}\"}}")));
    let answered = || counted("veiloc_said_total{said=\"answered\"}");
    let before = answered();
    let (endless, query) = (town.place.sealed_without_consensus(), town.query(&truth()));
    let at_work = [ask(1, &endless), ask(2, &endless)];
    eventually("work on both threads", || is(2, 0)).await;
    let mut waiting: Vec<_> = (0..WAITING).map(|i| ask(3 + i, &query)).collect();
    eventually("a queue", || is(2, u64::from(WAITING))).await;
    let kept = waiting.pop().expect("the last");
    waiting.iter().for_each(JoinHandle::abort);
    eventually("an end of those that wait", || cancelled() == [u64::from(WAITING) - 1, 0]).await;
    at_work.iter().for_each(JoinHandle::abort);
    assert!(matches!(kept.await.expect("it ends"), Outcome::Pose(_)));
    eventually("an end of those at work", || cancelled() == [u64::from(WAITING) - 1, 2] && is(0, 0)).await;
    assert_eq!(answered(), before + 1);
    // The next ones are answered as if nothing had been.
    assert!(matches!(ask(99, &query).await.expect("it ends"), Outcome::Pose(_)));
}

/// The sealed bytes are what the device sent, to every member that sees them, however often.
#[tokio::test(flavor = "multi_thread")]
async fn every_message_holds_the_very_same_sealed_bytes() {
    let town = Town::new(10);
    let bus = Bus::in_process();
    let machines = Machines::start(&town, bus.clone(), &["all"]).await;
    let seen = Arc::new(std::sync::Mutex::new(Vec::new()));
    let keep = seen.clone();
    let _listener = impostor(&bus, &town.subject(0), move |incoming| {
        if let Wanted::Pose { body, .. } = understood(&incoming).wanted {
            keep.lock().expect("whole").push(body.to_vec());
        }
        std::future::ready(())
    })
    .await;
    let query = town.query(&truth());
    for _ in 0..6 {
        machines.ask(&query).await.expect("a pose");
    }
    let seen = seen.lock().expect("whole");
    assert!(!seen.is_empty() && seen.iter().all(|body| *body == query), "{} messages", seen.len());
}

#[tokio::test(flavor = "multi_thread")]
async fn who_talks_nonsense_is_asked_around_and_alone_is_not_believed() {
    let town = Town::new(10);
    let query = town.query(&truth());
    type Nonsense = fn(&Request) -> bytes::Bytes;
    let all: [(&str, Nonsense); 6] = [
        ("garbage", |_| b"\xff\xff garbage".to_vec().into()),
        ("nothing", |_| bytes::Bytes::new()),
        ("much", |_| vec![0; 8 << 20].into()),
        ("another request's", |request| {
            let other = Request { name: [9; 16], ..request.clone() };
            reply(&other, Outcome::LocalizeFailure(LocalizeFailure::NoPose(NoPose::TooFew)))
        }),
        ("what was not asked", |request| reply(request, Outcome::Here)),
        ("regions", |request| reply(request, Outcome::Regions(Vec::new()))),
    ];
    for (what, nonsense) in all {
        let bus = Bus::in_process();
        let machines = Machines::start(&town, bus.clone(), &["all", INDEX_ALONE]).await;
        let lies = Arc::new(AtomicUsize::new(0));
        let told = lies.clone();
        let liar = impostor(&bus, &town.subject(0), move |incoming| {
            let told = told.clone();
            async move {
                let request = understood(&incoming);
                // Whoever asked may have been told by somebody else meanwhile.
                let _ = incoming.answer(nonsense(&request)).await;
                told.fetch_add(1, Ordering::Relaxed);
            }
        })
        .await;
        for _ in 0..4 {
            assert!(machines.ask(&query).await.expect(what).trusted, "{what}");
        }
        eventually("members take turns", || lies.load(Ordering::Relaxed) > 0).await;
        assert!(machines.leave().await, "{what}");
        let alone = machines.ask(&query).await;
        assert!(matches!(alone, Err(LocalizeFailure::Unreached { .. })), "{what}: {alone:?}");
        assert!(machines.counted("veiloc_cluster_messages_total{end=\"bad-reply\"}") > 0, "{what}");
        liar.abort();
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn who_is_told_to_go_elsewhere_goes_and_is_told_the_reason_when_there_is_nowhere() {
    let town = Town::new(10);
    let query = town.query(&truth());
    let seven = 7.try_into().expect("not zero");
    let cases = [
        (Why::Busy { retry_after: seven }, LocalizeFailure::Busy { retry_after: seven }),
        (Why::Leaving, LocalizeFailure::Unreached { retry_after: 1.try_into().expect("not zero") }),
        (Why::Broken, LocalizeFailure::Broken),
    ];
    for (why, expected) in cases {
        let bus = Bus::in_process();
        let machines = Machines::start(&town, bus.clone(), &["all", INDEX_ALONE]).await;
        let busy = impostor(&bus, &town.subject(0), move |incoming| async move {
            let request = understood(&incoming);
            incoming.answer(reply(&request, Outcome::Rejected(why))).await.expect("sent");
        })
        .await;
        for _ in 0..4 {
            assert!(machines.ask(&query).await.expect("a pose").trusted);
        }
        assert!(machines.leave().await);
        assert_eq!(machines.ask(&query).await.expect_err("nobody else"), expected);
        busy.abort();
    }
}

/// A worker that was asked and is told to leave answers first; one that is dropped does not, and is asked around.
#[tokio::test(flavor = "multi_thread")]
async fn workers_come_and_go_and_every_query_is_answered() {
    let town = Arc::new(Town::new(4));
    let bus = Bus::in_process();
    let machines = Arc::new(Machines::start(&town, bus, &["all", "all"]).await);
    let (stop, answered) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicUsize::new(0)));
    let clients: Vec<_> = (0..3)
        .map(|client| {
            let (machines, town) = (machines.clone(), town.clone());
            let (stop, answered) = (stop.clone(), answered.clone());
            tokio::spawn(async move {
                let queries = town.queries(5);
                for query in queries.iter().cycle().skip(client) {
                    if stop.load(Ordering::Relaxed) {
                        return;
                    }
                    assert!(machines.ask(query).await.expect("a pose").trusted);
                    answered.fetch_add(1, Ordering::Relaxed);
                }
            })
        })
        .collect();
    for _ in 0..4 {
        machines.add(&town, "all").await;
        let before = answered.load(Ordering::Relaxed);
        assert!(machines.leave().await, "it finishes what it was asked");
        eventually("more answers", || answered.load(Ordering::Relaxed) > before + 3).await;
    }
    stop.store(true, Ordering::Relaxed);
    for client in clients {
        client.await.expect("no query was lost");
    }
}

/// The grace of workers is over when the gateway asks by the new manifest, and not before, as time passes here.
#[tokio::test(start_paused = true)]
async fn a_new_manifest_takes_over_without_a_lost_query() {
    const DAY: Duration = Duration::from_secs(86_400);
    let _held = hold_the_clock();
    let town = Arc::new(Town::new(5));
    let bus = Bus::in_process();
    let workers = ["1/2", "2/2"].map(|share| {
        let mut options = worker_options(share);
        options.grace = Duration::from_secs(3600);
        options
    });
    let machines = Arc::new(Machines::start_with(&town, bus.clone(), workers.into()).await);
    let stop = Arc::new(AtomicBool::new(false));
    let clients: Vec<_> = (0..3)
        .map(|client| {
            let (machines, town, stop) = (machines.clone(), town.clone(), stop.clone());
            tokio::spawn(async move {
                let (queries, mut asked) = (town.queries(5), 0);
                for query in queries.iter().cycle().skip(client) {
                    if stop.load(Ordering::Relaxed) {
                        break;
                    }
                    let question = machines.question(query, DAY);
                    assert!(machines.gateway.localize(question).await.expect("a pose").trusted);
                    asked += 1;
                }
                asked
            })
        })
        .collect();
    for (images, of_region) in [(9, 4), (10, 3), (8, 8)] {
        let old = town.subject(0);
        let manifest = town.publish(images, of_region);
        pass_until(OFTEN, "the new manifest", || machines.gateway.manifest() == Some(manifest.id())).await;
        let description = machines.gateway.describe().expect("held");
        assert_eq!(description.images, images as usize);
        // What nobody asks for any more is given back in the end.
        let left =
            || futures_util::FutureExt::now_or_never(bus.request(&old, "".into(), Duration::from_secs(9)));
        assert!(left().is_none(), "not before its time");
        let is_left = || matches!(left(), Some(Err(veiloc_cluster::ClusterError::Nobody { .. })));
        pass_until(Duration::from_secs(60), "nobody", is_left).await;
    }
    stop.store(true, Ordering::Relaxed);
    for client in clients {
        assert!(client.await.expect("no query was lost") > 0);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn nothing_is_asked_until_every_region_has_somebody() {
    let town = Town::new(4);
    let query = town.query(&truth());
    let machines = Machines::start(&town, Bus::in_process(), &["1/2"]).await;
    assert!(machines.gateway.describe().is_none());
    assert!(matches!(machines.ask(&query).await, Err(LocalizeFailure::Unreached { .. })));
    machines.add(&town, "2/2").await;
    eventually("all regions", || machines.gateway.describe().is_some()).await;
    assert!(machines.ask(&query).await.expect("a pose").trusted);
}

#[tokio::test(flavor = "multi_thread")]
async fn what_was_sealed_for_another_map_goes_to_no_worker() {
    let town = Town::new(10);
    let machines = Machines::start(&town, Bus::in_process(), &["all"]).await;
    let other = common::service::Place::new(5).sealed(&truth());
    assert_eq!(machines.ask(&other).await.expect_err("refused"), LocalizeFailure::WrongProfile);
    assert_eq!(machines.counted("veiloc_cluster_messages_total{end=\"answered\"}"), 0);
}

/// One request three times to one worker: the first waits there, and those that come later are turned away and take nothing
/// from it.
#[tokio::test(flavor = "multi_thread")]
async fn a_worker_that_is_at_it_says_so_and_goes_on() {
    let town = Town::new(10);
    let mut options = worker_options("all");
    options.localize.pose.max_hypotheses = usize::MAX;
    let machines = Machines::start_with(&town, Bus::in_process(), vec![options]).await;
    let worker = machines.handle();
    let ask = |name: u8, body: &[u8]| ask_worker(&town, &machines, name, body);
    let endless = town.place.sealed_without_consensus();
    let at_work = [ask(1, &endless), ask(2, &endless)];
    let is = |what: &str, count: u64| common::value(&worker.metrics(), what) == count;
    eventually("work on both threads", || is("veiloc_workers_busy", 2)).await;
    let query = town.query(&truth());
    let first = ask(5, &query);
    eventually("a queue", || is("veiloc_queue_length", 1)).await;
    for _ in 0..2 {
        let twin = ask(5, &query).await.expect("it ends");
        assert!(matches!(twin, Outcome::Rejected(Why::AtIt)), "{twin:?}");
    }
    at_work.iter().for_each(JoinHandle::abort);
    assert!(matches!(first.await.expect("it ends"), Outcome::Pose(_)));
    assert!(matches!(ask(5, &query).await.expect("it ends"), Outcome::Pose(_)), "not at it any more");
}

#[tokio::test(flavor = "multi_thread")]
async fn time_is_over_when_it_is_over() {
    let town = Town::new(10);
    let bus = Bus::in_process();
    let machines = Machines::start(&town, bus.clone(), &["all"]).await;
    assert!(machines.leave().await);
    let _silent = impostor(&bus, &town.subject(0), |_| std::future::ready(())).await;
    let _index = impostor(&bus, &town.index_subject(), |_| std::future::ready(())).await;
    let question: RemoteRequest = machines.question(&town.query(&truth()), Duration::from_millis(200));
    assert_eq!(
        machines.gateway.localize(question).await.expect_err("nobody says a word"),
        LocalizeFailure::TimedOut
    );
}
