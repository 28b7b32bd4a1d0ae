//! Publishing: objects first, then the manifest, last the pointer, so that whoever reads finds all or the old.

use std::sync::atomic::{AtomicU64, Ordering};

use futures_util::{StreamExt as _, TryStreamExt as _};
use object_store::buffered::BufWriter;
use object_store::{ObjectStoreExt as _, PutPayload};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use veiloc_map::regions::{Folder, ObjectId, ObjectRef, verify_file};

use crate::ClusterError;
use crate::object_store::pointer::Pointer;
use crate::object_store::storage::{Entry, Storage};

/// Controllable how many bytes are done, of how many.
pub type Watch<'a> = &'a (dyn Fn(u64, u64) + Send + Sync);

/// What was published.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct Published {
    /// Id of the manifest, which is now the current one of its map.
    pub manifest: ObjectId,
    /// Objects that were sent.
    pub sent: usize,
    /// Bytes of them.
    pub sent_bytes: u64,
    /// Objects that were there already.
    pub there: usize,
    /// Bytes of them.
    pub there_bytes: u64,
}

/// Objects that are sent at the same time.
const AT_ONCE: usize = 4;
/// What was being published is gone.
const MEANWHILE: &str = "it went while it was being published: run `veiloc map publish` again";
/// Bytes of a part of a large object; storage wants 5 MB at least.
const PART: usize = 8 << 20;

impl Storage {
    /// Publishes a folder of regions, whose manifest becomes the current one of its map.
    ///
    /// Objects that are there with the right length are not sent again. Each file is read through and held against its name
    /// before it is sent. Nothing is removed: readers may be using what an older manifest names.
    ///
    /// # Errors
    /// [`ClusterError::Map`] when a file of the folder is damaged or missing, [`ClusterError::Storage`]; what was current
    /// before is then current still.
    pub async fn publish(&self, folder: &Folder, watch: Watch<'_>) -> Result<Published, ClusterError> {
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
            .buffer_unordered(AT_ONCE)
            .try_collect()
            .await?;
        self.put(&self.manifest_entry(id), manifest.encode()).await?;
        self.put(&self.pointer(&manifest.map)?, Pointer::new(&manifest.map, id).encode()).await?;
        let sum = |new: bool| {
            let own = objects.iter().filter(|(_, is_new)| *is_new == new);
            own.fold((0, 0), |(count, bytes), (object, _)| (count + 1, bytes + object.bytes))
        };
        let ((sent, sent_bytes), (there, there_bytes)) = (sum(true), sum(false));
        Ok(Published { manifest: id, sent, sent_bytes, there, there_bytes })
    }

    /// Whether it had to be sent.
    async fn object(&self, folder: &Folder, object: &ObjectRef) -> Result<bool, ClusterError> {
        let entry = self.object_entry(object.sha256);
        match self.retry_policy.await_next(self.store.head(&entry.location), &entry.address).await? {
            Ok(there) if there.size == object.bytes => return Ok(false),
            Ok(_) | Err(object_store::Error::NotFound { .. }) => {}
            Err(source) => return Err(entry.error(source, MEANWHILE)),
        }
        let path = folder.path_of(&object.sha256);
        let verified = {
            let (path, object) = (path.clone(), *object);
            tokio::task::spawn_blocking(move || verify_file(&path, &object)).await
        };
        verified.map_err(|error| entry.error(error.into(), MEANWHILE))??;
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
            written.map_err(|error| entry.error(cause_of(error), MEANWHILE))?;
            left -= read as u64;
        }
        let ended = self.retry_policy.await_next(writer.shutdown(), &entry.address).await?;
        ended.map_err(|error| entry.error(cause_of(error), MEANWHILE))?;
        Ok(true)
    }

    async fn put(&self, entry: &Entry, bytes: Vec<u8>) -> Result<(), ClusterError> {
        let put = async || {
            let payload = PutPayload::from(bytes.clone());
            let answer = self
                .retry_policy
                .await_next(self.store.put(&entry.location, payload), &entry.address)
                .await?;
            answer.map(|_| ()).map_err(|source| entry.error(source, MEANWHILE))
        };
        self.retry_policy.attempt(put).await
    }
}

/// What storage said, out of what the writer makes of it.
fn cause_of(error: std::io::Error) -> object_store::Error {
    error
        .downcast()
        .unwrap_or_else(|error| object_store::Error::Generic { store: "writer", source: error.into() })
}
