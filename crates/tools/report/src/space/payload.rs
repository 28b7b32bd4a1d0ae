//! Data of the script as JSON: points on a 16-bit grid, poses as numbers, names.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde_json::{Value, json};
use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::nalgebra::Vector3;
use veiloc_geometry::statistics::median;
use veiloc_pose::State;

use crate::numbers::LengthUnit;
use crate::scene::{QueryOutcome, SceneView, SpaceRow};

/// Maximum number of drawn map cameras.
const MAX_CAMERAS: usize = 600;

/// Maximum numbers of drawn map points and queries.
#[derive(Clone, Copy)]
pub(crate) struct Budget {
    pub(crate) points: usize,
    pub(crate) queries: usize,
}

/// Data of one drawing.
pub(super) struct Payload {
    /// JSON for the script; it cannot contain the end tag of its element.
    pub(super) json: String,
    /// Names of the drawn queries.
    pub(super) queries: Vec<String>,
    /// Initial magnification of ±, so that it is visible.
    pub(super) times: u32,
    /// A remark about left-out data; may be empty.
    pub(super) remark: String,
}

pub(super) fn payload(
    scene: &SceneView,
    rows: &[SpaceRow<'_>],
    up: Vector3<f64>,
    budget: Budget,
    unit: LengthUnit,
    anchor: &dyn Fn(&str) -> Option<String>,
) -> Payload {
    let finite: Vec<&[f64; 3]> = scene.points.iter().filter(|p| p.iter().all(|x| x.is_finite())).collect();
    let every = finite.len().div_ceil(budget.points.max(1)).max(1);
    let points: Vec<&[f64; 3]> = finite.iter().copied().step_by(every).collect();
    let (low, step, codes) = on_grid(&points);
    let digits = digits(step);
    let cameras: Vec<&CameraFromWorld> = scene.cameras.iter().filter(|pose| pose.is_finite()).collect();
    let every_camera = cameras.len().div_ceil(MAX_CAMERAS).max(1);
    let drawn_cameras: Vec<Value> =
        cameras.iter().step_by(every_camera).map(|pose| camera(Some(pose), digits)).collect();
    let (names, queries) = queries(rows, budget, digits, anchor);
    let json = json!({
        "low": low,
        "step": step,
        "points": STANDARD.encode(codes),
        "up": [up.x, up.y, up.z],
        "metres": unit == LengthUnit::Metres,
        "rows": rows.iter().map(|row| &row.name).collect::<Vec<_>>(),
        "map": drawn_cameras,
        "queries": queries,
    });
    let requested = rows.iter().map(|row| row.outcomes.len()).max().unwrap_or(0);
    let left_out = [
        (every > 1, format!("{} of {} map points are drawn. ", points.len(), finite.len())),
        (every_camera > 1, format!("One camera of the map in {every_camera} is drawn. ")),
        (names.len() < requested, format!("{} of {requested} queries are drawn. ", names.len())),
    ];
    Payload {
        // Otherwise a name could end the script element.
        json: json.to_string().replace('<', "\\u003c"),
        queries: names,
        times: times(rows, 65_535.0 * step),
        remark: left_out.into_iter().filter(|(is_so, _)| *is_so).map(|(_, text)| text).collect(),
    }
}

/// Every query once, with its pose in every row.
fn queries(
    rows: &[SpaceRow<'_>],
    budget: Budget,
    digits: usize,
    anchor: &dyn Fn(&str) -> Option<String>,
) -> (Vec<String>, Vec<Value>) {
    let most = rows.iter().max_by_key(|row| row.outcomes.len());
    let all = most.map_or(&[][..], |row| &row.outcomes);
    let every = all.len().div_ceil(budget.queries.max(1)).max(1);
    // Queries with a drawing on the page are always included.
    let chosen = all.iter().enumerate().filter(|(at, q)| at % every == 0 || anchor(&q.name).is_some());
    let mut names = Vec::new();
    let mut entries = Vec::new();
    // Rows mostly have the queries in the same order, so the search starts where the last one ended.
    let mut cursors = vec![0; rows.len()];
    for (_, query) in chosen {
        let mut found = Vec::new();
        for (at, row) in rows.iter().enumerate() {
            let len = row.outcomes.len();
            let own = (0..len).map(|i| (cursors[at] + i) % len).find(|i| row.outcomes[*i].name == query.name);
            if let Some(own) = own {
                cursors[at] = own;
                found.push(estimate(at, row.outcomes[own], digits));
            }
        }
        let truth = camera(query.truth.as_ref(), digits);
        entries.push(json!({ "n": query.name, "t": truth, "id": anchor(&query.name), "e": found }));
        names.push(query.name.clone());
    }
    (names, entries)
}

/// Row, pose, ±, state (0: none, 1: doubtful, 2: trusted or not evaluated), errors.
fn estimate(row: usize, query: &QueryOutcome, digits: usize) -> Value {
    let pose = query.estimate.filter(CameraFromWorld::is_finite);
    let kind = match (pose, query.state) {
        (None, _) | (_, Some(State::NotFound)) => 0,
        (_, Some(State::Doubtful)) => 1,
        _ => 2,
    };
    // JSON has no non-finite numbers: they become null.
    json!([
        row,
        camera(pose.as_ref(), digits),
        query.position_sd,
        kind,
        query.position_error,
        query.rotation_error_deg
    ])
}

/// Centre and world-to-camera rotation: `[x, y, z, qw, qx, qy, qz]`.
fn camera(pose: Option<&CameraFromWorld>, digits: usize) -> Value {
    let Some(pose) = pose.filter(|pose| pose.is_finite()) else { return Value::Null };
    let (c, [w, x, y, z]) = (pose.center().coords, pose.quaternion());
    let rounded = |value: f64, digits: usize| {
        let scale = 10f64.powi(digits as i32);
        (value * scale).round() / scale
    };
    let turn = [w, x, y, z].map(|q| rounded(q, 5));
    json!([
        rounded(c.x, digits),
        rounded(c.y, digits),
        rounded(c.z, digits),
        turn[0],
        turn[1],
        turn[2],
        turn[3]
    ])
}

/// The corner of the points, the step of the grid, and the points on it: three 16-bit numbers each, low byte first.
/// Points far from all others are clamped to the edge.
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
    // A margin for points slightly outside.
    let low = ranges.map(|(low, _)| low - 0.25 * size);
    let step = 1.5 * size / 65_535.0;
    let code = |x: f64, axis: usize| ((x - low[axis]) / step).round().clamp(0.0, 65_535.0) as u16;
    let codes = points.iter().flat_map(|p| (0..3).flat_map(move |axis| code(p[axis], axis).to_le_bytes()));
    (low, step, codes.collect())
}

/// Decimals that resolve a tenth of a grid step.
fn digits(step: f64) -> usize {
    (-step.log10()).ceil().clamp(0.0, 12.0) as usize + 1
}

/// The magnification at which the median ± is a hundredth of the scene.
fn times(rows: &[SpaceRow<'_>], extent: f64) -> u32 {
    let sds: Vec<f64> = rows.iter().flat_map(|row| &row.outcomes).filter_map(|q| q.position_sd).collect();
    let wanted = 0.01 * extent / median(&sds);
    [100, 30, 10, 3].into_iter().find(|by| wanted.is_finite() && wanted >= f64::from(*by)).unwrap_or(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_cannot_close_the_script_element() {
        let query =
            QueryOutcome { name: "</script>".into(), position_sd: Some(f64::NAN), ..QueryOutcome::default() };
        let rows = [SpaceRow { name: "<b>".into(), outcomes: vec![&query] }];
        let budget = Budget { points: 9, queries: 9 };
        let drawn = payload(&SceneView::default(), &rows, Vector3::z(), budget, LengthUnit::Map, &|_| None);
        assert!(!drawn.json.contains('<') && drawn.json.contains("\\u003c/script>"), "{}", drawn.json);
        let read: Value = serde_json::from_str(&drawn.json).expect("JSON");
        assert_eq!(
            (&read["queries"][0]["n"], &read["queries"][0]["e"][0][2]),
            (&"</script>".into(), &Value::Null)
        );
    }

    #[test]
    fn grid_round_trip_is_robust_to_outliers() {
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
    fn small_deviations_are_magnified() {
        let query = QueryOutcome { position_sd: Some(0.004), ..QueryOutcome::default() };
        let row = |query| [SpaceRow { name: String::new(), outcomes: vec![query] }];
        assert_eq!(times(&row(&query), 10.0), 10);
        assert_eq!(times(&[], 10.0), 1);
    }
}
