//! A scene of random points, and a real server on a loopback port.
#![allow(dead_code, unreachable_pub)] // each test program uses its own part

pub mod collector;
pub mod gate;
pub mod http;
pub mod mark;
pub mod own_process;

use std::net::SocketAddr;
use std::ops::{Deref, DerefMut};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, mpsc};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha20Rng;
use tokio::sync::mpsc::{UnboundedSender, unbounded_channel};
use veiloc_descriptor::{DescriptorKind, Descriptors};
use veiloc_features::Features;
use veiloc_geometry::{CameraFromWorld, Intrinsics};
use veiloc_obfuscation::{Extracted, KnownPlace, PackUse, SealOptions, Sealer};
use veiloc_protocol::{Pack, Profile, SealedQuery};
use veiloc_service::{
    Clock, Listening, MapSource, Server, ServerHandle, ServerOptions, ShutdownSummary, Timeouts,
};

use veiloc_testing::RandomScene;

use http::{Request, Response};

/// Token of a client.
pub const PHONE: &str = "phone-token";
/// The token that may read metrics.
pub const OPERATOR: &str = "operator-token";

/// A scene of 900 random points, and the queries of a device in it.
pub struct TestScene(RandomScene);

impl Deref for TestScene {
    type Target = RandomScene;

    fn deref(&self) -> &RandomScene {
        &self.0
    }
}

impl DerefMut for TestScene {
    fn deref_mut(&mut self) -> &mut RandomScene {
        &mut self.0
    }
}

impl TestScene {
    pub fn new(seed: u64) -> Self {
        Self(RandomScene::new(seed, 900, 8, "SIMPLE_RADIAL,640,480,520,322,238,-0.04"))
    }

    /// A sealed query from this pose, encoded.
    pub fn sealed(&self, pose: &CameraFromWorld) -> Vec<u8> {
        let mut rng = ChaCha20Rng::seed_from_u64(3);
        seal_features(self.features(pose), &self.camera, &self.profile, &mut rng).encode()
    }

    /// A match query of a device with this pack.
    pub fn matched(&self, pose: &CameraFromWorld, pack: Pack) -> Vec<u8> {
        let place = KnownPlace::new(pack).expect("sift");
        let options = SealOptions::default().with_place(place, PackUse::Matches);
        let sealer = Sealer::new(&self.profile, options).expect("its profile");
        let extracted = Extracted::new(self.features(pose), self.camera);
        sealer.seal(extracted, &mut ChaCha20Rng::seed_from_u64(3)).expect("sealed").encode()
    }

    /// A query under the paper's halves whose left half shows this scene and whose right half another: matching lines
    /// share one anchor, so one direction is not constrained.
    pub fn sealed_with_doubts(&self) -> Vec<u8> {
        let own = self.features(&truth());
        let other = TestScene::new(77).features(&truth()).descriptors;
        let middle = f64::from(self.camera.width) / 2.0;
        let row = |i: usize| {
            let shown = if own.keypoints[i].pixel.u < middle { &own.descriptors } else { &other };
            shown.as_bytes()[128 * i..128 * (i + 1)].to_vec()
        };
        self.with_descriptors(row, other.len(), "dcl:paper")
    }

    /// A query whose rows are all equal: no row matches better than another.
    pub fn sealed_without_features(&self) -> Vec<u8> {
        self.with_descriptors(|_| vec![200; 128], usize::MAX, "dcl")
    }

    /// A query in which each row has the descriptor of another point: all match, but no pose is consistent. Under the
    /// paper's halves its search takes minutes without a limit of samples: a sample needs three lines to each anchor.
    pub fn sealed_without_consensus(&self) -> Vec<u8> {
        let own = self.features(&truth()).descriptors;
        let mut shuffled: Vec<usize> = (0..own.len()).collect();
        shuffled.shuffle(&mut ChaCha20Rng::seed_from_u64(5));
        let row = |i: usize| own.as_bytes()[128 * shuffled[i]..128 * (shuffled[i] + 1)].to_vec();
        self.with_descriptors(row, own.len(), "dcl:paper")
    }

    fn with_descriptors(&self, row: impl Fn(usize) -> Vec<u8>, most: usize, scheme: &str) -> Vec<u8> {
        let mut features = self.features(&truth());
        features.keypoints.truncate(most);
        let rows = (0..features.keypoints.len()).flat_map(row).collect();
        features.descriptors = Descriptors::new(DescriptorKind::ROOT_SIFT, rows).expect("whole rows");
        let options = SealOptions::new(scheme.parse().expect("a scheme")).expect("protected");
        let mut rng = ChaCha20Rng::seed_from_u64(4);
        let sealer = Sealer::new(&self.profile, options).expect("its profile");
        sealer.seal(Extracted::new(features, self.camera), &mut rng).expect("sealed").encode()
    }
}

