//! MATLAB's files of version 5 (`.mat`): numbers in cells and structs, as NetVLAD's authors give their network.
//!
//! Numbers are kept under the path that leads to them, fields by name and cells from 0: `net.layers.30.weights.0`. MATLAB stores
//! an array a × b × c × d by columns, which is one of the sides d, c, b, a by rows: so it is kept, and nothing is turned.
//! Text and whole numbers that are no weights are read over; everything else (objects, functions, sparse and complex arrays) is
//! refused. The file is read as a stream, so that a large one is never whole in memory beside its numbers.
//!
//! Source: *MAT-File Format*, MathWorks, the chapter on level 5.

use std::io::Read;

use flate2::read::ZlibDecoder;

use crate::learned::{Tensor, WeightsError};

/// What such a file begins with; files of version 7.3 are another format and begin otherwise.
pub(super) const MARK: &[u8] = b"MATLAB 5.0 MAT-file";
/// Text, offset of subsystem data, version, the order of bytes.
const HEADER: usize = 128;
/// Version 1.0 in the order of bytes of a little-endian machine.
const VERSION: [u8; 4] = *b"\x00\x01IM";
/// How deep cells and structs may lie in each other.
const MOST_DEPTH: usize = 16;
/// Arrays, cells and structs of a file.
const MOST_ARRAYS: usize = 100_000;
/// Numbers of a file: 1 GiB of them.
const MOST_NUMBERS: usize = 1 << 28;
/// Bytes that are read at a time.
const PIECE: usize = 1 << 16;

/// Types of data.
const MATRIX: u32 = 14;
const PACKED: u32 = 15;

/// All arrays of floats, by the paths that lead to them.
pub(super) fn of_stream(file: impl Read) -> Result<Vec<(String, Tensor)>, WeightsError> {
    let mut stream = Stream { input: Box::new(file), left: u64::MAX };
    let mut header = [0; HEADER];
    stream.fill(&mut header)?;
    if !header.starts_with(MARK) {
        return Err(WeightsError::Format);
    }
    if header[HEADER - 4..] != VERSION {
        return Err(WeightsError::Unsupported("a MATLAB file of another version or a big-endian machine"));
    }
    let mut found = Found::default();
    // An end is right only where an element would begin.
    while let Some(first) = stream.byte_or_end()? {
        let [b, c, d] = stream.array()?;
        let kind = u32::from_le_bytes([first, b, c, d]);
        let bytes = u64::from(stream.u32()?);
        match kind {
            PACKED => {
                let packed = Box::new(ZlibDecoder::new(stream.input.by_ref().take(bytes)));
                let mut inner = Stream { input: packed, left: u64::MAX };
                let (kind, bytes) = (inner.u32()?, inner.u32()?);
                if kind != MATRIX {
                    return Err(damaged("what is packed is no array"));
                }
                inner.left = u64::from(bytes);
                found.array(&mut inner, None, 0)?;
                if inner.left != 0 || inner.byte_or_end()?.is_some() {
                    return Err(damaged("something stands behind a packed array"));
                }
            }
            MATRIX => {
                let mut inner = Stream { input: Box::new(stream.input.by_ref()), left: bytes };
                found.array(&mut inner, None, 0)?;
                if inner.left != 0 {
                    return Err(damaged("something stands behind an array"));
                }
            }
            _ => return Err(WeightsError::NotTensors(format!("data of the type {kind}"))),
        }
    }
    if found.arrays == 0 {
        return Err(damaged("there is no array"));
    }
    Ok(found.tensors)
}

fn damaged(what: &'static str) -> WeightsError {
    WeightsError::Damaged(what)
}

fn refused(what: &str) -> WeightsError {
    WeightsError::NotTensors(what.to_owned())
}

/// What an array is of.
enum Class {
    Cells,
    Struct,
    Text,
    Floats,
    /// Whole numbers, and true and false.
    Whole,
}

impl Class {
    fn of(number: u8) -> Result<Self, WeightsError> {
        Ok(match number {
            1 => Self::Cells,
            2 => Self::Struct,
            3 => return Err(refused("an object")),
            4 => Self::Text,
            5 => return Err(refused("a sparse array")),
            6 | 7 => Self::Floats,
            8..=15 => Self::Whole,
            16 => return Err(refused("a function")),
            _ => return Err(refused("an array of an unknown class")),
        })
    }
}

#[derive(Default)]
struct Found {
    tensors: Vec<(String, Tensor)>,
    arrays: usize,
    numbers: usize,
}

