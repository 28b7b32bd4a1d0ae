//! For every bad input the error names the file and the remedy; nothing panics, and no partial result is left.

use super::common;

use common::{CAMERA, Run, TestScene, scene};
use image::{GrayImage, Luma, RgbImage};

/// A command line that must be refused.
struct Case {
    arguments: String,
    /// 1: the input was refused; 2: wrong usage.
    code: i32,
    /// Required parts of the message: the name of the bad input, and a word of the remedy.
    expected_words: &'static [&'static str],
}

fn refused(arguments: impl Into<String>, expected_words: &'static [&'static str]) -> Case {
    Case { arguments: arguments.into(), code: 1, expected_words }
}

fn misused(arguments: impl Into<String>, expected_words: &'static [&'static str]) -> Case {
    Case { arguments: arguments.into(), code: 2, expected_words }
}

/// Runs every case and reports all failures, not only the first.
fn check(scene: &TestScene, cases: Vec<Case>) {
    let mut wrong = Vec::new();
    for case in cases {
        let run = scene.run(&case.arguments);
        let missing: Vec<_> =
            case.expected_words.iter().filter(|word| !plain(&run).contains(**word)).collect();
        if run.code != Some(case.code) || !missing.is_empty() || !run.stdout.is_empty() {
            wrong.push(format!("expected code {} and {missing:?}: {run}", case.code));
        }
    }
    assert!(wrong.is_empty(), "{} cases:\n\n{}", wrong.len(), wrong.join("\n\n"));
}

/// Stderr without the frame and the line breaks that wrap it.
fn plain(run: &Run) -> String {
    let words = run.stderr.split_whitespace().filter(|word| !["│", "×", "╰─▶", "├─▶"].contains(word));
    words.collect::<Vec<_>>().join(" ")
}

fn seal_with(image: &str, camera: &str, profile: &str, more: &str) -> String {
    format!("seal {image} --camera {camera} --profile {profile} -o bad/out.vquery {more}")
}

fn seal(image: &str) -> String {
    seal_with(image, CAMERA, "place.vprofile", "")
}

#[test]
fn images() {
    let scene = scene();
    let png = scene.read("images/query-0.png");
    scene.write("bad/cut.png", &png[..png.len() / 2]);
    scene.write("bad/empty.png", []);
    scene.write("bad/text.png", "this is no image");
    scene.write("bad/cut.heic", b"\0\0\0\x18ftypheic\0\0\0\0mif1heic");
    scene.write("bad/cut.webp", b"RIFF\x24\0\0\0WEBPVP8 ");
    scene.write("bad/phone.avif", b"\0\0\0\x18ftypavif\0\0\0\0mif1avif");
    let view = image::open(scene.path("images/query-0.png")).expect("rendered").to_rgb8();
    let mut jpeg = std::io::Cursor::new(Vec::new());
    view.write_to(&mut jpeg, image::ImageFormat::Jpeg).expect("encoded");
    let jpeg = jpeg.into_inner();
    scene.write("bad/cut.jpg", &jpeg[..jpeg.len() * 2 / 3]);
    scene.write("bad/head.jpg", &jpeg[..100]);
    let mut flipped = png.clone();
    flipped[png.len() / 2] ^= 0xff;
    scene.write("bad/flipped.png", flipped);
    RgbImage::from_pixel(400, 300, image::Rgb([128; 3])).save(scene.path("bad/blank.png")).expect("written");
    GrayImage::from_pixel(300, 400, Luma([9])).save(scene.path("bad/upright.png")).expect("written");

    let mut cases = vec![
        refused(seal("bad/missing.png"), &["bad/missing.png", "check the path"]),
        refused(seal("posed"), &["posed", "no JPEG, PNG, WebP or HEIC file", "give a folder"]),
        refused(seal("-"), &["stdin", "give a file"]),
        refused(seal("bad/cut.png"), &["bad/cut.png", "copy it again"]),
        refused(seal("bad/flipped.png"), &["bad/flipped.png", "copy it again"]),
        refused(seal("bad/cut.jpg"), &["bad/cut.jpg", "copy it again"]),
        refused(seal("bad/head.jpg"), &["bad/head.jpg", "copy it again"]),
        refused(seal("bad/empty.png"), &["bad/empty.png", "JPEG or PNG"]),
        refused(seal("bad/text.png"), &["bad/text.png", "not an image", "PNG, WebP or HEIC"]),
        refused(seal("bad/cut.heic"), &["bad/cut.heic", "copy it again"]),
        refused(seal("bad/cut.webp"), &["bad/cut.webp", "copy it again"]),
        refused(seal("bad/phone.avif"), &["bad/phone.avif", "AVIF", "convert it to JPEG"]),
        refused(seal("place.vmap"), &["place.vmap", "not an image"]),
        refused(seal("bad/upright.png"), &["bad/upright.png", "300x400", "400x300", "give the camera"]),
    ];
    for scheme in ["points", "random-lines", "coordinate-permutation", "dcl"] {
        let scheme = format!("--scheme {scheme}");
        cases.push(refused(
            seal_with("bad/blank.png", CAMERA, "place.vprofile", &scheme),
            &["bad/blank.png", "no usable keypoint", "take another image"],
        ));
    }
    check(scene, cases);
    assert!(!scene.path("bad/out.vquery").exists(), "a refused image leaves no sealed query");
}

