//! Fetches all regions of a map into a folder, as `veiloc map split` writes it.

use std::path::Path;

use veiloc_map::regions::{MANIFEST_FILE, ObjectId};

use crate::ClusterError;
use crate::object_store::cache::ObjectCache;
use crate::object_store::publish::ProgressCallback;
use crate::object_store::storage::Storage;

/// Result of a fetch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct FetchSummary {
    /// Id of the manifest.
    pub manifest: ObjectId,
    /// Fetched objects.
    pub fetched: usize,
    /// Their bytes.
    pub fetched_bytes: u64,
    /// Objects that existed and were valid.
    pub there: usize,
    /// Their bytes.
    pub there_bytes: u64,
}

/// Fetches all objects of a manifest into a folder. The manifest is written last, so that an older manifest in the
/// folder stays complete until then.
///
/// # Errors
/// As [`ObjectCache::object`] and [`Storage::manifest`].
pub async fn fetch_folder(
    storage: &Storage,
    map: &str,
    id: ObjectId,
    folder: &Path,
    watch: ProgressCallback<'_>,
) -> Result<FetchSummary, ClusterError> {
    let manifest = storage.manifest(map, id).await?;
    let cache = ObjectCache::open_objects(folder)?;
    let total = manifest.byte_count();
    let mut result = FetchSummary { manifest: id, fetched: 0, fetched_bytes: 0, there: 0, there_bytes: 0 };
    watch(0, total);
    for object in manifest.objects() {
        let (_, is_new) = cache.object_of(storage, &object).await?;
        let (count, bytes) = if is_new {
            (&mut result.fetched, &mut result.fetched_bytes)
        } else {
            (&mut result.there, &mut result.there_bytes)
        };
        *count += 1;
        *bytes += object.bytes;
        watch(result.fetched_bytes + result.there_bytes, total);
    }
    let path = folder.join(MANIFEST_FILE);
    veiloc_map::atomic_file::write_atomic(&path, &manifest.encode()).map_err(ClusterError::io(&path))?;
    Ok(result)
}
