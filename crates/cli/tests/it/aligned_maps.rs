//! Maps in another coordinate frame: `map align` and `map merge`.

use super::common;

use common::{CAMERA, EXTRACTION, POSITION_TOLERANCE, Run, TestScene, pose, scene};
use serde_json::Value;
use veiloc_geometry::nalgebra::{Rotation3, Vector3};
use veiloc_mapping::Similarity3;

/// A frame that has nothing in common with that of the scene.
fn gauge() -> Similarity3 {
    Similarity3 {
        scale: 2.3,
        rotation: Rotation3::from_scaled_axis(Vector3::new(0.2, 1.0, 0.4)),
        translation: Vector3::new(5.0, -3.0, 7.0),
    }
}

/// Aligns a map to the true camera centres in a frame; one of them is wrong.
fn align(scene: &TestScene, map: &str, out: &str, to: &Similarity3) -> Run {
    let mut lines = vec!["# name, x, y, z".to_owned(), "unknown.png, 1, 2, 3".to_owned()];
    for (index, (name, pose)) in scene.poses.iter().filter(|(name, _)| name.starts_with("map")).enumerate() {
        let mut c = to.transform(&pose.center().coords);
        c.x += if index == 2 { 3.0 } else { 0.0 };
        lines.push(format!("{name}, {}, {}, {}", c.x, c.y, c.z));
    }
    scene.write("known.csv", lines.join("\n"));
    scene
        .run(&format!(
            "map align {map} --positions known.csv --known-down none --no-self-test -o {out} --json"
        ))
        .succeeded()
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or(f64::NAN)
}

/// Distance of a localized query from its true centre in a frame.
fn query_error(scene: &TestScene, map: &str, frame: &Similarity3) -> f64 {
    scene.run(&format!("map profile {map} -o {map}.vprofile")).succeeded();
    let seal = format!("seal images/query-1.png --camera {CAMERA} --profile {map}.vprofile -o {map}.vquery");
    scene.run(&seal).succeeded();
    let run = scene.run(&format!("localize --map {map} {map}.vquery --json"));
    let pose = pose(&run.json()["queries"][0]["cam_from_world"]);
    let truth = frame.transform(&scene.pose_of("query-1.png").center().coords);
    (pose.center().coords - truth).norm()
}

#[test]
fn map_is_aligned_to_positions_and_back_to_another_map() {
    let scene = scene();
    let run = align(scene, "place.vmap", "gauge.vmap", &gauge());
    assert!(run.stderr.contains("1 names are not in the map, the first is unknown.png"), "{run}");
    let alignment = &run.json()["alignment"];
    assert!((number(&alignment["scale"]) - 2.3).abs() < 1e-9, "{alignment}");
    let unused = alignment["positions"].as_array().into_iter().flatten().filter(|p| p["used"] == false);
    assert_eq!(unused.map(|p| p["name"].clone()).collect::<Vec<_>>(), ["map-02.png"]);
    assert!(number(&alignment["rms"]) < 1e-9, "{alignment}");
    let error = query_error(scene, "gauge.vmap", &gauge());
    assert!(error < gauge().scale * POSITION_TOLERANCE, "{error}");

    let back =
        scene.run("map align gauge.vmap --to-map place.vmap --no-self-test -o back.vmap --json").succeeded();
    let alignment = &back.json()["alignment"];
    assert!((number(&alignment["scale"]) * 2.3 - 1.0).abs() < 0.01, "{alignment}");
    let error = query_error(scene, "back.vmap", &Similarity3::identity());
    assert!(error < POSITION_TOLERANCE, "{error}");
}

#[test]
fn map_is_leveled_by_its_images_and_keeps_its_gravity() {
    let scene = scene();
    align(scene, "place.vmap", "tilted.vmap", &gauge());
    let run = scene.run("map align tilted.vmap --level --no-self-test -o level.vmap --json").succeeded();
    assert!(run.stderr.contains("Gravity by the images"), "{run}");
    // Down of the rendered room is −z; its cameras are level up to some degrees.
    let rotation = &run.json()["alignment"]["rotation"];
    let row =
        |i: usize| Vector3::new(number(&rotation[i][0]), number(&rotation[i][1]), number(&rotation[i][2]));
    let down = gauge().rotation * -Vector3::z();
    let found = Vector3::new(row(0).dot(&down), row(1).dot(&down), row(2).dot(&down));
    assert!(found.angle(&-Vector3::z()).to_degrees() < 5.0, "{found}");

    let known = gauge().rotation * Vector3::new(0.0, 0.6, -0.8);
    let down = format!("{},{},{}", known.x, known.y, known.z);
    let run =
        scene.run(&format!("map align tilted.vmap --level --down {down} --no-self-test --json")).succeeded();
    assert!(!run.stderr.contains("Gravity by the images"), "{run}");
}

