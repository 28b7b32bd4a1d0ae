//! Options of an evaluation on a scene with known poses.

use std::collections::BTreeMap;
use std::path::PathBuf;

use veiloc_geometry::Intrinsics;
use veiloc_localization::LocalizeOptions;
use veiloc_map::PosedImages;
use veiloc_map::regions::SplitOptions;
use veiloc_mapping::{BuildOptions, Input, OnOtherFrame, image_file, mask_file};
use veiloc_protocol::Scheme;

use crate::error::EvalError;
use crate::pipeline::{EvaluatedQuery, GravityNoise, PosedQuery, QueryTransmission, queries_of_scene};
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
    pub on_other_frame: OnOtherFrame,
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
    /// Standard deviation of an accelerometer, degrees: the map gets a down direction, and every query is sealed
    /// without and with gravity. `None`: no gravity.
    pub gravity: Option<GravityNoise>,
    /// Folder of the queries' masks ([`veiloc_mapping::mask_file`]): masked keypoints are not sent. `None`: no masks.
    pub masks: Option<PathBuf>,
    /// How queries are sent.
    pub transmission: QueryTransmission,
    /// Queries of another scene, which must not be localized.
    pub negatives: Option<NegativeQueryImages>,
    /// Seed of sealing and sampling.
    pub seed: u64,
    /// Folder for intermediate results: the map, and the result of each query as soon as it is finished. An
    /// evaluation of the same images with the same options reuses them, also after an interruption. `None`: nothing
    /// is stored.
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
            on_other_frame: OnOtherFrame::Refuse,
            compress: None,
            regions: None,
            schemes: vec![Scheme::default()],
            estimators: vec![Estimator::default()],
            thresholds: Vec::new(),
            gravity: None,
            masks: None,
            transmission: QueryTransmission::Whole,
            negatives: None,
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
        Input::new(&self.posed, &self.images).with_names(names).on_other_frame(self.on_other_frame)
    }

    /// The mask of a query, if queries have masks.
    pub(crate) fn mask_of(&self, name: &str) -> Option<PathBuf> {
        self.masks.as_deref().map(|folder| mask_file(folder, name))
    }

    /// The queries without known poses.
    pub(super) fn unposed(&self) -> impl Iterator<Item = EvaluatedQuery> {
        self.unposed.iter().map(|(name, camera)| EvaluatedQuery {
            name: name.clone(),
            path: image_file(&self.images, name),
            camera: *camera,
            truth: None,
        })
    }
}

/// Queries of another scene.
#[derive(Debug, Clone)]
pub struct NegativeQueryImages {
    /// Images of the other scene; only their cameras are used.
    pub posed: PosedImages,
    /// Folder of its images.
    pub images: PathBuf,
    /// Names of the query images.
    pub list: Vec<String>,
}
