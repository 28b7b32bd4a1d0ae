//! `veiloc audit`: photographs and keypoints as input, a page as output, and refused input.

use super::common;

use common::{TestScene, folder, keys, scene};
use image::{Rgb, RgbImage};

/// Discs of many sizes on a gradient: plenty of keypoints.
fn photograph(scene: &TestScene, name: &str, shift: u32) {
    std::fs::create_dir_all(scene.path(name).parent().expect("a parent")).expect("folder");
    RgbImage::from_fn(240, 180, |x, y| {
        let (u, v) = (f64::from(x + shift), f64::from(y));
        let wave = (u * (0.2 + u / 3000.0)).sin() * (v * 0.27).cos() + (u * 0.61 + v * 0.47).sin() * 0.4;
        Rgb([(128.0 + 80.0 * wave) as u8, (100.0 + 0.3 * v) as u8, (120.0 - 40.0 * wave) as u8])
    })
    .save(scene.path(name))
    .expect("written");
}

/// A file of uniformly distributed keypoints.
fn keypoints(n: u32) -> String {
    let spread = |i: u32| [f64::from(i * 7919 % 6400) / 10.0, f64::from(i * 104_729 % 4800) / 10.0];
    let points: Vec<[f64; 2]> = (1..=n).map(spread).collect();
    serde_json::json!({"name": "k<1>", "width": 640, "height": 480, "keypoints": points}).to_string() + "\n"
}

const FAST: &str = "--attacks closed-form --synthetic 100 --schemes random-lines,dcl";

#[test]
fn report_shows_photographs() {
    let scene = folder();
    photograph(&scene, "a.png", 0);
    photograph(&scene, "place/b.png", 5);
    let run = scene.run(&format!("audit a.png place {FAST} --out out/deep --json audit.json")).succeeded();
    let page = String::from_utf8(scene.read("out/deep/audit.html")).expect("text");
    assert!(run.stderr.contains("out/deep/audit.html"), "{run}");
    assert!(run.stdout.contains("The strongest attack on each scheme"), "{run}");
    assert!(run.stdout.starts_with("Under dcl, private things that no map shows stay hidden"), "{run}");
    assert!(page.contains("data:image/jpeg") && page.contains("This file contains the photographs"));
    assert!(page.contains("audit a.png place --attacks closed-form"), "the command");
    let document: serde_json::Value = serde_json::from_slice(&scene.read("audit.json")).expect("a document");
    assert_eq!(keys(&document), ["command", "inputs", "synthetic", "version"]);
    assert_eq!(document["inputs"]["data"], serde_json::json!(["place", "a.png"]));
    assert_eq!(document["inputs"]["attacks"].as_array().map(Vec::len), Some(4));
    assert_eq!(document["inputs"]["strongest"][1]["with_oracle"], "closed-form");
    assert!(document["inputs"]["keypoints"].as_u64().expect("a number") > 50, "{document}");

    scene
        .run(
            &format!("audit a.png {FAST} --no-images --no-synthetic --out bare.html")
                .replace(" --synthetic 100", ""),
        )
        .succeeded();
    let bare = String::from_utf8(scene.read("bare.html")).expect("text");
    assert!(!bare.contains("data:image") && !bare.contains("synthetic scene"));
}

#[test]
fn report_from_keypoints() {
    let scene = folder();
    scene.write("k.jsonl", keypoints(150));
    let run = scene.run(&format!("audit k.jsonl {FAST} --out page.html --json")).succeeded();
    let document = run.json();
    assert_eq!((&document["command"], &document["inputs"]["data"][0]), (&"audit".into(), &"k.jsonl".into()));
    let page = String::from_utf8(scene.read("page.html")).expect("text");
    assert!(page.contains("k&lt;1&gt;") && !page.contains("k<1>"));
    // Equal seeds give equal figures, except for the times.
    let again = scene.run(&format!("audit k.jsonl {FAST} --out page.html --json")).succeeded().json();
    let mean = |d: &serde_json::Value| d["inputs"]["attacks"][3]["mean_px"].as_f64().expect("a number");
    assert_eq!(mean(&document), mean(&again));
}

#[test]
fn keypoints_are_drawn_on_images_of_their_names() {
    let scene = folder();
    photograph(&scene, "images/a.png", 0);
    photograph(&scene, "images/b.png", 5);
    scene.run("eval keypoints images -o k.jsonl").succeeded();
    let fast = FAST.replace("--synthetic 100", "--no-synthetic");
    // Images given beside the keypoints are not attacked a second time.
    let run =
        scene.run(&format!("audit k.jsonl images {fast} --out given.html --json given.json")).succeeded();
    let document: serde_json::Value = serde_json::from_slice(&scene.read("given.json")).expect("a document");
    assert_eq!(document["inputs"]["data"], serde_json::json!(["k.jsonl"]), "{run}");
    assert!(String::from_utf8_lossy(&scene.read("given.html")).contains("data:image/jpeg"));
    // Images found beside the file of keypoints.
    std::fs::copy(scene.path("k.jsonl"), scene.path("images/k.jsonl")).expect("copied");
    scene.run(&format!("audit images/k.jsonl {fast} --out beside.html")).succeeded();
    assert!(String::from_utf8_lossy(&scene.read("beside.html")).contains("data:image/jpeg"));
    // No images: figures only.
    scene.run(&format!("audit k.jsonl {fast} --out none.html")).succeeded();
    assert!(!String::from_utf8_lossy(&scene.read("none.html")).contains("data:image/jpeg"));
    // An image of the same name with another size is another image.
    RgbImage::from_pixel(90, 200, Rgb([9, 9, 9])).save(scene.path("images/a.png")).expect("written");
    let run = scene.run(&format!("audit k.jsonl images {fast} --out other.html"));
    assert_eq!(run.code, Some(1), "{run}");
    assert!(run.stderr.contains("90 x 200") && run.stderr.contains("240 x 180"), "{run}");
}

