//! The gateway's half: a query to the regions where it may have been taken, and the best of their poses.
//!
//! It holds no map. It follows what is published, and asks by a new manifest as soon as somebody holds each of its regions;
//! a query under way stays with the manifest it began with, unless that has nobody left.

mod ask;
mod choose;
mod latency_tracker;

use std::sync::{Arc, PoisonError, RwLock, Weak};
use std::time::Duration;

use crate::bus::Bus;
use bytes::Bytes;
use futures_util::future::join_all;
use tokio::time::Instant;
use veiloc_map::MapError;
use veiloc_map::regions::{ASKED, Folder, Manifest, ObjectId, rounds};
use veiloc_protocol::{Answer, Profile};
use veiloc_service::telemetry::GatewayCounts;
use veiloc_service::{AnswerFuture, MapDescription, RemoteBackend, RemoteRequest, LocalizeFailure};

use self::ask::{Ask, Route};
use self::latency_tracker::LatencyTracker;
use crate::ClusterError;
use crate::manifest_source::ManifestSource;
use crate::message::{Candidate, FRAME_BYTES, Outcome, Wanted};
use crate::reachability::Groups;

/// What a gateway does.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct GatewayOptions {
    /// The map it asks for.
    pub map: String,
    /// Regions that a query is asked in at most. Default 3.
    pub regions: usize,
    /// How often to look what is published. Default 2 s.
    pub watch: Duration,
}

impl GatewayOptions {
    /// For this map.
    pub fn new(map: &str) -> Self {
        Self { map: map.to_owned(), regions: ASKED, watch: Duration::from_secs(2) }
    }
}

/// Asks a cluster for the poses in one map. A clone is the same gateway.
#[derive(Clone)]
pub struct Gateway(Arc<Inner>);

struct Inner {
    bus: Bus,
    source: Arc<dyn ManifestSource>,
    options: GatewayOptions,
    counts: GatewayCounts,
    /// What is asked by now.
    current: RwLock<Option<Arc<ActiveManifest>>>,
    searches: LatencyTracker,
    poses: LatencyTracker,
}

/// A manifest that is asked by.
struct ActiveManifest {
    id: ObjectId,
    groups: Groups,
    description: Arc<MapDescription>,
}

impl Gateway {
    /// Looks what is published, and follows it from now on. That nobody holds it yet is no error.
    ///
    /// # Errors
    /// [`ClusterError`]: nothing is published, or it is not what it should be.
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

    /// The id of the manifest that it asks by, if there is one whose regions are all held.
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

    fn localize(&self, question: RemoteRequest) -> AnswerFuture<'_> {
        Box::pin(async move { self.0.localize(question).await })
    }
}

/// Looks what is published until the gateway is gone.
async fn follow(gateway: Weak<Inner>, every: Duration) {
    loop {
        tokio::time::sleep(every).await;
        let Some(gateway) = gateway.upgrade() else { return };
        if let Err(error) = gateway.follow().await {
            tracing::error!(map = gateway.options.map, %error, "what is published cannot be read; what is asked by stays");
        }
    }
}

