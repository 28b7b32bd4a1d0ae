//! By how much errors that neighbouring matches share increase the variance of a pose.
//!
//! Rolling shutter, blur, distortion that the camera model lacks and drift of the map's poses move all keypoints of a part of
//! the image together, so `n` matches hold less information than `n` independent ones. The residuals show it: with
//! `s_i` the score of a match (the gradient of its likelihood by the pose) and `c` the cells of a grid over the image, the
//! covariance of the sum of all scores is `Σ_i s_i s_iᵀ` when errors are independent and `Σ_c (Σ_{i∈c} s_i)(Σ_{i∈c} s_i)ᵀ` when
//! those of a cell are not (cluster-robust covariance; Liang and Zeger, *Longitudinal data analysis using generalized
//! linear models*, Biometrika 1986). Their ratio is the design effect (Kish, *Survey sampling*, 1965), here a single
//! number:
//!
//! ```text
//! B = Σ_i s_i s_iᵀ      B_c = Σ_{i∈c} s_i s_iᵀ      f = 6 − Σ_c tr(B⁻¹ B_c B⁻¹ B_c) + Σ_i (s_iᵀ B⁻¹ s_i)²
//! effect = (ν + Σ_grids Σ_c (Σ s)ᵀ B⁻¹ (Σ s)) / (ν + Σ_grids f)
//! ```
//!
//! `f` is what the numerator is for independent errors, given that all scores sum to 0 at an optimum. The `ν` keep a
//! few matches from deciding. Two grids are used, because errors may be shared by a quarter of the image or by less.

use veiloc_geometry::Pinhole;
use veiloc_geometry::nalgebra::{Matrix6, Vector2, Vector6};

/// Cells of the finer grid along each axis of the image.
const GRID: usize = 4;

/// Degrees of freedom of the prior that errors are independent.
const PRIOR_FREEDOM: f64 = 4.0;

/// Minimum of the effect: below, the residuals are more even than independent errors by chance.
const MIN_EFFECT: f64 = 0.5;

/// Eigenvalues of the scaled `B` below this share of the largest belong to directions that the matches leave free.
const MIN_EIGENVALUE: f64 = 1e-6;

/// Scores of matches, with the cells of the image in which their points project.
#[derive(Debug, Clone)]
pub struct ScoreCells {
    size: Vector2<f64>,
    scores: Vec<([usize; 2], Vector6<f64>)>,
}

impl ScoreCells {
    /// No scores yet.
    pub fn new(camera: &Pinhole) -> Self {
        Self { size: Vector2::new(f64::from(camera.width), f64::from(camera.height)), scores: Vec::new() }
    }

    /// Adds the score of a match whose point projects to this pixel.
    pub fn add(&mut self, pixel: &Vector2<f64>, score: &Vector6<f64>) {
        let at = pixel.component_div(&self.size) * GRID as f64;
        // The cast saturates: projections in the margin belong to the cells at the border.
        self.scores.push(([at.x, at.y].map(|x| (x as usize).min(GRID - 1)), *score));
    }

    /// Variance of the pose relative to that with independent errors; 1 without scores.
    pub fn design_effect(&self) -> f64 {
        let mut total = Matrix6::zeros();
        self.scores.iter().for_each(|(_, score)| add_square(&mut total, score));
        // Radians and map units differ in scale.
        let unit = total.diagonal().map(|d| if d > 0.0 { d.sqrt().recip() } else { 0.0 });
        let unit = Matrix6::from_diagonal(&unit);
        let eigen = (unit * total * unit).symmetric_eigen();
        let least = MIN_EIGENVALUE * eigen.eigenvalues.max();
        let roots = eigen.eigenvalues.map(|v| if v > least { v.sqrt().recip() } else { 0.0 });
        // `whiten · B · whitenᵀ` is the identity on the directions that are constrained.
        let whiten = Matrix6::from_diagonal(&roots) * eigen.eigenvectors.transpose() * unit;
        let constrained = roots.iter().filter(|r| **r > 0.0).count() as f64;
        let mut cells = [[Cell::default(); GRID]; GRID];
        let mut of_matches = 0.0;
        for ([column, row], score) in &self.scores {
            let mut white = Vector6::<f64>::zeros();
            for k in 0..6 {
                for (l, s) in score.iter().enumerate() {
                    white[k] += whiten[(k, l)] * s;
                }
            }
            of_matches += white.norm_squared().powi(2);
            let cell = &mut cells[*row][*column];
            cell.sum += white;
            add_square(&mut cell.square, &white);
        }
        let (mut found, mut expected) = (PRIOR_FREEDOM, PRIOR_FREEDOM);
        for width in [1, 2] {
            let mut independent = constrained + of_matches;
            for rows in cells.chunks(width) {
                for column in (0..GRID).step_by(width) {
                    let parts = || rows.iter().flat_map(|row| &row[column..column + width]);
                    found += parts().map(|cell| cell.sum).sum::<Vector6<f64>>().norm_squared();
                    independent -= parts().map(|cell| cell.square).sum::<Matrix6<f64>>().norm_squared();
                }
            }
            expected += independent.max(0.0);
        }
        let effect = found / expected;
        if effect.is_finite() { effect.max(MIN_EFFECT) } else { 1.0 }
    }
}

