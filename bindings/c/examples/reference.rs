//! Raw frames, and the queries that the library makes of their image files with given seeds: what tests in other languages
//! compare with (`scripts/phones/run.py`).
//!
//! `reference PACK CAMERA OUT IMAGE…` writes for image `i`
//!
//! - `OUT/i.rgba`: its pixels, red, green, blue, 255;
//! - `OUT/i.pgm`: its gray image, rounded to bytes;
//! - `OUT/i.query`: its query, sealed from the file as `veiloc seal` does, with the seed `[i mod 256; 32]`;
//!
//! `OUT/matched`, the query of the first image sealed with the pack (empty when the image does not show the place); `OUT/mask`, 40 × 30
//! labels of ARCore in rows of 48 bytes, `OUT/masked`, the query of the first image under it, and `OUT/hidden.rgba`, the image with
//! other pixels under the mask, whose query must be the same (rule L13); and
//! `OUT/frames.txt` with a line for each image: number, width, height, model, parameters. `CAMERA` is that of all images;
//! `unknown` stands for a pinhole with 1.2 times the longer side.

use std::error::Error;
use std::fmt::Write as _;
use std::path::Path;

use rand_chacha::ChaCha20Rng;
use rand_chacha::rand_core::SeedableRng as _;
use veiloc_features::{FrameMask, Image, MaskKind, guessed_camera, load_gray};
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
            let labels: Vec<u8> = (0..48 * 30).map(|at| 10 * u8::from(is_marked(at % 48, at / 48))).collect();
            let (size, bytes) = ((40, 30), labels.as_slice());
            let (kind, margin) = (MaskKind::ArcoreSemantics, FrameMask::MARGIN);
            let mask = FrameMask { kind, size, bytes, row_stride: 48, margin };
            let mask = mask.of_frame(pixels.dimensions())?.ok_or("the mask hides nothing")?;
            let extracted = sealer.extract(Image::open(image)?.without(&mask)?, camera)?;
            let masked = sealer.seal(extracted, &mut ChaCha20Rng::from_seed([0; 32]))?;
            let mut hidden = pixels.clone();
            for (x, y, pixel) in hidden.enumerate_pixels_mut() {
                if is_marked(x * 40 / pixels.width(), y * 30 / pixels.height()) {
                    pixel.0 = pixel.0.map(|value| !value);
                }
            }
            std::fs::write(out.join("mask"), labels)?;
            std::fs::write(out.join("masked"), masked.encode())?;
            std::fs::write(out.join("hidden.rgba"), hidden.as_raw())?;
        }
        write!(list, "{i} {} {} {}", camera.width, camera.height, camera.model.name())?;
        camera.model.params().iter().try_for_each(|p| write!(list, " {p}"))?;
        list.push('\n');
    }
    std::fs::write(out.join("frames.txt"), list)?;
    Ok(())
}

/// Whether a pixel of the mask is marked.
fn is_marked(x: u32, y: u32) -> bool {
    (12..26).contains(&x) && (8..22).contains(&y)
}
