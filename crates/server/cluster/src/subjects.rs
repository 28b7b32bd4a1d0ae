//! Subjects of the bus. The map name comes first, so that an account of the bus can be restricted to maps.

use crate::ClusterError;
use crate::announcement::MemberId;
use crate::bus::Subject;

/// Where the workers of a map announce themselves.
pub(crate) fn of_members(map: &str) -> Result<Subject, ClusterError> {
    Ok(Subject::new(["veiloc", map, "members"])?)
}

/// Where a worker of a map receives its requests.
pub(crate) fn of_member(map: &str, member: &MemberId) -> Result<Subject, ClusterError> {
    Ok(Subject::new(["veiloc", map, "member", &member.to_string()])?)
}

/// Where gateways report what their clients spend. No map has this subject, because those begin with `veiloc.`.
pub(crate) fn of_gateways() -> Result<Subject, ClusterError> {
    Ok(Subject::new(["veiloc_gateways", "spent"])?)
}
