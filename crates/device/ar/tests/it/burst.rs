//! Bursts: which frames are kept, what is sent, and that the server localizes it.

use rand::{CryptoRng, RngCore};
use rand_chacha::ChaCha20Rng;
use rand_chacha::rand_core::SeedableRng;
use veiloc_ar::{
    Alignment, Burst, BurstError, BurstOptions, CameraFrame, CameraFromAr, PixelFormat, QuarterTurns,
    RigError, SealedBurst, Update, orientation_in_world, rig_message,
};
use veiloc_features::Image;
use veiloc_geometry::nalgebra::Vector3;
use veiloc_geometry::{Anchor, Stop};
use veiloc_localization::{LocalizeOptions, localize_rig};
use veiloc_obfuscation::{KnownPlace, PackUse, SealErrorKind, SealOptions, Sealer, Session, SessionOptions};
use veiloc_pose::State;
use veiloc_protocol::{CoarseGravity, Observations, RigMessage, SealedQuery, SeparateAnchors};

use crate::room::{Frame, Room, known, room};
use crate::walk;

const SIZE: (u32, u32) = (400, 300);

fn rng() -> ChaCha20Rng {
    ChaCha20Rng::from_seed([7; 32])
}

fn session() -> Session {
    Session::new(SessionOptions::default(), &mut rng())
}

fn burst() -> Burst {
    Burst::new(BurstOptions::default().with_metres_per_unit(1.0)).expect("options")
}

fn offer(burst: &mut Burst, frame: &Frame, seconds: f64) -> bool {
    burst.offer(&frame.camera_frame(), &known(), &frame.cam_from_ar, seconds).expect("finite")
}

fn sealer(options: SealOptions) -> Sealer {
    Sealer::new(room().map.profile(), options).expect("its profile")
}

fn seal(burst: &mut Burst, session: &mut Session) -> Result<SealedBurst, BurstError> {
    burst.seal(&sealer(SealOptions::default()), session, &Stop::default(), &mut rng())
}

/// A burst of the frames of this many seconds.
fn burst_of(room: &Room, seconds: &[f64]) -> (Burst, Vec<Frame>) {
    let mut burst = burst();
    let frames: Vec<Frame> = seconds.iter().map(|s| room.frame(*s)).collect();
    for (frame, s) in frames.iter().zip(seconds) {
        assert!(offer(&mut burst, frame, *s), "{s}");
    }
    (burst, frames)
}

fn black(frame: &Frame) -> Frame {
    frame.with_pixels(vec![0; frame.pixels.len()])
}

/// Mean of neighbours along rows: blurred by a turn of the camera.
fn blurred(frame: &Frame) -> Frame {
    let mean = |i: usize| {
        let window = &frame.pixels[i.saturating_sub(4)..(i + 5).min(frame.pixels.len())];
        (window.iter().map(|p| u32::from(*p)).sum::<u32>() / window.len() as u32) as u8
    };
    frame.with_pixels((0..frame.pixels.len()).map(mean).collect())
}

#[test]
fn a_burst_is_localized_and_trusted() {
    let room = room();
    let (mut burst, frames) = burst_of(&room, &[0.0, 0.4, 0.8]);
    let sealed = seal(&mut burst, &mut session()).expect("texture");
    assert_eq!((sealed.message.frames.len(), sealed.left_out), (3, 0));
    assert!(sealed.keypoints > 256 && (0.1..0.9).contains(&sealed.brightness));
    let received = RigMessage::decode(&sealed.message.encode()).expect("decodes");
    let found = localize_rig(&received.frames, &room.map, &LocalizeOptions::default()).expect("localized");
    assert_eq!((found.state, found.inlier_frame_count()), (State::Trusted, 3));
    let newest = &frames[2];
    for (k, frame) in found.frames.iter().enumerate() {
        let error = frame.cam_from_world.translation_error(&frames[2 - k].cam_from_map);
        assert!(error < 0.03, "frame {k} is {error} m off");
    }
    // The answer is about the newest frame, whose pose the app adds with it.
    assert!((found.rig_from_world.center().coords - newest.cam_from_map.center().coords).norm() < 0.03);
    let mut alignment = Alignment::default();
    let answer = walk::answer(&found.frames[0].cam_from_world, true);
    assert_eq!(alignment.add(&answer, &sealed.cam_from_ar), Update::Used);
    let aligned = alignment.aligned().expect("one answer").ar_from_map;
    assert!(aligned.rotation().angle_to(room.ar_from_map.rotation()).to_degrees() < 0.5);
    assert!((aligned.translation() - room.ar_from_map.translation()).norm() < 0.05);
}

