//! Options of an evaluation on a scene with known poses.

use std::collections::BTreeMap;
use std::path::PathBuf;

use veiloc_features::FeatureError;
use veiloc_geometry::Intrinsics;
use veiloc_localization::LocalizeOptions;
use veiloc_map::PosedImages;
use veiloc_map::regions::SplitOptions;
use veiloc_mapping::{BuildOptions, Input, OnOtherCoordinateFrame, image_file, mask_file};
use veiloc_obfuscation::audit::options_for;
use veiloc_obfuscation::{KnownCamera, PackUse, SealError, SealOptions, Sealer};
use veiloc_pose::ScoreKind;
use veiloc_protocol::{FocalKnowledge, Profile, Scheme};

use super::condition::Condition;
use super::retrieved::RetrievedImages;
use crate::error::EvalError;
use crate::pipeline::{EvaluatedQuery, PosedQuery, QueryTransmission, queries_of_scene};
use crate::pose::Estimator;
use crate::results::metrics::Threshold;

/// Inputs and options.
#[derive(Debug, Clone)]
pub struct SceneEvaluation {
    /// Cameras and poses of the scene's images, from any data set layout.
    pub posed: PosedImages,
    /// Folder of the images.
    pub images: PathBuf,
    /// Names of the images the map is built from.
    pub map_list: Vec<String>,
    /// Names of the images to localize.
    pub query_list: Vec<String>,
    /// Better cameras of queries by name; the model's cameras are used for the others.
    pub query_cameras: BTreeMap<String, Intrinsics>,
    /// Queries without known poses, after the others: they are localized, but errors are not measured.
    pub unposed: Vec<(String, Intrinsics)>,
    /// Where to write the map; `None`: a temporary file.
    pub keep_map: Option<PathBuf>,
    /// How the map is built.
    pub build: BuildOptions,
    /// Treatment of map images whose poses are in another frame than the rest.
    pub on_other_coordinate_frame: OnOtherCoordinateFrame,
    /// Factor by which the map is compressed; `None`: not compressed.
    pub compress: Option<f64>,
    /// How the map is split into regions; each query is then localized in up to three of them, as by a gateway.
    /// `None`: not split.
    pub regions: Option<SplitOptions>,
    /// Schemes, in the order of the table.
    pub schemes: Vec<Scheme>,
    /// Estimators, in the order of the table; at least one.
    pub estimators: Vec<Estimator>,
    /// Thresholds of the recall columns.
    pub thresholds: Vec<Threshold>,
    /// Conditions of the queries, in the order of the table.
    pub conditions: Vec<Condition>,
    /// Whether each condition also has rows of estimates that start from the true pose: the estimator's own optimum, and
    /// least squares on the true matches. The largest reprojection error of a true match, pixels; `None`: no such rows.
    pub from_truth: Option<f64>,
    /// Odometry of images that are localized together.
    pub odometry: Odometry,
    /// Folder of the queries' masks ([`veiloc_mapping::mask_file`]): masked keypoints are not sent. `None`: no masks.
    pub masks: Option<PathBuf>,
    /// Map images that another program retrieved for each query. `None`: the map's own retrieval.
    pub retrieved: Option<RetrievedImages>,
    /// How queries are sent.
    pub transmission: QueryTransmission,
    /// Out-of-map images of the condition `negatives`, which must not be localized.
    pub negatives: Vec<NegativeImage>,
    /// A map that is used as it is, if all queries are out-of-map images; `None`: the map is built.
    pub map: Option<PathBuf>,
    /// Seed of sealing and sampling.
    pub seed: u64,
    /// Folder for intermediate results: the map, and the result of each query as soon as it is finished. An
    /// evaluation of the same images with the same options reuses them, also after an interruption. Results of images
    /// that are localized together are not stored. `None`: nothing is stored.
    pub work: Option<PathBuf>,
    /// Queries that are localized in parallel, at least 1. With more than one, times are those of a busy machine.
    pub jobs: usize,
}

impl SceneEvaluation {
    /// The default scheme on a scene: images in `images`, split into map and queries; all other options have their
    /// defaults, without thresholds.
    pub fn of_scene(
        posed: PosedImages,
        images: PathBuf,
        map_list: Vec<String>,
        query_list: Vec<String>,
    ) -> Self {
        Self {
            posed,
            images,
            map_list,
            query_list,
            query_cameras: BTreeMap::new(),
            unposed: Vec::new(),
            keep_map: None,
            build: BuildOptions::default(),
            on_other_coordinate_frame: OnOtherCoordinateFrame::Refuse,
            compress: None,
            regions: None,
            schemes: vec![Scheme::default()],
            estimators: vec![Estimator::default()],
            thresholds: Vec::new(),
            conditions: vec![Condition::NONE],
            from_truth: None,
            odometry: Odometry::default(),
            masks: None,
            retrieved: None,
            transmission: QueryTransmission::Whole,
            negatives: Vec::new(),
            map: None,
            seed: 0,
            work: None,
            jobs: 1,
        }
    }

    /// Localization by the first estimator.
    pub(crate) fn localize(&self) -> &LocalizeOptions {
        &self.estimators[0].localize
    }

    /// The queries with known poses; refused if one of them is in the map.
    pub(crate) fn queries(&self) -> Result<Vec<PosedQuery>, EvalError> {
        queries_of_scene(&self.posed, &self.images, &self.map_list, &self.query_list, &self.query_cameras)
    }

