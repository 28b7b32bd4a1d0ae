//! Files of posed images with something odd in them: what is read correctly is kept, an odd item is left out and counted, and a
//! file without meaning is refused with the place.

use std::fs;
use std::path::{Path, PathBuf};

use veiloc_map::colmap;
use veiloc_mapping::importers::poses::{PosedInput, read_posed};

use super::poses::{assert_same, data, images_called};

/// A copy of a fixture that can be edited, with its images.
struct Copy {
    fixture: String,
    folder: tempfile::TempDir,
    images: PathBuf,
    _kept: tempfile::TempDir,
}

impl Copy {
    fn of(fixture: &str) -> Self {
        let folder = tempfile::tempdir().expect("temporary folder");
        copy_folder(&data(fixture), folder.path());
        let names = colmap::read_posed(&data("expected").join(fixture)).expect("a model").names();
        let (kept, images) = images_called(&names, if fixture == "kitti" { "image_2" } else { "images" });
        Self { fixture: fixture.to_owned(), folder, images, _kept: kept }
    }

    fn path(&self, file: &str) -> PathBuf {
        self.folder.path().join(file)
    }

    /// Replaces the first occurrence of a text.
    fn edit(&self, file: &str, from: &str, to: &str) -> &Self {
        let text = fs::read_to_string(self.path(file)).expect("read");
        assert!(text.contains(from), "{}: {from}", self.fixture);
        fs::write(self.path(file), text.replacen(from, to, 1)).expect("written");
        self
    }

    fn read(&self, file: &str) -> Result<PosedInput, String> {
        read_posed(&self.path(file), &self.images).map_err(|error| error.to_string())
    }

    /// The images are these, as expected.
    fn check(&self, file: &str, kept: &[&str]) -> String {
        let read = self.read(file).expect("posed images");
        let expected = colmap::read_posed(&data("expected").join(&self.fixture)).expect("a model");
        let mut names = read.images.names();
        names.sort();
        let remarks = read.images.remarks().join("; ");
        assert_eq!(names, kept, "{}: {remarks}", self.fixture);
        let expected = expected.images().iter().filter(|image| kept.contains(&image.name.as_str()));
        let expected = veiloc_map::PosedImages::new(
            expected.cloned().map(|image| veiloc_map::PosedImage { seen: Vec::new(), ..image }).collect(),
            Vec::new(),
        );
        assert_same(&read.images, &expected.expect("images"), &self.fixture);
        remarks
    }
}

fn copy_folder(from: &Path, to: &Path) {
    for entry in fs::read_dir(from).expect("a folder").flatten() {
        let to = to.join(entry.file_name());
        if entry.path().is_dir() {
            fs::create_dir_all(&to).expect("a folder");
            copy_folder(&entry.path(), &to);
        } else {
            fs::copy(entry.path(), to).expect("copied");
        }
    }
}

const ALL: [&str; 4] = ["a.jpg", "b.jpg", "c.jpg", "d.jpg"];
const NOT_A: [&str; 3] = ["b.jpg", "c.jpg", "d.jpg"];

