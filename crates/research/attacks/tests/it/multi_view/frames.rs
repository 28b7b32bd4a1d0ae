//! Several frames of synthetic points: what lines determine, what they do not, and which answers are accepted.

use rand::seq::SliceRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc_attacks::multi_view::{
    Frame, FramesOptions, StaticCameraOptions, TriangulatedKeypoint, multi_view_attack, select_frames,
    static_camera,
};
use veiloc_attacks::{
    AttackError, DecodedDescriptors, ErrorSummary, Observation, bits_over_prior, lift, prior_only,
};
use veiloc_geometry::frames::World;
use veiloc_geometry::{CameraFromWorld, Pencils, Pinhole, Pixel, PlanePoint, Point3};
use veiloc_protocol::AngleBits;

const CAMERA: Pinhole = Pinhole { width: 640, height: 480, focal: [500.0, 500.0], principal: [320.0, 240.0] };

/// Frames of the same points, `[frames]`: keypoint `i` of each shows point `i`.
#[derive(Clone)]
struct Scene {
    poses: Vec<CameraFromWorld>,
    points: Vec<Point3<World>>,
    pixels: Vec<Vec<Pixel>>,
    lines: Vec<Vec<Observation>>,
    descriptors: Vec<DecodedDescriptors>,
    /// Depth limits that the attacker assumes.
    depths: [f64; 2],
}

fn project_point(pose: &CameraFromWorld, x: &Point3<World>) -> Option<Pixel> {
    PlanePoint::from_camera_point(&pose.transform(x))
        .map(|p| CAMERA.project(p))
        .filter(|p| CAMERA.contains(*p, -5.0))
}

impl Scene {
    /// Points that all frames see. Cameras translate by up to `moved` map units and rotate by up to `turned` radians
    /// per axis.
    fn new(frames: usize, moved: f64, turned: f64, seed: u64) -> Self {
        Self::at_depths([2.0, 6.0], frames, moved, turned, seed)
    }

    fn at_depths(depths: [f64; 2], frames: usize, moved: f64, turned: f64, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let poses: Vec<CameraFromWorld> = (0..frames)
            .map(|_| {
                let mut step = |most: f64| most * rng.random_range(-1.0..=1.0);
                let turn = [step(turned), step(turned), step(turned)];
                let go = [step(moved), step(moved), step(moved)];
                CameraFromWorld::identity().perturbed(&[turn[0], turn[1], turn[2], go[0], go[1], go[2]])
            })
            .collect();
        let mut points = Vec::new();
        while points.len() < 200 {
            let z = rng.random_range(depths[0]..depths[1]);
            let x = Point3::new(z * rng.random_range(-0.6..0.6), z * rng.random_range(-0.45..0.45), z);
            if poses.iter().all(|pose| project_point(pose, &x).is_some()) {
                points.push(x);
            }
        }
        let bytes: Vec<u8> = (0..200 * 16).map(|_| rng.random()).collect();
        let descriptors = vec![DecodedDescriptors::new(&bytes, 16).expect("whole"); frames];
        let mut scene =
            Self { poses, points, pixels: Vec::new(), lines: Vec::new(), descriptors, depths: [0.5, 20.0] };
        scene.project();
        scene
    }

    /// Pixels and exact lines of the points.
    fn project(&mut self) {
        let pencils = Pencils::paper(640, 480);
        let project = |pose: &CameraFromWorld| {
            self.points.iter().map(|x| project_point(pose, x).expect("all frames see it")).collect::<Vec<_>>()
        };
        self.pixels = self.poses.iter().map(project).collect();
        self.lines = self.pixels.iter().map(|p| lift::dual_convergent(p, &pencils)).collect();
    }

    /// A frame as a device seals it: the detector's noise, dither, and quantized angles.
    fn sealed(&self, frame: usize, noise: f64, seed: u64) -> Vec<Observation> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let pencils = Pencils::paper(640, 480);
        let cell = std::f64::consts::PI / f64::from(AngleBits::default().levels());
        let one = |p: &Pixel| {
            let mut step = || {
                // The sum of twelve uniform variables approximates a Gaussian.
                let gauss: f64 = (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
                noise * gauss + rng.random::<f64>() - 0.5
            };
            let moved = Pixel::new(p.u + step(), p.v + step());
            // Near the dividing line a dither may change sides, as on a device.
            let anchor = pencils.anchor_of(moved);
            let code = (pencils.angle_of(anchor, moved) / cell).floor();
            Observation::anchored(&pencils, anchor, (code + 0.5) * cell)
        };
        self.pixels[frame].iter().map(one).collect()
    }

