//! Where maps are published: what a machine of a cluster needs of it, and a folder that does for one.
//!
//! A [`ManifestSource`] says which manifest of a map holds now, and brings objects to the local disk. What it brings has been
//! verified: an object is named by the SHA-256 of its bytes.

mod object_store;

use crate::ClusterError;
use std::collections::BTreeSet;
use std::future::Future;
use std::path::{Path, PathBuf};
use std::pin::Pin;
use std::sync::Arc;

use veiloc_map::MapError;
use veiloc_map::regions::{Folder, Manifest, ObjectId, ObjectRef, verify_file};

pub use object_store::ObjectStoreSource;

/// What is published of a map.
#[derive(Debug)]
pub struct Published {
    /// The SHA-256 of the manifest.
    pub id: ObjectId,
    /// The manifest.
    pub manifest: Manifest,
}

impl Published {
    /// This manifest.
    pub fn of(manifest: Manifest) -> Arc<Self> {
        Arc::new(Self { id: manifest.id(), manifest })
    }
}

/// The future result of a source.
pub type Fetching<'a, T> = Pin<Box<dyn Future<Output = Result<T, ClusterError>> + Send + 'a>>;

/// Where maps are published.
pub trait ManifestSource: Send + Sync {
    /// The manifest that holds now for the map of this name.
    fn current<'a>(&'a self, map: &'a str) -> Fetching<'a, Arc<Published>>;

    /// Brings these objects, each verified, to a folder in which [`Folder::of`] finds them; those that are there stay.
    fn fetch(&self, objects: Vec<ObjectRef>) -> Fetching<'_, PathBuf>;

    /// Of what was brought these objects are needed; others may go when there is little room.
    fn retain(&self, needed: &BTreeSet<ObjectId>) {
        let _ = needed;
    }
}

/// A folder as `veiloc map split` writes it: one map, nothing to be brought. For tests and machines that share a disk.
#[derive(Debug, Clone)]
pub struct FolderSource {
    folder: PathBuf,
}

impl FolderSource {
    /// Of this folder.
    pub fn new(folder: &Path) -> Self {
        Self { folder: folder.to_owned() }
    }
}

impl ManifestSource for FolderSource {
    fn current<'a>(&'a self, map: &'a str) -> Fetching<'a, Arc<Published>> {
        Box::pin(async move {
            let found = Folder::open(&self.folder);
            let other =
                || ClusterError::NoMap { map: map.to_owned(), place: self.folder.display().to_string() };
            match found {
                Ok(folder) if folder.manifest().map == map => Ok(Published::of(folder.manifest().clone())),
                Ok(_) | Err(MapError::NoRegions { .. }) => Err(other()),
                Err(error) => Err(error.into()),
            }
        })
    }

    fn fetch(&self, objects: Vec<ObjectRef>) -> Fetching<'_, PathBuf> {
        Box::pin(async move {
            let anywhere = || -> Result<(), MapError> {
                let manifest = Folder::open(&self.folder)?;
                objects.iter().try_for_each(|object| verify_file(&manifest.path_of(&object.sha256), object))
            };
            anywhere()?;
            Ok(self.folder.clone())
        })
    }
}
