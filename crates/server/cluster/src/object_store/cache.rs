//! Verified objects on the local disk.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, SystemTime};

use futures_util::StreamExt as _;
use sha2::{Digest as _, Sha256};
use tokio::io::AsyncWriteExt as _;
use veiloc_map::MapError;
use veiloc_map::is_map_name;
use veiloc_map::regions::{
    MAX_MANIFEST_BYTES, Manifest, OBJECTS_FOLDER, ObjectId, ObjectRef, RegionFolder, verify_file,
};

use crate::ClusterError;
use crate::object_store::pointer::ManifestPointer;
use crate::object_store::storage::{REMEDY_REPUBLISH, Storage};

/// A folder of fetched objects, `objects/<sha256>`, manifests, `manifests/<id>.json`, and the last pointers,
/// `pointers/<map name>.json`.
///
/// A file has the name of an object only if its content is that object: it is written under another name, verified,
/// and renamed. It is verified again on each use, and fetched again if damaged. Several programs may share a folder.
#[derive(Debug)]
pub struct ObjectCache {
    folder: PathBuf,
    max_bytes: u64,
}

/// Result of trimming a cache.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct TrimSummary {
    /// Removed objects.
    pub removed: usize,
    /// Bytes of the remaining objects.
    pub bytes: u64,
}

const MANIFESTS_FOLDER: &str = "manifests";
const POINTERS_FOLDER: &str = "pointers";
/// Suffix of a download until it is verified.
const PARTIAL: &str = ".partial";
/// Age after which an unfinished download is considered abandoned.
const DEAD_AFTER: Duration = Duration::from_secs(3600);

impl ObjectCache {
    /// Opens a cache in this folder, which is created if missing, with this limit of object bytes.
    ///
    /// # Errors
    /// [`ClusterError::Io`]: the folder cannot be created.
    pub fn open(folder: &Path, max_bytes: u64) -> Result<Self, ClusterError> {
        for part in [OBJECTS_FOLDER, MANIFESTS_FOLDER, POINTERS_FOLDER] {
            let path = folder.join(part);
            fs::create_dir_all(&path).map_err(ClusterError::io(&path))?;
        }
        Ok(Self { folder: folder.to_owned(), max_bytes })
    }

    /// Its limit of object bytes.
    pub const fn max_bytes(&self) -> u64 {
        self.max_bytes
    }

    /// A cache for objects only, without a limit.
    pub(crate) fn open_objects(folder: &Path) -> Result<Self, ClusterError> {
        let path = folder.join(OBJECTS_FOLDER);
        fs::create_dir_all(&path).map_err(ClusterError::io(&path))?;
        Ok(Self { folder: folder.to_owned(), max_bytes: u64::MAX })
    }

    /// The folder that contains the objects of a manifest once they are fetched.
    pub fn folder_of(&self, manifest: Manifest) -> RegionFolder {
        RegionFolder::of(manifest, &self.folder)
    }

    /// The manifest of a map with this id, from the cache or fetched.
    ///
    /// # Errors
    /// As [`Storage::manifest`], and [`ClusterError::Io`].
    pub async fn manifest(
        &self,
        storage: &Storage,
        map: &str,
        id: ObjectId,
    ) -> Result<Manifest, ClusterError> {
        let path = self.folder.join(MANIFESTS_FOLDER).join(format!("{id}.json"));
        // A file that is too long or damaged is ignored.
        let is_short = fs::metadata(&path).is_ok_and(|m| m.len() <= MAX_MANIFEST_BYTES as u64);
        let stored = is_short.then(|| fs::read(&path).ok()).flatten();
        let stored = stored.and_then(|bytes| Manifest::decode_as(&bytes, id).ok());
        if let Some(manifest) = stored.filter(|manifest| manifest.map == map) {
            return Ok(manifest);
        }
        let manifest = storage.manifest(map, id).await?;
        veiloc_map::atomic_file::write_atomic(&path, &manifest.encode()).map_err(ClusterError::io(&path))?;
        Ok(manifest)
    }

    /// Records the current manifest of a map.
    ///
    /// # Errors
    /// [`ClusterError::Io`].
    pub fn record_manifest(&self, map: &str, id: ObjectId) -> Result<(), ClusterError> {
        let path = self.pointer(map);
        veiloc_map::atomic_file::write_atomic(&path, &ManifestPointer::new(map, id).encode())
            .map_err(ClusterError::io(&path))
    }

