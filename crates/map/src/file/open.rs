//! Opening a map file: everything that could be wrong with it is found here, so that nothing later needs to look.

use std::collections::BTreeSet;
use std::ops::Range;
use std::path::Path;

use veiloc_geometry::nalgebra::{Matrix3, Rotation3, Vector3};
use veiloc_geometry::{CameraFromWorld, CameraModel, Intrinsics};
use veiloc_kernels::MappedFile;
use veiloc_query::{ExtractionLimits, Profile};
use xxhash_rust::xxh3::xxh3_64;
use zerocopy::{FromBytes, Immutable, KnownLayout};

use super::layout::{
    ALIGN, CameraRecord, Entry, FORMAT_VERSION, Header, ImageRecord, MAGIC, NO_POINT, ObservationRecord,
    PointRecord, Section, SettingsRecord, header_checksum,
};
use super::view::{ImageEntry, LargeSections, MapFile};
use crate::error::MapError;
use crate::model::is_rigid;

impl MapFile {
    /// Opens a map, reading it once to check all of it.
    ///
    /// # Errors
    /// [`MapError`] naming the file: it cannot be read, is no map, is of another version, was cut, is damaged (which
    /// section), or does not hold together although it is undamaged.
    pub fn open(path: &Path) -> Result<Self, MapError> {
        let bytes = MappedFile::open(path).map_err(MapError::io(path))?;
        let parser = Parser { path, bytes: &bytes };
        let sections = parser.sections()?;
        let parts = parser.parts(&sections)?;
        let Parts { profile, extraction, cameras, images, large } = parts;
        Ok(Self { path: path.to_owned(), bytes, profile, extraction, cameras, images, large })
    }
}

struct Parts {
    profile: Profile,
    extraction: ExtractionLimits,
    cameras: Vec<Intrinsics>,
    images: Vec<ImageEntry>,
    large: LargeSections,
}

struct Parser<'a> {
    path: &'a Path,
    bytes: &'a [u8],
}

impl<'a> Parser<'a> {
    /// The bytes of each section, in the order of [`Section::ALL`], checksums verified.
    fn sections(&self) -> Result<[Range<usize>; Section::ALL.len()], MapError> {
        let path = || self.path.to_owned();
        let actual = self.bytes.len() as u64;
        let damaged = |section: &'static str| MapError::Checksum { path: path(), section };
        if self.bytes.len() < MAGIC.len() || !self.bytes.starts_with(&MAGIC) {
            return Err(MapError::NotAMap { path: path() });
        }
        let smallest = size_of::<Header>() + Section::ALL.len() * size_of::<Entry>();
        let too_short = || MapError::Length { path: path(), actual, expected: smallest as u64 };
        let (header, rest) = Header::read_from_prefix(self.bytes).map_err(|_| too_short())?;
        if header.version != FORMAT_VERSION {
            return Err(MapError::Version { path: path(), found: header.version, supported: FORMAT_VERSION });
        }
        let table_bytes = rest.get(..Section::ALL.len() * size_of::<Entry>()).ok_or_else(too_short)?;
        if header.checksum != header_checksum(&header, table_bytes) {
            return Err(damaged("header"));
        }
        if header.length != actual {
            return Err(MapError::Length { path: path(), actual, expected: header.length });
        }
        let wrong = |reason: &str| self.wrong("header", reason);
        if header.sections as usize != Section::ALL.len() || header.reserved != [0; 4] {
            return Err(wrong("another number of sections than version 1 has, or reserved bytes in use"));
        }
        let mut ranges = [const { 0..0 }; Section::ALL.len()];
        let mut end = smallest;
        for (i, section) in Section::ALL.into_iter().enumerate() {
            let at = &table_bytes[i * size_of::<Entry>()..][..size_of::<Entry>()];
            let entry = Entry::read_from_bytes(at).map_err(|_| too_short())?;
            let start = end.next_multiple_of(ALIGN);
            let fits = (start as u64).checked_add(entry.length).is_some_and(|end| end <= actual);
            if entry.code != section as u32 || entry.reserved != 0 || entry.offset != start as u64 || !fits {
                return Err(wrong("a section that is not where version 1 has it"));
            }
            if self.bytes[end..start].iter().any(|b| *b != 0) {
                return Err(damaged(section.name()));
            }
            end = start + entry.length as usize;
            if xxh3_64(&self.bytes[start..end]) != entry.checksum {
                return Err(damaged(section.name()));
            }
            ranges[i] = start..end;
        }
        if end as u64 != actual {
            return Err(wrong("bytes behind the last section"));
        }
        Ok(ranges)
    }

