//! NumPy's arrays in an archive: `name.npy` for each, a header in text and the numbers.

use super::bytes::Bytes;
use super::pth::Element;
use super::zip::Archive;
use crate::learned::Tensor;
use crate::learned::WeightsError;

/// All arrays of floats; those of whole numbers are left out.
pub(super) fn of_archive(archive: &Archive<'_>) -> Result<Vec<(String, Tensor)>, WeightsError> {
    let mut all = Vec::new();
    for name in archive.names() {
        let array = name.strip_suffix(".npy").ok_or(WeightsError::Format)?;
        if let Some(tensor) = array_of(archive.get(name).unwrap_or_default())? {
            all.push((array.to_owned(), tensor));
        }
    }
    Ok(all)
}

fn array_of(content: &[u8]) -> Result<Option<Tensor>, WeightsError> {
    let mut bytes = Bytes(content);
    if bytes.take(6)? != b"\x93NUMPY" {
        return Err(WeightsError::Format);
    }
    let [major, _minor] = bytes.array()?;
    let length = match major {
        1 => usize::from(bytes.u16()?),
        2 | 3 => bytes.u32()? as usize,
        _ => return Err(WeightsError::Unsupported("a newer form of NumPy's arrays")),
    };
    let header = std::str::from_utf8(bytes.take(length)?).map_err(|_| WeightsError::Format)?;
    let Header { element, by_rows, shape } = Header::parse(header)
        .ok_or_else(|| WeightsError::NotTensors("an array of something else".to_owned()))?;
    let Some(element) = element else { return Ok(None) };
    if !by_rows && shape.len() > 1 {
        return Err(WeightsError::Unsupported("an array that is stored by columns"));
    }
    let count = (shape.iter()).try_fold(1_usize, |all, side| all.checked_mul(*side));
    if count.and_then(|count| count.checked_mul(element.size())) != Some(bytes.0.len()) {
        return Err(WeightsError::Damaged("an array is not as large as it says"));
    }
    let data = (0..count.unwrap_or(0)).filter_map(|index| element.number(bytes.0, index)).collect();
    Ok(Some(Tensor { shape, data }))
}

/// `{'descr': '<f4', 'fortran_order': False, 'shape': (8, 3), }`.
struct Header {
    /// `None` for whole numbers.
    element: Option<Element>,
    by_rows: bool,
    shape: Vec<usize>,
}

impl Header {
    fn parse(text: &str) -> Option<Self> {
        let value = |key: &str| Some(text.split_once(&format!("'{key}':"))?.1.trim_start());
        let (descr, _) = value("descr")?.strip_prefix('\'')?.split_once('\'')?;
        let element = match descr {
            "<f2" => Some(Element::Half),
            "<f4" => Some(Element::Float),
            "<f8" => Some(Element::Double),
            "<i4" | "<i8" | "|i1" | "|u1" | "<i2" | "|b1" => None,
            _ => return None,
        };
        let by_rows = value("fortran_order")?.starts_with("False");
        let (sides, _) = value("shape")?.strip_prefix('(')?.split_once(')')?;
        let sides = sides.split(',').map(str::trim).filter(|side| !side.is_empty());
        let shape: Option<Vec<usize>> = sides.map(|side| side.parse().ok()).collect();
        Some(Self { element, by_rows, shape: shape? })
    }
}
