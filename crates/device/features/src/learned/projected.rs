//! The projection of a network's descriptors, and its file.

use std::path::Path;

use crate::FeatureError;
use crate::Projection;
use serde::Deserialize;
use veiloc_descriptor::DescriptorKind;

/// Built-in projections, by file name.
const BUILT_IN: [(&str, &[u8]); 2] = [
    ("xfeat-compact.bin", include_bytes!("../../projections/xfeat-compact.bin")),
    ("alike-t-compact.bin", include_bytes!("../../projections/alike-t-compact.bin")),
];

/// The part of a description that names a projection.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Projected {
    pub(crate) file: String,
    pub(crate) numbers: usize,
    shift: u32,
    pub(crate) length: u32,
}

impl Projected {
    /// The built-in projection of this name, or the file beside the description.
    pub(crate) fn read(
        &self,
        description: &Path,
        from: DescriptorKind,
        to: DescriptorKind,
    ) -> Result<Projection, FeatureError> {
        let path = description.with_file_name(&self.file);
        let beside;
        let bytes = match BUILT_IN.iter().find(|(name, _)| *name == self.file) {
            Some((_, bytes)) => *bytes,
            None if !path.is_file() => {
                let known: Vec<&str> = BUILT_IN.iter().map(|(name, _)| *name).collect();
                let (file, known) = (&self.file, known.join(", "));
                let reason =
                    format!("its projection {file:?} is neither a file beside it nor built in ({known})");
                return Err(FeatureError::Description { path: description.to_owned(), reason });
            }
            None => {
                beside = crate::learned::file::read(&path, MAX_BYTES)?;
                &beside
            }
        };
        Projection::new(from, to, self.shift, bytes)
            .map_err(|source| FeatureError::Projection { path, source })
    }
}

/// Size of a projection between the largest kinds.
const MAX_BYTES: u64 = (DescriptorKind::MAX_DIM * (2 * DescriptorKind::MAX_DIM + 4)) as u64;
