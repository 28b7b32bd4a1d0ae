//! Learned attacks: the networks' inputs and outputs, and files that are refused.
//!
//! The networks come from `research/oracles/tiny_networks.py`, which documents what each computes, and from
//! `research/train/make_tiny.py`, with the outputs of PyTorch.

use std::path::{Path, PathBuf};

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc_attacks::learned::InputModality;
use veiloc_attacks::learned::inversion::{InversionNetwork, PositionKnowledge};
use veiloc_attacks::learned::neighbours::NeighbourNetwork;
use veiloc_attacks::learned::positions::{PositionNetwork, position_accuracy, recover};
use veiloc_attacks::{
    AttackError, DecodedDescriptors, ErrorSummary, KnownImage, Observation, bits_over_prior,
    expected_positions,
};
use veiloc_features::learned::{Engine, Network, Tensor};
use veiloc_geometry::{Pencils, Pixel};
use veiloc_obfuscation::audit::obfuscate_points;
use veiloc_protocol::{AngleBits, Scheme};

const SIZE: [u32; 2] = [320, 240];

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/learned").join(name)
}

/// The same numbers as in the script.
fn synthetic_values(count: usize, seed: u64, scale: f64) -> Vec<f32> {
    let number = |i: u64| ((i + seed * 7919) * 2_654_435_761 % (1 << 32)) as f64 / (1_u64 << 32) as f64 - 0.5;
    (0..count as u64).map(|i| (number(i) * scale) as f32).collect()
}

/// Keypoints whose descriptors encode which of 4 x 3 fields they are in.
fn image(seed: u64) -> KnownImage {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let keypoints: Vec<Pixel> =
        (0..120).map(|_| Pixel::new(rng.random_range(0.0..320.0), rng.random_range(0.0..240.0))).collect();
    let bytes: Vec<u8> =
        keypoints.iter().flat_map(|p| (0..12).map(move |i| 200 * u8::from(i == field(*p)))).collect();
    let descriptors = DecodedDescriptors::new(&bytes, 12).expect("whole");
    KnownImage::new(keypoints, descriptors, SIZE[0], SIZE[1]).expect("one each")
}

fn field(p: Pixel) -> usize {
    (p.u / 80.0) as usize + 4 * (p.v / 80.0) as usize
}

fn sent(image: &KnownImage, scheme: &Scheme) -> Vec<Observation> {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let [width, height] = SIZE;
    let sent = obfuscate_points(image.keypoints(), width, height, scheme, AngleBits::default(), &mut rng)
        .expect("inside");
    Observation::of_sent(&sent)
}

/// Points of the half-line of a keypoint under the paper's halves, their distances from the anchor, and the probability of
/// each: uniform keypoints lie in a narrow wedge, so it grows with the distance. Times `likelihood`.
struct HalfLine {
    anchor: Pixel,
    direction: [f64; 2],
    weights: Vec<f64>,
}

/// Points of a half-line, pixels apart.
const STEP: f64 = 0.02;

impl HalfLine {
    fn new(keypoint: Pixel, likelihood: impl Fn(Pixel) -> f64) -> Self {
        let pencils = Pencils::paper(SIZE[0], SIZE[1]);
        let own = pencils.anchor_of(keypoint);
        let anchor = pencils.position(own).expect("about the image");
        let length = keypoint.distance(&anchor);
        let direction = [(keypoint.u - anchor.u) / length, (keypoint.v - anchor.v) / length];
        let mut line = Self { anchor, direction, weights: Vec::new() };
        let is_possible = |p: &Pixel| {
            (0.0..f64::from(SIZE[0])).contains(&p.u)
                && (0.0..f64::from(SIZE[1])).contains(&p.v)
                && pencils.anchor_of(*p) == own
        };
        line.weights = (0..(400.0 / STEP) as usize)
            .map(|i| line.at((i as f64 + 0.5) * STEP))
            .enumerate()
            .map(|(i, p)| if is_possible(&p) { (i as f64 + 0.5) * likelihood(p) } else { 0.0 })
            .collect();
        line
    }

    fn at(&self, distance: f64) -> Pixel {
        let [u, v] = self.direction;
        Pixel::new(self.anchor.u + distance * u, self.anchor.v + distance * v)
    }

