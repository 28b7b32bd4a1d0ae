//! Selection of the attacked images.

/// `count` indices of `0..n`, spread evenly; all for `None`, or if there are fewer.
pub(crate) fn spread(n: usize, count: Option<usize>) -> Vec<usize> {
    let count = count.unwrap_or(n).min(n);
    (0..count).map(|i| i * n / count).collect()
}

#[cfg(test)]
mod tests {
    use super::spread;

    #[test]
    fn images_are_spread_evenly() {
        assert_eq!(spread(10, Some(4)), [0, 2, 5, 7]);
        assert_eq!((spread(3, None), spread(3, Some(9))), (vec![0, 1, 2], vec![0, 1, 2]));
        assert!(spread(0, Some(2)).is_empty());
    }
}
