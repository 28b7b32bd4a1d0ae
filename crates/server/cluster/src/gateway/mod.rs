//! The gateway: sends a query to the regions where it may have been taken, and returns the best of their poses.
//!
//! It holds the retrieval index of a map and no region. It follows the published manifests; a query in flight stays with the
//! manifest it began with, unless no worker has its regions any more.

mod reply;
mod select;
mod workers;

use std::num::{NonZeroU64, NonZeroUsize};
use std::sync::{Arc, PoisonError, RwLock, Weak};
use std::time::Duration;

use bytes::Bytes;
use futures_util::future::join_all;
use reqwest::header::{ACCEPT, CONTENT_TYPE, HeaderMap, HeaderName, HeaderValue};
use tokio::time::Instant;
use veiloc_localization::LocalizeOptions;
use veiloc_map::regions::{DEFAULT_SEARCHED_REGIONS, Manifest, ObjectId, RegionIndex, search_rounds};
use veiloc_map::{MapError, MapMemory};
use veiloc_protocol::{Answer, Profile};
use veiloc_service::auth::Lane;
use veiloc_service::queue::{JobSpec, Pool, Rejected};
use veiloc_service::telemetry::{GatewayCounts, RequestContext, RequestId};
use veiloc_service::{
    AnswerFuture, BodyKind, Clock, LocalizeFailure, MapDescription, RemoteBackend, RemoteRequest,
};

use crate::ClusterError;
use crate::published::{PublishedManifest, PublishedMaps};

pub use self::workers::{WorkerAccess, Workers};

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

/// Computes the poses of one map with workers. Clones share it.
#[derive(Clone)]
pub struct Gateway(Arc<Inner>);

struct Inner {
    published: PublishedMaps,
    options: GatewayOptions,
    workers: Arc<Workers>,
    counts: GatewayCounts,
    /// Threads that search the index.
    searches: Pool,
    /// Number of images that a search retrieves.
    retrieve: usize,
    current: RwLock<Option<Arc<ActiveManifest>>>,
}

/// A manifest in use.
struct ActiveManifest {
    published: Arc<PublishedManifest>,
    index: Arc<RegionIndex>,
    description: Arc<MapDescription>,
}

/// Capacity of the queue of searches.
const SEARCH_QUEUE: NonZeroUsize = NonZeroUsize::MIN.saturating_add(255);

impl Gateway {
    /// Reads the published manifest with its index, and follows it from now on.
    ///
    /// # Errors
    /// [`ClusterError`]: nothing is published, or it is invalid.
    pub async fn start(
        published: PublishedMaps,
        workers: Arc<Workers>,
        options: GatewayOptions,
        counts: GatewayCounts,
    ) -> Result<Self, ClusterError> {
        let threads = std::thread::available_parallelism().unwrap_or(NonZeroUsize::MIN);
        let searches = Pool::start(threads, SEARCH_QUEUE, Clock::default())
            .map_err(|source| ClusterError::System { what: "threads", source })?;
        let (retrieve, current) = (LocalizeOptions::default().retrieve, RwLock::default());
        let inner = Inner { published, options, workers, counts, searches, retrieve, current };
        let gateway = Self(Arc::new(inner));
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
        self.0.workers.any_answers()
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
        if let Err(error) = gateway.update().await {
            tracing::error!(map = gateway.options.map, %error, "the published manifest cannot be read; the active one stays in use");
        }
    }
}

