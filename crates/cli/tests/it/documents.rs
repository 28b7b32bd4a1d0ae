//! Output of every command: the fields of its document are those of `docs/reference/json.md`, and a failed write is never a
//! success.

use super::common;

use std::fs::{self, File};
use std::process::Stdio;

use common::documented::{Fields, mistakes, page, tables};
use common::{CAMERA, EXTRACTION, TestScene, scene};
use serde_json::{Value, json};

/// Every command that prints a document, by its section of `docs/reference/json.md`. Several commands of a section together cover
/// all fields. `{seal}` stands for the arguments that seal an image.
const COMMANDS: &[(&str, &str)] = &[
    ("seal", "seal images/query-0.png no-such.png {seal} -o documents/ --json"),
    ("localize", "localize --map place.vmap good.vquery no-such.vquery five.vquery --json"),
    ("localize", "localize --map place.vmap good.vquery --need 0.000001 --json"),
    ("localize --rig", "localize --map place.vmap --rig rig.json --json"),
    ("localize --rig", "localize --map place.vmap --rig rig.json --need 0.000001 --json"),
    ("localize --rig", "localize --map place.vmap --rig lost.json --json"),
    ("map info", "map info place.vmap --json"),
    ("map info", "map remove place.vmap map-00.png -o less.vmap --json"),
    ("map split", "map split place.vmap --images 6 --out documents-regions --json"),
    ("map publish", "map publish published-regions storage --json"),
    ("map versions", "map versions storage place --remove-older-than 1 --json"),
    ("map fetch", "map fetch storage place --out fetched-regions --json"),
    (
        "eval scene",
        "eval scene --posed posed --images images --map-list map.txt --query-list queries.txt {few} --regions 6 --json",
    ),
    (
        "eval scene",
        "eval scene --posed posed --images images --map-list map.txt --query-list queries.txt {few} --max-distance 9 \
         --conditions half-hidden,sparse-map,frames:2 --optimum --schemes dcl --json",
    ),
    (
        "eval scene",
        "eval scene --map place.vmap --conditions negatives --negatives images --negatives-list foreign.txt \
         --schemes points,dcl --json",
    ),
    ("eval scene", "eval pose p.jsonl --schemes points,dcl --estimator default,floor --seeds 2 --json"),
    (
        "eval dataset",
        "eval dataset 7scenes --root 7scenes --poses depth --schemes points,dcl --jobs 1 {few} --json",
    ),
    ("eval dataset", "eval dataset aachen --root aachen --schemes dcl {few} --json"),
    (
        "eval adversaries",
        "eval adversaries --posed posed --images images --map-list map.txt --query-list queries.txt {few} \
         --train k.jsonl --schemes dcl --max-attacked 1 --quick --json",
    ),
    ("token list", "token list --tokens tokens --json"),
    (
        "eval inversion",
        "eval inversion images/query-1.png --features sift --network {networks}/learned/inversion.toml --classifier \
         {networks}/image_metrics/classifier.onnx --max-keypoints 64 -k 5 --schemes dcl --json",
    ),
    (
        "eval inversion",
        "eval inversion images --list queries.txt --limit 1 --keypoints s.jsonl --server-matches sp.jsonl --features sift \
         --network {networks}/learned/plain.toml -k 5 --schemes dcl --json",
    ),
    ("attack", "attack --synthetic 60 --schemes dcl --attacks closed-form --json"),
    (
        "attack",
        "attack k.jsonl --server-matches p.jsonl --limit 1 --schemes dcl --attacks server-side --json",
    ),
    (
        "audit",
        "audit k.jsonl --limit 1 --attacks closed-form --synthetic 60 --schemes dcl --out documents.html --json",
    ),
];

