//! Published versions of a map: list them, return to one, and remove old ones with what only they need.

use std::collections::BTreeSet;
use std::time::{Duration, SystemTime};

use futures_util::TryStreamExt as _;
use object_store::{ObjectMeta, ObjectStoreExt as _};
use veiloc_map::ManifestError;
use veiloc_map::regions::{MAX_MANIFEST_BYTES, Manifest, ObjectId};

use crate::ClusterError;
use crate::object_store::pointer::ManifestPointer;
use crate::object_store::storage::{REMEDY_REPUBLISH, Storage, StorageEntry};

/// A published version of a map.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct PublishedVersion {
    /// Id of its manifest.
    pub manifest: ObjectId,
    /// When it was published first, by the clock of the storage.
    pub published: SystemTime,
    /// Number of its regions.
    pub regions: usize,
    /// Bytes of all its objects; other versions may share them.
    pub bytes: u64,
    /// Whether it is the current one.
    pub is_current: bool,
}

/// Result of a removal.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct RemovalSummary {
    /// Removed versions of the map.
    pub versions: usize,
    /// Removed objects, which no version of any map needs any more.
    pub objects: usize,
    /// Their bytes.
    pub bytes: u64,
}

impl Storage {
    /// The published versions of a map, newest first.
    ///
    /// # Errors
    /// [`ClusterError::NotThere`]: the map is not published; [`ClusterError::Manifest`]: a manifest in the storage is
    /// damaged; [`ClusterError::Storage`].
    pub async fn versions(&self, map: &str) -> Result<Vec<PublishedVersion>, ClusterError> {
        let current = self.current(map).await?;
        let mut versions = Vec::new();
        for (manifest, meta) in self.manifests().await? {
            if manifest.map == map {
                versions.push(PublishedVersion {
                    manifest: manifest.id(),
                    published: meta.last_modified.into(),
                    regions: manifest.regions.len(),
                    bytes: manifest.byte_count(),
                    is_current: manifest.id() == current,
                });
            }
        }
        versions.sort_by_key(|version| (std::cmp::Reverse(version.published), version.manifest));
        Ok(versions)
    }

    /// Makes a version of a map that was published before the current one again. All its objects are looked for first.
    ///
    /// # Errors
    /// [`ClusterError::NotThere`]: the map, the version or one of its objects is not in the storage;
    /// [`ClusterError::Manifest`]: the version belongs to another map; [`ClusterError::Storage`]. The pointer then stays.
    pub async fn restore(&self, map: &str, id: ObjectId) -> Result<(), ClusterError> {
        self.current(map).await?;
        let manifest = self.manifest(map, id).await?;
        for object in manifest.objects() {
            let entry = self.object_entry(object.sha256);
            let head = async || self.store.head(&entry.location).await;
            let found = self.request(&entry, REMEDY_REPUBLISH, head).await?;
            if found.size != object.bytes {
                let (address, found) = (entry.address, format!("{} bytes", found.size));
                return Err(ClusterError::Object { address, expected: object, found });
            }
        }
        self.put(&self.pointer(map)?, ManifestPointer::new(map, id).encode()).await
    }

    /// Removes the versions of a map that were published longer ago than `age`, except the current one, and then all
    /// objects older than that which no version of any map in this storage needs.
    ///
    /// Nothing may be published at the same time: a new version may reuse an object that is about to be removed.
    ///
    /// # Errors
    /// As [`Self::versions`]; nothing is removed if any manifest cannot be read, because what it needs is then unknown.
    pub async fn remove_older(
        &self,
        map: &str,
        age: Duration,
        now: SystemTime,
    ) -> Result<RemovalSummary, ClusterError> {
        let current = self.current(map).await?;
        let is_old =
            |meta: &ObjectMeta| now.duration_since(meta.last_modified.into()).is_ok_and(|of| of > age);
        let (old, kept): (Vec<_>, Vec<_>) =
            self.manifests().await?.into_iter().partition(|(manifest, meta)| {
                manifest.map == map && manifest.id() != current && is_old(meta)
            });
        let needed: BTreeSet<ObjectId> =
            kept.iter().flat_map(|(manifest, _)| manifest.objects()).map(|object| object.sha256).collect();
        let mut removed = RemovalSummary::default();
        // Versions first: an object that is missing from a version that is still listed would be a broken version.
        for (manifest, _) in old {
            self.remove(&self.manifest_entry(manifest.id())).await?;
            removed.versions += 1;
        }
        for meta in self.listed("objects").await? {
            let name = meta.location.filename().and_then(|name| name.parse::<ObjectId>().ok());
            if let Some(id) = name.filter(|id| !needed.contains(id) && is_old(&meta)) {
                self.remove(&self.object_entry(id)).await?;
                removed.objects += 1;
                removed.bytes += meta.size;
            }
        }
        Ok(removed)
    }

    /// Whether the storage answers that it has no manifest of any map.
    pub(crate) async fn is_empty(&self) -> bool {
        self.listed("manifests").await.is_ok_and(|manifests| manifests.is_empty())
    }

    /// All manifests in the storage, of all maps.
    async fn manifests(&self) -> Result<Vec<(Manifest, ObjectMeta)>, ClusterError> {
        let mut manifests = Vec::new();
        for meta in self.listed("manifests").await? {
            let name = meta.location.filename().and_then(|name| name.strip_suffix(".json"));
            let Some(id) = name.and_then(|name| name.parse::<ObjectId>().ok()) else { continue };
            let entry = self.manifest_entry(id);
            let bytes = self.read_small(&entry, MAX_MANIFEST_BYTES as u64, REMEDY_REPUBLISH).await?;
            let wrong =
                |source: ManifestError| ClusterError::Manifest { address: entry.address.clone(), source };
            manifests.push((Manifest::decode_as(&bytes, id).map_err(wrong)?, meta));
        }
        Ok(manifests)
    }

    /// What is stored in one of the folders of this storage.
    async fn listed(&self, folder: &'static str) -> Result<Vec<ObjectMeta>, ClusterError> {
        let entry = self.entry(&[folder]);
        let list = async || self.store.list(Some(&entry.location)).try_collect().await;
        self.request(&entry, REMEDY_REPUBLISH, list).await
    }

    async fn remove(&self, entry: &StorageEntry) -> Result<(), ClusterError> {
        let delete = async || match self.store.delete(&entry.location).await {
            // Another program may have removed it first.
            Err(object_store::Error::NotFound { .. }) => Ok(()),
            done => done,
        };
        self.request(entry, REMEDY_REPUBLISH, delete).await
    }
}
