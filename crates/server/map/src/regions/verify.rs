//! Verifies the content of an object file.

use std::fs::File;
use std::io::Read as _;
use std::path::Path;

use sha2::{Digest as _, Sha256};

use crate::MapError;
use crate::regions::object::{ObjectId, ObjectRef};

/// Checks that the file at `path` is this object, reading at most its length.
///
/// # Errors
/// [`MapError::Io`]: it cannot be read; [`MapError::Object`]: it has other content.
pub fn verify_file(path: &Path, object: &ObjectRef) -> Result<(), MapError> {
    let io = |source| MapError::Io { path: path.to_owned(), source };
    let wrong = |found: String| MapError::Object { path: path.to_owned(), expected: *object, found };
    let mut file = File::open(path).map_err(io)?;
    let actual = file.metadata().map_err(io)?.len();
    if actual != object.bytes {
        return Err(wrong(format!("{actual} bytes")));
    }
    let (mut hash, mut buffer) = (Sha256::new(), vec![0; 1 << 18]);
    let mut left = object.bytes;
    while left > 0 {
        let most = usize::try_from(left).unwrap_or(usize::MAX).min(buffer.len());
        let read = file.read(&mut buffer[..most]).map_err(io)?;
        if read == 0 {
            return Err(wrong(format!("{} bytes", object.bytes - left)));
        }
        hash.update(&buffer[..read]);
        left -= read as u64;
    }
    let found = ObjectId::from_bytes(hash.finalize().into());
    if found == object.sha256 { Ok(()) } else { Err(wrong(format!("the object {found}"))) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn file_content_is_verified() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("object");
        let bytes: Vec<u8> = (0..700_000_u32).map(|i| (i % 251) as u8).collect();
        let object = ObjectRef::of(&bytes);
        let is = |bytes: &[u8]| {
            std::fs::write(&path, bytes).unwrap();
            verify_file(&path, &object)
        };
        is(&bytes).unwrap();
        let mut other = bytes.clone();
        other[500_000] ^= 1;
        for wrong in [&other[..], &bytes[1..], b""] {
            assert!(matches!(is(wrong), Err(MapError::Object { .. })));
        }
        std::fs::remove_file(&path).unwrap();
        assert!(matches!(verify_file(&path, &object), Err(MapError::Io { .. })));
        std::fs::write(&path, b"").unwrap();
        verify_file(&path, &ObjectRef::of(b"")).unwrap();
    }
}
