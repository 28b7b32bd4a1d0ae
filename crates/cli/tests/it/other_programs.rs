//! Files as other programs write them.

use super::common;

use common::{CAMERA, folder, scene};
use veiloc_testing::exif as made;

/// Byte order marks, backslashes, decomposed accents and spoiled lists: what was read, and what stderr says.
#[test]
fn models_and_lists_of_other_systems_are_read() {
    let scene = scene();
    let model = |file: &str| String::from_utf8(scene.read(&format!("posed/{file}"))).expect("text");
    let images =
        model("images.txt").replace("map-00.png", r"cam0\00.png").replace("map-01.png", "Ku\u{308}che.png");
    scene.write("windows/images.txt", format!("\u{feff}{}", images.replace('\n', "\r\n")));
    scene.write(
        "windows/cameras.txt",
        format!("\u{feff}{}", model("cameras.txt").replace("SIMPLE", "simple")),
    );
    scene.write("windows/points3D.txt", "1 nan 0 1 255.0 0 0 1 1 0\n2 0 0 1 0 0 0 1 9 0\n");
    for k in 0..10 {
        let name = match k {
            0 => "cam0/00.png".to_owned(),
            1 => "K\u{fc}che.png".to_owned(),
            k => format!("map-{k:02}.png"),
        };
        scene.write(&format!("photos/{name}"), scene.read(&format!("images/map-{k:02}.png")));
    }
    let others = (2..10).map(|k| format!("map-{k:02}.png\n")).collect::<Vec<_>>().concat();
    scene.write("windows.txt", format!("\u{feff}cam0/00.png\nK\u{fc}che.png\n{others}"));
    let pair = |k: u32| format!("map-{k:02}.png map-{:02}.png\n", k + 1);
    let pairs = (2..9).map(pair).collect::<Vec<_>>().concat();
    let first = "\u{feff}cam0/00.png K\u{fc}che.png\nK\u{fc}che.png map-02.png\n";
    scene.write("pairs.txt", format!("{first}{pairs}gone.png map-02.png\nmap-03.png lost.png\n"));
    let build = "map build --posed windows --images photos --list windows.txt --max-keypoints 512 \
                 --query-keypoints 512 --no-self-test --pairs pairs.txt --out-pairs matched.txt -o windows.vmap";
    let run = scene.run(build).succeeded();
    let matched = String::from_utf8(scene.read("matched.txt")).expect("text");
    assert_eq!(matched.lines().count(), 9, "{matched}");
    assert!(matched.contains(r"cam0\00.png"), "names are those of the model: {matched}");
    for part in
        ["2 of 11 pairs are left out", "gone.png, lost.png", "1 of 2 points have", "1 only in points3D"]
    {
        assert!(run.stderr.contains(part), "{part}: {run}");
    }
}

/// A camera in EXIF with a damaged directory, and a list in another form.
#[test]
fn images_and_queries_of_other_programs_are_sealed() {
    let scene = scene();
    let view = image::open(scene.path("images/query-0.png")).expect("rendered");
    let fields = made::tiff(&[], &[made::Field::Short(made::FOCAL_35MM, 28)]);
    scene.write("photo/a.jpg", []);
    made::save(&scene.path("photo/a.jpg"), &view, Some(fields[..fields.len() - 4].to_vec()));
    scene.run("seal photo/a.jpg --profile place.vprofile -o photo/a.vquery").succeeded();
    let camera = CAMERA.replace(',', " ").replace("400 300", "400.0 300.0").to_lowercase();
    let names = ["1403636579763555584.png", "1403636579813555456.png"];
    for (k, name) in names.iter().enumerate() {
        scene.write(&format!("times/{name}"), scene.read(&format!("images/query-{k}.png")));
    }
    scene.write("times.txt", format!("\u{feff}{} {camera}\n{} {camera}\n", names[0], names[1]));
    let run = scene
        .run("localize --map place.vmap --queries times.txt --images times --scheme points --out-tum times.tum")
        .succeeded();
    assert!(run.stderr.contains("times.tum: times are the nanoseconds in the names"), "{run}");
    let lines = String::from_utf8(scene.read("times.tum")).expect("text");
    assert!(
        lines.starts_with("1403636579.763555584 ") && lines.contains("\n1403636579.813555456 "),
        "{lines}"
    );
}

/// Formats that are not read are counted, and no image is left out in silence.
#[test]
fn other_image_formats_are_counted() {
    let place = folder();
    for name in ["a.avif", "b.AVIF", "c.tif", "d.jxl"] {
        place.write(&format!("phone/{name}"), "an image");
    }
    place.write("phone/e.jpg", "no image");
    let run = place.run("features phone --out-hloc f.h5");
    assert!(run.stderr.contains("2 AVIF files, 1 JPEG XL file and 1 TIFF file left out"), "{run}");
}
