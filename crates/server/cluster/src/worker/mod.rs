//! A worker: holds regions of a map, answers for them, and follows what is published.
//!
//! It joins one group a region, named by the region's SHA-256, so that a new manifest moves only what changed. What a new
//! manifest needs is loaded and joined first; what it does not name any more is left when all of the new one is held by
//! somebody, and a grace after that, so that no gateway is left alone with the old one.

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
use veiloc_map::regions::{Folder, Manifest, ObjectId, ObjectRef};
use veiloc_service::labour::{HealthProbe, Controllable};
use veiloc_service::telemetry::{WorkerCounts, WorkerGauges};

use self::content::Content;
use self::executor::Executor;
use self::subscription::Subscription;
use crate::ClusterError;
use crate::manifest_source::ManifestSource;
use crate::reachability::Groups;
use crate::share::Share;
use crate::subjects;

/// What a worker does.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct WorkerOptions {
    /// The map whose regions it takes.
    pub map: String,
    /// Which of them.
    pub share: Share,
    /// Whether it also takes the index. Default: it does.
    pub index: bool,
    /// Threads that localize. Default: one a core.
    pub threads: NonZeroUsize,
    /// Requests that may wait for one; more are told to go elsewhere. Default 32.
    pub queue: NonZeroUsize,
    /// How to localize.
    pub localize: LocalizeOptions,
    /// Where the bytes of regions are.
    pub memory: MapMemory,
    /// How often to look what is published. Default 2 s.
    pub watch: Duration,
    /// How long what is no longer published is still answered for, once all that is can be reached. Default 10 s: longer
    /// than gateways take to look, and than a query takes.
    pub grace: Duration,
    /// How long what was accepted may take when the worker is stopped. Default 30 s.
    pub finish: Duration,
}

impl WorkerOptions {
    /// All of this map.
    pub fn new(map: &str) -> Self {
        Self {
            map: map.to_owned(),
            share: Share::All,
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
    /// The manifest that holds, and its groups.
    current: Option<(ObjectId, Groups)>,
    /// When what is no longer published is left.
    leave_at: Option<Instant>,
    state: Arc<State>,
    stop: watch::Sender<Phase>,
}

/// What others may know of a worker.
#[derive(Default)]
struct State {
    held: AtomicUsize,
    leaving: AtomicBool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Phase {
    Working,
    Leaving,
    GivingUp,
}

/// Returns when the worker has got so far.
async fn reached(phase: &mut watch::Receiver<Phase>, least: Phase) {
    // The worker holds a sender itself.
    let _ = phase.wait_for(|phase| *phase >= least).await;
}

/// Tells a running worker what to do, and tells probes how it is.
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
        self.stop.send_if_modified(|phase| std::mem::replace(phase, (*phase).max(Phase::Leaving)) != *phase);
    }

    fn stop_now(&self) {
        self.state.leaving.store(true, Ordering::Relaxed);
        self.stop.send_replace(Phase::GivingUp);
    }

    /// It looks at what is published by itself.
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

/// The pause after one more failure: twice as long, up to a minute, or to what lies between two looks where that is longer.
fn longer(pause: Duration, watch: Duration) -> Duration {
    (pause * 2).min(watch.max(LONGEST_PAUSE))
}

const LONGEST_PAUSE: Duration = Duration::from_secs(60);

impl Worker {
    /// Fetches and opens its share of what is published, and joins.
    ///
    /// # Errors
    /// [`ClusterError`]: nothing is published, something cannot be fetched or is not what it should be, or the bus is gone.
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
            stop: watch::Sender::new(Phase::Working),
        };
        worker.follow().await?;
        Ok(worker)
    }

    /// For stopping it and asking how it is while it runs.
    pub fn handle(&self) -> WorkerHandle {
        WorkerHandle {
            stop: self.stop.clone(),
            state: self.state.clone(),
            executor: Arc::downgrade(&self.executor),
            bus: self.bus.clone(),
            counts: self.counts.clone(),
        }
    }

    /// Regions and indexes that it holds.
    pub fn held(&self) -> usize {
        self.subscriptions.len()
    }

