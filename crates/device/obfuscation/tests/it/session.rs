//! Frames of one session: anchors and sector borders are fixed in the world, angles repeat, and keypoints whose line
//! would change are dropped.

use super::common;

use common::{camera, features_at, options, profile, rng, seal, seal_in, uniform_pixels};
use veiloc_features::Features;
use veiloc_geometry::nalgebra::{Rotation3, Vector3};
use veiloc_geometry::{Anchor, Intrinsics, Pencils, Pixel};
use veiloc_obfuscation::{
    Extracted, Orientation, SealError, SealOptions, SealTruth, Sealer, Session, SessionAnchors,
    SessionOptions,
};
use veiloc_protocol::{AnchoredLine, CoarseGravity, Observations, SealedQuery};

const STRIPES: &str = "dcl:axis=115:sectors=20:anchors=0.23/-0.33+-0.88/-0.47";
const LAYOUTS: [&str; 4] = ["dcl", "dcl:angle=30,s=2", STRIPES, "dcl:axis=90:sectors=16:anchors=@90+@0"];

/// Rotations of the camera in the frames.
fn turns() -> Vec<Rotation3<f64>> {
    let turn = |x, y, z| Rotation3::from_euler_angles(x, y, z);
    vec![turn(0.3, -0.2, 0.1), turn(0.32, -0.05, 0.1), turn(0.2, -0.3, 0.25), turn(0.3, -0.2, 0.1)]
}

fn held(cam_from_world: Rotation3<f64>) -> Orientation {
    Orientation::in_world(cam_from_world).expect("finite")
}

/// Directions of distant points, so that a moving camera sees them like a rotating one.
fn directions() -> Vec<Vector3<f64>> {
    let first = turns()[0];
    let ray = |p: &Pixel| first.inverse() * Vector3::new((p.u - 320.0) / 512.0, (p.v - 240.0) / 512.0, 1.0);
    uniform_pixels(900, 4).iter().map(ray).collect()
}

/// Features that a camera with this rotation sees, with falling strengths, and the index of each direction.
fn seen(cam_from_world: &Rotation3<f64>) -> (Features, Vec<usize>) {
    let all = features_at(&uniform_pixels(900, 4), 11);
    let project = |(i, d): (usize, &Vector3<f64>)| {
        let d = cam_from_world * d;
        let pixel = Pixel::new(320.0 + 512.0 * d.x / d.z, 240.0 + 512.0 * d.y / d.z);
        let inside = d.z > 0.0 && (0.0..640.0).contains(&pixel.u) && (0.0..480.0).contains(&pixel.v);
        inside.then_some((i, pixel))
    };
    let (numbers, pixels): (Vec<usize>, Vec<Pixel>) =
        directions().iter().enumerate().filter_map(project).unzip();
    let mut keypoints: Vec<_> = numbers.iter().map(|i| all.keypoints[*i]).collect();
    for (keypoint, pixel) in keypoints.iter_mut().zip(pixels) {
        keypoint.pixel = pixel;
    }
    (
        Features { keypoints, descriptors: all.descriptors.select(numbers.iter().copied()), global: None },
        numbers,
    )
}

fn lines(query: &SealedQuery) -> (Pencils, Vec<AnchoredLine>) {
    match query.observations() {
        Observations::Anchored { pencils, lines } => (pencils, lines),
        other => panic!("{other:?} are not of dcl"),
    }
}

struct Frame {
    query: SealedQuery,
    truth: SealTruth,
    /// By row, the index of its direction; `None` for decoys.
    numbers: Vec<Option<usize>>,
}

fn sealed(scheme: &str, session: SessionOptions, turns: &[Rotation3<f64>], seed: u64) -> Vec<Frame> {
    let (mut rng, profile) = (rng(seed), profile());
    let mut session = Session::new(session, &mut rng);
    let frame = |cam_from_world: &Rotation3<f64>| {
        let (features, numbers) = seen(cam_from_world);
        let held = held(*cam_from_world);
        let (query, truth) =
            seal_in(&mut session, features, &camera(), &profile, &options(scheme), &held, &mut rng)
                .expect("it can be sealed");
        let numbers = truth.source.iter().map(|source| source.map(|s| numbers[s])).collect();
        Frame { query, truth, numbers }
    };
    turns.iter().map(frame).collect()
}

