//! Frames give the same query as the same pixels in an image.

use std::path::Path;

use rand_chacha::ChaCha20Rng;
use rand_chacha::rand_core::SeedableRng;
use veiloc_ar::{
    Axes, CameraFrame, FrameError, FrameworkPose, PixelFormat, QuarterTurns, rig_of, seal_frame,
    seal_frame_in, seal_to_send,
};
use veiloc_descriptor::{DescriptorKind, Descriptors, Vocabulary};
use veiloc_features::{GrayImage, Image};
use veiloc_geometry::nalgebra::Vector3;
use veiloc_geometry::{Intrinsics, Stop};
use veiloc_obfuscation::{
    KnownCamera, SealError, SealErrorKind, SealOptions, Session, SessionAnchors, SessionOptions,
    extract_loaded, seal,
};
use veiloc_protocol::{CoarseGravity, Profile};

const SIZE: (u32, u32) = (320, 240);

fn profile() -> Profile {
    let words = Descriptors::new(DescriptorKind::ROOT_SIFT, vec![20; 2 * 128]).expect("two words");
    Profile::vlad(Vocabulary::new(words).expect("words"))
}

fn camera() -> Intrinsics {
    "OPENCV,320,240,300,302,158,121,-0.02,0.003,0.0004,-0.0002".parse().expect("valid")
}

fn rng() -> ChaCha20Rng {
    ChaCha20Rng::from_seed([7; 32])
}

/// A gray image full of squares, bytes `[240, 320]`.
fn pixels() -> Vec<u8> {
    let shade = |x: u32, y: u32| (x / 8 * 73 + y / 8 * 151 + (x / 8) * (y / 8) * 29) % 200;
    (0..SIZE.1).flat_map(|y| (0..SIZE.0).map(move |x| (30 + shade(x, y)) as u8)).collect()
}

#[test]
fn a_frame_gives_the_query_of_its_image() {
    let (profile, options, pixels) = (profile(), SealOptions::default(), pixels());
    let image = Image::from(GrayImage::from_luma8(SIZE.0, SIZE.1, &pixels).expect("an image"));
    let (features, own) =
        extract_loaded(image, Path::new("image"), &camera(), &profile, &options).expect("texture");
    let expected = seal(features, &own, &profile, &options, &mut rng()).expect("enough").encode();
    // A stride, as Android has it, does not change a bit.
    let padded: Vec<u8> = pixels.chunks(320).flat_map(|row| row.iter().copied().chain([0; 64])).collect();
    for (bytes, stride) in [(&pixels, 0), (&padded, 384)] {
        let frame = CameraFrame::new(PixelFormat::Gray, SIZE, bytes, stride).expect("a frame");
        let known = KnownCamera::calibrated(camera());
        let sealed = seal_frame(&frame, &known, &profile, &options, &mut rng()).expect("texture");
        assert_eq!(sealed.query.encode(), expected);
        assert!((0.3..0.7).contains(&sealed.brightness) && sealed.keypoints > 256);
    }
}

#[test]
fn a_stopped_frame_gives_no_query_and_leaves_its_session() {
    let (profile, pixels) = (profile(), pixels());
    let frame = CameraFrame::new(PixelFormat::Gray, SIZE, &pixels, 0).expect("a frame");
    let known = KnownCamera::calibrated(camera());
    let stop = Stop::default();
    let options = SealOptions::default().with_stop(&stop);
    let mut session = Session::new(SessionOptions::default(), &mut rng());
    let mut seal = || seal_to_send(Some(&mut session), &frame, &known, &profile, &options, None, &mut rng());
    assert!(seal().is_ok());
    stop.set();
    let stopped = seal().map(|_| ());
    assert!(
        matches!(&stopped, Err(FrameError::Seal(e)) if e.kind() == SealErrorKind::Stopped),
        "{stopped:?}"
    );
    assert_eq!(session.frames(), 1);
}

#[test]
fn a_turned_frame_gives_the_query_of_the_turned_image() {
    let (profile, options, pixels) = (profile(), SealOptions::default(), pixels());
    let frame = CameraFrame::new(PixelFormat::Gray, SIZE, &pixels, 0).expect("a frame");
    for turns in QuarterTurns::ALL {
        let turned = camera().turned(turns);
        let image = Image::from(frame.turned(turns).gray());
        let (features, own) =
            extract_loaded(image, Path::new("image"), &turned, &profile, &options).expect("texture");
        let expected = seal(features, &own, &profile, &options, &mut rng()).expect("enough");
        let known = KnownCamera::calibrated(camera());
        let sealed = seal_frame(&frame.turned(turns), &known, &profile, &options, &mut rng());
        assert_eq!(sealed.expect("texture").query.encode(), expected.encode(), "{turns:?}");
    }
}

#[test]
fn the_camera_of_another_size_is_an_error() {
    let pixels = pixels();
    let frame = CameraFrame::new(PixelFormat::Gray, SIZE, &pixels, 0).expect("a frame");
    let known = KnownCamera::calibrated("SIMPLE_PINHOLE,240,320,300,120,160".parse().expect("valid"));
    let options = SealOptions::default();
    let error = seal_frame(&frame, &known, &profile(), &options, &mut rng()).expect_err("another size");
    assert!(matches!(error, SealError::Image(_)) && error.to_string().contains("240x320"), "{error}");
}

