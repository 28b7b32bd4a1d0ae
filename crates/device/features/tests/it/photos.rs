//! Real photographs under known homographies. Needs the environment variable `VEILOC_DATA`.

use std::path::Path;

use veiloc_features::{Features, GrayImage, SiftOptions, extract_sift, load_gray};
use veiloc_testdata::real_data_test;

/// `x = a u + b v + c, y = d u + e v + f`
type Affine = [f64; 6];

fn apply([a, b, c, d, e, f]: Affine, u: f64, v: f64) -> (f64, f64) {
    (a * u + b * v + c, d * u + e * v + f)
}

/// Rotates by `degrees` and scales about the centre of an image.
fn about_centre(image: &GrayImage, degrees: f64, scale: f64) -> Affine {
    let (sin, cos) = degrees.to_radians().sin_cos();
    let (cu, cv) = (f64::from(image.width()) / 2.0, f64::from(image.height()) / 2.0);
    let (cos, sin) = (scale * cos, scale * sin);
    [cos, -sin, cu - cos * cu + sin * cv, sin, cos, cv - sin * cu - cos * cv]
}

/// The warped image: nine bilinear samples averaged per pixel, the border continued.
fn warped(image: &GrayImage, affine: Affine) -> GrayImage {
    let [a, b, c, d, e, f] = affine;
    let det = a * e - b * d;
    let inverse = [e / det, -b / det, (b * f - c * e) / det, -d / det, a / det, (c * d - a * f) / det];
    let (width, height) = (image.width(), image.height());
    let sample = |u: f64, v: f64| {
        let x = (u - 0.5).clamp(0.0, f64::from(width - 1));
        let y = (v - 0.5).clamp(0.0, f64::from(height - 1));
        let (fx, fy) = ((x - x.floor()) as f32, (y - y.floor()) as f32);
        let (x, y) = (x as usize, y as u32);
        let (right, below) = ((x + 1).min(width as usize - 1), (y + 1).min(height - 1));
        let mix = |row: &[f32]| row[x] * (1.0 - fx) + row[right] * fx;
        mix(image.row(y)) * (1.0 - fy) + mix(image.row(below)) * fy
    };
    let pixel = |i: u32| {
        let mut sum = 0.0;
        for k in 0..9u32 {
            let u = f64::from(i % width) + f64::from(2 * (k % 3) + 1) / 6.0;
            let v = f64::from(i / width) + f64::from(2 * (k / 3) + 1) / 6.0;
            let (u, v) = apply(inverse, u, v);
            sum += sample(u, v);
        }
        sum / 9.0
    };
    GrayImage::new(width, height, (0..width * height).map(pixel).collect()).expect("finite")
}

/// Share of keypoints (at least 16 px inside) with one of the other image's within 1.5 px; mean offset of those.
fn repeatability(
    here: &Features,
    there: &Features,
    affine: Affine,
    [width, height]: [f64; 2],
) -> (f64, [f64; 2]) {
    let (mut inside, mut repeated, mut bias) = (0, 0, [0.0; 2]);
    for keypoint in &here.keypoints {
        let (u, v) = apply(affine, keypoint.pixel.u, keypoint.pixel.v);
        if u < 16.0 || v < 16.0 || u > width - 16.0 || v > height - 16.0 {
            continue;
        }
        inside += 1;
        let offsets = there.keypoints.iter().map(|k| [k.pixel.u - u, k.pixel.v - v]);
        let nearest = offsets.min_by(|a, b| a[0].hypot(a[1]).total_cmp(&b[0].hypot(b[1])));
        let Some([du, dv]) = nearest.filter(|[du, dv]| du.hypot(*dv) < 1.5) else { continue };
        repeated += 1;
        bias = [bias[0] + du, bias[1] + dv];
    }
    (f64::from(repeated) / f64::from(inside), bias.map(|sum| sum / f64::from(repeated)))
}

#[real_data_test]
fn keypoints_are_repeatable(data: &Path) {
    let mut options = SiftOptions::default();
    options.max_keypoints = 1024;
    for photo in
        ["photos/01.jpg", "photos/10265353_3838484249.jpg", "redkitchen/images/frame-000000.color.jpg"]
    {
        let image = load_gray(&data.join(photo)).expect("an image");
        let here = extract_sift(&image, &options);
        assert!(here.keypoints.len() == 1024, "{photo}: {}", here.keypoints.len());
        for (degrees, scale, expected) in [(30.0, 1.0, 0.75), (0.0, 0.7, 0.58), (-100.0, 0.85, 0.7)] {
            let affine = about_centre(&image, degrees, scale);
            let there = extract_sift(&warped(&image, affine), &options);
            let size = [f64::from(image.width()), f64::from(image.height())];
            let (share, bias) = repeatability(&here, &there, affine, size);
            eprintln!("{photo}, {degrees} degrees, scale {scale}: {share:.3}, bias {bias:.3?}");
            assert!(share > expected, "{photo}, {degrees} degrees, scale {scale}: {share}");
            assert!(bias.iter().all(|b| b.abs() < 0.03), "{photo}, {degrees} degrees: bias {bias:?}");
        }
    }
}
