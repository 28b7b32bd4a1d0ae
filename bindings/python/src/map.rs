//! The server's road: posed images to a map, and sealed queries with a map to poses.

use std::path::PathBuf;
use std::sync::Arc;

use numpy::PyArray2;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use veiloc_client::{CameraFromRig, SealedFrame};
use veiloc_geometry::CameraFromWorld;
use veiloc_localization::{LocalizeOptions, localize, localize_rig};
use veiloc_map::colmap::read_model;
use veiloc_map::{MapFile, MapLock, MapModel, PointId, PosedImages, SelfTest};
use veiloc_mapping::build_cache::Keeping;
use veiloc_mapping::calibration::{SelfTestOptions, Trial, chosen, is_testable, self_test, test_of, trials};
use veiloc_mapping::{BuildOptions, Doubt, Input, Words};
use veiloc_protocol::SealedQuery;

use crate::answer::Answer;
use crate::arrays;
use crate::errors::{Fault, Result};
use crate::estimate::position_of;
use crate::options::pose_options;
use crate::pose::CameraPose;
use crate::posed::{down_of, on_bad, posed_of};
use crate::profile::Profile;
use crate::shares::{ImageParts, parts_of, trials_of};
use crate::waiting::{Told, released};

/// A map: what sealed queries are localized in.
///
/// A map does not change: what adds or removes images returns another one. Maps of `build` and the like are in memory until
/// `save` writes them.
#[pyclass(frozen, module = "veiloc")]
pub(crate) struct Map {
    file: Arc<MapFile>,
    warnings: Vec<String>,
}

fn test_options(images: usize) -> SelfTestOptions {
    let mut options = SelfTestOptions::default();
    options.images = images;
    options
}

impl Map {
    /// A model that was built or changed, tested where that is wanted.
    fn finished(mut model: MapModel, doubts: &[Doubt], wanted: bool, told: &Told) -> Result<Self> {
        if wanted && is_testable(&model) {
            model.self_test = Some(self_test(&model, &SelfTestOptions::default(), told).map_err(Fault::map)?);
        }
        Self::of_model(&model, doubts.iter().map(ToString::to_string).collect())
    }

    fn of_model(model: &MapModel, warnings: Vec<String>) -> Result<Self> {
        Ok(Self { file: Arc::new(MapFile::of_model(model)?), warnings })
    }
}

#[pymethods]
impl Map {
    /// Builds a map of images whose poses are known.
    ///
    /// Args:
    ///     posed: the folder of a COLMAP model (text or binary) with cameras and poses, or a list of (name, camera,
    ///         CameraPose).
    ///     images: the folder of the images.
    ///     names: only these, in their order.
    ///     features: `"compact"` or `"sift"`.
    ///     down: which way is down in the map's axes, `[x, y, z]` or `"-z"`, if somebody knows.
    ///     self_test: let the map localize some of its own images, so that its answers know how far to believe themselves.
    ///     skip_bad: leave out images that cannot be used, instead of refusing.
    ///     work: a folder for features and matches: what is there is not computed again, what is computed is kept. It holds
    ///         keypoints and descriptors of the images.
    ///     progress: a callable of (stage, done, total).
    ///
    /// Raises:
    ///     MapError, ImageError: what cannot be read, or makes no map.
    #[staticmethod]
    #[pyo3(signature = (posed, images, *, names=None, features="compact", down=None, self_test=true, skip_bad=false, work=None, progress=None))]
    #[expect(clippy::too_many_arguments, reason = "keywords in Python")]
    fn build(
        py: Python<'_>,
        posed: &Bound<'_, PyAny>,
        images: PathBuf,
        names: Option<Vec<String>>,
        features: &str,
        down: Option<&Bound<'_, PyAny>>,
        self_test: bool,
        skip_bad: bool,
        work: Option<PathBuf>,
        progress: Option<Py<PyAny>>,
    ) -> Result<Self> {
        let posed = posed_of(posed)?;
        let down = down.map(down_of).transpose()?;
        let mut options = BuildOptions::default();
        features.clone_into(&mut options.features);
        Told::new(py, progress)?.run(py, |told| {
            let mut input = Input::new(&posed, &images).on_bad_image(on_bad(skip_bad));
            if let Some(names) = &names {
                input = input.with_names(names);
            }
            let keeping = work.as_deref().map(|folder| Keeping::in_folder(folder, &options)).transpose();
            let keeping = keeping.map_err(Fault::map)?;
            if let Some(keeping) = &keeping {
                input = input.with_kept(keeping);
            }
            let (mut model, report) = veiloc_mapping::build(&input, &options, told)?;
            keeping.map_or(Ok(()), |keeping| keeping.finish()).map_err(Fault::map)?;
            model.down = down;
            Self::finished(model, &report.doubts, self_test, told)
        })?
    }

