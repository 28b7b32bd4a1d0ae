//! Standard deviation of a covariance in its least certain direction: the meaning of "±" everywhere.

use nalgebra::Matrix3;

/// Standard deviation of the camera centre in its least certain direction, map units, from the covariance of a pose in
/// the chart of [`CameraFromWorld::perturbed`](crate::CameraFromWorld::perturbed): the root of the largest eigenvalue
/// of the translation block, which is the centre's covariance rotated. Infinite when that block is not finite.
pub fn position_sd(covariance: &[[f64; 6]; 6]) -> f64 {
    largest_sd(covariance, 3)
}

/// The same for the orientation, about its least certain axis, degrees.
pub fn rotation_sd_degrees(covariance: &[[f64; 6]; 6]) -> f64 {
    largest_sd(covariance, 0).to_degrees()
}

/// For the block of three rows from `at` on.
fn largest_sd(covariance: &[[f64; 6]; 6], at: usize) -> f64 {
    let block = Matrix3::from_fn(|i, j| covariance[at + i][at + j]);
    if block.iter().all(|c| c.is_finite()) {
        block.symmetric_eigenvalues().max().max(0.0).sqrt()
    } else {
        f64::INFINITY
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn deviation_is_in_the_least_certain_direction() {
        let mut covariance = [[0.0; 6]; 6];
        // Two axes of translation, standard deviations 3 and 1, rotated by 45°.
        covariance[3][3] = 5.0;
        covariance[4][4] = 5.0;
        covariance[3][4] = 4.0;
        covariance[4][3] = 4.0;
        covariance[1][1] = 4e-4;
        assert!((position_sd(&covariance) - 3.0).abs() < 1e-12);
        assert!((rotation_sd_degrees(&covariance) - 0.02_f64.to_degrees()).abs() < 1e-9);
        covariance[5][5] = f64::INFINITY;
        assert_eq!(position_sd(&covariance), f64::INFINITY);
        assert!(rotation_sd_degrees(&covariance).is_finite());
    }
}