/// All texture lies left of the middle: dcl would leave the depth along the anchor's ray free.
#[test]
fn keypoints_on_one_side_only() {
    let scene = scene();
    let mut view = image::open(scene.path("images/query-0.png")).expect("rendered").to_rgb8();
    for (x, _, pixel) in view.enumerate_pixels_mut() {
        if x >= 150 {
            *pixel = image::Rgb([120; 3]);
        }
    }
    scene.write("bad/placeholder", []);
    view.save(scene.path("bad/left.png")).expect("written");
    let command = |scheme: &str| {
        format!(
            "seal bad/left.png --camera {CAMERA} --profile place.vprofile -o bad/left.vquery --scheme {scheme}"
        )
    };
    let expected_words: &[&str] = &["bad/left.png", "one side", "turn the camera", "dcl:horizontal"];
    check(scene, vec![refused(command("dcl:paper"), expected_words)]);
    // The remedy works, and the default needs none.
    scene.run(&command("dcl:horizontal")).succeeded();
    scene.run(&command("dcl")).succeeded();
}

#[test]
fn maps() {
    let scene = scene();
    let map = scene.read("place.vmap");
    scene.seal("query-0.png", "dcl", "good.vquery");
    scene.write("bad/empty.vmap", []);
    scene.write("bad/text.vmap", "no map at all, but long enough to hold a header: ".repeat(40));
    let mut newer = map.clone();
    newer[8..12].copy_from_slice(&3_u32.to_le_bytes());
    scene.write("bad/newer.vmap", &newer);
    newer[8..12].copy_from_slice(&0_u32.to_le_bytes());
    scene.write("bad/older.vmap", &newer);
    scene.write("bad/longer.vmap", [&map[..], &[0]].concat());
    scene.write("bad/in-the-way", []);

    let mut cases = vec![
        refused("map info bad/missing.vmap", &["bad/missing.vmap", "check the path"]),
        refused("map info images", &["images", "check the path"]),
        refused("map info bad/empty.vmap", &["bad/empty.vmap", "map build"]),
        refused("map info bad/text.vmap", &["bad/text.vmap", "map build"]),
        refused("map info good.vquery", &["good.vquery", "map build"]),
        refused("map info bad/newer.vmap", &["bad/newer.vmap", "version 3", "build the map again"]),
        refused("map info bad/older.vmap", &["bad/older.vmap", "version 0", "build the map again"]),
        refused("map info bad/longer.vmap", &["bad/longer.vmap", "copy it again"]),
        refused("localize --map bad/missing.vmap good.vquery", &["bad/missing.vmap", "check the path"]),
        refused("localize --map bad/newer.vmap good.vquery", &["bad/newer.vmap", "build the map again"]),
        refused("map profile bad/empty.vmap -o bad/p", &["bad/empty.vmap", "map build"]),
        refused("map profile place.vmap -o bad/no/such/p", &["bad/no/such/p", "folder"]),
        refused("map profile place.vmap -o bad/in-the-way/p", &["bad/in-the-way/p", "folder"]),
        refused("map remove place.vmap nobody.png -o bad/x.vmap", &["nobody.png", "not in the map"]),
        refused("map remove place.vmap map-01.png map-01.png -o bad/x.vmap", &["map-01.png", "once"]),
        refused("map remove bad/empty.vmap map-01.png", &["bad/empty.vmap", "map build"]),
        refused("map remove place.vmap map-01.png -o bad/no/such/x.vmap", &["bad/no/such/x.vmap", "folder"]),
        refused(
            "map add place.vmap --posed posed --images images --list map.txt -o bad/x.vmap",
            &["map-00.png", "already in the map", "remove it first", "--prefix"],
        ),
        misused("map remove place.vmap", &["NAME"]),
        misused("map info", &["MAP"]),
    ];
    for length in [1, 7, 8, 11, 40, 63, 64, 200, 415, 416, 1000, map.len() / 2, map.len() - 1] {
        scene.write(&format!("bad/cut-{length}.vmap"), &map[..length]);
        let remedy: &[&str] = if length < 8 { &[".vmap", "map build"] } else { &[".vmap", "copy it again"] };
        cases.push(refused(format!("map info bad/cut-{length}.vmap"), remedy));
    }
    // After magic and version, every byte is covered by a checksum or must be zero.
    for at in [12, 16, 30, 60, 70, 300, 420, map.len() / 3, map.len() / 2, map.len() - 1] {
        let mut flipped = map.clone();
        flipped[at] ^= 0x10;
        scene.write(&format!("bad/flipped-{at}.vmap"), flipped);
        cases.push(refused(
            format!("map info bad/flipped-{at}.vmap"),
            &[".vmap", "checksum", "damaged", "copy it again"],
        ));
    }
    check(scene, cases);
    assert!(scene.read("place.vmap") == map, "a refused change leaves the map unchanged");
    assert!(!scene.path("bad/x.vmap").exists());
}

