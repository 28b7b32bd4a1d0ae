//! Frames of one rig: those of one session may be sent together, others of one view may not (rule L10).

use super::common;

use common::{camera, features_at, options, profile, rng, seal_in, uniform_pixels};
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use veiloc_features::Features;
use veiloc_geometry::nalgebra::{Rotation3, Vector3};
use veiloc_geometry::{CameraFromRig, Intrinsics, Panorama, Pixel};
use veiloc_obfuscation::{Extracted, Orientation, Sealer, Session, SessionAnchors, SessionOptions};
use veiloc_protocol::{
    CanonicalCamera, RigMessage, SealedFrame, SealedIn, SealedQuery, SeparateAnchors, SessionTag,
};

const SEEDS: u64 = 12;
/// Standard deviations of the tracking, degrees about each axis: none, of a phone, of a poor gyroscope.
const ROTATION_SDS: [f64; 3] = [0.0, 0.1, 0.4];

/// Points all around, 2 to 6 m away.
struct Scene {
    points: Vec<Vector3<f64>>,
    whole: Features,
}

impl Scene {
    fn new(seed: u64) -> Self {
        const POINTS: usize = 6000;
        let mut rng = rng(seed);
        let mut point = || {
            let any = Vector3::from_fn(|_, _| rng.random_range(-1.0..1.0));
            any.normalize() * rng.random_range(2.0..6.0)
        };
        let points = (0..POINTS).map(|_| point()).collect();
        Self { points, whole: features_at(&uniform_pixels(POINTS, seed), seed) }
    }

    /// What a camera of 640 x 480 pixels sees from here, with half a pixel of noise.
    fn seen(&self, pose: &CameraFromRig, rng: &mut ChaCha8Rng) -> Features {
        let mut features = Features { keypoints: Vec::new(), ..self.whole.clone() };
        let mut numbers = Vec::new();
        for (i, point) in self.points.iter().enumerate() {
            let p = pose.rotation() * point + pose.translation();
            let pixel = Pixel::new(320.0 + 512.0 * p.x / p.z, 240.0 + 512.0 * p.y / p.z);
            if p.z > 0.2 && (1.0..639.0).contains(&pixel.u) && (1.0..479.0).contains(&pixel.v) {
                let mut noise = || rng.random_range(-0.5..0.5);
                let pixel = Pixel::new(pixel.u + noise(), pixel.v + noise());
                features.keypoints.push(veiloc_features::Keypoint { pixel, ..self.whole.keypoints[i] });
                numbers.push(i);
            }
        }
        features.descriptors = self.whole.descriptors.select(numbers);
        features
    }
}

fn turn(degrees: [f64; 3]) -> Rotation3<f64> {
    Rotation3::from_scaled_axis(Vector3::from(degrees.map(f64::to_radians)))
}

fn noise(sd_deg: f64, rng: &mut ChaCha8Rng) -> Rotation3<f64> {
    // A sum of uniform numbers, nearly normal.
    let mut normal = || (0..12).map(|_| rng.random_range(-0.5..0.5)).sum::<f64>() * sd_deg;
    turn([normal(), normal(), normal()])
}

/// Poses of a walking, turning device, of which the first is the rig.
fn walk(step_deg: f64, rng: &mut ChaCha8Rng) -> Vec<CameraFromRig> {
    let mut poses = vec![CameraFromRig::identity()];
    for k in 1..4 {
        let mut any = |most: f64| rng.random_range(-most..most);
        let rotation = turn([any(3.0), f64::from(k) * step_deg + any(2.0), any(3.0)]);
        poses.push(CameraFromRig::new(rotation, Vector3::new(any(0.3), any(0.1), any(0.3))));
    }
    poses
}

/// Seals what a device sees, with what it measured of its motion, each frame in the session of `session_of`.
fn sealed(
    seed: u64,
    (scheme, sd): (&str, f64),
    step_deg: f64,
    sessions: &mut [Session],
    session_of: impl Fn(usize) -> usize,
) -> RigMessage {
    let (scene, profile, mut rng) = (Scene::new(seed), profile(), rng(seed));
    let mut frames = Vec::new();
    for (k, pose) in walk(step_deg, &mut rng).into_iter().enumerate() {
        let sd = if k == 0 { 0.0 } else { sd };
        let measured = noise(sd, &mut rng) * pose.rotation();
        let down: [f64; 3] = (measured * Vector3::y()).into();
        let held = Orientation::in_world(measured).and_then(|o| o.with_down(down)).expect("finite");
        let features = scene.seen(&pose, &mut rng);
        let session = &mut sessions[session_of(k)];
        let (query, _) = seal_in(session, features, &camera(), &profile, &options(scheme), &held, &mut rng)
            .expect("texture");
        let cam_from_rig = CameraFromRig::new(measured, *pose.translation());
        frames.push(SealedFrame { query, cam_from_rig, rotation_sd_deg: sd, translation_sd: 0.01 });
    }
    RigMessage { frames }
}

