//! Learned features: a described network in the whole pipeline, and the errors if it is missing or another one.

use super::common;

use common::{CAMERA, TestScene, scene};

/// An analytic network, and its description (`research/oracles/networks.py`).
fn corners(ending: &str) -> String {
    format!("{}/../device/features/tests/data/learned/corners.{ending}", env!("CARGO_MANIFEST_DIR"))
}

/// The command exits with 1, prints all these words, and writes no query.
fn refused(scene: &TestScene, command: &str, expected_words: &[&str]) {
    let run = scene.run(command).refused(expected_words);
    assert!(!scene.path("none.vquery").exists(), "{run}");
}

#[test]
fn a_described_network_maps_seals_and_localizes() {
    let scene = scene();
    let features = format!("--features {}", corners("toml"));
    let build = format!("map build --posed posed --images images --list map.txt {features} -o corners.vmap");
    scene.run(&build).succeeded();
    scene.run("map profile corners.vmap -o corners.vprofile").succeeded();
    let info = scene.run("map info corners.vmap --json").succeeded().json();
    assert!(info.to_string().contains("corners"), "{info}");
    let seal = format!("seal images/query-0.png --camera {CAMERA} --profile corners.vprofile");
    scene.run(&format!("{seal} {features} -o corners.vquery")).succeeded();
    let found = scene.run("localize --map corners.vmap corners.vquery --json").succeeded().json();
    assert!(found["queries"][0]["cam_from_world"].is_object(), "{found}");

    // The audit and out-of-map images use the network too, and do not fall back to built-in features.
    let audit = "audit images/query-0.png --no-synthetic --attacks closed-form --max-keypoints 256 --json";
    let attacked = scene.run(&format!("{audit} {features} -o corners.html")).succeeded().json();
    let built_in = scene.run(&format!("{audit} -o built-in.html"));
    assert_ne!(attacked["inputs"]["attacks"], built_in.succeeded().json()["inputs"]["attacks"]);
    let out_of_map = "eval scene --map corners.vmap --conditions negatives --negatives images --schemes dcl";
    let negatives = scene.run(&format!("{out_of_map} {features} --json")).succeeded().json();
    assert!(negatives["schemes"][0]["queries"].as_u64() > Some(0), "{negatives}");
    refused(scene, out_of_map, &["no extractor for features of kind corners"]);

    // `corners` without a description; another kind than the map's; compact rows for a map of corners.
    refused(scene, &format!("{seal} -o none.vquery"), &["unknown feature type \"corners\"", "xfeat"]);
    refused(scene, &format!("{seal} --features sift -o none.vquery"), &["do not match", "corners", "sift"]);
    let of_compact =
        format!("seal images/query-0.png --camera {CAMERA} --profile place.vprofile -o none.vquery");
    refused(scene, &format!("{of_compact} {features}"), &["do not match", "corners", "compact"]);
    scene
        .run(&format!("seal images/query-0.png --camera {CAMERA} --profile place.vprofile -o compact.vquery"))
        .succeeded();
    let run = scene.run("localize --map corners.vmap compact.vquery");
    assert!(run.code == Some(1) && run.stdout.contains("sealed with profile"), "{run}");
    refused(
        scene,
        &format!("{of_compact} --model-file {}", corners("onnx")),
        &["--model-file", "compact has no network"],
    );
    scene.write("cut.onnx", &std::fs::read(corners("onnx")).expect("a network")[..400]);
    refused(
        scene,
        &format!("{seal} {features} --model-file cut.onnx -o none.vquery"),
        &["cut.onnx", "cannot be used"],
    );
    refused(scene, &format!("{seal} {features} --model-file gone.onnx -o none.vquery"), &["gone.onnx"]);
    if cfg!(not(feature = "onnxruntime")) {
        let other = format!("{seal} {features} --engine onnxruntime -o none.vquery");
        refused(scene, &other, &["built without ONNX Runtime"]);
    }
}

