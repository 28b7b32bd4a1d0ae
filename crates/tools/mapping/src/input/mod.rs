//! Input of map building: the images, the folder of their files, and the treatment of unusable images.

pub(crate) mod bad_image;
pub(crate) mod cache;
pub(crate) mod exif;
pub(crate) mod image_names;
pub(crate) mod masks;
pub(crate) mod options;

use std::collections::BTreeSet;
use std::path::Path;

use veiloc_features::{Extractors, FeatureError, SharedGlobal};
use veiloc_map::{PosedImage, PosedImages};

use crate::error::MappingError;
use crate::input::bad_image::{BadImage, BadImages, BadReason};
use crate::input::cache::BuildCache;
use crate::input::image_names::{NameIndex, image_file};

/// Images to map: their poses, and the folder of their files.
#[derive(Debug, Clone, Copy)]
pub struct Input<'a> {
    posed: &'a PosedImages,
    folder: &'a Path,
    masks: Option<&'a Path>,
    names: Option<&'a [String]>,
    on_bad: OnBadImage,
    extractors: Option<&'a Extractors>,
    global: Option<&'a SharedGlobal>,
    cache: Option<&'a dyn BuildCache>,
    pairs: Option<&'a [(String, String)]>,
    prefix: &'a str,
    on_other_coordinate_frame: OnOtherCoordinateFrame,
}

/// Treatment of images whose poses are in another coordinate frame than the rest of the map.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum OnOtherCoordinateFrame {
    /// Nothing is changed, and the error names them with the distance.
    #[default]
    Refuse,
    /// Their poses are transformed to the coordinate frame of the map, and the report has the transform.
    Align,
    /// Coordinate frames are not compared. For places that look alike: images of another floor of a building may be localized,
    /// wrongly, on a floor that is in the map.
    Accept,
}

/// Treatment of unusable images.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum OnBadImage {
    /// Nothing is built, and all of them are named.
    #[default]
    Refuse,
    /// They are left out and named in the report. If no image remains, that is still an error.
    Skip,
}

impl<'a> Input<'a> {
    /// Uses all images of `posed`, whose names are relative to `folder`; unusable images are refused.
    pub const fn new(posed: &'a PosedImages, folder: &'a Path) -> Self {
        Self {
            posed,
            folder,
            masks: None,
            names: None,
            on_bad: OnBadImage::Refuse,
            extractors: None,
            global: None,
            cache: None,
            pairs: None,
            prefix: "",
            on_other_coordinate_frame: OnOtherCoordinateFrame::Refuse,
        }
    }

    /// Uses only the images with these names, in their order. A name may differ from the image's in its spelling
    /// ([`image_file`]).
    #[must_use]
    pub const fn with_names(self, names: &'a [String]) -> Self {
        Self { names: Some(names), ..self }
    }

    /// Sets the folder of masks ([`mask_file`](crate::mask_file)): of what is black no feature is extracted. An image without a mask,
    /// and one whose mask hides nothing, is used as a whole.
    #[must_use]
    pub const fn with_masks(self, folder: &'a Path) -> Self {
        Self { masks: Some(folder), ..self }
    }

    /// Sets the treatment of unusable images.
    #[must_use]
    pub const fn on_bad_image(self, on_bad: OnBadImage) -> Self {
        Self { on_bad, ..self }
    }

    /// Sets the extractors, instead of those in the options, or, for images added to a map, instead of the built-in
    /// ones.
    #[must_use]
    pub const fn with_extractors(self, extractors: &'a Extractors) -> Self {
        Self { extractors: Some(extractors), ..self }
    }

    /// Sets the global extractor, for images added to a map with global descriptors of whole images.
    #[must_use]
    pub const fn with_global(self, global: &'a SharedGlobal) -> Self {
        Self { global: Some(global), ..self }
    }

    /// Sets the cache of features and matches, for repeated, resumed or distributed builds
    /// ([`prepare`](crate::build::prepare)).
    #[must_use]
    pub const fn with_cache(self, cache: &'a dyn BuildCache) -> Self {
        Self { cache: Some(cache), ..self }
    }

    /// Sets the image pairs to match, by their names, instead of pairs that probably overlap; pairs with images that
    /// are not mapped are ignored.
    #[must_use]
    pub const fn with_pairs(self, pairs: &'a [(String, String)]) -> Self {
        Self { pairs: Some(pairs), ..self }
    }

    /// Sets the text before the names of images that are added to a map: two sessions may have files of the same names.
    #[must_use]
    pub const fn with_prefix(self, prefix: &'a str) -> Self {
        Self { prefix, ..self }
    }

    /// Sets the treatment of images whose poses are in another coordinate frame than the rest of the map.
    #[must_use]
    pub const fn on_other_coordinate_frame(self, on_other_coordinate_frame: OnOtherCoordinateFrame) -> Self {
        Self { on_other_coordinate_frame, ..self }
    }

