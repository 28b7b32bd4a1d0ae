//! Fills a report from the documents of an evaluation and its queries.

use veiloc_geometry::CameraFromWorld;
use veiloc_map::MapFile;
use veiloc_protocol::PoseDocument;
use veiloc_report::images::undistorted;
use veiloc_report::{
    LocalizationReport, Method, MethodFigures, QueryDrawing, QueryOutcome, SceneView, SentDrawing,
};

use crate::DrawnQuery;
use crate::results::{QueryResult, STAGES, SchemeSummary};

/// Fields that distinguish methods.
type Key<'a> = (Option<&'a str>, &'a str, Option<&'a str>);

/// Adds a scene with its part of a document: methods and queries. `truth` returns the true pose of a query, if known.
pub fn add_scene<'a>(
    report: &mut LocalizationReport,
    view: SceneView,
    methods: impl IntoIterator<Item = &'a SchemeSummary>,
    queries: impl IntoIterator<Item = &'a QueryResult>,
    truth: &dyn Fn(&str) -> Option<CameraFromWorld>,
) {
    report.stages = STAGES.map(str::to_owned).to_vec();
    let scene = report.scenes.len();
    report.scenes.push(view);
    let methods: Vec<_> = methods.into_iter().collect();
    let recipe_of = |summary: &'a SchemeSummary| summary.variant.recipe.as_deref();
    let several = methods.iter().any(|summary| recipe_of(summary) != recipe_of(methods[0]));
    let mut keys: Vec<(Key<'a>, usize)> = Vec::new();
    for summary in methods {
        let key = (summary.condition.as_deref(), summary.scheme.as_str(), recipe_of(summary));
        keys.push((key, report.methods.len()));
        report.methods.push(Method {
            scene,
            condition: summary.condition.clone(),
            scheme: summary.scheme.clone(),
            variant: recipe_of(summary).filter(|_| several).unwrap_or_default().to_owned(),
            figures: Some(figures_of(summary)),
        });
    }
    for result in queries {
        let key = (result.condition.as_deref(), result.scheme.as_str(), result.variant.recipe.as_deref());
        let Some((_, method)) = keys.iter().find(|(known, _)| *known == key) else { continue };
        report.outcomes.push(outcome_of(result, *method, truth(&result.name)));
    }
}

/// The figures of a method that a report shows.
pub(super) fn figures_of(summary: &SchemeSummary) -> MethodFigures {
    let known = summary.uncertainty.as_ref();
    MethodFigures {
        queries: summary.queries,
        localized: summary.localized,
        trusted: summary.trusted,
        trusted_wrong: summary.trusted_wrong,
        doubtful: summary.doubtful,
        not_found: summary.not_found,
        median_translation: summary.median_translation,
        median_rotation_deg: summary.median_rotation_deg,
        recall: summary.recall.clone(),
        mean_inlier_ratio: summary.mean_inlier_ratio,
        sealed_bytes: summary.sealed_bytes,
        error_over_sd: known.and_then(|u| u.center_error_over_sd),
        within_90: known.and_then(|u| u.coverage.get("90").copied()),
        median_ms: summary.median_ms.clone(),
    }
}

/// The outcome of a document's query.
fn outcome_of(result: &QueryResult, method: usize, truth: Option<CameraFromWorld>) -> QueryOutcome {
    let sd = result.uncertainty;
    QueryOutcome {
        method,
        name: result.name.clone(),
        truth,
        estimate: result.cam_from_world.as_ref().and_then(PoseDocument::pose),
        state: result.state,
        position_error: result.translation_error,
        rotation_error_deg: result.rotation_error_deg,
        position_sd: sd.and_then(|sd| sd.position_sd),
        rotation_sd_deg: sd.and_then(|sd| sd.rotation_sd_deg),
        inliers: result.inliers,
        matches: result.correspondences,
        bytes: result.sent.map(|sent| sent.sent_bytes).or(result.sealed_bytes),
        ms: (!result.ms.is_empty()).then(|| result.ms.values().sum()),
        remark: result.failure.clone(),
    }
}

/// The drawing of an evaluation's query, with its image if requested and readable.
pub fn query_drawing(drawn: &DrawnQuery, scene: usize, map: &MapFile, with_image: bool) -> QueryDrawing {
    let camera = drawn.sent.first().map(|sent| sent.query.camera());
    let image = camera.filter(|_| with_image).and_then(|camera| {
        let image = image::open(&drawn.path).ok()?.to_rgb8();
        Some(undistorted(&image, &drawn.camera, &camera))
    });
    let sent = drawn.sent.iter().map(|sent| SentDrawing::of(&sent.query, sent.found.as_ref(), map));
    QueryDrawing { scene, name: drawn.name.clone(), image, is_undistorted: true, sent: sent.collect() }
}
