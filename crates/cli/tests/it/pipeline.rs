//! The whole pipeline, run through the binary: map, profile, seal, localize, evaluate.

use super::common;

use common::{CAMERA, MAP_VIEWS, QUERIES, TestScene, keys, pose, scene};
use serde_json::{Value, json};
use veiloc_geometry::CameraFromWorld;
use veiloc_protocol::SealedQuery;

/// Rotation (degrees) and translation (map units) between the pose of a document and the true one.
fn pose_error(document: &Value, truth: &CameraFromWorld) -> (f64, f64) {
    let pose = pose(document);
    (pose.rotation_error_degrees(truth), pose.translation_error(truth))
}

/// One word per query, for a command line.
fn each_query(word: impl Fn(usize) -> String) -> String {
    (0..QUERIES).map(word).collect::<Vec<_>>().join(" ")
}

/// Seals all queries of the scene, localizes them in one call, and checks the document.
fn localize_all(scene: &TestScene, map: &str, scheme: &str, folder: &str, bound: (f64, f64)) {
    let images = each_query(|i| format!("images/query-{i}.png"));
    let scheme_words = if scheme.is_empty() { String::new() } else { format!("--scheme {scheme}") };
    scene
        .run(&format!("seal {images} --camera {CAMERA} --profile place.vprofile {scheme_words} -o {folder}"))
        .succeeded();
    let sealed = each_query(|i| format!("{folder}/query-{i}.vquery"));
    let run = scene.run(&format!("localize --map {map} --json {sealed}")).succeeded();
    let document = run.json();
    assert_eq!(document["version"], 1);
    assert_eq!(document["map"], map);
    let counts = ["trusted", "doubtful", "not_found", "failed"].map(|state| document[state].as_u64());
    assert_eq!(counts[0].zip(counts[1]).map(|(a, b)| a + b), Some(QUERIES as u64), "{run}");
    assert_eq!(counts[2..], [Some(0), Some(0)]);
    let queries = document["queries"].as_array().expect("an array");
    assert_eq!(queries.len(), QUERIES);
    for (i, query) in queries.iter().enumerate() {
        assert_eq!(
            keys(query),
            [
                "cam_from_world",
                "center",
                "center_covariance",
                "confidence",
                "covariance",
                "doubts",
                "down",
                "file",
                "focal_scale",
                "hypotheses",
                "inliers",
                "matches",
                "metres_per_unit",
                "ms",
                "noise_px",
                "position_sd",
                "principal_shift_px",
                "rotation_sd_deg",
                "sd_includes",
                "state",
                "version"
            ],
            "{run}"
        );
        assert_eq!(query["file"], format!("{folder}/query-{i}.vquery"));
        assert_eq!(keys(&query["ms"]), ["match", "pose", "queue", "retrieve"]);
        let covariance = query["covariance"].as_array().expect("rows");
        for (axis, row) in covariance.iter().enumerate() {
            assert_eq!(row.as_array().map(Vec::len), Some(6));
            assert!(row[axis].as_f64().is_some_and(|v| v > 0.0), "variance of axis {axis}: {run}");
        }
        let (inliers, matches) = (&query["inliers"], &query["matches"]);
        assert!(inliers.as_u64().is_some_and(|n| n >= 6 && n <= matches.as_u64().unwrap_or(0)), "{run}");
        let truth = scene.pose_of(&format!("query-{i}.png"));
        let (degrees, metres) = pose_error(&query["cam_from_world"], &truth);
        assert!(degrees <= bound.0 && metres <= bound.1, "{degrees} deg, {metres} m under {scheme:?}: {run}");
        let center: Vec<f64> = serde_json::from_value(query["center"].clone()).expect("three numbers");
        let true_center = truth.center().coords;
        let away = (0..3).map(|k| (center[k] - true_center[k]).powi(2)).sum::<f64>().sqrt();
        assert!((away - metres).abs() < 1e-6, "centre error {away}, pose error {metres}");
    }
}

