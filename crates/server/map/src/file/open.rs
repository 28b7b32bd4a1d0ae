//! Opens and validates a map file. All checks are made here, so later code needs none.

use std::collections::BTreeSet;
use std::ops::Range;
use std::path::Path;
use std::sync::OnceLock;

use veiloc_geometry::nalgebra::{Matrix3, Rotation3, Vector3};
use veiloc_geometry::{CameraFromWorld, CameraModel, Intrinsics};
use veiloc_protocol::{ExtractionLimits, Profile};
use veiloc_simd::MappedFile;
use xxhash_rust::xxh3::xxh3_64;
use zerocopy::{FromBytes, Immutable, KnownLayout};

use super::layout::{
    ALIGN, BuildingRecord, CameraRecord, FORMAT_VERSION, Header, ImageRecord, MAGIC, NO_POINT,
    ObservationRecord, PointRecord, Section, SectionEntry, SettingsRecord, header_checksum,
};
use super::view::{ImageEntry, LargeSections, MapFile};
use super::write::{IN_MEMORY, MapEncoding, byte_count, in_memory};
use super::{compressed, region, self_test};
use crate::alignment::AlignmentAccuracy;
use crate::compressed::WholeMapSummary;
use crate::error::MapError;
use crate::gravity::GravityDirection;
use crate::model::{MapModel, is_name, is_rigid};
use crate::region::Region;
use crate::self_test::SelfTest;
use crate::settings::BuildSettings;

/// How the bytes of an open map are held.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum MapMemory {
    /// Copied into memory. Later changes of the file have no effect; needs as much memory as the file is long.
    #[default]
    Copied,
    /// Memory-mapped. The caller guarantees that no process writes into the file or truncates it while it is open:
    /// after a write the content is no longer validated, after truncation reading terminates the process (SIGBUS).
    Mapped,
}

impl MapFile {
    /// Opens a map with this [`MapMemory`], and validates all of it.
    ///
    /// # Errors
    /// As [`Self::open`]. Copying a file during a write gives a mixture, which is a damaged map.
    pub fn open_in(path: &Path, memory: MapMemory) -> Result<Self, MapError> {
        match memory {
            MapMemory::Copied => Self::of_bytes(MappedFile::copied(path).map_err(MapError::io(path))?, path),
            MapMemory::Mapped => Self::open(path),
        }
    }

    /// Opens a map memory-mapped ([`MapMemory::Mapped`]), and validates all of it.
    ///
    /// # Errors
    /// [`MapError`] with the file: unreadable, not a map, of another version, truncated, damaged (with the section),
    /// or inconsistent.
    pub fn open(path: &Path) -> Result<Self, MapError> {
        Self::of_bytes(MappedFile::open(path).map_err(MapError::io(path))?, path)
    }

    /// A map in memory, as if it had been written and opened, for using a model without writing it.
    ///
    /// It needs the memory of the file in addition to that of the model.
    ///
    /// # Errors
    /// [`MapError::Model`]: the map is inconsistent; [`MapError::Io`]: out of memory.
    pub fn of_model(model: &MapModel) -> Result<Self, MapError> {
        let mut file = Self::of_bytes(in_memory(model, MapEncoding::Plain)?, Path::new(IN_MEMORY))?;
        if let (Some(own), Some(given)) = (&mut file.compressed, &model.compressed) {
            own.packed_from = given.packed_from;
            file.file_bytes = byte_count(model);
        }
        Ok(file)
    }

    /// The map as its file will represent it.
    pub(crate) fn unpacked_of(model: &MapModel) -> Result<Self, MapError> {
        Self::of_bytes(in_memory(model, MapEncoding::of(model))?, Path::new(IN_MEMORY))
    }

    fn of_bytes(bytes: MappedFile, path: &Path) -> Result<Self, MapError> {
        let parser = Parser { path, bytes: &bytes };
        let sections = parser.sections()?;
        if sections[Section::Packed as usize - 1].is_some() {
            let file = Self::of_model(&parser.unpacked(&sections)?)
                .map_err(|e| parser.wrong(Section::Packed.name(), &e.to_string()))?;
            return Ok(Self { path: path.to_owned(), file_bytes: bytes.len() as u64, ..file });
        }
        let parts = parser.parts(&sections)?;
        let Parts {
            profile,
            settings,
            cameras,
            images,
            self_test,
            down,
            is_metric,
            alignment,
            compressed,
            region,
            large,
        } = parts;
        Ok(Self {
            path: path.to_owned(),
            file_bytes: bytes.len() as u64,
            bytes,
            profile,
            settings,
            cameras,
            images,
            self_test,
            down,
            is_metric,
            alignment,
            compressed,
            region,
            large,
            index: OnceLock::new(),
            pack: OnceLock::new(),
            noise: OnceLock::new(),
            covariances: OnceLock::new(),
        })
    }
}

