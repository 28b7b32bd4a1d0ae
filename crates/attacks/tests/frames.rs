//! Several frames of made-up points: what lines fix, what they do not, and what is believed.

use rand::seq::SliceRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc_attacks::{
    AttackError, Descriptors, ErrorSummary, Frame, FramesOptions, Observation, Sighted, lift, prior_only,
    several_frames,
};
use veiloc_geometry::frames::World;
use veiloc_geometry::{CameraFromWorld, Pencils, Pinhole, Pixel, PlanePoint, Point3};

const CAMERA: Pinhole = Pinhole { width: 640, height: 480, focal: [500.0, 500.0], principal: [320.0, 240.0] };

/// Frames of the same points, `[frames]`: keypoint `i` of each shows point `i`.
struct Scene {
    poses: Vec<CameraFromWorld>,
    pixels: Vec<Vec<Pixel>>,
    lines: Vec<Vec<Observation>>,
    descriptors: Vec<Descriptors>,
}

impl Scene {
    /// Points that all frames see. Cameras move by up to `moved` map units and turn by up to `turned` radians an axis.
    fn new(frames: usize, moved: f64, turned: f64, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let poses: Vec<CameraFromWorld> = (0..frames)
            .map(|_| {
                let mut step = |most: f64| most * rng.random_range(-1.0..=1.0);
                let turn = [step(turned), step(turned), step(turned)];
                let go = [step(moved), step(moved), step(moved)];
                CameraFromWorld::identity().perturbed(&[turn[0], turn[1], turn[2], go[0], go[1], go[2]])
            })
            .collect();
        let see = |pose: &CameraFromWorld, x: &Point3<World>| {
            PlanePoint::from_camera_point(&pose.transform(x))
                .map(|p| CAMERA.project(p))
                .filter(|p| CAMERA.contains(*p, -5.0))
        };
        let mut pixels = vec![Vec::new(); frames];
        while pixels[0].len() < 200 {
            let z = rng.random_range(2.0..6.0);
            let x = Point3::new(z * rng.random_range(-0.6..0.6), z * rng.random_range(-0.45..0.45), z);
            let seen: Option<Vec<Pixel>> = poses.iter().map(|pose| see(pose, &x)).collect();
            for (frame, pixel) in seen.into_iter().flatten().enumerate() {
                pixels[frame].push(pixel);
            }
        }
        let bytes: Vec<u8> = (0..200 * 16).map(|_| rng.random()).collect();
        let descriptors = vec![Descriptors::new(&bytes, 16).expect("whole"); frames];
        let pencils = Pencils::paper(640, 480);
        let lines = pixels.iter().map(|p| lift::dual_convergent(p, &pencils)).collect();
        Self { poses, pixels, lines, descriptors }
    }

    /// What the first `n` frames tell about the first.
    fn sighted(&self, n: usize) -> Vec<Sighted> {
        let frames: Vec<Frame<'_>> = (0..n)
            .map(|f| Frame {
                camera: CAMERA,
                cam_from_world: self.poses[f],
                observations: &self.lines[f],
                descriptors: &self.descriptors[f],
            })
            .collect();
        several_frames(&frames, &FramesOptions::with_depths([0.5, 20.0])).expect("they fit")
    }

    fn errors(&self, found: &[Sighted]) -> Vec<f64> {
        found.iter().zip(&self.pixels[0]).map(|(s, t)| s.pixel.expect("seen").distance(t)).collect()
    }
}

#[test]
fn three_frames_fix_a_place_and_the_fourth_makes_it_believed() {
    let scene = Scene::new(6, 0.5, 0.3, 1);
    let guess = prior_only(&scene.lines[0], 640, 480);
    let guess: Vec<f64> = guess.iter().zip(&scene.pixels[0]).map(|(g, t)| g.distance(t)).collect();
    let guess = ErrorSummary::of(&guess);
    let of = |n: usize| {
        let found = scene.sighted(n);
        let errors = scene.errors(&found);
        let believed: Vec<f64> =
            found.iter().zip(&errors).filter(|(s, _)| s.is_believed()).map(|(_, e)| *e).collect();
        (ErrorSummary::of(&errors), believed)
    };
    // Two: limits of depth and image cut the line, more they cannot.
    let (two, believed) = of(2);
    assert!(two.median_px > 0.4 * guess.median_px && believed.is_empty(), "{two:?} {guess:?}");
    let (three, believed) = of(3);
    assert!(three.median_px < 0.3 * two.median_px && believed.is_empty(), "{three:?} {two:?}");
    let (four, believed) = of(4);
    assert!(four.median_px < 0.01, "exact lines fix places exactly: {four:?}");
    assert!(believed.len() > 100 && believed.iter().all(|e| *e < 1.0), "{}", believed.len());
    let (six, more) = of(6);
    assert!(six.under_5px > 0.9 && more.len() >= believed.len(), "{six:?}");
}

