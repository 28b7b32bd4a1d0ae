//! Calls of the loader: seals equal those of the library for the same pixels and random bytes; steps, inspection,
//! attacks; and an error, never a panic, for every invalid call.

use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha20Rng;
use serde_json::{Value, json};
use veiloc_descriptor::{DescriptorKind, Descriptors, Vocabulary};
use veiloc_features::{GrayImage, Image};
use veiloc_geometry::Intrinsics;
use veiloc_obfuscation::{Extracted, KnownPlace, PackUse, SealOptions, Sealer};
use veiloc_protocol::{CoarseGravity, Pack, Profile, SealedQuery};
use veiloc_web::device::Device;
use veiloc_web::exports::reply;
use veiloc_web::inspection::ATTACKS;
use veiloc_web::message;

const CAMERA: &str = "SIMPLE_RADIAL,320,240,260,160,120,-0.01";
const SEED: [u8; 32] = [7; 32];

fn profile() -> Profile {
    let words = (0..4 * 128_u32).map(|i| (i * 37 % 120) as u8).collect();
    let words = Descriptors::new(DescriptorKind::ROOT_SIFT, words).expect("whole rows");
    Profile::vlad(Vocabulary::new(words).expect("words"))
}

/// Blocks of random colours at two sizes, which give many corners.
fn pixels() -> Vec<u8> {
    let mut rng = ChaCha20Rng::seed_from_u64(3);
    let blocks: Vec<[u8; 3]> = (0..80 * 60).map(|_| rng.random()).collect();
    let at = |x: usize, y: usize| {
        let (fine, coarse) = (blocks[y / 4 * 80 + x / 4], blocks[y / 20 * 80 + x / 20]);
        [0, 1, 2].map(|c| fine[c] / 3 + coarse[c] / 2)
    };
    (0..240).flat_map(|y| (0..320).flat_map(move |x| at(x, y).into_iter().chain([200]))).collect()
}

fn call(device: &mut Device, head: &Value, parts: &[&[u8]]) -> (Value, Vec<u8>) {
    let reply = reply(device, &message::write(head, &parts.concat()));
    let (head, bytes) = message::read::<Value>(&reply).expect("a reply");
    (head, bytes.to_vec())
}

/// A device with a profile, and its handle.
fn device_and_profile() -> (Device, Value) {
    let mut device = Device::default();
    let (head, _) = call(&mut device, &json!({"op": "profile"}), &[&profile().encode()]);
    assert_eq!(head["id"], profile().id().to_string());
    (device, head["profile"].clone())
}

/// Calls with fields in place of the defaults: of the sealer, of the image, and the session.
#[derive(Clone)]
struct Calls {
    profile: Value,
    options: Value,
    /// Bytes of a pack; nothing for none.
    pack: Vec<u8>,
    image: Value,
    session: Value,
    seed: [u8; 32],
}

impl Calls {
    fn of(profile: Value) -> Self {
        let image = json!({"width": 320, "height": 240, "camera": CAMERA});
        Self { profile, options: json!({}), pack: Vec::new(), image, session: Value::Null, seed: SEED }
    }

    /// Makes a sealer, extracts and seals; the reply of the last call, or of the first that fails.
    fn seal(&self, device: &mut Device, pixels: &[u8]) -> (Value, Vec<u8>) {
        let (sealer, none) = call(
            device,
            &with(&self.options, &[("op", json!("sealer")), ("profile", self.profile.clone())]),
            &[&self.pack],
        );
        if !sealer["error"].is_null() {
            return (sealer, none);
        }
        let sealer = ("sealer", sealer["sealer"].clone());
        let (extracted, none) =
            call(device, &with(&self.image, &[("op", json!("extract")), sealer.clone()]), &[pixels]);
        if !extracted["error"].is_null() {
            return (extracted, none);
        }
        let extracted = ("extracted", extracted["extracted"].clone());
        let seal = with(&json!({"op": "seal", "session": self.session}), &[sealer, extracted]);
        let sealed = call(device, &seal, &[&self.seed]);
        // An image is sealed once (rule L7), also when it failed; an unknown session uses nothing up.
        let again = call(device, &with(&seal, &[("session", Value::Null)]), &[&self.seed]).0;
        assert_eq!(again["kind"] == "gone", sealed.0["kind"] != "gone", "{again}");
        sealed
    }
}