impl Inner {
    fn current(&self) -> Option<Arc<ActiveManifest>> {
        self.current.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Activates the published manifest if it is new.
    async fn update(&self) -> Result<(), ClusterError> {
        let published = self.published.current(&self.options.map).await?;
        let (map, id) = (&self.options.map, published.id);
        if self.current().is_some_and(|active| active.published.id == id) {
            return Ok(());
        }
        let manifest = &published.manifest;
        let path = self.published.object(manifest.index).await?.path;
        // Mapped: no other program writes to files of the cache.
        let index = Arc::new(RegionIndex::open(&path, MapMemory::Mapped)?);
        let description = Arc::new(self.describe(manifest).await?);
        tracing::info!(map, manifest = %id, regions = manifest.regions.len(), "manifest activated");
        let active = ActiveManifest { published, index, description };
        *self.current.write().unwrap_or_else(PoisonError::into_inner) = Some(Arc::new(active));
        self.counts.manifest_activated();
        Ok(())
    }

    async fn describe(&self, manifest: &Manifest) -> Result<MapDescription, ClusterError> {
        let object = manifest.profile;
        let path = self.published.object(object).await?.path;
        let bytes = std::fs::read(&path).map_err(|source| MapError::Io { path: path.clone(), source })?;
        let wrong = |source| ClusterError::Profile { object: object.sha256, source };
        Ok(MapDescription {
            profile: Profile::decode(&bytes).map_err(wrong)?,
            images: manifest.images as usize,
            points: manifest.points as usize,
            coordinates: manifest.coordinates(),
        })
    }

    async fn localize(&self, request: RemoteRequest) -> Result<Answer, LocalizeFailure> {
        let unreached = LocalizeFailure::Unreached { retry_after: NonZeroU64::MIN };
        let mut active = self.current().ok_or(unreached)?;
        let request = Arc::new(request);
        let query = Query::of(&request)?;
        loop {
            // A query for another profile is refused here; no worker need see it.
            let profile = &active.description.profile;
            if request.decoded.queries().any(|sealed| profile.check(sealed).is_err()) {
                return Err(LocalizeFailure::WrongProfile);
            }
            let result = self.query_regions(&active, &query).await;
            // No worker has the regions of the old manifest any more: again with the new one.
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
        let (mut answers, mut searched) = (Vec::new(), 0);
        for round in search_rounds(candidates, self.options.regions) {
            searched += round.len();
            answers.extend(join_all(round.into_iter().map(|region| self.pose(active, query, region))).await);
            if answers.iter().any(|answer| matches!(answer, Ok(answer) if answer.trusted())) {
                break;
            }
        }
        self.counts.regions_searched(searched);
        select::best(answers)
    }

    /// The regions with their numbers of retrieved images, best first; for several images their sums.
    async fn search(
        &self,
        active: &ActiveManifest,
        query: &Query,
    ) -> Result<Vec<(usize, usize)>, LocalizeFailure> {
        let (index, request, retrieve) = (active.index.clone(), query.request.clone(), self.retrieve);
        let work = move |_| {
            let mut candidates: Vec<(usize, usize)> = Vec::new();
            for sealed in request.decoded.queries() {
                // A match query has none: a region has a pack of its own.
                let global = sealed.global().filter(|global| global.as_codes().len() == index.global_len());
                for ranked in index.rank(global.as_ref().ok_or(LocalizeFailure::WrongProfile)?, retrieve) {
                    match candidates.iter_mut().find(|(region, _)| *region == ranked.region) {
                        Some((_, held)) => *held += ranked.held,
                        None => candidates.push((ranked.region, ranked.held)),
                    }
                }
            }
            // The sort is stable: equal regions keep the order of the first image.
            candidates.sort_by_key(|(_, held)| std::cmp::Reverse(*held));
            Ok(candidates)
        };
        let (client, limit) = (query.request.client, query.request.within);
        match self.searches.submit(JobSpec { client, rows: 0, is_session: false, limit }, work) {
            Ok(result) => result.await.unwrap_or(Err(LocalizeFailure::Broken)),
            Err(Rejected::Full { retry_after } | Rejected::Late { retry_after }) => {
                Err(LocalizeFailure::Busy { retry_after })
            }
            Err(Rejected::Closed) => Err(LocalizeFailure::Stopped),
        }
    }

    async fn pose(
        &self,
        active: &ActiveManifest,
        query: &Query,
        region: usize,
    ) -> Result<Answer, LocalizeFailure> {
        // A verified index names only regions of its manifest.
        let region = active.published.manifest.regions.get(region).ok_or(LocalizeFailure::Broken)?.sha256;
        self.workers.ask(&self.options.map, region, query, &self.counts).await
    }
}

/// The parts of a request that are sent to workers.
struct Query {
    request: Arc<RemoteRequest>,
    /// The bytes that the device sealed (rule L7).
    body: Bytes,
    headers: HeaderMap,
    deadline: Instant,
}

/// Which region, for balancers that hash it.
const REGION: HeaderName = HeaderName::from_static("veiloc-region");
/// Which client, for the fair queues of workers.
const CLIENT: HeaderName = HeaderName::from_static("veiloc-client");
const NEAR: HeaderName = HeaderName::from_static("veiloc-near");
const TRACEPARENT: HeaderName = HeaderName::from_static("traceparent");

impl Query {
    fn of(request: &Arc<RemoteRequest>) -> Result<Self, LocalizeFailure> {
        let protobuf = HeaderValue::from_static("application/x-protobuf");
        let mut headers = HeaderMap::from_iter([(ACCEPT, protobuf.clone()), (CONTENT_TYPE, protobuf)]);
        // Numbers and hexadecimal digits are valid values.
        let value = |text: String| HeaderValue::try_from(text).map_err(|_| LocalizeFailure::Broken);
        if let Some(client) = &request.client {
            headers.insert(CLIENT, value(Lane::of(client).hex())?);
        }
        if let Some(near) = &request.near {
            let [x, y, z] = near.center();
            headers.insert(NEAR, value(format!("{x},{y},{z},{}", near.sd()))?);
        }
        let body = Bytes::copy_from_slice(&request.bytes);
        // A little before the service gives up, so that workers that are too slow are known.
        let within = request.within.saturating_sub((request.within / 20).min(Duration::from_millis(100)));
        Ok(Self { request: request.clone(), body, headers, deadline: Instant::now() + within })
    }

    /// End of the address of a region.
    fn route(&self) -> &'static str {
        match self.request.decoded.kind() {
            BodyKind::Query => "localize",
            BodyKind::Rig => "localize-rig",
        }
    }

    fn id(&self) -> RequestId {
        self.request.id
    }

    fn trace(&self) -> Option<&Arc<RequestContext>> {
        self.request.trace.as_ref()
    }
}
