//! Tests of the map file: round trip, known answer, and damage of every kind.

mod compressed;
mod gravity;
mod pack;
mod packed;
mod region;
mod self_test;

use std::path::PathBuf;

use proptest::prelude::*;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc_descriptor::{DescriptorKind, Descriptors, Vocabulary};
use veiloc_geometry::frames::World;
use veiloc_geometry::nalgebra::{Rotation3, Vector3};
use veiloc_geometry::{CameraFromWorld, Intrinsics, Point3};
use veiloc_protocol::{ExtractionLimits, Profile};
use xxhash_rust::xxh3::xxh3_64;
use zerocopy::{FromBytes, IntoBytes};

use super::layout::{Header, NO_POINT, Section, SectionEntry, header_checksum};
use super::write::to_bytes;
use crate::{
    AlignmentAccuracy, BuildSettings, MapError, MapFile, MapImage, MapModel, MapPoint, Observation, PointId,
    SelfTest, write,
};

/// A map with this many images, keypoints per image, and points observed by some of them.
fn sample(seed: u64, images: usize, keypoints: usize, points: usize) -> MapModel {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut rows = |n: usize| {
        let bytes = (0..n * 128).map(|_| rng.random()).collect();
        Descriptors::new(DescriptorKind::ROOT_SIFT, bytes).unwrap()
    };
    let vocabulary = Vocabulary::new(rows(2)).unwrap();
    let descriptors: Vec<Descriptors> = (0..images).map(|_| rows(keypoints)).collect();
    let mut number = || rng.random_range(-10.0..10.0);
    let images = descriptors
        .into_iter()
        .enumerate()
        .map(|(i, descriptors)| MapImage {
            name: format!("Türen/photo {i}.jpg"),
            camera: i % 2,
            cam_from_world: CameraFromWorld::new(
                Rotation3::from_scaled_axis(Vector3::from_fn(|_, _| 0.1 * number())),
                Vector3::from_fn(|_, _| number()),
            ),
            keypoints: (0..keypoints).map(|_| [number() as f32, number() as f32]).collect(),
            global: vocabulary.aggregate(descriptors.view()),
            descriptors,
            point_of_keypoint: vec![None; keypoints],
        })
        .collect::<Vec<_>>();
    let points = (0..points)
        .map(|p| MapPoint {
            position: Point3::<World>::new(number(), number(), number()),
            track: (0..images.len() as u32)
                .filter(|i| !(p as u32 + i).is_multiple_of(3))
                .map(|image| Observation { image, keypoint: p as u32 })
                .collect(),
            error: number().abs(),
        })
        .collect();
    let mut model = MapModel {
        cameras: [
            "PINHOLE,640,480,500,510,320,240",
            "OPENCV,1000,800,900,905,510,390,-0.15,0.05,0.001,-0.0007",
        ]
        .map(|c| c.parse::<Intrinsics>().unwrap())
        .to_vec(),
        images,
        points,
        settings: settings(),
        profile: Profile::vlad(vocabulary),
        self_test: None,
        down: None,
        is_metric: false,
        alignment: None,
        compressed: None,
        region: None,
    };
    model.link_keypoints();
    model
}

/// Settings that all differ from the defaults.
fn settings() -> BuildSettings {
    BuildSettings {
        extraction: ExtractionLimits { max_keypoints: 3000, max_image_side: 1200 },
        vocabulary_words: 65,
        pairs_per_image: 21,
        min_track_length: 4,
        max_ratio: 0.75,
        max_epipolar_error_px: 3.5,
        max_reprojection_error_px: 4.5,
        min_triangulation_angle_deg: 1.25,
        seed: 0x0123_4567_89ab_cdef,
    }
}

/// A file that pins the format. `VEILOC_BLESS=1` rewrites it after a deliberate change of version.
fn known_answer(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(format!("tests/data/{name}.bin"))
}

fn open_bytes(bytes: &[u8]) -> Result<MapFile, MapError> {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("place.vmap");
    std::fs::write(&path, bytes).unwrap();
    // The mapping stays valid after the file is removed.
    MapFile::open(&path)
}

