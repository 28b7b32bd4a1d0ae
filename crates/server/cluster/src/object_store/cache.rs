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
    Folder, MOST_MANIFEST_BYTES, Manifest, OBJECTS_FOLDER, ObjectId, ObjectRef, verify_file,
};

use crate::ClusterError;
use crate::object_store::pointer::Pointer;
use crate::object_store::storage::{AGAIN, Storage};

/// A folder of objects that were fetched, `objects/<sha256>`, manifests, `manifests/<id>.json`, and pointers as they were read
/// last, `pointers/<map name>.json`.
///
/// A file bears the name of an object only when it is that object: it is written beside, verified, and renamed. It is
/// verified again whenever it is asked for, and one that is damaged is fetched again. Several programs may share a folder.
#[derive(Debug)]
pub struct Cache {
    folder: PathBuf,
    most_bytes: u64,
}

/// What was removed from a cache.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct Trimmed {
    /// Objects that were removed.
    pub removed: usize,
    /// Bytes of the objects that are left.
    pub bytes: u64,
}

const MANIFESTS_FOLDER: &str = "manifests";
const POINTERS_FOLDER: &str = "pointers";
/// What a download is called until it is verified.
const PARTIAL: &str = ".partial";
/// A download that nobody wrote to for so long is of the dead.
const DEAD_AFTER: Duration = Duration::from_secs(3600);

impl Cache {
    /// A cache in this folder, which is made where there is none, of so many bytes of objects at most.
    ///
    /// # Errors
    /// [`ClusterError::Io`] when it cannot be made.
    pub fn open(folder: &Path, most_bytes: u64) -> Result<Self, ClusterError> {
        for part in [OBJECTS_FOLDER, MANIFESTS_FOLDER, POINTERS_FOLDER] {
            let path = folder.join(part);
            fs::create_dir_all(&path).map_err(ClusterError::io(&path))?;
        }
        Ok(Self { folder: folder.to_owned(), most_bytes })
    }

    /// Without manifests and without bounds.
    pub(crate) fn open_objects(folder: &Path) -> Result<Self, ClusterError> {
        let path = folder.join(OBJECTS_FOLDER);
        fs::create_dir_all(&path).map_err(ClusterError::io(&path))?;
        Ok(Self { folder: folder.to_owned(), most_bytes: u64::MAX })
    }

    /// The objects of a manifest, as they lie here once they were fetched.
    pub fn folder_of(&self, manifest: Manifest) -> Folder {
        Folder::of(manifest, &self.folder)
    }

