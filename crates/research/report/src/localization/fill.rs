//! Fills a report from evaluation documents, maps, and queries with their answers.

use veiloc_evaluation::DrawnQuery;
use veiloc_evaluation::results::metrics::median;
use veiloc_evaluation::results::{QueryResult, SchemeSummary};
use veiloc_geometry::CameraFromWorld;
use veiloc_map::MapFile;
use veiloc_pose::State;
use veiloc_protocol::PoseDocument;

use super::data::{LocalizationReport, Method, QueryDrawing};
use crate::images::undistorted;
use crate::numbers::{degrees, kilobytes, percent, scheme_name};
use crate::page::Card;
use crate::scene::{QueryOutcome, SceneView, SentDrawing};

/// Fields that distinguish methods.
type Key<'a> = (Option<&'a str>, &'a str, Option<&'a str>);

impl LocalizationReport {
    /// Adds a scene with its part of a document: methods and queries. `truth` returns the true pose of a query, if known.
    pub fn add_scene<'a>(
        &mut self,
        view: SceneView,
        methods: impl IntoIterator<Item = &'a SchemeSummary>,
        queries: impl IntoIterator<Item = &'a QueryResult>,
        truth: &dyn Fn(&str) -> Option<CameraFromWorld>,
    ) {
        let scene = self.scenes.len();
        self.scenes.push(view);
        let methods: Vec<_> = methods.into_iter().collect();
        let recipe_of = |summary: &'a SchemeSummary| summary.variant.recipe.as_deref();
        let several = methods.iter().any(|summary| recipe_of(summary) != recipe_of(methods[0]));
        let mut keys: Vec<(Key<'a>, usize)> = Vec::new();
        for summary in methods {
            let key = (summary.condition.as_deref(), summary.scheme.as_str(), recipe_of(summary));
            keys.push((key, self.methods.len()));
            self.methods.push(Method {
                scene,
                condition: summary.condition.clone(),
                scheme: summary.scheme.clone(),
                variant: recipe_of(summary).filter(|_| several).unwrap_or_default().to_owned(),
                summary: Some(summary.clone()),
            });
        }
        for result in queries {
            let key = (result.condition.as_deref(), result.scheme.as_str(), result.variant.recipe.as_deref());
            let Some((_, method)) = keys.iter().find(|(known, _)| *known == key) else { continue };
            self.outcomes.push(QueryOutcome::of(result, *method, truth(&result.name)));
        }
    }

    /// Fills the large numbers with those of dcl, or of the first scheme.
    pub fn add_cards(&mut self) {
        let is_dcl = |method: &Method| method.scheme.starts_with("dcl");
        let Some(main) = self.methods.iter().find(|m| is_dcl(m)).or(self.methods.first()) else { return };
        let is_main = |method: &Method| method.scheme == main.scheme && method.variant == main.variant;
        let own: Vec<&QueryOutcome> =
            self.outcomes.iter().filter(|o| self.methods.get(o.method).is_some_and(is_main)).collect();
        if own.is_empty() {
            return;
        }
        let card = |value: String, label: &str, note: String| Card { value, label: label.to_owned(), note };
        let median_of = |of: &dyn Fn(&QueryOutcome) -> Option<f64>| {
            let values: Vec<f64> = own.iter().filter_map(|outcome| of(outcome)).collect();
            Some(median(&values)).filter(|_| !values.is_empty())
        };
        let localized = own.iter().filter(|outcome| outcome.estimate.is_some()).count();
        let note = format!("Under {}.", scheme_name(&main.scheme).to_lowercase());
        let mut cards = vec![card(format!("{localized} of {}", own.len()), "queries localized", note)];
        let or_lost = |error: Option<f64>| Some(error.unwrap_or(f64::INFINITY));
        if let Some(error) = median_of(&|o| o.truth.and_then(|_| or_lost(o.position_error))) {
            let rotation = median_of(&|o| o.truth.and_then(|_| or_lost(o.rotation_error_deg)));
            let rotation = rotation.filter(|r| r.is_finite());
            let rotation = rotation.map_or_else(String::new, |r| format!(", {}", degrees(r)));
            cards.push(card(
                if error.is_finite() { self.unit.length(error) } else { "none".to_owned() },
                &format!("{}{rotation}", self.unit.head("median error of the position")),
                "A query without a pose counts as an infinite error.".to_owned(),
            ));
        }
        let trusted = own.iter().filter(|outcome| outcome.state == Some(State::Trusted)).count();
        if trusted > 0 {
            let sd = median_of(&|o| o.position_sd.filter(|_| o.state == Some(State::Trusted)));
            let note = sd.map_or_else(String::new, |sd| {
                format!("The median ± of their positions is {}.", self.unit.with_unit(sd))
            });
            cards.push(card(
                percent(trusted as f64 / own.len() as f64),
                "of queries have a trusted pose",
                note,
            ));
        }
        if let Some(bytes) = median_of(&|o| o.bytes.map(|bytes| bytes as f64)) {
            let note = "Lines and descriptors; no image and no keypoint.".to_owned();
            cards.push(card(kilobytes(bytes), "sent per query", note));
        }
        self.cards.extend(cards);
    }
}

impl QueryOutcome {
    /// The outcome of a document's query.
    pub fn of(result: &QueryResult, method: usize, truth: Option<CameraFromWorld>) -> Self {
        let sd = result.uncertainty;
        Self {
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
}

impl QueryDrawing {
    /// The drawing of an evaluation's query, with its image if requested and readable.
    pub fn of(drawn: &DrawnQuery, scene: usize, map: &MapFile, with_image: bool) -> Self {
        let camera = drawn.sent.first().map(|sent| sent.query.camera());
        let image = camera.filter(|_| with_image).and_then(|camera| {
            let image = image::open(&drawn.path).ok()?.to_rgb8();
            Some(undistorted(&image, &drawn.camera, &camera))
        });
        let sent = drawn.sent.iter().map(|sent| SentDrawing::of(&sent.query, sent.found.as_ref(), map));
        Self { scene, name: drawn.name.clone(), image, is_undistorted: true, sent: sent.collect() }
    }
}
