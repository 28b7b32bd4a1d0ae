//! Source of an image's camera, and the output about camera and gravity.

use super::common;

use common::{CAMERA, TestScene, scene};
use made::Field::Short;
use veiloc_protocol::{FocalKnowledge, SealedQuery};
use veiloc_testing::exif as made;

/// An image of the scene with EXIF data: the focal length, and a word that must not be sent.
fn with_exif(scene: &TestScene, name: &str, fields: &[made::Field]) {
    let image = image::open(scene.path("images/query-0.png")).expect("an image");
    let mut metadata = made::tiff(&[Short(made::ORIENTATION, 6)], fields);
    metadata.extend(b"a-name-of-somebody");
    made::save(&scene.path(name), &image, Some(metadata));
}

fn sealed(scene: &TestScene, name: &str) -> SealedQuery {
    SealedQuery::decode(&scene.read(name)).expect("a query")
}

#[test]
fn only_focal_length_is_read_from_exif() {
    let scene = scene();
    // 330 px of 400 x 300 are 28.6 mm of film, which a camera may truncate.
    with_exif(scene, "exif.jpg", &[Short(made::FOCAL_35MM, 28)]);
    let run = scene.run("seal exif.jpg --profile place.vprofile -o exif.vquery --json").succeeded();
    assert_eq!(run.json()["images"][0]["focal_known"], "exif");
    assert!(run.stderr.contains("exif.jpg is rotated by 90\u{b0} for display"), "{run}");
    let given = format!("seal exif.jpg --camera {CAMERA} --profile place.vprofile -o exif-given.vquery");
    assert!(
        !scene.run(&given).succeeded().stderr.contains("rotated"),
        "a given camera is of the stored image"
    );
    let query = sealed(scene, "exif.vquery");
    assert_eq!((query.focal_known(), query.gravity()), (FocalKnowledge::Exif, None));
    // The quantized value instead of the focal length; the same as for the calibrated camera.
    scene.seal("query-0.png", "", "calibrated.vquery");
    let calibrated = sealed(scene, "calibrated.vquery");
    assert_eq!(query.canonical_camera().codes().0, calibrated.canonical_camera().codes().0);
    assert_eq!(calibrated.focal_known(), FocalKnowledge::Calibrated);
    let bytes = scene.read("exif.vquery");
    for hidden in [&b"a-name-of-somebody"[..], b"Exif", b"II*\0"] {
        assert!(!bytes.windows(hidden.len()).any(|w| w == hidden), "metadata in the query");
    }
    let read = scene.run("localize --map place.vmap exif.vquery --json").json();
    assert_ne!(read["queries"][0]["state"], "failed");
}

#[test]
fn missing_exif_names_remedy_and_unknown_camera_is_marked() {
    let scene = scene();
    let seal = |what: &str| {
        scene.run(&format!("seal images/query-0.png --profile place.vprofile -o guess.vquery {what}"))
    };
    let run = seal("");
    assert_eq!(run.code, Some(1), "{run}");
    for word in ["images/query-0.png", "no EXIF", "--camera unknown"] {
        assert!(run.stderr.contains(word), "{word}: {run}");
    }
    let message = |what: &str| {
        seal(what).succeeded();
        sealed(scene, "guess.vquery").focal_known()
    };
    assert_eq!(message("--camera unknown"), FocalKnowledge::Unknown);
    assert_eq!(message(&format!("--camera {CAMERA}")), FocalKnowledge::Calibrated);
    for known in FocalKnowledge::ALL {
        assert_eq!(message(&format!("--camera {CAMERA} --focal-known {known}")), known);
    }
    let run = seal("--camera unknown --focal-known calibrated");
    assert!(run.code == Some(1) && run.stderr.contains("unknown camera"), "{run}");
    let run = seal(&format!("--camera {CAMERA} --focal-known well"));
    assert!(run.code == Some(2) && run.stderr.contains("calibrated"), "{run}");
    // No request is sent before the camera is known.
    let send = "query send images/query-0.png --map place --server http://127.0.0.1:9";
    let run = scene.run(send);
    assert!(
        run.code == Some(1) && run.stderr.contains("no EXIF") && run.stderr.contains("--camera unknown"),
        "{run}"
    );
}

#[test]
fn gravity_is_sent_for_one_image_only() {
    let scene = scene();
    let seal = |what: &str| format!("seal {what} --camera {CAMERA} --profile place.vprofile");
    let one = seal("images/query-0.png");
    scene.run(&format!("{one} -o none.vquery")).succeeded();
    assert!(sealed(scene, "none.vquery").gravity().is_none(), "gravity is sent only if given");
    scene.run(&format!("{one} -o down.vquery --gravity=-0.1,9.81,0.5,1")).succeeded();
    let sent_gravity = sealed(scene, "down.vquery").gravity().expect("it was given");
    assert!(sent_gravity.in_camera()[1] > 0.99 && (sent_gravity.sd_deg() - 1.0).abs() < 1e-12);
    assert_eq!(scene.read("none.vquery").len(), scene.read("down.vquery").len(), "L5");
    for bad in ["0,0,0", "1,2", "0,1,0,-1", "0,1,0,99", "down"] {
        let run = scene.run(&format!("{one} -o bad.vquery --gravity {bad}"));
        assert!(run.code == Some(2) && run.stderr.contains("X,Y,Z"), "{bad}: {run}");
    }
    let run =
        scene.run(&format!("{} -o several/ --gravity 0,1,0", seal("images/query-0.png images/query-1.png")));
    assert!(run.code == Some(1) && run.stderr.contains("for one image"), "{run}");
}
