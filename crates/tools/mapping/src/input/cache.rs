//! Interface of a build cache: features of images, matches of pairs.

use std::fmt::Debug;
use std::path::Path;

use veiloc_descriptor::{DescriptorKind, DescriptorView, Descriptors, GlobalDescriptor, Match, MatchOptions};
use veiloc_protocol::ExtractionLimits;

/// Features of one image.
#[derive(Debug, Clone, PartialEq)]
pub struct ExtractedFeatures {
    /// `[N]`, pixels of the stored image.
    pub keypoints: Vec<[f32; 2]>,
    /// `[N, dim]`
    pub descriptors: Descriptors,
    /// Of the whole image, if requested.
    pub global: Option<GlobalDescriptor>,
}

/// A request for features: the image, and the extraction parameters.
#[derive(Debug, Clone, Copy)]
pub struct FeatureRequest<'a> {
    /// The image's file.
    pub path: &'a Path,
    /// The file of its mask, if there is one.
    pub mask: Option<&'a Path>,
    /// Width and height of its camera; an image of another size is refused.
    pub size: (u32, u32),
    /// Limits on keypoints and image size.
    pub limits: ExtractionLimits,
    /// The kind of descriptors.
    pub kind: DescriptorKind,
    /// Whether a global descriptor of the whole image is computed.
    pub global: bool,
}

/// A cache of features and matches. A build looks up before it computes, and stores what it computed, from several
/// threads at once. A cached result must equal the computed one. Write errors are reported separately: the build
/// continues.
pub trait BuildCache: Debug + Sync {
    /// Looks up the features of an image.
    fn features(&self, request: &FeatureRequest<'_>) -> Option<ExtractedFeatures>;

    /// Stores the features of an image.
    fn store_features(&self, request: &FeatureRequest<'_>, found: &ExtractedFeatures);

    /// Returns the cache key of an image's descriptors: equal descriptors have equal keys, different ones different
    /// keys.
    fn key(&self, descriptors: DescriptorView<'_>) -> [u8; 32];

    /// Looks up the matches of the first image's descriptors in the second's.
    fn matches(&self, a: &[u8; 32], b: &[u8; 32], options: &MatchOptions) -> Option<Vec<Match>>;

    /// Stores matches.
    fn store_matches(&self, a: &[u8; 32], b: &[u8; 32], options: &MatchOptions, matches: &[Match]);
}
