//! Pencils compared with closed forms, random keypoints and finite differences.

use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::Rotation3;

use super::*;

const SIZE: [u32; 2] = [640, 480];

fn stripes(anchors: &[AnchorPosition]) -> Layout {
    let count = (24 / anchors.len() * anchors.len()) as u16;
    Layout::new(anchors, Sectors { axis: 1.17, count, shift: 0.3 }, None).expect("closes")
}

/// Layouts of all kinds: the paper's, stripes, anchors outside and at infinity, three anchors, a checkerboard.
fn layouts() -> Vec<Layout> {
    let at = |x, y| AnchorPosition::At([x, y]);
    let board = Sectors { axis: 0.0, count: 16, shift: 0.5 };
    vec![
        Layout::halves(FRAC_PI_2, 1.0).expect("finite"),
        Layout::halves(0.4, 3.0).expect("finite"),
        stripes(&[at(-0.12, -0.49), at(1.5, 0.0)]),
        stripes(&[AnchorPosition::Toward(FRAC_PI_2), AnchorPosition::Toward(0.0)]),
        stripes(&[at(0.0, 0.0), at(0.7, 0.7), AnchorPosition::Toward(2.0)]),
        Layout::new(
            &[AnchorPosition::Toward(FRAC_PI_2), AnchorPosition::Toward(0.0)],
            Sectors { axis: FRAC_PI_2, ..board },
            Some(board),
        )
        .expect("closes"),
    ]
}

/// Identity, a small rotation, one that moves the anchors out of view, one that looks backwards.
fn turns() -> [Rotation3<f64>; 4] {
    [[0.0, 0.0, 0.0], [0.1, -0.2, 0.05], [0.3, 1.2, -0.4], [3.0, 0.1, 0.2]]
        .map(|[x, y, z]| Rotation3::from_euler_angles(x, y, z))
}

fn pixels() -> impl Iterator<Item = Pixel> + Clone {
    (0..200).map(|i| Pixel::new(f64::from(i * 97 % 640) + 0.3, f64::from(i * 53 % 480) + 0.7))
}

fn all() -> Vec<Pencils> {
    let turned = |layout| turns().map(|turn| Pencils::new(SIZE, 525.0, &layout, &turn).expect("possible"));
    layouts().into_iter().flat_map(turned).collect()
}

#[test]
fn layout_of_the_paper_is_reproduced() {
    let dcl = Pencils::paper(640, 480);
    let near = |a: Option<Pixel>, b: Pixel| a.expect("finite").distance(&b) < 1e-9;
    assert!(near(dcl.position(Anchor::FIRST), Pixel::new(320.0, 0.0)));
    assert!(near(dcl.position(Anchor::SECOND), Pixel::new(320.0, 480.0)));
    assert_eq!(dcl.anchor_of(Pixel::new(10.0, 300.0)), Anchor::FIRST);
    assert_eq!(dcl.anchor_of(Pixel::new(600.0, 300.0)), Anchor::SECOND);
    assert_eq!(dcl.anchor_of(Pixel::new(320.0, 123.0)), Anchor::FIRST);
    assert!((dcl.distance(Anchor::FIRST, Pixel::new(320.0, 123.0)) - 123.0).abs() < 1e-9);
    let horizontal = Pencils::of_image(SIZE, &Layout::halves(0.0, 1.0).expect("finite"));
    assert!(near(horizontal.position(Anchor::FIRST), Pixel::new(80.0, 240.0)));
    assert_eq!(horizontal.anchor_of(Pixel::new(10.0, 470.0)), Anchor::FIRST);
    assert_eq!(horizontal.anchor_of(Pixel::new(10.0, 240.0)), Anchor::FIRST);
    assert_eq!(horizontal.anchor_of(Pixel::new(600.0, 20.0)), Anchor::SECOND);
}

#[test]
fn keypoints_are_on_their_lines_within_the_spans() {
    for pencils in all() {
        for x in pixels() {
            let anchor = pencils.anchor_of(x);
            let angle = pencils.angle_of(anchor, x);
            assert!((0.0..TAU).contains(&angle));
            assert!(pencils.admits(anchor, x, 0.0));
            assert!(pencils.ahead(anchor, angle).dot(&x.homogeneous()) > 0.0);
            let line = pencils.line(anchor, angle).expect("it meets the image");
            assert!(line.signed_distance(x).abs() < 1e-6, "{}", line.signed_distance(x));
            let along = pencils.along(anchor, angle).expect("it meets the image");
            let t = (x.vector() - along.origin.vector()).dot(&along.direction);
            assert!(along.at(t).distance(&x) < 1e-5);
            let spans = pencils.spans(anchor, angle);
            assert!(spans.iter().any(|s| s.near - 1e-6 <= t && t <= s.far + 1e-6), "{t} {spans:?}");
            let distance = along.offset + along.slope * t;
            assert!((distance - pencils.distance(anchor, x)).abs() < 1e-6 * (1.0 + distance));
        }
    }
}

