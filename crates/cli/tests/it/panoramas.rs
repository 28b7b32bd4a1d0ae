//! `veiloc seal --panorama`: a panorama is a rig of sealed queries, which gives one pose.

use super::common;

use common::{POSITION_TOLERANCE, TestScene, pose, scene};
use veiloc_geometry::{CameraFromWorld, Panorama, RigFromWorld};
use veiloc_synthetic::{RenderOptions, RenderedRoom};

/// A panorama from where a query was taken, its middle where the query looks.
fn panorama(scene: &TestScene, query: &str) {
    let pose = scene.pose_of(query);
    let rig_from_world = RigFromWorld::new(*pose.rotation(), *pose.translation());
    let size = Panorama::new(2048, 1024).expect("2:1");
    let image =
        RenderedRoom::generate(11).render_panorama(&rig_from_world, size, &RenderOptions::with_seed(70));
    std::fs::create_dir_all(scene.path("panoramas")).expect("folder");
    image.save(scene.path("panoramas/round.jpg")).expect("written");
}

/// The file with what 360° cameras write.
fn marked(jpeg: &[u8]) -> Vec<u8> {
    let xmp = b"http://ns.adobe.com/xap/1.0/\0<x:xmpmeta><rdf:Description GPano:ProjectionType=\"equirectangular\"/></x:xmpmeta>";
    let length = u16::try_from(xmp.len() + 2).expect("short").to_be_bytes();
    [&jpeg[..2], &[0xFF, 0xE1], &length, xmp, &jpeg[2..]].concat()
}

#[test]
fn a_panorama_gives_one_pose() {
    let scene = scene();
    panorama(scene, "query-0.png");
    let seal = "seal panoramas/round.jpg --profile place.vprofile -o sealed --panorama";
    let run = scene.run(&format!("{seal} --json")).succeeded();
    assert_eq!(run.json()["images"][0]["out"], "sealed/round/rig.json", "{run}");
    let files = std::fs::read_dir(scene.path("sealed/round")).expect("a folder").count();
    assert!(
        (4..=6).contains(&files),
        "five queries, or four where the ceiling is bare, and the rig: {files}"
    );
    let run = scene.run("localize --map place.vmap --rig sealed/round/rig.json --json");
    assert_eq!(run.code, Some(0), "{run}");
    let found: CameraFromWorld = pose(&run.json()["cam_from_world"]);
    assert!(scene.position_error("query-0.png", &found) < POSITION_TOLERANCE, "{run}");
    assert!(found.rotation_error_degrees(&scene.pose_of("query-0.png")) < 1.0, "{run}");

    // Without the flag a panorama that says what it is gives no wrong query; other images are no panoramas.
    let jpeg = scene.read("panoramas/round.jpg");
    scene.write("panoramas/marked.jpg", marked(&jpeg));
    let run = scene.run("seal panoramas/marked.jpg --camera unknown --profile place.vprofile -o a.vquery");
    assert!(run.code == Some(1) && run.stderr.contains("seal it with --panorama"), "{run}");
    scene.run("seal panoramas/marked.jpg --profile place.vprofile -o sealed --panorama").succeeded();
    let run = scene.run("seal images/query-0.png --profile place.vprofile -o sealed --panorama");
    assert!(run.code == Some(1) && run.stderr.contains("twice as wide as high"), "{run}");
}