#[test]
fn default_attacks_put_oracles_last() {
    let scene = folder();
    photograph(&scene, "a.png", 0);
    photograph(&scene, "b.png", 5);
    let run = scene
        .run("audit a.png b.png --no-synthetic --schemes dcl --max-keypoints 150 --out page.html")
        .succeeded();
    let at = |text: &str| run.stdout.find(text).unwrap_or_else(|| panic!("{text}: {run}"));
    let oracle = at("Attacks with true neighbours from an oracle, which no real attacker has");
    for attack in ["static-camera", "transfer"] {
        assert!(at(attack) < oracle, "{run}");
    }
    assert!(at("closed-form") > oracle && at("graph") > oracle, "{run}");
    let strongest = at("The strongest attack on each scheme");
    for attacker in ["without an oracle", "with true neighbours"] {
        assert!(run.stdout[strongest..].contains(attacker), "{run}");
    }
}

/// With a pack, only what is sent is attacked, and the page says how much that is; of an image of elsewhere nothing is.
#[test]
fn only_what_a_device_with_the_pack_sends_is_attacked() {
    let scene = scene();
    scene.run("map pack place.vmap -o place.vpack").succeeded();
    photograph(scene, "elsewhere.png", 0);
    let fast = FAST.replace("--synthetic 100", "--no-synthetic");
    let sent = |send: &str| {
        let run = scene
            .run(&format!(
                "audit images/query-0.png elsewhere.png {fast} --pack place.vpack {send} -o p.html --json"
            ))
            .succeeded();
        let page = String::from_utf8(scene.read("p.html")).expect("text");
        assert!(page.contains("a device with this pack sends"), "{run}");
        let with_pack = run.json()["inputs"]["with_pack"].clone();
        assert_eq!(with_pack["images_not_sent"], 1, "{run}");
        let attacked = run.json()["inputs"]["attacks"][0]["keypoints"].clone();
        assert_eq!(attacked, with_pack["sent"], "{run}");
        let count = |what: &str| with_pack[what].as_u64().expect("a number");
        (with_pack["send"].clone(), count("sent"), count("keypoints"))
    };
    let (word, matches, of) = sent("");
    let (other, explained, _) = sent("--send explained");
    assert_eq!((word, other), ("matches".into(), "explained".into()));
    assert!(50 < matches && matches <= explained && explained < of, "{matches} {explained} {of}");
    let run = scene.run("audit images/query-0.png --send explained -o p.html");
    assert!(run.code == Some(2) && run.stderr.contains("--pack"), "{run}");
}

#[test]
fn the_synthetic_scene_needs_no_input() {
    let scene = folder();
    let run = scene.run(&format!("audit {FAST} -o page.html")).succeeded();
    assert!(run.stdout.contains("closed-form"), "{run}");
    let page = String::from_utf8(scene.read("page.html")).expect("text");
    assert!(page.contains("1 image with 100 keypoints"));
    assert!(page.contains("Fig. 4: dcl under the paper's attack") && page.contains("Fig. 5"));
}

#[test]
fn invalid_inputs_are_refused() {
    let scene = folder();
    scene.write("empty.jsonl", "\n");
    scene.write("none.jsonl", "{\"name\":\"n\",\"width\":64,\"height\":48,\"keypoints\":[]}\n");
    scene.write("empty.png", "");
    scene.write("text.jpg", "no image");
    RgbImage::from_pixel(120, 90, Rgb([90, 90, 90])).save(scene.path("flat.png")).expect("written");
    std::fs::create_dir_all(scene.path("nothing")).expect("folder");
    for (arguments, code, expected_words) in [
        ("audit", 2, "IMAGE"),
        ("audit gone.jpg", 1, "gone.jpg"),
        ("audit gone.jsonl", 1, "gone.jsonl"),
        ("audit empty.jsonl", 1, "empty.jsonl"),
        ("audit none.jsonl", 1, "no keypoint"),
        ("audit empty.png", 1, "empty.png"),
        ("audit text.jpg", 1, "text.jpg"),
        ("audit flat.png", 1, "no keypoint"),
        ("audit nothing", 1, "nothing"),
        ("audit flat.png --schemes points", 1, "no keypoint"),
        ("audit flat.png flat.png --limit 1", 1, "--limit 2"),
        ("audit flat.png --no-synthetic --synthetic 9", 2, "--no-synthetic"),
        ("audit flat.png --attacks guess", 2, "closed-form-informed"),
    ] {
        let run = scene.run(&format!("{arguments} -o page.html"));
        assert_eq!(run.code, Some(code), "{run}");
        assert!(run.stderr.contains(expected_words) && run.stdout.is_empty(), "{expected_words}: {run}");
        assert!(!scene.path("page.html").exists(), "{arguments}");
    }
}
