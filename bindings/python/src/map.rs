//! The server side: builds maps from posed images, and localizes sealed queries in them.

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
use veiloc_mapping::build_cache::FolderCache;
use veiloc_mapping::calibration::{SelfTestOptions, SelfTestTrial, chosen, self_test, trials};
use veiloc_mapping::structure_from_motion::{SfmOptions, reconstruct};
use veiloc_mapping::{
    BuildOptions, FinishOptions, Input, MapWarning, MaskFacts, OnOtherCoordinateFrame, VocabularyUpdate,
    finish, finish_tested,
};
use veiloc_protocol::SealedQuery;

use crate::answer::Answer;
use crate::arrays;
use crate::blocking::{ProgressCallback, interruptible};
use crate::build_shares::{ImageParts, parts_of, trials_of};
use crate::camera::dictionary;
use crate::errors::{BindingError, Result};
use crate::estimate::position_of;
use crate::options::pose_options;
use crate::pack::Pack;
use crate::pose::CameraPose;
use crate::posed::{Posed, down_of, matching_of, on_bad, on_other_coordinate_frame, posed_of};
use crate::profile::Profile;
use crate::sealed_in::query_of;

/// A map, in which sealed queries are localized.
///
/// A map is immutable: `add` and `remove` return a new one. A map that was built or changed is in memory until `save`
/// writes it.
#[pyclass(frozen, module = "veiloc")]
pub(crate) struct Map {
    file: Arc<MapFile>,
    warnings: Vec<MapWarning>,
    /// What was left out of the poses.
    remarks: Vec<String>,
}

fn test_options(images: usize) -> SelfTestOptions {
    let mut options = SelfTestOptions::default();
    options.images = images;
    options
}

impl Map {
    /// The map of a model that was built or changed. `remarks`: what was left out of the poses.
    fn finished(
        mut model: MapModel,
        mut warnings: Vec<MapWarning>,
        remarks: &[String],
        options: FinishOptions,
        progress: &ProgressCallback,
    ) -> Result<Self> {
        finish(&mut model, &mut warnings, &options, progress)?;
        Ok(Self { file: Arc::new(MapFile::of_model(&model)?), warnings, remarks: remarks.to_vec() })
    }
}

