//! Seals several images of one scene in a session with world-fixed anchors, as an app does while its user moves.
//!
//! `cargo run --release -p veiloc --example session`
#![expect(clippy::print_stdout, reason = "an example talks to its terminal")]

mod rendered;

use std::error::Error;
use std::path::Path;

use veiloc::device::{Image, Orientation, SealOptions, SealedQuery, Sealer, SessionFile};
use veiloc::geometry::{CameraFromWorld, Intrinsics};
use veiloc::server::{BuildOptions, Input, LocalizeOptions, MapFile, build, localize, write_map};

fn main() -> Result<(), Box<dyn Error>> {
    run().map(|_| ())
}

/// Runs the example; returns the error of each answer, metres.
pub(crate) fn run() -> Result<Vec<f64>, Box<dyn Error>> {
    let folder = tempfile::tempdir()?;
    println!("rendering a scene");
    let scene = rendered::render(folder.path(), 11)?;
    let (model, _) = build(&Input::new(&scene.posed, &scene.folder), &BuildOptions::default(), &())?;
    let map = folder.path().join("place.vmap");
    write_map(&model, &map)?;
    let map = MapFile::open(&map)?;

    let sealer = Sealer::new(map.profile(), SealOptions::default())?;
    let session = folder.path().join("walk.session");
    let mut errors = Vec::new();
    for (image, truth) in &scene.queries {
        let bytes = seal(&sealer, image, scene.camera, truth, &session)?;
        let found = localize(&SealedQuery::decode(&bytes)?, &map, &LocalizeOptions::default())?;
        errors.push(found.cam_from_world.translation_error(truth));
        println!("{}: {:.1} mm off", image.display(), 1e3 * found.cam_from_world.translation_error(truth));
    }
    println!("{} bytes of the session stay on the device", std::fs::metadata(&session)?.len());
    Ok(errors)
}

/// The device: the session's file is opened for each image, so the app may be closed between two images.
fn seal(
    sealer: &Sealer,
    image: &Path,
    camera: Intrinsics,
    truth: &CameraFromWorld,
    session: &Path,
) -> Result<Vec<u8>, Box<dyn Error>> {
    // Orientation of the camera in the device's own world frame: from its gyroscope or odometry. Here from the true
    // pose.
    let held = Orientation::in_world(*truth.rotation()).unwrap_or(Orientation::unknown());
    let extracted = sealer.extract(Image::open(image)?, camera)?.with_orientation(held);
    Ok(SessionFile::open(session, None)?.seal(sealer, extracted)?.encode())
}
