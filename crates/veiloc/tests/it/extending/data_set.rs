//! A user-defined data set: a reader that returns posed images.

use std::error::Error;
use std::fmt::Write as _;
use std::path::Path;

use veiloc::geometry::{CameraFromWorld, Intrinsics};
use veiloc::server::{PosedImage, PosedImages};
use veiloc_evaluation::{SceneEvaluation, evaluate_scene};

use super::rendered;

/// The layout: one image per line, `name qw qx qy qz tx ty tz`, camera from world, one camera for all images.
fn read(list: &Path, camera: &Intrinsics) -> Result<PosedImages, Box<dyn Error>> {
    let mut images = Vec::new();
    for (number, line) in (1..).zip(std::fs::read_to_string(list)?.lines()) {
        let mut words = line.split_whitespace();
        let name = words.next().ok_or(format!("line {number} is empty"))?.to_owned();
        let numbers: Vec<f64> = words.map(str::parse).collect::<Result<_, _>>()?;
        let [qw, qx, qy, qz, tx, ty, tz] = *numbers else {
            return Err(format!("line {number} has {} numbers, seven are wanted", numbers.len()).into());
        };
        let cam_from_world = CameraFromWorld::from_quaternion([qw, qx, qy, qz], [tx, ty, tz])
            .ok_or(format!("line {number} is no pose"))?;
        images.push(PosedImage { name, camera: *camera, cam_from_world, seen: Vec::new() });
    }
    Ok(PosedImages::new(images, Vec::new())?)
}

#[test]
fn user_defined_data_set_is_mapped_and_evaluated() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let scene = rendered::render(folder.path(), 11).expect("rendered");
    let mut list = String::new();
    let queries = scene
        .queries
        .iter()
        .map(|(path, pose)| (path.file_name().expect("a name").to_string_lossy().into_owned(), *pose));
    let mapped = scene.posed.images().iter().map(|i| (i.name.clone(), i.cam_from_world));
    for (name, pose) in mapped.chain(queries.clone()) {
        let (q, t) = (pose.quaternion(), pose.translation());
        writeln!(list, "{name} {} {} {} {} {} {} {}", q[0], q[1], q[2], q[3], t.x, t.y, t.z)
            .expect("in memory");
    }
    let file = folder.path().join("poses.txt");
    std::fs::write(&file, list).expect("written");

    let posed = read(&file, &scene.camera).expect("read");
    let result = evaluate_scene(
        &SceneEvaluation {
            schemes: vec!["dcl".parse().expect("a scheme")],
            thresholds: vec!["0.05/5".parse().expect("a threshold")],
            ..SceneEvaluation::of_scene(
                posed,
                scene.folder.clone(),
                scene.posed.names(),
                queries.map(|q| q.0).collect(),
            )
        },
        &(),
    )
    .expect("evaluated");
    assert_eq!((result.schemes[0].localized, result.schemes[0].recall["0.05/5"]), (3, 1.0));

    std::fs::write(&file, "a.png 1 0 0 0 0 0").expect("written");
    assert!(read(&file, &scene.camera).is_err_and(|e| e.to_string().contains("line 1 has 6 numbers")));
}