/// Ranges of the sections of the file, by section code minus one.
pub(super) type Sections = [Option<Range<usize>>; Section::ALL.len()];

struct Parts {
    profile: Profile,
    settings: BuildSettings,
    cameras: Vec<Intrinsics>,
    images: Vec<ImageEntry>,
    self_test: Option<SelfTest>,
    down: Option<GravityDirection>,
    is_metric: bool,
    alignment: Option<AlignmentAccuracy>,
    compressed: Option<WholeMapSummary>,
    region: Option<Region>,
    large: LargeSections,
}

pub(super) struct Parser<'a> {
    path: &'a Path,
    pub(super) bytes: &'a [u8],
}

impl<'a> Parser<'a> {
    /// The ranges of the sections, after verifying the checksums.
    fn sections(&self) -> Result<Sections, MapError> {
        let path = || self.path.to_owned();
        let actual = self.bytes.len() as u64;
        let damaged = |section: &'static str| MapError::Checksum { path: path(), section };
        if self.bytes.len() < MAGIC.len() || !self.bytes.starts_with(&MAGIC) {
            return Err(MapError::NotAMap { path: path() });
        }
        let smallest = size_of::<Header>() + Section::REQUIRED.len() * size_of::<SectionEntry>();
        let too_short =
            |expected: usize| MapError::Length { path: path(), actual, expected: expected as u64 };
        let (header, rest) = Header::read_from_prefix(self.bytes).map_err(|_| too_short(smallest))?;
        if header.version != FORMAT_VERSION {
            return Err(MapError::Version { path: path(), found: header.version, supported: FORMAT_VERSION });
        }
        // The saturating arithmetic turns impossible counts into lengths beyond the file.
        let table_length = (header.sections as usize).saturating_mul(size_of::<SectionEntry>());
        let head = table_length.saturating_add(size_of::<Header>());
        let table_bytes = rest.get(..table_length).ok_or_else(|| too_short(head.max(smallest)))?;
        if header.checksum != header_checksum(&header, table_bytes) {
            return Err(damaged("header"));
        }
        if header.length != actual {
            return Err(MapError::Length { path: path(), actual, expected: header.length });
        }
        let wrong = |reason: String| self.wrong("header", &reason);
        let table = <[SectionEntry]>::ref_from_bytes(table_bytes).map_err(|_| too_short(head))?;
        if let Some(unknown) = table.iter().find(|e| Section::from_code(e.code).is_none()) {
            return Err(MapError::UnknownSection { path: path(), code: unknown.code });
        }
        if !Section::fit(table.iter().map(|e| e.code)) || header.reserved != [0; 4] {
            return Err(wrong("not the sections of a map, or reserved bytes are used".to_owned()));
        }
        let mut ranges = Sections::default();
        let mut end = head;
        for (section, entry) in table.iter().filter_map(|e| Some((Section::from_code(e.code)?, e))) {
            let start = end.next_multiple_of(ALIGN);
            let fits = (start as u64).checked_add(entry.length).is_some_and(|end| end <= actual);
            if entry.reserved != 0 || entry.offset != start as u64 || !fits {
                return Err(wrong(format!("section {:?} is not where it belongs", section.name())));
            }
            if self.bytes[end..start].iter().any(|b| *b != 0) {
                return Err(damaged(section.name()));
            }
            end = start + entry.length as usize;
            if xxh3_64(&self.bytes[start..end]) != entry.checksum {
                return Err(damaged(section.name()));
            }
            ranges[section as usize - 1] = Some(start..end);
        }
        if end as u64 != actual {
            return Err(wrong("bytes behind the last section".to_owned()));
        }
        Ok(ranges)
    }

