//! `veiloc demo`: a place that renders itself, and everything that is done with a real one.
//!
//! The renderer writes images and a posed COLMAP model to a folder. From there on nothing knows that the place
//! is not real: the map is built from the files, queries are sealed, sent as bytes and localized by the code that
//! `veiloc eval scene` runs, and the attack works on what was sent.

mod attack;
mod error;
mod options;
mod page;
mod place;
mod views;

use std::path::PathBuf;

use serde::Serialize;
use veiloc_map::MapFile;
use veiloc_map::colmap::read_posed;

use veiloc_evaluation::audit::AttackDocument;
use veiloc_evaluation::results::Evaluation;
use veiloc_evaluation::results::metrics::Threshold;
use veiloc_evaluation::{SceneEvaluation, evaluate_scene};
use veiloc_features::Progress;

pub(crate) use error::DemoError;
pub(crate) use options::DemoOptions;
pub(crate) use views::{HiddenViews, map_place};

/// The document of `veiloc demo --json`.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct DemoDocument {
    /// Localization of the hidden views.
    pub evaluation: Evaluation,
    /// What attacks recovered: the graph attack and several seals on the views that the report draws, others on all hidden
    /// views.
    pub attacks: AttackDocument,
}

/// What the demo found, and where its report is.
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
/// [`DemoError`] when a file cannot be written, or the place could not be mapped.
pub(crate) fn run_demo(options: &DemoOptions, progress: &dyn Progress) -> Result<Demo, DemoError> {
    let place = place::render(options, progress)?;
    let evaluation = SceneEvaluation {
        keep_map: Some(options.out.join("place.vmap")),
        schemes: options.schemes.clone(),
        thresholds: vec![
            Threshold { translation: 0.05, rotation_deg: 5.0 },
            Threshold { translation: 0.02, rotation_deg: 1.0 },
        ],
        seed: options.seed,
        ..SceneEvaluation::of_place(
            read_posed(&place.posed)?,
            place.images.clone(),
            place.map_list.clone(),
            place.query_list.clone(),
        )
    };
    let result = evaluate_scene(&evaluation, progress)?;
    let map = MapFile::open(&options.out.join("place.vmap"))?;
    let attacked = attack::attack_all(&place, &map, options, progress)?;
    let found = page::Found {
        place: &place,
        map: &map,
        asked: &evaluation,
        evaluation: &result,
        attacked: &attacked,
    };
    let page = page::page(&found, options, progress)?;
    let report = options.out.join("report.html");
    std::fs::write(&report, veiloc_report::demo_page(&page))
        .map_err(|source| DemoError::Io { path: report.clone(), source })?;
    let document = DemoDocument { evaluation: result, attacks: attacked.document };
    Ok(Demo { document, report })
}
