//! Whether a worker holds each object of a manifest.

use crate::ClusterError;
use std::time::Duration;

use crate::bus::{Bus, Subject};
use futures_util::StreamExt as _;
use futures_util::stream;
use veiloc_map::regions::{Manifest, ObjectId};

use crate::message::{Reply, ReplyOutcome, Request, Task};
use crate::subjects;

/// Time limit of a ping, and number of concurrent pings.
const PING_TIMEOUT: Duration = Duration::from_secs(2);
const MAX_CONCURRENT_PINGS: usize = 32;

/// Request name of messages that belong to no query.
const NO_REQUEST: [u8; 16] = [0; 16];

/// The groups of a manifest: its index, and its regions by number.
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

    /// Number of groups without a responding member.
    pub(crate) async fn unreachable(&self, bus: &Bus) -> usize {
        let all: Vec<_> = std::iter::once(&self.index).chain(&self.regions).cloned().collect();
        let pings = stream::iter(all).map(|(subject, object)| is_held(bus.clone(), subject, object));
        pings.buffer_unordered(MAX_CONCURRENT_PINGS).filter(|held| std::future::ready(!held)).count().await
    }
}

async fn is_held(bus: Bus, subject: Subject, object: ObjectId) -> bool {
    let ping = Request { name: NO_REQUEST, object, within: PING_TIMEOUT, task: Task::Ping };
    let reply = bus.request(&subject, ping.encode(), PING_TIMEOUT).await;
    reply.is_ok_and(|bytes| {
        matches!(Reply::decode(bytes, &NO_REQUEST), Ok(Reply { outcome: ReplyOutcome::Here, .. }))
    })
}
