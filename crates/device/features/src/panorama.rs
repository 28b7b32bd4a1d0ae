//! Panoramas become pinhole images: see [`veiloc_geometry::Panorama`].

use std::path::Path;

use rayon::prelude::*;
use veiloc_geometry::{Panorama, PanoramaFace, Pixel};

use crate::{ColourImage, FeatureError, GrayImage, Image, Mask, image_size};

/// Whether the metadata of an image of a panorama's shape says that it is equirectangular, as 360° cameras write it
/// (`GPano:ProjectionType`). Files that cannot be read are none.
pub fn is_marked_panorama(path: &Path) -> bool {
    const KEY: &[u8] = b"ProjectionType";
    const VALUE: &[u8] = b"equirectangular";
    if !image_size(path).is_ok_and(|(width, height)| Panorama::new(width, height).is_some()) {
        return false;
    }
    let Ok(bytes) = std::fs::read(path) else { return false };
    bytes.windows(KEY.len()).enumerate().filter(|(_, window)| *window == KEY).any(|(at, _)| {
        // An attribute or an element of XMP.
        let after = &bytes[at + KEY.len()..bytes.len().min(at + KEY.len() + 2 + VALUE.len())];
        after.strip_prefix(b"=\"").or_else(|| after.strip_prefix(b">")).is_some_and(|v| v.starts_with(VALUE))
    })
}

/// The pinhole images of a panorama in memory, with its hidden pixels; without those that its mask hides whole.
///
/// # Errors
/// [`FeatureError::NoPanorama`] for an image that is not twice as wide as high; [`FeatureError::HidesAll`] if its mask hides all
/// of them.
pub fn faces_of_image(image: &Image) -> Result<Vec<(PanoramaFace, Image)>, FeatureError> {
    let panorama = panorama_of(image.name(), (image.width(), image.height()))?;
    let one = |face: PanoramaFace| {
        let side = face.camera.width;
        let data = sample_face(panorama, &face, |at| [image.gray().data()[at]]);
        let samples = data.into_iter().map(|[sample]| sample).collect();
        let own = Image::from(GrayImage::new(side, side, samples)?)
            .named(format!("{} ({})", image.name().display(), face.name))
            .with_stop(image.stop());
        let Some(hidden) = image.hidden() else { return Ok(Some((face, own))) };
        // A pixel is hidden when one is that it was sampled from.
        let mask = Mask::new(side, side, |x, y| {
            let pixel = panorama.project(&face.direction(&Pixel::from_center_at_zero(x.into(), y.into())));
            neighbours(panorama, &pixel).iter().any(|&(x, y, _)| hidden.hides(x, y))
        });
        match mask {
            Ok(mask) => Ok(Some((face, own.without(&mask)?))),
            Err(FeatureError::HidesNothing { .. }) => Ok(Some((face, own))),
            Err(FeatureError::HidesAll { .. }) => Ok(None),
            Err(error) => Err(error),
        }
    };
    let faces: Result<Vec<_>, FeatureError> =
        panorama.faces().into_iter().filter_map(|face| one(face).transpose()).collect();
    let faces = faces?;
    if faces.is_empty() { Err(FeatureError::HidesAll { mask: None }) } else { Ok(faces) }
}

/// The pinhole images of a panorama in colour.
///
/// # Errors
/// As [`crate::load_colour`]; [`FeatureError::NoPanorama`].
pub fn faces_of_file(path: &Path) -> Result<Vec<(PanoramaFace, ColourImage)>, FeatureError> {
    let image = crate::load_colour(path)?;
    let panorama = panorama_of(path, (image.width(), image.height()))?;
    let one = |face: PanoramaFace| {
        let side = face.camera.width;
        let data = sample_face(panorama, &face, |at| {
            let at = 3 * at;
            [0, 1, 2].map(|channel| f32::from(image.data()[at + channel]))
        });
        let bytes = data.iter().flatten().map(|sample| sample.round() as u8).collect();
        Ok((face, ColourImage::new(side, side, bytes)?))
    };
    panorama.faces().into_iter().map(one).collect()
}

fn panorama_of(path: &Path, (width, height): (u32, u32)) -> Result<Panorama, FeatureError> {
    Panorama::new(width, height).ok_or_else(|| FeatureError::NoPanorama { path: path.into(), width, height })
}

