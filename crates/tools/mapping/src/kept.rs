//! What earlier builds computed, for whoever keeps it: features of images, matches of pairs.

use std::fmt::Debug;
use std::path::Path;

use veiloc_descriptor::{DescriptorKind, DescriptorView, Descriptors, GlobalDescriptor, Match, MatchOptions};
use veiloc_protocol::ExtractionLimits;

/// What was found in one image.
#[derive(Debug, Clone, PartialEq)]
pub struct Extracted {
    /// `[N]`, pixels of the image as it was taken.
    pub keypoints: Vec<[f32; 2]>,
    /// `[N, dim]`
    pub descriptors: Descriptors,
    /// Of the whole image, where one is asked for.
    pub global: Option<GlobalDescriptor>,
}

/// Features that a build asks for: of which image, and how they are to be made.
#[derive(Debug, Clone, Copy)]
pub struct Wanted<'a> {
    /// The image's file.
    pub path: &'a Path,
    /// Width and height that its camera has; an image of another size is refused, not described.
    pub size: (u32, u32),
    /// How many, and of how large an image.
    pub limits: ExtractionLimits,
    /// The kind of descriptors.
    pub kind: DescriptorKind,
    /// Whether a global descriptor is made of the whole image.
    pub global: bool,
}

/// Where features and matches are kept. A build asks before it computes, and hands over what it computed; several threads do so
/// at once. What is answered is taken for what computing would give. Who cannot keep something says so elsewhere: the build goes
/// on.
pub trait Kept: Debug + Sync {
    /// Features of an image, if they are there.
    fn features(&self, wanted: &Wanted<'_>) -> Option<Extracted>;

    /// Keeps what was found in an image.
    fn keep_features(&self, wanted: &Wanted<'_>, found: &Extracted);

    /// What names the descriptors of an image: equal ones have one name, others another.
    fn name(&self, descriptors: DescriptorView<'_>) -> [u8; 32];

    /// Matches of the first image's descriptors in the second's, if they are there.
    fn matches(&self, a: &[u8; 32], b: &[u8; 32], options: &MatchOptions) -> Option<Vec<Match>>;

    /// Keeps what was matched.
    fn keep_matches(&self, a: &[u8; 32], b: &[u8; 32], options: &MatchOptions, matches: &[Match]);
}