    fn mean(&self) -> Pixel {
        let sum: f64 = self.weights.iter().enumerate().map(|(i, weight)| weight * (i as f64 + 0.5)).sum();
        self.at(STEP * sum / self.weights.iter().sum::<f64>())
    }

    /// The point before which this share of the probability lies.
    fn quantile(&self, share: f64) -> Pixel {
        let mut left = share * self.weights.iter().sum::<f64>();
        let index = self.weights.iter().position(|weight| {
            left -= weight;
            left <= 0.0
        });
        self.at(STEP * (index.expect("below 1") as f64 + 0.5))
    }
}

/// Errors of one answer for each keypoint of an image.
fn errors(image: &KnownImage, answer: impl Fn(Pixel) -> Pixel) -> Vec<f64> {
    image.keypoints().iter().map(|keypoint| answer(*keypoint).distance(keypoint)).collect()
}

#[test]
fn positions_follow_network_output() {
    let network = PositionNetwork::open(&data("positions.toml")).expect("a network");
    assert_eq!(
        (network.scheme().to_string().as_str(), network.input_modality()),
        ("dcl:paper", InputModality::Row)
    );
    let images = [image(1), image(2)];
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let found = position_accuracy(&network, &images, AngleBits::default(), &mut rng)
        .expect("sent")
        .expect("keypoints");
    // On a line across the whole image a field leaves a third.
    assert!(found.information > 0.9 && found.bits > found.bits_untrained + 0.9, "{found:?}");
    // The network's likelihood: a Gaussian about the middle of the field.
    let near_field = |keypoint: Pixel| {
        let middle = |x: f64| 80.0 * (x / 80.0).floor() + 40.0;
        let field = Pixel::new(middle(keypoint.u), middle(keypoint.v));
        move |p: Pixel| (-50.0 * (p.distance(&field) / 320.0).powi(2)).exp()
    };
    let posterior_median = |keypoint| HalfLine::new(keypoint, near_field(keypoint)).quantile(0.5);
    let of_all = |answer: &dyn Fn(Pixel) -> Pixel| -> Vec<f64> {
        images.iter().flat_map(|image| errors(image, answer)).collect()
    };
    let expected = ErrorSummary::of(&of_all(&posterior_median));
    assert!((found.errors.median_px - expected.median_px).abs() < 0.5, "{found:?} {expected:?}");
    // The baseline: 0.58 of the probability lies before it, for bits 0.52 (study privacy fit-baseline).
    let prior = ErrorSummary::of(&of_all(&|keypoint| HalfLine::new(keypoint, |_| 1.0).quantile(0.58)));
    assert!((found.prior.median_px - prior.median_px).abs() < 0.5, "{found:?} {prior:?}");
    let of_bits = of_all(&|keypoint| HalfLine::new(keypoint, |_| 1.0).quantile(0.52));
    let bits = bits_over_prior(&of_all(&posterior_median), &of_bits, SIZE[0], SIZE[1]);
    assert!((found.bits - bits).abs() < 0.03, "{found:?} {bits}");
    assert_eq!((found.keypoints, found.by_image.len()), (240, 2));
}

#[test]
fn untrained_network_equals_prior() {
    let network = PositionNetwork::open(&data("untrained.onnx")).expect("the description is beside it");
    let image = image(3);
    let sent = sent(&image, &network.scheme());
    let found = recover(&network, &sent, image.descriptors(), 320, 240).expect("recovered");
    let lines: Vec<HalfLine> = image.keypoints().iter().map(|p| HalfLine::new(*p, |_| 1.0)).collect();
    // Sent keypoints are moved by up to half a pixel, which turns the lines of those near the anchor. Mean and median differ
    // by some 8 px.
    let far = |line: &HalfLine, keypoint: &Pixel| keypoint.distance(&line.anchor) > 100.0;
    let of_far = found.iter().zip(&lines).zip(image.keypoints()).filter(|((_, line), p)| far(line, p));
    for ((own, line), _) in of_far {
        let (mean, median) = (line.mean(), line.quantile(0.5));
        assert!(own.mean.distance(&mean) < 2.5, "{own:?} {mean:?}");
        assert!(own.pixel.distance(&median) < 4.0, "{own:?} {median:?}");
    }
    let prior = expected_positions(&sent, 320, 240);
    assert!(found.iter().zip(&prior).all(|(own, prior)| own.mean.distance(prior) < 1e-3));
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let whole = |keypoint| HalfLine::new(keypoint, |_| 1.0);
    let bits_of = |answer: &dyn Fn(Pixel) -> Pixel| {
        let baseline = errors(&image, |keypoint| whole(keypoint).quantile(0.52));
        bits_over_prior(&errors(&image, answer), &baseline, SIZE[0], SIZE[1])
    };
    let (mean, median) = (bits_of(&|p| whole(p).mean()), bits_of(&|p| whole(p).quantile(0.5)));
    let accuracy = position_accuracy(&network, &[image], AngleBits::default(), &mut rng)
        .expect("sent")
        .expect("keypoints");
    assert!(accuracy.information.abs() < 1e-6, "{accuracy:?}");
    assert!((accuracy.bits_of_mean - mean).abs() < 0.03, "{accuracy:?} {mean}");
    assert!((accuracy.bits - median).abs() < 0.05, "{accuracy:?} {median}");
    // Of an even number of equally probable bins, two are the median: rounding decides.
    assert!((accuracy.bits - accuracy.bits_untrained).abs() < 0.05, "{accuracy:?}");
}

