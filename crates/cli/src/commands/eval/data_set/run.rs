//! Evaluates the scenes of a data set one after another, and collects their results in one document.

use veiloc_datasets::{DatasetError, DatasetScene};
use veiloc_evaluation::results::{
    DataSetEvaluation, EvaluationDocument, QueryResult, RunInfo, SceneInfo, SceneQuery, SceneSummary,
    summarize, table,
};
use veiloc_evaluation::{SceneEvaluation, evaluate_scene};
use veiloc_map::{PosedImage, PosedImages};
use veiloc_mapping::OnOtherCoordinateFrame;
use veiloc_report::LengthUnit;

use super::options::{Args, cores};
use crate::commands::eval::html;
use crate::output::exit::{Exit, Failure};
use crate::output::stages::Stages;
use crate::output::ui::Ui;

/// Evaluates the scenes and prints the results. Each scene is read again when its turn comes.
pub(super) fn evaluate(
    scenes: &[String],
    read: &dyn Fn(&str) -> Result<DatasetScene, DatasetError>,
    args: &Args,
    ui: &Ui,
) -> Result<(DataSetEvaluation, Exit), Failure> {
    // All scenes are read before the first is computed, so that missing files are reported at once.
    let scenes: Vec<DatasetScene> =
        scenes.iter().map(|name| read(name)).collect::<Result<_, _>>().map_err(refused)?;
    let mut document = DataSetEvaluation {
        version: 1,
        command: args.data_set.command(),
        data: scenes.iter().map(|scene| scene.name.clone()).collect(),
        run: facts(args),
        seed: args.estimator.seed,
        scenes: Vec::new(),
        schemes: Vec::new(),
        queries: Vec::new(),
    };
    let retrieved = args.pairs.retrieved()?;
    if scenes.len() > 1 && retrieved.is_some() {
        return Err(Failure::with_help(
            "--pairs has the queries of one scene",
            "name this scene with --scenes",
        ));
    }
    if let (Some(retrieved), [scene]) = (&retrieved, &scenes[..]) {
        let queries = scene.queries.iter().map(|query| query.name.as_str());
        args.pairs.check(retrieved, queries, &scene.mapped.names(), ui)?;
    }
    let mut report = args.html.begin(scenes.len(), LengthUnit::Metres)?;
    let mut attacked = None;
    for scene in &scenes {
        scene.remarks.iter().for_each(|remark| ui.warn(format!("{}: {remark}", scene.name)));
        ui.info(format!(
            "{}: {} images for the map, {} queries{}",
            scene.name,
            scene.mapped.images().len(),
            scene.queries.len(),
            if scene.is_official { "" } else { " (not the published scene)" }
        ));
        let mut evaluation = scene_evaluation(scene, args)?;
        evaluation.retrieved.clone_from(&retrieved);
        if let Some(report) = &report {
            report.keep_map(&mut evaluation);
        }
        let found = evaluate_scene(&evaluation, &Stages::new(ui))?;
        args.attack.attack(&scene.name, &evaluation, &mut attacked, ui)?;
        add(&mut document, scene, found, &evaluation);
        if let Some(report) = &mut report {
            let rows = document.schemes.iter().filter(|row| row.scene == scene.name);
            let rows = rows.map(|row| &row.summary);
            let queries = document.queries.iter().filter(|query| query.scene == scene.name);
            report.add(&scene.name, &evaluation, rows, queries.map(|query| &query.result), ui)?;
        }
    }
    let text = text_of(&document.schemes);
    args.json.print(&text, &document, ui)?;
    args.attack.finish(attacked.as_ref(), args.json.takes_stdout(), ui)?;
    if let Some(report) = report {
        let title = format!("veiloc {}", args.data_set.command());
        report.write(&title, html::facts(Some(document.seed)), ui)?;
    }
    let localized = document.schemes.iter().any(|row| row.summary.localized > 0);
    Ok((document, if localized { Exit::Success } else { Exit::Refused }))
}

