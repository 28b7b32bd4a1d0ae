//! How many of the neighbours that are named are true, by descriptors alone and with angles.
//!
//! The gate of near angles says much alone: a predictor that knows descriptors is then worth what it adds to drawing at
//! random from it.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use veiloc_attacks::{NeighbourLists, Observation};
use veiloc_datasets::problem_files::{KeypointImage, seed_for};
use veiloc_obfuscation::audit::obfuscate_points;
use veiloc_protocol::{AngleBits, DclLayout, Scheme};

use super::document::PrecisionRow;
use crate::EvalError;
use crate::audit::gate;
use crate::audit::neighbours::{Predictor, descriptors};

/// Neighbours a keypoint that the figures count, of the [`NEAREST`].
const LENGTHS: [usize; 3] = [5, 10, 20];
pub(super) const NEAREST: usize = 20;
/// Precision of a predictor over all keypoints of some images, by descriptors alone, with angles, and of angles alone.
pub(super) fn rows(
    part: &'static str,
    set: &[KeypointImage],
    predictor: &Predictor,
    name: &'static str,
) -> Result<Vec<PrecisionRow>, EvalError> {
    let names = match name {
        "network" => ["network", "network, angles", "angles"],
        _ => ["statistic", "statistic, angles", "angles"],
    };
    let mut tallies: [Tally; 3] = Default::default();
    for image in set {
        let n = image.keypoints.len();
        let said = predictor.predict(&descriptors(image)?, n.saturating_sub(1))?;
        let near = NeighbourLists::nearest(&image.keypoints, NEAREST);
        let gate = gate(image)?;
        let mut of_image: [Counts; 3] = Default::default();
        for i in 0..near.len() {
            let is_near = |j: &u32| near.of(i).contains(j);
            of_image[0].count(said.of(i).iter().map(is_near));
            of_image[1].count(said.of(i).iter().filter(|j| gate.of(i).contains(j)).map(is_near));
            // Of angles alone: the share among all that pass.
            let true_ones = gate.of(i).iter().filter(|j| is_near(j)).count() as f64;
            let share = true_ones / (gate.of(i).len() as f64).max(1.0);
            of_image[2].expected(share, gate.of(i).len());
        }
        let chance: f64 =
            (0..n).map(|i| near.of(i).len() as f64 / (n as f64 - 1.0).max(1.0)).sum::<f64>() / n as f64;
        tallies.iter_mut().zip(of_image).for_each(|(tally, counts)| tally.add(&counts, chance, n));
    }
    Ok(tallies.iter().zip(names).filter_map(|(tally, name)| tally.row(part, name, set.len())).collect())
}

/// For each row the rows that pass its gate under the paper's layout, in no order.
fn gate(image: &KeypointImage) -> Result<NeighbourLists, EvalError> {
    let scheme = Scheme::Dcl(DclLayout::VERTICAL);
    let seed = seed_for(0, &[&image.name, "gate"]);
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (width, height) = (image.width, image.height);
    let sent = obfuscate_points(&image.keypoints, width, height, &scheme, AngleBits::default(), &mut rng)
        .map_err(|source| EvalError::Seal { name: image.name.clone(), source })?;
    Ok(gate::gate(&Observation::of_sent(&sent))?)
}

/// Named neighbours that are true and all that are named, of each length.
#[derive(Default)]
struct Counts {
    right: [f64; 3],
    said: [f64; 3],
}

impl Counts {
    /// Of one keypoint, likeliest first: whether each is true.
    fn count(&mut self, named: impl Iterator<Item = bool>) {
        for (at, is_true) in named.take(NEAREST).enumerate() {
            for (slot, length) in LENGTHS.into_iter().enumerate() {
                if at < length {
                    self.said[slot] += 1.0;
                    self.right[slot] += f64::from(u8::from(is_true));
                }
            }
        }
    }

    /// Of one keypoint whose neighbours are drawn from so many, this share of which are true.
    fn expected(&mut self, share: f64, among: usize) {
        for (slot, length) in LENGTHS.into_iter().enumerate() {
            let said = length.min(among) as f64;
            self.said[slot] += said;
            self.right[slot] += share * said;
        }
    }
}

#[derive(Default)]
struct Tally {
    all: Counts,
    chance: f64,
    keypoints: f64,
    by_image: Vec<f64>,
}

impl Tally {
    fn add(&mut self, counts: &Counts, chance: f64, keypoints: usize) {
        for slot in 0..3 {
            self.all.right[slot] += counts.right[slot];
            self.all.said[slot] += counts.said[slot];
        }
        self.by_image.push(counts.right[2] / counts.said[2].max(1.0));
        if keypoints > 0 {
            self.chance += chance * keypoints as f64;
            self.keypoints += keypoints as f64;
        }
    }

    fn row(&self, part: &'static str, predictor: &'static str, images: usize) -> Option<PrecisionRow> {
        let share = |slot: usize| self.all.right[slot] / self.all.said[slot];
        (self.all.said[0] > 0.0).then(|| PrecisionRow {
            part,
            predictor,
            images,
            at_5: share(0),
            at_10: share(1),
            at_20: share(2),
            chance: self.chance / self.keypoints,
            by_image: self.by_image.clone(),
        })
    }
}