#[test]
fn other_schemes_and_descriptors_are_refused() {
    let network = PositionNetwork::open(&data("positions.toml")).expect("a network");
    let image = image(1);
    let lines = sent(&image, &Scheme::RandomLines);
    let refused = recover(&network, &lines, image.descriptors(), 320, 240).expect_err("another scheme");
    assert!(matches!(refused, AttackError::Scheme { .. }), "{refused}");
    let sent = sent(&image, &network.scheme());
    let short = DecodedDescriptors::new(&[1; 120 * 5], 5).expect("whole");
    let refused = recover(&network, &sent, &short, 320, 240).expect_err("another length");
    assert_eq!(refused, AttackError::Dimensions { expected: 12, found: 5 });
    let few = recover(&network, &sent[1..], image.descriptors(), 320, 240).expect_err("one too many");
    assert!(matches!(few, AttackError::DescriptorCount { .. }), "{few}");
    let none = DecodedDescriptors::new(&[], 12).expect("none");
    assert!(recover(&network, &[], &none, 320, 240).expect("nothing to do").is_empty());
}

#[test]
fn neighbours_have_similar_embeddings() {
    let network = NeighbourNetwork::open(&data("neighbours.toml")).expect("a network");
    let image = image(5);
    let lists = network.predict(image.descriptors(), 5).expect("predicted");
    let count = image.keypoints().len();
    assert_eq!(lists.len(), count);
    for i in 0..count {
        let own = field(image.keypoints()[i]);
        let others = (0..count).filter(|j| *j != i && field(image.keypoints()[*j]) == own).count();
        assert_eq!(lists.of(i).len(), 5);
        let same = lists.of(i).iter().filter(|j| field(image.keypoints()[**j as usize]) == own).count();
        assert_eq!(same, others.min(5), "keypoint {i}: equal descriptors are the likeliest");
    }
    let none = DecodedDescriptors::new(&[], 12).expect("none");
    assert_eq!(network.predict(&none, 5).expect("nothing to do").len(), 0);
    let short = DecodedDescriptors::new(&[1; 10], 5).expect("whole");
    assert!(matches!(network.predict(&short, 5), Err(AttackError::Dimensions { expected: 12, found: 5 })));
}

