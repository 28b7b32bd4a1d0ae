//! Storage of regions: bounded reads.

use std::sync::Arc;

use futures_util::StreamExt as _;
use object_store::path::Path as Location;
use object_store::{ObjectStore, ObjectStoreExt as _};
use veiloc_map::is_map_name;
use veiloc_map::regions::{MAX_MANIFEST_BYTES, Manifest, ObjectId};
use veiloc_map::{ManifestError, MapError};

use crate::ClusterError;
use crate::object_store::address::{MissingFolder, resolve};
use crate::object_store::pointer::ManifestPointer;
use crate::object_store::refusal::{Refusal, refusal_of};
use crate::object_store::retry::RetryPolicy;

/// Storage where regions of maps are published.
#[derive(Debug, Clone)]
pub struct Storage {
    pub(crate) store: Arc<dyn ObjectStore>,
    root: Location,
    address: String,
    pub(crate) retry_policy: RetryPolicy,
}

impl Storage {
    /// Opens storage by URL; a path is a folder. Credentials and settings of clouds come from the environment
    /// (`AWS_…`, `GOOGLE_…`, `AZURE_…`). No request is sent yet.
    ///
    /// # Errors
    /// [`ClusterError::StorageAddress`]: the URL names no supported storage; [`ClusterError::Io`]: the folder does
    /// not exist; [`ClusterError::Storage`]: settings of a cloud are missing or wrong.
    pub fn open(url: &str) -> Result<Self, ClusterError> {
        let (store, root) = resolve(url, MissingFolder::Refuse)?;
        Ok(Self::of(store, root, url))
    }

    /// As [`Self::open`], but a folder need not exist yet: until it does, everything in it is
    /// [`ClusterError::NotThere`]. For services, which start from their cache while a drive is not mounted.
    ///
    /// # Errors
    /// As [`Self::open`], except [`ClusterError::Io`] for a missing folder.
    pub fn open_lazily(url: &str) -> Result<Self, ClusterError> {
        let (store, root) = resolve(url, MissingFolder::Wait)?;
        Ok(Self::of(store, root, url))
    }

