//! What the script draws: points on a grid of 16 bits, poses as numbers, names.

use std::fmt::Write as _;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use veiloc_evaluation::results::metrics::median;
use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::nalgebra::Vector3;
use veiloc_pose::State;

use super::{Budget, SpaceRow};
use crate::run::{PlaceView, QueryOutcome};

/// Cameras of the map drawn at most.
const MOST_CAMERAS: usize = 600;

/// What is drawn.
pub(super) struct Payload {
    /// For the script.
    pub(super) json: String,
    /// Names of the drawn queries.
    pub(super) queries: Vec<String>,
    /// By how much ± is drawn too large at first, so that it is seen.
    pub(super) times: u32,
    /// What is left out, a sentence or two; empty when nothing is.
    pub(super) remark: String,
}

pub(super) fn payload(
    place: &PlaceView,
    rows: &[SpaceRow<'_>],
    up: Vector3<f64>,
    budget: Budget,
    id_of: &dyn Fn(&str) -> Option<String>,
) -> Payload {
    let finite: Vec<&[f64; 3]> = place.points.iter().filter(|p| p.iter().all(|x| x.is_finite())).collect();
    let every = finite.len().div_ceil(budget.points.max(1)).max(1);
    let points: Vec<&[f64; 3]> = finite.iter().copied().step_by(every).collect();
    let (low, step, codes) = on_grid(&points);
    let digits = digits(step);
    let cameras: Vec<&CameraFromWorld> = place.mapping.iter().filter(|pose| pose.is_finite()).collect();
    let every_camera = cameras.len().div_ceil(MOST_CAMERAS).max(1);
    let mapped: Vec<String> =
        cameras.iter().step_by(every_camera).map(|pose| camera(Some(pose), digits)).collect();
    let (names, queries) = queries(rows, budget, digits, id_of);
    let row_names: Vec<String> = rows.iter().map(|row| text(&row.name)).collect();
    let json = format!(
        "{{\"low\":[{}],\"step\":{step:e},\"points\":\"{}\",\"up\":[{:.6},{:.6},{:.6}],\"rows\":[{}],\"map\":[{}],\"queries\":[{}]}}",
        low.map(|x| format!("{x:e}")).join(","),
        STANDARD.encode(codes),
        up.x,
        up.y,
        up.z,
        row_names.join(","),
        mapped.join(","),
        queries.join(","),
    );
    let asked = rows.iter().map(|row| row.outcomes.len()).max().unwrap_or(0);
    let mut remark = String::new();
    if every > 1 {
        let _ = write!(remark, "{} of {} map points are drawn. ", points.len(), finite.len());
    }
    if every_camera > 1 {
        let _ = write!(remark, "One camera of the map in {every_camera} is drawn. ");
    }
    if names.len() < asked {
        let _ = write!(remark, "{} of {asked} queries are drawn. ", names.len());
    }
    Payload { json, queries: names, times: times(rows, 65_535.0 * step), remark }
}

/// Every query once, with its pose in every row.
fn queries(
    rows: &[SpaceRow<'_>],
    budget: Budget,
    digits: usize,
    id_of: &dyn Fn(&str) -> Option<String>,
) -> (Vec<String>, Vec<String>) {
    let most = rows.iter().max_by_key(|row| row.outcomes.len());
    let all = most.map_or(&[][..], |row| &row.outcomes);
    let every = all.len().div_ceil(budget.queries.max(1)).max(1);
    // What is drawn elsewhere on the page is drawn here too.
    let chosen = all.iter().enumerate().filter(|(at, q)| at % every == 0 || id_of(&q.name).is_some());
    let mut names = Vec::new();
    let mut entries = Vec::new();
    // Rows mostly hold the queries in one order: the search begins where the last ended.
    let mut cursors = vec![0; rows.len()];
    for (_, query) in chosen {
        let mut found = Vec::new();
        for (at, row) in rows.iter().enumerate() {
            let len = row.outcomes.len();
            let place =
                (0..len).map(|i| (cursors[at] + i) % len).find(|i| row.outcomes[*i].name == query.name);
            if let Some(place) = place {
                cursors[at] = place;
                found.push(estimate(at, row.outcomes[place], digits));
            }
        }
        let truth = query.truth.filter(CameraFromWorld::is_finite);
        let id = id_of(&query.name).map_or_else(|| "null".to_owned(), |id| text(&id));
        entries.push(format!(
            "{{\"n\":{},\"t\":{},\"id\":{id},\"e\":[{}]}}",
            text(&query.name),
            camera(truth.as_ref(), digits),
            found.join(",")
        ));
        names.push(query.name.clone());
    }
    (names, entries)
}

/// Row, pose, ±, state (0: none, 1: doubtful, 2: trusted or not asked), errors.
fn estimate(row: usize, query: &QueryOutcome, digits: usize) -> String {
    let pose = query.estimate.filter(CameraFromWorld::is_finite);
    let kind = match (pose, query.state) {
        (None, _) | (_, Some(State::NotFound)) => 0,
        (_, Some(State::Doubtful)) => 1,
        _ => 2,
    };
    format!(
        "[{row},{},{},{kind},{},{}]",
        camera(pose.as_ref(), digits),
        number(query.position_sd),
        number(query.position_error),
        number(query.rotation_error_deg),
    )
}

/// Centre and world-to-camera turn: `[x, y, z, qw, qx, qy, qz]`.
fn camera(pose: Option<&CameraFromWorld>, digits: usize) -> String {
    let Some(pose) = pose else { return "null".to_owned() };
    let (c, [w, x, y, z]) = (pose.center().coords, pose.quaternion());
    format!("[{:.digits$},{:.digits$},{:.digits$},{w:.5},{x:.5},{y:.5},{z:.5}]", c.x, c.y, c.z)
}

/// Four digits; what is none is null.
fn number(value: Option<f64>) -> String {
    value.filter(|v| v.is_finite()).map_or_else(|| "null".to_owned(), |v| format!("{v:.3e}"))
}

/// A text that stands between quotes in JSON and cannot end the element it stands in.
fn text(value: &str) -> String {
    let mut out = String::from("\"");
    for c in value.chars() {
        match c {
            '"' | '\\' => out.extend(['\\', c]),
            '<' | '>' | '&' | '\u{2028}' | '\u{2029}' | '\0'..='\u{1f}' => {
                let _ = write!(out, "\\u{:04x}", u32::from(c));
            }
            c => out.push(c),
        }
    }
    out + "\""
}

/// The corner of the points, the step of the grid, and the points on it: three numbers of 16 bits each, low byte first. Points
/// far from all others are held to the edge.
fn on_grid(points: &[&[f64; 3]]) -> ([f64; 3], f64, Vec<u8>) {
    let range = |axis: usize| {
        let mut along: Vec<f64> = points.iter().map(|p| p[axis]).collect();
        along.sort_by(f64::total_cmp);
        let cut = along.len() / 200;
        let ends = (along.get(cut), along.get(along.len().saturating_sub(cut + 1)));
        (ends.0.copied().unwrap_or(0.0), ends.1.copied().unwrap_or(0.0))
    };
    let ranges = [range(0), range(1), range(2)];
    let size = ranges.iter().map(|(low, high)| high - low).fold(1e-6, f64::max);
    // A rim for what lies a little outside.
    let low = ranges.map(|(low, _)| low - 0.25 * size);
    let step = 1.5 * size / 65_535.0;
    let code = |x: f64, axis: usize| ((x - low[axis]) / step).round().clamp(0.0, 65_535.0) as u16;
    let codes = points.iter().flat_map(|p| (0..3).flat_map(move |axis| code(p[axis], axis).to_le_bytes()));
    (low, step, codes.collect())
}

/// Digits behind the point that tell places a tenth of a grid step apart.
fn digits(step: f64) -> usize {
    (-step.log10()).ceil().clamp(0.0, 12.0) as usize + 1
}

/// A median ± is seen when it is a hundredth of the place.
fn times(rows: &[SpaceRow<'_>], extent: f64) -> u32 {
    let sds: Vec<f64> = rows.iter().flat_map(|row| &row.outcomes).filter_map(|q| q.position_sd).collect();
    let wanted = 0.01 * extent / median(&sds);
    [100, 30, 10, 3].into_iter().find(|by| wanted.is_finite() && wanted >= f64::from(*by)).unwrap_or(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_cannot_end_the_element() {
        assert_eq!(text("a\"\\</script>\n&"), "\"a\\\"\\\\\\u003c/script\\u003e\\u000a\\u0026\"");
    }

    #[test]
    fn points_come_back_from_the_grid_and_stray_ones_do_not_coarsen_it() {
        let mut points: Vec<[f64; 3]> =
            (0..1000).map(|i| [f64::from(i) * 0.01, 3.0, -f64::from(i) * 0.002]).collect();
        points.push([1e9, 0.0, 0.0]);
        let (low, step, codes) = on_grid(&points.iter().collect::<Vec<_>>());
        assert!(step < 1e-3, "{step}");
        let at = |i: usize, axis: usize| {
            let code = u16::from_le_bytes([codes[6 * i + 2 * axis], codes[6 * i + 2 * axis + 1]]);
            low[axis] + step * f64::from(code)
        };
        for (i, axis) in [(0, 0), (500, 0), (500, 1), (999, 2)] {
            assert!((at(i, axis) - points[i][axis]).abs() <= step, "{i} {axis}");
        }
        assert_eq!(on_grid(&[]).2, Vec::<u8>::new());
    }

    #[test]
    fn deviations_that_are_small_are_drawn_larger() {
        let query = QueryOutcome { position_sd: Some(0.004), ..QueryOutcome::default() };
        let row = |query| [SpaceRow { name: String::new(), outcomes: vec![query] }];
        assert_eq!(times(&row(&query), 10.0), 10);
        assert_eq!(times(&[], 10.0), 1);
    }
}
