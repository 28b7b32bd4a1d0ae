//! Runs a network on given numbers and writes its layers, and times it on an image, for research/oracles/networks.py.
//!
//! ```text
//! layers MODEL|FILE.toml NETWORK_FILE run INPUT C H W OUT_DIR LAYER…
//! layers MODEL|FILE.toml NETWORK_FILE time IMAGE MAX REPEAT
//! layers MODEL|FILE.toml NETWORK_FILE keypoints IMAGE MAX OUT
//! ```
//!
//! INPUT: little endian `f32`, `[1, C, H, W]`. A layer is a name or the number of an output; layer `i` is written to
//! `OUT_DIR/i.f32`, and its shape to stdout. `time` prints the fastest of REPEAT extractions, and of as many runs of
//! the network alone, milliseconds. `keypoints` writes their positions, `[N, 2]` pixels, little endian `f32`, strongest
//! first. RAYON_NUM_THREADS sets the threads, VEILOC_ENGINE the engine (`rten` or `onnxruntime`).
#![expect(clippy::print_stdout, reason = "a command-line program")]

use std::error::Error;
use std::path::Path;
use std::time::Instant;

use veiloc_features::learned::{Engine, Layer, Models, Tensor};
use veiloc_features::{Extractor, Image, load_gray};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [model, file, job, rest @ ..] = &arguments[..] else {
        return Err("wrong arguments; the head of this file describes them".into());
    };
    let engine = std::env::var("VEILOC_ENGINE").map_or(Ok(Engine::default()), |name| name.parse())?;
    let learned = Models::new(Vec::new()).with_engine(engine).open(model, Some(Path::new(file)))?;
    match (job.as_str(), rest) {
        ("run", [input, channels, height, width, out, layers @ ..]) => {
            let bytes = std::fs::read(input)?;
            let data = bytes.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
            let tensor = Tensor { shape: vec![1, channels.parse()?, height.parse()?, width.parse()?], data };
            let names: Vec<Layer> = layers
                .iter()
                .map(|layer| layer.parse().map_or_else(|_| Layer::from(layer.as_str()), Layer::Output))
                .collect();
            for (i, result) in learned.network().run(&tensor, &names)?.into_iter().enumerate() {
                let bytes: Vec<u8> = result.data.iter().flat_map(|number| number.to_le_bytes()).collect();
                std::fs::write(Path::new(out).join(format!("{i}.f32")), bytes)?;
                println!("{:?}", result.shape);
            }
        }
        ("time", [image, most, repeat]) => {
            let image = Image::from(load_gray(Path::new(image))?);
            let (most, repeat): (usize, usize) = (most.parse()?, repeat.parse()?);
            let mut fastest = f64::INFINITY;
            let mut keypoints = 0;
            for _ in 0..repeat {
                let started = Instant::now();
                keypoints = learned.extract(&image, most)?.keypoints.len();
                fastest = fastest.min(started.elapsed().as_secs_f64() * 1e3);
            }
            println!("{fastest:.1} {keypoints}");
        }
        ("keypoints", [image, most, out]) => {
            let features = learned.extract(&Image::from(load_gray(Path::new(image))?), most.parse()?)?;
            let pixels = features.keypoints.iter().flat_map(|k| [k.pixel.u as f32, k.pixel.v as f32]);
            std::fs::write(out, pixels.flat_map(f32::to_le_bytes).collect::<Vec<u8>>())?;
        }
        _ => return Err("wrong arguments; the head of this file describes them".into()),
    }
    Ok(())
}
