//! Writes map files, under a lock.

use std::io::{self, Write};
use std::path::Path;

use crate::atomic_file::{Permissions, TargetLock, replace_file};
use veiloc_simd::MappedFile;
use xxhash_rust::xxh3::Xxh3;
use zerocopy::IntoBytes;

use super::layout::{
    ALIGN, BuildingRecord, CameraRecord, FORMAT_VERSION, Header, ImageRecord, MAGIC, NO_POINT,
    ObservationRecord, PointRecord, Section, SectionEntry, SettingsRecord, header_checksum,
};
use super::{compressed, packed, region, self_test};
use crate::compressed::WholeMapSummary;
use crate::error::MapError;
use crate::model::MapModel;
use crate::settings::BuildSettings;

/// A lock on a map file, held by one program at a time.
///
/// A program that modifies a map must hold the lock from before reading until after writing, or it could overwrite
/// changes of another program. Readers need no lock. The lock is on a file `.NAME.lock` next to the map, is advisory,
/// and is released when its holder ends in any way.
#[derive(Debug)]
pub struct MapLock {
    target: TargetLock,
}

impl MapLock {
    /// Waits for the lock.
    ///
    /// # Errors
    /// [`MapError::Io`]: the folder is missing or not writable.
    pub fn acquire(path: &Path) -> Result<Self, MapError> {
        Ok(Self { target: TargetLock::acquire(path).map_err(MapError::io(path))? })
    }

    /// Tries to lock; `None` if another program holds the lock.
    ///
    /// # Errors
    /// As for [`Self::acquire`].
    pub fn try_acquire(path: &Path) -> Result<Option<Self>, MapError> {
        let target = TargetLock::try_acquire(path).map_err(MapError::io(path))?;
        Ok(target.map(|target| Self { target }))
    }

    /// Writes the map file, as [`write()`] does.
    ///
    /// # Errors
    /// [`MapError::Model`] when the map does not hold together, [`MapError::Io`] naming the file.
    pub fn write(&self, model: &MapModel) -> Result<(), MapError> {
        model.validate()?;
        let sections = Sections::of(model);
        replace_file(&self.target, Permissions::Preserve, |out| sections.write(out))
            .map_err(MapError::io(self.target.target()))
    }
}

/// Writes a map file. Equal maps give equal bytes.
///
/// The file is written next to `path`, flushed to the disk, and renamed over it. After an interruption the file at
/// `path` is completely old or completely new; a program that has the old file open keeps it. Waits for the
/// [`MapLock`].
///
/// # Errors
/// [`MapError::Model`] when the map does not hold together, [`MapError::Io`] naming the file.
pub fn write(model: &MapModel, path: &Path) -> Result<(), MapError> {
    MapLock::acquire(path)?.write(model)
}

/// Length of the file of a map, bytes. The map may be inconsistent.
pub fn byte_count(model: &MapModel) -> u64 {
    Sections::of(model).head().0.length
}

/// Encoding of the large arrays of a map.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum MapEncoding {
    /// Plain arrays in sections 6 to 11.
    Plain,
    /// Packed into section 17.
    Packed,
}

impl MapEncoding {
    /// The encoding of a map's file.
    pub(super) fn of(model: &MapModel) -> Self {
        let packed = model.compressed.as_ref().is_some_and(|c| c.packed_from.is_some());
        if packed { Self::Packed } else { Self::Plain }
    }
}

/// The bytes of a map file with this encoding, in memory.
pub(super) fn in_memory(model: &MapModel, encoding: MapEncoding) -> Result<MappedFile, MapError> {
    model.validate()?;
    let sections = Sections::with_encoding(model, encoding);
    let (header, table) = sections.head();
    let fill = |mut to: &mut [u8]| sections.write_behind(&header, &table, &mut to);
    MappedFile::in_memory(header.length as usize, fill).map_err(MapError::io(Path::new(IN_MEMORY)))
}

/// Sections as lists of pieces, so that large arrays are not copied.
struct Sections<'a> {
    pieces: Vec<(Section, Vec<Piece<'a>>)>,
}

enum Piece<'a> {
    Owned(Vec<u8>),
    Borrowed(&'a [u8]),
}

