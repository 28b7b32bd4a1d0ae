//! `veiloc map export`: the exported files match the map.

use super::common;

use common::scene;
use veiloc_map::colmap::read_model;

#[test]
fn exported_map_has_every_point_and_is_reimported() {
    let scene = scene();
    let map = veiloc_map::MapFile::open(&scene.path("place.vmap")).expect("a map").to_model();
    for (folder, words) in [("binary", ""), ("text", "--text")] {
        scene.run(&format!("map export place.vmap --colmap {folder} {words}")).succeeded();
        let model = read_model(&scene.path(folder)).expect("a model");
        let names: Vec<&str> = map.images.iter().map(|image| image.name.as_str()).collect();
        assert_eq!(model.image_names(), names, "{folder}");
        assert_eq!(model.points().len(), map.points.len(), "{folder}");
        for (written, own) in model.points().iter().zip(&map.points) {
            assert_eq!((written.position, written.track.len()), (own.position, own.track.len()), "{folder}");
        }
        // A keypoint with two orientations is one image position: of its points one is merged with it again.
        let import =
            format!("map import --model {folder} --images images --no-self-test -o {folder}.vmap --json");
        let again = scene.run(&import).succeeded().json();
        let points = again["points"].as_u64().expect("a number") as usize;
        assert_eq!(
            (again["images"].as_u64(), again["cameras"].as_u64()),
            (Some(names.len() as u64), Some(1))
        );
        assert!(10 * points > 9 * map.points.len() && points <= map.points.len(), "{folder}: {points}");
    }
    assert!(scene.path("binary/points3D.bin").exists() && !scene.path("text/points3D.bin").exists());

    // Binary files in the folder would take precedence over text.
    let hidden = scene.run("map export place.vmap --colmap binary --text");
    assert!(hidden.code == Some(1) && hidden.stderr.contains("binary COLMAP model"), "{hidden}");
    assert!(!scene.path("binary/points3D.txt").exists());
}

#[test]
fn a_ply_file_has_every_point() {
    let scene = scene();
    let info = scene.run("map info place.vmap --json").succeeded().json();
    let run = scene.run("map export place.vmap --ply points.ply").succeeded();
    let (file, points) = (scene.read("points.ply"), info["points"].as_u64().expect("a number") as usize);
    let end = b"end_header\n";
    let at = file.windows(end.len()).position(|w| w == end).expect("a header") + end.len();
    let head = std::str::from_utf8(&file[..at]).expect("text");
    assert!(head.starts_with("ply\nformat binary_little_endian 1.0\n"), "{head}");
    assert!(head.contains(&format!("element vertex {points}\n")), "{head} {run}");
    let rows: Vec<&[u8]> = file[at..].chunks(3 * 8 + 4 + 4).collect();
    assert_eq!(rows.len(), points);
    let map = veiloc_map::MapFile::open(&scene.path("place.vmap")).expect("a map").to_model();
    for (row, point) in rows.iter().zip(&map.points) {
        for (axis, value) in point.position.coords.iter().enumerate() {
            assert_eq!(row[8 * axis..8 * axis + 8], value.to_le_bytes());
        }
        assert_eq!(row[24..28], (point.error as f32).to_le_bytes());
        assert_eq!(row[28..], (point.track.len() as u32).to_le_bytes());
    }
}

#[test]
fn invalid_exports_are_refused() {
    let scene = scene();
    let nothing = scene.run("map export place.vmap");
    assert!(nothing.code == Some(2) && nothing.stderr.contains("--colmap"), "{nothing}");
    let text = scene.run("map export place.vmap --ply a.ply --text");
    assert!(text.code == Some(2) && text.stderr.contains("--colmap"), "{text}");
    let none = scene.run("map export none.vmap --ply a.ply");
    assert!(none.code == Some(1) && none.stderr.contains("none.vmap"), "{none}");
    let folder = scene.run("map export place.vmap --ply images");
    assert!(folder.code == Some(1) && folder.stderr.contains("images"), "{folder}");
}