impl Found {
    /// One array of `stream.left` bytes at most, its tag read. `path`: where it lies; its own name where there is none.
    fn array(
        &mut self,
        stream: &mut Stream<'_>,
        path: Option<&str>,
        depth: usize,
    ) -> Result<(), WeightsError> {
        self.arrays += 1;
        if depth > MOST_DEPTH || self.arrays > MOST_ARRAYS {
            return Err(refused("more arrays than any network has"));
        }
        let flags = stream.small(6, 8)?;
        let [class, bits, ..] = flags[..] else { return Err(damaged("an array says nothing of itself")) };
        if bits & 0x08 != 0 {
            return Err(refused("complex numbers"));
        }
        let class = Class::of(class)?;
        let sides = stream.small(5, 4 * 8)?;
        let sides = sides.as_chunks::<4>().0.iter().map(|side| u32::from_le_bytes(*side) as usize);
        let shape: Vec<usize> = sides.rev().collect();
        if shape.len() < 2 {
            return Err(damaged("an array has fewer sides than two"));
        }
        let count = shape.iter().try_fold(1_usize, |all, side| all.checked_mul(*side));
        let count = count.ok_or(damaged("an array is larger than can be"))?;
        let name = stream.small(1, 64)?;
        let name = std::str::from_utf8(&name).map_err(|_| damaged("a name is no text"))?;
        let path = path.unwrap_or(name).to_owned();
        match class {
            Class::Cells => {
                for number in 0..count {
                    self.inner(stream, &format!("{path}.{number}"), depth)?;
                }
            }
            Class::Struct => {
                let fields = fields(stream)?;
                for number in 0..count {
                    let path = if count == 1 { path.clone() } else { format!("{path}.{number}") };
                    for field in &fields {
                        self.inner(stream, &format!("{path}.{field}"), depth)?;
                    }
                }
            }
            Class::Floats => {
                let data = self.numbers(stream, count)?;
                self.tensors.push((path, Tensor { shape, data }));
            }
            Class::Text | Class::Whole => {
                let data = stream.tag()?;
                stream.skip(data.padded())?;
            }
        }
        Ok(())
    }

    /// An array within another.
    fn inner(&mut self, stream: &mut Stream<'_>, path: &str, depth: usize) -> Result<(), WeightsError> {
        let tag = stream.tag()?;
        if tag.kind != MATRIX {
            return Err(damaged("a cell or a field is no array"));
        }
        // A cell that was never filled.
        if tag.bytes == 0 {
            return Ok(());
        }
        let rest =
            stream.left.checked_sub(tag.bytes).ok_or(damaged("an array is larger than what holds it"))?;
        stream.left = tag.bytes;
        self.array(stream, Some(path), depth + 1)?;
        if stream.left != 0 {
            return Err(damaged("something stands behind an array"));
        }
        stream.left = rest;
        Ok(())
    }

    /// The numbers of an array of floats, which may be stored as whole numbers where they are some.
    fn numbers(&mut self, stream: &mut Stream<'_>, count: usize) -> Result<Vec<f32>, WeightsError> {
        let tag = stream.tag()?;
        let stored = Stored::of(tag.kind).ok_or(damaged("numbers of no known type"))?;
        self.numbers = self
            .numbers
            .checked_add(count)
            .filter(|all| *all <= MOST_NUMBERS)
            .ok_or(damaged("there are more numbers than in any network"))?;
        if (count as u64).checked_mul(stored.size() as u64) != Some(tag.bytes) {
            return Err(damaged("an array is not as large as it says"));
        }
        // It grows with what is there, not with what is said, and by eighths: whitenings are half a gigabyte.
        let mut data = Vec::new();
        let mut piece = vec![0; PIECE];
        let mut left = tag.bytes as usize;
        while left > 0 {
            let now = left.min(PIECE);
            stream.fill(&mut piece[..now])?;
            let (numbers, rest) = (now / stored.size(), (left - now) / stored.size());
            if data.capacity() < data.len() + numbers {
                data.reserve_exact(numbers + (data.len() / 8).min(rest));
            }
            data.extend(piece[..now].chunks_exact(stored.size()).map(|bytes| stored.number(bytes)));
            left -= now;
        }
        stream.skip(tag.padded() - tag.bytes)?;
        Ok(data)
    }
}

/// The names of a struct's fields.
fn fields(stream: &mut Stream<'_>) -> Result<Vec<String>, WeightsError> {
    let length = stream.small(5, 4)?;
    let length = length.first_chunk().map(|bytes| u32::from_le_bytes(*bytes) as usize);
    let length = length.filter(|length| (1..=64).contains(length)).ok_or(damaged("names of no length"))?;
    let names = stream.small(1, 64 * 1024)?;
    if names.len() % length != 0 {
        return Err(damaged("names are not as long as they say"));
    }
    let name = |bytes: &[u8]| {
        let end = bytes.iter().position(|byte| *byte == 0).unwrap_or(bytes.len());
        let name = std::str::from_utf8(&bytes[..end]).ok().filter(|name| !name.is_empty());
        name.map(str::to_owned).ok_or(damaged("a name is no text"))
    };
    names.chunks_exact(length).map(name).collect()
}

