//! A worker's regions: read from the store when they are first asked for, and kept open while there is space.
//!
//! A region is named by the SHA-256 of its file, so it never changes, and a new manifest costs only the regions that are
//! new in it. Those of the previous manifest stay available for gateways that have not read the new one yet.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::Duration;

use futures_util::FutureExt as _;
use futures_util::future::{BoxFuture, Shared};
use tokio::time::Instant;
use veiloc_map::regions::{ObjectId, ObjectRef};
use veiloc_map::{MapFile, MapMemory};
use veiloc_service::telemetry::RegionCounts;
use veiloc_service::{OpenRegion, RegionFailure, RegionFuture, RegionSource};

use crate::ClusterError;
use crate::published::{PublishedManifest, PublishedMaps};

/// The regions of all published maps. Clones share them.
#[derive(Clone)]
pub struct StoredRegions(Arc<Inner>);

struct Inner {
    published: PublishedMaps,
    counts: RegionCounts,
    /// Maps that were asked for, by name.
    maps: Mutex<BTreeMap<String, Arc<FollowedMap>>>,
    regions: Mutex<HashMap<Key, Region>>,
}

/// Map and region.
type Key = (String, ObjectId);

/// A map whose manifests are followed.
#[derive(Default)]
struct FollowedMap {
    /// The newest manifest and the one before it.
    manifests: Mutex<Vec<Arc<PublishedManifest>>>,
    /// When the store was last asked, and what came of it; held while it is.
    asked: tokio::sync::Mutex<Option<(Instant, Result<(), RegionFailure>)>>,
}

/// A region that is open or being opened.
struct Region {
    opening: Shared<BoxFuture<'static, Result<OpenRegion, RegionFailure>>>,
    bytes: u64,
    used: Instant,
}

/// How long a client with an unknown region, or a failure, is answered without asking the store again.
const PAUSE: Duration = Duration::from_secs(1);

impl StoredRegions {
    /// The regions of these maps, whose manifests are read again after each `watch`. Must be called within a runtime.
    pub fn start(published: PublishedMaps, watch: Duration, counts: RegionCounts) -> Self {
        let (maps, regions) = (Mutex::default(), Mutex::default());
        let inner = Arc::new(Inner { published, counts, maps, regions });
        tokio::spawn(follow(Arc::downgrade(&inner), watch));
        Self(inner)
    }
}

impl RegionSource for StoredRegions {
    fn region<'a>(&'a self, map: &'a str, region: ObjectId) -> RegionFuture<'a> {
        Box::pin(async move {
            let key = (map.to_owned(), region);
            if let Some(opening) = self.0.in_use(&key) {
                return opening.await;
            }
            let object = self.0.find(map, region).await?;
            self.0.open(key, object).await
        })
    }
}

/// Reads the manifests again until the regions are dropped.
async fn follow(regions: Weak<Inner>, watch: Duration) {
    loop {
        tokio::time::sleep(watch).await;
        let Some(inner) = regions.upgrade() else { return };
        let names: Vec<String> = inner.maps().keys().cloned().collect();
        for map in names {
            if inner.refresh(&map).await == Err(RegionFailure::Unknown) {
                tracing::warn!(map, "this map is no longer published, and no longer served");
                inner.maps().remove(&map);
            }
        }
        inner.drop_unpublished();
    }
}

