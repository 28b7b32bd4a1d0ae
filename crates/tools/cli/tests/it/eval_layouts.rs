//! `veiloc eval layouts`: tables, document, plot, and refused input.

use super::common;

use common::{EXTRACTION, folder, keys, scene};

#[test]
fn layouts_are_compared_on_rendered_scene() {
    let scene = scene();
    let other = "dcl:axis=67:sectors=20:anchors=-0.12/-0.49+1.5/0";
    let run = scene
        .run(&format!(
            "eval layouts --posed posed --images images --map-list map.txt --query-list queries.txt {} \
             --layouts dcl:paper,{other} --stress none --max-attacked 1 --plot l.svg --json l.json",
            EXTRACTION.join(" ")
        ))
        .succeeded();
    for word in ["  1  dcl:paper", other, "outsider-statistic", "several-seals", "prior px"] {
        assert!(run.stdout.contains(word), "{word}: {run}");
    }
    assert!(run.stdout.lines().all(|line| line.chars().count() <= 120), "{run}");
    let plot = String::from_utf8(scene.read("l.svg")).expect("text");
    assert!(plot.contains("pose error relative to points"));
    let document: serde_json::Value = serde_json::from_slice(&scene.read("l.json")).expect("a document");
    let rows = document["rows"].as_array().expect("a list");
    assert_eq!(rows.len(), 2);
    assert_eq!((&rows[0]["layout"], &rows[1]["layout"]), (&"dcl:paper".into(), &other.into()));
    assert_eq!(
        keys(&rows[1]),
        [
            "adversaries",
            "bits",
            "conditions",
            "error_over_points",
            "layout",
            "other_pencil_neighbours",
            "prior_mean_px",
            "protects_as_paper",
            "rotation_over_points",
            "tail_over_points"
        ]
    );
    assert_eq!(rows[0]["protects_as_paper"], true, "as itself");
    let number = |row: usize, field: &str| rows[row][field].as_f64().unwrap_or(f64::NAN);
    // Stripes separate more neighbours than one line through the middle, and the prior-only baseline of a 400 x 300
    // image is some tens of px.
    assert!(number(1, "other_pencil_neighbours") > 1.5 * number(0, "other_pencil_neighbours"), "{document}");
    assert!((20.0..120.0).contains(&number(0, "prior_mean_px")), "{document}");
    // Lines give less accuracy than points.
    assert!(number(0, "error_over_points") > 1.0, "{document}");
    for row in rows {
        let bits = |adversary: &str| row["bits"][adversary].as_f64().unwrap_or(f64::NAN);
        assert!(bits("true-neighbours") > bits("outsider-statistic") + 1.0, "{document}");
        assert!(bits("several-seals") > 0.1, "{document}");
    }
}

#[test]
fn contradictory_arguments_are_refused() {
    let scene = folder();
    for (arguments, code, expected_words) in [
        ("--layouts points", 2, "points has no layout"),
        ("--layouts dcl:axis=1", 2, "--layouts"),
        ("--max-attacked 0", 2, "--max-attacked"),
        ("", 1, "q.txt"),
    ] {
        let run = scene.run(&format!(
            "eval layouts --posed p --images i --map-list m.txt --query-list q.txt {arguments}"
        ));
        assert_eq!(run.code, Some(code), "{run}");
        assert!(run.stderr.contains(expected_words), "{run}");
    }
    let help = scene.run("eval layouts --help").succeeded().stdout;
    assert!(help.contains("several-seals") && help.contains("@DEG at infinity"), "{help}");
}
