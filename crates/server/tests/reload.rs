//! Exchanging maps, tokens and certificates under a running server.

mod common;

use std::fs;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;

use common::{Files, OPERATOR, PHONE, Running, eventually, tokens_file, truth};

fn images(server: &Running) -> u64 {
    server.get("/v1/maps", OPERATOR).json()["maps"][0]["images"].as_u64().expect("a number")
}

/// Replaces the map again and again while clients ask all the time: every one of them gets its pose.
#[test]
fn a_map_is_exchanged_without_dropping_a_request() {
    let files = Files::new();
    let mut options = files.options();
    options.watch = Some(Duration::from_millis(10));
    let server = Running::start(options);
    let query = files.place.sealed(&truth());
    let (done, answered) = (AtomicBool::new(false), AtomicUsize::new(0));
    std::thread::scope(|scope| {
        for _ in 0..3 {
            scope.spawn(|| {
                while !done.load(Ordering::Relaxed) {
                    let response = server.localize(&query, PHONE);
                    assert_eq!(response.status, 200, "{response:?}");
                    answered.fetch_add(1, Ordering::Relaxed);
                }
            });
        }
        for round in 0..8 {
            let count = 4 + round % 3;
            veiloc_map::write(&files.place.map(count), &files.path("place.vmap")).expect("written");
            eventually("the new map", || images(&server) == u64::from(count));
        }
        let before = answered.load(Ordering::Relaxed);
        eventually("answers with the last map", || answered.load(Ordering::Relaxed) > before + 3);
        done.store(true, Ordering::Relaxed);
    });
    let text = server.get("/metrics", OPERATOR).text();
    assert!(text.contains("veiloc_reloads_total{file=\"map\",map=\"place\",result=\"taken\"}"), "{text}");
    assert!(!text.contains("refused"), "{text}");
}

#[test]
fn a_broken_map_is_refused_and_the_old_one_stays() {
    let files = Files::new();
    let mut options = files.options();
    options.watch = Some(Duration::from_millis(10));
    let server = Running::start(options);
    let query = files.place.sealed(&truth());
    let map = fs::read(files.path("place.vmap")).expect("the map");
    let refused = |n: usize| {
        let line = format!("veiloc_reloads_total{{file=\"map\",map=\"place\",result=\"refused\"}} {n}");
        server.get("/metrics", OPERATOR).text().contains(&line)
    };
    let replace = |bytes: &[u8]| {
        fs::write(files.path("new"), bytes).expect("written");
        fs::rename(files.path("new"), files.path("place.vmap")).expect("renamed");
    };
    let mut flipped = map.clone();
    flipped[map.len() / 2] ^= 1;
    for (i, broken) in [&map[..map.len() / 2], &flipped, b"", b"no map at all"].into_iter().enumerate() {
        replace(broken);
        eventually("a refusal", || refused(i + 1));
        assert_eq!(images(&server), 6, "the old map stays");
        assert_eq!(server.localize(&query, PHONE).status, 200, "and answers");
    }
    // A file that is gone changes nothing either, and is no refusal: it may be back at once.
    fs::remove_file(files.path("place.vmap")).expect("removed");
    std::thread::sleep(Duration::from_millis(50));
    assert_eq!(server.localize(&query, PHONE).status, 200);
    assert!(refused(4));
    veiloc_map::write(&files.place.map(4), &files.path("place.vmap")).expect("written");
    eventually("the new map", || images(&server) == 4);
    assert_eq!(server.localize(&query, PHONE).status, 200);
}

/// A map with another vocabulary: old queries are told to fetch the profile, new ones get their pose.
#[test]
fn another_profile_is_told_to_clients() {
    let files = Files::new();
    let server = Running::start(files.open_options());
    let old = files.place.sealed(&truth());
    let etag = |server: &Running| server.get("/v1/maps/place/profile", "").header("etag").map(str::to_owned);
    let before = etag(&server);
    let other = common::Place::new(2);
    veiloc_map::write(&other.map(6), &files.path("place.vmap")).expect("written");
    server.handle.reload();
    assert_ne!(etag(&server), before);
    assert_eq!(server.localize(&old, "").problem(), "wrong-profile");
    assert_eq!(server.localize(&other.sealed(&truth()), "").status, 200);
}

#[test]
fn a_token_is_withdrawn_while_the_service_runs() {
    let files = Files::new();
    let mut options = files.options();
    options.watch = Some(Duration::from_millis(10));
    let server = Running::start(options);
    assert_eq!(server.get("/v1/maps", PHONE).status, 200);
    fs::write(files.path("tokens"), "not a line of tokens").expect("written");
    eventually("a refusal", || server.get("/metrics", OPERATOR).text().contains("file=\"tokens\""));
    assert_eq!(server.get("/v1/maps", PHONE).status, 200, "a broken file withdraws nothing");
    fs::write(files.path("tokens"), tokens_file(&[(OPERATOR, "operator"), ("new", "")])).expect("written");
    eventually("the new token", || server.get("/v1/maps", "new").status == 200);
    assert_eq!(server.get("/v1/maps", PHONE).problem(), "unauthenticated");
}