#[test]
fn halves_with_other_gauges_are_merged() {
    let scene = scene();
    let names = |range: std::ops::Range<usize>| {
        range.map(|i| format!("map-{i:02}.png")).collect::<Vec<_>>().join(" ")
    };
    for (map, without) in [("first.vmap", names(6..10)), ("second.vmap", names(0..6))] {
        scene.write(map, scene.read("place.vmap"));
        scene.run(&format!("map remove {map} {without} --no-self-test")).succeeded();
    }
    align(scene, "second.vmap", "second.vmap", &gauge());
    let run = scene
        .run("map merge first.vmap second.vmap --prefix day-2/ --no-self-test -o whole.vmap --json")
        .succeeded();
    let document = run.json();
    assert_eq!(document["images"], 10, "{document}");
    assert_eq!(document["warnings"], serde_json::json!([]), "the halves fit");
    assert!((number(&document["alignment"]["scale"]) * 2.3 - 1.0).abs() < 0.02, "{document}");
    let whole = scene.run("map info whole.vmap --json").json();
    let half = scene.run("map info first.vmap --json").json();
    assert!(number(&whole["points"]) > 1.2 * number(&half["points"]), "points of both: {whole}");
    let error = query_error(scene, "whole.vmap", &Similarity3::identity());
    assert!(error < POSITION_TOLERANCE, "{error}");

    // Two images cannot confirm a transform in the other direction.
    for (map, without) in [("two.vmap", names(2..10)), ("eight.vmap", names(0..2))] {
        scene.run(&format!("map remove place.vmap {without} --no-self-test -o {map}")).succeeded();
    }
    let loose = "map merge two.vmap eight.vmap --no-self-test -o loose.vmap";
    let refused = scene.run(loose);
    assert!(refused.code == Some(1) && refused.stderr.contains("--keep-loose"), "{refused}");
    assert!(!scene.path("loose.vmap").exists());
    let kept = scene.run(&format!("{loose} --keep-loose --json")).succeeded().json();
    assert!(kept["warnings"][0]["name"] == "loose-merge" && scene.path("loose.vmap").exists(), "{kept}");

    let twice = scene.run("map merge whole.vmap first.vmap --no-self-test");
    assert!(twice.code == Some(1) && twice.stderr.contains("map-00.png"), "{twice}");
}

#[test]
fn places_without_a_common_part_are_not_merged() {
    let scene = scene();
    common::render_out_of_map_images(12);
    let build = format!(
        "map build --posed other/posed --images other/images -o other.vmap --no-self-test {}",
        EXTRACTION.join(" ")
    );
    scene.run(&build).succeeded();
    let before = scene.read("place.vmap");
    for command in ["map merge place.vmap other.vmap", "map align place.vmap --to-map other.vmap"] {
        let run = scene.run(command);
        assert!(run.code == Some(1) && run.stderr.contains("must show a common part"), "{run}");
    }
    assert_eq!(scene.read("place.vmap"), before, "unchanged");
    let line = scene.run("map align place.vmap --positions nothing.csv");
    assert!(line.code == Some(1) && line.stderr.contains("nothing.csv"), "{line}");
}

#[test]
fn page_of_a_map_names_its_weak_parts() {
    let scene = scene();
    // Few images are left, so most points are observed by few.
    scene.write("weak.vmap", scene.read("place.vmap"));
    scene.run("map remove weak.vmap map-01.png map-02.png map-03.png map-04.png --no-self-test").succeeded();
    let run = scene.run("map view weak.vmap -o weak.html").succeeded();
    let advice = "points are observed by three images or fewer";
    assert!(run.stderr.contains(advice), "{run}");
    let page = String::from_utf8(scene.read("weak.html")).expect("text");
    assert!(page.contains(advice) && page.contains("data-part=\"canvas\""));
    assert!(page.contains("map-00.png") && page.contains("trusted from dcl"), "the images and their states");

    assert!(page.contains("Where a camera is localized") && page.contains("class=\"heat h0\""));
    assert!(page.contains("map units") && !page.contains(" cm<"), "its unit is not known");

    let run = scene.run("map view place.vmap --test-images 0 -o place.html").succeeded();
    assert!(!run.stderr.contains("no trusted pose"), "{run}");
}