    /// The same scene with lines as a device sends them.
    fn sent(&self, seed: u64) -> Self {
        let lines = (0..self.poses.len()).map(|f| self.sealed(f, 0.3, seed + f as u64)).collect();
        Self { lines, ..self.clone() }
    }

    /// Points on one surface: depth is a function of position.
    fn set_depth_by_position(&mut self, seed: u64) {
        let bend = |x: f64, y: f64| 3.5 + 1.5 * (4.0 * x).sin() * (3.0 * y).cos();
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        self.points.clear();
        while self.points.len() < 200 {
            let (x, y) = (rng.random_range(-0.6..0.6), rng.random_range(-0.45..0.45));
            let z = bend(x, y);
            let point = Point3::new(x * z, y * z, z);
            if self.poses.iter().all(|pose| project_point(pose, &point).is_some()) {
                self.points.push(point);
            }
        }
        self.project();
        *self = self.sent(seed + 1);
    }

    /// Other points of that surface, as map points.
    fn nearby_map_points(&self, seed: u64) -> Vec<(Pixel, f64)> {
        let mut other = self.clone();
        other.set_depth_by_position(seed);
        let pose = &self.poses[0];
        other
            .points
            .iter()
            .map(|x| (project_point(pose, x).expect("projected"), pose.transform(x).depth()))
            .collect()
    }

    fn frames(&self, n: usize) -> Vec<Frame<'_>> {
        let frame = |f: usize| Frame {
            camera: CAMERA,
            cam_from_world: self.poses[f],
            observations: &self.lines[f],
            descriptors: &self.descriptors[f],
        };
        (0..n).map(frame).collect()
    }

    fn options(&self) -> FramesOptions {
        FramesOptions::with_depths(self.depths)
    }

    /// Estimates of the first frame from the first `n` frames.
    fn triangulated(&self, n: usize) -> Vec<TriangulatedKeypoint> {
        self.triangulated_with(n, Vec::new())
    }

    fn triangulated_with(&self, n: usize, known: Vec<(Pixel, f64)>) -> Vec<TriangulatedKeypoint> {
        multi_view_attack(&self.frames(n), &self.options().with_known_points(known)).expect("they fit")
    }

    fn prior_errors(&self) -> Vec<f64> {
        let prior = prior_only(&self.lines[0], 640, 480);
        prior.iter().zip(&self.pixels[0]).map(|(g, t)| g.distance(t)).collect()
    }

    fn prior(&self) -> ErrorSummary {
        ErrorSummary::of(&self.prior_errors())
    }

    fn errors(&self, found: &[TriangulatedKeypoint]) -> Vec<f64> {
        found.iter().zip(&self.pixels[0]).map(|(s, t)| s.pixel.expect("projected").distance(t)).collect()
    }
}

#[test]
fn three_frames_determine_a_position_and_the_fourth_makes_it_accepted() {
    let scene = Scene::new(6, 0.5, 0.3, 1);
    let prior = scene.prior();
    let of = |n: usize| {
        let found = scene.triangulated(n);
        let errors = scene.errors(&found);
        let accepted: Vec<f64> =
            found.iter().zip(&errors).filter(|(s, _)| s.is_accepted()).map(|(_, e)| *e).collect();
        (ErrorSummary::of(&errors), accepted)
    };
    // Two frames of cameras that translate by a tenth of the depth: depth limits and rotation constrain the line.
    let (two, accepted) = of(2);
    assert!(two.median_px < prior.median_px && two.median_px > 10.0, "{two:?} {prior:?}");
    assert!(accepted.is_empty());
    let (three, accepted) = of(3);
    assert!(three.median_px < 0.3 * two.median_px && accepted.is_empty(), "{three:?} {two:?}");
    let (four, accepted) = of(4);
    assert!(four.median_px < 0.01, "exact lines determine positions exactly: {four:?}");
    assert!(accepted.len() > 100 && accepted.iter().all(|e| *e < 1.0), "{}", accepted.len());
    let (six, more) = of(6);
    assert!(six.under_5px > 0.9 && more.len() >= accepted.len(), "{six:?}");
}

