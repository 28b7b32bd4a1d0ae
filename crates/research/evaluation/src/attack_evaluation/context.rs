//! One attack on one image: the attacker's inputs and answers.

use crate::EvalError;
use crate::attack_evaluation::multi_view::{FrameChoice, multi_view_answers};
use crate::attack_evaluation::position_networks::TrainedPositions;
use crate::attack_evaluation::server_view::ServerView;
use veiloc_attacks::multi_view::{RestingOptions, TriangulatedKeypoint, resting_camera};
use veiloc_attacks::{
    DecodedDescriptors, Density, KnownImage, MapVisibility, NeighbourLists, Observation,
    TransferredPositions, hole, prior_median, prior_only,
};
use veiloc_geometry::Pixel;
use veiloc_protocol::Scheme;

/// Inputs of an attack on one image. `[N]`: one entry per keypoint, in the order of the rows.
#[derive(Clone, Copy)]
pub struct AttackInput<'a> {
    /// `[N]`, the sent observations as the attacker reads them; positions that a server knows are
    /// [`Observation::Known`].
    pub observations: &'a [Observation],
    /// Neighbour lists, from an oracle or predicted.
    pub neighbours: &'a NeighbourLists,
    /// Width and height of the image, pixels.
    pub size: (u32, u32),
    /// Density of keypoints in the other images of the scene.
    pub density: &'a Density,
    /// Positions and neighbours from map images; `None` unless the attack's
    /// [`AttackRequirements`](crate::attack_evaluation::AttackRequirements) require them.
    pub transferred: Option<&'a TransferredPositions>,
    /// All images of the scene with descriptors; empty unless the attack's needs require them.
    pub images: &'a [KnownImage],
    /// Index of the attacked image in [`Self::images`]. Its positions are the ground truth: an attack must not read
    /// them.
    pub own: usize,
    /// Number of frames, if the attack needs several.
    pub frames: Option<usize>,
    /// How these frames are chosen.
    pub choice: FrameChoice,
    /// More seals of the image, or frames of a stationary camera, each `[N]` in the order of the rows, if the attack
    /// needs them: one fewer than [`Self::frames`].
    pub seals: &'a [Vec<Observation>],
    /// Model of the angle codes of these seals.
    pub codes: RestingOptions,
    /// Descriptors of the image, if the attack needs them.
    pub descriptors: Option<&'a DecodedDescriptors>,
    /// The outsider's trained networks.
    pub trained: &'a TrainedPositions,
    /// Obfuscation scheme.
    pub scheme: Scheme,
    /// Name of the image, for messages.
    pub(crate) name: &'a str,
    /// The images of the scene as a server sees them that has localized them.
    pub(crate) views: &'a [ServerView],
}

/// Positions `[N]`, and which of them the attack accepts, if it rates its answers.
#[derive(Debug, Clone, PartialEq)]
pub struct RecoveredPositions {
    /// Recovered keypoints, pixels; not finite without an answer.
    pub pixels: Vec<Pixel>,
    /// Which answers the attack accepts.
    pub accepted: Option<Vec<bool>>,
    /// Probability that a keypoint belongs to something that hides the map, if the attack estimates it.
    pub hiding: Option<Vec<f64>>,
}

impl From<Vec<Pixel>> for RecoveredPositions {
    fn from(pixels: Vec<Pixel>) -> Self {
        Self { pixels, accepted: None, hiding: None }
    }
}

impl AttackInput<'_> {
    /// The prior-only baseline for bits: the answer where an attack has none.
    pub fn prior_only(&self) -> Vec<Pixel> {
        prior_only(self.observations, self.size.0, self.size.1)
    }

    /// The prior-only baseline for errors in pixels.
    pub fn prior_median(&self) -> Vec<Pixel> {
        prior_median(self.observations, self.size.0, self.size.1)
    }

    /// Positions transferred from map images; the prior-only baseline where there are none.
    pub fn transferred(&self) -> Vec<Pixel> {
        let (width, height) = self.size;
        let positions = self.transferred.map(|t| t.projected(self.observations, width, height));
        positions.unwrap_or_else(|| self.prior_only())
    }

    /// Positions from the trained network; the prior-only baseline if there is no network for the scheme.
    pub(crate) fn by_training(&self) -> Result<RecoveredPositions, EvalError> {
        let found = match self.descriptors {
            Some(descriptors) => {
                self.trained.recover(self.scheme, self.observations, descriptors, self.size)?
            }
            None => None,
        };
        Ok(found.unwrap_or_else(|| self.prior_only()).into())
    }

    /// Positions from the scatter of several seals' angles; the prior-only baseline where it has no answer.
    pub(crate) fn by_scatter(&self) -> Result<RecoveredPositions, EvalError> {
        let others: Vec<Vec<Option<Observation>>> =
            self.seals.iter().map(|seal| seal.iter().copied().map(Some).collect()).collect();
        let found = resting_camera(self.observations, &others, self.size, &self.codes)?;
        Ok(found
            .iter()
            .zip(self.prior_only())
            .map(|(s, prior)| s.pixel.unwrap_or(prior))
            .collect::<Vec<_>>()
            .into())
    }

    /// Positions from several frames; the prior-only baseline where there is no answer.
    pub(crate) fn by_frames(&self) -> Result<RecoveredPositions, EvalError> {
        let frames = self.frames.unwrap_or(0);
        if self.views.len() < frames {
            return Err(EvalError::Options(format!(
                "{frames} frames are requested, but the file of {} has {} images",
                self.name,
                self.views.len()
            )));
        }
        let prior = self.prior_only();
        let Some(found) = multi_view_answers(self.views, self.images, self.own, frames, self.choice)? else {
            let accepted = Some(vec![false; prior.len()]);
            return Ok(RecoveredPositions { accepted, ..prior.into() });
        };
        let pixels: Vec<Pixel> = found.iter().zip(prior).map(|(s, prior)| s.pixel.unwrap_or(prior)).collect();
        let accepted = Some(found.iter().map(TriangulatedKeypoint::is_accepted).collect());
        Ok(RecoveredPositions { accepted, ..pixels.into() })
    }

    /// Positions where the map should have been seen and was not; the prior-only baseline without a pose.
    pub(crate) fn in_the_hole(&self) -> RecoveredPositions {
        let pose = self.views.get(self.own).and_then(|view| view.pose.as_ref());
        let map = pose.map_or_else(MapVisibility::default, |pose| MapVisibility {
            expected: pose.expected.clone(),
            confirmed: pose.known.iter().map(|(at, _)| *at).collect(),
        });
        let found = hole(self.observations, &map, self.size.0, self.size.1);
        RecoveredPositions { hiding: Some(found.inside), ..found.pixels.into() }
    }
}
