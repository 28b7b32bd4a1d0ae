//! Our keypoints compared with those of an independent pipeline on the same image. Needs `VEILOC_DATA`.

use std::path::Path;

use veiloc_datasets::problem_files::{KeypointImage, keypoints_of_image, read_keypoints};
use veiloc_features::Sift;
use veiloc_protocol::ExtractionLimits;
use veiloc_testdata::real_data_test;

/// Row `i` as a unit vector.
fn unit(image: &KeypointImage, i: usize) -> Vec<f64> {
    let row: Vec<f64> =
        image.descriptors.as_ref().expect("descriptors").view().values(i).map(f64::from).collect();
    let norm = row.iter().map(|x| x * x).sum::<f64>().sqrt();
    row.iter().map(|x| x / norm).collect()
}

#[real_data_test]
fn descriptor_layout_equals_problem_files(data: &Path) {
    // The images of some frames in RedKitchen's file are missing.
    let all = read_keypoints(&data.join("problems/herzjesu_keypoints.jsonl.gz")).expect("keypoints");
    let theirs = all.iter().find(|p| p.name == "0002.jpg").expect("the image");
    let limits = ExtractionLimits { max_keypoints: 4096, max_image_side: 1024 };
    let ours = keypoints_of_image(&data.join("herzjesu/images/0002.jpg"), &Sift::default(), limits)
        .expect("an image");
    assert_eq!((ours.width, ours.height), (theirs.width, theirs.height));

    let cosine = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
    let (mut met, mut alike, mut shifted) = (0, 0, 0);
    for (i, p) in ours.keypoints.iter().enumerate() {
        let near = (0..theirs.keypoints.len()).filter(|j| theirs.keypoints[*j].distance(p) < 0.5);
        let mine = unit(&ours, i);
        let mut turned = mine.clone();
        turned.rotate_left(1); // another order of the directions
        let best = |mine: &[f64]| near.clone().map(|j| cosine(mine, &unit(theirs, j))).fold(0.0, f64::max);
        met += usize::from(near.clone().next().is_some());
        alike += usize::from(best(&mine) > 0.9);
        shifted += usize::from(best(&turned) > 0.9);
    }
    eprintln!("{met} met, {alike} alike, {shifted} alike with directions turned by one");
    assert!(met > 1500, "{met}");
    assert!(f64::from(alike as u32) > 0.6 * met as f64, "{alike} of {met}");
    assert!(shifted < met / 20, "{shifted} of {met}");
}