/// Both planes of a keypoint contain the common centre and intersect in its viewing ray: two frames suffice, at any
/// depth. The intersection depth `−n·t / n·R b` does not exist for `t = 0`: a search over such depths returns the
/// prior-only baseline.
#[test]
fn two_frames_of_pure_rotation_reveal_keypoints() {
    for (turned, most) in [(0.1, 6.0), (0.3, 2.0)] {
        let scene = Scene::new(2, 0.0, turned, 21);
        let prior = scene.prior();
        assert!(prior.median_px > 60.0, "{prior:?}");
        // As sent: dither and quantized angles.
        let sent = scene.sent(22);
        let found = sent.triangulated(2);
        let errors = ErrorSummary::of(&sent.errors(&found));
        assert!(errors.median_px < most, "turned by {turned}: {errors:?}");
        assert!(found.iter().all(|s| !s.is_accepted()), "one match may be wrong, and nothing would show it");
    }
    // Points at a very large distance: depth has no effect, and the result stays finite.
    let mut scene = Scene::at_depths([1e5, 1e6], 2, 0.5, 0.3, 23);
    scene.depths = [0.5, 1e7];
    let errors = ErrorSummary::of(&scene.errors(&scene.triangulated(2)));
    assert!(errors.median_px < 0.5, "{errors:?}");
}

/// With a translation of a hundredth of the depth the answer hardly depends on depth; with a tenth the depth must be
/// known.
#[test]
fn translation_needs_known_depth() {
    let of = |moved: f64, depths: [f64; 2]| {
        let mut scene = Scene::new(2, moved, 0.2, 31).sent(32);
        scene.depths = depths;
        ErrorSummary::of(&scene.errors(&scene.triangulated(2))).median_px
    };
    let wide = [0.5, 20.0];
    let [spot, step, far] = [0.0, 0.05, 0.5].map(|moved| of(moved, wide));
    assert!(spot < 0.5 * step && step < 0.7 * far, "{spot} {step} {far}");
    // Depth limits are respected: points between 2 and 6 are located better with the limits 2 and 6.
    let narrow = of(0.5, [2.0, 6.0]);
    assert!(narrow < 0.85 * far, "{narrow} {far}");

    // Map points near the keypoints reveal their depths.
    let mut scene = Scene::new(2, 0.5, 0.2, 33).sent(34);
    scene.set_depth_by_position(35);
    let without = ErrorSummary::of(&scene.errors(&scene.triangulated(2)));
    let known = scene.nearby_map_points(36);
    let with = ErrorSummary::of(&scene.errors(&scene.triangulated_with(2, known)));
    assert!(with.median_px < 0.5 * without.median_px, "{with:?} {without:?}");
}

/// Planes of one anchor contain the anchor's direction, which is the same for cameras that do not rotate: six frames
/// determine no more than the limits of depth and image do.
#[test]
fn pure_translation_determines_nothing() {
    let scene = Scene::new(6, 0.5, 0.0, 2).sent(3);
    let found = scene.triangulated(6);
    // A point that changes sides belongs to the other anchor, and is determined.
    let stays = |i: usize| scene.pixels.iter().all(|p| (p[i].u < 320.0) == (scene.pixels[0][i].u < 320.0));
    let errors = scene.errors(&found);
    let (same, other): (Vec<usize>, Vec<usize>) = (0..200).partition(|i| stays(*i));
    let of = |all: &[usize]| ErrorSummary::of(&all.iter().map(|i| errors[*i]).collect::<Vec<_>>());
    assert!(same.len() > 60, "{}", same.len());
    for i in &same {
        assert!(!found[*i].is_accepted(), "{:?}", found[*i]);
    }
    assert!(other.len() > 30 && of(&other).median_px < 0.1 * of(&same).median_px, "{:?}", of(&other));
    assert!(of(&same).median_px > 20.0, "{:?}", of(&same));
}