#[test]
fn sealed_queries() {
    let scene = scene();
    scene.seal("query-0.png", "dcl", "fine.vquery");
    let sealed = scene.read("fine.vquery");
    let with_version = |version: u32| {
        // The first field, `fixed32 version = 1`: one byte of tag, four of number.
        let mut bytes = sealed.clone();
        bytes[1..5].copy_from_slice(&version.to_le_bytes());
        bytes
    };
    let random: Vec<u8> = (0_u32..5000).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
    scene.write("bad/empty.vquery", []);
    scene.write("bad/version.vquery", with_version(9));
    scene.write("bad/trailing.vquery", [&sealed[..], &[0]].concat());
    scene.write("bad/doubled.vquery", [&sealed[..], &sealed[..]].concat());
    scene.write("bad/random.vquery", random);
    scene.write("bad/huge.vquery", vec![0; 4 << 20]);
    let mut cases = Vec::new();
    for (name, reason) in [
        ("missing", "check the path"),
        ("empty", "seal the image again"),
        ("version", "version 9"),
        ("trailing", "seal the image again"),
        ("doubled", "seal the image again"),
        ("random", "seal the image again"),
        ("huge", "seal the image again"),
    ] {
        let expected_words: &[&str] = Box::leak(Box::new([".vquery", reason]));
        cases.push(refused(format!("localize --map place.vmap bad/{name}.vquery"), expected_words));
        let run = scene.run(&format!("localize --map place.vmap --json bad/{name}.vquery"));
        let document = run.json();
        assert_eq!((run.code, &document["failed"]), (Some(1), &1.into()), "{run}");
        let kind = if name == "missing" { "missing" } else { "damaged" };
        assert_eq!(document["queries"][0]["error"]["kind"], kind, "{run}");
        assert!(
            document["queries"][0]["error"]["message"].as_str().is_some_and(|m| m.contains(reason)),
            "{run}"
        );
    }
    for length in [1, 4, 5, 6, 30, 70, sealed.len() / 2, sealed.len() - 1] {
        scene.write(&format!("bad/cut-{length}.vquery"), &sealed[..length]);
        cases.push(refused(
            format!("localize --map place.vmap bad/cut-{length}.vquery"),
            &["bad/cut-", ".vquery", "seal the image again"],
        ));
    }
    cases.push(refused("localize --map place.vmap place.vprofile", &["place.vprofile", "veiloc seal"]));
    cases.push(refused("localize --map place.vmap images/query-0.png", &["query-0.png", "veiloc seal"]));
    cases.push(misused("localize --map place.vmap", &["SEALED"]));
    check(scene, cases);
}

