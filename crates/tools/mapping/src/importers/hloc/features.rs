//! Feature files: one group per image with keypoints, scores and descriptors.

use std::path::Path;

use veiloc_descriptor::{DescriptorKind, Descriptors};
use veiloc_features::{Features, Keypoint};
use veiloc_geometry::Pixel;

use crate::MappingError;
use crate::importers::hloc::archive::Archive;
use crate::importers::hloc::numbers::Numbers;
use crate::importers::hloc::write::{GroupTree, NewDataset, Values};

const KEYPOINTS: &str = "keypoints";
const DESCRIPTORS: &str = "descriptors";
const SCORES: &str = "scores";
const SIZE: &str = "image_size";
const UNCERTAINTY: &str = "uncertainty";

/// Maximum number of keypoints per image.
const MAX_KEYPOINTS: usize = 1 << 17;
/// Maximum side length of an image, pixels.
const MAX_SIDE: f32 = 65535.0;

/// Vectors, stored contiguously.
#[derive(Clone, PartialEq)]
pub struct Vectors {
    /// Elements per vector.
    pub dim: usize,
    /// `[N, dim]`
    pub values: Vec<f32>,
}

// Descriptors reveal image content and must not reach a log (leak L8).
impl std::fmt::Debug for Vectors {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Vectors({} of {})", self.values.len() / self.dim.max(1), self.dim)
    }
}

/// Features of one image.
#[derive(Clone, PartialEq)]
pub struct ImageFeatures {
    /// `[N]`, in COLMAP's pixels of the stored image.
    pub keypoints: Vec<Pixel>,
    /// `[N]`, larger is stronger.
    pub scores: Option<Vec<f32>>,
    /// `[N, dim]`
    pub descriptors: Vectors,
    /// Width and height of the image, pixels.
    pub image_size: Option<(u32, u32)>,
    /// Standard deviation of a keypoint, pixels, if the file states it.
    pub uncertainty: Option<f64>,
}

// Keypoint positions must never reach a log (leak L8).
impl std::fmt::Debug for ImageFeatures {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "ImageFeatures({})", self.keypoints.len())
    }
}

/// A feature file.
#[derive(Debug)]
pub struct FeaturesFile(Archive);

impl FeaturesFile {
    /// Opens a file; each image is read on demand.
    ///
    /// # Errors
    /// [`MappingError::Io`], [`MappingError::NotHdf5`].
    pub fn open(path: &Path) -> Result<Self, MappingError> {
        Archive::open(path).map(Self)
    }

    /// Returns the path of the file.
    pub fn path(&self) -> &Path {
        self.0.path()
    }

    /// Returns the names of all images, sorted folder by folder.
    ///
    /// # Errors
    /// [`MappingError::BadInFile`] for groups that cannot be read, or are nested without end.
    pub fn names(&self) -> Result<Vec<String>, MappingError> {
        self.0.names(KEYPOINTS)
    }

    /// Returns whether it contains keypoints of an image of this name.
    pub fn holds(&self, name: &str) -> bool {
        let group = self.0.group(name);
        group.is_some_and(|group| matches!(self.0.dataset(name, &group, KEYPOINTS), Ok(Some(_))))
    }

    /// Returns the descriptor dimension, from the first image with keypoints; `None` if there is none.
    ///
    /// # Errors
    /// As [`Self::names`] and [`Self::read`].
    pub fn dim(&self) -> Result<Option<usize>, MappingError> {
        let Some(name) = self.0.any_name(DESCRIPTORS)? else { return Ok(None) };
        self.read(&name).map(|features| Some(features.descriptors.dim))
    }

