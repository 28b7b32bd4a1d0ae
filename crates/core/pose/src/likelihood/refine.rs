//! Levenberg–Marquardt on the six parameters of a pose, with robust losses and the anchored likelihood.

use veiloc_geometry::CameraFromWorld;

use crate::likelihood::descent::{Convergence, DescentResult, levenberg_marquardt};
use crate::likelihood::matches::{Matches, SumOfLogs};
use crate::likelihood::system::System;

/// The loss over the chosen correspondences.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Loss {
    /// `½ e²`.
    Squared,
    /// `½ min(e², τ²)`: the loss of MSAC.
    Truncated {
        /// `τ`, pixels.
        threshold: f64,
    },
    /// `−log(1 + exp(llr))`: the likelihood of the mixture of right and wrong, with the `log r` of anchored lines.
    Likelihood {
        /// Scale of the noise, pixels.
        noise: f64,
    },
}

/// A pose and its loss.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Refined {
    /// The pose.
    pub pose: CameraFromWorld,
    /// Its loss.
    pub loss: f64,
}

/// Minimises the loss over the correspondences `active`, with at most `steps` accepted or rejected steps.
///
/// Never returns a pose with a larger loss than the start's.
pub fn refine(
    matches: &Matches<'_>,
    active: &[usize],
    loss: Loss,
    start: &CameraFromWorld,
    steps: usize,
) -> Refined {
    descend(|pose| linearize(matches, active, loss, pose), start, steps, 1e-9)
}

/// Levenberg–Marquardt on any objective that can be linearized, with at most `steps` accepted or rejected steps; ends
/// when a step gains less than this share of the loss.
///
/// Never returns a pose with a larger loss than the start's.
pub fn descend(
    objective: impl Fn(&CameraFromWorld) -> System,
    start: &CameraFromWorld,
    steps: usize,
    min_gain: f64,
) -> Refined {
    let step = |pose: &CameraFromWorld, system: &System, damping| {
        let step = system.damped_step(damping)?;
        Some((pose.perturbed(&step.into()), -0.5 * step.dot(&system.gradient)))
    };
    let DescentResult { at: pose, here } =
        levenberg_marquardt(*start, Convergence { steps, min_gain }, objective, |here| here.loss, step);
    Refined { pose: reorthonormalized(&pose), loss: here.loss }
}

/// Products of rotations lose orthonormality only by rounding; one correction at the end is enough.
fn reorthonormalized(pose: &CameraFromWorld) -> CameraFromWorld {
    let mut rotation = *pose.rotation();
    rotation.renormalize();
    CameraFromWorld::new(rotation, *pose.translation())
}

/// Loss and derivatives over the correspondences `active` at a pose. Those that the pose cannot see count as certainly
/// wrong.
pub fn linearize(matches: &Matches<'_>, active: &[usize], loss: Loss, pose: &CameraFromWorld) -> System {
    let mut system = System::empty();
    let mut gain = SumOfLogs::new();
    let rows = matches.residuals();
    let at_noise = match loss {
        Loss::Likelihood { noise } => Some(matches.at_noise(noise)),
        Loss::Squared | Loss::Truncated { .. } => None,
    };
    for &i in active {
        let Some(residual) = matches.residual(i, pose, at_noise.is_some()) else {
            system.loss += loss_out_of_sight(loss);
            continue;
        };
        if let Some(noise) = &at_noise {
            let term = matches.likelihood_term(i, &residual, noise);
            gain.add(term.ratio);
            system.add(&residual, term.weight, term.right, rows);
            continue;
        }
        let e2 = residual.squared();
        let t2 = if let Loss::Truncated { threshold } = loss { threshold * threshold } else { f64::INFINITY };
        system.loss += 0.5 * e2.min(t2);
        system.add(&residual, if e2 < t2 { 1.0 } else { 0.0 }, 0.0, rows);
    }
    system.loss -= gain.sum();
    system.mirrored()
}

