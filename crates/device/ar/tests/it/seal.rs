//! Frames give the same query as the same pixels in an image.

use rand_chacha::ChaCha20Rng;
use rand_chacha::rand_core::SeedableRng;
use veiloc_ar::{Axes, CameraFrame, FrameworkPose, PixelFormat, QuarterTurns, orientation_in_world, rig_of};
use veiloc_descriptor::{DescriptorKind, Descriptors, Vocabulary};
use veiloc_features::{GrayImage, Image};
use veiloc_geometry::nalgebra::Vector3;
use veiloc_geometry::{Intrinsics, Stop};
use veiloc_obfuscation::{
    Orientation, SealError, SealErrorKind, SealOptions, Sealer, Session, SessionAnchors, SessionOptions,
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

fn sealer(options: SealOptions) -> Sealer {
    Sealer::new(&profile(), options).expect("two words")
}

#[test]
fn a_frame_gives_the_query_of_its_image() {
    let (sealer, pixels) = (sealer(SealOptions::default()), pixels());
    let sealed = |image| {
        let extracted = sealer.extract(image, camera()).expect("texture");
        sealer.seal(extracted, &mut rng()).expect("enough").encode()
    };
    let expected = sealed(GrayImage::from_luma8(SIZE.0, SIZE.1, &pixels).expect("an image").into());
    // A stride, as Android has it, does not change a bit.
    let padded: Vec<u8> = pixels.chunks(320).flat_map(|row| row.iter().copied().chain([0; 64])).collect();
    for (bytes, stride) in [(&pixels, 0), (&padded, 384)] {
        let frame = CameraFrame::new(PixelFormat::Gray, SIZE, bytes, stride).expect("a frame");
        assert_eq!(sealed(Image::from(&frame)), expected);
    }
}

#[test]
fn a_stopped_frame_gives_no_features() {
    let pixels = pixels();
    let frame = CameraFrame::new(PixelFormat::Gray, SIZE, &pixels, 0).expect("a frame");
    let stop = Stop::default();
    let extract =
        || sealer(SealOptions::default()).extract(Image::from(&frame).with_stop(&stop), camera()).map(|_| ());
    assert!(extract().is_ok());
    stop.set();
    let stopped = extract();
    assert!(matches!(&stopped, Err(e) if e.kind() == SealErrorKind::Stopped), "{stopped:?}");
}

#[test]
fn a_turned_frame_gives_the_query_of_the_turned_image() {
    let (sealer, pixels) = (sealer(SealOptions::default()), pixels());
    let frame = CameraFrame::new(PixelFormat::Gray, SIZE, &pixels, 0).expect("a frame");
    let sealed = |image, camera| {
        let extracted = sealer.extract(image, camera).expect("texture");
        sealer.seal(extracted, &mut rng()).expect("enough").encode()
    };
    for turns in QuarterTurns::ALL {
        let frame = frame.turned(turns);
        let expected = sealed(frame.gray().into(), camera().turned(turns));
        assert_eq!(sealed(Image::from(&frame), camera()), expected, "{turns:?}");
    }
}

#[test]
fn the_camera_of_another_size_is_an_error() {
    let pixels = pixels();
    let other: Intrinsics = "SIMPLE_PINHOLE,240,320,300,120,160".parse().expect("valid");
    for turns in QuarterTurns::ALL {
        let frame = CameraFrame::new(PixelFormat::Gray, SIZE, &pixels, 0).expect("a frame").turned(turns);
        let error =
            sealer(SealOptions::default()).extract(Image::from(&frame), other).expect_err("another size");
        let text = error.to_string();
        assert!(
            text.contains("320x240 pixels") && text.contains("takes 240x320"),
            "the sizes before the turn: {text}"
        );
    }
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
    let of_halves = SealOptions::new("dcl:paper".parse().expect("a layout")).expect("protected");
    let (sealer, mut rng) = (sealer(of_halves.only_balanced()), rng());
    let mut session = Session::new(SessionOptions::default(), &mut rng);
    let extracted = || sealer.extract(Image::from(&frame), camera()).expect("texture");
    let alone = sealer.seal(extracted(), &mut rng);
    let in_session = sealer.in_session(&mut session).seal(extracted(), &mut rng);
    for sealed in [alone, in_session] {
        assert!(matches!(sealed, Err(SealError::Unbalanced(_))), "{sealed:?}");
    }
    assert_eq!(session.frames(), 0);
}

#[test]
fn sessions_take_orientation_and_gravity_from_the_ar_world() {
    let pixels = pixels();
    let frame = CameraFrame::new(PixelFormat::Gray, SIZE, &pixels, 0).expect("a frame");
    let (sealer, mut rng) = (sealer(SealOptions::default()), rng());
    let extracted = || sealer.extract(Image::from(&frame), camera()).expect("texture");
    let anchors = SessionOptions::default().with_anchors(SessionAnchors::Gravity);
    let mut session = Session::new(anchors, &mut rng);
    // Without a pose there is no gravity.
    let without = sealer.in_session(&mut session).seal(extracted(), &mut rng);
    assert!(matches!(without, Err(SealError::NoGravity)));
    // An ARKit camera in landscape, upright: `y` is up.
    let upright = Axes::OpenGl.cam_from_ar(&FrameworkPose::default()).expect("a pose");
    let orientation = orientation_in_world(&upright).expect("finite");
    sealer
        .in_session(&mut session)
        .seal(extracted().with_orientation(orientation), &mut rng)
        .expect("texture");
    assert_eq!((session.frames(), session.starts()), (1, 1));
    let down = orientation.cam_from_world().expect("an orientation") * -Vector3::y();
    assert!((down - Vector3::y()).norm() < 1e-12, "down is along the image's y: {down}");
}

#[test]
fn gravity_is_sent_where_a_pose_has_it_unless_it_is_switched_off() {
    let pixels = pixels();
    let frame = CameraFrame::new(PixelFormat::Gray, SIZE, &pixels, 0).expect("a frame");
    // Turned to the left about the viewing direction: down is along the image's x.
    let turned = FrameworkPose { rotation: [0.0, 0.0, 0.5_f64.sqrt(), 0.5_f64.sqrt()], ..Default::default() };
    let turned = Axes::OpenGl.cam_from_ar(&turned).expect("a pose");
    let (orientation, unknown) = (orientation_in_world(&turned).expect("finite"), Orientation::unknown());
    let measured = CoarseGravity::new([-1.0, 0.0, 0.0], 0.5).ok();
    let given = CoarseGravity::new([0.1, 0.9, 0.0], 2.0).ok();
    for in_session in [false, true] {
        let gravity_of = |options: SealOptions, orientation, given| {
            let sealer = sealer(options);
            let extracted = sealer.extract(Image::from(&frame), camera()).expect("texture");
            let extracted = extracted.with_orientation(orientation).with_gravity(given);
            let mut session = Session::new(SessionOptions::default(), &mut rng());
            let query = if in_session {
                sealer.in_session(&mut session).seal(extracted, &mut rng())
            } else {
                sealer.seal(extracted, &mut rng())
            };
            query.expect("texture").gravity()
        };
        let options = SealOptions::default();
        assert_eq!(gravity_of(options.clone(), orientation, None), measured);
        assert_eq!(gravity_of(options.clone(), unknown, None), None);
        assert_eq!(gravity_of(options.clone(), orientation, given), given);
        assert_eq!(gravity_of(options.without_gravity(), orientation, given), None);
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
