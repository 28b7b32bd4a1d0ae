//! Facts about a map, as text and as JSON.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Serialize;
use veiloc_geometry::Intrinsics;
use veiloc_map::MapFile;
use veiloc_mapping::{BadImage, CoordinateFrameReport, MapWarning, SkippedImages};

use super::alignment::{AccuracyInfo, AlignmentInfo};
use super::coordinate_frame::{self, CoordinateFrameInfo};
use super::self_test::SelfTestInfo;
use crate::output::exit::{Exit, Outcome};
use crate::output::position::unit_of;
use crate::output::ui::Ui;

/// Also of `map build`, `map import`, `map add` and `map remove`: facts about the written map.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub(crate) struct Info {
    /// 1.
    version: u32,
    /// The map, as given.
    file: String,
    /// Bytes of the file.
    bytes: u64,
    /// Version of the map format.
    format_version: u32,
    /// Number of mapped images.
    images: usize,
    /// Number of cameras of the images.
    cameras: usize,
    /// The camera of most images, and how many images have it; null without images.
    main_camera: Option<MainCamera>,
    /// Number of keypoints of all images.
    keypoints: usize,
    /// Number of map points.
    points: usize,
    /// Bytes of the file per map point.
    bytes_per_point: f64,
    /// Mean number of images that observe a map point.
    mean_track_length: f64,
    /// Mean reprojection error of the map points, pixels.
    mean_reprojection_error_px: f64,
    /// Kind of the descriptors.
    descriptors: String,
    /// Method of the global descriptors: `vlad`, or the name of a model.
    global: String,
    /// Id of the profile, as sealed queries carry it.
    profile: String,
    /// Whether map units are metres; false if not known (`--metres`, `map align`).
    is_metric: bool,
    /// Direction of gravity (down), a unit vector in the axes of the map; null if not known (`--down`).
    down: Option<[f64; 3]>,
    /// How well the coordinate frame is known on earth or in the plan that the map was aligned to; null if it was not aligned.
    accuracy: Option<AccuracyInfo>,
    /// The original of a compressed map; null otherwise.
    compressed: Option<CompressedInfo>,
    /// The part of a larger map that a region holds; null otherwise.
    region: Option<RegionInfo>,
    /// Result of the self-test; null if the map was not tested.
    self_test: Option<SelfTestInfo>,
    /// Comparison of the poses of images with the coordinate frame of the map; absent if there was none.
    #[serde(skip_serializing_if = "Option::is_none")]
    coordinate_frame: Option<CoordinateFrameInfo>,
    /// The transform of the map by `map align`, or of the second map by `map merge`; absent for other commands.
    #[serde(skip_serializing_if = "Option::is_none")]
    alignment: Option<AlignmentInfo>,
    /// Reasons to expect poor localization; may be empty.
    warnings: Vec<Warning>,
    /// Images that `--skip-bad` left out; absent when there are none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    skipped: Vec<Skipped>,
    /// The mapped images; absent without `--images`.
    #[serde(skip_serializing_if = "Option::is_none")]
    image_list: Option<Vec<ImageInfo>>,
}

/// The camera of most images of a map.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
struct MainCamera {
    /// The camera, `MODEL,W,H,PARAMS…`, as `--camera` takes it.
    camera: String,
    /// Number of images that have it.
    images: usize,
}

impl MainCamera {
    /// Of equally frequent cameras, the first one of the map.
    fn of<'a>(cameras: impl Iterator<Item = &'a Intrinsics>) -> Option<Self> {
        let mut counts: Vec<(&Intrinsics, usize)> = Vec::new();
        let mut place = BTreeMap::new();
        for camera in cameras {
            let at = *place.entry(camera.to_string()).or_insert_with(|| {
                counts.push((camera, 0));
                counts.len() - 1
            });
            counts[at].1 += 1;
        }
        let (camera, images) = counts.into_iter().rev().max_by_key(|(_, images)| *images)?;
        Some(Self { camera: camera.to_string(), images })
    }
}

