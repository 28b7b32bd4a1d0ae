//! `veiloc eval adversaries`: results, left-out adversaries, and refused input.

use super::common;

use common::{EXTRACTION, folder, keys, scene};

#[test]
fn adversaries_on_rendered_scene_and_keypoint_files() {
    let scene = scene();
    let few = EXTRACTION.join(" ");
    scene.run("eval keypoints images --list map.txt --max-keypoints 512 -o elsewhere.jsonl").succeeded();
    let run = scene
        .run(&format!(
            "eval adversaries --posed posed --images images --map-list map.txt --query-list queries.txt {few} \
             --keypoints elsewhere.jsonl --train elsewhere.jsonl --max-attacked 1 --quick --json a.json"
        ))
        .succeeded();
    for word in ["query-only-statistic", "pose-server-images", "several-seals", "their resources are missing"]
    {
        assert!(run.stdout.contains(word), "{word}: {run}");
    }
    assert!(run.stdout.lines().all(|line| line.chars().count() <= 120), "{run}");
    let document: serde_json::Value = serde_json::from_slice(&scene.read("a.json")).expect("a document");
    let rows = document["rows"].as_array().expect("a list");
    for row in rows {
        for key in ["adversary", "scheme", "attack", "images", "median_px", "under_10px", "under_30px"] {
            assert!(keys(row).contains(&key), "{key}: {row}");
        }
        let best = row["bits_over_prior"].as_f64().expect("a number");
        let attacks = row["attacks"].as_array().expect("a list").iter();
        let most = attacks.filter_map(|t| t["bits_over_prior"].as_f64()).fold(f64::NEG_INFINITY, f64::max);
        assert!((best - most).abs() < 1e-12, "the best of its attacks: {row}");
    }
    let of = |data: &str, adversary: &str, scheme: &str| {
        rows.iter().find(|r| r["data"] == data && r["adversary"] == adversary && r["scheme"] == scheme)
    };
    let data = |row: &serde_json::Value| row["data"].as_str().expect("text").to_owned();
    let name = data(rows.first().expect("rows"));
    let bits = |adversary: &str, scheme: &str| {
        let row = of(&name, adversary, scheme).unwrap_or_else(|| panic!("{adversary} {scheme}: {document}"));
        row["bits_over_prior"].as_f64().expect("a number")
    };
    // An oracle's neighbours give more than predicted ones, and the map's images give more than several sealed queries.
    for scheme in ["random-lines", "coordinate-permutation", "dcl"] {
        assert!(bits("true-neighbours", scheme) > bits("query-only-statistic", scheme) + 0.5, "{scheme}");
    }
    assert!(bits("several-seals", "dcl") > 0.1, "{document}");
    // A file of keypoints comes without a map.
    assert!(of("elsewhere.jsonl", "true-neighbours", "dcl").is_some());
    assert!(of("elsewhere.jsonl", "map-server", "dcl").is_none());
    assert!(of("elsewhere.jsonl", "pose-server", "dcl").is_none());
}

#[test]
fn contradictory_arguments_are_refused() {
    let scene = folder();
    scene.write("k.jsonl", "{}\n");
    for (arguments, code, expected_words) in [
        ("", 1, "nothing to attack"),
        ("--keypoints k.jsonl --schemes points", 1, "points are sent openly"),
        ("--keypoints no-such.jsonl", 1, "no-such.jsonl"),
        ("--keypoints k.jsonl", 1, "k.jsonl"),
        ("--posed p", 2, "--images"),
        ("--keypoints k.jsonl --masks m", 2, "--posed"),
        ("--keypoints k.jsonl --adversaries nobody", 2, "query-only-statistic"),
        ("--keypoints k.jsonl --max-attacked 0", 2, "--max-attacked"),
    ] {
        let run = scene.run(&format!("eval adversaries {arguments}"));
        assert_eq!(run.code, Some(code), "{run}");
        assert!(run.stderr.contains(expected_words), "{expected_words}: {run}");
    }
}
