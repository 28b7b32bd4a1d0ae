//! The wire format, pinned: these files must be decoded, and encoded again to the same bytes.
//!
//! `cargo run -p veiloc-protocol --example known_answers` made the files. The hashes and the meaning of the rows come
//! from `proto/read_sealed_query.py`, a reader written from `docs/reference/wire-format.md` alone.

use std::fs;
use std::path::PathBuf;

use sha2::{Digest, Sha256};
use veiloc_protocol::{FocalKnowledge, Observations, Pack, Profile, QueryContent, SealedQuery};

/// File, SHA-256 of its bytes, profile it was sealed with, and the numbers that the Python reader prints for rows 0, 1
/// and 255: a position, a line `(a, b, c)`, or for dcl the unit normal of the half-plane and the direction that leads
/// into it from the anchor.
struct KnownAnswer {
    file: &'static str,
    sha256: &'static str,
    profile_id: &'static str,
    rows: [&'static [f64]; 3],
}

const ROWS: [usize; 3] = [0, 1, 255];

const KNOWN_ANSWERS: [KnownAnswer; 12] = [
    KnownAnswer {
        file: "points",
        sha256: "bf462e207fc0b8a5996811fdf667565d9958f6c855976bdaa3dae32588a69100",
        profile_id: "e2a612103bb7f7345063407a684dd970",
        rows: [&[351.5, 193.25], &[630.25, 38.5], &[304.75, 108.0]],
    },
    KnownAnswer {
        file: "random-lines",
        sha256: "8604945dd6725ae3503121f7a7492d08ddde1e4bca515a1bd8d0814bf781020f",
        profile_id: "e2a612103bb7f7345063407a684dd970",
        rows: [
            &[-0.987_962_766, -0.154_691_863, 327.524_132_391],
            &[-0.250_041_711, 0.968_235_066, -243.363_068_106],
            &[-0.798_384_132, 0.602_148_468, 61.717_290_063],
        ],
    },
    KnownAnswer {
        file: "coordinate-permutation",
        sha256: "33b6aed5c357fe12437708f60165f5cca34599955a22fd467b722abe876179cf",
        profile_id: "e2a612103bb7f7345063407a684dd970",
        rows: [&[351.5, 193.25], &[630.25, 38.5], &[304.75, 108.0]],
    },
    KnownAnswer {
        file: "dcl",
        sha256: "5f7e651b4664cb5f42109788241e8c6747f3236326fa44278f4474ea89f775f1",
        profile_id: "e2a612103bb7f7345063407a684dd970",
        rows: [
            &[-0.818_246_731, 0.520_518_635, -0.243_993_11, 0.574_867_191, 0.740_888_814, -0.347_291_632],
            &[0.875_143_908, 0.438_117_831, -0.205_367_733, 0.483_862_728, -0.792_406_872, 0.371_440_721],
            &[-0.154_691_863, -0.894_559_715, -0.419_324_866, -0.987_962_766, 0.140_067_13, 0.065_656_467],
        ],
    },
    KnownAnswer {
        file: "dcl-angle-30-s-2",
        sha256: "f3b9665d36b08c18371bff7ae19f12a45bccf8ed669285abb849c7375a703d4e",
        profile_id: "e2a612103bb7f7345063407a684dd970",
        rows: [
            &[-0.046_232_047, 0.918_392_351, -0.392_960_67, 0.804_382_37, -0.199_026_691, -0.559_783_333],
            &[0.743_156_023, -0.581_682_003, -0.330_704_056, -0.311_267_609, -0.738_039_416, 0.598_673_78],
            &[-0.701_386_576, -0.226_760_455, -0.675_748_894, -0.396_516_419, 0.911_940_694, 0.105_540_989],
        ],
    },
    KnownAnswer {
        file: "own-kind",
        sha256: "a752845617968ea9fe4af1d79a844cd71592221898088ed4502f481d3cc87e77",
        profile_id: "5145c8de454f2f3bae2941e0ccde1cf5",
        rows: [
            &[-0.818_246_731, 0.520_518_635, -0.243_993_11, 0.574_867_191, 0.740_888_814, -0.347_291_632],
            &[0.875_143_908, 0.438_117_831, -0.205_367_733, 0.483_862_728, -0.792_406_872, 0.371_440_721],
            &[-0.154_691_863, -0.894_559_715, -0.419_324_866, -0.987_962_766, 0.140_067_13, 0.065_656_467],
        ],
    },
    KnownAnswer {
        file: "exif-gravity",
        sha256: "cbf54c041dec3476daed763965f333e58a58df6f3491f04e14d88320140fe470",
        profile_id: "e2a612103bb7f7345063407a684dd970",
        rows: [
            &[-0.818_246_731, 0.520_518_635, -0.243_993_11, 0.574_867_191, 0.740_888_814, -0.347_291_632],
            &[0.875_143_908, 0.438_117_831, -0.205_367_733, 0.483_862_728, -0.792_406_872, 0.371_440_721],
            &[-0.154_691_863, -0.894_559_715, -0.419_324_866, -0.987_962_766, 0.140_067_13, 0.065_656_467],
        ],
    },
    KnownAnswer {
        file: "unknown-gravity",
        sha256: "b419963c605f8c50e654da79b580d6e15f5140635a56cb7c2585581aada3367d",
        profile_id: "e2a612103bb7f7345063407a684dd970",
        rows: [
            &[-0.818_246_731, 0.520_518_635, -0.243_993_11, 0.574_867_191, 0.740_888_814, -0.347_291_632],
            &[0.875_143_908, 0.438_117_831, -0.205_367_733, 0.483_862_728, -0.792_406_872, 0.371_440_721],
            &[-0.154_691_863, -0.894_559_715, -0.419_324_866, -0.987_962_766, 0.140_067_13, 0.065_656_467],
        ],
    },
    KnownAnswer {
        file: "stripes",
        sha256: "dec32b4a8a90798f1130b78147ef9774d5dd30c31fd14f66d95b51dd234f028c",
        profile_id: "e2a612103bb7f7345063407a684dd970",
        rows: [
            &[0.333_149_211, 0.818_246_731, -0.468_491_078, 0.474_193_444, -0.574_867_191, -0.666_834_53],
            &[0.280_409_96, -0.875_143_908, -0.394_326_507, -0.507_166_711, -0.483_862_728, 0.713_203_188],
            &[-0.362_695_418, -0.830_681_788, -0.422_397_681, -0.926_341_875, 0.370_832_237, 0.066_137_598],
        ],
    },
    KnownAnswer {
        file: "board",
        sha256: "efd0fac9eed45237707360f0225dc860a187a2c0a11ebdb323d29eda9b7c9dcd",
        profile_id: "e2a612103bb7f7345063407a684dd970",
        rows: [
            &[0.0, 0.818_246_731, -0.574_867_191, 0.0, -0.574_867_191, -0.818_246_731],
            &[-0.875_143_908, -0.025_769_388, -0.483_176_032, -0.483_862_728, 0.046_608_102, 0.873_901_908],
            &[0.0, -0.154_691_863, -0.987_962_766, 0.0, -0.987_962_766, 0.154_691_863],
        ],
    },
    KnownAnswer {
        file: "session",
        sha256: "6330015434a75fc8c77932787a5c060a27486d5760e0478c8e61317149a02c94",
        profile_id: "e2a612103bb7f7345063407a684dd970",
        rows: [
            &[0.282_425_14, -0.857_418_731, -0.430_196_653, -0.454_322_71, 0.275_416_838, -0.847_193_272],
            &[-0.532_122_487, 0.623_089_332, -0.573_241_087, -0.054_943_093, 0.650_216_117, 0.757_760_026],
            &[0.593_509_194, -0.780_067_884, -0.198_093_244, -0.767_996_157, -0.475_320_045, -0.429_246_733],
        ],
    },
    KnownAnswer {
        file: "session-halves",
        sha256: "641e1bada3822d5d6e6122d53cadecc9094d3ec28d9b60340e9297e6049302d8",
        profile_id: "e2a612103bb7f7345063407a684dd970",
        rows: [
            &[-0.648_017_052, 0.524_550_687, -0.552_196_049, 0.601_243_271, 0.797_379_81, 0.051_884_172],
            &[0.824_308_14, 0.487_138_092, 0.288_465_889, 0.319_273_647, -0.820_770_653, 0.473_708_638],
            &[0.144_042_931, -0.834_032_838, -0.532_579_439, -0.909_098_162, 0.101_058_958, -0.404_138_119],
        ],
    },
];

/// Camera hints of the queries: file, how well the focal length is known, and the gravity direction with its deviation
/// as the Python reader prints them.
const HINTS: [(&str, FocalKnowledge, Option<[f64; 4]>); 3] = [
    ("dcl", FocalKnowledge::Calibrated, None),
    ("exif-gravity", FocalKnowledge::Exif, Some([0.033_122_946, 0.979_492_831, -0.198_737_676, 1.0])),
    ("unknown-gravity", FocalKnowledge::Unknown, Some([-0.911_477_019, 0.104_957_96, -0.397_735_427, 8.0])),
];

/// Profiles and the SHA-256 of their bytes, whose beginning is their id.
const PROFILES: [(&str, &str); 2] = [
    ("sift.profile", "e2a612103bb7f7345063407a684dd970810c3b1b5199e99ea48e0ebdd439d63d"),
    ("own-kind.profile", "5145c8de454f2f3bae2941e0ccde1cf5d132c070ef5647dd11c924a2d33a9c30"),
];

fn read(name: &str) -> Vec<u8> {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name);
    fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

fn hex(bytes: impl AsRef<[u8]>) -> String {
    bytes.as_ref().iter().fold(String::new(), |text, byte| text + &format!("{byte:02x}"))
}

#[test]
fn known_queries_round_trip() {
    for known in &KNOWN_ANSWERS {
        let bytes = read(&format!("{}.vquery", known.file));
        assert_eq!(hex(Sha256::digest(&bytes)), known.sha256, "{} was changed", known.file);
        let query = SealedQuery::decode(&bytes).unwrap_or_else(|e| panic!("{}: {e}", known.file));
        assert!(query.encode() == bytes, "{} is now encoded differently", known.file);
        assert_eq!(query.profile_id().to_string(), known.profile_id, "{}", known.file);
        let camera = query.camera();
        assert_eq!((camera.width, camera.height, camera.focal), (640, 480, [512.0; 2]));
        let observations = query.observations();
        for (row, expected) in ROWS.into_iter().zip(known.rows) {
            let meaning_of_row = meaning(&observations, row);
            assert_eq!(meaning_of_row.len(), expected.len(), "{} row {row}", known.file);
            for (a, b) in meaning_of_row.iter().zip(expected) {
                assert!((a - b).abs() < 1e-8, "{} row {row}: {meaning_of_row:?}", known.file);
            }
        }
    }
}

#[test]
fn camera_hints_are_read() {
    for (file, focal, down) in HINTS {
        let query = SealedQuery::decode(&read(&format!("{file}.vquery"))).expect("known");
        assert_eq!(query.focal_known(), focal, "{file}");
        let gravity = query.gravity().map(|g| (g.in_camera(), g.sd_deg()));
        assert_eq!(gravity.is_some(), down.is_some(), "{file}");
        if let (Some((gravity, sd)), Some([x, y, z, expected])) = (gravity, down) {
            assert!(gravity.iter().zip([x, y, z]).all(|(a, b)| (a - b).abs() < 1e-8), "{file}: {gravity:?}");
            assert!((sd - expected).abs() < 1e-12, "{file}: {sd}");
        }
    }
}

/// A match query and its pack: SHA-256, and what the Python reader prints for the rows 0, 1 and 255.
#[test]
fn known_matches_round_trip() {
    let (bytes, packed) = (read("matches.vquery"), read("place.vpack"));
    assert_eq!(
        [&bytes, &packed].map(|bytes| hex(Sha256::digest(bytes))),
        [
            "f30d0ed0a290623a7f07598225627b5631ccb389c98267ac591a71edb867716d",
            "ba140dc7683ad3d292ece00cfc5ce6c45a5b6a20063677a67d5d0399aac18b7f"
        ]
    );
    let query = SealedQuery::decode(&bytes).expect("known");
    let pack = Pack::decode(&packed).expect("known");
    assert!(query.encode() == bytes && pack.encode() == packed, "they are now encoded differently");
    assert_eq!(query.profile_id(), pack.profile().id());
    let QueryContent::Matched { pack: id, matches, .. } = query.content() else { panic!("no match query") };
    assert_eq!((*id, matches.points()), (pack.id(), 20));
    let expected = [(1, 0.029_312_231), (19, 0.731_058_579), (10, 0.817_574_476)];
    for (row, (point, probability)) in ROWS.into_iter().zip(expected) {
        let found = matches.rows()[row];
        assert_eq!(found.point, point, "{row}");
        assert!((found.weight.probability() - probability).abs() < 1e-8, "{row}");
    }
    let row = meaning(&query.observations(), 1);
    let expected = [0.562_850_721, 0.759_681_257, -0.325_704_55, 0.742_973_476, -0.292_323_921, 0.602_110_57];
    assert!(row.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-8), "{row:?}");
}

#[test]
fn known_profiles_round_trip() {
    for (file, sha256) in PROFILES {
        let bytes = read(file);
        let profile = Profile::decode(&bytes).unwrap_or_else(|e| panic!("{file}: {e}"));
        assert!(profile.encode() == bytes, "{file} is now encoded differently");
        assert_eq!(hex(Sha256::digest(&bytes)), sha256, "{file} was changed");
        assert_eq!(profile.id().to_string(), sha256[..32]);
    }
}

#[test]
fn queries_belong_to_the_map_of_their_profile() {
    let sift = Profile::decode(&read("sift.profile")).expect("a profile");
    let own = Profile::decode(&read("own-kind.profile")).expect("a profile");
    for known in &KNOWN_ANSWERS {
        let query = SealedQuery::decode(&read(&format!("{}.vquery", known.file))).expect("known");
        let is_own = known.file == "own-kind";
        assert_eq!(
            (sift.check(&query).is_ok(), own.check(&query).is_ok()),
            (!is_own, is_own),
            "{}",
            known.file
        );
    }
}

fn meaning(observations: &Observations, row: usize) -> Vec<f64> {
    match observations {
        Observations::Anchored { pencils, lines } => {
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
    }
}