/// Flipped bits give an error or another query, never a panic.
#[test]
fn sealed_queries_with_flipped_bytes() {
    let scene = scene();
    scene.seal("query-0.png", "random-lines", "bits.vquery");
    let sealed = scene.read("bits.vquery");
    let mut files = Vec::new();
    for k in 0..24 {
        let mut flipped = sealed.clone();
        let at = if k < 12 { k * 5 } else { k * sealed.len() / 24 };
        flipped[at] ^= 0x41;
        scene.write(&format!("bad/bits-{k}.vquery"), &flipped);
        let run = scene.run(&format!("localize --map place.vmap bad/bits-{k}.vquery"));
        assert!(matches!(run.code, Some(0 | 1)), "{run}");
        files.push(format!("bad/bits-{k}.vquery"));
    }
    let run = scene.run(&format!("localize --map place.vmap {}", files.join(" ")));
    assert_eq!(run.code, Some(1), "an unreadable query counts: {run}");
}

#[test]
fn profiles() {
    let scene = scene();
    let profile = scene.read("place.vprofile");
    scene.write("bad/empty.vprofile", []);
    scene.write("bad/cut.vprofile", &profile[..profile.len() / 2]);
    scene.write("bad/trailing.vprofile", [&profile[..], b"!"].concat());
    let mut newer = profile.clone();
    newer[1..5].copy_from_slice(&9_u32.to_le_bytes());
    scene.write("bad/newer.vprofile", newer);
    let remedy: &[&str] = &["bad/", ".vprofile", "veiloc map profile"];
    let with = |profile: &str| seal_with("images/query-0.png", CAMERA, profile, "");
    check(
        scene,
        vec![
            refused(with("bad/empty.vprofile"), remedy),
            refused(with("bad/cut.vprofile"), remedy),
            refused(with("bad/trailing.vprofile"), remedy),
            refused(with("bad/newer.vprofile"), &["bad/newer.vprofile", "version 9", "veiloc map profile"]),
            refused(with("bad/missing.vprofile"), &["bad/missing.vprofile", "check the path"]),
            refused(with("place.vmap"), &["place.vmap", "veiloc map profile"]),
        ],
    );
}

/// A valid query for another map is a result: it is reported with the other results, with the remedy.
#[test]
fn a_query_for_another_map() {
    let scene = scene();
    scene.write("five.txt", "map-00.png\nmap-01.png\nmap-02.png\nmap-03.png\nmap-04.png\n");
    scene
        .run(
            "map build --posed posed --images images --list five.txt --max-keypoints 512 --query-keypoints 512 \
             -o five.vmap",
        )
        .succeeded();
    scene.run("map profile five.vmap -o five.vprofile").succeeded();
    scene
        .run(&format!("seal images/query-0.png --camera {CAMERA} --profile five.vprofile -o five.vquery"))
        .succeeded();
    let run = scene.run("localize --map place.vmap five.vquery");
    assert_eq!(run.code, Some(1), "{run}");
    for word in ["five.vquery", "veiloc map profile"] {
        assert!(run.stdout.contains(word), "{word}: {run}");
    }
    let run = scene.run("localize --map place.vmap --json five.vquery");
    assert_eq!(run.code, Some(1), "{run}");
    let document = run.json();
    assert_eq!(document["not_found"], 1);
    assert_eq!(document["queries"][0]["error"]["kind"], "wrong_profile");
    let error = document["queries"][0]["error"]["message"].as_str().expect("a reason");
    assert!(error.contains("veiloc map profile") && error.contains("profile"), "{run}");
    assert!(document["queries"][0].get("cam_from_world").is_none(), "{run}");

    // Beside a localized query both are reported; the exit code is 1 unless --skip-bad is given.
    scene.seal("query-0.png", "points", "mine.vquery");
    let run = scene.run("localize --map place.vmap --json five.vquery mine.vquery");
    assert_eq!(run.code, Some(1), "{run}");
    scene.run("localize --map place.vmap --skip-bad five.vquery mine.vquery").succeeded();
    let document = run.json();
    assert_eq!(document["trusted"], 1);
    assert!(document["queries"][0]["error"].is_object() && document["queries"][1].get("error").is_none());
}

