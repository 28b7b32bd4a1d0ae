//! Finds the images that other programs' files name.
//!
//! Programs write absolute paths, paths relative to their file, names without an extension or without a folder, and
//! `\` for `/`. A name is looked up as it is written first, then relative to the file that names it, then by shorter
//! and shorter ends of the path, then with the extensions of images, and last by the only file of this name in the
//! folders below.
//!
//! A file by a shorter end of its path may be another image: `cam1/3.jpg` is not `3.jpg` of the folder `cam0`. When all
//! paths are read, those that lead to an image which another path names better, or to another image than the file
//! that exists elsewhere, are [misplaced](ImageNames::misplaced).

use std::cell::{OnceCell, RefCell};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Component, Path, PathBuf};

use veiloc_features::{FeatureError, image_size, is_image_file, spelled_image_extensions};

use crate::error::MappingError;
use crate::input::image_names::image_file;

/// Depth of folders that are searched.
const MAX_DEPTH: usize = 8;

/// The name of an image, with its width and height in pixels.
pub(super) type SizedName = (String, (u32, u32));

/// Names of image files, relative to their folder.
pub(super) struct ImageNames {
    folder: PathBuf,
    /// Names of all image files below the folder, by file name without extension.
    by_stem: OnceCell<BTreeMap<String, Vec<String>>>,
    /// What was found so far.
    found: RefCell<BTreeMap<String, Found>>,
    /// Paths for which no file is to be found.
    left_out: BTreeSet<String>,
    /// Paths that several files may be, and those files.
    ambiguous: RefCell<BTreeMap<String, Vec<String>>>,
}

/// The image that a path leads to.
#[derive(Debug, Clone)]
struct Found {
    name: String,
    /// The part of the path that was left away; `None` if it leads there as it is written.
    dropped: Option<String>,
    /// The file that the path names, if it exists outside of the folder of the images.
    outside: Option<PathBuf>,
}

impl ImageNames {
    pub(super) fn new(folder: &Path) -> Self {
        Self {
            folder: folder.to_owned(),
            by_stem: OnceCell::new(),
            found: RefCell::default(),
            left_out: BTreeSet::new(),
            ambiguous: RefCell::default(),
        }
    }

    /// The same names, with no file for these paths.
    pub(super) fn without(self, left_out: BTreeSet<String>) -> Self {
        Self { left_out, ..self }
    }

    /// Of the paths that were looked up, those that lead to another image than the one that they name.
    pub(super) fn misplaced(&self) -> BTreeSet<String> {
        let found = self.found.borrow();
        let as_written: BTreeSet<&str> =
            found.values().filter(|f| f.dropped.is_none()).map(|f| f.name.as_str()).collect();
        let mut claims: BTreeMap<&str, usize> = BTreeMap::new();
        for of in found.values() {
            *claims.entry(&of.name).or_default() += 1;
        }
        let dropped: BTreeSet<&str> = found.values().filter_map(|f| f.dropped.as_deref()).collect();
        let own = self.folder.canonicalize().unwrap_or_else(|_| self.folder.clone());
        let own = own.file_name().map(|name| name.to_string_lossy().into_owned());
        let is_own = |dropped: &str| own.as_deref() == dropped.rsplit('/').next();
        let is_misplaced = |of: &Found| {
            let Some(part) = &of.dropped else { return false };
            let is_claimed = claims[of.name.as_str()] > 1;
            let is_other = |outside: &PathBuf| !is_same(outside, &image_file(&self.folder, &of.name));
            as_written.contains(of.name.as_str())
                || is_claimed && !is_own(part)
                || !as_written.is_empty() && !is_own(part)
                || dropped.len() > 1 && of.outside.as_ref().is_some_and(is_other)
        };
        found.iter().filter(|(_, of)| is_misplaced(of)).map(|(written, _)| written.clone()).collect()
    }

    /// The files that a path may be, if there are several and it was looked up.
    pub(super) fn alike(&self, written: &str) -> Option<Vec<String>> {
        self.ambiguous.borrow().get(&cleaned(written)).cloned()
    }

    /// Whether several files may be the one that `file` names.
    pub(super) fn is_ambiguous(&self, file: &Path, written: &str) -> bool {
        let name = cleaned(written);
        self.lookup(file, &name).is_none() && self.alike(&name).is_some()
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
        match image_size(&path) {
            Ok(size) => Ok(Some((name, size))),
            Err(FeatureError::Read { path, source }) => Err(MappingError::Io { path, source }),
            Err(FeatureError::Decode { path, reason }) => Err(super::posed_input::faulty(&path, reason)),
            Err(error) => Err(super::posed_input::faulty(&path, error.to_string())),
        }
    }

    /// Names of all image files below the folder, sorted.
    pub(super) fn all(&self) -> Vec<String> {
        let mut names: Vec<String> = self.by_stem().values().flatten().cloned().collect();
        names.sort();
        names
    }

    fn existing(&self, file: &Path, name: &str) -> Option<String> {
        if self.left_out.contains(name) {
            return None;
        }
        let (found, dropped) = self.lookup(file, name)?;
        let named = file.parent().unwrap_or(Path::new("")).join(name);
        let outside = (dropped.is_some() && named.is_file()).then_some(named);
        self.found.borrow_mut().insert(name.to_owned(), Found { name: found.clone(), dropped, outside });
        Some(found)
    }