/// The scene, with all files that the commands need.
fn ready() -> &'static TestScene {
    static READY: std::sync::Once = std::sync::Once::new();
    let scene = scene();
    READY.call_once(|| {
        scene.seal("query-0.png", "dcl", "good.vquery");
        scene.write("five.txt", "map-00.png\nmap-01.png\nmap-02.png\nmap-03.png\nmap-04.png\n");
        scene.write("foreign.txt", format!("query-0.png {}\nmap-00.png\n", CAMERA.replace(',', " ")));
        scene.run("map split place.vmap --images 6 --out published-regions").succeeded();
        scene.run("map publish published-regions storage").succeeded();
        for layout in ["7scenes", "aachen"] {
            let small = "--map-views 12 --query-views 3 --width 320";
            scene.run(&format!("synth export --layout {layout} --out {layout} {small}")).succeeded();
        }
        scene.run("token new phone --tokens tokens --maps lobby --days 1").succeeded();
        let few = "--max-keypoints 512 --query-keypoints 512";
        scene
            .run(&format!("map build --posed posed --images images --list five.txt {few} -o five.vmap"))
            .succeeded();
        scene.run("map profile five.vmap -o five.vprofile").succeeded();
        let seal =
            format!("seal images/query-0.png --camera {CAMERA} --profile five.vprofile -o five.vquery");
        scene.run(&seal).succeeded();
        let rig = |query: &str| {
            let frame = json!({
                "query": query, "cam_from_rig": {"q": [1, 0, 0, 0], "t": [0, 0, 0]},
                "rotation_sd_deg": 0, "translation_sd": 0
            });
            json!({"frames": [frame]}).to_string()
        };
        scene.write("rig.json", rig("good.vquery"));
        let noise = image::RgbImage::from_fn(400, 300, |x, y| {
            let hash = (x / 3).wrapping_mul(0x9E37_79B1) ^ (y / 3).wrapping_mul(0x85EB_CA77);
            image::Rgb([(hash.wrapping_mul(0xC2B2_AE3D) >> 24) as u8; 3])
        });
        noise.save(scene.path("images/noise.png")).expect("written");
        scene.seal("noise.png", "dcl", "noise.vquery");
        scene.write("lost.json", rig("noise.vquery"));
        let problems =
            "eval problems --posed posed --images images --map-list map.txt --query-list queries.txt";
        let few = EXTRACTION.join(" ");
        scene.run(&format!("{problems} {few} -o p.jsonl --keypoints k.jsonl")).succeeded();
        scene.run(&format!("{problems} {few} --features sift -o sp.jsonl --keypoints s.jsonl")).succeeded();
    });
    scene
}

fn words(command: &str) -> String {
    let seal = format!("--camera {CAMERA} --profile place.vprofile");
    let networks = concat!(env!("CARGO_MANIFEST_DIR"), "/../research/attacks/tests/data");
    command.replace("{seal}", &seal).replace("{few}", &EXTRACTION.join(" ")).replace("{networks}", networks)
}

