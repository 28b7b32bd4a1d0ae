//! What is evaluated on a place with known poses.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use veiloc_features::mask_in;
use veiloc_geometry::Intrinsics;
use veiloc_localization::LocalizeOptions;
use veiloc_map::PosedImages;
use veiloc_map::regions::SplitOptions;
use veiloc_mapping::BuildOptions;
use veiloc_pose::ScoreKind;
use veiloc_protocol::Scheme;

use crate::results::metrics::Threshold;
use crate::road::{AskedQuery, Sending};

/// What to evaluate.
#[derive(Debug, Clone)]
pub struct SceneEvaluation {
    /// Cameras and poses of the place's images, whatever layout they were read from.
    pub posed: PosedImages,
    /// Folder of the images.
    pub images: PathBuf,
    /// Names of the images the map is built from.
    pub map_list: Vec<String>,
    /// Names of the images to localize.
    pub query_list: Vec<String>,
    /// Cameras of queries that are known better than the model's, by name; the model's are used for the others.
    pub query_cameras: BTreeMap<String, Intrinsics>,
    /// Queries whose true poses nobody knows, after the others: they are localized and not judged.
    pub unposed: Vec<(String, Intrinsics)>,
    /// Where to keep the map; a temporary file when none.
    pub keep_map: Option<PathBuf>,
    /// How the map is built.
    pub build: BuildOptions,
    /// How many times smaller the map is made than it is built; it stays as it is when none.
    pub compress: Option<f64>,
    /// How the map is cut into regions, of which each query is asked in up to three, as a gateway asks them; it stays whole when none.
    pub regions: Option<SplitOptions>,
    /// Schemes, in the order of the table.
    pub schemes: Vec<Scheme>,
    /// Scores, in the order of the table; empty for the default.
    pub scores: Vec<ScoreKind>,
    /// Thresholds of the recall columns.
    pub thresholds: Vec<Threshold>,
    /// Localization; its score is replaced by each of [`Self::scores`].
    pub localize: LocalizeOptions,
    /// Standard deviation of an accelerometer, degrees: the map is told which way is down, and every query is sealed without
    /// gravity and with it. Nothing is told when none.
    pub gravity_sd_deg: Option<f64>,
    /// Folder of the queries' masks ([`veiloc_features::mask_in`]): what they hide is not sent. Nothing is hidden when none.
    pub masks: Option<PathBuf>,
    /// How queries leave the device.
    pub sending: Sending,
    /// Queries of another place, none of which should be localized.
    pub negatives: Option<Negatives>,
    /// Seed of sealing and sampling.
    pub seed: u64,
    /// Folder for what is computed: the map, and the results of each query as soon as it is finished. An evaluation of the
    /// same images with the same options takes them from there, also one that was interrupted. Nothing is kept when none.
    pub work: Option<PathBuf>,
    /// Queries that are localized at the same time, at least 1. With more than one, times are those of a busy machine.
    pub jobs: usize,
}

impl SceneEvaluation {
    /// The default scheme on a place: images in `images`, of which some make the map and others ask; every other field as
    /// where nothing is asked for, without thresholds.
    pub fn of_place(
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
            compress: None,
            regions: None,
            schemes: vec![Scheme::default()],
            scores: Vec::new(),
            thresholds: Vec::new(),
            localize: LocalizeOptions::default(),
            gravity_sd_deg: None,
            masks: None,
            sending: Sending::Whole,
            negatives: None,
            seed: 0,
            work: None,
            jobs: 1,
        }
    }

    /// Where the mask of a query is, when queries have masks.
    pub(super) fn mask_of(&self, name: &str) -> Option<PathBuf> {
        self.masks.as_deref().map(|folder| mask_in(folder, Path::new(name)))
    }

    /// The queries that nobody judges.
    pub(super) fn unposed(&self) -> impl Iterator<Item = AskedQuery> {
        self.unposed.iter().map(|(name, camera)| AskedQuery {
            name: name.clone(),
            path: self.images.join(name),
            camera: *camera,
            truth: None,
        })
    }
}

/// Where queries of another place are.
#[derive(Debug, Clone)]
pub struct Negatives {
    /// Images of the other place; only their cameras are used.
    pub posed: PosedImages,
    /// Folder of its images.
    pub images: PathBuf,
    /// Names of the images that ask for their place.
    pub list: Vec<String>,
}
