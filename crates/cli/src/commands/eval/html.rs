//! `--report FILE` of evaluations: collects results while they run, and writes the report.

use std::path::{Path, PathBuf};

use tempfile::TempDir;
use veiloc_evaluation::report::{add_scene, query_drawing};
use veiloc_evaluation::results::{QueryResult, SchemeSummary};
use veiloc_evaluation::{DrawnQuery, SceneEvaluation, drawn_queries};
use veiloc_geometry::deviations::{position_sd, rotation_sd_degrees};
use veiloc_map::MapFile;
use veiloc_report::{LengthUnit, LocalizationReport, SceneView, localization_page, worst_first};

use crate::args::report_args::ReportFileArgs;
use crate::output::command_line::command_line;
use crate::output::exit::Failure;
use crate::output::files;
use crate::output::stages::Stages;
use crate::output::ui::Ui;

/// The HTML report of an evaluation.
#[derive(clap::Args)]
pub(super) struct HtmlArgs {
    #[command(flatten)]
    report: ReportFileArgs,
    /// Leave the images out of the report. Default: it contains the images of the queries that it draws, so everyone
    /// who gets the file gets these images.
    #[arg(long, requires = "report_file")]
    report_without_images: bool,
}

/// The unit of lengths of a map.
pub(crate) fn unit_of(map: &MapFile) -> LengthUnit {
    if map.is_metric() { LengthUnit::Metres } else { LengthUnit::Map }
}

impl HtmlArgs {
    /// Begins a report of this number of scenes, with lengths in this unit; `None` if no report was requested.
    pub(super) fn begin(&self, scenes: usize, unit: LengthUnit) -> Result<Option<HtmlReport>, Failure> {
        let Some(path) = self.report.file.as_deref().map(Path::to_owned) else { return Ok(None) };
        let folder = tempfile::tempdir().map_err(|e| Failure::output(std::env::temp_dir().display(), &e))?;
        let each = usize::from(self.report.queries).div_ceil(scenes.max(1));
        Ok(Some(HtmlReport {
            path,
            each,
            images: !self.report_without_images,
            folder,
            run: LocalizationReport { unit, ..LocalizationReport::default() },
        }))
    }
}

/// A report that is being filled.
pub(super) struct HtmlReport {
    path: PathBuf,
    /// Number of queries drawn per scene.
    each: usize,
    images: bool,
    /// Stores maps until they are drawn, if the user does not keep them.
    folder: TempDir,
    run: LocalizationReport,
}

impl HtmlReport {
    /// Makes the evaluation store its map, which is drawn afterwards.
    pub(super) fn keep_map(&self, evaluation: &mut SceneEvaluation) {
        evaluation.keep_map.get_or_insert_with(|| self.folder.path().join("place.vmap"));
    }

    /// Adds a scene that was evaluated: its part of the document, and drawings of its worst queries.
    pub(super) fn add<'a>(
        &mut self,
        name: &str,
        evaluation: &SceneEvaluation,
        methods: impl IntoIterator<Item = &'a SchemeSummary>,
        queries: impl IntoIterator<Item = &'a QueryResult>,
        ui: &Ui,
    ) -> Result<(), Failure> {
        let Some(path) = &evaluation.keep_map else { return Ok(()) };
        let map = MapFile::open(path)?;
        let scene = self.run.scenes.len();
        let judged = |query: &str| evaluation.query_list.iter().any(|name| name == query);
        let truth =
            |query: &str| evaluation.posed.get(query).filter(|_| judged(query)).map(|i| i.cam_from_world);
        add_scene(&mut self.run, SceneView::of_map(name, &map), methods, queries, &truth);
        let worst = worst_first(&self.run.methods, &self.run.outcomes).into_iter();
        let names: Vec<String> =
            worst.filter(|(at, _)| *at == scene).map(|(_, name)| name).take(self.each).collect();
        for drawn in drawn_queries(evaluation, &map, &names, &Stages::new(ui))? {
            self.add_deviations(scene, &drawn);
            self.run.drawings.push(query_drawing(&drawn, scene, &map, self.images));
        }
        Ok(())
    }

    /// Adds what the document lacks: standard deviations of poses without ground truth, and the reasons for doubt.
    fn add_deviations(&mut self, scene: usize, drawn: &DrawnQuery) {
        let LocalizationReport { methods, outcomes, .. } = &mut self.run;
        for sent in &drawn.sent {
            let (scheme, Some(found)) = (sent.scheme.to_string(), &sent.found) else { continue };
            let first = outcomes.iter_mut().find(|outcome| {
                let method = &methods[outcome.method];
                method.scene == scene && method.scheme == scheme && outcome.name == drawn.name
            });
            let Some(outcome) = first.filter(|outcome| outcome.estimate.is_some()) else { continue };
            outcome.position_sd = outcome.position_sd.or(Some(position_sd(&found.covariance)));
            outcome.rotation_sd_deg =
                outcome.rotation_sd_deg.or(Some(rotation_sd_degrees(&found.covariance)));
            let doubts: Vec<String> = found.confidence.doubts().iter().map(ToString::to_string).collect();
            if !doubts.is_empty() {
                outcome.remark.get_or_insert(doubts.join("; "));
            }
        }
    }

    /// Writes the report.
    pub(super) fn write(mut self, title: &str, facts: Vec<(String, String)>, ui: &Ui) -> Result<(), Failure> {
        let run = &mut self.run;
        let (queries, scenes) = (worst_first(&run.methods, &run.outcomes).len(), run.scenes.len());
        title.clone_into(&mut run.title);
        run.lead = format!(
            "{queries} queries of {} were sealed under every scheme, encoded as for a server, and \
             localized in {}. The server got lines and descriptors, neither images nor keypoints.",
            if scenes > 1 { format!("{scenes} scenes") } else { "one scene".to_owned() },
            if scenes > 1 { "the maps of their scenes" } else { "its map" },
        );
        let images = run.drawings.iter().filter(|drawing| drawing.image.is_some()).count();
        run.notices.push(match images {
            0 => "This file contains lines and map points, but no images.".to_owned(),
            n => format!(
                "This file contains {n} complete query images, including the parts that masks hide. They \
                 were added on this device and were not sent anywhere; everyone who gets the file gets \
                 them. --report-without-images leaves them out."
            ),
        });
        run.add_cards();
        run.facts = facts;
        write_page(&self.path, &localization_page(run), ui)
    }
}

/// Writes a page and prints its path.
pub(crate) fn write_page(path: &Path, page: &str, ui: &Ui) -> Result<(), Failure> {
    files::write(path, page.as_bytes())?;
    let megabytes = page.len() as f64 / 1e6;
    ui.info(format!("report: {} ({megabytes:.1} MB; open it in a browser)", path.display()));
    Ok(())
}

/// Returns the facts that are needed to repeat a run.
pub(crate) fn facts(seed: Option<u64>) -> Vec<(String, String)> {
    let seed = seed.map(|seed| ("Seed".to_owned(), seed.to_string()));
    let run = [
        ("Command".to_owned(), command_line()),
        ("Version".to_owned(), format!("veiloc {}", env!("CARGO_PKG_VERSION"))),
    ];
    run.into_iter().chain(seed).collect()
}
