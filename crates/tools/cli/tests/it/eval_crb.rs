//! `veiloc eval crb`: table, document and plot, and refused input.

use super::common;

use common::{folder, keys};

const SMALL: &str = "eval crb --scenes narrow --schemes points,dcl --keypoint-noise 1 --outliers 25 --problems 4 --matches 100";

#[test]
fn table_document_and_plot() {
    let scene = folder();
    let run = scene.run(&format!("{SMALL} --plot law.svg --json law.json")).succeeded();
    for word in ["narrow", "points", "dcl", "trans / bound", "centre 99 %"] {
        assert!(run.stdout.contains(word), "{word}: {run}");
    }
    assert!(run.stdout.lines().all(|line| line.chars().count() <= 120), "{run}");
    assert!(String::from_utf8(scene.read("law.svg")).expect("text").contains("narrow, 25 % outliers"));
    let document: serde_json::Value = serde_json::from_slice(&scene.read("law.json")).expect("a document");
    assert_eq!(keys(&document), ["cells", "command", "coverage", "matches", "problems", "seed", "version"]);
    assert_eq!((&document["command"], &document["version"]), (&"eval crb".into(), &1.into()));
    assert_eq!(document["cells"].as_array().map(Vec::len), Some(2));
    assert_eq!(document["cells"][0]["outlier_ratio"], 0.25);
    assert_eq!(keys(&document["coverage"][0]["pose"]), ["50", "90", "99"]);
    let again = scene.run(&format!("{SMALL} --json")).succeeded().json();
    assert_eq!(again, document, "equal seeds give equal results");
    let other = scene.run(&format!("{SMALL} --seed 1 --json")).succeeded().json();
    assert_ne!(other["cells"], document["cells"]);
}

#[test]
fn contradictory_arguments_are_refused() {
    let scene = folder();
    let cases: &[(&str, i32, &[&str])] = &[
        ("eval crb --scenes flat", 2, &["flat", "near-planar"]),
        ("eval crb --keypoint-noise 0", 2, &["above 0"]),
        ("eval crb --outliers 100", 2, &["below 100"]),
        ("eval crb --problems 0", 2, &["--problems"]),
        ("eval crb --matches 20 --outliers 80", 1, &["20 matches", "use more matches"]),
        (&format!("{SMALL} --plot no/such/folder/law.svg"), 1, &["law.svg", "folder"]),
    ];
    for (arguments, code, expected_words) in cases {
        let run = scene.run(arguments);
        assert_eq!(run.code, Some(*code), "{run}");
        assert!(
            run.stdout.is_empty() && expected_words.iter().all(|word| run.stderr.contains(word)),
            "{run}"
        );
    }
    let help = scene.run("eval crb --help").succeeded().stdout;
    assert!(help.contains("Cramér–Rao") && help.contains("field of view 20 degrees"), "{help}");
}
