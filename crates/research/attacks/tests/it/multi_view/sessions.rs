//! L10: frames of one session, sealed as a device seals them, attacked with all methods for several frames.
//!
//! Synthetic 3D points, a camera that rotates, translates or is stationary, detector noise, gyroscope noise; the
//! attacker holds the true poses and the sent queries. Each bound is checked beside the same frames sealed without
//! the protection.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc_attacks::multi_view::{
    Frame, FramesOptions, StaticCameraOptions, multi_view_attack, static_camera,
};
use veiloc_attacks::{DecodedDescriptors, Observation, bits_over_prior, prior_only};
use veiloc_descriptor::{DescriptorKind, Vocabulary};
use veiloc_features::{Features, Keypoint};
use veiloc_geometry::frames::World;
use veiloc_geometry::nalgebra::{Rotation3, Vector3};
use veiloc_geometry::{CameraFromWorld, Intrinsics, Pixel, PlanePoint, Point3};
use veiloc_obfuscation::{
    Extracted, Orientation, SealOptions, SealTruth, Sealer, Session, SessionAnchors, SessionOptions,
};
use veiloc_protocol::{Profile, SealedQuery};

const STRIPES: &str = "dcl:axis=115:sectors=20:anchors=0.23/-0.33+-0.88/-0.47";
const LAYOUTS: [&str; 2] = ["dcl", STRIPES];
/// Detector noise from frame to frame along each axis, pixels.
const DETECTOR_PX: f64 = 0.3;

/// Without the protection of world-fixed anchors, and with it.
fn image_fixed() -> SessionOptions {
    SessionOptions::default().with_anchors(SessionAnchors::Image).with_max_starts(None)
}
fn without_memory() -> SessionOptions {
    SessionOptions::default().with_step(0.0).with_memory(false)
}

/// Motion of a camera before the points, and the error of its gyroscope.
#[derive(Clone, Copy)]
struct Trajectory {
    frames: usize,
    /// Radians about each axis, metres along each.
    turned: f64,
    moved: f64,
    /// Error of the orientation about each axis, degrees.
    gyroscope_deg: f64,
}

struct Sealed {
    query: SealedQuery,
    truth: SealTruth,
    pose: CameraFromWorld,
    lines: Vec<Observation>,
    descriptors: DecodedDescriptors,
}

fn camera() -> Intrinsics {
    "SIMPLE_PINHOLE,640,480,512,320,240".parse().expect("valid")
}

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0
}

/// Seals the frames of one trajectory; feature `i` of each is point `i`. All frames see all points.
fn sealed(trajectory: Trajectory, scheme: &str, options: SessionOptions, seed: u64) -> Vec<Sealed> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let pinhole = camera().pinhole();
    let poses: Vec<CameraFromWorld> = (0..trajectory.frames)
        .map(|k| {
            let mut step = |most: f64| if k == 0 { 0.0 } else { most * rng.random_range(-1.0..=1.0) };
            let turn = [step(trajectory.turned), step(trajectory.turned), step(trajectory.turned)];
            let go = [step(trajectory.moved), step(trajectory.moved), step(trajectory.moved)];
            CameraFromWorld::identity().perturbed(&[turn[0], turn[1], turn[2], go[0], go[1], go[2]])
        })
        .collect();
    let see = |pose: &CameraFromWorld, x: &Point3<World>| {
        PlanePoint::from_camera_point(&pose.transform(x))
            .map(|p| pinhole.project(p))
            .filter(|p| (3.0..637.0).contains(&p.u) && (3.0..477.0).contains(&p.v))
    };
    let mut points = Vec::new();
    while points.len() < 500 {
        let z = rng.random_range(2.0..6.0);
        let x = Point3::new(z * rng.random_range(-0.6..0.6), z * rng.random_range(-0.45..0.45), z);
        if poses.iter().all(|pose| see(pose, &x).is_some()) {
            points.push(x);
        }
    }
    let kind = DescriptorKind::ROOT_SIFT;
    let mut bytes = Vec::new();
    for _ in 0..500 {
        let values: Vec<f64> = (0..128).map(|_| rng.random::<f64>().powi(3)).collect();
        let norm = values.iter().map(|v| v * v).sum::<f64>().sqrt();
        bytes.extend(values.iter().map(|v| (v / norm * 512.0).round().min(255.0) as u8));
    }
    let descriptors = veiloc_descriptor::Descriptors::new(kind, bytes).expect("whole rows");
    let profile = Profile::vlad(Vocabulary::new(descriptors.select([0, 1])).expect("two words"));
    let seal_options = SealOptions::new(scheme.parse().expect("a scheme")).expect("it hides positions");
    let sealer = Sealer::new(&profile, seal_options).expect("two words");
    let mut device = rand_chacha::ChaCha20Rng::seed_from_u64(seed);
    let mut session = Session::new(options, &mut device);
    poses
        .into_iter()
        .map(|pose| {
            let keypoint = |x: &Point3<World>| {
                let p = see(&pose, x).expect("all frames see it");
                let pixel =
                    Pixel::new(p.u + DETECTOR_PX * normal(&mut rng), p.v + DETECTOR_PX * normal(&mut rng));
                Keypoint { pixel, scale: 2.0, orientation: 0.0, response: 1.0 }
            };
            let keypoints = points.iter().map(keypoint).collect();
            let features = Features { keypoints, descriptors: descriptors.clone(), global: None };
            let error = Vector3::from_fn(|_, _| trajectory.gyroscope_deg.to_radians() * normal(&mut rng));
            let felt = Rotation3::from_scaled_axis(error) * *pose.rotation();
            let held = Orientation::in_world(felt).expect("finite");
            let extracted = Extracted::new(features, camera()).with_orientation(held);
            let sealed = sealer.in_session(&mut session).seal_with_truth(extracted, &mut device);
            let (query, truth) = sealed.expect("it can be sealed");
            let lines = Observation::of_sent(&query.observations());
            let descriptors = DecodedDescriptors::new(query.descriptors().expect("rows").as_bytes(), 128)
                .expect("whole rows");
            Sealed { query, truth, pose, lines, descriptors }
        })
        .collect()
}

