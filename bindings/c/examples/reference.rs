//! Raw frames, and the queries that the library makes of their image files with given seeds: what tests in other languages
//! compare with (`scripts/phones/run.py`).
//!
//! `reference PACK CAMERA OUT IMAGE…` writes for image `i`
//!
//! - `OUT/i.rgba`: its pixels, red, green, blue, 255;
//! - `OUT/i.pgm`: its gray image, rounded to bytes;
//! - `OUT/i.query`: its query, sealed from the file as `veiloc seal` does, with the seed `[i mod 256; 32]`;
//!
//! `OUT/matched`, the query of the first image sealed with the pack (empty when the image does not show the place), and
//! `OUT/frames.txt` with a line for each image: number, width, height, model, parameters. `CAMERA` is that of all images;
//! `unknown` stands for a pinhole with 1.2 times the longer side.

use std::error::Error;
use std::fmt::Write as _;
use std::path::Path;

use rand_chacha::ChaCha20Rng;
use rand_chacha::rand_core::SeedableRng as _;
use veiloc_features::{Image, guessed_camera, load_gray};
use veiloc_geometry::Intrinsics;
use veiloc_obfuscation::{KnownPlace, PackUse, SealError, SealOptions, Sealer};
use veiloc_protocol::Pack;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [pack, camera, out, images @ ..] = arguments.as_slice() else {
        return Err("reference PACK CAMERA OUT IMAGE…".into());
    };
    let place = KnownPlace::new(Pack::decode(&std::fs::read(pack)?)?)?;
    let with_pack = SealOptions::default().with_place(place.clone(), PackUse::Matches);
    let [sealer, matching] =
        [SealOptions::default(), with_pack].map(|o| Sealer::new(place.pack().profile(), o));
    let (sealer, matching) = (sealer?, matching?);
    let out = Path::new(out);
    std::fs::create_dir_all(out)?;
    let mut list = String::new();
    for (i, image) in images.iter().map(Path::new).enumerate() {
        let camera: Intrinsics = match camera.as_str() {
            "unknown" => guessed_camera(image)?,
            text => text.parse()?,
        };
        let pixels = image::open(image)?.into_rgba8();
        std::fs::write(out.join(format!("{i}.rgba")), pixels.as_raw())?;
        let gray = load_gray(image)?;
        let mut pgm = format!("P5\n{} {}\n255\n", gray.width(), gray.height()).into_bytes();
        pgm.extend(gray.data().iter().map(|sample| (sample * 255.0).round() as u8));
        std::fs::write(out.join(format!("{i}.pgm")), pgm)?;
        let extracted = sealer.extract(Image::open(image)?, camera)?;
        let query = sealer.seal(extracted, &mut ChaCha20Rng::from_seed([i as u8; 32]))?;
        std::fs::write(out.join(format!("{i}.query")), query.encode())?;
        if i == 0 {
            let extracted = matching.extract(Image::open(image)?, camera)?;
            let matched = match matching.seal(extracted, &mut ChaCha20Rng::from_seed([0; 32])) {
                Ok(query) => query.encode(),
                Err(SealError::NotThisPlace { .. }) => Vec::new(),
                Err(error) => return Err(error.into()),
            };
            std::fs::write(out.join("matched"), matched)?;
        }
        write!(list, "{i} {} {} {}", camera.width, camera.height, camera.model.name())?;
        camera.model.params().iter().try_for_each(|p| write!(list, " {p}"))?;
        list.push('\n');
    }
    std::fs::write(out.join("frames.txt"), list)?;
    Ok(())
}