impl Piece<'_> {
    fn bytes(&self) -> &[u8] {
        match self {
            Self::Owned(bytes) => bytes,
            Self::Borrowed(bytes) => bytes,
        }
    }
}

impl<'a> Sections<'a> {
    fn of(model: &'a MapModel) -> Self {
        Self::with_encoding(model, MapEncoding::of(model))
    }

    fn with_encoding(model: &'a MapModel, encoding: MapEncoding) -> Self {
        let section = |section: Section| {
            let images = || model.images.iter();
            let pieces = match section {
                section if encoding == MapEncoding::Packed && section.is_packed() => Vec::new(),
                Section::Profile => vec![Piece::Owned(model.profile.encode())],
                Section::Settings => vec![owned(&[settings_record(&model.settings)])],
                Section::Cameras => vec![owned(&camera_records(&model.cameras))],
                Section::Images => vec![owned(&image_records(model))],
                Section::Names => images().map(|i| Piece::Borrowed(i.name.as_bytes())).collect(),
                Section::Keypoints => images().map(|i| Piece::Borrowed(i.keypoints.as_bytes())).collect(),
                Section::KeypointPoints => images()
                    .map(|i| {
                        let ids = i.point_of_keypoint.iter().map(|p| p.map_or(NO_POINT, |p| p.0));
                        owned(&ids.collect::<Vec<_>>())
                    })
                    .collect(),
                Section::Descriptors => images().map(|i| Piece::Borrowed(i.descriptors.as_bytes())).collect(),
                Section::Globals => {
                    images().map(|i| Piece::Borrowed(i.global.as_codes().as_bytes())).collect()
                }
                Section::Points => vec![owned(&point_records(model))],
                Section::Observations => {
                    let track = model.points.iter().flat_map(|p| &p.track);
                    let records = track.map(|o| ObservationRecord { image: o.image, keypoint: o.keypoint });
                    vec![owned(&records.collect::<Vec<_>>())]
                }
                Section::Building => vec![owned(&[building_record(&model.settings)])],
                Section::SelfTest => {
                    model.self_test.iter().map(|t| Piece::Owned(self_test::encode(t))).collect()
                }
                Section::Down => model.down.iter().map(|down| owned(&down.in_world())).collect(),
                Section::Compressed => {
                    let here = |c: &'a WholeMapSummary| {
                        if encoding == MapEncoding::Packed { &[][..] } else { &c.of_points[..] }
                    };
                    model.compressed.iter().map(|c| Piece::Owned(compressed::encode(c, here(c)))).collect()
                }
                Section::Packed => {
                    let encode = |c: &WholeMapSummary| {
                        Some(Piece::Owned(packed::encode(model, c.packed_from?, &c.of_points)))
                    };
                    model.compressed.iter().filter_map(encode).collect()
                }
                Section::Metric => Vec::new(),
                Section::Alignment => model.alignment.iter().map(|a| owned(&a.numbers())).collect(),
                Section::Region => model.region.iter().map(|r| Piece::Owned(region::encode(r))).collect(),
            };
            (section, pieces)
        };
        let is_there = |section: &Section| match section {
            Section::SelfTest => model.self_test.is_some(),
            Section::Down => model.down.is_some(),
            Section::Metric => model.is_metric,
            Section::Alignment => model.alignment.is_some(),
            Section::Compressed => model.compressed.is_some(),
            Section::Packed => encoding == MapEncoding::Packed,
            Section::Region => model.region.is_some(),
            _ => true,
        };
        let there = Section::ALL.into_iter().filter(is_there);
        Self { pieces: there.map(section).collect() }
    }

    /// Header and table.
    fn head(&self) -> (Header, Vec<SectionEntry>) {
        let mut table = Vec::new();
        let mut end = size_of::<Header>() + self.pieces.len() * size_of::<SectionEntry>();
        for (section, pieces) in &self.pieces {
            let mut hash = Xxh3::new();
            let mut length = 0;
            for piece in pieces {
                hash.update(piece.bytes());
                length += piece.bytes().len();
            }
            let offset = end.next_multiple_of(ALIGN);
            table.push(SectionEntry {
                code: *section as u32,
                reserved: 0,
                offset: offset as u64,
                length: length as u64,
                checksum: hash.digest(),
            });
            end = offset + length;
        }
        let mut header = Header {
            magic: MAGIC,
            version: FORMAT_VERSION,
            sections: table.len() as u32,
            length: end as u64,
            checksum: 0,
            reserved: [0; 4],
        };
        header.checksum = header_checksum(&header, table.as_bytes());
        (header, table)
    }

    fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        let (header, table) = self.head();
        self.write_behind(&header, &table, out)
    }

    /// Writes the whole file with this header and table.
    fn write_behind(&self, header: &Header, table: &[SectionEntry], out: &mut dyn Write) -> io::Result<()> {
        out.write_all(header.as_bytes())?;
        out.write_all(table.as_bytes())?;
        let mut at = size_of::<Header>() + table.as_bytes().len();
        for ((_, pieces), entry) in self.pieces.iter().zip(table) {
            out.write_all(&[0; ALIGN][..entry.offset as usize - at])?;
            pieces.iter().try_for_each(|p| out.write_all(p.bytes()))?;
            at = (entry.offset + entry.length) as usize;
        }
        Ok(())
    }
}