#[test]
fn anchors_are_fixed_in_the_world() {
    for scheme in LAYOUTS {
        let mut first: Option<Vec<Vector3<f64>>> = None;
        for (frame, turn) in sealed(scheme, SessionOptions::default(), &turns(), 1).iter().zip(turns()) {
            let (pencils, _) = lines(&frame.query);
            let in_world: Vec<Vector3<f64>> =
                pencils.anchors().map(|a| turn.inverse() * pencils.frame(a)[0]).collect();
            let first = first.get_or_insert_with(|| in_world.clone());
            for (a, b) in first.iter().zip(&in_world) {
                assert!(a.dot(b) > 1.0 - 1e-10, "{scheme}");
            }
            let decoded = SealedQuery::decode(&frame.query.encode()).expect("a query");
            assert_eq!(decoded, frame.query);
        }
    }
    // The same measure detects anchors that turn with the camera.
    let options = SessionOptions::default().with_anchors(SessionAnchors::Image).with_max_starts(None);
    let frames = sealed("dcl", options, &turns(), 1);
    let direction = |k: usize| turns()[k].inverse() * lines(&frames[k].query).0.frame(Anchor::FIRST)[0];
    assert!(direction(0).dot(&direction(1)) < 0.995);
}

/// Share of rows seen again that have the same anchor and angle as before.
fn repeated(frames: &[Frame], a: usize, b: usize) -> f64 {
    let given = |frame: &Frame| {
        let (_, lines) = lines(&frame.query);
        frame.numbers.iter().zip(lines).filter_map(|(n, line)| Some(((*n)?, line))).collect::<Vec<_>>()
    };
    let first: std::collections::BTreeMap<usize, AnchoredLine> = given(&frames[a]).into_iter().collect();
    let pairs: Vec<bool> = given(&frames[b])
        .iter()
        .filter_map(|(n, line)| {
            first.get(n).map(|own| own.anchor == line.anchor && (own.angle - line.angle).abs() < 1e-9)
        })
        .collect();
    assert!(pairs.len() > 100, "{} pairs", pairs.len());
    pairs.iter().filter(|same| **same).count() as f64 / pairs.len() as f64
}

#[test]
fn recognized_keypoints_repeat_their_rows() {
    for scheme in LAYOUTS {
        let frames = sealed(scheme, SessionOptions::default(), &turns(), 2);
        for (earlier, later) in [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3)] {
            let share = repeated(&frames, earlier, later);
            assert!(share > 0.99, "{scheme}: {share} of rows of frame {earlier} repeat in frame {later}");
        }
        // With a new dither per frame hardly any row repeats.
        let forgets = SessionOptions::default().with_memory(false);
        let scattered = sealed(scheme, forgets.with_step(0.0), &turns(), 2);
        assert!(repeated(&scattered, 1, 2) < 0.5, "{scheme}");
        // The grid alone repeats rows without detector noise; memory alone repeats dithered rows.
        for options in [forgets, SessionOptions::default().with_step(0.0)] {
            assert!(repeated(&sealed(scheme, options, &turns(), 2), 1, 2) > 0.99, "{scheme}");
        }
    }
}

#[test]
fn border_keypoints_are_dropped_and_anchors_persist() {
    for scheme in LAYOUTS {
        let mut anchors = std::collections::BTreeMap::new();
        for frame in sealed(scheme, SessionOptions::default().with_band_deg(1.0), &turns(), 3) {
            let (pencils, lines) = lines(&frame.query);
            let focal = pencils.camera().mean_focal();
            for ((pixel, number), line) in frame.truth.pixels.iter().zip(&frame.numbers).zip(lines) {
                assert!(pencils.clearance(*pixel) / focal >= 1.0_f64.to_radians() - 1e-9);
                if let Some(number) = number {
                    assert_eq!(*anchors.entry(*number).or_insert(line.anchor), line.anchor, "{scheme}");
                }
            }
        }
    }
}