/// Adds `score · scoreᵀ`; a loop over numbers is faster here than products of matrices.
fn add_square(sum: &mut Matrix6<f64>, score: &Vector6<f64>) {
    for k in 0..6 {
        for l in 0..6 {
            sum[(l, k)] += score[l] * score[k];
        }
    }
}

/// Whitened scores of one cell.
#[derive(Debug, Clone, Copy, Default)]
struct Cell {
    sum: Vector6<f64>,
    square: Matrix6<f64>,
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    const CAMERA: Pinhole =
        Pinhole { width: 640, height: 480, focal: [500.0, 500.0], principal: [320.0, 240.0] };

    /// Mean effect over random problems, whose errors are `shared` within parts of the image of a quarter of its width.
    fn mean_effect(shared: f64, matches: usize) -> f64 {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let mut normal = move || (0..12).map(|_| rng.random_range(-0.5..0.5)).sum::<f64>();
        let mut uniform = ChaCha8Rng::seed_from_u64(6);
        let runs = 200;
        let effects = (0..runs).map(|_| {
            let common: Vec<f64> = (0..12).map(|_| shared * normal()).collect();
            let of_match: Vec<(Vector2<f64>, Vector6<f64>, f64)> = (0..matches)
                .map(|_| {
                    let pixel =
                        Vector2::new(uniform.random_range(0.0..640.0), uniform.random_range(0.0..480.0));
                    let part = (pixel.x / 160.0) as usize + 4 * (pixel.y / 160.0) as usize;
                    let (x, y) = (pixel.x / 320.0 - 1.0, pixel.y / 240.0 - 1.0);
                    let jacobian = Vector6::new(1.0, x, y, x * y, x * x, y * y);
                    (pixel, jacobian, normal() + common[part])
                })
                .collect();
            // At the optimum the scores sum to 0.
            let hessian: Matrix6<f64> = of_match.iter().map(|(_, j, _)| j * j.transpose()).sum();
            let gradient: Vector6<f64> = of_match.iter().map(|(_, j, e)| j * *e).sum();
            let step = hessian.cholesky().expect("many matches").solve(&gradient);
            let mut cells = ScoreCells::new(&CAMERA);
            for (pixel, j, e) in &of_match {
                cells.add(pixel, &(j * (e - j.dot(&step))));
            }
            cells.design_effect()
        });
        effects.sum::<f64>() / f64::from(runs)
    }

    #[test]
    fn independent_errors_have_no_effect() {
        for (matches, tolerance) in [(40, 0.15), (400, 0.06)] {
            let effect = mean_effect(0.0, matches);
            assert!((effect - 1.0).abs() < tolerance, "{matches}: {effect}");
        }
    }

    #[test]
    fn errors_shared_by_cells_have_the_effect_of_their_number() {
        // 400 matches in 12 parts, about 33 in each: a shared variance of 1 adds about 33 times that of independent errors;
        // the parts are not the cells, and the pose takes a part of the errors.
        let effect = mean_effect(1.0, 400);
        assert!((4.0..34.0).contains(&effect), "{effect}");
        assert!(mean_effect(0.3, 400) < 0.4 * effect);
    }

    #[test]
    fn few_or_no_scores_count_as_independent() {
        let mut cells = ScoreCells::new(&CAMERA);
        assert_eq!(cells.design_effect(), 1.0);
        cells.add(&Vector2::new(-3.0, 700.0), &Vector6::repeat(1.0));
        assert_eq!(cells.design_effect(), 1.0);
        cells.add(&Vector2::new(10.0, 10.0), &Vector6::repeat(f64::NAN));
        assert_eq!(cells.design_effect(), 1.0);
    }
}
