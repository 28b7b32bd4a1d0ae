//! The records of the map file. `docs/reference/map-format.md` is the specification; the known-answer tests check that both
//! agree.
//!
//! ```text
//! header            64 bytes
//! table             32 bytes a section, in the order of their codes
//! sections          each at a multiple of 64 bytes, gaps zero, the next one as early as possible
//! ```
//! All numbers are little-endian; records are used in place in the mapped file, without copies.

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

#[cfg(target_endian = "big")]
compile_error!(
    "map files are little-endian and are used as they lie on disk; big-endian machines are not supported"
);

/// The version of the format that this program writes and reads.
pub const FORMAT_VERSION: u32 = 1;

/// Magic number of a map file.
pub(super) const MAGIC: [u8; 8] = *b"\x89VEILMAP";

/// Alignment of sections, for vector loads from the mapped file.
pub(super) const ALIGN: usize = 64;

/// In `KEYPOINT_POINTS`: the keypoint observes no point.
pub(super) const NO_POINT: u32 = u32::MAX;

/// Kind of a section.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub(super) enum Section {
    Profile = 1,
    Settings = 2,
    Cameras = 3,
    Images = 4,
    Names = 5,
    Keypoints = 6,
    KeypointPoints = 7,
    Descriptors = 8,
    Globals = 9,
    Points = 10,
    Observations = 11,
    Building = 12,
    /// Optional.
    SelfTest = 13,
    /// Optional.
    Down = 14,
    /// In compressed maps only.
    Compressed = 15,
    /// In regions of a larger map only.
    Region = 16,
    /// Replaces sections 6 to 11, which are then empty.
    Packed = 17,
    /// Optional, empty: map units are metres.
    Metric = 18,
    /// Optional.
    Alignment = 19,
}

impl Section {
    /// In the order of their codes, which are 1, 2, 3, ...
    pub(super) const ALL: [Self; 19] = [
        Self::Profile,
        Self::Settings,
        Self::Cameras,
        Self::Images,
        Self::Names,
        Self::Keypoints,
        Self::KeypointPoints,
        Self::Descriptors,
        Self::Globals,
        Self::Points,
        Self::Observations,
        Self::Building,
        Self::SelfTest,
        Self::Down,
        Self::Compressed,
        Self::Region,
        Self::Packed,
        Self::Metric,
        Self::Alignment,
    ];

    /// The required sections, in order; the others are optional.
    pub(super) const REQUIRED: &[Self] = Self::ALL.split_at(12).0;

    /// Whether a file may have these sections: all required ones, and optional ones, in order.
    pub(super) fn fit(codes: impl Iterator<Item = u32> + Clone) -> bool {
        let is_there = |s: &Self| codes.clone().any(|code| code == *s as u32);
        let known = codes.clone().all(|code| Self::from_code(code).is_some());
        known && Self::REQUIRED.iter().all(is_there) && codes.clone().is_sorted_by(|a, b| a < b)
    }

    /// Whether a packed map stores this content in [`Self::Packed`].
    pub(super) const fn is_packed(self) -> bool {
        matches!(
            self,
            Self::Keypoints
                | Self::KeypointPoints
                | Self::Descriptors
                | Self::Globals
                | Self::Points
                | Self::Observations
        )
    }

    pub(super) fn from_code(code: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|s| *s as u32 == code)
    }

    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Profile => "profile",
            Self::Settings => "settings",
            Self::Cameras => "cameras",
            Self::Images => "images",
            Self::Names => "names",
            Self::Keypoints => "keypoints",
            Self::KeypointPoints => "keypoint points",
            Self::Descriptors => "descriptors",
            Self::Globals => "globals",
            Self::Points => "points",
            Self::Observations => "observations",
            Self::Building => "building",
            Self::SelfTest => "self-test",
            Self::Down => "down",
            Self::Compressed => "compressed",
            Self::Packed => "packed",
            Self::Metric => "metric",
            Self::Alignment => "alignment",
            Self::Region => "region",
        }
    }
}

/// The header of the file.
#[derive(Debug, Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub(super) struct Header {
    pub(super) magic: [u8; 8],
    pub(super) version: u32,
    pub(super) sections: u32,
    /// Length of the file, bytes.
    pub(super) length: u64,
    /// XXH3-64 of header and table, this field taken as zero.
    pub(super) checksum: u64,
    pub(super) reserved: [u64; 4],
}

/// An entry of the table of sections.
#[derive(Debug, Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub(super) struct SectionEntry {
    pub(super) code: u32,
    pub(super) reserved: u32,
    /// Offset from the beginning of the file, bytes.
    pub(super) offset: u64,
    /// Bytes.
    pub(super) length: u64,
    /// XXH3-64 of the section.
    pub(super) checksum: u64,
}

/// Limits of the feature extraction of map images.
#[derive(Debug, Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub(super) struct SettingsRecord {
    pub(super) max_keypoints: u32,
    pub(super) max_image_side: u32,
}

/// The other build settings.
#[derive(Debug, Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub(super) struct BuildingRecord {
    pub(super) vocabulary_words: u32,
    pub(super) pairs_per_image: u32,
    pub(super) min_track_length: u32,
    pub(super) max_ratio: f32,
    pub(super) max_epipolar_error_px: f64,
    pub(super) max_reprojection_error_px: f64,
    pub(super) min_triangulation_angle_deg: f64,
    pub(super) seed: u64,
}

