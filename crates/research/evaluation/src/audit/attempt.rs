//! One attack on one image: what the attacker holds, and what they answer.

use crate::EvalError;
use crate::audit::outsider::TrainedPositions;
use crate::audit::sightings::{FrameChoice, sighted};
use crate::audit::view::View;
use veiloc_attacks::multi_view::{RestingOptions, TriangulatedKeypoint, resting_camera};
use veiloc_attacks::{Density, Descriptors, KnownImage, NeighbourLists, Observation, Transfer, prior_only};
use veiloc_geometry::Pixel;
use veiloc_protocol::Scheme;

/// What an attacker holds of one image. `[N]`: one entry a keypoint, in the order of the rows.
#[derive(Clone, Copy)]
pub struct Attempt<'a> {
    /// `[N]`, what was sent, as the attacker reads it; positions where a server knows them.
    pub observations: &'a [Observation],
    /// Whom the attacker was told, or predicted, to be near whom.
    pub neighbours: &'a NeighbourLists,
    /// Width and height of the image, pixels.
    pub size: (u32, u32),
    /// Where keypoints lie in the other images of the place.
    pub density: &'a Density,
    /// What map images tell; `None` unless the attack's [`Needs`](crate::audit::Needs) say so.
    pub transferred: Option<&'a Transfer>,
    /// All images of the place with descriptors; empty unless the attack's needs say so.
    pub images: &'a [KnownImage],
    /// Which of [`Self::images`] is attacked. Its positions are the truth: an attack must not read them.
    pub own: usize,
    /// How many frames are put together, where the attack needs several.
    pub frames: Option<usize>,
    /// Which frames those are.
    pub choice: FrameChoice,
    /// The image sealed again, or frames of a camera at rest, each `[N]` in the order of the rows, where the attack
    /// needs them: one fewer than [`Self::frames`].
    pub seals: &'a [Vec<Observation>],
    /// What is known of the codes of such seals.
    pub codes: RestingOptions,
    /// Descriptors of the image, where the attack needs them.
    pub descriptors: Option<&'a Descriptors>,
    /// What an outsider has trained.
    pub trained: &'a TrainedPositions,
    /// Obfuscation scheme.
    pub scheme: Scheme,
    /// Name of the image, for messages.
    pub(crate) name: &'a str,
    /// The images of the place as a server sees them that has localized them.
    pub(crate) views: &'a [View],
}

/// Positions `[N]`, and which of them the attack believes, where it says so.
#[derive(Debug, Clone, PartialEq)]
pub struct Answers {
    /// Where the attack puts the keypoints, pixels; not finite where it has no answer.
    pub pixels: Vec<Pixel>,
    /// Which answers it believes.
    pub believed: Option<Vec<bool>>,
}

impl From<Vec<Pixel>> for Answers {
    fn from(pixels: Vec<Pixel>) -> Self {
        Self { pixels, believed: None }
    }
}

impl Attempt<'_> {
    /// The guess from the single line.
    pub fn guess(&self) -> Vec<Pixel> {
        prior_only(self.observations, self.size.0, self.size.1)
    }

    /// Positions taken over from map images; the guess where there are none.
    pub fn transferred(&self) -> Vec<Pixel> {
        let (width, height) = self.size;
        let positions = self.transferred.map(|t| t.projected(self.observations, width, height));
        positions.unwrap_or_else(|| self.guess())
    }

    /// Where the trained network puts the keypoints; the guess where there is none for the scheme.
    pub(crate) fn by_training(&self) -> Result<Answers, EvalError> {
        let found = match self.descriptors {
            Some(descriptors) => {
                self.trained.recover(self.scheme, self.observations, descriptors, self.size)?
            }
            None => None,
        };
        Ok(found.unwrap_or_else(|| self.guess()).into())
    }

    /// What the scatter of several seals' angles tells; the guess where it tells nothing.
    pub(crate) fn by_scatter(&self) -> Result<Answers, EvalError> {
        let others: Vec<Vec<Option<Observation>>> =
            self.seals.iter().map(|seal| seal.iter().copied().map(Some).collect()).collect();
        let found = resting_camera(self.observations, &others, self.size, &self.codes)?;
        Ok(found
            .iter()
            .zip(self.guess())
            .map(|(s, guess)| s.pixel.unwrap_or(guess))
            .collect::<Vec<_>>()
            .into())
    }

    /// What several frames tell about the image; the guess where they tell nothing.
    pub(crate) fn by_frames(&self) -> Result<Answers, EvalError> {
        let frames = self.frames.unwrap_or(0);
        if self.views.len() < frames {
            return Err(EvalError::Options(format!(
                "{frames} frames are asked for, and the file of {} has {} images",
                self.name,
                self.views.len()
            )));
        }
        let guess = self.guess();
        let Some(found) = sighted(self.views, self.images, self.own, frames, self.choice)? else {
            return Ok(Answers { believed: Some(vec![false; guess.len()]), pixels: guess });
        };
        Ok(Answers {
            believed: Some(found.iter().map(TriangulatedKeypoint::is_accepted).collect()),
            pixels: found.iter().zip(guess).map(|(s, guess)| s.pixel.unwrap_or(guess)).collect(),
        })
    }
}