#[pymethods]
impl Map {
    /// Builds a map from images with known poses.
    ///
    /// Args:
    ///     posed: images with cameras and poses, of any format that `read_posed` reads, or a list of (name, camera,
    ///         CameraPose).
    ///     images: folder of the images.
    ///     names: use only these images, in this order.
    ///     masks: folder of masks, `door/3.jpg.png` for `door/3.jpg` as in COLMAP: nothing of what is black gets into the map. An
    ///         image without a mask is used as a whole.
    ///     features: `"compact"` or `"sift"`.
    ///     down: the down direction in the map's axes, `[x, y, z]` or a string such as `"-z"`. Default:
    ///         that of the format of `posed`, if it defines one.
    ///     metres: the poses are in metres. Default: if the format of `posed` defines it.
    ///     self_test: localize some of the map's own images, to calibrate the covariances of its answers.
    ///     keep_broken: return a map in which nothing can be localized, too.
    ///     skip_bad: skip images that cannot be used, instead of raising an error.
    ///     other_coordinate_frame: what to do with a group of images whose poses are in another coordinate frame than the rest: `"refuse"`,
    ///         `"align"` (transform their poses) or `"accept"` (do not compare).
    ///     work: folder that caches features and matches between calls. It holds keypoints and descriptors of the
    ///         images.
    ///     progress: a callable of (stage, done, total).
    ///
    /// Raises:
    ///     ImageError: an image cannot be used.
    ///     MapError: the model cannot be read, no map can be built from these images, or nothing can be localized in it.
    #[staticmethod]
    #[pyo3(signature = (posed, images, *, names=None, masks=None, features="compact", down=None, metres=false, self_test=true, keep_broken=false, skip_bad=false, other_coordinate_frame="refuse", work=None, progress=None))]
    #[expect(clippy::too_many_arguments, clippy::fn_params_excessive_bools, reason = "keywords in Python")]
    fn build(
        py: Python<'_>,
        posed: &Bound<'_, PyAny>,
        images: PathBuf,
        names: Option<Vec<String>>,
        masks: Option<PathBuf>,
        features: &str,
        down: Option<&Bound<'_, PyAny>>,
        metres: bool,
        self_test: bool,
        keep_broken: bool,
        skip_bad: bool,
        other_coordinate_frame: &str,
        work: Option<PathBuf>,
        progress: Option<Py<PyAny>>,
    ) -> Result<Self> {
        let Posed { images: posed, down: down_of_format, is_metric } = posed_of(posed, &images)?;
        let down = down.map(down_of).transpose()?.or(down_of_format);
        let other_coordinate_frame = on_other_coordinate_frame(other_coordinate_frame)?;
        let mut options = BuildOptions::default();
        features.clone_into(&mut options.features);
        ProgressCallback::new(py, progress)?.run(py, |progress| {
            let mut input = Input::new(&posed, &images)
                .on_bad_image(on_bad(skip_bad))
                .on_other_coordinate_frame(other_coordinate_frame);
            if let Some(names) = &names {
                input = input.with_names(names);
            }
            let mut remarks = posed.remarks().to_vec();
            if let Some(masks) = &masks {
                let all = posed.images().iter().map(|image| image.name.as_str());
                let facts = match &names {
                    Some(names) => MaskFacts::of(masks, names.iter().map(String::as_str)),
                    None => MaskFacts::of(masks, all),
                }?;
                remarks.extend(facts.doubt());
                input = input.with_masks(masks);
            }
            let cache = work.as_deref().map(|folder| FolderCache::in_folder(folder, &options)).transpose();
            let cache = cache.map_err(BindingError::map)?;
            if let Some(cache) = &cache {
                input = input.with_cache(cache);
            }
            let (mut model, report) = veiloc_mapping::build(&input, &options, progress)?;
            cache.map_or(Ok(()), |cache| cache.finish()).map_err(BindingError::map)?;
            model.down = down;
            model.is_metric = metres || is_metric;
            Self::finished(
                model,
                report.warnings,
                &remarks,
                FinishOptions { self_test, keep_broken },
                progress,
            )
        })?
    }

    /// Builds a map from images without poses: pycolmap computes the poses (`pip install veiloc[sfm]`).
    ///
    /// The map has no metric scale. Images without a pose, and further models that are not connected, are in `warnings`.
    ///
    /// Args:
    ///     images: folder of the images.
    ///     work: folder that keeps the database and models of COLMAP, and features and matches of the map, so that an
    ///         interrupted build continues. It holds keypoints and descriptors of the images.
    ///     names: use only these images.
    ///     features, down, self_test, keep_broken, skip_bad, progress: as for `build`.
    ///     matching: `"exhaustive"` (all pairs), `"sequential"` (frames of a video) or `"auto"`.
    ///     python: the Python that has pycolmap. Default: this one.
    ///     panoramas: all images that are twice as wide as high are equirectangular panoramas, also if their metadata does not say so.
    ///         Each becomes five pinhole images of the map.
    ///
    /// Raises:
    ///     ImageError: an image cannot be used.
    ///     MapError: pycolmap is not installed or fails, or no map can be built from these images.
    #[staticmethod]
    #[pyo3(signature = (images, work, *, names=None, features="compact", down=None, self_test=true, keep_broken=false, skip_bad=false, matching="auto", python=None, panoramas=false, progress=None))]
    #[expect(clippy::too_many_arguments, clippy::fn_params_excessive_bools, reason = "keywords in Python")]
    fn from_images(
        py: Python<'_>,
        images: PathBuf,
        work: PathBuf,
        names: Option<Vec<String>>,
        features: &str,
        down: Option<&Bound<'_, PyAny>>,
        self_test: bool,
        keep_broken: bool,
        skip_bad: bool,
        matching: &str,
        python: Option<PathBuf>,
        panoramas: bool,
        progress: Option<Py<PyAny>>,
    ) -> Result<Self> {
        let down = down.map(down_of).transpose()?;
        let mut sfm = SfmOptions::default();
        sfm.matching = matching_of(matching)?;
        sfm.skip_bad = skip_bad;
        sfm.are_panoramas = panoramas;
        sfm.python = match python {
            Some(python) => Some(python),
            None => py.import("sys")?.getattr("executable")?.extract()?,
        };
        let mut options = BuildOptions::default();
        features.clone_into(&mut options.features);
        ProgressCallback::new(py, progress)?.run(py, |progress| {
            let found = reconstruct(&images, names.as_deref(), &work.join("sfm"), &sfm, progress)?;
            let cache = FolderCache::in_folder(&work, &options).map_err(BindingError::map)?;
            let input =
                Input::new(&found.posed, &found.folder).on_bad_image(on_bad(skip_bad)).with_cache(&cache);
            let (mut model, report) = veiloc_mapping::build(&input, &options, progress)?;
            cache.finish().map_err(BindingError::map)?;
            model.down = down;
            let without_pose = found.unregistered.iter().map(ToString::to_string);
            let others = found.others.iter().map(|(model, posed)| {
                let (model, images) = (model.display(), posed.images().len());
                format!("{model}: a model of {images} images that is not connected is not used")
            });
            let left_out =
                found.left_out.iter().map(|(reason, count)| format!("{count} files are left out: {reason}"));
            let bad = found.bad.iter().map(ToString::to_string);
            let remarks: Vec<String> = without_pose.chain(others).chain(left_out).chain(bad).collect();
            Self::finished(
                model,
                report.warnings,
                &remarks,
                FinishOptions { self_test, keep_broken },
                progress,
            )
        })?
    }

