//! What building a map came to, and whether to believe it.

use std::fmt;

use veiloc_map::{MapModel, SelfTest};

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
    /// Which images were matched with which, in the order of the images; empty where a map is imported, or images join one.
    pub pairs: Vec<(String, String)>,
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
        Self { images, skipped, matches, verified, pairs: Vec::new(), doubts }
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
    /// The map localizes few of its own images.
    SelfTest {
        /// Images that were localized within a twentieth of what they see, each left out of the map, under the best of
        /// the schemes.
        right: u32,
        /// Of how many.
        images: u32,
    },
    /// Matches would agree with the poses much better had what was given been wrong in this way.
    LikelyCause {
        /// In which way.
        fault: Fault,
        /// Share of matches that agree with the poses as they were given, per cent.
        agree_percent: u32,
        /// Share that would agree.
        would_percent: u32,
    },
}

/// What is often wrong with poses and cameras.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    /// Poses are camera-to-world where world-to-camera is wanted.
    CameraToWorld,
    /// The camera's y points up and its z backwards, as in OpenGL, where down and forwards are wanted.
    AxesUpAndBack,
    /// Both.
    CameraToWorldAxesUpAndBack,
    /// The focal length that was given is this many per cent of the right one.
    FocalLength {
        /// Within about a tenth.
        percent: u32,
    },
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::CameraToWorld => {
                f.write_str("the poses look camera-to-world; world-to-camera is wanted, so invert them")
            }
            Self::AxesUpAndBack => f.write_str(
                "the camera's axes look like OpenGL's (y up, z backwards); y down and z forwards are wanted, so negate \
                 the second and third row of each world-to-camera pose",
            ),
            Self::CameraToWorldAxesUpAndBack => f.write_str(
                "the poses look camera-to-world with OpenGL's axes (y up, z backwards), as NeRF data has them; negate \
                 the second and third column of each rotation, then invert the pose",
            ),
            Self::FocalLength { percent } => write!(
                f,
                "the focal length looks wrong: what was given is about {:.2} times the right one; do the cameras \
                 belong to images of this size?",
                f64::from(*percent) / 100.0
            ),
        }
    }
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

    /// The doubt about a map that localizes less than half of its own images.
    pub fn of_self_test(test: &SelfTest) -> Option<Self> {
        let right = test.schemes.iter().map(|s| s.within_of_scale[2]).max()?;
        (2 * right < test.images).then_some(Self::SelfTest { right, images: test.images })
    }

    /// Whether so few matches agree with the poses that it is worth asking why.
    pub(crate) fn is_worth_asking(matches: usize, verified: usize) -> bool {
        (verified as f64) < ASKED_BELOW * matches as f64
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
            Self::SelfTest { .. } => "self-test",
            Self::LikelyCause { fault, .. } => match fault {
                Fault::CameraToWorld => "poses-camera-to-world",
                Fault::AxesUpAndBack => "axes-up-and-back",
                Fault::CameraToWorldAxesUpAndBack => "poses-camera-to-world-axes-up-and-back",
                Fault::FocalLength { .. } => "focal-length",
            },
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
            Self::SelfTest { right, images } => {
                write!(f, "the map localizes only {right} of {images} of its own images")
            }
            Self::LikelyCause { fault, agree_percent, would_percent } => {
                return write!(
                    f,
                    "likely cause: {fault} ({agree_percent} % of matches agree with what was given, {would_percent} % \
                     would)"
                );
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
/// Share below which the cause is looked for: sound maps have 80 % and more.
const ASKED_BELOW: f64 = 0.7;
