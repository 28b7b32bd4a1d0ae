//! `veiloc eval compare`: two runs side by side, and invalid files.

use super::common;

use common::scene;
use serde_json::Value;

#[test]
fn runs_are_compared_and_invalid_files_refused() {
    let scene = scene();
    let make = "eval problems --posed posed --images images --map-list map.txt --query-list queries.txt";
    scene.run(&format!("{make} --max-keypoints 512 -o compared.jsonl")).succeeded();
    let pose = "eval pose compared.jsonl --schemes points,dcl --thresholds 0.02/2,0.1/5";
    scene.run(&format!("{pose} --json plain.json")).succeeded();
    scene.run(&format!("{pose} --seed 1 --no-prior --json other.json")).succeeded();

    let itself = scene.run("eval compare plain.json plain.json --json").succeeded().json();
    let rows = itself["rows"].as_array().expect("rows");
    assert_eq!(rows.len(), 2, "{itself}");
    for figure in rows.iter().flat_map(|row| row["figures"].as_array().expect("figures")) {
        assert_eq!(
            (&figure["difference"], &figure["result"]),
            (&0.0.into(), &"not-shown".into()),
            "{figure}"
        );
    }
    // Points are more accurate than lines, and both are in one file.
    let schemes = "eval compare plain.json plain.json --row dcl --against points";
    let document = scene.run(&format!("{schemes} --json")).succeeded().json();
    let row = &document["rows"][0];
    assert!(row["a"].as_str().expect("a name").starts_with("dcl"), "{row}");
    let counts = ["better_in_b", "worse_in_b", "queries"].map(|name| row[name].as_u64().expect("a count"));
    assert!(counts[0] + counts[1] <= counts[2] && counts[2] > 0, "{row}");
    let text = scene.run(schemes).succeeded().stdout;
    assert!(text.contains("recall 0.02/2, %") && text.contains("95 % of draws"), "{text}");
    // Equal seeds give equal intervals.
    assert_eq!(text, scene.run(schemes).succeeded().stdout);

    // Another seed and no prior: no common row, and no query with the same seed.
    let other = scene.run("eval compare plain.json other.json");
    assert!(other.code == Some(1) && other.stderr.contains("no rows to compare"), "{other}");
    let other = scene.run("eval compare plain.json other.json --row dcl --against dcl");
    assert!(other.code == Some(1) && other.stderr.contains("no query in common"), "{other}");
    let cut = scene.read("plain.json");
    scene.write("cut.json", &cut[..cut.len() / 2]);
    let mut layouts: Value = serde_json::from_slice(&cut).expect("a document");
    layouts["command"] = "eval layouts".into();
    scene.write("layouts.json", layouts.to_string());
    for (file, expected_words) in [
        ("cut.json", "not a document of an evaluation"),
        ("layouts.json", "eval layouts"),
        ("gone.json", "gone.json"),
    ] {
        let run = scene.run(&format!("eval compare plain.json {file}"));
        assert!(
            run.code == Some(1) && run.stderr.contains(expected_words) && run.stderr.contains(file),
            "{run}"
        );
    }
}
