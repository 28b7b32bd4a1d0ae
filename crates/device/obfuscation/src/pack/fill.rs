//! Decoys of the place itself.

use rand::Rng;
use rand::seq::IndexedRandom;
use veiloc_descriptor::{Descriptors, Encoding};
use veiloc_protocol::{Candidate, MatchWeight};

use super::KnownPlace;
use super::find::FoundRows;

/// Ratios of decoys: those of rows that the place explains, but that match none of its points well. Nearer ones would match
/// points, and mislead the estimator.
const RATIOS: std::ops::RangeInclusive<f32> = 0.7..=0.8;
/// Most rounds of drawing decoys.
const ROUNDS: usize = 16;

impl KnownPlace {
    /// `count` descriptors as the place shows them, of these images of the pack: each is a row, changed as two other points
    /// change from one image to another, and so is as far from all rows of the pack as real rows are that match by chance.
    pub(super) fn decoy_rows<R: Rng + ?Sized>(
        &self,
        images: &[usize],
        count: usize,
        rng: &mut R,
    ) -> Descriptors {
        let pack = self.pack();
        let mut rows: Vec<usize> = images.iter().flat_map(|image| pack.rows_of(*image)).collect();
        // Rows by point, so that two rows of one point are neighbours.
        rows.sort_unstable_by_key(|row| (pack.points()[*row], *row));
        let is_pair = |two: &&[usize]| pack.points()[two[0]] == pack.points()[two[1]];
        let pairs: Vec<&[usize]> = rows.windows(2).filter(is_pair).collect();
        let mut made = Descriptors::empty(pack.profile().descriptor_kind());
        for round in 0..ROUNDS {
            let missing = count - made.len();
            if missing == 0 {
                break;
            }
            let drawn = self.drawn(&rows, &pairs, 2 * missing, rng);
            let explained = self.explain(&drawn).expect("of the kind of the pack");
            let fitting =
                (0..drawn.len()).filter(|row| RATIOS.contains(&explained[*row].ratio) || round + 1 == ROUNDS);
            for row in fitting.take(missing) {
                made.push(drawn.row(row)).expect("of one kind");
            }
        }
        made
    }

    /// `count` rows, each with the changes of two points.
    fn drawn<R: Rng + ?Sized>(
        &self,
        rows: &[usize],
        pairs: &[&[usize]],
        count: usize,
        rng: &mut R,
    ) -> Descriptors {
        let all = self.pack().descriptors();
        let kind = all.kind();
        let mut drawn = Descriptors::empty(kind);
        for _ in 0..count {
            let row = rows.choose(rng).copied().unwrap_or(0);
            let mut values: Vec<f64> = all.values(row).map(f64::from).collect();
            for _ in 0..2 {
                // Without a point that is seen twice, the difference of any two rows.
                let [from, to] = match pairs.choose(rng) {
                    Some(pair) => [pair[0], pair[1]],
                    None => [0, 1].map(|_| rows.choose(rng).copied().unwrap_or(0)),
                };
                let change = all.values(to).zip(all.values(from)).map(|(to, from)| f64::from(to - from));
                values.iter_mut().zip(change).for_each(|(value, change)| *value += change);
            }
            if kind.encoding() == Encoding::Unsigned {
                for value in &mut values {
                    *value = value.max(0.0);
                }
            }
            let length = values.iter().map(|value| value * value).sum::<f64>().sqrt().max(1.0);
            let scale = f64::from(kind.norm()) / length;
            let bytes: Vec<u8> = values.iter().map(|value| kind.encoding().byte(value * scale)).collect();
            drawn.push(&bytes).expect("as many numbers");
        }
        drawn
    }

    /// `count` candidates: points of the images of the view, with the weights of rows that match there by chance, those of
    /// this image that the place does not explain. Heavier ones would mislead the estimator.
    pub(super) fn decoy_candidates<R: Rng + ?Sized>(
        &self,
        found: &FoundRows,
        count: usize,
        rng: &mut R,
    ) -> Vec<Candidate> {
        let points: Vec<u32> =
            found.images.iter().flat_map(|image| self.pack().image(*image).points()).copied().collect();
        let by_chance = found.rows.iter().filter(|row| !row.is_explained());
        let weights: Vec<MatchWeight> = by_chance.filter_map(|row| Some(row.candidate?.weight)).collect();
        let candidate = |rng: &mut R| Candidate {
            point: points.choose(rng).copied().unwrap_or(0),
            weight: weights.choose(rng).copied().unwrap_or(MatchWeight::LEAST),
        };
        (0..count).map(|_| candidate(rng)).collect()
    }
}
