//! The entries of a zip archive that is not packed, as PyTorch and `numpy.savez` write them.

use flate2::Crc;

use super::bytes::Bytes;
use crate::learned::WeightsError;

const ENTRY: &[u8] = b"PK\x03\x04";
const DIRECTORY_ENTRY: &[u8] = b"PK\x01\x02";
const END: &[u8] = b"PK\x05\x06";
const END_BYTES: usize = 22;
/// A size that stands elsewhere: an archive beyond 4 GiB.
const ELSEWHERE: u32 = u32::MAX;

/// Names and contents.
pub(super) struct Archive<'a>(Vec<(&'a str, &'a [u8])>);

pub(super) fn is_zip(bytes: &[u8]) -> bool {
    bytes.starts_with(ENTRY)
}

impl<'a> Archive<'a> {
    /// Reads the directory at the end of the file, and checks every entry's sum.
    pub(super) fn read(file: &'a [u8]) -> Result<Self, WeightsError> {
        let damaged = || WeightsError::Damaged("no directory of a zip archive");
        // A comment of up to 64 KiB may stand behind the end.
        let earliest = file.len().saturating_sub(END_BYTES + 65535);
        let at = (earliest..=file.len().saturating_sub(END_BYTES)).rev();
        let end = at.into_iter().find(|at| file[*at..].starts_with(END)).ok_or_else(damaged)?;
        let mut fields = Bytes(&file[end + 8..]);
        let (count, all) = (fields.u16()?, fields.u16()?);
        let (size, offset) = (fields.u32()?, fields.u32()?);
        if count != all || count == u16::MAX || size == ELSEWHERE || offset == ELSEWHERE {
            return Err(WeightsError::Unsupported("an archive of several parts, or beyond 4 GiB,"));
        }
        let mut directory = Bytes(file.get(offset as usize..end).ok_or_else(damaged)?);
        let mut entries = Vec::with_capacity(count.into());
        for _ in 0..count {
            entries.push(entry(file, &mut directory)?);
        }
        Ok(Self(entries))
    }

    pub(super) fn names(&self) -> impl Iterator<Item = &'a str> {
        self.0.iter().map(|(name, _)| *name)
    }

    /// The content of an entry.
    pub(super) fn get(&self, name: &str) -> Option<&'a [u8]> {
        self.0.iter().find(|(own, _)| *own == name).map(|(_, content)| *content)
    }
}

/// One entry of the directory, and what it points to.
fn entry<'a>(file: &'a [u8], directory: &mut Bytes<'a>) -> Result<(&'a str, &'a [u8]), WeightsError> {
    let damaged = || WeightsError::Damaged("an entry of the zip archive is not what its directory says");
    if directory.take(4)? != DIRECTORY_ENTRY {
        return Err(damaged());
    }
    directory.take(4)?; // versions
    let (flags, method) = (directory.u16()?, directory.u16()?);
    directory.take(4)?; // time
    let (sum, packed, size) = (directory.u32()?, directory.u32()?, directory.u32()?);
    let lengths = [directory.u16()?, directory.u16()?, directory.u16()?].map(usize::from);
    directory.take(8)?; // disk, attributes
    let offset = directory.u32()?;
    let name = directory.take(lengths[0])?;
    directory.take(lengths[1] + lengths[2])?;
    if method != 0 || flags & 1 != 0 {
        return Err(WeightsError::Unsupported("a packed or locked zip archive"));
    }
    if [packed, size, offset].contains(&ELSEWHERE) {
        return Err(WeightsError::Unsupported("an entry beyond 4 GiB"));
    }
    let mut local = Bytes(file.get(offset as usize..).ok_or_else(damaged)?);
    if packed != size || local.take(4)? != ENTRY {
        return Err(damaged());
    }
    local.take(22)?;
    let (name_length, extra) = (usize::from(local.u16()?), usize::from(local.u16()?));
    local.take(name_length + extra)?;
    let content = local.take(size as usize)?;
    let mut crc = Crc::new();
    crc.update(content);
    if crc.sum() != sum {
        return Err(WeightsError::Damaged("the sum of an entry of the zip archive is another"));
    }
    Ok((std::str::from_utf8(name).map_err(|_| damaged())?, content))
}
