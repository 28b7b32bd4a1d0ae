//! One attack on one image: what the attacker holds, and what he answers.

use std::collections::BTreeMap;

use rand_chacha::ChaCha8Rng;
use veiloc_attacks::{
    AttackError, ClosedFormOptions, Density, GraphOptions, Guided, GuidedOptions, KnownImage, LineNeighbours,
    NeighbourLists, Observation, Sighted, Transfer, closed_form, graph, guided_transfer, iterative,
    prior_only, server_side,
};
use veiloc_geometry::Pixel;

use super::keypoints::KeypointImage;
use super::kind::AttackKind;
use super::server::View;
use super::sightings::sighted;
use crate::error::EvalError;

/// What the attacker holds of one image beside what was sent.
pub(super) struct Held<'a> {
    pub(super) density: Density,
    pub(super) neighbours: NeighbourLists,
    pub(super) transferred: Option<Transfer>,
    /// Which of the file's images it is.
    pub(super) own: usize,
    /// The file's images with descriptors, where an attack reads them.
    pub(super) images: &'a [KnownImage],
    /// By scheme, the file's images as the server sees them, where there is one.
    pub(super) views: &'a BTreeMap<String, Vec<View>>,
}

/// Positions `[N]`, and which of them the attack believes, where it says so.
pub(super) struct Answers {
    pub(super) pixels: Vec<Pixel>,
    pub(super) believed: Option<Vec<bool>>,
}

impl From<Vec<Pixel>> for Answers {
    fn from(pixels: Vec<Pixel>) -> Self {
        Self { pixels, believed: None }
    }
}

/// Pixels within which neighbours agree, in shares of the image's width: 20 px of 640.
const CONSENSUS: f64 = 20.0 / 640.0;

/// What several frames tell about one image; the guess where they tell nothing.
pub(super) fn by_frames(
    observations: &[Observation],
    frames: usize,
    held: &Held<'_>,
    scheme: &str,
    image: &KeypointImage,
) -> Result<Answers, EvalError> {
    let views = held.views.get(scheme).map_or(&[][..], Vec::as_slice);
    if views.len() < frames {
        return Err(EvalError::Options(format!(
            "{frames} frames are asked for, and the file of {} has {} images",
            image.name,
            views.len()
        )));
    }
    let guess = prior_only(observations, image.width, image.height);
    let Some(found) = sighted(views, held.images, held.own, frames)? else {
        return Ok(Answers { believed: Some(vec![false; guess.len()]), pixels: guess });
    };
    Ok(Answers {
        believed: Some(found.iter().map(Sighted::is_believed).collect()),
        pixels: found.iter().zip(guess).map(|(s, guess)| s.pixel.unwrap_or(guess)).collect(),
    })
}

/// One attack on one image.
pub(super) fn answer(
    attack: AttackKind,
    observations: &[Observation],
    neighbours: &NeighbourLists,
    image: &KeypointImage,
    held: &Held<'_>,
    rng: &mut ChaCha8Rng,
) -> Result<Answers, AttackError> {
    let (width, height) = (image.width, image.height);
    let closed = |options: ClosedFormOptions| {
        let answers = closed_form(observations, neighbours, width, height, &options)?;
        Ok(answers.iter().map(|a| a.pixel).collect::<Vec<_>>().into())
    };
    let served = |lines| {
        let answers = server_side(observations, neighbours, width, height, lines)?;
        Ok(answers.iter().map(|a| a.pixel).collect::<Vec<_>>().into())
    };
    let transferred = || {
        let positions = held.transferred.as_ref().map(|t| t.projected(observations, width, height));
        positions.unwrap_or_else(|| prior_only(observations, width, height))
    };
    let laid_out = |options: GraphOptions, rng: &mut ChaCha8Rng| {
        Ok(graph(observations, neighbours, width, height, &options, rng)?.pixels.into())
    };
    match attack {
        AttackKind::Prior => Ok(prior_only(observations, width, height).into()),
        AttackKind::LearnedPrior => Ok(held.density.guess(observations, width, height).into()),
        AttackKind::ClosedForm => closed(ClosedFormOptions::default()),
        AttackKind::ClosedFormInImage => closed(ClosedFormOptions::in_image()),
        AttackKind::ClosedFormInformed => closed(ClosedFormOptions::informed()),
        AttackKind::ClosedFormConsensus => {
            closed(ClosedFormOptions::informed().with_consensus(CONSENSUS * f64::from(width)))
        }
        AttackKind::Transfer => Ok(transferred().into()),
        AttackKind::Graph => laid_out(GraphOptions::default(), rng),
        AttackKind::TransferGraph => laid_out(GraphOptions::default().beginning_at(transferred()), rng),
        AttackKind::ServerSide => served(LineNeighbours::Count),
        AttackKind::ServerSidePoints => served(LineNeighbours::LeftOut),
        AttackKind::Iterative => Ok(iterative(observations, neighbours, width, height)?.into()),
        AttackKind::GuidedTransfer => guided(observations, held, (width, height), transferred()),
        // Asked for by its number of frames, not by neighbours.
        AttackKind::SeveralFrames => Ok(prior_only(observations, width, height).into()),
    }
}

/// Positions from warped map images where the server believes them, and of the plain transfer elsewhere.
fn guided(
    observations: &[Observation],
    held: &Held<'_>,
    size: (u32, u32),
    plain: Vec<Pixel>,
) -> Result<Answers, AttackError> {
    let own = held.images[held.own].descriptors();
    let others = held.images.iter().enumerate().filter(|(i, _)| *i != held.own);
    let map: Vec<KnownImage> = others.map(|(_, p)| p.clone()).collect();
    let found = guided_transfer(own, observations, &map, size, &GuidedOptions::default())?;
    let chosen = |(g, plain): (&Guided, Pixel)| g.pixel.filter(|_| g.is_believed()).unwrap_or(plain);
    Ok(Answers {
        believed: Some(found.iter().map(Guided::is_believed).collect()),
        pixels: found.iter().zip(plain).map(chosen).collect(),
    })
}
