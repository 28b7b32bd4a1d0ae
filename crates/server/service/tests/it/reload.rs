//! Replacing maps, tokens and certificates while the server runs.

use super::common;

use std::cell::Cell;
use std::fs;
use std::io::Write as _;
use std::num::NonZeroUsize;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, SystemTime};

use common::gate::{Gate, wait_until_load};
use common::http::{Request, Response, connect};
use common::{Files, OPERATOR, PHONE, Running, eventually, tokens_file, truth};

fn images(server: &Running) -> u64 {
    server.get("/v1/maps", OPERATOR).json()["maps"][0]["images"].as_u64().expect("a number")
}

/// Replaces the map repeatedly while clients send queries: every query gets its pose.
#[test]
fn map_is_replaced_without_dropping_requests() {
    let files = Files::new();
    let mut options = files.options();
    options.watch = Some(Duration::from_millis(10));
    let server = Running::start(options);
    let query = files.scene.sealed(&truth());
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
            veiloc_map::write(&files.scene.map(count), &files.path("place.vmap")).expect("written");
            eventually("the new map", || images(&server) == u64::from(count));
        }
        let before = answered.load(Ordering::Relaxed);
        eventually("answers with the last map", || answered.load(Ordering::Relaxed) > before + 3);
        done.store(true, Ordering::Relaxed);
    });
    let text = server.get("/metrics", OPERATOR).text();
    assert!(text.contains("veiloc_reloads_total{file=\"map\",map=\"place\",result=\"taken\"}"), "{text}");
    assert!(
        text.contains("veiloc_reloads_total{file=\"map\",map=\"place\",result=\"refused\"} 0\n"),
        "{text}"
    );
}

#[test]
fn broken_map_is_refused_and_the_old_one_stays() {
    let files = Files::new();
    let mut options = files.options();
    options.watch = Some(Duration::from_millis(10));
    let server = Running::start(options);
    let query = files.scene.sealed(&truth());
    let map = fs::read(files.path("place.vmap")).expect("the map");
    let failing = || {
        server
            .get("/metrics", OPERATOR)
            .text()
            .contains("veiloc_reload_failing{file=\"map\",map=\"place\"} 1")
    };
    let replace = |bytes: &[u8]| {
        fs::write(files.path("new"), bytes).expect("written");
        fs::rename(files.path("new"), files.path("place.vmap")).expect("renamed");
    };
    let mut flipped = map.clone();
    flipped[map.len() / 2] ^= 1;
    for broken in [&map[..map.len() / 2], &flipped, b"", b"no map at all"] {
        replace(broken);
        eventually("a refusal", failing);
        assert_eq!(images(&server), 6, "the old map stays");
        assert_eq!(server.localize(&query, PHONE).status, 200, "and answers");
        replace(&map);
        eventually("the map", || !failing());
    }
    // The same when the file is missing.
    fs::remove_file(files.path("place.vmap")).expect("removed");
    eventually("a refusal", failing);
    assert_eq!(server.localize(&query, PHONE).status, 200);
    assert_eq!(server.get("/readyz", "").status, 200);
    veiloc_map::write(&files.scene.map(4), &files.path("place.vmap")).expect("written");
    eventually("the new map", || images(&server) == 4);
    assert_eq!(server.localize(&query, PHONE).status, 200);
}