    /// Reads the features of an image.
    ///
    /// # Errors
    /// [`MappingError::MissingInFile`] if there are none; [`MappingError::BadInFile`] for datasets that cannot be read,
    /// are not finite, or have inconsistent sizes.
    pub fn read(&self, name: &str) -> Result<ImageFeatures, MappingError> {
        let file = &self.0;
        let missing =
            |what| MappingError::MissingInFile { path: file.path().to_owned(), what, name: name.to_owned() };
        let group = file.group(name).ok_or_else(|| missing("features"))?;
        let numbers = |what| file.numbers(name, &group, what);
        let bad = |what: &str, reason: String| file.bad(&format!("{name}/{what}"), reason);
        let keypoints = numbers(KEYPOINTS)?.ok_or_else(|| missing("keypoints"))?;
        let count = match keypoints.shape[..] {
            [count, 2] if count <= MAX_KEYPOINTS => count,
            ref other => {
                let reason =
                    format!("has shape {other:?}; at most {MAX_KEYPOINTS} rows of 2 numbers are expected");
                return Err(bad(KEYPOINTS, reason));
            }
        };
        let descriptors = numbers(DESCRIPTORS)?.ok_or_else(|| missing("descriptors"))?;
        let descriptors = rows_of(descriptors, count).map_err(|reason| bad(DESCRIPTORS, reason))?;
        let scores = numbers(SCORES)?;
        if let Some(scores) = scores.as_ref().filter(|scores| scores.values.len() != count) {
            let reason =
                format!("has {} numbers for {count} keypoints; write the file again", scores.values.len());
            return Err(bad(SCORES, reason));
        }
        for (what, values) in [
            (KEYPOINTS, &keypoints.values),
            (DESCRIPTORS, &descriptors.values),
            (SCORES, scores.as_ref().map_or(&keypoints.values, |scores| &scores.values)),
        ] {
            if values.iter().any(|value| !value.is_finite()) {
                return Err(bad(what, "has numbers that are not finite; extract the image again".to_owned()));
            }
        }
        let image_size =
            numbers(SIZE)?.map(|size| size_of(&size)).transpose().map_err(|reason| bad(SIZE, reason))?;
        let uncertainty = match file.dataset(name, &group, KEYPOINTS)? {
            Some(own) => own.attrs().ok().and_then(|all| all.get(UNCERTAINTY)?.as_f64()),
            None => None,
        };
        let pixels = keypoints.values.chunks_exact(2);
        Ok(ImageFeatures {
            keypoints: pixels.map(|at| Pixel::from_center_at_zero(at[0].into(), at[1].into())).collect(),
            scores: scores.map(|scores| scores.values),
            descriptors,
            image_size,
            uncertainty: uncertainty.filter(|pixels| pixels.is_finite() && *pixels > 0.0),
        })
    }
}

/// hloc stores descriptors in columns, `[dim, N]`; here they are rows.
fn rows_of(columns: Numbers, count: usize) -> Result<Vectors, String> {
    let [dim, own] = columns.shape[..] else {
        return Err(format!("has shape {:?}; [descriptor dimension, {count}] is expected", columns.shape));
    };
    if own != count || dim == 0 {
        return Err(format!(
            "has shape [{dim}, {own}] and there are {count} keypoints; descriptors are columns, \
             [dimension, keypoints]"
        ));
    }
    let mut values = Vec::with_capacity(columns.values.len());
    values.extend((0..count).flat_map(|row| {
        let columns = &columns.values;
        (0..dim).map(move |number| columns[number * count + row])
    }));
    Ok(Vectors { dim, values })
}

fn size_of(size: &Numbers) -> Result<(u32, u32), String> {
    let side = |value: f32| (1.0..=MAX_SIDE).contains(&value) && value.fract() == 0.0;
    match size.values[..] {
        [width, height] if side(width) && side(height) => Ok((width as u32, height as u32)),
        _ => Err("is not the width and height of an image; write the file again".to_owned()),
    }
}

impl ImageFeatures {
    /// Converts to features of a kind, strongest first: vectors times the kind's norm, rounded to its bytes. Vectors
    /// with a norm of about 1 are not normalized, so that features written here are read back exactly; others are
    /// normalized.
    ///
    /// `scale`: standard deviation of the smoothing at which keypoints were detected, pixels; the files do not contain
    /// it.
    ///
    /// # Errors
    /// The reason, if the descriptor dimension differs from the kind's.
    pub fn features(&self, kind: DescriptorKind, scale: f32) -> Result<Features, String> {
        let dim = self.descriptors.dim;
        if dim != kind.dim() {
            return Err(format!("descriptors have {dim} numbers, and {kind} needs {}", kind.dim()));
        }
        let score = |i: usize| self.scores.as_ref().map_or(1.0, |scores| scores[i]);
        let mut order: Vec<usize> = (0..self.keypoints.len()).collect();
        order.sort_by(|a, b| score(*b).total_cmp(&score(*a)));
        let keypoints = order.iter().map(|&i| Keypoint {
            pixel: self.keypoints[i],
            scale,
            orientation: 0.0,
            response: score(i),
        });
        let mut bytes = Vec::with_capacity(self.descriptors.values.len());
        for &i in &order {
            let vector = &self.descriptors.values[i * dim..(i + 1) * dim];
            let length = vector.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt();
            let unit = if (0.9..1.1).contains(&length) || length < 1e-12 { 1.0 } else { length };
            let factor = f64::from(kind.norm()) / unit;
            bytes.extend(vector.iter().map(|v| kind.encoding().byte(f64::from(*v) * factor)));
        }
        let descriptors = Descriptors::new(kind, bytes).map_err(|e| e.to_string())?;
        Ok(Features { keypoints: keypoints.collect(), descriptors, global: None })
    }

