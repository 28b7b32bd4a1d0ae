//! How fast the network learns, step by step.

/// Share of the steps over which the rate rises from nothing.
const WARM_UP: f64 = 0.05;
/// Share of the highest rate that is left at the end.
const LAST: f64 = 0.02;

/// Learning rate of a step: rising in a line, then falling as a cosine.
pub(crate) fn learning_rate(highest: f64, step: usize, steps: usize) -> f64 {
    let warm = (WARM_UP * steps as f64).max(1.0);
    let at = step as f64 + 1.0;
    if at < warm {
        return highest * at / warm;
    }
    let done = ((at - warm) / (steps as f64 - warm).max(1.0)).min(1.0);
    highest * (LAST + (1.0 - LAST) * 0.5 * (1.0 + (std::f64::consts::PI * done).cos()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_rises_and_falls() {
        let rates: Vec<f64> = (0..1000).map(|step| learning_rate(2.0, step, 1000)).collect();
        let top = rates.iter().position(|r| *r > 1.999).expect("reaches its highest");
        assert!((40..60).contains(&top), "{top}");
        assert!(rates[..top].is_sorted() && rates[top..].iter().rev().is_sorted());
        assert!((rates[999] - 0.04).abs() < 1e-9, "{}", rates[999]);
        assert!(learning_rate(1.0, 0, 1).is_finite());
    }
}
