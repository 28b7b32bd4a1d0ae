//! A source in object storage, with what was fetched on the local disk.

use crate::ClusterError;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::object_store::{Cache, Storage};
use tokio::runtime::Handle;
use veiloc_map::regions::{ObjectId, ObjectRef};

use super::{Fetching, ManifestSource, Published};

/// Maps that were published to object storage.
#[derive(Debug, Clone)]
pub struct ObjectStoreSource(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    storage: Storage,
    cache: Cache,
    folder: PathBuf,
    /// What was published last, by the name of the map: its manifest is not read again.
    latest: Mutex<BTreeMap<String, Arc<Published>>>,
    /// What [`ManifestSource::keep`] was told last.
    kept: Mutex<BTreeSet<ObjectId>>,
}

impl ObjectStoreSource {
    /// Of this storage, with a cache in this folder of so many bytes at most.
    ///
    /// # Errors
    /// [`ClusterError`]: no such storage, or the folder cannot be made.
    pub fn open(url: &str, cache: &Path, most_bytes: u64) -> Result<Self, ClusterError> {
        Self::of(Storage::open(url)?, cache, most_bytes)
    }

    /// The same of storage of your own.
    ///
    /// # Errors
    /// [`ClusterError`]: the folder cannot be made.
    pub fn of(storage: Storage, cache: &Path, most_bytes: u64) -> Result<Self, ClusterError> {
        let folder = cache.to_owned();
        let cache = Cache::open(cache, most_bytes)?;
        Ok(Self(Arc::new(Inner { storage, cache, folder, latest: Mutex::default(), kept: Mutex::default() })))
    }
}

impl Inner {
    fn latest(&self) -> MutexGuard<'_, BTreeMap<String, Arc<Published>>> {
        self.latest.lock().unwrap_or_else(PoisonError::into_inner)
    }

    async fn current(&self, map: &str) -> Result<Arc<Published>, ClusterError> {
        let id = match self.storage.current(map).await {
            Ok(id) => id,
            Err(error) if error.may_pass() => self.last(map).ok_or(error)?,
            Err(error) => return Err(error),
        };
        let known = self.latest().get(map).filter(|published| published.id == id).cloned();
        if let Some(known) = known {
            return Ok(known);
        }
        let manifest = self.cache.manifest(&self.storage, map, id).await?;
        let published = Arc::new(Published { id, manifest });
        // Without it a machine cannot start while the storage is away, and all else goes well.
        if let Err(error) = self.cache.remember(map, id) {
            tracing::warn!(%error, map, "which manifest is current cannot be remembered");
        }
        self.latest().insert(map.to_owned(), published.clone());
        Ok(published)
    }

    /// Of a machine that starts while the storage is away: what was current before. One that has started has what it has.
    fn last(&self, map: &str) -> Option<ObjectId> {
        let id = self.cache.remembered(map).filter(|_| !self.latest().contains_key(map))?;
        tracing::warn!(map, manifest = %id, "the storage cannot be reached; what was current last is taken from the cache");
        Some(id)
    }

    async fn fetch(&self, objects: &[ObjectRef]) -> Result<PathBuf, ClusterError> {
        self.cache.check_room(objects.iter().map(|object| object.bytes).sum())?;
        let mut needed = self.kept.lock().unwrap_or_else(PoisonError::into_inner).clone();
        needed.extend(objects.iter().map(|object| object.sha256));
        self.cache.make_room(objects, &needed)?;
        for object in objects {
            self.cache.object(&self.storage, object).await?;
        }
        Ok(self.folder.clone())
    }
}

/// Does what storage takes time for on a thread of its own: its futures belong to one thread.
async fn apart<T: Send + 'static>(
    work: impl AsyncFnOnce() -> Result<T, ClusterError> + Send + 'static,
) -> Result<T, ClusterError> {
    let runtime = Handle::current();
    match tokio::task::spawn_blocking(move || runtime.block_on(work())).await {
        Ok(done) => done,
        Err(panic) => std::panic::resume_unwind(panic.into_panic()),
    }
}

impl ManifestSource for ObjectStoreSource {
    fn current<'a>(&'a self, map: &'a str) -> Fetching<'a, Arc<Published>> {
        let (inner, map) = (self.0.clone(), map.to_owned());
        Box::pin(apart(async move || inner.current(&map).await))
    }

    fn fetch(&self, objects: Vec<ObjectRef>) -> Fetching<'_, PathBuf> {
        let inner = self.0.clone();
        Box::pin(apart(async move || inner.fetch(&objects).await))
    }

    fn retain(&self, needed: &BTreeSet<ObjectId>) {
        self.0.kept.lock().unwrap_or_else(PoisonError::into_inner).clone_from(needed);
        // A cache that grew too large is told of, and no reason to stop answering.
        if let Err(error) = self.0.cache.trim(needed) {
            tracing::warn!(%error, "the cache could not be made smaller");
        }
    }
}
