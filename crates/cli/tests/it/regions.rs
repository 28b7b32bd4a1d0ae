//! `veiloc map split`, `publish` and `fetch`: regions give the same answers as the whole map, and survive storage
//! unchanged.

use super::common;

use std::fs;

use common::{MAP_VIEWS, POSITION_TOLERANCE, pose, scene};
use serde_json::Value;

fn text(value: &Value) -> String {
    value.as_str().expect("text").to_owned()
}

#[test]
fn regions_localize_queries_of_the_whole_map() {
    let scene = scene();
    let whole = scene.run("map info place.vmap --json").succeeded().json();
    let split =
        scene.run("map split place.vmap --images 6 --overlap 0.34 --out regions --json").succeeded().json();
    assert_eq!((&split["map"], &split["profile"]), (&Value::from("place"), &whole["profile"]));
    assert_eq!((&split["images"], &split["map_bytes"]), (&whole["images"], &whole["bytes"]));
    let regions = split["regions"].as_array().expect("regions");
    let sum = |field: &str| regions.iter().map(|r| r[field].as_u64().expect("a number")).sum::<u64>();
    assert!(
        regions.len() > 1 && sum("core_images") == MAP_VIEWS as u64 && sum("images") > sum("core_images"),
        "{split}"
    );
    // Each is a map with the profile and the self-test of the whole map.
    let file = |region: &Value| format!("regions/objects/{}", text(&region["sha256"]));
    for region in regions {
        let info = scene.run(&format!("map info {} --json", file(region))).succeeded().json();
        for field in ["bytes", "images", "points"] {
            assert_eq!(info[field], region[field], "{field}");
        }
        assert_eq!((&info["profile"], &info["self_test"]), (&whole["profile"], &whole["self_test"]));
        assert_eq!(info["region"]["core_images"], region["core_images"]);
        assert_eq!(info["region"]["map_images"], whole["images"]);
    }
    let printed = scene.run(&format!("map info {}", file(&regions[0]))).succeeded();
    assert!(printed.stdout.contains("images of the 10 of the whole map"), "{printed}");
    assert!(printed.stdout.contains("of the whole map, whose calibration"), "{printed}");
    for query in ["query-0.png", "query-1.png", "query-2.png"] {
        let sealed = format!("regions-{query}.vquery");
        scene.seal(query, "dcl", &sealed);
        let trusted = regions.iter().filter(|region| {
            let answer = scene.run(&format!("localize --map {} --json {sealed}", file(region))).json();
            let found = &answer["queries"][0];
            if found["state"] != "trusted" {
                return false;
            }
            let error = scene.position_error(query, &pose(&found["cam_from_world"]));
            assert!(error < POSITION_TOLERANCE, "{query}: {error}");
            true
        });
        assert!(trusted.count() > 0, "{query} is trusted in no region");
    }
    // A region cannot be changed or split again.
    for (command, expected) in [
        (format!("map compress {} -o again.vmap", file(&regions[0])), "a region of a larger"),
        (format!("map remove {} map-00.png -o again.vmap", file(&regions[0])), "a region of a larger"),
        (format!("map split {} --out again", file(&regions[0])), "cut the whole map"),
        ("map split place.vmap --out again --overlap 2".to_owned(), "from 0 to 0.9"),
        ("map split place.vmap --out again --name a/b".to_owned(), "not a valid map name"),
    ] {
        let refused = scene.run(&command);
        assert!(refused.code == Some(1) && refused.stderr.contains(expected), "{refused}");
    }
    assert!(!scene.path("again.vmap").exists());
    assert_eq!(scene.run("map split place.vmap --out again --images 0").code, Some(2));
}

