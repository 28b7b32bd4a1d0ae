//! The transform from the map to the AR world: wrong answers, drift, jumps, scale.

use veiloc_ar::{Alignment, AlignmentOptions, AlignmentState, Axes, DistanceVerdict, FrameworkPose, Update};
use veiloc_geometry::nalgebra::{Matrix6, Rotation3, Vector3, Vector6};
use veiloc_geometry::{CameraFromWorld, Rigid3};
use veiloc_protocol::{AnchorPose, Answer, ContentAnchor, ContentAnchors, MapCoordinates};

use crate::walk::{Walk, answer};

/// Metres between the camera's true place in the map and that by the alignment.
fn error(alignment: &Alignment, walk: &Walk, i: usize) -> f64 {
    let frame = &walk.frames[i];
    let found = alignment.cam_from_map(&frame.cam_from_ar).expect("a transform");
    found.translation_error(&frame.cam_from_map)
}

#[test]
fn exact_answers_give_the_exact_transform() {
    let walk = Walk::new(10, 0.0, 1);
    let mut alignment = Alignment::default();
    assert_eq!(alignment.state(), AlignmentState::Searching);
    for (i, frame) in walk.frames.iter().enumerate() {
        assert_eq!(alignment.add(&answer(&frame.cam_from_map, true), &frame.cam_from_ar), Update::Used);
        let expected = if i == 0 { AlignmentState::Tentative } else { AlignmentState::Aligned };
        assert_eq!(alignment.state(), expected);
        assert!(error(&alignment, &walk, i) < 1e-9);
    }
    let found = alignment.aligned().expect("answers").ar_from_map;
    assert!(found.rotation_error_degrees(&walk.ar_from_map) < 1e-9);
    alignment.reset();
    assert_eq!((alignment.state(), alignment.aligned()), (AlignmentState::Searching, None));
}

#[test]
fn anchor_is_where_the_camera_sees_it() {
    let walk = Walk::new(3, 0.0, 2);
    for axes in Axes::ALL {
        // A map in centimetres.
        let mut alignment = Alignment::new(AlignmentOptions::default().with_metres_per_unit(0.01));
        for frame in &walk.frames {
            let t = frame.cam_from_map.translation() * 100.0;
            let in_cm = CameraFromWorld::new(*frame.cam_from_map.rotation(), t);
            alignment.add(&answer(&in_cm, true), &frame.cam_from_ar);
        }
        // Content two metres ahead of the last camera, with the camera's own axes.
        let camera = &walk.frames[2];
        let ahead = Vector3::new(0.0, 0.0, 2.0);
        let map_from_anchor = camera.cam_from_map.inverse();
        let position = map_from_anchor.rotation() * ahead + map_from_anchor.translation();
        let [w, x, y, z] = map_from_anchor.quaternion();
        let map_from_anchor = FrameworkPose { position: (position * 100.0).into(), rotation: [x, y, z, w] };
        let placed = alignment.world_from_anchor(axes, &map_from_anchor).expect("a transform");
        let expected = camera.cam_from_ar.inverse();
        let expected = Rigid3::<veiloc_ar::ArWorld, veiloc_geometry::frames::Camera>::new(
            *expected.rotation(),
            expected.rotation() * ahead + expected.translation(),
        );
        let expected = axes.object_pose(&expected);
        for k in 0..3 {
            let difference = (placed.position[k] - expected.position[k]).abs();
            assert!(difference < 1e-9 * axes.units_per_metre(), "{axes} {placed:?} {expected:?}");
        }
        for k in 0..4 {
            assert!(
                (placed.rotation[k] - expected.rotation[k]).abs() < 1e-9,
                "{axes} {placed:?} {expected:?}"
            );
        }
    }
}

