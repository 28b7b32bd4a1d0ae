//! Attack on one image of a session: number of frames and attacked keypoints.

use crate::EvalError;
use rayon::prelude::*;
use veiloc_attacks::multi_view::{
    Frame, FramesOptions, RestingOptions, TriangulatedKeypoint, multi_view_attack_matched, resting_camera,
    select_frames_matched,
};
use veiloc_attacks::{AttackError, Observation, errors_px, prior_median, prior_only};
use veiloc_descriptor::{MatchOptions, match_descriptors};
use veiloc_geometry::Pixel;
use veiloc_obfuscation::SessionAnchors;
use veiloc_protocol::AngleBits;

use super::SessionsEvaluation;
use super::localized_frame::{LocalizedFrame, TrustedFrame};
use super::motion::Motion;

/// The attacked keypoints.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "lowercase")]
pub(super) enum AttackedKeypoints {
    /// Keypoints of a person-like region that is missing from the map; the server knows the other keypoints that it
    /// matched.
    Private,
    /// Keypoints that the map knows, with their positions withheld.
    Matched,
}

impl AttackedKeypoints {
    pub(super) const ALL: [Self; 2] = [Self::Private, Self::Matched];
}

/// The server's attack method.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub(super) enum Method {
    /// Lines of several poses, integrated over depth.
    SeveralFrames,
    /// The scatter of the angles at one pose.
    RestingCamera,
}

impl Method {
    /// Methods that apply to frames of this motion.
    pub(super) const fn of(motion: Motion) -> &'static [Self] {
        match motion {
            Motion::Turning | Motion::Walking | Motion::Visiting => &[Self::SeveralFrames],
            Motion::Resting => &[Self::SeveralFrames, Self::RestingCamera],
        }
    }
}

/// Result of an attack: errors of the attacked keypoints and of the baseline, pixels.
#[derive(Default)]
pub(super) struct AttackErrors {
    pub(super) errors: Vec<f64>,
    /// Errors of the best answer for bits.
    pub(super) prior: Vec<f64>,
    /// Errors of the best answer for errors in pixels.
    pub(super) prior_for_pixels: Vec<f64>,
    pub(super) size: (u32, u32),
}

/// Factors by which the depth limits extend the depths of the matched points.
const NEARER: f64 = 0.5;
const FARTHER: f64 = 2.0;
/// Ratio test for matches between two frames.
const RATIO: f32 = 0.9;

/// Attacks frame `own` with frames of `others`, in the order of [`super::SessionRow::of`]: by measure, method and
/// number of frames. Empty if the server does not trust the pose of `own`.
pub(super) fn attack(
    evaluation: &SessionsEvaluation,
    (anchors, motion): (SessionAnchors, Motion),
    localized: &[LocalizedFrame],
    own: usize,
    others: &[usize],
) -> Result<Vec<AttackErrors>, EvalError> {
    let methods =
        || AttackedKeypoints::ALL.into_iter().flat_map(|m| Method::of(motion).iter().map(move |by| (m, *by)));
    let Some(posed) = &localized[own].posed else {
        return Ok(methods()
            .flat_map(|_| evaluation.frames.iter().map(|_| AttackErrors::default()))
            .collect());
    };
    let others: Vec<Other<'_>> = others
        .par_iter()
        .filter_map(|i| localized[*i].posed.as_ref())
        .map(|other| Other { posed: other, matches: matches(posed, other) })
        .collect();
    let name = &localized[own].result.name;
    let codes = codes(anchors, evaluation);
    let mut all = Vec::new();
    for (measured, method) in methods() {
        let target = Target::new(posed, measured);
        let of_each = target.attack_errors(&others, motion, method, &codes, &evaluation.frames);
        all.extend(of_each.map_err(|e| EvalError::DataSet(format!("{name}: {e}")))?);
    }
    Ok(all)
}

/// Another frame, and its rows that show the keypoints of the attacked frame: `[N]`.
struct Other<'a> {
    posed: &'a TrustedFrame,
    matches: Vec<Option<usize>>,
}

/// Matches by descriptors: mutual nearest neighbours with ratio test.
fn matches(from: &TrustedFrame, to: &TrustedFrame) -> Vec<Option<usize>> {
    let options = MatchOptions::default().with_max_ratio(Some(RATIO));
    let mut matches = vec![None; from.lines.len()];
    for m in match_descriptors(from.query.descriptors(), to.query.descriptors(), &options) {
        matches[m.query as usize] = Some(m.database as usize);
    }
    matches
}

/// The attacked frame.
struct Target<'a> {
    posed: &'a TrustedFrame,
    observations: Vec<Observation>,
    attacked: Vec<bool>,
    options: FramesOptions,
}