    /// The manifest of a map that has this id: from here, or fetched.
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
        // One that is longer than any, or is damaged, is as good as none.
        let is_short = fs::metadata(&path).is_ok_and(|m| m.len() <= MOST_MANIFEST_BYTES as u64);
        let kept = is_short.then(|| fs::read(&path).ok()).flatten();
        let kept = kept.and_then(|bytes| Manifest::decode_as(&bytes, id).ok());
        if let Some(manifest) = kept.filter(|manifest| manifest.map == map) {
            return Ok(manifest);
        }
        let manifest = storage.manifest(map, id).await?;
        veiloc_map::atomic_file::write_whole(&path, &manifest.encode()).map_err(ClusterError::io(&path))?;
        Ok(manifest)
    }

    /// Remembers that this manifest of a map was the current one.
    ///
    /// # Errors
    /// [`ClusterError::Io`].
    pub fn remember(&self, map: &str, id: ObjectId) -> Result<(), ClusterError> {
        let path = self.pointer(map);
        veiloc_map::atomic_file::write_whole(&path, &Pointer::new(map, id).encode())
            .map_err(ClusterError::io(&path))
    }

    /// What was remembered last of a map: what to begin with while storage cannot be reached.
    pub fn remembered(&self, map: &str) -> Option<ObjectId> {
        let bytes = fs::read(self.pointer(map)).ok().filter(|_| is_map_name(map))?;
        Pointer::decode(&bytes, map).ok().map(|pointer| pointer.manifest)
    }

    fn pointer(&self, map: &str) -> PathBuf {
        self.folder.join(POINTERS_FOLDER).join(format!("{map}.json"))
    }

    /// Where an object lies here, verified; fetched where it does not yet, or is damaged.
    ///
    /// # Errors
    /// [`ClusterError::Object`] when storage has something else under this name, [`ClusterError::NotThere`],
    /// [`ClusterError::CacheTooSmall`] when it alone is more than the cache may hold, [`ClusterError::Storage`],
    /// [`ClusterError::Io`].
    pub async fn object(&self, storage: &Storage, object: &ObjectRef) -> Result<PathBuf, ClusterError> {
        Ok(self.object_of(storage, object).await?.0)
    }

    /// The same, and whether it had to be fetched.
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

    /// Removes what was used least recently until the cache holds no more than it may, but nothing that is `needed`, and what
    /// downloads that died left behind. Whoever has a file open keeps it.
    ///
    /// # Errors
    /// [`ClusterError::Io`] when the folder cannot be read.
    pub fn trim(&self, needed: &BTreeSet<ObjectId>) -> Result<Trimmed, ClusterError> {
        self.trim_to(needed, self.most_bytes)
    }

    /// The same before these objects are fetched, so that they and what is there are together no more than there may be.
    ///
    /// # Errors
    /// [`ClusterError::Io`] when the folder cannot be read.
    pub fn make_room(
        &self,
        objects: &[ObjectRef],
        needed: &BTreeSet<ObjectId>,
    ) -> Result<Trimmed, ClusterError> {
        let folder = self.folder.join(OBJECTS_FOLDER);
        let is_missing = |object: &&ObjectRef| !folder.join(object.sha256.to_string()).exists();
        let coming: u64 = objects.iter().filter(is_missing).map(|object| object.bytes).sum();
        self.trim_to(needed, self.most_bytes.saturating_sub(coming))
    }

    fn trim_to(&self, needed: &BTreeSet<ObjectId>, most_bytes: u64) -> Result<Trimmed, ClusterError> {
        let folder = self.folder.join(OBJECTS_FOLDER);
        let mut others = Vec::new();
        let mut trimmed = Trimmed::default();
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
            } else if name.ends_with(PARTIAL) && apart(used, SystemTime::now()) > DEAD_AFTER {
                let _ = fs::remove_file(entry.path());
            }
        }
        others.sort_unstable();
        for (_, id, bytes) in others {
            if trimmed.bytes <= most_bytes {
                break;
            }
            // One that another program removed first is gone all the same.
            let _ = fs::remove_file(folder.join(id.to_string()));
            trimmed.removed += 1;
            trimmed.bytes -= bytes;
        }
        Ok(trimmed)
    }

    /// Whether the cache may hold so many bytes together.
    ///
    /// # Errors
    /// [`ClusterError::CacheTooSmall`].
    pub fn check_room(&self, needed: u64) -> Result<(), ClusterError> {
        if needed <= self.most_bytes {
            return Ok(());
        }
        Err(ClusterError::CacheTooSmall { path: self.folder.clone(), needed, most: self.most_bytes })
    }

    /// Whether the object is there and sound; it counts as used then. One that is damaged is removed.
    async fn has(&self, path: &Path, object: &ObjectRef) -> Result<bool, ClusterError> {
        let verified = {
            let (path, object) = (path.to_owned(), *object);
            tokio::task::spawn_blocking(move || {
                let verified = verify_file(&path, &object);
                if verified.is_ok()
                    && let Ok(file) = fs::File::options().append(true).open(&path)
                {
                    // When it was used last; a disk that cannot say it loses the order, and nothing else.
                    let _ = file.set_modified(SystemTime::now());
                }
                verified
            })
            .await
        };
        match verified {
            Ok(Ok(())) => Ok(true),
            Ok(Err(MapError::Object { .. })) => {
                fs::remove_file(path).or_else(gone_is_gone).map_err(ClusterError::io(path))?;
                Ok(false)
            }
            Ok(Err(MapError::Io { source, .. })) if source.kind() == std::io::ErrorKind::NotFound => {
                Ok(false)
            }
            Ok(Err(error)) => Err(error.into()),
            Err(_) => Err(ClusterError::io(path)(std::io::Error::other("reading it was broken off"))),
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

    /// Writes the object there; anything but the object is an error.
    async fn download(&self, storage: &Storage, object: &ObjectRef, to: &Path) -> Result<(), ClusterError> {
        let entry = storage.object_entry(object.sha256);
        let wrong =
            |found: String| ClusterError::Object { address: entry.address.clone(), expected: *object, found };
        let mut pieces = storage.read(&entry, AGAIN).await?;
        let mut file = tokio::fs::File::create_new(to).await.map_err(ClusterError::io(to))?;
        let (mut hash, mut length) = (Sha256::new(), 0_u64);
        while let Some(piece) = storage.retry_policy.await_next(pieces.next(), &entry.address).await? {
            let piece = piece.map_err(|source| entry.error(source, AGAIN))?;
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
        // The last write is told by `flush` alone: `sync_all` forgets that it failed, on a full disk for example.
        file.flush().await.map_err(ClusterError::io(to))?;
        file.sync_all().await.map_err(ClusterError::io(to))
    }
}

/// A download, which goes with whoever makes it.
struct Partial(PathBuf);

impl Drop for Partial {
    fn drop(&mut self) {
        let _ = fs::remove_file(&self.0);
    }
}

/// Between two times of the clock, whichever is first: it may have been set back since.
fn apart(one: SystemTime, other: SystemTime) -> Duration {
    one.duration_since(other).unwrap_or_else(|error| error.duration())
}

fn gone_is_gone(error: std::io::Error) -> std::io::Result<()> {
    if error.kind() == std::io::ErrorKind::NotFound { Ok(()) } else { Err(error) }
}
