//! Result of map building, with warnings about the map.

use std::collections::BTreeMap;
use std::fmt;

use veiloc_map::{MapModel, RELATIVE, SelfTest};

use crate::calibration::SelfTestTrial;
use crate::calibration::run::MIN_ALIKE;
use crate::coordinate_frames::CoordinateFrameReport;
use crate::input::bad_image::BadImage;

/// Result of building a map, or of adding images to one.
#[derive(Debug)]
#[non_exhaustive]
pub struct BuildReport {
    /// Number of mapped images.
    pub images: usize,
    /// Images that were left out because they are unusable.
    pub skipped: Vec<BadImage>,
    /// Number of matches by descriptors.
    pub matches: usize,
    /// Number of matches that agree with the poses.
    pub verified: usize,
    /// The matched image pairs, in the order of the images; empty for an imported map and for added images.
    pub pairs: Vec<(String, String)>,
    /// Comparison of the poses with the coordinate frame of the map; `None` if there was nothing to compare.
    pub coordinate_frame: Option<CoordinateFrameReport>,
    /// Reasons why the map may be unusable; empty if none was found.
    pub warnings: Vec<MapWarning>,
}

impl BuildReport {
    pub(crate) fn of(
        model: &MapModel,
        images: usize,
        skipped: Vec<BadImage>,
        matches: usize,
        verified: usize,
    ) -> Self {
        let mut warnings = MapWarning::of_matches(matches, verified);
        warnings.extend(warnings_about(model));
        Self { images, skipped, matches, verified, pairs: Vec::new(), coordinate_frame: None, warnings }
    }
}

/// Reason why a map may be unusable although it could be built. The message has advice.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum MapWarning {
    /// Few matches agree with the poses.
    MatchesDisagree {
        /// Number of matches by descriptors.
        matches: usize,
        /// Number of matches that agree with the poses.
        verified: usize,
    },
    /// There are almost no points.
    FewPoints {
        /// Number of points.
        points: usize,
        /// Number of images.
        images: usize,
    },
    /// Most images observe almost no points.
    BlindImages {
        /// Number of such images.
        blind: usize,
        /// Number of images.
        images: usize,
    },
    /// The map localizes few of its own images.
    SelfTest {
        /// Images localized within a twentieth of their scene distance, each left out of the map, under the best
        /// scheme.
        right: u32,
        /// Number of tested images.
        images: u32,
    },
    /// The map localizes its own images, but imprecisely.
    ImpreciseSelfTest {
        /// Images localized within a hundredth of their scene distance, under the best scheme.
        precise: u32,
        /// Images localized under it.
        localized: u32,
        /// Factor of the ± of queries that the self-test found.
        sd_factor: u32,
        /// Images of one camera and folder that are worse than all others: an example, and their precise and tested ones.
        worst: Option<(String, [u32; 2])>,
    },
    /// Parts of the map look alike: queries of one fit a pose in the other.
    PlacesLookAlike {
        /// Number of test images that fit a second place.
        queries: usize,
        /// Number of test images.
        images: usize,
        /// An image each of two such places, for up to three pairs of places.
        examples: Vec<[String; 2]>,
    },
    /// Whether images are in the map's coordinate frame is not known: none of them was localized in the map without them.
    CoordinateFrameUnknown {
        /// Number of images.
        images: usize,
    },
    /// The poses of images disagree with the map, without a common transform or by a small distance.
    PosesDisagree {
        /// Number of images whose pose disagrees.
        images: usize,
        /// Number of compared images.
        of: usize,
    },
    /// Two merged maps fit loosely: their images do not confirm the transform between them.
    LooseMerge {
        /// Images of the one map that are localized in the other and agree on the transform.
        localized: usize,
        /// Distance between what the two directions make of camera centres, per cent of the distance to the scene; `None`
        /// if too few images are localized in the other direction.
        apart_percent: Option<u32>,
    },
    /// Matches would agree with the poses much better if the input had this mistake.
    LikelyCause {
        /// The mistake.
        fault: InputMistake,
        /// Share of matches that agree with the given poses, per cent.
        agree_percent: u32,
        /// Share that would agree without the mistake, per cent.
        would_percent: u32,
    },
}

/// Common mistakes in poses and cameras.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum InputMistake {
    /// Poses are camera-to-world instead of world-to-camera.
    CameraToWorld,
    /// The camera's y axis points up and its z axis backwards, as in OpenGL, instead of down and forwards.
    AxesUpAndBack,
    /// Both.
    CameraToWorldAxesUpAndBack,
    /// The components of the quaternions are in another order than they are read in.
    QuaternionOrder {
        /// Whether `w` is first, and read as the last; or the reverse.
        w_first: bool,
        /// Whether the quaternions turn the camera into the world; or the reverse.
        to_world: bool,
    },
    /// The given focal length is this many per cent of the correct one.
    FocalLength {
        /// Within about a tenth.
        percent: u32,
    },
}