#[test]
fn points_localize() {
    localize_all(scene(), "place.vmap", "points", "sealed-points", (0.5, 0.03));
}

#[test]
fn random_lines_localize() {
    localize_all(scene(), "place.vmap", "random-lines", "sealed-random", (1.0, 0.06));
}

#[test]
fn dcl_localizes_for_any_border() {
    for (scheme, folder) in [
        ("", "sealed-default"),
        ("dcl", "sealed-dcl"),
        ("dcl:horizontal", "sealed-horizontal"),
        ("dcl:angle=30", "sealed-30"),
    ] {
        localize_all(scene(), "place.vmap", scheme, folder, (1.0, 0.06));
    }
}

#[test]
fn coordinate_permutation_is_sealed_and_read() {
    let scene = scene();
    scene.seal("query-0.png", "coordinate-permutation", "permuted.vquery");
    let run = scene.run("localize --map place.vmap permuted.vquery --json");
    let document = run.json();
    assert_eq!(document["queries"].as_array().map(Vec::len), Some(1));
    // Half of its coordinates are swapped; the evaluation, not this test, decides whether that localizes.
    let code = match document["queries"][0]["state"].as_str() {
        Some("trusted") => 0,
        Some("doubtful") => 4,
        Some("not-found") => 1,
        other => panic!("{other:?} is no state"),
    };
    assert_eq!(run.code, Some(code), "{run}");
}

#[test]
fn packs_are_written_sealed_with_and_localized() {
    let scene = scene();
    scene.run("map pack place.vmap -o place.vpack").succeeded();
    let seal = format!("seal images/query-0.png --camera {CAMERA} --profile place.vprofile");
    let length = |file: &str| std::fs::metadata(scene.path(file)).expect("a file").len();
    scene.run(&format!("{seal} -o all.vquery")).succeeded();
    for (send, file) in [("", "matched.vquery"), ("--send explained", "explained.vquery")] {
        scene.run(&format!("{seal} --pack place.vpack {send} -o {file}")).succeeded();
        let document = scene.run(&format!("localize --map place.vmap {file} --json")).succeeded().json();
        let (degrees, metres) =
            pose_error(&document["queries"][0]["cam_from_world"], &scene.pose_of("query-0.png"));
        assert!(degrees < 1.0 && metres < 0.06, "{send}: {degrees} deg, {metres} m");
        assert!(length(file) < length("all.vquery"), "{send}");
    }
    assert!(length("matched.vquery") * 8 < length("all.vquery"));
    let bytes = std::fs::read(scene.path("matched.vquery")).expect("a file");
    assert!(SealedQuery::decode(&bytes).expect("a query").descriptors().is_none());

    scene.run(&format!("{seal} --send matches -o no.vquery")).refused(&["--pack FILE"]);
    scene.run(&format!("{seal} --pack place.vpack --send all -o no.vquery")).refused(&["contradicts"]);
    scene.run(&format!("{seal} --pack place.vprofile -o no.vquery")).refused(&["place.vprofile", "map pack"]);
    let mut damaged = std::fs::read(scene.path("place.vpack")).expect("a file");
    let middle = damaged.len() / 2;
    damaged[middle] ^= 4;
    std::fs::write(scene.path("damaged.vpack"), damaged).expect("writable");
    scene.run(&format!("{seal} --pack damaged.vpack -o no.vquery")).refused(&["damaged.vpack", "checksum"]);
    assert!(!scene.path("no.vquery").exists());
}

#[test]
fn the_device_chooses_the_scheme() {
    let scene = scene();
    let message = |scheme: &str, out: &str| scene.seal("query-0.png", scheme, out).stderr;
    assert!(message("", "chosen.vquery").contains("sent as dcl"));
    assert!(message("random-lines", "chosen.vquery").contains("sent as random-lines"));
    let warned = message("points", "chosen.vquery");
    assert!(warned.contains("WARNING") && warned.contains("position of every keypoint is sent"), "{warned}");
    let seal = format!("seal images/query-0.png --camera {CAMERA} --profile place.vprofile");
    let quiet = scene.run(&format!("--quiet {seal} --scheme points -o chosen.vquery")).succeeded();
    assert!(quiet.stderr.contains("WARNING"), "quiet is no reason not to warn: {quiet}");
}