    /// The last recorded manifest of a map, for starting while storage is unreachable.
    pub fn recorded_manifest(&self, map: &str) -> Option<ObjectId> {
        let bytes = fs::read(self.pointer(map)).ok().filter(|_| is_map_name(map))?;
        ManifestPointer::decode(&bytes, map).ok().map(|pointer| pointer.manifest)
    }

    fn pointer(&self, map: &str) -> PathBuf {
        self.folder.join(POINTERS_FOLDER).join(format!("{map}.json"))
    }

    /// The path of an object in the cache, verified; fetched if it is missing or damaged.
    ///
    /// # Errors
    /// [`ClusterError::Object`]: storage has other content under this name; [`ClusterError::NotThere`];
    /// [`ClusterError::CacheTooSmall`]: the object alone exceeds the limit; [`ClusterError::Storage`];
    /// [`ClusterError::Io`].
    pub async fn object(&self, storage: &Storage, object: &ObjectRef) -> Result<PathBuf, ClusterError> {
        Ok(self.object_of(storage, object).await?.0)
    }

    /// As [`Self::object`]; also returns whether the object was fetched.
    pub(crate) async fn object_of(
        &self,
        storage: &Storage,
        object: &ObjectRef,
    ) -> Result<(PathBuf, bool), ClusterError> {
        self.check_room(object.bytes)?;
        let path = self.folder.join(OBJECTS_FOLDER).join(object.sha256.to_string());
        if self.has(&path, object).await? {
            return Ok((path, false));
        }
        storage.retry_policy.attempt(async || self.fetch(storage, object, &path).await).await?;
        Ok((path, true))
    }

    /// Removes least recently used objects until the limit is met, except `needed` ones, and abandoned downloads.
    /// Open files stay usable.
    ///
    /// # Errors
    /// [`ClusterError::Io`]: the folder cannot be read.
    pub fn trim(&self, needed: &BTreeSet<ObjectId>) -> Result<TrimSummary, ClusterError> {
        self.trim_to(needed, self.max_bytes)
    }

    /// As [`Self::trim`], with space for these objects, which are fetched next.
    ///
    /// # Errors
    /// [`ClusterError::Io`]: the folder cannot be read.
    pub fn trim_for(
        &self,
        objects: &[ObjectRef],
        needed: &BTreeSet<ObjectId>,
    ) -> Result<TrimSummary, ClusterError> {
        let folder = self.folder.join(OBJECTS_FOLDER);
        let is_missing = |object: &&ObjectRef| !folder.join(object.sha256.to_string()).exists();
        let coming: u64 = objects.iter().filter(is_missing).map(|object| object.bytes).sum();
        self.trim_to(needed, self.max_bytes.saturating_sub(coming))
    }

    fn trim_to(&self, needed: &BTreeSet<ObjectId>, max_bytes: u64) -> Result<TrimSummary, ClusterError> {
        let folder = self.folder.join(OBJECTS_FOLDER);
        let mut others = Vec::new();
        let mut trimmed = TrimSummary::default();
        for entry in fs::read_dir(&folder).map_err(ClusterError::io(&folder))?.flatten() {
            let Ok(metadata) = entry.metadata() else { continue };
            let name = entry.file_name();
            let Some(name) = name.to_str() else { continue };
            let used = metadata.modified().unwrap_or(SystemTime::UNIX_EPOCH);
            if let Ok(id) = name.parse::<ObjectId>() {
                trimmed.bytes += metadata.len();
                if !needed.contains(&id) {
                    others.push((used, id, metadata.len()));
                }
            } else if name.ends_with(PARTIAL) && time_between(used, SystemTime::now()) > DEAD_AFTER {
                let _ = fs::remove_file(entry.path());
            }
        }
        others.sort_unstable();
        for (_, id, bytes) in others {
            if trimmed.bytes <= max_bytes {
                break;
            }
            // Another program may have removed it first.
            let _ = fs::remove_file(folder.join(id.to_string()));
            trimmed.removed += 1;
            trimmed.bytes -= bytes;
        }
        Ok(trimmed)
    }