    /// Builds a map from a complete COLMAP model; it keeps the model's points and observations.
    ///
    /// Args:
    ///     model: folder of the model, text or binary.
    ///     images, features, down, self_test, keep_broken, skip_bad, progress: as for `build`.
    ///     metres: lengths of the model are in metres.
    ///     other_coordinate_frame: what to do with a group of images whose poses are in another coordinate frame than the rest: `"refuse"` or
    ///         `"accept"`. To transform it, use `build` with `other_coordinate_frame="align"`.
    ///
    /// Raises:
    ///     MapError, ImageError: as for `build`.
    #[staticmethod]
    #[pyo3(signature = (model, images, *, features="compact", down=None, metres=false, self_test=true, keep_broken=false, skip_bad=false, other_coordinate_frame="refuse", progress=None))]
    #[expect(clippy::too_many_arguments, clippy::fn_params_excessive_bools, reason = "keywords in Python")]
    fn from_colmap(
        py: Python<'_>,
        model: PathBuf,
        images: PathBuf,
        features: &str,
        down: Option<&Bound<'_, PyAny>>,
        metres: bool,
        self_test: bool,
        keep_broken: bool,
        skip_bad: bool,
        other_coordinate_frame: &str,
        progress: Option<Py<PyAny>>,
    ) -> Result<Self> {
        let down = down.map(down_of).transpose()?;
        let other_coordinate_frame = on_other_coordinate_frame(other_coordinate_frame)?;
        if other_coordinate_frame == OnOtherCoordinateFrame::Align {
            return Err(BindingError::input(
                "other_coordinate_frame: the points of a complete model cannot be transformed; use `build` with other_coordinate_frame=\"align\"",
            ));
        }
        let mut options = BuildOptions::default();
        features.clone_into(&mut options.features);
        ProgressCallback::new(py, progress)?.run(py, |progress| {
            let colmap = read_model(&model)?;
            let posed = PosedImages::from(&colmap);
            let input = Input::new(&posed, &images)
                .on_bad_image(on_bad(skip_bad))
                .on_other_coordinate_frame(other_coordinate_frame);
            let (mut model, report) = veiloc_mapping::import(&colmap, &input, &options, progress)?;
            model.down = down;
            model.is_metric = metres;
            Self::finished(
                model,
                report.warnings,
                posed.remarks(),
                FinishOptions { self_test, keep_broken },
                progress,
            )
        })?
    }

