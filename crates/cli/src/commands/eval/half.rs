//! Halves of a set of images: one to design with, the other untouched until the final figure.
//!
//! The half depends on the name of the file alone (without its folders), so that it is the same on every machine and
//! stays when images join or leave: the first hexadecimal digit of the name's SHA-256, as `printf %s NAME | sha256sum`
//! prints it, is 0 to 7 in the half for design and 8 to f in the final one.

use std::path::Path;

use serde::Serialize;
use sha2::{Digest as _, Sha256};

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
        let design = Sha256::digest(name.as_encoded_bytes())[0] < 0x80;
        match self {
            Self::Design => design,
            Self::Final => !design,
            Self::All => true,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// First digits by `printf %s NAME | sha256sum`: 6, 1, c, a.
    #[test]
    fn halves_are_those_of_sha256sum() {
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
        [("fur-1.jpg", true), ("fur-2.jpg", true), ("fur-4.jpg", false), ("fur-5.jpg", false)];
}
