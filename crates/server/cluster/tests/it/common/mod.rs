//! A published map: the random points of the service's tests, mapped, cut into regions and published; and a gateway with
//! workers, which are services on loopback.
#![allow(dead_code, unreachable_pub)] // each test program uses its own part

#[path = "../../../../service/tests/it/common/mod.rs"]
pub mod service;

use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use tokio::runtime::Handle;
use tokio::task::block_in_place;
use veiloc_cluster::object_store::Storage;
use veiloc_cluster::{Gateway, GatewayOptions, PublishedMaps, StoredRegions, WorkerAccess, Workers};
use veiloc_geometry::CameraFromWorld;
use veiloc_localization::LocalizeOptions;
use veiloc_map::regions::{FolderWriter, Manifest, ObjectId, RegionFolder, SplitOptions, cut};
use veiloc_map::{MapFile, MapMemory};
use veiloc_protocol::Answer;
use veiloc_service::telemetry::{
    GatewayCounts, GaugeValues, Metrics, MetricsOptions, RegionCounts, RequestIds,
};
use veiloc_service::{
    BodyKind, DecodedRequest, LocalizeFailure, Regions, RemoteBackend as _, RemoteRequest, ServerOptions,
};

use service::{Running, TestScene, no_timeouts, pose, tokens_file};

pub const MAP: &str = "town";
/// The token of the gateway.
pub const GATEWAY: &str = "gateway-token";

/// Longer than any step on any machine.
pub const STEP_TIMEOUT: Duration = Duration::from_secs(120);

/// Short polling interval, so that tests are short.
pub const POLL_INTERVAL: Duration = Duration::from_millis(20);

/// Runs slow storage operations, whose futures are not `Send`.
pub fn run<T>(future: impl Future<Output = T>) -> T {
    block_in_place(|| Handle::current().block_on(future))
}

pub struct PublishedMap {
    folder: tempfile::TempDir,
    pub scene: TestScene,
    manifest: Mutex<Manifest>,
}

