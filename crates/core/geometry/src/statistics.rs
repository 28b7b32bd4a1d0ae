//! What several crates ask of a few numbers.

/// The middle value, of an even number the upper of the two, `None` of none. NaN sorts last. Reorders the values.
pub fn upper_median(values: &mut [f64]) -> Option<f64> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_middle_is_found_in_any_order() {
        assert_eq!(upper_median(&mut [3.0, 1.0, 2.0]), Some(2.0));
        assert_eq!(upper_median(&mut [4.0, 1.0, 3.0, 2.0]), Some(3.0));
        assert_eq!(upper_median(&mut [f64::NAN, 1.0, 2.0]), Some(2.0));
        assert_eq!(upper_median(&mut []), None);
    }
}
