//! L11, the image border in descriptors: a descriptor whose window crosses the image border has cells without
//! gradients, which reveals that its keypoint is near the border. A device therefore describes the image continued by
//! its mirror image.
//!
//! `research/notes/border.py` trains a stronger classifier; docs/reference/privacy-rules.md reports its results.

use super::common;

use std::path::{Path, PathBuf};

use common::{profile, rng, seal_with_truth};
use image::{GrayImage, Luma};
use rand::Rng;
use veiloc_features::{Extractor, Extractors, Features, Image, Limits, Sift, extract_image, guessed_camera};
use veiloc_geometry::{Intrinsics, Pixel};
use veiloc_obfuscation::{SealOptions, Sealer};
use veiloc_testdata::real_data_test;

/// A row as the server sees it, with the ground truth.
struct Row {
    image: usize,
    descriptor: Vec<u8>,
    /// Whether the keypoint is within 16 pixels of the border of the sealed image.
    near: bool,
}

/// Features as a device extracts them.
fn shipped(path: &Path, camera: &Intrinsics) -> (Features, Intrinsics) {
    extracted_by(SealOptions::default(), path, camera)
}

fn extracted_by(options: SealOptions, path: &Path, camera: &Intrinsics) -> (Features, Intrinsics) {
    let sealer = Sealer::new(&profile(), options).expect("its profile");
    let extracted = sealer.extract(Image::open(path).expect("an image"), *camera).expect("extracted");
    (extracted.features().clone(), extracted.camera().intrinsics)
}

/// All features of the image, without continuing it: the leak.
fn with_border(path: &Path, camera: &Intrinsics) -> (Features, Intrinsics) {
    let limits = Limits { max_keypoints: 4096, max_side: 1600 };
    let image = extract_image(path, Some((camera.width, camera.height)), &Sift::default(), limits);
    let image = image.expect("extracted");
    (image.features, camera.resized(image.size.0, image.size.1))
}

/// Share of features with an empty descriptor cell, among those within 8 pixels of the border of an image of this size.
fn empty_cells(features: &Features, size: &Intrinsics) -> f64 {
    let (width, height) = (f64::from(size.width), f64::from(size.height));
    let near = |i: &usize| {
        let Pixel { u, v } = features.keypoints[*i].pixel;
        u.min(v).min(width - u).min(height - v) < 8.0
    };
    let near: Vec<usize> = (0..features.keypoints.len()).filter(near).collect();
    assert!(near.len() > 20, "{} features near the border", near.len());
    let empty = near.iter().filter(|i| emptiest(features.descriptors.row(**i))[1] == 0).count();
    empty as f64 / near.len() as f64
}

/// An image with keypoints everywhere, up to its border.
fn noise(folder: &Path, width: u32, height: u32) -> PathBuf {
    let mut rng = rng(5);
    let path = folder.join("noise.png");
    GrayImage::from_fn(width, height, |_, _| Luma([rng.random_range(0..=255)])).save(&path).expect("written");
    path
}

#[test]
fn l11_descriptors_at_the_border_have_no_empty_cells() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = noise(folder.path(), 640, 480);
    let camera = guessed_camera(&path).expect("an image");
    let (leak, size) = with_border(&path, &camera);
    let leaked = empty_cells(&leak, &size);
    assert!(leaked > 0.05, "the measure does not see the leak: {leaked}");
    let (features, size) = shipped(&path, &camera);
    assert!(empty_cells(&features, &size) < 0.01, "{}", empty_cells(&features, &size));
}

/// An extractor that does not continue the image drops keypoints whose window crosses the border.
#[test]
fn l11_other_extractors_drop_border_keypoints() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = noise(folder.path(), 640, 480);
    let camera = guessed_camera(&path).expect("an image");
    let options = SealOptions::default().with_extractors(Extractors::default());
    let (features, size) = extracted_by(options, &path, &camera);
    let over = |features: &Features| {
        let whole = features.clone().whole((size.width, size.height), Sift::default().support_radius());
        features.keypoints.len() - whole.keypoints.len()
    };
    let (leak, _) = with_border(&path, &camera);
    assert!(over(&leak) > leak.keypoints.len() / 50, "the measure does not see the leak");
    assert_eq!(over(&features), 0);
}

/// Some of the training photos, which show other scenes than the maps: landscapes, objects and streets.
fn images(data: &Path) -> Vec<PathBuf> {
    let mut paths = Vec::new();
    for kind in ["nature", "objects", "streets"] {
        let folder = std::fs::read_dir(data.join("training-photos").join(kind)).expect("a folder");
        paths.extend(folder.map(|entry| entry.expect("an entry").path()));
    }
    paths.sort();
    paths.into_iter().step_by(16).collect()
}

