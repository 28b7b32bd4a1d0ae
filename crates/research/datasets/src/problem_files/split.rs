//! Development and test split of a set of images: one half for design, the other untouched until the final figure.
//!
//! The half depends only on the file's name without folders, so it is the same on every machine and does not change
//! when images are added or removed.

use std::path::Path;

/// Whether an image belongs to the half for design: bit 32 (counted from the lowest, 0) of the 64-bit FNV-1a hash of
/// its name is 0.
pub fn is_in_design_split(file: &Path) -> bool {
    (fnv_1a(file.file_name().unwrap_or_default().as_encoded_bytes()) >> 32).is_multiple_of(2)
}

/// The 64-bit FNV-1a hash (Fowler, Noll and Vo).
fn fnv_1a(bytes: &[u8]) -> u64 {
    bytes
        .iter()
        .fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn split_follows_the_hash() {
        // Hashes computed by an implementation in Python.
        let known = [
            ("fur-1.jpg", 0x1dc6_cbb9_c70b_ad39, false),
            ("fur-2.jpg", 0xe7b1_a2b0_413d_dae4, true),
            ("fur-4.jpg", 0xf9c5_4dbd_08cc_c3fe, false),
            ("fur-5.jpg", 0x4b10_14b6_a5be_6dad, true),
        ];
        for (name, hash, design) in known {
            assert_eq!(fnv_1a(name.as_bytes()), hash);
            for folder in ["", "elsewhere/deep"] {
                assert_eq!(is_in_design_split(&Path::new(folder).join(name)), design, "{folder} {name}");
            }
        }
    }

    #[test]
    fn split_has_equal_halves() {
        let design = (0..2000).filter(|i| is_in_design_split(Path::new(&format!("{i:06}.jpg")))).count();
        assert!((900..1100).contains(&design), "{design} of 2000");
    }
}
