//! Renders the demo's scene to files: images and a posed COLMAP model, the input of a map build.

use std::path::{Path, PathBuf};

use image::RgbImage;
use veiloc_features::Progress;
use veiloc_geometry::{CameraFromWorld, Intrinsics};
use veiloc_map::colmap::{ColmapImage, ColmapModel, write_text};
use veiloc_synthetic::{PathOptions, RenderOptions, RenderedRoom};

use crate::demo::error::DemoError;
use crate::demo::options::DemoOptions;

/// Camera of the demo: a typical phone lens with some distortion, so that the pipeline includes undistortion.
const CAMERA: &str = "OPENCV,640,480,525,524,322,237,-0.06,0.02,0.0004,-0.0003";

/// A scene on disk, with its true poses.
pub(crate) struct RenderedScene {
    pub(crate) posed: PathBuf,
    pub(crate) images: PathBuf,
    pub(crate) camera: Intrinsics,
    pub(crate) map_list: Vec<String>,
    pub(crate) query_list: Vec<String>,
    poses: Vec<(String, CameraFromWorld)>,
}

impl RenderedScene {
    /// Returns the true pose of an image.
    pub(crate) fn pose_of(&self, name: &str) -> Option<CameraFromWorld> {
        self.poses.iter().find(|(n, _)| n == name).map(|(_, pose)| *pose)
    }
}

/// Renders every view and writes the folder.
pub(crate) fn render(options: &DemoOptions, progress: &dyn Progress) -> Result<RenderedScene, DemoError> {
    let camera: Intrinsics = CAMERA.parse().map_err(|e| DemoError::Scene(format!("{CAMERA}: {e}")))?;
    let (images, posed) = (options.out.join("images"), options.out.join("posed"));
    for folder in [&images, &posed] {
        std::fs::create_dir_all(folder).map_err(|source| DemoError::Io { path: folder.clone(), source })?;
    }

    progress.start("Rendering textures", 1);
    let scene = RenderedRoom::generate(options.seed);
    progress.advance(1);
    let path = scene.camera_path(&PathOptions::with_counts(options.map_views, options.query_views));
    let named = |kind: &str, poses: &[CameraFromWorld]| {
        poses.iter().enumerate().map(|(i, pose)| (format!("{kind}-{i:02}.png"), *pose)).collect::<Vec<_>>()
    };
    let (mapping, queries) = (named("map", &path.mapping), named("query", &path.queries));
    let names = |views: &[(String, CameraFromWorld)]| views.iter().map(|(name, _)| name.clone()).collect();
    let (map_list, query_list) = (names(&mapping), names(&queries));
    let poses: Vec<(String, CameraFromWorld)> = mapping.into_iter().chain(queries).collect();

    progress.start("Rendering views", poses.len());
    for (index, (name, pose)) in poses.iter().enumerate() {
        let noise = RenderOptions::with_seed(options.seed.wrapping_add(index as u64));
        let view = scene.render(pose, &camera, &noise);
        let path = images.join(name);
        view.rgb().save(&path).map_err(|e| DemoError::Io { path, source: std::io::Error::other(e) })?;
        progress.advance(1);
    }
    progress.finish();

    let posed_images = poses
        .iter()
        .zip(1..)
        .map(|((name, pose), id)| ColmapImage {
            id,
            name: name.clone(),
            camera_id: 1,
            cam_from_world: *pose,
            points2d: Vec::new(),
        })
        .collect();
    write_text(&ColmapModel::new(vec![(1, camera)], posed_images, Vec::new())?, &posed)?;
    Ok(RenderedScene { posed, images, camera, map_list, query_list, poses })
}

/// Reads a rendered image in colour, for the report.
pub(crate) fn image(path: &Path) -> Result<RgbImage, DemoError> {
    let image = image::open(path)
        .map_err(|e| DemoError::Io { path: path.to_owned(), source: std::io::Error::other(e) })?;
    Ok(image.to_rgb8())
}
