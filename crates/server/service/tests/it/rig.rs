//! Sessions: several sealed queries in, one pose out, in every format; and invalid bodies.

use super::common;

use std::num::NonZeroU32;

use common::http::{Request, Response};
use common::{Files, ManualClock, OPERATOR, PHONE, Running, TestScene, pose, truth};
use veiloc_geometry::{CameraFromRig, CameraFromWorld};
use veiloc_localization::{LocalizeOptions, localize_rig};
use veiloc_map::MapFile;
use veiloc_protocol::{Answer, RigMessage, SealedFrame, SealedQuery};

/// A device that turned and moved; the rig is the camera of its first image.
fn session(scene: &TestScene) -> RigMessage {
    let frame = |k: u32| {
        let cam = pose(0.13 - 0.05 * f64::from(k), 0.2 + 0.1 * f64::from(k));
        let relative = cam.compose(&pose(0.13, 0.2).inverse());
        SealedFrame {
            query: SealedQuery::decode(&scene.sealed(&cam)).expect("own bytes"),
            cam_from_rig: CameraFromRig::new(*relative.rotation(), *relative.translation()),
            rotation_sd_deg: 0.05 * f64::from(k.min(1)),
            translation_sd: 0.005 * f64::from(k.min(1)),
        }
    };
    RigMessage { frames: (0..3).map(frame).collect() }
}

fn ask(server: &Running, body: &[u8], accept: &str) -> Response {
    Request::post("/v1/maps/place/localize-rig", body)
        .token(PHONE)
        .header("content-type", "application/octet-stream")
        .header("accept", accept)
        .send(server.address)
}

#[test]
fn session_answer_equals_library_result() {
    let files = Files::new();
    let server = Running::start(files.options());
    let message = session(&files.scene);
    let bytes = message.encode();
    let map = MapFile::open(&files.path("place.vmap")).expect("a map");
    let read = RigMessage::decode(&bytes).expect("own bytes");
    assert!(read.encode().len() == bytes.len() && read.frames.len() == 3);
    let expected = localize_rig(&read.frames, &map, &LocalizeOptions::default()).expect("localized");
    let response = ask(&server, &bytes, "application/x-protobuf");
    assert_eq!(response.status, 200, "{}", response.text());
    assert_eq!(response.body.len(), Answer::PADDED_BYTES);
    let answer = Answer::decode(&response.body).expect("an answer");
    let response_pose = answer.pose.expect("a pose");
    let found =
        CameraFromWorld::from_quaternion(response_pose.rotation, response_pose.translation).expect("a pose");
    assert!(found.translation_error(&pose(0.13, 0.2)) < 0.03);
    assert_eq!(response_pose.covariance, expected.covariance);
    assert_eq!(answer.inliers as usize, expected.frames.iter().map(|f| f.inliers).sum::<usize>());
    let fit = answer.fit.expect("noise and focal length");
    assert!(
        answer.trusted() && fit.focal_scale == 1.0 && fit.noise_px > 0.0 && fit.noise_px < 3.0,
        "{fit:?}"
    );
    let response = ask(&server, &bytes, "application/json");
    assert_eq!((response.status, response.body.len()), (200, Answer::PADDED_BYTES));
    assert_eq!(response.json()["state"], "trusted");
    let response_pose = server.get("/metrics", OPERATOR).text();
    assert!(response_pose.contains("outcome=\"trusted\"} 2"), "{response_pose}");
}

#[test]
fn invalid_sessions_are_refused_with_equal_length() {
    let files = Files::new();
    let server = Running::start(files.options());
    let message = session(&files.scene);
    let bytes = message.encode();
    let with = |at: usize, byte: u8| {
        let mut bytes = bytes.clone();
        bytes[at] = byte;
        bytes
    };
    let mut number = bytes.clone();
    number[8..16].copy_from_slice(&f64::NAN.to_le_bytes());
    let mut deviation = bytes.clone();
    deviation[64..72].copy_from_slice(&(-1.0_f64).to_le_bytes());
    let mut length = bytes.clone();
    length[80..84].copy_from_slice(&u32::MAX.to_le_bytes());
    let other = RigMessage { frames: session(&TestScene::new(2)).frames };
    for (what, body, problem) in [
        ("nothing", Vec::new(), "malformed-query"),
        ("a single query", files.scene.sealed(&truth()), "malformed-query"),
        ("no frames", with(7, 0), "malformed-query"),
        ("too many frames", with(7, 33), "malformed-query"),
        ("a frame less than announced", with(7, 4), "malformed-query"),
        ("a frame more than announced", with(7, 2), "malformed-query"),
        ("cut short", bytes[..bytes.len() - 1].to_vec(), "malformed-query"),
        ("trailing", [bytes.as_slice(), b"x"].concat(), "malformed-query"),
        ("no pose", number, "malformed-query"),
        ("no deviation", deviation, "malformed-query"),
        ("a length beyond the end", length, "malformed-query"),
        ("another map", other.encode(), "wrong-profile"),
    ] {
        let response = ask(&server, &body, "application/json");
        assert_eq!(response.problem(), problem, "{what}: {}", response.text());
        assert_eq!(response.body.len(), Answer::PADDED_BYTES, "{what}");
    }
}

#[test]
fn session_costs_as_much_as_its_images() {
    let files = Files::new();
    let mut options = files.options();
    options.rate.per_second = NonZeroU32::MIN;
    options.rate.burst = NonZeroU32::new(4).expect("not 0");
    options.clock = ManualClock::new().clock();
    let server = Running::start(options);
    let message = session(&files.scene);
    let bytes = message.encode();
    // More than the burst size: waiting would not help.
    let long = RigMessage { frames: [&message.frames[..], &message.frames[..2]].concat() };
    let refused = ask(&server, &long.encode(), "application/json");
    assert_eq!((refused.status, refused.problem()), (413, "session-too-long".into()), "{}", refused.text());
    assert_eq!(ask(&server, &bytes, "application/json").status, 200);
    assert_eq!(ask(&server, &bytes, "application/json").problem(), "rate-limited");
}
