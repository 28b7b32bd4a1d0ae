//! What building a map came to, and whether to believe it.

use std::fmt;

use veiloc_map::MapModel;

use crate::bad_image::BadImage;

/// What building a map, or adding to one, came to.
#[derive(Debug)]
#[non_exhaustive]
pub struct BuildReport {
    /// Images that were mapped.
    pub images: usize,
    /// Images that were left out because they cannot be used.
    pub skipped: Vec<BadImage>,
    /// Matches by descriptors.
    pub matches: usize,
    /// Those that agree with the poses.
    pub verified: usize,
    /// Why the map may be good for nothing; empty for a map that looks sound.
    pub doubts: Vec<Doubt>,
}

impl BuildReport {
    pub(crate) fn of(
        model: &MapModel,
        images: usize,
        skipped: Vec<BadImage>,
        matches: usize,
        verified: usize,
    ) -> Self {
        let mut doubts = Doubt::of_matches(matches, verified);
        doubts.extend(doubts_about(model));
        Self { images, skipped, matches, verified, doubts }
    }
}

/// Why a map may be good for nothing although it could be built. Printed, it says what to look for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Doubt {
    /// Few matches agree with the poses.
    MatchesDisagree {
        /// Matches by descriptors.
        matches: usize,
        /// Those that agree with the poses.
        verified: usize,
    },
    /// There are hardly any points.
    FewPoints {
        /// How many.
        points: usize,
        /// Of how many images.
        images: usize,
    },
    /// Most images see hardly any points.
    BlindImages {
        /// How many images.
        blind: usize,
        /// Of how many.
        images: usize,
    },
}

impl Doubt {
    /// Doubts about a map with so many points, of which its images see so many each.
    pub fn of_counts(points: usize, seen_by_image: &[usize]) -> Vec<Self> {
        let images = seen_by_image.len();
        let mut doubts = Vec::new();
        if images > 0 && points < MIN_POINTS {
            doubts.push(Self::FewPoints { points, images });
        }
        let blind = seen_by_image.iter().filter(|seen| **seen < MIN_SEEN).count();
        if 2 * blind > images {
            doubts.push(Self::BlindImages { blind, images });
        }
        doubts
    }

    fn of_matches(matches: usize, verified: usize) -> Vec<Self> {
        let disagree = matches >= MIN_MATCHES && (verified as f64) < MIN_AGREEING * matches as f64;
        disagree.then_some(Self::MatchesDisagree { matches, verified }).into_iter().collect()
    }

    /// A short name for programs.
    pub const fn name(&self) -> &'static str {
        match self {
            Self::MatchesDisagree { .. } => "matches-disagree",
            Self::FewPoints { .. } => "few-points",
            Self::BlindImages { .. } => "blind-images",
        }
    }
}

impl fmt::Display for Doubt {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::MatchesDisagree { matches, verified } => write!(
                f,
                "only {verified} of {matches} matches agree with the poses ({:.0} %)",
                100.0 * *verified as f64 / (*matches).max(1) as f64
            ),
            Self::FewPoints { points, images } => {
                write!(f, "the map has only {points} points, of {images} images")
            }
            Self::BlindImages { blind, images } => {
                write!(f, "{blind} of {images} images see fewer than {MIN_SEEN} points each")
            }
        }?;
        f.write_str(
            "; queries will hardly be localized. Are the poses world-to-camera, are the focal lengths right, and do \
             the images overlap, from different places?",
        )
    }
}

/// Doubts about a map as it is.
pub(crate) fn doubts_about(model: &MapModel) -> Vec<Doubt> {
    let seen = model.images.iter().map(|i| i.point_of_keypoint.iter().flatten().count());
    Doubt::of_counts(model.points.len(), &seen.collect::<Vec<_>>())
}

/// A map of fewer points cannot be told from chance: a query takes a few dozen right matches, and finds a part.
const MIN_POINTS: usize = 100;
/// An image that sees fewer points hardly helps a query taken beside it.
const MIN_SEEN: usize = 10;
/// Fewer matches say nothing about the poses.
const MIN_MATCHES: usize = 100;
/// Share of matches that agree with the poses, below which the poses are doubted: 88 % in a part of RedKitchen, 12 % with
/// its focal length doubled.
const MIN_AGREEING: f64 = 0.25;
