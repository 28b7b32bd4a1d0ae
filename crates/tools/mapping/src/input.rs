//! What is to be mapped: which images, where their files are, and what to do about those that cannot be used.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use veiloc_features::{Extractors, FeatureError, SharedGlobal};
use veiloc_map::{PosedImage, PosedImages};

use crate::bad_image::{BadImage, BadImages, BadReason};
use crate::error::MappingError;
use crate::kept::Kept;

/// Images that are to be mapped: their poses, and the folder of their files.
#[derive(Debug, Clone, Copy)]
pub struct Input<'a> {
    posed: &'a PosedImages,
    folder: &'a Path,
    names: Option<&'a [String]>,
    on_bad: OnBadImage,
    extractors: Option<&'a Extractors>,
    global: Option<&'a SharedGlobal>,
    kept: Option<&'a dyn Kept>,
    pairs: Option<&'a [(String, String)]>,
}

/// What to do when an image cannot be used.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum OnBadImage {
    /// Nothing is built, and all that are bad are named.
    #[default]
    Refuse,
    /// They are left out, and named in the report. When none is left, that is an error all the same.
    Skip,
}

impl<'a> Input<'a> {
    /// All images of `posed`, whose names are relative to `folder`; none of them may be bad.
    pub const fn new(posed: &'a PosedImages, folder: &'a Path) -> Self {
        Self {
            posed,
            folder,
            names: None,
            on_bad: OnBadImage::Refuse,
            extractors: None,
            global: None,
            kept: None,
            pairs: None,
        }
    }

    /// Only the images with these names, in their order.
    #[must_use]
    pub const fn with_names(self, names: &'a [String]) -> Self {
        Self { names: Some(names), ..self }
    }

    /// What to do about images that cannot be used.
    #[must_use]
    pub const fn on_bad_image(self, on_bad: OnBadImage) -> Self {
        Self { on_bad, ..self }
    }

    /// What makes features, where that is not what the options say, or, for images that join a map, more than the built-in
    /// extractors.
    #[must_use]
    pub const fn with_extractors(self, extractors: &'a Extractors) -> Self {
        Self { extractors: Some(extractors), ..self }
    }

    /// What makes the global descriptors of images that join a map whose own were made of whole images.
    #[must_use]
    pub const fn with_global(self, global: &'a SharedGlobal) -> Self {
        Self { global: Some(global), ..self }
    }

    /// Where features and matches are kept, for builds that are done again, go on, or are shared by many hands
    /// ([`prepare`](crate::prepare)).
    #[must_use]
    pub const fn with_kept(self, kept: &'a dyn Kept) -> Self {
        Self { kept: Some(kept), ..self }
    }

    /// Which images to match with which when a map is built, by their names, instead of those that seem to show the same; pairs of
    /// images that are not mapped do not count.
    #[must_use]
    pub const fn with_pairs(self, pairs: &'a [(String, String)]) -> Self {
        Self { pairs: Some(pairs), ..self }
    }

    /// The pairs that are given, as indices of these images, each once and in order.
    pub(crate) fn pairs_of(&self, images: &[&PosedImage]) -> Result<Option<Vec<(u32, u32)>>, MappingError> {
        let Some(pairs) = self.pairs else { return Ok(None) };
        let index: BTreeMap<&str, u32> = images.iter().map(|image| image.name.as_str()).zip(0..).collect();
        let of = |name: &String| index.get(name.as_str()).copied();
        let known = pairs.iter().filter_map(|(a, b)| Some((of(a)?, of(b)?))).filter(|(a, b)| a != b);
        let known: BTreeSet<(u32, u32)> = known.map(|(a, b)| (a.min(b), a.max(b))).collect();
        if known.is_empty() {
            return Err(MappingError::NoPairs { given: pairs.len(), images: images.len() });
        }
        Ok(Some(known.into_iter().collect()))
    }

    pub(crate) const fn kept(&self) -> Option<&'a dyn Kept> {
        self.kept
    }

    pub(crate) const fn global(&self) -> Option<&'a SharedGlobal> {
        self.global
    }

    pub(crate) const fn extractors(&self) -> Option<&'a Extractors> {
        self.extractors
    }

    /// All posed images, also those that are not to be mapped.
    pub(crate) const fn posed(&self) -> &'a PosedImages {
        self.posed
    }

    /// Finds the images and looks for their files, before any work begins. `there` says which names a map has already.
    pub(crate) fn check(&self, there: impl Fn(&str) -> bool) -> Result<Checked<'a>, MappingError> {
        let named: Vec<&'a str> = self.names.map_or_else(
            || self.posed.images().iter().map(|i| i.name.as_str()).collect(),
            |names| names.iter().map(String::as_str).collect(),
        );
        let mut seen = BTreeSet::new();
        let results = named.into_iter().map(|name| {
            let usable = self.usable(name, &mut seen, &there);
            usable.map_err(|reason| BadImage { name: name.to_owned(), reason })
        });
        let (images, skipped) = sift(results.collect(), self.on_bad)?;
        Ok(Checked { images, skipped, folder: self.folder, on_bad: self.on_bad, kept: self.kept })
    }

    fn usable(
        &self,
        name: &'a str,
        seen: &mut BTreeSet<&'a str>,
        there: impl Fn(&str) -> bool,
    ) -> Result<&'a PosedImage, BadReason> {
        if !seen.insert(name) {
            return Err(BadReason::Twice);
        }
        let image = self.posed.get(name).ok_or(BadReason::NoPose)?;
        if there(name) {
            return Err(BadReason::AlreadyInMap);
        }
        let path = self.folder.join(name);
        match path.metadata() {
            Ok(file) if file.is_file() => Ok(image),
            Ok(_) => Err(BadReason::NoFile { path }),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Err(BadReason::NoFile { path }),
            Err(source) => Err(BadReason::Image(FeatureError::Read { path, source })),
        }
    }
}

/// Images that are there, as far as one can tell without reading them.
#[derive(Debug)]
pub(crate) struct Checked<'a> {
    pub(crate) images: Vec<&'a PosedImage>,
    /// What was left out.
    pub(crate) skipped: Vec<BadImage>,
    pub(crate) folder: &'a Path,
    pub(crate) on_bad: OnBadImage,
    /// Where their features may be already.
    pub(crate) kept: Option<&'a dyn Kept>,
}

/// Parts what can be used from what cannot; an error when there is something bad that may not be left out, or nothing
/// good at all.
pub(crate) fn sift<T>(
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
