//! Spellings of image names: a name and its file may differ in separators and in the composition of accents.
//!
//! Programs on Windows write `cam0\a.jpg`. Macs store `ü` as `u` with an accent (NFD), and most other systems as one
//! character (NFC). Both look alike on a screen, so a name is looked up as it is written first, and then in its other
//! spellings.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use icu_normalizer::{ComposingNormalizerBorrowed, DecomposingNormalizerBorrowed};

/// The file of an image in a folder: the name as it is written, or, if there is no such file, the other spelling of the
/// name for which there is one.
///
/// The file need not exist.
pub fn image_file(folder: &Path, name: &str) -> PathBuf {
    let written = folder.join(name);
    if written.exists() {
        return written;
    }
    other_spellings(name).map(|name| folder.join(name)).find(|path| path.exists()).unwrap_or(written)
}

/// The file of an image's mask in a folder of masks, by COLMAP's rule: `extract/3.jpg.png` for `extract/3.jpg`, or the
/// other spelling of that name for which there is a file.
pub fn mask_file(folder: &Path, image: &str) -> PathBuf {
    image_file(folder, &format!("{image}.png"))
}

/// Other spellings of a name: with `/` for `\`, composed, decomposed.
pub(crate) fn other_spellings(name: &str) -> impl Iterator<Item = String> {
    let slashes = with_slashes(name);
    // A separator must not lead out of the folder where the name as written does not.
    let is_safe = slashes == name || slashes.split('/').all(|part| part != "..");
    let mut spellings = Vec::new();
    if !name.is_ascii() || slashes != name {
        for base in [Some(name), is_safe.then_some(&*slashes)].into_iter().flatten() {
            let composed = ComposingNormalizerBorrowed::new_nfc().normalize(base).into_owned();
            let decomposed = DecomposingNormalizerBorrowed::new_nfd().normalize(base).into_owned();
            spellings.extend([base.to_owned(), composed, decomposed]);
        }
    }
    let written = name.to_owned();
    spellings.into_iter().filter(move |spelling| *spelling != written)
}

fn with_slashes(name: &str) -> Cow<'_, str> {
    if name.contains('\\') { Cow::Owned(name.replace('\\', "/")) } else { Cow::Borrowed(name) }
}

/// Values by image name, for names that may be spelled in another way.
#[derive(Debug)]
pub struct NameIndex<T> {
    exact: BTreeMap<String, T>,
    /// By the composed spelling with `/`; `None` if names differ only in their spelling.
    alike: BTreeMap<String, Option<T>>,
}

impl<T: Copy> NameIndex<T> {
    /// Indexes values by their names; of equal names the last counts.
    pub fn new<'a>(names: impl IntoIterator<Item = (&'a str, T)>) -> Self {
        let (mut exact, mut alike) = (BTreeMap::new(), BTreeMap::new());
        for (name, value) in names {
            exact.insert(name.to_owned(), value);
            alike.entry(canonical(name)).and_modify(|entry| *entry = None).or_insert(Some(value));
        }
        Self { exact, alike }
    }

    /// The value of a name as it is written, or of the only name that differs from it in the spelling.
    pub fn get(&self, name: &str) -> Option<T> {
        self.exact.get(name).copied().or_else(|| self.alike.get(&canonical(name)).copied().flatten())
    }
}

fn canonical(name: &str) -> String {
    ComposingNormalizerBorrowed::new_nfc().normalize(&with_slashes(name)).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    const COMPOSED: &str = "K\u{fc}che.jpg";
    const DECOMPOSED: &str = "Ku\u{308}che.jpg";

    #[test]
    fn files_are_found_in_other_spellings() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let folder = folder.path();
        let write = |name: &str| std::fs::write(folder.join(name), name).expect("written");
        let found = |name: &str| std::fs::read_to_string(image_file(folder, name)).ok();
        std::fs::create_dir(folder.join("cam0")).expect("a folder");
        write("cam0/a.jpg");
        assert_eq!(found(r"cam0\a.jpg").as_deref(), Some("cam0/a.jpg"));
        assert_eq!(image_file(folder, r"cam0\b.jpg"), folder.join(r"cam0\b.jpg"), "the name as written");
        assert_eq!(found(r"cam0\..\cam0\a.jpg"), None, "no way out of the folder");
        write("cam0/a.jpg.png");
        assert_eq!(mask_file(folder, r"cam0\a.jpg"), folder.join("cam0/a.jpg.png"));
        write(DECOMPOSED);
        assert_eq!(found(COMPOSED).as_deref(), Some(DECOMPOSED));
        write(COMPOSED);
        assert_eq!(found(COMPOSED).as_deref(), Some(COMPOSED), "the name as written first");
        assert_eq!(found(DECOMPOSED).as_deref(), Some(DECOMPOSED));
    }

    #[test]
    fn index_finds_the_only_name_that_is_alike() {
        let index = NameIndex::new([("cam0/a.jpg", 1), (DECOMPOSED, 2), (r"b\c.jpg", 3), ("b/c.jpg", 4)]);
        assert_eq!(index.get(r"cam0\a.jpg"), Some(1));
        assert_eq!((index.get(COMPOSED), index.get(DECOMPOSED)), (Some(2), Some(2)));
        assert_eq!((index.get(r"b\c.jpg"), index.get("b/c.jpg")), (Some(3), Some(4)));
        assert_eq!(index.get("d.jpg"), None);
        let both = NameIndex::new([(COMPOSED, 1), (DECOMPOSED, 2)]);
        assert_eq!((both.get(COMPOSED), both.get(DECOMPOSED)), (Some(1), Some(2)));
    }
}
