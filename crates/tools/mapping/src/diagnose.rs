//! Why the images of a map do not fit together: poses and cameras are changed as people get them wrong, and where matches
//! then agree with them much better, that is the likely cause.
//!
//! Pairs of images are chosen by how they look, because poses that may be wrong cannot choose them. Their matches are
//! made once; then each hypothesis asks how many of them lie on each other's epipolar lines and meet in front of both
//! cameras.

use rayon::prelude::*;
use veiloc_descriptor::{DescriptorView, GlobalDescriptor, Match, MatchOptions, match_descriptors};
use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::nalgebra::{Matrix3, Rotation3, Vector3};
use veiloc_map::MapModel;

use crate::matching::Epipolar;
use crate::report::{BuildReport, Doubt, Fault};
use crate::scene::Scene;
use crate::view::View;

/// The likely reason why the matches of a map's images do not agree with their poses and cameras; `None` where they do
/// agree, or no hypothesis explains them much better.
///
/// Measures every time it is asked, by matching some dozen pairs of images: for maps that are doubted already.
pub fn diagnose(model: &MapModel) -> Option<Doubt> {
    let scene = Scene::of(model, &model.settings);
    let globals: Vec<&GlobalDescriptor> = model.images.iter().map(|i| &i.global).collect();
    let pairs = pairs_by_looks(&globals);
    let matched = match_pairs(&pairs, &scene.descriptors, model.settings.max_ratio);
    let matches: usize = matched.iter().map(|(_, m)| m.len()).sum();
    if matches < MIN_MATCHES {
        return None;
    }
    let share = |fault: Option<Fault>| {
        let agreeing: usize = matched
            .par_iter()
            .map(|((i, j), matches)| {
                let [a, b] = [*i, *j].map(|k| mended(&scene.views[k], fault));
                let relation = Epipolar::between(&a, &b);
                matches
                    .iter()
                    .filter(|m| relation.admits(&a, m.query as usize, &b, m.database as usize))
                    .count()
            })
            .sum();
        agreeing as f64 / matches as f64
    };
    let given = share(None);
    let mut best: Option<(f64, Fault)> = None;
    for fault in faults() {
        let then = share(Some(fault));
        if best.is_none_or(|(most, _)| then > most) {
            best = Some((then, fault));
        }
    }
    let (then, fault) = best?;
    let percent = |share: f64| (100.0 * share).round() as u32;
    (then >= LEAST_SHARE && then >= given + LEAST_GAIN).then_some(Doubt::LikelyCause {
        fault,
        agree_percent: percent(given),
        would_percent: percent(then),
    })
}

/// Adds the likely cause to what is doubted of a map, when it is doubted or few of its matches agree.
pub(crate) fn explain(report: &mut BuildReport, model: &MapModel) {
    if !report.doubts.is_empty() || Doubt::is_worth_asking(report.matches, report.verified) {
        report.doubts.extend(diagnose(model));
    }
}

/// What people get wrong. Of focal lengths, steps of an eighth octave from a quarter to four times.
fn faults() -> impl Iterator<Item = Fault> {
    // The matches of a sound map lose a tenth of their agreement with an eighth octave.
    let focal =
        |step: i32| Fault::FocalLength { percent: (100.0 * (f64::from(step) / 8.0).exp2()).round() as u32 };
    let poses = [Fault::CameraToWorld, Fault::AxesUpAndBack, Fault::CameraToWorldAxesUpAndBack];
    poses.into_iter().chain((-16..=16).filter(|step| *step != 0).map(focal))
}

/// The view as it would be had the fault not been made.
fn mended(view: &View, fault: Option<Fault>) -> View {
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
        Some(Fault::CameraToWorld) => view.with(inverse(), 1.0),
        Some(Fault::AxesUpAndBack) => view.with(flipped(given), 1.0),
        Some(Fault::CameraToWorldAxesUpAndBack) => view.with(flipped(inverse()), 1.0),
        Some(Fault::FocalLength { percent }) => view.with(given, 100.0 / f64::from(percent)),
    }
}

/// For images spread over the map, the ones that look most alike, and one that looks somewhat alike: neighbours in a walk
/// stand so near each other that any pose explains them.
fn pairs_by_looks(globals: &[&GlobalDescriptor]) -> Vec<(usize, usize)> {
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

type Matched = ((usize, usize), Vec<Match>);

fn match_pairs(pairs: &[(usize, usize)], descriptors: &[DescriptorView<'_>], max_ratio: f32) -> Vec<Matched> {
    let options = MatchOptions::default().with_mutual(true).with_max_ratio(Some(max_ratio));
    pairs
        .par_iter()
        .map(|&(i, j)| ((i, j), match_descriptors(descriptors[i], descriptors[j], &options)))
        .collect()
}

/// Images whose pairs are asked.
const MAX_FOCUS: usize = 24;
/// Ranks of their partners by looks.
const RANKS: [usize; 3] = [0, 2, 5];
/// Fewer matches say nothing.
const MIN_MATCHES: usize = 50;
/// Least share of matches that agrees under a cause that is named.
const LEAST_SHARE: f64 = 0.4;
/// How much more of all matches must agree than as things were given.
const LEAST_GAIN: f64 = 0.15;
