//! A folder of regions: `manifest.json`, and the objects that it names in `objects/`.

use std::collections::BTreeSet;
use std::ffi::OsStr;
use std::fs;
use std::io::Read as _;
use std::path::{Path, PathBuf};

use crate::atomic_file::{Readers, TargetLock, replace_file, write_whole};
use crate::is_map_name;
use crate::{MapFile, MapMemory, Region};
use veiloc_geometry::Point3;
use veiloc_geometry::frames::World;

use crate::regions::index::Index;
use crate::regions::manifest::{MOST_MANIFEST_BYTES, Manifest, RegionEntry};
use crate::regions::object::{ObjectId, ObjectRef};
use crate::{ManifestError, MapError};

/// Name of the manifest in its folder.
pub const MANIFEST_FILE: &str = "manifest.json";

/// Name of the folder of the objects beside it.
pub const OBJECTS_FOLDER: &str = "objects";

/// Writes a folder of regions, one region at a time and several threads at once where the caller likes.
///
/// Whoever reads the folder finds the old manifest or the new one: objects come first, the manifest is replaced last, and
/// objects that only the old one names go after that. One program at a time writes a folder.
#[derive(Debug)]
pub struct FolderWriter<'a> {
    map: &'a MapFile,
    name: &'a str,
    folder: PathBuf,
    lock: TargetLock,
}

impl<'a> FolderWriter<'a> {
    /// For the regions of a map of this name. Waits for another program that writes the folder; makes it where it is not.
    ///
    /// # Errors
    /// [`MapError::Name`], or [`MapError::Io`] when the folder cannot be made or written into.
    pub fn begin(map: &'a MapFile, name: &'a str, folder: &Path) -> Result<Self, MapError> {
        if !is_map_name(name) {
            return Err(MapError::Name { name: name.to_owned() });
        }
        let objects = folder.join(OBJECTS_FOLDER);
        fs::create_dir_all(&objects).map_err(MapError::io(&objects))?;
        let manifest = folder.join(MANIFEST_FILE);
        let lock = TargetLock::acquire(&manifest).map_err(MapError::io(&manifest))?;
        Ok(Self { map, name, folder: folder.to_owned(), lock })
    }

    /// Cuts a region out and writes it; what the manifest says of it.
    ///
    /// Takes the memory of the region twice.
    ///
    /// # Errors
    /// [`MapError::Model`] when the map has no such region, [`MapError::Io`] when it cannot be written.
    pub fn region(&self, region: &Region) -> Result<RegionEntry, MapError> {
        let model = self.map.region(region.clone())?;
        let file = MapFile::of_model(&model)?;
        let (centre, radius) = self.place_of(region);
        let ObjectRef { sha256, bytes } = self.object(file.as_bytes())?;
        Ok(RegionEntry {
            sha256,
            bytes,
            images: region.of_images.len() as u64,
            core_images: region.core_count() as u64,
            points: model.points.len() as u64,
            centre,
            radius,
        })
    }

    /// Writes profile, index and manifest, and removes objects that the manifest does not name. `entries` are what
    /// [`Self::region`] gave of `regions`, in their order.
    ///
    /// # Errors
    /// [`MapError::Manifest`] when they do not hold together, [`MapError::Io`].
    pub fn finish(self, regions: &[Region], entries: Vec<RegionEntry>) -> Result<Manifest, MapError> {
        let path = self.folder.join(MANIFEST_FILE);
        let profile = self.object(&self.map.profile().encode())?;
        let index = self.object(&Index::encode(self.map, regions))?;
        let (images, points) = (self.map.image_count() as u64, self.map.point_count() as u64);
        let manifest = Manifest::new(self.name, images, points, profile, index, entries)
            .map_err(|source| manifest_error(&path, source))?;
        let bytes = manifest.encode();
        replace_file(&self.lock, Readers::AsBefore, |out| out.write_all(&bytes))
            .map_err(MapError::io(&path))?;
        self.remove_others(&manifest);
        Ok(manifest)
    }

    fn object(&self, bytes: &[u8]) -> Result<ObjectRef, MapError> {
        let object = ObjectRef::of(bytes);
        let path = path_in(&self.folder, &object.sha256);
        write_whole(&path, bytes).map_err(MapError::io(&path))?;
        Ok(object)
    }

    /// Mean of the camera centres of the core, and distance of the farthest.
    fn place_of(&self, region: &Region) -> ([f64; 3], f64) {
        let core = region.of_images.iter().filter(|image| image.is_core);
        let centres: Vec<Point3<World>> =
            core.map(|image| self.map.image(image.whole as usize).cam_from_world().center()).collect();
        let count = centres.len().max(1) as f64;
        let mean =
            centres.iter().fold(Point3::<World>::new(0.0, 0.0, 0.0).coords, |sum, c| sum + c.coords / count);
        let radius = centres.iter().map(|c| (c.coords - mean).norm()).fold(0.0, f64::max);
        (mean.into(), radius)
    }

