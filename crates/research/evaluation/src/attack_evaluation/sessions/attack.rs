//! Attack on one image of a session: number of frames and attacked keypoints.

use std::collections::BTreeMap;

use rayon::prelude::*;
use veiloc_attacks::multi_view::{
    Frame, FramesOptions, StaticCameraOptions, TriangulatedKeypoint, multi_view_attack_matched,
    select_frames_matched, static_camera,
};
use veiloc_attacks::{AttackError, Observation, errors_px, prior_median, prior_only};
use veiloc_descriptor::{MatchOptions, match_descriptors};
use veiloc_geometry::Pixel;
use veiloc_obfuscation::SessionAnchors;
use veiloc_protocol::{AngleBits, Candidate, QueryContent};

use super::super::inliers::depth_limits;
use super::Sessions;
use super::document::SessionRow;
use super::localized_frame::{LocalizedFrame, TrustedFrame};
use super::motion::Motion;
use crate::EvalError;

/// The attacked keypoints.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "lowercase")]
pub enum AttackedKeypoints {
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
pub enum Method {
    /// Lines of several poses, integrated over depth.
    SeveralFrames,
    /// The scatter of the angles at one pose.
    StaticCamera,
}

impl Method {
    /// Methods that apply to frames of this motion.
    pub(super) const fn of(motion: Motion) -> &'static [Self] {
        match motion {
            Motion::Turning | Motion::Walking | Motion::Visiting => &[Self::SeveralFrames],
            Motion::Static => &[Self::SeveralFrames, Self::StaticCamera],
        }
    }
}

/// Ratio test for matches between two frames.
const RATIO: f32 = 0.9;

impl Sessions<'_> {
    /// Attacks an image with frames of this motion, and adds the errors to these rows; an image whose pose the server
    /// does not trust adds nothing. `index`: of the attacked images.
    pub(super) fn attack(
        &self,
        motion: Motion,
        index: usize,
        rows: &mut [SessionRow],
    ) -> Result<(), EvalError> {
        let recording = self.recording;
        let own = recording.attacked[index];
        let still;
        let (frames, own, others): (&[LocalizedFrame], usize, Vec<usize>) = match motion {
            Motion::Turning | Motion::Walking => (&self.frames, own, recording.others(own, motion)),
            Motion::Visiting => (&self.visits, own, recording.others(own, motion)),
            Motion::Static => {
                let shown = &recording.static_frames[index];
                let sealed = recording.seal(shown, &self.condition).frames;
                still = recording.localize(&sealed, shown, self.condition.scheme);
                (&still, 0, (1..still.len()).collect())
            }
        };
        let Some(posed) = &frames[own].posed else { return Ok(()) };
        let others: Vec<Other<'_>> = others
            .par_iter()
            .filter_map(|i| frames[*i].posed.as_ref())
            .map(|other| Other { posed: other, matches: matches(posed, other) })
            .collect();
        let name = &frames[own].result.name;
        let attacked = self.attack_frame(motion, posed, &others, rows);
        attacked.map_err(|e| EvalError::DataSet(format!("{name}: {e}")))
    }

    fn attack_frame(
        &self,
        motion: Motion,
        posed: &TrustedFrame,
        others: &[Other<'_>],
        rows: &mut [SessionRow],
    ) -> Result<(), AttackError> {
        let evaluation = self.recording.evaluation;
        let codes = codes(self.condition.anchors, evaluation.session.step);
        for rows in rows.chunk_by_mut(|a, b| a.target == b.target) {
            let target = Target::new(posed, rows[0].target);
            let chosen = target.chosen(others, motion, evaluation.longest() - 1)?;
            for row in rows {
                let chosen = &chosen[..chosen.len().min(row.frames - 1)];
                let found = match row.method {
                    _ if chosen.is_empty() => None,
                    Method::SeveralFrames => Some(target.by_planes(chosen)?),
                    Method::StaticCamera => Some(target.by_scatter(chosen, &codes)?),
                };
                target.add_errors(found.as_deref(), row);
            }
        }
        Ok(())
    }
}

/// Another frame, and its rows that show the keypoints of the attacked frame: `[N]`.
struct Other<'a> {
    posed: &'a TrustedFrame,
    matches: Vec<Option<usize>>,
}

