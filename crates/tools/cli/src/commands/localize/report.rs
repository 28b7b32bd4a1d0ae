//! `veiloc localize --report`: the answers as one HTML file, to look at.

use std::path::{Component, Path, PathBuf};

use veiloc_geometry::deviations::rotation_sd_degrees;
use veiloc_localization::{LocalizeOptions, localize};
use veiloc_map::MapFile;
use veiloc_pose::State;
use veiloc_protocol::SealedQuery;
use veiloc_report::{
    PlaceView, QueryDrawing, QueryOutcome, RunReport, RunRow, SentDrawing, run_page, worst_first,
};

use super::document::{Document, Query, Status, name_of};
use crate::args::report_args::ReportFileArgs;
use crate::exit::Failure;
use crate::files;
use crate::ui::Ui;

/// The report, and where the images of its queries are.
#[derive(clap::Args)]
pub(super) struct ReportArgs {
    #[command(flatten)]
    report: ReportFileArgs,
    /// Folder of the images that were sealed, for the report: of `door.vquery` the image `door.jpg` or another ending, in it or in
    /// a folder of it as the query is; of images of a list (--queries) those of that name. Default: the report holds no images.
    #[arg(long, value_name = "DIR", requires = "report_file")]
    report_images: Option<PathBuf>,
}

/// Endings that images have.
const ENDINGS: [&str; 6] = ["jpg", "jpeg", "png", "JPG", "JPEG", "PNG"];

impl ReportArgs {
    /// Whether there will be one: then queries are kept until it is written.
    pub(super) const fn is_asked(&self) -> bool {
        self.report.file.is_some()
    }

    /// Writes the report where one is asked for. Queries that are drawn are localized once more, with the same result.
    ///
    /// `sealed` are the queries of the document, in its order, as far as they could be read.
    pub(super) fn write(
        &self,
        document: &Document,
        sealed: &[Option<SealedQuery>],
        map: &MapFile,
        options: &LocalizeOptions,
        ui: &Ui,
    ) -> Result<(), Failure> {
        let Some(path) = &self.report.file else { return Ok(()) };
        let mut run = filled(document, sealed, map);
        let worst = worst_first(&run.rows, &run.outcomes).into_iter().take(self.report.queries.into());
        for (_, name) in worst {
            let of_name = document.queries.iter().zip(sealed).find(|(query, _)| query.file == name);
            let Some((query, Some(sealed))) = of_name else { continue };
            // A withheld pose is not drawn either.
            let found = localize(sealed, map, options).ok().filter(|_| query.status == Status::Localized);
            let sent = SentDrawing::of(sealed, found.as_ref(), map);
            let image = self.report_images.as_deref().and_then(|folder| image_of(folder, Path::new(&name)));
            run.drawings.push(QueryDrawing { place: 0, name, image, sent: vec![sent] });
        }
        let images = run.drawings.iter().filter(|drawing| drawing.image.is_some()).count();
        run.remarks.push(match images {
            0 => "This file contains no images, only what was sent. --report-images names the folder of those that were sealed."
                .to_owned(),
            n => format!(
                "This file contains {n} images of queries. They were put in on this device and sent nowhere; who gets the file gets \
                 them. The lens is not undone in them, for a sealed query does not tell it, so lines may lie beside what they run through."
            ),
        });
        let page = run_page(&run);
        files::write(path, page.as_bytes())?;
        ui.say(format!(
            "report: {} ({:.1} MB; open it in a browser)",
            path.display(),
            page.len() as f64 / 1e6
        ));
        Ok(())
    }
}

/// The tables of the report, and the place.
fn filled(document: &Document, sealed: &[Option<SealedQuery>], map: &MapFile) -> RunReport {
    let answered: Vec<(&Query, Option<&SealedQuery>)> = document
        .queries
        .iter()
        .zip(sealed.iter().map(Option::as_ref))
        .filter(|(q, _)| q.status != Status::Failed)
        .collect();
    let mut run = RunReport {
        title: "Where the queries were taken".to_owned(),
        lead: format!(
            "{} sealed queries localized in {}: {} have a pose.",
            answered.len(),
            document.map,
            document.localized
        ),
        places: vec![PlaceView::of_map("", map)],
        details: vec![
            (
                "Map".to_owned(),
                format!("{}: {} images, {} points", document.map, map.image_count(), map.point_count()),
            ),
            ("Version".to_owned(), format!("veiloc {}", env!("CARGO_PKG_VERSION"))),
            ("Lengths".to_owned(), "map units, written as metres".to_owned()),
        ],
        ..RunReport::default()
    };
    for (query, sealed) in answered {
        let scheme = sealed.map(|sealed| sealed.scheme().to_string()).unwrap_or_default();
        let row = run.rows.iter().position(|row| row.scheme == scheme).unwrap_or_else(|| {
            run.rows.push(RunRow { scheme, ..RunRow::default() });
            run.rows.len() - 1
        });
        run.outcomes.push(outcome(query, sealed, row));
    }
    run.add_cards();
    run
}

fn outcome(query: &Query, sealed: Option<&SealedQuery>, row: usize) -> QueryOutcome {
    let error = query.error.as_ref().map(|error| error.message().to_owned());
    let doubts = (!query.doubts.is_empty()).then(|| query.doubts.join("; "));
    QueryOutcome {
        row,
        name: query.file.clone(),
        estimate: query.cam_from_world.as_ref().and_then(veiloc_evaluation::results::PoseDocument::pose),
        state: State::ALL.into_iter().find(|state| name_of(*state) == query.state),
        position_sd: query.position_sd,
        rotation_sd_deg: query.covariance.as_ref().map(rotation_sd_degrees),
        inliers: query.inliers,
        matches: query.matches,
        bytes: sealed.map(|sealed| sealed.encode().len()),
        ms: (!query.ms.is_empty()).then(|| query.ms.values().sum()),
        remark: error.or(doubts),
        ..QueryOutcome::default()
    }
}

/// The image of a sealed query: the longest tail of its path that is there under the folder.
fn image_of(folder: &Path, query: &Path) -> Option<image::RgbImage> {
    let parts: Vec<_> = query.iter().collect();
    let tails = (0..parts.len()).map(|from| parts[from..].iter().collect::<PathBuf>());
    // Others would leave the folder.
    let inside = tails.filter(|tail| tail.components().all(|part| matches!(part, Component::Normal(_))));
    let named = inside.flat_map(|tail| ENDINGS.map(|ending| folder.join(tail.with_extension(ending))));
    let path = named.into_iter().find(|path| path.is_file())?;
    Some(image::open(path).ok()?.to_rgb8())
}
