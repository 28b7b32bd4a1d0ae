//! Version 1 of the wire format, pinned: these files must be read, and written back byte for byte, for ever.
//!
//! The files were made once by `cargo run -p veiloc-query --example known_answers`. The hashes and the meaning of
//! the rows below come from `proto/read_sealed_query.py`, a reader written from `docs/wire-format.md` alone.

use std::fs;
use std::path::PathBuf;

use sha2::{Digest, Sha256};
use veiloc_query::{Observations, Profile, ProfileId, SealedQuery};

/// File, SHA-256 of its bytes, profile it was sealed with, and the numbers the Python reader prints for rows
/// 0, 1 and 255: a position, a line `(a, b, c)`, or an anchor and a direction.
struct KnownAnswer {
    file: &'static str,
    sha256: &'static str,
    profile_id: &'static str,
    rows: [&'static [f64]; 3],
}

const ROWS: [usize; 3] = [0, 1, 255];

const KNOWN_ANSWERS: [KnownAnswer; 5] = [
    KnownAnswer {
        file: "v1-points",
        sha256: "80d054d166368a4965f8218b2c5fec61da2621568a45982762aa99fe558843ab",
        profile_id: "6c1ea78d680ff48abfa548c6deafb666",
        rows: [&[351.5, 193.25], &[630.25, 38.5], &[304.75, 108.0]],
    },
    KnownAnswer {
        file: "v1-random-lines",
        sha256: "afe0c6f2665f160ceeb28e30f823e710caa54c3d5cb6a3942232175eafe73c68",
        profile_id: "41f669c22cdd4c3d4ca9d76390b1f829",
        rows: [
            &[-0.987_962_766, -0.154_691_863, 327.524_132_391],
            &[-0.250_041_711, 0.968_235_066, -243.363_068_106],
            &[-0.798_384_132, 0.602_148_468, 61.717_290_063],
        ],
    },
    KnownAnswer {
        file: "v1-coordinate-permutation",
        sha256: "14e965404180048b4c826e1a02045e6a616fc6fb45b9ab08bfb5dacf40cd5f2a",
        profile_id: "38b3a0ee96fe0eb12fbb22fb330180ee",
        rows: [&[351.5, 193.25], &[630.25, 38.5], &[304.75, 108.0]],
    },
    KnownAnswer {
        file: "v1-dcl",
        sha256: "c9a4c00435c9136d5e5c6b86d0152165d1b431fd4167bcc2a03d9f3045b714b6",
        profile_id: "0b39cbde14aedf66902133a3ad61e244",
        rows: [
            &[320.0, 480.0, 0.953_421_788, -0.301_640_339],
            &[320.0, 480.0, 0.250_041_711, -0.968_235_066],
            &[320.0, 0.0, -0.649_972_795, 0.759_957_476],
        ],
    },
    KnownAnswer {
        file: "v1-dcl-angle-30-s-2",
        sha256: "914a8c57414a3a977856d8ef6d102a0395062b429118fb234f69d24939547042",
        profile_id: "bf81c59c439cc5140b3412ac7c9741c0",
        rows: [
            &[735.692_193_817, 480.0, 0.216_606_013, -0.976_259_102],
            &[735.692_193_817, 480.0, -0.713_226_556, -0.700_933_578],
            &[-95.692_193_817, 0.0, 0.333_517_645, 0.942_743_857],
        ],
    },
];

fn read(name: &str) -> Vec<u8> {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name);
    fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

fn hex(bytes: impl AsRef<[u8]>) -> String {
    bytes.as_ref().iter().fold(String::new(), |text, byte| text + &format!("{byte:02x}"))
}

#[test]
fn version_1_is_read_and_written_for_ever() {
    for known in KNOWN_ANSWERS {
        let bytes = read(&format!("{}.vquery", known.file));
        assert_eq!(hex(Sha256::digest(&bytes)), known.sha256, "{} was changed", known.file);
        let query = SealedQuery::decode(&bytes).unwrap_or_else(|e| panic!("{}: {e}", known.file));
        assert!(query.encode() == bytes, "{} is written otherwise now", known.file);
        assert_eq!(query.profile_id().to_string(), known.profile_id, "{}", known.file);
        let camera = query.camera();
        assert_eq!((camera.width, camera.height, camera.focal), (640, 480, [512.0; 2]));
        let observations = query.observations();
        for (row, expected) in ROWS.into_iter().zip(known.rows) {
            let told = meaning(&observations, row);
            assert_eq!(told.len(), expected.len(), "{} row {row}", known.file);
            for (a, b) in told.iter().zip(expected) {
                assert!((a - b).abs() < 1e-8, "{} row {row}: {told:?}", known.file);
            }
        }
    }
}

#[test]
fn the_profile_of_version_1_is_read_and_named_for_ever() {
    let bytes = read("v1.profile");
    let profile = Profile::decode(&bytes).expect("version 1");
    assert!(profile.encode() == bytes, "profiles are written otherwise now");
    let named = hex(&Sha256::digest(&bytes)[..16]);
    assert_eq!(profile.id().to_string(), named);
    assert_eq!(named, "0b39cbde14aedf66902133a3ad61e244");
    for known in KNOWN_ANSWERS {
        let query = SealedQuery::decode(&read(&format!("{}.vquery", known.file))).expect("version 1");
        profile.check(&query).expect("sealed for the same map");
    }
    assert_ne!(profile.id(), ProfileId::from_bytes([0; 16]));
}

fn meaning(observations: &Observations, row: usize) -> Vec<f64> {
    match observations {
        Observations::Points(pixels) => vec![pixels[row].u, pixels[row].v],
        Observations::Lines(lines) => lines[row].coefficients().iter().copied().collect(),
        Observations::EitherLine(lines) => {
            let sent = lines[row][0].intersection(&lines[row][1]).expect("they are at right angles");
            vec![sent.u, sent.v]
        }
        Observations::Anchored { anchors, lines } => {
            let position = anchors.position(lines[row].anchor);
            let direction = anchors.ray_direction(lines[row].anchor, lines[row].angle);
            vec![position.u, position.v, direction.x, direction.y]
        }
    }
}