fn with(head: &Value, fields: &[(&str, Value)]) -> Value {
    let mut head = head.clone();
    for (field, value) in fields {
        head[*field] = value.clone();
    }
    head
}

/// What the library extracts of the image.
fn extracted(sealer: &Sealer) -> Extracted {
    let rgb: Vec<u8> = pixels().chunks(4).flat_map(|p| [p[0], p[1], p[2]]).collect();
    let image = Image::from(GrayImage::from_rgb8(320, 240, &rgb).expect("an image"));
    let camera: Intrinsics = CAMERA.parse().expect("a camera");
    sealer.extract(image, camera).expect("features")
}

/// A place of which this image is known, each keypoint a point.
fn pack() -> Pack {
    let sealer = Sealer::new(&profile(), SealOptions::default()).expect("its profile");
    let rows = extracted(&sealer).features().descriptors.clone();
    let points = rows.len() as u32;
    Pack::new(profile(), points, [((0..points).collect(), rows)]).expect("a pack")
}

/// Nothing under a mask reaches the query (rule L13), whatever the resolution of the mask; what hides nothing is none.
/// The network of the tests takes what is red for people (`research/oracles/segmenter.py`).
#[test]
fn people_are_hidden_in_turned_images_too() {
    let (mut device, profile) = device_and_profile();
    let network = include_bytes!("../../../crates/device/features/tests/data/segmenter/red.tflite");
    let (head, _) = call(&mut device, &json!({"op": "segmenter"}), &[network]);
    let segmenter = head["segmenter"].clone();
    assert!(segmenter.is_u64(), "{head}");
    let (refused, _) = call(&mut device, &json!({"op": "segmenter"}), &[&network[..400]]);
    assert!(
        refused["error"].as_str().is_some_and(|text| text.contains("selfie_segmentation.tflite")),
        "{refused}"
    );
    let (sealer, _) = call(&mut device, &json!({"op": "sealer", "profile": profile}), &[]);
    // Half as much red, so that nothing looks like a person.
    let blue: Vec<u8> = pixels().chunks_exact(4).flat_map(|p| [p[0] / 2, p[1], p[2], p[3]]).collect();
    let mut red = blue.clone();
    for (y, x) in (40..100).flat_map(|y| (60..140).map(move |x| (y, x))) {
        // Two reds, so that there are corners under the mask.
        red[(y * 320 + x) * 4..][..3].copy_from_slice(&[
            if (x / 5 + y / 7) % 2 == 0 { 255 } else { 230 },
            5,
            5,
        ]);
    }
    let extract =
        json!({"op": "extract", "sealer": sealer["sealer"], "width": 320, "height": 240, "camera": CAMERA});
    let mut hidden = |pixels: &[u8], people: &Value, turn: i32| {
        let head = with(&extract, &[("people", people.clone()), ("turn", json!(turn))]);
        call(&mut device, &head, &[pixels]).0
    };
    assert_eq!(hidden(&red, &Value::Null, 0)["hidden"], 0.0);
    assert_eq!(hidden(&blue, &segmenter, 0)["hidden"], 0.0, "nobody");
    for turn in [0, 90, 180, 270] {
        let reply = hidden(&red, &segmenter, turn);
        // 80 x 60 of 320 x 240, and the margin.
        assert!((0.0625..0.1).contains(&reply["hidden"].as_f64().expect("a share")), "{turn}: {reply}");
        assert!(
            reply["keypoints"].as_u64() < hidden(&red, &Value::Null, 0)["keypoints"].as_u64(),
            "{turn}: {reply}"
        );
    }
    assert_eq!(hidden(&red, &segmenter, 45)["kind"], "option");
    assert_eq!(hidden(&red, &json!(9999), 0)["kind"], "gone");
}

