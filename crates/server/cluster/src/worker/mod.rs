//! A worker: holds regions of a map, answers requests for them, and follows the published manifests.
//!
//! It announces the SHA-256 of each region that it holds, so that a new manifest moves only changed regions. Objects of a
//! new manifest are loaded and announced first. Objects that it no longer names are left when every object of the new
//! manifest has a worker, plus a grace period, so that gateways with the old manifest can finish.

mod announcer;
mod assignment;
mod executor;
mod holdings;
mod responder;
mod spans;

use std::collections::BTreeSet;
use std::fmt;
use std::num::NonZeroUsize;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Weak};
use std::time::Duration;

use crate::bus::Bus;
use tokio::sync::watch;
use tokio::task::JoinHandle;
use tokio::time::Instant;
use veiloc_localization::LocalizeOptions;
use veiloc_map::MapMemory;
use veiloc_map::regions::{Manifest, ObjectId, RegionFolder};
use veiloc_service::telemetry::{WorkerCounts, WorkerGauges};
use veiloc_service::worker_api::{Controllable, HealthProbe};

use self::announcer::Announcer;
use self::assignment::{Assigned, Assigner, Assignment};
use self::executor::Executor;
use self::holdings::{Content, Holdings};
use self::responder::Responder;
use self::spans::Spans;
use crate::ClusterError;
use crate::announcement::MemberId;
use crate::manifest_source::{ManifestSource, PublishedManifest};
use crate::members::{Members, Role};
use crate::share::RegionShare;
use crate::subjects;

pub use self::assignment::PlacementOptions;

/// Options of a worker.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct WorkerOptions {
    /// Name of the map.
    pub map: String,
    /// The regions to hold, unless they are placed.
    pub share: RegionShare,
    /// Regions are placed on the workers that have this option. Default: none.
    pub placement: Option<PlacementOptions>,
    /// Whether to hold the index too. Default: true.
    pub index: bool,
    /// Threads that localize. Default: one per core.
    pub threads: NonZeroUsize,
    /// Capacity of the queue; further requests are rejected, and the gateway asks another worker. Default 32.
    pub queue: NonZeroUsize,
    /// Options of localization.
    pub localize: LocalizeOptions,
    /// How region files are loaded.
    pub memory: MapMemory,
    /// Polling interval for new manifests. Default 2 s.
    pub watch: Duration,
    /// Period of its announcements. Default 500 ms.
    pub period: Duration,
    /// How long objects that are no longer published stay available after all of the new manifest has workers. Default 10
    /// s: longer than the polling interval of gateways plus the duration of a query.
    pub grace: Duration,
    /// Time limit for finishing accepted requests at shutdown. Default 30 s.
    pub finish: Duration,
    /// Where spans are sent for requests of gateways that send traces too. Default: nowhere.
    pub traces: Option<veiloc_service::telemetry::Traces>,
}

impl WorkerOptions {
    /// Default options: all regions of this map.
    pub fn new(map: &str) -> Self {
        Self {
            map: map.to_owned(),
            share: RegionShare::All,
            placement: None,
            index: true,
            threads: std::thread::available_parallelism().unwrap_or(NonZeroUsize::MIN),
            queue: NonZeroUsize::MIN.saturating_add(31),
            localize: LocalizeOptions::default(),
            memory: MapMemory::default(),
            watch: Duration::from_secs(2),
            period: Duration::from_millis(500),
            grace: Duration::from_secs(10),
            finish: Duration::from_secs(30),
            traces: None,
        }
    }
}

/// A worker that answers requests and announces itself.
pub struct Worker {
    bus: Bus,
    source: Arc<dyn ManifestSource>,
    options: WorkerOptions,
    executor: Arc<Executor>,
    counts: Arc<WorkerCounts>,
    member: MemberId,
    holdings: Arc<Holdings>,
    members: Members,
    assigner: Assigner,
    responder: Responder,
    announcing: JoinHandle<()>,
    /// Becomes true when the worker leaves.
    leaving: watch::Sender<bool>,
    /// The current manifest.
    current: Option<Arc<PublishedManifest>>,
    /// When to leave objects that are no longer published.
    leave_at: Option<Instant>,
    state: Arc<State>,
    stop: watch::Sender<Phase>,
}

