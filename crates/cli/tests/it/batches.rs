//! Several inputs at once: each has its own result, and folders, lists and `-` are accepted as inputs.

use super::common;

use std::fs;
use std::io::Write as _;
use std::process::Stdio;

use common::{CAMERA, QUERIES, Run, TestScene, keys, scene};
use serde_json::Value;

/// The arguments that seal an image of the scene.
fn seal(what: &str, out: &str) -> String {
    format!("seal {what} --camera {CAMERA} --profile place.vprofile -o {out}")
}

/// Ten images in a folder, two of them broken.
fn write_ten_images(scene: &TestScene, folder: &str) {
    for i in 0..10 {
        scene.write(&format!("{folder}/{i}.png"), scene.read(&format!("images/query-{}.png", i % QUERIES)));
    }
    scene.write(&format!("{folder}/3.png"), "no image");
    let png = scene.read("images/query-0.png");
    scene.write(&format!("{folder}/7.png"), &png[..png.len() / 2]);
}

/// Files of a folder, sorted.
fn names(scene: &TestScene, folder: &str) -> Vec<String> {
    let entries = fs::read_dir(scene.path(folder)).expect("a folder");
    let mut names: Vec<String> =
        entries.map(|e| e.expect("an entry").file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

/// Items of a document with this status.
fn with_status<'a>(items: &'a Value, status: &str) -> Vec<&'a Value> {
    items.as_array().expect("an array").iter().filter(|item| item["status"] == status).collect()
}

#[test]
fn two_bad_images_of_ten_give_eight_queries_and_two_errors() {
    let scene = scene();
    write_ten_images(scene, "ten");
    let run = scene.run(&seal("ten", "ten-sealed"));
    assert_eq!(run.code, Some(1), "{run}");
    assert_eq!(names(scene, "ten-sealed").len(), 8, "{run}");
    for word in
        ["8 of 10 sealed; 2 could not be used", "ten/3.png", "JPEG or PNG", "ten/7.png", "copy it again"]
    {
        assert!(run.stderr.contains(word), "{word}: {run}");
    }

    let run = scene.run(&(seal("ten", "ten-again") + " --skip-bad --json")).succeeded();
    let document = run.json();
    assert_eq!(keys(&document), ["failed", "images", "scheme", "sealed", "version"]);
    assert_eq!((&document["sealed"], &document["failed"]), (&8.into(), &2.into()));
    let failed = with_status(&document["images"], "failed");
    assert_eq!(
        failed.iter().map(|f| f["file"].as_str()).collect::<Vec<_>>(),
        [Some("ten/3.png"), Some("ten/7.png")]
    );
    assert!(failed.iter().all(|f| f["error"]["kind"] == "damaged" && f.get("out").is_none()), "{run}");
    for sealed in with_status(&document["images"], "sealed") {
        let out = sealed["out"].as_str().expect("a file");
        assert_eq!(sealed["bytes"], scene.read(out).len(), "{run}");
    }
}

#[test]
fn two_bad_queries_of_ten_give_eight_poses_and_two_errors() {
    let scene = scene();
    let images: Vec<String> = (0..QUERIES).map(|i| format!("images/query-{i}.png")).collect();
    scene.run(&seal(&images.join(" "), "sound")).succeeded();
    for i in 0..10 {
        scene.write(
            &format!("queries/{i}.vquery"),
            scene.read(&format!("sound/query-{}.vquery", i % QUERIES)),
        );
    }
    scene.write("queries/3.vquery", "no query");
    fs::remove_file(scene.path("queries/7.vquery")).expect("removed");
    let files: Vec<String> = (0..10).map(|i| format!("queries/{i}.vquery")).collect();

    let run = scene.run(&format!("localize --map place.vmap {}", files.join(" ")));
    assert_eq!(run.code, Some(1), "{run}");
    assert_eq!(run.stdout.lines().count(), 8, "{run}");
    let reported = run.stderr.find("1 of 10 cannot be read").expect("missing inputs are named");
    let ended = run.stderr.find("8 of 10 localized; 2 could not be used").expect("a summary");
    assert!(reported < ended && run.stderr[reported..ended].contains("queries/7.vquery"), "{run}");
    assert!(
        run.stderr[ended..].contains("queries/3.vquery") && run.stderr[ended..].contains("veiloc seal"),
        "{run}"
    );

    let run =
        scene.run(&format!("localize --map place.vmap --skip-bad --json {}", files.join(" "))).succeeded();
    let document = run.json();
    let poses = document["trusted"].as_u64().zip(document["doubtful"].as_u64()).map(|(a, b)| a + b);
    assert_eq!((poses, &document["failed"]), (Some(8), &2.into()));
    let queries = &document["queries"];
    assert_eq!(queries.as_array().map(Vec::len), Some(10), "results are in the given order");
    let with_pose = queries.as_array().expect("an array").iter().filter(|q| q["cam_from_world"].is_object());
    assert_eq!(with_pose.count(), 8, "{run}");
    assert_eq!(
        (&queries[3]["error"]["kind"], &queries[7]["error"]["kind"]),
        (&"damaged".into(), &"missing".into())
    );

    // A folder stands for its files, sorted; if no input is usable, the command fails even with --skip-bad.
    let run = scene.run("localize --map place.vmap queries --skip-bad --quiet").succeeded();
    let first: Vec<&str> = run.stdout.lines().filter_map(|line| line.split_whitespace().next()).collect();
    let sound = [0, 1, 2, 4, 5, 6, 8, 9].map(|i| format!("queries/{i}.vquery"));
    assert_eq!(first, sound, "{run}");
    let run = scene.run("localize --map place.vmap queries/3.vquery queries/7.vquery --skip-bad");
    assert_eq!((run.code, run.stdout.as_str()), (Some(1), ""), "{run}");
}

