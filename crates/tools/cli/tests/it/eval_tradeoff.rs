//! `veiloc eval problems --keypoints` and `veiloc eval tradeoff`: table, document, plot, and what is refused.

use super::common;

use common::{EXTRACTION, folder, keys, place};

#[test]
fn a_rendered_place_is_judged() {
    let place = place();
    let mut problems =
        "eval problems --posed posed --images images --map-list map.txt --query-list queries.txt \
                        -o p.jsonl.gz --keypoints k.jsonl.gz"
            .to_owned();
    problems.extend(EXTRACTION.map(|word| format!(" {word}")));
    place.run(&problems).succeeded();
    let arguments = "eval tradeoff k.jsonl.gz p.jsonl.gz --variants dcl,first=256,random=128+bits=8 --attacked 1 --corrupt 0 --thresholds 0.1/2";
    let run = place.run(&format!("{arguments} --plot t.svg --json t.json")).succeeded();
    for word in ["first=256", "random=128+bits=8", "shape", "≤0.1/2 %"] {
        assert!(run.stdout.contains(word), "{word}: {run}");
    }
    assert!(run.stdout.lines().all(|line| line.chars().count() <= 120), "{run}");
    assert!(String::from_utf8(place.read("t.svg")).expect("text").contains("poses within 0.1/2"));
    let document: serde_json::Value = serde_json::from_slice(&place.read("t.json")).expect("a document");
    let variants = document["variants"].as_array().expect("a list");
    assert_eq!(variants.len(), 3);
    assert_eq!(variants[1]["sent"], 256.0);
    // The same keypoints as in the problems: the whole query, and poses come out of it.
    assert!(variants[0]["sent"].as_f64() >= Some(256.0));
    assert!(variants[0]["localization"]["recall"]["0.1/2"].as_f64() >= Some(0.5), "{document}");
    assert_eq!(
        keys(&variants[0]),
        ["attacks", "chance", "decoys", "localization", "precision", "sent", "variant"]
    );
}

#[test]
fn what_makes_no_sense_is_refused() {
    let place = folder();
    place.write("k.jsonl", "{\"name\":\"a\",\"width\":640,\"height\":480,\"keypoints\":[[1,2]]}\n");
    for (arguments, code, says) in [
        ("eval tradeoff k.jsonl p.jsonl --variants blur=3", 2, "nothing is called"),
        ("eval tradeoff k.jsonl p.jsonl --variants spacing", 2, "no value"),
        ("eval tradeoff k.jsonl p.jsonl", 1, "p.jsonl"),
        ("eval tradeoff k.jsonl k.jsonl", 1, "k.jsonl:1"),
    ] {
        let run = place.run(arguments);
        assert_eq!(run.code, Some(code), "{run}");
        assert!(run.stderr.contains(says), "{run}");
    }
    let help = place.run("eval tradeoff --help").succeeded().stdout;
    assert!(help.contains("spacing=PX") && help.contains("known=R"), "{help}");
}