    /// As [`Self::open`], and creates a missing folder, for publishing.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn create(url: &str) -> Result<Self, ClusterError> {
        let (store, root) = resolve(url, MissingFolder::Create)?;
        Ok(Self::of(store, root, url))
    }

    /// A given storage below `root`; `address` is its name in messages.
    pub fn of(store: Arc<dyn ObjectStore>, root: Location, address: &str) -> Self {
        Self {
            store,
            root,
            address: address.trim_end_matches('/').to_owned(),
            retry_policy: RetryPolicy::default(),
        }
    }

    /// Sets the number of attempts, the first pause, and the stall timeout.
    #[must_use]
    pub fn with_retry_policy(
        self,
        attempts: u32,
        pause: std::time::Duration,
        stall: std::time::Duration,
    ) -> Self {
        Self { retry_policy: RetryPolicy { attempts: attempts.max(1), pause, stall }, ..self }
    }

    /// Its name in messages.
    pub fn address(&self) -> &str {
        &self.address
    }

    /// The id of the current manifest of a map.
    ///
    /// # Errors
    /// [`ClusterError::NotThere`]: the map is not published; [`ClusterError::Pointer`]; [`ClusterError::Storage`].
    pub async fn current(&self, map: &str) -> Result<ObjectId, ClusterError> {
        let entry = self.pointer(map)?;
        let remedy = "publish the map first with `veiloc map publish`, and check its name";
        let bytes = self.read_small(&entry, ManifestPointer::MAX_BYTES, remedy).await?;
        let pointer = ManifestPointer::decode(&bytes, map)
            .map_err(|reason| ClusterError::Pointer { address: entry.address.clone(), reason })?;
        Ok(pointer.manifest)
    }

    /// The manifest of this map with this id.
    ///
    /// # Errors
    /// [`ClusterError::NotThere`]; [`ClusterError::Manifest`]: it is invalid or another one;
    /// [`ClusterError::Storage`].
    pub async fn manifest(&self, map: &str, id: ObjectId) -> Result<Manifest, ClusterError> {
        let entry = self.manifest_entry(id);
        let bytes = self.read_small(&entry, MAX_MANIFEST_BYTES as u64, REMEDY_REPUBLISH).await?;
        let wrong = |source| ClusterError::Manifest { address: entry.address.clone(), source };
        let manifest = Manifest::decode_as(&bytes, id).map_err(wrong)?;
        if manifest.map != map {
            return Err(wrong(ManifestError::OtherMap { expected: map.to_owned(), found: manifest.map }));
        }
        Ok(manifest)
    }

    pub(crate) fn pointer(&self, map: &str) -> Result<StorageEntry, ClusterError> {
        if !is_map_name(map) {
            return Err(MapError::Name { name: map.to_owned() }.into());
        }
        Ok(self.entry(&[&format!("{map}.json")]))
    }

    pub(crate) fn manifest_entry(&self, id: ObjectId) -> StorageEntry {
        self.entry(&["manifests", &format!("{id}.json")])
    }

    pub(crate) fn object_entry(&self, id: ObjectId) -> StorageEntry {
        self.entry(&["objects", &id.to_string()])
    }

    pub(crate) fn entry(&self, parts: &[&str]) -> StorageEntry {
        let location = parts.iter().fold(self.root.clone(), |location, part| location.join(*part));
        StorageEntry { location, address: format!("{}/{}", self.address, parts.join("/")) }
    }

    /// Reads a small object completely; fails when it is longer than `most`.
    pub(crate) async fn read_small(
        &self,
        entry: &StorageEntry,
        most: u64,
        remedy: &'static str,
    ) -> Result<Vec<u8>, ClusterError> {
        let read = async || {
            let mut bytes = Vec::new();
            let mut pieces = self.read(entry, remedy).await?;
            while let Some(piece) = self.retry_policy.await_next(pieces.next(), &entry.address).await? {
                bytes.extend_from_slice(&piece.map_err(|source| entry.error(source, remedy))?);
                if bytes.len() as u64 > most {
                    return Err(ClusterError::ObjectTooLong { address: entry.address.clone(), most });
                }
            }
            Ok(bytes)
        };
        self.retry_policy.attempt(read).await
    }

    /// Sends a request to the store, again after errors that pass.
    pub(crate) async fn request<T>(
        &self,
        entry: &StorageEntry,
        remedy: &'static str,
        act: impl AsyncFn() -> object_store::Result<T>,
    ) -> Result<T, ClusterError> {
        let once = async || {
            let answer = self.retry_policy.await_next(act(), &entry.address).await?;
            answer.map_err(|source| entry.error(source, remedy))
        };
        self.retry_policy.attempt(once).await
    }

    /// Reads an object as a stream.
    pub(crate) async fn read(
        &self,
        entry: &StorageEntry,
        remedy: &'static str,
    ) -> Result<futures_util::stream::BoxStream<'static, object_store::Result<bytes::Bytes>>, ClusterError>
    {
        let request = self.store.get(&entry.location);
        let answer = self.retry_policy.await_next(request, &entry.address).await?;
        Ok(answer.map_err(|source| entry.error(source, remedy))?.into_stream())
    }
}

/// An object in storage.
#[derive(Debug, Clone)]
pub(crate) struct StorageEntry {
    pub(crate) location: Location,
    pub(crate) address: String,
}

impl StorageEntry {
    pub(crate) fn error(&self, source: object_store::Error, remedy: &'static str) -> ClusterError {
        let address = self.address.clone();
        if let Some(Refusal { why, remedy, reported }) = refusal_of(&address, &source) {
            return ClusterError::StorageRefused { address, why, remedy, reported };
        }
        match source {
            object_store::Error::NotFound { .. } => ClusterError::NotThere { address, remedy },
            source => ClusterError::Storage { address, source: Box::new(source) },
        }
    }
}

/// Remedy if a published object is missing.
pub(crate) const REMEDY_REPUBLISH: &str =
    "it was removed, or not all was published: run `veiloc map publish` again";
