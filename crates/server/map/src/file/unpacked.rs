//! Opens a packed map: the small sections as in any map, and the packed section.

use veiloc_descriptor::{Descriptors, GlobalDescriptor};

use super::layout::{ImageRecord, Section};
use super::open::{Parser, Sections};
use super::view::ImageEntry;
use super::{compressed, packed};
use crate::error::MapError;
use crate::model::{MapImage, MapModel};

impl Parser<'_> {
    /// The map of a packed file.
    pub(super) fn unpacked(&self, sections: &Sections) -> Result<MapModel, MapError> {
        let range = |section: Section| sections[section as usize - 1].clone().unwrap_or_default();
        let wrong = |reason: String| self.wrong(Section::Packed.name(), &reason);
        if Section::ALL.into_iter().any(|s| s.is_packed() && !range(s).is_empty()) {
            return Err(wrong("duplicates other sections".to_owned()));
        }
        let bytes = &self.bytes[range(Section::Packed)];
        let profile = self.profile(sections)?;
        let settings = self.settings(sections)?;
        let cameras = self.cameras(self.records(&range(Section::Cameras), Section::Cameras)?)?;
        let keypoints = packed::keypoint_count(bytes).map_err(wrong)?;
        let records: &[ImageRecord] = self.records(&range(Section::Images), Section::Images)?;
        let entries = self.images(records, self.names(sections)?, keypoints, &cameras, 0)?;
        let kind = profile.descriptor_kind();
        let bare = |entry: ImageEntry| {
            let image = MapImage {
                name: entry.name,
                camera: entry.camera,
                cam_from_world: entry.cam_from_world,
                keypoints: Vec::new(),
                descriptors: Descriptors::empty(kind),
                global: GlobalDescriptor::new(Vec::new()),
                point_of_keypoint: Vec::new(),
            };
            (image, entry.keypoints.len())
        };
        let model = MapModel {
            cameras,
            self_test: self.self_test(sections)?,
            down: self.down(sections)?,
            is_metric: self.is_metric(sections)?,
            alignment: self.alignment(sections)?,
            region: self.region(sections, entries.len(), true)?,
            ..MapModel::empty(profile, settings)
        };
        let images = entries.into_iter().map(bare).collect();
        let unpacked = packed::decode(bytes, &model, images).map_err(wrong)?;
        let compressed = compressed::decode_packed(
            &self.bytes[range(Section::Compressed)],
            unpacked.of_points,
            unpacked.origin,
        )
        .map_err(|e| self.wrong(Section::Compressed.name(), &e))?;
        Ok(MapModel {
            images: unpacked.images,
            points: unpacked.points,
            compressed: Some(compressed),
            ..model
        })
    }
}
