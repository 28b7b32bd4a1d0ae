//! What a loader gets: the very query that the library seals of the same pixels and random bytes, its steps, what it shows; and a
//! refusal, never a panic, of whatever else is asked.

use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha20Rng;
use serde_json::{Value, json};
use veiloc_descriptor::{DescriptorKind, Descriptors, Vocabulary};
use veiloc_features::{GrayImage, Image};
use veiloc_obfuscation::{SealOptions, extract_loaded, seal};
use veiloc_protocol::{Profile, SealedQuery};
use veiloc_web::device::Device;
use veiloc_web::exports::reply;
use veiloc_web::message;
use veiloc_web::shown::ATTACKS;

const CAMERA: &str = "SIMPLE_RADIAL,320,240,260,160,120,-0.01";
const SEED: [u8; 32] = [7; 32];

fn profile() -> Profile {
    let words = (0..4 * 128_u32).map(|i| (i * 37 % 120) as u8).collect();
    let words = Descriptors::new(DescriptorKind::ROOT_SIFT, words).expect("whole rows");
    Profile::vlad(Vocabulary::new(words).expect("words"))
}

/// Blocks of random colours at two sizes: plenty of corners.
fn pixels() -> Vec<u8> {
    let mut rng = ChaCha20Rng::seed_from_u64(3);
    let blocks: Vec<[u8; 3]> = (0..80 * 60).map(|_| rng.random()).collect();
    let at = |x: usize, y: usize| {
        let (fine, coarse) = (blocks[y / 4 * 80 + x / 4], blocks[y / 20 * 80 + x / 20]);
        [0, 1, 2].map(|c| fine[c] / 3 + coarse[c] / 2)
    };
    (0..240).flat_map(|y| (0..320).flat_map(move |x| at(x, y).into_iter().chain([200]))).collect()
}

fn ask(device: &mut Device, head: &Value, parts: &[&[u8]]) -> (Value, Vec<u8>) {
    let answer = reply(device, &message::write(head, &parts.concat()));
    let (head, bytes) = message::read::<Value>(&answer).expect("a reply");
    (head, bytes.to_vec())
}

fn ready() -> (Device, Value) {
    let mut device = Device::default();
    let (head, _) = ask(&mut device, &json!({"op": "profile"}), &[&profile().encode()]);
    assert_eq!(head["id"], profile().id().to_string());
    let asked =
        json!({"op": "seal", "profile": head["profile"], "width": 320, "height": 240, "camera": CAMERA});
    (device, asked)
}

#[test]
fn a_browser_seals_what_the_library_seals() {
    let (mut device, asked) = ready();
    let pixels = pixels();
    let (head, bytes) = ask(&mut device, &asked, &[&SEED, &pixels]);

    let rgb: Vec<u8> = pixels.chunks(4).flat_map(|p| [p[0], p[1], p[2]]).collect();
    let image = Image::from(GrayImage::from_rgb8(320, 240, &rgb).expect("an image"));
    let (profile, options) = (profile(), SealOptions::default());
    let camera = CAMERA.parse().expect("a camera");
    let (features, camera) =
        extract_loaded(image, "image".as_ref(), &camera, &profile, &options).expect("features");
    let mut rng = ChaCha20Rng::from_seed(SEED);
    let query = seal(features, &camera, &profile, &options, &mut rng).expect("sealed");
    assert!(query.encode() == bytes, "{head}");
    assert_eq!(head["rows"], query.len());
    assert!(query.len() >= 512, "too little texture to tell anything");

    // Every step is the beginning of it, as the library cuts it.
    let steps: Vec<usize> = serde_json::from_value(head["steps"].clone()).expect("numbers");
    assert_eq!(steps.last(), Some(&query.len()));
    for (rows, class) in steps.iter().zip(query.step_sizes()) {
        let step = json!({"op": "step", "query": head["query"], "rows": rows});
        let part = query.first_rows(class, &profile).expect("a step");
        assert!(ask(&mut device, &step, &[]).1 == part.encode(), "{rows}");
    }
    assert_eq!(
        ask(&mut device, &json!({"op": "step", "query": head["query"], "rows": 257}), &[]).0["kind"],
        "option"
    );
}

#[test]
fn what_is_shown_is_what_is_sent() {
    let (mut device, asked) = ready();
    let (head, bytes) = ask(&mut device, &asked, &[&SEED, &pixels()]);
    let query = SealedQuery::decode(&bytes).expect("a query");
    let (shown, numbers) = ask(&mut device, &json!({"op": "show", "query": head["query"]}), &[]);
    assert_eq!(
        (shown["width"].clone(), shown["anchors"].as_array().map(Vec::len)),
        (json!(query.camera().width), Some(2))
    );
    let count = |field: &str| shown[field].as_u64().expect("a count") as usize;
    assert_eq!(count("segments"), query.len());
    assert_eq!(numbers.len(), 4 * (4 * count("segments") + 2 * count("keypoints") + 2 * count("real")));
    assert_eq!(count("real"), query.len(), "there are no decoys, and each row's keypoint is known again");

    // Another worker attacks: it is told all by the exhibit.
    let (told, exhibit) = ask(&mut device, &json!({"op": "exhibit", "query": head["query"]}), &[]);
    assert!(exhibit.starts_with(&bytes) && told["queryBytes"] == bytes.len(), "{told}");
    let mut other = Device::default();
    let mut medians = Vec::new();
    for (name, words, _) in ATTACKS {
        let asked = json!({"op": "attack", "attack": name, "queryBytes": told["queryBytes"]});
        let (found, numbers) = ask(&mut other, &asked, &[&exhibit]);
        assert_eq!((&found["words"], numbers.len()), (&json!(words), 16 * query.len()), "{found}");
        medians.push(found["medianPx"].as_f64().expect("a median"));
        assert_eq!(found["guessMedianPx"], medians[0]);
    }
    // Told the true neighbours the layout of the graph is far better than a guess: truth and rows belong together.
    assert!(medians[3] < 0.5 * medians[0], "{medians:?}");
}

