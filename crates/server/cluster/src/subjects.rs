//! Subjects of the groups that workers join: one group per object, independent of the manifest.
//!
//! So a region that two manifests share stays in its group when one manifest replaces the other. The map name comes
//! first, so that an account of the bus can be restricted to maps.

use crate::ClusterError;
use crate::bus::Subject;
use veiloc_map::regions::ObjectId;

/// The workers that hold this region of a map.
pub(crate) fn of_region(map: &str, region: &ObjectId) -> Result<Subject, ClusterError> {
    Ok(Subject::new(["veiloc", map, "region", &region.to_string()])?)
}

/// The workers that hold this index of a map.
pub(crate) fn of_index(map: &str, index: &ObjectId) -> Result<Subject, ClusterError> {
    Ok(Subject::new(["veiloc", map, "index", &index.to_string()])?)
}