    /// Makes a map of a complete COLMAP model: its points and observations are kept.
    ///
    /// Args:
    ///     model: the model's folder, text or binary.
    ///     images, features, down, self_test, skip_bad, progress: as of `build`.
    ///
    /// Raises:
    ///     MapError, ImageError: what cannot be read, or makes no map.
    #[staticmethod]
    #[pyo3(signature = (model, images, *, features="compact", down=None, self_test=true, skip_bad=false, progress=None))]
    #[expect(clippy::too_many_arguments, reason = "keywords in Python")]
    fn from_colmap(
        py: Python<'_>,
        model: PathBuf,
        images: PathBuf,
        features: &str,
        down: Option<&Bound<'_, PyAny>>,
        self_test: bool,
        skip_bad: bool,
        progress: Option<Py<PyAny>>,
    ) -> Result<Self> {
        let down = down.map(down_of).transpose()?;
        let mut options = BuildOptions::default();
        features.clone_into(&mut options.features);
        Told::new(py, progress)?.run(py, |told| {
            let colmap = read_model(&model)?;
            let posed = PosedImages::from(&colmap);
            let input = Input::new(&posed, &images).on_bad_image(on_bad(skip_bad));
            let (mut model, report) = veiloc_mapping::import(&colmap, &input, &options, told)?;
            model.down = down;
            Self::finished(model, &report.doubts, self_test, told)
        })?
    }

    /// Opens a map file.
    ///
    /// Raises:
    ///     MapError: it cannot be read, or is damaged.
    #[staticmethod]
    fn open(py: Python<'_>, path: PathBuf) -> Result<Self> {
        let file = py.detach(|| MapFile::open(&path))?;
        Ok(Self { file: Arc::new(file), warnings: Vec::new() })
    }

    /// Writes the map: the old file or the new one is there, whole, whatever happens.
    ///
    /// Raises:
    ///     MapError: it cannot be written.
    fn save(&self, py: Python<'_>, path: PathBuf) -> Result<()> {
        Ok(py.detach(|| MapLock::acquire(&path)?.write(&self.file.to_model()))?)
    }

    /// The map with more posed images; all else stays, the profile too.
    ///
    /// Args:
    ///     posed, images, names, self_test, skip_bad, progress: as of `build`; the poses are in the map's frame.
    ///
    /// Raises:
    ///     MapError, ImageError: what cannot be read, or an image that is there already.
    #[pyo3(signature = (posed, images, *, names=None, self_test=true, skip_bad=false, progress=None))]
    #[expect(clippy::too_many_arguments, reason = "keywords in Python")]
    fn add(
        &self,
        py: Python<'_>,
        posed: &Bound<'_, PyAny>,
        images: PathBuf,
        names: Option<Vec<String>>,
        self_test: bool,
        skip_bad: bool,
        progress: Option<Py<PyAny>>,
    ) -> Result<Self> {
        let posed = posed_of(posed)?;
        Told::new(py, progress)?.run(py, |told| {
            let mut input = Input::new(&posed, &images).on_bad_image(on_bad(skip_bad));
            if let Some(names) = &names {
                input = input.with_names(names);
            }
            let mut model = self.file.to_model();
            let report = veiloc_mapping::add(&mut model, &input, told)?;
            Self::finished(model, &report.doubts, self_test, told)
        })?
    }

