//! Workers that divide the regions of a map among them.

use super::common;

use std::num::NonZeroU32;
use std::time::Duration;

use common::service::truth;
use common::{Announcements, PublishedMap, TestCluster, eventually, worker_options};
use veiloc_cluster::bus::Bus;
use veiloc_cluster::{PlacementOptions, WorkerHandle, WorkerOptions};
use veiloc_service::RemoteBackend as _;
use veiloc_service::worker_api::{Controllable as _, HealthProbe as _};

/// A worker that is forgotten 12 s after its last announcement, on a busy machine too.
fn placed_worker(name: &str, replicas: u32) -> WorkerOptions {
    let mut options = worker_options("all");
    options.period = Duration::from_secs(2);
    let mut placement = PlacementOptions::new(name.to_owned(), NonZeroU32::new(replicas).expect("not zero"));
    placement.settle = Duration::from_secs(3600);
    options.placement = Some(placement);
    options
}

fn loads(worker: &WorkerHandle) -> u64 {
    common::value(&worker.metrics(), "veiloc_object_loads_total")
}

/// A map of ten regions.
fn published() -> PublishedMap {
    let published = PublishedMap::new(1);
    assert!(published.folder().manifest().regions.len() >= 8);
    published
}

#[tokio::test(flavor = "multi_thread")]
async fn workers_divide_the_regions_and_move_few_when_one_joins() {
    let (published, bus) = (published(), Bus::in_process());
    let announced = Announcements::listen(&bus).await;
    let regions: Vec<_> = published.folder().manifest().regions.iter().map(|region| region.sha256).collect();
    let cluster = TestCluster::start_with(&published, bus, vec![]).await;
    let have = |copies: usize| regions.iter().all(|region| announced.holders(region) == copies);
    // The first one has all of them; with the second one too, and then they divide.
    for count in 1..=3_usize {
        cluster.start_worker(&published, placed_worker(&format!("worker-{count}"), 2)).await;
        cluster.knows(count).await;
        let copies = count.min(2);
        eventually("the copies", || have(copies)).await;
    }
    let workers = cluster.handles();
    let before: Vec<u64> = workers.iter().map(loads).collect();
    assert_eq!(announced.holders(&published.index()), 3);
    assert!(cluster.ask(&published.query(&truth())).await.expect("a pose").trusted());

    cluster.start_worker(&published, placed_worker("worker-4", 2)).await;
    let of_new = || loads(&cluster.handles()[3]) - 1;
    eventually("two copies of each", || have(2)).await;
    assert_eq!(workers.iter().map(loads).collect::<Vec<_>>(), before, "the others loaded nothing");
    assert!((1..regions.len() as u64).contains(&of_new()), "{} of {}", of_new(), regions.len());
    assert!(cluster.ask(&published.query(&truth())).await.expect("a pose").trusted());

    // One that leaves is expected back, because each of its regions has another copy.
    assert!(cluster.leave().await);
    cluster.knows(3).await;
    let least = || regions.iter().map(|region| announced.holders(region)).min();
    assert_eq!(least(), Some(1));
    // It comes back under its name and takes what it had.
    cluster.start_worker(&published, placed_worker("worker-1", 2)).await;
    eventually("two copies of each", || have(2)).await;
    assert_eq!(workers[1..].iter().map(loads).collect::<Vec<_>>(), before[1..]);
}

/// A region that no other worker has does not wait for the worker that left with it.
#[tokio::test(flavor = "multi_thread")]
async fn regions_without_a_copy_move_at_once() {
    let (published, bus) = (published(), Bus::in_process());
    let announced = Announcements::listen(&bus).await;
    let regions: Vec<_> = published.folder().manifest().regions.iter().map(|region| region.sha256).collect();
    let cluster = TestCluster::start_with(&published, bus, vec![]).await;
    for count in 1..=2_usize {
        cluster.start_worker(&published, placed_worker(&format!("worker-{count}"), 1)).await;
        cluster.knows(count).await;
    }
    eventually("a copy of each", || regions.iter().all(|region| announced.holders(region) == 1)).await;
    assert!(cluster.leave().await);
    cluster.knows(1).await;
    assert!(cluster.ask(&published.query(&truth())).await.expect("a pose").trusted());
}

#[tokio::test(flavor = "multi_thread")]
async fn full_workers_take_no_more_and_say_so() {
    let (published, bus) = (published(), Bus::in_process());
    let regions = published.folder().manifest().regions.len() as u64;
    let cluster = TestCluster::start_with(&published, bus, vec![]).await;
    let mut options = placed_worker("worker-1", 2);
    options.placement.as_mut().expect("placed").placed.max_regions = NonZeroU32::new(3);
    cluster.start_worker(&published, options).await;
    let worker: WorkerHandle = cluster.handle();
    let is = |what: &str, count: u64| common::value(&worker.metrics(), what) == count;
    // The index too.
    assert!(is("veiloc_objects_loaded", 4) && is("veiloc_copies_unplaced", regions - 3));
    worker.ready().expect("it serves what it has");
    assert!(!cluster.gateway.is_complete(), "most regions have no worker");
    cluster.start_worker(&published, placed_worker("worker-2", 2)).await;
    cluster.knows(2).await;
    eventually("the gauge", || is("veiloc_copies_unplaced", regions - 3)).await;
    worker.stop();
}