#[test]
fn published_regions_are_fetched_and_damage_is_detected() {
    let scene = scene();
    let split =
        scene.run("map split place.vmap --images 6 --out shop-regions --name hall --json").succeeded().json();
    let objects = split["regions"].as_array().expect("regions").len() + 2;
    let published = scene.run("map publish shop-regions shop --json").succeeded().json();
    assert_eq!((&published["manifest"], &published["map"]), (&split["manifest"], &Value::from("hall")));
    assert_eq!(
        (published["objects_sent"].as_u64(), &published["bytes_sent"]),
        (Some(objects as u64), &split["bytes"])
    );
    let again = scene.run("map publish shop-regions shop").succeeded();
    assert!(again.stdout.contains("sent        0 objects"), "{again}");
    let url = url_of(&scene.path("shop"));
    let fetched = scene.run(&format!("map fetch {url} hall --out back --json")).succeeded().json();
    assert_eq!((&fetched["manifest"], &fetched["bytes_fetched"]), (&split["manifest"], &split["bytes"]));
    assert_eq!(scene.read("back/manifest.json"), scene.read("shop-regions/manifest.json"));
    let by_id = format!("map fetch shop hall --out back --manifest {}", text(&split["manifest"]));
    assert!(scene.run(&by_id).succeeded().stdout.contains("fetched     0 objects"));

    // Corrupted storage: the error names the object, and the folder stays unchanged.
    let region = text(&split["regions"][0]["sha256"]);
    let path = scene.path(format!("shop/objects/{region}"));
    let mut bytes = fs::read(&path).expect("bytes");
    bytes[1000] ^= 1;
    fs::write(&path, bytes).expect("damaged");
    let refused = scene.run("map fetch shop hall --out elsewhere");
    assert!(refused.code == Some(1) && refused.stderr.contains(&region), "{refused}");
    assert!(!scene.path("elsewhere/manifest.json").exists());
    for (command, expected) in [
        ("map fetch shop kitchen --out elsewhere", "veiloc map publish"),
        ("map fetch nowhere hall --out elsewhere", "nowhere"),
        ("map publish no-such-folder shop", "veiloc map split"),
        ("map publish shop-regions ftp://example.com", "s3://BUCKET"),
        ("map publish shop-regions s3://key:secret@bucket", "environment"),
    ] {
        let refused = scene.run(command);
        assert!(refused.code == Some(1) && refused.stderr.contains(expected), "{refused}");
    }
}

/// A full disk, simulated by a file size limit: an incomplete file is no object.
#[cfg(unix)]
#[test]
fn full_disk_is_reported_and_leaves_no_object() {
    let scene = scene();
    let split = scene.run("map split place.vmap --images 6 --out full-regions --json").succeeded().json();
    scene.run("map publish full-regions full").succeeded();
    let regions = split["regions"].as_array().expect("regions");
    let largest = regions.iter().max_by_key(|region| region["bytes"].as_u64()).expect("some");
    let (name, bytes) = (text(&largest["sha256"]), largest["bytes"].as_u64().expect("a length"));
    for lost in [1, 20_000] {
        let fetch = scene.command("map fetch full place --out half");
        let mut limited = std::process::Command::new("sh");
        let limit = format!("trap '' XFSZ; ulimit -f {}; exec \"$0\" \"$@\"", (bytes - lost) / 512);
        limited.args(["-c", &limit]).arg(fetch.get_program()).args(fetch.get_args());
        limited.current_dir(fetch.get_current_dir().expect("the place's"));
        let refused = limited.output().expect("the binary runs");
        let printed = String::from_utf8_lossy(&refused.stderr);
        assert!(
            refused.status.code() == Some(3) && printed.contains(".partial: "),
            "{lost}: {:?} {printed}",
            refused.status
        );
        let left: Vec<_> = fs::read_dir(scene.path("half/objects")).expect("a folder").collect();
        assert!(
            left.iter().flatten().all(|entry| !entry.file_name().to_string_lossy().contains(&name)),
            "{left:?}"
        );
    }
    scene.run("map fetch full place --out half").succeeded();
    let object = format!("objects/{name}");
    assert_eq!(scene.read(&format!("half/{object}")), scene.read(&format!("full/{object}")));
}

fn url_of(path: &std::path::Path) -> String {
    format!("file://{}", path.canonicalize().expect("a folder").display())
}
