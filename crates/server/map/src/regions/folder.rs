//! A folder of regions: `manifest.json`, and its objects in `objects/`.

use std::collections::BTreeSet;
use std::ffi::OsStr;
use std::fs;
use std::io::Read as _;
use std::path::{Path, PathBuf};

use crate::atomic_file::{Permissions, TargetLock, replace_file, write_atomic};
use crate::is_map_name;
use crate::{MapFile, MapMemory, Region};
use veiloc_geometry::Point3;
use veiloc_geometry::frames::World;

use crate::regions::index::RegionIndex;
use crate::regions::manifest::{MAX_MANIFEST_BYTES, Manifest, RegionEntry};
use crate::regions::object::{ObjectId, ObjectRef};
use crate::{ManifestError, MapError};

/// Name of the manifest in its folder.
pub const MANIFEST_FILE: &str = "manifest.json";

/// Name of the folder of the objects.
pub const OBJECTS_FOLDER: &str = "objects";

/// Writes a folder of regions, one region at a time, from several threads if the caller likes.
///
/// A reader finds the old or the new manifest: objects are written first, the manifest is replaced last, and objects
/// of only the old manifest are removed after that. One program at a time writes a folder.
#[derive(Debug)]
pub struct FolderWriter<'a> {
    map: &'a MapFile,
    name: &'a str,
    folder: PathBuf,
    lock: TargetLock,
}

impl<'a> FolderWriter<'a> {
    /// For the regions of a map of this name. Waits for another writer of the folder; creates the folder if missing.
    ///
    /// # Errors
    /// [`MapError::Name`], or [`MapError::Io`]: the folder cannot be created or written.
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

    /// Extracts a region and writes it; returns its entry of the manifest.
    ///
    /// Needs twice the memory of the region.
    ///
    /// # Errors
    /// [`MapError::Model`]: the map has no such region; [`MapError::Io`]: it cannot be written.
    pub fn region(&self, region: &Region) -> Result<RegionEntry, MapError> {
        let model = self.map.region(region.clone())?;
        let file = MapFile::of_model(&model)?;
        let (center, radius) = self.center_and_radius(region);
        let ObjectRef { sha256, bytes } = self.object(file.as_bytes())?;
        Ok(RegionEntry {
            sha256,
            bytes,
            images: region.of_images.len() as u64,
            core_images: region.core_count() as u64,
            points: model.points.len() as u64,
            center,
            radius,
        })
    }

    /// Writes profile, index and manifest, and removes objects that the manifest does not name. `entries` are the
    /// results of [`Self::region`] for `regions`, in order.
    ///
    /// # Errors
    /// [`MapError::Manifest`]: they are inconsistent; [`MapError::Io`].
    pub fn finish(self, regions: &[Region], entries: Vec<RegionEntry>) -> Result<Manifest, MapError> {
        let path = self.folder.join(MANIFEST_FILE);
        let profile = self.object(&self.map.profile().encode())?;
        let index = self.object(&RegionIndex::encode(self.map, regions))?;
        let (images, points) = (self.map.image_count() as u64, self.map.point_count() as u64);
        let manifest =
            Manifest::new(self.name, images, points, self.map.coordinates(), profile, index, entries)
                .map_err(|source| manifest_error(&path, source))?;
        let bytes = manifest.encode();
        replace_file(&self.lock, Permissions::Preserve, |out| out.write_all(&bytes))
            .map_err(MapError::io(&path))?;
        self.remove_unnamed_objects(&manifest);
        Ok(manifest)
    }

    fn object(&self, bytes: &[u8]) -> Result<ObjectRef, MapError> {
        let object = ObjectRef::of(bytes);
        let path = path_in(&self.folder, &object.sha256);
        write_atomic(&path, bytes).map_err(MapError::io(&path))?;
        Ok(object)
    }

    /// Mean of the camera centres of the core, and distance of the farthest one.
    fn center_and_radius(&self, region: &Region) -> ([f64; 3], f64) {
        let core = region.of_images.iter().filter(|image| image.is_core);
        let centres: Vec<Point3<World>> =
            core.map(|image| self.map.image(image.whole as usize).cam_from_world().center()).collect();
        let count = centres.len().max(1) as f64;
        let mean =
            centres.iter().fold(Point3::<World>::new(0.0, 0.0, 0.0).coords, |sum, c| sum + c.coords / count);
        let radius = centres.iter().map(|c| (c.coords - mean).norm()).fold(0.0, f64::max);
        (mean.into(), radius)
    }

    /// Removes objects of older manifests; a failure is ignored.
    fn remove_unnamed_objects(&self, manifest: &Manifest) {
        let named: BTreeSet<ObjectId> = manifest.objects().map(|object| object.sha256).collect();
        let Ok(entries) = fs::read_dir(self.folder.join(OBJECTS_FOLDER)) else { return };
        for entry in entries.flatten() {
            // Only files with the name of an object; others are foreign.
            let id = entry.file_name().to_str().and_then(|name| name.parse::<ObjectId>().ok());
            if id.is_some_and(|id| !named.contains(&id)) {
                let _ = fs::remove_file(entry.path());
            }
        }
    }
}

/// A folder of regions with its manifest.
#[derive(Debug, Clone)]
pub struct RegionFolder {
    folder: PathBuf,
    manifest: Manifest,
}

impl RegionFolder {
    /// Opens a folder of [`FolderWriter`]; reads only its manifest.
    ///
    /// # Errors
    /// [`MapError::NoRegions`]: there is no manifest; [`MapError::Manifest`]: it is invalid; [`MapError::Io`].
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
        file.take(MAX_MANIFEST_BYTES as u64 + 1).read_to_end(&mut bytes).map_err(MapError::io(&path))?;
        let manifest = Manifest::decode(&bytes).map_err(|source| manifest_error(&path, source))?;
        Ok(Self { folder: folder.to_owned(), manifest })
    }

    /// The objects of this manifest in `folder`, wherever the manifest came from.
    pub fn of(manifest: Manifest, folder: &Path) -> Self {
        Self { folder: folder.to_owned(), manifest }
    }

    /// The manifest.
    pub const fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// Path of an object.
    pub fn path_of(&self, object: &ObjectId) -> PathBuf {
        path_in(&self.folder, object)
    }

    /// Opens the index, and checks it against the manifest.
    ///
    /// # Errors
    /// As [`RegionIndex::open`], and [`MapError::Mismatch`].
    pub fn open_index(&self, memory: MapMemory) -> Result<RegionIndex, MapError> {
        let path = self.path_of(&self.manifest.index.sha256);
        let index = RegionIndex::open(&path, memory)?;
        let profile = &self.manifest.profile.sha256.as_bytes()[..16];
        let matches_manifest = index.region_count() == self.manifest.regions.len()
            && index.image_count() as u64 == self.manifest.images
            && index.profile().as_bytes() == profile;
        if matches_manifest { Ok(index) } else { Err(mismatch(&path, "an index of other regions")) }
    }

    /// Opens a region by its number in the manifest, and checks it against the manifest.
    ///
    /// # Errors
    /// [`MapError::NotAMap`]: the file is not a map; [`MapError::Mismatch`]: it is another region, or there is no
    /// region with this number.
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
