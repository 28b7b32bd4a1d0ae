//! The images as structure from motion takes them: panoramas become rigs of pinhole images, and formats that COLMAP does not read
//! become JPEG.
//!
//! ```text
//! work/images/panoramas-5760/front/hall/1.jpg, right/hall/1.jpg, …   of the panorama hall/1.jpg, 5760 pixels wide
//! work/images/hall/2.heic.jpg                                         of hall/2.heic
//! work/images/hall/2.heic, hall/3.jpg                                 the other images: links, or else copies
//! ```
//!
//! A rig has a camera for each pinhole image, whose focal length and pose on the rig are known; COLMAP finds the images of a rig
//! by the names of their folders.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use rayon::prelude::*;
use serde_json::{Value, json};
use veiloc_features::{Progress, faces_of_file, image_size, is_marked_panorama, load_colour};
use veiloc_geometry::{Panorama, PanoramaFace};
use veiloc_map::PosedImages;
use veiloc_map::atomic_file::write_atomic;

use super::images;
use crate::error::MappingError;
use crate::input::bad_image::{BadImage, BadImages, BadReason};
use crate::input::image_names::image_file;

/// Quality of the JPEG files.
const QUALITY: u8 = 95;

/// Images that share a camera.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct SharedCamera {
    pub(super) names: Vec<String>,
    /// Its parameters, if they are known: focal length and principal point, pixels.
    pub(super) simple_pinhole: Option<[f64; 3]>,
}

/// The images of structure from motion.
pub(super) struct Prepared {
    /// Their folder.
    pub(super) folder: PathBuf,
    /// Their names in it.
    pub(super) names: Vec<String>,
    pub(super) cameras: Vec<SharedCamera>,
    /// Widths of the panoramas, one rig each.
    rigs: BTreeMap<u32, Panorama>,
    /// Number of panoramas.
    pub(super) panoramas: usize,
    /// Name of the image that a name of [`Self::names`] stands for, where it is another.
    originals: BTreeMap<String, String>,
}

impl Prepared {
    /// The images of a folder. `are_panoramas`: all images of a panorama's shape are panoramas, also if their metadata does not
    /// say so.
    ///
    /// # Errors
    /// [`MappingError::BadImages`] for images that cannot be decoded, [`MappingError::Io`], and [`MappingError::Sfm`] if panoramas
    /// are expected and there is none.
    pub(super) fn new(
        images: &Path,
        names: Vec<String>,
        work: &Path,
        are_panoramas: bool,
        progress: &dyn Progress,
    ) -> Result<Self, MappingError> {
        let kind = |name: &String| Kind::of(&image_file(images, name), are_panoramas);
        let kinds: Vec<Kind> = names.par_iter().map(kind).collect();
        let panoramas = kinds.iter().filter(|kind| matches!(kind, Kind::Panorama(_))).count();
        if are_panoramas && panoramas == 0 {
            let reason = format!(
                "none of {} images is twice as wide as high, as an equirectangular panorama is; leave out --panoramas",
                names.len()
            );
            return Err(MappingError::Sfm { reason });
        }
        if kinds.iter().all(|kind| *kind == Kind::Photograph) {
            let cameras = images::by_camera(images, &names).into_iter();
            return Ok(Self {
                folder: images.to_owned(),
                cameras: cameras.map(|names| SharedCamera { names, simple_pinhole: None }).collect(),
                names,
                rigs: BTreeMap::new(),
                panoramas,
                originals: BTreeMap::new(),
            });
        }
        let folder = work.join("images");
        let all: Vec<(&String, &Kind)> = names.iter().zip(&kinds).collect();
        progress.start("panoramas and other formats", all.len());
        let written = all.par_iter().map(|(name, kind)| {
            let done = kind.write(images, name, &folder);
            progress.advance(1);
            done
        });
        let written: Result<Vec<()>, MappingError> = written.collect();
        progress.finish();
        written?;
        let mut prepared = Self {
            folder,
            names: Vec::new(),
            cameras: Vec::new(),
            rigs: BTreeMap::new(),
            panoramas,
            originals: BTreeMap::new(),
        };
        prepared.add(images, &all);
        Ok(prepared)
    }

    fn add(&mut self, images: &Path, all: &[(&String, &Kind)]) {
        let mut faces: BTreeMap<(u32, &str), (PanoramaFace, Vec<String>)> = BTreeMap::new();
        let mut photographs = Vec::new();
        for (name, kind) in all {
            match kind {
                Kind::Panorama(panorama) => {
                    self.rigs.insert(panorama.width(), *panorama);
                    for face in panorama.faces() {
                        let entry = faces.entry((panorama.width(), face.name)).or_insert((face, Vec::new()));
                        entry.1.push(face_name(*panorama, &face, name));
                    }
                }
                Kind::Photograph | Kind::Other => photographs.push((*name).clone()),
            }
        }
        let others: BTreeSet<&String> =
            all.iter().filter(|(_, kind)| **kind == Kind::Other).map(|(name, _)| *name).collect();
        for of_camera in images::by_camera(images, &photographs) {
            let names = of_camera.into_iter().map(|name| {
                if !others.contains(&name) {
                    return name;
                }
                let converted = converted_name(&name);
                self.originals.insert(converted.clone(), name);
                converted
            });
            self.cameras.push(SharedCamera { names: names.collect(), simple_pinhole: None });
        }
        for (_, (face, names)) in faces {
            let half = 0.5 * f64::from(face.camera.width);
            self.cameras.push(SharedCamera { names, simple_pinhole: Some([half; 3]) });
        }
        self.names = self.cameras.iter().flat_map(|camera| camera.names.iter().cloned()).collect();
        self.names.sort();
    }

