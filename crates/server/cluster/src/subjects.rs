//! The groups that workers join: one an object, whatever manifest names it.
//!
//! So a region that two manifests have in common stays where it is when one takes the place of the other. The map's name
//! stands in front, so that an account of the bus can be given the maps that it may ask for.

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