    fn parts(&self, sections: &Sections) -> Result<Parts, MapError> {
        let range = |section: Section| sections[section as usize - 1].clone().unwrap_or_default();
        let profile = self.profile(sections)?;
        let settings = self.settings(sections)?;
        let cameras = self.cameras(self.records(&range(Section::Cameras), Section::Cameras)?)?;
        let keypoints: &[[f32; 2]] = self.records(&range(Section::Keypoints), Section::Keypoints)?;
        let links: &[u32] = self.records(&range(Section::KeypointPoints), Section::KeypointPoints)?;
        let names = self.names(sections)?;
        let records: &[ImageRecord] = self.records(&range(Section::Images), Section::Images)?;
        let global = profile.global_model().global_len();
        let images = self.images(records, names, keypoints.len(), &cameras, global)?;

        let descriptor_bytes = keypoints.len().checked_mul(profile.descriptor_kind().dim());
        if descriptor_bytes != Some(range(Section::Descriptors).len()) {
            return Err(self.wrong(Section::Descriptors.name(), "not one descriptor per keypoint"));
        }
        if images.len().checked_mul(global) != Some(range(Section::Globals).len()) {
            return Err(self.wrong(Section::Globals.name(), "not one global descriptor per image"));
        }
        if links.len() != keypoints.len() {
            return Err(self.wrong(Section::KeypointPoints.name(), "not one entry per keypoint"));
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
        let (self_test, down) = (self.self_test(sections)?, self.down(sections)?);
        let (is_metric, alignment) = (self.is_metric(sections)?, self.alignment(sections)?);
        let compressed = sections[Section::Compressed as usize - 1].clone();
        let compressed = compressed
            .map(|range| {
                let starts = std::iter::once(0).chain(points.iter().map(|p| p.track_end as usize));
                let lengths: Vec<usize> =
                    points.iter().zip(starts).map(|(p, start)| p.track_end as usize - start).collect();
                compressed::decode(&self.bytes[range], lengths.into_iter())
                    .map_err(|e| self.wrong(Section::Compressed.name(), &e))
            })
            .transpose()?;
        let region = self.region(sections, images.len(), compressed.is_some())?;
        Ok(Parts {
            profile,
            settings,
            cameras,
            images,
            self_test,
            down,
            is_metric,
            alignment,
            compressed,
            region,
            large,
        })
    }

    pub(super) fn self_test(&self, sections: &Sections) -> Result<Option<SelfTest>, MapError> {
        let decode = |range: Range<usize>| {
            self_test::decode(&self.bytes[range]).map_err(|e| self.wrong(Section::SelfTest.name(), &e))
        };
        sections[Section::SelfTest as usize - 1].clone().map(decode).transpose()
    }

    pub(super) fn down(&self, sections: &Sections) -> Result<Option<GravityDirection>, MapError> {
        let decode = |range: Range<usize>| {
            let vector: &[f64; 3] = self.record(&range, Section::Down)?;
            GravityDirection::from_stored(*vector).map_err(|e| self.wrong(Section::Down.name(), &e))
        };
        sections[Section::Down as usize - 1].clone().map(decode).transpose()
    }

    pub(super) fn is_metric(&self, sections: &Sections) -> Result<bool, MapError> {
        let Some(range) = &sections[Section::Metric as usize - 1] else { return Ok(false) };
        if range.is_empty() { Ok(true) } else { Err(self.wrong(Section::Metric.name(), "is not empty")) }
    }

    pub(super) fn alignment(&self, sections: &Sections) -> Result<Option<AlignmentAccuracy>, MapError> {
        let decode = |range: Range<usize>| {
            let numbers: &[f64; 7] = self.record(&range, Section::Alignment)?;
            AlignmentAccuracy::from_stored(*numbers).map_err(|e| self.wrong(Section::Alignment.name(), &e))
        };
        sections[Section::Alignment as usize - 1].clone().map(decode).transpose()
    }

    pub(super) fn region(
        &self,
        sections: &Sections,
        images: usize,
        has_summaries: bool,
    ) -> Result<Option<Region>, MapError> {
        let decode = |range: Range<usize>| {
            region::decode(&self.bytes[range], images, has_summaries)
                .map_err(|e| self.wrong(Section::Region.name(), &e))
        };
        sections[Section::Region as usize - 1].clone().map(decode).transpose()
    }

    pub(super) fn profile(&self, sections: &Sections) -> Result<Profile, MapError> {
        let range = sections[Section::Profile as usize - 1].clone().unwrap_or_default();
        Profile::decode(&self.bytes[range]).map_err(|e| self.wrong(Section::Profile.name(), &e.to_string()))
    }

    pub(super) fn names(&self, sections: &Sections) -> Result<&'a str, MapError> {
        let range = sections[Section::Names as usize - 1].clone().unwrap_or_default();
        std::str::from_utf8(&self.bytes[range]).map_err(|_| self.wrong(Section::Names.name(), "not UTF-8"))
    }

    pub(super) fn settings(&self, sections: &Sections) -> Result<BuildSettings, MapError> {
        let range = |section: Section| sections[section as usize - 1].clone().unwrap_or_default();
        let extraction: &SettingsRecord = self.record(&range(Section::Settings), Section::Settings)?;
        let record: &BuildingRecord = self.record(&range(Section::Building), Section::Building)?;
        let settings = BuildSettings {
            extraction: ExtractionLimits {
                max_keypoints: extraction.max_keypoints,
                max_image_side: extraction.max_image_side,
            },
            vocabulary_words: record.vocabulary_words,
            pairs_per_image: record.pairs_per_image,
            min_track_length: record.min_track_length,
            max_ratio: record.max_ratio,
            max_epipolar_error_px: record.max_epipolar_error_px,
            max_reprojection_error_px: record.max_reprojection_error_px,
            min_triangulation_angle_deg: record.min_triangulation_angle_deg,
            seed: record.seed,
        };
        settings.check().map_err(|e| self.wrong(Section::Settings.name(), &e.to_string()))?;
        Ok(settings)
    }

