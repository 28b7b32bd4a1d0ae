//! A remote backend whose queries block, each on its worker, until the test admits them.
#![allow(dead_code, unreachable_pub)] // each user takes its own part

use std::sync::Arc;

use tokio::sync::Semaphore;
use veiloc_localization::LocalizeOptions;
use veiloc_map::MapFile;
use veiloc_service::{AnswerFuture, MapDescription, RemoteBackend, RemoteMap, RemoteRequest, ServerOptions};

use super::{Files, eventually};

pub struct Gate {
    map: MapFile,
    description: Arc<MapDescription>,
    permits: Semaphore,
}

impl Gate {
    /// Replaces the map of these options.
    pub fn install(files: &Files, options: &mut ServerOptions) -> Arc<Self> {
        let map = MapFile::open(&files.path("place.vmap")).expect("a map");
        let (profile, images, points) = (map.profile().clone(), map.image_count(), map.point_count());
        let description =
            Arc::new(MapDescription { profile, images, points, coordinates: map.coordinates() });
        let gate = Arc::new(Self { map, description, permits: Semaphore::new(0) });
        options.maps.clear();
        options.remote_maps = vec![RemoteMap { name: "place".to_owned(), backend: gate.clone() }];
        gate
    }

    /// Admits this many queries, waiting and future ones.
    pub fn admit(&self, count: usize) {
        self.permits.add_permits(count);
    }

    /// Admits all queries from now on.
    pub fn open(&self) {
        self.permits.add_permits(Semaphore::MAX_PERMITS / 2);
    }
}

impl RemoteBackend for Gate {
    fn describe(&self) -> Option<Arc<MapDescription>> {
        Some(self.description.clone())
    }

    fn is_complete(&self) -> bool {
        true
    }

    fn longest(&self) -> usize {
        usize::MAX
    }

    fn localize(&self, request: RemoteRequest) -> AnswerFuture<'_> {
        Box::pin(async move {
            self.permits.acquire().await.expect("never closed").forget();
            request.decoded.localize(&self.map, &LocalizeOptions::default(), 0.0)
        })
    }
}

/// Waits until this many workers are busy and this many queries are queued.
pub fn wait_until_load(server: &super::Running, busy: u32, queued: u32) {
    eventually("the expected load", || {
        let is = |series: &str, count: u32| server.metric(series) == Some(f64::from(count));
        is("veiloc_workers_busy", busy) && is("veiloc_queue_length", queued)
    });
}