    fn parts(&self, sections: &[Range<usize>; Section::ALL.len()]) -> Result<Parts, MapError> {
        let range = |section: Section| sections[section as usize - 1].clone();
        let profile = Profile::decode(&self.bytes[range(Section::Profile)])
            .map_err(|e| self.wrong(Section::Profile.name(), &e.to_string()))?;
        let extraction = match self.records::<SettingsRecord>(&range(Section::Settings), Section::Settings)? {
            [one] => {
                ExtractionLimits { max_keypoints: one.max_keypoints, max_image_side: one.max_image_side }
            }
            _ => return Err(self.wrong(Section::Settings.name(), "not one record")),
        };
        let cameras = self.cameras(self.records(&range(Section::Cameras), Section::Cameras)?)?;
        let keypoints: &[[f32; 2]] = self.records(&range(Section::Keypoints), Section::Keypoints)?;
        let links: &[u32] = self.records(&range(Section::KeypointPoints), Section::KeypointPoints)?;
        let names = std::str::from_utf8(&self.bytes[range(Section::Names)])
            .map_err(|_| self.wrong(Section::Names.name(), "not UTF-8"))?;
        let records: &[ImageRecord] = self.records(&range(Section::Images), Section::Images)?;
        let global = profile.global_model().global_len();
        let images = self.images(records, names, keypoints.len(), &cameras, global)?;

        let descriptor_bytes = keypoints.len().checked_mul(profile.descriptor_kind().dim());
        if descriptor_bytes != Some(range(Section::Descriptors).len()) {
            return Err(self.wrong(Section::Descriptors.name(), "not one descriptor a keypoint"));
        }
        if images.len().checked_mul(global) != Some(range(Section::Globals).len()) {
            return Err(self.wrong(Section::Globals.name(), "not one global descriptor an image"));
        }
        if links.len() != keypoints.len() {
            return Err(self.wrong(Section::KeypointPoints.name(), "not one entry a keypoint"));
        }
        if !keypoints.iter().flatten().all(|c| c.is_finite()) {
            return Err(self.wrong(Section::Keypoints.name(), "a keypoint that is not finite"));
        }
        let points: &[PointRecord] = self.records(&range(Section::Points), Section::Points)?;
        let observations: &[ObservationRecord] =
            self.records(&range(Section::Observations), Section::Observations)?;
        self.tracks(points, observations, links, &images)?;
        let large = LargeSections {
            keypoints: range(Section::Keypoints),
            keypoint_points: range(Section::KeypointPoints),
            descriptors: range(Section::Descriptors),
            globals: range(Section::Globals),
            points: range(Section::Points),
            observations: range(Section::Observations),
        };
        Ok(Parts { profile, extraction, cameras, images, large })
    }

    fn cameras(&self, records: &[CameraRecord]) -> Result<Vec<Intrinsics>, MapError> {
        let camera = |record: &CameraRecord| {
            let wrong = |reason: &str| self.wrong(Section::Cameras.name(), reason);
            let (name, count) = CameraModel::from_colmap_id(record.model as i32)
                .ok_or_else(|| wrong(&format!("unknown camera model {}", record.model)))?;
            let (params, unused) = record.params.split_at(count);
            if record.reserved != 0 || unused.iter().any(|p| p.to_bits() != 0) {
                return Err(wrong("bytes in use that version 1 reserves"));
            }
            Intrinsics::new(name, record.width, record.height, params).map_err(|e| wrong(&e.to_string()))
        };
        records.iter().map(camera).collect()
    }