    pub(super) fn cameras(&self, records: &[CameraRecord]) -> Result<Vec<Intrinsics>, MapError> {
        let wrong = |reason: &str| self.wrong(Section::Cameras.name(), reason);
        let cameras = records.iter().take_while(|r| r.model != CameraRecord::CONTINUED).count();
        let (own, more) = records.split_at(cameras);
        let mut more = more.iter();
        let mut camera = |(index, record): (usize, &CameraRecord)| {
            let (name, count) = CameraModel::from_colmap_id(record.model as i32)
                .ok_or_else(|| wrong(&format!("unknown camera model {}", record.model)))?;
            let mut params = record.params.to_vec();
            if count > params.len() {
                let rest = more.next().filter(|rest| {
                    rest.model == CameraRecord::CONTINUED && rest.width as usize == index && rest.height == 0
                });
                let rest = rest.ok_or_else(|| wrong(&format!("camera {index} lacks parameters")))?;
                if rest.reserved != 0 {
                    return Err(wrong("reserved bytes are used"));
                }
                params.extend(rest.params);
            }
            let (params, unused) = params.split_at(count);
            if record.reserved != 0 || unused.iter().any(|p| p.to_bits() != 0) {
                return Err(wrong("reserved bytes are used"));
            }
            Intrinsics::new(name, record.width, record.height, params).map_err(|e| wrong(&e.to_string()))
        };
        let cameras = own.iter().enumerate().map(&mut camera).collect::<Result<_, _>>()?;
        if more.next().is_some() {
            return Err(wrong("parameters without a camera"));
        }
        Ok(cameras)
    }

    pub(super) fn images(
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
            let name = name.filter(|n| is_name(n));
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
            return Err(wrong("names or keypoints without an image".to_owned()));
        }
        Ok(images)
    }

    /// Checks that tracks are ordered, in range, and consistent with the keypoints.
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
            let links_back = |o: &ObservationRecord| {
                let image = images.get(o.image as usize)?;
                let keypoint = image.keypoints.clone().nth(o.keypoint as usize)?;
                (links[keypoint] == id as u32).then_some(())
            };
            if !track.iter().all(|o| links_back(o).is_some()) {
                return Err(wrong(format!(
                    "point {id} has an observation whose keypoint does not refer to it"
                )));
            }
            start = range.end;
        }
        // Every observation has its own keypoint; one more linked keypoint would refer to a point that does not list
        // it.
        if start != observations.len()
            || links.iter().filter(|l| **l != NO_POINT).count() != observations.len()
        {
            return Err(wrong("observations without a point".to_owned()));
        }
        Ok(())
    }

    pub(super) fn records<T: FromBytes + Immutable + KnownLayout>(
        &self,
        range: &Range<usize>,
        section: Section,
    ) -> Result<&'a [T], MapError> {
        <[T]>::ref_from_bytes(&self.bytes[range.clone()])
            .map_err(|_| self.wrong(section.name(), "not whole records"))
    }

    fn record<T: FromBytes + Immutable + KnownLayout>(
        &self,
        range: &Range<usize>,
        section: Section,
    ) -> Result<&'a T, MapError> {
        match self.records(range, section)? {
            [one] => Ok(one),
            _ => Err(self.wrong(section.name(), "not one record")),
        }
    }

    pub(super) fn wrong(&self, section: &'static str, reason: &str) -> MapError {
        MapError::Structure { path: self.path.to_owned(), section, reason: reason.to_owned() }
    }
}

/// `start..end` if it is ordered and within `length`.
fn slice_end(start: usize, end: u64, length: usize) -> Option<Range<usize>> {
    let end = usize::try_from(end).ok()?;
    (start <= end && end <= length).then_some(start..end)
}

/// The pose exactly as written, if it is a rotation up to rounding and a finite translation.
fn pose(record: &ImageRecord) -> Option<CameraFromWorld> {
    let r = Matrix3::from_fn(|row, column| record.rotation[row][column]);
    let t = Vector3::from(record.translation);
    let pose = CameraFromWorld::new(Rotation3::from_matrix_unchecked(r), t);
    is_rigid(&pose).then_some(pose)
}
