//! `--mask` and `--masks`: nothing under a mask is sent, and an implausible mask prevents sending.

use super::common;

use common::{CAMERA, TestScene, scene};
use image::{DynamicImage, GrayImage, ImageBuffer, Luma, LumaA, RgbImage};
use veiloc_protocol::SealedQuery;

/// Black in a region the size of a person.
fn person(x: u32, y: u32) -> bool {
    ((f64::from(x) - 130.0) / 40.0).hypot((f64::from(y) - 170.0) / 100.0) < 1.0
}

fn white_except(hides: fn(u32, u32) -> bool) -> GrayImage {
    GrayImage::from_fn(400, 300, |x, y| Luma([if hides(x, y) { 0 } else { 255 }]))
}

fn save(scene: &TestScene, name: &str, image: impl Into<DynamicImage>) {
    scene.write(name, "");
    image.into().save(scene.path(name)).expect("written");
}

fn seal(more: &str) -> String {
    format!("seal images/query-0.png --camera {CAMERA} --profile place.vprofile -o masked.vquery {more}")
}

/// The command exits with 1, and prints all these words.
fn refused(scene: &TestScene, command: &str, expected_words: &[&str]) {
    scene.run(command).refused(expected_words);
}

#[test]
fn a_masked_image_is_sealed_and_localized() {
    let scene = scene();
    save(scene, "masks/query-0.png.png", white_except(person));
    let sent = |more: &str| {
        let run = scene.run(&format!("{} --json", seal(more))).succeeded();
        let image = run.json()["images"][0].clone();
        let fields = &common::documented::tables()["seal"];
        assert_eq!(common::documented::mistakes(fields, &[run.json()]), [""; 0]);
        (image["keypoints"].as_u64().expect("a count"), image["masked"].as_f64(), run)
    };
    let (all, none, _) = sent("");
    let (rest, hidden, run) = sent("--mask masks/query-0.png.png");
    assert_eq!(none, None);
    assert!(hidden.is_some_and(|share| (0.1..0.11).contains(&share)), "{hidden:?}");
    assert!(run.stderr.contains("10.4 % of the image hidden"), "{run}");
    assert!(rest < all, "{rest} of {all}");
    scene.run("localize --map place.vmap masked.vquery").succeeded();
    // A folder of masks, by COLMAP's rule; and in a session.
    let two = format!(
        "seal images/query-0.png images/query-1.png --camera {CAMERA} --profile place.vprofile -o some/"
    );
    refused(scene, &format!("{two} --masks masks"), &["query-1.png.png"]);
    SealedQuery::decode(&scene.read("some/query-0.vquery")).expect("the image with a mask");
    assert!(!scene.path("some/query-1.vquery").exists(), "an image without a mask is not sealed");
    scene.run(&seal("--masks masks --session masked.session")).succeeded();
}

/// L13, through the whole program: two folders of images that differ only under the mask give the same evaluation.
#[test]
fn l13_hidden_pixels_change_no_result() {
    let scene = scene();
    for k in 0..common::QUERIES {
        save(scene, &format!("masks-of-all/query-{k}.png.png"), white_except(person));
    }
    let evaluated = |images: &str, more: &str| {
        let run = scene.run(&format!(
            "eval scene --posed posed --images {images} --map-list map.txt --query-list queries.txt --max-keypoints 512 \
             --query-keypoints 512 --schemes dcl --json {images}.json {more}"
        ));
        let document: serde_json::Value =
            serde_json::from_slice(&scene.read(&format!("{images}.json"))).expect("a document");
        let queries = document["queries"].as_array().expect("an array").clone();
        let summary = |query: &serde_json::Value| {
            let mut query = query.clone();
            query["ms"] = serde_json::Value::Null;
            query
        };
        (queries.iter().map(summary).collect::<Vec<_>>(), run.succeeded())
    };
    for entry in std::fs::read_dir(scene.path("images")).expect("a folder").flatten() {
        let mut image = image::open(entry.path()).expect("an image").to_rgb8();
        let name = entry.file_name().into_string().expect("text");
        if name.starts_with("query-") {
            for (x, y, pixel) in image.enumerate_pixels_mut().filter(|(x, y, _)| person(*x, *y)) {
                *pixel = image::Rgb([(x * 37) as u8, (y * 91) as u8, (x * y) as u8]);
            }
        }
        save(scene, &format!("changed/{name}"), image);
    }
    let masks = "--masks masks-of-all";
    let masked = evaluated("images", masks).0;
    assert_eq!(masked, evaluated("changed", masks).0);
    assert!(masked.iter().all(|query| query["state"] == "trusted"), "{masked:?}");
    assert_ne!(
        evaluated("images", "").0,
        evaluated("changed", "").0,
        "the test measure does not detect the leak"
    );
}