/// State shared with handles.
#[derive(Default)]
struct State {
    leaving: AtomicBool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Phase {
    Running,
    Draining,
    Aborting,
}

/// Returns when the worker has reached this phase.
async fn wait_for_phase(phase: &mut watch::Receiver<Phase>, target: Phase) {
    // Cannot fail: the worker holds a sender.
    let _ = phase.wait_for(|phase| *phase >= target).await;
}

/// Controls a running worker and reports its state to probes.
#[derive(Clone)]
pub struct WorkerHandle {
    stop: watch::Sender<Phase>,
    state: Arc<State>,
    executor: Weak<Executor>,
    holdings: Arc<Holdings>,
    bus: Bus,
    member: MemberId,
    counts: Arc<WorkerCounts>,
}

impl WorkerHandle {
    /// Id of the worker in announcements.
    pub const fn member(&self) -> MemberId {
        self.member
    }
}

impl Controllable for WorkerHandle {
    fn stop(&self) {
        self.state.leaving.store(true, Ordering::Relaxed);
        self.stop.send_if_modified(|phase| std::mem::replace(phase, (*phase).max(Phase::Draining)) != *phase);
    }

    fn stop_now(&self) {
        self.state.leaving.store(true, Ordering::Relaxed);
        self.stop.send_replace(Phase::Aborting);
    }

    /// The worker polls by itself.
    fn reload(&self) {}
}

impl HealthProbe for WorkerHandle {
    fn ready(&self) -> Result<(), String> {
        if self.state.leaving.load(Ordering::Relaxed) {
            return Err("leaving".to_owned());
        }
        if !self.bus.is_connected() {
            return Err("no connection to the bus".to_owned());
        }
        if self.holdings.len() == 0 { Err("holds nothing".to_owned()) } else { Ok(()) }
    }

    fn metrics(&self) -> String {
        let (queued, busy) = self.executor.upgrade().map_or((0, 0), |executor| executor.queued_and_busy());
        let held = self.holdings.len();
        self.counts.text(&WorkerGauges { queued, busy, held, ready: self.ready().is_ok() })
    }
}

/// Pause after a further failure: doubles up to a minute, or to the polling interval if that is longer.
fn next_pause(pause: Duration, watch: Duration) -> Duration {
    (pause * 2).min(watch.max(MAX_PAUSE))
}

const MAX_PAUSE: Duration = Duration::from_secs(60);

impl Worker {
    /// Fetches and opens its share of the published map, then answers requests and announces itself. An object that cannot
    /// be fetched or is invalid is logged, counted and tried again later, and does not keep it from serving the others.
    ///
    /// # Errors
    /// [`ClusterError`]: nothing is published, its manifest cannot be read, its share does not fit into the cache, or the bus is
    /// closed.
    pub async fn start(
        bus: Bus,
        source: Arc<dyn ManifestSource>,
        options: WorkerOptions,
        counts: Arc<WorkerCounts>,
    ) -> Result<Self, ClusterError> {
        let executor =
            Executor::start(options.threads, options.queue, options.localize.clone(), counts.clone());
        let executor = executor.map_err(|source| ClusterError::System { what: "threads", source })?;
        let (executor, holdings) = (Arc::new(executor), Arc::<Holdings>::default());
        let member = MemberId::draw()?;
        let subject = subjects::of_member(&options.map, &member)?;
        let members = Members::listen(&bus, &options.map, Role::Worker).await?;
        let published = source.current(&options.map).await?;
        let assigner = Assigner::new(&options, member, members.clone());
        let leaving = watch::Sender::new(false);
        let begin = async || {
            // It is announced only when it can be asked.
            let membership = bus.join(&subject).await?;
            let spans = Spans { member, traces: options.traces.clone() };
            let responder = Responder::start(executor.clone(), holdings.clone(), membership, spans);
            let announcer = Announcer {
                bus: bus.clone(),
                subject: subjects::of_members(&options.map)?,
                member,
                period: options.period,
                threads: u32::try_from(options.threads.get()).unwrap_or(u32::MAX),
                executor: executor.clone(),
                holdings: holdings.clone(),
                placed: options.placement.as_ref().map(|placement| placement.placed.clone()),
            };
            Ok::<_, ClusterError>((responder, tokio::spawn(announcer.run(leaving.subscribe()))))
        };
        let mut begun = None;
        if options.placement.is_some() {
            // The others know it, and it knows them, before it chooses.
            begun = Some(begin().await?);
            tokio::time::sleep(options.period * 2).await;
        }
        // A damaged object is no reason to refuse the others; it is tried again with the next check.
        let loaded =
            match load(&*source, &holdings, options.memory, &published.manifest, &assigner, &counts).await {
                Err(FollowFailure::Other(error)) => return Err(error),
                Err(FollowFailure::Objects(failure)) => Err(failure),
                Ok(assignment) => Ok(assignment),
            };
        counts.set_activation_failing(loaded.is_err());
        match &loaded {
            Ok(assignment) => counts.set_unplaced(assignment.unplaced),
            Err(failure) => {
                counts.set_missing(failure.missing());
                tracing::error!(map = options.map, held = holdings.len(), "{failure}");
            }
        }
        tracing::info!(map = options.map, manifest = %published.id, held = holdings.len(), "manifest loaded");
        let (responder, announcing) = match begun {
            Some(begun) => begun,
            None => begin().await?,
        };
        Ok(Self {
            bus,
            source,
            options,
            executor,
            counts,
            member,
            holdings,
            members,
            assigner,
            responder,
            announcing,
            leaving,
            current: loaded.is_ok().then_some(published),
            leave_at: None,
            state: Arc::default(),
            stop: watch::Sender::new(Phase::Running),
        })
    }

