//! Chooses the keypoints of a point that stay: those whose descriptors represent all best.

use std::collections::BTreeMap;

use rayon::prelude::*;
use veiloc_map::{MapModel, Observation, PointId};

use crate::progress::Progress;

/// Maximum number of compared keypoints per track: a track of a thousand would need a million distances, and an evenly
/// spaced sample represents it.
const MAX_COMPARED: usize = 48;

/// Returns up to `limit` keypoints of each chosen point, ascending.
///
/// Greedy k-medoids: the first has the smallest sum of squared distances to all others; each further one reduces the
/// sum of squared distances to the nearest kept one the most.
pub(super) fn represent(
    model: &MapModel,
    chosen: &[PointId],
    limit: usize,
    progress: &dyn Progress,
) -> BTreeMap<PointId, Vec<Observation>> {
    progress.start("Choosing descriptors", chosen.len());
    let representatives = chosen
        .par_iter()
        .map(|id| {
            let track = &model.points[id.index()].track;
            let representatives = if track.len() <= limit {
                track.clone()
            } else {
                medoids(model, &evenly_spaced(track), limit)
            };
            progress.advance(1);
            (*id, representatives)
        })
        .collect();
    progress.finish();
    representatives
}

fn medoids(model: &MapModel, track: &[Observation], limit: usize) -> Vec<Observation> {
    let rows: Vec<Vec<i16>> = track
        .iter()
        .map(|o| model.images[o.image as usize].descriptors.view().values(o.keypoint as usize).collect())
        .collect();
    let distance = |a: &[i16], b: &[i16]| -> i64 {
        a.iter().zip(b).map(|(a, b)| (i64::from(*a) - i64::from(*b)).pow(2)).sum()
    };
    let distances: Vec<Vec<i64>> =
        rows.iter().map(|a| rows.iter().map(|b| distance(a, b)).collect()).collect();
    let mut nearest = vec![i64::MAX; rows.len()];
    let mut selected: Vec<usize> = Vec::with_capacity(limit);
    while selected.len() < limit {
        let left = |candidate: usize| -> i128 {
            nearest.iter().zip(&distances[candidate]).map(|(near, d)| i128::from(*near.min(d))).sum()
        };
        let free = (0..rows.len()).filter(|i| !selected.contains(i));
        let Some(best) = free.min_by_key(|i| (left(*i), *i)) else { break };
        for (near, d) in nearest.iter_mut().zip(&distances[best]) {
            *near = (*near).min(*d);
        }
        selected.push(best);
    }
    selected.sort_unstable();
    selected.into_iter().map(|i| track[i]).collect()
}

/// Returns up to [`MAX_COMPARED`] keypoints of a track, evenly spaced.
fn evenly_spaced(track: &[Observation]) -> Vec<Observation> {
    let count = track.len().min(MAX_COMPARED);
    (0..count).map(|i| track[i * track.len() / count]).collect()
}