/// The attack on a masked query uses only what a device sends.
#[test]
fn attacks_use_no_hidden_keypoints() {
    let scene = scene();
    for k in 0..common::QUERIES {
        save(scene, &format!("masks-of-all/query-{k}.png.png"), white_except(person));
    }
    let hidden = |more: &str| {
        scene
            .run(&format!(
                "eval problems --posed posed --images images --map-list map.txt --query-list queries.txt \
                 --max-keypoints 512 --query-keypoints 512 -o p.jsonl --keypoints masked.jsonl {more}"
            ))
            .succeeded();
        let read = |name: &str| {
            let text = String::from_utf8(scene.read(name)).expect("text");
            let line = |l: &str| serde_json::from_str::<serde_json::Value>(l).expect("JSON");
            text.lines().map(line).collect::<Vec<_>>()
        };
        let number = |value: &serde_json::Value| value.as_f64().expect("a number");
        let mut count = 0;
        for (problem, image) in read("p.jsonl").iter().zip(read("masked.jsonl")) {
            // From the canonical camera back to the image's own, except for its distortion: a pixel at most.
            let canonical = &problem["camera"]["params"];
            let own = |p: &serde_json::Value, i: usize| {
                let ahead = (number(&p[i]) - number(&canonical[2 + i])) / number(&canonical[i]);
                (330.0 * ahead + [201.0, 149.0][i]) as u32
            };
            count += image["keypoints"]
                .as_array()
                .expect("a list")
                .iter()
                .filter(|p| person(own(p, 0), own(p, 1)))
                .count();
        }
        count
    };
    assert!(hidden("") > 20);
    assert_eq!(hidden("--masks masks-of-all"), 0);
    refused(
        scene,
        "eval problems --posed posed --images images --map-list map.txt --query-list queries.txt -o p.jsonl --masks nowhere",
        &["nowhere", "query-0.png.png"],
    );
}

#[test]
fn implausible_masks_are_refused_without_output() {
    let scene = scene();
    let good = white_except(person);
    save(scene, "bad/nothing.png", white_except(|_, _| false));
    save(scene, "bad/all.png", white_except(|_, _| true));
    save(scene, "bad/turned.png", image::imageops::rotate90(&good));
    save(scene, "bad/small.png", GrayImage::from_fn(200, 150, |x, _| Luma([(x > 9) as u8 * 255])));
    let clear = ImageBuffer::from_fn(400, 300, |x, y| LumaA([255_u8, if person(x, y) { 0 } else { 255 }]));
    save(scene, "bad/alpha.png", clear);
    let whole = std::fs::read(scene.path("bad/turned.png")).expect("written");
    scene.write("bad/cut.png", &whole[..whole.len() / 2]);
    scene.write("bad/text.png", "no image");
    for (more, expected_words) in [
        ("--mask bad/nothing.png", &["bad/nothing.png", "hides nothing", "black hides"][..]),
        ("--mask bad/all.png", &["bad/all.png", "hides the whole image"]),
        ("--mask bad/turned.png", &["bad/turned.png", "300x400", "400x300", "query-0.png"]),
        ("--mask bad/small.png", &["200x150", "400x300"]),
        ("--mask bad/alpha.png", &["bad/alpha.png", "transparent"]),
        ("--mask bad/cut.png", &["bad/cut.png", "cannot decode"]),
        ("--mask bad/text.png", &["bad/text.png", "cannot decode"]),
        ("--mask bad/gone.png", &["bad/gone.png", "cannot read"]),
        ("--masks bad", &["query-0.png.png", "cannot read"]),
        ("--mask bad/nothing.png images/query-1.png", &["--mask is for one image"]),
    ] {
        refused(scene, &seal(more).replace("masked.vquery", "none.vquery"), expected_words);
        assert!(!scene.path("none.vquery").exists(), "{more}");
    }
    // The error comes before any request: there is no service at this address.
    let send =
        format!("query send images/query-0.png --camera {CAMERA} --map place --server http://127.0.0.1:9");
    refused(scene, &format!("{send} --mask bad/nothing.png"), &["hides nothing"]);
    let run = scene.run(&seal("--mask a.png --masks b"));
    assert!(run.code == Some(2) && run.stderr.contains("--masks"), "{run}");
    // A mask is an input and must not be overwritten.
    refused(
        scene,
        &seal("--mask bad/turned.png").replace("masked.vquery", "bad/turned.png"),
        &["is an input"],
    );
}