fn section(bytes: &[u8], section: Section) -> (usize, SectionEntry) {
    let places = (size_of::<Header>()..).step_by(size_of::<SectionEntry>());
    let mut entries = places
        .map(|at| (at, SectionEntry::read_from_bytes(&bytes[at..at + size_of::<SectionEntry>()]).unwrap()));
    entries.find(|(_, entry)| entry.code == section as u32).unwrap()
}

/// Changes a section as a faulty program would: with valid checksums.
fn forged(bytes: &[u8], which: Section, change: impl FnOnce(&mut [u8])) -> Result<MapFile, MapError> {
    let mut bytes = bytes.to_vec();
    let (at, mut entry) = section(&bytes, which);
    let range = entry.offset as usize..(entry.offset + entry.length) as usize;
    change(&mut bytes[range.clone()]);
    entry.checksum = xxh3_64(&bytes[range]);
    bytes[at..at + size_of::<SectionEntry>()].copy_from_slice(entry.as_bytes());
    seal_header(&mut bytes);
    open_bytes(&bytes)
}

fn seal_header(bytes: &mut [u8]) {
    let mut header = Header::read_from_bytes(&bytes[..size_of::<Header>()]).unwrap();
    let table_end = size_of::<Header>() + header.sections as usize * size_of::<SectionEntry>();
    header.checksum = header_checksum(&header, &bytes[size_of::<Header>()..table_end]);
    bytes[..size_of::<Header>()].copy_from_slice(header.as_bytes());
}

#[test]
fn written_maps_round_trip() {
    for (images, keypoints, points) in [(0, 0, 0), (1, 0, 0), (3, 5, 0), (4, 30, 20)] {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("place.vmap");
        let model = sample(1, images, keypoints, points);
        write(&model, &path).unwrap();
        let map = MapFile::open(&path).unwrap();
        assert_eq!(map.to_model(), model);
        assert_eq!(std::fs::read(&path).unwrap(), to_bytes(&map.to_model()), "equal maps, equal bytes");
        assert_eq!((map.image_count(), map.point_count()), (images, points));
        assert_eq!(map.observation_count(), model.observation_count());
    }
}

#[test]
fn accessors_agree_with_the_model() {
    let model = sample(2, 4, 30, 20);
    let map = open_bytes(&to_bytes(&model)).unwrap();
    assert_eq!(map.profile(), &model.profile);
    assert_eq!(map.camera_count(), 2);
    for (i, image) in model.images.iter().enumerate() {
        let view = map.image(i);
        assert_eq!(view.name(), image.name);
        assert_eq!(view.camera(), &model.cameras[image.camera]);
        assert_eq!(view.keypoints(), image.keypoints);
        assert_eq!(view.descriptors().as_bytes(), image.descriptors.as_bytes());
        assert_eq!(view.global(), image.global.as_codes());
        for (k, point) in image.point_of_keypoint.iter().enumerate() {
            assert_eq!(view.point_of(k), *point);
        }
    }
    for (id, point) in (0..).map(PointId).zip(&model.points) {
        assert_eq!(map.point(id), point.position);
        assert_eq!(map.track_length(id), point.track.len());
        assert_eq!(map.track(id).collect::<Vec<_>>(), point.track);
        assert_eq!(map.reprojection_error(id), point.error);
    }
}

/// The file was once written from this model.
#[test]
fn known_answer_of_a_map() {
    let path = known_answer("map");
    if std::env::var_os("VEILOC_BLESS").is_some() {
        std::fs::write(&path, to_bytes(&sample(7, 3, 4, 3))).unwrap();
    }
    let map = MapFile::open(&path).unwrap();
    assert_eq!(map.settings(), &settings());
    assert_eq!(to_bytes(&map.to_model()), std::fs::read(&path).unwrap());
    assert_eq!(map.image(1).name(), "Türen/photo 1.jpg");
    assert_eq!(map.image(1).camera().model.name(), "OPENCV");
    assert_eq!(map.image(2).point_of(0), Some(PointId(0)));
    assert_eq!(map.image(0).point_of(3), None);
    assert_eq!(map.track_length(PointId(1)), 2);
    let x = map.point(PointId(2)).coords;
    assert_eq!([x.x, x.y, x.z], POINT_2);
}

const POINT_2: [f64; 3] = [1.1692299231299863, -9.645533375089684, -5.95976962999496];