#[test]
fn fewer_keypoints_are_accepted() {
    let scene = scene();
    let seal = format!("seal images/query-0.png --camera {CAMERA} --profile place.vprofile");
    let run = scene.run(&format!("{seal} --max-keypoints 300 -o few.vquery")).succeeded();
    assert!(run.stderr.contains("256 sent as dcl"), "{run}");
    assert_eq!(rows_of(&scene.read("few.vquery")), 256);
    let document = scene.run("localize --map place.vmap few.vquery --json").succeeded().json();
    let (degrees, metres) =
        pose_error(&document["queries"][0]["cam_from_world"], &scene.pose_of("query-0.png"));
    assert!(degrees < 2.0 && metres < 0.2, "{degrees} {metres}");
    let refused = scene.run(&format!("{seal} --max-keypoints 200 -o few.vquery"));
    assert_eq!(refused.code, Some(2), "{refused}");
    assert!(refused.stderr.contains("256..=4096"), "{refused}");
}

#[test]
fn text_output_has_one_line_per_query() {
    let scene = scene();
    scene.seal("query-1.png", "", "table-1.vquery");
    scene.seal("query-2.png", "points", "table-2.vquery");
    let run = scene.run("localize --map place.vmap table-1.vquery table-2.vquery").succeeded();
    let lines: Vec<&str> = run.stdout.lines().collect();
    assert_eq!(lines.len(), 2, "{run}");
    for (line, file) in lines.iter().zip(["table-1.vquery", "table-2.vquery"]) {
        assert!(line.starts_with(&format!("{file}  trusted    at (")), "{run}");
        assert!(line.contains("matches agree"), "{run}");
    }
}

#[test]
fn quiet_prints_only_results() {
    let scene = scene();
    let seal =
        format!("--quiet seal images/query-0.png --camera {CAMERA} --profile place.vprofile -o quiet.vquery");
    let run = scene.run(&seal).succeeded();
    assert_eq!((run.stdout.as_str(), run.stderr.as_str()), ("", ""));
    let run = scene.run("localize --quiet --map place.vmap quiet.vquery").succeeded();
    assert_eq!(run.stderr, "");
    assert_eq!(run.stdout.lines().count(), 1);
}

#[test]
fn sealing_twice_gives_different_queries_of_equal_length() {
    let scene = scene();
    for scheme in ["points", "random-lines", "coordinate-permutation", "dcl"] {
        scene.seal("query-0.png", scheme, "twice-a.vquery");
        scene.seal("query-0.png", scheme, "twice-b.vquery");
        scene.seal("query-1.png", scheme, "twice-c.vquery");
        let [a, b, c] = ["twice-a.vquery", "twice-b.vquery", "twice-c.vquery"].map(|file| scene.read(file));
        assert_ne!(a, b, "{scheme}: sealing must draw from the operating system");
        assert_eq!(a.len(), b.len(), "{scheme}");
        // The number of rows gives the size class, and the length may depend on nothing else.
        let rows = |file: &str| rows_of(&scene.read(file));
        assert_eq!(rows("twice-a.vquery"), rows("twice-c.vquery"), "both images fill the profile's class");
        assert_eq!(a.len(), c.len(), "{scheme}: all messages of a class have one length");
    }
}

fn rows_of(sealed: &[u8]) -> usize {
    SealedQuery::decode(sealed).expect("a sealed query").len()
}

