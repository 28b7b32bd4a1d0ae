//! Image files that lists name, with any extension.

use std::path::{Path, PathBuf};

use crate::error::DatasetError;

/// What to do if images named by a list are missing.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum MissingImages {
    /// Refuse the data set.
    #[default]
    Refuse,
    /// Leave them out, and count them in the scene's remarks; the scene is then not the official one.
    LeaveOut,
}

/// Extensions of the data sets' images; that of the list is tried first.
const ENDINGS: [&str; 4] = ["png", "jpg", "jpeg", "JPG"];

/// The name under which an image of a list exists: as listed, or with another extension.
pub(crate) fn present(folder: &Path, name: &str) -> Option<String> {
    let there = |name: &str| folder.join(name).is_file();
    if there(name) {
        return Some(name.to_owned());
    }
    let (stem, _) = name.rsplit_once('.')?;
    ENDINGS.iter().map(|ending| format!("{stem}.{ending}")).find(|other| there(other))
}

/// Counts the listed and the existing images.
#[derive(Debug)]
pub(crate) struct ImageFiles {
    folder: PathBuf,
    policy: MissingImages,
    named: usize,
    missing: usize,
    first: Option<String>,
}

impl ImageFiles {
    pub(crate) fn new(folder: &Path, policy: MissingImages) -> Self {
        Self { folder: folder.to_owned(), policy, named: 0, missing: 0, first: None }
    }

    /// The name under which an image exists.
    pub(crate) fn find(&mut self, name: &str) -> Option<String> {
        self.named += 1;
        let found = present(&self.folder, name);
        if found.is_none() {
            self.missing += 1;
            self.first.get_or_insert_with(|| name.to_owned());
        }
        found
    }

    /// Fails on missing images, or returns a remark about those left out; `None` when all exist.
    pub(crate) fn finish(self, get: &str) -> Result<Option<String>, DatasetError> {
        let Some(first) = self.first else { return Ok(None) };
        let (missing, named) = (self.missing, self.named);
        match self.policy {
            MissingImages::LeaveOut if missing < named => {
                Ok(Some(format!("{missing} of {named} listed images are missing and were left out")))
            }
            MissingImages::LeaveOut | MissingImages::Refuse => Err(DatasetError::MissingImages {
                folder: self.folder,
                missing,
                named,
                first,
                remedy: if missing < named {
                    format!("{get}, or evaluate the existing images with --available-only")
                } else {
                    get.to_owned()
                },
            }),
        }
    }
}

/// Width and height of an image, from its header.
pub(crate) fn size(path: &Path) -> Result<(u32, u32), DatasetError> {
    image::image_dimensions(path).map_err(|source| match source {
        image::ImageError::IoError(source) => DatasetError::Io { path: path.to_owned(), source },
        source => DatasetError::Image { path: path.to_owned(), source },
    })
}
