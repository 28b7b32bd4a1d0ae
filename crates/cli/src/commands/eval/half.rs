//! Halves of a set of images: one to design with, the other untouched until the final figure.
//!
//! The half depends on the name of the file alone (without its folders), so that it is the same on every machine and
//! stays when images join or leave: of the 64-bit FNV-1a hash of the name, bit 32 (counted from the lowest, 0) is 0 in the
//! half for design and 1 in the final one.

use std::path::Path;

use serde::Serialize;

/// Which images.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub(super) enum Half {
    /// The half to design and calibrate with.
    Design,
    /// The half that only final figures may be of.
    Final,
    /// All of them.
    All,
}

impl Half {
    /// Whether a file belongs to it.
    pub(super) fn holds(self, file: &Path) -> bool {
        let name = file.file_name().unwrap_or_default();
        let design = (fnv_1a(name.as_encoded_bytes()) >> 32).is_multiple_of(2);
        match self {
            Self::Design => design,
            Self::Final => !design,
            Self::All => true,
        }
    }
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

    /// Hashes by an implementation in Python: 1dc6cbb9c70bad39, e7b1a2b0413ddae4, f9c54dbd08ccc3fe, 4b1014b6a5be6dad.
    #[test]
    fn halves_are_those_of_the_hash() {
        for (name, design) in NAMES {
            let of = |folder: &str| {
                [Half::Design, Half::Final, Half::All].map(|h| h.holds(&Path::new(folder).join(name)))
            };
            assert_eq!(of(""), [design, !design, true], "{name}");
            assert_eq!(of("elsewhere/deep"), of(""), "folders do not count: {name}");
        }
    }

    #[test]
    fn halves_are_halves() {
        let design = (0..2000).filter(|i| Half::Design.holds(Path::new(&format!("{i:06}.jpg")))).count();
        assert!((900..1100).contains(&design), "{design} of 2000");
    }

    const NAMES: [(&str, bool); 4] =
        [("fur-1.jpg", false), ("fur-2.jpg", true), ("fur-4.jpg", false), ("fur-5.jpg", true)];
}
