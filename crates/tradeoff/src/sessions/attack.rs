//! The attack on one image of a session: with how many frames, on which of its keypoints.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use veiloc_attacks::{AttackError, Observation, errors_px, mutual_matches, prior_only};
use veiloc_audit::person;
use veiloc_datasets::seed_for;
use veiloc_eval::EvalError;
use veiloc_geometry::Pixel;
use veiloc_obfuscation::SessionAnchors;
use veiloc_query::AngleBits;
use veiloc_sightings::{
    Frame, FramesOptions, RestingOptions, Sighted, most_telling, resting_camera, several_frames,
};

use super::SessionsEvaluation;
use super::motion::Motion;
use super::seen::{Posed, Seen};

/// Whose positions are asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Measured {
    /// Those of a region like a person, of which the map knows nothing; the server knows the others that it matched.
    Private,
    /// Those that the map knows, as if it did not.
    Matched,
}

impl Measured {
    pub(super) const ALL: [Self; 2] = [Self::Private, Self::Matched];
}

/// What the server tries.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Method {
    /// Lines of several poses, integrated over depth.
    SeveralFrames,
    /// The scatter of the angles of one pose.
    RestingCamera,
}

impl Method {
    /// Those that make sense of frames of this motion.
    pub(super) const fn of(motion: Motion) -> &'static [Self] {
        match motion {
            Motion::Turning | Motion::Walking => &[Self::SeveralFrames],
            Motion::Resting => &[Self::SeveralFrames, Self::RestingCamera],
        }
    }
}

/// One attack over: errors of the keypoints asked for and of the guess, pixels.
#[derive(Default)]
pub(super) struct Attacked {
    pub(super) errors: Vec<f64>,
    pub(super) guess: Vec<f64>,
    pub(super) size: (u32, u32),
}

/// Shares by which nearer and farther depths than those of the matched points are allowed.
const NEARER: f64 = 0.5;
const FARTHER: f64 = 2.0;
/// Ratio of descriptor distances by which rows of frames at rest are matched.
const RATIO: f64 = 0.9;

/// Attacks frame `own` with frames of `others`, in the order of [`super::SessionRow::of`]: by measure, method and number
/// of frames. Empty where the server does not trust its pose.
pub(super) fn attack(
    evaluation: &SessionsEvaluation,
    (anchors, motion): (SessionAnchors, Motion),
    seen: &[Seen],
    own: usize,
    others: &[usize],
) -> Result<Vec<Attacked>, EvalError> {
    let mut all = Vec::new();
    for measured in Measured::ALL {
        for method in Method::of(motion) {
            let of_each = match &seen[own].posed {
                Some(posed) => {
                    let others: Vec<&Posed> = others.iter().filter_map(|i| seen[*i].posed.as_ref()).collect();
                    let name = &seen[own].result.name;
                    let target = Target::new(evaluation, name, posed, measured);
                    target
                        .attacked(&others, motion, *method, &codes(anchors, evaluation), &evaluation.frames)
                        .map_err(|e| EvalError::DataSet(format!("{name}: {e}")))?
                }
                None => evaluation.frames.iter().map(|_| Attacked::default()).collect(),
            };
            all.extend(of_each);
        }
    }
    Ok(all)
}

/// The attacked frame.
struct Target<'a> {
    posed: &'a Posed,
    observations: Vec<Observation>,
    asked: Vec<bool>,
    options: FramesOptions,
}

impl<'a> Target<'a> {
    fn new(evaluation: &SessionsEvaluation, name: &str, posed: &'a Posed, measured: Measured) -> Self {
        let real: Vec<usize> = (0..posed.truth.len()).filter(|i| posed.truth[*i].is_some()).collect();
        let pixels: Vec<Pixel> = real.iter().filter_map(|i| posed.truth[*i]).collect();
        // One region of an image, whatever the session.
        let seed = seed_for(evaluation.place.seed, &[name, "private region"]);
        let inside = person(&pixels, evaluation.private, &mut ChaCha8Rng::seed_from_u64(seed));
        let mut private = vec![false; posed.lines.len()];
        real.iter().zip(inside).for_each(|(row, inside)| private[*row] = inside);
        let told = |i: usize| posed.known[i].filter(|_| measured == Measured::Private && !private[i]);
        let observations = (0..posed.lines.len())
            .map(|i| told(i).map_or(posed.lines[i], |(pixel, _)| Observation::Known(pixel)))
            .collect();
        let asked = match measured {
            Measured::Private => private.clone(),
            Measured::Matched => {
                (0..posed.lines.len()).map(|i| posed.known[i].is_some() && posed.truth[i].is_some()).collect()
            }
        };
        let depths = || posed.known.iter().flatten().map(|k| k.1);
        let (least, most) = depths().fold((f64::INFINITY, 0.0_f64), |(a, b), z| (a.min(z), b.max(z)));
        let beside: Vec<(Pixel, f64)> = (0..posed.lines.len()).filter_map(told).collect();
        let options = FramesOptions::with_depths([NEARER * least, FARTHER * most]);
        Self { posed, observations, options: options.beside(beside).asking(asked.clone()), asked }
    }