#[test]
fn info_describes_the_map() {
    let scene = scene();
    let run = scene.run("map info place.vmap --json").succeeded();
    let info = run.json();
    assert_eq!(
        keys(&info),
        [
            "accuracy",
            "bytes",
            "bytes_per_point",
            "cameras",
            "compressed",
            "descriptors",
            "down",
            "file",
            "format_version",
            "global",
            "images",
            "is_metric",
            "keypoints",
            "main_camera",
            "mean_reprojection_error_px",
            "mean_track_length",
            "points",
            "profile",
            "region",
            "self_test",
            "version",
            "warnings",
        ]
    );
    assert_eq!(info["version"], 1);
    assert_eq!(info["file"], "place.vmap");
    assert_eq!(info["format_version"], 1);
    assert_eq!(info["images"], MAP_VIEWS);
    assert_eq!(info["cameras"], 1);
    assert_eq!((&info["descriptors"], &info["global"]), (&json!("compact"), &json!("vlad")));
    let bytes = scene.read("place.vmap").len();
    assert_eq!(info["bytes"], bytes);
    let number = |key: &str| info[key].as_f64().unwrap_or_else(|| panic!("{key}: {run}"));
    assert!(number("points") > 200.0, "{run}");
    assert!(number("keypoints") >= number("points"), "{run}");
    assert!(number("mean_track_length") >= 2.0, "{run}");
    assert!(
        number("mean_reprojection_error_px") > 0.0 && number("mean_reprojection_error_px") < 2.0,
        "{run}"
    );
    assert!((number("bytes_per_point") - bytes as f64 / number("points")).abs() < 1e-6, "{run}");

    let text = scene.run("map info place.vmap").succeeded().stdout;
    for word in ["place.vmap", "images", "points", "profile", info["profile"].as_str().expect("an id")] {
        assert!(text.contains(word), "{word}: {text}");
    }
}

#[test]
fn profile_is_small_and_has_the_maps_id() {
    let scene = scene();
    let run = scene.run("map profile place.vmap -o again.vprofile").succeeded();
    assert_eq!(scene.read("again.vprofile"), scene.read("place.vprofile"), "profiles are deterministic");
    let info = scene.run("map info place.vmap --json").succeeded().json();
    assert!(run.stderr.contains(info["profile"].as_str().expect("an id")), "{run}");
    assert!(scene.read("place.vprofile").len() < 64 * 1024);
}

#[test]
fn equal_input_gives_an_equal_map() {
    let scene = scene();
    let build =
        "map build --posed posed --images images --list map.txt --max-keypoints 512 --query-keypoints 512";
    let run = scene.run(&format!("{build} -o equal.vmap --json")).succeeded();
    assert_eq!(run.json()["images"], MAP_VIEWS);
    assert!(scene.read("equal.vmap") == scene.read("place.vmap"), "two builds of the same input differ");
}

#[test]
fn images_are_removed_and_added() {
    let scene = scene();
    let without =
        scene.run("map remove place.vmap map-03.png map-06.png -o less.vmap --json").succeeded().json();
    assert_eq!(without["images"], MAP_VIEWS - 2);
    scene.write("leaving.txt", "map-03.png\nmap-06.png\n");
    let run = scene
        .run("map add less.vmap --posed posed --images images --list leaving.txt -o more.vmap --json")
        .succeeded();
    let with = run.json();
    assert_eq!(with["images"], MAP_VIEWS);
    assert!(with["points"].as_u64() > without["points"].as_u64(), "{run}");
    assert_eq!(with["profile"], without["profile"], "queries sealed before stay valid");
    localize_all(scene, "less.vmap", "points", "sealed-less", (0.5, 0.05));
    localize_all(scene, "more.vmap", "dcl", "sealed-more", (1.0, 0.06));

    // Without --out the map itself is replaced.
    std::fs::copy(scene.path("more.vmap"), scene.path("own.vmap")).expect("copied");
    scene.run("map remove own.vmap map-00.png").succeeded();
    let info = scene.run("map info own.vmap --json").succeeded().json();
    assert_eq!(info["images"], MAP_VIEWS - 1);
}

