//! An opened map file: the read access of the server.

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use veiloc_descriptor::{DescriptorView, GlobalDescriptor, GlobalIndex};
use veiloc_geometry::frames::World;
use veiloc_geometry::{CameraFromWorld, Intrinsics, Point3};
use veiloc_protocol::{MapCoordinates, Profile};
use veiloc_simd::MappedFile;
use zerocopy::{FromBytes, Immutable, KnownLayout};

use super::layout::{NO_POINT, ObservationRecord, PointRecord};
use crate::alignment::AlignmentAccuracy;
use crate::compressed::{PointSummary, WholeMapSummary};
use crate::gravity::GravityDirection;
use crate::model::{MapImage, MapModel, MapPoint, Observation, PointId};
use crate::pack::PackPoints;
use crate::region::Region;
use crate::self_test::SelfTest;
use crate::settings::BuildSettings;

/// An opened map file: it is validated once when it is opened, and reading copies nothing.
///
/// A memory-mapped file must not be overwritten while it is open; [`write`](crate::write()) replaces the file
/// instead.
#[derive(Debug)]
pub struct MapFile {
    pub(super) path: PathBuf,
    pub(super) bytes: MappedFile,
    /// Length of the file; differs from `bytes` if the file is packed.
    pub(super) file_bytes: u64,
    pub(super) profile: Profile,
    pub(super) settings: BuildSettings,
    pub(super) cameras: Vec<Intrinsics>,
    pub(super) images: Vec<ImageEntry>,
    pub(super) self_test: Option<SelfTest>,
    pub(super) down: Option<GravityDirection>,
    pub(super) is_metric: bool,
    pub(super) alignment: Option<AlignmentAccuracy>,
    pub(super) compressed: Option<WholeMapSummary>,
    pub(super) region: Option<Region>,
    pub(super) large: LargeSections,
    /// Built on first use.
    pub(super) index: OnceLock<GlobalIndex>,
    /// Numbers of the pack, computed on first use.
    pub(crate) pack: OnceLock<PackPoints>,
    /// Computed on first use.
    pub(super) noise: OnceLock<f64>,
    /// Upper triangle of each covariance by rows; the list and each element are computed on first use.
    pub(super) covariances: OnceLock<Box<[OnceLock<[f64; 6]>]>>,
}

/// Small parts of an image, and ranges of its large ones.
#[derive(Debug)]
pub(super) struct ImageEntry {
    pub(super) name: String,
    pub(super) camera: usize,
    pub(super) cam_from_world: CameraFromWorld,
    /// Range in the sections with one record per keypoint.
    pub(super) keypoints: Range<usize>,
    /// Range in the global codes.
    pub(super) global: Range<usize>,
}

/// Ranges of the large sections.
#[derive(Debug, Default)]
pub(super) struct LargeSections {
    pub(super) keypoints: Range<usize>,
    pub(super) keypoint_points: Range<usize>,
    pub(super) descriptors: Range<usize>,
    pub(super) globals: Range<usize>,
    pub(super) points: Range<usize>,
    pub(super) observations: Range<usize>,
}

impl MapFile {
    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Length of the file, bytes.
    pub const fn byte_count(&self) -> u64 {
        self.file_bytes
    }

    /// Its bytes in memory: those of the file, or of the unpacked map.
    pub fn as_bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// The profile with which a device seals queries for this map.
    pub const fn profile(&self) -> &Profile {
        &self.profile
    }

    /// How the map was built.
    pub const fn settings(&self) -> &BuildSettings {
        &self.settings
    }

    /// The self-test; `None` if there was none since the map was built or changed.
    pub const fn self_test(&self) -> Option<&SelfTest> {
        self.self_test.as_ref()
    }

    /// The direction of gravity, if the builder of the map gave it.
    pub const fn down(&self) -> Option<GravityDirection> {
        self.down
    }

    /// Whether map units are metres; false if not known.
    pub const fn is_metric(&self) -> bool {
        self.is_metric
    }

    /// How well its coordinate frame is known, if it was aligned to known positions.
    pub const fn alignment(&self) -> Option<AlignmentAccuracy> {
        self.alignment
    }

    /// What its coordinates mean: unit and direction of gravity.
    pub fn coordinates(&self) -> MapCoordinates {
        MapCoordinates {
            metres_per_unit: self.is_metric.then_some(1.0),
            down: self.down.map(|down| down.in_world()),
        }
    }

    /// Data about the whole map, if this is a compressed map.
    pub const fn compressed(&self) -> Option<&WholeMapSummary> {
        self.compressed.as_ref()
    }

    /// The part of a larger map that this is, if it is a region.
    pub const fn part_of(&self) -> Option<&Region> {
        self.region.as_ref()
    }

    /// Number of cameras.
    pub fn camera_count(&self) -> usize {
        self.cameras.len()
    }

    /// Number of images.
    pub fn image_count(&self) -> usize {
        self.images.len()
    }

    /// Number of points.
    pub fn point_count(&self) -> usize {
        self.points().len()
    }

    /// Number of observations of all points.
    pub fn observation_count(&self) -> usize {
        self.observations().len()
    }