/// A pipe under the name of a map or of the tokens is refused at once: opening it would wait for a writer for ever, and
/// no file would be exchanged any more.
#[cfg(unix)]
#[test]
fn pipes_do_not_stop_the_watchers() {
    let files = Files::new();
    let mut options = files.options();
    options.watch = Some(Duration::from_millis(10));
    let server = Running::start(options);
    let failing = |file: &str| {
        server.get("/metrics", OPERATOR).text().contains(&format!("veiloc_reload_failing{{{file}}} 1"))
    };
    let tokens = fs::read(files.path("tokens")).expect("the tokens");
    for (name, labels) in [("place.vmap", r#"file="map",map="place""#), ("tokens", r#"file="tokens",map="""#)]
    {
        let made = std::process::Command::new("mkfifo").arg(files.path("pipe")).status().expect("mkfifo");
        assert!(made.success());
        fs::rename(files.path("pipe"), files.path(name)).expect("renamed");
        eventually("a refusal", || failing(labels));
        assert_eq!(images(&server), 6, "the old map stays");
    }
    fs::remove_file(files.path("tokens")).expect("removed");
    fs::write(files.path("tokens"), tokens).expect("written");
    veiloc_map::write(&files.scene.map(4), &files.path("new")).expect("written");
    fs::rename(files.path("new"), files.path("place.vmap")).expect("renamed");
    eventually("the new map", || images(&server) == 4);
    for files in ["maps", "credentials"] {
        let checked = server.metric(&format!("veiloc_files_checked_timestamp_seconds{{files=\"{files}\"}}"));
        let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).expect("a time").as_secs_f64();
        assert!(checked.is_some_and(|at| at > 0.0 && at <= now), "{files}: {checked:?}");
    }
}

/// A map with another vocabulary: old queries are refused with `wrong-profile`, new ones get their pose.
#[test]
fn clients_learn_of_a_new_profile() {
    let files = Files::new();
    let server = Running::start(files.open_options());
    let old = files.scene.sealed(&truth());
    let etag = |server: &Running| server.get("/v1/maps/place/profile", "").header("etag").map(str::to_owned);
    let before = etag(&server);
    let other = common::TestScene::new(2);
    veiloc_map::write(&other.map(6), &files.path("place.vmap")).expect("written");
    server.handle.reload();
    assert_ne!(etag(&server), before);
    assert_eq!(server.localize(&old, "").problem(), "wrong-profile");
    assert_eq!(server.localize(&other.sealed(&truth()), "").status, 200);
}

#[test]
fn token_is_revoked_at_run_time() {
    let files = Files::new();
    let mut options = files.options();
    options.watch = Some(Duration::from_millis(10));
    let server = Running::start(options);
    assert_eq!(server.get("/v1/maps", PHONE).status, 200);
    let failing = || {
        server.get("/metrics", OPERATOR).text().contains("veiloc_reload_failing{file=\"tokens\",map=\"\"} 1")
    };
    for broken in ["not a line of tokens", ""] {
        fs::write(files.path("tokens"), broken).expect("written");
        eventually("a refusal", failing);
        assert_eq!(server.get("/v1/maps", PHONE).status, 200, "an invalid file revokes nothing yet");
        let good = tokens_file(&[(PHONE, ""), (OPERATOR, "operator")]);
        fs::write(files.path("tokens"), good).expect("written");
        eventually("the tokens", || !failing());
    }
    fs::write(files.path("tokens"), tokens_file(&[(OPERATOR, "operator"), ("new", "")])).expect("written");
    eventually("the new token", || server.get("/v1/maps", "new").status == 200);
    assert_eq!(server.get("/v1/maps", PHONE).problem(), "unauthenticated");
}

/// After the configured time, the last valid tokens are no longer in force; a valid file ends this state.
#[test]
fn stale_tokens_expire() {
    let files = Files::new();
    let mut options = files.options();
    options.watch = Some(Duration::from_millis(10));
    options.tokens_max_stale = Duration::ZERO;
    let server = Running::start(options);
    let admin = server.listening.admin.expect("a listener");
    assert_eq!(server.get("/v1/maps", PHONE).status, 200);
    fs::remove_file(files.path("tokens")).expect("removed");
    eventually("the end of stale tokens", || server.get("/v1/maps", PHONE).status == 503);
    assert_eq!(server.get("/v1/maps", PHONE).problem(), "no-tokens");
    assert_eq!((server.get("/readyz", "").status, server.get("/healthz", "").status), (503, 200));
    let text = Request::get("/metrics").send(admin).text();
    assert!(text.contains("veiloc_reload_failing{file=\"tokens\",map=\"\"} 1"), "{text}");
    fs::write(files.path("tokens"), tokens_file(&[(PHONE, "")])).expect("written");
    eventually("valid tokens", || server.get("/v1/maps", PHONE).status == 200);
    assert_eq!(server.get("/readyz", "").status, 200);
}

/// Revocation works under load: with all workers busy and a full queue, the token is refused.
#[test]
fn token_is_revoked_under_load() {
    let files = Files::new();
    let mut options = files.options();
    options.watch = Some(Duration::from_millis(10));
    (options.threads, options.queue) = (NonZeroUsize::MIN, NonZeroUsize::MIN.saturating_add(1));
    let gate = Gate::install(&mut options);
    let server = Running::start(options);
    let query = files.scene.sealed(&truth());
    let ask = |busy: u32, queued: u32| {
        let mut stream = connect(server.address);
        stream.write_all(&Request::localize(&query).token(OPERATOR).bytes()).expect("written");
        wait_until_load(&server, busy, queued);
        stream
    };
    let streams = [ask(1, 0), ask(1, 1)];
    assert_eq!(server.localize(&query, OPERATOR).problem(), "queue-full");
    assert_eq!(server.get("/v1/maps", PHONE).status, 200);
    fs::write(files.path("tokens"), tokens_file(&[(OPERATOR, "operator")])).expect("written");
    eventually("the refusal", || server.get("/v1/maps", PHONE).status == 401);
    wait_until_load(&server, 1, 1);
    gate.open();
    for mut stream in streams {
        assert_eq!(Response::read(&mut stream).status, 200);
    }
}

/// `cp new.vmap live.vmap`, a truncated file, and an overwritten file of equal length: queries are answered all the
/// time, and a valid file is loaded.
#[test]
fn overwriting_a_served_map_is_safe() {
    let files = Files::new();
    let mut options = files.options();
    options.watch = Some(Duration::from_millis(10));
    let server = Running::start(options);
    let query = files.scene.sealed(&truth());
    let path = files.path("place.vmap");
    let live = fs::read(&path).expect("the map");
    veiloc_map::write(&files.scene.map(4), &files.path("new.vmap")).expect("written");
    let new = fs::read(files.path("new.vmap")).expect("the map");
    let answers = || {
        for _ in 0..3 {
            assert_eq!(server.localize(&query, PHONE).status, 200);
        }
    };
    // File times have a coarse resolution, and a fast machine writes twice within one tick.
    let hours = Cell::new(0);
    let in_place = |bytes: &[u8]| {
        let mut file = fs::File::options().write(true).open(&path).expect("the live file");
        file.write_all(bytes).expect("written");
        file.set_len(bytes.len() as u64).expect("cut");
        hours.set(hours.get() + 1);
        file.set_modified(SystemTime::now() + hours.get() * common::HOUR).expect("a time of its own");
    };
    // As `cp` does: the same file, truncated and written again.
    fs::write(&path, &new).expect("written");
    eventually("the new map", || images(&server) == 4);
    answers();
    in_place(&new[..new.len() / 3]);
    let failing = || {
        server
            .get("/metrics", OPERATOR)
            .text()
            .contains("veiloc_reload_failing{file=\"map\",map=\"place\"} 1")
    };
    eventually("a refusal", failing);
    assert_eq!(images(&server), 4);
    answers();
    in_place(&live);
    eventually("the old map", || images(&server) == 6 && !failing());
    in_place(&vec![0x5A; live.len()]);
    eventually("a refusal", failing);
    assert_eq!(images(&server), 6);
    answers();
    in_place(&live);
    eventually("the map", || !failing());
    answers();
}

/// One broken map of several: the others are served, and each has its own readiness.
#[test]
fn one_broken_map_does_not_stop_the_others() {
    let files = Files::new();
    let mut options = files.open_options();
    fs::write(files.path("broken.vmap"), "no map").expect("written");
    options
        .maps
        .push(veiloc_service::MapSource { name: "broken".to_owned(), path: files.path("broken.vmap") });
    options.watch = Some(Duration::from_millis(10));
    let server = Running::start(options);
    let admin = server.listening.admin.expect("a listener");
    assert_eq!(server.listening.maps, ["place"]);
    let query = files.scene.sealed(&truth());
    assert_eq!(server.localize(&query, "").status, 200);
    let broken =
        Request::post("/v1/maps/broken/localize", &query).header("content-type", "application/x-protobuf");
    assert_eq!(broken.send(server.address).problem(), "map-unavailable");
    assert_eq!(server.get("/v1/maps/broken/profile", "").problem(), "map-unavailable");
    assert_eq!(server.get("/readyz", "").text(), "ready, but not every map\n");
    assert_eq!(Request::get("/readyz").send(admin).text(), "ready\nnot served: broken\n");
    let status = |name: &str| Request::get(&format!("/readyz/{name}")).send(admin).status;
    assert_eq!((status("place"), status("broken"), status("none")), (200, 503, 404));
    veiloc_map::write(&files.scene.map(4), &files.path("broken.vmap")).expect("written");
    eventually("the second map", || status("broken") == 200);
    assert_eq!(Request::get("/readyz").send(admin).text(), "ready\n");
}

/// Maps of the folder are added and removed with their files.
#[test]
fn maps_folder_is_followed() {
    let files = Files::new();
    let folder = files.path("maps");
    fs::create_dir(&folder).expect("a folder");
    let mut options = files.open_options();
    options.maps.clear();
    options.maps_folder = Some(folder.clone());
    options.watch = Some(Duration::from_millis(10));
    let server = Running::start(options);
    let names = || -> Vec<String> {
        let maps = server.get("/v1/maps", "").json()["maps"].as_array().expect("a list").clone();
        maps.iter().map(|map| map["name"].as_str().expect("a name").to_owned()).collect()
    };
    assert_eq!((names().len(), server.get("/readyz", "").text()), (0, "no map\n".to_owned()));
    for file in ["lobby.vmap", "garage.vmap", "a b.vmap", ".hidden.vmap", "notes.txt"] {
        fs::copy(files.path("place.vmap"), folder.join(file)).expect("copied");
    }
    eventually("both maps", || names().len() == 2);
    let mut found = names();
    found.sort();
    assert_eq!(found, ["garage", "lobby"]);
    assert_eq!(server.get("/readyz", "").status, 200);
    let query = files.scene.sealed(&truth());
    let at = |name: &str| {
        let path = format!("/v1/maps/{name}/localize");
        Request::post(&path, &query)
            .header("content-type", "application/x-protobuf")
            .send(server.address)
            .status
    };
    assert_eq!((at("lobby"), at("garage")), (200, 200));
    fs::remove_file(folder.join("garage.vmap")).expect("removed");
    eventually("the end of a map", || names() == ["lobby"]);
    assert_eq!((at("lobby"), at("garage")), (200, 404));
}