    /// Answers until it is told to stop, then leaves its groups and finishes what it was asked. Whether it could.
    pub async fn run(mut self) -> bool {
        let mut phase = self.stop.subscribe();
        let mut pause = self.options.watch;
        loop {
            tokio::select! {
                () = tokio::time::sleep(pause) => {}
                () = reached(&mut phase, Phase::Leaving) => break,
            }
            // What is being fetched must not hold up the end.
            tokio::select! {
                followed = self.follow() => {
                    self.counts.failing(followed.is_err());
                    // What cannot be taken, on a full disk for example, was perhaps fetched nearly to its end: not at every look.
                    pause = if followed.is_ok() { self.options.watch } else { longer(pause, self.options.watch) };
                    if let Err(error) = followed {
                        tracing::error!(%error, "what is published cannot be taken; what is held stays");
                    }
                }
                () = reached(&mut phase, Phase::Leaving) => break,
            }
        }
        let subscriptions = std::mem::take(&mut self.subscriptions);
        self.state.held.store(0, Ordering::Relaxed);
        let all = futures_util::future::join_all(subscriptions.into_values().map(Subscription::leave));
        let finished = tokio::select! {
            _ = all => true,
            () = tokio::time::sleep(self.options.finish) => false,
            () = reached(&mut phase, Phase::GivingUp) => false,
        };
        self.bus.flush().await;
        if finished {
            let executor = self.executor.clone();
            // Nothing is queued any more: the threads end at once.
            let _ = tokio::task::spawn_blocking(move || executor.finish()).await;
        }
        finished
    }

    /// Looks at what is published, and takes and leaves accordingly.
    async fn follow(&mut self) -> Result<(), ClusterError> {
        let published = self.source.current(&self.options.map).await?;
        let (id, manifest) = (published.id, &published.manifest);
        let wanted = self.wanted(manifest);
        let is_new = self.current.as_ref().is_none_or(|(known, _)| *known != id);
        if is_new || wanted.iter().any(|(object, _)| !self.subscriptions.contains_key(&object.sha256)) {
            self.take(manifest, &wanted).await?;
            self.current = Some((id, Groups::of(manifest)?));
            self.leave_at = None;
            if is_new {
                tracing::info!(map = manifest.map, manifest = %id, held = self.subscriptions.len(), "manifest taken");
            }
        }
        self.leave_what_is_not(&wanted).await;
        self.state.held.store(self.subscriptions.len(), Ordering::Relaxed);
        Ok(())
    }

    /// The objects of its share, and the numbers of those that are regions.
    fn wanted(&self, manifest: &Manifest) -> Vec<(ObjectRef, Option<usize>)> {
        let regions =
            manifest.regions.iter().enumerate().filter(|(number, _)| self.options.share.takes(*number));
        let index = self.options.index.then_some((manifest.index, None));
        index.into_iter().chain(regions.map(|(number, region)| (region.object(), Some(number)))).collect()
    }

    /// Fetches, opens and joins what it does not hold yet.
    async fn take(
        &mut self,
        manifest: &Manifest,
        wanted: &[(ObjectRef, Option<usize>)],
    ) -> Result<(), ClusterError> {
        let missing = wanted.iter().filter(|(object, _)| !self.subscriptions.contains_key(&object.sha256));
        let missing: Vec<(ObjectRef, Option<usize>)> = missing.copied().collect();
        let folder = self.source.fetch(missing.iter().map(|(object, _)| *object).collect()).await?;
        let folder = Folder::of(manifest.clone(), &folder);
        for (object, number) in missing {
            let (folder, memory) = (folder.clone(), self.options.memory);
            // Large files: not where messages are served.
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
            let subscription = Subscription::take(self.executor.clone(), object.sha256, content, membership);
            self.subscriptions.insert(object.sha256, subscription);
        }
        self.source.retain(&self.subscriptions.keys().copied().collect());
        Ok(())
    }

    /// Leaves what is not wanted, once all that is published can be reached, and a grace after that.
    async fn leave_what_is_not(&mut self, wanted: &[(ObjectRef, Option<usize>)]) {
        let wanted = |id: &ObjectId| wanted.iter().any(|(object, _)| object.sha256 == *id);
        let old: Vec<ObjectId> = self.subscriptions.keys().filter(|id| !wanted(id)).copied().collect();
        let Some((_, groups)) = self.current.as_ref().filter(|_| !old.is_empty()) else { return };
        match self.leave_at {
            None => {
                if groups.unreached(&self.bus).await == 0 {
                    self.leave_at = Some(Instant::now() + self.options.grace);
                }
            }
            Some(at) if Instant::now() >= at => {
                for id in old {
                    if let Some(subscription) = self.subscriptions.remove(&id) {
                        // What it was asked before is answered meanwhile.
                        tokio::spawn(subscription.leave());
                    }
                }
                self.leave_at = None;
                tracing::info!(held = self.subscriptions.len(), "what is no longer published was left");
            }
            Some(_) => {}
        }
    }
}