#[test]
fn angles_are_exact_to_half_a_cell() {
    for scheme in LAYOUTS {
        for frame in sealed(scheme, SessionOptions::default(), &turns(), 5) {
            let (pencils, lines) = lines(&frame.query);
            for (pixel, line) in frame.truth.pixels.iter().zip(lines) {
                assert_eq!(pencils.anchor_of(*pixel), line.anchor);
                let off = pencils.angle_of(line.anchor, *pixel) - line.angle;
                let off =
                    (off + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU) - std::f64::consts::PI;
                // Half a cell plus the rounding of the wire.
                assert!(off.abs() < 0.002 + 0.0012, "{scheme}: {off}");
            }
        }
    }
}

#[test]
fn image_anchors_are_sealed_as_single_frames() {
    let options = SessionOptions::default().with_anchors(SessionAnchors::Image);
    let (mut own, mut single) = (rng(6), rng(6));
    let mut session = Session::new(options, &mut own);
    // The session has already drawn its key.
    rand::RngCore::fill_bytes(&mut single, &mut [0; 32]);
    let (profile, seal_options) = (profile(), SealOptions::default());
    let features = || seen(&turns()[0]).0;
    let held = held(turns()[0]);
    let (of_session, _) =
        seal_in(&mut session, features(), &camera(), &profile, &seal_options, &held, &mut own)
            .expect("a query");
    let alone = seal(features(), &camera(), &profile, &seal_options, &mut single).expect("a query");
    assert_eq!(of_session.encode(), alone.encode());
}

#[test]
fn gravity_of_the_orientation_is_sent_unless_it_is_switched_off_or_given() {
    let turn = turns()[0];
    let down = [0.1, 0.97, 0.2];
    let upright = held(turn).with_down(down).expect("a direction");
    let sent = |options: &SealOptions, held: &Orientation, given| {
        let mut session = Session::new(SessionOptions::default(), &mut rng(7));
        let extracted = Extracted::new(seen(&turn).0, camera()).with_orientation(*held).with_gravity(given);
        let sealer = Sealer::new(&profile(), options.clone()).expect("its profile");
        let query = sealer.in_session(&mut session).seal(extracted, &mut rng(8)).expect("a query");
        query.gravity()
    };
    let options = SealOptions::default();
    assert_eq!(sent(&options, &upright, None), CoarseGravity::new(down, 0.5).ok());
    assert_eq!(sent(&options, &held(turn), None), None);
    let given = CoarseGravity::new([0.0, 1.0, 0.0], 2.0).ok();
    assert_eq!(sent(&options, &upright, given), given);
    assert_eq!(sent(&options.without_gravity(), &upright, given), None);
}

#[test]
fn gravity_anchor_is_vertical_for_all_views() {
    let options = SessionOptions::default().with_anchors(SessionAnchors::Gravity);
    for turn in turns() {
        let mut rng = rng(7);
        let mut session = Session::new(options, &mut rng);
        // In a world whose y axis is down.
        let down: [f64; 3] = (turn * Vector3::y()).into();
        let given = held(turn).with_down(down).expect("a direction");
        let scheme = common::options("dcl:axis=90:sectors=16:anchors=@90+@0");
        let (query, _) =
            seal_in(&mut session, seen(&turn).0, &camera(), &profile(), &scheme, &given, &mut rng)
                .expect("a query");
        let (pencils, _) = lines(&query);
        let vertical = turn.inverse() * pencils.frame(Anchor::FIRST)[0];
        let across = turn.inverse() * pencils.frame(Anchor::SECOND)[0];
        // Gravity is rounded to about a degree, and the second anchor is level to the same accuracy.
        let rounding = 1.0_f64.to_radians().sin();
        assert!(vertical.xz().norm() < rounding && across.y.abs() < rounding, "{vertical} {across}");
        assert!(vertical.dot(&across).abs() < 1e-5);
    }
}

