//! A town: the random points of the service's tests, mapped, cut into regions and published; and machines that talk within
//! this process, or over whatever bus they are given.
#![allow(dead_code, unreachable_pub)] // each test program uses its own part

#[path = "../../../../service/tests/it/common/mod.rs"]
pub mod service;

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use tokio::task::JoinHandle;
use veiloc_cluster::bus::{Bus, Incoming, Subject};
use veiloc_cluster::{FolderSource, Gateway, GatewayOptions, Share, Worker, WorkerHandle, WorkerOptions};
use veiloc_geometry::CameraFromWorld;
use veiloc_localization::LocalizeOptions;
use veiloc_map::regions::{Folder, FolderWriter, Manifest, SplitOptions, cut};
use veiloc_map::{MapFile, MapMemory};
use veiloc_protocol::Answer;
use veiloc_service::labour::Controllable as _;
use veiloc_service::telemetry::{GatewayCounts, Metrics, MetricsOptions, GaugeValues, RequestIds, WorkerCounts};
use veiloc_service::{DecodedRequest, RemoteBackend as _, BodyKind, RemoteRequest, LocalizeFailure};

use service::{Place, pose};

pub const MAP: &str = "town";

/// Longer than anything takes on any machine.
pub const LONG: Duration = Duration::from_secs(120);

/// How often machines look what is published: often, so that tests are short.
pub const OFTEN: Duration = Duration::from_millis(20);

pub struct Town {
    folder: tempfile::TempDir,
    pub place: Place,
}

impl Town {
    /// With a map of ten images in regions of at most so many.
    pub fn new(images: usize) -> Self {
        let town = Self { folder: tempfile::tempdir().expect("temporary folder"), place: Place::new(1) };
        town.publish(10, images);
        town
    }

    pub fn regions(&self) -> PathBuf {
        self.folder.path().join("regions")
    }

    pub fn map(&self, images: u32) -> MapFile {
        MapFile::of_model(&self.place.map(images)).expect("a map")
    }

    /// Replaces what is published by a map of so many images, in regions of at most so many; as one step for readers, as
    /// `veiloc map publish` does.
    pub fn publish(&self, images: u32, of_region: usize) -> Manifest {
        self.publish_spoilt(images, of_region, |_, _| ())
    }

    /// The same, after something was done to its objects.
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

    pub fn folder(&self) -> Folder {
        Folder::open(&self.regions()).expect("published")
    }

    pub fn source(&self) -> Arc<FolderSource> {
        Arc::new(FolderSource::new(&self.regions()))
    }

    /// Where region 0 is asked.
    pub fn subject(&self, region: usize) -> Subject {
        let sha = self.folder().manifest().regions[region].sha256.to_string();
        Subject::new(["veiloc", MAP, "region", &sha]).expect("a subject")
    }

    pub fn index_subject(&self) -> Subject {
        let sha = self.folder().manifest().index.sha256.to_string();
        Subject::new(["veiloc", MAP, "index", &sha]).expect("a subject")
    }

    /// Sealed queries of different places.
    pub fn queries(&self, count: u32) -> Vec<Vec<u8>> {
        let pose = |i: u32| pose(0.06 * f64::from(i % 7) - 0.2, 0.1 * f64::from(i % 5));
        (0..count).map(|i| self.place.sealed(&pose(i))).collect()
    }

    pub fn query(&self, pose: &CameraFromWorld) -> Vec<u8> {
        self.place.sealed(pose)
    }
}

/// Gateway and workers, and what they count.
pub struct Machines {
    pub bus: Bus,
    pub gateway: Gateway,
    counts: GatewayCounts,
    ids: RequestIds,
    workers: Mutex<Vec<(WorkerHandle, JoinHandle<bool>)>>,
}

impl Machines {
    /// With workers for these shares.
    pub async fn start(town: &Town, bus: Bus, shares: &[&str]) -> Self {
        Self::start_with(town, bus, shares.iter().map(|share| worker_options(share)).collect()).await
    }