#[test]
fn nothing_under_a_mask_is_sent() {
    let (mut device, profile) = device_and_profile();
    let labels: Vec<u8> =
        (0..32 * 24).map(|at| u8::from((10..20).contains(&(at % 32)) && at / 32 > 12) * 9).collect();
    let mut hidden = pixels();
    for (at, pixel) in hidden.chunks_mut(4).enumerate() {
        if labels[at / 320 / 10 * 32 + at % 320 / 10] != 0 {
            for value in pixel {
                *value = !*value;
            }
        }
    }
    let masked = |kind: &str, more: Value| {
        let mask = with(&json!({"width": 32, "height": 24, "kind": kind}), &[]);
        let mask = with(
            &mask,
            &more
                .as_object()
                .expect("fields")
                .iter()
                .map(|(k, v)| (k.as_str(), v.clone()))
                .collect::<Vec<_>>(),
        );
        let image = json!({"width": 320, "height": 240, "camera": CAMERA, "mask": mask});
        Calls { image, ..Calls::of(profile.clone()) }
    };
    let of = |pixels: &[u8], labels: &[u8]| [pixels, labels].concat();
    let mask = masked("marked", json!({}));
    let (head, shown) = mask.seal(&mut device, &of(&pixels(), &labels));
    assert!(head["query"].is_u64(), "{head}");
    assert!(mask.seal(&mut device, &of(&hidden, &labels)).1 == shown, "nothing under it is sent");
    assert!(
        masked("arcore-semantics", json!({})).seal(&mut device, &of(&hidden, &labels)).1 == shown,
        "the same pixels"
    );
    let plain = Calls::of(profile.clone());
    let without = plain.seal(&mut device, &pixels()).1;
    assert!(without != shown && plain.seal(&mut device, &hidden).1 != without, "the region has keypoints");
    assert!(
        masked("marked", json!({})).seal(&mut device, &of(&pixels(), &[0; 32 * 24])).1 == without,
        "none"
    );
    for (mask, labels, part) in [
        (masked("unknown", json!({})), labels.clone(), "unknown"),
        (masked("marked", json!({"margin": -1.0})), labels.clone(), "margin"),
        (masked("marked", json!({})), labels[..700].to_vec(), "700"),
        (masked("marked", json!({})), vec![1; 32 * 24], "hides the whole image"),
        (plain, labels, "samples"),
    ] {
        let (head, _) = mask.seal(&mut device, &of(&pixels(), &labels));
        assert!(head["error"].as_str().is_some_and(|text| text.contains(part)), "{part}: {head}");
    }
}

