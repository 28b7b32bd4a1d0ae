//! The rules of docs/reference/privacy-rules.md with learned features: only descriptors of a network's output are sent. Each test also
//! builds the leak and shows that its own measure detects it.

use super::common;

use std::path::Path;
use std::sync::Arc;

use common::{drawn, synthetic_alike, synthetic_compact};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc_descriptor::{Descriptors, Encoding, Vocabulary};
use veiloc_features::learned::{Description, Engine, Learned};
use veiloc_features::{Extractor, Extractors, Features, GrayImage, Image, Mask};
use veiloc_geometry::Intrinsics;
use veiloc_obfuscation::{Extracted, SealOptions, Sealer};
use veiloc_protocol::{Profile, Scheme, SealedQuery};

const SCHEMES: [&str; 3] = ["dcl", "random-lines", "coordinate-permutation"];

fn rng() -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(7)
}

fn camera() -> Intrinsics {
    "SIMPLE_PINHOLE,320,240,256,160,120".parse().expect("valid")
}

/// A profile for the kind of these features: two of their rows are its words.
fn profile(features: &Features) -> Profile {
    Profile::vlad(Vocabulary::new(features.descriptors.select([0, 1])).expect("two words"))
}

fn sealer(scheme: &str, learned: &Arc<Learned>, profile: &Profile) -> Sealer {
    let scheme: Scheme = scheme.parse().expect("a scheme");
    let extractors = Extractors::default().with(Arc::clone(learned));
    let options = SealOptions::new(scheme).expect("it hides positions").with_extractors(extractors.sealing());
    Sealer::new(profile, options).expect("two words")
}

/// Features of the camera.
fn of_camera(features: &Features) -> Extracted {
    Extracted::new(features.clone(), camera())
}

fn learned() -> Arc<Learned> {
    Arc::new(synthetic_alike(&[]))
}

/// A network, and one whose descriptors are projected.
fn both() -> [Arc<Learned>; 2] {
    [learned(), Arc::new(synthetic_compact())]
}

/// Features as a device extracts them, and their profile.
fn extracted(learned: &Arc<Learned>, image: Image) -> (Features, Profile) {
    let first = learned.extract(&image, 600).expect("extracted");
    let profile = profile(&first);
    let features =
        sealer("dcl", learned, &profile).extract(image, camera()).expect("extracted").features().clone();
    assert!(features.keypoints.len() > 400, "{}", features.keypoints.len());
    (features, profile)
}

#[test]
fn l4_scores_scales_and_orientations_of_a_network_are_not_sent() {
    both().iter().for_each(only_rows_are_sent);
}

fn only_rows_are_sent(learned: &Arc<Learned>) {
    let (plain, profile) = extracted(learned, drawn(320, 240).into());
    let mut other = plain.clone();
    for (i, keypoint) in other.keypoints.iter_mut().enumerate() {
        (keypoint.scale, keypoint.orientation, keypoint.response) = (9.0, 0.3, 500.0 - i as f32);
    }
    for scheme in SCHEMES {
        let bytes = |features: &Features| {
            let sealer = sealer(scheme, learned, &profile);
            sealer.seal(of_camera(features), &mut rng()).expect("sealed").encode()
        };
        assert_eq!(bytes(&plain), bytes(&other), "{scheme}");
        let leaky = |features: &Features| {
            let mut rows = features.descriptors.as_bytes().to_vec();
            for (row, keypoint) in
                rows.chunks_exact_mut(features.descriptors.kind().dim()).zip(&features.keypoints)
            {
                row[0] = keypoint.response as u8;
            }
            let descriptors = Descriptors::new(features.descriptors.kind(), rows).expect("whole rows");
            bytes(&Features { descriptors, keypoints: features.keypoints.clone(), global: None })
        };
        assert_ne!(leaky(&plain), leaky(&other), "the measure does not see the leak");
    }
}

#[test]
fn l3_the_order_of_a_networks_scores_is_not_sent() {
    both().iter().for_each(order_is_not_sent);
}