#[test]
fn lengths_are_metres_only_if_the_map_knows() {
    let scene = scene();
    let text = |map: &str| {
        scene.run(&format!("map profile {map} -o {map}.vprofile")).succeeded();
        let seal =
            format!("seal images/query-1.png --camera {CAMERA} --profile {map}.vprofile -o {map}.vquery");
        scene.run(&seal).succeeded();
        scene.run(&format!("localize --map {map} {map}.vquery")).stdout
    };
    let is_metric = |run: &Run| run.json()["is_metric"].clone();
    assert_eq!(is_metric(&scene.run("map info place.vmap --json")), false);
    assert!(text("place.vmap").contains(" units  "), "{}", text("place.vmap"));
    let info = scene.run("map info place.vmap").succeeded();
    assert!(
        info.stdout.contains("lengths are in units") && info.stdout.contains("Median error: units"),
        "{info}"
    );

    let mut lines = Vec::new();
    for (name, pose) in &scene.poses {
        let c = pose.center().coords;
        lines.push(format!("{name}, {}, {}, {}\n", c.x, c.y, c.z));
    }
    scene.write("metres.csv", lines.concat());
    let run =
        scene.run("map align place.vmap --positions metres.csv --metres -o metric.vmap --json").succeeded();
    assert_eq!(is_metric(&run), true);
    assert!(text("metric.vmap").contains(" m  "), "{}", text("metric.vmap"));
    let info = scene.run("map info metric.vmap").succeeded();
    assert!(
        info.stdout.contains("unit        metres") && info.stdout.contains("Median error: m, degrees"),
        "{info}"
    );
    scene.run("map view metric.vmap -o metric.html").succeeded();
    let page = String::from_utf8(scene.read("metric.html")).expect("text");
    assert!(page.contains("\"metres\":true") && !page.contains("map units"), "m, cm or mm");

    // It is kept by changes and by a compressed copy, and taken over from another map.
    scene.run("map remove metric.vmap map-03.png --no-self-test -o fewer.vmap").succeeded();
    scene.run("map compress metric.vmap -o small.vmap").succeeded();
    for map in ["fewer.vmap", "small.vmap"] {
        assert_eq!(is_metric(&scene.run(&format!("map info {map} --json"))), true, "{map}");
    }
    align(scene, "place.vmap", "other-gauge.vmap", &gauge());
    let run = scene.run("map align other-gauge.vmap --to-map metric.vmap --no-self-test --json").succeeded();
    assert_eq!(is_metric(&run), true);

    let run = scene.run("map build --images images --metres -o none.vmap");
    assert!(run.code == Some(1) && run.stderr.contains("map align"), "{run}");
}

#[test]
fn a_fit_that_is_not_to_be_believed_is_refused() {
    let scene = scene();
    let line = |f: &dyn Fn(usize, Vector3<f64>) -> Vector3<f64>| {
        let known = scene.poses.iter().filter(|(name, _)| name.starts_with("map")).enumerate();
        let lines = known.map(|(i, (name, pose))| {
            let c = f(i, pose.center().coords);
            format!("{name}, {}, {}, {}\n", c.x, c.y, c.z)
        });
        lines.collect::<String>()
    };
    let first = scene.poses[0].1.center().coords;
    for (what, content, reason) in [
        ("frozen", line(&|i, c| if i < 7 { first } else { c }), "repeat others"),
        ("degrees", line(&|_, c| c * 1e-5), "degrees"),
        ("mirrored", line(&|_, c| Vector3::new(c.x, -c.y, c.z)), "mirrored"),
        ("upside down", line(&|_, c| Vector3::new(c.x, -c.y, -c.z)), "up by the images"),
    ] {
        scene.write("wrong.csv", content);
        let command = "map align place.vmap --positions wrong.csv --metres --no-self-test -o wrong.vmap";
        let run = scene.run(command);
        assert!(run.code == Some(1) && run.stderr.contains(reason), "{what}: {run}");
        assert!(run.stderr.contains("--accept-fit") && !scene.path("wrong.vmap").exists(), "{what}: {run}");
        let accepted = scene.run(&format!("{command} --accept-fit")).succeeded();
        assert!(accepted.stderr.contains(reason), "{what}: {accepted}");
        std::fs::remove_file(scene.path("wrong.vmap")).expect("written");
    }

    // A right one is kept with its ±, and knows where down is.
    scene.write("right.csv", line(&|_, c| 2.0 * c));
    let run = scene
        .run("map align place.vmap --positions right.csv --metres --no-self-test -o right.vmap")
        .succeeded();
    assert!(run.stderr.contains("scale ±") && run.stderr.contains("up ±"), "{run}");
    let info = scene.run("map info right.vmap --json").json();
    assert!(number(&info["accuracy"]["scale"]) < 1e-6, "{info}");
    assert_eq!(info["down"], serde_json::json!([0.0, 0.0, -1.0]), "{info}");
    assert!(scene.run("map info right.vmap").stdout.contains("aligned     scale ±"));
    // The fit to another map has a ±, too; leveling keeps that of the scale.
    scene.run("map align right.vmap --to-map place.vmap --no-self-test -o back.vmap").succeeded();
    let info = scene.run("map info back.vmap --json").json();
    let scale = number(&info["accuracy"]["scale"]);
    assert!(scale > 0.0 && scale < 0.05, "{info}");
    scene.run("map align back.vmap --level --down 0,0,-1 --no-self-test -o level.vmap").succeeded();
    assert_eq!(scene.run("map info level.vmap --json").json()["accuracy"]["scale"], scale);

    // Two maps that know different directions of gravity.
    let build =
        "map build --posed posed --images images --list map.txt --down 0,1,0 --no-self-test -o sideways.vmap";
    scene.run(&format!("{build} {}", EXTRACTION.join(" "))).succeeded();
    let run = scene.run("map align right.vmap --to-map sideways.vmap --no-self-test -o wrong.vmap");
    assert!(run.code == Some(1) && run.stderr.contains("90° apart"), "{run}");
    assert!(!scene.path("wrong.vmap").exists());
}

