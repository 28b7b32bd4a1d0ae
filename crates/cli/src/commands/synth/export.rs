//! `veiloc synth export`: writes a rendered scene in the layout of a published data set.

use veiloc_datasets::DatasetError;
use veiloc_datasets::write::{DatasetCamera, DatasetLayout, DatasetView, Split, write};
use veiloc_features::Progress as _;
use veiloc_synthetic::{PathOptions, RenderOptions, RenderedRoom};

use crate::output::exit::{Exit, Outcome};
use crate::output::stages::Stages;
use crate::output::targets::OutFolder;
use crate::output::ui::Ui;

/// Brightness of a query at night, relative to day.
const NIGHT: f32 = 0.25;

/// Render a scene with its true poses, in the folders and lists of a published data set.
///
/// Tests programs that read the data set, with known results. For Aachen, whose query poses are not published,
/// `queries/poses.txt` contains them (`veiloc eval dataset aachen --truth`).
#[derive(clap::Args)]
pub(crate) struct Args {
    /// The layout: 7scenes, cambridge, aachen or aachen-v1.1.
    #[arg(long, value_name = "LAYOUT")]
    layout: DatasetLayout,
    /// Output folder; it must be new or empty.
    #[arg(long, value_name = "DIR")]
    out: OutFolder,
    /// Name of the scene, for layouts with several scenes.
    #[arg(long, default_value = "room", value_name = "NAME")]
    scene: String,
    /// Number of map views.
    #[arg(long, default_value_t = 40, value_name = "N", value_parser = clap::value_parser!(u32).range(2..=10_000))]
    map_views: u32,
    /// Number of query views; every third of them is at night if the layout has night queries.
    #[arg(long, default_value_t = 12, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=10_000))]
    query_views: u32,
    /// Width of an image in pixels; the height is three quarters of it.
    #[arg(long, default_value_t = 640, value_name = "PX", value_parser = clap::value_parser!(u32).range(160..=4096))]
    width: u32,
    /// Seed of the scene; equal seeds give equal scenes.
    #[arg(long, default_value_t = 0, value_name = "N")]
    seed: u64,
}

pub(super) fn run(args: &Args, ui: &Ui) -> Outcome {
    super::check_empty(&args.out)?;
    let lens = DatasetCamera::of(args.layout, (args.width, args.width * 3 / 4));
    let camera = lens.camera().map_err(super::refused)?;
    let progress = Stages::new(ui);
    progress.start("Rendering textures", 1);
    let room = RenderedRoom::generate(args.seed);
    progress.advance(1);
    let path =
        room.camera_path(&PathOptions::with_counts(args.map_views as usize, args.query_views as usize));
    let map = path.mapping.iter().map(|pose| DatasetView { cam_from_world: *pose, split: Split::Map });
    let queries = path.queries.iter().enumerate().map(|(k, pose)| DatasetView {
        cam_from_world: *pose,
        split: if k % 3 == 2 { Split::NightQuery } else { Split::Query },
    });
    let views: Vec<DatasetView> = map.chain(queries).collect();
    let knows_night = matches!(args.layout, DatasetLayout::Aachen | DatasetLayout::AachenV1_1);
    progress.start("Rendering views", views.len());
    write(args.layout, &args.out, &args.scene, &lens, &views, &mut |index, file| {
        let view = &views[index];
        let mut options = RenderOptions::with_seed(args.seed.wrapping_add(index as u64));
        if knows_night && view.split == Split::NightQuery {
            options.exposure = NIGHT;
        }
        let rendered = room.render(&view.cam_from_world, &camera, &options);
        rendered
            .rgb()
            .save(file)
            .map_err(|e| DatasetError::Io { path: file.to_owned(), source: std::io::Error::other(e) })?;
        progress.advance(1);
        Ok(())
    })
    .map_err(super::refused)?;
    progress.finish();
    ui.info(format!("{}: {} views in the layout of {}", args.out.display(), views.len(), args.layout.name()));
    Ok(Exit::Success)
}