fn session(anchors: SessionAnchors, seed: u64) -> Session {
    // Anchors in the image are placed anew in each frame.
    let most = (anchors != SessionAnchors::Image).then_some(2);
    Session::new(SessionOptions::default().with_anchors(anchors).with_max_starts(most), &mut rng(1000 + seed))
}

fn received(message: &RigMessage) -> RigMessage {
    RigMessage::decode(&message.encode()).expect("its own bytes")
}

#[test]
fn frames_of_one_session_may_be_sent_together() {
    for anchors in [SessionAnchors::World, SessionAnchors::Gravity, SessionAnchors::Image] {
        for sd in ROTATION_SDS {
            for seed in 0..SEEDS {
                let mut own = [session(anchors, seed)];
                let message = sealed(seed, ("dcl", sd), 6.0, &mut own, |_| 0);
                assert_eq!(message.check_anchors(), Ok(()), "{anchors}, {sd} degrees, seed {seed}");
                // Files say nothing of the session: the anchors decide.
                if anchors != SessionAnchors::Image {
                    assert_eq!(own[0].starts(), 1, "{anchors}, {sd} degrees, seed {seed}");
                    let read = received(&message);
                    assert_eq!(read.check_anchors(), Ok(()), "{anchors}, {sd} degrees, seed {seed}");
                }
            }
        }
    }
}

/// A camera that turned away from its first view: the session places its anchors anew and drops what it sent.
#[test]
fn a_session_with_new_anchors_may_be_sent_together() {
    let mut own = [session(SessionAnchors::World, 1)];
    let message = sealed(1, ("dcl:paper", 0.1), 40.0, &mut own, |_| 0);
    assert!(own[0].starts() > 1);
    assert_eq!(message.check_anchors(), Ok(()));
    // From bytes, the name of its session says it.
    let mut read = received(&message);
    assert!(read.check_anchors().is_err());
    let tag: SessionTag = own[0].tag().to_string().parse().expect("its own text");
    let restored = Session::from_bytes(&own[0].to_bytes()).expect("its own bytes");
    assert!(tag == restored.tag() && tag != session(SessionAnchors::World, 2).tag());
    for frame in &mut read.frames {
        frame.query = frame.query.clone().with_sealed_in(SealedIn::Session(tag));
    }
    assert_eq!(read.check_anchors(), Ok(()));
}

/// Without an orientation a session begins anew, with all keypoints: an image and a retry, whose lines cross.
#[test]
fn frames_before_and_after_a_retry_are_refused() {
    let (scene, profile, mut rng) = (Scene::new(4), profile(), rng(4));
    let mut own = session(SessionAnchors::World, 4);
    let poses = walk(6.0, &mut rng);
    let mut frames = Vec::new();
    for (pose, known) in poses.iter().zip([true, true, false]) {
        let held =
            Orientation::in_world(*pose.rotation()).filter(|_| known).unwrap_or_else(Orientation::unknown);
        let features = scene.seen(pose, &mut rng);
        let sealed = seal_in(&mut own, features, &camera(), &profile, &options("dcl"), &held, &mut rng);
        let (query, cam_from_rig) = (sealed.expect("texture").0, *pose);
        frames.push(SealedFrame { query, cam_from_rig, rotation_sd_deg: 0.1, translation_sd: 0.01 });
    }
    assert_eq!(own.starts(), 2, "the third saw parallax, which is no rotation");
    let mut message = RigMessage { frames };
    assert_eq!(message.check_anchors(), Err(SeparateAnchors { first: 0, second: 2 }));
    message.frames.pop();
    assert_eq!(message.check_anchors(), Ok(()));
    // The part goes on after it was stored.
    let restored = Session::from_bytes(&own.to_bytes()).expect("its own bytes");
    assert!(restored.tag() == own.tag() && own.tag() != session(SessionAnchors::World, 4).tag());
}