#[test]
fn posed_models_and_lists() {
    let scene = scene();
    let lists: [(&str, &[u8]); 9] = [
        ("intrinsics", b"map-00.png SIMPLE_RADIAL 400 300 330 201 149 -0.04\nmap-01.png\n"),
        ("empty", b""),
        ("comments", b"# nothing\n\n"),
        ("twice", b"map-00.png\nmap-01.png\nmap-00.png\n"),
        ("unposed", b"map-00.png\nmap-99.png\n"),
        ("binary", &[0xff, 0xfe, 0x00]),
        ("one", b"map-00.png\n"),
        ("climbing", b"../secret.png\n"),
        ("query", b"query-0.png\nmap-00.png\n"),
    ];
    for (name, bytes) in lists {
        scene.write(&format!("bad/{name}.txt"), bytes);
    }
    let text = |file: &str| String::from_utf8(scene.read(&format!("posed/{file}"))).expect("text");
    let model = |folder: &str, images: &str, cameras: &str| {
        scene.write(&format!("bad/{folder}/images.txt"), images);
        scene.write(&format!("bad/{folder}/cameras.txt"), cameras);
        scene.write(&format!("bad/{folder}/points3D.txt"), text("points3D.txt"));
    };
    let (images, cameras) = (text("images.txt"), text("cameras.txt"));
    let first = images.lines().find(|l| l.contains("map-00.png")).expect("the first image").to_owned();
    let with_first = |words: &dyn Fn(&mut Vec<&str>)| {
        let mut fields: Vec<&str> = first.split(' ').collect();
        words(&mut fields);
        images.replace(&first, &fields.join(" "))
    };
    model("nan", &with_first(&|f| f[6] = "nan"), &cameras);
    model("infinite", &with_first(&|f| f[5] = "inf"), &cameras);
    model("zero", &with_first(&|f| f[1..5].fill("0")), &cameras);
    model("word", &with_first(&|f| f[2] = "north"), &cameras);
    model("short", &with_first(&|f| f.truncate(5)), &cameras);
    model("no-camera", &with_first(&|f| f[8] = "7"), &cameras);
    model("same-name", &images.replace("map-01.png", "map-00.png"), &cameras);
    model("fisheye", &images, &cameras.replace("SIMPLE_RADIAL", "SPHERICAL"));
    model("panorama", &images, &cameras.replace("SIMPLE_RADIAL", "EQUIRECTANGULAR"));
    model("nan-camera", &images, &cameras.replace("330", "nan"));
    model("scaled", &images, &cameras.replace("400 300", "800 600"));
    scene.write("bad/cut-binary/cameras.bin", [1, 0, 0]);
    scene.write("bad/cut-binary/images.bin", []);
    scene.write("bad/cut-binary/points3D.bin", []);
    scene.write("bad/here", []);

    let build = |posed: &str, list: &str, out: &str| {
        format!("map build --posed {posed} --images images --list {list} -o {out}")
    };
    let list = |name: &str| build("posed", &format!("bad/{name}.txt"), "bad/x.vmap");
    let posed = |name: &str| build(&format!("bad/{name}"), "map.txt", "bad/x.vmap");
    check(
        scene,
        vec![
            refused(list("empty"), &["bad/empty.txt", "write one image name per line"]),
            refused(list("comments"), &["bad/comments.txt", "write one image name per line"]),
            refused(list("twice"), &["bad/twice.txt", "map-00.png", "twice", "once"]),
            refused(list("unposed"), &["map-99.png", "no pose", "remove it from the list"]),
            refused(list("climbing"), &["../secret.png", "no pose"]),
            refused(list("binary"), &["bad/binary.txt", "one image name per line"]),
            refused(list("missing"), &["bad/missing.txt", "check the path"]),
            refused(list("intrinsics"), &["bad/intrinsics.txt", "line 1", "would not be used", "names only"]),
            refused(list("one"), &["no point could be triangulated", "overlap"]),
            refused(build("bad/missing", "map.txt", "bad/x.vmap"), &["bad/missing", "check the path"]),
            refused(
                build("images", "map.txt", "bad/x.vmap"),
                &["images", "no posed images", "transforms.json"],
            ),
            refused(posed("nan"), &["images.txt", "line", "not finite", "remove the image"]),
            refused(posed("infinite"), &["images.txt", "line", "not finite", "remove the image"]),
            refused(posed("zero"), &["images.txt", "line", "quaternion is zero", "remove the image"]),
            refused(posed("word"), &["images.txt", "line", "north", "not such a number"]),
            refused(posed("short"), &["images.txt", "line", "ends before"]),
            refused(posed("no-camera"), &["no-camera", "map-00.png", "camera 7", "add it"]),
            refused(posed("same-name"), &["same-name", "map-00.png", "twice", "keep one"]),
            refused(posed("fisheye"), &["cameras.txt", "line", "SPHERICAL", "undistort"]),
            refused(posed("panorama"), &["cameras.txt", "line", "EQUIRECTANGULAR", "perspective images"]),
            refused(posed("nan-camera"), &["cameras.txt", "line 2", "NaN", "correct the line"]),
            refused(posed("scaled"), &["map-00.png", "400x300", "800x600", "neither scaled nor turned"]),
            refused(posed("cut-binary"), &["cameras.bin", "byte 0", "export the model again"]),
            refused("map build --posed posed --images bad -o bad/x.vmap", &["map-00.png", "check the path"]),
            refused(build("posed", "map.txt", "bad/no/such/x.vmap"), &["bad/no/such/x.vmap", "folder"]),
            refused(build("posed", "map.txt", "bad/here/x.vmap"), &["bad/here/x.vmap", "folder"]),
            refused(build("posed", "map.txt", "images"), &["images", "a file is expected"]),
            refused(
                "map import --model posed --images images -o bad/x.vmap",
                &["0 points", "build a map instead"],
            ),
            refused(
                "map import --model bad --images images -o bad/x.vmap",
                &["models in it", "bad/cut-binary"],
            ),
            refused(
                "eval scene --posed posed --images images --map-list map.txt --query-list bad/query.txt",
                &["map-00.png", "map list", "query list"],
            ),
            refused(
                "eval scene --posed posed --images images --map-list map.txt --query-list bad/unposed.txt",
                &["map-99.png", "no pose"],
            ),
            refused(
                "eval scene --posed posed --images images --map-list bad/empty.txt --query-list queries.txt",
                &["bad/empty.txt", "write one image name per line"],
            ),
        ],
    );
    assert!(!scene.path("bad/x.vmap").exists(), "a refused build leaves no map");
}

