//! Sequences from a list of queries: their images, and the simulated odometry of the device.

use rand_chacha::ChaCha8Rng;
use veiloc_geometry::nalgebra::{Rotation3, Vector3};
use veiloc_geometry::{CameraFromRig, CameraFromWorld};
use veiloc_synthetic::problems::normal;

/// One image of a sequence relative to the rig, which is the camera of the newest image.
#[derive(Debug, Clone, Copy)]
pub(super) struct OdometryStep {
    pub(super) cam_from_rig: CameraFromRig,
    pub(super) rotation_sd_deg: f64,
    pub(super) translation_sd: f64,
}

/// The images of the sequence that ends with image `newest`, oldest first: `count` consecutive images of its
/// trajectory, those before it or, if they are too few, those after it, as if the trajectory were reversed. A
/// trajectory is a run of the list whose neighbours are at most `max_distance` apart. `None` if the trajectory has too
/// few images on both sides.
pub fn sequence_of(
    poses: &[CameraFromWorld],
    newest: usize,
    count: usize,
    max_distance: f64,
) -> Option<Vec<usize>> {
    let near = |a: usize, b: usize| poses[a].translation_error(&poses[b]) <= max_distance;
    let before = (0..newest).rev().take_while(|&i| near(i, i + 1));
    let after = (newest + 1..poses.len()).take_while(|&i| near(i - 1, i));
    let row = |others: &mut dyn Iterator<Item = usize>| {
        let mut images: Vec<usize> = std::iter::once(newest).chain(others).take(count).collect();
        images.reverse();
        (images.len() == count).then_some(images)
    };
    row(&mut before.into_iter()).or_else(|| row(&mut after.into_iter()))
}

/// Simulated odometry of these images, oldest first: every step has a normal error with these standard deviations, in
/// degrees about each axis and map units along each. The error of an image `k` steps ago has `√k` of the deviation.
pub(super) fn odometry(truth: &[CameraFromWorld], sd: [f64; 2], rng: &mut ChaCha8Rng) -> Vec<OdometryStep> {
    if truth.is_empty() {
        return Vec::new();
    }
    let mut steps = vec![OdometryStep {
        cam_from_rig: CameraFromRig::identity(),
        rotation_sd_deg: 0.0,
        translation_sd: 0.0,
    }];
    for (k, pair) in truth.windows(2).rev().enumerate() {
        let (older, newer) = (&pair[0], &pair[1]);
        let turn = Rotation3::from_scaled_axis(Vector3::from_fn(|_, _| sd[0].to_radians() * normal(rng)));
        let shift = Vector3::from_fn(|_, _| sd[1] * normal(rng));
        let older_from_newer = older.compose(&newer.inverse());
        let step_rotation = older_from_newer.rotation();
        let known = &steps[k].cam_from_rig;
        // The measured step, followed by the later steps.
        let rotation = turn * step_rotation * known.rotation();
        let translation =
            turn * (step_rotation * known.translation() + older_from_newer.translation()) + shift;
        let ago = ((k + 1) as f64).sqrt();
        steps.push(OdometryStep {
            cam_from_rig: CameraFromRig::new(rotation, translation),
            rotation_sd_deg: ago * sd[0],
            translation_sd: ago * sd[1],
        });
    }
    steps.reverse();
    steps
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use veiloc_geometry::Rigid3;

    fn at(x: f64) -> CameraFromWorld {
        Rigid3::new(Rotation3::from_euler_angles(0.1 * x, 0.2, -x), Vector3::new(x, 1.0, 2.0))
    }

    #[test]
    fn sequences_stay_within_their_trajectory() {
        let level = |x: f64| CameraFromWorld::new(Rotation3::identity(), Vector3::new(x, 0.0, 0.0));
        let poses: Vec<CameraFromWorld> = [0.0, 0.1, 0.2, 5.0, 5.1, 5.2, 5.3].map(level).into();
        let of = |newest, count| sequence_of(&poses, newest, count, 0.5);
        assert_eq!(of(2, 3), Some(vec![0, 1, 2]));
        assert_eq!(of(6, 2), Some(vec![5, 6]));
        assert_eq!(of(3, 3), Some(vec![5, 4, 3]), "none before it");
        assert_eq!(of(4, 1), Some(vec![4]));
        assert_eq!(of(2, 4), None);
        assert_eq!(of(4, 3), Some(vec![6, 5, 4]));
    }

    #[test]
    fn odometry_noise_has_stated_deviation() {
        let truth: Vec<CameraFromWorld> = (0..5).map(|i| at(0.1 * f64::from(i))).collect();
        let exact = odometry(&truth, [0.0, 0.0], &mut ChaCha8Rng::seed_from_u64(1));
        for (step, truth_of) in exact.iter().zip(&truth) {
            let expected = truth_of.compose(&truth[4].inverse());
            assert!((step.cam_from_rig.translation() - expected.translation()).norm() < 1e-12);
            assert_eq!(step.translation_sd, 0.0);
        }
        let mut squared = 0.0;
        for seed in 0..400 {
            let measured = odometry(&truth, [0.1, 0.01], &mut ChaCha8Rng::seed_from_u64(seed));
            let expected = exact[0].cam_from_rig;
            let step = expected.translation() - measured[0].cam_from_rig.translation();
            squared += (step / measured[0].translation_sd).norm_squared() / 3.0;
            assert_eq!(measured[4].translation_sd, 0.0);
        }
        assert!((squared / 400.0_f64 - 1.0).abs() < 0.2, "{squared}");
    }
}