#[test]
fn frames_of_several_sessions_are_refused() {
    let mut refused = 0;
    for anchors in [SessionAnchors::World, SessionAnchors::Gravity, SessionAnchors::Image] {
        for seed in 0..SEEDS {
            let mut own = [session(anchors, seed), session(anchors, 100 + seed)];
            let message = sealed(seed, ("dcl", 0.1), 6.0, &mut own, |k| usize::from(k > 1));
            let expected = Err(SeparateAnchors { first: 0, second: 2 });
            assert_eq!(message.check_anchors(), expected, "{anchors}, seed {seed}");
            // Levelled anchors of two sessions are nearly the same where the camera did not turn about the vertical.
            let read = received(&message).check_anchors();
            assert!(read.is_err() || anchors == SessionAnchors::Gravity, "{anchors}, seed {seed}");
            refused += u64::from(read.is_err());
        }
    }
    assert!(refused >= 2 * SEEDS);
}

/// Even where anchors agree: keypoints near borders of sectors have other anchors in the other view.
#[test]
fn frames_sealed_alone_are_refused() {
    let (scene, profile, mut rng) = (Scene::new(1), profile(), rng(1));
    let mut message_of = |scheme: &str, rotation: Rotation3<f64>, base: f64| {
        let sealer = Sealer::new(&profile, options(scheme)).expect("its profile");
        let poses = [CameraFromRig::identity(), CameraFromRig::new(rotation, Vector3::new(base, 0.0, 0.0))];
        let frames = poses.map(|cam_from_rig| {
            let extracted = Extracted::new(scene.seen(&cam_from_rig, &mut rng), camera());
            let query = sealer.seal(extracted, &mut rng).expect("texture");
            SealedFrame { query, cam_from_rig, rotation_sd_deg: 0.0, translation_sd: 0.0 }
        });
        RigMessage { frames: frames.into() }
    };
    let refused = Err(SeparateAnchors { first: 0, second: 1 });
    for (angle, base) in [(0.0, -0.1), (10.0, -0.1), (10.0, 0.0), (180.0, -0.1)] {
        let message = message_of("dcl", turn([0.0, angle, 0.0]), base);
        assert_eq!(message.check_anchors(), refused, "{angle} degrees");
        let expected = if angle == 0.0 { Ok(()) } else { refused };
        assert_eq!(received(&message).check_anchors(), expected, "{angle} degrees, from bytes");
    }
    // From one place in opposite directions no keypoint is in both.
    assert_eq!(message_of("dcl", turn([0.0, 180.0, 0.0]), 0.0).check_anchors(), Ok(()));
    // Other schemes have no anchors that a session could share.
    for scheme in ["points", "random-lines", "coordinate-permutation"] {
        assert_eq!(message_of(scheme, turn([0.0, 10.0, 0.0]), -0.1).check_anchors(), Ok(()), "{scheme}");
    }
    // One protected frame beside an unprotected one is not of its session.
    let mut mixed = message_of("dcl", turn([0.0, 10.0, 0.0]), -0.1);
    mixed.frames[1].query = message_of("random-lines", Rotation3::identity(), 0.0).frames.remove(0).query;
    assert_eq!(mixed.check_anchors(), refused);
}

#[test]
fn images_of_a_panorama_may_be_sealed_alone() {
    let (scene, profile, mut rng) = (Scene::new(2), profile(), rng(2));
    let sealer = Sealer::new(&profile, options("dcl")).expect("its profile");
    for width in [512, 676, 1000, 2048, 5760, 8192] {
        let faces = Panorama::new(width, width / 2).expect("2:1").faces();
        let mut frame = |face: &veiloc_geometry::PanoramaFace| {
            let mut features = scene.seen(&face.cam_from_rig, &mut rng);
            let scale = f64::from(face.camera.width) / 640.0;
            for keypoint in &mut features.keypoints {
                keypoint.pixel = Pixel::new(keypoint.pixel.u * scale, keypoint.pixel.v * scale);
            }
            let query = sealer.seal(Extracted::new(features, face.camera), &mut rng).expect("texture");
            let cam_from_rig = face.cam_from_rig;
            SealedFrame { query, cam_from_rig, rotation_sd_deg: 0.0, translation_sd: 0.0 }
        };
        let mut message = RigMessage { frames: faces.iter().map(&mut frame).collect() };
        assert_eq!(message.check_anchors(), Ok(()), "{width}");
        assert_eq!(received(&message).check_anchors(), Ok(()), "{width}, from bytes");
        // With a deviation, or turned so that two overlap, they may show one keypoint.
        message.frames[1].rotation_sd_deg = 1.0;
        assert!(message.check_anchors().is_err(), "{width}");
        message.frames[1].rotation_sd_deg = 0.0;
        let front = message.frames[0].cam_from_rig;
        message.frames[0].cam_from_rig =
            CameraFromRig::new(turn([0.0, 15.0, 0.0]) * front.rotation(), *front.translation());
        assert!(message.check_anchors().is_err(), "{width}");
    }
}

