//! Versions 1 to 4 of the wire format, pinned: these files must be read, and written back byte for byte, for ever.
//!
//! The files were made once by `cargo run -p veiloc-protocol --example known_answers`. The hashes and the meaning of
//! the rows below come from `proto/read_sealed_query.py`, a reader written from `docs/wire-format.md` alone.

use std::fs;
use std::path::PathBuf;

use sha2::{Digest, Sha256};
use veiloc_protocol::{FocalKnowledge, Observations, Profile, ProfileId, SealedQuery, WireVersion};

/// File, SHA-256 of its bytes, profile it was sealed with, and the numbers the Python reader prints for rows
/// 0, 1 and 255: a position, a line `(a, b, c)`, or an anchor and a direction.
struct KnownAnswer {
    file: &'static str,
    sha256: &'static str,
    profile_id: &'static str,
    rows: [&'static [f64]; 3],
}

const ROWS: [usize; 3] = [0, 1, 255];

const KNOWN_ANSWERS: [KnownAnswer; 19] = [
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
    KnownAnswer {
        file: "v2-points",
        sha256: "ef25edd45d98c8a93b1a96df2a5a8c300a0b60095e8682d2d7ed934dc1387938",
        profile_id: "79aa18e6486e5b6928205eda0541b6c1",
        rows: [&[351.5, 193.25], &[630.25, 38.5], &[304.75, 108.0]],
    },
    KnownAnswer {
        file: "v2-random-lines",
        sha256: "569063c9d6f1ae5a913590851895570d9c0ee7d56cce2512829a0dd5953d48e5",
        profile_id: "79aa18e6486e5b6928205eda0541b6c1",
        rows: [
            &[-0.987_962_766, -0.154_691_863, 327.524_132_391],
            &[-0.250_041_711, 0.968_235_066, -243.363_068_106],
            &[-0.798_384_132, 0.602_148_468, 61.717_290_063],
        ],
    },
    KnownAnswer {
        file: "v2-coordinate-permutation",
        sha256: "4140344c6951d591a837a2c46796766c2798558ca7751b535504c49837d1e05f",
        profile_id: "79aa18e6486e5b6928205eda0541b6c1",
        rows: [&[351.5, 193.25], &[630.25, 38.5], &[304.75, 108.0]],
    },
    KnownAnswer {
        file: "v2-dcl",
        sha256: "b9e8a94feb09a1b8012e9f941e0b99c3a12ca49319ac85532a22bdbfb47c697d",
        profile_id: "79aa18e6486e5b6928205eda0541b6c1",
        rows: [
            &[320.0, 480.0, 0.953_421_788, -0.301_640_339],
            &[320.0, 480.0, 0.250_041_711, -0.968_235_066],
            &[320.0, 0.0, -0.649_972_795, 0.759_957_476],
        ],
    },
    KnownAnswer {
        file: "v2-dcl-angle-30-s-2",
        sha256: "9dc3c3015bf72e33bdfaee9a8e40729dd318dcc145168b372adbefc6201cd0cf",
        profile_id: "79aa18e6486e5b6928205eda0541b6c1",
        rows: [
            &[735.692_193_817, 480.0, 0.216_606_013, -0.976_259_102],
            &[735.692_193_817, 480.0, -0.713_226_556, -0.700_933_578],
            &[-95.692_193_817, 0.0, 0.333_517_645, 0.942_743_857],
        ],
    },
    KnownAnswer {
        file: "v2-own-kind",
        sha256: "05dd696a500a85a7f04d4ee2ecdcf38242ae649ef9286d00ae1cb36d142a36b1",
        profile_id: "4bb760015d15a07d1a06cf685eada72e",
        rows: [
            &[320.0, 480.0, 0.953_421_788, -0.301_640_339],
            &[320.0, 480.0, 0.250_041_711, -0.968_235_066],
            &[320.0, 0.0, -0.649_972_795, 0.759_957_476],
        ],
    },
    KnownAnswer {
        file: "v3-points",
        sha256: "7835bb1d137bc2b899b116befe9864e66bc5fbf1728e5026b8277a1e400e3e0a",
        profile_id: "79aa18e6486e5b6928205eda0541b6c1",
        rows: [&[351.5, 193.25], &[630.25, 38.5], &[304.75, 108.0]],
    },
    KnownAnswer {
        file: "v3-random-lines",
        sha256: "bfea24a090f0539cff962e3d765b61920677e47abf804b50fc88e4e832fd38a6",
        profile_id: "79aa18e6486e5b6928205eda0541b6c1",
        rows: [
            &[-0.987_962_766, -0.154_691_863, 327.524_132_391],
            &[-0.250_041_711, 0.968_235_066, -243.363_068_106],
            &[-0.798_384_132, 0.602_148_468, 61.717_290_063],
        ],
    },
    KnownAnswer {
        file: "v3-coordinate-permutation",
        sha256: "fba09ecd1bde7ec66c25c94f98314d448168275605b0cefcc9c48f7af703cfb5",
        profile_id: "79aa18e6486e5b6928205eda0541b6c1",
        rows: [&[351.5, 193.25], &[630.25, 38.5], &[304.75, 108.0]],
    },
    KnownAnswer {
        file: "v3-dcl",
        sha256: "537e50777f6eb653f5941f6c04080c26803bbfa1aaf28b07f555a8a8261609e4",
        profile_id: "79aa18e6486e5b6928205eda0541b6c1",
        rows: [
            &[320.0, 480.0, 0.953_421_788, -0.301_640_339],
            &[320.0, 480.0, 0.250_041_711, -0.968_235_066],
            &[320.0, 0.0, -0.649_972_795, 0.759_957_476],
        ],
    },
    KnownAnswer {
        file: "v3-dcl-angle-30-s-2",
        sha256: "a386b04b5a6aed37ddbe591eb0518c1917e082df1ae6034bc100d06b6b1407a0",
        profile_id: "79aa18e6486e5b6928205eda0541b6c1",
        rows: [
            &[735.692_193_817, 480.0, 0.216_606_013, -0.976_259_102],
            &[735.692_193_817, 480.0, -0.713_226_556, -0.700_933_578],
            &[-95.692_193_817, 0.0, 0.333_517_645, 0.942_743_857],
        ],
    },
    KnownAnswer {
        file: "v3-exif-gravity",
        sha256: "a834d7cc8831c4246149c91d1f0154e92487d8429d3a724cc45176db65ef80f2",
        profile_id: "79aa18e6486e5b6928205eda0541b6c1",
        rows: [
            &[320.0, 480.0, 0.953_421_788, -0.301_640_339],
            &[320.0, 480.0, 0.250_041_711, -0.968_235_066],
            &[320.0, 0.0, -0.649_972_795, 0.759_957_476],
        ],
    },
    KnownAnswer {
        file: "v3-unknown-gravity",
        sha256: "d42996314ed9969b1179941371071a1d0338e9c90d1496a019076362329e021d",
        profile_id: "79aa18e6486e5b6928205eda0541b6c1",
        rows: [
            &[320.0, 480.0, 0.953_421_788, -0.301_640_339],
            &[320.0, 480.0, 0.250_041_711, -0.968_235_066],
            &[320.0, 0.0, -0.649_972_795, 0.759_957_476],
        ],
    },
    KnownAnswer {
        file: "v3-own-kind",
        sha256: "a11ed61ee654f22219f995e379267439f4211d0a39eadd6d4f2bd727f19a9f29",
        profile_id: "4bb760015d15a07d1a06cf685eada72e",
        rows: [
            &[320.0, 480.0, 0.953_421_788, -0.301_640_339],
            &[320.0, 480.0, 0.250_041_711, -0.968_235_066],
            &[320.0, 0.0, -0.649_972_795, 0.759_957_476],
        ],
    },
];

/// The same of version 4: a row is the unit normal of its half-plane and the direction that leads into it from the anchor.
const KNOWN_ANSWERS_4: [KnownAnswer; 4] = [
    KnownAnswer {
        file: "v4-stripes",
        sha256: "6cd0a9edadf7eb8d896acf4a36ddf0da9a62921c5edf3dc116d3734d50b2b6ce",
        profile_id: "79aa18e6486e5b6928205eda0541b6c1",
        rows: [
            &[0.333_149_211, 0.818_246_731, -0.468_491_078, 0.474_193_444, -0.574_867_191, -0.666_834_53],
            &[0.280_409_96, -0.875_143_908, -0.394_326_507, -0.507_166_711, -0.483_862_728, 0.713_203_188],
            &[-0.362_695_418, -0.830_681_788, -0.422_397_681, -0.926_341_875, 0.370_832_237, 0.066_137_598],
        ],
    },
    KnownAnswer {
        file: "v4-board",
        sha256: "535641ee739eda194f6548cf52b177db285510a028c41fa9f879651661fe3433",
        profile_id: "79aa18e6486e5b6928205eda0541b6c1",
        rows: [
            &[0.0, 0.818_246_731, -0.574_867_191, 0.0, -0.574_867_191, -0.818_246_731],
            &[-0.875_143_908, -0.025_769_388, -0.483_176_032, -0.483_862_728, 0.046_608_102, 0.873_901_908],
            &[0.0, -0.154_691_863, -0.987_962_766, 0.0, -0.987_962_766, 0.154_691_863],
        ],
    },
    KnownAnswer {
        file: "v4-session",
        sha256: "70f54dd60d3f5c2220a778a6e9b446ae8c2f13a20e7b4829a326b62a15c0ed27",
        profile_id: "79aa18e6486e5b6928205eda0541b6c1",
        rows: [
            &[0.282_425_14, -0.857_418_731, -0.430_196_653, -0.454_322_71, 0.275_416_838, -0.847_193_272],
            &[-0.532_122_487, 0.623_089_332, -0.573_241_087, -0.054_943_093, 0.650_216_117, 0.757_760_026],
            &[0.593_509_194, -0.780_067_884, -0.198_093_244, -0.767_996_157, -0.475_320_045, -0.429_246_733],
        ],
    },
    KnownAnswer {
        file: "v4-halves",
        sha256: "5a8232fbc245f546a6656be84bafc57db71ebec1f4cf56635a44539c23cbbe14",
        profile_id: "79aa18e6486e5b6928205eda0541b6c1",
        rows: [
            &[-0.648_017_052, 0.524_550_687, -0.552_196_049, 0.601_243_271, 0.797_379_81, 0.051_884_172],
            &[0.824_308_14, 0.487_138_092, 0.288_465_889, 0.319_273_647, -0.820_770_653, 0.473_708_638],
            &[0.144_042_931, -0.834_032_838, -0.532_579_439, -0.909_098_162, 0.101_058_958, -0.404_138_119],
        ],
    },
];

/// What queries of version 3 say of their camera: file, how well the focal length is known, and, as the Python reader
/// prints it, which way is down and the deviation.
const HINTS: [(&str, FocalKnowledge, Option<[f64; 4]>); 3] = [
    ("v3-dcl", FocalKnowledge::Calibrated, None),
    ("v3-exif-gravity", FocalKnowledge::Exif, Some([0.033_122_946, 0.979_492_831, -0.198_737_676, 1.0])),
    (
        "v3-unknown-gravity",
        FocalKnowledge::Unknown,
        Some([-0.911_477_019, 0.104_957_96, -0.397_735_427, 8.0]),
    ),
];

/// Profiles of version 2 and the SHA-256 of their bytes, which they are named after.
const PROFILES_2: [(&str, &str); 2] = [
    ("v2.profile", "79aa18e6486e5b6928205eda0541b6c1d293245fb417b9e361cc13390b28ce15"),
    ("v2-own-kind.profile", "4bb760015d15a07d1a06cf685eada72eea627f94dec299196714a2d1ed7f8e1d"),
];

fn read(name: &str) -> Vec<u8> {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name);
    fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

fn hex(bytes: impl AsRef<[u8]>) -> String {
    bytes.as_ref().iter().fold(String::new(), |text, byte| text + &format!("{byte:02x}"))
}

#[test]
fn every_version_is_read_and_written_for_ever() {
    for known in KNOWN_ANSWERS.iter().chain(&KNOWN_ANSWERS_4) {
        let bytes = read(&format!("{}.vquery", known.file));
        assert_eq!(hex(Sha256::digest(&bytes)), known.sha256, "{} was changed", known.file);
        let query = SealedQuery::decode(&bytes).unwrap_or_else(|e| panic!("{}: {e}", known.file));
        assert!(query.encode() == bytes, "{} is written otherwise now", known.file);
        assert_eq!(query.profile_id().to_string(), known.profile_id, "{}", known.file);
        let camera = query.camera();
        assert_eq!((camera.width, camera.height, camera.focal), (640, 480, [512.0; 2]));
        let observations = query.observations();
        for (row, expected) in ROWS.into_iter().zip(known.rows) {
            let told = meaning(query.version(), &observations, row);
            assert_eq!(told.len(), expected.len(), "{} row {row}", known.file);
            for (a, b) in told.iter().zip(expected) {
                assert!((a - b).abs() < 1e-8, "{} row {row}: {told:?}", known.file);
            }
        }
    }
}

#[test]
fn what_is_said_of_a_camera_is_read_for_ever() {
    for (file, focal, down) in HINTS {
        let query = SealedQuery::decode(&read(&format!("{file}.vquery"))).expect("known");
        assert_eq!(query.focal_known(), focal, "{file}");
        let told = query.gravity().map(|g| (g.in_camera(), g.sd_deg()));
        assert_eq!(told.is_some(), down.is_some(), "{file}");
        if let (Some((told, sd)), Some([x, y, z, expected])) = (told, down) {
            assert!(told.iter().zip([x, y, z]).all(|(a, b)| (a - b).abs() < 1e-8), "{file}: {told:?}");
            assert!((sd - expected).abs() < 1e-12, "{file}: {sd}");
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
    assert_ne!(profile.id(), ProfileId::from_bytes([0; 16]));
}

#[test]
fn profiles_of_version_2_are_read_and_named_for_ever() {
    for (file, sha256) in PROFILES_2 {
        let bytes = read(file);
        let profile = Profile::decode(&bytes).unwrap_or_else(|e| panic!("{file}: {e}"));
        assert!(profile.encode() == bytes, "{file} is written otherwise now");
        assert_eq!(hex(Sha256::digest(&bytes)), sha256, "{file} was changed");
        assert_eq!(profile.id().to_string(), sha256[..32]);
        assert_eq!(profile.wish(), None);
    }
}

/// A map whose profile became version 2 still takes what devices sealed with its version 1, and the other way round.
#[test]
fn queries_of_both_versions_belong_to_one_map() {
    let v1 = Profile::decode(&read("v1.profile")).expect("version 1");
    let v2 = Profile::decode(&read("v2.profile")).expect("version 2");
    let own = Profile::decode(&read("v2-own-kind.profile")).expect("version 2");
    assert_eq!(v1.to_v2(), v2);
    assert_eq!(v2.to_v1(v1.wish().expect("version 1 has one")), Some(v1.clone()));
    for known in KNOWN_ANSWERS.iter().chain(&KNOWN_ANSWERS_4) {
        let query = SealedQuery::decode(&read(&format!("{}.vquery", known.file))).expect("known");
        let belongs = !known.file.ends_with("own-kind");
        for profile in [&v1, &v2] {
            assert_eq!(profile.check(&query).is_ok(), belongs, "{}", known.file);
        }
        assert_eq!(own.check(&query).is_ok(), !belongs, "{}", known.file);
    }
}

fn meaning(version: WireVersion, observations: &Observations, row: usize) -> Vec<f64> {
    match observations {
        Observations::Anchored { pencils, lines } if version == WireVersion::V4 => {
            let ([d, zero, quarter], (sin, cos)) =
                (pencils.frame(lines[row].anchor), lines[row].angle.sin_cos());
            let inward = zero * cos + quarter * sin;
            d.cross(&inward).iter().chain(&inward).copied().collect()
        }
        Observations::Points(pixels) => vec![pixels[row].u, pixels[row].v],
        Observations::Lines(lines) => lines[row].coefficients().iter().copied().collect(),
        Observations::EitherLine(lines) => {
            let sent = lines[row][0].intersection(&lines[row][1]).expect("they are at right angles");
            vec![sent.u, sent.v]
        }
        Observations::Anchored { pencils, lines } => {
            let line = pencils.along(lines[row].anchor, lines[row].angle).expect("it meets the image");
            vec![line.origin.u, line.origin.v, line.direction.x, line.direction.y]
        }
    }
}
