//! Fills the demo's report with what was measured.

use veiloc_geometry::CameraFromWorld;
use veiloc_map::{MapFile, PointId};

use veiloc_audit::Attack;
use veiloc_report::{Card, Report, TopView, TopViewScheme};
use veiloc_results::{Evaluation, SchemeSummary};

use crate::attack::Attacked;
use crate::options::DemoOptions;
use crate::place::RenderedPlace;

/// Map points the top view draws at most; more only make the file larger.
const DRAWN_POINTS: usize = 4000;

pub(crate) fn page(
    place: &RenderedPlace,
    map: &MapFile,
    evaluation: &Evaluation,
    attacked: &Attacked,
    options: &DemoOptions,
) -> Report {
    let mut page = Report {
        title: "veiloc demo".to_owned(),
        lead: format!(
            "A room that nobody has photographed was rendered from {} places and turned into a map. Then {} hidden views \
             asked where they were taken, without sending their image or where their keypoints are.",
            place.map_list.len(),
            place.query_list.len()
        ),
        ..Report::default()
    };
    page.cards = cards(evaluation, attacked);
    page.localization.clone_from(&evaluation.schemes);
    page.attacks.clone_from(&attacked.document.attacks);
    page.queries.clone_from(&attacked.panels);
    page.top_view = Some(top_view(place, map, evaluation));
    page.details = details(evaluation, options);
    page
}

fn find<'a>(evaluation: &'a Evaluation, scheme: &str) -> Option<&'a SchemeSummary> {
    evaluation.schemes.iter().find(|s| s.scheme == scheme)
}

fn cards(evaluation: &Evaluation, attacked: &Attacked) -> Vec<Card> {
    let mut cards = Vec::new();
    if let Some(dcl) = find(evaluation, "dcl") {
        cards.push(Card {
            value: format!("{} of {}", dcl.localized, dcl.queries),
            label: "hidden views found with dcl".to_owned(),
            note: "The server saw lines, never keypoints.".to_owned(),
        });
        cards.push(Card {
            value: dcl.median_translation.map_or("—".to_owned(), |t| format!("{:.1} cm", 100.0 * t)),
            label: "median error of the position".to_owned(),
            note: "Half of the views were placed better than this, in a room of several metres.".to_owned(),
        });
    }
    let attack_on = |scheme: &str, attack: Attack| {
        attacked.document.attacks.iter().find(|r| r.scheme == scheme && r.attack == attack)
    };
    for (scheme, attack, label) in [
        ("random-lines", Attack::CLOSED_FORM, "the paper's attack on random lines"),
        ("dcl", Attack::CLOSED_FORM, "the paper's attack on dcl"),
        ("dcl", Attack::GRAPH, "our attack on dcl, told all neighbours"),
    ] {
        if let (Some(row), Some(guess)) = (attack_on(scheme, attack), attack_on(scheme, Attack::PRIOR)) {
            cards.push(Card {
                value: format!("{:.0} px", row.median_px),
                label: format!("median error, {label}"),
                note: format!(
                    "Guessing without any attack gives {:.0} px; an attack counts by what it gains over that.",
                    guess.median_px
                ),
            });
        }
    }
    cards
}

fn top_view(place: &RenderedPlace, map: &MapFile, evaluation: &Evaluation) -> TopView {
    let step = map.point_count().div_ceil(DRAWN_POINTS).max(1);
    let points = (0..map.point_count())
        .step_by(step)
        .map(|i| {
            let p = map.point(PointId(i as u32)).coords;
            [p.x, p.y, p.z]
        })
        .collect();
    let true_pose = |name: &str| place.pose_of(name);
    let schemes = evaluation
        .schemes
        .iter()
        .map(|s| TopViewScheme {
            scheme: s.scheme.clone(),
            cameras: evaluation
                .queries
                .iter()
                .filter(|q| q.scheme == s.scheme && q.score == s.score)
                .filter_map(|q| {
                    let estimate: Option<CameraFromWorld> = q.cam_from_world.as_ref().and_then(|p| p.pose());
                    Some((true_pose(&q.name)?, estimate))
                })
                .collect(),
        })
        .collect();
    TopView {
        points,
        right: place.right,
        up: place.up,
        mapping: place.map_list.iter().filter_map(|name| true_pose(name)).collect(),
        schemes,
    }
}

fn details(evaluation: &Evaluation, options: &DemoOptions) -> Vec<(String, String)> {
    let mut details = vec![
        ("Command".to_owned(), format!("veiloc demo --seed {}", options.seed)),
        ("Version".to_owned(), env!("CARGO_PKG_VERSION").to_owned()),
    ];
    if let Some(map) = &evaluation.map {
        details.push((
            "Map".to_owned(),
            format!("{} images, {} points, {:.1} MB", map.images, map.points, map.bytes as f64 / 1e6),
        ));
        details.push((
            "Map build".to_owned(),
            format!("{:.2} s an image", map.build_seconds / map.images.max(1) as f64),
        ));
    }
    details
}
