//! Sources of published maps: the interface that machines of a cluster need, and a folder as source.
//!
//! A [`ManifestSource`] returns the current manifest of a map, and fetches objects to the local disk. Fetched objects
//! are verified: an object is named by the SHA-256 of its bytes.

mod object_store;

use crate::ClusterError;
use std::collections::BTreeSet;
use std::future::Future;
use std::path::{Path, PathBuf};
use std::pin::Pin;
use std::sync::Arc;

use veiloc_map::MapError;
use veiloc_map::regions::{Manifest, ObjectId, ObjectRef, RegionFolder, verify_file};

pub use object_store::ObjectStoreSource;

/// A published manifest.
#[derive(Debug)]
pub struct PublishedManifest {
    /// The SHA-256 of the manifest.
    pub id: ObjectId,
    /// The manifest.
    pub manifest: Manifest,
}

impl PublishedManifest {
    /// From this manifest.
    pub fn of(manifest: Manifest) -> Arc<Self> {
        Arc::new(Self { id: manifest.id(), manifest })
    }
}

/// The future result of a source.
pub type SourceFuture<'a, T> = Pin<Box<dyn Future<Output = Result<T, ClusterError>> + Send + 'a>>;

/// A source of published maps.
pub trait ManifestSource: Send + Sync {
    /// The current manifest of the map of this name.
    fn current<'a>(&'a self, map: &'a str) -> SourceFuture<'a, Arc<PublishedManifest>>;

    /// Fetches these objects, each verified, into a folder for [`RegionFolder::of`]; existing objects are kept.
    fn fetch(&self, objects: Vec<ObjectRef>) -> SourceFuture<'_, PathBuf>;

    /// Checks that objects of this many bytes have space on the local disk together.
    ///
    /// # Errors
    /// [`ClusterError::CacheTooSmall`].
    fn check_room(&self, bytes: u64) -> Result<(), ClusterError> {
        let _ = bytes;
        Ok(())
    }

    /// Declares which fetched objects are needed; others may be removed when space is short.
    fn retain(&self, needed: &BTreeSet<ObjectId>) {
        let _ = needed;
    }
}

/// A folder written by `veiloc map split`, with one map, for tests and machines that share a disk. Nothing is
/// fetched.
#[derive(Debug, Clone)]
pub struct FolderSource {
    folder: PathBuf,
}

impl FolderSource {
    /// From this folder.
    pub fn new(folder: &Path) -> Self {
        Self { folder: folder.to_owned() }
    }
}

impl ManifestSource for FolderSource {
    fn current<'a>(&'a self, map: &'a str) -> SourceFuture<'a, Arc<PublishedManifest>> {
        Box::pin(async move {
            let found = RegionFolder::open(&self.folder);
            let other =
                || ClusterError::NoMap { map: map.to_owned(), place: self.folder.display().to_string() };
            match found {
                Ok(folder) if folder.manifest().map == map => {
                    Ok(PublishedManifest::of(folder.manifest().clone()))
                }
                Ok(_) | Err(MapError::NoRegions { .. }) => Err(other()),
                Err(error) => Err(error.into()),
            }
        })
    }

    fn fetch(&self, objects: Vec<ObjectRef>) -> SourceFuture<'_, PathBuf> {
        Box::pin(async move {
            let verify_all = || -> Result<(), MapError> {
                let manifest = RegionFolder::open(&self.folder)?;
                objects.iter().try_for_each(|object| verify_file(&manifest.path_of(&object.sha256), object))
            };
            verify_all()?;
            Ok(self.folder.clone())
        })
    }
}
