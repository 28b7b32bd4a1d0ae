//! A place that renders itself, with its true poses: to try everything without data.

use std::io::Cursor;
use std::path::{Path, PathBuf};

use image::{ImageFormat, RgbImage};
use pyo3::prelude::*;
use veiloc_geometry::{CameraFromWorld, Intrinsics};
use veiloc_pose::Stop;
use veiloc_synthetic::{PathOptions, Place, RenderOptions};

use crate::errors::{Fault, Result};
use crate::pose::CameraPose;
use crate::waiting::released;

/// The camera of all images: small, so that everything is quick.
const CAMERA: &str = "SIMPLE_RADIAL,400,300,330,200,150,-0.02";

/// Images of one kind: name, camera, true pose.
type Views = Vec<(String, &'static str, CameraPose)>;

/// Renders a room into a folder of images, a part of the walk around it.
///
/// Args:
///     folder: of the images; it must be there.
///     mapped, queries: how many of each, at most 30 and 9.
///     seed: of the place; equal seeds give equal places.
///
/// Returns:
///     Two lists of (name, camera, CameraPose), as `Map.build` takes them: views for the map, and others. Units are metres.
///
/// Raises:
///     Error: an image cannot be written. InputError: more views than there are.
#[pyfunction]
#[pyo3(signature = (folder, *, mapped=10, queries=3, seed=11))]
pub(crate) fn render_place(
    py: Python<'_>,
    folder: PathBuf,
    mapped: usize,
    queries: usize,
    seed: u64,
) -> Result<(Views, Views)> {
    let (most_mapped, most_queries) = (30, 9);
    if mapped > most_mapped || queries > most_queries {
        return Err(Fault::input(format_args!(
            "at most {most_mapped} views for the map and {most_queries} others"
        )));
    }
    let camera: Intrinsics = CAMERA.parse()?;
    released(py, &Stop::default(), || {
        let place = Place::generate(seed);
        let path = place.camera_path(&PathOptions::with_counts(most_mapped, most_queries));
        let views = |kind: &str, first: u64, poses: &[CameraFromWorld]| -> Result<Views> {
            let one = |(seed, pose): (u64, &CameraFromWorld)| {
                let name = format!("{kind}-{seed:02}.png");
                let rendered = place.render(pose, &camera, &RenderOptions::with_seed(seed));
                write(&folder.join(&name), rendered.rgb())?;
                Ok((name, CAMERA, CameraPose(*pose)))
            };
            (first..).zip(poses).map(one).collect()
        };
        Ok((views("map", 1, &path.mapping[..mapped])?, views("query", 100, &path.queries[..queries])?))
    })?
}

fn write(path: &Path, image: &RgbImage) -> Result<()> {
    let mut bytes = Cursor::new(Vec::new());
    image.write_to(&mut bytes, ImageFormat::Png).map_err(Fault::other)?;
    let told = |why| Fault::other(format_args!("{}: {why}", path.display()));
    veiloc_map::atomic_file::write_whole(path, bytes.get_ref()).map_err(told)
}
