//! Renders and maps a scene without localizing its hidden views; the web page localizes them.

use std::path::PathBuf;

use veiloc_features::Progress;
use veiloc_geometry::Intrinsics;
use veiloc_map::colmap::read_posed;
use veiloc_mapping::{BuildOptions, Input, build};

use crate::demo::error::DemoError;
use crate::demo::options::DemoOptions;
use crate::demo::scene;

/// A rendered scene with its map, and views that are not in the map.
#[derive(Debug)]
pub(crate) struct HiddenViews {
    /// The map.
    pub map: PathBuf,
    /// The hidden views: name and file, PNG.
    pub views: Vec<(String, PathBuf)>,
    /// The camera of all of them.
    pub camera: Intrinsics,
}

/// Renders and maps the scene as [`crate::demo::run_demo`] does, without localization and attacks.
///
/// # Errors
/// [`DemoError`] if a file cannot be written, or the scene could not be mapped.
pub(crate) fn map_scene(options: &DemoOptions, progress: &dyn Progress) -> Result<HiddenViews, DemoError> {
    let scene = scene::render(options, progress)?;
    let posed = read_posed(&scene.posed)?;
    let input = Input::new(&posed, &scene.images).with_names(&scene.map_list);
    let (model, _) = build(&input, &BuildOptions::default(), progress)?;
    let map = options.out.join("place.vmap");
    veiloc_map::write(&model, &map)?;
    let views = scene.query_list.iter().map(|name| (name.clone(), scene.images.join(name))).collect();
    Ok(HiddenViews { map, views, camera: scene.camera })
}
