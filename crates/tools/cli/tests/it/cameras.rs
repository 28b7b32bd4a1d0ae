//! Source of an image's camera, and the output about camera and gravity.

use super::common;

use common::{CAMERA, Place, place};
use made::Field::Short;
use veiloc_protocol::{FocalKnowledge, SealedQuery};
use veiloc_testing::exif as made;

/// An image of the scene with EXIF data: the focal length, and a word that must not be sent.
fn with_exif(place: &Place, name: &str, fields: &[made::Field]) {
    let image = image::open(place.path("images/query-0.png")).expect("an image");
    let mut metadata = made::tiff(&[Short(made::ORIENTATION, 6)], fields);
    metadata.extend(b"a-name-of-somebody");
    made::save(&place.path(name), &image, Some(metadata));
}

fn sealed(place: &Place, name: &str) -> SealedQuery {
    SealedQuery::decode(&place.read(name)).expect("a query")
}

#[test]
fn exif_tells_the_focal_length_and_nothing_else() {
    let place = place();
    // 330 px of 400 x 300 are 28.6 mm of film, which a camera may truncate.
    with_exif(place, "exif.jpg", &[Short(made::FOCAL_35MM, 28)]);
    let run = place.run("seal exif.jpg --profile place.vprofile -o exif.vquery --json").succeeded();
    assert_eq!(run.json()["images"][0]["focal_known"], "exif");
    let query = sealed(place, "exif.vquery");
    assert_eq!((query.focal_known(), query.gravity()), (FocalKnowledge::Exif, None));
    // The quantized value instead of the focal length; the same as for the calibrated camera.
    place.seal("query-0.png", "", "calibrated.vquery");
    let calibrated = sealed(place, "calibrated.vquery");
    assert_eq!(query.canonical_camera().codes().0, calibrated.canonical_camera().codes().0);
    assert_eq!(calibrated.focal_known(), FocalKnowledge::Calibrated);
    let bytes = place.read("exif.vquery");
    for hidden in [&b"a-name-of-somebody"[..], b"Exif", b"II*\0"] {
        assert!(!bytes.windows(hidden.len()).any(|w| w == hidden), "metadata in the query");
    }
    let read = place.run("localize --map place.vmap exif.vquery --json").json();
    assert_ne!(read["queries"][0]["status"], "failed");
}

#[test]
fn without_exif_the_remedy_is_named_and_a_guess_says_that_it_is_one() {
    let place = place();
    let seal = |what: &str| {
        place.run(&format!("seal images/query-0.png --profile place.vprofile -o guess.vquery {what}"))
    };
    let run = seal("");
    assert_eq!(run.code, Some(1), "{run}");
    for word in ["images/query-0.png", "no EXIF", "--camera unknown"] {
        assert!(run.stderr.contains(word), "{word}: {run}");
    }
    let said = |what: &str| {
        seal(what).succeeded();
        sealed(place, "guess.vquery").focal_known()
    };
    assert_eq!(said("--camera unknown"), FocalKnowledge::Unknown);
    assert_eq!(said(&format!("--camera {CAMERA}")), FocalKnowledge::Calibrated);
    for known in FocalKnowledge::ALL {
        assert_eq!(said(&format!("--camera {CAMERA} --focal-known {known}")), known);
    }
    let run = seal("--camera unknown --focal-known calibrated");
    assert!(run.code == Some(1) && run.stderr.contains("unknown camera"), "{run}");
    let run = seal(&format!("--camera {CAMERA} --focal-known well"));
    assert!(run.code == Some(2) && run.stderr.contains("calibrated"), "{run}");
    // No request is sent before the camera is known.
    let send = "query send images/query-0.png --map place --server http://127.0.0.1:9";
    let run = place.run(send);
    assert!(
        run.code == Some(1) && run.stderr.contains("no EXIF") && run.stderr.contains("--camera unknown"),
        "{run}"
    );
}

#[test]
fn gravity_is_sent_when_it_is_given_and_of_one_image() {
    let place = place();
    let seal = |what: &str| format!("seal {what} --camera {CAMERA} --profile place.vprofile");
    let one = seal("images/query-0.png");
    place.run(&format!("{one} -o none.vquery")).succeeded();
    assert!(sealed(place, "none.vquery").gravity().is_none(), "nothing is sent that nobody gave");
    place.run(&format!("{one} -o down.vquery --gravity=-0.1,9.81,0.5,1")).succeeded();
    let told = sealed(place, "down.vquery").gravity().expect("it was given");
    assert!(told.in_camera()[1] > 0.99 && (told.sd_deg() - 1.0).abs() < 1e-12);
    assert_eq!(place.read("none.vquery").len(), place.read("down.vquery").len(), "L5");
    for bad in ["0,0,0", "1,2", "0,1,0,-1", "0,1,0,99", "down"] {
        let run = place.run(&format!("{one} -o bad.vquery --gravity {bad}"));
        assert!(run.code == Some(2) && run.stderr.contains("X,Y,Z"), "{bad}: {run}");
    }
    let run =
        place.run(&format!("{} -o several/ --gravity 0,1,0", seal("images/query-0.png images/query-1.png")));
    assert!(run.code == Some(1) && run.stderr.contains("for one image"), "{run}");
}
