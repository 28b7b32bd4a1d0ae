//! The paper's iterative server-side attack: estimated positions are used as known ones in later steps.

use veiloc_geometry::Pixel;
use veiloc_geometry::nalgebra::Vector2;

use super::{check, known};
use crate::error::AttackError;
use crate::geometry_recovery::{ClosedFormOptions, closed_form};
use crate::neighbours::NeighbourLists;
use crate::observation::Observation;
use crate::prior::KnownSegment;

/// Recovers keypoints in the order of how many of their neighbours are known: `[N]` positions, pixels.
///
/// Each step takes all keypoints with the largest number of known neighbours, moves each to the point of its line
/// with the smallest sum of squared distances to them (Eq. 3 with the distance to points: the foot of the
/// perpendicular from their mean), and adds them to the known ones. Neighbours that are lines are ignored, since the
/// paper "strictly filters outliers". Of two candidate lines the one with the smaller sum is used.
///
/// Keypoints without known neighbours that remain at the end are recovered from lines alone, as by [`closed_form`].
///
/// # Errors
/// [`AttackError::ListCount`] when the numbers of neighbour lists and observations differ,
/// [`AttackError::NoNeighbours`] when no keypoint has any.
pub fn iterative(
    observations: &[Observation],
    neighbours: &NeighbourLists,
    width: u32,
    height: u32,
) -> Result<Vec<Pixel>, AttackError> {
    check(observations, neighbours)?;
    let mut at = known(observations);
    // Repeated entries are counted once, and the keypoint itself is ignored.
    let lists: Vec<Vec<u32>> = (0..neighbours.len())
        .map(|i| {
            let mut list: Vec<u32> = neighbours.of(i).iter().copied().filter(|j| *j as usize != i).collect();
            list.sort_unstable();
            list.dedup();
            list
        })
        .collect();
    let mut named_by: Vec<Vec<usize>> = vec![Vec::new(); lists.len()];
    for (i, list) in lists.iter().enumerate() {
        for &j in list {
            named_by[j as usize].push(i);
        }
    }
    let mut support: Vec<usize> =
        lists.iter().map(|list| list.iter().filter(|j| at[**j as usize].is_some()).count()).collect();
    loop {
        let open = || (0..at.len()).filter(|i| at[*i].is_none());
        let most = open().map(|i| support[i]).max().unwrap_or(0);
        if most == 0 {
            break;
        }
        let step: Vec<(usize, Pixel)> = open()
            .filter(|i| support[*i] == most)
            .map(|i| {
                let points = lists[i].iter().filter_map(|j| at[*j as usize]);
                (i, nearest_to(&observations[i], points, width, height))
            })
            .collect();
        for (i, pixel) in step {
            at[i] = Some(pixel);
            named_by[i].iter().for_each(|k| support[*k] += 1);
        }
    }
    if at.iter().any(Option::is_none) {
        let lines = closed_form(observations, neighbours, width, height, &ClosedFormOptions::default())?;
        at.iter_mut().zip(lines).for_each(|(at, line)| *at = Some(at.unwrap_or(line.pixel)));
    }
    Ok(at.into_iter().flatten().collect())
}

/// The point of the observation's line with the smallest sum of squared distances to these points (at least one).
fn nearest_to(
    observation: &Observation,
    points: impl Iterator<Item = Pixel>,
    width: u32,
    height: u32,
) -> Pixel {
    let (sum, count) = points.fold((Vector2::zeros(), 0.0), |(s, n), p| (s + p.vector(), n + 1.0));
    let mean = sum / count;
    let feet = KnownSegment::of(observation, width, height).into_iter().map(|s| {
        let foot = s.at(s.direction.dot(&(mean - s.origin.vector())));
        ((foot.vector() - mean).norm(), foot)
    });
    // The sums differ from the squared distance to the mean by a constant.
    feet.min_by(|a, b| a.0.total_cmp(&b.0)).map_or(Pixel::new(mean.x, mean.y), |f| f.1)
}