/// All images are blank: no map can be built.
#[test]
fn blank_images() {
    let scene = scene();
    for i in 0..4 {
        let path = format!("blank/map-{i:02}.png");
        scene.write(&path, []);
        GrayImage::from_pixel(400, 300, Luma([100])).save(scene.path(&path)).expect("written");
    }
    scene.write("bad/blank.txt", "map-00.png\nmap-01.png\nmap-02.png\nmap-03.png\n");
    let build = "map build --posed posed --images blank --list bad/blank.txt -o bad/blank.vmap";
    check(scene, vec![refused(build, &["no usable keypoints", "not blank"])]);
}

#[test]
fn problems() {
    let scene = scene();
    let good = r#"{"name":"q","camera":{"model":"PINHOLE","width":640,"height":480,"params":[500,500,320,240]},"points2d":[[1,2],[5,6],[3,4]],"points3d":[[0,0,1],[0,1,1],[1,0,1]],"cam_from_world":{"q":[1,0,0,0],"t":[0,0,0]},"ratio":[0.5,0.6,0.7]}"#;
    let mut cases = Vec::new();
    let mut case = |name: &str, second: &str, expected_words: &'static [&'static str]| {
        scene.write(&format!("bad/{name}.jsonl"), format!("{good}\n{second}\n"));
        cases.push(refused(format!("eval pose bad/{name}.jsonl"), expected_words));
    };
    case("brace", "{", &["bad/brace.jsonl:2", "EOF"]);
    case("words", "hello", &["bad/words.jsonl:2"]);
    case("nan", &good.replace("[0,1,1]", "[0,NaN,1]"), &["bad/nan.jsonl:2"]);
    case("null", &good.replace("[0,1,1]", "[0,null,1]"), &["bad/null.jsonl:2"]);
    case("huge", &good.replace("[0,1,1]", "[0,1e999,1]"), &["bad/huge.jsonl:2"]);
    case(
        "unequal",
        &good.replace("[0,1,1],", ""),
        &["bad/unequal.jsonl:2", "points3d has 2", "points2d has 3"],
    );
    case("ratios", &good.replace("0.6,", ""), &["bad/ratios.jsonl:2", "ratio has 2"]);
    case("camera", &good.replace("PINHOLE", "SPHERICAL"), &["bad/camera.jsonl:2", "SPHERICAL"]);
    case("focal", &good.replace("[500,500", "[0,500"), &["bad/focal.jsonl:2"]);
    case("pose", &good.replace("[1,0,0,0]", "[0,0,0,0]"), &["bad/pose.jsonl:2", "not a finite pose"]);
    case(
        "missing-field",
        &good.replace("\"points2d\"", "\"points\""),
        &["bad/missing-field.jsonl:2", "points2d"],
    );
    scene.write("bad/nothing.jsonl", "");
    scene.write("bad/gzip.jsonl.gz", [0x1f, 0x8b, 8, 0, 1, 2, 3]);
    scene.write("bad/good.jsonl", good);
    cases.extend([
        refused(
            "eval pose bad/nothing.jsonl",
            &["bad/nothing.jsonl", "one JSON object per line is expected"],
        ),
        refused("eval pose bad/gzip.jsonl.gz", &["bad/gzip.jsonl.gz", "copy it again"]),
        refused("eval pose bad/absent.jsonl", &["bad/absent.jsonl", "check the path"]),
        refused("eval pose images", &["images", "a file is expected"]),
        refused("eval pose bad/good.jsonl --json bad/no/such/r.json", &["bad/no/such/r.json", "folder"]),
        misused("eval pose bad/good.jsonl --schemes dcl,cubes", &["cubes", "points"]),
        misused("eval pose bad/good.jsonl --thresholds 5", &["TRANSLATION/DEGREES"]),
        misused("eval pose bad/good.jsonl --angle-bits 40", &["40"]),
        misused("eval pose bad/good.jsonl --estimator best", &["best"]),
        misused("eval pose", &["PROBLEMS"]),
    ]);
    check(scene, cases);

    // Three matches are too few for lines: a query without pose is a result, and the exit code is 1 if no query has a
    // pose.
    let run = scene.run("eval pose bad/good.jsonl --schemes dcl --json");
    assert_eq!(run.code, Some(1), "{run}");
    let document = run.json();
    assert_eq!(document["schemes"][0]["localized"], 0);
    assert!(document["schemes"][0]["median_rotation_deg"].is_null(), "{run}");
    assert!(document["queries"][0]["failure"].is_string(), "{run}");
}