/// Masks in the formats of common tools: 16 bits, colour, an alpha channel that hides nothing, soft edges.
#[test]
fn mask_formats_are_equivalent() {
    let scene = scene();
    let gray = |x, y| if person(x, y) { 0_u8 } else { 255 };
    save(scene, "forms/plain.png", white_except(person));
    save(
        scene,
        "forms/deep.png",
        ImageBuffer::from_fn(400, 300, |x, y| Luma([if person(x, y) { 0x7fff_u16 } else { 0x8000 }])),
    );
    save(scene, "forms/colour.png", RgbImage::from_fn(400, 300, |x, y| image::Rgb([gray(x, y); 3])));
    save(scene, "forms/opaque.png", ImageBuffer::from_fn(400, 300, |x, y| LumaA([gray(x, y), 255])));
    save(
        scene,
        "forms/soft.png",
        GrayImage::from_fn(400, 300, |x, y| Luma([if person(x, y) { 127 } else { 128 }])),
    );
    for form in ["plain", "deep", "colour", "opaque", "soft"] {
        let run = scene.run(&seal(&format!("--mask forms/{form}.png --json"))).succeeded();
        let share = run.json()["images"][0]["masked"].as_f64().expect("a share");
        let expected =
            (0..300).flat_map(|y| (0..400).map(move |x| (x, y))).filter(|(x, y)| person(*x, *y)).count();
        assert!((share - expected as f64 / 120_000.0).abs() < 1e-12, "{form}: {share}");
    }
}

/// Two folders of map images that differ only under their masks give one map, byte for byte; also after a build without masks in the
/// same work folder.
#[test]
fn nothing_under_a_mask_gets_into_a_map() {
    let scene = scene();
    let names: Vec<String> =
        String::from_utf8(scene.read("map.txt")).expect("text").lines().map(str::to_owned).collect();
    for name in &names {
        let mut image = image::open(scene.path(format!("images/{name}"))).expect("an image").to_rgb8();
        for (x, y, pixel) in image.enumerate_pixels_mut().filter(|(x, y, _)| person(*x, *y)) {
            *pixel = image::Rgb([(x * 37) as u8, (y * 91) as u8, (x * y) as u8]);
        }
        save(scene, &format!("visited/{name}"), image);
        // One image has no mask, and shows no person.
        if *name == names[0] {
            std::fs::copy(scene.path(format!("images/{name}")), scene.path(format!("visited/{name}")))
                .expect("copied");
        } else {
            save(scene, &format!("people/{name}.png"), white_except(person));
            save(scene, &format!("inverted/{name}.png"), white_except(|x, y| !person(x, y)));
        }
    }
    let build = |images: &str, more: &str| {
        scene.run(&format!(
            "map build --posed posed --images {images} --list map.txt --max-keypoints 512 --no-self-test --work masked.work -o \
             {images}.vmap {more}"
        ))
    };
    build("visited", "").succeeded();
    let whole = scene.read("visited.vmap");
    let (of_images, of_visited) =
        (build("images", "--masks people").succeeded(), build("visited", "--masks people").succeeded());
    assert!(of_images.stderr.contains(&format!("{} of {} images have a mask", names.len() - 1, names.len())));
    assert!(!of_visited.stderr.contains("invert"), "{of_visited}");
    assert!(scene.read("images.vmap") == scene.read("visited.vmap"), "the maps differ by what is hidden");
    assert!(whole != scene.read("visited.vmap"), "the masks hide something");
    let inverted = build("images", "--masks inverted --keep-broken");
    assert!(inverted.stderr.contains("the masks hide 90 % of an image in the median"), "{inverted}");
    refused(
        scene,
        "map build --posed posed --images images --list map.txt -o none.vmap --masks posed",
        &["no image has a mask there", &format!("{}.png", names[0])],
    );
}