fn attempt(
    session: &mut Session,
    camera: &Intrinsics,
    scheme: &str,
    held: &Orientation,
) -> Result<SealedQuery, SealError> {
    seal_in(session, seen(&turns()[0]).0, camera, &profile(), &options(scheme), held, &mut rng(9))
        .map(|(query, _)| query)
}

#[test]
fn starts_per_scene_are_limited() {
    let unknown = Orientation::unknown();
    let mut session = Session::new(SessionOptions::default().with_memory(false), &mut rng(8));
    for _ in 0..2 {
        attempt(&mut session, &camera(), "dcl", &unknown).expect("an image and one retry");
    }
    let refused = attempt(&mut session, &camera(), "dcl", &unknown);
    assert!(matches!(refused, Err(SealError::TooManyStarts { starts: 2, most: 2 })));
    assert_eq!((session.frames(), session.starts()), (2, 2));

    let mut session = Session::new(SessionOptions::default(), &mut rng(8));
    for turn in turns().iter().cycle().take(8) {
        attempt(&mut session, &camera(), "dcl", &held(*turn)).expect("oriented frames share one start");
    }
    assert_eq!((session.frames(), session.starts()), (8, 1));

    // With memory the limit holds per scene, not per session: a move within the scene looks like a new start.
    let mut session = Session::new(SessionOptions::default(), &mut rng(8));
    let (profile, mut rng) = (profile(), rng(9));
    let mut frame = |features| {
        seal_in(&mut session, features, &camera(), &profile, &SealOptions::default(), &unknown, &mut rng)
            .map(|_| ())
    };
    let moved = |by: f64| {
        let mut features = features_at(&uniform_pixels(400, 4), 11);
        for (i, keypoint) in features.keypoints.iter_mut().enumerate() {
            keypoint.pixel.u += by * (1.0 + (i % 7) as f64);
        }
        features
    };
    assert!(matches!([frame(moved(0.0)), frame(moved(5.0))], [Ok(()), Ok(())]));
    for other_scene in [21, 22, 23] {
        frame(features_at(&uniform_pixels(400, other_scene), other_scene)).expect("sealed");
    }
    assert!(matches!(frame(moved(-5.0)), Err(SealError::TooManyStarts { starts: 2, most: 2 })));
}

#[test]
fn rotation_is_estimated_without_gyroscope() {
    let (profile, mut rng) = (profile(), rng(10));
    let mut session = Session::new(SessionOptions::default(), &mut rng);
    let mut directions: Vec<Vector3<f64>> = Vec::new();
    for (k, turn) in turns().iter().enumerate() {
        // The second frame gives its orientation, which allows comparison with later ones.
        let given = if k == 1 { held(*turn) } else { Orientation::unknown() };
        let (query, _) = seal_in(
            &mut session,
            seen(turn).0,
            &camera(),
            &profile,
            &SealOptions::default(),
            &given,
            &mut rng,
        )
        .expect("a query");
        directions.push(turn.inverse() * lines(&query).0.frame(Anchor::FIRST)[0]);
    }
    assert_eq!((session.frames(), session.starts()), (4, 1));
    for direction in &directions {
        assert!(direction.dot(&directions[0]) > 1.0 - 1e-8);
    }
}