/// The nearest first, and each where its known place is; distances in metres although the map is in centimetres.
#[test]
fn content_anchors_are_placed_by_their_distance() {
    let walk = Walk::new(3, 0.0, 2);
    let mut alignment = Alignment::new(AlignmentOptions::default().with_metres_per_unit(0.01));
    let (camera, places) = (&walk.frames[2], [("far", 7.0), ("near", 0.5), ("behind", -3.0)]);
    let mut anchors = ContentAnchors::default();
    for (name, depth) in places {
        let in_map = camera.cam_from_map.inverse();
        let at = in_map.rotation() * Vector3::new(0.0, 0.0, depth) + in_map.translation();
        let map_from_anchor = AnchorPose { q: in_map.quaternion(), t: (at * 100.0).into() };
        let anchor =
            ContentAnchor { name: name.to_owned(), map_from_anchor, content: depth.into(), owner: None };
        anchors.set(anchor).expect("valid");
    }
    assert!(alignment.place_anchors(Axes::OpenGl, &anchors, &camera.cam_from_ar).is_empty(), "no answer yet");
    for frame in &walk.frames {
        let in_cm =
            CameraFromWorld::new(*frame.cam_from_map.rotation(), frame.cam_from_map.translation() * 100.0);
        alignment.add(&answer(&in_cm, true), &frame.cam_from_ar);
    }
    let placed = alignment.place_anchors(Axes::OpenGl, &anchors, &camera.cam_from_ar);
    let names: Vec<&str> = placed.iter().map(|placed| placed.anchor.name.as_str()).collect();
    assert_eq!(names, ["near", "behind", "far"]);
    let ar_from_cam = camera.cam_from_ar.inverse();
    for (placed, depth) in placed.iter().zip([0.5, -3.0, 7.0]) {
        let expected = ar_from_cam.rotation() * Vector3::new(0.0, 0.0, depth) + ar_from_cam.translation();
        assert!((Vector3::from(placed.world_from_anchor.position) - expected).norm() < 1e-9, "{placed:?}");
        assert!((placed.distance - depth.abs()).abs() < 1e-9, "{placed:?}");
    }
}

/// Sixty answers, of which one in ten is wrong, half of these trusted.
#[test]
fn wrong_answers_move_nothing() {
    for seed in 0..5 {
        let mut walk = Walk::new(60, 0.01, seed);
        let mut alignment = Alignment::default();
        for i in 0..60 {
            let cam_from_ar = walk.frames[i].cam_from_ar;
            alignment.moved(&cam_from_ar);
            // The third is wrong, and every tenth from then on.
            let is_wrong = i % 10 == 2;
            let given = match (is_wrong, i % 20 == 2) {
                (true, trusted) => walk.wrong_answer(i, trusted),
                (false, _) => walk.answer(i),
            };
            let before = alignment.aligned().copied();
            let update = alignment.add(&given, &cam_from_ar);
            if is_wrong {
                assert!(matches!(update, Update::Contradicts | Update::Doubtful), "{seed} {i} {update:?}");
                let after = alignment.aligned().expect("answers").ar_from_map;
                let moved = before.expect("answers").ar_from_map.step_to(&after);
                // The oldest answer left the average.
                assert!(Vector6::from(moved).norm() < 4e-3, "{seed} {i} {moved:?}");
            }
            assert!(error(&alignment, &walk, i) < 0.2, "{seed} {i} {}", error(&alignment, &walk, i));
        }
        let aligned = alignment.aligned().expect("answers");
        assert!(aligned.used >= 18 && aligned.contradicting <= 4, "{seed} {aligned:?}");
    }
}

#[test]
fn a_wrong_first_answer_is_outvoted() {
    for seed in 0..20 {
        let mut walk = Walk::new(6, 0.01, 100 + seed);
        let mut alignment = Alignment::default();
        for i in 0..6 {
            let given = if i == 0 { walk.wrong_answer(0, true) } else { walk.answer(i) };
            let update = alignment.add(&given, &walk.frames[i].cam_from_ar);
            // One against one decides nothing.
            let expected = [Update::Used, Update::Contradicts];
            assert_eq!(update, *expected.get(i).unwrap_or(&Update::Used), "{seed} {i}");
        }
        assert!(error(&alignment, &walk, 5) < 0.2, "{seed}");
    }
}

