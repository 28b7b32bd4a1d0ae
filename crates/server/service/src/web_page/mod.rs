//! The page that a service may serve: its files, checked and compressed once, and a map's points, thinned.
//!
//! The page is built by `bindings/web/build.sh`, which makes one flat folder of it ([`Page::read`]); where a program finds that
//! folder says [`Page::folder`]. All of it is held in memory from then on. This room knows neither HTTP nor what the page does.
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
pub use points::thinned;

/// Most files of a page, and most bytes of all of them together.
const MOST_FILES: usize = 256;
const MOST_BYTES: u64 = 64 << 20;
/// What must be there.
const NEEDED: [&str; 2] = ["index.html", "veiloc.wasm"];
/// What a page is made of: ending, what HTTP calls it, and whether it can be compressed. Other files of its folder are left alone.
const TYPES: [(&str, &str, bool); 8] = [
    ("html", "text/html; charset=utf-8", true),
    ("css", "text/css; charset=utf-8", true),
    ("js", "text/javascript; charset=utf-8", true),
    ("json", "application/json", true),
    ("wasm", "application/wasm", true),
    ("svg", "image/svg+xml", true),
    ("png", "image/png", false),
    ("jpg", "image/jpeg", false),
];

/// A page in memory.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Page {
    files: BTreeMap<String, PageFile>,
}

/// A file of it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PageFile {
    /// What HTTP calls its form.
    pub content_type: &'static str,
    /// All of it, as it is.
    pub plain: Content,
    /// The same compressed (gzip, RFC 1952), where that is shorter.
    pub gzip: Option<Content>,
}

impl Page {
    /// The name of the folder that lies beside the program.
    pub const FOLDER: &str = "veiloc-page";

    /// Reads a folder, without folders in it.
    ///
    /// # Errors
    /// [`ServerError`]: it cannot be read, lacks what every page has, or is larger than any page.
    pub fn read(folder: &Path) -> Result<Self, ServerError> {
        let io = |source| ServerError::Io { path: folder.to_owned(), source };
        let mut page = Self::default();
        let mut left = MOST_BYTES;
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
                .filter(|_| page.files.len() < MOST_FILES)
                .ok_or_else(|| ServerError::PageTooLarge { path: folder.to_owned() })?;
            page.add(name, bytes)?;
        }
        match NEEDED.iter().find(|name| !page.files.contains_key(**name)) {
            Some(missing) => Err(ServerError::PageIncomplete { path: folder.to_owned(), missing }),
            None => Ok(page),
        }
    }

    /// Where the folder of the page is when nobody says: beside the program, or in `share/veiloc` beside the program's folder.
    ///
    /// # Errors
    /// [`ServerError::NoPage`] naming where it was looked for.
    pub fn folder(program: &Path) -> Result<PathBuf, ServerError> {
        let beside = program.parent().unwrap_or_else(|| Path::new("."));
        let shared = beside.parent().unwrap_or(beside).join("share").join("veiloc");
        let places = [beside.join(Self::FOLDER), shared.join(Self::FOLDER)];
        let found = places.iter().find(|place| place.join(NEEDED[0]).is_file()).cloned();
        found.ok_or_else(|| {
            let [beside, shared] = places;
            ServerError::NoPage { beside, shared }
        })
    }

    /// Adds a file.
    ///
    /// # Errors
    /// [`ServerError::PageName`] for a name that is no file's of a page.
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

/// Of a plain name with a known ending: what HTTP calls it, and whether it can be compressed.
fn kind(name: &str) -> Option<(&'static str, bool)> {
    let is_plain = name.chars().all(|c| c.is_ascii_alphanumeric() || "-_.".contains(c));
    let ending = name.rsplit_once('.').filter(|(stem, _)| is_plain && !stem.is_empty())?.1;
    TYPES.iter().find(|(known, ..)| *known == ending).map(|(_, name, compressible)| (*name, *compressible))
}

/// As short as it gets, as it is done once; `None` where that is no shorter. Equal bytes for equal bytes: it holds no time.
fn compressed(bytes: &[u8]) -> Option<Vec<u8>> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::best());
    // A `Vec` takes all that is written to it; did it not, the file would go out as it is.
    encoder.write_all(bytes).ok()?;
    encoder.finish().ok().filter(|short| short.len() < bytes.len())
}
