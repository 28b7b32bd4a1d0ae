//! The regions and indexes that a worker holds, by the SHA-256 of their bytes.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, PoisonError, RwLock, RwLockReadGuard};

use tokio::sync::watch;
use veiloc_map::MapFile;
use veiloc_map::regions::{ObjectId, RegionIndex};

/// A part of a map that a worker holds.
#[derive(Debug)]
pub(crate) enum Content {
    /// A region, in which queries are localized.
    Region(Box<MapFile>),
    /// An index, which selects the regions for a query.
    Index(Box<RegionIndex>),
}

/// What a worker holds. A request keeps its content, so removing it affects no request in progress.
pub(crate) struct Holdings {
    held: RwLock<BTreeMap<ObjectId, Arc<Content>>>,
    changes: watch::Sender<u64>,
}

impl Default for Holdings {
    fn default() -> Self {
        Self { held: RwLock::default(), changes: watch::Sender::new(0) }
    }
}

impl Holdings {
    fn held(&self) -> RwLockReadGuard<'_, BTreeMap<ObjectId, Arc<Content>>> {
        self.held.read().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn find(&self, object: &ObjectId) -> Option<Arc<Content>> {
        self.held().get(object).cloned()
    }

    pub(crate) fn contains(&self, object: &ObjectId) -> bool {
        self.held().contains_key(object)
    }

    pub(crate) fn objects(&self) -> BTreeSet<ObjectId> {
        self.held().keys().copied().collect()
    }

    pub(crate) fn len(&self) -> usize {
        self.held().len()
    }

    /// Notified of each change.
    pub(crate) fn changes(&self) -> watch::Receiver<u64> {
        self.changes.subscribe()
    }

    pub(crate) fn insert(&self, object: ObjectId, content: Content) {
        self.held.write().unwrap_or_else(PoisonError::into_inner).insert(object, Arc::new(content));
        self.changes.send_modify(|changes| *changes += 1);
    }

    pub(crate) fn remove(&self, objects: &[ObjectId]) {
        let mut held = self.held.write().unwrap_or_else(PoisonError::into_inner);
        held.retain(|object, _| !objects.contains(object));
        drop(held);
        self.changes.send_modify(|changes| *changes += 1);
    }
}