#[test]
fn usage() {
    let scene = scene();
    // The output folder of sealed queries.
    scene.write("bad/placeholder", []);
    let camera = |camera: &str| seal_with("images/query-0.png", camera, "place.vprofile", "");
    let option = |more: &str| seal_with("images/query-0.png", CAMERA, "place.vprofile", more);
    scene.seal("query-0.png", "dcl", "usage.vquery");
    let localize = |more: &str| format!("localize --map place.vmap usage.vquery {more}");
    check(
        scene,
        vec![
            misused("", &["Usage"]),
            misused("fly", &["fly", "help"]),
            misused("map", &["Usage"]),
            misused("map explode place.vmap", &["explode", "help"]),
            misused("map info place.vmap --loudly", &["--loudly", "help"]),
            misused(camera("nonsense"), &["nonsense"]),
            misused(camera("PINHOLE"), &["--camera"]),
            misused(camera("PINHOLE,400,300"), &["--camera"]),
            misused(camera("PINHOLE,400,300,330,330,200,x"), &["--camera"]),
            misused(camera("PINHOLE,400,300,nan,330,200,150"), &["--camera"]),
            misused(camera("PINHOLE,400,300,0,330,200,150"), &["--camera"]),
            misused(camera("PINHOLE,0,0,330,330,200,150"), &["--camera"]),
            misused(camera("FISHEYE,400,300,330,200,150"), &["FISHEYE"]),
            refused(camera("PINHOLE,400,300,3,3,200,150"), &["images/query-0.png", "check the camera"]),
            refused(camera("PINHOLE,400,300,1e9,1e9,200,150"), &["images/query-0.png", "check the camera"]),
            misused(option("--scheme cubes"), &["cubes", "random-lines"]),
            misused(option("--scheme dcl:angle=999"), &["999"]),
            misused(option("--scheme dcl:s=nan"), &["--scheme"]),
            misused(localize("--score best"), &["--score"]),
            misused(localize("--need far"), &["far"]),
            refused("map build --posed posed --images images -o bad/x.vmap --features orb", &["orb", "sift"]),
            misused("map build --posed posed --images images -o bad/x.vmap --max-keypoints 3", &["3"]),
        ],
    );
    // A scale out of all proportion gives "not localized"; it never causes a panic.
    scene.write("bad/noise.toml", "noise-px = 1e300");
    let run = scene.run("eval pose bad/good.jsonl --estimator bad/noise.toml");
    assert!(matches!(run.code, Some(0..=2)), "{run}");
}

