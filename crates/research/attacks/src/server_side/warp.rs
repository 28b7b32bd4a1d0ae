//! A map image warped into the query, and the similarity of descriptors of the same point.

use veiloc_geometry::Pixel;
use veiloc_geometry::nalgebra::DMatrix;

use super::flow::{Flow, FlowVector, WarpedPoint};
use crate::features::{DecodedDescriptors, KnownImage};
use crate::prior::KnownSegment;

/// A keypoint of a map image that may match the hidden one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Candidate {
    /// Its position in the query, projected on the hidden keypoint's line.
    pub(super) pixel: Pixel,
    pub(super) weight: f64,
}

/// A map image with the descriptor similarities between its keypoints and the query's.
pub(super) struct MatchedMapImage<'a> {
    image: &'a KnownImage,
    /// `[map, query]`: cosines of descriptors.
    similarity: DMatrix<f32>,
    /// Mutual nearest neighbours of map and query keypoints, in the order of the query.
    pub(super) mutual: Vec<(usize, usize)>,
}

impl<'a> MatchedMapImage<'a> {
    pub(super) fn new(query: &DecodedDescriptors, image: &'a KnownImage) -> Self {
        let similarity = image.descriptors().cosines(query);
        let mutual = mutual(&similarity);
        Self { image, similarity, mutual }
    }
}

/// A map image with its keypoints warped into the query.
pub(super) struct MapView {
    /// `[map, query]`: cosines of descriptors.
    similarity: DMatrix<f32>,
    warped: Vec<WarpedPoint>,
    /// Pairs of known keypoints and map keypoints that are mutual nearest neighbours and consistent with the flow.
    agreeing: Vec<(usize, usize)>,
}

impl MapView {
    /// `None` when too few known keypoints match to estimate the flow.
    pub(super) fn new(
        matched: MatchedMapImage,
        known: &[Option<Pixel>],
        (width, height): (u32, u32),
        gate: f64,
    ) -> Option<Self> {
        let MatchedMapImage { image, similarity, mutual } = matched;
        let of_known = || mutual.iter().filter_map(|&(at, i)| known[i].map(|p| (at, i, p)));
        let vectors = of_known().map(|(at, _, p)| {
            let from = image.scaled(at, width, height).vector();
            FlowVector { from, moved: p.vector() - from }
        });
        let flow = Flow::new(vectors.collect())?;
        let indices = 0..image.keypoints().len();
        let warped: Vec<WarpedPoint> = indices.map(|at| flow.warp(image.scaled(at, width, height))).collect();
        let agrees = |at: usize, p: Pixel| warped[at].pixel.distance(&p) <= gate * warped[at].sigma;
        let agreeing = of_known().filter(|(at, _, p)| agrees(*at, *p)).map(|(at, i, _)| (at, i)).collect();
        Some(Self { similarity, warped, agreeing })
    }

    /// The candidates for keypoint `i` within `gate` standard deviations of a segment.
    pub(super) fn near(
        &self,
        i: usize,
        segment: &KnownSegment,
        gate: f64,
        similarities: &DescriptorLikelihood,
        into: &mut Vec<Candidate>,
    ) {
        let mut near = Vec::new();
        let mut least_other = f64::INFINITY;
        for (at, warped) in self.warped.iter().enumerate() {
            let position = warped.pixel.vector();
            let along = segment.direction.dot(&(position - segment.origin.vector()));
            let pixel = segment.at(along.clamp(segment.near, segment.far));
            let off = pixel.distance(&warped.pixel) / warped.sigma;
            if off <= gate {
                near.push((at, pixel, off));
            } else if off > 2.0 * gate {
                least_other = least_other.min(self.distance(at, i));
            }
        }
        if least_other.is_infinite() {
            return; // nothing to compare with
        }
        for (at, pixel, off) in near {
            let similar = similarities.likelihood_ratio((self.distance(at, i) / least_other).ln());
            into.push(Candidate { pixel, weight: similar * (-0.5 * off * off).exp() });
        }
    }

