//! Storage that holds regions: what is read from it, and no more of it than there may be.

use std::sync::Arc;

use futures_util::StreamExt as _;
use object_store::path::Path as Location;
use object_store::{ObjectStore, ObjectStoreExt as _};
use veiloc_map::is_map_name;
use veiloc_map::regions::{MOST_MANIFEST_BYTES, Manifest, ObjectId};
use veiloc_map::{ManifestError, MapError};

use crate::ClusterError;
use crate::object_store::address::place_of;
use crate::object_store::pointer::Pointer;
use crate::object_store::refusal::{Refusal, refusal_of};
use crate::object_store::retry::RetryPolicy;

/// A place where regions of maps are published.
#[derive(Debug, Clone)]
pub struct Storage {
    pub(crate) store: Arc<dyn ObjectStore>,
    root: Location,
    address: String,
    pub(crate) retry_policy: RetryPolicy,
}

impl Storage {
    /// By its URL; a path is a folder. Credentials and settings of clouds are the environment's (`AWS_…`, `GOOGLE_…`,
    /// `AZURE_…`). Nothing is asked yet.
    ///
    /// # Errors
    /// [`ClusterError::StorageAddress`] when it names no storage that this program knows, [`ClusterError::Io`] when there is no such
    /// folder, [`ClusterError::Storage`] when settings of a cloud are missing or wrong.
    pub fn open(url: &str) -> Result<Self, ClusterError> {
        let (store, root) = place_of(url, false)?;
        Ok(Self::of(store, root, url))
    }

    /// The same, and a folder that is not there is made: for who publishes.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn create(url: &str) -> Result<Self, ClusterError> {
        let (store, root) = place_of(url, true)?;
        Ok(Self::of(store, root, url))
    }

    /// Storage of your own, below `root`; `address` is how messages call it.
    pub fn of(store: Arc<dyn ObjectStore>, root: Location, address: &str) -> Self {
        Self {
            store,
            root,
            address: address.trim_end_matches('/').to_owned(),
            retry_policy: RetryPolicy::default(),
        }
    }

    /// With less retry_policy: so many attempts, pauses that begin so, and so long without an answer.
    #[must_use]
    pub fn with_retry_policy(
        self,
        attempts: u32,
        pause: std::time::Duration,
        stall: std::time::Duration,
    ) -> Self {
        Self { retry_policy: RetryPolicy { attempts: attempts.max(1), pause, stall }, ..self }
    }

    /// How messages call it.
    pub fn address(&self) -> &str {
        &self.address
    }

    /// The id of the current manifest of a map.
    ///
    /// # Errors
    /// [`ClusterError::NotThere`] when the map was not published, [`ClusterError::Pointer`], [`ClusterError::Storage`].
    pub async fn current(&self, map: &str) -> Result<ObjectId, ClusterError> {
        let entry = self.pointer(map)?;
        let remedy = "publish the map first with `veiloc map publish`, and look whether this is its name";
        let bytes = self.small(&entry, Pointer::MOST_BYTES, remedy).await?;
        let pointer = Pointer::decode(&bytes, map)
            .map_err(|reason| ClusterError::Pointer { address: entry.address.clone(), reason })?;
        Ok(pointer.manifest)
    }

    /// The manifest of this map that has this id.
    ///
    /// # Errors
    /// [`ClusterError::NotThere`], [`ClusterError::Manifest`] when it is wrong or another one, [`ClusterError::Storage`].
    pub async fn manifest(&self, map: &str, id: ObjectId) -> Result<Manifest, ClusterError> {
        let entry = self.manifest_entry(id);
        let bytes = self.small(&entry, MOST_MANIFEST_BYTES as u64, AGAIN).await?;
        let wrong = |source| ClusterError::Manifest { address: entry.address.clone(), source };
        let manifest = Manifest::decode_as(&bytes, id).map_err(wrong)?;
        if manifest.map != map {
            return Err(wrong(ManifestError::OtherMap { expected: map.to_owned(), found: manifest.map }));
        }
        Ok(manifest)
    }

    pub(crate) fn pointer(&self, map: &str) -> Result<Entry, ClusterError> {
        if !is_map_name(map) {
            return Err(MapError::Name { name: map.to_owned() }.into());
        }
        Ok(self.entry(&[&format!("{map}.json")]))
    }

    pub(crate) fn manifest_entry(&self, id: ObjectId) -> Entry {
        self.entry(&["manifests", &format!("{id}.json")])
    }

    pub(crate) fn object_entry(&self, id: ObjectId) -> Entry {
        self.entry(&["objects", &id.to_string()])
    }

    fn entry(&self, parts: &[&str]) -> Entry {
        let location = parts.iter().fold(self.root.clone(), |location, part| location.join(*part));
        Entry { location, address: format!("{}/{}", self.address, parts.join("/")) }
    }

    /// All of something small; what is longer is not read to its end.
    async fn small(&self, entry: &Entry, most: u64, remedy: &'static str) -> Result<Vec<u8>, ClusterError> {
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

    /// What is there, piece by piece.
    pub(crate) async fn read(
        &self,
        entry: &Entry,
        remedy: &'static str,
    ) -> Result<futures_util::stream::BoxStream<'static, object_store::Result<bytes::Bytes>>, ClusterError>
    {
        let asked = self.store.get(&entry.location);
        let answer = self.retry_policy.await_next(asked, &entry.address).await?;
        Ok(answer.map_err(|source| entry.error(source, remedy))?.into_stream())
    }
}

/// Something in storage.
#[derive(Debug, Clone)]
pub(crate) struct Entry {
    pub(crate) location: Location,
    pub(crate) address: String,
}

impl Entry {
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

/// What was published is gone.
pub(crate) const AGAIN: &str = "it was removed, or not all was published: run `veiloc map publish` again";