#[test]
fn a_burst_with_a_pack_sends_matches_and_is_trusted() {
    let room = room();
    let (pack, _) = room.map.pack().expect("points");
    let place = KnownPlace::new(pack).expect("compact");
    let sealer = sealer(SealOptions::default().with_place(place.clone(), PackUse::Matches));
    // The sealers of a burst are made as this one, and share the pack that was prepared once.
    let other = Sealer::new(sealer.profile(), sealer.options().clone().only_balanced()).expect("its profile");
    for own in [&sealer, &other] {
        assert!(std::ptr::eq(own.place().expect("a pack").pack(), place.pack()));
    }
    let (mut burst, frames) = burst_of(&room, &[0.0, 0.4, 0.8]);
    let mut session = session();
    let sealed = burst.seal(&sealer, &mut session, &Stop::default(), &mut rng()).expect("the place");
    assert_eq!((sealed.message.frames.len(), sealed.left_out), (3, 0));
    let received = RigMessage::decode(&sealed.message.encode()).expect("decodes");
    assert!(received.frames.iter().all(|frame| frame.query.descriptors().is_none()));
    let found = localize_rig(&received.frames, &room.map, &LocalizeOptions::default()).expect("localized");
    assert_eq!((found.state, found.inlier_frame_count()), (State::Trusted, 3));
    for (k, frame) in found.frames.iter().enumerate() {
        let error = frame.cam_from_world.translation_error(&frames[2 - k].cam_from_map);
        assert!(error < 0.03, "frame {k} is {error} m off");
    }
    // Nothing of another place is sealed.
    let before = session.clone();
    let mut elsewhere = self::burst();
    let mut noise = rng();
    let pixels = (0..frames[0].pixels.len()).map(|_| noise.next_u32() as u8).collect();
    offer(&mut elsewhere, &frames[0].with_pixels(pixels), 0.0);
    let error = elsewhere.seal(&sealer, &mut session, &Stop::default(), &mut rng()).expect_err("noise");
    assert!(
        matches!(&error, BurstError::Frame(e) if e.kind() == SealErrorKind::NotThisPlace),
        "{error}: {:?}",
        sealer.place()
    );
    assert!(session == before);
}

/// The frames contradict each other then. Either they lose their influence, or the pose its trust.
#[test]
fn a_wrong_unit_makes_no_wrong_pose_trusted() {
    let room = room();
    for metres_per_unit in [0.01, 0.1, 0.5, 2.0, 10.0] {
        let options = BurstOptions::default().with_metres_per_unit(metres_per_unit);
        let mut burst = Burst::new(options).expect("options");
        for seconds in [0.0, 0.4, 0.8] {
            offer(&mut burst, &room.frame(seconds), seconds);
        }
        let sealed = seal(&mut burst, &mut session()).expect("texture");
        let Ok(found) = localize_rig(&sealed.message.frames, &room.map, &LocalizeOptions::default()) else {
            continue;
        };
        let off = found.frames[0].cam_from_world.translation_error(&room.frame(0.8).cam_from_map);
        assert!(off < 0.03 || found.state != State::Trusted, "{metres_per_unit}: {off} m off");
    }
}

#[test]
fn a_burst_of_one_frame_is_sealed_as_the_frame() {
    let room = room();
    let frame = room.frame(0.0);
    // Rows with gaps, turned.
    let padded: Vec<u8> =
        frame.pixels.chunks(400).flat_map(|row| row.iter().copied().chain([9; 16])).collect();
    let padded = CameraFrame::new(PixelFormat::Gray, SIZE, &padded, 416).expect("a frame");
    let padded = padded.turned(QuarterTurns::from_degrees(90).expect("a quarter"));
    let (mut own, mut other) = (session(), session());
    let mut burst = Burst::new(BurstOptions::default().with_frames(1)).expect("options");
    burst.offer(&padded, &known(), &frame.cam_from_ar, 1.0).expect("finite");
    let sealed = seal(&mut burst, &mut own).expect("texture");
    let (image, sealer) = (Image::from(&padded), sealer(SealOptions::default()));
    let brightness = image.gray().mean();
    let orientation = orientation_in_world(&frame.cam_from_ar).expect("finite");
    let extracted = sealer.extract(image, known()).expect("texture").with_orientation(orientation);
    let keypoints = extracted.features().keypoints.len();
    let alone = sealer.in_session(&mut other).seal(extracted, &mut rng()).expect("texture");
    assert_eq!(sealed.message.frames[0].query.encode(), alone.encode());
    assert!(own == other);
    assert_eq!((sealed.keypoints, sealed.brightness), (keypoints, brightness));
    let on_rig = &sealed.message.frames[0];
    assert_eq!((on_rig.rotation_sd_deg, on_rig.translation_sd), (0.0, 0.0));
}