#[test]
fn spans_agree_with_admits() {
    for pencils in all() {
        for x in pixels().step_by(7) {
            let anchor = pencils.anchor_of(x);
            let angle = pencils.angle_of(anchor, x);
            let along = pencils.along(anchor, angle).expect("it meets the image");
            let spans = pencils.spans(anchor, angle);
            for step in -900..900 {
                let t = f64::from(step) + 0.37;
                let pixel = along.at(t);
                let inside = pencils.camera().contains(pixel, 0.0)
                    && pencils.anchor_of(pixel) == anchor
                    && pencils.ahead(anchor, angle).dot(&pixel.homogeneous()) > 0.0;
                let edge = spans.iter().any(|s| (s.near - t).abs() < 1e-3 || (s.far - t).abs() < 1e-3);
                let held = spans.iter().any(|s| s.near <= t && t <= s.far);
                assert!(edge || held == inside, "{t} {spans:?}");
            }
        }
    }
}

#[test]
fn pixels_per_radian_agrees_with_finite_differences() {
    for pencils in all() {
        for x in pixels().step_by(3) {
            let anchor = pencils.anchor_of(x);
            let angle = pencils.angle_of(anchor, x);
            let Some(turned) = pencils.line(anchor, angle + 1e-6) else { continue };
            let moved = turned.signed_distance(x).abs() / 1e-6;
            let predicted = pencils.pixels_per_radian(anchor, angle) * pencils.distance(anchor, x);
            assert!((moved - predicted).abs() < 1e-3 * (1.0 + predicted), "{moved} {predicted}");
        }
    }
}

#[test]
fn rotating_the_layout_rotates_everything() {
    // A direction in space keeps its anchor and its angle for every orientation of the camera.
    for layout in layouts() {
        let still = Pencils::new(SIZE, 525.0, &layout, &Rotation3::identity()).expect("possible");
        let turn = Rotation3::from_euler_angles(0.05, -0.12, 0.2);
        let turned = Pencils::new(SIZE, 525.0, &layout, &turn).expect("possible");
        let mut seen = 0;
        for x in pixels() {
            let ray = turn * still.camera().unproject(x).homogeneous();
            let there = still.camera().project(crate::PlanePoint::new(ray.x / ray.z, ray.y / ray.z));
            if !still.camera().contains(there, 0.0) {
                continue;
            }
            seen += 1;
            let anchor = still.anchor_of(x);
            assert_eq!(turned.anchor_of(there), anchor);
            let difference = turned.angle_of(anchor, there) - still.angle_of(anchor, x);
            assert!((difference + PI).rem_euclid(TAU) - PI < 1e-9);
        }
        assert!(seen > 100);
    }
}

#[test]
fn arc_is_exactly_the_angles_of_the_image() {
    for pencils in all() {
        for anchor in pencils.anchors() {
            let arc = pencils.arc(anchor);
            let mut ends = (1.0_f64, 0.0_f64);
            let border =
                (0..=640).flat_map(|i| [[i, 0], [i, 480]]).chain((0..=480).flat_map(|i| [[0, i], [640, i]]));
            for [u, v] in border {
                let share = arc.share(pencils.angle_of(anchor, Pixel::new(f64::from(u), f64::from(v))));
                assert!((-1e-6..=1.0 + 1e-6).contains(&share), "{share}");
                ends = (ends.0.min(share), ends.1.max(share));
            }
            assert!(ends.0 < 0.01 && ends.1 > 0.99, "{ends:?} {arc:?}");
        }
    }
    let paper = Pencils::paper(640, 480);
    assert!(paper.anchors().all(|a| (paper.arc(a).length - PI).abs() < 1e-6));
}

#[test]
fn margins_extend_over_borders() {
    let dcl = Pencils::paper(640, 480);
    for (u, margin, both) in
        [(321.0, 2.0, true), (325.0, 2.0, false), (318.5, 2.0, true), (310.0, 0.0, false)]
    {
        let x = Pixel::new(u, 200.0);
        let admitted = dcl.anchors().filter(|a| dcl.admits(*a, x, margin)).count();
        assert_eq!(admitted, if both { 2 } else { 1 }, "{u} {margin}");
    }
}

#[test]
fn invalid_cameras_are_rejected() {
    let layout = layouts()[0];
    for focal in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(Pencils::new(SIZE, focal, &layout, &Rotation3::identity()).is_none());
    }
    assert!(Pencils::new([0, 480], 500.0, &layout, &Rotation3::identity()).is_none());
}

#[test]
fn random_assignment_admits_every_anchor_everywhere() {
    let halves = Layout::halves(FRAC_PI_2, 1.0).expect("finite");
    let [own, random] = [halves, halves.with_random_assignment()].map(|l| Pencils::of_image([640, 480], &l));
    for (u, v) in [(100.0, 200.0), (500.0, 470.0), (320.0, 240.0)] {
        let pixel = Pixel::new(u, v);
        for anchor in Anchor::BOTH {
            assert!(random.admits(anchor, pixel, 0.0));
            let angle = random.angle_of(anchor, pixel);
            let (line, spans) =
                (random.along(anchor, angle).expect("it meets the image"), random.spans(anchor, angle));
            let t = line.direction.dot(&(pixel.vector() - line.origin.vector()));
            assert!(
                spans.len() == 1 && spans[0].near <= t && t <= spans[0].far,
                "{anchor:?} {pixel:?} {spans:?}"
            );
        }
        assert!(random.clearance(pixel).is_infinite());
    }
    let left = Pixel::new(100.0, 200.0);
    assert!(!own.admits(Anchor::SECOND, left, 0.0), "in halves a pixel has one anchor");
}