/// The AR framework loses its world without saying so: its poses jump by metres.
#[test]
fn after_a_jump_the_new_answers_take_over() {
    let mut walk = Walk::new(40, 0.01, 7);
    let turn = Rotation3::from_scaled_axis(Vector3::y() * 0.8);
    let jump = Rigid3::<veiloc_ar::ArWorld, veiloc_ar::ArWorld>::new(turn, Vector3::new(4.0, 0.0, 1.0));
    let mut alignment = Alignment::default();
    let mut taken_over = None;
    for i in 0..40 {
        let given = walk.answer(i);
        if i >= 25 {
            walk.frames[i].cam_from_ar = walk.frames[i].cam_from_ar.compose(&jump);
        }
        let update = alignment.add(&given, &walk.frames[i].cam_from_ar);
        if i >= 25 && update == Update::Used {
            taken_over.get_or_insert(i - 24);
        }
    }
    assert!(taken_over.is_some_and(|answers| (4..=7).contains(&answers)), "{taken_over:?}");
    assert!(error(&alignment, &walk, 39) < 0.2);
}

/// A map without a unit is not taken for one in metres, and a new unit belongs to a new map.
#[test]
fn unit_comes_from_the_answers_or_from_the_app() {
    let mut walk = Walk::new(2, 0.0, 9);
    let (first, second) = (walk.answer(0), walk.answer(1));
    let of_unit = |answer: &Answer, metres_per_unit| {
        let map = MapCoordinates { metres_per_unit, ..answer.map };
        Answer { map, ..answer.clone() }
    };
    let [here, there] = [0, 1].map(|i| walk.frames[i].cam_from_ar);
    let mut alignment = Alignment::default();
    assert_eq!(alignment.add(&of_unit(&first, None), &here), Update::UnknownUnit);
    assert!(alignment.aligned().is_none());
    assert_eq!(alignment.add(&first, &here), Update::Used);
    assert_eq!(alignment.add(&second, &there), Update::Used);
    assert_eq!(alignment.state(), AlignmentState::Aligned);
    assert_eq!(alignment.add(&of_unit(&second, Some(0.5)), &there), Update::Used);
    assert_eq!(alignment.state(), AlignmentState::Tentative);
    let mut given = Alignment::new(AlignmentOptions::default().with_metres_per_unit(1.0));
    assert_eq!(given.add(&of_unit(&first, None), &here), Update::Used);
    for impossible in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let mut alignment = Alignment::new(AlignmentOptions::default().with_metres_per_unit(impossible));
        assert_eq!(alignment.add(&first, &here), Update::UnknownUnit, "{impossible}");
    }
}

#[test]
fn errors_are_as_large_as_the_covariance_says() {
    let (mut sum, mut count) = (0.0, 0.0);
    for seed in 0..300 {
        let mut walk = Walk::new(5, 0.0, 1000 + seed);
        let options = AlignmentOptions::default().with_floors(1e-4, 1e-3).with_drift(0.0, 0.0);
        let mut alignment = Alignment::new(options);
        for i in 0..5 {
            let given = walk.answer(i);
            alignment.add(&given, &walk.frames[i].cam_from_ar);
        }
        let aligned = alignment.aligned().expect("answers");
        let step = Vector6::from(aligned.ar_from_map.step_to(&walk.ar_from_map));
        let covariance = Matrix6::from_fn(|i, j| aligned.covariance[i][j]);
        sum += step.dot(&covariance.cholesky().expect("positive").solve(&step));
        count += 6.0;
    }
    // The mean of chi-square divided by its degrees of freedom, with a standard deviation of 0.033.
    let ratio: f64 = sum / count;
    assert!((0.88..1.12).contains(&ratio), "{ratio}");
}