#[test]
fn other_files_and_versions_are_reported() {
    let bytes = to_bytes(&sample(3, 2, 5, 3));
    for other in [&b""[..], b"\x89VEIL", b"# CAMERA_ID, MODEL", &[0; 4096]] {
        let error = open_bytes(other).unwrap_err();
        assert!(matches!(error, MapError::NotAMap { .. }), "{error}");
        assert!(error.to_string().contains("place.vmap"), "{error}");
    }
    for version in [0_u32, 2, 3] {
        let mut other = bytes.clone();
        other[8..12].copy_from_slice(&version.to_le_bytes());
        let error = open_bytes(&other).unwrap_err();
        assert!(
            matches!(error, MapError::Version { found, supported: 1, .. } if found == version),
            "{error}"
        );
        for words in [&format!("version {version}"), "build the map again with this program"] {
            assert!(error.to_string().contains(words), "{error}");
        }
    }
    let missing = MapFile::open(std::path::Path::new("no/such/place.vmap")).unwrap_err();
    assert!(
        matches!(&missing, MapError::Io { .. }) && missing.to_string().contains("place.vmap"),
        "{missing}"
    );
}

#[test]
fn truncation_is_detected() {
    let bytes = to_bytes(&sample(4, 2, 5, 3));
    for length in 0..bytes.len() {
        let error = open_bytes(&bytes[..length]).expect_err("cut short");
        assert!(length < 12 || matches!(error, MapError::Length { .. }), "{length}: {error}");
    }
    let mut longer = bytes;
    longer.push(0);
    assert!(matches!(open_bytes(&longer), Err(MapError::Length { .. })));
}

#[test]
fn changed_bytes_are_detected() {
    let bytes = to_bytes(&sample(5, 2, 5, 3));
    for i in 0..bytes.len() {
        let mut damaged = bytes.clone();
        damaged[i] ^= 0x10;
        assert!(open_bytes(&damaged).is_err(), "byte {i} of {}", bytes.len());
    }
    for which in Section::REQUIRED {
        let (_, entry) = section(&bytes, *which);
        let mut damaged = bytes.clone();
        damaged[entry.offset as usize] ^= 1;
        let error = open_bytes(&damaged).unwrap_err();
        assert!(matches!(error, MapError::Checksum { section, .. } if section == which.name()), "{error}");
    }
}

type Damage = Box<dyn FnOnce(&mut [u8])>;

#[test]
fn inconsistent_content_with_valid_checksums_is_refused() {
    let bytes = to_bytes(&sample(6, 3, 6, 4));
    let put_u32 = |at: usize, value: u32| {
        move |bytes: &mut [u8]| bytes[at..at + 4].copy_from_slice(&value.to_le_bytes())
    };
    let put_u64 = |at: usize, value: u64| {
        move |bytes: &mut [u8]| bytes[at..at + 8].copy_from_slice(&value.to_le_bytes())
    };
    let nan = f64::NAN.to_bits();
    let cases: Vec<(Section, Damage)> = vec![
        (Section::Profile, Box::new(put_u32(0, 0xffff_ffff))),
        (Section::Cameras, Box::new(put_u32(0, 77))),
        (Section::Cameras, Box::new(put_u32(4, 0))),
        (Section::Cameras, Box::new(put_u64(16, nan))),
        (Section::Images, Box::new(put_u64(0, nan))),
        (Section::Images, Box::new(put_u64(0, 3.0_f64.to_bits()))),
        (Section::Images, Box::new(put_u64(72, nan))),
        (Section::Images, Box::new(put_u64(96, 0))),
        (Section::Images, Box::new(put_u64(96, u64::MAX))),
        (Section::Images, Box::new(put_u64(104, 7))),
        (Section::Images, Box::new(put_u64(104, u64::MAX))),
        (Section::Images, Box::new(put_u32(112, 2))),
        (Section::Names, Box::new(|bytes| bytes[0] = 0xff)),
        (Section::Names, Box::new(|bytes| bytes[0] = b'\n')),
        (Section::Names, Box::new(|bytes| bytes[bytes.len() - 5] = b'1')),
        (Section::Keypoints, Box::new(put_u32(0, f32::NAN.to_bits()))),
        (Section::KeypointPoints, Box::new(put_u32(0, 3))),
        (Section::KeypointPoints, Box::new(put_u32(4, NO_POINT))),
        (Section::KeypointPoints, Box::new(put_u32(5 * 4, 0))),
        (Section::Points, Box::new(put_u64(0, nan))),
        (Section::Points, Box::new(put_u64(24, nan))),
        (Section::Points, Box::new(put_u64(32, 0))),
        (Section::Points, Box::new(put_u64(32, u64::MAX))),
        (Section::Observations, Box::new(put_u32(0, 3))),
        (Section::Observations, Box::new(put_u32(4, 6))),
        (Section::Observations, Box::new(put_u32(4, u32::MAX))),
        (Section::Settings, Box::new(put_u32(0, 0))),
        (Section::Settings, Box::new(put_u32(4, u32::MAX))),
        (Section::Building, Box::new(put_u32(0, 0))),
        (Section::Building, Box::new(put_u32(4, u32::MAX))),
        (Section::Building, Box::new(put_u32(8, 1))),
        (Section::Building, Box::new(put_u32(12, f32::NAN.to_bits()))),
        (Section::Building, Box::new(put_u64(16, nan))),
        (Section::Building, Box::new(put_u64(24, f64::INFINITY.to_bits()))),
        (Section::Building, Box::new(put_u64(32, (-1.0_f64).to_bits()))),
    ];
    for (i, (which, change)) in cases.into_iter().enumerate() {
        let error = forged(&bytes, which, change).expect_err(which.name());
        assert!(matches!(error, MapError::Structure { .. }), "case {i}, {}: {error}", which.name());
        assert!(error.to_string().contains("place.vmap"), "{error}");
    }
}