    fn images(
        &self,
        records: &[ImageRecord],
        names: &str,
        keypoints: usize,
        cameras: &[Intrinsics],
        global: usize,
    ) -> Result<Vec<ImageEntry>, MapError> {
        let wrong = |reason: String| self.wrong(Section::Images.name(), &reason);
        let (mut name_start, mut keypoint_start) = (0, 0);
        let mut seen = BTreeSet::new();
        let mut images = Vec::with_capacity(records.len());
        for (i, record) in records.iter().enumerate() {
            let name = slice_end(name_start, record.name_end, names.len()).and_then(|r| names.get(r));
            let name = name.filter(|n| !n.is_empty() && !n.contains(['\0', '\n', '\r']));
            let name = name.ok_or_else(|| wrong(format!("image {i} has no usable name")))?;
            if !seen.insert(name) {
                return Err(wrong(format!("the name {name:?} appears twice")));
            }
            let own = slice_end(keypoint_start, record.keypoint_end, keypoints);
            let own =
                own.ok_or_else(|| wrong(format!("the keypoints of {name:?} do not lie in their section")))?;
            let camera = record.camera as usize;
            if camera >= cameras.len() || record.reserved != 0 {
                return Err(wrong(format!("{name:?} has camera {camera} of {}", cameras.len())));
            }
            let cam_from_world = pose(record)
                .ok_or_else(|| wrong(format!("{name:?} has a pose that is no rigid transform")))?;
            name_start += name.len();
            keypoint_start = own.end;
            images.push(ImageEntry {
                name: name.to_owned(),
                camera,
                cam_from_world,
                keypoints: own,
                global: i * global..(i + 1) * global,
            });
        }
        if name_start != names.len() || keypoint_start != keypoints {
            return Err(wrong("names or keypoints of no image".to_owned()));
        }
        Ok(images)
    }

    /// Tracks in order, in range, and telling the same as the keypoints.
    fn tracks(
        &self,
        points: &[PointRecord],
        observations: &[ObservationRecord],
        links: &[u32],
        images: &[ImageEntry],
    ) -> Result<(), MapError> {
        let wrong = |reason: String| self.wrong(Section::Points.name(), &reason);
        if points.len() >= NO_POINT as usize {
            return Err(wrong("more points than 32-bit numbers can count".to_owned()));
        }
        let mut start = 0;
        for (id, point) in points.iter().enumerate() {
            if !point.position.iter().chain([&point.error]).all(|c| c.is_finite()) {
                return Err(wrong(format!("point {id} is not finite")));
            }
            let range = slice_end(start, point.track_end, observations.len()).filter(|r| !r.is_empty());
            let range =
                range.ok_or_else(|| wrong(format!("the track of point {id} does not lie in its section")))?;
            let track = &observations[range.clone()];
            if !track.is_sorted_by(|a, b| (a.image, a.keypoint) < (b.image, b.keypoint)) {
                return Err(wrong(format!("the track of point {id} is not in rising order")));
            }
            let says_so = |o: &ObservationRecord| {
                let image = images.get(o.image as usize)?;
                let keypoint = image.keypoints.clone().nth(o.keypoint as usize)?;
                (links[keypoint] == id as u32).then_some(())
            };
            if !track.iter().all(|o| says_so(o).is_some()) {
                return Err(wrong(format!("point {id} is seen by a keypoint that does not say so")));
            }
            start = range.end;
        }
        // Every observation has its own keypoint; a keypoint more would see a point that does not know it.
        if start != observations.len()
            || links.iter().filter(|l| **l != NO_POINT).count() != observations.len()
        {
            return Err(wrong("observations of no point".to_owned()));
        }
        Ok(())
    }

    fn records<T: FromBytes + Immutable + KnownLayout>(
        &self,
        range: &Range<usize>,
        section: Section,
    ) -> Result<&'a [T], MapError> {
        <[T]>::ref_from_bytes(&self.bytes[range.clone()])
            .map_err(|_| self.wrong(section.name(), "not whole records"))
    }

    fn wrong(&self, section: &'static str, reason: &str) -> MapError {
        MapError::Structure { path: self.path.to_owned(), section, reason: reason.to_owned() }
    }
}

/// `start..end` when it goes forward and stays within `length`.
fn slice_end(start: usize, end: u64, length: usize) -> Option<Range<usize>> {
    let end = usize::try_from(end).ok()?;
    (start <= end && end <= length).then_some(start..end)
}

/// The pose exactly as it was written, when it is a rotation up to rounding and a finite translation.
fn pose(record: &ImageRecord) -> Option<CameraFromWorld> {
    let r = Matrix3::from_fn(|row, column| record.rotation[row][column]);
    let t = Vector3::from(record.translation);
    let pose = CameraFromWorld::new(Rotation3::from_matrix_unchecked(r), t);
    is_rigid(&pose).then_some(pose)
}