/// Fixture, file to edit (the first one is read; with `*` its folder), what is replaced by what, images that are kept, and a part
/// of the remarks. If none is kept, the file is refused, and the part is of the message.
const CASES: &str = r#"
nerfstudio | transforms.json | "file_path" | "file" | bcd | 1 frames are left out: file_path is missing
nerfstudio | transforms.json | [\n     1.0 | [\n     NaN | bcd | first is frames[0]
nerfstudio | transforms.json | [\n     1.0 | [\n     -Infinity | bcd | not an array of finite numbers
nerfstudio | transforms.json | [\n     1.0 | [\n     3.0 | bcd | no rotation
nerfstudio | transforms.json | [\n     1.0 | [\n     1.0001 | abcd |
nerfstudio | transforms.json | images/b.jpg", | images/b.jpg", "k4": 9, | acd | (k4) move a corner
nerfstudio | transforms.json | "k1" | "k4": 1e-9, "k1" | abcd |
nerfstudio | transforms.json | "k1" | "k4" | | (k4) move a corner of the image by
nerfstudio | transforms.json | OPENCV | SPHERE | | 4 frames are left out: camera_model is "SPHERE"
nerfstudio | transforms.json | \n ]\n} | \n ],\n} | | is not JSON: line 156 column 1: trailing comma
nerfstudio | * transforms.json | { | {{ | | transforms.json: is not JSON: line 1 column 2
opensfm | reconstruction.json | "v2 a phone": { | "x": {"projection_type": "dual", "focal": -1}, "v2 a phone": { | abcd |
opensfm | reconstruction.json | "camera": "v2 | "camera": "v3 | bcd | its camera "v3 a phone" is missing
opensfm | reconstruction.json | "coordinates": [\n     0.5 | "coordinates": [\n     NaN | abcd | 1 points are left out
opensfm | reconstruction.json | "brown" | "dual" | | projection_type is "dual"
metashape | cameras.xml | <b1> | <b2>0.012</b2><b1> | abcd |
metashape | cameras.xml | <b1> | <b2>1</b2><b1> | | (skew) move a corner of the image by 0.4
metashape | cameras.xml | <transform>0.66 | <transform>nan 0.66 | bcd | something else than numbers; the first is a
metashape | cameras.xml | sensor_id="0" | sensor_id="8" | bcd | their sensor "8" is missing
metashape | cameras.xml | type="frame" class="adjusted" | type="spherical" class="adjusted" | | its type is "spherical"
metashape | cameras.xml | <sensor id="0" | <sensor id="7" type="spherical"/><sensor id="0" | abcd |
metashape | cameras.xml | </document> | | | is not XML
bundler | bundle.out | 60.5 -0.2 | 60.5 nan | bcd | is not finite; the first is images/a.jpg
bundler | bundle.out | -0.5 0.0 -2.0 | -0.5 0.0 x | bcd | the translation is "x"
bundler | bundle.out | 0.5 0.25 4.0 | nan 0.25 4.0 | abcd | 1 points are left out
bundler | bundle.out | 5 1 | 6 1 | | has 6 cameras
bundler | bundle.out | 2 0 17 | 2 9 17 | | is seen by camera 9
nvm | place.nvm | 60.5 1.0 0.0 0.0 0.0 | 60.5 0 0 0 0 | bcd | the pose is no rotation; the first is images/a.jpg
nvm | place.nvm | 60.5 1.0 | -60.5 1.0 | bcd | 1 images are left out
nvm | place.nvm | 0.5 0.25 4.0 | 0.5 inf 4.0 | abcd | 1 points are left out
nvm | place.nvm | NVM_V3  | NVM_V3_R9T | | a camera of NVM_V3_R9T needs name
reality_capture | cameras.csv | a.jpg, | a.jpg,x | bcd | x is "x0.5"
reality_capture | cameras.csv | heading | yaw | | has no column heading
tum | groundtruth.txt | -2.0 0.0 0.0 0.0 1.0 | -2.0 0 0 0 0 | bcd | is not a rotation; the first is line 2
tum | groundtruth.txt | 0.5 0.0 -2.0 | nan nan nan | bcd | 1 poses are left out: a pose is not finite
tum | groundtruth.txt | -1.089182603518896 | | abc | is missing; the first is line 5
tum | * rgb.txt | # timestamp | timestamp | abcd | 1 images are left out: the time is "timestamp"
tum | * rgb.txt | 1305031102.5000 | x | bcd | the time is "x"
tum | groundtruth.txt | # timestamp | timestamp | abcd | 1 poses are left out
kitti | 00.txt | 1.0 | nan | bcd | a pose is not finite; the first is line 1
kitti | 00.txt | 1.0 | # a head\n1.0 | abcd |
kitti | 00.txt | 1.0 | x\n1.0 | | 00.txt:1: a pose is "x"
kitti | * calib.txt | P2: 60.5 0.0 | P2: 60.5 1e-9 | abcd |
kitti | * calib.txt | P2: 60.5 0.0 | P2: 60.5 1.5 | | (skew) move a corner
record3d | metadata.json | [\n   1.0 | [\n   NaN | bcd | first is poses[0]
record3d | metadata.json | "w" | "width" | | w is missing
record3d | metadata.json | 60.5,\n  0.0,\n  0.0,\n  0.0 | 60.5,\n  0.0,\n  0.0,\n  3.0 | | (skew) move a corner
scanner_app | * frame_00000.json | 1.0 | NaN | bcd | 1 images are left out
scanner_app | * frame_00000.json | 60.5,\n  0.0 | 60.5,\n  2.0 | bcd | (skew) move a corner
euroc | * mav0/state_groundtruth_estimate0/data.csv | 0.49669 | nan,0.49669 | bcd | 1 poses are left out
euroc | * mav0/cam0/data.csv | 1403636579763555584 | 1403636579.7635555840 | abcd |
euroc | * mav0/cam0/data.csv | 1403636579763555584,a.jpg | 1403636579763555584 | bcd | the file name is missing
kapture | * sensors/sensors.txt | cam1, , camera, UNKNOWN_CAMERA | cam1, , camera, PINHOLE | abcd | 1 images are left out
kapture | * sensors/sensors.txt | cam1, | cam2, , camera, PINHOLE, 1, 1, -5\ncam1, | abcd | without a known camera
kapture | * sensors/trajectories.txt | cam0, 1.0 | cam0, 0.0 | bcd | not a rotation; the first is line 2
polycam | * keyframes/corrected_cameras/a.json | 1.0 | "" | bcd | 1 images are left out: t_00 is
polycam | * keyframes/corrected_cameras/a.json | { | {, | bcd | is not JSON: line 1 column 2
"#;

#[test]
fn odd_items_are_left_out_and_counted() {
    for case in CASES.trim().lines() {
        let columns: Vec<&str> = case.split('|').map(|c| c.strip_prefix(' ').unwrap_or(c)).collect();
        let [fixture, file, from, to, kept, part] = columns[..] else { panic!("{case}") };
        let [fixture, file, kept, part] = [fixture, file, kept, part].map(str::trim);
        let [from, to] = [from, to].map(|text| text.strip_suffix(' ').unwrap_or(text).replace("\\n", "\n"));
        let edited = file.trim_start_matches("* ");
        let file = if file == edited { file } else { "" };
        let copy = Copy::of(fixture);
        copy.edit(edited, &from, &to);
        if kept.is_empty() {
            let error = copy.read(file).expect_err(case);
            assert!(error.contains(part), "{case}: {error}");
            continue;
        }
        let mut names = colmap::read_posed(&data("expected").join(fixture)).expect("a model").names();
        names.sort();
        let kept: Vec<&str> = kept.bytes().map(|letter| names[usize::from(letter - b'a')].as_str()).collect();
        let remarks = copy.check(file, &kept);
        assert!(remarks.contains(part), "{case}: {remarks}");
    }
}

#[test]
fn many_reasons_are_counted_together() {
    let copy = Copy::of("tum");
    let odd: Vec<String> = (0..20).map(|n| format!("1305031109.0 x{n}\n")).collect();
    copy.edit("groundtruth.txt", "1305031103.2500", &format!("{}1305031103.2500", odd.concat()));
    let remarks = copy.check("groundtruth.txt", &ALL);
    // 12 of the reasons are listed; that of the late image comes after them.
    assert!(remarks.contains("is \"x11\"") && !remarks.contains("is \"x12\""), "{remarks}");
    assert!(remarks.ends_with("9 more items are left out for other reasons"), "{remarks}");
}

#[test]
fn shots_of_other_cameras_are_left_out() {
    for (model, remark) in [("dual", "is \"dual\""), ("spherical", "panoramas have no pinhole image")] {
        let copy = Copy::of("opensfm");
        let file = "reconstruction.json";
        let camera = format!("\"x\": {{\"projection_type\": \"{model}\"}}, \"v2 a phone\": {{");
        copy.edit(file, "\"v2 a phone\": {", &camera).edit(
            file,
            "\"camera\": \"v2 a phone\"",
            "\"camera\": \"x\"",
        );
        assert!(copy.check(file, &NOT_A).contains(remark));
    }
}

#[test]
fn image_listed_twice_is_taken_once_or_not_at_all() {
    for (line, kept, remark) in [
        ("9999, cam0, a.jpg", &NOT_A[..], "several poses or cameras are given for one file"),
        (
            "0, cam0, a.jpg",
            &ALL[..],
            "1 entries are left out: their image is listed before with the same pose",
        ),
    ] {
        let copy = Copy::of("kapture");
        copy.edit("sensors/records_camera.txt", "9999, cam1, other.jpg", line);
        copy.edit("sensors/trajectories.txt", ", , , , , 1, 2, 3", ", 1, 0, 0, 0, 1, 2, 3");
        let remarks = copy.check("", kept);
        assert!(remarks.contains(remark), "{remarks}");
    }
}

#[test]
fn files_of_other_systems_are_read() {
    // Line ends of Windows, empty lines, and a byte order mark.
    for (fixture, files) in [
        ("bundler", &["bundle.out", "list.txt"][..]),
        ("nvm", &["place.nvm"]),
        ("tum", &["groundtruth.txt", "rgb.txt", "cameras.txt"]),
        ("kapture", &["sensors/sensors.txt", "sensors/rigs.txt", "sensors/trajectories.txt"]),
        ("reality_capture", &["cameras.csv"]),
        ("opensfm", &["reconstruction.json"]),
        ("metashape", &["cameras.xml"]),
        ("euroc", &["mav0/cam0/sensor.yaml", "mav0/cam0/data.csv"]),
    ] {
        let copy = Copy::of(fixture);
        for file in files {
            let text = fs::read_to_string(copy.path(file)).expect("read");
            fs::write(copy.path(file), format!("\u{feff}{}\r\n", text.replace('\n', "\r\n")))
                .expect("written");
        }
        copy.check("", &ALL);
        for file in files {
            let text = fs::read_to_string(copy.path(file)).expect("read");
            let utf16: Vec<u8> = text.encode_utf16().flat_map(u16::to_le_bytes).collect();
            fs::write(copy.path(file), utf16).expect("written");
        }
        copy.check("", &ALL);
    }
    // RealityCapture's CSV where commas are decimal points.
    let copy = Copy::of("reality_capture");
    let text = fs::read_to_string(copy.path("cameras.csv")).expect("read");
    let text = text.replace(',', ";").replace('.', ",").replace(",jpg", ".jpg");
    fs::write(copy.path("cameras.csv"), text).expect("written");
    copy.check("", &ALL);
    // RealityCapture's list of a Bundler file.
    let copy = Copy::of("bundler");
    fs::rename(copy.path("list.txt"), copy.path("imagelist.lst")).expect("renamed");
    copy.check("bundle.out", &ALL);
    fs::write(copy.path("other.lst"), "a.jpg\n").expect("written");
    assert!(copy.read("bundle.out").expect_err("two lists").contains("one .lst"));
}

#[test]
fn nvm_with_matrices_is_read() {
    let copy = Copy::of("nvm");
    let expected = colmap::read_posed(&data("expected/nvm")).expect("a model");
    let text = fs::read_to_string(copy.path("place.nvm")).expect("read");
    let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
    lines[0] = "NVM_V3_R9T".to_owned();
    for (line, image) in lines[3..7].iter_mut().zip(expected.images()) {
        let rotation = image.cam_from_world.rotation().matrix().transpose();
        let numbers = rotation.iter().chain(image.cam_from_world.translation().iter());
        let numbers: Vec<String> = numbers.map(f64::to_string).collect();
        *line = format!("images/{} 60.5 {} 0 0", image.name, numbers.join(" "));
    }
    fs::write(copy.path("place.nvm"), lines.join("\n") + "\n").expect("written");
    copy.check("", &ALL);
}

#[test]
fn intrinsics_of_each_frame_are_read() {
    let copy = Copy::of("record3d");
    let list = |of: &[&str]| format!("\"perFrameIntrinsicCoeffs\": [{}], \"w\"", of.join(", "));
    let frame = "[60.5, 61.25, 31.75, 24.5]";
    // K is that of the first frame; the others differ.
    copy.edit("metadata.json", "\"w\"", &list(&[frame, frame, "[62, 63, 30, 25]", "[62, 63, NaN, 25]"]));
    let read = copy.read("metadata.json").expect("posed images");
    let camera = |name: &str| read.images.get(name).map(|image| image.camera.to_string());
    assert_eq!(camera("0.jpg"), Some("PINHOLE,64,48,60.5,61.25,31.75,24.5".to_owned()));
    assert_eq!(camera("1.jpg"), camera("0.jpg"));
    assert_eq!(camera("2.jpg"), Some("PINHOLE,64,48,62,63,30,25".to_owned()));
    assert_eq!(camera("3.jpg"), None);
    assert!(read.images.remarks()[0].starts_with("1 images are left out"), "{:?}", read.images.remarks());
    let copy = Copy::of("record3d");
    let error = copy.edit("metadata.json", "\"w\"", &list(&[frame; 3])).read("metadata.json");
    let error = error.expect_err("other counts");
    assert!(error.contains("poses has 4 frames, and perFrameIntrinsicCoeffs has 3"), "{error}");

    let copy = Copy::of("nerfstudio");
    copy.edit("transforms.json", "images/b.jpg\",", "images/b.jpg\", \"fl_x\": 70, \"k1\": 0.1,");
    let read = copy.read("transforms.json").expect("posed images");
    let camera = read.images.get("b.jpg").map(|image| image.camera.to_string()).expect("an image");
    assert!(camera.starts_with("FULL_OPENCV,64,48,70,70,31.75,24.5,0.1,"), "{camera}");
}

#[test]
fn polycams_cameras_are_those_of_the_images() {
    let copy = Copy::of("polycam");
    let keyframes = copy.path("keyframes");
    let images = |folder: &str, width: u32| {
        fs::create_dir_all(keyframes.join(folder)).expect("a folder");
        for name in ALL {
            image::GrayImage::new(width, 48).save(keyframes.join(folder).join(name)).expect("an image");
        }
    };
    images("images", 66);
    images("corrected_images", 64);
    let read = |folder: PathBuf| read_posed(copy.folder.path(), &folder).map_err(|error| error.to_string());
    let width =
        |read: Result<PosedInput, String>| read.expect("posed images").images.images()[0].camera.width;
    assert_eq!(width(read(keyframes.join("corrected_images"))), 64);
    let error = read(keyframes.join("images")).expect_err("no cameras of raw images");
    assert!(error.contains("the images are those of images; give the folder corrected_images"), "{error}");
    // Those of raw images, of 66 pixels.
    copy_folder(&keyframes.join("corrected_cameras"), &{
        fs::create_dir(keyframes.join("cameras")).expect("a folder");
        keyframes.join("cameras")
    });
    for name in ["a", "b", "c", "d"] {
        copy.edit(&format!("keyframes/cameras/{name}.json"), "\"width\": 64", "\"width\": 66");
    }
    assert_eq!(width(read(keyframes.join("corrected_images"))), 64);
    let raw = read(keyframes.join("images")).expect("posed images");
    assert!(
        raw.images.remarks()[0].contains("it has the cameras of these images"),
        "{:?}",
        raw.images.remarks()
    );
    assert_eq!(width(Ok(raw)), 66);
    // By the size, if the folder is another.
    fs::create_dir(copy.path("copy")).expect("a folder");
    copy_folder(&keyframes.join("images"), &copy.path("copy"));
    assert_eq!(width(read(copy.path("copy"))), 66);
    let error = read(keyframes.clone()).expect_err("two files of each name");
    assert!(error.contains("4 images are left out: several files in"), "{error}");
    assert!(error.contains("(corrected_images/a.jpg, images/a.jpg)"), "{error}");
}

#[test]
fn fields_that_polycam_leaves_out_are_found() {
    let copy = Copy::of("polycam");
    let file = "keyframes/corrected_cameras/a.json";
    let without = |lines: &[&str]| {
        let text = fs::read_to_string(copy.path(file)).expect("read");
        let kept: Vec<&str> = text.lines().filter(|line| !lines.iter().any(|l| line.contains(l))).collect();
        fs::write(copy.path(file), kept.join("\n")).expect("written");
    };
    without(&["width", "height"]);
    copy.check("", &ALL);
    fs::create_dir(copy.path("keyframes/cameras")).expect("a folder");
    fs::copy(copy.path(file), copy.path("keyframes/cameras/a.json")).expect("copied");
    without(&["fx", "fy"]);
    copy.check("", &ALL);
    fs::remove_file(copy.path("keyframes/cameras/a.json")).expect("removed");
    assert!(copy.check("", &NOT_A).contains("fx is missing, here and in the folder cameras"));
    let copy = Copy::of("polycam");
    copy.edit(file, "\"cx\": 31.75,", "").edit(file, "\"cy\": 24.5,", "");
    let read = copy.read("").expect("posed images");
    assert!(read.images.remarks()[0].starts_with("1 cameras have no principal point"));
    assert!(read.images.get("a.jpg").is_some_and(|a| a.camera.to_string().ends_with(",32,24")));
}

#[test]
fn cameras_of_metashapes_rigs_have_the_pose_of_their_master() {
    let copy = Copy::of("metashape");
    let expected = colmap::read_posed(&data("expected/metashape")).expect("a model");
    let of = |name: &str| expected.get(name).expect("an image").cam_from_world;
    // b as the slave of a: its axes and centre in the camera of the master.
    let (master, slave) = (of("a.jpg"), of("b.jpg"));
    let rotation = (master.rotation() * slave.rotation().inverse()).matrix().transpose();
    let location = master.rotation() * slave.center().coords + master.translation();
    let words = |numbers: Vec<f64>| numbers.iter().map(f64::to_string).collect::<Vec<_>>().join(" ");
    let text = fs::read_to_string(copy.path("cameras.xml")).expect("read");
    let start = text.find("<sensor id").expect("a sensor");
    let end = text.find("</sensor>").expect("its end");
    let sensor = text[start..end].replacen("id=\"0\"", "id=\"1\" master_id=\"0\"", 1);
    let at = text.find("label=\"b\"><transform>").expect("a camera") + "label=\"b\">".len();
    let after = at + text[at..].find("</transform>").expect("its end") + "</transform>".len();
    let slave = format!("{}{}", &text[..at], &text[after..]).replacen(
        "<camera id=\"1\" sensor_id=\"0\"",
        "<camera id=\"1\" sensor_id=\"1\" master_id=\"0\"",
        1,
    );
    let with_sensor = |offset: &str| {
        let text = format!("{}{sensor}{offset}</sensor>{}", &slave[..start], &slave[start..]);
        fs::write(copy.path("cameras.xml"), text).expect("written");
    };
    let [rotation, location] =
        [words(rotation.iter().copied().collect()), words(location.iter().copied().collect())];
    with_sensor(&format!("<rotation>{rotation}</rotation><location>{location}</location>"));
    assert!(copy.check("", &ALL).contains("1 cameras of rigs have the pose of their master"));
    with_sensor("<rotation fixed=\"true\"/>");
    let remarks = copy.check("", &["a.jpg", "c.jpg", "d.jpg"]);
    assert!(remarks.contains("their sensor has no rotation and location in the rig"), "{remarks}");
}

#[test]
fn equal_labels_of_metashape_are_told_apart_by_their_groups() {
    let copy = Copy::of("metashape");
    for (folder, label) in [("left", "a"), ("right", "b"), ("left", "c"), ("right", "d")] {
        fs::create_dir_all(copy.images.join(folder)).expect("a folder");
        let name = if label < "c" { "1.jpg" } else { "2.jpg" };
        fs::rename(copy.images.join(format!("{label}.jpg")), copy.images.join(folder).join(name))
            .expect("moved");
        let start = format!("label=\"{label}\"");
        copy.edit("cameras.xml", &start, &format!("label=\"{}\"", &name[..1]));
    }
    let error = copy.read("").expect_err("equal labels, one group");
    assert!(error.contains("several files in"), "{error}");
    let text = fs::read_to_string(copy.path("cameras.xml")).expect("read");
    let mut number = 0;
    let lines = text.replace("<group id=\"0\" label=\"walk\" type=\"folder\">", "").replace("</group>", "");
    let lines = lines.lines().map(|line| {
        if !line.contains("<transform>0") && !line.contains("<transform>-") {
            return line.to_owned();
        }
        number += 1;
        format!("<group label=\"{}\">{line}</group>", if number % 2 == 1 { "left" } else { "right" })
    });
    let grouped = lines.collect::<Vec<_>>().join("\n");
    fs::write(copy.path("cameras.xml"), grouped).expect("written");
    let read = copy.read("").expect("posed images");
    let expected = colmap::read_posed(&data("expected/metashape")).expect("a model");
    for (name, as_name) in [("left/1.jpg", "a.jpg"), ("right/1.jpg", "b.jpg"), ("left/2.jpg", "c.jpg")] {
        let pose =
            |images: &veiloc_map::PosedImages, name: &str| images.get(name).expect("an image").cam_from_world;
        let error = pose(&read.images, name).translation_error(&pose(&expected, as_name));
        assert!(error < 1e-9, "{name}: {error}");
    }
    // One folder is given: the images of the other are not in it.
    let one = read_posed(&copy.path("cameras.xml"), &copy.images.join("left")).expect("posed images");
    assert_eq!(one.images.names(), ["1.jpg", "2.jpg"]);
}

#[test]
fn times_of_trajectories_may_have_other_units() {
    let nanoseconds = |text: &str| {
        let lines = text.lines().map(|line| match line.split_once(' ') {
            Some((time, rest)) if !line.starts_with('#') => {
                format!("{}00000 {rest}", time.replace('.', ""))
            }
            _ => line.to_owned(),
        });
        lines.collect::<Vec<_>>().join("\n")
    };
    let copy = Copy::of("tum");
    let text = fs::read_to_string(copy.path("groundtruth.txt")).expect("read");
    let written = nanoseconds(&text);
    assert!(written.contains("130503110250000"), "{written}");
    fs::write(copy.path("groundtruth.txt"), written).expect("written");
    copy.check("groundtruth.txt", &ALL);
    // The head says that w is first.
    let lines = text.lines().map(|line| match line.rsplit_once(' ') {
        Some((rest, w)) if !line.starts_with('#') => {
            let words: Vec<&str> = rest.split(' ').collect();
            format!("{} {w} {}", words[..4].join(" "), words[4..].join(" "))
        }
        _ => line.replace("qx qy qz qw", "qw qx qy qz"),
    });
    fs::write(copy.path("groundtruth.txt"), lines.collect::<Vec<_>>().join("\n")).expect("written");
    assert!(copy.check("groundtruth.txt", &ALL).contains("qw qx qy qz, as the head"));
    // No image has a pose: both ranges.
    let later = text.replace("\n130503", "\n140503");
    fs::write(copy.path("groundtruth.txt"), later).expect("written");
    let error = copy.read("groundtruth.txt").expect_err("other times");
    assert!(error.contains("5 images are left out: the trajectory has no pose near their times"), "{error}");
    assert!(
        error.contains("images: 1305031102.500 to 1305031999.000 s; poses: 1405031102.500 to"),
        "{error}"
    );
}

#[test]
fn poses_of_lost_tracking_are_left_out() {
    let check = |fixture: &str, file: &str, lines: &[(usize, &str)], kept: &[&str]| {
        let copy = Copy::of(fixture);
        let text = fs::read_to_string(copy.path(file)).expect("read");
        let mut changed: Vec<&str> = text.lines().collect();
        for (at, line) in lines {
            changed[*at] = line;
        }
        fs::write(copy.path(file), changed.join("\n")).expect("written");
        let read = copy.read("").expect("posed images");
        let remarks = read.images.remarks().join("; ");
        assert_eq!(read.images.names(), kept, "{fixture}: {remarks}");
        assert_eq!(remarks.contains("exactly the identity"), kept.len() < 4, "{remarks}");
    };
    let (c, d) = ("1305031103.0000 0 0 0 0 0 0 1", "1305031103.2500 0 0 0 0 0 0 1");
    check("tum", "groundtruth.txt", &[(3, c), (4, d)], &ALL[..2]);
    // One may be the reference of all.
    check("tum", "groundtruth.txt", &[(4, d)], &ALL);
    let (c, d) = ("1403636580263555584,0,0,0,1,0,0,0", "1403636580513555584,0,0,0,1,0,0,0");
    check("euroc", "mav0/state_groundtruth_estimate0/data.csv", &[(3, c), (4, d)], &ALL[..2]);
    let identity = "1 0 0 0 0 1 0 0 0 0 1 0";
    check("kitti", "00.txt", &[(1, identity), (3, identity)], &["000000.png", "000002.png"]);
    let copy = Copy::of("record3d");
    let text = fs::read_to_string(copy.path("metadata.json")).expect("read");
    let mut document: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    for index in [1, 2] {
        document["poses"][index] = serde_json::json!([0, 0, 0, 1, 0, 0, 0]);
    }
    fs::write(copy.path("metadata.json"), document.to_string()).expect("written");
    assert!(copy.check("metadata.json", &["0.jpg", "3.jpg"]).contains("exactly the identity"));
}

#[test]
fn degrees_of_reality_capture_are_named() {
    let copy = Copy::of("reality_capture");
    for (from, to) in [
        ("0.5,0.0,", "8.5417066,47.3769,"),
        ("0.7478878552166244,-0.2316031832729213,", "8.5417099,47.3768979,"),
        ("0.08996697293176399,-0.2275097891194076,", "8.5417012,47.3768980,"),
        ("-1.089182603518896,-0.33368140921633554,", "8.5416855,47.3768970,"),
    ] {
        copy.edit("cameras.csv", from, to);
    }
    let read = copy.read("").expect("posed images");
    assert!(read.images.remarks().iter().any(|remark| remark.contains("degrees of longitude and latitude")));
}

#[test]
fn files_of_programs_that_are_not_read_are_named() {
    let folder = tempfile::tempdir().expect("temporary folder");
    for (file, content, remedy) in [
        ("database.db", "SQLite format 3\0", "give the folder of the model"),
        ("sfm_data.json", "{\"sfm_data_version\": \"0.3\"}", "openMVG_main_openMVG2Colmap"),
        ("cameras.sfm", "{\"version\": [\"1\", \"2\"]}", "aliceVision_exportColmap"),
        ("odometry.csv", "timestamp, frame, x, y, z, qx, qy, qz, qw\n", "trajectory of TUM"),
        ("cameras.json", "[{\"id\": 0, \"img_name\": \"a\"}]", "that it was trained on"),
    ] {
        let path = folder.path().join(file);
        fs::write(&path, content).expect("written");
        for given in [&path, folder.path()] {
            let error = read_posed(given, folder.path()).expect_err("not read").to_string();
            assert!(error.contains(file) && error.contains(remedy), "{error}");
        }
        fs::remove_file(&path).expect("removed");
    }
}

#[test]
fn kitti_needs_to_know_which_camera_took_the_images() {
    let names: Vec<String> = (0..4).map(|frame| format!("{frame:06}.png")).collect();
    let (_kept, images) = images_called(&names, "left");
    let error = read_posed(&data("kitti").join("00.txt"), &images).expect_err("two cameras").to_string();
    assert!(error.contains("calib.txt") && error.contains("image_0 to image_3"), "{error}");
}
