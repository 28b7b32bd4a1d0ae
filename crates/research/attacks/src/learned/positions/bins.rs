//! The possible positions of a keypoint, divided into bins with the exact probabilities of `crate::expected_positions`.
//!
//! Each candidate of an observation (a span of a line of a pencil, or one of two lines) is divided into bins of
//! equal prior probability; the number of bins of a candidate is proportional to its share, at least one. A bin is
//! represented by its expected position, so the mean over all bins equals the prior-only baseline exactly.

use crate::{KnownSegment, Observation};
use veiloc_geometry::Pixel;

/// The bins of all rows of an image.
#[derive(Debug, Clone)]
pub(super) struct Bins {
    /// `[N + 1]`: row `i` has the bins `offsets[i]..offsets[i + 1]`, at least one.
    offsets: Vec<usize>,
    /// Mean position of each bin, pixels.
    pub(super) positions: Vec<Pixel>,
    /// Log prior probability of each bin within its row.
    pub(super) log_prior: Vec<f32>,
    pieces: Vec<Vec<Piece>>,
}

/// A candidate and its bins.
#[derive(Debug, Clone)]
struct Piece {
    segment: KnownSegment,
    first: usize,
    count: usize,
}

impl Bins {
    /// About `count` bins per row; one bin if the line misses the image or the position is known.
    pub(super) fn of(observations: &[Observation], [width, height]: [u32; 2], count: usize) -> Self {
        let mut bins =
            Self { offsets: vec![0], positions: Vec::new(), log_prior: Vec::new(), pieces: Vec::new() };
        for observation in observations {
            let candidates = KnownSegment::of(observation, width, height);
            let whole: f64 = candidates.iter().map(|s| s.share).sum();
            let pieces = candidates.into_iter().map(|segment| bins.cut(segment, whole, count)).collect();
            bins.pieces.push(pieces);
            bins.offsets.push(bins.positions.len());
        }
        bins
    }

    fn cut(&mut self, segment: KnownSegment, whole: f64, count: usize) -> Piece {
        let first = self.positions.len();
        let share = segment.share / whole;
        let extended = !segment.is_empty() && segment.far > segment.near;
        let count = if extended { ((share * count as f64).round() as usize).max(1) } else { 1 };
        let mut near = segment.near;
        for k in 0..count {
            let far =
                if k + 1 == count { segment.far } else { quantile(&segment, (k + 1) as f64 / count as f64) };
            let part = KnownSegment { near, far, ..segment };
            self.positions.push(segment.at(if extended { part.expected() } else { segment.expected() }));
            self.log_prior.push((share / count as f64).max(f64::MIN_POSITIVE).ln() as f32);
            near = far;
        }
        Piece { segment, first, count }
    }

    /// Number of rows.
    pub(super) fn rows(&self) -> usize {
        self.offsets.len() - 1
    }

    /// The bins of a row.
    pub(super) fn of_row(&self, row: usize) -> std::ops::Range<usize> {
        self.offsets[row]..self.offsets[row + 1]
    }

    /// The bin of a row that holds, or is nearest to, this position; `None` if the row has one bin only.
    pub(super) fn bin_of(&self, row: usize, position: Pixel) -> Option<usize> {
        if self.of_row(row).len() < 2 {
            return None;
        }
        let along = |piece: &Piece| {
            let s = &piece.segment;
            s.direction.dot(&(position.vector() - s.origin.vector())).clamp(s.near, s.far)
        };
        let open = self.pieces[row].iter().filter(|p| !p.segment.is_empty());
        let distance = |p: &Piece| p.segment.at(along(p)).distance(&position);
        let piece = open.min_by(|a, b| distance(a).total_cmp(&distance(b)))?;
        let s = &piece.segment;
        let share = mass(s, along(piece)) / mass(s, s.far);
        // Written so that NaN, from a candidate of zero length, gives the first bin.
        let bin = if share > 0.0 { (share * piece.count as f64) as usize } else { 0 };
        Some(piece.first + bin.min(piece.count - 1))
    }
}

/// Prior probability of the segment before `t`, up to one factor.
fn mass(segment: &KnownSegment, t: f64) -> f64 {
    (t - segment.near) * segment.likelihood(f64::midpoint(segment.near, t))
}

