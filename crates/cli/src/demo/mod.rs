//! `veiloc demo`: the whole pipeline on a rendered scene.
//!
//! The renderer writes images and a posed COLMAP model to a folder. Everything after it is the pipeline of a real
//! scene: the map is built from the files, queries are sealed, sent as bytes and localized by the code of `veiloc eval
//! scene`, and the attacks use the sent queries.

mod attack;
mod error;
mod options;
mod page;
mod scene;
mod views;

use std::path::PathBuf;

use serde::Serialize;
use veiloc_map::MapFile;
use veiloc_map::colmap::read_posed;

use veiloc_evaluation::attack_evaluation::AttackDocument;
use veiloc_evaluation::results::EvaluationDocument;
use veiloc_evaluation::results::metrics::Threshold;
use veiloc_evaluation::{SceneEvaluation, evaluate_scene};
use veiloc_features::Progress;

pub(crate) use error::DemoError;
pub(crate) use options::DemoOptions;
pub(crate) use views::{HiddenViews, map_scene};

/// Localization of the hidden views, and attacks on them.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub(crate) struct DemoDocument {
    /// Localization of the hidden views.
    pub evaluation: EvaluationDocument,
    /// Results of the attacks: graph attack and several sealed queries on the view that the report draws, other
    /// attacks on all hidden views.
    pub attacks: AttackDocument,
}

/// Results of the demo, and the path of its report.
#[derive(Debug)]
pub(crate) struct Demo {
    /// All figures.
    pub document: DemoDocument,
    /// The report, one HTML file.
    pub report: PathBuf,
}

/// Runs the demo.
///
/// # Errors
/// [`DemoError`] if a file cannot be written, or the scene could not be mapped.
pub(crate) fn run_demo(options: &DemoOptions, progress: &dyn Progress) -> Result<Demo, DemoError> {
    let scene = scene::render(options, progress)?;
    let evaluation = SceneEvaluation {
        keep_map: Some(options.out.join("place.vmap")),
        schemes: options.schemes.clone(),
        thresholds: vec![
            Threshold { translation: 0.05, rotation_deg: 5.0 },
            Threshold { translation: 0.02, rotation_deg: 1.0 },
        ],
        seed: options.seed,
        ..SceneEvaluation::of_scene(
            read_posed(&scene.posed)?,
            scene.images.clone(),
            scene.map_list.clone(),
            scene.query_list.clone(),
        )
    };
    let result = evaluate_scene(&evaluation, progress)?;
    let map = MapFile::open(&options.out.join("place.vmap"))?;
    let attacked = attack::attack_all(&scene, &map, options, progress)?;
    let results = page::DemoResults {
        scene: &scene,
        map: &map,
        scene_evaluation: &evaluation,
        evaluation: &result,
        attacked: &attacked,
    };
    let page = page::page(&results, options, progress)?;
    let report = options.out.join("report.html");
    std::fs::write(&report, veiloc_evaluation::report::demo_page(&page))
        .map_err(|source| DemoError::Io { path: report.clone(), source })?;
    let document = DemoDocument { evaluation: result, attacks: attacked.document };
    Ok(Demo { document, report })
}