/// Planes of a stationary camera determine nothing, and no answer is accepted; the scatter of the angles reveals the
/// distance.
#[test]
fn stationary_camera_is_not_accepted_but_scatter_reveals_distance() {
    let scene = Scene::new(2, 0.0, 0.0, 41);
    let prior = scene.prior_errors();
    let cell = std::f64::consts::PI / f64::from(AngleBits::default().levels());
    let of = |seals: usize, noise: f64| {
        let all: Vec<Vec<Observation>> = (0..seals).map(|k| scene.sealed(0, noise, 100 + k as u64)).collect();
        let options = StaticCameraOptions::of_one_image(cell).with_noise(noise);
        let found = static_camera(&all[0], &shown(&all[1..]), (640, 480), &options).expect("they fit");
        let errors = scene.errors(&found);
        // The posterior's own estimate of its error is correct.
        let expected: f64 = found.iter().map(|s| s.sigma_px.powi(2)).sum::<f64>();
        let made: f64 = errors.iter().map(|e| e * e).sum();
        assert!((0.6..1.6).contains(&(made / expected)), "{seals} {noise}: {}", made / expected);
        let accepted: Vec<usize> = (0..200).filter(|i| found[*i].is_accepted()).collect();
        let wrong = accepted.iter().filter(|i| errors[**i] > 10.0).count();
        assert!(5 * wrong <= accepted.len(), "{wrong} of {}", accepted.len());
        bits_over_prior(&errors, &prior, 640, 480)
    };
    let [two, eight, many] = [2, 8, 32].map(|n| of(n, 0.0));
    assert!(two > 0.1 && eight > two + 0.4 && many > eight + 0.5, "{two} {eight} {many}");
    let [two, eight] = [2, 8].map(|n| of(n, 0.4));
    assert!(two > 0.05 && eight > two + 0.3, "{two} {eight}");

    // Planes, with all frames of the stationary camera at one pose.
    let mut rest = Scene::new(8, 0.0, 0.0, 41);
    for (f, lines) in rest.lines.iter_mut().enumerate() {
        *lines = scene.sealed(0, 0.4, 300 + f as u64);
    }
    let found = rest.triangulated(8);
    let wrong = found.iter().zip(rest.errors(&found)).filter(|(s, e)| s.is_accepted() && *e > 10.0).count();
    assert!(wrong <= 4, "{wrong}");
}

/// Lines with different directions, and half-lines of two anchors, intersect in the keypoint: scatter is not needed.
#[test]
fn seals_with_intersecting_lines_reveal_keypoints() {
    let scene = Scene::new(2, 0.0, 0.0, 51);
    let mut rng = ChaCha8Rng::seed_from_u64(52);
    let seals = [0, 1].map(|_| lift::random_lines(&scene.pixels[0], &mut rng));
    let options = StaticCameraOptions::of_one_image(0.0);
    let found = static_camera(&seals[0], &shown(&seals[1..]), (640, 480), &options).expect("they fit");
    assert!(ErrorSummary::of(&scene.errors(&found)).median_px < 0.1);
    let refused = static_camera(&seals[0], &shown(&[seals[1][1..].to_vec()]), (640, 480), &options);
    assert_eq!(refused, Err(AttackError::Rows { rows: 199, expected: 200 }));
    let alone = static_camera(&seals[0], &[], (640, 480), &options);
    assert_eq!(alone, Err(AttackError::TooFewFrames { frames: 1 }));
    // A keypoint without a match in another frame has no answer and does not affect the others.
    let mut partly = shown(&seals[1..]);
    partly[0][3] = None;
    let some = static_camera(&seals[0], &partly, (640, 480), &options).expect("they fit");
    assert_eq!((some[3].pixel, some[4]), (None, found[4]));
}

/// Rows that all other frames show.
fn shown(seals: &[Vec<Observation>]) -> Vec<Vec<Option<Observation>>> {
    seals.iter().map(|rows| rows.iter().copied().map(Some).collect()).collect()
}

/// From a pool: the frame that only rotated is chosen before those that translated, then a frame that adds
/// information.
#[test]
fn frames_are_selected_by_rotation_against_translation() {
    let spot = Scene::new(2, 0.0, 0.3, 61);
    let mut pool = Scene::new(6, 0.5, 0.0, 61);
    // Frame 4 only rotated.
    pool.poses[0] = spot.poses[0];
    pool.poses[4] = spot.poses[0].perturbed(&[0.1, -0.2, 0.2, 0.0, 0.0, 0.0]);
    let frames = pool.frames(6);
    let chosen = select_frames(&frames[0], &frames[1..], 3, &pool.options()).expect("they fit");
    assert_eq!(chosen.len(), 3);
    assert_eq!(chosen[0], 3, "index 3 of the others is frame 4: {chosen:?}");
    let all = select_frames(&frames[0], &frames[1..], 9, &pool.options()).expect("they fit");
    let mut sorted = all.clone();
    sorted.sort_unstable();
    assert_eq!((&all[..3], sorted), (&chosen[..], vec![0, 1, 2, 3, 4]));
}