/// The inversion network outputs a formula of the descriptors' cells.
#[test]
fn inverted_image_depends_on_descriptors_in_cells() {
    let network = InversionNetwork::open(&data("inversion.toml")).expect("a network");
    assert!(network.has_visibility() && network.features() == "sift");
    let grid = network.grid(SIZE);
    assert_eq!((grid.width, grid.height, network.side(), network.dimension()), (32, 24, 32, 128));
    // Two keypoints in one cell, one in another, one outside the image.
    let positions =
        [Pixel::new(5.0, 5.0), Pixel::new(9.9, 0.0), Pixel::new(300.0, 235.0), Pixel::new(320.0, 5.0)];
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let bytes: Vec<u8> = (0..4 * 128).map(|_| rng.random_range(0..=255)).collect();
    let descriptors = DecodedDescriptors::new(&bytes, 128).expect("whole");
    let made = network.invert(&descriptors, SIZE, PositionKnowledge::Positions(&positions), 1).expect("made");

    let kernel = synthetic_values(3 * 129, 1, 0.5);
    let sigmoid = |x: f64| 1.0 / (1.0 + (-x).exp());
    let unit: Vec<Vec<f64>> = bytes
        .chunks(128)
        .map(|row| {
            let length = row.iter().map(|b| f64::from(*b).powi(2)).sum::<f64>().sqrt();
            row.iter().map(|b| f64::from(*b) / length * 128f64.sqrt()).collect()
        })
        .collect();
    for (cell, own) in [([0, 0], &[0, 1][..]), ([30, 23], &[2]), ([31, 0], &[])] {
        let count = own.len() as f64;
        for colour in 0..3 {
            let row = &kernel[colour * 129..][..129];
            let mut sum = f64::from(row[128]) * count.ln_1p();
            for i in own {
                let product: f64 = unit[*i].iter().zip(row).map(|(x, w)| x * f64::from(*w)).sum();
                sum += product / count;
            }
            let at = 3 * (cell[1] * 32 + cell[0]) + colour;
            let (found, expected) = (f64::from(made.image.data()[at]), 255.0 * sigmoid(sum));
            assert!((found - expected).abs() < 0.51, "{cell:?} {colour}: {found} {expected}");
        }
    }
    let visibility = made.visibility.expect("a visibility output");
    for (value, count) in visibility.iter().zip([2.0f64, 2.0, 1.0]) {
        assert!((f64::from(*value) - sigmoid(count.ln_1p())).abs() < 1e-6);
    }
    assert!(visibility[3].is_nan(), "it has no cell");

    // A view twice as wide and high also shows what lies outside the image.
    let wide = network.invert(&descriptors, SIZE, PositionKnowledge::Positions(&positions), 2).expect("made");
    assert_eq!((wide.image.width(), wide.image.height()), (64, 48));
    assert!(wide.visibility.expect("a visibility output").iter().all(|value| value.is_finite()));
    // Without positions, and without descriptors: one colour.
    let none = DecodedDescriptors::new(&[], 128).expect("none");
    for (descriptors, known) in
        [(&descriptors, PositionKnowledge::None), (&none, PositionKnowledge::Positions(&[]))]
    {
        let made = network.invert(descriptors, SIZE, known, 1).expect("made");
        assert!(made.image.data().chunks(3).all(|pixel| *pixel == made.image.data()[..3]));
    }
    let lines = sent(&image(1), &Scheme::default());
    let refused =
        network.invert(&descriptors, SIZE, PositionKnowledge::Lines(&lines), 1).expect_err("more lines");
    assert!(matches!(refused, AttackError::DescriptorCount { keypoints: 120, descriptors: 4 }), "{refused}");
    let made = network.invert(&descriptors, SIZE, PositionKnowledge::Lines(&lines[..4]), 1).expect("made");
    assert!(made.visibility.is_none(), "lines have no visibility");

    let plain = InversionNetwork::open(&data("plain.toml")).expect("a network");
    let made = plain.invert(&descriptors, SIZE, PositionKnowledge::Positions(&positions), 1).expect("made");
    assert!(!plain.has_visibility() && made.visibility.is_none());
}

#[test]
fn invalid_network_outputs_are_refused() {
    let descriptors = DecodedDescriptors::new(&[7; 128], 128).expect("whole");
    for (name, expected) in [("nan.toml", "values that are not finite"), ("half.toml", "wrong shape")] {
        let network = InversionNetwork::open(&data(name)).expect("it can be read");
        let positions = [Pixel::new(5.0, 5.0)];
        let refused = network
            .invert(&descriptors, SIZE, PositionKnowledge::Positions(&positions), 1)
            .expect_err(name)
            .to_string();
        assert!(refused.contains(expected) && refused.contains(&name.replace("toml", "onnx")), "{refused}");
    }
}

/// Opens a description with these lines as each kind of network; returns the message of the intended kind.
fn refused(folder: &Path, kind: &str, text: &str) -> String {
    let path = folder.join("described.toml");
    std::fs::write(&path, text).expect("written");
    let error = match kind {
        "inversion" => InversionNetwork::open(&path).expect_err(text),
        "positions" => PositionNetwork::open(&path).expect_err(text),
        _ => NeighbourNetwork::open(&path).expect_err(text),
    };
    error.to_string()
}