#[test]
fn poses_are_relative_to_the_newest_frame_and_errors_add_up() {
    let room = room();
    let options = BurstOptions::default().with_sds(0.2, 0.03).with_metres_per_unit(0.5);
    let mut burst = Burst::new(options).expect("options");
    let frames = [0.0, 0.4, 0.8].map(|seconds| {
        let frame = room.frame(seconds);
        offer(&mut burst, &frame, seconds);
        frame
    });
    let sealed = seal(&mut burst, &mut session()).expect("texture");
    assert_eq!(sealed.cam_from_ar, frames[2].cam_from_ar);
    for (k, on_rig) in sealed.message.frames.iter().enumerate() {
        let expected = frames[2 - k].cam_from_ar.compose(&sealed.cam_from_ar.inverse());
        // Two units of this map are a metre.
        assert!((on_rig.cam_from_rig.translation() - 2.0 * expected.translation()).norm() < 1e-9);
        let turn = on_rig.cam_from_rig.rotation().matrix() - expected.rotation().matrix();
        assert!(turn.norm() < 1e-9);
        let steps = (k as f64).sqrt();
        assert!((on_rig.rotation_sd_deg - 0.2 * steps).abs() < 1e-12);
        assert!((on_rig.translation_sd - 0.06 * steps).abs() < 1e-12);
    }
}

/// Frames that an app sealed one by one make a rig if they are of one session.
#[test]
fn a_rig_of_several_sessions_is_refused() {
    let room = room();
    let frames = [0.0, 0.8].map(|seconds| room.frame(seconds));
    let poses = frames.each_ref().map(|frame| frame.cam_from_ar);
    let sealer = sealer(SealOptions::default());
    let seal = |frame: &Frame, session: Option<&mut Session>| {
        let extracted = sealer.extract(Image::from(&frame.camera_frame()), known()).expect("texture");
        let orientation = orientation_in_world(&frame.cam_from_ar).expect("finite");
        let extracted = extracted.with_orientation(orientation);
        match session {
            Some(session) => sealer.in_session(session).seal(extracted, &mut rng()).expect("texture"),
            None => sealer.seal(extracted, &mut rng()).expect("texture"),
        }
    };
    let rig = |queries| rig_message(queries, &poses, 1.0, 0.1, 0.01);
    let (mut own, mut other) =
        (session(), Session::new(SessionOptions::default(), &mut ChaCha20Rng::from_seed([8; 32])));
    let one = seal(&frames[0], Some(&mut own));
    assert!(rig(vec![one.clone(), seal(&frames[1], Some(&mut own))]).is_ok());
    let refused = RigError::SeparateAnchors(SeparateAnchors { first: 0, second: 1 });
    for query in [seal(&frames[1], Some(&mut other)), seal(&frames[1], None)] {
        assert_eq!(rig(vec![one.clone(), query]).expect_err("refused"), refused);
    }
    assert_eq!(rig(frames.iter().map(|frame| seal(frame, None)).collect()).expect_err("refused"), refused);
}

#[test]
fn gravity_is_sent_once_and_only_if_the_app_allows_it() {
    let room = room();
    let gravity_of = |options: SealOptions| -> Vec<Option<CoarseGravity>> {
        let (mut burst, _) = burst_of(&room, &[0.0, 0.4]);
        let sealed =
            burst.seal(&sealer(options), &mut session(), &Stop::default(), &mut rng()).expect("texture");
        sealed.message.frames.iter().map(|frame| frame.query.gravity()).collect()
    };
    let newest = room.frame(0.4);
    let down = newest.cam_from_map.rotation() * -Vector3::z();
    let rounded = CoarseGravity::new(down.into(), 0.5).expect("a direction");
    assert_eq!(gravity_of(SealOptions::default()), [Some(rounded), None]);
    assert_eq!(gravity_of(SealOptions::default().without_gravity()), [None, None]);
}