#[test]
fn with_a_pack_the_library_s_matches_are_sent() {
    let (mut device, profile_handle) = device_and_profile();
    let (pack, pixels) = (pack(), pixels());
    let place = KnownPlace::new(pack.clone()).expect("SIFT");
    let calls = Calls { pack: pack.encode(), ..Calls::of(profile_handle) };
    for (send, usage) in [
        (json!(null), PackUse::Matches),
        (json!("matches"), PackUse::Matches),
        (json!("explained"), PackUse::Explained),
    ] {
        let calls = Calls { options: json!({"pack": true, "send": send}), ..calls.clone() };
        let (head, bytes) = calls.seal(&mut device, &pixels);
        let options = SealOptions::default().with_place(place.clone(), usage);
        let sealer = Sealer::new(&profile(), options).expect("its profile");
        let query = sealer.seal(extracted(&sealer), &mut ChaCha20Rng::from_seed(SEED)).expect("sealed");
        assert!(query.encode() == bytes, "{head}");
        assert_eq!(query.descriptors().is_some(), usage == PackUse::Explained);
        // The device shows the lines; rows without descriptors do not tell their keypoints.
        let (shown, _) = call(&mut device, &json!({"op": "show", "query": head["query"]}), &[]);
        assert!(shown["segments"].as_u64() >= Some(query.len() as u64));
        assert_eq!(shown["real"].as_u64() == Some(0), usage == PackUse::Matches, "{shown}");
        let (exhibited, exhibit) = call(&mut device, &json!({"op": "exhibit", "query": head["query"]}), &[]);
        let attack = json!({"op": "attack", "attack": "prior", "queryBytes": exhibited["queryBytes"]});
        assert_eq!(call(&mut device, &attack, &[&exhibit]).0["count"], shown["real"]);
    }
    // Without the word no payload is read as a pack, and without a pack there is no word for what is sent.
    let given = |options: Value, bytes: &[u8]| Calls { options, pack: bytes.to_vec(), ..calls.clone() };
    let bytes = pack.encode();
    for (calls, kind) in [
        (given(json!({"pack": true}), &[]), "pack"),
        (given(json!({"pack": true}), &bytes[1..]), "pack"),
        (given(json!({"pack": true, "send": "all"}), &bytes), "option"),
        (given(json!({"send": "matches"}), &[]), "option"),
    ] {
        assert_eq!(calls.seal(&mut device, &pixels).0["kind"], kind);
    }
    let noise: Vec<u8> =
        (0..pixels.len() as u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
    let elsewhere = given(json!({"pack": true}), &bytes).seal(&mut device, &noise).0;
    assert_eq!(elsewhere["kind"], "not-this-place", "{elsewhere}");
}

#[test]
fn seals_equal_those_of_the_library() {
    let (mut device, profile_handle) = device_and_profile();
    let pixels = pixels();
    let (head, bytes) = Calls::of(profile_handle).seal(&mut device, &pixels);

    let profile = profile();
    let sealer = Sealer::new(&profile, SealOptions::default()).expect("its profile");
    let query = sealer.seal(extracted(&sealer), &mut ChaCha20Rng::from_seed(SEED)).expect("sealed");
    assert!(query.encode() == bytes, "{head}");
    assert_eq!(head["rows"], query.len());
    assert!(query.len() >= 512, "too little texture for this test");

    // Every step is a prefix of the query, as the library cuts it.
    let steps: Vec<usize> = serde_json::from_value(head["steps"].clone()).expect("numbers");
    assert_eq!(steps.last(), Some(&query.len()));
    for (rows, class) in steps.iter().zip(query.step_sizes()) {
        let step = json!({"op": "step", "query": head["query"], "rows": rows});
        let part = query.first_rows(class, &profile).expect("a step");
        assert!(call(&mut device, &step, &[]).1 == part.encode(), "{rows}");
    }
    assert_eq!(
        call(&mut device, &json!({"op": "step", "query": head["query"], "rows": 257}), &[]).0["kind"],
        "option"
    );
}

#[test]
fn shown_lines_are_those_of_the_query() {
    let (mut device, profile) = device_and_profile();
    let (head, bytes) = Calls::of(profile).seal(&mut device, &pixels());
    let query = SealedQuery::decode(&bytes).expect("a query");
    let (shown, numbers) = call(&mut device, &json!({"op": "show", "query": head["query"]}), &[]);
    assert_eq!(
        (shown["width"].clone(), shown["anchors"].as_array().map(Vec::len)),
        (json!(query.camera().width), Some(2))
    );
    let count = |field: &str| shown[field].as_u64().expect("a count") as usize;
    // The line of a row may cross several strips of its anchor.
    assert!(count("segments") >= query.len());
    assert_eq!(numbers.len(), 4 * (4 * count("segments") + 2 * count("keypoints") + 2 * count("real")));
    assert_eq!(count("real"), query.len(), "there are no decoys, and each row has its keypoint");

    // Another worker attacks; the exhibit is its only input.
    let (reply_head, exhibit) = call(&mut device, &json!({"op": "exhibit", "query": head["query"]}), &[]);
    assert!(exhibit.starts_with(&bytes) && reply_head["queryBytes"] == bytes.len(), "{reply_head}");
    let mut other = Device::default();
    let mut medians = Vec::new();
    for (name, words, _) in ATTACKS {
        let attack = json!({"op": "attack", "attack": name, "queryBytes": reply_head["queryBytes"]});
        let (found, numbers) = call(&mut other, &attack, &[&exhibit]);
        assert_eq!((&found["words"], numbers.len()), (&json!(words), 16 * query.len()), "{found}");
        medians.push(found["medianPx"].as_f64().expect("a median"));
        assert_eq!(found["priorMedianPx"], medians[0]);
    }
    // With true neighbours the graph attack beats the prior-only baseline, so rows and true keypoints correspond.
    assert!(medians[3] < 0.5 * medians[0], "{medians:?}");
}

#[test]
fn gravity_is_sent_in_and_without_a_session_unless_it_is_switched_off() {
    let (mut device, profile) = device_and_profile();
    let (session, _) = call(&mut device, &json!({"op": "session"}), &[&SEED]);
    let (calls, pixels) = (Calls::of(profile), pixels());
    let mut gravity_of = |fields: &[(&str, Value)], in_session: bool, options: Value| {
        let session = if in_session { session["session"].clone() } else { Value::Null };
        let calls = Calls { image: with(&calls.image, fields), session, options, ..calls.clone() };
        let (_, bytes) = calls.seal(&mut device, &pixels);
        SealedQuery::decode(&bytes).expect("a query").gravity()
    };
    let down = ("down", json!([0.1, 0.9, 0.2]));
    let rounded = |sd_deg| CoarseGravity::new([0.1, 0.9, 0.2], sd_deg).ok();
    assert_eq!(gravity_of(&[], false, json!({})), None);
    assert_eq!(gravity_of(std::slice::from_ref(&down), false, json!({})), rounded(0.5));
    assert_eq!(gravity_of(&[down.clone(), ("downSdDeg", json!(2))], false, json!({})), rounded(2.0));
    let orientation = [down, ("orientation", json!([1.0, 0.0, 0.0, 0.0]))];
    assert_eq!(gravity_of(&orientation, true, json!({})), rounded(0.5));
    assert_eq!(gravity_of(&orientation, true, json!({"sendGravity": false})), None);
}

#[test]
fn session_resumes_from_bytes() {
    let (mut device, profile) = device_and_profile();
    let (session, _) = call(&mut device, &json!({"op": "session", "anchors": "world"}), &[&SEED]);
    let mut calls = Calls { session: session["session"].clone(), ..Calls::of(profile) };
    calls.image["orientation"] = json!([1.0, 0.0, 0.0, 0.0]);
    let pixels = pixels();
    let (first, _) = calls.seal(&mut device, &pixels);
    assert_eq!((&first["frames"], &first["starts"]), (&json!(1), &json!(1)), "{first}");
    let (_, session_bytes) = call(&mut device, &json!({"op": "sessionBytes", "session": calls.session}), &[]);
    let (again, _) = call(&mut device, &json!({"op": "sessionFrom"}), &[&session_bytes]);
    assert_eq!(again["frames"], 1);
    (calls.session, calls.seed) = (again["session"].clone(), [8; 32]);
    calls.image["orientation"] = json!([0.9998, 0.0, 0.02, 0.0]);
    let (second, _) = calls.seal(&mut device, &pixels);
    assert_eq!((&second["frames"], &second["starts"]), (&json!(2), &json!(1)), "{second}");
}

#[test]
fn invalid_calls_return_errors() {
    let (mut device, profile) = device_and_profile();
    let (calls, pixels) = (Calls::of(profile), pixels());
    for (head, bytes, kind) in [
        (json!({"op": "no"}), &[][..], "call"),
        (json!([]), &[], "call"),
        (json!({"op": "profile"}), &[1, 2, 3], "profile"),
        (json!({"op": "sessionFrom"}), &[1, 2, 3], "session"),
        (json!({"op": "session"}), &[1, 2, 3], "call"),
        (json!({"op": "show", "query": 99}), &[], "gone"),
        (json!({"op": "exhibit", "query": 99}), &[], "gone"),
        (json!({"op": "attack", "attack": "guess", "queryBytes": 0}), &[], "option"),
        (json!({"op": "attack", "attack": "prior", "queryBytes": 2}), &[1, 2, 3], "query"),
        (json!({"op": "attack", "attack": "prior", "queryBytes": 4}), &[1, 2, 3], "call"),
        (json!({"op": "sealer", "profile": 77}), &[], "gone"),
        (json!({"op": "extract", "sealer": 77, "width": 320, "height": 240}), &pixels, "gone"),
        (json!({"op": "seal", "sealer": 77, "extracted": 77}), &SEED, "gone"),
    ] {
        let (answer, _) = call(&mut device, &head, &[bytes]);
        assert_eq!(answer["kind"], kind, "{head}: {answer}");
        assert!(answer["error"].as_str().is_some_and(|text| !text.is_empty()));
    }
    let image = |field, value| Calls { image: with(&calls.image, &[(field, value)]), ..calls.clone() };
    let options = |field, value| Calls { options: with(&calls.options, &[(field, value)]), ..calls.clone() };
    for (calls, bytes, kind) in [
        (calls.clone(), &pixels[..40], "image"),
        (image("width", json!(0)), &pixels, "image"),
        (image("width", json!(u32::MAX)), &pixels, "image"),
        (image("camera", json!("SIMPLE_PINHOLE,320,240")), &pixels, "camera"),
        (image("camera", json!("SIMPLE_PINHOLE,640,480,500,320,240")), &pixels, "image"),
        (image("orientation", json!([0, 0, 0, 0])), &pixels, "option"),
        (image("secret", json!(1)), &pixels, "call"),
        (options("scheme", json!("points")), &pixels, "seal"),
        (options("scheme", json!("rot13")), &pixels, "option"),
        (options("angleBits", json!(200)), &pixels, "option"),
        (options("secret", json!(1)), &pixels, "call"),
        (Calls { session: json!(77), ..calls.clone() }, &pixels, "gone"),
        (Calls { profile: json!(77), ..calls.clone() }, &pixels, "gone"),
    ] {
        let (answer, _) = calls.seal(&mut device, bytes);
        assert_eq!(answer["kind"], kind, "{answer}");
    }
    for junk in [&[][..], &[255; 3], &[255; 64], &[0; 64]] {
        let answer = reply(&mut device, junk);
        assert_eq!(message::read::<Value>(&answer).expect("a reply").0["kind"], "call");
    }
    let (sealed, _) = calls.seal(&mut device, &pixels);
    let (reply_head, exhibit) = call(&mut device, &json!({"op": "exhibit", "query": sealed["query"]}), &[]);
    let attack = json!({"op": "attack", "attack": "prior", "queryBytes": reply_head["queryBytes"]});
    for cut in [exhibit.len() - 1, exhibit.len() - 16] {
        assert_eq!(
            call(&mut device, &attack, &[&exhibit[..cut]]).0["kind"],
            "call",
            "a row without its keypoint"
        );
    }
    // A blank image has no features.
    assert_eq!(calls.seal(&mut device, &vec![90; 320 * 240 * 4]).0["kind"], "texture");
}

#[test]
fn oldest_queries_are_dropped() {
    let (mut device, profile) = device_and_profile();
    let (small, pixels) = (Calls { options: json!({"maxKeypoints": 256}), ..Calls::of(profile) }, pixels());
    let handles: Vec<Value> = (0..34).map(|_| small.seal(&mut device, &pixels).0["query"].clone()).collect();
    let is_stored = |device: &mut Device, query: &Value| {
        call(device, &json!({"op": "show", "query": query}), &[]).0["kind"].is_null()
    };
    assert!(!is_stored(&mut device, &handles[1]) && is_stored(&mut device, &handles[2]));
    call(&mut device, &json!({"op": "free", "handle": handles[33]}), &[]);
    assert!(!is_stored(&mut device, &handles[33]));
}

#[test]
fn an_alignment_is_that_of_the_phones() {
    use veiloc_ar::{Alignment, Axes, FrameworkPose};
    use veiloc_protocol::{Answer, AnswerPose, AnswerTimes, GravityUse, MapCoordinates};

    let mut device = Device::default();
    let (head, _) = call(&mut device, &json!({"op": "alignment"}), &[]);
    let handle = head["alignment"].clone();
    let turn = std::f64::consts::FRAC_1_SQRT_2;
    let camera = FrameworkPose { position: [1.0, 1.5, -2.0], rotation: [0.0, -turn, 0.0, turn] };
    let anchor = FrameworkPose { position: [3.0, 1.0, -0.5], ..FrameworkPose::default() };
    let pose = |pose: &FrameworkPose| json!({"position": pose.position, "orientation": pose.rotation});
    let place = json!({"op": "worldFromAnchor", "alignment": handle, "pose": pose(&anchor)});
    assert_eq!(call(&mut device, &place, &[]).0, json!({"pose": null}));

    let mut own = Alignment::default();
    for step in 0..3 {
        let mut covariance = [[0.0; 6]; 6];
        (0..6).for_each(|i| covariance[i][i] = 1e-4);
        let answer = Answer {
            pose: Some(AnswerPose {
                rotation: [turn, turn, 0.0, 0.0],
                translation: [0.3, -0.2 + 0.001 * f64::from(step), 2.0],
                covariance,
            }),
            doubts: Vec::new(),
            log_evidence: 40.0,
            margin: f64::INFINITY,
            fit: None,
            gravity: GravityUse::Used,
            map: MapCoordinates { metres_per_unit: Some(2.0), down: None },
            inliers: 50,
            matches: 60,
            hypotheses: 100,
            times: AnswerTimes::default(),
        };
        let update = own.add(&answer, &Axes::OpenGl.cam_from_ar(&camera).expect("a pose"));
        let add = json!({"op": "alignmentAdd", "alignment": handle, "pose": pose(&camera)});
        let (head, _) = call(&mut device, &add, &[answer.to_json().as_bytes()]);
        assert_eq!(
            (head["update"].as_str(), head["state"].as_str()),
            (Some(update.name()), Some(own.state().name()))
        );
        assert_eq!(head["used"], step + 1);
    }
    let expected = own.world_from_anchor(Axes::OpenGl, &anchor).expect("aligned");
    assert_eq!(call(&mut device, &place, &[]).0["pose"], pose(&expected));
    let (head, _) =
        call(&mut device, &json!({"op": "cameraInMap", "alignment": handle, "pose": pose(&camera)}), &[]);
    let center =
        own.cam_from_map(&Axes::OpenGl.cam_from_ar(&camera).expect("a pose")).expect("aligned").center();
    for i in 0..3 {
        assert!((head["pose"]["position"][i].as_f64().expect("a number") - center.coords[i]).abs() < 1e-12);
    }
    assert!(head["accuracy"]["yawDeg"].as_f64().is_some_and(|deg| deg > 0.0));

    // Nothing of a bad call is kept.
    let zero = FrameworkPose { rotation: [0.0; 4], ..FrameworkPose::default() };
    for (head, bytes, kind) in [
        (json!({"op": "alignment", "metresPerUnit": -1.0}), &b""[..], "option"),
        (json!({"op": "alignmentAdd", "alignment": handle, "pose": pose(&camera)}), b"{}", "option"),
        (json!({"op": "alignmentMoved", "alignment": handle, "pose": pose(&zero)}), b"", "pose"),
        (json!({"op": "worldFromAnchor", "alignment": handle, "pose": pose(&zero)}), b"", "pose"),
        (json!({"op": "alignmentMoved", "alignment": 99, "pose": pose(&camera)}), b"", "gone"),
    ] {
        assert_eq!(call(&mut device, &head, &[bytes]).0["kind"], kind, "{head}");
    }
    assert_eq!(call(&mut device, &place, &[]).0["pose"], pose(&expected));
}
