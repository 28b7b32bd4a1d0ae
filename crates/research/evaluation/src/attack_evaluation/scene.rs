//! The attacker's resources for all images, and the images of one scene as they were sent.

use std::cell::OnceCell;
use std::rc::Rc;

use veiloc_attacks::{KeypointHistogram, KnownImage};
use veiloc_datasets::problem_files::KeypointImage;
use veiloc_protocol::Scheme;

use super::neighbours::{Predictor, known};
use super::options::AttackEvaluation;
use super::position_networks::PositionNetworks;
use super::server::{SentImage, Server};
use crate::EvalError;

/// What the attacker holds for all images.
pub(super) struct Attacker<'a> {
    pub(super) evaluation: &'a AttackEvaluation,
    /// The attacked schemes, each once.
    pub(super) schemes: Vec<Scheme>,
    pub(super) server: Option<Server<'a>>,
    pub(super) predictor: Option<Predictor>,
    pub(super) networks: PositionNetworks,
}

impl<'a> Attacker<'a> {
    /// Reads matches, networks and training data.
    pub(super) fn new(
        evaluation: &'a AttackEvaluation,
        attacked: &[&KeypointImage],
    ) -> Result<Self, EvalError> {
        let mut schemes: Vec<Scheme> = Vec::new();
        for scheme in evaluation.schemes.iter().filter(|scheme| scheme.hides_positions()) {
            if !schemes.contains(scheme) {
                schemes.push(*scheme);
            }
        }
        Ok(Self {
            evaluation,
            schemes,
            server: evaluation.server.as_ref().map(Server::new).transpose()?,
            networks: PositionNetworks::read(&evaluation.positions)?,
            predictor: evaluation.neighbours.learn(attacked, evaluation.k)?,
        })
    }
}

/// The images of one group; for each, the others are images of the same scene.
pub(super) struct Scene<'a> {
    pub(super) attacker: &'a Attacker<'a>,
    /// Index of the group in the document's `data`.
    pub(super) group: usize,
    pub(super) images: &'a [KeypointImage],
    histogram: KeypointHistogram,
    known: OnceCell<Vec<KnownImage>>,
    /// `[schemes][images]`, as a server sees them.
    sent: Vec<Vec<OnceCell<Rc<SentImage>>>>,
}

impl<'a> Scene<'a> {
    pub(super) fn new(attacker: &'a Attacker<'a>, group: usize, images: &'a [KeypointImage]) -> Self {
        let mut histogram = KeypointHistogram::default();
        for image in images {
            histogram.add(&histogram_of(image));
        }
        let sent = attacker.schemes.iter().map(|_| vec![OnceCell::new(); images.len()]).collect();
        Self { attacker, group, images, histogram, known: OnceCell::new(), sent }
    }

    /// Histogram of the keypoints of the images other than this one.
    pub(super) fn histogram_of_others(&self, own: usize) -> KeypointHistogram {
        let mut others = self.histogram.clone();
        others.subtract(&histogram_of(&self.images[own]));
        others
    }

    /// The images with their descriptors.
    pub(super) fn known(&self) -> Result<&[KnownImage], EvalError> {
        once(&self.known, || self.images.iter().map(known).collect()).map(Vec::as_slice)
    }

    /// An image as it was sent under a scheme. With a server it is localized once; a seal alone is not kept.
    pub(super) fn sent(&self, scheme: Scheme, image: usize) -> Result<Rc<SentImage>, EvalError> {
        let Attacker { evaluation, schemes, server, .. } = self.attacker;
        let (Some(server), Some(at)) = (server, schemes.iter().position(|s| *s == scheme)) else {
            return Ok(Rc::new(SentImage::of(evaluation, &self.images[image], scheme)?));
        };
        let view = || Ok(Rc::new(server.view(evaluation, &self.images[image], scheme)?));
        once(&self.sent[at][image], view).cloned()
    }
}

fn histogram_of(image: &KeypointImage) -> KeypointHistogram {
    KeypointHistogram::of(&image.keypoints, image.width, image.height)
}

/// The value of a cell, computed at the first call.
pub(super) fn once<T>(
    cell: &OnceCell<T>,
    make: impl FnOnce() -> Result<T, EvalError>,
) -> Result<&T, EvalError> {
    if let Some(value) = cell.get() {
        return Ok(value);
    }
    let value = make()?;
    Ok(cell.get_or_init(|| value))
}
