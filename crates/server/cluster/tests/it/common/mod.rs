//! A published map: the random points of the service's tests, mapped, cut into regions and published; and machines that
//! communicate within this process, or over a given bus.
#![allow(dead_code, unreachable_pub)] // each test program uses its own part

#[path = "../../../../service/tests/it/common/mod.rs"]
pub mod service;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use tokio::task::{JoinHandle, JoinSet};
use veiloc_cluster::bus::{Bus, Incoming, Subject};
use veiloc_cluster::message::{Load, Reply, ReplyOutcome, Request, Task};
use veiloc_cluster::{
    Announced, Announcement, FolderSource, FrameVersions, Gateway, GatewayOptions, MemberId, RegionShare,
    VERSION, Worker, WorkerHandle, WorkerOptions,
};
use veiloc_geometry::CameraFromWorld;
use veiloc_localization::LocalizeOptions;
use veiloc_map::regions::{FolderWriter, Manifest, ObjectId, RegionFolder, SplitOptions, cut};
use veiloc_map::{MapFile, MapMemory};
use veiloc_protocol::Answer;
use veiloc_service::telemetry::{
    GatewayCounts, GaugeValues, Metrics, MetricsOptions, RequestIds, WorkerCounts,
};
use veiloc_service::worker_api::Controllable as _;
use veiloc_service::{BodyKind, DecodedRequest, LocalizeFailure, RemoteBackend as _, RemoteRequest};

use service::{TestScene, pose};

pub const MAP: &str = "town";

/// Longer than any step on any machine.
pub const STEP_TIMEOUT: Duration = Duration::from_secs(120);

/// Short polling interval, so that tests are short.
pub const POLL_INTERVAL: Duration = Duration::from_millis(20);

/// The longest period of announcements.
const LONG_PERIOD: Duration = Duration::from_secs(60);

pub struct PublishedMap {
    folder: tempfile::TempDir,
    pub scene: TestScene,
}

impl PublishedMap {
    /// A published map of ten images, in regions of at most this many images.
    pub fn new(images: usize) -> Self {
        let published =
            Self { folder: tempfile::tempdir().expect("temporary folder"), scene: TestScene::new(1) };
        published.publish(10, images);
        published
    }

    pub fn regions(&self) -> PathBuf {
        self.folder.path().join("regions")
    }

    pub fn map(&self, images: u32) -> MapFile {
        MapFile::of_model(&self.scene.map(images)).expect("a map")
    }

    /// Publishes a map of this many images, in regions of at most `of_region` images; atomically for readers, as
    /// `veiloc map publish` does.
    pub fn publish(&self, images: u32, of_region: usize) -> Manifest {
        self.publish_spoilt(images, of_region, |_, _| ())
    }

    /// The same, after `spoil` modified its objects.
    pub fn publish_spoilt(
        &self,
        images: u32,
        of_region: usize,
        spoil: impl FnOnce(&Path, &Manifest),
    ) -> Manifest {
        let next = self.folder.path().join("next");
        let map = self.map(images);
        let regions = cut(&map, &SplitOptions::default().with_images(of_region)).expect("regions");
        let writer = FolderWriter::begin(&map, MAP, &next).expect("a folder");
        let entries = regions.iter().map(|region| writer.region(region).expect("written")).collect();
        let manifest = writer.finish(&regions, entries).expect("a manifest");
        let (from, to) = (next.join("objects"), self.regions().join("objects"));
        std::fs::create_dir_all(&to).expect("a folder");
        for entry in std::fs::read_dir(&from).expect("a folder") {
            let name = entry.expect("an entry").file_name();
            std::fs::copy(from.join(&name), to.join(&name)).expect("copied");
        }
        spoil(&to, &manifest);
        std::fs::rename(next.join("manifest.json"), self.regions().join("manifest.json")).expect("replaced");
        manifest
    }

    pub fn folder(&self) -> RegionFolder {
        RegionFolder::open(&self.regions()).expect("published")
    }

    pub fn source(&self) -> Arc<FolderSource> {
        Arc::new(FolderSource::new(&self.regions()))
    }

    pub fn region(&self, number: usize) -> ObjectId {
        self.folder().manifest().regions[number].sha256
    }

    pub fn index(&self) -> ObjectId {
        self.folder().manifest().index.sha256
    }

    /// Sealed queries from different poses.
    pub fn queries(&self, count: u32) -> Vec<Vec<u8>> {
        let pose = |i: u32| pose(0.06 * f64::from(i % 7) - 0.2, 0.1 * f64::from(i % 5));
        (0..count).map(|i| self.scene.sealed(&pose(i))).collect()
    }