#[test]
fn distances_show_a_wrong_unit() {
    for (metres, verdict) in [(1.0, DistanceVerdict::Agrees), (0.8, DistanceVerdict::Differs)] {
        let mut walk = Walk::new(20, 0.01, 3);
        let mut alignment = Alignment::new(AlignmentOptions::default().with_metres_per_unit(metres));
        for i in 0..20 {
            // One wrong answer does not change the median.
            let given = if i == 9 { walk.wrong_answer(i, true) } else { walk.answer(i) };
            alignment.add(&given, &walk.frames[i].cam_from_ar);
        }
        let ratio = alignment.distance_ratio().expect("pairs");
        assert!((ratio.median - metres).abs() < 0.03, "{ratio:?}");
        assert_eq!(ratio.verdict(), verdict, "{ratio:?}");
    }
    let mut walk = Walk::new(1, 0.0, 3);
    let mut alignment = Alignment::default();
    let given = walk.answer(0);
    alignment.add(&given, &walk.frames[0].cam_from_ar);
    assert_eq!(alignment.distance_ratio(), None);
}

#[test]
fn answers_without_a_pose_or_with_a_free_direction_change_nothing() {
    let walk = Walk::new(2, 0.0, 4);
    let frame = &walk.frames[0];
    let mut alignment = Alignment::default();
    let withheld = Answer { pose: None, ..answer(&frame.cam_from_map, false) };
    assert_eq!(alignment.add(&withheld, &frame.cam_from_ar), Update::NoPose);
    let mut free = answer(&frame.cam_from_map, true);
    free.pose.as_mut().expect("a pose").covariance[5][5] = f64::INFINITY;
    assert_eq!(alignment.add(&free, &frame.cam_from_ar), Update::NoPose);
    assert_eq!(alignment.add(&answer(&frame.cam_from_map, false), &frame.cam_from_ar), Update::Doubtful);
    assert_eq!(alignment.state(), AlignmentState::Searching);
    alignment.add(&answer(&frame.cam_from_map, true), &frame.cam_from_ar);
    let before = alignment.aligned().copied();
    let doubtful = alignment.add(&answer(&frame.cam_from_map, false), &frame.cam_from_ar);
    assert_eq!((doubtful, alignment.aligned().copied()), (Update::DoubtfulAgrees, before));
}

#[test]
fn accuracy_of_one_answer_is_that_of_its_alignment() {
    let walk = Walk::new(1, 0.0, 5);
    let frame = &walk.frames[0];
    let given = answer(&frame.cam_from_map, true);
    let options = AlignmentOptions::default().with_floors(1e-6, 1e-6);
    let mut alignment = Alignment::new(options);
    alignment.add(&given, &frame.cam_from_ar);
    let own = veiloc_ar::Accuracy::of_answer(given.pose.as_ref().expect("a pose"), &frame.cam_from_ar, 1.0);
    let of_alignment = alignment.accuracy(&frame.cam_from_ar).expect("an answer");
    // The camera looks along the ground with its y axis down: 0.02 and 0.05 on the ground, 0.03 up and down.
    assert!((own.vertical - 0.03).abs() < 3e-4, "{own:?}");
    assert!(own.horizontal > 0.05 && own.horizontal < 0.06, "{own:?}");
    assert!((own.yaw_deg - 0.004_f64.to_degrees()).abs() < 3e-3, "{own:?}");
    assert!((own.horizontal - of_alignment.horizontal).abs() < 1e-4, "{own:?} {of_alignment:?}");
    assert!((own.vertical - of_alignment.vertical).abs() < 1e-4, "{own:?} {of_alignment:?}");
    assert!((own.yaw_deg - of_alignment.yaw_deg).abs() < 1e-3, "{own:?} {of_alignment:?}");
}