/// Planes of one anchor hold the anchor's direction, which is one and the same for cameras that do not turn: six
/// frames are then worth no more than two.
#[test]
fn cameras_that_do_not_turn_fix_nothing() {
    let scene = Scene::new(6, 0.5, 0.0, 2);
    let found = scene.sighted(6);
    // A point that changes sides belongs to the other anchor, and is fixed.
    let stays = |i: usize| scene.pixels.iter().all(|p| (p[i].u < 320.0) == (scene.pixels[0][i].u < 320.0));
    let errors = scene.errors(&found);
    let (same, other): (Vec<usize>, Vec<usize>) = (0..200).partition(|i| stays(*i));
    let of = |all: &[usize]| ErrorSummary::of(&all.iter().map(|i| errors[*i]).collect::<Vec<_>>());
    assert!(same.len() > 60, "{}", same.len());
    for i in &same {
        assert!(!found[*i].is_believed() && found[*i].sigma_px > 100.0, "{:?}", found[*i]);
    }
    assert!(other.len() > 30 && of(&other).median_px < 0.1 * of(&same).median_px, "{:?}", of(&other));
    assert!(of(&same).median_px > 20.0, "{:?}", of(&same));
}

#[test]
fn wrong_matches_are_not_believed() {
    let mut scene = Scene::new(6, 0.5, 0.3, 3);
    // The keypoints of the second half are those of other places, other ones in each frame.
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    for lines in &mut scene.lines[1..] {
        lines[100..].shuffle(&mut rng);
    }
    let found = scene.sighted(6);
    let believed = |s: &[Sighted]| s.iter().filter(|s| s.is_believed()).count();
    assert!(believed(&found[..100]) > 60, "{}", believed(&found[..100]));
    assert!(believed(&found[100..]) <= 5, "{}", believed(&found[100..]));

    // Two of the five matches wrong, which ones differs: the other three outvote them.
    let mut scene = Scene::new(6, 0.5, 0.3, 3);
    let untouched = scene.lines.clone();
    for i in 0..200 {
        for f in rand::seq::index::sample(&mut rng, 5, 2) {
            scene.lines[f + 1][i] = untouched[f + 1][(i + 37) % 200];
        }
    }
    let errors = scene.errors(&scene.sighted(6));
    assert!(ErrorSummary::of(&errors).median_px < 2.0, "{:?}", ErrorSummary::of(&errors));
}

#[test]
fn known_ones_stay_unseen_ones_have_no_answer_and_bad_frames_are_refused() {
    let mut scene = Scene::new(3, 0.5, 0.3, 5);
    scene.lines[0][7] = Observation::Known(Pixel::new(1.0, 2.0));
    assert_eq!(scene.sighted(3)[7].pixel, Some(Pixel::new(1.0, 2.0)));
    let options = FramesOptions::with_depths([0.5, 20.0]);
    let frame = |lines| Frame {
        camera: CAMERA,
        cam_from_world: scene.poses[0],
        observations: lines,
        descriptors: &scene.descriptors[0],
    };
    let nothing = Descriptors::new(&[], 16).expect("whole");
    let blind = Frame { observations: &[], descriptors: &nothing, ..frame(&scene.lines[0]) };
    let found = several_frames(&[frame(&scene.lines[0]), blind], &options).expect("they fit");
    assert!(found.iter().enumerate().all(|(i, s)| s.pixel.is_some() == (i == 7)));

    assert_eq!(several_frames(&[], &options), Err(AttackError::TooFewFrames { frames: 0 }));
    let alone = several_frames(&[frame(&scene.lines[0])], &options);
    assert_eq!(alone, Err(AttackError::TooFewFrames { frames: 1 }));
    let short = several_frames(&[frame(&scene.lines[0]), frame(&scene.lines[1][1..])], &options);
    assert_eq!(short, Err(AttackError::FrameDescriptors { frame: 1, observations: 199, descriptors: 200 }));
    let two = Descriptors::new(&[1; 400], 2).expect("whole");
    let other = Frame { descriptors: &two, ..frame(&scene.lines[1]) };
    let mixed = several_frames(&[frame(&scene.lines[0]), other], &options);
    assert_eq!(mixed, Err(AttackError::Dimensions { expected: 16, found: 2 }));
}
