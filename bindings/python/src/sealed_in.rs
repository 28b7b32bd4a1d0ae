//! With which other queries the bytes of a query were sealed: bytes do not say it, and a rig's queries must be of one session.

use std::collections::VecDeque;
use std::hash::{BuildHasher as _, RandomState};
use std::sync::{LazyLock, Mutex, PoisonError};

use pyo3::prelude::*;
use pyo3::types::PyBytes;
use veiloc_protocol::{QueryError, SealedIn, SealedQuery};

/// Queries that are remembered: many times the frames of a rig.
const REMEMBERED: usize = 256;

/// The last queries that this process sealed, oldest first: hashes, no content.
static SEALED: Mutex<VecDeque<(u64, SealedIn)>> = Mutex::new(VecDeque::new());

/// Of this process only.
static HASHES: LazyLock<RandomState> = LazyLock::new(RandomState::new);

/// The bytes of a query that was just sealed.
pub(crate) fn bytes_of<'py>(py: Python<'py>, query: &SealedQuery) -> Bound<'py, PyBytes> {
    let bytes = query.encode();
    let mut sealed = SEALED.lock().unwrap_or_else(PoisonError::into_inner);
    sealed.push_back((HASHES.hash_one(&bytes[..]), query.sealed_in()));
    if sealed.len() > REMEMBERED {
        sealed.pop_front();
    }
    PyBytes::new(py, &bytes)
}

/// A query from its bytes, with what this process knows of its sealing.
pub(crate) fn query_of(bytes: &[u8]) -> Result<SealedQuery, QueryError> {
    let (query, hash) = (SealedQuery::decode(bytes)?, HASHES.hash_one(bytes));
    let sealed = SEALED.lock().unwrap_or_else(PoisonError::into_inner);
    let known = sealed.iter().rev().find(|(sealed, _)| *sealed == hash).map(|(_, sealed_in)| *sealed_in);
    Ok(query.with_sealed_in(known.unwrap_or_default()))
}