    pub fn query(&self, pose: &CameraFromWorld) -> Vec<u8> {
        self.scene.sealed(pose)
    }
}

/// A gateway and workers, with their metrics.
pub struct TestCluster {
    pub bus: Bus,
    pub gateway: Gateway,
    counts: GatewayCounts,
    ids: RequestIds,
    workers: Mutex<Vec<(WorkerHandle, JoinHandle<bool>)>>,
}

impl TestCluster {
    /// Starts workers for these shares, which must be all regions, and waits until the gateway knows them.
    pub async fn start(published: &PublishedMap, bus: Bus, shares: &[&str]) -> Self {
        let options = shares.iter().map(|share| worker_options(share)).collect();
        let cluster = Self::start_with(published, bus, options).await;
        cluster.knows(shares.len()).await;
        cluster
    }

    /// Waits until the gateway knows this number of members, and each region has one.
    pub async fn knows(&self, members: usize) {
        let count = format!("veiloc_cluster_members{{map=\"{MAP}\",state=\"answering\"}}");
        let is_so = || self.gateway.is_complete() && self.metric(&count) == members as u64;
        eventually("the members", is_so).await;
    }

    /// Starts workers with these options.
    pub async fn start_with(published: &PublishedMap, bus: Bus, all: Vec<WorkerOptions>) -> Self {
        let counts = GatewayCounts::default();
        let mut options = GatewayOptions::new(MAP);
        options.watch = POLL_INTERVAL;
        let gateway = Gateway::start(bus.clone(), published.source(), options, counts.clone())
            .await
            .expect("a gateway");
        let ids = RequestIds::start().expect("randomness");
        // The gateway hears the first announcement of each.
        let mut workers = Vec::new();
        for options in all {
            workers.push(start_worker(published, &bus, options).await);
        }
        Self { bus, gateway, counts, ids, workers: Mutex::new(workers) }
    }

    pub async fn add(&self, published: &PublishedMap, share: &str) {
        self.start_worker(published, worker_options(share)).await;
    }

    /// Adds a worker with these options.
    pub async fn start_worker(&self, published: &PublishedMap, options: WorkerOptions) {
        let worker = start_worker(published, &self.bus, options).await;
        self.workers.lock().expect("whole").push(worker);
    }

    /// The handles of all workers.
    pub fn handles(&self) -> Vec<WorkerHandle> {
        self.workers.lock().expect("whole").iter().map(|(handle, _)| handle.clone()).collect()
    }

    /// Stops the first worker; returns whether it finished its requests.
    pub async fn leave(&self) -> bool {
        let (handle, running) = self.workers.lock().expect("whole").remove(0);
        handle.stop();
        running.await.expect("it ends")
    }

    pub fn request(&self, bytes: &[u8], within: Duration) -> RemoteRequest {
        RemoteRequest {
            id: self.ids.next(),
            client: None,
            decoded: DecodedRequest::decode(BodyKind::Query, bytes).expect("a sealed query"),
            bytes: bytes.to_vec(),
            near: None,
            within,
            trace: None,
        }
    }

    pub async fn ask(&self, bytes: &[u8]) -> Result<Answer, LocalizeFailure> {
        self.gateway.localize(self.request(bytes, STEP_TIMEOUT)).await
    }

    /// A value of the gateway's metrics.
    pub fn metric(&self, what: &str) -> u64 {
        let metrics =
            Metrics::new(&MetricsOptions { gateway: Some(&self.counts), ..MetricsOptions::default() });
        let text = metrics.text(&GaugeValues::default());
        value(&text, what)
    }

    /// The handle of the first worker.
    pub fn handle(&self) -> WorkerHandle {
        self.workers.lock().expect("whole")[0].0.clone()
    }
}

/// A value in a text of metrics.
pub fn value(text: &str, what: &str) -> u64 {
    let line = text.lines().find_map(|line| line.strip_prefix(what)).expect("it is counted");
    line.trim().parse().expect("a count")
}

/// Options of a worker with two threads and this share.
pub fn worker_options(share: &str) -> WorkerOptions {
    let mut options = WorkerOptions::new(MAP);
    options.share = share.parse::<RegionShare>().expect("a share");
    options.threads = 2.try_into().expect("not zero");
    // Announced when something changes, and never late on a busy machine.
    (options.watch, options.period) = (POLL_INTERVAL, LONG_PERIOD);
    (options.grace, options.finish) = (POLL_INTERVAL * 10, STEP_TIMEOUT);
    options
}

async fn start_worker(
    published: &PublishedMap,
    bus: &Bus,
    options: WorkerOptions,
) -> (WorkerHandle, JoinHandle<bool>) {
    let counts = WorkerCounts::new("test", 2, 32);
    let worker = Worker::start(bus.clone(), published.source(), options, counts).await.expect("a worker");
    (worker.handle(), tokio::spawn(worker.run()))
}