#[test]
fn a_session_goes_on_and_is_kept() {
    let (mut device, mut asked) = ready();
    let (session, _) = ask(&mut device, &json!({"op": "session", "anchors": "world"}), &[&SEED]);
    asked["session"] = session["session"].clone();
    asked["orientation"] = json!([1.0, 0.0, 0.0, 0.0]);
    let pixels = pixels();
    let (first, _) = ask(&mut device, &asked, &[&SEED, &pixels]);
    assert_eq!((&first["frames"], &first["starts"]), (&json!(1), &json!(1)), "{first}");
    let (_, kept) = ask(&mut device, &json!({"op": "sessionBytes", "session": asked["session"]}), &[]);
    let (again, _) = ask(&mut device, &json!({"op": "sessionFrom"}), &[&kept]);
    assert_eq!(again["frames"], 1);
    asked["session"] = again["session"].clone();
    asked["orientation"] = json!([0.9998, 0.0, 0.02, 0.0]);
    let (second, _) = ask(&mut device, &asked, &[&[8; 32], &pixels]);
    assert_eq!((&second["frames"], &second["starts"]), (&json!(2), &json!(1)), "{second}");
}

#[test]
fn whatever_is_asked_is_answered() {
    let (mut device, asked) = ready();
    let pixels = pixels();
    let with = |field: &str, value: Value| {
        let mut asked = asked.clone();
        asked[field] = value;
        asked
    };
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
        (asked.clone(), &pixels[..40], "image"),
        (with("width", json!(0)), &pixels, "image"),
        (with("width", json!(u32::MAX)), &pixels, "image"),
        (with("camera", json!("SIMPLE_PINHOLE,320,240")), &pixels, "camera"),
        (with("camera", json!("SIMPLE_PINHOLE,640,480,500,320,240")), &pixels, "image"),
        (with("scheme", json!("points")), &pixels, "seal"),
        (with("scheme", json!("rot13")), &pixels, "option"),
        (with("angleBits", json!(200)), &pixels, "option"),
        (with("session", json!(77)), &pixels, "gone"),
        (with("profile", json!(77)), &pixels, "gone"),
        (with("secret", json!(1)), &pixels, "call"),
    ] {
        let (answer, _) = ask(&mut device, &head, &[&SEED, bytes][usize::from(head["op"] != "seal")..]);
        assert_eq!(answer["kind"], kind, "{head}: {answer}");
        assert!(answer["error"].as_str().is_some_and(|text| !text.is_empty()));
    }
    for junk in [&[][..], &[255; 3], &[255; 64], &[0; 64]] {
        let answer = reply(&mut device, junk);
        assert_eq!(message::read::<Value>(&answer).expect("a reply").0["kind"], "call");
    }
    let (sealed, _) = ask(&mut device, &asked, &[&SEED, &pixels]);
    let (told, exhibit) = ask(&mut device, &json!({"op": "exhibit", "query": sealed["query"]}), &[]);
    let attack = json!({"op": "attack", "attack": "prior", "queryBytes": told["queryBytes"]});
    for cut in [exhibit.len() - 1, exhibit.len() - 16] {
        assert_eq!(
            ask(&mut device, &attack, &[&exhibit[..cut]]).0["kind"],
            "call",
            "a row without its keypoint"
        );
    }
    // A blank image holds nothing to send.
    assert_eq!(ask(&mut device, &asked, &[&SEED, &vec![90; 320 * 240 * 4]]).0["kind"], "seal");
}

#[test]
fn queries_are_kept_until_they_are_many() {
    let (mut device, asked) = ready();
    let pixels = pixels();
    let mut small = asked;
    small["maxKeypoints"] = json!(256);
    let handles: Vec<Value> =
        (0..34).map(|_| ask(&mut device, &small, &[&SEED, &pixels]).0["query"].clone()).collect();
    let kept = |device: &mut Device, query: &Value| {
        ask(device, &json!({"op": "show", "query": query}), &[]).0["kind"].is_null()
    };
    assert!(!kept(&mut device, &handles[1]) && kept(&mut device, &handles[2]));
    ask(&mut device, &json!({"op": "free", "handle": handles[33]}), &[]);
    assert!(!kept(&mut device, &handles[33]));
}