fn order_is_not_sent(learned: &Arc<Learned>) {
    let (features, profile) = extracted(learned, drawn(320, 240).into());
    let strongest_first = features.keypoints.windows(2).all(|pair| pair[0].response >= pair[1].response);
    assert!(strongest_first, "the leak is an order of strength");
    for scheme in SCHEMES {
        let sealer = sealer(scheme, learned, &profile);
        let (_, truth) = sealer.seal_with_truth(of_camera(&features), &mut rng()).expect("sealed");
        let order: Vec<f64> = truth.source.iter().flatten().map(|source| *source as f64).collect();
        let count = order.len() as f64;
        assert!(count > 200.0, "{scheme}: {count}");
        let mean = order.iter().sum::<f64>() / count;
        let middle = (count - 1.0) / 2.0;
        let (mut both, mut own) = (0.0, 0.0);
        for (row, source) in order.iter().enumerate() {
            both += (row as f64 - middle) * (source - mean);
            own += (source - mean).powi(2);
        }
        let rows = (0..order.len()).map(|row| (row as f64 - middle).powi(2)).sum::<f64>();
        let correlation = both / (own * rows).sqrt();
        assert!(correlation.abs() < 0.2, "{scheme}: {correlation}");
    }
}

#[test]
fn l5_decoys_of_a_network_are_no_copies_with_equal_norms() {
    both().iter().for_each(decoys_are_no_copies);
}

fn decoys_are_no_copies(learned: &Arc<Learned>) {
    let (features, profile) = extracted(learned, drawn(320, 240).into());
    let some: Vec<usize> =
        (0..features.keypoints.len()).step_by(features.keypoints.len() / 90).take(90).collect();
    let kind = learned.kind();
    let mut descriptors = features.descriptors.select(some.iter().copied());
    if kind.encoding() == Encoding::Coarse {
        // Rows of a synthetic network are equal after coarse quantization, and so would be blends of them.
        let (mut rng, steps) = (rng(), f64::from(kind.norm()) / (kind.dim() as f64).sqrt());
        let number =
            |rng: &mut ChaCha8Rng| (0..4).map(|_| rng.random_range(-0.87..0.87)).sum::<f64>() * steps;
        let rows = (0..90 * kind.dim()).map(|_| kind.encoding().byte(number(&mut rng)));
        descriptors = Descriptors::new(kind, rows.collect()).expect("whole rows");
    }
    let few = Features {
        keypoints: some.iter().map(|i| features.keypoints[*i]).collect(),
        descriptors,
        global: None,
    };
    let sealer = sealer("dcl", learned, &profile);
    let (query, truth) = sealer.seal_with_truth(of_camera(&few), &mut rng()).expect("sealed");
    let of_decoys = |decoy: bool| (0..query.len()).filter(move |row| truth.source[*row].is_none() == decoy);
    let rows = query.descriptors().expect("rows");
    let length = |row: usize| rows.values(row).map(|v| f64::from(v).powi(2)).sum::<f64>().sqrt();
    let mean = |rows: Vec<usize>| rows.iter().map(|row| length(*row)).sum::<f64>() / rows.len() as f64;
    let (decoys, real): (Vec<usize>, Vec<usize>) =
        (of_decoys.clone()(true).collect(), of_decoys(false).collect());
    assert!(decoys.len() >= 160 && real.len() >= 50, "{} {}", decoys.len(), real.len());
    for decoy in &decoys {
        assert!((0..90).all(|row| few.descriptors.row(row) != rows.row(*decoy)), "a copy");
    }
    let (of_decoys, of_real) = (mean(decoys), mean(real));
    assert!((of_decoys / of_real - 1.0).abs() < 0.03, "{of_decoys} {of_real}");
}

/// Pixels under a mask change nothing that is sent, and no descriptor window touches them.
#[test]
fn l13_hidden_pixels_have_no_influence_on_a_network() {
    both().iter().for_each(mask_hides_pixels);
}