/// The `t` with this share of the prior probability before it: the likelihood is linear, its integral quadratic.
fn quantile(segment: &KnownSegment, share: f64) -> f64 {
    let (first, growth) = (segment.likelihood(segment.near), segment.growth[1]);
    let wanted = share * mass(segment, segment.far);
    let root = (first * first + 2.0 * growth * wanted).max(0.0).sqrt();
    let t = segment.near + 2.0 * wanted / (first + root);
    // For a likelihood that is zero everywhere: uniform.
    let even = segment.near + share * (segment.far - segment.near);
    if t.is_finite() { t.clamp(segment.near, segment.far) } else { even }
}

#[cfg(test)]
mod tests {
    use crate::{expected_positions, lift};
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use veiloc_geometry::Pencils;
    use veiloc_protocol::{AngleBits, Scheme};

    use super::*;

    fn schemes() -> [Scheme; 4] {
        let stripes = "dcl:axis=138:sectors=24:anchors=-0.62/-0.61+0.92/-1.16";
        ["random-lines", "coordinate-permutation", "dcl:paper", stripes].map(|s| s.parse().expect("a scheme"))
    }

    #[test]
    fn bin_mean_equals_prior_and_bin_holds_keypoint() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let keypoints: Vec<Pixel> = (0..400)
            .map(|_| Pixel::new(rng.random_range(1.0..639.0), rng.random_range(1.0..479.0)))
            .collect();
        for scheme in schemes() {
            let sent = veiloc_obfuscation::audit::obfuscate_points(
                &keypoints,
                640,
                480,
                &scheme,
                AngleBits::default(),
                &mut rng,
            );
            let sent = Observation::of_sent(&sent.expect("inside"));
            let bins = Bins::of(&sent, [640, 480], 64);
            let expected = expected_positions(&sent, 640, 480);
            let mut far = 0;
            for (i, keypoint) in keypoints.iter().enumerate() {
                let all = bins.of_row(i);
                let (mut whole, mut mean) = (0.0, [0.0, 0.0]);
                for b in all.clone() {
                    let share = f64::from(bins.log_prior[b]).exp();
                    whole += share;
                    mean[0] += share * bins.positions[b].u;
                    mean[1] += share * bins.positions[b].v;
                }
                assert!((whole - 1.0).abs() < 1e-5, "{scheme}: {whole}");
                let mean = Pixel::new(mean[0] / whole, mean[1] / whole);
                assert!(mean.distance(&expected[i]) < 1e-3, "{scheme}: {mean:?} {:?}", expected[i]);
                let bin = bins.bin_of(i, *keypoint).expect("a line");
                let nearest = |b: usize| bins.positions[b].distance(keypoint);
                let best = all.map(nearest).fold(f64::MAX, f64::min);
                far += usize::from(nearest(bin) > best + 12.0);
            }
            // Between two bins of unequal length the nearer centre may be that of the other bin.
            assert!(far < 20, "{scheme}: {far}");
        }
    }

    #[test]
    fn wedge_bins_have_equal_probability() {
        let pencils = Pencils::paper(640, 480);
        let mut rng = ChaCha8Rng::seed_from_u64(8);
        // All on nearly one line, uniform over its wedge: the distance is the square root of a uniform number.
        let anchor = pencils.anchor_of(Pixel::new(100.0, 400.0));
        let row = Observation::anchored(&pencils, anchor, pencils.angle_of(anchor, Pixel::new(100.0, 400.0)));
        let bins = Bins::of(&[row], [640, 480], 10);
        let segment = KnownSegment::of(&row, 640, 480)[0];
        let mut full = [0; 10];
        for _ in 0..20_000 {
            let (a, b) = (segment.near.powi(2), segment.far.powi(2));
            let t = (a + (b - a) * rng.random::<f64>()).sqrt();
            full[bins.bin_of(0, segment.at(t)).expect("a line")] += 1;
        }
        assert!(full.iter().all(|n| (1800..2200).contains(n)), "{full:?}");
        // A known position has one bin, and there is nothing to predict.
        let known = lift::dual_convergent(&[], &pencils);
        assert_eq!(Bins::of(&known, [640, 480], 64).rows(), 0);
        let bins = Bins::of(&[Observation::Known(Pixel::new(3.0, 4.0))], [640, 480], 64);
        assert_eq!((bins.positions.len(), bins.bin_of(0, Pixel::new(3.0, 4.0))), (1, None));
        assert_eq!(bins.positions[0], Pixel::new(3.0, 4.0));
    }
}