    /// Opens a map file.
    ///
    /// Raises:
    ///     MapError: the file cannot be read, or is damaged.
    #[staticmethod]
    fn open(py: Python<'_>, path: PathBuf) -> Result<Self> {
        let file = py.detach(|| MapFile::open(&path))?;
        Ok(Self { file: Arc::new(file), warnings: Vec::new(), remarks: Vec::new() })
    }

    /// Writes the map to a file atomically: a failure leaves the old file unchanged.
    ///
    /// Raises:
    ///     MapError: the file cannot be written.
    fn save(&self, py: Python<'_>, path: PathBuf) -> Result<()> {
        Ok(py.detach(|| MapLock::acquire(&path)?.write(&self.file.to_model()))?)
    }

    /// Returns the map with more posed images; the profile stays the same.
    ///
    /// Args:
    ///     posed, images, names, self_test, keep_broken, skip_bad, progress: as for `build`; the poses are in the map's coordinate frame.
    ///     other_coordinate_frame: as for `build`; the images are localized in the map before they are added.
    ///
    /// Raises:
    ///     ImageError: an image cannot be used.
    ///     MapError: the poses cannot be read, or an image is in the map already.
    #[pyo3(signature = (posed, images, *, names=None, self_test=true, keep_broken=false, skip_bad=false, other_coordinate_frame="refuse", progress=None))]
    #[expect(clippy::too_many_arguments, reason = "keywords in Python")]
    fn add(
        &self,
        py: Python<'_>,
        posed: &Bound<'_, PyAny>,
        images: PathBuf,
        names: Option<Vec<String>>,
        self_test: bool,
        keep_broken: bool,
        skip_bad: bool,
        other_coordinate_frame: &str,
        progress: Option<Py<PyAny>>,
    ) -> Result<Self> {
        let posed = posed_of(posed, &images)?.images;
        let other_coordinate_frame = on_other_coordinate_frame(other_coordinate_frame)?;
        ProgressCallback::new(py, progress)?.run(py, |progress| {
            let mut input = Input::new(&posed, &images)
                .on_bad_image(on_bad(skip_bad))
                .on_other_coordinate_frame(other_coordinate_frame);
            if let Some(names) = &names {
                input = input.with_names(names);
            }
            let mut model = self.file.to_model();
            let report = veiloc_mapping::add(&mut model, &input, progress)?;
            Self::finished(
                model,
                report.warnings,
                posed.remarks(),
                FinishOptions { self_test, keep_broken },
                progress,
            )
        })?
    }

    /// Returns the map without these images, their keypoints, and the points that only they observe.
    ///
    /// Args:
    ///     names: names of the images to remove.
    ///     retrain: train the vocabulary again without them; this changes the profile.
    ///     self_test, keep_broken, progress: as for `build`.
    ///
    /// Raises:
    ///     MapError: a name is not in the map.
    #[pyo3(signature = (names, *, retrain=false, self_test=true, keep_broken=false, progress=None))]
    fn remove(
        &self,
        py: Python<'_>,
        names: Vec<String>,
        retrain: bool,
        self_test: bool,
        keep_broken: bool,
        progress: Option<Py<PyAny>>,
    ) -> Result<Self> {
        let words = if retrain { VocabularyUpdate::Retrain } else { VocabularyUpdate::Keep };
        ProgressCallback::new(py, progress)?.run(py, |progress| {
            let mut model = self.file.to_model();
            veiloc_mapping::remove(&mut model, &names, words, progress)?;
            Self::finished(model, Vec::new(), &[], FinishOptions { self_test, keep_broken }, progress)
        })?
    }

