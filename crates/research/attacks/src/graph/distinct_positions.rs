//! Rows with the same keypoint position: a detector that finds several orientations at one position makes a row for
//! each, and all of these rows are sent with the same line.
//!
//! As separate keypoints they fill each other's neighbour lists, so a list carries almost no information about the
//! surroundings; merged, they are one keypoint whose list reaches as far as other lists. Equal lines alone are not
//! sufficient (angles are rounded, and large images repeat some by chance), so rows are merged only when their
//! neighbour lists agree too.

use std::collections::HashMap;

use crate::neighbours::NeighbourLists;
use crate::observation::Observation;

/// Smallest share of common neighbours (Jaccard's index, each row counted on its own list) of two rows with one
/// position.
const COMMON: f64 = 0.85;

/// Groups of rows with the same position.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct DistinctPositions {
    /// `[rows]`: the position index of each row.
    pub(super) of: Vec<u32>,
    /// `[positions]`: the first row of each position.
    pub(super) first: Vec<u32>,
}

impl DistinctPositions {
    pub(super) fn of(observations: &[Observation], lists: &NeighbourLists) -> Self {
        let mut same_line: HashMap<[u64; 5], Vec<u32>> = HashMap::new();
        let mut positions = Self { of: Vec::with_capacity(observations.len()), first: Vec::new() };
        for (i, observation) in observations.iter().enumerate() {
            let known = same_line.entry(bits(observation)).or_default();
            let here = known
                .iter()
                .copied()
                .find(|&p| same_position(lists, i, positions.first[p as usize] as usize));
            let position = here.unwrap_or_else(|| {
                let new = positions.first.len() as u32;
                positions.first.push(i as u32);
                known.push(new);
                new
            });
            positions.of.push(position);
        }
        positions
    }

    /// Whether all rows have different positions.
    pub(super) fn all_distinct(&self) -> bool {
        self.first.len() == self.of.len()
    }

    /// Neighbour lists of positions: the union of the lists of their rows, without the position itself.
    pub(super) fn lists(&self, lists: &NeighbourLists) -> NeighbourLists {
        let mut joined: Vec<Vec<u32>> = vec![Vec::new(); self.first.len()];
        for (i, &position) in self.of.iter().enumerate() {
            let listed = lists.of(i).iter().map(|&j| self.of[j as usize]);
            joined[position as usize].extend(listed.filter(|&p| p != position));
        }
        for list in &mut joined {
            list.sort_unstable();
            list.dedup();
        }
        NeighbourLists::from_lists(&joined).expect("positions are numbered from zero")
    }

    /// The values of each position's first row.
    pub(super) fn first_of<T: Copy>(&self, rows: &[T]) -> Vec<T> {
        self.first.iter().map(|&i| rows[i as usize]).collect()
    }

    /// The values of each position, copied to its rows.
    pub(super) fn to_rows<T: Copy>(&self, positions: &[T]) -> Vec<T> {
        self.of.iter().map(|&p| positions[p as usize]).collect()
    }
}

/// A key that is equal only for equal observations.
fn bits(observation: &Observation) -> [u64; 5] {
    let [a, b] = observation.lines().map(|line| {
        line.map_or([0; 2], |l| {
            let at = |u: f64, v: f64| l.signed_distance(veiloc_geometry::Pixel::new(u, v));
            [at(0.0, 0.0).to_bits(), at(1.0, 0.0).to_bits()]
        })
    });
    let extra = match *observation {
        // Rows with one line have the same angle, so all other values agree too.
        Observation::Pencil(row) => {
            let (origin, direction) = (row.line.origin, row.line.direction);
            let anchor = 8 + row.anchor.index() as u64;
            return [
                anchor,
                origin.u.to_bits(),
                origin.v.to_bits(),
                direction.x.to_bits(),
                direction.y.to_bits(),
            ];
        }
        Observation::Known(pixel) => return [2, pixel.u.to_bits(), pixel.v.to_bits(), 0, 0],
        Observation::Line(_) => 3,
        Observation::EitherLine(_) => 4,
    };
    [extra, a[0], a[1], b[0], b[1]]
}

fn same_position(lists: &NeighbourLists, i: usize, j: usize) -> bool {
    let on = |list: usize, entry: usize| entry == list || lists.of(list).contains(&(entry as u32));
    if !(on(i, j) && on(j, i)) {
        return false;
    }
    // The two rows themselves are common.
    let others = |list: usize| lists.of(list).iter().filter(move |&&e| e as usize != i && e as usize != j);
    let common = 2 + others(i).filter(|e| lists.of(j).contains(e)).count();
    let all = 2 + others(i).count() + others(j).count() - (common - 2);
    common as f64 >= COMMON * all as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use veiloc_geometry::{Pencils, Pixel};

    #[test]
    fn rows_with_one_position_are_merged_and_equal_lines_of_other_keypoints_are_not() {
        let pencils = Pencils::paper(640, 480);
        // Two corners of a strip of keypoints; 3 and 4 repeat 0; 20 lies on the line of 0, farther out.
        let mut pixels: Vec<Pixel> = (0..40).map(|i| Pixel::new(20.0 + 15.0 * f64::from(i), 100.0)).collect();
        pixels[3] = pixels[0];
        pixels[4] = pixels[0];
        let anchor = pencils.anchor_of(pixels[0]);
        let line = |p: Pixel| {
            Observation::anchored(&pencils, pencils.anchor_of(p), pencils.angle_of(pencils.anchor_of(p), p))
        };
        let lists = NeighbourLists::nearest(&pixels, 6);
        let mut sent: Vec<Observation> = pixels.iter().map(|&p| line(p)).collect();
        sent[10] = sent[0];
        assert_eq!(pencils.anchor_of(pixels[10]), anchor);
        let positions = DistinctPositions::of(&sent, &lists);
        assert_eq!(positions.first.len(), 38);
        assert_eq!((positions.of[3], positions.of[4]), (positions.of[0], positions.of[0]));
        assert_ne!(
            positions.of[10], positions.of[0],
            "an equal line with other neighbours is another position"
        );
        let joined = positions.lists(&lists);
        assert_eq!(joined.len(), 38);
        assert!((0..38).all(|p| !joined.of(p).contains(&(p as u32))));
        assert_eq!(
            positions.to_rows(&positions.first),
            (0..40).map(|i| if i == 3 || i == 4 { 0 } else { i }).collect::<Vec<u32>>()
        );
        let apart = DistinctPositions::of(&sent[..3], &NeighbourLists::nearest(&pixels[..3], 2));
        assert!(apart.all_distinct());
    }
}