/// Seals features; all tests use this function.
pub fn seal_features(
    features: Features,
    camera: &Intrinsics,
    profile: &Profile,
    rng: &mut ChaCha20Rng,
) -> SealedQuery {
    let sealer = Sealer::new(profile, SealOptions::default()).expect("its profile");
    sealer.seal(Extracted::new(features, *camera), rng).expect("sealed")
}

/// A camera within the mapped part of the scene.
pub use veiloc_testing::pose_in_scene as pose;

/// A pose that differs from all map images.
pub fn truth() -> CameraFromWorld {
    pose(0.13, 0.2)
}

/// Path of a file of the test data.
pub fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

/// A folder with `place.vmap` and `tokens`.
pub struct Files {
    pub folder: tempfile::TempDir,
    pub scene: TestScene,
}

impl Files {
    pub fn new() -> Self {
        let folder = tempfile::tempdir().expect("temporary folder");
        let scene = TestScene::new(1);
        veiloc_map::write(&scene.map(6), &folder.path().join("place.vmap")).expect("written");
        std::fs::write(folder.path().join("tokens"), tokens_file(&[(PHONE, ""), (OPERATOR, "operator")]))
            .expect("written");
        Self { folder, scene }
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Options that serve the map as `place`, with tokens, on a free port, without watching files.
    pub fn options(&self) -> ServerOptions {
        let mut options = self.open_options();
        options.tokens = Some(self.path("tokens"));
        options
    }

    /// The same without tokens.
    pub fn open_options(&self) -> ServerOptions {
        let source = MapSource { name: "place".to_owned(), path: self.path("place.vmap") };
        let mut options = ServerOptions::new(vec![source]);
        options.listen = vec!["127.0.0.1:0".parse().expect("an address")];
        options.admin = Some("127.0.0.1:0".parse().expect("an address"));
        options.rate.per_second = 100_000.try_into().expect("not zero");
        options.rate.burst = 100_000.try_into().expect("not zero");
        options.watch = None;
        options.timeouts = no_timeouts();
        options.answer_quantum = Duration::ZERO;
        options
    }
}

/// Time limits that a slow machine cannot reach; a test of a limit sets it explicitly.
pub fn no_timeouts() -> Timeouts {
    Timeouts {
        head: HOUR,
        body: HOUR,
        localize: HOUR,
        write: HOUR,
        unauthenticated_max_age: HOUR,
        max_age: HOUR,
        drain: Duration::ZERO,
        grace: Duration::from_secs(100),
    }
}

pub const SECOND: Duration = Duration::from_secs(1);
pub const HOUR: Duration = Duration::from_secs(3600);

/// A clock for [`ServerOptions::clock`] that changes only by `advance`.
#[derive(Clone)]
pub struct ManualClock(Arc<Mutex<Instant>>);

impl ManualClock {
    pub fn new() -> Self {
        Self(Arc::new(Mutex::new(Instant::now())))
    }

    pub fn clock(&self) -> Clock {
        let shown = self.0.clone();
        Clock::new(move || *shown.lock().expect("not poisoned"))
    }

    pub fn advance(&self, time: Duration) {
        *self.0.lock().expect("not poisoned") += time;
    }
}

/// A token file, hashed as an operator would with `openssl dgst -sha256`.
pub fn tokens_file(tokens: &[(&str, &str)]) -> String {
    use sha2::Digest as _;
    let line = |(token, role): &(&str, &str)| {
        let hash = sha2::Sha256::digest(token.as_bytes());
        let hex = hash.iter().fold(String::new(), |text, byte| text + &format!("{byte:02x}"));
        format!("someone {hex} {role}\n")
    };
    tokens.iter().map(line).collect()
}

/// A server in its own thread, stopped when dropped.
pub struct Running {
    pub address: SocketAddr,
    pub listening: Listening,
    pub handle: ServerHandle,
    /// Control of a paused clock.
    time: Option<UnboundedSender<ClockCommand>>,
    thread: Option<JoinHandle<ShutdownSummary>>,
}

/// Command to a paused clock.
enum ClockCommand {
    /// Advance, then confirm.
    Advance(Duration, mpsc::Sender<()>),
    /// Resume.
    Resume,
}

impl Running {
    pub fn start(options: ServerOptions) -> Self {
        let (sender, receiver) = mpsc::channel();
        let thread = std::thread::spawn(move || {
            let runtime = tokio::runtime::Builder::new_multi_thread()
                .worker_threads(2)
                .enable_all()
                .build()
                .expect("runtime");
            runtime.block_on(async {
                let server = Server::bind(options).await.expect("a server");
                sender.send((server.listening().clone(), server.handle())).expect("the test waits");
                server.run().await
            })
        });
        Self::of(receiver, None, thread)
    }