impl<'a> Target<'a> {
    fn new(posed: &'a TrustedFrame, measured: AttackedKeypoints) -> Self {
        let known_to_server =
            |i: usize| posed.known[i].filter(|_| measured == AttackedKeypoints::Private && !posed.private[i]);
        let observations = (0..posed.lines.len())
            .map(|i| known_to_server(i).map_or(posed.lines[i], |(pixel, _)| Observation::Known(pixel)))
            .collect();
        let attacked = match measured {
            AttackedKeypoints::Private => posed.private.clone(),
            AttackedKeypoints::Matched => {
                (0..posed.lines.len()).map(|i| posed.known[i].is_some() && posed.truth[i].is_some()).collect()
            }
        };
        let depths = || posed.known.iter().flatten().map(|k| k.1);
        let (least, most) = depths().fold((f64::INFINITY, 0.0_f64), |(a, b), z| (a.min(z), b.max(z)));
        let known_points: Vec<(Pixel, f64)> = (0..posed.lines.len()).filter_map(known_to_server).collect();
        let options = FramesOptions::with_depths([NEARER * least, FARTHER * most]);
        Self {
            posed,
            observations,
            options: options.with_known_points(known_points).for_keypoints(attacked.clone()),
            attacked,
        }
    }

    fn size(&self) -> (u32, u32) {
        (self.posed.camera.width, self.posed.camera.height)
    }

    fn frame(&self) -> Frame<'_> {
        Frame { observations: &self.observations, ..self.posed.frame() }
    }

    /// Attacks with the number of frames of each row.
    fn attack_errors(
        &self,
        others: &[Other<'_>],
        motion: Motion,
        method: Method,
        codes: &RestingOptions,
        counts: &[usize],
    ) -> Result<Vec<AttackErrors>, AttackError> {
        let longest = counts.iter().copied().max().unwrap_or(2);
        let frames: Vec<Frame<'_>> = others.iter().map(|o| o.posed.frame()).collect();
        let matches: Vec<&[Option<usize>]> = others.iter().map(|o| o.matches.as_slice()).collect();
        let chosen: Vec<usize> = match motion {
            Motion::Turning | Motion::Visiting => {
                select_frames_matched(&self.frame(), &frames, &matches, longest - 1, &self.options)?
            }
            Motion::Walking | Motion::Resting => (0..others.len()).collect(),
        };
        let (width, height) = self.size();
        let prior = prior_only(&self.observations, width, height);
        let for_pixels = prior_median(&self.observations, width, height);
        counts
            .iter()
            .map(|count| {
                let chosen: Vec<&Other<'_>> = chosen.iter().take(count - 1).map(|i| &others[*i]).collect();
                let found = match method {
                    _ if chosen.is_empty() => None,
                    Method::SeveralFrames => Some(self.by_planes(&chosen)?),
                    Method::RestingCamera => Some(self.by_scatter(&chosen, codes)?),
                };
                let answer = |i: usize| {
                    found.as_ref().and_then(|f: &Vec<TriangulatedKeypoint>| f[i].pixel).unwrap_or(prior[i])
                };
                let evaluated: Vec<(usize, Pixel)> = (0..self.attacked.len())
                    .filter(|i| self.attacked[*i])
                    .filter_map(|i| Some((i, self.posed.truth[i]?)))
                    .collect();
                let truth: Vec<Pixel> = evaluated.iter().map(|j| j.1).collect();
                Ok(AttackErrors {
                    errors: errors_px(evaluated.iter().map(|j| answer(j.0)), &truth),
                    prior: errors_px(evaluated.iter().map(|j| prior[j.0]), &truth),
                    prior_for_pixels: errors_px(evaluated.iter().map(|j| for_pixels[j.0]), &truth),
                    size: (width, height),
                })
            })
            .collect()
    }

    fn by_planes(&self, chosen: &[&Other<'_>]) -> Result<Vec<TriangulatedKeypoint>, AttackError> {
        let all: Vec<Frame<'_>> =
            std::iter::once(self.frame()).chain(chosen.iter().map(|o| o.posed.frame())).collect();
        let matches: Vec<&[Option<usize>]> = chosen.iter().map(|o| o.matches.as_slice()).collect();
        multi_view_attack_matched(&all, &matches, &self.options)
    }

    fn by_scatter(
        &self,
        chosen: &[&Other<'_>],
        codes: &RestingOptions,
    ) -> Result<Vec<TriangulatedKeypoint>, AttackError> {
        let of = |o: &&Other<'_>| o.matches.iter().map(|m| m.map(|j| o.posed.lines[j])).collect();
        let others: Vec<Vec<Option<Observation>>> = chosen.iter().map(of).collect();
        resting_camera(&self.observations, &others, self.size(), codes)
    }
}

impl TrustedFrame {
    /// The frame as it was sent.
    fn frame(&self) -> Frame<'_> {
        Frame {
            camera: self.camera,
            cam_from_world: self.cam_from_world,
            observations: &self.lines,
            descriptors: &self.descriptors,
        }
    }
}

/// The attacker's model of the angle codes of a stationary camera: codes of anchors in the world are cells of the
/// session's grid, other codes are dithered.
fn codes(anchors: SessionAnchors, evaluation: &SessionsEvaluation) -> RestingOptions {
    let step = evaluation.session.step;
    let options = if anchors != SessionAnchors::Image && step > 0.0 {
        RestingOptions::of_one_image(step).without_dither()
    } else {
        RestingOptions::of_one_image(std::f64::consts::PI / f64::from(AngleBits::default().levels()))
    };
    options.with_noise(DETECTOR_PX)
}

/// Assumed detector noise from frame to frame of a stationary camera, along each axis, pixels.
const DETECTOR_PX: f64 = 0.2;