fn sent(paths: &[PathBuf], extracted: impl Fn(&Path, &Intrinsics) -> (Features, Intrinsics)) -> Vec<Row> {
    let mut rows = Vec::new();
    for (image, path) in paths.iter().enumerate() {
        let (features, camera) = extracted(path, &guessed_camera(path).expect("an image"));
        let sealed =
            seal_with_truth(features, &camera, &profile(), &SealOptions::default(), &mut rng(image as u64));
        // An image with few keypoints may have none on one side.
        let Ok((query, truth)) = sealed else { continue };
        let size = query.camera();
        let (width, height) = (f64::from(size.width), f64::from(size.height));
        for (row, pixel) in truth.pixels.iter().enumerate().filter(|(row, _)| truth.source[*row].is_some()) {
            let nearest = pixel.u.min(pixel.v).min(width - pixel.u).min(height - pixel.v);
            let descriptor = query.descriptors().expect("rows").row(row).to_vec();
            rows.push(Row { image, descriptor, near: nearest < 16.0 });
        }
    }
    rows
}

/// The largest byte of each cell, for the two emptiest cells.
fn emptiest(descriptor: &[u8]) -> [u8; 2] {
    let mut most: Vec<u8> = descriptor.chunks(8).map(|cell| *cell.iter().max().expect("eight")).collect();
    most.sort_unstable();
    [most[0], most[1]]
}

/// Information that the two emptiest cells of a row give about whether it is near the border, bits per row: for all
/// rows, and for those near the border. The table is estimated on every second image and tested on the others.
fn border_bits(rows: &[Row]) -> [f64; 2] {
    const STEPS: [u8; 9] = [1, 2, 3, 4, 6, 8, 11, 15, 21];
    let step = |byte: u8| STEPS.iter().filter(|s| byte >= **s).count();
    let bin = |row: &Row| {
        let [first, second] = emptiest(&row.descriptor).map(step);
        first * (STEPS.len() + 1) + second
    };
    let mut counts = vec![[0.0_f64; 2]; (STEPS.len() + 1).pow(2)];
    let mut all = [0.0_f64; 2];
    for row in rows.iter().filter(|row| row.image % 2 == 0) {
        counts[bin(row)][usize::from(row.near)] += 1.0;
        all[usize::from(row.near)] += 1.0;
    }
    let prior = all.map(|n| n / (all[0] + all[1]));
    // Five pseudo-rows at the prior in each bin, so that bins without data give no information.
    let gain = |row: &Row| {
        let (seen, near) = (counts[bin(row)], usize::from(row.near));
        let share = (seen[near] + 5.0 * prior[near]) / (seen[0] + seen[1] + 5.0);
        (share / prior[near]).log2()
    };
    let mean = |chosen: &dyn Fn(&Row) -> bool| {
        let gains: Vec<f64> = rows.iter().filter(|row| row.image % 2 == 1 && chosen(row)).map(gain).collect();
        gains.iter().sum::<f64>() / gains.len() as f64
    };
    [mean(&|_| true), mean(&|row| row.near)]
}

/// `cargo test -p veiloc-obfuscation --test it border -- --nocapture` prints the results.
#[real_data_test]
fn l11_descriptors_do_not_reveal_the_border(data: &Path) {
    let paths = images(data);
    let (leak, real) = (sent(&paths, with_border), sent(&paths, shipped));
    let (leaked, real_bits) = (border_bits(&leak), border_bits(&real));
    let empty = |rows: &[Row]| rows.iter().filter(|row| emptiest(&row.descriptor)[0] == 0).count();
    let (all, sent) = (leak.len(), real.len());
    eprintln!(
        "bits of all rows and of those near the border: {leaked:.4?} of all {all}, {real_bits:.4?} of the {sent} sent"
    );
    eprintln!("rows with an empty cell: {} and {}", empty(&leak), empty(&real));
    // An attacker knows this prior without any descriptor: fewer keypoints lie near the border.
    let near = |rows: &[Row]| 100.0 * rows.iter().filter(|row| row.near).count() as f64 / rows.len() as f64;
    eprintln!("rows within 16 pixels of the border: {:.1} and {:.1} %", near(&leak), near(&real));
    assert!(leaked[0] > 0.008 && leaked[1] > 0.03, "the measure does not see the leak: {leaked:?}");
    assert!(real_bits[0] < 0.002 && real_bits[1] < 0.02, "{real_bits:?}");
    assert!(empty(&leak) > leak.len() / 500, "the measure does not see the leak: {}", empty(&leak));
    assert!(empty(&real) < real.len() / 10_000, "{} rows show an empty cell", empty(&real));
    // Only few rows are lost.
    assert!(sent * 100 > all * 99, "{sent} of {all}");
}
