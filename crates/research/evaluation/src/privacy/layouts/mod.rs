//! `veiloc eval layouts`: layouts of dcl, evaluated by their pose errors relative to points and by the attackers'
//! gain.
//!
//! A layout ([`DclLayout`]) defines the anchors and the anchor of each keypoint. Poses come from the whole pipeline,
//! also under difficult conditions; attacks are those of the audit, on the same queries
//! ([`Adversary`](crate::privacy::adversaries::Adversary)).

mod accuracy;
mod document;
mod options;
mod privacy;
mod table;

use std::collections::BTreeMap;

use crate::EvalError;
use crate::ProblemSource;
use crate::stress::{StressQuery, evaluate_stress};
use veiloc_features::Progress;
use veiloc_protocol::{DclLayout, Scheme};

use crate::privacy::adversaries::AttackedKeypoints;
use accuracy::Accuracy;
use privacy::Privacy;

pub use accuracy::ConditionFigures;
pub use document::{LayoutRow, LayoutsDocument, TOLERANCE_BITS};
pub use options::LayoutsEvaluation;
pub use privacy::AdversaryFigures;
pub use table::layouts_table;

/// Evaluates every layout.
///
/// # Errors
/// [`EvalError`] when data is missing, a map cannot be built, or the options select nothing. A query that is not
/// localized is a result, not an error.
pub fn evaluate_layouts(
    evaluation: &LayoutsEvaluation,
    progress: &dyn Progress,
) -> Result<LayoutsDocument, EvalError> {
    evaluation.check()?;
    let stress = &evaluation.stress;
    let source = ProblemSource {
        posed: &stress.posed,
        images: &stress.images,
        map_list: &stress.map_list,
        query_list: &stress.query_list,
        build: &stress.build,
        on_other_frame: stress.on_other_frame,
        localize: &stress.localize,
        masks: &BTreeMap::new(),
        seed: stress.seed,
    };
    let keypoints = AttackedKeypoints::of_scene(&source, evaluation.attacked, progress)?;
    let mut stressed = StressedQueries { scene: String::new(), queries: Vec::new() };
    for seed in evaluation.seeds() {
        let mut stress = evaluation.stress.clone();
        stress.schemes = std::iter::once(Scheme::Points)
            .chain(evaluation.layouts.iter().copied().map(Scheme::Dcl))
            .collect();
        stress.seed = seed;
        let found = evaluate_stress(&stress, progress)?;
        stressed.scene = found.data;
        stressed.queries.extend(found.queries);
    }
    let accuracy = |layout: &DclLayout| Accuracy::of(&stressed.queries, Scheme::Dcl(*layout));
    let privacy = Privacy::of(evaluation, &keypoints, progress)?;
    let rows = evaluation.layouts.iter().map(|layout| LayoutRow::of(*layout, accuracy(layout), &privacy));
    let mut document = LayoutsDocument {
        version: 1,
        command: "eval layouts",
        data: stressed.scene,
        queries: evaluation.stress.query_list.len(),
        attacked: keypoints.attacked.len(),
        map_images: keypoints.scene.as_ref().map_or(0, |scene| scene.map.len()),
        k: evaluation.k,
        seed: evaluation.stress.seed,
        seeds: evaluation.seeds,
        rows: rows.collect(),
    };
    document.compare();
    Ok(document)
}

/// All queries under all conditions, layouts and seeds.
struct StressedQueries {
    scene: String,
    queries: Vec<StressQuery>,
}

/// Name of a layout in documents: the paper's layout has a fixed name, even while it is the default.
fn name(layout: DclLayout) -> String {
    if layout == DclLayout::VERTICAL { PAPER.to_owned() } else { Scheme::Dcl(layout).to_string() }
}

/// The paper's layout.
const PAPER: &str = "dcl:paper";
