//! Positions of images from GPS in their EXIF: WGS 84 to a local frame, east, north, up, metres.

use std::path::Path;

use exif::{Exif, In, Reader, Tag, Value};
use veiloc_geometry::Geodetic;
use veiloc_map::MapModel;

use super::KnownPosition;
use crate::error::MappingError;
use crate::input::image_names::image_file;

/// Known positions of a map's images from GPS in the EXIF of their files. The frame is east, north, up about the first of
/// them, which is returned, too. Images without a file or without GPS are left out.
///
/// # Errors
/// [`MappingError::Alignment`]: no image has GPS.
pub fn gps_positions(
    model: &MapModel,
    images: &Path,
) -> Result<(Vec<KnownPosition>, Geodetic), MappingError> {
    let located = model.images.iter().filter_map(|image| {
        let place = geodetic_of(&image_file(images, &image.name))?;
        Some((image, place))
    });
    let located: Vec<_> = located.collect();
    let Some((_, origin)) = located.first().copied() else {
        let reason = format!("no image in {} has GPS in its EXIF", images.display());
        return Err(MappingError::Alignment { reason });
    };
    let position = |(image, place): &(&veiloc_map::MapImage, Geodetic)| KnownPosition {
        name: image.name.clone(),
        in_map: image.cam_from_world.center().coords,
        known: origin.east_north_up(place),
    };
    Ok((located.iter().map(position).collect(), origin))
}

/// The position in the EXIF of a file; `None` if it has none, or a damaged one.
fn geodetic_of(path: &Path) -> Option<Geodetic> {
    let file = std::fs::File::open(path).ok()?;
    let exif = Reader::new()
        .continue_on_error(true)
        .read_from_container(&mut std::io::BufReader::new(file))
        .or_else(|error| error.distill_partial_result(|_| {}))
        .ok()?;
    let latitude = angle(&exif, Tag::GPSLatitude, Tag::GPSLatitudeRef, b'S')?;
    let longitude = angle(&exif, Tag::GPSLongitude, Tag::GPSLongitudeRef, b'W')?;
    // Files of programs without a fix have zeros.
    let is_fix = (latitude, longitude) != (0.0, 0.0) && latitude.abs() <= 90.0 && longitude.abs() <= 180.0;
    let below =
        exif.get_field(Tag::GPSAltitudeRef, In::PRIMARY).and_then(|field| field.value.get_uint(0)) == Some(1);
    let altitude =
        rationals(&exif, Tag::GPSAltitude).and_then(|numbers| numbers.first().copied()).unwrap_or(0.0);
    is_fix.then_some(Geodetic { latitude, longitude, altitude: if below { -altitude } else { altitude } })
}

/// Degrees, minutes and seconds, negative for this reference.
fn angle(exif: &Exif, tag: Tag, reference: Tag, negative: u8) -> Option<f64> {
    let parts = rationals(exif, tag)?;
    let degrees = parts.iter().zip([1.0, 60.0, 3600.0]).map(|(part, unit)| part / unit).sum::<f64>();
    let is_negative = match &exif.get_field(reference, In::PRIMARY)?.value {
        Value::Ascii(texts) => texts.first()?.first()?.to_ascii_uppercase() == negative,
        _ => return None,
    };
    degrees.is_finite().then_some(if is_negative { -degrees } else { degrees })
}

fn rationals(exif: &Exif, tag: Tag) -> Option<Vec<f64>> {
    match &exif.get_field(tag, In::PRIMARY)?.value {
        Value::Rational(parts) => {
            let parts: Vec<f64> = parts.iter().map(|part| part.to_f64()).collect();
            parts.iter().all(|part| part.is_finite()).then_some(parts)
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// TIFF with a directory of GPS: degrees, minutes and seconds in thousandths, altitude in centimetres below sea level.
    fn tiff(latitude: [u32; 3], longitude: [u32; 3], altitude: u32) -> Vec<u8> {
        let mut bytes = b"MM\0*".to_vec();
        let entry = |tag: u16, kind: u16, count: u32, value: [u8; 4]| {
            [&tag.to_be_bytes()[..], &kind.to_be_bytes(), &count.to_be_bytes(), &value].concat()
        };
        bytes.extend(8_u32.to_be_bytes());
        bytes.extend(1_u16.to_be_bytes());
        bytes.extend(entry(0x8825, 4, 1, 26_u32.to_be_bytes()));
        bytes.extend([0; 4]);
        // The directory at 26 has six entries, so its rationals begin at 26 + 2 + 6 * 12 + 4.
        bytes.extend(6_u16.to_be_bytes());
        bytes.extend(entry(1, 2, 2, *b"S\0\0\0"));
        bytes.extend(entry(2, 5, 3, 104_u32.to_be_bytes()));
        bytes.extend(entry(3, 2, 2, *b"E\0\0\0"));
        bytes.extend(entry(4, 5, 3, 128_u32.to_be_bytes()));
        bytes.extend(entry(5, 1, 1, [1, 0, 0, 0]));
        bytes.extend(entry(6, 5, 1, 152_u32.to_be_bytes()));
        bytes.extend([0; 4]);
        for [degrees, minutes, seconds] in [latitude, longitude] {
            for (part, over) in [(degrees, 1), (minutes, 1), (seconds, 1000)] {
                bytes.extend(part.to_be_bytes());
                bytes.extend(u32::to_be_bytes(over));
            }
        }
        bytes.extend(altitude.to_be_bytes());
        bytes.extend(100_u32.to_be_bytes());
        bytes
    }

    #[test]
    fn position_is_read_from_exif() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("a.jpg");
        std::fs::write(&path, tiff([33, 51, 24_600], [151, 12, 30_000], 250)).expect("written");
        let place = geodetic_of(&path).expect("a position");
        assert!((place.latitude + (33.0 + 51.0 / 60.0 + 24.6 / 3600.0)).abs() < 1e-12, "{place}");
        assert!((place.longitude - (151.0 + 12.0 / 60.0 + 30.0 / 3600.0)).abs() < 1e-12, "{place}");
        assert_eq!(place.altitude, -2.5);
        // Programs without a fix write zeros.
        std::fs::write(&path, tiff([0; 3], [0; 3], 0)).expect("written");
        assert_eq!(geodetic_of(&path), None);
        assert_eq!(geodetic_of(&folder.path().join("none.jpg")), None);
    }
}