/// Path of a map that has no file.
pub(super) const IN_MEMORY: &str = "(in memory)";

fn owned<T: IntoBytes + zerocopy::Immutable>(records: &[T]) -> Piece<'static> {
    Piece::Owned(records.as_bytes().to_vec())
}

fn settings_record(settings: &BuildSettings) -> SettingsRecord {
    SettingsRecord {
        max_keypoints: settings.extraction.max_keypoints,
        max_image_side: settings.extraction.max_image_side,
    }
}

fn building_record(settings: &BuildSettings) -> BuildingRecord {
    BuildingRecord {
        vocabulary_words: settings.vocabulary_words,
        pairs_per_image: settings.pairs_per_image,
        min_track_length: settings.min_track_length,
        max_ratio: settings.max_ratio,
        max_epipolar_error_px: settings.max_epipolar_error_px,
        max_reprojection_error_px: settings.max_reprojection_error_px,
        min_triangulation_angle_deg: settings.min_triangulation_angle_deg,
        seed: settings.seed,
    }
}

/// One record per camera, then records for parameters beyond the eighth.
pub(super) fn camera_records(cameras: &[veiloc_geometry::Intrinsics]) -> Vec<CameraRecord> {
    let room = |given: &[f64]| {
        let mut params = [0.0; 8];
        params.iter_mut().zip(given).for_each(|(param, value)| *param = *value);
        params
    };
    let own = cameras.iter().map(|camera| CameraRecord {
        model: camera.model.colmap_id() as u32,
        width: camera.width,
        height: camera.height,
        reserved: 0,
        params: room(camera.model.params()),
    });
    let more = (0..).zip(cameras).filter_map(|(index, camera)| {
        Some(CameraRecord {
            model: CameraRecord::CONTINUED,
            width: index,
            height: 0,
            reserved: 0,
            params: room(camera.model.params().get(8..).filter(|rest| !rest.is_empty())?),
        })
    });
    own.chain(more).collect()
}

fn image_records(model: &MapModel) -> Vec<ImageRecord> {
    let (mut name_end, mut keypoint_end) = (0, 0);
    let record = |image: &crate::MapImage| {
        name_end += image.name.len() as u64;
        keypoint_end += image.keypoints.len() as u64;
        let r = image.cam_from_world.rotation().matrix();
        ImageRecord {
            rotation: [0, 1, 2].map(|row| [0, 1, 2].map(|column| r[(row, column)])),
            translation: (*image.cam_from_world.translation()).into(),
            name_end,
            keypoint_end,
            camera: image.camera as u32,
            reserved: 0,
        }
    };
    model.images.iter().map(record).collect()
}

fn point_records(model: &MapModel) -> Vec<PointRecord> {
    let mut track_end = 0;
    let record = |point: &crate::MapPoint| {
        track_end += point.track.len() as u64;
        PointRecord { position: point.position.coords.into(), error: point.error, track_end }
    };
    model.points.iter().map(record).collect()
}

/// The whole file as bytes, for tests.
#[cfg(test)]
pub(super) fn to_bytes(model: &MapModel) -> Vec<u8> {
    let mut bytes = Vec::new();
    Sections::of(model).write(&mut bytes).expect("memory takes all that is written to it");
    bytes
}