impl fmt::Display for InputMistake {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::CameraToWorld => f.write_str(
                "the poses seem to be camera-to-world; world-to-camera is expected, so invert \
                 them",
            ),
            Self::AxesUpAndBack => f.write_str(
                "the camera's axes seem to be OpenGL's (y up, z backwards); y down and z forwards are \
                 expected, so negate the second and third row of each world-to-camera pose",
            ),
            Self::CameraToWorldAxesUpAndBack => f.write_str(
                "the poses seem to be camera-to-world with OpenGL's axes (y up, z backwards), as in NeRF \
                 data; negate the second and third column of each rotation, then invert the pose",
            ),
            Self::QuaternionOrder { w_first, .. } => {
                let (written, expected) =
                    if *w_first { ("w x y z", "x y z w") } else { ("x y z w", "w x y z") };
                write!(f, "the quaternions seem to be written as {written}; {expected} is expected")
            }
            Self::FocalLength { percent } => write!(
                f,
                "the focal length seems to be wrong: the given one is about {:.2} times the correct one; \
                 check that the cameras belong to images of this size",
                f64::from(*percent) / 100.0
            ),
        }
    }
}

impl MapWarning {
    /// Returns the warnings for the number of points and the number of points that each image observes.
    pub fn of_counts(points: usize, seen_by_image: &[usize]) -> Vec<Self> {
        let images = seen_by_image.len();
        let mut warnings = Vec::new();
        if images > 0 && points < MIN_POINTS {
            warnings.push(Self::FewPoints { points, images });
        }
        let blind = seen_by_image.iter().filter(|seen| **seen < MIN_SEEN).count();
        if 2 * blind > images {
            warnings.push(Self::BlindImages { blind, images });
        }
        warnings
    }

    /// Returns the warning for a map that localizes less than half of its own images.
    pub fn of_self_test(test: &SelfTest) -> Option<Self> {
        let right = test.schemes.iter().map(|s| s.within_of_scale[2]).max()?;
        (2 * right < test.images).then_some(Self::SelfTest { right, images: test.images })
    }

    /// Returns the warning for a map that localizes its own images imprecisely: some of its poses or cameras are wrong.
    pub fn of_precision(test: &SelfTest) -> Option<Self> {
        let best = test.schemes.iter().max_by_key(|scheme| scheme.within_of_scale[1])?;
        let (precise, localized) = (best.within_of_scale[1], best.localized);
        let sd_factor = best.calibration.factor.sqrt().round() as u32;
        let is_judged = localized >= MIN_JUDGED && 2 * localized >= test.images;
        let is_bad = 2 * precise < localized || sd_factor >= MAX_SD_FACTOR;
        (is_judged && is_bad).then_some(Self::ImpreciseSelfTest {
            precise,
            localized,
            sd_factor,
            worst: None,
        })
    }

    /// Names the images of one camera and folder whose precise share is less than half of that of all others.
    pub(crate) fn with_worst(
        self,
        model: &MapModel,
        images: &[usize],
        trials: &[Vec<Option<SelfTestTrial>>],
        scale: f64,
    ) -> Self {
        let Self::ImpreciseSelfTest { precise, localized, sd_factor, .. } = self else { return self };
        let (share, degrees) = RELATIVE[1];
        let is_precise = |of: &Vec<Option<SelfTestTrial>>| {
            of.iter().flatten().any(|t| t.translation() <= share * scale && t.rotation_deg() <= degrees)
        };
        let mut groups: BTreeMap<(usize, &str), (&str, [u32; 2])> = BTreeMap::new();
        for (&image, of) in images.iter().zip(trials) {
            let image = &model.images[image];
            let folder = image.name.rfind('/').map_or("", |end| &image.name[..end]);
            let (_, counts) = groups.entry((image.camera, folder)).or_insert((&image.name, [0; 2]));
            counts[0] += u32::from(is_precise(of));
            counts[1] += 1;
        }
        let all = groups.values().fold([0; 2], |all, (_, of)| [all[0] + of[0], all[1] + of[1]]);
        let ratio = |[precise, tested]: [u32; 2]| f64::from(precise) / f64::from(tested.max(1));
        let worst = groups.values().min_by(|a, b| ratio(a.1).total_cmp(&ratio(b.1))).filter(|(_, of)| {
            let others = [all[0] - of[0], all[1] - of[1]];
            of[1] >= MIN_GROUP && others[1] >= MIN_GROUP && 2.0 * ratio(*of) < ratio(others)
        });
        let worst = worst.map(|(name, of)| ((*name).to_owned(), *of));
        Self::ImpreciseSelfTest { precise, localized, sd_factor, worst }
    }

