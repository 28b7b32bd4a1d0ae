//! Positions transferred from images that the attacker knows: a server holds the features of its map.
//!
//! Descriptors are sent without change, so a server can match them. Each match gives the position of a keypoint in a
//! map image; in a map image from a nearby viewpoint this is nearly its position in the query. The transferred
//! position, projected on the segment, is an attack by itself ([`TransferredPositions::projected`]), and keypoints near
//! each other in the map image are predicted neighbours ([`TransferredPositions::neighbours`]) for attacks that need
//! them.

use rayon::prelude::*;
use veiloc_geometry::Pixel;

use crate::error::AttackError;
use crate::features::{DecodedDescriptors, KnownImage};
use crate::neighbours::NeighbourLists;
use crate::observation::Observation;
use crate::prior::{KnownSegment, prior_only};

/// What map images reveal about a query.
#[derive(Debug, Clone, PartialEq)]
pub struct TransferredPositions {
    /// `[N]`: position of the best match of each keypoint, in pixels of the query; `None` without a map.
    pub positions: Vec<Option<Pixel>>,
    /// `[N]`: the keypoints whose mutual matches lie nearest to it in the same map image, nearest first.
    pub neighbours: NeighbourLists,
}

/// The best match of each query keypoint in one image, and which matches are mutual.
struct ImageMatches {
    /// `[N]`: similarity and map keypoint.
    best: Vec<(f32, usize)>,
    /// `[N]`.
    mutual: Vec<bool>,
}

/// Matches a query's descriptors against map images and transfers positions and neighbours.
///
/// Only the `images` images of `map` with the most mutual matches are used. `width`, `height`: the query image,
/// pixels. For each keypoint the most similar mutual match of all these images is used, or, without mutual matches,
/// the most similar match.
///
/// # Errors
/// [`AttackError::Dimensions`] when the descriptors of a map image have another dimension.
pub fn transfer(
    query: &DecodedDescriptors,
    map: &[KnownImage],
    (width, height): (u32, u32),
    images: usize,
    k: usize,
) -> Result<TransferredPositions, AttackError> {
    let expected = query.columns().nrows();
    if let Some(bad) = map.iter().find(|p| p.descriptors().columns().nrows() != expected) {
        return Err(AttackError::Dimensions { expected, found: bad.descriptors().columns().nrows() });
    }
    let mut matched: Vec<(&KnownImage, ImageMatches)> = map
        .par_iter()
        .filter(|p| !p.descriptors().is_empty())
        .map(|p| (p, ImageMatches::of(query, p.descriptors())))
        .collect();
    // A stable sort keeps the order of the map for equal counts.
    matched.sort_by_key(|(_, m)| std::cmp::Reverse(m.mutual.iter().filter(|m| **m).count()));
    matched.truncate(images);

    let anchors: Vec<Vec<(Pixel, u32)>> = matched.iter().map(|(p, m)| m.anchors(p)).collect();
    let found: Vec<(Option<Pixel>, Vec<u32>)> = (0..query.len())
        .into_par_iter()
        .map(|i| {
            let rank = |m: &ImageMatches| (m.mutual[i], m.best[i].0);
            let best = (0..matched.len()).reduce(|a, b| {
                let (x, y) = (rank(&matched[a].1), rank(&matched[b].1));
                if y.0.cmp(&x.0).then(y.1.total_cmp(&x.1)).is_gt() { b } else { a }
            });
            let Some(best) = best else { return (None, vec![]) };
            let (image, matches) = &matched[best];
            let at = matches.best[i].1;
            let near = nearest(image.keypoints()[at], &anchors[best], i, k);
            (Some(image.scaled(at, width, height)), near)
        })
        .collect();
    let (positions, lists): (Vec<_>, Vec<_>) = found.into_iter().unzip();
    Ok(TransferredPositions { positions, neighbours: NeighbourLists::from_lists(&lists)? })
}

impl TransferredPositions {
    /// The transferred positions projected on the segments; the prior-only baseline where there is no match.
    pub fn projected(&self, observations: &[Observation], width: u32, height: u32) -> Vec<Pixel> {
        let prior = prior_only(observations, width, height);
        let answer = |((o, prior), position): ((&Observation, Pixel), &Option<Pixel>)| {
            let Some(position) = position else { return prior };
            KnownSegment::of(o, width, height)
                .iter()
                .filter(|s| !s.is_empty())
                .map(|s| {
                    let t = s.direction.dot(&(position.vector() - s.origin.vector()));
                    s.at(t.clamp(s.near, s.far))
                })
                .min_by(|a, b| a.distance(position).total_cmp(&b.distance(position)))
                .unwrap_or(prior)
        };
        observations.iter().zip(prior).zip(&self.positions).map(answer).collect()
    }
}

impl ImageMatches {
    fn of(query: &DecodedDescriptors, map: &DecodedDescriptors) -> Self {
        // [map, query]: one column per query keypoint.
        let similarity = map.cosines(query);
        let mut back = vec![(f32::NEG_INFINITY, 0); map.len()];
        let mut best = Vec::with_capacity(query.len());
        for (i, column) in similarity.column_iter().enumerate() {
            let mut own = (f32::NEG_INFINITY, 0);
            for (j, &s) in column.iter().enumerate() {
                if s > own.0 {
                    own = (s, j);
                }
                if s > back[j].0 {
                    back[j] = (s, i);
                }
            }
            best.push(own);
        }
        let mutual = best.iter().enumerate().map(|(i, b)| back[b.1].1 == i).collect();
        Self { best, mutual }
    }

    /// Mutual matches: position in the map image and index of the query keypoint.
    fn anchors(&self, image: &KnownImage) -> Vec<(Pixel, u32)> {
        let all = self.best.iter().zip(&self.mutual).enumerate();
        all.filter(|(_, (_, mutual))| **mutual)
            .map(|(i, (best, _))| (image.keypoints()[best.1], i as u32))
            .collect()
    }
}

/// The `k` entries nearest to a position, without `i`.
fn nearest(at: Pixel, anchors: &[(Pixel, u32)], i: usize, k: usize) -> Vec<u32> {
    let mut all: Vec<(f64, u32)> =
        anchors.iter().filter(|a| a.1 as usize != i).map(|a| (a.0.distance(&at), a.1)).collect();
    all.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    all.truncate(k);
    all.into_iter().map(|a| a.1).collect()
}
