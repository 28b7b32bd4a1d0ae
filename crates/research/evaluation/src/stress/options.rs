//! Options of an evaluation under stress.

use std::collections::BTreeMap;
use std::path::PathBuf;

use veiloc_geometry::Intrinsics;
use veiloc_localization::LocalizeOptions;
use veiloc_map::PosedImages;
use veiloc_mapping::{BuildOptions, OnOtherFrame};
use veiloc_protocol::Scheme;

use super::condition::StressCondition;
use crate::pipeline::GravityNoise;
use crate::pose::ORACLE_RADIUS_PX;
use crate::results::metrics::Threshold;

/// Inputs and options: every stress with every scheme.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct StressEvaluation {
    /// Cameras and poses of the scene's images.
    pub posed: PosedImages,
    /// Folder of the images.
    pub images: PathBuf,
    /// Names of the images the map is built from.
    pub map_list: Vec<String>,
    /// Names of the images to localize.
    pub query_list: Vec<String>,
    /// Better cameras of queries by name.
    pub query_cameras: BTreeMap<String, Intrinsics>,
    /// How the maps are built.
    pub build: BuildOptions,
    /// Treatment of map images whose poses are in another frame than the rest.
    pub on_other_frame: OnOtherFrame,
    /// Schemes, in the order of the table.
    pub schemes: Vec<Scheme>,
    /// Conditions, in the order of the table; [`StressCondition::None`] always comes first.
    pub stresses: Vec<StressCondition>,
    /// Thresholds of the recall columns.
    pub thresholds: Vec<Threshold>,
    /// A pose beyond either bound is wrong, and must not be trusted.
    pub wrong_threshold: Threshold,
    /// Localization.
    pub localize: LocalizeOptions,
    /// As [`SceneEvaluation::gravity`](crate::SceneEvaluation::gravity).
    pub gravity: Option<GravityNoise>,
    /// Whether to optimize from the true pose as well, to find the losses of the search
    /// ([`TruthStartErrors`](super::TruthStartErrors)).
    pub from_truth: bool,
    /// For [`Self::from_truth`]: largest reprojection error of a true match under the true pose, pixels.
    pub oracle_radius_px: f64,
    /// Seed of degradation, sealing and sampling.
    pub seed: u64,
}

impl StressEvaluation {
    /// All conditions with the paper's schemes; 5 cm and 5°, 25 cm and 2°.
    pub fn new(posed: PosedImages, images: PathBuf, map_list: Vec<String>, query_list: Vec<String>) -> Self {
        let coarse = Threshold { translation: 0.25, rotation_deg: 2.0 };
        Self {
            posed,
            images,
            map_list,
            query_list,
            query_cameras: BTreeMap::new(),
            build: BuildOptions::default(),
            on_other_frame: OnOtherFrame::Refuse,
            schemes: vec![Scheme::Points, Scheme::RandomLines, Scheme::default()],
            stresses: StressCondition::DEFAULT.to_vec(),
            thresholds: vec![Threshold { translation: 0.05, rotation_deg: 5.0 }, coarse],
            wrong_threshold: coarse,
            localize: LocalizeOptions::default(),
            gravity: None,
            from_truth: false,
            oracle_radius_px: ORACLE_RADIUS_PX,
            seed: 0,
        }
    }

    /// Each condition once, [`StressCondition::None`] first.
    pub(super) fn ordered(&self) -> Vec<StressCondition> {
        let mut ordered = vec![StressCondition::None];
        for stress in &self.stresses {
            if !ordered.contains(stress) {
                ordered.push(*stress);
            }
        }
        ordered
    }
}