    /// A handle for stopping and monitoring the running worker.
    pub fn handle(&self) -> WorkerHandle {
        WorkerHandle {
            stop: self.stop.clone(),
            state: self.state.clone(),
            executor: Arc::downgrade(&self.executor),
            holdings: self.holdings.clone(),
            bus: self.bus.clone(),
            member: self.member,
            counts: self.counts.clone(),
        }
    }

    /// Number of held regions and indexes.
    pub fn held_count(&self) -> usize {
        self.holdings.len()
    }

    /// Runs until it is stopped, then announces that it leaves and finishes accepted requests. Returns whether all were
    /// finished.
    pub async fn run(mut self) -> bool {
        let mut phase = self.stop.subscribe();
        let mut pause = self.options.watch;
        let (mut changes, mut failing) = (self.members.changes(), false);
        loop {
            tokio::select! {
                () = tokio::time::sleep(pause) => {}
                () = self.placement_changed(&mut changes, failing) => {}
                () = wait_for_phase(&mut phase, Phase::Draining) => break,
            }
            // A fetch in progress must not delay the shutdown.
            tokio::select! {
                followed = self.follow() => {
                    failing = followed.is_err();
                    self.counts.set_activation_failing(failing);
                    let missing = followed.as_ref().err().map_or(0, FollowFailure::missing);
                    self.counts.set_missing(missing);
                    // A manifest that cannot be loaded, for example on a full disk, may have been fetched almost
                    // completely: do not retry at every poll.
                    pause = if followed.is_ok() { self.options.watch } else { next_pause(pause, self.options.watch) };
                    if let Err(error) = followed {
                        tracing::error!(%error, "the published manifest cannot be loaded completely; the worker keeps its objects");
                    }
                }
                () = wait_for_phase(&mut phase, Phase::Draining) => break,
            }
        }
        self.leaving.send_replace(true);
        let (announcing, responder) = (self.announcing, self.responder);
        let left = async {
            // It ends after it has announced that the worker leaves.
            let _ = announcing.await;
            responder.leave().await;
        };
        let finished = tokio::select! {
            () = left => true,
            () = tokio::time::sleep(self.options.finish) => false,
            () = wait_for_phase(&mut phase, Phase::Aborting) => false,
        };
        self.bus.flush().await;
        if finished {
            let executor = self.executor.clone();
            // No job is queued any more, so the threads end at once.
            let _ = tokio::task::spawn_blocking(move || executor.finish()).await;
        }
        finished
    }

    /// Returns when the members changed among which regions are placed, and a moment later, because changes come together.
    /// While the last attempt failed, only the pause counts.
    async fn placement_changed(&self, changes: &mut watch::Receiver<u64>, failing: bool) {
        if failing || self.options.placement.is_none() || changes.changed().await.is_err() {
            std::future::pending::<()>().await;
        }
        tokio::time::sleep(self.options.period).await;
        changes.mark_unchanged();
    }

    /// Reads the published manifest, loads new objects and leaves old ones.
    async fn follow(&mut self) -> Result<(), FollowFailure> {
        let published = self.source.current(&self.options.map).await?;
        let manifest = &published.manifest;
        let is_new = self.current.as_ref().is_none_or(|known| known.id != published.id);
        let assignment =
            load(&*self.source, &self.holdings, self.options.memory, manifest, &self.assigner, &self.counts)
                .await?;
        self.counts.set_unplaced(assignment.unplaced);
        if is_new {
            self.leave_at = None;
            tracing::info!(map = manifest.map, manifest = %published.id, held = self.holdings.len(), "manifest loaded");
            self.current = Some(published.clone());
        }
        self.leave_others(manifest, &assignment);
        Ok(())
    }

