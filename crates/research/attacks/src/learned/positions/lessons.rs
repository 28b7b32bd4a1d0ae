//! What the network learns from: some keypoints of a part of an image, obfuscated anew at every draw.

use crate::{KnownImage, Observation};
use rand::Rng;
use rand::seq::SliceRandom as _;
use rand_chacha::ChaCha8Rng;
use veiloc_geometry::Pixel;
use veiloc_obfuscation::SealError;
use veiloc_obfuscation::audit::obfuscate_points;

use super::PositionTask;
use super::bins::Bins;
use super::mirror::mirrored;
use crate::learned::engine::Matrix;
use crate::learned::neighbours::input;

/// Sides of a part of an image are at least this share of the image's.
const LEAST_SIDE: f64 = 0.5;
/// A part with fewer keypoints is not looked at; the whole image is instead.
const FEWEST: usize = 48;

/// An image made ready for training.
#[derive(Debug)]
pub(super) struct Lesson {
    keypoints: Vec<Pixel>,
    /// `[dimension, N]`
    descriptors: Matrix,
    size: [u32; 2],
}

/// Some keypoints as an attacker holds them, and where they are.
pub(super) struct Drawn {
    /// `[dimension, n]`
    pub(super) descriptors: Matrix,
    pub(super) observations: Vec<Observation>,
    /// `[n]`
    pub(super) truth: Vec<Pixel>,
    pub(super) size: [u32; 2],
}

impl Lesson {
    /// Keypoints outside the image are left out; `None` when fewer than two are left.
    pub(super) fn new(image: &KnownImage) -> Option<Self> {
        let size = image.size();
        let [width, height] = size.map(f64::from);
        let inside = |p: &Pixel| (0.0..width).contains(&p.u) && (0.0..height).contains(&p.v);
        let kept: Vec<usize> =
            (0..image.keypoints().len()).filter(|i| inside(&image.keypoints()[*i])).collect();
        (kept.len() > 1).then(|| Self {
            keypoints: kept.iter().map(|i| image.keypoints()[*i]).collect(),
            descriptors: input(image.descriptors()).select_columns(&kept),
            size,
        })
    }

    /// All of it, obfuscated by this generator.
    pub(super) fn whole(&self, task: &PositionTask, rng: &mut impl Rng) -> Result<Drawn, SealError> {
        self.sent((0..self.keypoints.len()).collect(), [0, 0], self.size, false, task, rng)
    }

    /// At most `most` keypoints of a part of the image, maybe mirrored.
    pub(super) fn draw(
        &self,
        task: &PositionTask,
        most: usize,
        rng: &mut ChaCha8Rng,
    ) -> Result<Drawn, SealError> {
        let (mut corner, mut size) = ([0, 0], self.size);
        if task.crop && rng.random::<bool>() {
            size = self.size.map(|side| {
                let share = rng.random_range(LEAST_SIDE..1.0);
                ((share * f64::from(side)).ceil() as u32).clamp(1, side)
            });
            corner = [0, 1].map(|axis| rng.random_range(0..=self.size[axis] - size[axis]));
        }
        let mut kept = self.within(corner, size);
        if kept.len() < FEWEST {
            (corner, size) = ([0, 0], self.size);
            kept = (0..self.keypoints.len()).collect();
        }
        let n = most.min(kept.len());
        kept.partial_shuffle(rng, n);
        // The drawn ones stand at the end.
        let drawn = kept.split_off(kept.len() - n);
        let flip = task.mirror && rng.random::<bool>();
        self.sent(drawn, corner, size, flip, task, rng)
    }

    fn within(&self, corner: [u32; 2], size: [u32; 2]) -> Vec<usize> {
        let inside = |p: &Pixel| {
            let range = |axis: usize| f64::from(corner[axis])..f64::from(corner[axis] + size[axis]);
            range(0).contains(&p.u) && range(1).contains(&p.v)
        };
        (0..self.keypoints.len()).filter(|i| inside(&self.keypoints[*i])).collect()
    }

    fn sent(
        &self,
        drawn: Vec<usize>,
        corner: [u32; 2],
        size: [u32; 2],
        flip: bool,
        task: &PositionTask,
        rng: &mut impl Rng,
    ) -> Result<Drawn, SealError> {
        let place = |p: Pixel| {
            let moved = Pixel::new(p.u - f64::from(corner[0]), p.v - f64::from(corner[1]));
            if flip { Pixel::new(f64::from(size[0]) - moved.u, moved.v) } else { moved }
        };
        let truth: Vec<Pixel> = drawn.iter().map(|i| place(self.keypoints[*i])).collect();
        let [width, height] = size;
        let sent = obfuscate_points(&truth, width, height, &task.scheme, task.angle_bits, rng)?;
        let mut descriptors = self.descriptors.select_columns(&drawn);
        if flip {
            descriptors = mirrored(&descriptors);
        }
        Ok(Drawn { descriptors, observations: Observation::of_sent(&sent), truth, size })
    }
}

impl Drawn {
    /// The bins, and for each row the one in which its keypoint is, where there is something to learn.
    pub(super) fn bins(&self, count: usize) -> (Bins, Vec<Option<usize>>) {
        let bins = Bins::of(&self.observations, self.size, count);
        let truth = self.truth.iter().enumerate().map(|(row, place)| bins.holding(row, *place)).collect();
        (bins, truth)
    }
}
