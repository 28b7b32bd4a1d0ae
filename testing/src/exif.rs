//! EXIF made by hand: a TIFF header and two directories, little endian.

use std::path::Path;

use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::PngEncoder;
use image::{DynamicImage, ImageEncoder as _};

/// A field: its tag and value.
#[derive(Debug, Clone, Copy)]
pub enum Field {
    /// 16 bits.
    Short(u16, u16),
    /// 32 bits.
    Long(u16, u32),
    /// A fraction of two numbers of 32 bits.
    Rational(u16, u32, u32),
}

/// Orientation of the image.
pub const ORIENTATION: u16 = 0x0112;
/// Focal length, millimetres.
pub const FOCAL_LENGTH: u16 = 0x920A;
/// Width of the image.
pub const PIXEL_X: u16 = 0xA002;
/// Height of the image.
pub const PIXEL_Y: u16 = 0xA003;
/// Pixels of the sensor per unit of length.
pub const PLANE_X_RESOLUTION: u16 = 0xA20E;
/// The unit of that length.
pub const PLANE_UNIT: u16 = 0xA210;
/// Digital zoom.
pub const DIGITAL_ZOOM: u16 = 0xA404;
/// Equivalent focal length for 35 mm film, millimetres.
pub const FOCAL_35MM: u16 = 0xA405;

/// The content of the EXIF segment after its marker.
pub fn tiff(first: &[Field], exif: &[Field]) -> Vec<u8> {
    let pointer = Field::Long(0x8769, 0);
    let mut first: Vec<Field> = first.iter().copied().chain([pointer]).collect();
    let after_first = 8 + 2 + 12 * first.len() as u32 + 4;
    *first.last_mut().expect("the pointer") = Field::Long(0x8769, after_first);
    let mut bytes = b"II*\0\x08\0\0\0".to_vec();
    directory(&mut bytes, &first);
    directory(&mut bytes, exif);
    bytes
}

fn directory(bytes: &mut Vec<u8>, fields: &[Field]) {
    let mut data_at = bytes.len() as u32 + 2 + 12 * fields.len() as u32 + 4;
    let mut data = Vec::new();
    bytes.extend((fields.len() as u16).to_le_bytes());
    for field in fields {
        let (tag, kind, value) = match *field {
            Field::Short(tag, value) => (tag, 3_u16, u32::from(value)),
            Field::Long(tag, value) => (tag, 4, value),
            Field::Rational(tag, num, denom) => {
                data.extend(num.to_le_bytes());
                data.extend(denom.to_le_bytes());
                data_at += 8;
                (tag, 5, data_at - 8)
            }
        };
        bytes.extend(tag.to_le_bytes());
        bytes.extend(kind.to_le_bytes());
        bytes.extend(1_u32.to_le_bytes());
        bytes.extend(value.to_le_bytes());
    }
    bytes.extend([0; 4]);
    bytes.extend(data);
}

/// Writes the image with this metadata, as JPEG or PNG according to the file's name.
pub fn save(path: &Path, image: &DynamicImage, metadata: Option<Vec<u8>>) {
    let rgb = image.to_rgb8();
    let mut bytes = Vec::new();
    let color = image::ExtendedColorType::Rgb8;
    if path.extension().is_some_and(|e| e == "png") {
        let mut encoder = PngEncoder::new(&mut bytes);
        if let Some(metadata) = metadata {
            encoder.set_exif_metadata(metadata).expect("PNG has a chunk for it");
        }
        encoder.write_image(&rgb, rgb.width(), rgb.height(), color).expect("written");
    } else {
        let mut encoder = JpegEncoder::new_with_quality(&mut bytes, 95);
        if let Some(metadata) = metadata {
            encoder.set_exif_metadata(metadata).expect("JPEG has a segment for it");
        }
        encoder.write_image(&rgb, rgb.width(), rgb.height(), color).expect("written");
    }
    std::fs::write(path, bytes).expect("written");
}