#[test]
fn a_query_that_cannot_determine_a_pose_is_not_given() {
    // Texture on the left, and a single patch of it on the right.
    let mut pixels = pixels();
    for (i, pixel) in pixels.iter_mut().enumerate() {
        let (x, y) = (i % 320, i / 320);
        let is_patch = (250..270).contains(&x) && (100..120).contains(&y);
        if x > 140 && !is_patch {
            *pixel = 128;
        }
    }
    let frame = CameraFrame::new(PixelFormat::Gray, SIZE, &pixels, 0).expect("a frame");
    let known = KnownCamera::calibrated(camera());
    let of_halves = SealOptions::new("dcl:paper".parse().expect("a layout")).expect("protected");
    let (options, mut rng) = (of_halves, rng());
    let mut session = Session::new(SessionOptions::default(), &mut rng);
    for stored in [Some(&mut session), None] {
        let sealed = seal_to_send(stored, &frame, &known, &profile(), &options, None, &mut rng);
        assert!(matches!(sealed, Err(FrameError::Unbalanced(_))), "{sealed:?}");
    }
    assert_eq!(session.frames(), 0);
}

#[test]
fn sessions_take_orientation_and_gravity_from_the_ar_world() {
    let (profile, pixels) = (profile(), pixels());
    let frame = CameraFrame::new(PixelFormat::Gray, SIZE, &pixels, 0).expect("a frame");
    let known = KnownCamera::calibrated(camera());
    let (options, mut rng) = (SealOptions::default(), rng());
    let anchors = SessionOptions::default().with_anchors(SessionAnchors::Gravity);
    let mut session = Session::new(anchors, &mut rng);
    // Without a pose there is no gravity.
    let without = seal_frame_in(&mut session, &frame, &known, &profile, &options, None, &mut rng);
    assert!(matches!(without, Err(SealError::NoGravity)));
    // An ARKit camera in landscape, upright: `y` is up.
    let upright = Axes::OpenGl.cam_from_ar(&FrameworkPose::default()).expect("a pose");
    seal_frame_in(&mut session, &frame, &known, &profile, &options, Some(&upright), &mut rng)
        .expect("texture");
    assert_eq!((session.frames(), session.starts()), (1, 1));
    let held = veiloc_ar::orientation_in_world(&upright).expect("finite");
    let down = held.cam_from_world().expect("an orientation") * -Vector3::y();
    assert!((down - Vector3::y()).norm() < 1e-12, "down is along the image's y: {down}");
}

#[test]
fn gravity_is_sent_where_a_pose_has_it_unless_it_is_switched_off() {
    let (profile, pixels) = (profile(), pixels());
    let frame = CameraFrame::new(PixelFormat::Gray, SIZE, &pixels, 0).expect("a frame");
    let known = KnownCamera::calibrated(camera());
    // Turned to the left about the viewing direction: down is along the image's x.
    let turned = FrameworkPose { rotation: [0.0, 0.0, 0.5_f64.sqrt(), 0.5_f64.sqrt()], ..Default::default() };
    let turned = Axes::OpenGl.cam_from_ar(&turned).expect("a pose");
    let gravity_of = |in_session: bool, options: &SealOptions, pose| {
        let mut session = Session::new(SessionOptions::default(), &mut rng());
        let session = in_session.then_some(&mut session);
        let sealed = seal_to_send(session, &frame, &known, &profile, options, pose, &mut rng());
        sealed.expect("texture").query.gravity()
    };
    let measured = CoarseGravity::new([-1.0, 0.0, 0.0], 0.5).ok();
    let given = CoarseGravity::new([0.1, 0.9, 0.0], 2.0).ok();
    for in_session in [false, true] {
        let options = SealOptions::default();
        assert_eq!(gravity_of(in_session, &options, Some(&turned)), measured);
        assert_eq!(gravity_of(in_session, &options, None), None);
        assert_eq!(gravity_of(in_session, &options.clone().without_gravity(), Some(&turned)), None);
        assert_eq!(gravity_of(in_session, &options.with_gravity(given), Some(&turned)), given);
    }
}

#[test]
fn rigs_are_relative_to_the_first_camera() {
    let pose = |x: f64| FrameworkPose { position: [x, 1.0, -2.0], ..FrameworkPose::default() };
    let cameras = [5.0, 5.5].map(|x| Axes::OpenGl.cam_from_ar(&pose(x)).expect("a pose"));
    let rig = rig_of(&cameras, 0.1);
    assert!(rig[0].translation().norm() < 1e-12 && rig[0].rotation().angle() < 1e-12);
    // Half a metre to the right is five units of this map; the rig's origin is to the left of the second camera.
    assert!((rig[1].translation() - Vector3::new(-5.0, 0.0, 0.0)).norm() < 1e-9, "{:?}", rig[1]);
    assert!(rig_of(&[], 1.0).is_empty());
}
