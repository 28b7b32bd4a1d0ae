//! `veiloc synth export` and `eval dataset`: a rendered scene in every layout,
//! evaluated through the reader; an interrupted run continues.

use super::common;

use std::fs;

use common::{EXTRACTION, TestScene, folder};
use serde_json::Value;

/// A small scene: enough to localize in, quickly rendered.
fn export(scene: &TestScene, layout: &str) {
    scene
        .run(&format!(
            "synth export --layout {layout} --out {layout} --map-views 12 --query-views 3 --width 400"
        ))
        .succeeded();
}

fn evaluated(scene: &TestScene, data_set: &str, more: &str) -> Value {
    scene
        .run(&format!(
            "eval dataset {data_set} --root {data_set} --schemes points,dcl {} {more} --json -",
            EXTRACTION.join(" ")
        ))
        .succeeded()
        .json()
}

/// Checks that each row of the table is right to three centimetres, and returns the number of rows.
fn localized_rows(document: &Value) -> usize {
    let rows = document["schemes"].as_array().expect("rows");
    for row in rows {
        let error = row["median_translation"].as_f64().unwrap_or(f64::INFINITY);
        assert!(error < 0.03, "{}: {error} m", row["scheme"]);
    }
    rows.len()
}

/// Removes everything that depends on the machine's speed or on the command line.
fn without_times(document: &Value) -> Value {
    fn strip(value: &mut Value) {
        match value {
            Value::Object(fields) => {
                for field in ["ms", "median_ms", "build_seconds", "run"] {
                    fields.remove(field);
                }
                fields.values_mut().for_each(strip);
            }
            Value::Array(items) => items.iter_mut().for_each(strip),
            Value::Null | Value::Bool(_) | Value::Number(_) | Value::String(_) => {}
        }
    }
    let mut document = document.clone();
    strip(&mut document);
    document
}

#[test]
fn seven_scenes_layout_is_written_and_evaluated() {
    let scene = folder();
    export(&scene, "7scenes");
    for poses in ["sfm", "depth"] {
        assert_eq!(localized_rows(&evaluated(&scene, "7scenes", &format!("--poses {poses}"))), 2);
    }
}

#[test]
fn cambridge_layout_is_written_evaluated_and_attacked() {
    let scene = folder();
    export(&scene, "cambridge");
    let attacking = "--attack 1 --attack-neighbours 40 --attack-json attacks.json";
    assert_eq!(localized_rows(&evaluated(&scene, "cambridge", attacking)), 2);
    let attacks: Value = serde_json::from_slice(&scene.read("attacks.json")).expect("a document");
    assert_eq!((&attacks["command"], &attacks["k"]), (&"eval adversaries".into(), &40.into()));
    let rows = attacks["rows"].as_array().expect("rows");
    let adversaries: Vec<&str> = rows.iter().filter_map(|row| row["adversary"].as_str()).collect();
    assert!(
        ["map-server", "pose-server", "true-neighbours"].iter().all(|a| adversaries.contains(a)),
        "{adversaries:?}"
    );
    assert!(rows.iter().all(|row| row["scheme"] == "dcl" && row["data"] == "room"), "{attacks}");
}

#[test]
fn aachen_layout_is_written_and_evaluated_and_poses_are_submitted() {
    let scene = folder();
    export(&scene, "aachen");
    let with_truth = "--truth aachen/queries/poses.txt --submission results.txt --work work";
    assert_eq!(localized_rows(&evaluated(&scene, "aachen", with_truth)), 4, "day and night of each scheme");

    let text = |file: &str| String::from_utf8(scene.read(file)).expect("text");
    let submitted = text("results-dcl.txt");
    assert_eq!(submitted.lines().count(), 3, "{submitted}");
    let poses = text("aachen/queries/poses.txt");
    let words = |line: &str| line.split(' ').map(str::to_owned).collect::<Vec<_>>();
    for line in submitted.lines().map(words) {
        let same = |other: &Vec<String>| other[0].ends_with(&format!("/{}", line[0]));
        let true_line = poses.lines().map(words).find(same).expect("of a query");
        assert_eq!(line.len(), 8, "{line:?}");
        for (ours, truth) in line[1..].iter().zip(&true_line[1..]) {
            let number = |word: &String| word.parse::<f64>().expect("a number");
            assert!((number(ours) - number(truth)).abs() < 0.05, "{line:?}\n{true_line:?}");
        }
    }
    // Without ground truth there are no errors, and the poses are the same.
    let blind = evaluated(&scene, "aachen", "--submission blind.txt --work work");
    assert!(
        blind["schemes"].as_array().expect("rows").iter().all(|row| row["recall"] == serde_json::json!({}))
    );
    assert_eq!(text("blind-dcl.txt"), submitted);
}

