//! A rendered scene for the examples and tests of this crate, so that they need no data.
#![allow(dead_code, reason = "each of them uses what it needs")]

use std::error::Error;
use std::path::{Path, PathBuf};

use veiloc::geometry::{CameraFromWorld, Intrinsics};
use veiloc::server::{PosedImage, PosedImages};
use veiloc_synthetic::{PathOptions, RenderOptions, RenderedRoom};

/// A folder of images with their poses.
pub(crate) struct Rendered {
    /// Folder of the images.
    pub(crate) folder: PathBuf,
    /// The camera of all images.
    pub(crate) camera: Intrinsics,
    /// The images for the map.
    pub(crate) posed: PosedImages,
    /// Files and true poses of the query images.
    pub(crate) queries: Vec<(PathBuf, CameraFromWorld)>,
}

/// A third of a path around a room: ten views for the map, three queries.
pub(crate) fn render(folder: &Path, seed: u64) -> Result<Rendered, Box<dyn Error>> {
    let camera: Intrinsics = "SIMPLE_RADIAL,400,300,330,200,150,-0.02".parse()?;
    let scene = RenderedRoom::generate(seed);
    let path = scene.camera_path(&PathOptions::with_counts(30, 9));
    let save = |name: &str, pose: &CameraFromWorld, seed: u64| {
        scene.render(pose, &camera, &RenderOptions::with_seed(seed)).rgb().save(folder.join(name))
    };
    let mut posed = Vec::new();
    for (seed, pose) in (1..).zip(&path.mapping[..10]) {
        let name = format!("map-{seed}.png");
        save(&name, pose, seed)?;
        posed.push(PosedImage { name, camera, cam_from_world: *pose, seen: Vec::new() });
    }
    let mut queries = Vec::new();
    for (seed, pose) in (100..).zip(&path.queries[..3]) {
        let name = format!("query-{seed}.png");
        save(&name, pose, seed)?;
        queries.push((folder.join(name), *pose));
    }
    Ok(Rendered { folder: folder.to_owned(), camera, posed: PosedImages::new(posed, Vec::new())?, queries })
}