/// The lenses of one model differ by a few percent, and some of them are in the next class of the list: in a session they share
/// the camera of the first, and the anchors with it.
#[test]
fn similar_lenses_of_a_rig_share_their_anchors() {
    let (scene, profile) = (Scene::new(3), profile());
    let lens = |focal: f64| -> Intrinsics {
        format!("SIMPLE_PINHOLE,640,480,{focal},322,239").parse().expect("valid")
    };
    let own = |lens: &Intrinsics| CanonicalCamera::for_intrinsics(lens).expect("ordinary");
    assert_ne!(own(&lens(500.0)), own(&lens(520.0)));
    for scheme in ["dcl", "dcl:paper", "dcl:axis=90:sectors=16:anchors=@90+@0"] {
        for lenses in [[lens(500.0), lens(520.0)], [lens(520.0), lens(500.0)]] {
            let mut rng = rng(3);
            let mut session = session(SessionAnchors::World, 3);
            let poses = [
                CameraFromRig::identity(),
                CameraFromRig::new(turn([1.0, 4.0, 0.5]), Vector3::new(-0.1, 0.0, 0.0)),
            ];
            let mut frames = Vec::new();
            for (lens, cam_from_rig) in lenses.iter().zip(poses) {
                let mut features = scene.seen(&cam_from_rig, &mut rng);
                for keypoint in &mut features.keypoints {
                    let at = |v: f64, middle: f64, own: f64| {
                        own + (v - middle) / 512.0 * lens.pinhole().mean_focal()
                    };
                    keypoint.pixel =
                        Pixel::new(at(keypoint.pixel.u, 320.0, 322.0), at(keypoint.pixel.v, 240.0, 239.0));
                }
                let held = Orientation::in_world(*cam_from_rig.rotation()).expect("finite");
                let positions: Vec<Pixel> = features.keypoints.iter().map(|k| k.pixel).collect();
                let (query, truth) =
                    seal_in(&mut session, features, lens, &profile, &options(scheme), &held, &mut rng)
                        .expect("texture");
                assert_eq!(query.canonical_camera(), own(&lenses[0]), "{scheme}");
                let veiloc_protocol::Observations::Anchored { pencils, lines } = query.observations() else {
                    panic!("no anchors")
                };
                for ((source, pixel), line) in truth.source.iter().zip(&truth.pixels).zip(lines) {
                    assert!(pencils.camera().contains(*pixel, 1e-6), "{scheme}: {pixel:?}");
                    let Some(source) = source else { continue };
                    let shown = pencils.camera().project(lens.unproject(positions[*source]).expect("a ray"));
                    assert!(shown.distance(pixel) < 1e-9, "{scheme}");
                    let off = (pencils.angle_of(line.anchor, *pixel) - line.angle).abs();
                    let off = off.min(std::f64::consts::TAU - off);
                    // A cell, or the row of a keypoint of the first frame in nearly the same direction.
                    assert!(
                        off * pencils.distance(line.anchor, *pixel)
                            < 4.0 + 0.003 * pencils.distance(line.anchor, *pixel),
                        "{scheme}: {off}"
                    );
                }
                frames.push(SealedFrame { query, cam_from_rig, rotation_sd_deg: 0.0, translation_sd: 0.0 });
            }
            assert_eq!(session.starts(), 1);
            let message = RigMessage { frames };
            assert_eq!(message.check_anchors(), Ok(()));
            assert_eq!(received(&message).check_anchors(), Ok(()));
        }
    }
}

/// The name of a session stays on the device.
#[test]
fn the_session_of_a_query_is_not_sent() {
    let mut own = [session(SessionAnchors::World, 1)];
    let message = sealed(1, ("dcl", 0.1), 6.0, &mut own, |_| 0);
    let tag = own[0].tag();
    for frame in &message.frames {
        assert_eq!(frame.query.sealed_in(), SealedIn::Session(tag));
        let bytes = frame.query.encode();
        for other in [SealedIn::Unknown, SealedIn::Alone, SealedIn::Session(SessionTag([7; 8]))] {
            let other = frame.query.clone().with_sealed_in(other);
            assert!(other.encode() == bytes && other == frame.query);
        }
        assert_eq!(SealedQuery::decode(&bytes).expect("its own bytes").sealed_in(), SealedIn::Unknown);
    }
    assert!(!message.encode().windows(8).any(|window| window == tag.0));
    assert!(!format!("{message:?}").contains(&tag.to_string()));
}