/// Loss of a correspondence that the pose cannot see: it counts as certainly wrong.
fn loss_out_of_sight(loss: Loss) -> f64 {
    match loss {
        // Finite, but larger than any visible residual: least squares must not push points behind the camera.
        Loss::Squared => 1e12,
        Loss::Truncated { threshold } => 0.5 * threshold * threshold,
        Loss::Likelihood { .. } => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::likelihood::problem::PoseProblem;
    use crate::likelihood::test_data::observe;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use veiloc_geometry::nalgebra::{Rotation3, Vector3};
    use veiloc_geometry::{Pencils, Pinhole, Pixel, Point3, Rigid3};

    const LOSSES: [Loss; 3] =
        [Loss::Squared, Loss::Truncated { threshold: 4.0 }, Loss::Likelihood { noise: 2.0 }];

    /// Exact observations from the identity pose, well inside the image.
    fn exact(rng: &mut ChaCha8Rng, kind: usize) -> PoseProblem {
        let camera = Pinhole { width: 640, height: 480, focal: [500.0, 510.0], principal: [310.0, 250.0] };
        let pencils = Pencils::paper(640, 480);
        let pixels: Vec<Pixel> = (0..60)
            .map(|_| Pixel::new(rng.random_range(60.0..580.0), rng.random_range(60.0..420.0)))
            .collect();
        let points = pixels
            .iter()
            .map(|p| Point3::from_vector(camera.unproject(*p).homogeneous() * rng.random_range(2.0..6.0)))
            .collect();
        let observations = observe(kind, pixels, &pencils, || rng.random_range(0.0..3.0));
        let keypoints = (0..60).collect();
        PoseProblem::new(camera, observations, keypoints, points)
    }

    fn start(rng: &mut ChaCha8Rng, size: f64) -> CameraFromWorld {
        let mut r = || rng.random_range(-size..size);
        Rigid3::new(Rotation3::from_euler_angles(r(), r(), r()), Vector3::new(r(), r(), r()))
    }

    #[test]
    fn gradients_of_all_losses_agree_with_finite_differences() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for kind in 0..3 {
            let problem = exact(&mut rng, kind);
            let matches = Matches::new(&problem, 0.2);
            let active: Vec<usize> = (0..matches.len()).collect();
            for loss in LOSSES {
                let pose = start(&mut rng, 0.004);
                let system = linearize(&matches, &active, loss, &pose);
                for k in 0..6 {
                    let at = |h: f64| {
                        let mut step = [0.0; 6];
                        step[k] = h;
                        linearize(&matches, &active, loss, &pose.perturbed(&step)).loss
                    };
                    let numeric = (at(1e-7) - at(-1e-7)) / 2e-7;
                    let tolerance = 1e-3 * (1.0 + system.gradient.amax());
                    assert!((numeric - system.gradient[k]).abs() < tolerance, "{kind} {loss:?} {k}");
                }
            }
        }
    }

    #[test]
    fn descent_reaches_the_exact_pose_monotonically() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        for kind in 0..3 {
            for _ in 0..20 {
                let problem = exact(&mut rng, kind);
                let matches = Matches::new(&problem, 0.2);
                let active: Vec<usize> = (0..matches.len()).collect();
                let from = start(&mut rng, 0.02);
                let found = refine(&matches, &active, Loss::Squared, &from, 50).pose;
                assert!(found.translation_error(&CameraFromWorld::identity()) < 1e-6, "{kind}");
                for loss in LOSSES {
                    let before = linearize(&matches, &active, loss, &from).loss;
                    let refined = refine(&matches, &active, loss, &from, 10);
                    assert!(refined.loss <= before);
                    let after = linearize(&matches, &active, loss, &refined.pose).loss;
                    assert!((after - refined.loss).abs() < 1e-6 * (1.0 + after.abs()));
                }
            }
        }
    }
}