/// Matches by descriptors: mutual nearest neighbours with ratio test. Of match queries, rows of one point; of several with
/// one point those that are most probable.
fn matches(from: &TrustedFrame, to: &TrustedFrame) -> Vec<Option<usize>> {
    let options = MatchOptions::default().with_max_ratio(Some(RATIO));
    let mut matches = vec![None; from.lines.len()];
    if let (QueryContent::Matched { matches: own, .. }, QueryContent::Matched { matches: other, .. }) =
        (from.query.content(), to.query.content())
    {
        let [own, other] = [own, other].map(|matches| {
            let mut rows: Vec<(usize, Candidate)> = matches.rows().iter().copied().enumerate().collect();
            rows.sort_by_key(|(_, candidate)| candidate.weight);
            rows.into_iter().map(|(row, candidate)| (candidate.point, row)).collect::<BTreeMap<u32, usize>>()
        });
        for (point, row) in own {
            matches[row] = other.get(&point).copied();
        }
        return matches;
    }
    let (Some(own), Some(other)) = (from.query.descriptors(), to.query.descriptors()) else { return matches };
    for m in match_descriptors(own, other, &options) {
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
    /// The best answers without an attack, for bits and for errors in pixels.
    prior: Vec<Pixel>,
    prior_for_pixels: Vec<Pixel>,
}

impl<'a> Target<'a> {
    fn new(posed: &'a TrustedFrame, measured: AttackedKeypoints) -> Self {
        let known_to_server =
            |i: usize| posed.known[i].filter(|_| measured == AttackedKeypoints::Private && !posed.private[i]);
        let observations: Vec<Observation> = (0..posed.lines.len())
            .map(|i| known_to_server(i).map_or(posed.lines[i], |(pixel, _)| Observation::Known(pixel)))
            .collect();
        let attacked = match measured {
            AttackedKeypoints::Private => posed.private.clone(),
            AttackedKeypoints::Matched => {
                (0..posed.lines.len()).map(|i| posed.known[i].is_some() && posed.truth[i].is_some()).collect()
            }
        };
        let depths = depth_limits(posed.known.iter().flatten().map(|k| k.1));
        let known_points: Vec<(Pixel, f64)> = (0..posed.lines.len()).filter_map(known_to_server).collect();
        let options = FramesOptions::with_depths(depths.unwrap_or([f64::INFINITY, 0.0]));
        let (width, height) = (posed.camera.width, posed.camera.height);
        Self {
            posed,
            prior: prior_only(&observations, width, height),
            prior_for_pixels: prior_median(&observations, width, height),
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

    /// At most `count` other frames, in the order of their use.
    fn chosen<'o>(
        &self,
        others: &'o [Other<'o>],
        motion: Motion,
        count: usize,
    ) -> Result<Vec<&'o Other<'o>>, AttackError> {
        if matches!(motion, Motion::Walking | Motion::Static) {
            return Ok(others.iter().collect());
        }
        let frames: Vec<Frame<'_>> = others.iter().map(|o| o.posed.frame()).collect();
        let matches: Vec<&[Option<usize>]> = others.iter().map(|o| o.matches.as_slice()).collect();
        let chosen = select_frames_matched(&self.frame(), &frames, &matches, count, &self.options)?;
        Ok(chosen.into_iter().map(|i| &others[i]).collect())
    }

    /// Adds the errors on the attacked keypoints; without an answer that of the baseline.
    fn add_errors(&self, found: Option<&[TriangulatedKeypoint]>, row: &mut SessionRow) {
        let attacked = (0..self.attacked.len()).filter(|i| self.attacked[*i]);
        let (rows, truth): (Vec<usize>, Vec<Pixel>) =
            attacked.filter_map(|i| Some((i, self.posed.truth[i]?))).unzip();
        let answer = |i: &usize| found.and_then(|found| found[*i].pixel).unwrap_or(self.prior[*i]);
        let errors = errors_px(rows.iter().map(answer), &truth);
        let [bits, pixels] = [&self.prior, &self.prior_for_pixels]
            .map(|prior| errors_px(rows.iter().map(|i| prior[*i]), &truth));
        row.add(&errors, [&bits, &pixels], self.size());
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
        codes: &StaticCameraOptions,
    ) -> Result<Vec<TriangulatedKeypoint>, AttackError> {
        let of = |o: &&Other<'_>| o.matches.iter().map(|m| m.map(|j| o.posed.lines[j])).collect();
        let others: Vec<Vec<Option<Observation>>> = chosen.iter().map(of).collect();
        static_camera(&self.observations, &others, self.size(), codes)
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
fn codes(anchors: SessionAnchors, step: f64) -> StaticCameraOptions {
    let options = if anchors != SessionAnchors::Image && step > 0.0 {
        StaticCameraOptions::of_one_image(step).without_dither()
    } else {
        StaticCameraOptions::of_one_image(std::f64::consts::PI / f64::from(AngleBits::default().levels()))
    };
    options.with_noise(DETECTOR_PX)
}

/// Assumed detector noise from frame to frame of a stationary camera, along each axis, pixels.
const DETECTOR_PX: f64 = 0.2;