    /// A server whose tokio clock advances only by [`Self::pass`] until it is stopped, so that no time limit is
    /// reached by chance.
    pub fn start_paused(options: ServerOptions) -> Self {
        let (sender, receiver) = mpsc::channel();
        let (time, mut passing) = unbounded_channel();
        let thread = std::thread::spawn(move || {
            let runtime =
                tokio::runtime::Builder::new_current_thread().enable_all().start_paused(true).build();
            runtime.expect("runtime").block_on(async {
                // A paused clock jumps to the next timer when the runtime is idle, but not while a blocking task
                // runs.
                let (blocking, released) = mpsc::channel::<()>();
                tokio::task::spawn_blocking(move || released.recv());
                let server = Server::bind(options).await.expect("a server");
                sender.send((server.listening().clone(), server.handle())).expect("the test waits");
                let mut running = std::pin::pin!(server.run());
                loop {
                    tokio::select! {
                        stopped = &mut running => return stopped,
                        Some(passing) = passing.recv() => match passing {
                            ClockCommand::Advance(time, done) => {
                                tokio::time::advance(time).await;
                                done.send(()).expect("the test waits");
                            }
                            ClockCommand::Resume => break,
                        },
                    }
                }
                tokio::time::resume();
                drop(blocking);
                running.await
            })
        });
        Self::of(receiver, Some(time), thread)
    }

    fn of(
        started: mpsc::Receiver<(Listening, ServerHandle)>,
        time: Option<UnboundedSender<ClockCommand>>,
        thread: JoinHandle<ShutdownSummary>,
    ) -> Self {
        let (listening, handle) = started.recv().expect("the server starts");
        let address = listening.address().expect("a TCP listener");
        Self { address, listening, handle, time, thread: Some(thread) }
    }

    /// Advances the paused clock.
    pub fn pass(&self, time: Duration) {
        let (done, passed) = mpsc::channel();
        let clock = self.time.as_ref().expect("its clock is paused");
        clock.send(ClockCommand::Advance(time, done)).expect("the server runs");
        passed.recv().expect("the server runs");
    }

    /// Advances the paused clock in steps until a condition holds.
    pub fn pass_until(&self, step: Duration, what: &str, mut is_so: impl FnMut() -> bool) {
        eventually(what, || {
            is_so() || {
                self.pass(step);
                false
            }
        });
    }

    fn resume(&self) {
        if let Some(clock) = &self.time {
            // The server may have ended.
            let _ = clock.send(ClockCommand::Resume);
        }
    }

    /// Stops the server, waits, and returns how it ended.
    pub fn stop(mut self) -> ShutdownSummary {
        self.handle.stop();
        self.resume();
        self.thread.take().expect("running").join().expect("the server ends")
    }

    /// Value of a series of the metrics; `None` if it does not exist. Uses the operator's listener, whose connections
    /// are not counted.
    pub fn metric(&self, series: &str) -> Option<f64> {
        let admin = self.listening.admin.expect("a listener for the operator");
        value(&Request::get("/metrics").send(admin).text(), series)
    }

    pub fn get(&self, path: &str, token: &str) -> Response {
        Request::get(path).token(token).send(self.address)
    }

    pub fn localize(&self, query: &[u8], token: &str) -> Response {
        Request::localize(query).token(token).send(self.address)
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.handle.stop();
        self.resume();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Value of a series in a text of metrics; `None` if it does not exist.
pub fn value(text: &str, series: &str) -> Option<f64> {
    let line = text.lines().find_map(|line| line.strip_prefix(series)?.strip_prefix(' '))?;
    Some(line.parse().expect("a number"))
}

/// Waits until a condition holds; fails after a minute.
pub fn eventually(what: &str, mut is_so: impl FnMut() -> bool) {
    for _ in 0..3000 {
        if is_so() {
            return;
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    panic!("timed out waiting for {what}");
}