#[test]
fn sub_folders_are_preserved_and_names_do_not_collide() {
    let scene = scene();
    let png = scene.read("images/query-0.png");
    for camera in ["camA", "camB"] {
        scene.write(&format!("rig/{camera}/0001.png"), &png);
    }
    scene.run(&seal("rig", "rig-sealed")).succeeded();
    scene.run(&seal("rig/camA rig/camB", "cameras-sealed")).succeeded();
    for folder in ["rig-sealed", "cameras-sealed"] {
        assert_eq!(names(scene, folder), ["camA", "camB"]);
        assert_eq!(names(scene, &format!("{folder}/camB")), ["0001.vquery"]);
    }
    let run = scene.run(&seal("rig/camA/0001.png rig/camB/0001.png", "loose"));
    assert!(run.code == Some(1) && run.stderr.contains("parent folder"), "{run}");
    assert!(!scene.path("loose").exists(), "refused before the work");

    // One image is written into an existing folder, or into a path that ends in `/`.
    scene.run(&seal("images/query-0.png", "cameras-sealed")).succeeded();
    assert!(scene.path("cameras-sealed/query-0.vquery").is_file());
    scene.run(&seal("images/query-0.png", "new/folder/")).succeeded();
    assert!(scene.path("new/folder/query-0.vquery").is_file());
}

#[test]
fn dash_means_stdin_and_stdout() {
    let scene = scene();
    let out = scene.command(&seal("images/query-0.png", "-")).output().expect("runs");
    assert!(out.status.success());
    scene.write("from-stdout.vquery", &out.stdout);
    let by_file = scene.run("localize --map place.vmap --json from-stdout.vquery").succeeded().json();
    let mut child =
        scene.command("localize --map place.vmap --json -").stdin(Stdio::piped()).spawn().expect("runs");
    child.stdin.take().expect("a pipe").write_all(&out.stdout).expect("written");
    let answer = child.wait_with_output().expect("ended");
    let by_pipe: Value = serde_json::from_slice(&answer.stdout).expect("a document");
    assert_eq!(by_pipe["queries"][0]["file"], "-");
    assert_eq!(by_pipe["queries"][0]["cam_from_world"], by_file["queries"][0]["cam_from_world"]);
    assert!(by_pipe["queries"][0]["cam_from_world"].is_object());
    assert!(!scene.path("-").exists());

    let refused = |arguments: &str, word: &str| {
        let run = scene.run(arguments);
        assert!(run.code == Some(1) && run.stdout.is_empty() && run.stderr.contains(word), "{run}");
    };
    refused(&seal("images/query-0.png images/query-1.png", "-"), "one sealed query");
    refused(&(seal("images/query-0.png", "-") + " --json"), "one sealed query");
    refused("localize --map place.vmap - -", "given twice");
    refused("map profile place.vmap -o -", "./-");
}