#[test]
fn gyroscope_error_is_corrected_by_recognized_keypoints() {
    let direction = |memory: bool| {
        let (profile, mut rng) = (profile(), rng(10));
        let mut session = Session::new(SessionOptions::default().with_memory(memory), &mut rng);
        let [first, later] = [turns()[0], turns()[1]];
        let error = Rotation3::from_euler_angles(0.0, 0.3_f64.to_radians(), 0.0);
        let mut seal = |turn: &Rotation3<f64>, given: Rotation3<f64>| {
            let (query, _) = seal_in(
                &mut session,
                seen(turn).0,
                &camera(),
                &profile,
                &SealOptions::default(),
                &held(given),
                &mut rng,
            )
            .expect("a query");
            turn.inverse() * lines(&query).0.frame(Anchor::FIRST)[0]
        };
        seal(&first, first).angle(&seal(&later, error * later)).to_degrees()
    };
    assert!(direction(true) < 0.01, "{}", direction(true));
    assert!(direction(false) > 0.2, "{}", direction(false));
}

#[test]
fn large_rotation_starts_anew_without_repeated_keypoints() {
    let (profile, mut rng) = (profile(), rng(13));
    let mut session = Session::new(SessionOptions::default(), &mut rng);
    // Points all around a camera that pans to the right.
    let around: Vec<Vector3<f64>> = uniform_pixels(4800, 4)
        .iter()
        .map(|p| {
            let azimuth = (p.u - 320.0) / 320.0 * std::f64::consts::PI;
            Vector3::new(azimuth.sin(), (p.v - 240.0) / 500.0, azimuth.cos())
        })
        .collect();
    let whole = features_at(&uniform_pixels(4800, 4), 11);
    let mut given = std::collections::BTreeMap::new();
    let mut answered = Vec::new();
    for k in 0..12 {
        let turn = Rotation3::from_euler_angles(0.0, -0.2 * f64::from(k), 0.0);
        let (numbers, pixels): (Vec<usize>, Vec<Pixel>) = around
            .iter()
            .enumerate()
            .filter_map(|(i, d)| {
                let d = turn * d;
                let pixel = Pixel::new(320.0 + 512.0 * d.x / d.z, 240.0 + 512.0 * d.y / d.z);
                let inside = d.z > 0.1 && (0.0..640.0).contains(&pixel.u) && (0.0..480.0).contains(&pixel.v);
                inside.then_some((i, pixel))
            })
            .unzip();
        let mut keypoints: Vec<_> = numbers.iter().map(|i| whole.keypoints[*i]).collect();
        for (keypoint, pixel) in keypoints.iter_mut().zip(pixels) {
            keypoint.pixel = pixel;
        }
        let features = Features {
            keypoints,
            descriptors: whole.descriptors.select(numbers.iter().copied()),
            global: None,
        };
        let options = options("dcl:paper");
        let before = session.clone();
        let sealed = seal_in(&mut session, features, &camera(), &profile, &options, &held(turn), &mut rng);
        let (query, truth) = match sealed {
            Ok(sealed) => sealed,
            Err(error) => {
                assert!(matches!(error, SealError::TurnedAway { few: 0..32 }), "frame {k}: {error}");
                assert!(session == before);
                continue;
            }
        };
        answered.push(k);
        assert!(query.check_sides().is_ok(), "frame {k}");
        for source in truth.source.iter().flatten() {
            let start = *given.entry(numbers[*source]).or_insert(session.starts());
            assert_eq!(start, session.starts(), "frame {k} repeats a keypoint of an earlier start");
        }
    }
    assert!(session.starts() > 1 && answered.len() > 5 && answered.last() > Some(&8), "{answered:?}");
}

/// Most ambiguous matches are wrong: dropping their keypoints would cost rows without hiding anything.
#[test]
fn similar_descriptors_of_another_scene_are_not_dropped() {
    let (profile, mut rng) = (profile(), rng(14));
    let mut session = Session::new(SessionOptions::default(), &mut rng);
    let held = held(turns()[0]);
    let mut sent = Vec::new();
    for seed in 0..4 {
        // All of one distribution, without duplicates.
        let features = features_at(&uniform_pixels(600, 30 + seed), 40 + seed);
        let (_, truth) =
            seal_in(&mut session, features, &camera(), &profile, &options(STRIPES), &held, &mut rng)
                .expect("a query");
        sent.push(truth.source.iter().flatten().count());
    }
    assert_eq!(sent, [512; 4]);
}