#[test]
fn invalid_descriptions_are_refused_with_file_name_and_remedy() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let folder = folder.path();
    for name in ["inversion.onnx", "positions.onnx", "neighbours.onnx"] {
        std::fs::copy(data(name), folder.join(name)).expect("copied");
    }
    std::fs::write(folder.join("broken.onnx"), "no network").expect("written");
    let inversion = "version = 1\nkind = \"inversion\"\nmodel = \"inversion.onnx\"\nfeatures = \"sift\"\n\
                     dimension = 128\nside = 32\nmultiple = 4\n";
    let positions = "version = 1\nkind = \"positions\"\nmodel = \"positions.onnx\"\nfeatures = \"a\"\n\
                     dimension = 12\nscheme = \"dcl\"\ninput = \"set\"\n";
    let neighbours =
        "version = 1\nkind = \"neighbours\"\nmodel = \"neighbours.onnx\"\nfeatures = \"a\"\ndimension = 12\n";
    let cases: &[(&str, &str, &str, &str, &str)] = &[
        ("inversion", inversion, "version = 1", "version = 2", "version 2"),
        ("inversion", inversion, "version = 1", "", "has no `version`"),
        ("inversion", inversion, "version = 1", "version = \"1\"", "has no `version`"),
        ("inversion", inversion, "version = 1", "version = = 1", "described.toml"),
        ("inversion", inversion, "dimension = 128", "dimension = 0", "dimension is 0"),
        ("inversion", inversion, "dimension = 128", "dimension = 9999999999", "from 1 to 8192"),
        ("inversion", inversion, "dimension = 128", "dimension = -4", "described.toml"),
        (
            "inversion",
            inversion,
            "dimension = 128",
            "dimension = 64",
            "does not accept the input \"features\"",
        ),
        ("inversion", inversion, "side = 32", "side = 4000000000", "its side is 4000000000"),
        ("inversion", inversion, "side = 32", "", "lacks `side`"),
        ("inversion", inversion, "dimension = 128\nside = 32", "dimension = 8192\nside = 2048", "values"),
        ("inversion", inversion, "multiple = 4", "multiple = 0", "must divide"),
        ("inversion", inversion, "multiple = 4", "multiple = 5", "must divide"),
        ("inversion", inversion, "multiple = 4", "multiple = 4\nscheme = \"dcl\"", "it has `scheme`"),
        ("inversion", inversion, "multiple = 4", "multiple = 4\nwidth = 3", "width"),
        ("inversion", inversion, "multiple = 4", "multiple = 4\ninput = \"set\"", "not one of kind"),
        ("inversion", inversion, "multiple = 4", "multiple = 4\ninput = \"colour\"", "it must be 3"),
        ("positions", positions, "input = \"set\"", "input = \"colour\"", "not one of kind"),
        ("inversion", inversion, "\"inversion.onnx\"", "\"../inversion.onnx\"", "a file in the same folder"),
        ("inversion", inversion, "\"inversion.onnx\"", "\"/dev/zero\"", "a file in the same folder"),
        ("inversion", inversion, "\"inversion.onnx\"", "\"gone.onnx\"", "gone.onnx"),
        ("inversion", inversion, "\"inversion.onnx\"", "\"broken.onnx\"", "broken.onnx"),
        ("inversion", inversion, "\"inversion.onnx\"", "\"positions.onnx\"", "positions.onnx"),
        ("inversion", inversion, "\"inversion.onnx\"", "\"neighbours.onnx\"", "lacks the input \"features\""),
        ("positions", inversion, "", "", "kind \"inversion\", but kind \"positions\""),
        ("inversion", inversion, "\"inversion\"", "\"images\"", "images"),
        ("positions", positions, "\"dcl\"", "\"squares\"", "squares"),
        ("positions", positions, "\"dcl\"", "\"points\"", "openly"),
        ("positions", positions, "\"set\"", "\"all\"", "all"),
        ("positions", positions, "input = \"set\"", "", "lacks `input`"),
        (
            "positions",
            positions,
            "\"positions.onnx\"",
            "\"inversion.onnx\"",
            "it has 1 inputs, but 3 are required",
        ),
        ("neighbours", neighbours, "dimension = 12", "dimension = 12\nside = 32", "it has `side`"),
        (
            "neighbours",
            neighbours,
            "\"neighbours.onnx\"",
            "\"inversion.onnx\"",
            "lacks the input \"descriptors\"",
        ),
    ];
    for (kind, text, from, to, expected) in cases {
        assert!(from.is_empty() || text.contains(from), "{from}");
        let words = refused(folder, kind, &text.replacen(from, to, 1));
        assert!(words.contains(expected), "{expected}: {words}");
        assert!(words.contains("described.toml") || words.contains(".onnx"), "{words}");
    }
    assert!(refused(folder, "neighbours", &"#".repeat(1 << 17)).contains("more than"));
    let gone = InversionNetwork::open(&folder.join("gone.onnx")).expect_err("no description").to_string();
    assert!(gone.contains("gone.toml") && gone.contains("research/train"), "{gone}");
    let binary = InversionNetwork::open(&folder.join("described.png")).expect_err("nothing").to_string();
    assert!(binary.contains("described.png"), "{binary}");
}