/// The samples of a pinhole image, row by row, interpolated between those of the panorama. `at`: the sample at an index.
fn sample_face<const N: usize>(
    panorama: Panorama,
    face: &PanoramaFace,
    at: impl Fn(usize) -> [f32; N] + Sync,
) -> Vec<[f32; N]> {
    let (side, width) = (face.camera.width, panorama.width() as usize);
    let row = |y: u32| {
        let at = &at;
        (0..side).map(move |x| {
            let direction = face.direction(&Pixel::from_center_at_zero(x.into(), y.into()));
            let mut sum = [0.0; N];
            for (x, y, weight) in neighbours(panorama, &panorama.project(&direction)) {
                let sample = at(y as usize * width + x as usize);
                for (sum, sample) in sum.iter_mut().zip(sample) {
                    *sum += weight * sample;
                }
            }
            sum
        })
    };
    (0..side).into_par_iter().flat_map_iter(row).collect()
}

/// The four pixels around a position, column, row and weight: columns go round, and behind a pole rows go on at the opposite
/// column.
fn neighbours(panorama: Panorama, pixel: &Pixel) -> [(u32, u32, f32); 4] {
    let [x, y] = pixel.center_at_zero();
    let (left, top) = (x.floor(), y.floor());
    let (right_part, lower_part) = ((x - left) as f32, (y - top) as f32);
    let (width, last) = (f64::from(panorama.width()), f64::from(panorama.height() - 1));
    [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)].map(|(to_right, down)| {
        let (x, y) = (left + to_right, top + down);
        let is_behind = !(0.0..=last).contains(&y);
        let column = (x + if is_behind { 0.5 * width } else { 0.0 }).rem_euclid(width);
        let weight = |part: f32, is_far: f64| if is_far > 0.0 { part } else { 1.0 - part };
        let weight = weight(right_part, to_right) * weight(lower_part, down);
        (column as u32 % panorama.width(), y.clamp(0.0, last) as u32, weight)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Smooth over all directions, and different in each.
    fn shade(direction: [f64; 3]) -> f32 {
        let [x, y, z] = direction;
        (0.5 + 0.2 * x + 0.15 * y * z + 0.1 * z) as f32
    }

    fn panorama() -> (Panorama, Image) {
        let panorama = Panorama::new(512, 256).expect("2:1");
        let sample = |at: u32| {
            let (u, v) = (f64::from(at % 512) + 0.5, f64::from(at / 512) + 0.5);
            let longitude = (u / 512.0 - 0.5) * std::f64::consts::TAU;
            let latitude = (v / 256.0 - 0.5) * std::f64::consts::PI;
            shade([longitude.sin() * latitude.cos(), latitude.sin(), longitude.cos() * latitude.cos()])
        };
        let gray = GrayImage::new(512, 256, (0..512 * 256).map(sample).collect()).expect("finite");
        (panorama, Image::from(gray))
    }

    #[test]
    fn samples_are_those_of_their_directions_also_across_the_seam() {
        let (_, image) = panorama();
        for (face, own) in faces_of_image(&image).expect("a panorama") {
            for (at, sample) in (0_u32..).zip(own.gray().data()) {
                let (x, y) = (at % own.width(), at / own.width());
                let direction = face.direction(&Pixel::from_center_at_zero(x.into(), y.into())).normalize();
                let expected = shade(direction.into());
                assert!((sample - expected).abs() < 2e-4, "{} {x} {y}: {sample} {expected}", face.name);
            }
        }
    }

    #[test]
    fn hidden_pixels_stay_hidden() {
        let (_, image) = panorama();
        // A band around the seam, which is in the face behind.
        let mask = Mask::new(512, 256, |x, y| !(8..504).contains(&x) && (100..156).contains(&y));
        let image = image.without(&mask.expect("a mask")).expect("of its size");
        let faces = faces_of_image(&image).expect("a panorama");
        let hiding: Vec<&str> =
            faces.iter().filter(|(_, own)| own.hidden().is_some()).map(|(face, _)| face.name).collect();
        assert_eq!(hiding, ["back"]);
        let square = Image::from(GrayImage::new(300, 300, vec![0.5; 300 * 300]).expect("finite"));
        assert!(matches!(faces_of_image(&square), Err(FeatureError::NoPanorama { .. })));
    }
}