fn check_evaluation(document: &Value, command: &str, schemes: &[&str], queries: usize) {
    assert_eq!(document["version"], 1);
    assert_eq!(document["command"], command);
    let rows = document["schemes"].as_array().expect("an array");
    assert_eq!(rows.iter().map(|r| r["scheme"].as_str().expect("a name")).collect::<Vec<_>>(), schemes);
    for row in rows {
        for key in [
            "scheme",
            "score",
            "queries",
            "localized",
            "median_rotation_deg",
            "median_translation",
            "recall",
            "median_ms",
        ] {
            assert!(row.get(key).is_some(), "{key} is missing: {row}");
        }
        assert_eq!(row["queries"], queries);
        assert_eq!(row["localized"], queries, "{row}");
        assert_eq!(keys(&row["recall"]), ["0.05/5", "0.1/2"]);
        assert_eq!(row["recall"]["0.1/2"], 1.0, "{row}");
        assert!(row["median_rotation_deg"].as_f64().is_some_and(|v| v < 1.0), "{row}");
        assert!(row["median_translation"].as_f64().is_some_and(|v| v < 0.05), "{row}");
        assert!(row["median_ms"]["pose"].is_number(), "{row}");
    }
    let each = document["queries"].as_array().expect("an array");
    assert_eq!(each.len(), schemes.len() * queries);
    for query in each {
        for key in
            ["name", "scheme", "rotation_error_deg", "translation_error", "inliers", "hypotheses", "ms"]
        {
            assert!(query.get(key).is_some(), "{key} is missing: {query}");
        }
    }
}

#[test]
fn a_scene_is_evaluated() {
    let scene = scene();
    let command = "eval scene --posed posed --images images --map-list map.txt --query-list queries.txt \
                   --max-keypoints 512 --query-keypoints 512 --schemes points,dcl --thresholds 0.05/5,0.1/2 \
                   --keep-map kept.vmap";
    let run = scene.run(&format!("{command} --json")).succeeded();
    let document = run.json();
    check_evaluation(&document, "eval scene", &["points", "dcl"], QUERIES);
    assert_eq!(document["map"]["images"], MAP_VIEWS);
    for row in document["schemes"].as_array().expect("an array") {
        assert_eq!(
            keys(&row["median_ms"]),
            ["decode", "extract", "match", "pose", "retrieve", "seal"],
            "all stages are printed"
        );
        assert!(row["sealed_bytes"].as_u64().is_some_and(|b| b > 0));
    }
    // The stored map is a valid map.
    scene.run("map info kept.vmap").succeeded();

    // With a file for the document, the table goes to stdout, and everything except the times is the same. The camera
    // may come from the list, as in hloc: the model's own camera changes nothing, another one does.
    let listed = |camera: &str| {
        let lines = (0..QUERIES).map(|i| format!("query-{i}.png {camera}")).collect::<Vec<_>>();
        scene.write("listed.txt", lines.join("\n"));
        let command = command.replace("queries.txt", "listed.txt").replace("points,dcl", "points");
        let document = scene.run(&format!("{command} --json")).json();
        document["schemes"][0]["median_translation"].as_f64().unwrap_or(f64::INFINITY)
    };
    let own = listed(&CAMERA.replace(',', " "));
    assert_eq!(Some(own), document["schemes"][0]["median_translation"].as_f64());
    // A focal length 10 % too short is estimated: another pose, within two centimetres instead of half a metre.
    let short = listed(&CAMERA.replace(',', " ").replace("330", "300"));
    assert!(
        short.to_bits() != own.to_bits() && short < 0.02,
        "a focal length 10 % too short: {short}, {own}"
    );

    let run = scene.run(&format!("{command} --json scene.json")).succeeded();
    assert!(run.stdout.contains("points") && run.stdout.contains("≤0.05/5"), "{run}");
    let file: Value = serde_json::from_slice(&scene.read("scene.json")).expect("one document");
    assert_eq!(without_times(file), without_times(document));
}

fn without_times(mut document: Value) -> Value {
    document["map"]["build_seconds"] = json!(0);
    for list in ["schemes", "queries"] {
        for row in document[list].as_array_mut().expect("an array") {
            row["ms"] = json!(0);
            row["median_ms"] = json!(0);
        }
    }
    document
}

