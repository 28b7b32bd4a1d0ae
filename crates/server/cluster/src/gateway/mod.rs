//! The gateway: sends a query to the regions where it may have been taken, and returns the best of their poses.
//!
//! It holds no map. It follows the published manifests and activates a new one as soon as each of its regions is
//! reachable. A query in flight stays with the manifest it began with, unless that manifest becomes unreachable.

mod dispatch;
mod latency_tracker;
mod select;

use std::sync::{Arc, PoisonError, RwLock, Weak};
use std::time::Duration;

use crate::bus::Bus;
use bytes::Bytes;
use futures_util::future::join_all;
use tokio::time::Instant;
use veiloc_map::MapError;
use veiloc_map::regions::{DEFAULT_SEARCHED_REGIONS, Manifest, ObjectId, RegionFolder, search_rounds};
use veiloc_protocol::{Answer, Profile};
use veiloc_service::telemetry::GatewayCounts;
use veiloc_service::{AnswerFuture, LocalizeFailure, MapDescription, RemoteBackend, RemoteRequest};

use self::dispatch::{Dispatcher, GroupRequest};
use self::latency_tracker::LatencyTracker;
use crate::ClusterError;
use crate::manifest_source::ManifestSource;
use crate::message::{Candidate, FRAME_BYTES, ReplyOutcome, Task};
use crate::reachability::Groups;

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
    /// The active manifest.
    current: RwLock<Option<Arc<ActiveManifest>>>,
    searches: LatencyTracker,
    poses: LatencyTracker,
}

/// A manifest in use.
struct ActiveManifest {
    id: ObjectId,
    groups: Groups,
    description: Arc<MapDescription>,
}

impl Gateway {
    /// Reads the published manifest and follows it from now on. It is no error if its regions are not reachable yet.
    ///
    /// # Errors
    /// [`ClusterError`]: nothing is published, or it is invalid.
    pub async fn start(
        bus: Bus,
        source: Arc<dyn ManifestSource>,
        options: GatewayOptions,
        counts: GatewayCounts,
    ) -> Result<Self, ClusterError> {
        let gateway = Self(Arc::new(Inner {
            bus,
            source,
            options,
            counts,
            current: RwLock::default(),
            searches: LatencyTracker::default(),
            poses: LatencyTracker::default(),
        }));
        gateway.0.follow().await?;
        tokio::spawn(follow(Arc::downgrade(&gateway.0), gateway.0.options.watch));
        Ok(gateway)
    }

    /// Id of the active manifest, if there is one.
    pub fn manifest(&self) -> Option<ObjectId> {
        self.0.current().map(|active| active.id)
    }
}

impl RemoteBackend for Gateway {
    fn describe(&self) -> Option<Arc<MapDescription>> {
        self.0.current().map(|active| active.description.clone())
    }

    fn longest(&self) -> usize {
        self.0.bus.max_payload().saturating_sub(FRAME_BYTES)
    }

    fn localize(&self, request: RemoteRequest) -> AnswerFuture<'_> {
        Box::pin(async move { self.0.localize(request).await })
    }
}

/// Polls for new manifests until the gateway is dropped.
async fn follow(gateway: Weak<Inner>, every: Duration) {
    loop {
        tokio::time::sleep(every).await;
        let Some(gateway) = gateway.upgrade() else { return };
        if let Err(error) = gateway.follow().await {
            tracing::error!(map = gateway.options.map, %error, "the published manifest cannot be read; the active one stays in use");
        }
    }
}

impl Inner {
    fn current(&self) -> Option<Arc<ActiveManifest>> {
        self.current.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Activates the published manifest if it is new and all its regions are reachable.
    async fn follow(&self) -> Result<(), ClusterError> {
        let published = self.source.current(&self.options.map).await?;
        let (id, manifest, known) = (published.id, &published.manifest, self.current());
        if known.as_ref().is_some_and(|active| active.id == id) {
            return Ok(());
        }
        let groups = Groups::of(manifest)?;
        let unreachable = groups.unreachable(&self.bus).await;
        let map = &self.options.map;
        if unreachable > 0 {
            self.counts.all_reachable(known.is_some());
            let all = manifest.regions.len() + 1;
            tracing::warn!(map, manifest = %id, unreachable, all, "this manifest is not activated until all its regions are reachable");
            return Ok(());
        }
        let active = ActiveManifest { id, groups, description: Arc::new(self.describe(manifest).await?) };
        *self.current.write().unwrap_or_else(PoisonError::into_inner) = Some(Arc::new(active));
        self.counts.all_reachable(true);
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
        Ok(MapDescription { profile, images: manifest.images as usize, points: manifest.points as usize })
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
                (Err(LocalizeFailure::Unreached { .. }), Some(now)) if now.id != active.id => active = now,
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
            if answers.iter().any(|answer| matches!(answer, Ok(answer) if answer.trusted)) {
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
        match self.query_group(&active.groups.index, query, task, &self.searches).await? {
            ReplyOutcome::Regions(candidates) => Ok(candidates),
            ReplyOutcome::Failed(why) => Err(why),
            ReplyOutcome::Here | ReplyOutcome::Pose(_) | ReplyOutcome::Rejected(_) => {
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
        let group = active.groups.regions.get(region).ok_or(LocalizeFailure::Broken)?;
        let task = query.pose.clone();
        match self.query_group(group, query, task, &self.poses).await? {
            ReplyOutcome::Pose(answer) => Ok(*answer),
            ReplyOutcome::Failed(why) => Err(why),
            ReplyOutcome::Here | ReplyOutcome::Regions(_) | ReplyOutcome::Rejected(_) => {
                Err(LocalizeFailure::Broken)
            }
        }
    }

    async fn query_group(
        &self,
        group: &(crate::bus::Subject, ObjectId),
        query: &Query,
        task: Task,
        latency: &LatencyTracker,
    ) -> Result<ReplyOutcome, LocalizeFailure> {
        let dispatcher = Dispatcher { bus: &self.bus, counts: &self.counts, latency };
        dispatcher.dispatch(&GroupRequest { group, name: query.name, task, deadline: query.deadline }).await
    }
}

/// The parts of a request that are sent to workers.
struct Query {
    name: [u8; 16],
    globals: Vec<Bytes>,
    pose: Task,
    deadline: Instant,
}

impl Query {
    fn of(request: &RemoteRequest, deadline: Instant) -> Self {
        let codes = |codes: &[i8]| codes.iter().map(|code| code.cast_unsigned()).collect();
        Self {
            name: request.id.bytes(),
            globals: request.decoded.queries().map(|query| codes(query.global().as_codes())).collect(),
            pose: Task::Pose {
                kind: request.decoded.kind(),
                body: Bytes::copy_from_slice(&request.bytes),
                near: request.near,
            },
            deadline,
        }
    }
}
