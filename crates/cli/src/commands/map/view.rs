//! `veiloc map view`: a map as one HTML page: its points and cameras in 3D, its weak parts, where a camera is localized, and advice.

use std::collections::BTreeMap;
use std::path::PathBuf;

use veiloc_geometry::deviations::position_sd;
use veiloc_geometry::nalgebra::Vector3;
use veiloc_map::{MapFile, MapModel};
use veiloc_mapping::calibration::{SelfTestOptions, SelfTestTrial, chosen, is_testable, trials};
use veiloc_mapping::coverage::{Coverage, HEADINGS};
use veiloc_pose::State;
use veiloc_protocol::{DclLayout, Scheme};
use veiloc_report::{
    Card, HeatCell, HeatMap, LocalizationReport, Method, QueryOutcome, SceneView, localization_page,
};

use crate::commands::eval::html;
use crate::output::exit::{Exit, Outcome};
use crate::output::stages::Stages;
use crate::output::targets::OutFile;
use crate::output::ui::Ui;

/// Write a page that shows a map in 3D, its weak parts, and what to do about them.
///
/// Images of the map are localized in the map without them, from points and under dcl: those without a trusted pose mark its weak
/// parts. A heat map shows the ± that a camera anywhere near the images is expected to get. The page is one file that needs no
/// network. It shows map points and names of images: protect it as the map.
#[derive(clap::Args)]
pub(crate) struct ViewArgs {
    /// The map.
    map: PathBuf,
    /// The page to write.
    #[arg(long, short, value_name = "FILE")]
    out: OutFile,
    /// Images that are localized, evenly spaced over the map; 0 localizes none.
    #[arg(long, value_name = "N", default_value_t = 200)]
    test_images: usize,
}

/// Points that an image should observe: fewer are a weak part.
const FEW_POINTS: usize = 100;
/// Percentage of the ground below which a part is not worth advice.
const SMALL_PART: usize = 5;
/// Share of the directions below which they are worth advice.
const FEW_DIRECTIONS: f64 = 0.5;
/// Images that advice on the ground asks for.
const MORE_IMAGES: usize = 10;
/// Images that a piece of advice names.
const NAMED: usize = 8;

const SCHEMES: [Scheme; 2] = [Scheme::Points, Scheme::Dcl(DclLayout::DEFAULT)];

pub(super) fn run(args: &ViewArgs, ui: &Ui) -> Outcome {
    let map = MapFile::open(&args.map)?;
    let model = map.to_model();
    let mut options = SelfTestOptions::default();
    options.images = args.test_images;
    options.schemes = SCHEMES.into();
    let is_tested = args.test_images > 0 && is_testable(&model) && model.compressed.is_none();
    let images = if is_tested { chosen(&model, &options) } else { Vec::new() };
    let found =
        if images.is_empty() { Vec::new() } else { trials(&model, &images, &options, &Stages::new(ui))? };
    let of_points = found.iter().map(|trials| trials.first().and_then(Option::as_ref));
    let tested: Vec<(usize, Option<&SelfTestTrial>)> = images.iter().copied().zip(of_points).collect();
    // A compressed map has not all of its observations.
    let coverage = model.compressed.is_none().then(|| Coverage::of(&model, &tested));
    let page = localization_page(&report(args, &map, &model, &images, &found, coverage.as_ref()));
    html::write_page(&args.out, &page, ui)?;
    for advice in advice(&model, &images, &found, coverage.as_ref()) {
        ui.info(advice);
    }
    Ok(Exit::Success)
}

type Trials = [Vec<Option<SelfTestTrial>>];

fn report(
    args: &ViewArgs,
    map: &MapFile,
    model: &MapModel,
    images: &[usize],
    found: &Trials,
    coverage: Option<&Coverage>,
) -> LocalizationReport {
    // The page's plan and the grid have one up direction, so that cells fit together.
    let mut scene = SceneView::of_map("", map);
    scene.up = scene.up.or(coverage.map(|coverage| coverage.up.into()));
    let mut report = LocalizationReport {
        title: format!("The map {}", args.map.display()),
        lead: format!(
            "{} images, {} points. {} images were localized in the map without them.",
            model.images.len(),
            model.points.len(),
            images.len()
        ),
        notices: advice(model, images, found, coverage),
        unit: html::unit_of(map),
        scenes: vec![scene],
        facts: html::facts(None),
        cards: cards(model, found, coverage),
        heat: coverage.map(heat).unwrap_or_default(),
        ..LocalizationReport::default()
    };
    for (column, scheme) in SCHEMES.into_iter().enumerate().filter(|_| !images.is_empty()) {
        report.methods.push(Method { scheme: scheme.name().to_owned(), ..Method::default() });
        for (image, trials) in images.iter().zip(found) {
            report.outcomes.push(outcome(model, *image, column, trials.get(column).and_then(Option::as_ref)));
        }
    }
    report
}

