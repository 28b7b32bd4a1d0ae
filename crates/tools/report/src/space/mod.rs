//! The scene in 3D, which the page's script rotates, and the view from above that replaces it without scripts.

mod payload;

use maud::{Markup, PreEscaped, html};

use crate::numbers::LengthUnit;
use crate::scene::{SceneView, SpaceRow};
use crate::top_view::{self, TopView, page_axes, up_of};
pub(crate) use payload::Budget;
use payload::payload;

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
