//! Finds the cause of inconsistent poses and cameras: applies common mistakes and checks whether matches then agree
//! much better.
//!
//! Image pairs are chosen by appearance, because wrong poses cannot choose them. Matches are computed once; each
//! hypothesis then counts the matches that lie on each other's epipolar lines and intersect in front of both cameras.

use rayon::prelude::*;
use veiloc_descriptor::{DescriptorView, GlobalDescriptor, Match, MatchOptions, match_descriptors};
use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::nalgebra::{Matrix3, Quaternion, Rotation3, UnitQuaternion, Vector3};
use veiloc_map::MapModel;

use crate::build::report::{BuildReport, InputMistake, MapWarning};
use crate::triangulation::matching::Epipolar;
use crate::triangulation::scene::Scene;
use crate::triangulation::view::View;

/// Returns the likely reason why the matches of a map's images disagree with their poses and cameras; `None` if they
/// agree, or if no hypothesis explains them much better.
///
/// Each call matches some dozen image pairs: use it for maps that already have a warning.
pub(crate) fn diagnose(model: &MapModel) -> Option<MapWarning> {
    let scene = Scene::of(model, &model.settings);
    let globals: Vec<&GlobalDescriptor> = model.images.iter().map(|i| &i.global).collect();
    let pairs = pairs_by_similarity(&globals);
    let matched = match_pairs(&pairs, &scene.descriptors, model.settings.max_ratio);
    let matches: usize = matched.iter().map(|(_, m)| m.len()).sum();
    if matches < MIN_MATCHES {
        return None;
    }
    let share = |fault: Option<InputMistake>| {
        let agreeing: usize = matched
            .par_iter()
            .map(|((i, j), matches)| {
                let [a, b] = [*i, *j].map(|k| without_mistake(&scene.views[k], fault));
                let relation = Epipolar::between(&a, &b);
                matches
                    .iter()
                    .filter(|m| relation.is_consistent(&a, m.query as usize, &b, m.database as usize))
                    .count()
            })
            .sum();
        agreeing as f64 / matches as f64
    };
    let given = share(None);
    let mut best: Option<(f64, InputMistake)> = None;
    for fault in mistakes() {
        let then = share(Some(fault));
        if best.is_none_or(|(highest, _)| then > highest) {
            best = Some((then, fault));
        }
    }
    let (then, fault) = best?;
    let percent = |share: f64| (100.0 * share).round() as u32;
    (then >= MIN_SHARE && then >= given + MIN_GAIN).then_some(MapWarning::LikelyCause {
        fault,
        agree_percent: percent(given),
        would_percent: percent(then),
    })
}

/// Adds the likely cause to the warnings of a map, if there is a warning or few matches agree.
pub(crate) fn explain(report: &mut BuildReport, model: &MapModel) {
    if !report.warnings.is_empty() || MapWarning::needs_diagnosis(report.matches, report.verified) {
        report.warnings.extend(diagnose(model));
    }
}

/// Common mistakes. Focal lengths vary from a quarter to four times in steps of an eighth octave.
fn mistakes() -> impl Iterator<Item = InputMistake> {
    // Matches of a correct map lose a tenth of their agreement with an eighth octave.
    let focal = |step: i32| InputMistake::FocalLength {
        percent: (100.0 * (f64::from(step) / 8.0).exp2()).round() as u32,
    };
    let poses =
        [InputMistake::CameraToWorld, InputMistake::AxesUpAndBack, InputMistake::CameraToWorldAxesUpAndBack];
    let orders = [(false, false), (false, true), (true, false), (true, true)]
        .map(|(w_first, to_world)| InputMistake::QuaternionOrder { w_first, to_world });
    poses.into_iter().chain(orders).chain((-16..=16).filter(|step| *step != 0).map(focal))
}

/// Returns the view with the mistake undone.
fn without_mistake(view: &View, fault: Option<InputMistake>) -> View {
    let given = view.cam_from_world;
    let inverse = || {
        let inverse = given.inverse();
        CameraFromWorld::new(*inverse.rotation(), *inverse.translation())
    };
    let flipped = |pose: CameraFromWorld| {
        let flip = Rotation3::from_matrix_unchecked(Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0)));
        CameraFromWorld::new(flip * pose.rotation(), flip * pose.translation())
    };
    match fault {
        None => view.with(given, 1.0),
        Some(InputMistake::CameraToWorld) => view.with(inverse(), 1.0),
        Some(InputMistake::AxesUpAndBack) => view.with(flipped(given), 1.0),
        Some(InputMistake::CameraToWorldAxesUpAndBack) => view.with(flipped(inverse()), 1.0),
        Some(InputMistake::QuaternionOrder { w_first, to_world }) => {
            let written = if to_world { given.rotation().inverse() } else { *given.rotation() };
            let q = UnitQuaternion::from_rotation_matrix(&written);
            let mut wxyz = [q.w, q.i, q.j, q.k];
            if w_first {
                wxyz.rotate_left(1);
            } else {
                wxyz.rotate_right(1);
            }
            let [w, x, y, z] = wxyz;
            let right = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z)).to_rotation_matrix();
            // A pose of the camera in the world has its centre, and the reverse the origin of the world.
            view.with(
                if to_world {
                    let rotation = right.inverse();
                    CameraFromWorld::new(rotation, -(rotation * given.center().coords))
                } else {
                    CameraFromWorld::new(right, *given.translation())
                },
                1.0,
            )
        }
        Some(InputMistake::FocalLength { percent }) => view.with(given, 100.0 / f64::from(percent)),
    }
}

/// Returns pairs for images spread over the map: the most similar images, and a moderately similar one; neighbours in a
/// sequence are so close that any pose explains them.
fn pairs_by_similarity(globals: &[&GlobalDescriptor]) -> Vec<(usize, usize)> {
    let count = globals.len();
    let focus = (0..count).step_by(count.div_ceil(MAX_FOCUS).max(1));
    let mut pairs: Vec<(usize, usize)> = focus
        .collect::<Vec<_>>()
        .into_par_iter()
        .flat_map_iter(|i| {
            let mut ranked: Vec<(f32, usize)> = (0..count)
                .filter(|j| *j != i)
                .map(|j| (globals[i].similarity(globals[j].as_codes()), j))
                .collect();
            ranked.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
            RANKS.into_iter().filter_map(move |rank| ranked.get(rank).map(|(_, j)| (i.min(*j), i.max(*j))))
        })
        .collect();
    pairs.sort_unstable();
    pairs.dedup();
    pairs
}

type PairMatches = ((usize, usize), Vec<Match>);

fn match_pairs(
    pairs: &[(usize, usize)],
    descriptors: &[DescriptorView<'_>],
    max_ratio: f32,
) -> Vec<PairMatches> {
    let options = MatchOptions::default().with_mutual(true).with_max_ratio(Some(max_ratio));
    pairs
        .par_iter()
        .map(|&(i, j)| ((i, j), match_descriptors(descriptors[i], descriptors[j], &options)))
        .collect()
}

/// Maximum number of images whose pairs are used.
const MAX_FOCUS: usize = 24;
/// Ranks of their partners by similarity.
const RANKS: [usize; 3] = [0, 2, 5];
/// With fewer matches there is no conclusion.
const MIN_MATCHES: usize = 50;
/// Minimum share of agreeing matches for a cause to be named.
const MIN_SHARE: f64 = 0.4;
/// Minimum gain in the share of agreeing matches over the given poses and cameras.
const MIN_GAIN: f64 = 0.15;
