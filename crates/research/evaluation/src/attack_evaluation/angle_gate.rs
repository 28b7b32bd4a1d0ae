//! Restriction of predicted neighbours by the angles of rows.
//!
//! A row of Dual Convergent Lines carries the angle of its line, and near keypoints of one anchor have similar
//! angles. The attack predicts neighbours; of those with the same anchor it keeps only rows with similar angles (the
//! **gate**).

use veiloc_attacks::{AttackError, NeighbourLists, Observation};
use veiloc_geometry::Anchor;

/// Share of an image's rows that pass the gate: rows with the same anchor and the most similar angles. On RedKitchen
/// half of the true neighbours with that anchor pass.
const GATE: f64 = 0.05;

/// The `k` likeliest entries of each list, `[N]`, likeliest first: half from the rows that pass the gate, half from
/// other anchors, for which angles carry no information about distance. A row without an anchor keeps its likeliest
/// entries.
pub(super) fn restricted_by_angle(
    ranked: &NeighbourLists,
    rows: &[Observation],
    k: usize,
) -> Result<NeighbourLists, AttackError> {
    let angles = angles(rows);
    let restricted = |i: usize| {
        let Some((anchor, angle)) = angles[i] else { return ranked.of(i).iter().copied().take(k).collect() };
        let gate = gate(&angles, i, anchor, angle);
        let (mut near, mut far) = (k.div_ceil(2), k / 2);
        let mut taken = |j: u32| {
            let is_own = angles[j as usize].is_some_and(|other| other.0 == anchor);
            if is_own && !gate.contains(&j) {
                return false;
            }
            let left = if is_own { &mut near } else { &mut far };
            let take = *left > 0;
            *left -= usize::from(take);
            take
        };
        ranked.of(i).iter().copied().filter(|j| taken(*j)).collect()
    };
    NeighbourLists::from_lists(&(0..ranked.len()).map(restricted).collect::<Vec<Vec<u32>>>())
}

/// The rows that pass the gate of row `own`, with this anchor and angle.
fn gate(angles: &[Option<(Anchor, f64)>], own: usize, anchor: Anchor, angle: f64) -> Vec<u32> {
    let pass = (GATE * angles.len() as f64).ceil() as usize;
    let others = angles.iter().enumerate().filter(|(j, _)| *j != own);
    let mut others: Vec<(f64, u32)> = others
        .filter_map(|(j, row)| row.filter(|r| r.0 == anchor).map(|r| (turn(r.1, angle), j as u32)))
        .collect();
    others.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    others.into_iter().take(pass).map(|other| other.1).collect()
}

/// Anchor and direction of each row, radians.
fn angles(rows: &[Observation]) -> Vec<Option<(Anchor, f64)>> {
    rows.iter()
        .map(|row| match row {
            Observation::Pencil(row) => Some((row.anchor, row.line.direction.y.atan2(row.line.direction.x))),
            _ => None,
        })
        .collect()
}

/// The angle between two directions.
fn turn(a: f64, b: f64) -> f64 {
    let d = (a - b).abs();
    d.min(std::f64::consts::TAU - d)
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use veiloc_datasets::problem_files::synthetic_image;
    use veiloc_obfuscation::audit::obfuscate_points;
    use veiloc_protocol::{AngleBits, DclLayout, Scheme};

    use super::*;

    #[test]
    fn half_of_the_neighbours_pass_the_gate_and_half_have_another_anchor() {
        let image = synthetic_image(400, 3);
        let sent = |scheme: Scheme| {
            let mut rng = ChaCha8Rng::seed_from_u64(5);
            let sent = obfuscate_points(
                &image.keypoints,
                image.width,
                image.height,
                &scheme,
                AngleBits::default(),
                &mut rng,
            );
            Observation::of_sent(&sent.expect("keypoints in the image"))
        };
        let ranked = NeighbourLists::nearest(&image.keypoints, 399);
        let rows = sent(Scheme::Dcl(DclLayout::VERTICAL));
        let found = restricted_by_angle(&ranked, &rows, 10).expect("lists of these rows");
        let angles = angles(&rows);
        for i in 0..400 {
            let (anchor, angle) = angles[i].expect("an anchor");
            let of = |j: u32| angles[j as usize].expect("an anchor");
            let (own, other): (Vec<u32>, Vec<u32>) = found.of(i).iter().partition(|j| of(**j).0 == anchor);
            assert_eq!((own.len(), other.len()), (5, 5), "row {i}");
            // 5 % of 400 rows pass: no predicted neighbour ranks beyond the twentieth angle.
            let mut turns: Vec<f64> = (0..400)
                .filter(|j| *j != i && of(*j as u32).0 == anchor)
                .map(|j| turn(of(j as u32).1, angle))
                .collect();
            turns.sort_by(f64::total_cmp);
            assert!(own.iter().all(|j| turn(of(*j).1, angle) <= turns[19]));
        }
        // A random line has no anchor: its likeliest neighbours are kept.
        let plain =
            restricted_by_angle(&ranked, &sent(Scheme::RandomLines), 10).expect("lists of these rows");
        assert_eq!(plain.of(7), &ranked.of(7)[..10]);
    }
}
