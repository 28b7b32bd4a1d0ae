//! Whether everything that a manifest names is held by somebody.

use crate::ClusterError;
use std::time::Duration;

use crate::bus::{Bus, Subject};
use futures_util::StreamExt as _;
use futures_util::stream;
use veiloc_map::regions::{Manifest, ObjectId};

use crate::message::{Outcome, Reply, Request, Wanted};
use crate::subjects;

/// How long somebody may take to say that it is there, and how many are asked at a time.
const PATIENCE: Duration = Duration::from_secs(2);
const AT_A_TIME: usize = 32;

/// A name for requests that belong to no query.
const NO_REQUEST: [u8; 16] = [0; 16];

/// The groups of a manifest: of its index, and of its regions by their numbers.
#[derive(Debug, Clone)]
pub(crate) struct Groups {
    pub(crate) index: (Subject, ObjectId),
    pub(crate) regions: Vec<(Subject, ObjectId)>,
}

impl Groups {
    pub(crate) fn of(manifest: &Manifest) -> Result<Self, ClusterError> {
        let map = &manifest.map;
        let index = manifest.index.sha256;
        let regions = manifest.regions.iter().map(|region| region.sha256);
        Ok(Self {
            index: (subjects::of_index(map, &index)?, index),
            regions: regions
                .map(|region| Ok((subjects::of_region(map, &region)?, region)))
                .collect::<Result<_, ClusterError>>()?,
        })
    }

    /// How many of them nobody is in.
    pub(crate) async fn unreached(&self, bus: &Bus) -> usize {
        let all: Vec<_> = std::iter::once(&self.index).chain(&self.regions).cloned().collect();
        let asked = stream::iter(all).map(|(subject, object)| is_held(bus.clone(), subject, object));
        asked.buffer_unordered(AT_A_TIME).filter(|held| std::future::ready(!held)).count().await
    }
}

async fn is_held(bus: Bus, subject: Subject, object: ObjectId) -> bool {
    let ping = Request { name: NO_REQUEST, object, within: PATIENCE, wanted: Wanted::Ping };
    let reply = bus.request(&subject, ping.encode(), PATIENCE).await;
    reply.is_ok_and(|bytes| {
        matches!(Reply::decode(bytes, &NO_REQUEST), Ok(Reply { outcome: Outcome::Here, .. }))
    })
}