    /// The rigs for pycolmap: for each its cameras, by the beginning of the names of their images.
    pub(super) fn rigs(&self) -> Value {
        let camera = |panorama: &Panorama, face: &PanoramaFace| {
            let [w, x, y, z] = face.cam_from_rig.quaternion();
            let prefix = face_name(*panorama, face, "");
            json!({ "prefix": prefix, "xyzw": [x, y, z, w] })
        };
        let rig = |panorama: &Panorama| -> Value {
            panorama.faces().iter().map(|face| camera(panorama, face)).collect()
        };
        self.rigs.values().map(rig).collect()
    }

    /// A model with the names of the images that were given.
    pub(super) fn with_original_names(&self, posed: PosedImages) -> Result<PosedImages, MappingError> {
        if self.originals.is_empty() {
            return Ok(posed);
        }
        let mut images = posed.images().to_vec();
        for image in &mut images {
            if let Some(original) = self.originals.get(&image.name) {
                image.name.clone_from(original);
            }
        }
        let remarks = posed.remarks().to_vec();
        Ok(PosedImages::new(images, posed.points().to_vec())?.with_remarks(remarks))
    }

    /// The name of the image that a name stands for.
    pub(super) fn original<'a>(&'a self, name: &'a str) -> &'a str {
        self.originals.get(name).map_or(name, String::as_str)
    }
}

/// How an image is taken.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Kind {
    /// As it is.
    Photograph,
    /// A format that COLMAP does not read.
    Other,
    Panorama(Panorama),
}

impl Kind {
    fn of(path: &Path, are_panoramas: bool) -> Self {
        let panorama = image_size(path).ok().and_then(|(width, height)| Panorama::new(width, height));
        if let Some(panorama) = panorama.filter(|_| are_panoramas || is_marked_panorama(path)) {
            return Self::Panorama(panorama);
        }
        let extension = path.extension().map(|extension| extension.to_string_lossy().to_lowercase());
        let is_read = extension.is_some_and(|e| matches!(e.as_str(), "jpg" | "jpeg" | "png"));
        if is_read { Self::Photograph } else { Self::Other }
    }

    /// Writes what stands for an image, unless it is there from an earlier run and newer.
    fn write(self, images: &Path, name: &str, folder: &Path) -> Result<(), MappingError> {
        let path = image_file(images, name);
        let bad = |error| {
            let reason = BadReason::Image(error);
            MappingError::BadImages(BadImages {
                images: vec![BadImage { name: name.to_owned(), reason }],
                of: 1,
            })
        };
        match self {
            Self::Photograph => link(&path, &folder.join(name)),
            Self::Other => {
                link(&path, &folder.join(name))?;
                let to = folder.join(converted_name(name));
                if is_newer(&to, &path) {
                    return Ok(());
                }
                let colour = load_colour(&path).map_err(bad)?;
                write_jpeg(&to, (colour.width(), colour.height()), colour.data())
            }
            Self::Panorama(panorama) => {
                let to = |face: &PanoramaFace| folder.join(face_name(panorama, face, name));
                if panorama.faces().iter().all(|face| is_newer(&to(face), &path)) {
                    return Ok(());
                }
                for (face, image) in faces_of_file(&path).map_err(bad)? {
                    write_jpeg(&to(&face), (image.width(), image.height()), image.data())?;
                }
                Ok(())
            }
        }
    }
}

/// The name of a pinhole image of a panorama.
fn face_name(panorama: Panorama, face: &PanoramaFace, name: &str) -> String {
    // All are JPEG, whatever the panorama is.
    let ending = if name.is_empty() || has_jpeg_ending(name) { "" } else { ".jpg" };
    format!("panoramas-{}/{}/{name}{ending}", panorama.width(), face.name)
}

fn has_jpeg_ending(name: &str) -> bool {
    Path::new(name)
        .extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("jpg") || e.eq_ignore_ascii_case("jpeg"))
}

fn converted_name(name: &str) -> String {
    format!("{name}.jpg")
}

fn modified(path: &Path) -> Option<SystemTime> {
    path.metadata().ok()?.modified().ok()
}

fn is_newer(made: &Path, of: &Path) -> bool {
    matches!((modified(made), modified(of)), (Some(made), Some(of)) if made >= of)
}

fn make_parent(path: &Path) -> Result<(), MappingError> {
    path.parent().map_or(Ok(()), |parent| fs::create_dir_all(parent).map_err(MappingError::io(parent)))
}

/// The same file under another path: a link where the file system has them, or else a copy.
fn link(from: &Path, to: &Path) -> Result<(), MappingError> {
    make_parent(to)?;
    let length = |path: &Path| path.metadata().ok().map(|file| file.len());
    if length(to).is_some() {
        if length(to) == length(from) && is_newer(to, from) {
            return Ok(());
        }
        fs::remove_file(to).map_err(MappingError::io(to))?;
    }
    if fs::hard_link(from, to).is_ok() {
        return Ok(());
    }
    fs::copy(from, to).map(drop).map_err(MappingError::io(to))
}

fn write_jpeg(path: &Path, (width, height): (u32, u32), rgb: &[u8]) -> Result<(), MappingError> {
    make_parent(path)?;
    let mut bytes = Vec::new();
    image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, QUALITY)
        .encode(rgb, width, height, image::ExtendedColorType::Rgb8)
        .map_err(|error| MappingError::io(path)(std::io::Error::other(error)))?;
    write_atomic(path, &bytes).map_err(MappingError::io(path))
}
