//! The place in 3D: what the page's script turns, and what stands there without it.

mod payload;

use std::fmt::Write as _;

use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::nalgebra::Vector3;

use crate::format::escape;
use crate::run::{PlaceView, QueryOutcome};
use crate::top_view::{self, TopCamera, TopView, TopViewRow};
use payload::payload;

/// A row of the table, as far as the drawing goes.
pub(crate) struct SpaceRow<'a> {
    /// What it is called.
    pub(crate) name: String,
    /// Its queries.
    pub(crate) outcomes: Vec<&'a QueryOutcome>,
}

/// How many map points and queries are drawn.
#[derive(Clone, Copy)]
pub(crate) struct Budget {
    pub(crate) points: usize,
    pub(crate) queries: usize,
}

/// The drawing of a place with its controls; nothing when there is nothing finite to show. `index` tells it from others on the
/// page, `id_of` is where on the page a query is drawn. The first row is shown first.
pub(crate) fn figure(
    place: &PlaceView,
    rows: &[SpaceRow<'_>],
    index: usize,
    budget: Budget,
    id_of: &dyn Fn(&str) -> Option<String>,
) -> String {
    let up = up_of(place);
    let right = right_of(place, up);
    let flat = top_view::figures(&TopView {
        id: format!("ground-{index}"),
        points: &place.points,
        right: right.into(),
        up: up.cross(&right).into(),
        mapping: &place.mapping,
        rows: rows.iter().map(top_row).collect(),
    });
    if flat.is_empty() {
        return String::new();
    }
    let drawn = payload(place, rows, up, budget, id_of);
    let mut options = String::new();
    for (at, row) in rows.iter().enumerate() {
        let _ = write!(options, "<option value=\"{at}\">{}</option>", escape(&row.name));
    }
    let mut queries = String::from("<option value=\"-1\">none</option>");
    for (at, name) in drawn.queries.iter().enumerate() {
        let _ = write!(queries, "<option value=\"{at}\">{}</option>", escape(name));
    }
    let mut times = String::new();
    for by in [1, 3, 10, 30, 100] {
        let chosen = if by == drawn.times { " selected" } else { "" };
        let words = if by == 1 { "as it is".to_owned() } else { format!("{by} times as large") };
        let _ = write!(times, "<option value=\"{by}\"{chosen}>{words}</option>");
    }
    let button = |part: &str, label: &str, sign: &str| {
        format!(
            "<button type=\"button\" data-part=\"{part}\" aria-label=\"{label}\" title=\"{label}\">{sign}</button>"
        )
    };
    let of_place = if place.name.is_empty() { String::new() } else { format!(" {}", escape(&place.name)) };
    format!(
        "<div class=\"space\"><div class=\"live\" hidden><canvas data-part=\"canvas\" tabindex=\"0\" role=\"application\" \
         aria-label=\"The place{of_place} in 3D: map points, cameras and estimated poses\" aria-describedby=\"keys-{index}\">\
         </canvas><div class=\"controls\"><span class=\"buttons\">{}{}{}{}{}{}</span>\
         <label>Scheme <select data-part=\"row\">{options}</select></label>\
         <label>Query <select data-part=\"query\">{queries}</select></label>\
         <label>± drawn <select data-part=\"times\">{times}</select></label>\
         <label><input type=\"checkbox\" data-part=\"points\" checked> points</label>\
         <label><input type=\"checkbox\" data-part=\"map\" checked> map cameras</label>\
         <label><input type=\"checkbox\" data-part=\"sd\" checked> ±</label></div>\
         <p class=\"told\" data-part=\"told\" aria-live=\"polite\"></p><p class=\"note\" id=\"keys-{index}\">Drag to turn, with shift \
         or two fingers to move, pinch to zoom; click it and the wheel zooms. Keys: arrows turn, with shift move, + and − \
         zoom, 0 starts again. {}</p></div><div class=\"flat\">{flat}</div>\
         <script type=\"application/json\" data-part=\"data\">{}</script></div>",
        button("left", "Turn left", "↺"),
        button("right", "Turn right", "↻"),
        button("in", "Zoom in", "+"),
        button("out", "Zoom out", "−"),
        button("above", "From above", "⊤"),
        button("reset", "Start again", "⌂"),
        drawn.remark,
        drawn.json,
    )
}

fn top_row(row: &SpaceRow<'_>) -> TopViewRow {
    let camera = |q: &&QueryOutcome| TopCamera { truth: q.truth, estimate: q.estimate, state: q.state };
    TopViewRow { name: row.name.clone(), cameras: row.outcomes.iter().map(camera).collect() }
}

/// What is up: what the place says, or what its images have up on the whole.
fn up_of(place: &PlaceView) -> Vector3<f64> {
    let up = place.up.map_or_else(
        || {
            let poses = place.mapping.iter().filter(|pose| pose.is_finite());
            poses.map(|pose| -(pose.rotation().inverse() * Vector3::y())).sum()
        },
        Vector3::from,
    );
    up.try_normalize(1e-9).unwrap_or_else(Vector3::z)
}

/// Where the place is longest, seen from above: that lies level on the page.
fn right_of(place: &PlaceView, up: Vector3<f64>) -> Vector3<f64> {
    let centers = place.mapping.iter().filter(|pose| pose.is_finite()).map(CameraFromWorld::center);
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
