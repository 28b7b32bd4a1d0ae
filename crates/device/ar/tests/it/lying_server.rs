//! What a server that lies can do to content, and what the alignment notices (`docs/guide/lying-server.md`).

use veiloc_ar::{Alignment, AlignmentOptions, AlignmentState, Axes, DistanceVerdict, FrameworkPose, Update};
use veiloc_geometry::nalgebra::{Rotation3, Vector3};
use veiloc_geometry::{Rigid3, frames::World};

use crate::walk::Walk;

/// Metres between the places of the origin of the map in the AR world, by the alignment and in truth.
fn displacement(alignment: &Alignment, walk: &Walk) -> f64 {
    let found = alignment.aligned().expect("answers").ar_from_map;
    (found.translation() - walk.ar_from_map.translation()).norm()
}

/// One transform of all answers moves and tilts content, and nothing contradicts it.
#[test]
fn lies_of_one_transform_are_believed() {
    let mut walk = Walk::new(20, 0.01, 11);
    let tilt = Rotation3::from_scaled_axis(Vector3::x() * 20.0_f64.to_radians());
    let lie = Rigid3::<World, World>::new(tilt, Vector3::new(3.0, 0.0, 0.0));
    let mut alignment = Alignment::default();
    for i in 0..20 {
        walk.frames[i].cam_from_map = walk.frames[i].cam_from_map.compose(&lie);
        let given = walk.answer(i);
        assert_eq!(alignment.add(&given, &walk.frames[i].cam_from_ar), Update::Used, "{i}");
    }
    assert_eq!(alignment.state(), AlignmentState::Aligned);
    assert_eq!(alignment.distance_ratio().expect("pairs").verdict(), DistanceVerdict::Agrees);
    assert!((displacement(&alignment, &walk) - 3.0).abs() < 0.5, "{}", displacement(&alignment, &walk));
    let found = alignment.aligned().expect("answers").ar_from_map;
    assert!((found.rotation_error_degrees(&walk.ar_from_map) - 20.0).abs() < 1.0);
}

/// A lie that grows by a centimetre with each answer is followed.
#[test]
fn lies_that_grow_slowly_are_believed() {
    let mut walk = Walk::new(60, 0.0, 12);
    let mut alignment = Alignment::default();
    for i in 0..60 {
        let moved = Vector3::new(0.01 * i as f64, 0.0, 0.0);
        let lie = Rigid3::<World, World>::new(Rotation3::identity(), moved);
        walk.frames[i].cam_from_map = walk.frames[i].cam_from_map.compose(&lie);
        let given = walk.answer(i);
        assert_eq!(alignment.add(&given, &walk.frames[i].cam_from_ar), Update::Used, "{i}");
    }
    assert!(displacement(&alignment, &walk) > 0.3, "{}", displacement(&alignment, &walk));
}

/// Poses and unit that are scaled alike move content, and not the camera. The unit of an app ends that.
#[test]
fn a_unit_of_the_app_shows_a_lie_about_the_unit() {
    for (unit, verdict) in [(None, DistanceVerdict::Agrees), (Some(1.0), DistanceVerdict::Differs)] {
        let mut walk = Walk::new(20, 0.0, 13);
        let options = AlignmentOptions::default();
        let mut alignment = Alignment::new(unit.map_or(options, |m| options.with_metres_per_unit(m)));
        for i in 0..20 {
            let mut lie = walk.answer(i);
            let pose = lie.pose.as_mut().expect("a pose");
            pose.translation = pose.translation.map(|t| 0.5 * t);
            lie.map.metres_per_unit = Some(2.0);
            let update = alignment.add(&lie, &walk.frames[i].cam_from_ar);
            assert!(unit.is_some() || update == Update::Used, "{i}");
        }
        assert_eq!(alignment.distance_ratio().expect("pairs").verdict(), verdict);
        if unit.is_none() {
            // Content ten units from the origin of the map is 20 m from it.
            let at = |x: f64| FrameworkPose { position: [x, 0.0, 0.0], rotation: [0.0, 0.0, 0.0, 1.0] };
            let [a, b] = [0.0, 10.0].map(|x| {
                let placed = alignment.world_from_anchor(Axes::OpenGl, &at(x)).expect("a transform");
                Vector3::from(placed.position)
            });
            assert!(((a - b).norm() - 20.0).abs() < 1e-6);
        }
    }
}

/// With covariances that are large enough, contradictory answers agree. The accuracy of the alignment then is as large.
#[test]
fn large_covariances_hide_contradictions_and_show_in_the_accuracy() {
    for (factor, state) in [(1.0, AlignmentState::Tentative), (1e4, AlignmentState::Aligned)] {
        let mut walk = Walk::new(4, 0.0, 14);
        let mut alignment = Alignment::default();
        for i in 0..4 {
            let mut lie = walk.wrong_answer(i, true);
            let pose = lie.pose.as_mut().expect("a pose");
            pose.covariance = pose.covariance.map(|row| row.map(|c| factor * c));
            alignment.add(&lie, &walk.frames[i].cam_from_ar);
        }
        assert_eq!(alignment.state(), state);
        let accuracy = alignment.accuracy(&walk.frames[3].cam_from_ar).expect("an answer");
        assert_eq!(accuracy.horizontal > 0.5, factor > 1.0, "{accuracy:?}");
    }
}
