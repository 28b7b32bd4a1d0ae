//! Why there is no page, with the remedy.

use std::path::PathBuf;

/// Why there is no page.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PageError {
    /// The system's word.
    #[error("{}: {source}", path.display())]
    Io {
        /// File or folder.
        path: PathBuf,
        /// What it said.
        source: std::io::Error,
    },
    /// It is not where it is looked for.
    #[error(
        "the page is neither in {} nor in {}; build it with bindings/web/build.sh, or say where it is with \
         --page-folder (the npm package has it in node_modules/veiloc/page)",
        beside.display(), shared.display()
    )]
    Nowhere {
        /// Beside the program.
        beside: PathBuf,
        /// Where packages put it.
        shared: PathBuf,
    },
    /// A folder that is no page.
    #[error("{}: {missing} is missing, so this is no built page; build it with bindings/web/build.sh", path.display())]
    Missing {
        /// The folder.
        path: PathBuf,
        /// What is not there.
        missing: &'static str,
    },
    /// More than any page.
    #[error("{}: larger than any page, 64 MiB; give the folder that bindings/web/build.sh makes", path.display())]
    TooLarge {
        /// The folder.
        path: PathBuf,
    },
    /// A name that is none.
    #[error("{name:?} is no file of a page: letters, digits, `-`, `_` and `.`, with a known ending")]
    Name {
        /// It.
        name: String,
    },
}
