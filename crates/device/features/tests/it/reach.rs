//! The window of a SIFT descriptor: not beyond `Extractor::support_radius`, and nearly as large; and its content beyond the
//! border.

use veiloc_features::{Extractor, Features, GrayImage, Image, Keypoint, Sift};
use veiloc_geometry::Pixel;

const SIDE: u32 = 240;

/// A texture with keypoints of several scales; beyond `radius` pixels from `centre` it is different.
fn texture(centre: Pixel, radius: f64) -> GrayImage {
    let value = |x: u32, y: u32| {
        let (u, v) = (f64::from(x) + 0.5, f64::from(y) + 0.5);
        let other = if (u - centre.u).hypot(v - centre.v) > radius { 1.7 } else { 1.0 };
        let wave = (0.31 * other * u + 0.07 * v).sin() * (0.11 * u - 0.23 * other * v).cos();
        (0.5 + 0.2 * (wave + (0.0021 * other * u * v).sin())) as f32
    };
    let samples = (0..SIDE).flat_map(|y| (0..SIDE).map(move |x| value(x, y))).collect();
    GrayImage::new(SIDE, SIDE, samples).expect("finite")
}

fn features(centre: Pixel, radius: f64) -> Features {
    Sift::default().extract(&Image::from(texture(centre, radius)), 4096).expect("extracted")
}

/// The largest byte difference between the descriptor of a keypoint and the one with its position, scale and
/// orientation in other features; `None` when there is none.
fn difference(here: &Features, index: usize, there: &Features) -> Option<u8> {
    let wanted = &here.keypoints[index];
    let same = |k: &Keypoint| {
        (k.pixel.u - wanted.pixel.u).hypot(k.pixel.v - wanted.pixel.v) < 0.01
            && (k.scale / wanted.scale - 1.0).abs() < 0.01
            && (k.orientation - wanted.orientation).abs() < 0.01
    };
    let found = there.keypoints.iter().position(same)?;
    let (a, b) = (here.descriptors.row(index), there.descriptors.row(found));
    a.iter().zip(b).map(|(a, b)| a.abs_diff(*b)).max()
}

#[test]
fn descriptor_window_extends_to_the_reach() {
    let reach = Sift::default().support_radius();
    let middle = Pixel::new(120.0, 120.0);
    let here = features(middle, f64::INFINITY);
    let (mut checked, mut nearer) = (0, 0);
    for index in 0..here.keypoints.len() {
        let Keypoint { pixel, scale, .. } = here.keypoints[index];
        let scale = f64::from(scale);
        // The blur reads a few scales farther than the weighted gradients.
        let far = (reach + 4.5) * scale;
        if far + (pixel.u - middle.u).hypot(pixel.v - middle.v) > 100.0 || checked == 12 {
            continue;
        }
        checked += 1;
        let beyond = difference(&here, index, &features(pixel, far));
        assert!(beyond.is_some_and(|d| d <= 1), "{beyond:?} from pixels beyond its reach");
        // A change well inside must be visible.
        nearer += usize::from(difference(&here, index, &features(pixel, 0.55 * reach * scale)) > Some(3));
    }
    assert!(checked == 12 && nearer > 8, "{nearer} of {checked} have nearly the declared reach");
}

#[test]
fn whole_features_have_their_disc_in_the_image() {
    let all = features(Pixel::new(0.0, 0.0), f64::INFINITY);
    let whole = all.clone().whole((SIDE, SIDE), 10.0);
    let side = f64::from(SIDE);
    let inside = |k: &Keypoint| {
        let radius = 10.0 * f64::from(k.scale);
        [k.pixel.u, k.pixel.v].iter().all(|at| *at >= radius && *at + radius <= side)
    };
    let expected: Vec<usize> = (0..all.keypoints.len()).filter(|i| inside(&all.keypoints[*i])).collect();
    assert!(!expected.is_empty() && expected.len() < all.keypoints.len(), "{} of them", expected.len());
    assert_eq!(whole.keypoints, expected.iter().map(|i| all.keypoints[*i]).collect::<Vec<_>>());
    assert!(whole.descriptors == all.descriptors.select(expected));
    // With zero reach nothing is dropped.
    assert!(all.clone().whole((SIDE, SIDE), 0.0) == all);
}

/// A mirrored border equals that of the image continued by its mirror image, and changes nothing inside.
#[test]
fn sealing_mirrors_the_border() {
    const MARGIN: u32 = 80;
    let image = texture(Pixel::new(0.0, 0.0), f64::INFINITY);
    let mirrored = Sift::for_sealing().extract(&Image::from(image.clone()), 4096).expect("extracted");
    let cut = Sift::default().extract(&Image::from(image.clone()), 4096).expect("extracted");
    let at = |x: u32| {
        let x = (i64::from(x) - i64::from(MARGIN)).rem_euclid(2 * i64::from(SIDE));
        x.min(2 * i64::from(SIDE) - 1 - x) as usize
    };
    let side = SIDE + 2 * MARGIN;
    let samples = (0..side).flat_map(|y| {
        let row = image.row(at(y) as u32);
        (0..side).map(move |x| row[at(x)])
    });
    let continued = GrayImage::new(side, side, samples.collect()).expect("finite");
    let mut there = Sift::default().extract(&Image::from(continued), 40_000).expect("extracted");
    for keypoint in &mut there.keypoints {
        keypoint.pixel.u -= f64::from(MARGIN);
        keypoint.pixel.v -= f64::from(MARGIN);
    }
    let reach = Sift::default().support_radius();
    let (mut inside, mut over, mut found, mut changed) = (0, 0, 0, 0);
    for (index, keypoint) in mirrored.keypoints.iter().enumerate() {
        let (u, v) = (keypoint.pixel.u, keypoint.pixel.v);
        let nearest = u.min(v).min(f64::from(SIDE) - u).min(f64::from(SIDE) - v);
        // A sample or two at the border have no neighbour of their own.
        if nearest > reach * f64::from(keypoint.scale) + 8.0 {
            inside += 1;
            assert_eq!(difference(&mirrored, index, &cut), Some(0), "{keypoint:?}");
        } else if nearest < 0.5 * reach * f64::from(keypoint.scale) {
            over += 1;
            // The blur of the scale space also reads the border, so that some keypoints move.
            found += usize::from(difference(&mirrored, index, &there).is_some_and(|d| d <= 12));
            changed += usize::from(difference(&mirrored, index, &cut).is_none_or(|d| d > 12));
        }
    }
    assert!(inside > 20 && over > 20, "{inside} and {over}");
    assert!(found * 3 > over && changed * 2 > over, "{found} and {changed} of {over}");
    assert!(Sift::for_sealing().support_radius() < 1e-9);
}
