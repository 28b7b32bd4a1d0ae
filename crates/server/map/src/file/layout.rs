//! The records of the map file. `docs/reference/map-format.md` is the specification; the known-answer test holds both together.
//!
//! ```text
//! header            64 bytes
//! table             32 bytes a section, in the order of their codes
//! sections          each at a multiple of 64 bytes, gaps zero, the next one as early as possible
//! ```
//! All numbers are little-endian; records are used where they lie in the mapped file, without being copied.

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

#[cfg(target_endian = "big")]
compile_error!(
    "map files are little-endian and are used as they lie on disk; big-endian machines are not supported"
);

/// The version of the format that this program writes and reads.
pub const FORMAT_VERSION: u32 = 1;

/// The first bytes of every map.
pub(super) const MAGIC: [u8; 8] = *b"\x89VEILMAP";

/// Sections begin at multiples of this, for vector loads from the mapped file.
pub(super) const ALIGN: usize = 64;

/// In `KEYPOINT_POINTS`: the keypoint sees no point.
pub(super) const NO_POINT: u32 = u32::MAX;

/// What a section holds.
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
    /// Where there was one.
    SelfTest = 13,
    /// Where somebody knows it.
    Down = 14,
    /// In maps that were compressed.
    Compressed = 15,
    /// In maps that are a part of a larger one.
    Region = 16,
    /// In the place of what sections 6 to 11 hold in other maps, which are then empty.
    Packed = 17,
}

impl Section {
    /// In the order of their codes, which are 1, 2, 3, ...
    pub(super) const ALL: [Self; 17] = [
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
    ];

    /// The sections a file must have, in order; it may have the others.
    pub(super) const REQUIRED: &[Self] = Self::ALL.split_at(12).0;

    /// Whether these are the sections of a file: all that it must have, and what it may have, in order.
    pub(super) fn fit(codes: impl Iterator<Item = u32> + Clone) -> bool {
        let is_there = |s: &Self| codes.clone().any(|code| code == *s as u32);
        let known = codes.clone().all(|code| Self::from_code(code).is_some());
        known && Self::REQUIRED.iter().all(is_there) && codes.clone().is_sorted_by(|a, b| a < b)
    }

    /// Whether a packed map has its content in [`Self::Packed`].
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
            Self::Region => "region",
        }
    }
}

/// The beginning of the file.
#[derive(Debug, Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub(super) struct Header {
    pub(super) magic: [u8; 8],
    pub(super) version: u32,
    pub(super) sections: u32,
    /// Of the whole file, bytes.
    pub(super) length: u64,
    /// XXH3-64 of header and table, this field taken as zero.
    pub(super) checksum: u64,
    pub(super) reserved: [u64; 4],
}

/// Where a section lies.
#[derive(Debug, Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub(super) struct Entry {
    pub(super) code: u32,
    pub(super) reserved: u32,
    /// From the beginning of the file, bytes.
    pub(super) offset: u64,
    /// Bytes.
    pub(super) length: u64,
    /// XXH3-64 of the section.
    pub(super) checksum: u64,
}

/// How the map's own images were treated.
#[derive(Debug, Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub(super) struct SettingsRecord {
    pub(super) max_keypoints: u32,
    pub(super) max_image_side: u32,
}

/// How the map was built, beyond its [`SettingsRecord`].
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
    /// COLMAP's number of the camera model, or [`Self::CONTINUED`].
    pub(super) model: u32,
    pub(super) width: u32,
    pub(super) height: u32,
    pub(super) reserved: u32,
    /// COLMAP's order; zero behind the last one.
    pub(super) params: [f64; 8],
}

impl CameraRecord {
    /// In the place of a model: the parameters go on that had no room in the record of the camera whose index is the width. Such
    /// records lie behind those of all cameras, in their order.
    pub(super) const CONTINUED: u32 = u32::MAX;
}

#[derive(Debug, Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub(super) struct ImageRecord {
    /// `R` of `cam_from_world`, row by row.
    pub(super) rotation: [[f64; 3]; 3],
    /// `t` of `cam_from_world`.
    pub(super) translation: [f64; 3],
    /// Where its name ends in `NAMES`; it begins where the name before it ends.
    pub(super) name_end: u64,
    /// Where its keypoints end in `KEYPOINTS`, `KEYPOINT_POINTS` and `DESCRIPTORS`, in keypoints.
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
    /// Where its track ends in `OBSERVATIONS`; it begins where the track before it ends.
    pub(super) track_end: u64,
}

#[derive(Debug, Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub(super) struct ObservationRecord {
    pub(super) image: u32,
    pub(super) keypoint: u32,
}

/// What holds for all schemes of a self-test; the records of the schemes follow.
#[derive(Debug, Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub(super) struct SelfTestRecord {
    pub(super) scale: f64,
    pub(super) assumed_noise_px: f64,
    pub(super) images: u32,
    pub(super) schemes: u32,
}

/// What a self-test came to under one scheme.
#[derive(Debug, Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub(super) struct SchemeTestRecord {
    /// As on the wire.
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
}

/// What a compressed map was made of; the records of its points follow.
#[derive(Debug, Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub(super) struct CompressedRecord {
    pub(super) bytes: u64,
    pub(super) keypoints: u64,
    pub(super) points: u64,
}

/// What a compressed map remembers of a point.
#[derive(Debug, Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub(super) struct RememberedRecord {
    pub(super) seen_by: u32,
    pub(super) covariance: [f32; 6],
}

/// What holds for all records of a packed map.
#[derive(Debug, Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub(super) struct PackedRecord {
    /// Where positions are counted from, map units.
    pub(super) origin: [f64; 3],
    pub(super) points: u64,
    pub(super) keypoints: u64,
}

/// A point of a packed map.
#[derive(Debug, Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub(super) struct PackedPointRecord {
    /// From the origin, map units.
    pub(super) position: [f32; 3],
    /// Mean reprojection error, 4096 a pixel.
    pub(super) error: u16,
    /// Images that see it in the whole map.
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
    /// The point that it sees.
    pub(super) point: u32,
    /// Coordinates u, v, in steps.
    pub(super) at: [u16; 2],
}

/// What a region is of; the records of its images follow.
#[derive(Debug, Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub(super) struct RegionRecord {
    /// Of the whole map.
    pub(super) images: u32,
    pub(super) reserved: u32,
}

/// An image of a region.
#[derive(Debug, Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub(super) struct RegionImageRecord {
    /// Its index in the whole map.
    pub(super) whole: u32,
    /// 1 in the core, 0 beside it.
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
