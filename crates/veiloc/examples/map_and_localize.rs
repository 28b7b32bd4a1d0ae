//! Builds a map, seals images as a device does, and localizes them: device and server side in one program.
//!
//! `cargo run --release -p veiloc --example map_and_localize`
#![expect(clippy::print_stdout, reason = "an example talks to its terminal")]

mod rendered;

use std::error::Error;
use std::path::Path;

use veiloc::device::{Image, SealOptions, SealedQuery, Sealer, device_rng};
use veiloc::geometry::{CameraFromWorld, Intrinsics};
use veiloc::server::{
    BuildOptions, FinishOptions, Input, LocalizeOptions, MapFile, PosedImages, build, finish, localize,
    write_map,
};

fn main() -> Result<(), Box<dyn Error>> {
    run().map(|_| ())
}

/// Runs the example; returns the error of each answer, metres.
pub(crate) fn run() -> Result<Vec<f64>, Box<dyn Error>> {
    let folder = tempfile::tempdir()?;
    println!("rendering a scene");
    let scene = rendered::render(folder.path(), 11)?;
    let map = folder.path().join("place.vmap");
    build_map(&scene.posed, &scene.folder, &map)?;
    let mut errors = Vec::new();
    for (image, truth) in &scene.queries {
        let found = localize_image(image, &scene.camera, &map)?;
        errors.push(found.translation_error(truth));
        println!("{}: {:.1} mm off", image.display(), 1e3 * found.translation_error(truth));
    }
    Ok(errors)
}

/// The operator: posed images to a map file.
fn build_map(posed: &PosedImages, images: &Path, map: &Path) -> Result<(), Box<dyn Error>> {
    let (mut model, mut report) = build(&Input::new(posed, images), &BuildOptions::default(), &())?;
    // The map localizes its own images, which calibrates the covariances of its answers.
    finish(&mut model, &mut report.warnings, &FinishOptions::default(), &())?;
    for warning in &report.warnings {
        println!("warning: {warning}");
    }
    println!("{} images, {} points", model.images.len(), model.points.len());
    Ok(write_map(&model, map)?)
}

/// Device and server in one process; in practice the bytes cross a network (`veiloc::device::Client`).
fn localize_image(image: &Path, camera: &Intrinsics, map: &Path) -> Result<CameraFromWorld, Box<dyn Error>> {
    let map = MapFile::open(map)?;
    let sealer = Sealer::new(map.profile(), SealOptions::default())?;
    let extracted = sealer.extract(Image::open(image)?, *camera)?;
    let bytes = sealer.seal(extracted, &mut device_rng()?)?.encode();
    let found = localize(&SealedQuery::decode(&bytes)?, &map, &LocalizeOptions::default())?;
    Ok(found.cam_from_world)
}