#[test]
fn frames_that_cannot_be_sealed_are_left_out() {
    let room = room();
    for dark in 0..3 {
        let mut burst = burst();
        let mut frames: Vec<Frame> = [0.0, 0.4, 0.8].iter().map(|s| room.frame(*s)).collect();
        frames[dark] = black(&frames[dark]);
        for (i, frame) in frames.iter().enumerate() {
            offer(&mut burst, frame, 0.4 * i as f64);
        }
        let mut session = session();
        let sealed = seal(&mut burst, &mut session).expect("two frames with texture");
        assert_eq!((sealed.message.frames.len(), sealed.left_out, session.frames()), (2, 1, 2));
        // The newest that is left is the rig.
        let newest = if dark == 2 { 1 } else { 2 };
        assert_eq!(sealed.cam_from_ar, frames[newest].cam_from_ar);
        assert!(sealed.message.frames[0].query.gravity().is_some());
    }
}

#[test]
fn a_burst_that_cannot_be_sealed_leaves_the_session() {
    let room = room();
    let mut session = session();
    seal(&mut burst_of(&room, &[0.0]).0, &mut session).expect("texture");
    let before = session.clone();
    let mut dark = burst();
    for seconds in [0.0, 0.4] {
        offer(&mut dark, &black(&room.frame(seconds)), seconds);
    }
    let error = seal(&mut dark, &mut session).expect_err("no texture");
    assert!(matches!(&error, BurstError::Frame(e) if e.kind() == SealErrorKind::Texture), "{error}");
    assert!(dark.is_empty() && session == before);
    assert!(matches!(seal(&mut dark, &mut session), Err(BurstError::Empty)));
}

/// Stops the extraction of the next frame as soon as random numbers are drawn for this one.
struct Stopping<'a>(ChaCha20Rng, &'a Stop);

impl RngCore for Stopping<'_> {
    fn next_u32(&mut self) -> u32 {
        self.1.set();
        self.0.next_u32()
    }

    fn next_u64(&mut self) -> u64 {
        self.1.set();
        self.0.next_u64()
    }

    fn fill_bytes(&mut self, bytes: &mut [u8]) {
        self.1.set();
        self.0.fill_bytes(bytes);
    }
}

impl CryptoRng for Stopping<'_> {}

#[test]
fn a_burst_that_is_stopped_between_two_frames_leaves_the_session() {
    let room = room();
    let (mut burst, _) = burst_of(&room, &[0.0, 0.4]);
    let (stop, mut session) = (Stop::default(), session());
    let before = session.clone();
    let sealer = sealer(SealOptions::default());
    let sealed = burst.seal(&sealer, &mut session, &stop, &mut Stopping(rng(), &stop));
    let stopped = sealed.expect_err("stopped");
    assert!(matches!(&stopped, BurstError::Frame(e) if e.kind() == SealErrorKind::Stopped), "{stopped}");
    assert!(session == before);
}

#[test]
fn the_sharpest_frame_of_a_part_is_kept() {
    let room = room();
    let mut burst = burst();
    let sharp = room.frame(0.0);
    let (soft, later) = (blurred(&room.frame(0.1)), room.frame(0.2));
    assert!(offer(&mut burst, &soft, 0.0));
    assert!(offer(&mut burst, &sharp, 0.1), "sharper");
    assert!(!offer(&mut burst, &soft, 0.2), "not sharper");
    assert_eq!(burst.len(), 1);
    // In the next part, even a frame that is not sharp is the only one.
    assert!(offer(&mut burst, &blurred(&later), 0.4));
    let sealed = seal(&mut burst, &mut session()).expect("texture");
    assert_eq!(sealed.cam_from_ar, later.cam_from_ar);
    let of_sharp = sharp.cam_from_ar.compose(&later.cam_from_ar.inverse());
    let oldest = sealed.message.frames.last().expect("frames").cam_from_rig;
    assert!((oldest.translation() - of_sharp.translation()).norm() < 1e-12);
}

#[test]
fn each_part_of_the_window_keeps_one_frame() {
    // Frames of a prime rate, so that no part begins with one of them.
    let pixels = vec![0; 400 * 300];
    let frame = CameraFrame::new(PixelFormat::Gray, SIZE, &pixels, 0).expect("a frame");
    let pose = CameraFromAr::identity();
    for frames in 1..=BurstOptions::MAX_FRAMES {
        let options = BurstOptions::default().with_frames(frames).with_metres_per_unit(1.0);
        let mut burst = Burst::new(options).expect("options");
        for i in 0..100 {
            let elapsed = f64::from(i) / 29.0;
            burst.offer(&frame, &known(), &pose, 1e6 + elapsed).expect("finite");
            let parts = (elapsed * frames as f64).floor() as usize + 1;
            assert_eq!(burst.len(), parts.min(frames), "{frames} frames, {elapsed} s");
        }
    }
}