    pub(crate) const fn other_coordinate_frame(&self) -> OnOtherCoordinateFrame {
        self.on_other_coordinate_frame
    }

    pub(crate) const fn prefix(&self) -> &'a str {
        self.prefix
    }

    /// Returns the given pairs as indices of these images, sorted and without duplicates.
    pub(crate) fn pairs_of(&self, images: &[&PosedImage]) -> Result<Option<Vec<(u32, u32)>>, MappingError> {
        let Some(pairs) = self.pairs else { return Ok(None) };
        let index = NameIndex::new(images.iter().map(|image| image.name.as_str()).zip(0..));
        let of = |name: &String| index.get(name);
        let known = pairs.iter().filter_map(|(a, b)| Some((of(a)?, of(b)?))).filter(|(a, b)| a != b);
        let known: BTreeSet<(u32, u32)> = known.map(|(a, b)| (a.min(b), a.max(b))).collect();
        if known.is_empty() {
            return Err(MappingError::NoPairs { given: pairs.len(), images: images.len() });
        }
        Ok(Some(known.into_iter().collect()))
    }

    pub(crate) const fn cache(&self) -> Option<&'a dyn BuildCache> {
        self.cache
    }

    pub(crate) const fn global(&self) -> Option<&'a SharedGlobal> {
        self.global
    }

    pub(crate) const fn extractors(&self) -> Option<&'a Extractors> {
        self.extractors
    }

    /// Returns all posed images, including those that are not mapped.
    pub(crate) const fn posed(&self) -> &'a PosedImages {
        self.posed
    }

    /// Finds the images and checks their files before any computation. `is_in_map` returns whether the map already has
    /// a name.
    pub(crate) fn check(&self, is_in_map: impl Fn(&str) -> bool) -> Result<CheckedImages<'a>, MappingError> {
        let named: Vec<&'a str> = self.names.map_or_else(
            || self.posed.images().iter().map(|i| i.name.as_str()).collect(),
            |names| names.iter().map(String::as_str).collect(),
        );
        let mut seen = BTreeSet::new();
        let index = NameIndex::new(self.posed.images().iter().map(|image| (image.name.as_str(), image)));
        let results = named.into_iter().map(|name| {
            let usable = self.usable(name, &index, &mut seen, &is_in_map);
            usable.map_err(|reason| BadImage { name: name.to_owned(), reason })
        });
        let (images, skipped) = split_usable(results.collect(), self.on_bad)?;
        let Self { folder, masks, on_bad, cache, .. } = *self;
        Ok(CheckedImages { images, skipped, folder, masks, on_bad, cache })
    }

    fn usable(
        &self,
        name: &'a str,
        index: &NameIndex<&'a PosedImage>,
        seen: &mut BTreeSet<&'a str>,
        is_in_map: impl Fn(&str) -> bool,
    ) -> Result<&'a PosedImage, BadReason> {
        let found = index.get(name);
        if !seen.insert(found.map_or(name, |image| &image.name)) {
            return Err(BadReason::Twice);
        }
        let image = found.ok_or(BadReason::NoPose)?;
        if is_in_map(&image.name) {
            return Err(BadReason::AlreadyInMap);
        }
        let path = image_file(self.folder, &image.name);
        match path.metadata() {
            Ok(file) if file.is_file() => Ok(image),
            Ok(_) => Err(BadReason::NoFile { path }),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Err(BadReason::NoFile { path }),
            Err(source) => Err(BadReason::Image(FeatureError::Read { path, source })),
        }
    }
}

/// Images that exist, without having been read.
#[derive(Debug)]
pub(crate) struct CheckedImages<'a> {
    pub(crate) images: Vec<&'a PosedImage>,
    /// The images that were left out.
    pub(crate) skipped: Vec<BadImage>,
    pub(crate) folder: &'a Path,
    /// The folder of their masks.
    pub(crate) masks: Option<&'a Path>,
    pub(crate) on_bad: OnBadImage,
    /// The cache of their features.
    pub(crate) cache: Option<&'a dyn BuildCache>,
}

/// Separates usable from unusable images; an error if an unusable image must not be left out, or if no image is usable.
pub(crate) fn split_usable<T>(
    results: Vec<Result<T, BadImage>>,
    on_bad: OnBadImage,
) -> Result<(Vec<T>, Vec<BadImage>), MappingError> {
    let of = results.len();
    if of == 0 {
        return Err(MappingError::EmptyList);
    }
    let (mut good, mut images) = (Vec::new(), Vec::new());
    for result in results {
        match result {
            Ok(one) => good.push(one),
            Err(bad) => images.push(bad),
        }
    }
    if good.is_empty() || (on_bad == OnBadImage::Refuse && !images.is_empty()) {
        return Err(MappingError::BadImages(BadImages { images, of }));
    }
    Ok((good, images))
}