/// A projection trained by a user, beside the description: the same pipeline with less than half the bytes per row,
/// incompatible with other descriptors.
#[test]
fn a_projected_network_maps_seals_and_localizes() {
    let scene = scene();
    let features = format!("--features {}", corners("toml").replace("corners.toml", "corners-compact.toml"));
    for (name, features) in [("wide", format!("--features {}", corners("toml"))), ("small", features.clone())]
    {
        let build = "map build --posed posed --images images --list map.txt";
        scene.run(&format!("{build} {features} -o {name}.vmap")).succeeded();
        scene.run(&format!("map profile {name}.vmap -o {name}.vprofile")).succeeded();
        let seal = format!("seal images/query-0.png --camera {CAMERA} --profile {name}.vprofile");
        scene.run(&format!("{seal} {features} -o {name}.vquery")).succeeded();
        let found = scene.run(&format!("localize --map {name}.vmap {name}.vquery --json")).succeeded().json();
        assert!(found["queries"][0]["cam_from_world"].is_object(), "{found}");
    }
    let info = scene.run("map info small.vmap --json").succeeded().json();
    assert!(info.to_string().contains("corners-compact"), "{info}");
    let (wide, small) = (scene.read("wide.vquery").len(), scene.read("small.vquery").len());
    assert!(small < wide * 3 / 4, "{small} of {wide} bytes");
    // Neither accepts the other's.
    let run = scene.run("localize --map wide.vmap small.vquery");
    assert!(run.code == Some(1) && run.stdout.contains("sealed with profile"), "{run}");
    let seal = format!("seal images/query-0.png --camera {CAMERA} --profile wide.vprofile -o none.vquery");
    refused(scene, &format!("{seal} {features}"), &["do not match", "corners", "corners-compact"]);
}

/// A map with global descriptors of whole images: sealing requires consent to exactly this model.
#[test]
fn l14_whole_image_descriptor_needs_consent() {
    let scene = scene();
    let file =
        format!("{}/../device/features/tests/data/learned/corner-map.toml", env!("CARGO_MANIFEST_DIR"));
    let build =
        format!("map build --posed posed --images images --list map.txt --global {file} -o whole.vmap");
    scene.run(&build).succeeded();
    scene.run("map profile whole.vmap -o whole.vprofile").succeeded();
    let info = scene.run("map info whole.vmap --json").succeeded().json();
    assert!(info.to_string().contains("corner-map"), "{info}");
    let seal = format!("seal images/query-0.png --camera {CAMERA} --profile");
    let whole = format!("{seal} whole.vprofile");
    refused(
        scene,
        &format!("{whole} -o none.vquery"),
        &["global descriptor of the image (corner-map, 720 numbers)", "--image-global corner-map", "L14"],
    );
    refused(scene, &format!("{whole} --image-global vlad -o none.vquery"), &["do not match"]);
    refused(scene, &format!("{whole} --image-global gem -o none.vquery"), &["\"gem\"", "xfeat-netvlad"]);
    let run = scene.run(&format!("{whole} --image-global {file} --json -o whole.vquery")).succeeded();
    assert!(run.stderr.contains("reveals more than the local descriptors"), "{run}");
    assert!(run.stderr.contains("as dcl with corner-map of the image"), "{run}");
    let document = run.json();
    assert_eq!(document["images"][0]["image_global"], "corner-map", "{document}");
    let tables = common::documented::tables();
    assert_eq!(common::documented::mistakes(&tables["seal"], &[document]), [""; 0]);
    let found = scene.run("localize --map whole.vmap whole.vquery --json").succeeded().json();
    assert!(found["queries"][0]["cam_from_world"].is_object(), "{found}");

    // The user's own out-of-map images need no consent.
    let out_of_map = "eval scene --map whole.vmap --conditions negatives --negatives images --schemes dcl";
    refused(scene, out_of_map, &["corner-map"]);
    let negatives = scene.run(&format!("{out_of_map} --global {file} --json")).succeeded().json();
    assert!(negatives["schemes"][0]["queries"].as_u64() > Some(0), "{negatives}");

    // A map without such a descriptor gets none, regardless of consent.
    let run = scene.run(&format!("{seal} place.vprofile --image-global {file} -o rows.vquery")).succeeded();
    assert!(run.stderr.contains("none is sent") && !run.stderr.contains("of the image,"), "{run}");
    // Images are added with the map's own model, and with no other.
    scene.run("map remove whole.vmap map-03.png -o less.vmap").succeeded();
    let add = "map add less.vmap --posed posed --images images --list first.txt -o again.vmap";
    scene.write("first.txt", "map-03.png\n");
    let run = scene.run(add);
    assert!(run.code == Some(1) && run.stderr.contains("corner-map"), "{run}");
    scene.run(&format!("{add} --global {file}")).succeeded();
}

