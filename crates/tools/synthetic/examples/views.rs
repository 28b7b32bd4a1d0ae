//! Renders a few views of a scene into a folder, and prints the time of each.
//!
//! `cargo run --release -p veiloc-synthetic --example views -- DIR [SEED] [MAPPING VIEWS] [QUERIES]`
#![expect(clippy::print_stdout, reason = "an example prints to the terminal")]

use std::error::Error;
use std::path::PathBuf;
use std::time::Instant;

use veiloc_geometry::Intrinsics;
use veiloc_synthetic::{PathOptions, RenderOptions, RenderedRoom};

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let folder = PathBuf::from(arguments.next().ok_or("give an output folder")?);
    let mut number = |default: u64| arguments.next().map_or(Ok(default), |a| a.parse());
    let (seed, mapping, queries) = (number(7)?, number(6)? as usize, number(2)? as usize);
    std::fs::create_dir_all(&folder)?;
    let start = Instant::now();
    let scene = RenderedRoom::generate(seed);
    println!("{scene:?} in {:.2} s", start.elapsed().as_secs_f64());
    let path = scene.camera_path(&PathOptions::with_counts(mapping, queries));
    let camera: Intrinsics = "PINHOLE,640,480,525,525,320,240".parse()?;
    let views = path.mapping.iter().map(|p| ("map", p)).chain(path.queries.iter().map(|p| ("query", p)));
    for (k, (kind, pose)) in views.enumerate() {
        let start = Instant::now();
        let view = scene.render(pose, &camera, &RenderOptions::with_seed(k as u64));
        println!("{kind} {k}: {:.0} ms", 1e3 * start.elapsed().as_secs_f64());
        view.rgb().save(folder.join(format!("{kind}_{k:02}.png")))?;
    }
    Ok(())
}
