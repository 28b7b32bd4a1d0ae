//! A worker: holds regions of a map, answers requests for them, and follows the published manifests.
//!
//! It joins one group per region, named by the SHA-256 of the region, so that a new manifest moves only changed
//! regions. Objects of a new manifest are loaded and joined first. Objects that it no longer names are left when the
//! new manifest is completely reachable, plus a grace period, so that gateways with the old manifest can finish.

mod content;
mod executor;
mod subscription;

use std::collections::BTreeMap;
use std::num::NonZeroUsize;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Weak};
use std::time::Duration;

use crate::bus::Bus;
use tokio::sync::watch;
use tokio::time::Instant;
use veiloc_localization::LocalizeOptions;
use veiloc_map::MapMemory;
use veiloc_map::regions::{Manifest, ObjectId, ObjectRef, RegionFolder};
use veiloc_service::telemetry::{WorkerCounts, WorkerGauges};
use veiloc_service::worker_api::{Controllable, HealthProbe};

use self::content::Content;
use self::executor::Executor;
use self::subscription::Subscription;
use crate::ClusterError;
use crate::manifest_source::ManifestSource;
use crate::reachability::Groups;
use crate::share::RegionShare;
use crate::subjects;

/// Options of a worker.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct WorkerOptions {
    /// Name of the map.
    pub map: String,
    /// The regions to hold.
    pub share: RegionShare,
    /// Whether to hold the index too. Default: true.
    pub index: bool,
    /// Threads that localize. Default: one per core.
    pub threads: NonZeroUsize,
    /// Capacity of the queue; further requests are rejected, and the gateway tries another worker. Default 32.
    pub queue: NonZeroUsize,
    /// Options of localization.
    pub localize: LocalizeOptions,
    /// How region files are loaded.
    pub memory: MapMemory,
    /// Polling interval for new manifests. Default 2 s.
    pub watch: Duration,
    /// How long objects that are no longer published stay available after the new manifest is reachable. Default 10
    /// s: longer than the polling interval of gateways plus the duration of a query.
    pub grace: Duration,
    /// Time limit for finishing accepted requests at shutdown. Default 30 s.
    pub finish: Duration,
}

impl WorkerOptions {
    /// Default options: all regions of this map.
    pub fn new(map: &str) -> Self {
        Self {
            map: map.to_owned(),
            share: RegionShare::All,
            index: true,
            threads: std::thread::available_parallelism().unwrap_or(NonZeroUsize::MIN),
            queue: NonZeroUsize::MIN.saturating_add(31),
            localize: LocalizeOptions::default(),
            memory: MapMemory::default(),
            watch: Duration::from_secs(2),
            grace: Duration::from_secs(10),
            finish: Duration::from_secs(30),
        }
    }
}

/// A worker that has joined its groups.
pub struct Worker {
    bus: Bus,
    source: Arc<dyn ManifestSource>,
    options: WorkerOptions,
    executor: Arc<Executor>,
    counts: Arc<WorkerCounts>,
    subscriptions: BTreeMap<ObjectId, Subscription>,
    /// The current manifest, and its groups.
    current: Option<(ObjectId, Groups)>,
    /// When to leave objects that are no longer published.
    leave_at: Option<Instant>,
    state: Arc<State>,
    stop: watch::Sender<Phase>,
}

/// State shared with handles.
#[derive(Default)]
struct State {
    held: AtomicUsize,
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
    bus: Bus,
    counts: Arc<WorkerCounts>,
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
        if self.state.held.load(Ordering::Relaxed) == 0 { Err("holds nothing".to_owned()) } else { Ok(()) }
    }

    fn metrics(&self) -> String {
        let (queued, busy) = self.executor.upgrade().map_or((0, 0), |executor| executor.load());
        let held = self.state.held.load(Ordering::Relaxed);
        self.counts.text(&WorkerGauges { queued, busy, held, ready: self.ready().is_ok() })
    }
}

/// Pause after a further failure: doubles up to a minute, or to the polling interval if that is longer.
fn next_pause(pause: Duration, watch: Duration) -> Duration {
    (pause * 2).min(watch.max(MAX_PAUSE))
}

const MAX_PAUSE: Duration = Duration::from_secs(60);

impl Worker {
    /// Fetches and opens its share of the published map, and joins the groups.
    ///
    /// # Errors
    /// [`ClusterError`]: nothing is published, an object cannot be fetched or is invalid, or the bus is closed.
    pub async fn start(
        bus: Bus,
        source: Arc<dyn ManifestSource>,
        options: WorkerOptions,
        counts: Arc<WorkerCounts>,
    ) -> Result<Self, ClusterError> {
        let executor =
            Executor::start(options.threads, options.queue, options.localize.clone(), counts.clone());
        let executor = executor.map_err(|source| ClusterError::System { what: "threads", source })?;
        let mut worker = Self {
            bus,
            source,
            options,
            executor: Arc::new(executor),
            counts,
            subscriptions: BTreeMap::new(),
            current: None,
            leave_at: None,
            state: Arc::default(),
            stop: watch::Sender::new(Phase::Running),
        };
        worker.follow().await?;
        Ok(worker)
    }

    /// A handle for stopping and monitoring the running worker.
    pub fn handle(&self) -> WorkerHandle {
        WorkerHandle {
            stop: self.stop.clone(),
            state: self.state.clone(),
            executor: Arc::downgrade(&self.executor),
            bus: self.bus.clone(),
            counts: self.counts.clone(),
        }
    }

