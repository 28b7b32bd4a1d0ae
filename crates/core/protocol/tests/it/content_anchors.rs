//! Documents of content anchors.

use serde_json::{Value, json};
use veiloc_geometry::CameraFromWorld;
use veiloc_protocol::{AnchorPose, ContentAnchor, ContentAnchorError as Fault, ContentAnchors};

const HALF: f64 = std::f64::consts::FRAC_1_SQRT_2;

fn at(name: &str, t: [f64; 3]) -> ContentAnchor {
    let map_from_anchor = AnchorPose { q: [HALF, 0.0, HALF, 0.0], t };
    ContentAnchor { name: name.to_owned(), map_from_anchor, content: json!({"text": name}), owner: None }
}

fn anchor(change: impl Fn(&mut Value)) -> Result<ContentAnchor, Fault> {
    let mut json =
        json!({"map_from_anchor": {"q": [1, 0, 0, 0], "t": [1, 2, 3]}, "content": {"a": [1.5, null, "é"]}});
    change(&mut json);
    ContentAnchor::decode("door", json.to_string().as_bytes())
}

#[test]
fn a_document_is_read_as_it_was_written() {
    let mut all = ContentAnchors::default();
    for name in ["sofa", "door", "Z.9-_"] {
        all.set(at(name, [0.1, f64::from(name.len() as u32), -3.3])).expect("valid");
    }
    let pose = CameraFromWorld::from_quaternion([0.6, 0.0, 0.8, 0.0], [0.1, 0.2, 0.3]).expect("a rotation");
    all.set_frame([("a.jpg", &pose)].into_iter());
    let read = ContentAnchors::decode(&all.encode()).expect("its own");
    assert_eq!((&read, read.encode()), (&all, all.encode()));
    let names: Vec<&str> = all.anchors().iter().map(|anchor| anchor.name.as_str()).collect();
    assert_eq!(names, ["Z.9-_", "door", "sofa"]);
    let read = anchor(|_| ()).expect("valid");
    assert_eq!((read.name.as_str(), &read.content), ("door", &json!({"a": [1.5, null, "é"]})));
    let client = all.clone().for_client(|_| false);
    assert!(client.images().is_empty() && client.anchors() == all.anchors());
    assert!(all.remove("door") && !all.remove("door") && all.get("door").is_none());
}

#[test]
fn invalid_anchors_are_refused_by_name() {
    let pose = |part: &'static str, value: Value| {
        anchor(move |json| json["map_from_anchor"][part] = value.clone()).expect_err("refused")
    };
    for q in [json!([0, 0, 0, 0]), json!([2, 0, 0, 0]), json!([1, 0.1, 0, 0]), json!([1e300, 0, 0, 0])] {
        assert_eq!(pose("q", q.clone()), Fault::Rotation, "{q}");
    }
    assert_eq!(pose("t", json!([0, 0, 1.1e7])), Fault::Position);
    for (part, value) in
        [("q", json!([1, 0, 0])), ("t", json!([0, 0, null])), ("t", json!("x")), ("s", json!(1))]
    {
        assert!(matches!(pose(part, value.clone()), Fault::Json { .. }), "{part} {value}");
    }
    // Quaternions of single precision are rotations, and become unit quaternions.
    let single =
        anchor(|json| json["map_from_anchor"]["q"] = json!([0.60001, 0, 0.80001, 0])).expect("a rotation");
    let length: f64 = single.map_from_anchor.q.iter().map(|c| c * c).sum();
    assert!((length - 1.0).abs() < 1e-15, "{length}");
    assert_eq!(anchor(|json| json["content"] = "x".repeat(4095).into()), Err(Fault::Content));
    anchor(|json| json["content"] = "x".repeat(4094).into()).expect("with its quotation marks 4096 bytes");
    assert_eq!(anchor(|json| json["content"] = "x".repeat(9000).into()), Err(Fault::Content));
    assert_eq!(anchor(|json| json["name"] = "gate".into()), Err(Fault::Name));
    anchor(|json| json["name"] = "door".into()).expect("its own name");
    for bad in ["", ".", "..", "a/b", "a b", "ä", &"x".repeat(65)] {
        assert_eq!(ContentAnchors::default().set(at(bad, [0.0; 3])), Err(Fault::Name), "{bad:?}");
    }
    for text in ["", "{", "[]", "null", "{}", "NaN", "\u{feff}{}", "{\"content\":1e999}"] {
        assert!(
            matches!(ContentAnchor::decode("door", text.as_bytes()), Err(Fault::Json { .. })),
            "{text:?}"
        );
    }
    for bad in [f64::NAN, f64::INFINITY, -1e8] {
        assert_eq!(ContentAnchors::default().set(at("door", [0.0, bad, 0.0])), Err(Fault::Position), "{bad}");
    }
}

