//! Publishing: objects first, then the manifest, last the pointer, so that a reader sees either the old or the new
//! map completely.

use std::sync::atomic::{AtomicU64, Ordering};

use futures_util::{StreamExt as _, TryStreamExt as _};
use object_store::buffered::BufWriter;
use object_store::{ObjectStoreExt as _, PutPayload};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use veiloc_map::regions::{ObjectId, ObjectRef, RegionFolder, verify_file};

use crate::ClusterError;
use crate::object_store::pointer::ManifestPointer;
use crate::object_store::storage::{Storage, StorageEntry};

/// Progress callback: bytes done, and bytes in total.
pub type ProgressCallback<'a> = &'a (dyn Fn(u64, u64) + Send + Sync);

/// Result of publishing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct PublishSummary {
    /// Id of the manifest, which is now current.
    pub manifest: ObjectId,
    /// Uploaded objects.
    pub sent: usize,
    /// Their bytes.
    pub sent_bytes: u64,
    /// Objects that existed already.
    pub there: usize,
    /// Their bytes.
    pub there_bytes: u64,
}

/// Concurrent uploads.
const CONCURRENT_UPLOADS: usize = 4;
/// Remedy if an object disappeared during the upload.
const REMEDY_REMOVED: &str = "it was removed during publishing: run `veiloc map publish` again";
/// Part size of multipart uploads, bytes; storage requires at least 5 MB.
const PART: usize = 8 << 20;

impl Storage {
    /// Publishes a folder of regions; its manifest becomes the current one of its map.
    ///
    /// Existing objects of the right length are not uploaded again. Each file is verified before its upload. Nothing
    /// is removed, because readers may still use an older manifest.
    ///
    /// # Errors
    /// [`ClusterError::Map`]: a file of the folder is damaged or missing; [`ClusterError::Storage`]. The previous
    /// manifest then stays current.
    pub async fn publish(
        &self,
        folder: &RegionFolder,
        watch: ProgressCallback<'_>,
    ) -> Result<PublishSummary, ClusterError> {
        let manifest = folder.manifest();
        let (id, total) = (manifest.id(), manifest.byte_count());
        let done = AtomicU64::new(0);
        let one = async |object: ObjectRef| -> Result<(ObjectRef, bool), ClusterError> {
            let is_new = self.retry_policy.attempt(async || self.object(folder, &object).await).await?;
            watch(done.fetch_add(object.bytes, Ordering::Relaxed) + object.bytes, total);
            Ok((object, is_new))
        };
        watch(0, total);
        let objects: Vec<(ObjectRef, bool)> = futures_util::stream::iter(manifest.objects())
            .map(one)
            .buffer_unordered(CONCURRENT_UPLOADS)
            .try_collect()
            .await?;
        self.put(&self.manifest_entry(id), manifest.encode()).await?;
        self.put(&self.pointer(&manifest.map)?, ManifestPointer::new(&manifest.map, id).encode()).await?;
        let sum = |new: bool| {
            let own = objects.iter().filter(|(_, is_new)| *is_new == new);
            own.fold((0, 0), |(count, bytes), (object, _)| (count + 1, bytes + object.bytes))
        };
        let ((sent, sent_bytes), (there, there_bytes)) = (sum(true), sum(false));
        Ok(PublishSummary { manifest: id, sent, sent_bytes, there, there_bytes })
    }

    /// Uploads an object if needed; returns whether it was uploaded.
    async fn object(&self, folder: &RegionFolder, object: &ObjectRef) -> Result<bool, ClusterError> {
        let entry = self.object_entry(object.sha256);
        match self.retry_policy.await_next(self.store.head(&entry.location), &entry.address).await? {
            Ok(there) if there.size == object.bytes => return Ok(false),
            Ok(_) | Err(object_store::Error::NotFound { .. }) => {}
            Err(source) => return Err(entry.error(source, REMEDY_REMOVED)),
        }
        let path = folder.path_of(&object.sha256);
        let verified = {
            let (path, object) = (path.clone(), *object);
            tokio::task::spawn_blocking(move || verify_file(&path, &object)).await
        };
        verified.map_err(|error| entry.error(error.into(), REMEDY_REMOVED))??;
        let mut file = tokio::fs::File::open(&path).await.map_err(ClusterError::io(&path))?;
        let mut writer = BufWriter::with_capacity(self.store.clone(), entry.location.clone(), PART);
        let mut piece = vec![0; 1 << 18];
        let mut left = object.bytes;
        while left > 0 {
            let most = usize::try_from(left).unwrap_or(usize::MAX).min(piece.len());
            let read = file.read(&mut piece[..most]).await.map_err(ClusterError::io(&path))?;
            if read == 0 {
                let ended = std::io::Error::from(std::io::ErrorKind::UnexpectedEof);
                return Err(ClusterError::io(&path)(ended));
            }
            let written =
                self.retry_policy.await_next(writer.write_all(&piece[..read]), &entry.address).await?;
            written.map_err(|error| entry.error(cause_of(error), REMEDY_REMOVED))?;
            left -= read as u64;
        }
        let ended = self.retry_policy.await_next(writer.shutdown(), &entry.address).await?;
        ended.map_err(|error| entry.error(cause_of(error), REMEDY_REMOVED))?;
        Ok(true)
    }

    pub(crate) async fn put(&self, entry: &StorageEntry, bytes: Vec<u8>) -> Result<(), ClusterError> {
        let put = async || self.store.put(&entry.location, PutPayload::from(bytes.clone())).await.map(|_| ());
        self.request(entry, REMEDY_REMOVED, put).await
    }
}

/// Extracts the storage error from the error of the writer.
fn cause_of(error: std::io::Error) -> object_store::Error {
    error
        .downcast()
        .unwrap_or_else(|error| object_store::Error::Generic { store: "writer", source: error.into() })
}
