//! Reads the numbers of a dataset, with bounds on their size.

use hdf5_pure::{Dataset, Datatype, DatatypeByteOrder};

use crate::importers::hloc::binary16;

/// Maximum number of elements in a dataset: 64 million, a quarter of a gigabyte. hloc's largest descriptors are a tenth
/// of it.
const MAX_NUMBERS: u64 = 1 << 26;
/// Maximum size of an uncompressed chunk in bytes.
const MAX_CHUNK_BYTES: u64 = 1 << 28;
/// Maximum expansion ratio of deflate, with room for small files whose numbers are not stored at all.
const MAX_EXPANSION: u64 = 1040;

/// Numbers and their shape, row-major.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Numbers {
    pub(crate) shape: Vec<usize>,
    pub(crate) values: Vec<f32>,
}

/// Number type of a dataset.
#[derive(Clone, Copy)]
enum NumberType {
    Half,
    Single,
    Double,
    Signed(usize),
    Unsigned(usize),
}

impl NumberType {
    const fn bytes(self) -> usize {
        match self {
            Self::Half => 2,
            Self::Single => 4,
            Self::Double => 8,
            Self::Signed(bytes) | Self::Unsigned(bytes) => bytes,
        }
    }

    /// Decodes `bytes()` bytes, little endian.
    fn value(self, bytes: &[u8]) -> f32 {
        let mut eight = [0; 8];
        eight[..bytes.len()].copy_from_slice(bytes);
        let word = u64::from_le_bytes(eight);
        match self {
            Self::Half => binary16::from_bits(word as u16),
            Self::Single => f32::from_bits(word as u32),
            Self::Double => f64::from_bits(word) as f32,
            Self::Unsigned(_) => word as f32,
            Self::Signed(bytes) => {
                let unused = 64 - 8 * bytes as u32;
                ((word << unused) as i64 >> unused) as f32
            }
        }
    }
}

/// Reads the numbers of a dataset in a file of `file_bytes` bytes.
///
/// The error states the problem and the remedy.
pub(crate) fn read(dataset: &Dataset, file_bytes: u64) -> Result<Numbers, String> {
    let shape = dataset.shape().map_err(|e| damaged(&e))?;
    let stored = stored(&dataset.datatype().map_err(|e| damaged(&e))?)?;
    let count = product(&shape).filter(|count| *count <= MAX_NUMBERS).ok_or_else(|| {
        format!(
            "has shape {shape:?}, more than {MAX_NUMBERS} numbers; the file is damaged, or not an hloc file"
        )
    })?;
    let bytes = count * stored.bytes() as u64;
    if bytes > file_bytes.saturating_mul(MAX_EXPANSION) {
        return Err(format!(
            "has shape {shape:?}, more than a file of {file_bytes} bytes can hold; write it again"
        ));
    }
    check_chunks(dataset, stored, file_bytes)?;
    let raw = dataset.read_raw().map_err(|e| damaged(&e))?;
    if raw.len() as u64 != bytes {
        return Err(format!(
            "has {} bytes instead of {bytes}; the file is damaged, write it again",
            raw.len()
        ));
    }
    let values = raw.chunks_exact(stored.bytes()).map(|bytes| stored.value(bytes)).collect();
    Ok(Numbers { shape: shape.into_iter().map(|side| side as usize).collect(), values })
}

/// Checks chunk sizes, because the HDF5 library allocates the size that the file states before it reads.
fn check_chunks(dataset: &Dataset, stored: NumberType, file_bytes: u64) -> Result<(), String> {
    let Some(chunk) = dataset.chunk_shape().map_err(|e| damaged(&e))? else { return Ok(()) };
    let whole = product(&chunk).and_then(|count| count.checked_mul(stored.bytes() as u64));
    if whole.is_none_or(|bytes| bytes > MAX_CHUNK_BYTES.min(file_bytes.saturating_mul(MAX_EXPANSION))) {
        return Err(format!("has chunks of {chunk:?}; the file is damaged, or not an hloc file"));
    }
    let inside =
        |(address, length): (u64, u64)| address.checked_add(length).is_some_and(|end| end <= file_bytes);
    let chunks = dataset.chunks().map_err(|e| damaged(&e))?;
    if chunks.iter().all(|c| inside((c.address, c.storage_size))) {
        Ok(())
    } else {
        Err("has chunks beyond the end of the file; the file is truncated, copy it again".to_owned())
    }
}

fn product(sides: &[u64]) -> Option<u64> {
    sides.iter().try_fold(1_u64, |all, side| all.checked_mul(*side))
}

fn damaged(error: &hdf5_pure::Error) -> String {
    format!("cannot be read: {error}; write the file again, without `libver=\"latest\"` if it is compressed")
}

fn stored(datatype: &Datatype) -> Result<NumberType, String> {
    let refused = || {
        Err("has an unsupported number type; write float16, float32, float64 or integers, little endian, \
             as hloc does"
            .to_owned())
    };
    match datatype {
        Datatype::FloatingPoint { size, byte_order: DatatypeByteOrder::LittleEndian, layout } => {
            match (size, layout.exponent_size, layout.mantissa_size) {
                (2, 5, 10) => Ok(NumberType::Half),
                (4, 8, 23) => Ok(NumberType::Single),
                (8, 11, 52) => Ok(NumberType::Double),
                _ => refused(),
            }
        }
        Datatype::FixedPoint { size, byte_order: DatatypeByteOrder::LittleEndian, layout }
            if matches!(size, 1 | 2 | 4 | 8)
                && layout.bit_offset == 0
                && u32::from(layout.bit_precision) == 8 * size =>
        {
            let bytes = *size as usize;
            Ok(if layout.signed { NumberType::Signed(bytes) } else { NumberType::Unsigned(bytes) })
        }
        _ => refused(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_decode_to_numbers() {
        assert_eq!(NumberType::Half.value(&[0x00, 0xc0]), -2.0);
        assert_eq!(NumberType::Single.value(&1.25_f32.to_le_bytes()), 1.25);
        assert_eq!(NumberType::Double.value(&(-0.5_f64).to_le_bytes()), -0.5);
        assert_eq!(NumberType::Signed(2).value(&(-1_i16).to_le_bytes()), -1.0);
        assert_eq!(NumberType::Signed(8).value(&640_i64.to_le_bytes()), 640.0);
        assert_eq!(NumberType::Unsigned(2).value(&[0xff, 0xff]), 65535.0);
        assert_eq!(NumberType::Unsigned(1).value(&[200]), 200.0);
        assert_eq!(NumberType::Signed(1).value(&[200]), -56.0);
    }
}
