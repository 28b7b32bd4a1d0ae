//! Whether a query was sealed for a map.

use crate::profile::Wish;
use crate::{Profile, QueryError, SealedQuery};

impl Profile {
    /// Whether a query was sealed for a map with this profile: with the same descriptors, global model and limits, in
    /// whatever version. Scheme and angle bits are the device's.
    ///
    /// # Errors
    /// [`QueryError::WrongProfile`] when it was not; [`QueryError::Mismatch`] when it bears the right name, but its
    /// descriptors are not those of the profile.
    pub fn check(&self, query: &SealedQuery) -> Result<(), QueryError> {
        let wish = Wish { scheme: query.scheme(), angle_bits: query.angle_bits() };
        let asked = self.id_for(query.version(), wish);
        if asked != Some(query.profile_id()) {
            let map = asked.unwrap_or_else(|| self.to_v2().id());
            return Err(QueryError::WrongProfile { query: query.profile_id(), map });
        }
        let mismatch = |what, expected, actual| Err(QueryError::Mismatch { what, expected, actual });
        let (expected, actual) = (self.kind, query.descriptors().kind());
        if expected != actual {
            return mismatch("descriptor kind", format!("{expected:?}"), format!("{actual:?}"));
        }
        let (expected, actual) = (self.global.global_len(), query.global().len());
        if expected != actual {
            return mismatch("codes of the global descriptor", expected.to_string(), actual.to_string());
        }
        Ok(())
    }
}