fn mask_hides_pixels(learned: &Arc<Learned>) {
    let hides = |x: u32, y: u32| (120..200).contains(&x) && (60..150).contains(&y);
    let mask = Mask::new(320, 240, hides).expect("a part");
    let plain = drawn(320, 240);
    let other: Vec<f32> = (plain.data().iter().enumerate())
        .map(|(i, sample)| if hides(i as u32 % 320, i as u32 / 320) { 1.0 - sample } else { *sample })
        .collect();
    let other = GrayImage::new(320, 240, other).expect("whole rows");
    let (_, profile) = extracted(learned, plain.clone().into());
    let sealer = sealer("dcl", learned, &profile);
    let bytes = |image: Image| {
        let extracted = sealer.extract(image, camera()).expect("extracted");
        let features = extracted.features();
        let receptive_field = learned.receptive_field() as f32;
        for keypoint in &features.keypoints {
            let (u, v) = (keypoint.pixel.u as f32, keypoint.pixel.v as f32);
            let (du, dv) = ((120.0 - u).max(u - 200.0).max(0.0), (60.0 - v).max(v - 150.0).max(0.0));
            assert!(mask_is_not_applied(&mask, features) || du.hypot(dv) >= receptive_field * keypoint.scale);
        }
        sealer.seal(extracted, &mut rng()).expect("sealed").encode()
    };
    assert_ne!(bytes(plain.clone().into()), bytes(other.clone().into()), "the measure does not see the leak");
    let hidden = |image: GrayImage| bytes(Image::from(image).without(&mask).expect("a mask of its size"));
    assert_eq!(hidden(plain), hidden(other));
}

/// Whether some keypoint lies under the mask, that is, no mask was applied.
fn mask_is_not_applied(mask: &Mask, features: &Features) -> bool {
    features.keypoints.iter().any(|k| mask.hides(k.pixel.u as u32, k.pixel.v as u32))
}

/// A device without this network, or with one of another kind, sends nothing.
#[test]
fn features_of_another_kind_are_rejected() {
    let learned = learned();
    let (features, profile) = extracted(&learned, drawn(320, 240).into());
    let image = || Image::from(drawn(320, 240));
    let of_sift_only = Sealer::new(&profile, SealOptions::default()).expect("two words");
    let without = of_sift_only.extract(image(), camera());
    let text = without.expect_err("SIFT alone").to_string();
    assert!(text.contains("made-up") && text.contains("available: sift"), "{text}");
    // The same name with another vector length.
    let other = Arc::new(synthetic_alike(&[("length = 128", "length = 120")]));
    assert!(sealer("dcl", &other, &profile).extract(image(), camera()).is_err());
    // The same keypoints with another descriptor.
    let compact = sealer("dcl", &Arc::new(synthetic_compact()), &profile);
    let text = compact.extract(image(), camera()).expect_err("compact alone").to_string();
    assert!(text.contains("made-up"), "{text}");
    let sift =
        Extractors::default().named("sift").expect("built in").extract(&image(), 300).expect("extracted");
    assert!(of_sift_only.seal(of_camera(&sift), &mut rng()).is_err());
    let of_sift = Sealer::new(&self::profile(&sift), SealOptions::default()).expect("two words");
    assert!(of_sift.seal(of_camera(&features), &mut rng()).is_err());
}

/// Half a byte per number; both messages name the kind.
#[test]
fn messages_carry_a_compact_kind() {
    let [plain, compact] = both().map(|learned| {
        let (features, profile) = extracted(&learned, drawn(320, 240).into());
        let sealer = sealer("dcl", &learned, &profile);
        let query = sealer.seal(of_camera(&features), &mut rng()).expect("sealed");
        let read = SealedQuery::decode(&query.encode()).expect("a query");
        assert_eq!(read.descriptors().expect("rows").kind(), learned.kind());
        let row = |query: &SealedQuery, row: usize| query.descriptors().expect("rows").row(row).to_vec();
        assert!((0..query.len()).all(|i| row(&read, i) == row(&query, i)), "rows are settled first");
        let profile_read = Profile::decode(&profile.encode()).expect("a profile");
        assert_eq!(profile_read.descriptor_kind(), learned.kind());
        query.encode().len() as f64 / read.len() as f64
    });
    // 16 bytes and 48 half bytes.
    assert!((compact - plain - 8.0).abs() < 1.0, "{plain} and {compact} bytes a row");
}

