//! Real photographs, found by `VEILOC_DATA`.

use std::collections::BTreeSet;
use std::path::Path;

use veiloc_map::colmap::{ColmapModel, read_model};
use veiloc_testdata::real_data_test;

use crate::import::recomputed_error;
use crate::{BuildOptions, MappingError, add, build, import, remove};

/// COLMAP's convention of pixels, poses and distortion is ours: we find the errors that it wrote down, as far as the six
/// digits of its text go. (COLMAP itself, reading this file, finds them within 0.0043 px: `update_point_3d_errors`.)
#[real_data_test]
fn errors_of_a_colmap_model_are_what_the_file_says(data: &Path) {
    let colmap = read_model(&data.join("lund-door/sparse")).unwrap();
    let (mut told, mut own) = (0.0, 0.0);
    for point in colmap.points() {
        let error = recomputed_error(&colmap, point).unwrap();
        assert!((error - point.error).abs() < 0.005, "point {}: {error}, told {}", point.id, point.error);
        (told, own) = (told + point.error, own + error);
    }
    assert!((own / told - 1.0).abs() < 1e-4, "means {own} and {told}");
}

/// The model cut down to these images; points that fewer than two of them see go.
fn cut(model: &ColmapModel, names: &[&str]) -> ColmapModel {
    let mut images: Vec<_> =
        model.images().iter().filter(|i| names.contains(&i.name.as_str())).cloned().collect();
    let ids: BTreeSet<u32> = images.iter().map(|i| i.id).collect();
    let mut points = model.points().to_vec();
    for point in &mut points {
        point.track.retain(|(image, _)| ids.contains(image));
    }
    points.retain(|p| p.track.len() > 1);
    let kept: BTreeSet<u64> = points.iter().map(|p| p.id).collect();
    for keypoint in images.iter_mut().flat_map(|i| &mut i.points2d) {
        keypoint.point = keypoint.point.filter(|p| kept.contains(p));
    }
    let cameras = model.cameras().iter().map(|(id, c)| (*id, *c)).collect();
    ColmapModel::new(cameras, images, points).unwrap()
}

#[real_data_test]
fn a_colmap_model_is_imported_with_its_points(data: &Path) {
    let whole = read_model(&data.join("lund-door/sparse")).unwrap();
    let colmap = cut(&whole, &["DSC_0004.JPG", "DSC_0005.JPG", "DSC_0006.JPG"]);
    let options = BuildOptions { max_keypoints: 1000, max_image_side: 2000, ..BuildOptions::default() };
    let (model, report) = import(&colmap, &data.join("lund-door/images"), &options, &()).unwrap();
    model.validate().unwrap();
    assert_eq!((report.images, report.points), (3, colmap.points().len()));
    assert!(report.points_kept * 10 > 8 * report.points, "{report}");
    assert!(model.images.iter().all(|i| i.keypoints.len() >= 1000));
    assert!(report.map_error_px < 1.5, "{report}");
    let known: Vec<_> = colmap.points().iter().map(|p| p.position).collect();
    assert!(model.points.iter().all(|p| known.contains(&p.position)), "positions are COLMAP's");
    let elsewhere = cut(&whole, &[]);
    assert!(matches!(import(&elsewhere, data, &options, &()), Err(MappingError::EmptyList)));
}

#[real_data_test]
fn a_map_of_redkitchen_loses_and_regains_an_image(data: &Path) {
    let posed = read_model(&data.join("redkitchen/posed")).unwrap();
    let images = data.join("redkitchen/images");
    let names: Vec<String> = posed.image_names().into_iter().step_by(2).take(8).collect();
    let options = BuildOptions { max_keypoints: 1000, vocabulary_words: 16, ..BuildOptions::default() };
    let before = build(&posed, &images, &names, &options, &()).unwrap();
    before.validate().unwrap();
    assert!(before.points.len() > 500, "{} points", before.points.len());
    assert!(before.mean_track_length() > 3.5, "{}", before.mean_track_length());
    assert!(before.mean_reprojection_error() < 1.2, "{} px", before.mean_reprojection_error());

    let mut model = before.clone();
    let one = [names[3].clone()];
    assert!(matches!(
        add(&mut model, &posed, &images, &one, &()),
        Err(MappingError::AlreadyInMap { name }) if name == names[3]
    ));
    remove(&mut model, &one).unwrap();
    model.validate().unwrap();
    assert!(model.points.len() < before.points.len());
    let untouched = before.points.iter().filter(|p| p.track.iter().all(|o| o.image < 3)).count();
    let still =
        before.points.iter().filter(|p| p.track.iter().all(|o| o.image < 3) && model.points.contains(p));
    assert_eq!(still.count(), untouched);
    add(&mut model, &posed, &images, &one, &()).unwrap();
    model.validate().unwrap();
    let (now, then) = (model.points.len() as f64, before.points.len() as f64);
    assert!((now / then - 1.0).abs() < 0.06, "{now} points, {then} before");
    assert_eq!(model.profile, before.profile);

    // Images that share nothing: no map.
    let far: Vec<String> = vec![names[0].clone()];
    assert!(matches!(
        build(&posed, &images, &far, &options, &()),
        Err(MappingError::NoPoints { images: 1, .. })
    ));
}
