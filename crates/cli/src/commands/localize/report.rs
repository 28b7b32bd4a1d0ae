//! `veiloc localize --report`: the results as one HTML file.

use std::path::{Component, Path, PathBuf};

use veiloc_features::{load_colour, spelled_image_extensions};
use veiloc_localization::{LocalizeOptions, localize};
use veiloc_map::MapFile;
use veiloc_pose::State;
use veiloc_protocol::{AnswerPose, AnswerState, SealedQuery};
use veiloc_report::{
    LocalizationReport, Method, QueryDrawing, QueryOutcome, SceneView, SentDrawing, localization_page,
    worst_first,
};

use super::document::{LocalizedQuery, StateCounts, doubts};
use crate::args::report_args::ReportFileArgs;
use crate::commands::eval::html;
use crate::output::exit::Failure;
use crate::output::ui::Ui;

/// The report, and the folder of the query images.
#[derive(clap::Args)]
pub(super) struct ReportArgs {
    #[command(flatten)]
    report: ReportFileArgs,
    /// Folder of the images that were sealed, for the report: for `door.vquery` the image `door.jpg` or another image
    /// extension, at the same relative path; for images of a list (--queries) the image of that name. Default: the
    /// report contains no images.
    #[arg(long, value_name = "DIR", requires = "report_file")]
    report_images: Option<PathBuf>,
}

impl ReportArgs {
    /// Returns whether a report was requested: queries are then stored until it is written.
    pub(super) const fn is_requested(&self) -> bool {
        self.report.file.is_some()
    }

    /// Writes the report if requested. Drawn queries are localized once more, with the same result.
    ///
    /// `map_name`: as given. `sealed` holds the queries in the same order, as far as they could be read.
    pub(super) fn write(
        &self,
        map_name: &str,
        queries: &[LocalizedQuery],
        sealed: &[Option<SealedQuery>],
        map: &MapFile,
        options: &LocalizeOptions,
        ui: &Ui,
    ) -> Result<(), Failure> {
        let Some(path) = &self.report.file else { return Ok(()) };
        let mut run = filled(map_name, queries, sealed, map);
        let worst = worst_first(&run.methods, &run.outcomes).into_iter().take(self.report.queries.into());
        for (_, name) in worst {
            let of_name = queries.iter().zip(sealed).find(|(query, _)| query.file == name);
            let Some((query, Some(sealed))) = of_name else { continue };
            // A withheld pose is not drawn either.
            let has_pose = query.answer().is_some_and(|answer| answer.pose.is_some());
            let found = has_pose.then(|| localize(sealed, map, options).ok()).flatten();
            let sent = SentDrawing::of(sealed, found.as_ref(), map);
            let image = self.report_images.as_deref().and_then(|folder| image_of(folder, Path::new(&name)));
            let drawing = QueryDrawing { scene: 0, name, image, is_undistorted: false, sent: vec![sent] };
            run.drawings.push(drawing);
        }
        let images = run.drawings.iter().filter(|drawing| drawing.image.is_some()).count();
        run.notices.push(match images {
            0 => "This file contains no images, only what was sent. Give the folder of the sealed images \
                  with --report-images to add them."
                .to_owned(),
            n => format!(
                "This file contains {n} query images. They were added on this device and were not sent \
                 anywhere; everyone who gets the file gets them. Their lens distortion is not removed, \
                 because a sealed query does not contain it, so lines may lie beside their keypoints."
            ),
        });
        html::write_page(path, &localization_page(&run), ui)
    }
}

/// The tables of the report, and the scene.
fn filled(
    map_name: &str,
    queries: &[LocalizedQuery],
    sealed: &[Option<SealedQuery>],
    map: &MapFile,
) -> LocalizationReport {
    let answered: Vec<(&LocalizedQuery, Option<&SealedQuery>)> =
        queries.iter().zip(sealed.iter().map(Option::as_ref)).filter(|(query, _)| query.is_valid()).collect();
    let mut run = LocalizationReport {
        title: "Where the queries were taken".to_owned(),
        lead: format!(
            "{} sealed queries localized in {map_name}: {} have a pose.",
            answered.len(),
            StateCounts::of(queries).with_pose()
        ),
        unit: html::unit_of(map),
        scenes: vec![SceneView::of_map("", map)],
        facts: html::facts(None),
        ..LocalizationReport::default()
    };
    let size = format!("{map_name}: {} images, {} points", map.image_count(), map.point_count());
    run.facts.push(("Map".to_owned(), size));
    for (query, sealed) in answered {
        let scheme = sealed.map(|sealed| sealed.scheme().to_string()).unwrap_or_default();
        let method = run.methods.iter().position(|method| method.scheme == scheme).unwrap_or_else(|| {
            run.methods.push(Method { scheme, ..Method::default() });
            run.methods.len() - 1
        });
        run.outcomes.push(outcome(query, sealed, method));
    }
    run.add_cards();
    run
}

fn outcome(query: &LocalizedQuery, sealed: Option<&SealedQuery>, method: usize) -> QueryOutcome {
    let mut outcome = QueryOutcome {
        method,
        name: query.file.clone(),
        state: Some(State::NotFound),
        bytes: sealed.map(|sealed| sealed.encode().len()),
        remark: query.reason(),
        ..QueryOutcome::default()
    };
    let Some(answer) = query.answer() else { return outcome };
    let pose = answer.pose.as_ref();
    let times = &answer.times;
    outcome.state = Some(match answer.state() {
        AnswerState::Trusted => State::Trusted,
        AnswerState::Doubtful => State::Doubtful,
    });
    outcome.estimate = pose.and_then(AnswerPose::cam_from_world);
    outcome.position_sd = pose.map(AnswerPose::position_sd);
    outcome.rotation_sd_deg = pose.map(AnswerPose::rotation_sd_deg);
    (outcome.inliers, outcome.matches) = (answer.inliers as usize, answer.matches as usize);
    outcome.ms = Some(times.retrieve_ms + times.match_ms + times.pose_ms);
    if outcome.remark.is_none() && !answer.trusted() {
        outcome.remark = Some(doubts(answer));
    }
    outcome
}

/// Finds the image of a sealed query: the longest suffix of its path that exists in the folder.
fn image_of(folder: &Path, query: &Path) -> Option<image::RgbImage> {
    let parts: Vec<_> = query.iter().collect();
    let tails = (0..parts.len()).map(|from| parts[from..].iter().collect::<PathBuf>());
    // Other paths would leave the folder.
    let inside = tails.filter(|tail| tail.components().all(|part| matches!(part, Component::Normal(_))));
    let mut named =
        inside.flat_map(|tail| spelled_image_extensions().map(move |e| folder.join(tail.with_extension(e))));
    let colour = load_colour(&named.find(|path| path.is_file())?).ok()?;
    image::RgbImage::from_raw(colour.width(), colour.height(), colour.data().to_vec())
}
