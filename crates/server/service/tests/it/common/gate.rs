//! A map behind a gate: queries wait there, each on its worker, until the test lets them through.
#![allow(dead_code, unreachable_pub)] // each user takes its own part

use std::sync::Arc;

use tokio::sync::Semaphore;
use veiloc_localization::LocalizeOptions;
use veiloc_map::MapFile;
use veiloc_service::{Answering, Description, Elsewhere, MapElsewhere, Question, ServerOptions};

use super::{Files, eventually};

pub struct Gate {
    map: MapFile,
    description: Arc<Description>,
    permits: Semaphore,
}

impl Gate {
    /// Puts itself before the map of these options.
    pub fn before_the_map_of(files: &Files, options: &mut ServerOptions) -> Arc<Self> {
        let map = MapFile::open(&files.path("place.vmap")).expect("a map");
        let (profile, images, points) = (map.profile().clone(), map.image_count(), map.point_count());
        let description = Arc::new(Description { profile, images, points });
        let gate = Arc::new(Self { map, description, permits: Semaphore::new(0) });
        options.maps.clear();
        options.elsewhere = vec![MapElsewhere { name: "place".to_owned(), held_by: gate.clone() }];
        gate
    }

    /// Lets so many through, those that wait and those that come.
    pub fn let_through(&self, count: usize) {
        self.permits.add_permits(count);
    }

    /// Lets all through from now on.
    pub fn open(&self) {
        self.permits.add_permits(Semaphore::MAX_PERMITS / 2);
    }
}

impl Elsewhere for Gate {
    fn describe(&self) -> Option<Arc<Description>> {
        Some(self.description.clone())
    }

    fn longest(&self) -> usize {
        usize::MAX
    }

    fn localize(&self, question: Question) -> Answering<'_> {
        Box::pin(async move {
            self.permits.acquire().await.expect("never closed").forget();
            question.asked.localize(&self.map, &LocalizeOptions::default(), 0.0).map(|found| found.answer)
        })
    }
}

/// Waits until so many are at work and so many wait for a worker.
pub fn all_are_in(server: &super::Running, busy: u32, queued: u32) {
    eventually("the queries are in", || {
        let is = |series: &str, count: u32| server.metric(series) == Some(f64::from(count));
        is("veiloc_workers_busy", busy) && is("veiloc_queue_length", queued)
    });
}