    /// Leaves objects outside of its assignment: those of older manifests, a grace period after every object of the manifest has
    /// a worker; and regions that other workers took over, as long after.
    fn leave_others(&mut self, manifest: &Manifest, assignment: &Assignment) {
        let published: BTreeSet<ObjectId> = manifest.objects().map(|object| object.sha256).collect();
        let is_complete = self.members.copies(manifest).missing == 0;
        let may_leave = |id: &ObjectId| {
            let is_free =
                if published.contains(id) { assignment.taken_over.contains(id) } else { is_complete };
            is_free && !assignment.contains(id)
        };
        // A worker with a fixed share holds no published region beyond it.
        let may_leave = |id: &ObjectId| match self.options.placement {
            Some(_) => may_leave(id),
            None => is_complete && !assignment.contains(id),
        };
        let old: Vec<ObjectId> = self.holdings.objects().into_iter().filter(may_leave).collect();
        if old.is_empty() {
            self.leave_at = None;
            return;
        }
        match self.leave_at {
            None => self.leave_at = Some(Instant::now() + self.options.grace),
            Some(at) if Instant::now() >= at => {
                // Earlier requests are answered in the meantime.
                self.holdings.remove(&old);
                self.leave_at = None;
                tracing::info!(
                    held = self.holdings.len(),
                    left = old.len(),
                    "objects that other workers hold, or that are no longer published, were left"
                );
            }
            Some(_) => {}
        }
    }
}

/// Why a manifest was not loaded completely.
#[derive(Debug, thiserror::Error)]
enum FollowFailure {
    /// The manifest cannot be read, or its objects do not fit into the cache.
    #[error(transparent)]
    Other(#[from] ClusterError),
    #[error(transparent)]
    Objects(#[from] LoadFailure),
}

impl FollowFailure {
    /// Number of objects that are not loaded.
    fn missing(&self) -> usize {
        match self {
            Self::Other(_) => 0,
            Self::Objects(failure) => failure.missing(),
        }
    }
}

/// Objects that could not be loaded, and why.
#[derive(Debug)]
struct LoadFailure(Vec<(Assigned, ClusterError)>);

impl LoadFailure {
    fn missing(&self) -> usize {
        self.0.len()
    }
}

impl std::error::Error for LoadFailure {}

impl fmt::Display for LoadFailure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} objects cannot be loaded; the others are served, and these are tried again",
            self.0.len()
        )?;
        for ((_, number), error) in self.0.iter().take(MAX_NAMED) {
            match number {
                Some(number) => write!(f, "; region {number}: {error}")?,
                None => write!(f, "; the index: {error}")?,
            }
        }
        if self.0.len() > MAX_NAMED { f.write_str("; …") } else { Ok(()) }
    }
}

/// Maximum number of objects that a log line names.
const MAX_NAMED: usize = 8;

/// Fetches and opens what this worker should hold, all that can be. What that is may change in the meantime.
async fn load(
    source: &dyn ManifestSource,
    holdings: &Holdings,
    memory: MapMemory,
    manifest: &Manifest,
    assigner: &Assigner,
    counts: &WorkerCounts,
) -> Result<Assignment, FollowFailure> {
    let mut failed: Vec<(Assigned, ClusterError)> = Vec::new();
    let assignment = loop {
        let assignment = assigner.assign(manifest);
        let is_missing = |(object, _): &&Assigned| {
            !holdings.contains(&object.sha256)
                && failed.iter().all(|((known, _), _)| known.sha256 != object.sha256)
        };
        let missing: Vec<Assigned> = assignment.objects.iter().filter(is_missing).copied().collect();
        if missing.is_empty() {
            break assignment;
        }
        source.check_room(missing.iter().map(|(object, _)| object.bytes).sum())?;
        // What is fetched one by one must not displace what was fetched before it.
        let mut needed = holdings.objects();
        needed.extend(missing.iter().map(|(object, _)| object.sha256));
        source.retain(&needed);
        for (object, number) in missing.into_iter().take(AT_A_TIME) {
            match load_object(source, memory, manifest, (object, number)).await {
                Ok(content) => {
                    holdings.insert(object.sha256, content);
                    counts.loaded();
                }
                Err(error) => failed.push(((object, number), error)),
            }
        }
        source.retain(&holdings.objects());
    };
    if failed.is_empty() { Ok(assignment) } else { Err(LoadFailure(failed).into()) }
}

/// Number of objects that are loaded before a worker looks again what it should hold.
const AT_A_TIME: usize = 4;

/// Fetches and opens an object.
async fn load_object(
    source: &dyn ManifestSource,
    memory: MapMemory,
    manifest: &Manifest,
    (object, number): Assigned,
) -> Result<Content, ClusterError> {
    let folder = source.fetch(vec![object]).await?;
    let folder = RegionFolder::of(manifest.clone(), &folder);
    // Large files are opened on another thread than messages are served.
    let opened = tokio::task::spawn_blocking(move || match number {
        Some(number) => folder.open_region(number, memory).map(|map| Content::Region(Box::new(map))),
        None => folder.open_index(memory).map(|index| Content::Index(Box::new(index))),
    });
    match opened.await {
        Ok(content) => Ok(content?),
        Err(panic) => std::panic::resume_unwind(panic.into_panic()),
    }
}