    /// The input of a map of these images.
    pub(crate) fn map_input<'a>(&'a self, names: &'a [String]) -> Input<'a> {
        Input::new(&self.posed, &self.images)
            .with_names(names)
            .on_other_coordinate_frame(self.on_other_coordinate_frame)
    }

    /// The mask of a query, if queries have masks.
    pub(crate) fn mask_of(&self, name: &str) -> Option<PathBuf> {
        self.masks.as_deref().map(|folder| mask_file(folder, name))
    }

    /// The queries: those with known poses, which must not be in the map, then the others.
    pub(super) fn all_queries(&self) -> Result<Vec<EvaluatedQuery>, EvalError> {
        let unposed = self.unposed.iter().map(|(name, camera)| EvaluatedQuery {
            name: name.clone(),
            path: image_file(&self.images, name),
            camera: *camera,
            focal: FocalKnowledge::Calibrated,
            truth: None,
        });
        Ok(self.queries()?.into_iter().map(EvaluatedQuery::from).chain(unposed).collect())
    }

    /// The options with which a device seals under a scheme.
    ///
    /// They have the extractors of the map, and the extractor of global image descriptors if the map uses them (the
    /// owner's consent is implied).
    pub(super) fn seal_options(&self, scheme: Scheme) -> SealOptions {
        let options = options_for(scheme).with_extractors(self.build.extractors.sealing());
        match &self.build.global {
            Some(global) => options.with_image_global(global.clone()),
            None => options,
        }
    }

    /// A device that seals under a scheme.
    pub(crate) fn sealer(&self, profile: &Profile, scheme: Scheme) -> Result<Sealer, SealError> {
        Sealer::new(profile, self.seal_options(scheme))
    }

    /// Refuses options that exclude each other, before anything is computed.
    pub(super) fn check(&self) -> Result<(), EvalError> {
        let refuse = |what: &str| Err(EvalError::Options(what.to_owned()));
        let any = |of: fn(&Condition) -> bool| self.conditions.iter().any(of);
        if self.schemes.is_empty() || self.conditions.is_empty() {
            return refuse("no scheme or condition to evaluate");
        }
        if (1..self.conditions.len()).any(|at| self.conditions[..at].contains(&self.conditions[at])) {
            return refuse("a condition occurs twice; give each once");
        }
        if any(|condition| condition.negatives) == self.negatives.is_empty() {
            return refuse("out-of-map images are given with a condition `negatives`, and only with it");
        }
        if self.map.is_some() && any(|condition| !condition.negatives || condition.sparse_map) {
            return refuse("a map that is built already has only the condition `negatives`");
        }
        let is_served_whole = self.regions.is_none() && self.transmission == QueryTransmission::Whole;
        let retrieves = |condition: &Condition| {
            condition.negatives || condition.frames.is_some() || condition.pack == Some(PackUse::Matches)
        };
        if self.retrieved.is_some() && (!is_served_whole || any(retrieves)) {
            return refuse(
                "a list of pairs is for queries that are sent whole to a whole map, one by one, with descriptors",
            );
        }
        if !any(|condition| condition.frames.is_some()) {
            return Ok(());
        }
        if self.estimators.len() > 1 || self.estimators[0].score() != ScoreKind::Likelihood {
            return refuse("images together are localized by one estimator, which uses the likelihood");
        }
        if !is_served_whole {
            return refuse("images together are localized in one map, and sent whole");
        }
        let Odometry { rotation_sd_deg, translation_sd, max_distance } = self.odometry;
        if ![rotation_sd_deg, translation_sd, max_distance]
            .iter()
            .all(|value| value.is_finite() && *value >= 0.0)
        {
            return refuse("noise and distances of odometry must not be below 0");
        }
        Ok(())
    }
}

/// Simulated odometry of a device, and where its trajectories end.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Odometry {
    /// Standard deviation of the rotation about each axis per step, degrees.
    pub rotation_sd_deg: f64,
    /// Standard deviation of the translation along each axis per step, map units.
    pub translation_sd: f64,
    /// Images farther apart than this belong to different trajectories, map units.
    pub max_distance: f64,
}

impl Default for Odometry {
    /// A phone's in metres: 0.1° and 1 cm a step.
    fn default() -> Self {
        Self { rotation_sd_deg: 0.1, translation_sd: 0.01, max_distance: 0.5 }
    }
}

/// An out-of-map image.
#[derive(Debug, Clone)]
pub struct NegativeImage {
    /// Name in the results.
    pub name: String,
    /// Its file.
    pub path: PathBuf,
    /// Its camera, if known; otherwise that of its EXIF metadata, or an assumed one, which the query says.
    pub camera: Option<Intrinsics>,
}

impl NegativeImage {
    /// The query. An unknown camera cannot make its pose worse, since no pose is right.
    pub(super) fn query(&self) -> Result<EvaluatedQuery, EvalError> {
        let known = match self.camera {
            Some(camera) => KnownCamera::calibrated(camera),
            None => match KnownCamera::from_exif(&self.path) {
                Err(FeatureError::NoFocal { .. }) => KnownCamera::guessed(&self.path)?,
                other => other?,
            },
        };
        let KnownCamera { intrinsics: camera, focal } = known;
        Ok(EvaluatedQuery { name: self.name.clone(), path: self.path.clone(), camera, focal, truth: None })
    }
}