/// How a number is stored.
#[derive(Clone, Copy)]
enum Stored {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Stored {
    fn of(kind: u32) -> Option<Self> {
        Some(match kind {
            1 => Self::I8,
            2 => Self::U8,
            3 => Self::I16,
            4 => Self::U16,
            5 => Self::I32,
            6 => Self::U32,
            7 => Self::F32,
            9 => Self::F64,
            _ => return None,
        })
    }

    const fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// Of as many bytes as it has.
    fn number(self, bytes: &[u8]) -> f32 {
        match (self, bytes) {
            (Self::I8, &[a]) => f32::from(i8::from_le_bytes([a])),
            (Self::U8, &[a]) => f32::from(a),
            (Self::I16, &[a, b]) => f32::from(i16::from_le_bytes([a, b])),
            (Self::U16, &[a, b]) => f32::from(u16::from_le_bytes([a, b])),
            (Self::I32, &[a, b, c, d]) => i32::from_le_bytes([a, b, c, d]) as f32,
            (Self::U32, &[a, b, c, d]) => u32::from_le_bytes([a, b, c, d]) as f32,
            (Self::F32, &[a, b, c, d]) => f32::from_le_bytes([a, b, c, d]),
            (Self::F64, &[a, b, c, d, e, f, g, h]) => f64::from_le_bytes([a, b, c, d, e, f, g, h]) as f32,
            _ => f32::NAN,
        }
    }
}

/// What stands before data: its type, its bytes, and how many the short form has room for.
struct Tag {
    kind: u32,
    bytes: u64,
    short: bool,
}

impl Tag {
    /// Bytes with what fills them up.
    const fn padded(&self) -> u64 {
        if self.short { 4 } else { self.bytes.next_multiple_of(8) }
    }
}

/// What is left to read of an array.
struct Stream<'a> {
    input: Box<dyn Read + 'a>,
    left: u64,
}

impl Stream<'_> {
    fn fill(&mut self, bytes: &mut [u8]) -> Result<(), WeightsError> {
        let left =
            self.left.checked_sub(bytes.len() as u64).ok_or(damaged("an array is larger than it says"))?;
        self.input.read_exact(bytes).map_err(|_| damaged("the end is missing"))?;
        self.left = left;
        Ok(())
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], WeightsError> {
        let mut bytes = [0; N];
        self.fill(&mut bytes)?;
        Ok(bytes)
    }

    fn u32(&mut self) -> Result<u32, WeightsError> {
        self.array().map(u32::from_le_bytes)
    }

    /// The next byte, or `None` at the end.
    fn byte_or_end(&mut self) -> Result<Option<u8>, WeightsError> {
        let mut byte = [0];
        loop {
            match self.input.read(&mut byte) {
                Ok(0) => return Ok(None),
                Ok(_) => return Ok(Some(byte[0])),
                Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
                Err(_) => return Err(damaged("what is packed cannot be unpacked")),
            }
        }
    }

    /// In the short form type and length are halves of one number, and the data stands beside it.
    fn tag(&mut self) -> Result<Tag, WeightsError> {
        let first = self.u32()?;
        if first >> 16 == 0 {
            return Ok(Tag { kind: first, bytes: self.u32()?.into(), short: false });
        }
        let bytes = u64::from(first >> 16);
        if bytes > 4 {
            return Err(damaged("short data is not short"));
        }
        Ok(Tag { kind: first & 0xffff, bytes, short: true })
    }

    /// Data of this type, of `most` bytes.
    fn small(&mut self, kind: u32, most: u64) -> Result<Vec<u8>, WeightsError> {
        let tag = self.tag()?;
        if tag.kind != kind || tag.bytes > most {
            return Err(damaged("an array does not say what it is"));
        }
        let mut bytes = vec![0; tag.bytes as usize];
        self.fill(&mut bytes)?;
        self.skip(tag.padded() - tag.bytes)?;
        Ok(bytes)
    }

    fn skip(&mut self, mut bytes: u64) -> Result<(), WeightsError> {
        let mut piece = [0; 256];
        while bytes > 0 {
            let now = bytes.min(piece.len() as u64);
            self.fill(&mut piece[..now as usize])?;
            bytes -= now;
        }
        Ok(())
    }
}
