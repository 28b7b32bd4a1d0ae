//! Tests with real images, found by `VEILOC_DATA`.

use std::collections::BTreeSet;
use std::path::Path;

use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::nalgebra::{Rotation3, UnitQuaternion, Vector3};
use veiloc_map::colmap::{ColmapModel, read_model, read_posed};
use veiloc_map::{PosedImage, PosedImages};
use veiloc_protocol::ExtractionLimits;
use veiloc_testdata::real_data_test;

use crate::build::import::recomputed_error;
use crate::importers::lines::pose_at;
use crate::{
    BadReason, BuildOptions, Input, InputMistake, MapWarning, MappingError, VocabularyUpdate, add, build,
    import, remove,
};

/// COLMAP's conventions of pixels, poses and distortion are ours: the recomputed errors equal the stored ones to the
/// six digits of the text file. (COLMAP itself, reading this file, reproduces them within 0.0043 px:
/// `update_point_3d_errors`.)
#[real_data_test]
fn recomputed_errors_equal_colmaps(data: &Path) {
    let colmap = read_model(&data.join("lund-door/sparse")).unwrap();
    let (mut stated, mut own) = (0.0, 0.0);
    for point in colmap.points() {
        let error = recomputed_error(&colmap, point).unwrap();
        assert!(
            (error - point.error).abs() < 0.005,
            "point {}: recomputed {error}, stated {}",
            point.id,
            point.error
        );
        (stated, own) = (stated + point.error, own + error);
    }
    assert!((own / stated - 1.0).abs() < 1e-4, "means {own} and {stated}");
}

/// The model restricted to these images; points with fewer than two of them are removed.
fn cut(model: &ColmapModel, names: &[&str]) -> ColmapModel {
    let mut images: Vec<_> =
        model.images().iter().filter(|i| names.contains(&i.name.as_str())).cloned().collect();
    let ids: BTreeSet<u32> = images.iter().map(|i| i.id).collect();
    let mut points = model.points().to_vec();
    for point in &mut points {
        point.track.retain(|(image, _)| ids.contains(image));
    }
    points.retain(|p| p.track.len() > 1);
    let point_ids: BTreeSet<u64> = points.iter().map(|p| p.id).collect();
    for keypoint in images.iter_mut().flat_map(|i| &mut i.points2d) {
        keypoint.point = keypoint.point.filter(|p| point_ids.contains(p));
    }
    let cameras = model.cameras().iter().map(|(id, c)| (*id, *c)).collect();
    ColmapModel::new(cameras, images, points).unwrap()
}

#[real_data_test]
fn a_colmap_model_is_imported_with_its_points(data: &Path) {
    let whole = read_model(&data.join("lund-door/sparse")).unwrap();
    let colmap = cut(&whole, &["DSC_0004.JPG", "DSC_0005.JPG", "DSC_0006.JPG"]);
    let mut options = BuildOptions::default();
    options.settings.extraction = ExtractionLimits { max_keypoints: 1000, max_image_side: 2000 };
    let (posed, folder) = (PosedImages::from(&colmap), data.join("lund-door/images"));
    let (model, report) = import(&colmap, &Input::new(&posed, &folder), &options, &()).unwrap();
    model.validate().unwrap();
    assert_eq!((report.images, report.points), (3, colmap.points().len()));
    assert!(report.points_kept * 10 > 8 * report.points, "{report}");
    assert!(model.images.iter().all(|i| i.keypoints.len() >= 1000));
    assert!(report.map_error_px < 1.5, "{report}");
    let known: Vec<_> = colmap.points().iter().map(|p| p.position).collect();
    assert!(model.points.iter().all(|p| known.contains(&p.position)), "positions are COLMAP's");
    let other_place = cut(&whole, &[]);
    assert!(matches!(
        import(&other_place, &Input::new(&PosedImages::from(&other_place), data), &options, &()),
        Err(MappingError::EmptyList)
    ));
}

