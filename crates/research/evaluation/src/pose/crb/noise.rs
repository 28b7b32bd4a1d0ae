//! Noise of an observation: the detector's noise plus that of obfuscation.

use veiloc_geometry::{CameraFromWorld, PlanePoint};
use veiloc_pose::{Correspondences, PoseProblem};
use veiloc_protocol::AngleBits;

/// Variance of the dither, uniform over one pixel, along any direction.
const DITHER: f64 = 1.0 / 12.0;

/// Variance of rounding a position, or the offset of a line, to quarter pixels (`docs/reference/wire-format.md`).
const ROUNDING: f64 = 0.25 * 0.25 / 12.0;

/// Standard deviation of the chosen correspondences across their lines (of points along each axis), pixels.
///
/// The keypoint's own noise, plus dither, plus the rounding of the sent values. For `dcl` the angle is rounded, which
/// moves the line by `r · π/levels` at the distance `r` of the keypoint from its anchor; this part is averaged over
/// the correspondences and is a few percent of the total.
pub(crate) fn observation_noise(
    problem: &PoseProblem,
    truth: &CameraFromWorld,
    chosen: &[bool],
    keypoint_noise: f64,
    bits: AngleBits,
) -> f64 {
    let rounding = match &problem.observations {
        Correspondences::Anchored { pencils, lines } => {
            let step = std::f64::consts::PI / f64::from(bits.levels());
            let squared_radii: Vec<f64> = lines
                .iter()
                .zip(&problem.points)
                .zip(chosen)
                .filter(|(_, chosen)| **chosen)
                .filter_map(|(((anchor, _), point), _)| {
                    let seen = PlanePoint::from_camera_point(&truth.transform(point))?;
                    Some(pencils.distance(*anchor, problem.camera.project(seen)).powi(2))
                })
                .collect();
            let mean = squared_radii.iter().sum::<f64>() / squared_radii.len().max(1) as f64;
            mean * step * step / 12.0
        }
        Correspondences::Points { .. } | Correspondences::Lines { .. } => ROUNDING,
    };
    (keypoint_noise * keypoint_noise + DITHER + rounding).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pose::crb::SyntheticScene;
    use crate::pose::crb::trial::as_problem;
    use crate::pose::evaluate::pose_problem;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use veiloc_geometry::Pixel;
    use veiloc_obfuscation::obfuscate_points;
    use veiloc_protocol::Scheme;
    use veiloc_synthetic::problems::PointProblem;

    /// Compares the formula with sealing 20 000 keypoints: the spread of the distances of the true projections from
    /// the sent lines. Coarse angles make their rounding visible.
    #[test]
    fn formula_equals_spread_of_sent_lines() {
        let bits = AngleBits::new(9).expect("allowed");
        let paper = "dcl:paper".parse().expect("a layout");
        for scheme in [Scheme::Points, Scheme::RandomLines, paper] {
            for noise in [0.0, 0.7] {
                let mut rng = ChaCha8Rng::seed_from_u64(9);
                let options = SyntheticScene::Deep.problems(20_000).noise(noise);
                let synthetic = PointProblem::generate(&options, &mut rng);
                let problem = as_problem("spread", &synthetic);
                let hidden = obfuscate_points(&problem.keypoints, 640, 480, &scheme, bits, &mut rng);
                let (sent, _) = pose_problem(&problem, &hidden.expect("all inside"), false);
                let truth = &synthetic.cam_from_world;
                let distances: Vec<f64> = sent
                    .points
                    .iter()
                    .enumerate()
                    .map(|(i, point)| {
                        let seen = PlanePoint::from_camera_point(&truth.transform(point)).expect("in front");
                        let exact: Pixel = problem.camera.project(seen);
                        match &sent.observations {
                            Correspondences::Points { pixels } => pixels[i].u - exact.u,
                            Correspondences::Lines { lines } => lines[i].signed_distance(exact),
                            Correspondences::Anchored { pencils, lines } => {
                                let line = pencils.line(lines[i].0, lines[i].1).expect("in sight");
                                line.signed_distance(exact)
                            }
                        }
                    })
                    .collect();
                let measured = (distances.iter().map(|d| d * d).sum::<f64>() / distances.len() as f64).sqrt();
                let formula = observation_noise(&sent, truth, &vec![true; distances.len()], noise, bits);
                assert!((measured / formula - 1.0).abs() < 0.02, "{scheme} {noise}: {measured} {formula}");
            }
        }
    }
}