    /// Distance of the descriptors of map keypoint `at` and query keypoint `i`, never zero.
    fn distance(&self, at: usize, i: usize) -> f64 {
        (2.0 - 2.0 * f64::from(self.similarity[(at, i)])).max(1e-4).sqrt()
    }
}

fn mutual(similarity: &DMatrix<f32>) -> Vec<(usize, usize)> {
    let mut back = vec![(f32::NEG_INFINITY, 0); similarity.nrows()];
    let mut best = Vec::with_capacity(similarity.ncols());
    for (i, column) in similarity.column_iter().enumerate() {
        let mut own = (f32::NEG_INFINITY, 0);
        for (at, &s) in column.iter().enumerate() {
            if s > own.0 {
                own = (s, at);
            }
            if s > back[at].0 {
                back[at] = (s, i);
            }
        }
        best.push(own);
    }
    let pairs = best.iter().enumerate().filter(|(i, b)| b.0 > f32::NEG_INFINITY && back[b.1].1 == *i);
    pairs.map(|(i, b)| (b.1, i)).collect()
}

/// Likelihood of descriptor distances: two normal densities, for the same point in two images and for different
/// points.
///
/// Distances vary strongly between keypoints (a corner among a hundred similar ones, a letter on a sign), so the
/// statistic is the logarithm of the distance over the least distance among map keypoints that cannot be the same
/// point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct DescriptorLikelihood {
    same: (f64, f64),
    other: (f64, f64),
}

impl DescriptorLikelihood {
    /// Estimated from the known keypoints: a map keypoint that matches one and is warped onto it is the same point;
    /// one that is warped farther away than twice the `gate` is another point.
    pub(super) fn learn(views: &[MapView], known: &[Option<Pixel>], gate: f64) -> Self {
        let (mut same, mut other) = (Moments::default(), Moments::default());
        for view in views {
            let mut least_other = vec![f64::INFINITY; known.len()];
            for (i, pixel) in known.iter().enumerate().filter_map(|(i, k)| k.map(|k| (i, k))) {
                let far = |(_, w): &(usize, &WarpedPoint)| w.pixel.distance(&pixel) > 2.0 * gate * w.sigma;
                let others: Vec<f64> =
                    view.warped.iter().enumerate().filter(far).map(|(at, _)| view.distance(at, i)).collect();
                least_other[i] = others.iter().copied().fold(f64::INFINITY, f64::min);
                for d in others {
                    other.add((d / least_other[i]).ln());
                }
            }
            for &(at, i) in view.agreeing.iter().filter(|(_, i)| least_other[*i].is_finite()) {
                same.add((view.distance(at, i) / least_other[i]).ln());
            }
        }
        Self { same: same.normal(), other: other.normal() }
    }

    /// Likelihood ratio of the same point against different points. It decreases with the distance; where the tails
    /// of two normals with unequal widths would increase it again, it stays constant.
    fn likelihood_ratio(&self, log: f64) -> f64 {
        let x = log.min(self.other.0);
        let density =
            |x: f64, (mean, deviation): (f64, f64)| -0.5 * ((x - mean) / deviation).powi(2) - deviation.ln();
        let same = density(x.max(self.same.0), self.same);
        (same - density(x, self.other)).clamp(-20.0, 20.0).exp()
    }
}

#[derive(Default)]
struct Moments {
    count: f64,
    sum: f64,
    squares: f64,
}

impl Moments {
    fn add(&mut self, x: f64) {
        self.count += 1.0;
        self.sum += x;
        self.squares += x * x;
    }

    /// Mean and standard deviation; the latter has a lower bound so that no single value decides.
    fn normal(&self) -> (f64, f64) {
        let mean = self.sum / self.count.max(1.0);
        (mean, (self.squares / self.count.max(1.0) - mean * mean).max(0.0).sqrt().max(0.05))
    }
}
