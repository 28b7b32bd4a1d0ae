//! A scene from above: true and estimated cameras. Also a small drawing of a map for notebooks.

use std::fmt::Write as _;

use maud::{Markup, PreEscaped, html};
use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::nalgebra::{Vector2, Vector3};
use veiloc_pose::State;

use crate::numbers::LengthUnit;
use crate::page::{figure, legend};
use crate::scene::{QueryOutcome, SceneView, SpaceRow};

/// Maximum number of drawn map points.
const MAX_POINTS: usize = 3500;
/// Maximum number of drawn map cameras.
const MAX_CAMERAS: usize = 300;
/// Width of the drawing in SVG units.
const WIDTH: f64 = 520.0;

/// Cameras and map points seen from above.
pub(crate) struct TopView<'a> {
    pub(crate) points: &'a [[f64; 3]],
    /// Unit direction of the map that points right on the page.
    pub(crate) right: Vector3<f64>,
    /// Unit direction of the map that points up on the page.
    pub(crate) up: Vector3<f64>,
    /// Poses of the images in the map.
    pub(crate) cameras: &'a [CameraFromWorld],
}

/// A legend and one drawing per row; empty if nothing is finite. `id`: id of the shared layers.
pub(crate) fn figures(view: &TopView<'_>, id: &str, rows: &[SpaceRow<'_>], unit: LengthUnit) -> Markup {
    let outcomes = || rows.iter().flat_map(|row| row.outcomes.iter().copied());
    let truths: Vec<CameraFromWorld> = outcomes().filter_map(|outcome| outcome.truth).collect();
    let Some(plan) = Plan::new(view, &truths) else { return html! {} };
    let entries = [
        ("camera map", "image in the map"),
        ("camera true", "true camera"),
        ("camera trusted", "trusted estimate"),
        ("camera doubtful", "doubtful estimate"),
        ("cross lost", "not localized"),
    ];
    let entries: Vec<_> =
        entries.into_iter().filter(|e| e.0 != "camera true" || !truths.is_empty()).collect();
    html! {
        (legend(&entries))
        svg.shared width="0" height="0" aria-hidden="true" { defs { g #(id) { (plan.ground(view)) } } }
        div.two { @for row in rows { (plan.figure(row, id, unit)) } }
    }
}

/// A standalone SVG of a map from above; `None` if nothing is finite.
///
/// `down` is the direction of gravity, in the map's axes. Without it, the cameras are assumed to be upright on
/// average.
pub fn map_picture(
    points: &[[f64; 3]],
    cameras: &[CameraFromWorld],
    down: Option<[f64; 3]>,
) -> Option<String> {
    /// Colours that are distinct on light and dark backgrounds.
    const STYLE: &str =
        ".points{stroke:#8a8f98;stroke-linecap:round;fill:none}.camera{stroke:#2f7fd6;fill:none}";
    let held = || cameras.iter().map(|pose| pose.rotation().inverse() * Vector3::y()).sum::<Vector3<f64>>();
    let down = down.map_or_else(held, Vector3::from).try_normalize(1e-9).unwrap_or_else(|| -Vector3::z());
    // Seen from above; the page's up direction is the less vertical of the first two axes.
    let ahead = if down.y.abs() < 0.9 { Vector3::y() } else { -Vector3::z() };
    let up = (ahead - down * down.dot(&ahead)).normalize();
    let view = TopView { points, right: up.cross(&-down), up, cameras };
    let plan = Plan::new(&view, &[])?;
    let drawn = html! {
        svg xmlns="http://www.w3.org/2000/svg" viewBox=(plan.view_box()) width="360" role="img" aria-label="The map from above" {
            style { (PreEscaped(STYLE)) }
            (plan.ground(&view))
        }
    };
    Some(drawn.into_string())
}

/// The directions of the map that point right and up on a page that shows the scene from above.
pub(crate) fn page_axes(scene: &SceneView) -> (Vector3<f64>, Vector3<f64>) {
    let up = up_of(scene);
    let right = right_of(scene, up);
    (right, up.cross(&right))
}

/// The up direction: that of the scene, or the mean up direction of its images.
pub(crate) fn up_of(scene: &SceneView) -> Vector3<f64> {
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

/// Transformation from the map to the page.
pub(crate) struct Plan {
    right: Vector3<f64>,
    up: Vector3<f64>,
    low: Vector2<f64>,
    /// Page units per map unit.
    scale: f64,
    height: f64,
}

impl Plan {
    /// Fits all cameras and all but the farthest map points. `None` if nothing is finite.
    pub(crate) fn new(view: &TopView<'_>, truths: &[CameraFromWorld]) -> Option<Self> {
        let flat = |p: Vector3<f64>| Vector2::new(view.right.dot(&p), view.up.dot(&p));
        let cameras = view.cameras.iter().chain(truths).filter(|pose| pose.is_finite());
        let cameras: Vec<Vector2<f64>> = cameras.map(|pose| flat(pose.center().coords)).collect();
        let points: Vec<Vector2<f64>> = view.points.iter().map(|p| flat(Vector3::from(*p))).collect();
        let range = |axis: usize| {
            let mut along: Vec<f64> = points.iter().map(|p| p[axis]).filter(|x| x.is_finite()).collect();
            along.sort_by(f64::total_cmp);
            let trimmed = along.len() / 100..along.len() - along.len() / 100;
            let seen = along[trimmed].iter().copied().chain(cameras.iter().map(|c| c[axis]));
            seen.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), x| (l.min(x), h.max(x)))
        };
        let (x, y) = (range(0), range(1));
        if !(x.0 <= x.1 && y.0 <= y.1) {
            return None;
        }
        let extent = (x.1 - x.0).max(y.1 - y.0);
        let margin = if extent > 0.0 { 0.08 * extent } else { 1.0 };
        let low = Vector2::new(x.0 - margin, y.0 - margin);
        let (wide, tall) = (x.1 - x.0 + 2.0 * margin, y.1 - y.0 + 2.0 * margin);
        let scale = (WIDTH / wide).min(WIDTH * 1.4 / tall);
        // A tall scene is centred on the page.
        let low = Vector2::new(low.x - (WIDTH / scale - wide) / 2.0, low.y);
        Some(Self { right: view.right, up: view.up, low, scale, height: scale * tall })
    }

    pub(crate) fn view_box(&self) -> String {
        format!("0 0 {WIDTH:.0} {:.0}", self.height)
    }

    /// The map's points and the cameras of its images.
    pub(crate) fn ground(&self, view: &TopView<'_>) -> Markup {
        let mut points = String::new();
        for p in view.points.iter().step_by(view.points.len().div_ceil(MAX_POINTS).max(1)) {
            let q = self.project(Vector3::from(*p));
            if self.holds(q) {
                let _ = write!(points, "M{:.1} {:.1}h0", q.x, q.y);
            }
        }
        let every = view.cameras.len().div_ceil(MAX_CAMERAS).max(1);
        let cameras: String = view.cameras.iter().step_by(every).map(|pose| self.wedge(pose, 7.0)).collect();
        html! { path.points stroke-width="1.6" d=(points) {} path class="camera map" d=(cameras) {} }
    }

    fn figure(&self, row: &SpaceRow<'_>, ground: &str, unit: LengthUnit) -> Markup {
        let localized = |outcome: &QueryOutcome| outcome.estimate.filter(CameraFromWorld::is_finite);
        let truths: String =
            row.outcomes.iter().filter_map(|outcome| Some(self.wedge(&outcome.truth?, 15.0))).collect();
        let of_state = |doubtful: bool| -> String {
            let own = row.outcomes.iter().filter(|o| (o.state == Some(State::Doubtful)) == doubtful);
            own.filter_map(|o| Some(self.wedge(&localized(o)?, 10.0))).collect()
        };
        let lost = row.outcomes.iter().filter(|outcome| localized(outcome).is_none());
        let crosses = lost.filter_map(|outcome| outcome.truth).fold(String::new(), |mut d, truth| {
            let q = self.project(truth.center().coords);
            let _ = write!(d, "M{:.1} {:.1}l10 10m0 -10l-10 10", q.x - 5.0, q.y - 5.0);
            d
        });
        let count = row.outcomes.iter().filter(|outcome| localized(outcome).is_some()).count();
        let picture = html! {
            svg viewBox=(self.view_box()) role="img" aria-label={ "The scene from above, " (row.name) } {
                use href={ "#" (ground) } {}
                path class="camera true" d=(truths) {}
                path class="camera trusted" d=(of_state(false)) {}
                path class="camera doubtful" d=(of_state(true)) {}
                path class="cross lost" d=(crosses) {}
                (self.scale_bar(unit))
            }
        };
        figure(
            &picture,
            &html! { b { (row.name) "." } " " (count) " of " (row.outcomes.len()) " localized." },
        )
    }

    pub(crate) fn project(&self, p: Vector3<f64>) -> Vector2<f64> {
        let x = self.scale * (self.right.dot(&p) - self.low.x);
        Vector2::new(x, self.height - self.scale * (self.up.dot(&p) - self.low.y))
    }

    fn holds(&self, q: Vector2<f64>) -> bool {
        (0.0..=WIDTH).contains(&q.x) && (0.0..=self.height).contains(&q.y)
    }

    /// A triangle with its tip in the projection centre, open towards the view; empty outside the page.
    fn wedge(&self, pose: &CameraFromWorld, size: f64) -> String {
        let forward = pose.rotation().inverse() * Vector3::z();
        let d = Vector2::new(self.right.dot(&forward), -self.up.dot(&forward));
        let d = d.try_normalize(1e-9).unwrap_or_else(Vector2::x);
        let side = Vector2::new(-d.y, d.x) * 0.45;
        let tip = self.project(pose.center().coords);
        if !self.holds(tip) {
            return String::new();
        }
        let (a, b) = (tip + (d + side) * size, tip + (d - side) * size);
        format!("M{:.1} {:.1}L{:.1} {:.1}L{:.1} {:.1}Z", tip.x, tip.y, a.x, a.y, b.x, b.y)
    }

    /// A scale bar with a round length.
    pub(crate) fn scale_bar(&self, unit: LengthUnit) -> Markup {
        let wanted = 90.0 / self.scale;
        let power = 10f64.powf(wanted.log10().floor());
        let length = [5.0, 2.0, 1.0].into_iter().map(|m| m * power).find(|m| *m <= wanted).unwrap_or(power);
        let (y, long) = (self.height - 14.0, length * self.scale);
        html! {
            path.axis d=(format!("M14 {:.1}v8m0 -4h{long:.1}m0 -4v8", y - 4.0)) {}
            text x=(format!("{:.1}", 20.0 + long)) y=(format!("{:.1}", y + 4.0)) { (unit.with_unit(length)) }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn map_picture_draws_points_and_is_none_for_empty_maps() {
        let points: Vec<[f64; 3]> = (0..50).map(|i| [f64::from(i % 7), f64::from(i / 7), 0.1]).collect();
        let camera = CameraFromWorld::identity();
        let drawn = map_picture(&points, &[camera], Some([0.0, 0.0, -1.0])).expect("points");
        assert!(drawn.starts_with("<svg xmlns=") && drawn.ends_with("</svg>"));
        assert_eq!(drawn.matches("h0").count(), 50, "every point, and none over another: {drawn}");
        assert_eq!(drawn.matches('Z').count(), 1);
        // Without a direction: from the camera, whose y axis is the world's.
        assert!(map_picture(&points, &[camera], None).is_some());
        assert!(map_picture(&[], &[], None).is_none());
        assert!(map_picture(&[[f64::NAN; 3]], &[], None).is_none());
    }
}