/// An image as a query of a scheme: it is drawn at its place in the map, in the colour of its state.
fn outcome(model: &MapModel, image: usize, method: usize, trial: Option<&SelfTestTrial>) -> QueryOutcome {
    let image = &model.images[image];
    let state = match trial {
        None => State::NotFound,
        Some(trial) if trial.trusted => State::Trusted,
        Some(_) => State::Doubtful,
    };
    let points = image.point_of_keypoint.iter().flatten().count();
    QueryOutcome {
        method,
        name: image.name.clone(),
        truth: Some(image.cam_from_world),
        estimate: trial.is_some().then_some(image.cam_from_world),
        state: Some(state),
        position_error: trial.map(|trial| length(&trial.step[3..])),
        rotation_error_deg: trial.map(|trial| length(&trial.step[..3]).to_degrees()),
        position_sd: trial.map(|trial| position_sd(&trial.covariance)).filter(|sd| sd.is_finite()),
        inliers: points,
        matches: image.keypoints.len(),
        remark: (points < FEW_POINTS).then(|| format!("observes {points} map points only")),
        ..QueryOutcome::default()
    }
}

fn cards(model: &MapModel, found: &Trials, coverage: Option<&Coverage>) -> Vec<Card> {
    let card = |value: String, label: &str, note: &str| Card {
        value,
        label: label.to_owned(),
        note: note.to_owned(),
    };
    let mut cards = vec![
        card(
            format!("{:.1}", model.mean_track_length()),
            "images observe a point",
            "Points that many images observe are accurate and are found from many viewpoints.",
        ),
        card(
            format!("{:.2} px", model.mean_reprojection_error()),
            "mean reprojection error",
            "Well below a pixel: poses and cameras fit the images.",
        ),
    ];
    for (column, scheme) in SCHEMES.into_iter().enumerate().filter(|_| !found.is_empty()) {
        let trusted = found.iter().filter(|trials| is_trusted(trials, column)).count();
        cards.push(card(
            format!("{:.0} %", 100.0 * trusted as f64 / found.len() as f64),
            &format!("trusted from {}", scheme.name()),
            "Share of the map's images that are localized with a trusted pose when they are left out.",
        ));
    }
    if let Some(coverage) = coverage.filter(|coverage| !coverage.nodes.is_empty()) {
        cards.push(card(
            format!("{:.0} %", 100.0 * coverage.share()),
            "of views are expected to be localized",
            "Level cameras on the ground near the images of the map, in all directions.",
        ));
    }
    cards
}

/// The cells around the nodes of the grid, at the height of the images.
fn heat(coverage: &Coverage) -> HeatMap {
    let [a, b] = coverage.axes.map(|axis| axis * (0.5 * coverage.step));
    let cells = coverage.nodes.iter().map(|node| HeatCell {
        corners: [-a - b, a - b, a + b, b - a].map(|corner| (node.position + corner).into()),
        sd: node.median(),
        share: node.share(),
    });
    HeatMap { cells: cells.collect() }
}

fn is_trusted(trials: &[Option<SelfTestTrial>], column: usize) -> bool {
    trials.get(column).and_then(Option::as_ref).is_some_and(|trial| trial.trusted)
}

