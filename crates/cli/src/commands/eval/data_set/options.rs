//! The options of `veiloc eval dataset`; those of a single data set begin with its name.

use std::path::PathBuf;

use veiloc_datasets::MissingImages;
use veiloc_evaluation::pose::Estimator;
use veiloc_evaluation::results::metrics::Threshold;
use veiloc_geometry::Intrinsics;
use veiloc_protocol::{DclLayout, Scheme};

use super::adversaries::AttackArgs;
use crate::args::extraction_args::ExtractionArgs;
use crate::args::json_args::JsonArgs;
use crate::args::localization_args::EstimatorArgs;
use crate::commands::eval::html::HtmlArgs;
use crate::commands::eval::pairs::PairsArgs;
use crate::output::exit::Failure;
use crate::output::targets::{OutFile, OutFolder};

/// A published data set.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(super) enum DataSet {
    /// 7Scenes: `<scene>/TrainSplit.txt`, `<scene>/seq-01/frame-000000.color.png`; the map is built from the training
    /// sequences, the images of the test sequences are queries.
    #[value(name = "7scenes")]
    SevenScenes,
    /// Cambridge Landmarks: the map is built from `dataset_train.txt` of each scene, the images of `dataset_test.txt`
    /// are queries; cameras come from `reconstruction.nvm`.
    Cambridge,
    /// Aachen Day-Night v1, the paper's: the poses of its queries are not published, `--submission` writes the files
    /// that `https://www.visuallocalization.net` evaluates.
    Aachen,
    /// Aachen Day-Night v1.1, with more images and other reference poses.
    #[value(name = "aachen-v1.1")]
    AachenV1_1,
}

impl DataSet {
    /// The name on the command line.
    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::SevenScenes => "7scenes",
            Self::Cambridge => "cambridge",
            Self::Aachen => "aachen",
            Self::AachenV1_1 => "aachen-v1.1",
        }
    }

    /// The command in documents.
    pub(super) const fn command(self) -> &'static str {
        match self {
            Self::SevenScenes => "eval dataset 7scenes",
            Self::Cambridge => "eval dataset cambridge",
            Self::Aachen => "eval dataset aachen",
            Self::AachenV1_1 => "eval dataset aachen-v1.1",
        }
    }

    /// Recall thresholds of the paper, metres and degrees.
    const fn thresholds(self) -> &'static [(f64, f64)] {
        match self {
            Self::SevenScenes => &[(0.05, 5.0)],
            Self::Cambridge => &[(0.25, 2.0), (0.5, 5.0)],
            Self::Aachen | Self::AachenV1_1 => &[(0.25, 2.0), (0.5, 5.0), (5.0, 10.0)],
        }
    }

    /// The paper's inlier threshold for points, pixels.
    const fn paper_max_error_px(self) -> f64 {
        match self {
            Self::SevenScenes => 4.0,
            Self::Cambridge => 18.0,
            Self::Aachen | Self::AachenV1_1 => 8.0,
        }
    }

    /// Retrieved images per query, as in hloc and the paper.
    const fn retrieve(self) -> usize {
        match self {
            Self::SevenScenes | Self::Cambridge => 10,
            Self::Aachen | Self::AachenV1_1 => 50,
        }
    }
}

/// Ground truth of 7Scenes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(super) enum PoseKind {
    /// The pseudo ground truth from structure from motion, as in the paper.
    Sfm,
    /// The poses of the depth camera that come with the images.
    Depth,
}