#[test]
fn detector_noise_repeats_rows_and_side_changes_are_dropped() {
    // Frames of a camera at rest, a detector error of up to a pixel in each direction, and every fifth keypoint moving
    // right.
    let shift = |k: usize, i: usize, by: f64| {
        let noise = |n: usize| ((n * 7919 + k * 104_729) % 1000) as f64 / 500.0 - 1.0;
        let creep = if i.is_multiple_of(5) { by * k as f64 } else { 0.0 };
        [noise(i) + creep, noise(i + 31)]
    };
    for scheme in LAYOUTS {
        let (profile, mut rng) = (profile(), rng(12));
        let mut session = Session::new(SessionOptions::default(), &mut rng);
        let mut given = std::collections::BTreeMap::new();
        let (mut again, mut same) = (0, 0);
        for k in 0..6 {
            let mut features = features_at(&uniform_pixels(900, 4), 11);
            for (i, keypoint) in features.keypoints.iter_mut().enumerate() {
                let [du, dv] = shift(k, i, 25.0);
                keypoint.pixel = Pixel::new(keypoint.pixel.u + du, keypoint.pixel.v + dv);
            }
            let held = held(turns()[0]);
            let (query, truth) =
                seal_in(&mut session, features, &camera(), &profile, &options(scheme), &held, &mut rng)
                    .expect("a query");
            let (_, lines) = lines(&query);
            for (source, line) in truth.source.iter().zip(lines) {
                let Some(source) = source else { continue };
                let first = *given.entry(*source).or_insert(line);
                assert_eq!(first.anchor, line.anchor, "{scheme}: keypoint {source} of frame {k}");
                if k > 1 && !source.is_multiple_of(5) {
                    again += 1;
                    same += usize::from((first.angle - line.angle).abs() < 0.0016);
                }
            }
        }
        assert!(
            again > 1000 && f64::from(same as u32) > 0.99 * f64::from(again),
            "{scheme}: {same} of {again}"
        );
    }
}

#[test]
fn incompatible_frames_are_rejected() {
    let start = || {
        let mut session = Session::new(SessionOptions::default(), &mut rng(8));
        attempt(&mut session, &camera(), "dcl", &held(turns()[0])).expect("a query");
        session
    };
    let other_camera: Intrinsics = "SIMPLE_PINHOLE,640,480,700,320,240".parse().expect("valid");
    let changed = attempt(&mut start(), &other_camera, "dcl", &held(turns()[1]));
    assert!(matches!(changed, Err(SealError::SessionChanged { what: "camera" })));
    let changed = attempt(&mut start(), &camera(), STRIPES, &held(turns()[1]));
    assert!(matches!(changed, Err(SealError::SessionChanged { what: "scheme or layout" })));
    let mut session = Session::new(SessionOptions::default(), &mut rng(8));
    let lines = attempt(&mut session, &camera(), "random-lines", &held(turns()[0]));
    assert!(matches!(lines, Err(SealError::SessionScheme { scheme: "random-lines" })));
    let gravity = SessionOptions::default().with_anchors(SessionAnchors::Gravity);
    let mut session = Session::new(gravity, &mut rng(8));
    assert!(matches!(attempt(&mut session, &camera(), "dcl", &held(turns()[0])), Err(SealError::NoGravity)));
    assert_eq!((session.frames(), session.starts()), (0, 0));
}

#[test]
fn equal_seeds_give_equal_bytes_and_debug_is_redacted() {
    let bytes = |seed| -> Vec<Vec<u8>> {
        sealed(STRIPES, SessionOptions::default(), &turns(), seed).iter().map(|f| f.query.encode()).collect()
    };
    assert_eq!(bytes(1), bytes(1));
    assert_ne!(bytes(1), bytes(2));
    let session = Session::new(SessionOptions::default(), &mut rng(1));
    assert_eq!(format!("{session:?} {:?}", held(turns()[0])), "Session(0 frames, 0 starts) Orientation");
}