    /// Returns the warning for a map of which parts look alike. `images` are the tested images, with their trials under
    /// each scheme. `None` if fewer than two of them fit a second place.
    pub fn of_trials(
        model: &MapModel,
        images: &[usize],
        trials: &[Vec<Option<SelfTestTrial>>],
    ) -> Option<Self> {
        let alike =
            |of_image: &Vec<Option<SelfTestTrial>>| of_image.iter().flatten().find_map(|t| t.looks_like);
        let pairs: Vec<[usize; 2]> =
            images.iter().zip(trials).filter_map(|(image, of)| Some([*image, alike(of)?])).collect();
        let name = |image: usize| model.images[image].name.clone();
        let step = pairs.len().div_ceil(MAX_EXAMPLES).max(1);
        (pairs.len() >= MIN_ALIKE).then(|| Self::PlacesLookAlike {
            queries: pairs.len(),
            images: images.len(),
            examples: pairs.iter().step_by(step).map(|pair| pair.map(name)).collect(),
        })
    }

    /// Returns the warnings that follow from a comparison of poses with the coordinate frame of a map.
    pub(crate) fn of_frame(report: &CoordinateFrameReport) -> Vec<Self> {
        let unknown =
            (report.localized == 0).then_some(Self::CoordinateFrameUnknown { images: report.tested });
        let images = report.disagreeing.len() + report.near.len();
        let disagree = (images > 0).then_some(Self::PosesDisagree { images, of: report.localized });
        unknown.into_iter().chain(disagree).collect()
    }

    /// Returns the warning for two merged maps, by the distance there and back and the distance to the scene.
    pub(crate) fn of_merge(localized: usize, closure: Option<f64>, scale: f64) -> Option<Self> {
        let apart = closure.map(|closure| closure / scale);
        let is_tight = apart.is_some_and(|apart| apart <= MAX_APART);
        let percent = |apart: f64| (100.0 * apart).round() as u32;
        (!is_tight).then(|| Self::LooseMerge { localized, apart_percent: apart.map(percent) })
    }

    /// Returns whether so few matches agree with the poses that a diagnosis is useful.
    pub(crate) fn needs_diagnosis(matches: usize, verified: usize) -> bool {
        (verified as f64) < DIAGNOSE_BELOW * matches as f64
    }

    fn of_matches(matches: usize, verified: usize) -> Vec<Self> {
        let disagree = matches >= MIN_MATCHES && (verified as f64) < MIN_AGREEING * matches as f64;
        disagree.then_some(Self::MatchesDisagree { matches, verified }).into_iter().collect()
    }

    /// Short name for programs.
    pub const fn name(&self) -> &'static str {
        match self {
            Self::MatchesDisagree { .. } => "matches-disagree",
            Self::FewPoints { .. } => "few-points",
            Self::BlindImages { .. } => "blind-images",
            Self::SelfTest { .. } => "self-test",
            Self::ImpreciseSelfTest { .. } => "imprecise-self-test",
            Self::PlacesLookAlike { .. } => "places-look-alike",
            Self::CoordinateFrameUnknown { .. } => "coordinate-frame-unknown",
            Self::PosesDisagree { .. } => "poses-disagree",
            Self::LooseMerge { .. } => "loose-merge",
            Self::LikelyCause { fault, .. } => match fault {
                InputMistake::CameraToWorld => "poses-camera-to-world",
                InputMistake::AxesUpAndBack => "axes-up-and-back",
                InputMistake::CameraToWorldAxesUpAndBack => "poses-camera-to-world-axes-up-and-back",
                InputMistake::QuaternionOrder { .. } => "quaternion-order",
                InputMistake::FocalLength { .. } => "focal-length",
            },
        }
    }
}

