//! Small files that the service reads whole, on which its security depends.

use std::io::{self, Read as _};
use std::path::Path;

/// Reads a file of credentials. A pipe or a device is refused, because reading it could take for ever.
pub(crate) fn read_small_file(path: &Path) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    veiloc_map::open_regular_file(path)?.read_to_end(&mut bytes)?;
    Ok(bytes)
}
