//! The rules of docs/reference/privacy-rules.md with learned features: only descriptors of a network's output are sent. Each test also
//! builds the leak and shows that its own measure detects it.

use super::common;

use std::path::Path;
use std::sync::Arc;

use common::{drawn, synthetic_alike, synthetic_aliked, synthetic_compact};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc_descriptor::{Descriptors, Encoding, Vocabulary};
use veiloc_features::learned::{Description, Engine, Learned, Models};
use veiloc_features::{Extractor, Extractors, FeatureError, Features, GrayImage, Image, Mask, load_gray};
use veiloc_geometry::Intrinsics;
use veiloc_obfuscation::{Extracted, SealOptions, Sealer};
use veiloc_protocol::{Profile, Scheme, SealedQuery};
use veiloc_testdata::real_data_test;

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
    for learned in both() {
        mask_hides_pixels(&learned, &drawn(320, 240));
    }
    mask_hides_pixels(&Arc::new(synthetic_aliked(Engine::Rten)), &drawn(640, 480));
}

/// Real networks see far more than the pixels within `receptive_field`.
#[real_data_test]
fn l13_hidden_pixels_have_no_influence_on_real_networks(data: &Path) {
    let photo = load_gray(&data.join(PHOTO)).expect("a photo");
    for name in ["xfeat", "alike-t", "aliked-t16"] {
        if let Some(learned) = real(data, name) {
            mask_hides_pixels(&learned, &photo);
        }
    }
}

const PHOTO: &str = "redkitchen/images/frame-000295.color.jpg";

/// A model with its file in `weights` beside the real images or in `VEILOC_MODELS`; ALIKE and ALIKED are exported by the
/// user and may be missing.
#[expect(clippy::print_stdout, reason = "says which network is missing")]
fn real(data: &Path, name: &str) -> Option<Arc<Learned>> {
    let folders = std::env::var_os("VEILOC_MODELS").unwrap_or_default();
    let folders = std::env::split_paths(&folders).chain([data.join("../weights")]);
    match Models::new(folders.collect()).open(name, None) {
        Err(FeatureError::NoModelFile { .. }) if !name.starts_with("xfeat") => {
            println!("{name}: no file");
            None
        }
        found => Some(Arc::new(found.expect("a network"))),
    }
}

#[expect(clippy::print_stdout, reason = "the measured figure of privacy-rules.md")]
fn mask_hides_pixels(learned: &Arc<Learned>, plain: &GrayImage) {
    let (width, height) = (plain.width(), plain.height());
    let [left, right, upper, lower] = [3 * width / 8, 5 * width / 8, height / 4, 5 * height / 8];
    let hides = |x: u32, y: u32| (left..right).contains(&x) && (upper..lower).contains(&y);
    let mask = Mask::new(width, height, hides).expect("a part");
    let other: Vec<f32> = (plain.data().iter().enumerate())
        .map(|(i, sample)| if hides(i as u32 % width, i as u32 / width) { 1.0 - sample } else { *sample })
        .collect();
    let images = [plain.clone(), GrayImage::new(width, height, other).expect("whole rows")].map(Image::from);
    let masked = images.clone().map(|image| image.without(&mask).expect("a mask of its size"));
    let profile = profile(&learned.extract(&images[0], 600).expect("extracted"));
    let sealer = sealer("dcl", learned, &profile);
    let camera = format!("SIMPLE_PINHOLE,{width},{height},{},{},{}", 4 * width / 5, width / 2, height / 2);
    let camera: Intrinsics = camera.parse().expect("valid");
    let [images, masked] =
        [images, masked].map(|both| both.map(|image| sealer.extract(image, camera).expect("extracted")));
    let [seen, kept] = [&images, &masked].map(|both| both[0].features().clone());
    let bytes = |extracted| sealer.seal(extracted, &mut rng()).expect("sealed").encode();
    let ([one, two], masked) = (images.map(bytes), masked.map(bytes));
    assert_ne!(one, two, "the measure does not see the leak");
    assert_eq!(masked[0], masked[1]);
    let receptive_field = learned.receptive_field() as f32;
    for keypoint in &kept.keypoints {
        let off =
            |at: f64, from: u32, to: u32| (f64::from(from) - at).max(at - f64::from(to)).max(0.0) as f32;
        let (du, dv) = (off(keypoint.pixel.u, left, right), off(keypoint.pixel.v, upper, lower));
        assert!(du.hypot(dv) >= receptive_field * keypoint.scale);
    }
    let off: Vec<f64> = (0..kept.keypoints.len()).filter_map(|i| moved(&kept, i, &seen, 0)).collect();
    let mean = off.iter().sum::<f64>() / off.len() as f64;
    println!(
        "{}: {} rows are off by {mean:.3} of their length from those without a mask",
        learned.kind().name(),
        off.len()
    );
}

/// Distance of a descriptor from that of the keypoint at the same position of a larger image, as a share of its length.
fn moved(own: &Features, i: usize, there: &Features, beyond: u32) -> Option<f64> {
    let (u, v) = (own.keypoints[i].pixel.u, own.keypoints[i].pixel.v);
    let beyond = f64::from(beyond);
    let same =
        there.keypoints.iter().position(|k| (k.pixel.u - beyond - u).hypot(k.pixel.v - beyond - v) < 0.5)?;
    let kind = own.descriptors.kind();
    let (a, b) = (own.descriptors.row(i), there.descriptors.row(same));
    let off: f64 = a.iter().zip(b).map(|(a, b)| f64::from(a.abs_diff(*b)).powi(2)).sum();
    Some(off.sqrt() / f64::from(kind.norm()))
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
        let Some(off) = moved(&own, i, &there, beyond) else { continue };
        of.0 += off;
        of.1 += 1;
    }
    assert!(sums[0].1 > 20, "{sums:?}");
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

/// The same with real networks of any input size, on a photograph. ALIKED sees so far that no margin hides the border.
#[real_data_test]
fn l11_margins_of_real_networks_hide_the_border_in_part(data: &Path) {
    let photo = load_gray(&data.join(PHOTO)).expect("a photo");
    let folder = tempfile::tempdir().expect("a folder");
    for (name, most) in [("alike-t", 0.1), ("aliked-t16", 0.35)] {
        if real(data, name).is_none() {
            continue;
        }
        let shows = [0, 96].map(|margin| {
            let file = folder.path().join(format!("{margin}.toml"));
            let input = "[input]\nchannels = 3\nnormalize = \"none\"\nmultiple = 32";
            std::fs::write(&file, format!("of = \"{name}\"\n{input}\nmargin = {margin}\n")).expect("written");
            let learned = real(data, file.to_str().expect("a name")).expect("a file");
            border_visibility(&learned, &photo, 192)
        });
        println!(
            "{name}: {shows:.3?} of the length near the border and in the middle, without and with a margin"
        );
        let [[leak, _], [visible, _]] = shows;
        assert!(leak > 0.3 && visible < most, "{name}: {leak} and {visible}");
    }
}
