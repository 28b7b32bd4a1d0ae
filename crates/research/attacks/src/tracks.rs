//! Matches between two queries by descriptors alone.

use crate::error::AttackError;
use crate::features::DecodedDescriptors;

/// Mutual nearest neighbours with a ratio test: for each descriptor of `from` its match in `to`, if there is one:
/// `[N]` of `from`. `ratio`: largest ratio of the distances to the nearest and to the second nearest, 0 to 1.
///
/// # Errors
/// [`AttackError::Dimensions`] when the descriptors have different dimensions.
pub fn mutual_matches(
    from: &DecodedDescriptors,
    to: &DecodedDescriptors,
    ratio: f64,
) -> Result<Vec<Option<usize>>, AttackError> {
    let (expected, found) = (from.columns().nrows(), to.columns().nrows());
    if expected != found {
        return Err(AttackError::Dimensions { expected, found });
    }
    // [to, from]: one column per descriptor of `from`.
    let similarity = to.cosines(from);
    let mut back = vec![(f32::NEG_INFINITY, 0); to.len()];
    let mut best = Vec::with_capacity(from.len());
    for (i, column) in similarity.column_iter().enumerate() {
        let mut own = (f32::NEG_INFINITY, 0);
        let mut second = f32::NEG_INFINITY;
        for (j, &s) in column.iter().enumerate() {
            if s > own.0 {
                (second, own) = (own.0, (s, j));
            } else {
                second = second.max(s);
            }
            if s > back[j].0 {
                back[j] = (s, i);
            }
        }
        best.push((own, second));
    }
    // For unit vectors.
    let distance = |s: f32| (2.0 - 2.0 * f64::from(s)).max(0.0).sqrt();
    let nearer = |own: f32, second: f32| !second.is_finite() || distance(own) < ratio * distance(second);
    let answer = |(i, (own, second)): (usize, ((f32, usize), f32))| {
        (own.0.is_finite() && back[own.1].1 == i && nearer(own.0, second)).then_some(own.1)
    };
    Ok(best.into_iter().enumerate().map(answer).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn matches_are_mutual_and_pass_ratio_test() {
        let of = |rows: &[[u8; 3]]| DecodedDescriptors::new(rows.as_flattened(), 3).expect("whole");
        let from = of(&[[255, 0, 0], [0, 255, 0], [250, 20, 0], [0, 0, 255]]);
        let to = of(&[[0, 255, 10], [255, 2, 0], [0, 60, 255], [0, 55, 255]]);
        // The third prefers a descriptor that the first matches better; the fourth has two equally good matches.
        let matches = mutual_matches(&from, &to, 0.9).expect("one dimension");
        assert_eq!(matches, [Some(1), Some(0), None, None]);
        assert_eq!(mutual_matches(&from, &to, 1.0).expect("one dimension")[3], Some(3));
        let other = DecodedDescriptors::new(&[1, 2], 2).expect("whole");
        assert_eq!(
            mutual_matches(&from, &other, 0.9),
            Err(AttackError::Dimensions { expected: 3, found: 2 })
        );
        assert_eq!(mutual_matches(&from, &of(&[]), 0.9), Ok(vec![None; 4]));
    }
}