    /// The map without these images, their keypoints, and the points that only they saw.
    ///
    /// Args:
    ///     names: of the images.
    ///     retrain: learn the vocabulary again without them; the profile is then another one.
    ///     self_test, progress: as of `build`.
    ///
    /// Raises:
    ///     MapError: a name that is not in the map.
    #[pyo3(signature = (names, *, retrain=false, self_test=true, progress=None))]
    fn remove(
        &self,
        py: Python<'_>,
        names: Vec<String>,
        retrain: bool,
        self_test: bool,
        progress: Option<Py<PyAny>>,
    ) -> Result<Self> {
        let words = if retrain { Words::Retrain } else { Words::Keep };
        Told::new(py, progress)?.run(py, |told| {
            let mut model = self.file.to_model();
            veiloc_mapping::remove(&mut model, &names, words, told)?;
            model.self_test = None;
            Self::finished(model, &[], self_test, told)
        })?
    }

    /// Lets the map localize some of its own images, each left out; returns what that came to, a dictionary by scheme:
    /// `images`, `localized`, `trusted`, `median_rotation_deg`, `median_translation` (map units), `noise_px`, `factor` (by which
    /// covariances are multiplied), `rotation_floor_deg`, `translation_floor`.
    ///
    /// Args:
    ///     images: most images.
    ///     schemes: which. Default: all.
    ///     progress: as of `build`.
    ///
    /// Raises:
    ///     MapError: no query can be sealed for the map.
    #[pyo3(signature = (*, images=50, schemes=None, progress=None))]
    fn self_test<'py>(
        &self,
        py: Python<'py>,
        images: usize,
        schemes: Option<Vec<String>>,
        progress: Option<Py<PyAny>>,
    ) -> Result<Bound<'py, PyDict>> {
        let mut options = test_options(images);
        if let Some(schemes) = schemes {
            options.schemes = schemes.iter().map(|s| Ok(s.parse()?)).collect::<Result<_>>()?;
        }
        let test =
            Told::new(py, progress)?.run(py, |told| self_test(&self.file.to_model(), &options, told))?;
        Ok(test_told(py, &test.map_err(Fault::map)?)?)
    }

    /// A share of a self-test, for `with_self_test`.
    ///
    /// Args:
    ///     share: `(i, n)`: the i-th of n shares, the first being 0.
    ///     images: most images of the whole test.
    ///     progress: as of `build`.
    ///
    /// Returns:
    ///     A list that `with_self_test` takes, and that can be pickled.
    ///
    /// Raises:
    ///     MapError: no query can be sealed for the map; InputError: no such share.
    #[pyo3(signature = (share, *, images=50, progress=None))]
    fn self_test_share(
        &self,
        py: Python<'_>,
        share: (usize, usize),
        images: usize,
        progress: Option<Py<PyAny>>,
    ) -> Result<Vec<ImageParts>> {
        let (part, of) = share;
        if part >= of {
            return Err(Fault::input(format_args!(
                "share: ({part}, {of}) is none; the first of n is (0, n)"
            )));
        }
        let options = test_options(images);
        Told::new(py, progress)?.run(py, |told| {
            let model = self.file.to_model();
            let own: Vec<usize> = chosen(&model, &options).into_iter().skip(part).step_by(of).collect();
            let tried = trials(&model, &own, &options, told).map_err(Fault::map)?;
            Ok(own.into_iter().zip(tried).map(|(image, trials)| parts_of(image, trials)).collect())
        })?
    }

    /// The map with what all shares of a self-test came to: as if one pair of hands had made it.
    ///
    /// Args:
    ///     shares: what `self_test_share` returned, each share's, in any order.
    ///     images: as told them.
    ///
    /// Raises:
    ///     InputError: an image of the test is missing, or is there twice.
    #[pyo3(signature = (shares, *, images=50))]
    fn with_self_test(&self, py: Python<'_>, shares: Vec<Vec<ImageParts>>, images: usize) -> Result<Self> {
        let options = test_options(images);
        let mut parts: Vec<ImageParts> = shares.into_iter().flatten().collect();
        parts.sort_by_key(|(image, _)| *image);
        py.detach(|| {
            let mut model = self.file.to_model();
            let wanted = chosen(&model, &options);
            let (told, tried): (Vec<usize>, Vec<Vec<Option<Trial>>>) =
                parts.into_iter().map(|(image, parts)| (image, trials_of(parts))).unzip();
            if told != wanted || tried.iter().any(|trials| trials.len() != options.schemes.len()) {
                return Err(Fault::input(format_args!(
                    "shares: {} images are told, and the test has {}; give all shares, each once, of this map",
                    told.len(),
                    wanted.len()
                )));
            }
            model.self_test = Some(test_of(&model, &tried, &options));
            Self::of_model(&model, self.warnings.clone())
        })
    }

    /// What the map's own test came to when it was built, as `self_test` returns it; None when there was none.
    #[getter]
    fn tested<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyDict>>> {
        self.file.self_test().map(|test| test_told(py, test)).transpose()
    }

    /// Finds where a sealed query was taken.
    ///
    /// Args:
    ///     query: its bytes.
    ///     retrieve: map images to match with.
    ///     use_prior: weigh matches by how likely they are before geometry is asked.
    ///     ransac_opt, bundle_opt: as of `estimate_absolute_pose`, `seed` with them.
    ///     position: `(x, y, z, sd)`: where the camera roughly is, map units.
    ///
    /// Raises:
    ///     NotLocalizedError: no pose is supported by it.
    ///     WrongProfileError: it was sealed for another map.
    ///     QueryError: the bytes are no sealed query.
    #[pyo3(signature = (query, *, retrieve=10, use_prior=true, ransac_opt=None, bundle_opt=None, position=None))]
    #[expect(clippy::too_many_arguments, reason = "keywords in Python")]
    fn localize(
        &self,
        py: Python<'_>,
        query: &[u8],
        retrieve: usize,
        use_prior: bool,
        ransac_opt: Option<&Bound<'_, PyDict>>,
        bundle_opt: Option<&Bound<'_, PyDict>>,
        position: Option<&Bound<'_, PyAny>>,
    ) -> Result<Answer> {
        let query = SealedQuery::decode(query)?;
        let options = options(retrieve, use_prior, ransac_opt, bundle_opt, position)?;
        let found = released(py, &options.pose.stop, || localize(&query, &self.file, &options))??;
        Ok(Answer::of_localization(&found, &self.file))
    }

    /// Finds where a device was, from several sealed queries and how it moved between them.
    ///
    /// Args:
    ///     frames: a list of (bytes, CameraPose of the camera on the rig, degrees, map units): `x_cam = R x_rig + t` and the
    ///         standard deviations of its rotation and place; (bytes, CameraPose) is fixed to the rig.
    ///     retrieve, use_prior, ransac_opt, bundle_opt, position: as of `localize`.
    ///
    /// Returns:
    ///     The pose of the rig; `frames` of it are the poses of the cameras.
    ///
    /// Raises:
    ///     NotLocalizedError, WrongProfileError, QueryError: as `localize`; InputError: no frames.
    #[pyo3(signature = (frames, *, retrieve=10, use_prior=true, ransac_opt=None, bundle_opt=None, position=None))]
    #[expect(clippy::too_many_arguments, reason = "keywords in Python")]
    fn localize_rig(
        &self,
        py: Python<'_>,
        frames: &Bound<'_, PyAny>,
        retrieve: usize,
        use_prior: bool,
        ransac_opt: Option<&Bound<'_, PyDict>>,
        bundle_opt: Option<&Bound<'_, PyDict>>,
        position: Option<&Bound<'_, PyAny>>,
    ) -> Result<Answer> {
        let frames = frames_of(frames)?;
        let options = options(retrieve, use_prior, ransac_opt, bundle_opt, position)?;
        let found = released(py, &options.pose.stop, || localize_rig(&frames, &self.file, &options))??;
        Ok(Answer::of_rig(&found))
    }

    /// What a device needs to seal for this map.
    #[getter]
    fn profile(&self) -> Profile {
        Profile(self.file.profile().clone())
    }

    /// Names of its images.
    #[getter]
    fn image_names(&self) -> Vec<String> {
        self.file.images().map(|image| image.name().to_owned()).collect()
    }

    /// Poses of its images, by name.
    #[getter]
    fn poses(&self) -> std::collections::BTreeMap<String, CameraPose> {
        let pose =
            |image: veiloc_map::ImageView<'_>| (image.name().to_owned(), CameraPose(*image.cam_from_world()));
        self.file.images().map(pose).collect()
    }

    /// Its points, `[N, 3]`, map units.
    #[getter]
    fn points<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        arrays::matrix(
            py,
            (0..self.file.point_count()).map(|i| self.file.point(PointId(i as u32)).coords.into()),
        )
    }

    /// Which way is down, `[3]`; None when nobody said it.
    #[getter]
    fn down(&self) -> Option<[f64; 3]> {
        self.file.down().map(|down| down.in_world())
    }

    /// What was doubted when it was built or changed.
    #[getter]
    fn warnings(&self) -> Vec<String> {
        self.warnings.clone()
    }

    /// The map from above, for notebooks: its points, and the cameras of its images.
    fn _repr_svg_(&self, py: Python<'_>) -> Option<String> {
        py.detach(|| {
            let points =
                (0..self.file.point_count()).map(|i| self.file.point(PointId(i as u32)).coords.into());
            let cameras = self.file.images().map(|image| *image.cam_from_world());
            veiloc_report::map_picture(&points.collect::<Vec<_>>(), &cameras.collect::<Vec<_>>(), self.down())
        })
    }

    /// Number of images.
    fn __len__(&self) -> usize {
        self.file.image_count()
    }

    fn __repr__(&self) -> String {
        let (images, points) = (self.file.image_count(), self.file.point_count());
        format!("<Map of {images} images, {points} points, profile {}>", self.file.profile().id())
    }
}