    /// The image with this index, which must be below [`Self::image_count`].
    pub fn image(&self, index: usize) -> ImageView<'_> {
        ImageView { map: self, entry: &self.images[index] }
    }

    /// All images, in order.
    pub fn images(&self) -> impl ExactSizeIterator<Item = ImageView<'_>> {
        self.images.iter().map(|entry| ImageView { map: self, entry })
    }

    /// The index of global descriptors; `None` for a small map, in which comparing all images is as fast.
    ///
    /// Built on first use on all processors: about 20 microseconds per image and processor.
    pub fn global_index(&self) -> Option<&GlobalIndex> {
        let codes = self.profile.global_model().global_len();
        let make = || GlobalIndex::new(self.records(&self.large.globals), codes);
        (self.images.len() >= GlobalIndex::MIN_IMAGES).then(|| self.index.get_or_init(make))
    }

    /// Position of a point, map units.
    pub fn point(&self, id: PointId) -> Point3<World> {
        let [x, y, z] = self.points()[id.index()].position;
        Point3::new(x, y, z)
    }

    /// Mean reprojection error of a point of this map over its track, pixels.
    pub fn reprojection_error(&self, id: PointId) -> f64 {
        self.points()[id.index()].error
    }

    /// Number of images that observe a point; in a compressed map, of the whole map.
    pub fn seen_by(&self, id: PointId) -> usize {
        self.point_summary(id).map_or_else(|| self.track_length(id), |r| r.seen_by as usize)
    }

    pub(super) fn point_summary(&self, id: PointId) -> Option<&PointSummary> {
        self.compressed.as_ref().and_then(|c| c.of_points.get(id.index()))
    }

    /// Number of observations of a point of this map.
    pub fn track_length(&self, id: PointId) -> usize {
        self.track_range(id).len()
    }

    /// Observations of a point, in ascending order.
    pub fn track(&self, id: PointId) -> impl ExactSizeIterator<Item = Observation> {
        let records = &self.observations()[self.track_range(id)];
        records.iter().map(|o| Observation { image: o.image, keypoint: o.keypoint })
    }

    /// Copies the data into a mutable model.
    pub fn to_model(&self) -> MapModel {
        let points = (0..self.point_count() as u32).map(PointId).map(|id| MapPoint {
            position: self.point(id),
            track: self.track(id).collect(),
            error: self.reprojection_error(id),
        });
        MapModel {
            cameras: self.cameras.clone(),
            images: self.images().map(|image| image.to_model()).collect(),
            points: points.collect(),
            settings: self.settings,
            profile: self.profile.clone(),
            self_test: self.self_test.clone(),
            down: self.down,
            is_metric: self.is_metric,
            alignment: self.alignment,
            compressed: self.compressed.clone(),
            region: self.region.clone(),
        }
    }

    fn track_range(&self, id: PointId) -> Range<usize> {
        let points = self.points();
        let start = id.index().checked_sub(1).map_or(0, |before| points[before].track_end);
        start as usize..points[id.index()].track_end as usize
    }

    pub(super) fn points(&self) -> &[PointRecord] {
        self.records(&self.large.points)
    }

    pub(super) fn observations(&self) -> &[ObservationRecord] {
        self.records(&self.large.observations)
    }

    pub(super) fn records<T: FromBytes + Immutable + KnownLayout>(&self, section: &Range<usize>) -> &[T] {
        <[T]>::ref_from_bytes(&self.bytes[section.clone()])
            .expect("aligned and whole records, checked when opened")
    }
}

/// An image of a map file.
#[derive(Debug, Clone, Copy)]
pub struct ImageView<'a> {
    map: &'a MapFile,
    entry: &'a ImageEntry,
}

impl<'a> ImageView<'a> {
    /// File name of the image.
    pub fn name(&self) -> &'a str {
        &self.entry.name
    }

    /// Its camera.
    pub fn camera(&self) -> &'a Intrinsics {
        &self.map.cameras[self.entry.camera]
    }

    /// Its pose.
    pub fn cam_from_world(&self) -> &'a CameraFromWorld {
        &self.entry.cam_from_world
    }

    /// `[N]`, pixels `[u, v]` in the original (distorted) image.
    pub fn keypoints(&self) -> &'a [[f32; 2]] {
        &self.map.records(&self.map.large.keypoints)[self.entry.keypoints.clone()]
    }

    /// `[N, dim]`
    pub fn descriptors(&self) -> DescriptorView<'a> {
        let kind = self.map.profile.descriptor_kind();
        let all = &self.map.bytes[self.map.large.descriptors.clone()];
        DescriptorView::new(kind, all)
            .expect("whole rows, checked when opened")
            .rows(self.entry.keypoints.clone())
    }

    /// Codes of the global descriptor.
    pub fn global(&self) -> &'a [i8] {
        &self.map.records(&self.map.large.globals)[self.entry.global.clone()]
    }

    /// The point that keypoint `keypoint` observes; the index must be below the number of keypoints.
    pub fn point_of(&self, keypoint: usize) -> Option<PointId> {
        let all: &[u32] = self.map.records(&self.map.large.keypoint_points);
        let id = all[self.entry.keypoints.clone()][keypoint];
        (id != NO_POINT).then_some(PointId(id))
    }

    /// Copies the data into a mutable model.
    pub(super) fn to_model(self) -> MapImage {
        MapImage {
            name: self.name().to_owned(),
            camera: self.entry.camera,
            cam_from_world: *self.cam_from_world(),
            keypoints: self.keypoints().to_vec(),
            descriptors: self.descriptors().to_owned(),
            global: GlobalDescriptor::new(self.global().to_vec()),
            point_of_keypoint: (0..self.keypoints().len()).map(|k| self.point_of(k)).collect(),
        }
    }
}
