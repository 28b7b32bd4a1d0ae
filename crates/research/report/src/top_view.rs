//! The place from above: where cameras stood, and where the server put them.

use std::fmt::Write as _;

use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::nalgebra::{Vector2, Vector3};
use veiloc_pose::State;

use super::format::{escape, length};

/// Map points drawn at most.
const MOST_POINTS: usize = 3500;
/// Cameras of the map drawn at most.
const MOST_CAMERAS: usize = 300;
/// Width of the drawing in its own units.
pub(super) const WIDTH: f64 = 520.0;

/// Cameras and map points seen from above.
pub(crate) struct TopView<'a> {
    /// Name of what several drawings share, on the page.
    pub(crate) id: String,
    /// Map points, map units (metres).
    pub(crate) points: &'a [[f64; 3]],
    /// Unit direction of the map that points right on the page.
    pub(crate) right: [f64; 3],
    /// Unit direction of the map that points up on the page.
    pub(crate) up: [f64; 3],
    /// Poses of the images in the map.
    pub(crate) mapping: &'a [CameraFromWorld],
    /// One drawing per row.
    pub(crate) rows: Vec<TopViewRow>,
}

/// The queries of one row.
#[derive(Debug, Clone)]
pub(crate) struct TopViewRow {
    /// What the row is called.
    pub(crate) name: String,
    /// Its queries.
    pub(crate) cameras: Vec<TopCamera>,
}

/// A query.
#[derive(Debug, Clone, Copy)]
pub(crate) struct TopCamera {
    pub(crate) truth: Option<CameraFromWorld>,
    pub(crate) estimate: Option<CameraFromWorld>,
    pub(crate) state: Option<State>,
}

/// Legend and drawings; nothing when there is nothing finite to show.
pub(crate) fn figures(view: &TopView<'_>) -> String {
    let Some(plan) = Plan::new(view) else { return String::new() };
    let judged = view.rows.iter().flat_map(|row| &row.cameras).any(|camera| camera.truth.is_some());
    let mut out = legend(judged);
    let ground = plan.ground(view);
    // Drawn once, and referred to.
    let _ = write!(
        out,
        "<svg width=\"0\" height=\"0\" class=\"shared\" aria-hidden=\"true\"><defs><g id=\"{}\">{ground}</g></defs></svg>\
         <div class=\"two\">",
        view.id
    );
    let ground = format!("<use href=\"#{}\"/>", view.id);
    for group in alike(&view.rows) {
        out.push_str(&figure(&group, &plan, &ground));
    }
    out + "</div>"
}

fn legend(judged: bool) -> String {
    let wedge = "M2 11L6 1L10 11Z";
    let entry = |class: &str, words: &str| {
        format!(
            "<li><svg viewBox=\"0 0 12 12\" aria-hidden=\"true\"><path class=\"{class}\" stroke-width=\"1\" d=\"{wedge}\"/></svg>{words}</li>"
        )
    };
    let found = if judged {
        [
            entry("truecam", "true camera"),
            entry("near", "estimate, under 5 cm off"),
            entry("mid", "under 25 cm"),
            entry("far", "farther off"),
        ]
        .concat()
    } else {
        [entry("near", "trusted estimate"), entry("mid", "doubtful estimate")].concat()
    };
    let lost = "<li><svg viewBox=\"0 0 12 12\" aria-hidden=\"true\"><path class=\"lost\" stroke-width=\"2\" d=\"M2 2L10 10M10 2L2 10\"/>\
                </svg>not localized</li>";
    format!(
        "<ul class=\"legend\">{}{found}{}<li><svg viewBox=\"0 0 12 12\" aria-hidden=\"true\"><path class=\"mappoint\" \
         stroke-width=\"5\" d=\"M6 6h0\"/></svg>map point</li></ul>",
        entry("mapcam", "image in the map"),
        if judged { lost } else { "" },
    )
}

/// How far off one estimate is; as the legend has it.
fn class(camera: &TopCamera) -> &'static str {
    let Some(pose) = camera.estimate.filter(CameraFromWorld::is_finite) else { return "lost" };
    match camera.truth.map(|truth| pose.translation_error(&truth)) {
        None if camera.state == Some(State::Doubtful) => "mid",
        None => "near",
        Some(error) if error < 0.05 => "near",
        Some(error) if error < 0.25 => "mid",
        Some(_) => "far",
    }
}

