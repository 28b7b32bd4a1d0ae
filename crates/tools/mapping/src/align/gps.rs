//! Positions of images from GPS in their EXIF: WGS 84 to a local frame, east, north, up, metres.

use std::collections::BTreeMap;
use std::fmt;
use std::path::Path;

use exif::{Exif, In, Tag, Value};
use veiloc_geometry::Geodetic;
use veiloc_map::{GravityDirection, MapModel};

use super::known::{KnownPosition, KnownPositions, grid_step};
use crate::error::MappingError;
use crate::input::exif::exif_of;
use crate::input::image_names::image_file;

/// Known positions of a map's images from GPS in the EXIF of their files. The frame is east, north, up about the first of
/// them. Images without a file or without a fix are left out and counted.
///
/// # Errors
/// [`MappingError::Alignment`]: no image has a fix.
pub fn gps_positions(model: &MapModel, images: &Path) -> Result<KnownPositions, MappingError> {
    let mut fixes = Vec::new();
    let mut without: BTreeMap<NoFix, usize> = BTreeMap::new();
    for image in &model.images {
        match fix_of(&image_file(images, &image.name)) {
            Ok(fix) => fixes.push((image, fix)),
            Err(reason) => *without.entry(reason).or_default() += 1,
        }
    }
    let all = model.images.len();
    let remarks: Vec<String> =
        without.iter().map(|(reason, count)| format!("{count} of {all} images {reason}")).collect();
    let Some((_, first)) = fixes.first() else {
        let reason = format!("no image in {} gives a GPS position: {}", images.display(), remarks.join("; "));
        return Err(MappingError::Alignment { reason });
    };
    // The first height that there is, so that images without one do not move the origin by that height.
    let height = fixes.iter().find_map(|(_, fix)| fix.height);
    let origin = Geodetic { altitude: height.unwrap_or(0.0), ..first.place };
    let position = |(image, fix): &(&veiloc_map::MapImage, Fix)| KnownPosition {
        name: image.name.clone(),
        in_map: image.cam_from_world.center().coords,
        known: origin
            .east_north_up(&Geodetic { altitude: fix.height.unwrap_or(origin.altitude), ..fix.place }),
        has_height: fix.height.is_some(),
        sd: fix.sd,
    };
    let degrees: Vec<f64> =
        fixes.iter().flat_map(|(_, fix)| [fix.place.latitude, fix.place.longitude]).collect();
    Ok(KnownPositions {
        positions: fixes.iter().map(position).collect(),
        down: Some(GravityDirection::MINUS_Z),
        origin: Some(origin),
        has_heights: height.is_some(),
        is_metric: true,
        grid: METRES_PER_DEGREE * grid_step(&degrees, &GRIDS_DEG),
        is_list: false,
        remarks,
    })
}

/// Metres of a degree of latitude.
const METRES_PER_DEGREE: f64 = 111_320.0;
/// Grids that programs round to: minutes, seconds and their parts, and decimals of degrees.
const GRIDS_DEG: [f64; 6] = [1.0 / 60.0, 1e-3, 1.0 / 3600.0, 1e-4, 1.0 / 36_000.0, 1e-5];

/// A GPS position as EXIF has it.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Fix {
    /// Without the height.
    place: Geodetic,
    /// Metres, if it is known.
    height: Option<f64>,
    /// `GPSHPositioningError`, metres; 0 without it.
    sd: f64,
}

/// Why a file gives no position.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum NoFix {
    NoFile,
    NoGps,
    NoReference,
    NotValid,
    OtherDatum,
}

impl fmt::Display for NoFix {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::NoFile => "are not in that folder",
            Self::NoGps => "have no GPS in their EXIF",
            Self::NoReference => "have GPS without N or S, or without E or W",
            Self::NotValid => "have GPS that is marked or written as no fix",
            Self::OtherDatum => "have GPS of another datum than WGS 84",
        })
    }
}