    /// Converts features in pixels of an image of this size to unit vectors.
    pub fn of(features: &Features, image_size: (u32, u32)) -> Self {
        let kind = features.descriptors.kind();
        let view = features.descriptors.view();
        let length = kind.norm() as f32;
        let values = (0..view.len()).flat_map(|i| view.values(i).map(move |value| f32::from(value) / length));
        Self {
            keypoints: features.keypoints.iter().map(|k| k.pixel).collect(),
            scores: Some(features.keypoints.iter().map(|k| k.response).collect()),
            descriptors: Vectors { dim: kind.dim(), values: values.collect() },
            image_size: Some(image_size),
            uncertainty: None,
        }
    }
}

/// Checks that a feature file can hold images of these names.
///
/// # Errors
/// [`MappingError::Unwritable`] for a duplicate name, a name that is also a folder of another, or one that leaves its
/// folder.
pub fn check_feature_names<'a>(names: impl IntoIterator<Item = &'a str>) -> Result<(), MappingError> {
    let mut tree = GroupTree::default();
    for name in names {
        let values = Values::Single(Vec::new());
        tree.put(name, vec![NewDataset { name: KEYPOINTS, shape: vec![0, 2], values, attribute: None }])?;
    }
    Ok(())
}

/// Writes the features of images by name, like hloc's `extract_features`: keypoints and scores as float32 (a hundredth
/// of a pixel is preserved), descriptors in columns as float16.
///
/// # Errors
/// As [`check_feature_names`]; [`MappingError::Unwritable`] for different numbers of vectors and keypoints;
/// [`MappingError::Io`].
pub fn write_features(
    path: &Path,
    images: impl IntoIterator<Item = (String, ImageFeatures)>,
) -> Result<(), MappingError> {
    let mut tree = GroupTree::default();
    for (name, features) in images {
        let (count, dim) = (features.keypoints.len(), features.descriptors.dim);
        let of_scores = features.scores.as_ref().map_or(count, Vec::len);
        if features.descriptors.values.len() != count * dim || of_scores != count {
            let reason = "the numbers of keypoints, descriptors and scores differ".to_owned();
            return Err(MappingError::Unwritable { name, reason });
        }
        let at = |pixel: &Pixel| pixel.center_at_zero().map(|value| value as f32);
        let rows = &features.descriptors.values;
        let columns = (0..dim).flat_map(|number| (0..count).map(move |row| rows[row * dim + number]));
        let mut datasets = vec![
            NewDataset {
                name: DESCRIPTORS,
                shape: vec![dim, count],
                values: Values::Half(columns.collect()),
                attribute: None,
            },
            NewDataset {
                name: KEYPOINTS,
                shape: vec![count, 2],
                values: Values::Single(features.keypoints.iter().flat_map(at).collect()),
                attribute: features.uncertainty.map(|pixels| (UNCERTAINTY, pixels)),
            },
        ];
        if let Some((width, height)) = features.image_size {
            let values = Values::Whole(vec![width.into(), height.into()]);
            datasets.push(NewDataset { name: SIZE, shape: vec![2], values, attribute: None });
        }
        if let Some(scores) = features.scores {
            let values = Values::Single(scores);
            datasets.push(NewDataset { name: SCORES, shape: vec![count], values, attribute: None });
        }
        tree.put(&name, datasets)?;
    }
    tree.save(path)
}