#[test]
fn frames_after_a_gap_or_of_another_clock_start_anew() {
    let room = room();
    let frame = room.frame(0.0);
    let lengths = |times: &[f64]| -> Vec<usize> {
        let mut burst = burst();
        let length = |seconds: &f64| {
            offer(&mut burst, &frame, *seconds);
            burst.len()
        };
        times.iter().map(length).collect()
    };
    assert_eq!(lengths(&[5.0, 5.4, 5.8, 6.2]), [1, 2, 3, 3]);
    assert_eq!(lengths(&[5.0, 5.4, 6.5]), [1, 2, 1], "a gap");
    assert_eq!(lengths(&[5.0, 5.4, 2.0, 2.4]), [1, 2, 1, 2], "time goes back");
    assert_eq!(lengths(&[5.0, 5.9]), [1, 2], "a part without frames");
    // The same frame, once more, also after it was sealed.
    let mut burst = burst();
    assert!(offer(&mut burst, &frame, 5.0) && !offer(&mut burst, &frame, 5.0));
    assert_eq!((burst.take().len(), burst.len()), (1, 0));
    assert!(!offer(&mut burst, &frame, 5.0) && offer(&mut burst, &frame, 5.1));
    burst.clear();
    assert!(burst.is_empty());
}

#[test]
fn numbers_that_are_not_finite_are_refused_and_change_nothing() {
    let frame = room().frame(0.0);
    let mut burst = burst();
    assert!(offer(&mut burst, &frame, 1.0));
    for timestamp in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let refused = burst.offer(&frame.camera_frame(), &known(), &frame.cam_from_ar, timestamp);
        assert!(matches!(refused, Err(BurstError::Timestamp)), "{refused:?}");
    }
    for nowhere in [f64::NAN, f64::INFINITY] {
        let pose = CameraFromAr::new(*frame.cam_from_ar.rotation(), Vector3::new(0.0, nowhere, 0.0));
        let refused = burst.offer(&frame.camera_frame(), &known(), &pose, 1.4);
        assert!(matches!(refused, Err(BurstError::Pose)), "{refused:?}");
    }
    assert_eq!(burst.len(), 1);
    assert!(offer(&mut burst, &frame, 1.4), "the last time is still that of the first frame");
    assert_eq!(burst.len(), 2);
}

#[test]
fn options_that_are_not_possible_are_refused() {
    let default = BurstOptions::default().with_metres_per_unit(1.0);
    for options in [
        default.with_frames(0),
        default.with_frames(6),
        default.with_window(0.0),
        default.with_window(f64::NAN),
        default.with_window(f64::INFINITY),
    ] {
        assert!(matches!(Burst::new(options), Err(BurstError::Window { .. })), "{options:?}");
    }
    for options in [
        default.with_sds(-0.1, 0.01),
        default.with_sds(0.1, f64::NAN),
        default.with_metres_per_unit(0.0),
        default.with_metres_per_unit(f64::INFINITY),
    ] {
        assert!(matches!(Burst::new(options), Err(BurstError::Rig(_))), "{options:?}");
    }
}

/// L10: a camera that rests sends the same rows again, and its angles do not scatter.
#[test]
fn frames_of_a_static_camera_repeat_their_codes() {
    let room = room();
    let mut burst = burst();
    for (seed, seconds) in [(0, 0.0), (1, 0.4), (2, 0.8)] {
        offer(&mut burst, &room.frame_at_rest(seed), seconds);
    }
    let sealed = seal(&mut burst, &mut session()).expect("texture");
    let codes = |query: &SealedQuery| -> Vec<(Anchor, u64)> {
        let Observations::Anchored { lines, .. } = query.observations() else { panic!("dcl") };
        lines.iter().map(|line| (line.anchor, line.angle.to_bits())).collect()
    };
    let all: Vec<_> = sealed.message.frames.iter().map(|frame| codes(&frame.query)).collect();
    for later in &all[1..] {
        let repeated = later.iter().filter(|code| all[0].contains(code)).count();
        assert!(10 * repeated > 9 * later.len(), "{repeated} of {}", later.len());
    }
}

#[test]
fn debug_output_has_no_pixels_and_no_poses() {
    let (burst, _) = burst_of(&room(), &[0.0]);
    let printed = format!("{burst:?}");
    assert!(printed.contains("Kept(400x300)") && printed.len() < 400, "L8: {printed}");
}