#[test]
fn interrupted_runs_resume_without_losing_queries() {
    let scene = folder();
    export(&scene, "7scenes");
    let whole = evaluated(&scene, "7scenes", "");
    evaluated(&scene, "7scenes", "--work work --jobs 1");
    let journal = || String::from_utf8(scene.read("work/room/queries.jsonl")).expect("text");
    let lines = journal();
    assert_eq!(lines.lines().count(), 3);

    // Truncated after the first query, in the middle of the line of the second.
    let first = lines.find('\n').expect("a line") + 1;
    scene.write("work/room/queries.jsonl", &lines[..first + 200]);
    let resumed = evaluated(&scene, "7scenes", "--work work --jobs 2");
    assert_eq!(without_times(&resumed), without_times(&whole));
    let again = journal();
    assert!(again.starts_with(&lines[..first]), "the finished query stays");
    assert_eq!(again.lines().count(), 3);
    let third = evaluated(&scene, "7scenes", "--work work");
    assert_eq!(third["queries"], resumed["queries"], "nothing is computed a third time");
    // An interruption of the map build: features and matches exist, and the map is the same to the byte.
    let map = || {
        let files = fs::read_dir(scene.path("work/room")).expect("a folder").flatten();
        let maps = files.map(|file| file.path()).filter(|path| path.extension().is_some_and(|e| e == "vmap"));
        maps.collect::<Vec<_>>().pop().expect("a map")
    };
    let (path, bytes) = (map(), fs::read(map()).expect("a map"));
    let kept = || {
        (
            fs::read_dir(scene.path("work/room/features")).expect("kept").count(),
            scene.read("work/room/matches-0.bin"),
        )
    };
    let before = kept();
    assert_eq!(before.0, 12, "an image each");
    assert!(before.1.len() > 10_000);
    fs::remove_file(&path).expect("removed");
    assert_eq!(evaluated(&scene, "7scenes", "--work work")["queries"], resumed["queries"]);
    assert!(fs::read(&path).expect("built again") == bytes);
    assert!(kept() == before, "nothing was extracted or matched again");
    // Other options, or another image, are other queries.
    evaluated(&scene, "7scenes", "--work work --seed 7");
    assert_eq!(journal().lines().count(), 6);
    let frame = |n: u32| scene.path(format!("7scenes/room/seq-02/frame-00000{n}.color.png"));
    fs::copy(frame(1), frame(0)).expect("copied");
    evaluated(&scene, "7scenes", "--work work");
    assert_eq!(journal().lines().count(), 7);
    // A damaged line in the middle is named.
    scene.write("work/room/queries.jsonl", format!("{{\n{again}"));
    let refused = scene.run("eval dataset 7scenes --root 7scenes --schemes points,dcl --work work");
    assert_eq!(refused.code, Some(1), "{refused}");
    assert!(refused.stderr.contains("queries.jsonl:1:"), "{refused}");
}

#[test]
fn missing_files_are_named_with_source() {
    let scene = folder();
    scene.write("empty/here.txt", "");
    for (data_set, where_it_is) in [
        ("7scenes", "microsoft.com"),
        ("cambridge", "repository.cam.ac.uk"),
        ("aachen", "visuallocalization.net"),
    ] {
        let refused = scene.run(&format!("eval dataset {data_set} --root empty"));
        assert_eq!(refused.code, Some(1), "{refused}");
        assert!(refused.stderr.contains(where_it_is), "{refused}");
    }
    let refused = scene.run("eval dataset cambridge --root empty --submission a.txt");
    assert!(
        refused.code == Some(1) && refused.stderr.contains("--submission is no option of cambridge"),
        "{refused}"
    );
    let refused = scene.run("eval dataset aachen-v1.1 --root empty");
    assert!(refused.code == Some(1) && refused.stderr.contains("`aachen` if this is v1"), "{refused}");
    let refused = scene.run("synth export --layout 7scenes --out empty");
    assert_eq!(refused.code, Some(1), "{refused}");
    assert!(refused.stderr.contains("the folder is not empty"), "{refused}");
}