/// What to do about the weak parts of a map, a sentence each.
fn advice(model: &MapModel, images: &[usize], found: &Trials, coverage: Option<&Coverage>) -> Vec<String> {
    let name = |image: usize| model.images[image].name.as_str();
    let mut advice = Vec::new();
    let weak: Vec<usize> = images
        .iter()
        .zip(found)
        .filter(|(_, trials)| !is_trusted(trials, 0))
        .map(|(image, _)| *image)
        .collect();
    if !weak.is_empty() {
        advice.push(format!(
            "{} of {} images have no trusted pose without themselves: {}. Take more images around them, from different \
             positions.",
            weak.len(),
            images.len(),
            listed(weak.iter().map(|image| name(*image)))
        ));
    }
    let points = |image: &veiloc_map::MapImage| image.point_of_keypoint.iter().flatten().count();
    let few: Vec<&str> = model
        .images
        .iter()
        .filter(|image| points(image) < FEW_POINTS)
        .map(|image| image.name.as_str())
        .collect();
    if !few.is_empty() {
        advice.push(format!(
            "{} images observe fewer than {FEW_POINTS} map points: {}. They show little texture, are blurred, or overlap with \
             few others.",
            few.len(),
            listed(few.iter().copied())
        ));
    }
    let alike: Vec<String> = images
        .iter()
        .zip(found)
        .filter_map(|(image, trials)| {
            let other = trials.iter().flatten().find_map(|trial| trial.looks_like)?;
            Some(format!("{} and {}", name(*image), name(other)))
        })
        .collect();
    if !alike.is_empty() {
        advice.push(format!(
            "Places look alike: {}. Take images that show what differs, and give a rough position with queries (--near).",
            listed(alike.iter().map(String::as_str))
        ));
    }
    let thin = model.points.iter().filter(|point| point.track.len() < 4).count();
    if 2 * thin > model.points.len() {
        advice.push(format!(
            "{thin} of {} points are observed by three images or fewer: take images at smaller distances.",
            model.points.len()
        ));
    }
    advice.extend(coverage.into_iter().flat_map(|coverage| advice_on_ground(model, coverage)));
    if model.down.is_none() {
        advice.push(
            "Gravity is not known: `veiloc map align --level` or --down at `map build` makes poses more reliable.".to_owned(),
        );
    }
    if advice.is_empty() {
        advice.push("No weak part was found.".to_owned());
    }
    advice
}

/// What to do about ground where no camera is localized, and about directions in which none is.
fn advice_on_ground(model: &MapModel, coverage: &Coverage) -> Vec<String> {
    let mut advice = Vec::new();
    let weak = coverage.weak_parts();
    let largest = weak.first().filter(|part| part.len() >= SMALL_PART * coverage.nodes.len() / 100);
    if let Some(part) = largest {
        let mut nearest: BTreeMap<usize, usize> = BTreeMap::new();
        for at in part {
            *nearest.entry(coverage.nodes[*at].nearest).or_default() += 1;
        }
        let image = nearest.into_iter().max_by_key(|(image, count)| (*count, std::cmp::Reverse(*image)));
        let share = 100.0 * weak.iter().map(Vec::len).sum::<usize>() as f64 / coverage.nodes.len() as f64;
        advice.push(format!(
            "On {share:.0} % of the ground near the images, a camera is not localized in any direction; the largest such part is next \
             to {}. If queries are taken there, take about {MORE_IMAGES} more images there.",
            image.map_or("", |(image, _)| model.images[image].name.as_str())
        ));
    }
    if coverage.nodes.is_empty() || coverage.share() >= FEW_DIRECTIONS {
        return advice;
    }
    // The direction in which fewest cameras are localized, named by the images that look most nearly the other way.
    let localized = |heading: usize| coverage.nodes.iter().filter(|node| node.sd[heading].is_some()).count();
    let worst = (0..HEADINGS).min_by_key(|heading| localized(*heading)).unwrap_or(0);
    let angle = std::f64::consts::TAU * worst as f64 / HEADINGS as f64;
    let ahead = coverage.axes[0] * angle.cos() + coverage.axes[1] * angle.sin();
    let along =
        |image: &veiloc_map::MapImage| (image.cam_from_world.rotation().inverse() * Vector3::z()).dot(&ahead);
    let opposite = model.images.iter().min_by(|a, b| along(a).total_cmp(&along(b)));
    advice.push(format!(
        "Near the images a camera is localized in {:.0} % of the directions. Fewest look away from what {} shows: if queries do, take \
         about {MORE_IMAGES} images that look there, from several positions.",
        100.0 * coverage.share(),
        opposite.map_or("", |image| image.name.as_str())
    ));
    advice
}

fn length(step: &[f64]) -> f64 {
    step.iter().map(|x| x * x).sum::<f64>().sqrt()
}

fn listed<'a>(names: impl ExactSizeIterator<Item = &'a str>) -> String {
    let more = names.len().saturating_sub(NAMED);
    let shown: Vec<&str> = names.take(NAMED).collect();
    let more = if more > 0 { format!(" and {more} more") } else { String::new() };
    format!("{}{more}", shown.join(", "))
}