/// Bits over the prior-only baseline for real keypoints of the first frame; without an answer the baseline is used.
fn bits(first: &Sealed, found: &[Option<Pixel>], rows: impl Fn(usize) -> bool) -> f64 {
    let prior = prior_only(&first.lines, 640, 480);
    let mut errors = (Vec::new(), Vec::new());
    for (i, truth) in first.truth.pixels.iter().enumerate() {
        if first.truth.source[i].is_some() && rows(i) {
            errors.0.push(found[i].unwrap_or(prior[i]).distance(truth));
            errors.1.push(prior[i].distance(truth));
        }
    }
    assert!(errors.0.len() > 150, "{}", errors.0.len());
    bits_over_prior(&errors.0, &errors.1, 640, 480)
}

/// Information about the first frame from the planes of all frames, bits over the baseline.
fn bits_from_planes(frames: &[&Sealed]) -> f64 {
    let camera = frames[0].query.camera();
    let views: Vec<Frame<'_>> = frames
        .iter()
        .map(|f| Frame {
            camera,
            cam_from_world: f.pose,
            observations: &f.lines,
            descriptors: &f.descriptors,
        })
        .collect();
    let found = multi_view_attack(&views, &FramesOptions::with_depths([0.7, 20.0])).expect("they fit");
    let found: Vec<Option<Pixel>> = found.iter().map(|s| s.pixel).collect();
    bits(frames[0], &found, |_| true)
}

/// Information from the scatter of a stationary camera, for an attacker who knows how codes are made without a
/// session's memory.
fn bits_from_scatter(frames: &[&Sealed], noise_px: f64, dither_px: f64, cell: f64) -> f64 {
    // Rows of each feature in the first frame's order.
    let rows = |frame: &&Sealed| -> Vec<Option<Observation>> {
        let of = |i: usize| {
            let source = frames[0].truth.source[i]?;
            let row = frame.truth.source.iter().position(|other| *other == Some(source))?;
            Some(frame.lines[row])
        };
        (0..frames[0].lines.len()).map(of).collect()
    };
    let others: Vec<Vec<Option<Observation>>> = frames[1..].iter().map(rows).collect();
    let mut options = StaticCameraOptions::of_one_image(cell).with_noise(noise_px);
    options.dither_px = dither_px;
    let found = static_camera(&frames[0].lines, &others, (640, 480), &options).expect("they fit");
    let found: Vec<Option<Pixel>> = found.iter().map(|s| s.pixel).collect();
    bits(frames[0], &found, |_| true)
}

const TURNS: Trajectory = Trajectory { frames: 6, turned: 0.12, moved: 0.0, gyroscope_deg: 0.0 };