#[test]
fn result_is_independent_of_threads_and_depths_are_checked() {
    let scene = Scene::new(3, 0.2, 0.2, 71).sent(72);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| scene.triangulated(3))
    };
    assert_eq!(on(1), on(4));
    let frames = scene.frames(2);
    for depths in [[0.0, 1.0], [2.0, 1.0], [1.0, f64::INFINITY], [f64::NAN, 1.0]] {
        let options = FramesOptions::with_depths(depths);
        assert_eq!(multi_view_attack(&frames, &options), Err(AttackError::Depths), "{depths:?}");
        assert_eq!(select_frames(&frames[0], &frames[1..], 1, &options), Err(AttackError::Depths));
    }
    // Equal depth limits are valid.
    let mut exact = Scene::at_depths([3.0, 3.0 + 1e-9], 2, 0.3, 0.3, 73);
    exact.depths = [3.0, 3.0];
    let errors = ErrorSummary::of(&exact.errors(&exact.triangulated(2)));
    exact.depths = [0.5, 20.0];
    let wide = ErrorSummary::of(&exact.errors(&exact.triangulated(2)));
    assert!(errors.median_px < 0.2 * wide.median_px, "{errors:?} {wide:?}");
}

#[test]
fn wrong_matches_are_not_accepted() {
    let mut scene = Scene::new(6, 0.5, 0.3, 3);
    // The keypoints of the second half belong to other points, different ones in each frame.
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    for lines in &mut scene.lines[1..] {
        lines[100..].shuffle(&mut rng);
    }
    let found = scene.triangulated(6);
    let accepted = |s: &[TriangulatedKeypoint]| s.iter().filter(|s| s.is_accepted()).count();
    assert!(accepted(&found[..100]) > 60, "{}", accepted(&found[..100]));
    assert!(accepted(&found[100..]) <= 5, "{}", accepted(&found[100..]));

    // Two of the five matches are wrong, different ones per keypoint: the other three outvote them.
    let mut scene = Scene::new(6, 0.5, 0.3, 3);
    let untouched = scene.lines.clone();
    for i in 0..200 {
        for f in rand::seq::index::sample(&mut rng, 5, 2) {
            scene.lines[f + 1][i] = untouched[f + 1][(i + 37) % 200];
        }
    }
    let errors = scene.errors(&scene.triangulated(6));
    assert!(ErrorSummary::of(&errors).median_px < 2.0, "{:?}", ErrorSummary::of(&errors));
}

#[test]
fn known_keypoints_are_kept_unmatched_have_no_answer_and_invalid_frames_are_refused() {
    let mut scene = Scene::new(3, 0.5, 0.3, 5);
    scene.lines[0][7] = Observation::Known(Pixel::new(1.0, 2.0));
    assert_eq!(scene.triangulated(3)[7].pixel, Some(Pixel::new(1.0, 2.0)));
    let options = FramesOptions::with_depths([0.5, 20.0]);
    let frame = |lines| Frame {
        camera: CAMERA,
        cam_from_world: scene.poses[0],
        observations: lines,
        descriptors: &scene.descriptors[0],
    };
    let nothing = DecodedDescriptors::new(&[], 16).expect("whole");
    let blind = Frame { observations: &[], descriptors: &nothing, ..frame(&scene.lines[0]) };
    let found = multi_view_attack(&[frame(&scene.lines[0]), blind], &options).expect("they fit");
    assert!(found.iter().enumerate().all(|(i, s)| s.pixel.is_some() == (i == 7)));

    assert_eq!(multi_view_attack(&[], &options), Err(AttackError::TooFewFrames { frames: 0 }));
    let alone = multi_view_attack(&[frame(&scene.lines[0])], &options);
    assert_eq!(alone, Err(AttackError::TooFewFrames { frames: 1 }));
    let short = multi_view_attack(&[frame(&scene.lines[0]), frame(&scene.lines[1][1..])], &options);
    assert_eq!(short, Err(AttackError::FrameDescriptors { frame: 1, observations: 199, descriptors: 200 }));
    let two = DecodedDescriptors::new(&[1; 400], 2).expect("whole");
    let other = Frame { descriptors: &two, ..frame(&scene.lines[1]) };
    let mixed = multi_view_attack(&[frame(&scene.lines[0]), other], &options);
    assert_eq!(mixed, Err(AttackError::Dimensions { expected: 16, found: 2 }));
}