impl PublishedMap {
    /// A published map of ten images, in regions of at most this many images.
    pub fn new(images: usize) -> Self {
        let (folder, scene) = (tempfile::tempdir().expect("temporary folder"), TestScene::new(1));
        let regions = write_regions(&scene, &folder.path().join("regions-0"), 10, images);
        let published = Self { folder, scene, manifest: Mutex::new(regions.manifest().clone()) };
        published.publish_folder(&regions);
        std::fs::write(published.path("tokens"), tokens_file(&[(GATEWAY, "gateway")])).expect("written");
        published
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn store(&self) -> PathBuf {
        self.path("store")
    }

    pub fn map(&self, images: u32) -> MapFile {
        MapFile::of_model(&self.scene.map(images)).expect("a map")
    }

    /// Publishes a map of this many images, in regions of at most `of_region` images.
    pub fn publish(&self, images: u32, of_region: usize) -> Manifest {
        let folder = self.path(&format!("regions-{images}-{of_region}"));
        self.publish_folder(&write_regions(&self.scene, &folder, images, of_region))
    }

    fn publish_folder(&self, folder: &RegionFolder) -> Manifest {
        let storage = Storage::create(self.store().to_str().expect("text")).expect("a folder");
        run(storage.publish(folder, &|_, _| ())).expect("published");
        *self.manifest.lock().expect("whole") = folder.manifest().clone();
        folder.manifest().clone()
    }

    /// The published regions.
    pub fn folder(&self) -> RegionFolder {
        RegionFolder::of(self.manifest(), &self.store())
    }

    pub fn manifest(&self) -> Manifest {
        self.manifest.lock().expect("whole").clone()
    }

    /// The file of a region in the store.
    pub fn object(&self, number: usize) -> PathBuf {
        self.folder().path_of(&self.region(number))
    }

    pub fn region(&self, number: usize) -> ObjectId {
        self.manifest().regions[number].sha256
    }

    /// The store, with a cache of this name and size. Retries end at once.
    pub fn maps(&self, cache: &str, max_bytes: u64) -> PublishedMaps {
        let storage = Storage::open_lazily(self.store().to_str().expect("text")).expect("a folder");
        let storage = storage.with_retry_policy(1, Duration::from_millis(1), Duration::from_secs(3600));
        PublishedMaps::of(storage, &self.path(cache), max_bytes).expect("a cache")
    }

    /// Sealed queries from different poses.
    pub fn queries(&self, count: u32) -> Vec<Vec<u8>> {
        let pose = |i: u32| pose(0.06 * f64::from(i % 7) - 0.2, 0.1 * f64::from(i % 5));
        (0..count).map(|i| self.scene.sealed(&pose(i))).collect()
    }

    pub fn query(&self, pose: &CameraFromWorld) -> Vec<u8> {
        self.scene.sealed(pose)
    }

    /// Options of a worker with this cache.
    pub fn worker_options(&self, cache: &str, max_bytes: u64) -> ServerOptions {
        let mut options = ServerOptions::new(Vec::new());
        options.listen = vec!["127.0.0.1:0".parse().expect("an address")];
        options.admin = Some("127.0.0.1:0".parse().expect("an address"));
        options.tokens = Some(self.path("tokens"));
        options.threads = NonZeroUsize::MIN.saturating_add(1);
        options.timeouts = no_timeouts();
        let counts = RegionCounts::default();
        let source = StoredRegions::start(self.maps(cache, max_bytes), POLL_INTERVAL, counts.clone());
        options.regions = Some(Regions { source: Arc::new(source), counts });
        options
    }

    /// A worker with a cache of its own.
    pub fn worker(&self, name: &str) -> Running {
        let options = self.worker_options(name, 1 << 30);
        block_in_place(|| Running::start(options))
    }
}

fn write_regions(scene: &TestScene, folder: &std::path::Path, images: u32, of_region: usize) -> RegionFolder {
    let map = MapFile::of_model(&scene.map(images)).expect("a map");
    let regions = cut(&map, &SplitOptions::default().with_images(of_region)).expect("regions");
    let writer = FolderWriter::begin(&map, MAP, folder).expect("a folder");
    let entries = regions.iter().map(|region| writer.region(region).expect("written")).collect();
    writer.finish(&regions, entries).expect("a manifest");
    RegionFolder::open(folder).expect("written")
}

/// Address of a worker.
pub fn url_of(worker: &Running) -> String {
    format!("http://{}", worker.address)
}

/// A gateway of given workers.
pub struct TestGateway {
    pub gateway: Gateway,
    counts: GatewayCounts,
    ids: RequestIds,
}

impl TestGateway {
    pub async fn start(published: &PublishedMap, workers: Vec<String>) -> Self {
        let counts = GatewayCounts::default();
        let mut access = WorkerAccess::new(workers);
        access.token = Some(GATEWAY.to_owned());
        let workers = Workers::start(&access, counts.clone()).await.expect("workers");
        let mut options = GatewayOptions::new(MAP);
        options.watch = POLL_INTERVAL;
        let maps = published.maps("gateway", 1 << 30);
        let gateway = Gateway::start(maps, workers, options, counts.clone()).await.expect("a gateway");
        Self { gateway, counts, ids: RequestIds::start().expect("randomness") }
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
    pub fn metric(&self, series: &str) -> f64 {
        let metrics =
            Metrics::new(&MetricsOptions { gateway: Some(&self.counts), ..MetricsOptions::default() });
        service::value(&metrics.text(&GaugeValues::default()), series).expect("it is counted")
    }

    /// Requests to workers that ended so.
    pub fn requests(&self, outcome: &str) -> f64 {
        self.metric(&format!("veiloc_gateway_requests_total{{outcome=\"{outcome}\"}}"))
    }
}

/// Localizes directly in a region, without a service.
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
