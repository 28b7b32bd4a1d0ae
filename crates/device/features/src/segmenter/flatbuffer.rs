//! FlatBuffers, as far as TFLite files need them. Every offset is checked against the file.
//!
//! Source: *FlatBuffers internals*: a table begins with the signed distance back to its vtable, which has 16-bit offsets of
//! its fields; a vector begins with its length.

/// The bytes are not what the format requires.
#[derive(Debug)]
pub(super) struct Damaged;

impl From<Damaged> for String {
    fn from(_: Damaged) -> Self {
        "it is damaged".to_owned()
    }
}

/// A table of a file.
#[derive(Clone, Copy)]
pub(super) struct Table<'a> {
    file: &'a [u8],
    at: usize,
}

impl<'a> Table<'a> {
    /// The root of a file.
    pub(super) fn root(file: &'a [u8]) -> Result<Self, Damaged> {
        let at = array(file, 0).map(u32::from_le_bytes)? as usize;
        Ok(Self { file, at })
    }

    /// The position of a field; `None` for one that is omitted.
    fn field(self, number: usize) -> Result<Option<usize>, Damaged> {
        let back = i32::from_le_bytes(array(self.file, self.at)?);
        let vtable = usize::try_from(self.at as i64 - i64::from(back)).map_err(|_| Damaged)?;
        let length = usize::from(u16::from_le_bytes(array(self.file, vtable)?));
        let entry = 4 + 2 * number;
        if entry + 2 > length {
            return Ok(None);
        }
        let offset = usize::from(u16::from_le_bytes(array(self.file, vtable + entry)?));
        Ok((offset > 0).then_some(self.at + offset))
    }

    /// A byte, or its default.
    pub(super) fn byte(self, number: usize, default: u8) -> Result<u8, Damaged> {
        self.field(number)?.map_or(Ok(default), |at| array(self.file, at).map(|[byte]| byte))
    }

    /// A 32-bit number, or its default.
    pub(super) fn int(self, number: usize, default: i32) -> Result<i32, Damaged> {
        self.field(number)?.map_or(Ok(default), |at| array(self.file, at).map(i32::from_le_bytes))
    }

    /// What an offset leads to.
    fn target(self, at: usize) -> Result<usize, Damaged> {
        at.checked_add(u32::from_le_bytes(array(self.file, at)?) as usize).ok_or(Damaged)
    }

    /// A table; `None` for one that is omitted.
    pub(super) fn table(self, number: usize) -> Result<Option<Self>, Damaged> {
        let Some(at) = self.field(number)? else { return Ok(None) };
        Ok(Some(Self { file: self.file, at: self.target(at)? }))
    }

    /// The position of the first element of a vector, and its bytes; empty for one that is omitted.
    fn vector(self, number: usize, size: usize) -> Result<(usize, &'a [u8]), Damaged> {
        let Some(at) = self.field(number)? else { return Ok((0, &[])) };
        let at = self.target(at)?;
        let length = u32::from_le_bytes(array(self.file, at)?) as usize;
        let rest = self.file.get(at + 4..).ok_or(Damaged)?;
        Ok((at + 4, rest.get(..length.checked_mul(size).ok_or(Damaged)?).ok_or(Damaged)?))
    }

    /// A vector of bytes, or a text.
    pub(super) fn bytes(self, number: usize) -> Result<&'a [u8], Damaged> {
        Ok(self.vector(number, 1)?.1)
    }

    /// A vector of 32-bit numbers.
    pub(super) fn ints(self, number: usize) -> Result<Vec<i32>, Damaged> {
        let (_, bytes) = self.vector(number, 4)?;
        bytes.chunks_exact(4).map(|four| array(four, 0).map(i32::from_le_bytes)).collect()
    }

    /// A vector of at most `most` tables.
    pub(super) fn tables(self, number: usize, most: usize) -> Result<Vec<Self>, Damaged> {
        let (first, bytes) = self.vector(number, 4)?;
        if bytes.len() / 4 > most {
            return Err(Damaged);
        }
        (0..bytes.len() / 4).map(|i| Ok(Self { file: self.file, at: self.target(first + 4 * i)? })).collect()
    }
}

fn array<const N: usize>(file: &[u8], at: usize) -> Result<[u8; N], Damaged> {
    file.get(at..).and_then(|rest| rest.first_chunk()).copied().ok_or(Damaged)
}
