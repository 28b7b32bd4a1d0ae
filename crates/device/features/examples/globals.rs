//! Writes global descriptors of images, and layers of the first network, for `study features global`.
//!
//! ```text
//! globals MODEL|FILE.toml vectors LIST OUT
//! globals vlad WORDS_LIST LIST OUT
//! globals MODEL|FILE.toml run INPUT C H W OUT_DIR LAYER…
//! ```
//!
//! LIST: paths of images, one per line. OUT: `[images, numbers]`, little endian `f32`; codes for `vlad`, unit vectors
//! for a network. `vlad` trains 64 words on 2048 RootSIFT features of each image of `WORDS_LIST`, and aggregates as
//! many of each image of LIST, extracted as on a device. INPUT: `[1, C, H, W]`; a layer is a name, and layer `i` is
//! written to `OUT_DIR/i.f32`. Network files are searched in VEILOC_MODELS. Prints seconds.
#![expect(clippy::print_stdout, reason = "a command-line program")]

use std::error::Error;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::time::Instant;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use veiloc_descriptor::{DescriptorKind, Descriptors, Vocabulary};
use veiloc_features::learned::{Layer, Models, Tensor};
use veiloc_features::{Extractor, FeatureError, Image, Sift, load_gray};

/// Words and keypoints: the defaults of maps.
const WORDS: usize = 64;
const KEYPOINTS: usize = 2048;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let started = Instant::now();
    match &arguments[..] {
        ["vlad", words, list, out] => vlad(words, list, out)?,
        [model, "vectors", list, out] => {
            let learned = models().open_global(model)?;
            println!("opened in {:.2} s", started.elapsed().as_secs_f64());
            let mut file = BufWriter::new(std::fs::File::create(out)?);
            for path in read(list)? {
                let started = Instant::now();
                for number in learned.vector(&load_gray(&path)?)? {
                    file.write_all(&number.to_le_bytes())?;
                }
                println!("{:.2} s  {}", started.elapsed().as_secs_f64(), path.display());
            }
            file.flush()?;
        }
        [model, "run", input, channels, height, width, out, layers @ ..] => {
            let learned = models().open_global(model)?;
            let bytes = std::fs::read(input)?;
            let data = bytes.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
            let tensor = Tensor { shape: vec![1, channels.parse()?, height.parse()?, width.parse()?], data };
            let names: Vec<Layer> = layers.iter().map(|layer| Layer::from(*layer)).collect();
            for (i, result) in learned.networks()[0].run(&tensor, &names)?.into_iter().enumerate() {
                write(&Path::new(out).join(format!("{i}.f32")), &result.data)?;
                println!("{:?}", result.shape);
            }
        }
        _ => return Err("wrong arguments; the head of this file describes them".into()),
    }
    println!("{:.2} s in all", started.elapsed().as_secs_f64());
    Ok(())
}

fn models() -> Models {
    let folders = std::env::var_os("VEILOC_MODELS");
    Models::new(folders.map(|all| std::env::split_paths(&all).collect()).unwrap_or_default())
}

fn read(list: &str) -> Result<Vec<PathBuf>, std::io::Error> {
    Ok(std::fs::read_to_string(list)?.lines().map(PathBuf::from).collect())
}

fn write(path: &Path, numbers: &[f32]) -> Result<(), std::io::Error> {
    std::fs::write(path, numbers.iter().flat_map(|number| number.to_le_bytes()).collect::<Vec<u8>>())
}

fn rows(paths: &[PathBuf]) -> Result<Vec<Descriptors>, FeatureError> {
    let sift = Sift::for_sealing();
    let of = |path: &PathBuf| Ok(sift.extract(&Image::from(load_gray(path)?), KEYPOINTS)?.descriptors);
    paths.par_iter().map(of).collect()
}

fn vlad(words: &str, list: &str, out: &str) -> Result<(), Box<dyn Error>> {
    let mut sample = Descriptors::empty(DescriptorKind::ROOT_SIFT);
    for image in rows(&read(words)?)? {
        for row in (0..image.len()).step_by(4) {
            sample.push(image.row(row))?;
        }
    }
    let vocabulary = Vocabulary::train(sample.view(), WORDS, &mut ChaCha8Rng::seed_from_u64(1))?;
    let mut all = Vec::new();
    for image in rows(&read(list)?)? {
        all.extend(vocabulary.aggregate(image.view()).as_codes().iter().map(|code| f32::from(*code)));
    }
    Ok(write(Path::new(out), &all)?)
}