impl Inner {
    fn maps(&self) -> MutexGuard<'_, BTreeMap<String, Arc<FollowedMap>>> {
        self.maps.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn regions(&self) -> MutexGuard<'_, HashMap<Key, Region>> {
        self.regions.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The region, if it is open or being opened, or failed a moment ago.
    fn in_use(&self, key: &Key) -> Option<Shared<BoxFuture<'static, Result<OpenRegion, RegionFailure>>>> {
        let mut regions = self.regions();
        let region = regions.get_mut(key)?;
        if matches!(region.opening.peek(), Some(Err(_))) {
            return (region.used.elapsed() < PAUSE).then(|| region.opening.clone());
        }
        region.used = Instant::now();
        Some(region.opening.clone())
    }

    /// The object of a region in the known manifests of a map; the store is asked if it is in none of them.
    async fn find(&self, map: &str, region: ObjectId) -> Result<ObjectRef, RegionFailure> {
        let known = self.maps().get(map).cloned();
        if let Some(object) = known.as_ref().and_then(|followed| followed.find(region)) {
            return Ok(object);
        }
        self.refresh(map).await?;
        let known = self.maps().get(map).cloned();
        known.and_then(|followed| followed.find(region)).ok_or(RegionFailure::Unknown)
    }

    /// Reads the current manifest of a map, unless that was done a moment ago, and follows the map from now on.
    async fn refresh(&self, map: &str) -> Result<(), RegionFailure> {
        let known = self.maps().get(map).cloned();
        let followed = known.clone().unwrap_or_default();
        let mut asked = followed.asked.lock().await;
        if let Some((_, result)) = asked.filter(|(when, _)| when.elapsed() < PAUSE) {
            return result;
        }
        let result = self.read_manifest(map, &followed).await;
        *asked = Some((Instant::now(), result));
        if known.is_none() && result.is_ok() {
            // Another request may have been faster; either is as good.
            self.maps().entry(map.to_owned()).or_insert_with(|| followed.clone());
        }
        result
    }

    async fn read_manifest(&self, map: &str, followed: &FollowedMap) -> Result<(), RegionFailure> {
        let published = match self.published.current(map).await {
            Ok(published) => published,
            Err(ClusterError::NotThere { .. }) => return Err(RegionFailure::Unknown),
            Err(error) => {
                self.counts.failed();
                tracing::error!(map, %error, "the manifest cannot be read; the last one stays in use");
                return Err(RegionFailure::Unavailable);
            }
        };
        let before = followed.newest();
        if before.as_ref().is_some_and(|before| before.id == published.id) {
            return Ok(());
        }
        tracing::info!(map, manifest = %published.id, regions = published.manifest.regions.len(), "manifest read");
        if let Some(before) = &before {
            self.open_successors(map, before, &published);
        }
        let mut manifests = followed.manifests.lock().unwrap_or_else(PoisonError::into_inner);
        manifests.insert(0, published);
        manifests.truncate(2);
        Ok(())
    }

    /// Opens those regions of a new manifest whose predecessors are in use, before the first query asks for them.
    fn open_successors(&self, map: &str, before: &PublishedManifest, now: &PublishedManifest) {
        for (old, new) in before.manifest.regions.iter().zip(&now.manifest.regions) {
            let key = (map.to_owned(), old.sha256);
            if old.sha256 != new.sha256 && self.regions().contains_key(&key) {
                drop(self.open((map.to_owned(), new.sha256), new.object()));
            }
        }
    }

    /// Begins to open a region, and closes others if there is no space for it.
    fn open(
        &self,
        key: Key,
        object: ObjectRef,
    ) -> Shared<BoxFuture<'static, Result<OpenRegion, RegionFailure>>> {
        let mut regions = self.regions();
        if let Some(known) = regions.get(&key).filter(|known| !matches!(known.opening.peek(), Some(Err(_)))) {
            return known.opening.clone();
        }
        regions.remove(&key);
        make_room(&mut regions, self.published.max_bytes().saturating_sub(object.bytes));
        let (published, counts, map) = (self.published.clone(), self.counts.clone(), key.0.clone());
        // A task of its own: a client that leaves does not keep others waiting for it.
        let task = tokio::spawn(async move {
            let opened = open_region(&published, &map, object, &counts).await;
            opened.map_err(|error| {
                counts.failed();
                tracing::error!(map, region = %object.sha256, %error, "this region cannot be read");
                RegionFailure::Unavailable
            })
        });
        let opening = task.map(|ended| ended.unwrap_or(Err(RegionFailure::Unavailable))).boxed().shared();
        let region = Region { opening: opening.clone(), bytes: object.bytes, used: Instant::now() };
        regions.insert(key, region);
        self.retain(&regions);
        opening
    }

    /// Closes regions that are in no known manifest. Queries in flight keep theirs.
    fn drop_unpublished(&self) {
        let maps = self.maps().clone();
        let mut regions = self.regions();
        regions.retain(|(map, id), _| maps.get(map).is_some_and(|followed| followed.find(*id).is_some()));
        self.retain(&regions);
    }

    fn retain(&self, regions: &HashMap<Key, Region>) {
        self.counts.open(regions.len());
        self.published.retain(regions.keys().map(|(_, id)| *id).collect::<BTreeSet<_>>());
    }
}

impl FollowedMap {
    fn newest(&self) -> Option<Arc<PublishedManifest>> {
        self.manifests.lock().unwrap_or_else(PoisonError::into_inner).first().cloned()
    }

    fn find(&self, region: ObjectId) -> Option<ObjectRef> {
        let manifests = self.manifests.lock().unwrap_or_else(PoisonError::into_inner);
        let mut all = manifests.iter().flat_map(|published| &published.manifest.regions);
        all.find(|entry| entry.sha256 == region).map(|entry| entry.object())
    }
}

/// Closes the least recently used regions until the others have at most this many bytes.
fn make_room(regions: &mut HashMap<Key, Region>, most: u64) {
    let mut total: u64 = regions.values().map(|region| region.bytes).sum();
    while total > most {
        let oldest = regions.iter().min_by_key(|(_, region)| region.used).map(|(key, _)| key.clone());
        let Some(removed) = oldest.and_then(|key| regions.remove(&key)) else { return };
        total -= removed.bytes;
    }
}

async fn open_region(
    published: &PublishedMaps,
    map: &str,
    object: ObjectRef,
    counts: &RegionCounts,
) -> Result<OpenRegion, ClusterError> {
    let cached = published.object(object).await?;
    counts.read(cached.was_read);
    let map = map.to_owned();
    // Mapped: no other program writes to files of the cache, and a removed file stays until it is closed.
    let open = move || {
        Ok::<_, ClusterError>(OpenRegion::new(&map, MapFile::open_in(&cached.path, MapMemory::Mapped)?))
    };
    match tokio::task::spawn_blocking(open).await {
        Ok(opened) => opened,
        Err(panic) => std::panic::resume_unwind(panic.into_panic()),
    }
}