/// Tables with a wrong number of sections, and valid checksums where the file is long enough.
#[test]
fn hostile_section_counts_are_refused() {
    let bytes = to_bytes(&sample(8, 2, 5, 3));
    for count in [0, 1, 11, 13, 100, u32::MAX / 32, u32::MAX] {
        let mut forged = bytes.clone();
        forged[12..16].copy_from_slice(&count.to_le_bytes());
        if size_of::<Header>() + count as usize * size_of::<SectionEntry>() <= bytes.len() {
            seal_header(&mut forged);
        }
        let error = open_bytes(&forged).expect_err("another number of sections");
        assert!(!matches!(error, MapError::Checksum { .. }), "{count}: {error}");
    }
}

#[test]
fn unknown_section_is_reported_as_newer() {
    let bytes = to_bytes(&sample(8, 2, 5, 3));
    let (at, _) = section(&bytes, Section::Building);
    let mut newer = bytes.clone();
    newer[at..at + 4].copy_from_slice(&64_u32.to_le_bytes());
    seal_header(&mut newer);
    let error = open_bytes(&newer).unwrap_err();
    assert!(matches!(error, MapError::UnknownSection { code: 64, .. }), "{error}");
    assert!(error.to_string().contains("use a newer veiloc"), "{error}");
    // One section twice, and another one missing.
    let mut twice = bytes;
    twice[at..at + 4].copy_from_slice(&11_u32.to_le_bytes());
    seal_header(&mut twice);
    assert!(matches!(open_bytes(&twice), Err(MapError::Structure { section: "header", .. })));
}

#[test]
fn misplaced_sections_are_refused() {
    let test = SelfTest { images: 0, scale: 1.0, assumed_noise_px: 1.0, schemes: Vec::new() };
    let alignment = AlignmentAccuracy::from_stored([0.1, 1.0, 2.0, 0.3, 0.0, 0.0, 0.0]).ok();
    let bytes = to_bytes(&MapModel { self_test: Some(test), alignment, ..region::part(8) });
    // In a packed map the other sections are empty; it has its own tests.
    for which in Section::ALL.into_iter().filter(|which| !matches!(which, Section::Packed)) {
        for field in [0, 4, 8, 16] {
            for value in [u32::MAX, 64] {
                let (at, _) = section(&bytes, which);
                let mut forged = bytes.clone();
                forged[at + field..at + field + 4].copy_from_slice(&value.to_le_bytes());
                if forged == bytes {
                    continue;
                }
                seal_header(&mut forged);
                assert!(open_bytes(&forged).is_err(), "{} {field}", which.name());
            }
        }
    }
}