#[test]
fn outputs() {
    let scene = scene();
    let photo = scene.read("images/query-0.png");
    scene.write("bad/copy/query-0.png", &photo);
    scene.write("bad/file", []);
    let two = |images: &str, out: &str| {
        format!("seal {images} --camera {CAMERA} --profile place.vprofile -o {out}")
    };
    check(
        scene,
        vec![
            refused(
                two("images/query-0.png bad/copy/query-0.png", "bad/both"),
                &["images/query-0.png", "bad/copy/query-0.png", "bad/both/query-0.vquery", "different --out"],
            ),
            refused(
                two("images/query-0.png images/query-1.png", "bad/file"),
                &["bad/file", "choose a writable folder"],
            ),
            refused(two("images/query-0.png", "bad/no/such/q.vquery"), &["bad/no/such/q.vquery", "folder"]),
            refused(
                two("bad/copy/query-0.png", "bad/copy/query-0.png"),
                &["bad/copy/query-0.png", "another"],
            ),
            refused(two("images/query-0.png", "./place.vprofile"), &["place.vprofile", "another"]),
        ],
    );
    assert!(scene.read("bad/copy/query-0.png") == photo, "the image is not overwritten");
}

/// A name can be copied from the message for any terminal width.
#[test]
fn long_names_stay_whole() {
    let scene = scene();
    // The output folder of sealed queries.
    scene.write("bad/placeholder", []);
    let name = format!("bad/{}/{}.vmap", "a-long-folder-name-with-hyphens".repeat(3), "and-a-file".repeat(6));
    let run = scene.run(&format!("map info {name}"));
    assert!(run.code == Some(1) && run.stderr.contains(&name), "{run}");
    let name = name.replace(".vmap", ".png");
    let run = scene.run(&seal(&name));
    assert!(run.code == Some(1) && run.stderr.contains(&name), "{run}");
}