/// Any damage of a network file must lead to an error or to an output, never to a panic.
#[test]
fn damaged_networks_do_not_panic() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let text = std::fs::read_to_string(data("inversion.toml")).expect("text");
    std::fs::write(folder.path().join("inversion.toml"), text).expect("written");
    let whole = std::fs::read(data("inversion.onnx")).expect("bytes");
    let descriptors = DecodedDescriptors::new(&[7; 128], 128).expect("whole");
    let positions = [Pixel::new(5.0, 5.0)];
    let run = |bytes: &[u8]| {
        std::fs::write(folder.path().join("inversion.onnx"), bytes).expect("written");
        let network = InversionNetwork::open(&folder.path().join("inversion.toml"));
        network
            .and_then(|network| {
                network.invert(&descriptors, SIZE, PositionKnowledge::Positions(&positions), 1)
            })
            .is_ok()
    };
    assert!(run(&whole));
    for end in (0..whole.len()).step_by(41) {
        run(&whole[..end]);
    }
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    for _ in 0..200 {
        let mut changed = whole.clone();
        let at = rng.random_range(0..changed.len());
        changed[at] ^= 1 << rng.random_range(0..8);
        run(&changed);
    }
}

/// Networks of the trained architectures: outputs equal those that PyTorch wrote.
#[test]
fn outputs_equal_pytorch() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/networks");
    let text = std::fs::read_to_string(folder.join("expected.json")).expect("text");
    let expected: serde_json::Value = serde_json::from_str(&text).expect("a document");
    let tensor = |value: &serde_json::Value| Tensor {
        shape: serde_json::from_value(value["shape"].clone()).expect("sides"),
        data: serde_json::from_value(value["data"].clone()).expect("numbers"),
    };
    for (name, case) in expected.as_object().expect("networks") {
        let network = Network::open(&folder.join(format!("{name}.onnx")), Engine::Rten).expect(name);
        let tensors = |what: &str| -> Vec<(String, Tensor)> {
            let all = case[what].as_object().expect("tensors");
            all.iter().map(|(name, value)| (name.clone(), tensor(value))).collect()
        };
        let (inputs, outputs) = (tensors("inputs"), tensors("outputs"));
        let given: Vec<(&str, &Tensor)> =
            inputs.iter().map(|(name, tensor)| (name.as_str(), tensor)).collect();
        let names: Vec<&str> = outputs.iter().map(|(name, _)| name.as_str()).collect();
        let found = network.run_named(&given, &names).expect("it runs");
        for ((output, expected), found) in outputs.iter().zip(&found) {
            assert_eq!(found.shape, expected.shape, "{name} {output}");
            let largest = expected.data.iter().fold(0.0f32, |most, x| most.max(x.abs()));
            for (own, theirs) in found.data.iter().zip(&expected.data) {
                assert!((own - theirs).abs() < 1e-4 * largest.max(1.0), "{name} {output}: {own} {theirs}");
            }
        }
        let description = folder.join(format!("{name}.toml"));
        match name.as_str() {
            "inversion" => {
                assert!(!InversionNetwork::open(&description).expect("a network").has_visibility());
            }
            "invsfm" => assert!(InversionNetwork::open(&description).expect("a network").has_visibility()),
            "positions" => assert_eq!(
                PositionNetwork::open(&description).expect("one").input_modality(),
                InputModality::Set
            ),
            "neighbours" => drop(NeighbourNetwork::open(&description).expect("a network")),
            other => panic!("{other} is not tested"),
        }
    }
}
