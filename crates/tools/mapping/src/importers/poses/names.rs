//! Finds the images that other programs' files name.
//!
//! Programs write absolute paths, paths relative to their file, names without an extension or without a folder, and
//! `\` for `/`. A name is looked up as it is written first, then relative to the file that names it, then by shorter
//! and shorter ends of the path, then with the extensions of images, and last by the only file of this name in the
//! folders below.

use std::cell::OnceCell;
use std::collections::BTreeMap;
use std::path::{Component, Path, PathBuf};

use crate::error::MappingError;
use crate::input::image_names::image_file;

/// Extensions of images that are tried; that of the written name is tried first.
const EXTENSIONS: [&str; 6] = ["jpg", "png", "jpeg", "JPG", "PNG", "JPEG"];

/// Depth of folders that are searched.
const MAX_DEPTH: usize = 8;

/// The name of an image, with its width and height in pixels.
pub(super) type SizedName = (String, (u32, u32));

/// Names of image files, relative to their folder.
pub(super) struct ImageNames {
    folder: PathBuf,
    /// Names of all image files below the folder, by file name without extension.
    by_stem: OnceCell<BTreeMap<String, Vec<String>>>,
}

impl ImageNames {
    pub(super) fn new(folder: &Path) -> Self {
        Self { folder: folder.to_owned(), by_stem: OnceCell::new() }
    }

    /// The folder of the images.
    pub(super) fn folder(&self) -> &Path {
        &self.folder
    }

    /// The name of an image that `file` names. Without a file of this name: the name as written, without `./`.
    pub(super) fn find(&self, file: &Path, written: &str) -> String {
        let cleaned = cleaned(written);
        self.existing(file, &cleaned).unwrap_or(cleaned)
    }

    /// The name and the size of an image; `None` if there is no file.
    ///
    /// # Errors
    /// The file is no image.
    pub(super) fn with_size(&self, file: &Path, written: &str) -> Result<Option<SizedName>, MappingError> {
        let Some(name) = self.existing(file, &cleaned(written)) else { return Ok(None) };
        let path = image_file(&self.folder, &name);
        match image::image_dimensions(&path) {
            Ok(size) => Ok(Some((name, size))),
            Err(image::ImageError::IoError(source)) => Err(MappingError::Io { path, source }),
            Err(error) => Err(super::posed_input::faulty(&path, format!("{error}; give a JPEG or PNG file"))),
        }
    }

    /// Names of all image files below the folder, sorted.
    pub(super) fn all(&self) -> Vec<String> {
        let mut names: Vec<String> = self.by_stem().values().flatten().cloned().collect();
        names.sort();
        names
    }

    fn existing(&self, file: &Path, name: &str) -> Option<String> {
        let is_file = |name: &str| !name.is_empty() && image_file(&self.folder, name).is_file();
        if !Path::new(name).is_absolute() && is_file(name) {
            return Some(name.to_owned());
        }
        let beside_file = file.parent().unwrap_or(Path::new("")).join(name);
        if let (Ok(there), Ok(folder)) = (beside_file.canonicalize(), self.folder.canonicalize())
            && there.is_file()
            && let Ok(inside) = there.strip_prefix(&folder)
        {
            return Some(inside.to_string_lossy().into_owned());
        }
        let parts: Vec<&str> = name.split('/').filter(|part| !matches!(*part, "" | "." | "..")).collect();
        let ends = || (0..parts.len()).map(|from| parts[from..].join("/"));
        if let Some(found) = ends().find(|end| is_file(end)) {
            return Some(found);
        }
        let with_extensions = |end: String| {
            let stem = without_extension(&end).to_owned();
            let bases = [end, stem];
            bases.into_iter().flat_map(|base| EXTENSIONS.map(|extension| format!("{base}.{extension}")))
        };
        if let Some(found) = ends().flat_map(with_extensions).find(|end| is_file(end)) {
            return Some(found);
        }
        let last = parts.last()?;
        let alike = self.by_stem();
        let alike = alike.get(*last).or_else(|| alike.get(without_extension(last)))?;
        let same: Vec<&String> =
            alike.iter().filter(|found| found.rsplit('/').next() == Some(*last)).collect();
        match (&same[..], &alike[..]) {
            ([only], _) => Some((*only).clone()),
            ([], [only]) => Some(only.clone()),
            _ => None,
        }
    }

    fn by_stem(&self) -> &BTreeMap<String, Vec<String>> {
        self.by_stem.get_or_init(|| {
            let mut found = BTreeMap::new();
            collect(&self.folder, "", MAX_DEPTH, &mut found);
            found
        })
    }
}

fn collect(folder: &Path, prefix: &str, depth: usize, found: &mut BTreeMap<String, Vec<String>>) {
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let (path, name) = (entry.path(), entry.file_name().to_string_lossy().into_owned());
        if name.starts_with('.') {
            continue;
        }
        let relative = format!("{prefix}{name}");
        if path.is_dir() && depth > 0 {
            collect(&path, &format!("{relative}/"), depth - 1, found);
        } else if EXTENSIONS.iter().any(|e| path.extension().is_some_and(|is| is == *e)) {
            found.entry(without_extension(&name).to_owned()).or_default().push(relative);
        }
    }
}

/// A written name with `/`, without `./` and what it undoes.
fn cleaned(written: &str) -> String {
    let slashes = written.trim().replace('\\', "/");
    let parts: PathBuf = Path::new(&slashes).components().filter(|c| *c != Component::CurDir).collect();
    parts.to_string_lossy().into_owned()
}

/// A file name without its extension.
pub(super) fn without_extension(name: &str) -> &str {
    match name.rsplit_once('.') {
        Some((stem, extension)) if !stem.is_empty() && !extension.contains('/') => stem,
        _ => name,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_are_found_by_any_path_that_names_them() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let images = folder.path().join("scan/images");
        std::fs::create_dir_all(images.join("cam0")).expect("a folder");
        std::fs::create_dir_all(images.join("cam1")).expect("a folder");
        for name in ["a.jpg", "cam0/b.png", "cam0/c.jpg", "cam1/c.jpg"] {
            std::fs::write(images.join(name), name).expect("written");
        }
        let names = ImageNames::new(&images);
        let file = folder.path().join("scan/transforms.json");
        for (written, expected) in [
            ("a.jpg", "a.jpg"),
            ("./images/a.jpg", "a.jpg"),
            ("images/cam0/b.png", "cam0/b.png"),
            (r"D:\scan\images\cam0\b.jpg", "cam0/b.png"),
            ("b", "cam0/b.png"),
            ("a", "a.jpg"),
            ("/data/else/a.jpeg", "a.jpg"),
            // Two files of this name: as written, so that the message names it.
            ("c.jpg", "c.jpg"),
            ("./d.jpg", "d.jpg"),
        ] {
            assert_eq!(names.find(&file, written), expected, "{written}");
        }
        assert_eq!(names.all(), ["a.jpg", "cam0/b.png", "cam0/c.jpg", "cam1/c.jpg"]);
        assert!(names.with_size(&file, "d.jpg").expect("no file is no error").is_none());
        assert!(names.with_size(&file, "a.jpg").is_err(), "no image");
    }
}