/// Content anchors keep their places in the world while the map is aligned, merged, compressed, changed and replaced.
#[test]
fn content_anchors_stay_with_their_map() {
    let scene = scene();
    let turn = [0.8, 0.0, 0.0, 0.6];
    let places = [("board", [0.4, -0.3, 1.1]), ("cup", [-0.7, 0.5, 0.4])];
    let document = |names: &[(&str, [f64; 3])]| {
        let anchor = |(name, t): &(&str, [f64; 3])| serde_json::json!({"name": name, "map_from_anchor": {"q": turn, "t": t}, "content": {"of": name}, "owner": "ann"});
        serde_json::json!({"version": 1, "anchors": names.iter().map(anchor).collect::<Vec<_>>()}).to_string()
    };
    let import = |map: &str, names: &[(&str, [f64; 3])]| {
        scene.write("anchors.json", document(names));
        scene.run(&format!("map anchors {map} --import anchors.json")).succeeded();
    };
    let listed =
        |map: &str| scene.run(&format!("map anchors {map} --json")).succeeded().json()["anchors"].clone();
    // The largest distance from where the places are in a frame, over its scale, and angle in degrees.
    let errors = |map: &str, frame: &Similarity3| {
        let mut worst = (0.0_f64, 0.0_f64);
        for anchor in listed(map).as_array().expect("anchors") {
            let (_, t) = places.iter().find(|(name, _)| anchor["name"] == *name).expect("its place");
            let (q, at) = (&anchor["map_from_anchor"]["q"], &anchor["map_from_anchor"]["t"]);
            let found = Vector3::new(number(&at[0]), number(&at[1]), number(&at[2]));
            let off = (found - frame.transform(&Vector3::from(*t))).norm() / frame.scale;
            // By the direction of an axis of the content that its own rotation, about z by 73.74°, moves.
            let [w, x, y, z] = [0, 1, 2, 3].map(|i| number(&q[i]));
            let axis =
                Vector3::new(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y));
            let expected = frame.rotation * Vector3::new(0.28, 0.96, 0.0);
            worst = (worst.0.max(off), worst.1.max(axis.angle(&expected).to_degrees()));
            assert_eq!((&anchor["owner"], &anchor["content"]["of"]), (&"ann".into(), &anchor["name"]));
        }
        worst
    };
    let world = Similarity3::identity();
    let names = |range: std::ops::Range<usize>| {
        range.map(|i| format!("map-{i:02}.png")).collect::<Vec<_>>().join(" ")
    };
    for (map, without, own) in
        [("with-anchors-a.vmap", names(6..10), 0..1), ("with-anchors-b.vmap", names(0..6), 1..2)]
    {
        scene.run(&format!("map remove place.vmap {without} --no-self-test -o {map}")).succeeded();
        import(map, &places[own]);
    }
    // Aligned: by the exact transform that the map got.
    align(scene, "with-anchors-b.vmap", "with-anchors-b.vmap", &gauge());
    let (off, angle) = errors("with-anchors-b.vmap", &gauge());
    assert!(off < 1e-9 && angle < 1e-6, "{off} {angle}");

    // Merged: those of the second map by the transform of the merge; those of the first stay to the bit.
    scene.run("map merge with-anchors-a.vmap with-anchors-b.vmap --prefix day-2/ --no-self-test -o with-anchors-whole.vmap").succeeded();
    assert_eq!(listed("with-anchors-whole.vmap")[0], listed("with-anchors-a.vmap")[0]);
    let (off, angle) = errors("with-anchors-whole.vmap", &world);
    assert!(
        listed("with-anchors-whole.vmap").as_array().is_some_and(|all| all.len() == 2),
        "{}",
        listed("with-anchors-whole.vmap")
    );
    assert!(off < POSITION_TOLERANCE && angle < 1.0, "{off} {angle}");
    let before = listed("with-anchors-whole.vmap");
    import("with-anchors-b.vmap", &places[..1]);
    scene
        .run("map merge with-anchors-a.vmap with-anchors-b.vmap --prefix x/ --no-self-test")
        .refused(&["same name", "--import"]);

    // In the same coordinate frame: unchanged.
    scene.run(&format!("map remove with-anchors-whole.vmap {} --no-self-test", names(0..1))).succeeded();
    scene
        .run("map compress with-anchors-whole.vmap --ratio 2 --no-self-test -o with-anchors-small.vmap")
        .succeeded();
    assert_eq!((&listed("with-anchors-whole.vmap"), &listed("with-anchors-small.vmap")), (&before, &before));
    scene
        .run("map compress with-anchors-whole.vmap --ratio 3 --no-self-test -o with-anchors-b.vmap")
        .refused(&["both have content anchors"]);

    // Replaced by a map in another frame: kept, not used, and carried by common images, or by localizing the old ones.
    let again = |map: &str| scene.write(map, scene.read("with-anchors-gauge.vmap"));
    align(scene, "place.vmap", "with-anchors-gauge.vmap", &gauge());
    scene.write("with-anchors-old.vmap", scene.read("with-anchors-whole.vmap"));
    again("with-anchors-whole.vmap");
    scene
        .run("map remove with-anchors-whole.vmap map-09.png --no-self-test")
        .refused(&["another coordinate frame", "--carry"]);
    scene
        .run("map anchors with-anchors-whole.vmap --import with-anchors-whole.anchors.json")
        .refused(&["another coordinate frame"]);
    let stale = scene.read("with-anchors-whole.anchors.json");
    let run = scene.run("map anchors with-anchors-whole.vmap --carry").succeeded();
    assert!(run.stderr.contains("images agree"), "{run}");
    let (off, angle) = errors("with-anchors-whole.vmap", &gauge());
    assert!(off < POSITION_TOLERANCE && angle < 1.0, "{off} {angle}");
    scene.run("map anchors with-anchors-whole.vmap --carry").succeeded();
    scene.write("with-anchors-whole.anchors.json", stale);
    scene
        .run("map anchors with-anchors-whole.vmap --carry-from with-anchors-gauge.vmap")
        .refused(&["another coordinate frame"]);
    scene.run("map anchors with-anchors-whole.vmap --carry-from with-anchors-old.vmap").succeeded();
    let (off, angle) = errors("with-anchors-whole.vmap", &gauge());
    assert!(off < POSITION_TOLERANCE && angle < 1.0, "{off} {angle}");

    // A far anchor magnifies the uncertainty of the rotation: refused, whatever the images say.
    import("with-anchors-old.vmap", &[("board", [4000.0, 0.0, 0.0])]);
    again("with-anchors-new.vmap");
    let refused = scene
        .run("map anchors with-anchors-new.vmap --carry-from with-anchors-old.vmap")
        .refused(&["not to be believed", "an anchor"]);
    assert!(!scene.path("with-anchors-new.anchors.json").exists(), "{refused}");
    import("with-anchors-old.vmap", &[]);
    assert!(!scene.path("with-anchors-old.anchors.json").exists());
    for (text, words) in [("", "line 1"), ("{\"version\":2,\"anchors\":[]}", "version 2")] {
        scene.write("anchors.json", text);
        scene.run("map anchors with-anchors-old.vmap --import anchors.json").refused(&[words]);
    }
}