/// Bits of `n` frames, and of the first frame repeated `n` times: what the attack gains without new information.
fn compared_with_one_frame(frames: &[Sealed], bits_of: impl Fn(&[&Sealed]) -> f64) -> [f64; 2] {
    let all: Vec<&Sealed> = frames.iter().collect();
    [bits_of(&all), bits_of(&vec![&frames[0]; frames.len()])]
}

#[test]
fn l10_session_frames_give_no_joint_information() {
    for scheme in LAYOUTS {
        let striped = scheme == STRIPES;
        // The device knows its rotation up to the gyroscope's error. Sectors also exclude positions of a keypoint
        // that moves against them; finer sectors exclude more.
        for (trajectory, most) in [
            (TURNS, if striped { 0.5 } else { 0.15 }),
            (Trajectory { gyroscope_deg: 0.2, ..TURNS }, if striped { 0.5 } else { 0.15 }),
            (Trajectory { moved: 0.02, gyroscope_deg: 0.2, ..TURNS }, if striped { 0.6 } else { 0.3 }),
            (Trajectory { moved: 0.3, ..TURNS }, if striped { 1.6 } else { 0.6 }),
            (Trajectory { moved: 0.3, gyroscope_deg: 0.2, ..TURNS }, if striped { 2.0 } else { 1.3 }),
        ] {
            let bits_of = |options| {
                let frames = sealed(trajectory, scheme, options, 7);
                bits_from_planes(&frames.iter().collect::<Vec<_>>())
            };
            let (session, independent) = (bits_of(SessionOptions::default()), bits_of(image_fixed()));
            println!(
                "{scheme}: moved {}, gyroscope {}: session {session:+.2}, independent {independent:+.2}",
                trajectory.moved, trajectory.gyroscope_deg
            );
            assert!(session < most, "{scheme}: {session} bits from planes of a session");
            assert!(independent > session + 3.0, "{scheme}: {independent} bits from planes of single frames");
        }
    }
}

#[test]
fn l10_stationary_camera_repeats_its_codes() {
    for scheme in LAYOUTS {
        let rest = Trajectory { frames: 8, turned: 0.0, moved: 0.0, gyroscope_deg: 0.1 };
        let frames = sealed(rest, scheme, SessionOptions::default(), 8);
        let [session, once] =
            compared_with_one_frame(&frames, |f| bits_from_scatter(f, DETECTOR_PX, 0.0, 0.002));
        let leak = sealed(Trajectory { gyroscope_deg: 0.0, ..rest }, scheme, without_memory(), 8);
        let cell = std::f64::consts::PI / 4096.0;
        let [scattered, _] = compared_with_one_frame(&leak, |f| bits_from_scatter(f, DETECTOR_PX, 0.5, cell));
        println!("{scheme}: at rest: session {:+.2}, scattered {scattered:+.2}", session - once);
        assert!(
            session < once + 0.05,
            "{scheme}: {session} bits from the scatter of a session, {once} from one frame"
        );
        assert!(scattered > once + 0.5, "{scheme}: {scattered} bits from scatter");
    }
}

/// No keypoint that a frame joins to one anchor is joined to another by a later frame, under any motion: two such
/// lines would intersect in the keypoint.
#[test]
fn l10_keypoints_keep_their_anchor() {
    let crossing = |trajectory: Trajectory, options: SessionOptions| {
        let frames = sealed(trajectory, STRIPES, options, 9);
        let mut anchors = std::collections::BTreeMap::new();
        let mut changed = 0;
        for frame in &frames {
            for (source, line) in frame.truth.source.iter().zip(&frame.lines) {
                let (Some(source), Observation::Pencil(row)) = (source, line) else { continue };
                changed += usize::from(*anchors.entry(*source).or_insert(row.anchor) != row.anchor);
            }
        }
        changed
    };
    for moved in [0.0, 0.05, 0.3] {
        let trajectory = Trajectory { moved, gyroscope_deg: 0.2, ..TURNS };
        assert_eq!(crossing(trajectory, SessionOptions::default()), 0, "moved by {moved}");
    }
    // The band alone protects under rotation, but not under translation.
    let without = SessionOptions::default().with_memory(false);
    assert!(crossing(Trajectory { moved: 0.3, ..TURNS }, without) > 50);
    assert_eq!(crossing(TURNS, without.with_band_deg(1.0)), 0);
}