    /// With workers that do as these options say.
    pub async fn start_with(town: &Town, bus: Bus, all: Vec<WorkerOptions>) -> Self {
        let mut workers = Vec::new();
        for options in all {
            workers.push(start_worker(town, &bus, options).await);
        }
        let counts = GatewayCounts::default();
        let mut options = GatewayOptions::new(MAP);
        options.watch = OFTEN;
        let gateway =
            Gateway::start(bus.clone(), town.source(), options, counts.clone()).await.expect("a gateway");
        let ids = RequestIds::start().expect("randomness");
        Self { bus, gateway, counts, ids, workers: Mutex::new(workers) }
    }

    pub async fn add(&self, town: &Town, share: &str) {
        let worker = start_worker(town, &self.bus, worker_options(share)).await;
        self.workers.lock().expect("whole").push(worker);
    }

    /// Tells the first worker to leave; whether it finished all it was asked.
    pub async fn leave(&self) -> bool {
        let (handle, running) = self.workers.lock().expect("whole").remove(0);
        handle.stop();
        running.await.expect("it ends")
    }

    pub fn question(&self, bytes: &[u8], within: Duration) -> RemoteRequest {
        RemoteRequest {
            request: self.ids.next(),
            asked: DecodedRequest::decode(BodyKind::Query, bytes).expect("a sealed query"),
            bytes: bytes.to_vec(),
            near: None,
            within,
        }
    }

    pub async fn ask(&self, bytes: &[u8]) -> Result<Answer, LocalizeFailure> {
        self.gateway.localize(self.question(bytes, LONG)).await
    }

    /// A value of the gateway's metrics.
    pub fn counted(&self, what: &str) -> u64 {
        let metrics =
            Metrics::new(&MetricsOptions { gateway: Some(&self.counts), ..MetricsOptions::default() });
        let text = metrics.text(&GaugeValues::default());
        value(&text, what)
    }

    /// The first worker.
    pub fn handle(&self) -> WorkerHandle {
        self.workers.lock().expect("whole")[0].0.clone()
    }
}

/// A value of a page of metrics.
pub fn value(text: &str, what: &str) -> u64 {
    let line = text.lines().find_map(|line| line.strip_prefix(what)).expect("it is counted");
    line.trim().parse().expect("a count")
}

/// Of a worker with two threads that takes this share.
pub fn worker_options(share: &str) -> WorkerOptions {
    let mut options = WorkerOptions::new(MAP);
    options.share = share.parse::<Share>().expect("a share");
    options.threads = 2.try_into().expect("not zero");
    (options.watch, options.grace, options.finish) = (OFTEN, OFTEN * 10, LONG);
    options
}

async fn start_worker(town: &Town, bus: &Bus, options: WorkerOptions) -> (WorkerHandle, JoinHandle<bool>) {
    let counts = WorkerCounts::new("test", 2, 32);
    let worker = Worker::start(bus.clone(), town.source(), options, counts).await.expect("a worker");
    (worker.handle(), tokio::spawn(worker.run()))
}

/// Joins a region's group as a member that does with a request what the test says.
pub async fn impostor<F: Future<Output = ()> + Send>(
    bus: &Bus,
    subject: &Subject,
    mut act: impl FnMut(Incoming) -> F + Send + 'static,
) -> JoinHandle<()> {
    let mut membership = bus.join(subject).await.expect("joined");
    tokio::spawn(async move {
        while let Some(incoming) = membership.next().await {
            act(incoming).await;
        }
    })
}

/// What a region gives by itself, without any machine between.
pub fn directly(map: &MapFile, bytes: &[u8]) -> Result<Answer, LocalizeFailure> {
    let asked = DecodedRequest::decode(BodyKind::Query, bytes).expect("a sealed query");
    asked.localize(map, &LocalizeOptions::default(), 0.0).map(|found| found.answer)
}

pub fn region(folder: &Folder, number: usize) -> MapFile {
    folder.open_region(number, MapMemory::Copied).expect("a region")
}

/// An answer without what differs from run to run.
pub fn timeless(mut answer: Answer) -> Answer {
    answer.times = veiloc_protocol::AnswerTimes::default();
    answer
}

/// Waits until something is so; a test that waits in vain fails instead of hanging.
pub async fn eventually(what: &str, mut is_so: impl FnMut() -> bool) {
    for _ in 0..3000 {
        if is_so() {
            return;
        }
        tokio::time::sleep(OFTEN).await;
    }
    panic!("{what} never came about");
}
