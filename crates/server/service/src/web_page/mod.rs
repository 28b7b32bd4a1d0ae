//! The optional web page: its files, checked and compressed once, and a subset of map points.
//!
//! The page is built by `bindings/web/build.sh` as one flat folder ([`Page::read`]); [`Page::folder`] finds that
//! folder. All files are kept in memory. This module is independent of HTTP and of what the page does.
//!
//! ```
//! use veiloc_service::web_page::Page;
//!
//! let folder = tempfile::tempdir()?;
//! for name in ["index.html", "veiloc.wasm"] {
//!     std::fs::write(folder.path().join(name), "content")?;
//! }
//! let page = Page::read(folder.path())?;
//! let wasm = page.file("veiloc.wasm").ok_or("it was read")?;
//! assert_eq!((wasm.content_type, &wasm.plain.bytes()[..]), ("application/wasm", &b"content"[..]));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
#![forbid(unsafe_code)]

mod content;
mod points;

use std::collections::BTreeMap;
use std::io::{Read as _, Write as _};
use std::path::{Path, PathBuf};

use flate2::Compression;
use flate2::write::GzEncoder;

use crate::error::ServerError;
pub use content::Content;
pub use points::subsampled_points;

/// Maximum number of files of a page, and of their bytes together.
const MAX_FILES: usize = 256;
const MAX_BYTES: u64 = 64 << 20;
/// Required files.
const NEEDED: [&str; 2] = ["index.html", "veiloc.wasm"];
/// Allowed files: extension, media type, and whether to compress. Other files of the folder are ignored.
const TYPES: [(&str, &str, bool); 9] = [
    ("html", "text/html; charset=utf-8", true),
    ("css", "text/css; charset=utf-8", true),
    ("js", "text/javascript; charset=utf-8", true),
    ("json", "application/json", true),
    ("wasm", "application/wasm", true),
    ("tflite", "application/octet-stream", true),
    ("svg", "image/svg+xml", true),
    ("png", "image/png", false),
    ("jpg", "image/jpeg", false),
];

/// A page in memory.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Page {
    files: BTreeMap<String, PageFile>,
}

/// A file of the page.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PageFile {
    /// Media type.
    pub content_type: &'static str,
    /// The uncompressed content.
    pub plain: Content,
    /// The content compressed with gzip (RFC 1952), if that is shorter.
    pub gzip: Option<Content>,
}

impl Page {
    /// The network with which the page hides people, which the operator may put into the folder.
    pub const PEOPLE: &str = "selfie_segmentation.tflite";
    /// Name of the folder next to the program.
    pub const FOLDER: &str = "veiloc-page";

    /// Reads a folder, ignoring subfolders.
    ///
    /// # Errors
    /// [`ServerError`]: the folder cannot be read, lacks a required file, or is too large.
    pub fn read(folder: &Path) -> Result<Self, ServerError> {
        let io = |source| ServerError::Io { path: folder.to_owned(), source };
        let mut page = Self::default();
        let mut left = MAX_BYTES;
        for entry in std::fs::read_dir(folder).map_err(io)? {
            let path = entry.map_err(io)?.path();
            let Some(name) = path.file_name().and_then(|name| name.to_str()) else { continue };
            if kind(name).is_none() || !path.is_file() {
                continue;
            }
            let io = |source| ServerError::Io { path: path.clone(), source };
            let mut bytes = Vec::new();
            std::fs::File::open(&path).map_err(io)?.take(left + 1).read_to_end(&mut bytes).map_err(io)?;
            left = left
                .checked_sub(bytes.len() as u64)
                .filter(|_| page.files.len() < MAX_FILES)
                .ok_or_else(|| ServerError::PageTooLarge { path: folder.to_owned() })?;
            page.add(name, bytes)?;
        }
        match NEEDED.iter().find(|name| !page.files.contains_key(**name)) {
            Some(missing) => Err(ServerError::PageIncomplete { path: folder.to_owned(), missing }),
            None => Ok(page),
        }
    }

    /// The default folder of the page: next to the program, or in `share/veiloc` next to the folder of the program.
    ///
    /// # Errors
    /// [`ServerError::NoPage`] with the paths that were tried.
    pub fn folder(program: &Path) -> Result<PathBuf, ServerError> {
        let beside = program.parent().unwrap_or_else(|| Path::new("."));
        let shared = beside.parent().unwrap_or(beside).join("share").join("veiloc");
        let candidates = [beside.join(Self::FOLDER), shared.join(Self::FOLDER)];
        let found = candidates.iter().find(|folder| folder.join(NEEDED[0]).is_file()).cloned();
        found.ok_or_else(|| {
            let [beside, shared] = candidates;
            ServerError::NoPage { beside, shared }
        })
    }

    /// Adds a file.
    ///
    /// # Errors
    /// [`ServerError::PageName`]: the name is not allowed.
    pub fn add(&mut self, name: &str, bytes: Vec<u8>) -> Result<(), ServerError> {
        let (content_type, is_compressible) =
            kind(name).ok_or_else(|| ServerError::PageName { name: name.to_owned() })?;
        let gzip = is_compressible.then(|| compressed(&bytes)).flatten();
        self.files.insert(
            name.to_owned(),
            PageFile { content_type, plain: Content::new(bytes), gzip: gzip.map(Content::new) },
        );
        Ok(())
    }

    /// A file by its name.
    pub fn file(&self, name: &str) -> Option<&PageFile> {
        self.files.get(name)
    }
}

/// For an allowed name: media type, and whether to compress.
fn kind(name: &str) -> Option<(&'static str, bool)> {
    let is_plain = name.chars().all(|c| c.is_ascii_alphanumeric() || "-_.".contains(c));
    let ending = name.rsplit_once('.').filter(|(stem, _)| is_plain && !stem.is_empty())?.1;
    TYPES.iter().find(|(known, ..)| *known == ending).map(|(_, name, compressible)| (*name, *compressible))
}

/// Compressed at the highest level, because this is done once; `None` if the result is not shorter. The output is
/// deterministic: it contains no time.
fn compressed(bytes: &[u8]) -> Option<Vec<u8>> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::best());
    // Writing to a `Vec` cannot fail; if it did, the file would be sent uncompressed.
    encoder.write_all(bytes).ok()?;
    encoder.finish().ok().filter(|short| short.len() < bytes.len())
}
