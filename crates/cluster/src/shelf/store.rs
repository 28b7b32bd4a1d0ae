//! A shelf in object storage, with what was fetched on the local disk.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::runtime::Handle;
use veiloc_regions::{ObjectId, ObjectRef};
use veiloc_store::{Cache, Storage, StoreError};

use super::{Fetching, Published, Shelf, ShelfError};

/// Maps that were published to object storage.
#[derive(Debug, Clone)]
pub struct StoreShelf(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    storage: Storage,
    cache: Cache,
    folder: PathBuf,
    /// What was published last, by the name of the map: its manifest is not read again.
    latest: Mutex<BTreeMap<String, Arc<Published>>>,
}

impl StoreShelf {
    /// Of this storage, with a cache in this folder of so many bytes at most.
    ///
    /// # Errors
    /// [`ShelfError::Store`]: no such storage, or the folder cannot be made.
    pub fn open(url: &str, cache: &Path, most_bytes: u64) -> Result<Self, ShelfError> {
        let storage = Storage::open(url).map_err(ShelfError::of)?;
        let folder = cache.to_owned();
        let cache = Cache::open(cache, most_bytes).map_err(ShelfError::of)?;
        Ok(Self(Arc::new(Inner { storage, cache, folder, latest: Mutex::default() })))
    }
}

impl Inner {
    fn latest(&self) -> MutexGuard<'_, BTreeMap<String, Arc<Published>>> {
        self.latest.lock().unwrap_or_else(PoisonError::into_inner)
    }

    async fn current(&self, map: &str) -> Result<Arc<Published>, StoreError> {
        let id = self.storage.current(map).await?;
        let known = self.latest().get(map).filter(|published| published.id == id).cloned();
        if let Some(known) = known {
            return Ok(known);
        }
        let manifest = self.cache.manifest(&self.storage, map, id).await?;
        let published = Arc::new(Published { id, manifest });
        self.latest().insert(map.to_owned(), published.clone());
        Ok(published)
    }

    async fn bring(&self, objects: &[ObjectRef]) -> Result<PathBuf, StoreError> {
        self.cache.check_room(objects.iter().map(|object| object.bytes).sum())?;
        for object in objects {
            self.cache.object(&self.storage, object).await?;
        }
        Ok(self.folder.clone())
    }
}

impl ShelfError {
    fn of(error: StoreError) -> Self {
        Self::Store(Box::new(error))
    }
}

/// Does what storage takes time for on a thread of its own: its futures belong to one thread.
async fn apart<T: Send + 'static>(
    work: impl AsyncFnOnce() -> Result<T, StoreError> + Send + 'static,
) -> Result<T, ShelfError> {
    let runtime = Handle::current();
    match tokio::task::spawn_blocking(move || runtime.block_on(work())).await {
        Ok(done) => done.map_err(ShelfError::of),
        Err(panic) => std::panic::resume_unwind(panic.into_panic()),
    }
}

impl Shelf for StoreShelf {
    fn current<'a>(&'a self, map: &'a str) -> Fetching<'a, Arc<Published>> {
        let (inner, map) = (self.0.clone(), map.to_owned());
        Box::pin(apart(async move || inner.current(&map).await))
    }

    fn bring(&self, objects: Vec<ObjectRef>) -> Fetching<'_, PathBuf> {
        let inner = self.0.clone();
        Box::pin(apart(async move || inner.bring(&objects).await))
    }

    fn keep(&self, needed: &BTreeSet<ObjectId>) {
        // A cache that grew too large is told of, and no reason to stop answering.
        if let Err(error) = self.0.cache.trim(needed) {
            tracing::warn!(%error, "the cache could not be made smaller");
        }
    }
}
