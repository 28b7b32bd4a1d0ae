//! All of COLMAP's cameras compared with pycolmap (`research/oracles/cameras.py`).

use std::collections::BTreeSet;

use veiloc_geometry::{Intrinsics, IntrinsicsError, Pixel, PlanePoint};

const ORACLE: &str = include_str!("../data/cameras.txt");

/// Error of pycolmap's own inverse: its iterations stop at a step size. All other numbers are exact to float64.
const ORACLE_INVERSE_ERROR: f64 = 1e-8;

#[test]
fn pixels_and_rays_agree_with_pycolmap() {
    let mut camera: Option<Intrinsics> = None;
    let (mut models, mut points) = (BTreeSet::new(), 0);
    for line in ORACLE.lines().filter(|line| !line.starts_with('#')) {
        let (word, rest) = line.split_once(' ').expect("a word and numbers");
        if word == "camera" {
            let read: Intrinsics = rest.parse().expect("a camera");
            models.insert(read.model.name());
            camera = Some(read);
            continue;
        }
        let camera = camera.as_ref().expect("a camera first");
        let numbers: Vec<f64> = rest.split(' ').map(|n| n.parse().expect("a number")).collect();
        let &[x, y, u, v, back_x, back_y] = numbers.as_slice() else { panic!("{line}") };
        let projected = camera.project(PlanePoint::new(x, y));
        assert!(projected.distance(&Pixel::new(u, v)) < 1e-9, "{camera} {line}: {projected:?}");
        let ray = camera.unproject(Pixel::new(u, v)).expect("a ray");
        assert!((ray.x - x).hypot(ray.y - y) < 1e-12, "{camera} {line}: {ray:?}");
        assert!((ray.x - back_x).hypot(ray.y - back_y) < ORACLE_INVERSE_ERROR, "{camera} {line}: {ray:?}");
        points += 1;
    }
    assert_eq!((models.len(), points), (17, 17 * 28));
}

#[test]
fn a_cropped_camera_sees_the_same_rays_at_shifted_pixels() {
    for camera in ORACLE.lines().filter_map(|line| line.strip_prefix("camera ")) {
        let camera: Intrinsics = camera.parse().expect("a camera");
        let part = camera.cropped(7, 11, camera.width / 2, camera.height - 11).expect("within");
        assert_eq!((part.width, part.height), (camera.width / 2, camera.height - 11));
        let (whole, cut) =
            (camera.project(PlanePoint::new(0.13, -0.08)), part.project(PlanePoint::new(0.13, -0.08)));
        assert!(cut.distance(&Pixel::new(whole.u - 7.0, whole.v - 11.0)) < 1e-9, "{camera}");
        for [x, y, w, h] in
            [[0, 0, 0, 1], [1, 0, camera.width, 1], [u32::MAX, 0, 2, 1], [0, 0, 1, camera.height + 1]]
        {
            assert!(matches!(camera.cropped(x, y, w, h), Err(IntrinsicsError::Crop { .. })), "{camera}");
        }
    }
}