/// Compact descriptors, the default, need no file, and the message is a quarter as long; RootSIFT is still available.
#[test]
fn compact_descriptors_are_the_default() {
    let scene = scene();
    let build = "map build --posed posed --images images --list map.txt --features sift -o sift.vmap";
    scene.run(build).succeeded();
    scene.run("map profile sift.vmap -o sift.vprofile").succeeded();
    let seal = format!("seal images/query-0.png --camera {CAMERA} --max-keypoints 512");
    scene.run(&format!("{seal} --profile place.vprofile -o short.vquery")).succeeded();
    scene.run(&format!("{seal} --profile sift.vprofile -o long.vquery")).succeeded();
    let (short, long) = (scene.read("short.vquery").len(), scene.read("long.vquery").len());
    assert!(10 * short < 3 * long, "{short} of {long} bytes");
    for (map, query) in [("place", "short"), ("sift", "long")] {
        let found = scene.run(&format!("localize --map {map}.vmap {query}.vquery --json")).succeeded().json();
        assert_eq!(found["queries"][0]["state"], "trusted", "{found}");
    }
    refused(
        scene,
        &format!("{seal} --profile place.vprofile --features sift -o none.vquery"),
        &["do not match"],
    );
    let run =
        scene.run("map build --posed posed --images images -o x.vmap --features compact --model-file f.onnx");
    assert!(run.code == Some(1) && run.stderr.contains("compact has no network"), "{run}");
}

#[test]
fn models_list_files_and_searched_folders() {
    let scene = scene();
    scene.write("networks/xfeat/xfeat_640x640.onnx", "no network");
    let tables = common::documented::tables();
    let run = |folder: Option<&str>| {
        let mut command = scene.command("models --json");
        match folder {
            Some(folder) => command.env("VEILOC_MODELS", scene.path(folder)),
            None => command.env_remove("VEILOC_MODELS"),
        };
        let out = command.output().expect("it runs");
        let document: serde_json::Value = serde_json::from_slice(&out.stdout).expect("a document");
        document
    };
    let (nowhere, there) = (run(None), run(Some("networks")));
    assert_eq!(common::documented::mistakes(&tables["models"], &[nowhere.clone(), there.clone()]), [""; 0]);
    let names: Vec<&str> =
        there["models"].as_array().expect("a list").iter().filter_map(|m| m["name"].as_str()).collect();
    assert_eq!(names[..4], ["xfeat", "xfeat-compact", "alike", "alike-t"]);
    assert!(names.contains(&"aliked-n16") && names.contains(&"superpoint"), "{names:?}");
    assert!(
        nowhere["models"][0]["file"].is_null() && nowhere["folders"].as_array().expect("a list").is_empty()
    );
    let file = there["models"][0]["file"].as_str().expect("found").to_owned();
    assert!(file.ends_with("xfeat_640x640.onnx"), "{file}");
    assert_eq!(there["models"][1]["file"], there["models"][0]["file"], "one file serves both kinds");
    let text = scene.run("models").succeeded().stdout;
    assert!(text.contains("superpoint") && text.contains("non-commercial"), "{text}");
    assert!(text.contains("python scripts/export_onnx.py"), "the export command is printed: {text}");
    let missing = scene.run("map build --posed posed --images images --features superpoint -o none.vmap");
    assert!(missing.code == Some(1) && missing.stderr.contains("superpoint_v1.onnx"), "{missing}");
    assert!(missing.stderr.contains("VEILOC_MODELS"), "{missing}");
    let missing = scene.run("map build --posed posed --images images --global netvlad -o none.vmap");
    assert!(missing.code == Some(1) && missing.stderr.contains("VGG16-NetVLAD-Pitts30K.onnx"), "{missing}");
}
