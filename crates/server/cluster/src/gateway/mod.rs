//! The gateway: sends a query to the regions where it may have been taken, and returns the best of their poses.
//!
//! It holds no map. It follows the published manifests and activates a new one as soon as each of its regions has a worker.
//! A query in flight stays with the manifest it began with, unless a region of that has no worker left. The gateway is ready
//! while each region of the active manifest has a worker.

mod dispatch;
mod select;

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError, RwLock, Weak};
use std::time::Duration;

use crate::bus::Bus;
use bytes::Bytes;
use futures_util::future::join_all;
use tokio::time::Instant;
use veiloc_map::MapError;
use veiloc_map::regions::{DEFAULT_SEARCHED_REGIONS, Manifest, ObjectId, RegionFolder, search_rounds};
use veiloc_protocol::{Answer, Profile};
use veiloc_service::auth::Lane;
use veiloc_service::telemetry::{GatewayCounts, RequestContext};
use veiloc_service::{AnswerFuture, LocalizeFailure, MapDescription, RemoteBackend, RemoteRequest};

use self::dispatch::{Dispatcher, ObjectRequest};
use crate::ClusterError;
use crate::manifest_source::{ManifestSource, PublishedManifest};
use crate::members::{Members, Role};
use crate::message::{Candidate, FRAME_BYTES, ReplyOutcome, Task};

/// Options of a gateway.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct GatewayOptions {
    /// Name of the map.
    pub map: String,
    /// Maximum number of regions in which a query is searched. Default 3.
    pub regions: usize,
    /// Polling interval for new manifests. Default 2 s.
    pub watch: Duration,
}

impl GatewayOptions {
    /// Default options for this map.
    pub fn new(map: &str) -> Self {
        Self { map: map.to_owned(), regions: DEFAULT_SEARCHED_REGIONS, watch: Duration::from_secs(2) }
    }
}

/// A client of the cluster for one map. Clones share it.
#[derive(Clone)]
pub struct Gateway(Arc<Inner>);

struct Inner {
    bus: Bus,
    source: Arc<dyn ManifestSource>,
    options: GatewayOptions,
    counts: GatewayCounts,
    members: Members,
    /// The published manifest as last read.
    published: Mutex<Option<Arc<PublishedManifest>>>,
    /// The active manifest.
    current: RwLock<Option<Arc<ActiveManifest>>>,
    /// Whether each region of the active manifest has a worker.
    is_complete: AtomicBool,
}

/// A manifest in use.
struct ActiveManifest {
    published: Arc<PublishedManifest>,
    description: Arc<MapDescription>,
}

impl Gateway {
    /// Reads the published manifest and follows it from now on. It is no error if its regions have no workers yet; those
    /// that run are known after their next announcement.
    ///
    /// # Errors
    /// [`ClusterError`]: nothing is published, it is invalid, or the bus is closed.
    pub async fn start(
        bus: Bus,
        source: Arc<dyn ManifestSource>,
        options: GatewayOptions,
        counts: GatewayCounts,
    ) -> Result<Self, ClusterError> {
        let members = Members::listen(&bus, &options.map, Role::Gateway).await?;
        let gateway = Self(Arc::new(Inner {
            bus,
            source,
            options,
            counts,
            members,
            published: Mutex::default(),
            current: RwLock::default(),
            is_complete: AtomicBool::new(false),
        }));
        gateway.0.read_manifest().await?;
        gateway.0.update().await?;
        tokio::spawn(follow(Arc::downgrade(&gateway.0), gateway.0.options.watch));
        Ok(gateway)
    }

    /// Id of the active manifest, if there is one.
    pub fn manifest(&self) -> Option<ObjectId> {
        self.0.current().map(|active| active.published.id)
    }
}

impl RemoteBackend for Gateway {
    fn describe(&self) -> Option<Arc<MapDescription>> {
        self.0.current().map(|active| active.description.clone())
    }

    fn is_complete(&self) -> bool {
        self.0.is_complete.load(Ordering::Relaxed)
    }

    fn longest(&self) -> usize {
        self.0.bus.max_payload().saturating_sub(FRAME_BYTES)
    }

    fn localize(&self, request: RemoteRequest) -> AnswerFuture<'_> {
        Box::pin(async move { self.0.localize(request).await })
    }
}

