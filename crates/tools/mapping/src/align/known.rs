//! Known positions of images or points, and which of them repeat others.

use veiloc_geometry::Geodetic;
use veiloc_geometry::nalgebra::Vector3;
use veiloc_map::GravityDirection;

use super::fit::closed_form;

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
/// apart. Phones write their last fix again and again where they have no new one.
pub(super) fn counted(positions: &[KnownPosition]) -> Vec<bool> {
    let mut counted = vec![true; positions.len()];
    let bits = |p: &KnownPosition| {
        [p.known.x, p.known.y, if p.has_height { p.known.z } else { 0.0 }].map(f64::to_bits)
    };
    let mut seen = std::collections::HashSet::new();
    for (counted, position) in counted.iter_mut().zip(positions) {
        *counted = seen.insert(bits(position));
    }
    loop {
        let left: Vec<usize> = (0..positions.len()).filter(|&i| counted[i]).collect();
        let Some(together) = together(positions, &left) else { return counted };
        let first = together.iter().copied().min();
        for i in together {
            counted[i] = Some(i) == first;
        }
    }
}

/// The group of positions that are most together, if the map has them apart.
fn together(positions: &[KnownPosition], left: &[usize]) -> Option<Vec<usize>> {
    let count = MIN_REPEATED.max((NEIGHBOURS * left.len() as f64).ceil() as usize);
    if left.len() < 2 * count {
        return None;
    }
    let ground = |i: usize| Vector3::new(positions[i].known.x, positions[i].known.y, 0.0);
    let in_map = |i: usize| positions[i].in_map;
    let [all_known, all_in_map] =
        [spread(left.iter().map(|&i| ground(i))), spread(left.iter().map(|&i| in_map(i)))];
    let nearest = |&i: &usize| {
        let mut others = left.to_vec();
        others.sort_by(|&a, &b| (ground(a) - ground(i)).norm().total_cmp(&(ground(b) - ground(i)).norm()));
        let group = &others[..count];
        let known = spread(group.iter().map(|&j| ground(j))) / all_known;
        let share = known / (spread(group.iter().map(|&j| in_map(j))) / all_in_map);
        (share, i, others)
    };
    let step = left.len().div_ceil(MAX_CENTERS);
    let (share, center, others) =
        left.iter().step_by(step).map(nearest).min_by(|a, b| a.0.total_cmp(&b.0))?;
    if share.is_nan() || share >= MIN_SPREAD {
        return None;
    }
    // Wrong positions far away make right ones look together, too; these have the shape of the map.
    let group: Vec<_> = others[..count].iter().map(|&j| (in_map(j), positions[j].known)).collect();
    if shape_shared(&group) > MAX_SHAPE_SHARED {
        return None;
    }
    let reach = 3.0 * spread(others[..count].iter().map(|&j| ground(j)));
    Some(others.into_iter().filter(|&j| (ground(j) - ground(center)).norm() <= reach).collect())
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
