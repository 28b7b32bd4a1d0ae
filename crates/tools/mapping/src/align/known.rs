//! Known positions of images or points, and which of them repeat others.

use std::collections::HashSet;

use veiloc_geometry::Geodetic;
use veiloc_geometry::nalgebra::Vector3;
use veiloc_map::GravityDirection;

use super::fit::{Pair, closed_form};

/// A position in a map, and where it is known to be.
#[derive(Debug, Clone, PartialEq)]
pub struct KnownPosition {
    /// What it is, for people: the name of an image, or the line of a file.
    pub name: String,
    /// The position in the map, map units.
    pub in_map: Vector3<f64>,
    /// The position in the new coordinate frame.
    pub known: Vector3<f64>,
    /// Whether `z` of [`Self::known`] is known; it is ignored otherwise.
    pub has_height: bool,
    /// What the source says of its error: standard deviation along each axis, new units; 0 if it says nothing.
    pub sd: f64,
}

/// Known positions of a map, and their coordinate frame.
#[derive(Debug, Clone, Default)]
pub struct KnownPositions {
    /// The positions, in the order of their source.
    pub positions: Vec<KnownPosition>,
    /// The direction of gravity in the new coordinate frame, if known.
    pub down: Option<GravityDirection>,
    /// Where the origin of the new coordinate frame is on earth, of GPS.
    pub origin: Option<Geodetic>,
    /// Whether heights of [`Self::origin`] are known.
    pub has_heights: bool,
    /// Whether the new unit is the metre.
    pub is_metric: bool,
    /// Step of the grid that the positions lie on, such as whole seconds, new units; 0 without one.
    pub grid: f64,
    /// Whether the order of the positions is that of a list which may be shifted against the names.
    pub is_list: bool,
    /// What was left out, for people.
    pub remarks: Vec<String>,
}

/// Fewest positions that can be alike by a fault.
const MIN_REPEATED: usize = 5;
/// Share of the positions whose spread is compared with that of all.
const NEIGHBOURS: f64 = 0.2;
/// Share of the variance of a group that a similarity explains, from which on the group has the shape of the map.
const MAX_SHAPE_SHARED: f64 = 0.7;
/// Positions about which others are sought, at most.
const MAX_CENTERS: usize = 300;
/// Spread of known positions relative to that in the map, from which on they are not the positions of these images.
const MIN_SPREAD: f64 = 0.2;

/// Which positions count, `[N]`: one of each group of positions that are equal, or that are together where the map has them
/// apart. Phones write their last fix again and again where they have no new one. If `z` is up, positions that are together on
/// the ground are together.
pub(super) fn counted(pairs: &[Pair], has_vertical: bool) -> Vec<bool> {
    let mut seen = HashSet::new();
    let bits =
        |pair: &Pair| [pair.y.x, pair.y.y, if pair.has_height { pair.y.z } else { 0.0 }].map(f64::to_bits);
    let mut counted: Vec<bool> = pairs.iter().map(|pair| seen.insert(bits(pair))).collect();
    loop {
        let left: Vec<usize> = (0..pairs.len()).filter(|&i| counted[i]).collect();
        let Some(together) = together(pairs, &left, has_vertical) else { return counted };
        let first = together.iter().copied().min();
        for i in together {
            counted[i] = Some(i) == first;
        }
    }
}

/// The group of positions that are most together, if the map has them apart.
fn together(pairs: &[Pair], left: &[usize], has_vertical: bool) -> Option<Vec<usize>> {
    let count = MIN_REPEATED.max((NEIGHBOURS * left.len() as f64).ceil() as usize);
    if left.len() < 2 * count {
        return None;
    }
    let known = |i: usize| {
        let y = &pairs[i].y;
        Vector3::new(y.x, y.y, if has_vertical { 0.0 } else { y.z })
    };
    let spreads =
        |of: &[usize]| [spread(of.iter().map(|&i| known(i))), spread(of.iter().map(|&i| pairs[i].x))];
    let [all_known, all_in_map] = spreads(left);
    let nearest = |&i: &usize| {
        let distance = |j: usize| (known(j) - known(i)).norm();
        let mut others = left.to_vec();
        others.sort_by(|&a, &b| distance(a).total_cmp(&distance(b)));
        let [known, in_map] = spreads(&others[..count]);
        ((known / all_known) / (in_map / all_in_map), others)
    };
    let step = left.len().div_ceil(MAX_CENTERS);
    let (share, others) = left.iter().step_by(step).map(nearest).min_by(|a, b| a.0.total_cmp(&b.0))?;
    if share.is_nan() || share >= MIN_SPREAD {
        return None;
    }
    let (group, reach) = (&others[..count], 3.0 * spreads(&others[..count])[0]);
    // Wrong positions far away make right ones look together, too; these have the shape of the map.
    if shape_shared(&group.iter().map(|&j| (pairs[j].x, pairs[j].y)).collect::<Vec<_>>()) > MAX_SHAPE_SHARED {
        return None;
    }
    // About their mean, not about the one from which they were found: that may be beside them, and alone.
    let middle = group.iter().map(|&j| known(j)).sum::<Vector3<f64>>() / count as f64;
    Some(others.iter().copied().filter(|&j| (known(j) - middle).norm() <= reach).collect())
}

/// Share of the variance of known positions that a similarity of those in the map explains.
fn shape_shared(group: &[(Vector3<f64>, Vector3<f64>)]) -> f64 {
    let Some(found) = closed_form(group) else { return 0.0 };
    let left: f64 = group.iter().map(|(x, y)| (found.transform(x) - y).norm_squared()).sum();
    1.0 - left / (group.len() as f64 * spread(group.iter().map(|(_, y)| *y)).powi(2))
}

/// Root mean square distance from the mean.
pub(super) fn spread(positions: impl Iterator<Item = Vector3<f64>> + Clone) -> f64 {
    let count = positions.clone().count().max(1) as f64;
    let mean = positions.clone().sum::<Vector3<f64>>() / count;
    (positions.map(|p| (p - mean).norm_squared()).sum::<f64>() / count).sqrt()
}

/// The step of the grid that all numbers are on, of these; 0 without one.
pub(super) fn grid_step(numbers: &[f64], steps: &[f64]) -> f64 {
    let is_on = |step: f64| numbers.iter().all(|x| (x / step - (x / step).round()).abs() < OFF_GRID);
    steps.iter().copied().find(|step| numbers.len() >= MIN_REPEATED && is_on(*step)).unwrap_or(0.0)
}

/// Distance from a grid in steps, of numbers on it: they went through text, or through degrees, minutes and seconds.
const OFF_GRID: f64 = 1e-3;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grids_are_seen_in_the_numbers() {
        let steps = [1.0 / 3600.0, 1e-4, 1e-5];
        let seconds: Vec<f64> = (0..8).map(|i| 47.0 + 22.0 / 60.0 + f64::from(i * i) / 3600.0).collect();
        assert_eq!(grid_step(&seconds, &steps), 1.0 / 3600.0);
        let decimals: Vec<f64> = (0..8).map(|i| 47.3769 + f64::from(i * 7) * 1e-5).collect();
        assert_eq!(grid_step(&decimals, &steps), 1e-5);
        let free: Vec<f64> = (0..8).map(|i| 47.3769 + f64::from(i).sin() * 1e-4).collect();
        assert_eq!(grid_step(&free, &steps), 0.0);
        assert_eq!(grid_step(&seconds[..3], &steps), 0.0, "too few to tell");
    }
}