    /// Localizes some of the map's own images, each against the rest of the map (leave-one-out).
    ///
    /// Args:
    ///     images: most images to test.
    ///     schemes: obfuscation schemes. Default: all.
    ///     progress: as for `build`.
    ///
    /// Returns:
    ///     A dictionary for each scheme: `images`, `localized`, `trusted`, `median_rotation_deg`, `median_translation`
    ///     (map units), `noise_px`, `factor` (multiplies covariances), `rotation_floor_deg`, `translation_floor`.
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
        let test = ProgressCallback::new(py, progress)?
            .run(py, |progress| self_test(&self.file.to_model(), &options, progress))?;
        Ok(self_test_dict(py, &test.map_err(BindingError::map)?)?)
    }

    /// Runs one share of a self-test that several processes divide; `with_self_test` combines the shares.
    ///
    /// Args:
    ///     share: `(i, n)`: share `i` of `n`, counted from 0.
    ///     images: most images of the whole test.
    ///     progress: as for `build`.
    ///
    /// Returns:
    ///     A list for `with_self_test`; it can be pickled.
    ///
    /// Raises:
    ///     MapError: no query can be sealed for the map.
    ///     InputError: `share` is invalid.
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
            return Err(BindingError::input(format_args!(
                "share: ({part}, {of}) is not a share; give (i, n) with 0 <= i < n"
            )));
        }
        let options = test_options(images);
        ProgressCallback::new(py, progress)?.run(py, |progress| {
            let model = self.file.to_model();
            let own: Vec<usize> = chosen(&model, &options).into_iter().skip(part).step_by(of).collect();
            let tried = trials(&model, &own, &options, progress).map_err(BindingError::map)?;
            Ok(own.into_iter().zip(tried).map(|(image, trials)| parts_of(image, trials)).collect())
        })?
    }

    /// Returns the map with a self-test that was run in shares. The result equals that of a test in one process.
    ///
    /// Args:
    ///     shares: the results of `self_test_share` for all shares, in any order.
    ///     images: the same value as for `self_test_share`.
    ///     keep_broken: as for `build`.
    ///
    /// Raises:
    ///     MapError: nothing can be localized in the map.
    ///     InputError: an image of the test is missing or occurs twice.
    #[pyo3(signature = (shares, *, images=50, keep_broken=false))]
    fn with_self_test(
        &self,
        py: Python<'_>,
        shares: Vec<Vec<ImageParts>>,
        images: usize,
        keep_broken: bool,
    ) -> Result<Self> {
        let options = test_options(images);
        let mut parts: Vec<ImageParts> = shares.into_iter().flatten().collect();
        parts.sort_by_key(|(image, _)| *image);
        py.detach(|| {
            let mut model = self.file.to_model();
            let wanted = chosen(&model, &options);
            let (tested, tried): (Vec<usize>, Vec<Vec<Option<SelfTestTrial>>>) =
                parts.into_iter().map(|(image, parts)| (image, trials_of(parts))).unzip();
            if tested != wanted || tried.iter().any(|trials| trials.len() != options.schemes.len()) {
                return Err(BindingError::input(format_args!(
                    "shares: they hold {} images, but the test of this map has {}; give every share once",
                    tested.len(),
                    wanted.len()
                )));
            }
            let mut warnings = self.warnings.clone();
            finish_tested(&mut model, &mut warnings, &options, &tried, keep_broken)?;
            let file = Arc::new(MapFile::of_model(&model)?);
            Ok(Self { file, warnings, remarks: self.remarks.clone() })
        })
    }

    /// Result of the self-test that the map stores, as `self_test` returns it; None when it stores none.
    #[getter]
    fn tested<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyDict>>> {
        self.file.self_test().map(|test| self_test_dict(py, test)).transpose()
    }

    /// Localizes a sealed query.
    ///
    /// Args:
    ///     query: bytes of the sealed query.
    ///     retrieve: number of retrieved map images to match with.
    ///     use_prior: weight each match by its prior probability.
    ///     ransac_opt, bundle_opt: as for `estimate_absolute_pose`, including `seed`.
    ///     position: `(x, y, z, sd)`: approximate position of the camera and its standard deviation, map units.
    ///
    /// Raises:
    ///     NotLocalizedError: the query supports no pose in this map.
    ///     WrongProfileError: the query was sealed for another map.
    ///     QueryError: the bytes are not a sealed query.
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
        let found = interruptible(py, &options.pose.stop, || localize(&query, &self.file, &options))??;
        Ok(Answer::of_localization(&found, &self.file))
    }

    /// Localizes several sealed queries of one device together, given the relative poses of their cameras (a rig).
    ///
    /// Args:
    ///     frames: a list of (bytes, CameraPose, degrees, map units): the query, the camera's pose on the rig
    ///         (`x_cam = R x_rig + t`), and the standard deviations of its rotation and position; (bytes, CameraPose)
    ///         when the pose on the rig is exact.
    ///     retrieve, use_prior, ransac_opt, bundle_opt, position: as for `localize`.
    ///
    /// Returns:
    ///     An answer with the pose of the rig, and the poses of the cameras in `frames`.
    ///
    /// Raises:
    ///     NotLocalizedError, WrongProfileError, QueryError: as for `localize`.
    ///     InputError: `frames` is empty or invalid.
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
        let found = interruptible(py, &options.pose.stop, || localize_rig(&frames, &self.file, &options))??;
        Ok(Answer::of_rig(&found, &self.file))
    }

    /// The profile of the map; a device needs it to seal queries.
    #[getter]
    fn profile(&self) -> Profile {
        Profile(self.file.profile().clone())
    }

    /// The pack of the map: what its points look like, image by image, without positions. The same map gives the same pack.
    ///
    /// Raises:
    ///     QueryError: the map has no points, or more than a pack can have; give the pack of a region then.
    fn pack(&self, py: Python<'_>) -> Result<Pack> {
        let (pack, _) = py.detach(|| self.file.pack())?;
        Ok(pack.into())
    }

    /// Names of the map's images.
    #[getter]
    fn image_names(&self) -> Vec<String> {
        self.file.images().map(|image| image.name().to_owned()).collect()
    }

    /// Poses of the map's images, by name.
    #[getter]
    fn poses(&self) -> std::collections::BTreeMap<String, CameraPose> {
        let pose =
            |image: veiloc_map::ImageView<'_>| (image.name().to_owned(), CameraPose(*image.cam_from_world()));
        self.file.images().map(pose).collect()
    }

    /// The map's points, `[N, 3]`, map units.
    #[getter]
    fn points<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        arrays::matrix(
            py,
            (0..self.file.point_count()).map(|i| self.file.point(PointId(i as u32)).coords.into()),
        )
    }

    /// Cameras of the map's images, by name. Of a map from images without poses they are the estimated ones: seal queries of
    /// the same camera with them.
    #[getter]
    fn cameras<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let cameras = PyDict::new(py);
        for image in self.file.images() {
            cameras.set_item(image.name(), dictionary(py, image.camera())?)?;
        }
        Ok(cameras)
    }

    /// Whether map units are metres; False when it is not known.
    #[getter]
    fn is_metric(&self) -> bool {
        self.file.is_metric()
    }

    /// The down direction, `[3]`; None when it is not known.
    #[getter]
    fn down(&self) -> Option<[f64; 3]> {
        self.file.down().map(|down| down.in_world())
    }

    /// Warnings from when the map was built or changed.
    #[getter]
    fn warnings(&self) -> Vec<String> {
        self.warnings.iter().map(ToString::to_string).chain(self.remarks.iter().cloned()).collect()
    }

    /// Top view of the map for notebooks: its points and the cameras of its images.
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

/// Sealed queries and the pose of each camera on the rig.
pub(crate) fn frames_of(frames: &Bound<'_, PyAny>) -> Result<Vec<SealedFrame>> {
    let refused = || {
        BindingError::input(
            "frames: must be a list of at least one (bytes, CameraPose) or (bytes, CameraPose, degrees, map units)",
        )
    };
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
            query: query_of(&bytes)?,
            cam_from_rig: CameraFromRig::new(*on_rig.rotation(), *on_rig.translation()),
            rotation_sd_deg,
            translation_sd,
        })
    };
    let all: Vec<SealedFrame> =
        frames.try_iter().map_err(|_| refused())?.map(frame).collect::<Result<_>>()?;
    if all.is_empty() { Err(refused()) } else { Ok(all) }
}

fn self_test_dict<'py>(py: Python<'py>, test: &SelfTest) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
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
        dict.set_item(scheme.scheme.name(), entry)?;
    }
    Ok(dict)
}