impl fmt::Display for MapWarning {
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
                write!(f, "{blind} of {images} images observe fewer than {MIN_SEEN} points each")
            }
            Self::SelfTest { right, images } => {
                write!(f, "the map localizes only {right} of {images} of its own images")
            }
            Self::ImpreciseSelfTest { precise, localized, sd_factor, worst } => {
                write!(
                    f,
                    "the map localizes its own images imprecisely: {precise} of {localized} within a hundredth of the distance \
                     to the scene, and the ± of queries is {sd_factor} times as large"
                )?;
                if let Some((example, [precise, tested])) = worst {
                    write!(
                        f,
                        "; worst are the images of the camera and folder of {example}: {precise} of {tested}"
                    )?;
                }
                return f.write_str(
                    ". Some poses, cameras or names are wrong: check that images with other zooms or sizes have other \
                     cameras, and that each image has its own pose",
                );
            }
            Self::PlacesLookAlike { queries, images, examples } => {
                let pairs = examples.iter().map(|[a, b]| format!("{a} and {b}")).collect::<Vec<_>>();
                return write!(
                    f,
                    "parts of the map look alike: {queries} of {images} test images fit a pose in another part too \
                     ({}); queries there are doubtful. Remove images that are in the map twice; where two places really \
                     look alike, map what differs between them",
                    pairs.join("; ")
                );
            }
            Self::CoordinateFrameUnknown { images } => {
                return write!(
                    f,
                    "whether the poses of {images} images are in the coordinate frame of the map could not be checked: \
                     none of these images was localized in the map without them"
                );
            }
            Self::PosesDisagree { images, of } => {
                return write!(
                    f,
                    "the poses of {images} of {of} compared images disagree with the map (it localizes them \
                     with other poses, without a common transform or only a little away); queries near them may be wrong"
                );
            }
            Self::LooseMerge { localized, apart_percent } => {
                write!(f, "the two maps fit loosely: {localized} images agree on the transform, ")?;
                match apart_percent {
                    Some(percent) => write!(
                        f,
                        "and in the other direction it differs by {percent} % of the distance to the scene"
                    )?,
                    None => f.write_str("and too few are localized in the other direction to confirm it")?,
                }
                return f.write_str(
                    "; the ± of poses does not include this error. Add images of the common part to one of them, \
                     and merge again",
                );
            }
            Self::LikelyCause { fault, agree_percent, would_percent } => {
                return write!(
                    f,
                    "likely cause: {fault} ({agree_percent} % of matches agree with the given poses and \
                     cameras, {would_percent} % would after the fix)"
                );
            }
        }?;
        f.write_str(
            "; most queries will fail. Check that the poses are world-to-camera, that the focal lengths \
             are correct, and that the images overlap, from different positions",
        )
    }
}

/// Returns the warnings for a map.
pub(crate) fn warnings_about(model: &MapModel) -> Vec<MapWarning> {
    let seen = model.images.iter().map(|i| i.point_of_keypoint.iter().flatten().count());
    MapWarning::of_counts(model.points.len(), &seen.collect::<Vec<_>>())
}

/// Fewest localized images of which a share says something, and of a camera and folder.
const MIN_JUDGED: u32 = 8;
const MIN_GROUP: u32 = 3;
/// Factor of the ± from which on the covariances do not describe the errors. Those of seven places are 1 to 4.
const MAX_SD_FACTOR: u32 = 8;
/// Maximum number of named pairs of places that look alike.
const MAX_EXAMPLES: usize = 3;
/// With fewer points a pose cannot be distinguished from chance: a query needs a few dozen correct matches, and finds a
/// part of the points.
const MIN_POINTS: usize = 100;
/// An image with fewer points hardly helps to localize a nearby query.
const MIN_SEEN: usize = 10;
/// With fewer matches there is no conclusion about the poses.
const MIN_MATCHES: usize = 100;
/// Share of matches that agree with the poses, below which the poses are questioned: 88 % in a part of RedKitchen, 12 %
/// with its focal length doubled.
const MIN_AGREEING: f64 = 0.25;
/// Distance there and back of two maps that fit, relative to the distance to the scene: 0.5 % and less in merged halves of
/// RedKitchen and Herz-Jesu, which fit to 5 mm, and 11 % in those of hololens-office, which fit to 7 cm.
const MAX_APART: f64 = 0.02;
/// Share below which the cause is searched: correct maps have 80 % and more.
const DIAGNOSE_BELOW: f64 = 0.7;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn loosely_merged_maps_have_a_warning() {
        assert_eq!(MapWarning::of_merge(40, Some(0.01), 2.0), None);
        let loose = MapWarning::of_merge(6, Some(0.3), 2.5).expect("a warning");
        assert_eq!(loose, MapWarning::LooseMerge { localized: 6, apart_percent: Some(12) });
        assert!(loose.to_string().contains("by 12 % of the distance to the scene"), "{loose}");
        let unconfirmed = MapWarning::of_merge(3, None, 2.5).expect("a warning");
        assert!(
            unconfirmed.to_string().contains("too few are localized in the other direction"),
            "{unconfirmed}"
        );
    }
}
