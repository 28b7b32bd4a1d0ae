//! Tests that rendered scenes behave like real ones: geometry, no repetition, free space.

use veiloc_geometry::frames::World;
use veiloc_geometry::{CameraFromWorld, Intrinsics, Pixel, PlanePoint, Point3};
use veiloc_synthetic::{PathOptions, RenderOptions, RenderedRoom, Rendering};

fn camera() -> Intrinsics {
    "PINHOLE,320,240,262.5,262.5,160,120".parse().expect("valid")
}

fn quiet() -> RenderOptions {
    let mut options = RenderOptions::default();
    (options.noise, options.vignetting) = (0.0, 0.0);
    options
}

/// Grey value between pixel centres.
fn gray_at(image: &image::GrayImage, p: Pixel) -> Option<f64> {
    let (x, y) = (p.u - 0.5, p.v - 0.5);
    let inside =
        x >= 0.0 && y >= 0.0 && x < f64::from(image.width() - 1) && y < f64::from(image.height() - 1);
    inside.then(|| {
        let (i, j, fx, fy) = (x as u32, y as u32, x.fract(), y.fract());
        let at = |a, b| f64::from(image.get_pixel(i + a, j + b).0[0]);
        (at(0, 0) * (1.0 - fx) + at(1, 0) * fx) * (1.0 - fy) + (at(0, 1) * (1.0 - fx) + at(1, 1) * fx) * fy
    })
}

fn project(view: &Rendering, point: &Point3<World>) -> Option<(Pixel, f64)> {
    let p = view.cam_from_world().transform(point);
    Some((view.camera().project(PlanePoint::from_camera_point(&p)?), p.depth()))
}

/// Grey differences of points visible in both views, and the number of points that are occluded or outside.
fn compare(a: &Rendering, b: &Rendering) -> (Vec<f64>, usize) {
    let (ga, gb) = (a.gray(), b.gray());
    let (mut differences, mut unseen) = (Vec::new(), 0);
    for y in (2..a.camera().height - 2).step_by(3) {
        for x in (2..a.camera().width - 2).step_by(3) {
            let Some(point) = a.point(x, y) else { continue };
            let seen = project(b, &point).and_then(|(p, z)| {
                let value = gray_at(&gb, p)?;
                let depth = f64::from(b.depth(p.u as u32, p.v as u32)?);
                ((depth - z).abs() < 0.02 * z).then_some(value)
            });
            match seen {
                Some(value) => differences.push((value - f64::from(ga.get_pixel(x, y).0[0])).abs()),
                None => unseen += 1,
            }
        }
    }
    differences.sort_by(f64::total_cmp);
    (differences, unseen)
}

#[test]
fn a_point_has_the_same_colour_in_two_views() {
    let scene = RenderedRoom::generate(3);
    let path = scene.camera_path(&PathOptions::with_counts(40, 0));
    let render = |k: usize| scene.render(&path.mapping[k], &camera(), &quiet());
    let (first, next, far) = (render(0), render(1), render(20));
    let (differences, unseen) = compare(&first, &next);
    assert!(differences.len() > unseen, "neighbours share most of the view: {} seen", differences.len());
    assert!(differences[differences.len() / 2] < 5.0, "median {}", differences[differences.len() / 2]);
    // After a rotation by four pixels nothing agrees: the texture is fine enough to show the difference.
    let turned = first.cam_from_world().perturbed(&[0.0, 4.0 / 262.5, 0.0, 0.0, 0.0, 0.0]);
    let (ga, gb) = (first.gray(), scene.render(&turned, &camera(), &quiet()).gray());
    let mut changes: Vec<u8> = ga.pixels().zip(gb.pixels()).map(|(a, b)| a.0[0].abs_diff(b.0[0])).collect();
    changes.sort_unstable();
    assert!(f64::from(changes[changes.len() / 2]) > 2.0 * differences[differences.len() / 2]);
    // From the other end of the room something else is visible.
    assert!(compare(&first, &far).0.len() < differences.len() / 2);
}

#[test]
fn depth_does_not_depend_on_the_lens() {
    let scene = RenderedRoom::generate(4);
    let pose = scene.camera_path(&PathOptions::with_counts(3, 0)).mapping[1];
    let bent: Intrinsics = "OPENCV,320,240,262,263,158,122,-0.2,0.05,0.001,-0.001".parse().expect("valid");
    let straight = scene.render(&pose, &camera(), &quiet());
    let through_lens = scene.render(&pose, &bent, &quiet());
    let (differences, unseen) = compare(&through_lens, &straight);
    assert!(differences.len() > 3 * unseen, "{} seen, {unseen} not", differences.len());
    assert!(differences[differences.len() / 2] < 5.0);
}

#[test]
fn equal_seeds_give_equal_bytes_and_others_do_not() {
    let small: Intrinsics = "SIMPLE_PINHOLE,96,72,80,48,36".parse().expect("valid");
    let image = |seed: u64, threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| {
            let scene = RenderedRoom::generate(seed);
            let pose = scene.camera_path(&PathOptions::with_counts(1, 1)).queries[0];
            scene.render(&pose, &small, &RenderOptions::with_seed(5))
        })
    };
    let one = image(1, 1);
    assert!(one == image(1, 3), "the number of threads changed an image");
    assert!(one.rgb() != image(2, 1).rgb());
}

#[test]
fn cameras_keep_clearance_and_queries_differ() {
    for seed in 0..2 {
        let scene = RenderedRoom::generate(seed);
        let path = scene.camera_path(&PathOptions::default());
        assert_eq!((path.mapping.len(), path.queries.len()), (40, 12));
        let free = |pose: &CameraFromWorld| scene.is_free(pose.center().coords.into(), 0.3);
        assert!(path.mapping.iter().chain(&path.queries).all(free), "seed {seed}");
        for query in &path.queries {
            let gap = path.mapping.iter().map(|m| m.translation_error(query)).fold(f64::INFINITY, f64::min);
            assert!(gap > 0.005 && gap < 0.8, "seed {seed}: nearest mapping view {gap} m away");
        }
    }
    let scene = RenderedRoom::generate(0);
    assert!(!scene.is_free([0.0, 0.0, 0.42], 0.05), "inside the table");
    assert!(!scene.is_free([9.0, 0.0, 1.0], 0.0) && !scene.is_free([f64::NAN, 0.0, 1.0], 0.0));
    assert!(scene.camera_path(&PathOptions::with_counts(0, 0)).mapping.is_empty());
}

#[test]
fn rays_outside_the_room_or_undefined_do_not_panic() {
    let scene = RenderedRoom::generate(0);
    let outside = CameraFromWorld::from_quaternion([1.0, 0.0, 0.0, 0.0], [50.0, 0.0, 0.0]).expect("finite");
    let small: Intrinsics = "SIMPLE_PINHOLE,16,12,20,8,6".parse().expect("valid");
    let view = scene.render(&outside, &small, &quiet());
    assert!(view.depth(3, 3).is_none() && view.point(3, 3).is_none() && view.depth(99, 0).is_none());
    // Beyond the fold of a strong distortion a pixel has no ray.
    let folded: Intrinsics = "SIMPLE_RADIAL,16,12,8,8,6,-0.6".parse().expect("valid");
    let pose = scene.camera_path(&PathOptions::with_counts(1, 0)).mapping[0];
    let view = scene.render(&pose, &folded, &quiet());
    assert!(view.depth(8, 6).is_some() && view.depth(0, 0).is_none());
}