/// Exact matches of a pinhole camera at a known pose, one problem per line; one match in five is wrong.
fn problems(count: usize) -> String {
    let line = |k: usize| {
        let (half_turn, offset) = (0.1 * k as f64, 0.3 * k as f64);
        let q = [half_turn.cos(), 0.0, half_turn.sin(), 0.0];
        let pose = CameraFromWorld::from_quaternion(q, [offset, 0.1, 0.2]).expect("a pose");
        let (mut pixels, mut points) = (Vec::new(), Vec::new());
        for i in 0..120 {
            let spread = |m: u32| f64::from((i * m + 17 * k as u32) % 101) / 101.0;
            let (u, v, depth) = (640.0 * spread(37), 480.0 * spread(71), 2.0 + 4.0 * spread(53));
            let shift = if i % 5 == 0 { 1.5 } else { 0.0 };
            let seen = veiloc_geometry::Point3::new(
                (u - 320.0) / 500.0 * depth + shift,
                (v - 240.0) / 500.0 * depth,
                depth,
            );
            let point = pose.inverse().transform(&seen).coords;
            pixels.push([u, v]);
            points.push([point.x, point.y, point.z]);
        }
        let t = pose.translation();
        json!({
            "name": format!("problem-{k}"),
            "camera": {"model": "PINHOLE", "width": 640, "height": 480, "params": [500, 500, 320, 240]},
            "points2d": pixels,
            "points3d": points,
            "cam_from_world": {"q": pose.quaternion(), "t": [t.x, t.y, t.z]},
        })
        .to_string()
            + "\n"
    };
    (0..count).map(line).collect()
}

#[test]
fn poses_are_evaluated() {
    let scene = scene();
    scene.write("problems.jsonl", problems(4));
    let command =
        "eval pose problems.jsonl --schemes points,random-lines,dcl --thresholds 0.05/5,0.1/2 --seed 3";
    let run = scene.run(&format!("{command} --json")).succeeded();
    let document = run.json();
    check_evaluation(&document, "eval pose", &["points", "random-lines", "dcl"], 4);
    assert_eq!(document["seed"], 3);
    let again = scene.run(&format!("{command} --json -")).succeeded().json();
    assert_eq!(without_times(again), without_times(document), "equal seeds give equal results");
    let table = scene.run(command).succeeded().stdout;
    for word in ["points", "random-lines", "dcl", "4/4"] {
        assert!(table.contains(word), "{word}: {table}");
    }
}

#[test]
fn every_command_has_help() {
    let scene = scene();
    let help = scene.run("--help").succeeded().stdout;
    for code in ["0  done", "1  input was refused", "2  wrong usage", "3  results could not be written"] {
        assert!(help.contains(code), "{code}: {help}");
    }
    for (command, purpose) in [
        ("", "Visual localization"),
        ("demo", "Render a scene, map it, localize hidden queries, attack them"),
        ("map", "Build, import, inspect and change maps"),
        ("map build", "Build a map from images, with or without known poses"),
        ("map import", "Build a map from a complete COLMAP model"),
        ("map info", "Print facts about a map"),
        ("map add", "Add images with known poses to a map"),
        ("map remove", "Remove images from a map"),
        ("map profile", "the profile that a device needs to seal queries"),
        ("seal", "Seal images"),
        ("localize", "Estimate the poses of sealed queries"),
        ("eval", "Measure localization on data with known poses"),
        ("eval scene", "Run the whole pipeline on a scene with known poses"),
        ("eval pose", "Run only the pose stage"),
    ] {
        for flag in ["--help", "-h"] {
            let run = scene.run(&format!("{command} {flag}")).succeeded();
            assert!(run.stdout.contains(purpose), "{purpose}: {run}");
            assert!(run.stdout.contains("Usage:") && run.stderr.is_empty(), "{run}");
        }
    }
    assert!(scene.run("--version").succeeded().stdout.starts_with("veiloc "));
}