/// Evaluate the scenes of a published data set, from its unpacked folders.
///
/// Builds the map of each scene, seals every query image under every scheme, localizes it, and compares with its known
/// pose. `python3 research/study paper` prints the results beside the paper's. With `--estimator paper`, or a file based
/// on it without `max-error-px`, points have the paper's inlier threshold for the data set (4 pixels for 7Scenes, 18 for
/// Cambridge, 8 for Aachen), and `dcl` the paper's halves. As in hloc, a query is matched with 10 map images, in Aachen
/// with 50; `--pairs` takes those that another program retrieved.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// The data set.
    #[arg(value_enum, value_name = "DATA_SET")]
    pub(super) data_set: DataSet,
    /// Folder of the data set.
    #[arg(long, value_name = "DIR")]
    pub(super) root: PathBuf,
    /// 7scenes, cambridge: scenes to evaluate. Default: all that exist.
    #[arg(long, value_delimiter = ',', value_name = "SCENE,…")]
    pub(super) scenes: Vec<String>,
    /// 7scenes, cambridge: scenes to leave out. Default: of Cambridge those that the paper leaves out for their many
    /// geometric outliers; an empty text leaves out none.
    #[arg(long, value_delimiter = ',', value_name = "SCENE,…")]
    pub(super) exclude: Option<Vec<String>>,
    /// 7scenes: ground truth. Default: sfm.
    #[arg(long, value_enum, value_name = "KIND")]
    pub(super) poses: Option<PoseKind>,
    /// 7scenes: folder of the lists of pseudo ground truth, `<scene>_train.txt` and `<scene>_test.txt`. Default: `pgt_sfm`
    /// or `pgt/sfm/7scenes` in the root.
    #[arg(long, value_name = "DIR")]
    pub(super) pseudo_ground_truth: Option<PathBuf>,
    /// cambridge: one camera for all images, MODEL,WIDTH,HEIGHT,PARAMS…. Default: the cameras of `reconstruction.nvm`.
    #[arg(long, value_name = "CAMERA")]
    pub(super) camera: Option<Intrinsics>,
    /// aachen: query conditions, named as their lists. Default: day and night.
    #[arg(long, value_delimiter = ',', value_name = "CONDITION,…")]
    pub(super) conditions: Option<Vec<String>>,
    /// aachen: true poses of the queries, `name qw qx qy qz tx ty tz` per line, world to camera, for copies of the data
    /// set with known poses. Default: no errors are computed.
    #[arg(long, value_name = "FILE")]
    pub(super) truth: Option<PathBuf>,
    /// aachen: write the poses for visuallocalization.net, `name qw qx qy qz tx ty tz` per line, with file names without
    /// folders; with several schemes one file per scheme, with the scheme appended to the name.
    #[arg(long, value_name = "FILE")]
    pub(super) submission: Option<OutFile>,
    /// Evaluate the existing images if some are missing. Figures are then not compared with published ones. Default:
    /// missing images are an error.
    #[arg(long)]
    available_only: bool,
    /// Schemes to compare; `dcl:s=2`, `dcl:s=3` and `dcl:horizontal` are those of the paper's ablations.
    #[arg(long, value_delimiter = ',', default_value = "points,random-lines,dcl", value_name = "SCHEME,…")]
    schemes: Vec<Scheme>,
    /// Thresholds of the recall columns, `translation/degrees` with the translation in map units. Default: the paper's
    /// thresholds for the data set.
    #[arg(long, value_delimiter = ',', value_name = "T/DEG,…")]
    thresholds: Vec<Threshold>,
    /// Folder for intermediate results: features and matches of map images, maps, and the result of each finished
    /// query. An interrupted run continues from there, and results for the same images and options are not computed
    /// again. Default: nothing is stored.
    #[arg(long, value_name = "DIR")]
    pub(super) work: Option<OutFolder>,
    /// Queries that are localized in parallel. Default: one per core; times are then those of a loaded machine. Use 1
    /// to report times.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    jobs: Option<u16>,
    #[command(flatten)]
    extraction: ExtractionArgs,
    #[command(flatten)]
    pub(super) pairs: PairsArgs,
    #[command(flatten)]
    pub(super) estimator: EstimatorArgs,
    #[command(flatten)]
    pub(super) attack: AttackArgs,
    #[command(flatten)]
    pub(super) html: HtmlArgs,
    #[command(flatten)]
    pub(super) json: JsonArgs,
}

impl Args {
    /// An option that was given and belongs to another data set.
    pub(super) fn of_another_data_set(&self) -> Option<&'static str> {
        use DataSet::{Aachen, AachenV1_1, Cambridge, SevenScenes};
        let given: [(&str, bool, &[DataSet]); 8] = [
            ("scenes", !self.scenes.is_empty(), &[SevenScenes, Cambridge]),
            ("exclude", self.exclude.is_some(), &[SevenScenes, Cambridge]),
            ("poses", self.poses.is_some(), &[SevenScenes]),
            ("pseudo-ground-truth", self.pseudo_ground_truth.is_some(), &[SevenScenes]),
            ("camera", self.camera.is_some(), &[Cambridge]),
            ("conditions", self.conditions.is_some(), &[Aachen, AachenV1_1]),
            ("truth", self.truth.is_some(), &[Aachen, AachenV1_1]),
            ("submission", self.submission.is_some(), &[Aachen, AachenV1_1]),
        ];
        let wrong = given.into_iter().find(|(_, is_given, of)| *is_given && !of.contains(&self.data_set));
        wrong.map(|(name, ..)| name)
    }

    /// The estimator and the schemes; as published it has the paper's inlier threshold for the data set, and `dcl` the
    /// paper's layout.
    pub(super) fn estimator(&self) -> Result<(Estimator, Vec<Scheme>), Failure> {
        let (mut estimator, mut schemes) = (self.estimator.estimator()?, self.schemes.clone());
        if !estimator.names_retrieve {
            estimator.localize.retrieve = self.data_set.retrieve();
        }
        if estimator.as_published {
            estimator.localize.pose.max_error_px = self.data_set.paper_max_error_px();
            for scheme in schemes.iter_mut().filter(|scheme| **scheme == Scheme::default()) {
                *scheme = Scheme::Dcl(DclLayout::VERTICAL);
            }
        }
        Ok((estimator, schemes))
    }

    /// How missing images are handled.
    pub(super) const fn missing(&self) -> MissingImages {
        if self.available_only { MissingImages::LeaveOut } else { MissingImages::Refuse }
    }

    /// Returns the given thresholds, or the data set's.
    pub(super) fn thresholds(&self) -> Vec<Threshold> {
        if !self.thresholds.is_empty() {
            return self.thresholds.clone();
        }
        let of = |(translation, rotation_deg): &(f64, f64)| Threshold {
            translation: *translation,
            rotation_deg: *rotation_deg,
        };
        self.data_set.thresholds().iter().map(of).collect()
    }

    pub(super) fn jobs(&self) -> usize {
        self.jobs.map_or_else(cores, usize::from)
    }

    pub(super) fn build(&self) -> Result<veiloc_mapping::BuildOptions, Failure> {
        self.extraction.options()
    }
}

/// Returns the number of cores that this program may use.
pub(super) fn cores() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}