/// Rows whose drawings would look the same share one.
fn alike(rows: &[TopViewRow]) -> Vec<Vec<&TopViewRow>> {
    let classes = |row: &TopViewRow| -> Vec<&'static str> { row.cameras.iter().map(class).collect() };
    let mut groups: Vec<Vec<&TopViewRow>> = Vec::new();
    for scheme in rows {
        // Where nothing is farther off than a wedge is long, nobody sees a difference.
        let own = classes(scheme);
        let seen = own.contains(&"far");
        match groups.iter_mut().find(|g| !seen && classes(g[0]) == own) {
            Some(group) => group.push(scheme),
            None => groups.push(vec![scheme]),
        }
    }
    groups
}

fn figure(group: &[&TopViewRow], plan: &Plan, ground: &str) -> String {
    let row = group[0];
    let (mut drawn, mut off_page, mut lost) = (String::new(), 0, 0);
    for truth in row.cameras.iter().filter_map(|camera| camera.truth) {
        let wedge = plan.wedge(&truth, 15.0);
        let _ = write!(drawn, "<path class=\"truecam\" stroke-width=\"1.5\" d=\"{wedge}\"/>");
    }
    for camera in &row.cameras {
        if let Some(pose) = camera.estimate.filter(CameraFromWorld::is_finite) {
            if plan.holds(plan.place(pose.center().coords)) {
                let _ =
                    write!(drawn, "<path class=\"{}\" d=\"{}\"/>", class(camera), plan.wedge(&pose, 10.0));
            } else {
                off_page += 1;
            }
        } else {
            lost += 1;
            let Some(truth) = camera.truth else { continue };
            let q = plan.place(truth.center().coords);
            let (x, y) = (q.x - 5.0, q.y - 5.0);
            let cross = format!("M{x:.1} {y:.1}l10 10m0 -10l-10 10");
            let _ = write!(drawn, "<path class=\"lost\" stroke-width=\"2\" d=\"{cross}\"/>");
        }
    }
    let mut words = format!("{} of {} localized.", row.cameras.len() - lost, row.cameras.len());
    if off_page > 0 {
        let _ = write!(words, " {off_page} estimated so far away that they are off this page.");
    }
    let names: Vec<String> = group.iter().map(|row| escape(&row.name)).collect();
    let name = names.join(", ");
    if group.len() > 1 {
        words.push_str(" The same under each of these schemes; the first is drawn.");
    }
    format!(
        "<figure><svg viewBox=\"0 0 {WIDTH:.0} {:.0}\" role=\"img\" aria-label=\"The place from above, {name}\">{ground}{drawn}{}\
         </svg><figcaption><b>{name}.</b> {words}</figcaption></figure>",
        plan.height,
        plan.scale_bar()
    )
}

/// From the map to the page.
pub(super) struct Plan {
    right: Vector3<f64>,
    up: Vector3<f64>,
    low: Vector2<f64>,
    /// Page units per metre.
    scale: f64,
    pub(super) height: f64,
}

impl Plan {
    /// Fits all but the farthest map points and every true camera. `None` when there is nothing finite to show.
    pub(super) fn new(view: &TopView<'_>) -> Option<Self> {
        let (right, up) = (Vector3::from(view.right), Vector3::from(view.up));
        let flat = |p: Vector3<f64>| Vector2::new(right.dot(&p), up.dot(&p));
        let queries =
            view.rows.iter().flat_map(|row| &row.cameras).filter_map(|camera| camera.truth.as_ref());
        let cameras = view.mapping.iter().chain(queries).filter(|pose| pose.is_finite());
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
        let rim = 0.06 * (x.1 - x.0).max(y.1 - y.0) + 0.2;
        let low = Vector2::new(x.0 - rim, y.0 - rim);
        let (wide, tall) = (x.1 - x.0 + 2.0 * rim, y.1 - y.0 + 2.0 * rim);
        let scale = (WIDTH / wide).min(WIDTH * 1.4 / tall);
        // A tall place is centred on the page.
        let low = Vector2::new(low.x - (WIDTH / scale - wide) / 2.0, low.y);
        Some(Self { right, up, low, scale, height: scale * tall })
    }

