//! Matches of pairs that were found by an earlier build, for whoever keeps them.

use std::fmt::Debug;

use veiloc_descriptor::{DescriptorView, Match, MatchOptions};

/// Where matches of pairs of images are kept. A build asks for each pair before it matches it, and hands over what it found;
/// several threads do so at once. What is answered is taken for what matching would find.
pub trait KeptMatches: Debug + Sync {
    /// What names the descriptors of an image: equal ones have one name, others another.
    fn name(&self, descriptors: DescriptorView<'_>) -> [u8; 32];

    /// Matches of the first image's descriptors in the second's, if they are there.
    fn get(&self, a: &[u8; 32], b: &[u8; 32], options: &MatchOptions) -> Option<Vec<Match>>;

    /// Keeps what was found. Who cannot keep it says so elsewhere: the build goes on.
    fn keep(&self, a: &[u8; 32], b: &[u8; 32], options: &MatchOptions, matches: &[Match]);
}
