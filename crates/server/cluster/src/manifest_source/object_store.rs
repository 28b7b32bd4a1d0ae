//! A source in object storage with a local cache.

use crate::ClusterError;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::object_store::{ObjectCache, Storage};
use tokio::runtime::Handle;
use veiloc_map::regions::{ObjectId, ObjectRef};

use super::{ManifestSource, PublishedManifest, SourceFuture};

/// Maps that were published to object storage.
#[derive(Debug, Clone)]
pub struct ObjectStoreSource(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    storage: Storage,
    cache: ObjectCache,
    folder: PathBuf,
    /// The last manifest of each map, by name, so that it is not read again.
    latest: Mutex<BTreeMap<String, Arc<PublishedManifest>>>,
    /// The objects of the last [`ManifestSource::retain`].
    retained: Mutex<BTreeSet<ObjectId>>,
}

impl ObjectStoreSource {
    /// Opens this storage, with a cache in this folder of at most `max_bytes`.
    ///
    /// # Errors
    /// [`ClusterError`]: the URL names no storage, or the folder of the cache cannot be created.
    pub fn open(url: &str, cache: &Path, max_bytes: u64) -> Result<Self, ClusterError> {
        // A folder that is not mounted yet is no reason to stop: the cache may hold everything.
        Self::of(Storage::open_lazily(url)?, cache, max_bytes)
    }

    /// As [`Self::open`], for a given storage.
    ///
    /// # Errors
    /// [`ClusterError`]: the folder cannot be created.
    pub fn of(storage: Storage, cache: &Path, max_bytes: u64) -> Result<Self, ClusterError> {
        let folder = cache.to_owned();
        let cache = ObjectCache::open(cache, max_bytes)?;
        Ok(Self(Arc::new(Inner {
            storage,
            cache,
            folder,
            latest: Mutex::default(),
            retained: Mutex::default(),
        })))
    }
}

impl Inner {
    fn latest(&self) -> MutexGuard<'_, BTreeMap<String, Arc<PublishedManifest>>> {
        self.latest.lock().unwrap_or_else(PoisonError::into_inner)
    }

    async fn current(&self, map: &str) -> Result<Arc<PublishedManifest>, ClusterError> {
        let id = match self.storage.current(map).await {
            Ok(id) => id,
            Err(error) if error.is_transient() => self.last(map).ok_or(error)?,
            // A drive that is not mounted looks like a folder without anything. A map that was withdrawn leaves its
            // manifests, and must not be used any more.
            Err(error @ ClusterError::NotThere { .. }) if self.storage.is_empty().await => {
                self.last(map).ok_or(error)?
            }
            Err(error) => return Err(error),
        };
        let known = self.latest().get(map).filter(|published| published.id == id).cloned();
        if let Some(known) = known {
            return Ok(known);
        }
        let manifest = self.cache.manifest(&self.storage, map, id).await?;
        let published = Arc::new(PublishedManifest { id, manifest });
        // Without this record a machine cannot start while storage is unreachable; everything else works.
        if let Err(error) = self.cache.record_manifest(map, id) {
            tracing::warn!(%error, map, "the id of the current manifest cannot be stored in the cache");
        }
        self.latest().insert(map.to_owned(), published.clone());
        Ok(published)
    }

    /// For a machine that starts while storage is unreachable or empty: the manifest that was current before. A running
    /// machine already has one.
    fn last(&self, map: &str) -> Option<ObjectId> {
        let id = self.cache.recorded_manifest(map).filter(|_| !self.latest().contains_key(map))?;
        tracing::warn!(map, manifest = %id, "the storage cannot be reached or does not have the map; the last manifest is taken from the cache");
        Some(id)
    }

    async fn fetch(&self, objects: &[ObjectRef]) -> Result<PathBuf, ClusterError> {
        self.cache.check_room(objects.iter().map(|object| object.bytes).sum())?;
        let mut needed = self.retained.lock().unwrap_or_else(PoisonError::into_inner).clone();
        needed.extend(objects.iter().map(|object| object.sha256));
        self.cache.trim_for(objects, &needed)?;
        for object in objects {
            self.cache.object(&self.storage, object).await?;
        }
        Ok(self.folder.clone())
    }
}

/// Runs slow storage operations on a separate thread, because their futures are not `Send`.
async fn on_blocking_thread<T: Send + 'static>(
    work: impl AsyncFnOnce() -> Result<T, ClusterError> + Send + 'static,
) -> Result<T, ClusterError> {
    let runtime = Handle::current();
    match tokio::task::spawn_blocking(move || runtime.block_on(work())).await {
        Ok(done) => done,
        Err(panic) => std::panic::resume_unwind(panic.into_panic()),
    }
}

impl ManifestSource for ObjectStoreSource {
    fn current<'a>(&'a self, map: &'a str) -> SourceFuture<'a, Arc<PublishedManifest>> {
        let (inner, map) = (self.0.clone(), map.to_owned());
        Box::pin(on_blocking_thread(async move || inner.current(&map).await))
    }

    fn fetch(&self, objects: Vec<ObjectRef>) -> SourceFuture<'_, PathBuf> {
        let inner = self.0.clone();
        Box::pin(on_blocking_thread(async move || inner.fetch(&objects).await))
    }

    fn check_room(&self, bytes: u64) -> Result<(), ClusterError> {
        self.0.cache.check_room(bytes)
    }

    fn retain(&self, needed: &BTreeSet<ObjectId>) {
        self.0.retained.lock().unwrap_or_else(PoisonError::into_inner).clone_from(needed);
        // A cache that is too large is logged, but is no reason to stop answering.
        if let Err(error) = self.0.cache.trim(needed) {
            tracing::warn!(%error, "the cache could not be trimmed");
        }
    }
}