    /// The map's points and the cameras of its images.
    pub(super) fn ground(&self, view: &TopView<'_>) -> String {
        let step = view.points.len().div_ceil(MOST_POINTS).max(1);
        let mut cloud = String::new();
        for p in view.points.iter().step_by(step) {
            let q = self.place(Vector3::from(*p));
            if self.holds(q) {
                let _ = write!(cloud, "M{:.1} {:.1}h0", q.x, q.y);
            }
        }
        let mut ground = format!("<path class=\"mappoint\" stroke-width=\"1.6\" d=\"{cloud}\"/>");
        for pose in view.mapping.iter().step_by(view.mapping.len().div_ceil(MOST_CAMERAS).max(1)) {
            let wedge = self.wedge(pose, 7.0);
            let _ = write!(ground, "<path class=\"mapcam\" stroke-width=\"1\" d=\"{wedge}\"/>");
        }
        ground
    }

    fn place(&self, p: Vector3<f64>) -> Vector2<f64> {
        let x = self.scale * (self.right.dot(&p) - self.low.x);
        Vector2::new(x, self.height - self.scale * (self.up.dot(&p) - self.low.y))
    }

    fn holds(&self, q: Vector2<f64>) -> bool {
        (0.0..=WIDTH).contains(&q.x) && (0.0..=self.height).contains(&q.y)
    }

    /// A triangle with its tip in the projection centre, open to where the camera looks.
    fn wedge(&self, pose: &CameraFromWorld, size: f64) -> String {
        let forward = pose.rotation().inverse() * Vector3::z();
        let d = Vector2::new(self.right.dot(&forward), -self.up.dot(&forward));
        let d = d.try_normalize(1e-9).unwrap_or_else(Vector2::x);
        let side = Vector2::new(-d.y, d.x) * 0.45;
        let tip = self.place(pose.center().coords);
        let (a, b) = (tip + (d + side) * size, tip + (d - side) * size);
        format!("M{:.1} {:.1}L{:.1} {:.1}L{:.1} {:.1}Z", tip.x, tip.y, a.x, a.y, b.x, b.y)
    }

    /// A bar of a round length.
    fn scale_bar(&self) -> String {
        let wanted = 90.0 / self.scale;
        let power = 10f64.powf(wanted.log10().floor());
        let metres = [5.0, 2.0, 1.0].into_iter().map(|m| m * power).find(|m| *m <= wanted).unwrap_or(power);
        let (y, long) = (self.height - 14.0, metres * self.scale);
        format!(
            "<path class=\"axis\" d=\"M14 {:.1}v8m0 -4h{long:.1}m0 -4v8\"/><text x=\"{:.1}\" y=\"{:.1}\">{}</text>",
            y - 4.0,
            20.0 + long,
            y + 4.0,
            length(Some(metres)).replace(".00 ", " ").replace(".0 ", " ")
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scheme(name: &str, off: Option<f64>) -> TopViewRow {
        let at =
            |x: f64| CameraFromWorld::from_quaternion([1.0, 0.0, 0.0, 0.0], [x, 0.0, 0.0]).expect("a pose");
        let camera = |truth, estimate| TopCamera { truth: Some(truth), estimate, state: None };
        TopViewRow {
            name: name.to_owned(),
            cameras: vec![camera(at(0.0), off.map(at)), camera(at(1.0), Some(at(1.0)))],
        }
    }

    #[test]
    fn schemes_that_look_alike_share_a_drawing_and_others_do_not() {
        let (a, b, lost) =
            (scheme("points", Some(0.01)), scheme("dcl", Some(0.02)), scheme("random-lines", None));
        let (far, farther) = (scheme("points", Some(1.0)), scheme("dcl", Some(2.0)));
        assert_eq!(alike(&[a.clone(), lost, b.clone()]).iter().map(Vec::len).collect::<Vec<_>>(), [2, 1]);
        assert_eq!(alike(&[far, farther]).len(), 2, "they are drawn at different places");
        assert_eq!(alike(&[a, scheme("dcl", Some(0.2)), b]).len(), 2);
    }
}
