//! What an attacker holds about one image under one scheme. Costly parts are computed when an attack first asks for them.

use std::cell::{Cell, OnceCell};
use std::rc::Rc;
use std::time::{Duration, Instant};

use rand_chacha::ChaCha8Rng;
use veiloc_attacks::multi_view::StaticCameraOptions;
use veiloc_attacks::{
    DecodedDescriptors, Density, KnownImage, NeighbourLists, Observation, TransferredPositions, errors_px,
    prior_median, prior_only, transfer,
};
use veiloc_datasets::problem_files::KeypointImage;
use veiloc_geometry::Pixel;
use veiloc_protocol::{Observations, Scheme};

use super::angle_gate::restricted_by_angle;
use super::neighbours::{NeighbourSource, descriptors};
use super::options::AttackEvaluation;
use super::scene::{Scene, once};
use super::server::{PosedView, SentImage, reseal_image};
use crate::EvalError;

/// Map images from which positions and neighbours are transferred: those with the most mutual matches.
const MAP_IMAGES: usize = 5;

/// One attacked image under one scheme. `[N]`: one entry per keypoint, in the order of the rows.
pub struct AttackContext<'a> {
    pub(super) scene: &'a Scene<'a>,
    /// Index of the image in its scene.
    pub(super) own: usize,
    parts: &'a ImageParts,
    scheme: Scheme,
    pub(super) sent: Rc<SentImage>,
    prior_errors: OnceCell<Vec<f64>>,
    /// Percent of the neighbours that are replaced at random.
    pub(super) corrupt: f64,
    /// Number of frames or seals.
    pub(super) frames: usize,
    /// Time of what the attacker holds before it attacks.
    preparation: Cell<Duration>,
}

/// What does not depend on the scheme.
#[derive(Default)]
pub(super) struct ImageParts {
    density: OnceCell<Density>,
    descriptors: OnceCell<DecodedDescriptors>,
    transfer: OnceCell<TransferredPositions>,
    neighbours: OnceCell<NeighbourLists>,
    ranked: OnceCell<NeighbourLists>,
}

impl<'a> AttackContext<'a> {
    pub(super) fn new(
        scene: &'a Scene<'a>,
        own: usize,
        parts: &'a ImageParts,
        scheme: Scheme,
    ) -> Result<Self, EvalError> {
        Ok(Self {
            scene,
            own,
            parts,
            scheme,
            sent: scene.sent(scheme, own)?,
            prior_errors: OnceCell::new(),
            corrupt: 0.0,
            frames: 0,
            preparation: Cell::default(),
        })
    }

    /// Obfuscation scheme.
    pub fn scheme(&self) -> Scheme {
        self.scheme
    }

    /// Width of the image, pixels.
    pub fn width(&self) -> u32 {
        self.image().width
    }

    /// Height of the image, pixels.
    pub fn height(&self) -> u32 {
        self.image().height
    }

    /// `[N]`, the sent observations as the attacker reads them; positions that a server knows are
    /// [`Observation::Known`].
    pub fn observations(&self) -> &[Observation] {
        &self.sent.observations
    }

    /// The sent observations, with quantized angles.
    pub fn sent(&self) -> &Observations {
        &self.sent.observed
    }

    /// A generator, seeded by image and scheme: other schemes or attacks do not change the result.
    pub fn rng(&self) -> ChaCha8Rng {
        self.evaluation().rng(&self.image().name, self.scheme, "attack")
    }

    /// The prior-only baseline for bits: the answer where an attack has none.
    pub fn prior_only(&self) -> Vec<Pixel> {
        prior_only(self.observations(), self.width(), self.height())
    }

    /// The prior-only baseline for errors in pixels.
    pub fn prior_median(&self) -> Vec<Pixel> {
        prior_median(self.observations(), self.width(), self.height())
    }

    /// Neighbour lists, from an oracle, predicted or from a map; some of them replaced at random.
    ///
    /// # Errors
    /// [`EvalError`] when the image has no descriptors to predict them from.
    pub fn neighbours(&self) -> Result<NeighbourLists, EvalError> {
        self.prepare(|| Ok(self.corrupted(self.given_neighbours()?)))
    }

    /// Predicted neighbours; of those with the same anchor, only rows with similar angles.
    ///
    /// # Errors
    /// As [`Self::neighbours`].
    pub fn neighbours_of_near_angles(&self) -> Result<NeighbourLists, EvalError> {
        let Some(predictor) = &self.scene.attacker.predictor else { return self.neighbours() };
        self.prepare(|| {
            let others = self.image().keypoints.len().saturating_sub(1);
            let ranked = once(&self.parts.ranked, || Ok(predictor(self.descriptors()?, others)?))?;
            let near = restricted_by_angle(ranked, self.observations(), self.evaluation().k)?;
            Ok(self.corrupted(&near))
        })
    }

    fn corrupted(&self, lists: &NeighbourLists) -> NeighbourLists {
        let mut rng = self.evaluation().rng(&self.image().name, self.scheme, "corrupted");
        lists.corrupted(self.corrupt / 100.0, &mut rng)
    }

    /// Neighbour lists before any is replaced.
    pub(super) fn given_neighbours(&self) -> Result<&NeighbourLists, EvalError> {
        let AttackEvaluation { k, neighbours, .. } = self.evaluation();
        once(&self.parts.neighbours, || match &self.scene.attacker.predictor {
            Some(predictor) => Ok(predictor(self.descriptors()?, *k)?),
            None if *neighbours == NeighbourSource::Transferred => Ok(self.transfer()?.neighbours.clone()),
            None => Ok(self.true_neighbours()),
        })
    }