    /// Number of held regions and indexes.
    pub fn held_count(&self) -> usize {
        self.subscriptions.len()
    }

    /// Runs until it is stopped, then leaves its groups and finishes accepted requests. Returns whether all were
    /// finished.
    pub async fn run(mut self) -> bool {
        let mut phase = self.stop.subscribe();
        let mut pause = self.options.watch;
        loop {
            tokio::select! {
                () = tokio::time::sleep(pause) => {}
                () = wait_for_phase(&mut phase, Phase::Draining) => break,
            }
            // A fetch in progress must not delay the shutdown.
            tokio::select! {
                followed = self.follow() => {
                    self.counts.set_activation_failing(followed.is_err());
                    // A manifest that cannot be loaded, for example on a full disk, may have been fetched almost
                    // completely: do not retry at every poll.
                    pause = if followed.is_ok() { self.options.watch } else { next_pause(pause, self.options.watch) };
                    if let Err(error) = followed {
                        tracing::error!(%error, "the published manifest cannot be loaded; the worker keeps its objects");
                    }
                }
                () = wait_for_phase(&mut phase, Phase::Draining) => break,
            }
        }
        let subscriptions = std::mem::take(&mut self.subscriptions);
        self.state.held.store(0, Ordering::Relaxed);
        let all = futures_util::future::join_all(subscriptions.into_values().map(Subscription::leave));
        let finished = tokio::select! {
            _ = all => true,
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

    /// Reads the published manifest, loads new objects and leaves old ones.
    async fn follow(&mut self) -> Result<(), ClusterError> {
        let published = self.source.current(&self.options.map).await?;
        let (id, manifest) = (published.id, &published.manifest);
        let assigned = self.assigned_objects(manifest);
        let is_new = self.current.as_ref().is_none_or(|(known, _)| *known != id);
        if is_new || assigned.iter().any(|(object, _)| !self.subscriptions.contains_key(&object.sha256)) {
            self.load(manifest, &assigned).await?;
            self.current = Some((id, Groups::of(manifest)?));
            self.leave_at = None;
            if is_new {
                tracing::info!(map = manifest.map, manifest = %id, held = self.subscriptions.len(), "manifest loaded");
            }
        }
        self.leave_unpublished(&assigned).await;
        self.state.held.store(self.subscriptions.len(), Ordering::Relaxed);
        Ok(())
    }

    /// The objects of its share, with the numbers of those that are regions.
    fn assigned_objects(&self, manifest: &Manifest) -> Vec<(ObjectRef, Option<usize>)> {
        let regions =
            manifest.regions.iter().enumerate().filter(|(number, _)| self.options.share.contains(*number));
        let index = self.options.index.then_some((manifest.index, None));
        index.into_iter().chain(regions.map(|(number, region)| (region.object(), Some(number)))).collect()
    }

    /// Fetches and opens missing objects, and joins their groups.
    async fn load(
        &mut self,
        manifest: &Manifest,
        assigned: &[(ObjectRef, Option<usize>)],
    ) -> Result<(), ClusterError> {
        let missing = assigned.iter().filter(|(object, _)| !self.subscriptions.contains_key(&object.sha256));
        let missing: Vec<(ObjectRef, Option<usize>)> = missing.copied().collect();
        let folder = self.source.fetch(missing.iter().map(|(object, _)| *object).collect()).await?;
        let folder = RegionFolder::of(manifest.clone(), &folder);
        for (object, number) in missing {
            let (folder, memory) = (folder.clone(), self.options.memory);
            // Large files are opened on another thread than messages are served.
            let opened = tokio::task::spawn_blocking(move || match number {
                Some(number) => folder.open_region(number, memory).map(|map| Content::Region(Box::new(map))),
                None => folder.open_index(memory).map(|index| Content::Index(Box::new(index))),
            });
            let content = match opened.await {
                Ok(content) => content?,
                Err(panic) => std::panic::resume_unwind(panic.into_panic()),
            };
            let subject = match number {
                Some(_) => subjects::of_region(&manifest.map, &object.sha256)?,
                None => subjects::of_index(&manifest.map, &object.sha256)?,
            };
            let membership = self.bus.join(&subject).await?;
            let subscription = Subscription::start(self.executor.clone(), object.sha256, content, membership);
            self.subscriptions.insert(object.sha256, subscription);
        }
        self.source.retain(&self.subscriptions.keys().copied().collect());
        Ok(())
    }

    /// Leaves objects outside of its assignment, a grace period after the published manifest became reachable.
    async fn leave_unpublished(&mut self, assigned: &[(ObjectRef, Option<usize>)]) {
        let is_assigned = |id: &ObjectId| assigned.iter().any(|(object, _)| object.sha256 == *id);
        let old: Vec<ObjectId> = self.subscriptions.keys().filter(|id| !is_assigned(id)).copied().collect();
        let Some((_, groups)) = self.current.as_ref().filter(|_| !old.is_empty()) else { return };
        match self.leave_at {
            None => {
                if groups.unreachable(&self.bus).await == 0 {
                    self.leave_at = Some(Instant::now() + self.options.grace);
                }
            }
            Some(at) if Instant::now() >= at => {
                for id in old {
                    if let Some(subscription) = self.subscriptions.remove(&id) {
                        // Earlier requests are answered in the meantime.
                        tokio::spawn(subscription.leave());
                    }
                }
                self.leave_at = None;
                tracing::info!(
                    held = self.subscriptions.len(),
                    "objects that are no longer published were left"
                );
            }
            Some(_) => {}
        }
    }
}