#[real_data_test]
fn image_is_removed_from_and_added_to_redkitchen_map(data: &Path) {
    let posed = read_posed(&data.join("redkitchen/posed")).unwrap();
    let images = data.join("redkitchen/images");
    let names: Vec<String> = posed.names().into_iter().step_by(2).take(8).collect();
    let mut options = BuildOptions::default();
    options.settings.extraction.max_keypoints = 1000;
    options.settings.vocabulary_words = 16;
    let input = Input::new(&posed, &images);
    let (before, report) = build(&input.with_names(&names), &options, &()).unwrap();
    assert!(report.warnings.is_empty(), "{report:?}");
    before.validate().unwrap();
    assert!(before.points.len() > 500, "{} points", before.points.len());
    assert!(before.mean_track_length() > 3.5, "{}", before.mean_track_length());
    assert!(before.mean_reprojection_error() < 1.2, "{} px", before.mean_reprojection_error());

    let mut model = before.clone();
    let one = [names[3].clone()];
    assert!(matches!(
        add(&mut model, &input.with_names(&one), &()),
        Err(MappingError::BadImages(bad)) if matches!(bad.images[0].reason, BadReason::AlreadyInMap)
    ));
    remove(&mut model, &one, VocabularyUpdate::Keep, &()).unwrap();
    model.validate().unwrap();
    assert!(model.points.len() < before.points.len());
    let untouched = before.points.iter().filter(|p| p.track.iter().all(|o| o.image < 3)).count();
    let still =
        before.points.iter().filter(|p| p.track.iter().all(|o| o.image < 3) && model.points.contains(p));
    assert_eq!(still.count(), untouched);
    add(&mut model, &input.with_names(&one), &()).unwrap();
    model.validate().unwrap();
    let (now, then) = (model.points.len() as f64, before.points.len() as f64);
    assert!((now / then - 1.0).abs() < 0.06, "{now} points, {then} before");
    assert_eq!(model.profile, before.profile);

    // Images without overlap give no map.
    let far: Vec<String> = vec![names[0].clone()];
    assert!(matches!(
        build(&input.with_names(&far), &options, &()),
        Err(MappingError::NoPoints { images: 1, .. })
    ));
}

/// The message for inverted poses, other axes, quaternions in another order, or a focal length that is twice the correct one.
#[real_data_test]
fn wrong_poses_and_cameras_are_diagnosed(data: &Path) {
    let right = read_posed(&data.join("redkitchen/posed")).unwrap();
    let names: Vec<String> = right.names().into_iter().step_by(2).take(12).collect();
    let mut options = BuildOptions::default();
    options.settings.extraction.max_keypoints = 1000;
    options.settings.vocabulary_words = 16;
    let warnings = |change: fn(&mut PosedImage)| -> Result<Vec<MapWarning>, MappingError> {
        let mut images = right.images().to_vec();
        images.iter_mut().for_each(change);
        let posed = PosedImages::new(images, Vec::new()).unwrap();
        let folder = data.join("redkitchen/images");
        let (model, report) = build(&Input::new(&posed, &folder).with_names(&names), &options, &())?;
        eprintln!("{} points, {report:?}", model.points.len());
        Ok(report.warnings)
    };
    let inverted = |image: &mut PosedImage| {
        let world_from_cam = image.cam_from_world.inverse();
        image.cam_from_world =
            CameraFromWorld::new(*world_from_cam.rotation(), *world_from_cam.translation());
    };
    let doubled = |image: &mut PosedImage| {
        let p = image.camera.pinhole();
        let [fx, fy] = p.focal.map(|f| 2.0 * f);
        let camera =
            format!("PINHOLE,{},{},{fx},{fy},{},{}", p.width, p.height, p.principal[0], p.principal[1]);
        image.camera = camera.parse().unwrap();
    };
    assert_eq!(warnings(|_| {}).unwrap(), []);
    let opengl = |image: &mut PosedImage| {
        let flip = Rotation3::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        let pose = image.cam_from_world;
        image.cam_from_world = CameraFromWorld::new(flip * pose.rotation(), flip * pose.translation());
    };
    // A trajectory with w x y z, read as x y z w; a model with x y z w, read as w x y z.
    let w_first = |image: &mut PosedImage| {
        let q = UnitQuaternion::from_rotation_matrix(&image.cam_from_world.rotation().inverse());
        let center: [f64; 3] = image.cam_from_world.center().coords.into();
        image.cam_from_world = pose_at(center, [q.k, -q.w, -q.i, -q.j]).unwrap();
    };
    let w_last = |image: &mut PosedImage| {
        let q = UnitQuaternion::from_rotation_matrix(image.cam_from_world.rotation());
        let t: [f64; 3] = (*image.cam_from_world.translation()).into();
        image.cam_from_world = CameraFromWorld::from_quaternion([q.i, q.j, q.k, q.w], t).unwrap();
    };
    for (change, cause) in [
        (inverted as fn(&mut PosedImage), InputMistake::CameraToWorld),
        (opengl, InputMistake::AxesUpAndBack),
        (w_first, InputMistake::QuaternionOrder { w_first: true, to_world: true }),
        (w_last, InputMistake::QuaternionOrder { w_first: false, to_world: false }),
        (doubled, InputMistake::FocalLength { percent: 200 }),
    ] {
        let stated: Vec<String> = match warnings(change) {
            Ok(warnings) => warnings
                .iter()
                .filter(|warning| matches!(warning, MapWarning::LikelyCause { .. }))
                .map(ToString::to_string)
                .collect(),
            Err(MappingError::NoPoints { cause, .. }) => cause.into_iter().collect(),
            Err(error) => panic!("{error}"),
        };
        assert!(stated.len() == 1 && stated[0].contains(&cause.to_string()), "{cause}: {stated:?}");
    }
}
