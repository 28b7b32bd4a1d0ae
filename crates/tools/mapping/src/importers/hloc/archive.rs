//! HDF5 file with named groups: the common structure of feature, match and global descriptor files.

use std::path::{Path, PathBuf};

use crate::MappingError;
use crate::importers::hloc::numbers::{self, Numbers};
use hdf5_pure::{Dataset, File, Group};

/// Maximum depth of nested groups; image names with folders stay far below it.
const MAX_DEPTH: usize = 24;
/// Maximum number of visited groups.
const MAX_GROUPS: usize = 1 << 20;

/// An open file.
pub(crate) struct Archive {
    path: PathBuf,
    file: File,
    bytes: u64,
}

impl std::fmt::Debug for Archive {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Archive({})", self.path.display())
    }
}

impl Archive {
    pub(crate) fn open(path: &Path) -> Result<Self, MappingError> {
        let io = |source| MappingError::Io { path: path.to_owned(), source };
        let about = std::fs::metadata(path).map_err(io)?;
        if about.is_dir() {
            return Err(io(std::io::ErrorKind::IsADirectory.into()));
        }
        let file = File::open_streaming(path)
            .map_err(|e| MappingError::NotHdf5 { path: path.to_owned(), reason: e.to_string() })?;
        Ok(Self { path: path.to_owned(), file, bytes: about.len() })
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the error of an invalid entry.
    pub(crate) fn bad(&self, name: &str, reason: impl Into<String>) -> MappingError {
        MappingError::BadInFile { path: self.path.clone(), name: name.to_owned(), reason: reason.into() }
    }

    /// The group of this name; `None` where there is none.
    pub(crate) fn group(&self, name: &str) -> Option<Group> {
        let plain = |part: &str| !part.is_empty() && part != "." && part != "..";
        name.split('/').all(plain).then(|| self.file.group(name).ok()).flatten()
    }

    /// Names of all groups that hold a dataset of this name, in the order of the file.
    pub(crate) fn names(&self, dataset: &str) -> Result<Vec<String>, MappingError> {
        let mut found = Vec::new();
        self.walk(dataset, &mut |name| {
            found.push(name.to_owned());
            true
        })?;
        Ok(found)
    }

    /// Returns one of those names.
    pub(crate) fn any_name(&self, dataset: &str) -> Result<Option<String>, MappingError> {
        let mut found = None;
        self.walk(dataset, &mut |name| {
            found = Some(name.to_owned());
            false
        })?;
        Ok(found)
    }

    /// Calls `then` with each such name until it returns false.
    fn walk(&self, dataset: &str, then: &mut dyn FnMut(&str) -> bool) -> Result<(), MappingError> {
        let mut open = vec![(String::new(), self.file.root(), 0)];
        let mut seen = 0;
        while let Some((name, group, depth)) = open.pop() {
            seen += 1;
            if seen > MAX_GROUPS || depth > MAX_DEPTH {
                return Err(self.bad(
                    &name,
                    format!(
                        "groups are nested more than {MAX_DEPTH} deep, or there are more than \
                         {MAX_GROUPS}; this is not an hloc file"
                    ),
                ));
            }
            let broken = |e: hdf5_pure::Error| {
                self.bad(&format!("group {name:?}"), format!("cannot be read: {e}; copy the file again"))
            };
            let held = group.datasets().map_err(broken)?;
            if held.iter().any(|own| own == dataset) {
                if !then(&name) {
                    return Ok(());
                }
                continue;
            }
            let mut inside = group.groups().map_err(broken)?;
            inside.sort_unstable_by(|a, b| b.cmp(a));
            for child in inside {
                let below = if name.is_empty() { child.clone() } else { format!("{name}/{child}") };
                open.push((below, group.group(&child).map_err(broken)?, depth + 1));
            }
        }
        Ok(())
    }

    /// The dataset of a group; `None` where there is none.
    pub(crate) fn dataset(
        &self,
        name: &str,
        group: &Group,
        dataset: &str,
    ) -> Result<Option<Dataset>, MappingError> {
        let broken =
            |e: hdf5_pure::Error| self.bad(name, format!("cannot be read: {e}; copy the file again"));
        if !group.datasets().map_err(broken)?.iter().any(|own| own == dataset) {
            return Ok(None);
        }
        group.dataset(dataset).map(Some).map_err(broken)
    }

    /// The numbers of a dataset of a group; `None` where there is none.
    pub(crate) fn numbers(
        &self,
        name: &str,
        group: &Group,
        dataset: &str,
    ) -> Result<Option<Numbers>, MappingError> {
        let Some(found) = self.dataset(name, group, dataset)? else { return Ok(None) };
        let numbers = numbers::read(&found, self.bytes)
            .map_err(|reason| self.bad(&format!("{name}/{dataset}"), reason))?;
        Ok(Some(numbers))
    }
}