impl Inner {
    fn current(&self) -> Option<Arc<ActiveManifest>> {
        self.current.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Asks by what is published, if it is another manifest than before and somebody holds all of it.
    async fn follow(&self) -> Result<(), ClusterError> {
        let published = self.source.current(&self.options.map).await?;
        let (id, manifest, known) = (published.id, &published.manifest, self.current());
        if known.as_ref().is_some_and(|active| active.id == id) {
            return Ok(());
        }
        let groups = Groups::of(manifest)?;
        let unreached = groups.unreached(&self.bus).await;
        let map = &self.options.map;
        if unreached > 0 {
            self.counts.all_reachable(known.is_some());
            let all = manifest.regions.len() + 1;
            tracing::warn!(map, manifest = %id, unreached, all, "not asked by this manifest until all of it is held");
            return Ok(());
        }
        let active = ActiveManifest { id, groups, description: Arc::new(self.describe(manifest).await?) };
        *self.current.write().unwrap_or_else(PoisonError::into_inner) = Some(Arc::new(active));
        self.counts.all_reachable(true);
        self.counts.manifest_activated();
        tracing::info!(map, manifest = %id, regions = manifest.regions.len(), "asking by this manifest");
        Ok(())
    }

    async fn describe(&self, manifest: &Manifest) -> Result<MapDescription, ClusterError> {
        let object = manifest.profile;
        let folder = self.source.fetch(vec![object]).await?;
        let path = Folder::of(manifest.clone(), &folder).path_of(&object.sha256);
        let io = |source| ClusterError::from(MapError::Io { path: path.clone(), source });
        let bytes = std::fs::read(&path).map_err(io)?;
        let wrong = |source| ClusterError::Profile { object: object.sha256, source };
        let profile = Profile::decode(&bytes).map_err(wrong)?;
        Ok(MapDescription { profile, images: manifest.images as usize, points: manifest.points as usize })
    }

    async fn localize(&self, question: RemoteRequest) -> Result<Answer, LocalizeFailure> {
        let deadline = Instant::now() + question.within;
        let query = Query::of(&question, deadline);
        let nobody = LocalizeFailure::Unreached { retry_after: std::num::NonZeroU64::MIN };
        let mut active = self.current().ok_or(nobody)?;
        loop {
            // Sealed for another profile: no worker need see it.
            let profile = &active.description.profile;
            if question.asked.queries().any(|sealed| profile.check(sealed).is_err()) {
                return Err(LocalizeFailure::WrongProfile);
            }
            let result = self.ask_in(&active, &query).await;
            // Nobody is left of an old manifest: as if the query had come now.
            match (&result, self.current()) {
                (Err(LocalizeFailure::Unreached { .. }), Some(now)) if now.id != active.id => active = now,
                _ => return result,
            }
        }
    }

    /// Asks the regions of this manifest.
    async fn ask_in(&self, active: &ActiveManifest, query: &Query) -> Result<Answer, LocalizeFailure> {
        let candidates = self.search(active, query).await?;
        let ranked = candidates.iter().map(|one| (one.region as usize, one.held as usize));
        let (mut given, mut asked) = (Vec::new(), 0);
        for round in rounds(ranked, self.options.regions) {
            asked += round.len();
            given.extend(join_all(round.into_iter().map(|region| self.pose(active, query, region))).await);
            if given.iter().any(|given| matches!(given, Ok(answer) if answer.trusted)) {
                break;
            }
        }
        self.counts.regions_searched(asked);
        choose::best(given)
    }

    async fn search(&self, active: &ActiveManifest, query: &Query) -> Result<Vec<Candidate>, LocalizeFailure> {
        let wanted = Wanted::Search { globals: query.globals.clone() };
        match self.ask(&active.groups.index, query, wanted, &self.searches).await? {
            Outcome::Regions(candidates) => Ok(candidates),
            Outcome::LocalizeFailure(why) => Err(why),
            Outcome::Here | Outcome::Pose(_) | Outcome::Rejected(_) => Err(LocalizeFailure::Broken),
        }
    }

    async fn pose(
        &self,
        active: &ActiveManifest,
        query: &Query,
        region: usize,
    ) -> Result<Answer, LocalizeFailure> {
        // An index that was verified names regions of its manifest.
        let group = active.groups.regions.get(region).ok_or(LocalizeFailure::Broken)?;
        let wanted = query.pose.clone();
        match self.ask(group, query, wanted, &self.poses).await? {
            Outcome::Pose(answer) => Ok(*answer),
            Outcome::LocalizeFailure(why) => Err(why),
            Outcome::Here | Outcome::Regions(_) | Outcome::Rejected(_) => Err(LocalizeFailure::Broken),
        }
    }

    async fn ask(
        &self,
        group: &(crate::bus::Subject, ObjectId),
        query: &Query,
        wanted: Wanted,
        latency: &LatencyTracker,
    ) -> Result<Outcome, LocalizeFailure> {
        let route = Route { bus: &self.bus, counts: &self.counts, latency };
        route.ask(&Ask { group, name: query.name, wanted, deadline: query.deadline }).await
    }
}

/// What is sent of a question.
struct Query {
    name: [u8; 16],
    globals: Vec<Bytes>,
    pose: Wanted,
    deadline: Instant,
}

impl Query {
    fn of(question: &RemoteRequest, deadline: Instant) -> Self {
        let codes = |codes: &[i8]| codes.iter().map(|code| code.cast_unsigned()).collect();
        Self {
            name: question.request.bytes(),
            globals: question.asked.queries().map(|query| codes(query.global().as_codes())).collect(),
            pose: Wanted::Pose {
                kind: question.asked.kind(),
                body: Bytes::copy_from_slice(&question.bytes),
                near: question.near,
            },
            deadline,
        }
    }
}