#[test]
fn lists_may_have_cameras() {
    let scene = scene();
    let with_spaces = CAMERA.replace(',', " ");
    let list = |lines: &[String]| scene.write("seal.txt", lines.join("\n"));
    let seal = |more: &str, out: &str| {
        scene.run(&format!("seal images --list seal.txt --profile place.vprofile -o {out} {more}"))
    };
    let refused = |run: Run, words: &[&str]| {
        assert!(
            run.code == Some(1) && words.iter().all(|word| run.stderr.contains(word)),
            "{words:?}: {run}"
        );
    };
    list(&[format!("query-0.png {with_spaces}"), format!("query-1.png {with_spaces}")]);
    seal("", "listed").succeeded();
    assert_eq!(names(scene, "listed"), ["query-0.vquery", "query-1.vquery"]);
    let document = scene.run("localize --map place.vmap listed --json").succeeded().json();
    assert_eq!(document["trusted"], 2);
    refused(seal(&format!("--camera {CAMERA}"), "listed"), &["seal.txt: line 1", "leave out --camera"]);

    list(&["query-0.png".to_owned(), "no-such.png".to_owned()]);
    refused(seal("", "named"), &["query-0.png", "has no EXIF", "--camera unknown"]);
    let run = seal(&format!("--camera {CAMERA} --skip-bad"), "named").succeeded();
    assert!(run.stderr.contains("images/no-such.png") && run.stderr.contains("1 of 2 sealed"), "{run}");
    // The camera in hloc's form, or in COLMAP's.
    for camera in ["posed/cameras.txt", "posed"] {
        seal(&format!("--camera {camera} --skip-bad"), "named").succeeded();
    }
    let one =
        ["seal", "images/query-0.png", "--profile", "place.vprofile", "-o", "spaces.vquery", "--camera"];
    let out = scene.command("").args(one).arg(&with_spaces).output().expect("runs");
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));

    // A wrong camera in the list affects only its own image.
    list(&["query-0.png PINHOLE 640 480 500 500 320 240".to_owned()]);
    refused(seal("", "wrong"), &["query-0.png", "400x300", "640x480"]);
    list(&["../images/query-0.png PINHOLE 640 480 500 500 320 240".to_owned()]);
    refused(seal("", "wrong"), &["leads out of images"]);
    list(&[format!("query-0.png {}", with_spaces.replace("SIMPLE_RADIAL", "SPHERICAL"))]);
    refused(seal("", "wrong"), &["seal.txt: line 1", "SPHERICAL"]);
}

#[test]
fn images_of_other_formats_in_a_folder_are_counted() {
    let scene = scene();
    scene.write("phone/1.png", scene.read("images/query-0.png"));
    for name in ["2.avif", "3.AVIF", "4.tif"] {
        scene.write(&format!("phone/{name}"), "no matter");
    }
    let run = scene.run(&seal("phone", "phone-sealed")).succeeded();
    assert!(run.stderr.contains("phone: 2 AVIF files and 1 TIFF file left out"), "{run}");
    assert_eq!(names(scene, "phone-sealed"), ["1.vquery"]);
    fs::remove_file(scene.path("phone/1.png")).expect("removed");
    let run = scene.run(&seal("phone", "phone-sealed"));
    assert!(
        run.code == Some(1) && run.stderr.contains("no JPEG, PNG, WebP or HEIC file, but 2 AVIF files"),
        "{run}"
    );
}

#[test]
fn equal_errors_of_many_images_share_one_line() {
    let scene = scene();
    for i in 0..3 {
        scene.write(&format!("plain/{i}.png"), scene.read("images/query-0.png"));
    }
    let run = scene.run("seal plain --profile place.vprofile -o plain-sealed");
    assert_eq!(run.code, Some(1), "{run}");
    assert_eq!(run.stderr.matches("no EXIF").count(), 1, "{run}");
    assert!(
        run.stderr.contains("plain/0.png") && run.stderr.contains("also 2 others: plain/1.png, plain/2.png"),
        "{run}"
    );
}

#[test]
fn keypoints_of_folders_have_distinct_names() {
    let scene = scene();
    let png = scene.read("images/query-0.png");
    for camera in ["camA", "camB"] {
        scene.write(&format!("rig-2/{camera}/0001.png"), &png);
    }
    let run = scene.run("eval keypoints rig-2 --max-keypoints 64 -o - --quiet").succeeded();
    let names: Vec<Value> = run
        .stdout
        .lines()
        .map(|line| serde_json::from_str::<Value>(line).expect("an object")["name"].clone())
        .collect();
    assert_eq!(names, ["camA/0001.png", "camB/0001.png"]);
    let run = scene.run("eval keypoints rig-2 no-1.png no-2.png -o no.jsonl");
    assert!(
        run.code == Some(1) && run.stderr.contains("no-1.png") && run.stderr.contains("no-2.png"),
        "{run}"
    );
}