/// The map from which a compressed one was made.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
struct CompressedInfo {
    /// Bytes of its file.
    bytes: u64,
    /// Number of its keypoints.
    keypoints: u64,
    /// Number of its points.
    points: u64,
}

/// The part of a larger map that a region holds; the self-test is then the whole map's.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
struct RegionInfo {
    /// Number of images in its core, which are in no other core.
    core_images: usize,
    /// Number of images of the whole map.
    map_images: u32,
}

/// A reason to expect poor localization in the map.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
struct Warning {
    /// Name of the reason, for programs.
    name: &'static str,
    /// The reason, for people.
    message: String,
}

/// An image that was left out.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
struct Skipped {
    /// Name of the image.
    name: String,
    /// Why it was left out.
    reason: String,
}

/// An image of the map.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
struct ImageInfo {
    /// Name of the image.
    name: String,
    /// Number of its keypoints.
    keypoints: usize,
    /// Number of its observations: keypoints with a map point.
    observations: usize,
    /// Its camera, `MODEL,W,H,PARAMS…`.
    camera: String,
}

/// Output format of the facts about a map, and facts that only the building command knows.
#[derive(Default)]
pub(super) struct InfoOutput {
    pub(super) json: bool,
    pub(super) list: bool,
    pub(super) skipped: Vec<BadImage>,
    pub(super) warnings: Vec<MapWarning>,
    pub(super) coordinate_frame: Option<CoordinateFrameReport>,
    pub(super) alignment: Option<AlignmentInfo>,
}

impl InfoOutput {
    pub(super) fn print(self, path: &Path, ui: &Ui) -> Outcome {
        let map = MapFile::open(path)?;
        let images: Vec<ImageInfo> = map
            .images()
            .map(|image| ImageInfo {
                name: image.name().to_owned(),
                keypoints: image.keypoints().len(),
                observations: (0..image.keypoints().len()).filter(|k| image.point_of(*k).is_some()).count(),
                camera: image.camera().to_string(),
            })
            .collect();
        let mut warnings = self.warnings;
        let seen: Vec<usize> = images.iter().map(|i| i.observations).collect();
        let of_test = map.self_test().and_then(MapWarning::of_self_test);
        let of_precision = map.self_test().and_then(MapWarning::of_precision);
        let of_map =
            MapWarning::of_counts(map.point_count(), &seen).into_iter().chain(of_test).chain(of_precision);
        for warning in of_map {
            if !warnings.iter().any(|known| known.name() == warning.name()) {
                warnings.push(warning);
            }
        }
        let warning = |d: &MapWarning| Warning { name: d.name(), message: d.to_string() };
        let skipped = |bad: &BadImage| Skipped { name: bad.name.clone(), reason: bad.reason.to_string() };
        let info = Info {
            warnings: warnings.iter().map(warning).collect(),
            skipped: self.skipped.iter().map(skipped).collect(),
            image_list: self.list.then_some(images),
            coordinate_frame: self.coordinate_frame.as_ref().map(CoordinateFrameInfo::of),
            alignment: self.alignment,
            ..facts(&map, path)
        };
        if !self.skipped.is_empty() {
            ui.info(SkippedImages(self.skipped));
        }
        if let Some(frame) = &self.coordinate_frame {
            coordinate_frame::print(frame, ui);
        }
        for warning in &info.warnings {
            ui.warning(&warning.message);
        }
        if self.json {
            ui.json(&info)?;
        } else {
            ui.print(describe(&info));
        }
        Ok(Exit::Success)
    }
}

