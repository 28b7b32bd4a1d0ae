//! Native counterpart of `scripts/web/common.mjs`: seals the same image with the same random bytes, and checks that a
//! browser sent only sealed queries.
//!
//! - `native seal IMAGE CAMERA PROFILE SEED_HEX OUT ROUNDS`: seals as `veiloc seal` does, but with given randomness;
//!   prints the milliseconds of the fastest round.
//! - `native exif IMAGE…`: the camera of each image from its EXIF data, as `veiloc seal` uses it without `--camera`, or
//!   `none,WIDTH,HEIGHT`.
//! - `native check PROFILE FILE…`: checks that each file is one sealed query of the profile and holds no other byte.

#![forbid(unsafe_code)]

use std::error::Error;
use std::io::Write as _;
use std::path::Path;
use std::time::Instant;

use rand_chacha::ChaCha20Rng;
use rand_chacha::rand_core::SeedableRng;
use veiloc_features::{Image, exif_camera, guessed_camera};
use veiloc_geometry::Intrinsics;
use veiloc_obfuscation::{SealOptions, Sealer};
use veiloc_protocol::{Profile, SealedQuery};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match arguments[..] {
        ["seal", image, camera, profile, seed, out, rounds] => {
            let profile = Profile::decode(&std::fs::read(profile)?)?;
            let (camera, seed): (Intrinsics, _) = (camera.parse()?, bytes(seed)?);
            let sealer = Sealer::new(&profile, SealOptions::default())?;
            let mut best = f64::INFINITY;
            for _ in 0..rounds.parse::<usize>()?.max(1) {
                let began = Instant::now();
                let extracted = sealer.extract(Image::open(Path::new(image))?, camera)?;
                let encoded = sealer.seal(extracted, &mut ChaCha20Rng::from_seed(seed))?.encode();
                best = best.min(began.elapsed().as_secs_f64() * 1e3);
                std::fs::write(out, encoded)?;
            }
            writeln!(std::io::stdout(), "{best:.1}")?;
        }
        ["exif", ref images @ ..] => {
            for image in images {
                let camera = exif_camera(Path::new(image)).map(|camera| camera.to_string());
                let none = |_| {
                    guessed_camera(Path::new(image)).map(|any| format!("none,{},{}", any.width, any.height))
                };
                writeln!(std::io::stdout(), "{}", camera.or_else(none)?)?;
            }
        }
        ["check", profile, ref files @ ..] => {
            let profile = Profile::decode(&std::fs::read(profile)?)?;
            for file in files {
                let bytes = std::fs::read(file)?;
                let query = SealedQuery::decode(&bytes).map_err(|e| format!("{file}: {e}"))?;
                profile.check(&query).map_err(|e| format!("{file}: {e}"))?;
                // The encoding is unique, so equal bytes mean that the file holds nothing else.
                if query.encode() != bytes {
                    return Err(format!("{file}: holds more than a sealed query").into());
                }
                writeln!(std::io::stdout(), "{} {}", query.scheme(), query.len())?;
            }
        }
        _ => {
            return Err(
                "native seal IMAGE CAMERA PROFILE SEED_HEX OUT ROUNDS | native exif IMAGE… | native check PROFILE FILE…"
                    .into()
            );
        }
    }
    Ok(())
}

fn bytes(hex: &str) -> Result<[u8; 32], Box<dyn Error>> {
    let byte = |i: usize| hex.get(2 * i..2 * i + 2).and_then(|two| u8::from_str_radix(two, 16).ok());
    let all: Option<Vec<u8>> = (0..32).map(byte).collect();
    let all = all.filter(|_| hex.len() == 64).ok_or("SEED_HEX must have 64 hexadecimal digits")?;
    Ok(all.try_into().map_err(|_| "SEED_HEX must have 32 bytes")?)
}