fn options(
    retrieve: usize,
    use_prior: bool,
    ransac: Option<&Bound<'_, PyDict>>,
    bundle: Option<&Bound<'_, PyDict>>,
    position: Option<&Bound<'_, PyAny>>,
) -> Result<LocalizeOptions> {
    let mut options = LocalizeOptions::default();
    (options.retrieve, options.use_prior) = (retrieve, use_prior);
    (options.pose, options.seed) = pose_options(ransac, bundle)?;
    options.position = position.map(position_of).transpose()?;
    Ok(options)
}

/// Sealed queries and where on a rig each image was taken.
pub(crate) fn frames_of(frames: &Bound<'_, PyAny>) -> Result<Vec<SealedFrame>> {
    let refused =
        || Fault::input("frames: a list of (bytes, CameraPose) or (bytes, CameraPose, degrees, map units)");
    let frame = |entry: PyResult<Bound<'_, PyAny>>| -> Result<SealedFrame> {
        let entry = entry?;
        let whole = entry.extract::<(Vec<u8>, CameraPose, f64, f64)>();
        let (bytes, pose, rotation_sd_deg, translation_sd) = whole
            .or_else(|_| {
                entry.extract::<(Vec<u8>, CameraPose)>().map(|(bytes, pose)| (bytes, pose, 0.0, 0.0))
            })
            .map_err(|_| refused())?;
        let on_rig: CameraFromWorld = pose.0;
        Ok(SealedFrame {
            query: SealedQuery::decode(&bytes)?,
            cam_from_rig: CameraFromRig::new(*on_rig.rotation(), *on_rig.translation()),
            rotation_sd_deg,
            translation_sd,
        })
    };
    frames.try_iter().map_err(|_| refused())?.map(frame).collect()
}

fn test_told<'py>(py: Python<'py>, test: &SelfTest) -> PyResult<Bound<'py, PyDict>> {
    let told = PyDict::new(py);
    for scheme in &test.schemes {
        let entry = PyDict::new(py);
        entry.set_item("images", test.images)?;
        entry.set_item("localized", scheme.localized)?;
        entry.set_item("trusted", scheme.trusted)?;
        entry.set_item("median_rotation_deg", scheme.median_rotation_deg)?;
        entry.set_item("median_translation", scheme.median_translation)?;
        entry.set_item("noise_px", scheme.median_noise_px)?;
        entry.set_item("factor", scheme.calibration.factor)?;
        entry.set_item("rotation_floor_deg", scheme.calibration.rotation_floor.to_degrees())?;
        entry.set_item("translation_floor", scheme.calibration.translation_floor)?;
        told.set_item(scheme.scheme.name(), entry)?;
    }
    Ok(told)
}