/// Polls for new manifests, and follows which regions have workers, until the gateway is dropped.
async fn follow(gateway: Weak<Inner>, every: Duration) {
    let Some(members) = gateway.upgrade().map(|gateway| gateway.members.clone()) else { return };
    let mut changes = members.changes();
    let mut poll = Instant::now() + every;
    loop {
        let is_due = tokio::select! {
            () = tokio::time::sleep_until(poll) => true,
            _ = changes.changed() => false,
        };
        let Some(gateway) = gateway.upgrade() else { return };
        let read = if is_due { gateway.read_manifest().await } else { Ok(()) };
        if is_due {
            poll = Instant::now() + every;
        }
        // Also when it cannot be read: workers of the active one come and go.
        let updated = gateway.update().await;
        if let Err(error) = read.and(updated) {
            tracing::error!(map = gateway.options.map, %error, "the published manifest cannot be read; the active one stays in use");
        }
    }
}

impl Inner {
    fn current(&self) -> Option<Arc<ActiveManifest>> {
        self.current.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    async fn read_manifest(&self) -> Result<(), ClusterError> {
        let published = self.source.current(&self.options.map).await?;
        *self.published.lock().unwrap_or_else(PoisonError::into_inner) = Some(published);
        Ok(())
    }

    /// Activates the published manifest if it is new and all its regions have workers, and reports whether those of the
    /// active one do.
    async fn update(&self) -> Result<(), ClusterError> {
        let published = self.published.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let activated = match published {
            Some(published) => self.activate(&published).await,
            None => Ok(()),
        };
        let map = &self.options.map;
        let [answering, out] = self.members.counts();
        self.counts.members(map, answering, out, self.members.foreign_count());
        let copies = self.current().map(|active| self.members.copies(&active.published.manifest));
        self.counts.copies(map, copies.map_or(0, |copies| copies.least));
        let is_complete = copies.is_some_and(|copies| copies.missing == 0);
        if self.is_complete.swap(is_complete, Ordering::Relaxed) && !is_complete {
            let missing = copies.map_or(0, |copies| copies.missing);
            tracing::error!(
                map,
                missing,
                "regions of the active manifest have no worker; the gateway is not ready"
            );
        }
        activated
    }

    /// Activates this manifest if it is new and all its regions have workers.
    async fn activate(&self, published: &Arc<PublishedManifest>) -> Result<(), ClusterError> {
        let (id, manifest) = (published.id, &published.manifest);
        if self.current().is_some_and(|active| active.published.id == id) {
            return Ok(());
        }
        let (map, missing) = (&self.options.map, self.members.copies(manifest).missing);
        if missing > 0 {
            let all = manifest.regions.len() + 1;
            tracing::info!(map, manifest = %id, missing, all, "this manifest is not activated until all its regions have workers");
            return Ok(());
        }
        let description = Arc::new(self.describe(manifest).await?);
        let active = ActiveManifest { published: published.clone(), description };
        *self.current.write().unwrap_or_else(PoisonError::into_inner) = Some(Arc::new(active));
        self.counts.manifest_activated();
        tracing::info!(map, manifest = %id, regions = manifest.regions.len(), "manifest activated");
        Ok(())
    }

    async fn describe(&self, manifest: &Manifest) -> Result<MapDescription, ClusterError> {
        let object = manifest.profile;
        let folder = self.source.fetch(vec![object]).await?;
        let path = RegionFolder::of(manifest.clone(), &folder).path_of(&object.sha256);
        let io = |source| ClusterError::from(MapError::Io { path: path.clone(), source });
        let bytes = std::fs::read(&path).map_err(io)?;
        let wrong = |source| ClusterError::Profile { object: object.sha256, source };
        let profile = Profile::decode(&bytes).map_err(wrong)?;
        Ok(MapDescription {
            profile,
            images: manifest.images as usize,
            points: manifest.points as usize,
            coordinates: manifest.coordinates(),
        })
    }

    async fn localize(&self, request: RemoteRequest) -> Result<Answer, LocalizeFailure> {
        let deadline = Instant::now() + request.within;
        let query = Query::of(&request, deadline);
        let unreachable = LocalizeFailure::Unreached { retry_after: std::num::NonZeroU64::MIN };
        let mut active = self.current().ok_or(unreachable)?;
        loop {
            // A query for another profile is refused here; no worker need see it.
            let profile = &active.description.profile;
            if request.decoded.queries().any(|sealed| profile.check(sealed).is_err()) {
                return Err(LocalizeFailure::WrongProfile);
            }
            let result = self.query_regions(&active, &query).await;
            // The old manifest became unreachable: retry with the new one.
            match (&result, self.current()) {
                (Err(LocalizeFailure::Unreached { .. }), Some(now))
                    if now.published.id != active.published.id =>
                {
                    active = now;
                }
                _ => return result,
            }
        }
    }

    /// Searches the regions of this manifest.
    async fn query_regions(&self, active: &ActiveManifest, query: &Query) -> Result<Answer, LocalizeFailure> {
        let candidates = self.search(active, query).await?;
        let ranked = candidates.iter().map(|one| (one.region as usize, one.held as usize));
        let (mut answers, mut searched) = (Vec::new(), 0);
        for round in search_rounds(ranked, self.options.regions) {
            searched += round.len();
            answers.extend(join_all(round.into_iter().map(|region| self.pose(active, query, region))).await);
            if answers.iter().any(|answer| matches!(answer, Ok(answer) if answer.trusted())) {
                break;
            }
        }
        self.counts.regions_searched(searched);
        select::best(answers)
    }

    async fn search(
        &self,
        active: &ActiveManifest,
        query: &Query,
    ) -> Result<Vec<Candidate>, LocalizeFailure> {
        let task = Task::Search { globals: query.globals.clone() };
        let object = active.published.manifest.index.sha256;
        match self.query_object(object, query, task).await? {
            ReplyOutcome::Regions(candidates) => Ok(candidates),
            ReplyOutcome::Failed(why) => Err(why),
            ReplyOutcome::Here { .. } | ReplyOutcome::Pose(_) | ReplyOutcome::Rejected(_) => {
                Err(LocalizeFailure::Broken)
            }
        }
    }

    async fn pose(
        &self,
        active: &ActiveManifest,
        query: &Query,
        region: usize,
    ) -> Result<Answer, LocalizeFailure> {
        // A verified index names only regions of its manifest.
        let region = active.published.manifest.regions.get(region).ok_or(LocalizeFailure::Broken)?;
        match self.query_object(region.sha256, query, query.pose.clone()).await? {
            ReplyOutcome::Pose(answer) => Ok(*answer),
            ReplyOutcome::Failed(why) => Err(why),
            ReplyOutcome::Here { .. } | ReplyOutcome::Regions(_) | ReplyOutcome::Rejected(_) => {
                Err(LocalizeFailure::Broken)
            }
        }
    }

    async fn query_object(
        &self,
        object: ObjectId,
        query: &Query,
        task: Task,
    ) -> Result<ReplyOutcome, LocalizeFailure> {
        let dispatcher = Dispatcher { bus: &self.bus, members: &self.members, counts: &self.counts };
        let (name, lane, rows, deadline) = (query.name, query.lane, query.rows, query.deadline);
        let trace = query.trace.clone();
        let request = ObjectRequest { object, name, lane, rows, task, deadline, trace };
        dispatcher.dispatch(&request).await
    }
}

/// The parts of a request that are sent to workers.
struct Query {
    name: [u8; 16],
    lane: Option<Lane>,
    rows: u32,
    globals: Vec<Bytes>,
    pose: Task,
    deadline: Instant,
    trace: Option<Arc<RequestContext>>,
}

impl Query {
    fn of(request: &RemoteRequest, deadline: Instant) -> Self {
        let codes = |codes: &[i8]| codes.iter().map(|code| code.cast_unsigned()).collect();
        Self {
            name: request.id.bytes(),
            lane: request.client.as_ref().map(Lane::of),
            rows: u32::try_from(request.decoded.rows()).unwrap_or(u32::MAX),
            // A match query has none: a region has a pack of its own.
            globals: (request.decoded.queries())
                .map(|query| query.global().map(|global| codes(global.as_codes())).unwrap_or_default())
                .collect(),
            pose: Task::Pose {
                kind: request.decoded.kind(),
                body: Bytes::copy_from_slice(&request.bytes),
                near: request.near,
            },
            deadline,
            trace: request.trace.clone(),
        }
    }
}
