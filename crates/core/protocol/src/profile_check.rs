//! Whether a query was sealed for a map.

use crate::{Profile, QueryError, SealedQuery};

impl Profile {
    /// Whether a query was sealed for a map with this profile: with the same descriptors, global model and limits. The
    /// device chooses scheme and angle bits.
    ///
    /// # Errors
    /// [`QueryError::WrongProfile`] when it was not; [`QueryError::Mismatch`] when it has the right id, but its
    /// descriptors are not those of the profile.
    pub fn check(&self, query: &SealedQuery) -> Result<(), QueryError> {
        let (query_id, map) = (query.profile_id(), self.id());
        if query_id != map {
            return Err(QueryError::WrongProfile { query: query_id, map });
        }
        let mismatch = |what, expected, actual| Err(QueryError::Mismatch { what, expected, actual });
        let (expected, actual) = (self.kind, query.descriptor_kind());
        if expected != actual {
            return mismatch("descriptor kind", format!("{expected:?}"), format!("{actual:?}"));
        }
        let Some(global) = query.global() else { return Ok(()) };
        let (expected, actual) = (self.global.global_len(), global.len());
        if expected != actual {
            return mismatch("codes of the global descriptor", expected.to_string(), actual.to_string());
        }
        Ok(())
    }
}
