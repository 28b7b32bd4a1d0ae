//! The scene in 3D, which the page's script rotates, and the view from above that replaces it without scripts.

mod payload;

use maud::{Markup, PreEscaped, html};
use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::nalgebra::Vector3;

use crate::localization::{QueryOutcome, SceneView};
use crate::numbers::LengthUnit;
use crate::top_view::{self, TopView};
use payload::payload;

/// The queries of one method.
pub(crate) struct SpaceRow<'a> {
    /// Name of the method.
    pub(crate) name: String,
    pub(crate) outcomes: Vec<&'a QueryOutcome>,
}

/// Maximum numbers of drawn map points and queries.
#[derive(Clone, Copy)]
pub(crate) struct Budget {
    pub(crate) points: usize,
    pub(crate) queries: usize,
}

/// The drawing of a scene with its controls; empty if nothing is finite. `index` makes it unique on the page,
/// `anchor` returns where on the page a query is drawn. The first row is shown first.
pub(crate) fn figure(
    scene: &SceneView,
    rows: &[SpaceRow<'_>],
    index: usize,
    budget: Budget,
    unit: LengthUnit,
    anchor: &dyn Fn(&str) -> Option<String>,
) -> Markup {
    let up = up_of(scene);
    let (right, page_up) = page_axes(scene);
    let view = TopView { points: &scene.points, right, up: page_up, cameras: &scene.cameras };
    let flat = top_view::figures(&view, &format!("ground-{index}"), rows, unit);
    if flat.0.is_empty() {
        return flat;
    }
    let drawn = payload(scene, rows, up, budget, unit, anchor);
    let label = format!("The scene {} in 3D: map points, cameras and estimated poses", scene.name);
    let button = |part: &str, label: &str, sign: &str| {
        html! { button type="button" data-part=(part) aria-label=(label) title=(label) { (sign) } }
    };
    let checkbox = |part: &str, label: &str| {
        html! { label { input type="checkbox" data-part=(part) checked; " " (label) } }
    };
    let keys = format!("keys-{index}");
    html! {
        div.space {
            div.live hidden {
                canvas data-part="canvas" tabindex="0" role="application" aria-label=(label) aria-describedby=(keys) {}
                div.controls {
                    span.buttons {
                        (button("left", "Turn left", "↺")) (button("right", "Turn right", "↻"))
                        (button("in", "Zoom in", "+")) (button("out", "Zoom out", "−"))
                        (button("above", "From above", "⊤")) (button("reset", "Reset", "⌂"))
                    }
                    label {
                        "Scheme "
                        select data-part="row" { @for (at, row) in rows.iter().enumerate() { option value=(at) { (row.name) } } }
                    }
                    label {
                        "Query "
                        select data-part="query" {
                            option value="-1" { "none" }
                            @for (at, name) in drawn.queries.iter().enumerate() { option value=(at) { (name) } }
                        }
                    }
                    label {
                        "± drawn "
                        select data-part="times" {
                            @for times in [1, 3, 10, 30, 100] {
                                option value=(times) selected[times == drawn.times] {
                                    @if times == 1 { "as it is" } @else { (times) " times as large" }
                                }
                            }
                        }
                    }
                    (checkbox("points", "points")) (checkbox("map", "map cameras")) (checkbox("sd", "±"))
                }
                p.status data-part="status" aria-live="polite" {}
                p.note id=(keys) {
                    "Drag to turn, with shift or two fingers to move, pinch to zoom; after a click the wheel zooms. Keys: arrows \
                     turn, with shift they move, + and − zoom, 0 resets. " (drawn.remark)
                }
            }
            div.flat { (flat) }
            script type="application/json" data-part="data" { (PreEscaped(drawn.json)) }
        }
    }
}

/// The directions of the map that point right and up on a page that shows the scene from above.
pub(crate) fn page_axes(scene: &SceneView) -> (Vector3<f64>, Vector3<f64>) {
    let up = up_of(scene);
    let right = right_of(scene, up);
    (right, up.cross(&right))
}

/// The up direction: that of the scene, or the mean up direction of its images.
fn up_of(scene: &SceneView) -> Vector3<f64> {
    let up = scene.up.map_or_else(
        || {
            let poses = scene.cameras.iter().filter(|pose| pose.is_finite());
            poses.map(|pose| -(pose.rotation().inverse() * Vector3::y())).sum()
        },
        Vector3::from,
    );
    up.try_normalize(1e-9).unwrap_or_else(Vector3::z)
}

/// The direction of the scene's largest extent, seen from above: it is horizontal on the page.
fn right_of(scene: &SceneView, up: Vector3<f64>) -> Vector3<f64> {
    let centers = scene.cameras.iter().filter(|pose| pose.is_finite()).map(CameraFromWorld::center);
    let centers: Vec<Vector3<f64>> = centers.map(|center| center.coords).collect();
    let side = if up.x.abs() < 0.8 { Vector3::x() } else { Vector3::y() };
    let a = (side - up * up.dot(&side)).try_normalize(1e-9).unwrap_or_else(Vector3::x);
    let b = up.cross(&a);
    let middle = centers.iter().sum::<Vector3<f64>>() / centers.len().max(1) as f64;
    let (mut aa, mut ab, mut bb) = (0.0, 0.0, 0.0);
    for center in &centers {
        let d = center - middle;
        aa += d.dot(&a).powi(2);
        ab += d.dot(&a) * d.dot(&b);
        bb += d.dot(&b).powi(2);
    }
    let angle = 0.5 * f64::atan2(2.0 * ab, aa - bb);
    a * angle.cos() + b * angle.sin()
}