/// Where a worker receives its requests.
pub fn subject_of(member: &MemberId) -> Subject {
    Subject::new(["veiloc", MAP, "member", &member.to_string()]).expect("a subject")
}

/// Announces a member that holds these objects and answers pings, and whose reaction to other requests the test defines.
/// Returns what stops it when it is dropped.
pub async fn fake_member<F: Future<Output = ()> + Send>(
    bus: &Bus,
    objects: &[ObjectId],
    act: impl FnMut(Incoming) -> F + Send + 'static,
) -> JoinSet<()> {
    fake_member_of_versions(bus, FrameVersions::OWN, objects, act).await
}

/// The same, of a program that speaks these versions of frames.
pub async fn fake_member_of_versions<F: Future<Output = ()> + Send>(
    bus: &Bus,
    versions: FrameVersions,
    objects: &[ObjectId],
    mut act: impl FnMut(Incoming) -> F + Send + 'static,
) -> JoinSet<()> {
    let member = MemberId::draw().expect("randomness");
    let mut membership = bus.join(&subject_of(&member)).await.expect("joined");
    let load = Load { jobs: 0, free: 32 };
    let (period, objects) = (LONG_PERIOD, objects.iter().copied().collect());
    let announcement =
        Announcement { versions, member, period, leaving: false, threads: 1, load, objects, placed: None };
    let mut tasks = JoinSet::new();
    let announcing = bus.clone();
    tasks.spawn(async move {
        let subject = Subject::new(["veiloc", MAP, "members"]).expect("a subject");
        loop {
            announcing.publish(&subject, announcement.encode()).await.expect("sent");
            tokio::time::sleep(POLL_INTERVAL).await;
        }
    });
    tasks.spawn(async move {
        while let Some(incoming) = membership.next().await {
            match Request::decode(incoming.payload.clone()).expect("a request") {
                Request { name, task: Task::Ping { .. }, .. } => {
                    let reply = reply(name, ReplyOutcome::Here { unknown: Vec::new() });
                    // The requester may be gone.
                    let _ = incoming.answer(reply).await;
                }
                _ => act(incoming).await,
            }
        }
    });
    tasks
}

/// The reply of a worker to the request of this name.
pub fn reply(name: [u8; 16], outcome: ReplyOutcome) -> bytes::Bytes {
    let load = Load { jobs: 0, free: 32 };
    let (worked, waited) = (Duration::ZERO, Duration::ZERO);
    Reply { version: VERSION, name, outcome, worked, waited, load }.encode()
}

/// What is announced, by member.
pub struct Announcements(Arc<Mutex<BTreeMap<MemberId, Announcement>>>);

impl Announcements {
    pub async fn listen(bus: &Bus) -> Self {
        let subject = Subject::new(["veiloc", MAP, "members"]).expect("a subject");
        let mut listener = bus.listen(&subject).await.expect("a listener");
        let all = Arc::new(Mutex::new(BTreeMap::new()));
        let last = all.clone();
        tokio::spawn(async move {
            while let Some(message) = listener.next().await {
                let announced = Announcement::decode(message).expect("an announcement");
                let Announced::Known(announcement) = announced else { panic!("{announced:?}") };
                last.lock().expect("whole").insert(announcement.member, announcement);
            }
        });
        Self(all)
    }

    /// Number of members whose last announcement has this object.
    pub fn holders(&self, object: &ObjectId) -> usize {
        self.0
            .lock()
            .expect("whole")
            .values()
            .filter(|member| !member.leaving && member.objects.contains(object))
            .count()
    }
}

/// Localizes directly in a region, without a cluster.
pub fn localize_locally(map: &MapFile, bytes: &[u8]) -> Result<Answer, LocalizeFailure> {
    let request = DecodedRequest::decode(BodyKind::Query, bytes).expect("a sealed query");
    request.localize(map, &LocalizeOptions::default(), 0.0)
}

pub fn region(folder: &RegionFolder, number: usize) -> MapFile {
    folder.open_region(number, MapMemory::Copied).expect("a region")
}

/// An answer without its times, which differ between runs.
pub fn without_times(mut answer: Answer) -> Answer {
    answer.times = veiloc_protocol::AnswerTimes::default();
    answer
}

/// Waits until a condition holds; fails after a minute.
pub async fn eventually(what: &str, mut is_so: impl FnMut() -> bool) {
    for _ in 0..3000 {
        if is_so() {
            return;
        }
        tokio::time::sleep(POLL_INTERVAL).await;
    }
    panic!("timed out waiting for {what}");
}
