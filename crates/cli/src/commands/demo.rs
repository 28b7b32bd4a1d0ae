//! `veiloc demo`: the whole pipeline on a rendered scene.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use crate::commands::page_args::{PageConfig, PageView, page};
use crate::demo::{DemoOptions, HiddenViews, map_scene, run_demo};
use veiloc_evaluation::attack_evaluation::attacks_table;
use veiloc_evaluation::results::table;
use veiloc_service::{ListenAddress, MapSource, ServerOptions, run_until_signal};

use crate::output::exit::{Exit, Failure, Outcome};
use crate::output::stages::Stages;
use crate::output::targets::OutFolder;
use crate::output::ui::Ui;

/// Maximum number of map points that the web page shows.
const SHOWN_POINTS: usize = 20_000;

/// Render a scene, map it, localize hidden queries, attack them, write a report.
///
/// Needs no data and no network. Only the images are synthetic; everything after the renderer is the pipeline for real
/// images. With --page the scene is mapped and a local web page offers hidden views to localize.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// Folder for the images, the map, the sealed queries and the report.
    #[arg(long, default_value = "out/demo", value_name = "DIR")]
    out: OutFolder,
    /// Seed of the scene and of every random choice.
    #[arg(long, default_value_t = 7, value_name = "N")]
    seed: u64,
    /// Print the JSON document of the evaluation and the attacks to stdout.
    #[arg(long)]
    json: bool,
    /// Serve a web page with the hidden views instead of writing a report, until Ctrl-C. Default: a report.
    #[arg(long, conflicts_with = "json")]
    page: bool,
    /// Files of the web page, as built by bindings/web/build.sh. Default: the folder veiloc-page beside the program.
    #[arg(long, requires = "page", value_name = "DIR")]
    page_folder: Option<PathBuf>,
    /// Address of the web page: this machine, and a port (0 for any free one).
    #[arg(long, requires = "page", default_value = "127.0.0.1:8080", value_name = "ADDR:PORT")]
    listen: ListenAddress,
}

pub(crate) fn run(args: &Args, ui: &Ui) -> Outcome {
    let started = Instant::now();
    let options = DemoOptions::new(args.out.to_path_buf(), args.seed);
    if args.page {
        return serve(args, &options, ui);
    }
    let demo = run_demo(&options, &Stages::new(ui))?;
    if args.json {
        ui.json(&demo.document)?;
    } else {
        ui.print(table(&demo.document.evaluation.schemes));
        ui.print("\n");
        ui.print(attacks_table(&demo.document.attacks));
    }
    ui.info(format!(
        "\nReport: {} (open it in a browser). Done in {:.0} s.",
        demo.report.display(),
        started.elapsed().as_secs_f64()
    ));
    Ok(Exit::Success)
}

/// Serves the scene on a local web page.
fn serve(args: &Args, demo: &DemoOptions, ui: &Ui) -> Outcome {
    // Errors of the page appear before the scene is rendered.
    let mut page_config = PageConfig { points: SHOWN_POINTS, ..PageConfig::default() };
    page(args.page_folder.as_ref(), &page_config)?;
    let HiddenViews { map, views, camera } = map_scene(demo, &Stages::new(ui))?;
    page_config.views = (views.iter())
        .map(|(name, _)| PageView { name: name.clone(), file: name.clone(), camera: camera.to_string() })
        .collect();
    let mut page = page(args.page_folder.as_ref(), &page_config)?;
    for (name, path) in &views {
        let bytes = std::fs::read(path).map_err(|e| Failure::refused(format!("{}: {e}", path.display())))?;
        page.add(name, bytes)?;
    }
    let mut options = ServerOptions::new(vec![MapSource { name: "demo".to_owned(), path: map }]);
    options.listen = vec![args.listen.clone()];
    options.page = Some(Arc::new(page));
    options.page_points = SHOWN_POINTS;
    run_until_signal(options, |listening| {
        for address in &listening.addresses {
            ui.info(format!(
                "The scene is on http://{address} (open it in a browser; Ctrl-C stops \
                 the server)"
            ));
        }
    })?;
    Ok(Exit::Success)
}