    /// The name of an image, and the part of the path that was left away to find it.
    fn lookup(&self, file: &Path, name: &str) -> Option<(String, Option<String>)> {
        let is_file = |name: &str| !name.is_empty() && image_file(&self.folder, name).is_file();
        if !Path::new(name).is_absolute() && is_file(name) {
            return Some((name.to_owned(), None));
        }
        let beside_file = file.parent().unwrap_or(Path::new("")).join(name);
        if let (Ok(there), Ok(folder)) = (beside_file.canonicalize(), self.folder.canonicalize())
            && there.is_file()
            && let Ok(inside) = there.strip_prefix(&folder)
        {
            return Some((inside.to_string_lossy().into_owned(), None));
        }
        let parts: Vec<&str> = name.split('/').filter(|part| !matches!(*part, "" | "." | "..")).collect();
        // The end from a part on, and what is before it.
        let dropped = |from: usize| (from > 0).then(|| parts[..from].join("/"));
        let ends = || (0..parts.len()).map(|from| (parts[from..].join("/"), dropped(from)));
        if let Some(found) = ends().find(|(end, _)| is_file(end)) {
            return Some(found);
        }
        let with_extensions = |(end, dropped): (String, Option<String>)| {
            let stem = without_extension(&end).to_owned();
            let bases = [end, stem];
            let names = bases.into_iter().flat_map(|base| {
                spelled_image_extensions().map(move |extension| format!("{base}.{extension}"))
            });
            names.map(move |name| (name, dropped.clone()))
        };
        if let Some(found) = ends().flat_map(with_extensions).find(|(end, _)| is_file(end)) {
            return Some(found);
        }
        let last = parts.last()?;
        let dropped = dropped(parts.len() - 1);
        let alike = self.by_stem();
        let alike = alike.get(*last).or_else(|| alike.get(without_extension(last)))?;
        let same: Vec<&String> =
            alike.iter().filter(|found| found.rsplit('/').next() == Some(*last)).collect();
        match (&same[..], &alike[..]) {
            ([only], _) => Some(((*only).clone(), dropped)),
            ([], [only]) => Some((only.clone(), dropped)),
            (same, alike) => {
                let mut files: Vec<String> =
                    if same.is_empty() { alike.to_vec() } else { same.iter().copied().cloned().collect() };
                files.sort();
                self.ambiguous.borrow_mut().insert(name.to_owned(), files);
                None
            }
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
        } else if is_image_file(&path) {
            found.entry(without_extension(&name).to_owned()).or_default().push(relative);
        }
    }
}

/// Whether two files have the same content.
fn is_same(a: &Path, b: &Path) -> bool {
    let length = |path: &Path| std::fs::metadata(path).ok().map(|data| data.len());
    length(a) == length(b) && matches!((std::fs::read(a), std::fs::read(b)), (Ok(a), Ok(b)) if a == b)
}

/// A written name with `/`, without `./` and what it undoes.
pub(super) fn cleaned(written: &str) -> String {
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
    /// A file of posed images with two cameras, of which one folder is given, or a flat copy of both.
    #[test]
    fn image_of_another_folder_is_not_taken() {
        let root = tempfile::tempdir().expect("temporary folder");
        let write = |name: &str, content: &str| {
            let path = root.path().join(name);
            std::fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
            std::fs::write(path, content).expect("written");
        };
        for name in ["images/cam0/1.jpg", "images/cam0/2.jpg", "images/cam1/1.jpg", "images/cam1/3.jpg"] {
            write(name, name);
        }
        // Copied into one folder: cam0's is the one that is left.
        write("flat/1.jpg", "images/cam0/1.jpg");
        write("flat/2.jpg", "images/cam0/2.jpg");
        write("flat/3.jpg", "images/cam1/3.jpg");
        write("small/1.jpg", "smaller");
        write("small/2.jpg", "smaller");
        let file = root.path().join("transforms.json");
        let misplaced = |folder: &str, paths: &[&str]| {
            let names = ImageNames::new(&root.path().join(folder));
            for path in paths {
                names.find(&file, path);
            }
            let misplaced: Vec<String> = names.misplaced().into_iter().collect();
            let names = names.without(misplaced.iter().cloned().collect());
            assert!(misplaced.iter().all(|path| names.find(&file, path) == *path), "{misplaced:?}");
            misplaced
        };
        let (zero, one) =
            (["images/cam0/1.jpg", "images/cam0/2.jpg"], ["images/cam1/1.jpg", "images/cam1/3.jpg"]);
        // cam1/1.jpg is not cam0's, whether the file names cam0's, too, or not.
        assert_eq!(misplaced("images/cam0", &[zero[0], zero[1], one[0]]), [one[0]]);
        assert_eq!(misplaced("images/cam0", &[zero[1], one[0]]), [one[0]]);
        // In the flat copy it is neither's, or the other's.
        assert_eq!(misplaced("flat", &[zero[1], one[0], one[1]]), [one[0]]);
        assert_eq!(misplaced("flat", &[zero[0], zero[1], one[0], one[1]]), [zero[0], one[0]]);
        // Other images of the same names, as of another size, are meant when one folder is replaced.
        assert_eq!(misplaced("small", &zero), [""; 0]);
        assert_eq!(misplaced("images", &[zero[0], one[0], one[1]]), [""; 0]);
        // Paths of another machine.
        assert_eq!(misplaced("images/cam0", &["/data/scan/cam0/1.jpg", "/data/scan/cam0/2.jpg"]), [""; 0]);
        assert_eq!(misplaced("images/cam0", &["/data/cam0/1.jpg", "/data/cam1/1.jpg"]), ["/data/cam1/1.jpg"]);
    }
}