    pub(super) fn true_neighbours(&self) -> NeighbourLists {
        NeighbourLists::nearest(&self.image().keypoints, self.evaluation().k)
    }

    /// Density of keypoints in the other images of the scene.
    pub fn density(&self) -> &Density {
        self.prepare(|| self.parts.density.get_or_init(|| self.scene.histogram_of_others(self.own).density()))
    }

    /// Descriptors of the image, `[N]`.
    ///
    /// # Errors
    /// [`EvalError::Options`] when it has none.
    pub fn descriptors(&self) -> Result<&DecodedDescriptors, EvalError> {
        self.prepare(|| once(&self.parts.descriptors, || descriptors(self.image())))
    }

    /// The other images of the scene with their keypoints.
    ///
    /// # Errors
    /// [`EvalError::Options`] when one has no descriptors.
    pub fn map_images(&self) -> Result<Vec<KnownImage>, EvalError> {
        let others = self.known()?.iter().enumerate().filter(|(i, _)| *i != self.own);
        Ok(others.map(|(_, image)| image.clone()).collect())
    }

    /// All images of the scene with their keypoints.
    pub(super) fn known(&self) -> Result<&'a [KnownImage], EvalError> {
        self.prepare(|| self.scene.known())
    }

    /// Positions transferred from the other images; the prior-only baseline where there are none.
    ///
    /// # Errors
    /// As [`Self::map_images`].
    pub fn transferred(&self) -> Result<Vec<Pixel>, EvalError> {
        Ok(self.transfer()?.projected(self.observations(), self.width(), self.height()))
    }

    fn transfer(&self) -> Result<&TransferredPositions, EvalError> {
        let size = (self.width(), self.height());
        self.prepare(|| {
            once(&self.parts.transfer, || {
                let (own, map) = (self.descriptors()?, self.map_images()?);
                Ok(transfer(own, &map, size, MAP_IMAGES, self.evaluation().k)?)
            })
        })
    }

    /// More seals of the image, or frames of a stationary camera, each `[N]` in the order of the rows.
    ///
    /// # Errors
    /// [`EvalError::Seal`] when the scheme cannot obfuscate the image.
    pub fn seals(&self) -> Result<Vec<Vec<Option<Observation>>>, EvalError> {
        let seal = |number| {
            let rows = reseal_image(self.evaluation(), self.image(), self.scheme, number)?;
            Ok(rows.into_iter().map(Some).collect())
        };
        self.prepare(|| (1..self.frames).map(seal).collect())
    }

    /// Model of the angle codes of these seals.
    pub fn angle_codes(&self) -> StaticCameraOptions {
        let evaluation = self.evaluation();
        let cell = std::f64::consts::PI / f64::from(evaluation.angle_bits.levels());
        StaticCameraOptions::of_one_image(cell).with_noise(evaluation.static_noise_px)
    }

    /// Positions from the trained network; the prior-only baseline if there is no network for the scheme.
    pub(super) fn by_network(&self) -> Result<Vec<Pixel>, EvalError> {
        let (networks, size) = (&self.scene.attacker.networks, (self.width(), self.height()));
        let found = networks.recover(self.scheme, self.observations(), self.descriptors()?, size)?;
        Ok(found.unwrap_or_else(|| self.prior_only()))
    }

    /// The pose that a server has found, and what it sees from there.
    pub(super) fn pose(&self) -> Option<&PosedView> {
        self.sent.pose.as_ref()
    }

    /// All images of the scene as a server sees them, `[images]`.
    pub(super) fn views(&self) -> Result<Vec<Rc<SentImage>>, EvalError> {
        self.prepare(|| (0..self.scene.images.len()).map(|i| self.scene.sent(self.scheme, i)).collect())
    }

    pub(super) fn evaluation(&self) -> &'a AttackEvaluation {
        self.scene.attacker.evaluation
    }

    /// The image with its true keypoints.
    pub(super) fn image(&self) -> &'a KeypointImage {
        &self.scene.images[self.own]
    }

    /// Errors of the prior-only baseline for bits, on the measured keypoints.
    pub(super) fn prior_errors(&self) -> &[f64] {
        self.prior_errors
            .get_or_init(|| self.measured(&errors_px(self.prior_only(), &self.image().keypoints)))
    }

    /// The values of measured keypoints, of those of all, `[N]`.
    pub(super) fn measured(&self, all: &[f64]) -> Vec<f64> {
        all.iter().zip(&self.sent.measured).filter(|(_, measured)| **measured).map(|(x, _)| *x).collect()
    }

    /// Runs an attack, and returns its duration without that of what it is given.
    pub(super) fn timed<T>(&self, run: impl FnOnce(&Self) -> T) -> (T, Duration) {
        self.preparation.set(Duration::ZERO);
        let started = Instant::now();
        let answer = run(self);
        (answer, started.elapsed().saturating_sub(self.preparation.get()))
    }

    /// Computes what the attacker holds. Preparations can be nested; each moment counts once.
    fn prepare<T>(&self, make: impl FnOnce() -> T) -> T {
        let (started, before) = (Instant::now(), self.preparation.get());
        let made = make();
        self.preparation.set(before + started.elapsed());
        made
    }
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