type Breakage = (&'static str, fn(&mut MapModel));

#[test]
fn inconsistent_model_is_not_written() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("place.vmap");
    let good = sample(9, 3, 6, 4);
    write(&good, &path).unwrap();
    let broken: [Breakage; 13] = [
        ("settings", |m| m.settings.max_ratio = f32::NAN),
        ("duplicate name", |m| m.images[1].name = m.images[0].name.clone()),
        ("empty name", |m| m.images[1].name.clear()),
        ("camera", |m| m.images[0].camera = 2),
        ("pose", |m| {
            let pose = &mut m.images[0].cam_from_world;
            *pose = pose.perturbed(&[0.0, 0.0, 0.0, f64::NAN, 0.0, 0.0]);
        }),
        ("keypoint", |m| m.images[0].keypoints[0][1] = f32::INFINITY),
        ("descriptors", |m| m.images[0].descriptors = Descriptors::empty(DescriptorKind::ROOT_SIFT)),
        ("global", |m| m.images[0].global = veiloc_descriptor::GlobalDescriptor::new(vec![0; 3])),
        ("link", |m| m.images[0].point_of_keypoint[5] = Some(PointId(0))),
        ("no link", |m| m.images[1].point_of_keypoint[0] = None),
        ("empty track", |m| m.points[0].track.clear()),
        ("track order", |m| m.points[0].track.reverse()),
        ("position", |m| m.points[0].position = Point3::new(f64::NAN, 0.0, 0.0)),
    ];
    for (what, damage) in broken {
        let mut model = good.clone();
        damage(&mut model);
        assert!(matches!(write(&model, &path), Err(MapError::Model { .. })), "{what}");
        assert_eq!(MapFile::open(&path).unwrap().to_model(), good, "{what}: the old map is unchanged");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn arbitrary_maps_round_trip(seed: u64, images in 0_usize..5, keypoints in 1_usize..20, points in 0_usize..20) {
        let model = sample(seed, images, keypoints.max(points), if images < 2 { 0 } else { points });
        prop_assert_eq!(open_bytes(&to_bytes(&model)).unwrap().to_model(), model);
    }

    /// Random bytes in a random section with valid checksums: refused or opened, but never a panic, and an opened map
    /// can be used.
    #[test]
    fn forged_sections_never_panic(seed: u64, which in 0_usize..15, count in 1_usize..4) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let bytes = to_bytes(&region::part(seed % 8));
        // All required sections, and the last three of the optional ones.
        let which = which + usize::from(which >= 12);
        let opened = forged(&bytes, Section::ALL[which], |bytes| {
            for _ in 0..count {
                let at = rng.random_range(0..bytes.len());
                bytes[at] = rng.random();
            }
        });
        if let Ok(map) = opened {
            prop_assert!(map.to_model().validate().is_ok());
        }
    }
}

#[test]
fn cameras_with_more_than_eight_parameters_round_trip() {
    let mut model = sample(2, 4, 30, 20);
    for text in [
        "THIN_PRISM_FISHEYE,1000,800,500,505,510,390,-0.03,0.01,0.001,-0.0007,-0.004,0.0005,0.002,-0.001",
        "FOV,1000,800,500,505,510,390,0.9",
        "FULL_OPENCV,1000,800,900,905,510,390,-0.15,0.05,0.001,-0.0007,0.01,0.02,-0.01,0.003",
        "RAD_TAN_THIN_PRISM_FISHEYE,1000,800,500,505,510,390,-0.03,0.01,0.002,-0.004,0.001,-0.0002,0.001,-0.0007,0.002,-0.001,0.0005,0.0003",
    ] {
        model.cameras.insert(1, text.parse().unwrap());
    }
    for image in &mut model.images {
        image.camera = (image.camera + 1) % model.cameras.len();
    }
    let map = open_bytes(&to_bytes(&model)).unwrap();
    assert_eq!(map.camera_count(), 6);
    assert_eq!(map.to_model().cameras, model.cameras);
    let records = super::write::camera_records(&model.cameras);
    assert_eq!(records.len(), 9, "three of them have a second record");
}