/// The position in the EXIF of a file.
fn fix_of(path: &Path) -> Result<Fix, NoFix> {
    if !path.is_file() {
        return Err(NoFix::NoFile);
    }
    let exif = exif_of(path).ok_or(NoFix::NoGps)?;
    let number = |tag| rationals(&exif, tag).and_then(|numbers| numbers.first().copied());
    let latitude = angle(&exif, Tag::GPSLatitude, Tag::GPSLatitudeRef, [b'N', b'S'])?;
    let longitude = angle(&exif, Tag::GPSLongitude, Tag::GPSLongitudeRef, [b'E', b'W'])?;
    // Files of programs without a fix have zeros, or say so.
    let is_void = letter(&exif, Tag::GPSStatus) == Some(b'V');
    if is_void || (latitude, longitude) == (0.0, 0.0) || latitude.abs() > 90.0 || longitude.abs() > 180.0 {
        return Err(NoFix::NotValid);
    }
    if ascii(&exif, Tag::GPSMapDatum).is_some_and(|datum| !is_wgs84(&datum)) {
        return Err(NoFix::OtherDatum);
    }
    // 0 and 2 are above, 1 and 3 are below (2 and 3 since EXIF 3.0).
    let reference = exif
        .get_field(Tag::GPSAltitudeRef, In::PRIMARY)
        .and_then(|field| field.value.get_uint(0))
        .unwrap_or(0);
    let height = number(Tag::GPSAltitude).map(|height| if reference % 2 == 1 { -height } else { height });
    Ok(Fix {
        place: Geodetic { latitude, longitude, altitude: 0.0 },
        height,
        sd: number(Tag::GPSHPositioningError).filter(|sd| *sd > 0.0).unwrap_or(0.0),
    })
}

fn is_wgs84(datum: &str) -> bool {
    let plain: String = datum.chars().filter(char::is_ascii_alphanumeric).collect();
    let plain = plain.to_ascii_uppercase();
    // Within a metre of WGS 84.
    plain.is_empty()
        || ["WGS84", "WGS1984", "ETRS89", "GRS80", "JGD2011", "JGD2000", "NAD83"].contains(&plain.as_str())
}

/// Degrees, minutes and seconds, negative for the second of the references.
fn angle(exif: &Exif, tag: Tag, reference: Tag, [positive, negative]: [u8; 2]) -> Result<f64, NoFix> {
    let parts = rationals(exif, tag).ok_or(NoFix::NoGps)?;
    let degrees = parts.iter().zip([1.0, 60.0, 3600.0]).map(|(part, unit)| part / unit).sum::<f64>();
    match letter(exif, reference) {
        Some(letter) if letter == positive => Ok(degrees),
        Some(letter) if letter == negative => Ok(-degrees),
        _ => Err(NoFix::NoReference),
    }
}

fn ascii(exif: &Exif, tag: Tag) -> Option<String> {
    match &exif.get_field(tag, In::PRIMARY)?.value {
        Value::Ascii(texts) => Some(String::from_utf8_lossy(texts.first()?).into_owned()),
        _ => None,
    }
}

/// The first letter, in upper case.
fn letter(exif: &Exif, tag: Tag) -> Option<u8> {
    Some(ascii(exif, tag)?.trim().as_bytes().first()?.to_ascii_uppercase())
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
        let fix = fix_of(&path).expect("a position");
        assert!((fix.place.latitude + (33.0 + 51.0 / 60.0 + 24.6 / 3600.0)).abs() < 1e-12, "{fix:?}");
        assert!((fix.place.longitude - (151.0 + 12.0 / 60.0 + 30.0 / 3600.0)).abs() < 1e-12, "{fix:?}");
        assert_eq!((fix.height, fix.sd), (Some(-2.5), 0.0));
        // Below, too, since EXIF 3.0; above; nothing.
        let mut bytes = tiff([33, 51, 24_600], [151, 12, 30_000], 250);
        let reference = 26 + 2 + 4 * 12 + 8;
        for (value, height) in [(3, -2.5), (2, 2.5), (0, 2.5)] {
            bytes[reference] = value;
            std::fs::write(&path, &bytes).expect("written");
            assert_eq!(fix_of(&path).expect("a position").height, Some(height), "{value}");
        }
        // Without an altitude it is not 0. The tag becomes one that is not known.
        bytes[reference + 4..reference + 6].copy_from_slice(&0x00F0_u16.to_be_bytes());
        std::fs::write(&path, &bytes).expect("written");
        assert_eq!(fix_of(&path).expect("a position").height, None);
        // An empty reference is no reference.
        bytes[26 + 2 + 8] = 0;
        std::fs::write(&path, &bytes).expect("written");
        assert_eq!(fix_of(&path), Err(NoFix::NoReference));
        // Programs without a fix write zeros.
        std::fs::write(&path, tiff([0; 3], [0; 3], 0)).expect("written");
        assert_eq!(fix_of(&path), Err(NoFix::NotValid));
        assert_eq!(fix_of(&folder.path().join("none.jpg")), Err(NoFix::NoFile));
    }
}