#[test]
fn documents_are_bounded() {
    let document = |anchors: Vec<ContentAnchor>, version: u32| {
        ContentAnchors::decode(json!({"version": version, "anchors": anchors}).to_string().as_bytes())
    };
    assert_eq!(document(vec![at("a", [0.0; 3]), at("a", [1.0; 3])], 1), Err(Fault::NameTwice));
    assert_eq!(document(Vec::new(), 2), Err(Fault::Version(2)));
    let many = |count: usize| (0..count).map(|i| at(&i.to_string(), [0.0; 3])).collect::<Vec<_>>();
    let mut full = document(many(1000), 1).expect("as many as a map has");
    assert_eq!(document(many(1001), 1), Err(Fault::TooMany));
    let before = full.clone();
    assert_eq!(full.set(at("one-more", [0.0; 3])), Err(Fault::TooMany));
    full.set(at("7", [1.0; 3])).expect("replaced");
    assert!(full.transform(|pose| AnchorPose { t: pose.t.map(|c| c * 1e8), ..*pose }).is_err());
    assert_eq!(full.anchors().len(), before.anchors().len(), "an error changes nothing");
    let large = |i: u32| ContentAnchor { content: "x".repeat(4000).into(), ..at(&i.to_string(), [0.0; 3]) };
    let mut all = document((0..250).map(large).collect(), 1).expect("a little below 1 MiB");
    let fitted = (300..400).take_while(|i| all.set(large(*i)).is_ok()).count();
    assert!(fitted < 10 && all.encode().len() > (1 << 20) - 4200, "{fitted}");
    assert_eq!(all.extend(&[large(2000)]), Err(Fault::TooLong));
    assert_eq!(all.extend(&[at("7", [0.0; 3])]), Err(Fault::NameTwice));
    // Recorded images do not make a full document unreadable.
    let pose = CameraFromWorld::from_quaternion([0.6, 0.0, 0.8, 0.0], [0.1 / 3.0; 3]).expect("a rotation");
    let names: Vec<String> = (0..1000).map(|i| format!("{}{i:03}", "\u{1}".repeat(i % 200))).collect();
    all.set_frame(names.iter().map(|name| (name.as_str(), &pose)).collect::<Vec<_>>().into_iter());
    assert!(all.images().len() > 30);
    assert_eq!(ContentAnchors::decode(&all.encode()).as_ref(), Ok(&all));
    assert_eq!(ContentAnchors::decode(&vec![b' '; ContentAnchors::MAX_FILE + 1]), Err(Fault::TooLong));
}

#[test]
fn the_nearest_comes_first() {
    let mut all = ContentAnchors::default();
    for (name, t) in [("a", [9.0, 0.0, 0.0]), ("b", [1.0, 2.0, 2.0]), ("c", [1.0, 0.0, 0.5])] {
        all.set(at(name, t)).expect("valid");
    }
    let found: Vec<(&str, f64)> =
        all.nearest([1.0, 0.0, 0.0]).into_iter().map(|(a, d)| (a.name.as_str(), d)).collect();
    assert_eq!(found, [("c", 0.5), ("b", 8.0_f64.sqrt()), ("a", 8.0)]);
}

#[test]
fn a_coordinate_frame_is_recognized_by_images() {
    let pose = |i: u32, x: f64| {
        let a = f64::from(i).sin() / 2.0;
        CameraFromWorld::from_quaternion([(1.0 - a * a).sqrt(), a, 0.0, 0.0], [x, f64::from(i), 2.0])
            .expect("one")
    };
    let images = |from: u32, x: f64| -> Vec<(String, CameraFromWorld)> {
        (from..from + 150).map(|i| (format!("{i}.jpg"), pose(i, x))).collect()
    };
    fn of(images: &[(String, CameraFromWorld)]) -> impl ExactSizeIterator<Item = (&str, &CameraFromWorld)> {
        images.iter().map(|(name, pose)| (name.as_str(), pose))
    }
    let mut all = ContentAnchors::default();
    assert!(all.is_of_frame(of(&images(0, 1.0))), "nothing is recorded");
    all.set_frame(of(&images(0, 1.0)));
    assert_eq!(all.images().len(), 50);
    assert!(all.is_of_frame(of(&images(0, 1.0))));
    assert!(all.is_of_frame(of(&images(100, 1.0))), "images were removed and added");
    assert!(!all.is_of_frame(of(&images(0, 1.001))), "moved");
    assert!(!all.is_of_frame(of(&images(500, 1.0))), "no common image");
    let one_moved: Vec<_> = images(0, 1.0)
        .into_iter()
        .map(|(name, p)| if name == "3.jpg" { (name, pose(4, 1.0)) } else { (name, p) })
        .collect();
    assert!(!all.is_of_frame(of(&one_moved)));
}