/// Difference of descriptors between an image and the same image continued by its mirror image: the mean, relative to
/// the length of a descriptor, within 16 pixels of the border and in the middle. The border is visible as far as the
/// first exceeds the second: a network that aligns corners during resizing sees a larger image slightly differently
/// everywhere.
fn border_visibility(learned: &Learned, image: &GrayImage, beyond: u32) -> [f64; 2] {
    let (width, height) = (image.width(), image.height());
    let fold = |at: u32, side: u32| {
        let at = (i64::from(at) - i64::from(beyond)).rem_euclid(2 * i64::from(side)) as u32;
        at.min(2 * side - 1 - at)
    };
    let (wide, high) = (width + 2 * beyond, height + 2 * beyond);
    let samples = (0..wide * high).map(|i| image.row(fold(i / wide, height))[fold(i % wide, width) as usize]);
    let continued = GrayImage::new(wide, high, samples.collect()).expect("whole rows");
    let own = learned.extract(&Image::from(image.clone()), 4000).expect("extracted");
    let there = learned.extract(&Image::from(continued), 20_000).expect("extracted");
    let mut sums = [(0.0, 0); 2];
    for (i, keypoint) in own.keypoints.iter().enumerate() {
        let (u, v) = (keypoint.pixel.u, keypoint.pixel.v);
        let from_border = u.min(v).min(f64::from(width) - u).min(f64::from(height) - v);
        let of = if from_border <= 16.0 { &mut sums[0] } else { &mut sums[1] };
        if (16.0..64.0).contains(&from_border) {
            continue;
        }
        let same = there
            .keypoints
            .iter()
            .position(|k| (k.pixel.u - f64::from(beyond) - u).hypot(k.pixel.v - f64::from(beyond) - v) < 0.5);
        let Some(same) = same else { continue };
        let (a, b) = (own.descriptors.row(i), there.descriptors.row(same));
        let off: f64 = a.iter().zip(b).map(|(a, b)| f64::from(a.abs_diff(*b)).powi(2)).sum();
        of.0 += off.sqrt() / f64::from(learned.kind().norm());
        of.1 += 1;
    }
    assert!(sums[0].1 > 30, "{sums:?}");
    sums.map(|(sum, count)| sum / f64::from(count.max(1)))
}

/// L11: convolutions pad an image with zeros, and descriptors near the border would show it. Tested with a network with
/// weights from a formula, whose descriptors cover patches of 17 pixels.
#[test]
fn l11_descriptors_of_a_network_do_not_show_the_border() {
    let image = drawn(384, 256);
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/learned");
    let text = std::fs::read_to_string(folder.join("corners.toml")).expect("a description");
    let shows = |margin: &str| {
        let text = text.lines().map(|line| if line.starts_with("margin") { margin } else { line });
        let text = text.collect::<Vec<_>>().join("\n");
        assert!(text.contains(margin), "{margin}");
        let description = Description::parse(&text, Path::new("own.toml")).expect("a description");
        let network = Learned::open(description, &folder.join("corners.onnx"), Engine::Rten);
        border_visibility(&network.expect("a network"), &image, 64)
    };
    let ([leak, _], [visible, middle]) = (shows("margin = 0"), shows("margin = 32"));
    println!(
        "{visible:.4} of the length near the border, {middle:.4} in the middle, {leak:.4} without a margin"
    );
    assert!(leak > 0.1, "the measure does not see the leak: {leak}");
    assert!(visible < 0.02, "{visible}");
}