    /// Objects of older manifests. One that cannot be removed is only rubbish, so no failure.
    fn remove_others(&self, manifest: &Manifest) {
        let named: BTreeSet<ObjectId> = manifest.objects().map(|object| object.sha256).collect();
        let Ok(entries) = fs::read_dir(self.folder.join(OBJECTS_FOLDER)) else { return };
        for entry in entries.flatten() {
            // Only what has the name of an object: all else is somebody else's.
            let id = entry.file_name().to_str().and_then(|name| name.parse::<ObjectId>().ok());
            if id.is_some_and(|id| !named.contains(&id)) {
                let _ = fs::remove_file(entry.path());
            }
        }
    }
}

/// A folder of regions, its manifest read.
#[derive(Debug, Clone)]
pub struct Folder {
    folder: PathBuf,
    manifest: Manifest,
}

impl Folder {
    /// Opens a folder that [`FolderWriter`] wrote; reads its manifest alone.
    ///
    /// # Errors
    /// [`MapError::NoRegions`] when there is none, [`MapError::Manifest`] when it is wrong, [`MapError::Io`].
    pub fn open(folder: &Path) -> Result<Self, MapError> {
        let path = folder.join(MANIFEST_FILE);
        let file = match fs::File::open(&path) {
            Ok(file) => file,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                return Err(MapError::NoRegions { path });
            }
            Err(source) => return Err(MapError::Io { path, source }),
        };
        let mut bytes = Vec::new();
        file.take(MOST_MANIFEST_BYTES as u64 + 1).read_to_end(&mut bytes).map_err(MapError::io(&path))?;
        let manifest = Manifest::decode(&bytes).map_err(|source| manifest_error(&path, source))?;
        Ok(Self { folder: folder.to_owned(), manifest })
    }

    /// Objects of this manifest that lie in `folder`, wherever the manifest came from.
    pub fn of(manifest: Manifest, folder: &Path) -> Self {
        Self { folder: folder.to_owned(), manifest }
    }

    /// What it holds.
    pub const fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// Where an object lies.
    pub fn path_of(&self, object: &ObjectId) -> PathBuf {
        path_in(&self.folder, object)
    }

    /// Opens the index, and holds it against the manifest.
    ///
    /// # Errors
    /// As [`Index::open`], and [`MapError::Mismatch`].
    pub fn open_index(&self, memory: MapMemory) -> Result<Index, MapError> {
        let path = self.path_of(&self.manifest.index.sha256);
        let index = Index::open(&path, memory)?;
        let profile = &self.manifest.profile.sha256.as_bytes()[..16];
        let holds = index.region_count() == self.manifest.regions.len()
            && index.image_count() as u64 == self.manifest.images
            && index.profile().as_bytes() == profile;
        if holds { Ok(index) } else { Err(mismatch(&path, "an index of other regions")) }
    }

    /// Opens a region, by its number in the manifest, and holds it against the manifest.
    ///
    /// # Errors
    /// [`MapError::NotAMap`] when it is no map, [`MapError::Mismatch`] when it is another region's or there is none of
    /// this number.
    pub fn open_region(&self, number: usize, memory: MapMemory) -> Result<MapFile, MapError> {
        let Some(entry) = self.manifest.regions.get(number) else {
            let path = self.folder.join(MANIFEST_FILE);
            return Err(mismatch(&path, &format!("no region {number} of {}", self.manifest.regions.len())));
        };
        let path = self.path_of(&entry.sha256);
        let map = MapFile::open_in(&path, memory)?;
        let Some(part) = map.part_of() else { return Err(mismatch(&path, "a map that is no region")) };
        if ObjectRef::of(&map.profile().encode()) != self.manifest.profile {
            return Err(mismatch(&path, "a region with another profile"));
        }
        let found = [map.image_count(), part.core_count(), map.point_count()].map(|n| n as u64);
        if found != [entry.images, entry.core_images, entry.points]
            || u64::from(part.images) != self.manifest.images
        {
            return Err(mismatch(&path, "a region of other images or points"));
        }
        Ok(map)
    }
}

fn path_in(folder: &Path, object: &ObjectId) -> PathBuf {
    folder.join(OBJECTS_FOLDER).join(OsStr::new(&object.to_string()))
}

fn manifest_error(path: &Path, source: ManifestError) -> MapError {
    MapError::Manifest { from: path.display().to_string(), source }
}

fn mismatch(path: &Path, reason: &str) -> MapError {
    MapError::Mismatch { path: path.to_owned(), reason: reason.to_owned() }
}