#[test]
fn every_field_is_documented() {
    let scene = ready();
    let tables = tables();
    let of =
        |section: &str| -> &Fields { tables.get(section).unwrap_or_else(|| panic!("no section {section}")) };
    let mut wrong = Vec::new();
    let mut sections: Vec<&str> = COMMANDS.iter().map(|(section, _)| *section).collect();
    sections.dedup();
    for section in sections {
        let commands = COMMANDS.iter().filter(|(of, _)| *of == section);
        let documents: Vec<Value> = commands.map(|(_, command)| scene.run(&words(command)).json()).collect();
        wrong.extend(mistakes(of(section), &documents).into_iter().map(|m| format!("{section}: {m}")));
    }
    // The demo takes a minute. Its document consists of two of those above.
    assert!(
        of("demo").contains_key("evaluation.queries[].name")
            && of("demo").contains_key("attacks.attacks[].mean_px")
    );
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn json_reference_is_current() {
    let generated = veiloc_cli::json_reference().expect("every field has documentation");
    assert!(page() == generated, "docs/reference/json.md is stale: run `cargo xtask json-reference`");
}

/// The check above detects missing and additional fields, other types, and lists without entries.
#[test]
fn documentation_check_detects_differences() {
    let attack = &tables()["attack"];
    let row = json!({
        "scheme": "dcl", "attack": "graph", "corrupt": 0, "images": 1, "keypoints": 1, "mean_px": 1, "median_px": 1, "under_5px": 1,
        "under_10px": 1, "under_30px": 1, "bits_over_prior": 1, "ms": 1
    });
    let document = json!({
        "version": 1, "command": "attack", "data": ["a"], "neighbours": "oracle", "k": 20, "seed": 0, "attacks": [row]
    });
    assert_eq!(mistakes(attack, std::slice::from_ref(&document)), [""; 0]);
    let with = |change: &dyn Fn(&mut Value)| {
        let mut document = document.clone();
        change(&mut document);
        mistakes(attack, &[document])
    };
    assert_eq!(
        with(&|d| d["attacks"][0]["secret"] = json!(1)),
        ["attacks[].secret is not in docs/reference/json.md"]
    );
    assert_eq!(with(&|d| d["k"] = json!(null)), ["k is null, and docs/reference/json.md does not say when"]);
    let gone = |d: &mut Value| _ = d.as_object_mut().expect("an object").remove("seed");
    assert_eq!(with(&gone), ["seed is absent"]);
    let gone = |d: &mut Value| _ = d["attacks"][0].as_object_mut().expect("an object").remove("images");
    assert_eq!(with(&gone), ["attacks[].images is absent"]);
    assert_eq!(with(&|d| d["k"] = json!("20")), ["k is no integer: \"20\""]);
    assert_eq!(with(&|d| d["data"] = json!([1])), ["data is no string[]: [1]"]);
    assert_eq!(with(&|d| d["attacks"] = json!([])), ["attacks never had an entry"]);
}

/// Runs a command with stdout to a device that is always full.
#[cfg(target_os = "linux")]
fn into_a_full_device(scene: &TestScene, command: &str) -> (Option<i32>, String) {
    let full = File::options().write(true).open("/dev/full").expect("a device");
    let output = scene.command(command).stdout(full).output().expect("runs");
    (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
}

#[cfg(target_os = "linux")]
#[test]
fn unwritable_results_exit_with_3() {
    let scene = ready();
    // All commands print by one function (clippy refuses `println!`), so evaluations that take long are left out.
    let is_quick = |command: &str| !command.starts_with("eval") || command.starts_with("eval pose");
    let with_and_without =
        COMMANDS.iter().filter(|(_, command)| is_quick(command)).flat_map(|(_, command)| {
            let json = words(command);
            [json.replace(" --json", ""), json]
        });
    let more = [
        "--help".to_owned(),
        "--version".to_owned(),
        "map info --help".to_owned(),
        words("seal images/query-0.png {seal} -o -"),
        "eval keypoints images/query-0.png --max-keypoints 64 -o -".to_owned(),
    ];
    // Without --json the output of `seal` is for people, and goes to stderr.
    let prints = |command: &String| {
        !command.starts_with("seal") || !command.contains("documents/") || command.contains("--json")
    };
    for command in with_and_without.chain(more).filter(prints) {
        let (code, stderr) = into_a_full_device(scene, &command);
        assert_eq!(code, Some(3), "{command}: {stderr}");
        assert!(stderr.contains("stdout") && stderr.contains("cannot be written"), "{command}: {stderr}");
        assert!(!stderr.contains("veiloc panicked"), "{command}: {stderr}");
    }
    // The same for a file on a full device or disk.
    for command in [
        "attack --synthetic 60 --schemes dcl --attacks closed-form --json /dev/full".to_owned(),
        words("seal images/query-0.png {seal} -o /dev/full"),
    ] {
        let run = scene.command(&command).output().expect("runs");
        let stderr = String::from_utf8_lossy(&run.stderr);
        assert!(run.status.code() == Some(3) && stderr.contains("/dev/full"), "{command}: {stderr}");
    }
    let still = fs::metadata("/dev/full").expect("there");
    assert!(!still.is_file(), "the device was replaced by a file");
}

/// A reader that closes the pipe early, as `head` does: no message, and the exit code of the command itself.
#[cfg(unix)]
#[test]
fn closed_pipe_is_not_an_error() {
    let scene = ready();
    for command in ["map info place.vmap --json", "localize --map place.vmap good.vquery", "--help"] {
        let (reader, writer) = std::io::pipe().expect("a pipe");
        drop(reader);
        let output = scene.command(command).stdout(Stdio::from(writer)).output().expect("runs");
        assert_eq!(output.status.code(), Some(0), "{command}");
        assert_eq!(String::from_utf8_lossy(&output.stderr), "", "{command}");
    }
}

/// Without a terminal, stages are printed as plain lines, and --quiet suppresses them.
#[test]
fn stages_are_printed_without_terminal() {
    let scene = ready();
    let build = format!(
        "map build --posed posed --images images --list map.txt {} -o repeated.vmap",
        EXTRACTION.join(" ")
    );
    let stages = scene.run(&build).succeeded().stderr;
    assert!(stages.lines().any(|line| line.ends_with("0/10")), "{stages}");
    assert_eq!(scene.run(&format!("{build} --quiet")).succeeded().stderr, "");
}
