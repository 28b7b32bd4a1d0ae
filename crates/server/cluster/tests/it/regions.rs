//! A worker: regions of a store over HTTP.

use super::common;

use common::service::http::{Request, Response};
use common::service::{Running, truth};
use common::{GATEWAY, MAP, PublishedMap, eventually};
use tokio::task::block_in_place;
use veiloc_map::regions::ObjectId;

fn ask(worker: &Running, map: &str, region: &str, query: &[u8]) -> Response {
    let request = Request::post(&format!("/v1/maps/{map}/regions/{region}/localize"), query);
    let request = request.header("content-type", "application/x-protobuf").token(GATEWAY);
    block_in_place(|| request.send(worker.address))
}

fn metric(worker: &Running, series: &str) -> f64 {
    block_in_place(|| worker.metric(series)).expect("it is counted")
}

fn reads(worker: &Running, from: &str) -> f64 {
    metric(worker, &format!("veiloc_region_reads_total{{from=\"{from}\"}}"))
}

#[tokio::test(flavor = "multi_thread")]
async fn only_published_regions_are_served_and_only_with_a_token() {
    let published = PublishedMap::new(4);
    let (worker, query) = (published.worker("worker"), published.query(&truth()));
    let region = published.region(0).to_string();
    assert_eq!(ask(&worker, MAP, &region, &query).status, 200);
    let unknown = ObjectId::of(b"another").to_string();
    let index = published.manifest().index.sha256.to_string();
    for (map, region) in
        [("other", &*region), (MAP, &unknown), (MAP, &index), (MAP, "0"), (MAP, "%2e%2e"), ("%00", &region)]
    {
        let answer = ask(&worker, map, region, &query);
        assert_eq!((answer.status, &*answer.problem()), (404, "unknown-map"), "{map} {region}");
    }
    let path = format!("/v1/maps/{MAP}/regions/{region}/localize");
    let without = Request::post(&path, &query).header("content-type", "application/x-protobuf");
    assert_eq!(block_in_place(|| without.send(worker.address)).status, 401);
    // A worker serves no whole map.
    let request = Request::post(&format!("/v1/maps/{MAP}/localize"), &query).token(GATEWAY);
    assert_eq!(block_in_place(|| request.send(worker.address)).problem(), "unknown-map");
    assert_eq!(block_in_place(|| worker.get("/readyz", "")).status, 200);
    assert_eq!((reads(&worker, "store"), metric(&worker, "veiloc_regions_open")), (1.0, 1.0));
}

/// The cache has room for one region: the other is closed, and read from the store again.
#[tokio::test(flavor = "multi_thread")]
async fn least_recently_used_region_goes() {
    let published = PublishedMap::new(4);
    let largest = published.manifest().regions.iter().map(|region| region.bytes).max().expect("regions");
    let options = published.worker_options("small", largest);
    let worker = block_in_place(|| Running::start(options));
    let query = published.query(&truth());
    for (number, read) in [(0, 1.0), (0, 1.0), (1, 2.0), (0, 3.0), (0, 3.0)] {
        let answer = ask(&worker, MAP, &published.region(number).to_string(), &query);
        assert!([200, 422].contains(&answer.status), "{answer:?}");
        assert_eq!((reads(&worker, "store"), metric(&worker, "veiloc_regions_open")), (read, 1.0));
    }
    let files = std::fs::read_dir(published.path("small").join("objects")).expect("a cache");
    let bytes: u64 = files.map(|file| file.expect("a file").metadata().expect("metadata").len()).sum();
    assert!(bytes <= largest, "{bytes} of {largest}");
}

/// A damaged object is not used and costs only its region; when it is mended, it is served.
#[tokio::test(flavor = "multi_thread")]
async fn damaged_object_costs_only_its_region() {
    let published = PublishedMap::new(4);
    let good = std::fs::read(published.object(1)).expect("an object");
    let mut bad = good.clone();
    bad[good.len() / 2] ^= 1;
    std::fs::write(published.object(1), &bad).expect("written");
    let (worker, query) = (published.worker("worker"), published.query(&truth()));
    let status = |number: usize| ask(&worker, MAP, &published.region(number).to_string(), &query).status;
    assert_eq!((status(0), status(1), status(0)), (200, 503, 200));
    assert!(metric(&worker, "veiloc_region_failures_total") >= 1.0);
    std::fs::write(published.object(1), &good).expect("mended");
    eventually("the mended region", || [200, 422].contains(&status(1))).await;
}

/// While the store is away, a worker serves what it has, also after a restart; a region that it does not have is
/// unavailable, not unknown.
#[tokio::test(flavor = "multi_thread")]
async fn worker_lives_from_its_cache_while_the_store_is_away() {
    let published = PublishedMap::new(4);
    let (worker, query) = (published.worker("worker"), published.query(&truth()));
    let status = |worker: &Running, number: usize| {
        ask(worker, MAP, &published.region(number).to_string(), &query).status
    };
    assert_eq!(status(&worker, 0), 200);
    let away = published.path("away");
    std::fs::rename(published.store(), &away).expect("renamed");
    let failures = || metric(&worker, "veiloc_region_failures_total");
    eventually("failed reads of the manifest", || failures() >= 2.0).await;
    assert_eq!((status(&worker, 0), status(&worker, 1)), (200, 503));
    block_in_place(|| worker.stop());
    let again = published.worker("worker");
    assert_eq!((status(&again, 0), status(&again, 1)), (200, 503));
    assert_eq!((reads(&again, "cache"), reads(&again, "store")), (1.0, 0.0));
    std::fs::rename(&away, published.store()).expect("back");
    eventually("the store", || [200, 422].contains(&status(&again, 1))).await;
}

/// Regions of the manifest before the last are still served, those of a withdrawn map are not.
#[tokio::test(flavor = "multi_thread")]
async fn worker_follows_what_is_published() {
    let published = PublishedMap::new(4);
    let (worker, query) = (published.worker("worker"), published.query(&truth()));
    let status = |region: ObjectId| ask(&worker, MAP, &region.to_string(), &query).status;
    let first = published.region(0);
    assert_eq!(status(first), 200);
    published.publish(9, 4);
    // Its successor is opened before anyone asks for it.
    eventually("the successor", || reads(&worker, "store") == 2.0).await;
    assert_eq!((status(published.region(0)), reads(&worker, "store")), (200, 2.0));
    assert_eq!(status(first), 200);
    published.publish(8, 4);
    eventually("the end of the first", || status(first) == 404).await;
    std::fs::remove_file(published.store().join(format!("{MAP}.json"))).expect("withdrawn");
    eventually("the end of the map", || status(published.region(0)) == 404).await;
    assert_eq!(metric(&worker, "veiloc_regions_open"), 0.0);
}