fn facts(map: &MapFile, path: &Path) -> Info {
    let bytes = map.byte_count();
    let points = map.point_count();
    let per_point = |total: f64| if points == 0 { 0.0 } else { total / points as f64 };
    let observations: usize = (0..points).map(|i| map.track_length(veiloc_map::PointId(i as u32))).sum();
    let error: f64 = (0..points).map(|i| map.reprojection_error(veiloc_map::PointId(i as u32))).sum();
    Info {
        version: 1,
        file: path.display().to_string(),
        bytes,
        format_version: veiloc_map::FORMAT_VERSION,
        images: map.image_count(),
        cameras: map.camera_count(),
        main_camera: MainCamera::of(map.images().map(|image| image.camera())),
        keypoints: (0..map.image_count()).map(|i| map.image(i).keypoints().len()).sum(),
        points,
        bytes_per_point: per_point(bytes as f64),
        mean_track_length: per_point(observations as f64),
        mean_reprojection_error_px: per_point(error),
        descriptors: map.profile().descriptor_kind().name().to_owned(),
        global: map.profile().global_model().name().to_owned(),
        profile: map.profile().id().to_string(),
        is_metric: map.is_metric(),
        down: map.down().map(|down| down.in_world()),
        accuracy: map.alignment().map(AccuracyInfo::from),
        compressed: map.compressed().map(|c| CompressedInfo {
            bytes: c.bytes,
            keypoints: c.keypoints,
            points: c.points,
        }),
        region: map
            .part_of()
            .map(|region| RegionInfo { core_images: region.core_count(), map_images: region.images }),
        self_test: map.self_test().map(SelfTestInfo::of),
        coordinate_frame: None,
        alignment: None,
        warnings: Vec::new(),
        skipped: Vec::new(),
        image_list: None,
    }
}

fn describe(info: &Info) -> String {
    let mut text = format!(
        "{}: map format {}, {:.1} MB\n  images      {} with {} cameras, {} keypoints\n  points      {}, \
         observed by {:.1} images each, mean reprojection error {:.2} px\n  per point   {:.0} bytes of \
         the file\n  devices     {} features, global descriptors {}, profile {}\n",
        info.file,
        info.format_version,
        info.bytes as f64 / 1e6,
        info.images,
        info.cameras,
        info.keypoints,
        info.points,
        info.mean_track_length,
        info.mean_reprojection_error_px,
        info.bytes_per_point,
        info.descriptors,
        info.global,
        info.profile,
    );
    if let Some(MainCamera { camera, images }) = &info.main_camera {
        text.extend([format!("  camera      {camera}, of {images} images\n")]);
    }
    let unknown = || "not known: the gravity of queries is not used".to_owned();
    let down = info.down.map_or_else(unknown, |[x, y, z]| format!("({x:.4}, {y:.4}, {z:.4})"));
    text.extend(["  down        ", &down, "\n"]);
    let unit = unit_of(info.is_metric);
    let known =
        if info.is_metric { "metres" } else { "not known: lengths are in units; --metres or `map align`" };
    text.extend(["  unit        ", known, "\n"]);
    if let Some(accuracy) = &info.accuracy {
        text.extend(["  aligned     ", &accuracy.describe(unit), "\n"]);
    }
    if let Some(region) = &info.region {
        text.extend([format!(
            "  region      {} images of the {} of the whole map, {} in its core; images cannot be added \
             or removed\n",
            info.images, region.map_images, region.core_images
        )]);
    } else if let Some(whole) = &info.compressed {
        let times = whole.bytes as f64 / info.bytes.max(1) as f64;
        text.extend([format!(
            "  compressed  {times:.1} times, from {:.1} MB with {} points and {} keypoints; images cannot \
             be added or removed\n",
            whole.bytes as f64 / 1e6,
            whole.points,
            whole.keypoints
        )]);
    }
    match &info.self_test {
        Some(test) => {
            text.push_str(&test.describe(unit));
            if info.region.is_some() {
                text.push_str("              of the whole map, whose calibration applies to its regions\n");
            }
        }
        None => text.push_str("  self-test   none: covariances are calibrated with those of other maps\n"),
    }
    for image in info.image_list.iter().flatten() {
        let ImageInfo { name, keypoints, observations, camera } = image;
        let name = printable(name);
        text.extend([format!(
            "{observations:>7} of {keypoints:>6} keypoints with a map point  {camera}  \
             {name}\n"
        )]);
    }
    text
}

/// Escapes the characters of a name that would control a terminal.
fn printable(name: &str) -> String {
    let shown = |c: char| if c.is_control() { c.escape_default().to_string() } else { c.to_string() };
    name.chars().map(shown).collect()
}