    fn size(&self) -> (u32, u32) {
        (self.posed.camera.width, self.posed.camera.height)
    }

    fn frame(&self) -> Frame<'_> {
        Frame {
            camera: self.posed.camera,
            cam_from_world: self.posed.cam_from_world,
            observations: &self.observations,
            descriptors: &self.posed.descriptors,
        }
    }

    /// With as many frames as each row says.
    fn attacked(
        &self,
        others: &[&Posed],
        motion: Motion,
        method: Method,
        codes: &RestingOptions,
        counts: &[usize],
    ) -> Result<Vec<Attacked>, AttackError> {
        let longest = counts.iter().copied().max().unwrap_or(2);
        let frames: Vec<Frame<'_>> = others.iter().map(|o| frame(o)).collect();
        let chosen: Vec<usize> = match motion {
            Motion::Turning => most_telling(&self.frame(), &frames, longest - 1, &self.options)?,
            Motion::Walking | Motion::Resting => (0..others.len()).collect(),
        };
        let (width, height) = self.size();
        let guess = prior_only(&self.observations, width, height);
        counts
            .iter()
            .map(|count| {
                let chosen: Vec<&Posed> = chosen.iter().take(count - 1).map(|i| others[*i]).collect();
                let found = match method {
                    _ if chosen.is_empty() => None,
                    Method::SeveralFrames => Some(self.by_planes(&chosen)?),
                    Method::RestingCamera => Some(self.by_scatter(&chosen, codes)?),
                };
                let answer =
                    |i: usize| found.as_ref().and_then(|f: &Vec<Sighted>| f[i].pixel).unwrap_or(guess[i]);
                let judged: Vec<(usize, Pixel)> = (0..self.asked.len())
                    .filter(|i| self.asked[*i])
                    .filter_map(|i| Some((i, self.posed.truth[i]?)))
                    .collect();
                let truth: Vec<Pixel> = judged.iter().map(|j| j.1).collect();
                Ok(Attacked {
                    errors: errors_px(judged.iter().map(|j| answer(j.0)), &truth),
                    guess: errors_px(judged.iter().map(|j| guess[j.0]), &truth),
                    size: (width, height),
                })
            })
            .collect()
    }

    fn by_planes(&self, chosen: &[&Posed]) -> Result<Vec<Sighted>, AttackError> {
        let all: Vec<Frame<'_>> =
            std::iter::once(self.frame()).chain(chosen.iter().map(|o| frame(o))).collect();
        several_frames(&all, &self.options)
    }

    fn by_scatter(&self, chosen: &[&Posed], codes: &RestingOptions) -> Result<Vec<Sighted>, AttackError> {
        let mut others = Vec::with_capacity(chosen.len());
        for other in chosen {
            let matches = mutual_matches(&self.posed.descriptors, &other.descriptors, RATIO)?;
            others.push(matches.iter().map(|m| m.map(|j| other.lines[j])).collect());
        }
        resting_camera(&self.observations, &others, self.size(), codes)
    }
}

fn frame(posed: &Posed) -> Frame<'_> {
    Frame {
        camera: posed.camera,
        cam_from_world: posed.cam_from_world,
        observations: &posed.lines,
        descriptors: &posed.descriptors,
    }
}

/// What whoever reads frames of a camera at rest supposes of their codes: those of anchors in the world are cells of the
/// session's grid, and others are dithered.
fn codes(anchors: SessionAnchors, evaluation: &SessionsEvaluation) -> RestingOptions {
    let step = evaluation.session.step;
    let options = if anchors != SessionAnchors::Image && step > 0.0 {
        RestingOptions::of_one_image(step).without_dither()
    } else {
        RestingOptions::of_one_image(std::f64::consts::PI / f64::from(AngleBits::default().levels()))
    };
    options.with_noise(DETECTOR_PX)
}

/// By how much the detector is taken to err from frame to frame of a camera at rest, along each axis, pixels.
const DETECTOR_PX: f64 = 0.2;