/// A table for each scene.
fn text_of(rows: &[SceneSummary]) -> String {
    let of_scene = |rows: &[SceneSummary]| {
        let summaries: Vec<_> = rows.iter().map(|row| row.summary.clone()).collect();
        format!("{}\n{}", rows[0].scene, table(&summaries))
    };
    rows.chunk_by(|a, b| a.scene == b.scene).map(of_scene).collect::<Vec<_>>().join("\n")
}

/// Converts the error of a data set.
pub(super) fn refused(error: DatasetError) -> Failure {
    Failure::with_help(error.to_string(), "see `docs/guide/data-sets.md` for the layout of each data set")
}

fn facts(args: &Args) -> RunInfo {
    let words = crate::output::command_line::arguments().into_iter();
    RunInfo {
        veiloc: env!("CARGO_PKG_VERSION").to_owned(),
        command_line: words.map(|word| word.to_string_lossy().into_owned()).collect(),
        system: format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
        cores: cores(),
        jobs: args.jobs(),
    }
}

fn scene_evaluation(scene: &DatasetScene, args: &Args) -> Result<SceneEvaluation, Failure> {
    let known = scene.queries.iter().filter_map(|query| {
        Some(PosedImage {
            name: query.name.clone(),
            camera: query.camera,
            cam_from_world: query.cam_from_world?,
            seen: Vec::new(),
        })
    });
    let images = scene.mapped.images().iter().cloned().chain(known).collect();
    let posed = PosedImages::new(images, scene.mapped.points().to_vec()).map_err(|e| refused(e.into()))?;
    let (known, unknown): (Vec<_>, Vec<_>) =
        scene.queries.iter().partition(|query| query.cam_from_world.is_some());
    let (estimator, schemes) = args.estimator()?;
    Ok(SceneEvaluation {
        unposed: unknown.iter().map(|query| (query.name.clone(), query.camera)).collect(),
        build: args.build()?,
        // All poses of a data set are in one frame; some of its places look alike.
        on_other_coordinate_frame: OnOtherCoordinateFrame::Accept,
        schemes,
        estimators: vec![estimator],
        thresholds: args.thresholds(),
        seed: args.estimator.seed,
        work: args.work.as_ref().map(|folder| folder.join(&scene.name)),
        jobs: args.jobs(),
        ..SceneEvaluation::of_scene(
            posed,
            scene.images.clone(),
            scene.mapped.names(),
            known.iter().map(|query| query.name.clone()).collect(),
        )
    })
}

/// Adds the result of a scene.
fn add(
    document: &mut DataSetEvaluation,
    scene: &DatasetScene,
    found: EvaluationDocument,
    evaluation: &SceneEvaluation,
) {
    document.scenes.push(SceneInfo {
        name: scene.name.clone(),
        is_official: scene.is_official,
        queries: scene.queries.len(),
        remarks: scene.remarks.clone(),
        map: found.map,
    });
    let condition_of = |name: &str| {
        let query = scene.queries.iter().find(|query| query.name == name);
        query.and_then(|query| query.condition.clone())
    };
    let mut conditions: Vec<Option<String>> = Vec::new();
    for query in &scene.queries {
        if !conditions.contains(&query.condition) {
            conditions.push(query.condition.clone());
        }
    }
    let mut queries = found.queries;
    for query in &mut queries {
        query.condition = condition_of(&query.name);
    }
    // The document lists the queries row by row of the table.
    for row in queries.chunks(scene.queries.len().max(1)) {
        for condition in &conditions {
            let own: Vec<&QueryResult> = row.iter().filter(|query| query.condition == *condition).collect();
            let summary = summarize(&own, &evaluation.thresholds);
            document.schemes.push(SceneSummary { scene: scene.name.clone(), summary });
        }
    }
    let of_scene = |result| SceneQuery { scene: scene.name.clone(), result };
    document.queries.extend(queries.into_iter().map(of_scene));
}