    /// Checks that this many bytes fit into the limit.
    ///
    /// # Errors
    /// [`ClusterError::CacheTooSmall`].
    pub fn check_room(&self, needed: u64) -> Result<(), ClusterError> {
        if needed <= self.max_bytes {
            return Ok(());
        }
        Err(ClusterError::CacheTooSmall { path: self.folder.clone(), needed, most: self.max_bytes })
    }

    /// Whether the object exists and is valid; updates its time of use. A damaged file is removed.
    async fn has(&self, path: &Path, object: &ObjectRef) -> Result<bool, ClusterError> {
        let verified = {
            let (path, object) = (path.to_owned(), *object);
            tokio::task::spawn_blocking(move || {
                let verified = verify_file(&path, &object);
                if verified.is_ok()
                    && let Ok(file) = fs::File::options().append(true).open(&path)
                {
                    // Time of last use. If it cannot be set, only the order of eviction suffers.
                    let _ = file.set_modified(SystemTime::now());
                }
                verified
            })
            .await
        };
        match verified {
            Ok(Ok(())) => Ok(true),
            Ok(Err(MapError::Object { .. })) => {
                fs::remove_file(path).or_else(ignore_not_found).map_err(ClusterError::io(path))?;
                Ok(false)
            }
            Ok(Err(MapError::Io { source, .. })) if source.kind() == std::io::ErrorKind::NotFound => {
                Ok(false)
            }
            Ok(Err(error)) => Err(error.into()),
            Err(_) => Err(ClusterError::io(path)(std::io::Error::other("reading the file was aborted"))),
        }
    }

    async fn fetch(&self, storage: &Storage, object: &ObjectRef, path: &Path) -> Result<(), ClusterError> {
        static COUNT: AtomicU64 = AtomicU64::new(0);
        let count = COUNT.fetch_add(1, Ordering::Relaxed);
        let partial = format!(".{}.{}-{count}{PARTIAL}", object.sha256, std::process::id());
        let partial = Partial(path.with_file_name(partial));
        self.download(storage, object, &partial.0).await?;
        fs::rename(&partial.0, path).map_err(ClusterError::io(path))
    }

    /// Downloads the object to this path; other content is an error.
    async fn download(&self, storage: &Storage, object: &ObjectRef, to: &Path) -> Result<(), ClusterError> {
        let entry = storage.object_entry(object.sha256);
        let wrong =
            |found: String| ClusterError::Object { address: entry.address.clone(), expected: *object, found };
        let mut pieces = storage.read(&entry, REMEDY_REPUBLISH).await?;
        let mut file = tokio::fs::File::create_new(to).await.map_err(ClusterError::io(to))?;
        let (mut hash, mut length) = (Sha256::new(), 0_u64);
        while let Some(piece) = storage.retry_policy.await_next(pieces.next(), &entry.address).await? {
            let piece = piece.map_err(|source| entry.error(source, REMEDY_REPUBLISH))?;
            length += piece.len() as u64;
            if length > object.bytes {
                return Err(wrong(format!("more than {} bytes", object.bytes)));
            }
            hash.update(&piece);
            file.write_all(&piece).await.map_err(ClusterError::io(to))?;
        }
        if length != object.bytes {
            return Err(wrong(format!("{length} bytes")));
        }
        let found = ObjectId::from_bytes(hash.finalize().into());
        if found != object.sha256 {
            return Err(wrong(format!("the object {found}")));
        }
        // Only `flush` reports a failed last write: `sync_all` loses the error, for example on a full disk.
        file.flush().await.map_err(ClusterError::io(to))?;
        file.sync_all().await.map_err(ClusterError::io(to))
    }
}

/// An unfinished download, removed when dropped.
struct Partial(PathBuf);

impl Drop for Partial {
    fn drop(&mut self) {
        let _ = fs::remove_file(&self.0);
    }
}

/// Absolute difference of two times; the clock may have been set back.
fn time_between(one: SystemTime, other: SystemTime) -> Duration {
    one.duration_since(other).unwrap_or_else(|error| error.duration())
}

fn ignore_not_found(error: std::io::Error) -> std::io::Result<()> {
    if error.kind() == std::io::ErrorKind::NotFound { Ok(()) } else { Err(error) }
}
