//! Published maps: their current manifests, and their objects in a cache on the local disk.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::runtime::Handle;
use veiloc_map::regions::{Manifest, ObjectId, ObjectRef};

use crate::ClusterError;
use crate::object_store::{ObjectCache, Storage};

/// A published manifest.
#[derive(Debug)]
pub struct PublishedManifest {
    /// The SHA-256 of the manifest.
    pub id: ObjectId,
    /// The manifest.
    pub manifest: Manifest,
}

/// The maps of an object store, read through a cache. Clones share it.
#[derive(Debug, Clone)]
pub struct PublishedMaps(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    storage: Storage,
    cache: ObjectCache,
    /// The last manifest of each map, by name, so that it is not read again.
    latest: Mutex<BTreeMap<String, Arc<PublishedManifest>>>,
    /// Objects that must stay in the cache.
    retained: Mutex<BTreeSet<ObjectId>>,
}

/// An object in the cache.
#[derive(Debug, Clone)]
pub struct CachedObject {
    /// Its file.
    pub path: PathBuf,
    /// Whether it had to be read from the store.
    pub was_read: bool,
}

impl PublishedMaps {
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
        let cache = ObjectCache::open(cache, max_bytes)?;
        let (latest, retained) = (Mutex::default(), Mutex::default());
        Ok(Self(Arc::new(Inner { storage, cache, latest, retained })))
    }

    /// The current manifest of the map of this name. When the store cannot be reached at the start, the one that was
    /// current before.
    ///
    /// # Errors
    /// [`ClusterError`]; [`ClusterError::NotThere`] only if the store is there and the map is not published.
    pub async fn current(&self, map: &str) -> Result<Arc<PublishedManifest>, ClusterError> {
        let (inner, map) = (self.0.clone(), map.to_owned());
        on_blocking_thread(async move || inner.current(&map).await).await
    }

    /// An object in the cache, verified; read from the store if it is missing or damaged.
    ///
    /// # Errors
    /// As [`ObjectCache::object`].
    pub async fn object(&self, object: ObjectRef) -> Result<CachedObject, ClusterError> {
        let inner = self.0.clone();
        on_blocking_thread(async move || inner.object(object).await).await
    }

    /// Declares which objects must stay in the cache; others may be removed when space is short.
    pub fn retain(&self, needed: BTreeSet<ObjectId>) {
        *self.0.retained.lock().unwrap_or_else(PoisonError::into_inner) = needed;
    }

    /// Limit of the cache, bytes.
    pub fn max_bytes(&self) -> u64 {
        self.0.cache.max_bytes()
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
            Err(ClusterError::NotThere { .. }) if self.storage.is_empty().await => {
                let address = self.storage.address().to_owned();
                self.last(map).ok_or(ClusterError::StorageEmpty { address })?
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

    async fn object(&self, object: ObjectRef) -> Result<CachedObject, ClusterError> {
        let mut needed = self.retained.lock().unwrap_or_else(PoisonError::into_inner).clone();
        needed.insert(object.sha256);
        self.cache.trim_for(&[object], &needed)?;
        let (path, was_read) = self.cache.object_of(&self.storage, &object).await?;
        Ok(CachedObject { path, was_read })
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