#[derive(Debug, Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub(super) struct CameraRecord {
    /// COLMAP's id of the camera model, or [`Self::CONTINUED`].
    pub(super) model: u32,
    pub(super) width: u32,
    pub(super) height: u32,
    pub(super) reserved: u32,
    /// In COLMAP's order; unused ones are zero.
    pub(super) params: [f64; 8],
}

impl CameraRecord {
    /// Marks a record with further parameters of the camera whose index is in the field `width`. Such records follow
    /// those of all cameras, in camera order.
    pub(super) const CONTINUED: u32 = u32::MAX;
}

#[derive(Debug, Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub(super) struct ImageRecord {
    /// `R` of `cam_from_world`, row-major.
    pub(super) rotation: [[f64; 3]; 3],
    /// `t` of `cam_from_world`.
    pub(super) translation: [f64; 3],
    /// End of its name in `NAMES`; it begins at the end of the previous name.
    pub(super) name_end: u64,
    /// End of its keypoints in `KEYPOINTS`, `KEYPOINT_POINTS` and `DESCRIPTORS`, in keypoints.
    pub(super) keypoint_end: u64,
    /// Index in `CAMERAS`.
    pub(super) camera: u32,
    pub(super) reserved: u32,
}

#[derive(Debug, Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub(super) struct PointRecord {
    pub(super) position: [f64; 3],
    /// Mean reprojection error, pixels.
    pub(super) error: f64,
    /// End of its track in `OBSERVATIONS`; it begins at the end of the previous track.
    pub(super) track_end: u64,
}

#[derive(Debug, Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub(super) struct ObservationRecord {
    pub(super) image: u32,
    pub(super) keypoint: u32,
}

/// Header of a self-test; the records of the schemes follow.
#[derive(Debug, Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub(super) struct SelfTestRecord {
    pub(super) scale: f64,
    pub(super) assumed_noise_px: f64,
    pub(super) images: u32,
    pub(super) schemes: u32,
}

/// Result of a self-test for one scheme.
#[derive(Debug, Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub(super) struct SchemeTestRecord {
    /// Code of the scheme, as on the wire.
    pub(super) scheme: u32,
    pub(super) localized: u32,
    pub(super) trusted: u32,
    pub(super) within_of_scale: [u32; 3],
    pub(super) within: [u32; 2],
    pub(super) median_rotation_deg: f64,
    pub(super) median_translation: f64,
    pub(super) median_noise_px: f64,
    pub(super) center_before: [f64; 3],
    pub(super) center_after: [f64; 3],
    pub(super) pose_before: [f64; 3],
    pub(super) pose_after: [f64; 3],
    pub(super) factor: f64,
    pub(super) rotation_floor: f64,
    pub(super) translation_floor: f64,
    pub(super) camera_sd: [f64; 6],
    pub(super) min_camera_log_odds: f64,
    pub(super) min_focal_gain: f64,
}

/// Data about the whole map of a compressed one; the records of the points follow.
#[derive(Debug, Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub(super) struct CompressedRecord {
    pub(super) bytes: u64,
    pub(super) keypoints: u64,
    pub(super) points: u64,
}

/// Summary of a point in a compressed map.
#[derive(Debug, Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub(super) struct PointSummaryRecord {
    pub(super) seen_by: u32,
    pub(super) covariance: [f32; 6],
}

/// Header of the packed section.
#[derive(Debug, Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub(super) struct PackedRecord {
    /// Origin of positions, map units.
    pub(super) origin: [f64; 3],
    pub(super) points: u64,
    pub(super) keypoints: u64,
}

/// A point of a packed map.
#[derive(Debug, Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub(super) struct PackedPointRecord {
    /// Position relative to the origin, map units.
    pub(super) position: [f32; 3],
    /// Mean reprojection error, in steps of 1/4096 pixel.
    pub(super) error: u16,
    /// Number of images that observe it in the whole map.
    pub(super) seen_by: u16,
    /// Logarithms of the standard deviations of its position along the axes.
    pub(super) log_sds: [u16; 3],
    /// Correlations `xy, xz, yz`.
    pub(super) correlations: [i16; 3],
}

/// A keypoint of a packed map.
#[derive(Debug, Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub(super) struct PackedKeypointRecord {
    /// The observed point.
    pub(super) point: u32,
    /// Coordinates u, v, in steps.
    pub(super) at: [u16; 2],
}

/// Header of the region section; the records of the images follow.
#[derive(Debug, Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub(super) struct RegionRecord {
    /// Number of images of the whole map.
    pub(super) images: u32,
    pub(super) reserved: u32,
}

/// An image of a region.
#[derive(Debug, Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub(super) struct RegionImageRecord {
    /// Its index in the whole map.
    pub(super) whole: u32,
    /// 1 in the core, 0 in the overlap.
    pub(super) core: u32,
}

/// XXH3-64 of header and table, the header's own checksum taken as zero.
pub(super) fn header_checksum(header: &Header, table: &[u8]) -> u64 {
    let blank = Header { checksum: 0, ..*header };
    let mut hash = xxhash_rust::xxh3::Xxh3::new();
    hash.update(blank.as_bytes());
    hash.update(table);
    hash.digest()
}
