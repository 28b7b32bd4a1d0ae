//! A map as one small drawing, for notebooks: its points from above, and the cameras of its images.

use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::nalgebra::Vector3;

use crate::top_view::{Plan, TopView, WIDTH};

/// Colours that can be told apart on light and on dark ground.
const STYLE: &str =
    ".mappoint{stroke:#8a8f98;stroke-linecap:round;fill:none}.mapcam{stroke:#2f7fd6;fill:none}";

/// A map from above as an SVG that stands alone; `None` when it has nothing finite to show.
///
/// `down` is the direction in which things fall, in the map's axes. Where nobody knows it, the cameras are taken to have been
/// held upright on the whole.
pub fn map_picture(
    points: &[[f64; 3]],
    cameras: &[CameraFromWorld],
    down: Option<[f64; 3]>,
) -> Option<String> {
    let held = || cameras.iter().map(|pose| pose.rotation().inverse() * Vector3::y()).sum::<Vector3<f64>>();
    let down = down.map_or_else(held, Vector3::from).try_normalize(1e-9).unwrap_or_else(|| -Vector3::z());
    // Seen from above, with the axis up the page that is the least upright of the first two.
    let ahead = if down.y.abs() < 0.9 { Vector3::y() } else { -Vector3::z() };
    let up = (ahead - down * down.dot(&ahead)).normalize();
    let right = up.cross(&-down);
    let view = TopView {
        id: String::new(),
        points,
        right: right.into(),
        up: up.into(),
        mapping: cameras,
        rows: Vec::new(),
    };
    let plan = Plan::new(&view)?;
    Some(format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH:.0} {:.0}\" width=\"360\" role=\"img\" \
         aria-label=\"The map from above\"><style>{STYLE}</style>{}</svg>",
        plan.height,
        plan.ground(&view)
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_map_is_drawn_from_above_and_nothing_from_nothing() {
        let points: Vec<[f64; 3]> = (0..50).map(|i| [f64::from(i % 7), f64::from(i / 7), 0.1]).collect();
        let camera = CameraFromWorld::identity();
        let drawn = map_picture(&points, &[camera], Some([0.0, 0.0, -1.0])).expect("points");
        assert!(drawn.starts_with("<svg xmlns=") && drawn.ends_with("</svg>"));
        assert_eq!(drawn.matches("h0").count(), 50, "every point, and none over another: {drawn}");
        assert_eq!(drawn.matches("mapcam\"").count(), 1);
        // Without a direction: by the camera, whose y axis is the world's.
        assert!(map_picture(&points, &[camera], None).is_some());
        assert!(map_picture(&[], &[], None).is_none());
        assert!(map_picture(&[[f64::NAN; 3]], &[], None).is_none());
    }
}
