//! A stored session continues as if it had never been interrupted; invalid bytes are rejected.

use super::common;

use common::{camera, features_at, options, profile, rng, seal_in, uniform_pixels};
use veiloc_geometry::nalgebra::Rotation3;
use veiloc_obfuscation::{Orientation, SealError, Session, SessionAnchors, SessionOptions};

const STRIPES: &str = "dcl:axis=115:sectors=20:anchors=0.23/-0.33+-0.88/-0.47";

/// A session after this many frames of a camera at rest.
fn after(frames: usize, options: SessionOptions, scheme: &str) -> Session {
    let mut rng = rng(3);
    let mut session = Session::new(options, &mut rng);
    for _ in 0..frames {
        next(&mut session, scheme);
    }
    session
}

fn next(session: &mut Session, scheme: &str) -> Vec<u8> {
    let held = Orientation::in_world(Rotation3::from_euler_angles(0.1, 0.2, 0.3)).expect("finite");
    let held = held.with_down([0.1, 1.0, 0.0]).expect("a direction");
    let features = features_at(&uniform_pixels(500, 1), 2);
    let mut rng = rng(17);
    seal_in(session, features, &camera(), &profile(), &options(scheme), &held, &mut rng)
        .expect("a query")
        .0
        .encode()
}

#[test]
fn stored_session_continues() {
    for anchors in [SessionAnchors::World, SessionAnchors::Gravity] {
        for scheme in ["dcl", STRIPES] {
            for frames in 0..3 {
                let mut session = after(frames, SessionOptions::default().with_anchors(anchors), scheme);
                let bytes = session.to_bytes();
                let mut again = Session::from_bytes(&bytes).expect("a session");
                assert_eq!(again.to_bytes(), bytes);
                assert_eq!(next(&mut again, scheme), next(&mut session, scheme));
                assert_eq!((again.frames(), again.starts()), (frames as u32 + 1, 1));
            }
        }
    }
    let mut any = after(2, SessionOptions::default().with_max_starts(None).with_memory(false), "dcl");
    let mut again = Session::from_bytes(&any.to_bytes()).expect("a session");
    assert_eq!(next(&mut again, "dcl"), next(&mut any, "dcl"));
}

#[test]
fn invalid_bytes_are_rejected() {
    let bytes = after(2, SessionOptions::default(), STRIPES).to_bytes();
    for length in (0..bytes.len()).step_by(997).chain([8, 12, 13, bytes.len() - 1]) {
        assert!(Session::from_bytes(&bytes[..length]).is_err(), "{length} bytes");
    }
    let mut longer = bytes.clone();
    longer.push(0);
    assert!(matches!(Session::from_bytes(&longer), Err(SealError::SessionDamaged { what: "checksum" })));
    for at in (0..bytes.len()).step_by(401) {
        let mut changed = bytes.clone();
        changed[at] ^= 1;
        assert!(Session::from_bytes(&changed).is_err(), "byte {at}");
    }
    assert!(matches!(Session::from_bytes(b"something else"), Err(SealError::NotASession)));
    let mut newer = bytes.clone();
    newer[8] = 2;
    assert!(matches!(Session::from_bytes(&newer), Err(SealError::SessionVersion { found: 2, .. })));
    assert!(SealError::SessionVersion { found: 2, supported: 1 }.to_string().contains("begin a new session"));
}

#[test]
fn invalid_fields_with_valid_checksum_are_rejected() {
    use sha2::{Digest as _, Sha256};
    let bytes = after(1, SessionOptions::default(), STRIPES).to_bytes();
    let mut refused = 0;
    // Every byte of the header and of the first landmarks, set to all ones and with its highest bit flipped.
    for at in 12..600 {
        for value in [0xFF, bytes[at] ^ 0x80] {
            let mut changed = bytes.clone();
            changed[at] = value;
            let body = changed.len() - 32;
            let sum = Sha256::digest(&changed[..body]);
            changed[body..].copy_from_slice(&sum);
            // Never a panic, and an accepted session can be continued.
            match Session::from_bytes(&changed) {
                Err(_) => refused += 1,
                Ok(mut session) => {
                    let held = Orientation::unknown();
                    let features = features_at(&uniform_pixels(400, 1), 2);
                    let _ = seal_in(
                        &mut session,
                        features,
                        &camera(),
                        &profile(),
                        &options(STRIPES),
                        &held,
                        &mut rng(1),
                    );
                    let _ = session.to_bytes();
                }
            }
        }
    }
    assert!(refused > 300, "{refused}");
}
