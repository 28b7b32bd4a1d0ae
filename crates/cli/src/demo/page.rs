//! Fills the demo's report with the results.

use veiloc_evaluation::{DrawnQuery, SceneEvaluation, drawn_queries};
use veiloc_features::Progress;
use veiloc_map::MapFile;

use veiloc_evaluation::attack_evaluation::Attack;
use veiloc_evaluation::report::{DemoReport, DeviceQuery, add_scene, query_drawing};
use veiloc_evaluation::results::{EvaluationDocument, SchemeSummary};
use veiloc_report::{Card, LengthUnit, LocalizationReport, SceneView, worst_first};

use crate::demo::attack::AttackResults;
use crate::demo::error::DemoError;
use crate::demo::options::DemoOptions;
use crate::demo::scene::{RenderedScene, image};

/// Number of drawn queries, worst first, beside the one that shows the stages.
const DRAWN: usize = 5;

/// Content of the report.
pub(crate) struct DemoResults<'a> {
    pub(crate) scene: &'a RenderedScene,
    pub(crate) map: &'a MapFile,
    pub(crate) scene_evaluation: &'a SceneEvaluation,
    pub(crate) evaluation: &'a EvaluationDocument,
    pub(crate) attacked: &'a AttackResults,
}

pub(crate) fn page(
    results: &DemoResults<'_>,
    options: &DemoOptions,
    progress: &dyn Progress,
) -> Result<DemoReport, DemoError> {
    let DemoResults { scene, map, scene_evaluation, evaluation, attacked } = results;
    let mut run = LocalizationReport {
        title: "veiloc demo".to_owned(),
        lead: format!(
            "A rendered room was mapped from {} views. Then {} hidden views were localized in the map, without sending their images or \
             the positions of their keypoints.",
            scene.map_list.len(),
            scene.query_list.len()
        ),
        cards: cards(evaluation, attacked),
        unit: LengthUnit::Metres,
        facts: facts(evaluation, options),
        ..LocalizationReport::default()
    };
    let view = SceneView { up: Some([0.0, 0.0, 1.0]), ..SceneView::of_map("", map) };
    add_scene(&mut run, view, &evaluation.schemes, &evaluation.queries, &|name| scene.pose_of(name));
    let shown = scene.query_list.first().cloned();
    let mut names: Vec<String> = shown.into_iter().collect();
    for (_, name) in worst_first(&run.methods, &run.outcomes).into_iter().take(DRAWN) {
        if !names.contains(&name) {
            names.push(name);
        }
    }
    let drawn = drawn_queries(scene_evaluation, map, &names, progress)?;
    run.drawings = drawn.iter().map(|query| query_drawing(query, 0, map, true)).collect();
    Ok(DemoReport {
        run,
        seen: drawn.first().map(seen).transpose()?,
        attacked: attacked.shown.clone(),
        attacks: attacked.document.clone(),
    })
}

fn seen(query: &DrawnQuery) -> Result<DeviceQuery, DemoError> {
    let image = image(&query.path)?;
    Ok(DeviceQuery { name: query.name.clone(), image, keypoints: query.keypoints.clone() })
}

fn find<'a>(evaluation: &'a EvaluationDocument, scheme: &str) -> Option<&'a SchemeSummary> {
    evaluation.schemes.iter().find(|s| s.scheme == scheme)
}

fn cards(evaluation: &EvaluationDocument, attacked: &AttackResults) -> Vec<Card> {
    let mut cards = Vec::new();
    if let Some(dcl) = find(evaluation, "dcl") {
        cards.push(Card {
            value: format!("{} of {}", dcl.localized, dcl.queries),
            label: "hidden views found with dcl".to_owned(),
            note: "The server got lines, never keypoints.".to_owned(),
        });
        cards.push(Card {
            value: dcl.median_translation.map_or("–".to_owned(), |t| LengthUnit::Metres.with_unit(t)),
            label: "median error of the position".to_owned(),
            note: "Half of the views have a smaller error, in a room of several metres.".to_owned(),
        });
    }
    let attack_on = |scheme: &str, attack: Attack| {
        attacked.document.attacks.iter().find(|r| r.scheme == scheme && r.attack == attack)
    };
    for (scheme, attack, label) in [
        ("random-lines", Attack::CLOSED_FORM, "the paper's attack on random lines"),
        ("dcl", Attack::CLOSED_FORM, "the paper's attack on dcl"),
        ("dcl", Attack::GRAPH, "our attack on dcl, given all neighbours"),
    ] {
        if let (Some(row), Some(baseline)) = (attack_on(scheme, attack), attack_on(scheme, Attack::PRIOR)) {
            cards.push(Card {
                value: format!("{:.0} px", row.median_px),
                label: format!("median error, {label}"),
                note: format!(
                    "The prior-only baseline, without any attack, has {:.0} px.",
                    baseline.median_px
                ),
            });
        }
    }
    cards
}

fn facts(evaluation: &EvaluationDocument, options: &DemoOptions) -> Vec<(String, String)> {
    let mut facts = vec![
        ("Command".to_owned(), format!("veiloc demo --seed {}", options.seed)),
        ("Version".to_owned(), env!("CARGO_PKG_VERSION").to_owned()),
    ];
    if let Some(map) = &evaluation.map {
        facts.push((
            "Map".to_owned(),
            format!("{} images, {} points, {:.1} MB", map.images, map.points, map.bytes as f64 / 1e6),
        ));
        facts.push((
            "Map build".to_owned(),
            format!("{:.2} s per image", map.build_seconds / map.images.max(1) as f64),
        ));
    }
    facts
}
