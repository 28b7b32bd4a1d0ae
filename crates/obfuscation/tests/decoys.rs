//! How well decoys hide among real keypoints, measured on real descriptors (`VEILOC_DATA`): the figures of
//! `docs/privacy.md`. `cargo test -p veiloc-obfuscation --test decoys -- --nocapture` prints them.

mod common;

use std::io::{BufRead, BufReader};
use std::path::Path;

use base64::Engine;
use common::{options, profile, rng};
use rand::seq::index::sample;
use rand_chacha::ChaCha8Rng;
use veiloc_descriptor::{DescriptorKind, Descriptors, GlobalDescriptor, Vocabulary};
use veiloc_features::{Features, Keypoint, compact};
use veiloc_geometry::{Intrinsics, Pixel};
use veiloc_obfuscation::{SealTruth, seal_with_truth};
use veiloc_query::{Profile, SealedQuery};
use veiloc_testdata::real_data_test;

/// One row of a sealed query as the attacker sees it, beside the truth.
struct Row {
    image: usize,
    descriptor: Vec<f64>,
    decoy: bool,
}

/// All keypoints of one real image.
struct Image {
    size: [u32; 2],
    features: Features,
}

fn images(folder: &Path) -> Vec<Image> {
    let mut images = Vec::new();
    for name in ["redkitchen", "herzjesu"] {
        let path = folder.join(format!("problems/{name}_keypoints.jsonl.gz"));
        let file = std::fs::File::open(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        for line in BufReader::new(flate2::read::GzDecoder::new(file)).lines() {
            let record: serde_json::Value = serde_json::from_str(&line.expect("text")).expect("JSON");
            let encoded = record["descriptors"].as_str().expect("text");
            let bytes = base64::engine::general_purpose::STANDARD.decode(encoded).expect("base64");
            let keypoints = record["keypoints"].as_array().expect("a list").iter().map(|position| {
                let [u, v] = [0, 1].map(|axis| position[axis].as_f64().expect("a number"));
                Keypoint { pixel: Pixel::new(u, v), scale: 1.0, orientation: 0.0, response: 1.0 }
            });
            images.push(Image {
                size: ["width", "height"].map(|k| record[k].as_u64().expect("a number") as u32),
                features: Features {
                    keypoints: keypoints.collect(),
                    descriptors: Descriptors::new(DescriptorKind::ROOT_SIFT, bytes).expect("whole rows"),
                    global: None,
                },
            });
        }
    }
    images
}

/// The image reduced to some of its keypoints, sealed.
fn seal_some(
    image: &Image,
    chosen: &[usize],
    profile: &Profile,
    rng: &mut ChaCha8Rng,
) -> (SealedQuery, SealTruth) {
    let features = Features {
        keypoints: chosen.iter().map(|&i| image.features.keypoints[i]).collect(),
        descriptors: image.features.descriptors.select(chosen.iter().copied()),
        global: None,
    };
    let [width, height] = image.size;
    let params = [f64::from(width.max(height)), f64::from(width) / 2.0, f64::from(height) / 2.0];
    let camera = Intrinsics::new("SIMPLE_PINHOLE", width, height, &params).expect("valid");
    seal_with_truth(features, &camera, profile, &options("dcl"), rng).expect("both sides have some")
}

/// Images of 100 keypoints drawn from real ones, sealed: those within the window, and decoys up to 256 rows.
fn sealed_rows(images: &[Image], profile: &Profile) -> Vec<Row> {
    let mut rng = rng(1);
    let mut rows = Vec::new();
    for (index, image) in images.iter().enumerate() {
        let chosen = sample(&mut rng, image.features.keypoints.len(), 100).into_vec();
        let (query, truth) = seal_some(image, &chosen, profile, &mut rng);
        let descriptors = query.descriptors();
        rows.extend(truth.source.iter().enumerate().map(|(row, source)| Row {
            image: index,
            descriptor: descriptors.values(row).map(f64::from).collect(),
            decoy: source.is_none(),
        }));
    }
    rows
}

/// Probability that a decoy has a higher value than a real row: 0.5 is chance.
fn auc(values: &[(f64, bool)]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (mut below, mut wins, mut at) = (0.0, 0.0, 0);
    while at < sorted.len() {
        let end = at + sorted[at..].iter().take_while(|v| v.0 == sorted[at].0).count();
        let decoys = sorted[at..end].iter().filter(|v| v.1).count() as f64;
        let real = (end - at) as f64 - decoys;
        wins += decoys * (below + real / 2.0);
        below += real;
        at = end;
    }
    wins / (below * (sorted.len() as f64 - below))
}

/// Cosine between the mirror image of quarter `quarter` of `a` and quarter `other` of `b`: what someone who has read
/// the recipe looks for.
fn mirrored_quarter(a: &[f64], b: &[f64], quarter: usize) -> f64 {
    let (mut ab, mut aa, mut bb) = (0.0, 1e-9, 1e-9);
    for cell in 0..4 {
        let (y, x) = (quarter / 2 * 2 + cell / 2, quarter % 2 * 2 + cell % 2);
        for direction in 0..8 {
            let p = a[(y * 4 + x) * 8 + direction];
            let q = b[((3 - y) * 4 + x) * 8 + (8 - direction) % 8];
            (ab, aa, bb) = (ab + p * q, aa + p * p, bb + q * q);
        }
    }
    ab / (aa * bb).sqrt()
}

/// Logistic regression on features of a row, trained on even images and judged on odd ones.
fn trained(rows: &[Row], features: impl Fn(&Row) -> Vec<f64>) -> f64 {
    let inputs: Vec<(Vec<f64>, bool, bool)> =
        rows.iter().map(|r| (features(r), r.decoy, r.image % 2 == 0)).collect();
    let mut weights = vec![0.0; inputs[0].0.len() + 1];
    let score = |w: &[f64], x: &[f64]| w[0] + x.iter().zip(&w[1..]).map(|(a, b)| a * b).sum::<f64>();
    for epoch in 0..60 {
        let rate = 0.05 / (1.0 + f64::from(epoch) / 10.0);
        for (x, decoy, train) in &inputs {
            if *train {
                let error = f64::from(u8::from(*decoy)) - 1.0 / (1.0 + (-score(&weights, x)).exp());
                weights[0] += rate * error;
                weights[1..].iter_mut().zip(x).for_each(|(w, v)| *w += rate * error * v);
            }
        }
    }
    let judged: Vec<(f64, bool)> =
        inputs.iter().filter(|i| !i.2).map(|(x, decoy, _)| (score(&weights, x), *decoy)).collect();
    auc(&judged)
}

#[real_data_test]
fn decoys_hide_as_well_as_the_document_says(data: &Path) {
    let rows = sealed_rows(&images(data), &profile());
    let simple = |value: &dyn Fn(&Row) -> f64| -> f64 {
        auc(&rows.iter().map(|row| (value(row), row.decoy)).collect::<Vec<_>>())
    };
    let others = |row: &Row| others(&rows, row);
    let norm = simple(&|r| r.descriptor.iter().map(|v| v * v).sum::<f64>().sqrt());
    let zeros = simple(&|r| r.descriptor.iter().filter(|v| **v == 0.0).count() as f64);
    let sum = simple(&|r| r.descriptor.iter().sum());
    let largest = simple(&|r| r.descriptor.iter().copied().fold(0.0, f64::max));
    let nearest = simple(&|r| {
        let distance = |o: &&Row| r.descriptor.iter().zip(&o.descriptor).map(|(a, b)| (a - b).powi(2)).sum();
        -others(r).iter().map(distance).fold(f64::INFINITY, f64::min)
    });
    let linear = trained(&rows, |r| r.descriptor.iter().map(|v| v / 64.0 - 0.6).collect());
    // Roughness: energy of the differences across the middle lines of the patch, where a decoy was pieced together,
    // against those inside the quarters.
    let seam = simple(&|r| {
        let difference = |y0: usize, x0: usize, y1: usize, x1: usize| -> f64 {
            (0..8)
                .map(|d| (r.descriptor[(y0 * 4 + x0) * 8 + d] - r.descriptor[(y1 * 4 + x1) * 8 + d]).powi(2))
                .sum()
        };
        let across: f64 = (0..4).map(|i| difference(1, i, 2, i) + difference(i, 1, i, 2)).sum();
        let within: f64 = (0..4)
            .map(|i| {
                difference(0, i, 1, i)
                    + difference(2, i, 3, i)
                    + difference(i, 0, i, 1)
                    + difference(i, 2, i, 3)
            })
            .sum();
        across / within
    });
    let recipe = simple(&|r| {
        (0..4)
            .map(|quarter| {
                others(r)
                    .iter()
                    .map(|o| mirrored_quarter(&r.descriptor, &o.descriptor, quarter))
                    .fold(0.0, f64::max)
            })
            .sum()
    });
    judge(
        "RootSIFT",
        &rows,
        &[
            ("length of the vector", norm, 0.40..0.60),
            ("zeros", zeros, 0.40..0.60),
            ("sum", sum, 0.40..0.60),
            ("largest number", largest, 0.40..0.60),
            ("distance to the nearest row", nearest, 0.40..0.60),
            ("seams between the quarters", seam, 0.40..0.65),
            ("logistic regression trained on decoys", linear, 0.40..0.72),
            // The measure must see the pieces, or it proves nothing; it must not see all of them.
            ("search for the mirrored pieces", recipe, 0.60..0.82),
        ],
    );
}

/// Prints what was found, and holds it within what the document says.
#[expect(clippy::print_stderr, reason = "the figures of the document")]
fn judge(kind: &str, rows: &[Row], found: &[(&str, f64, std::ops::Range<f64>)]) {
    eprintln!("AUC of telling decoys from real rows of {kind}, 0.5 is chance, {} images:", rows.len() / 256);
    for (what, found, _) in found {
        eprintln!("{found:.2}  {what}");
    }
    for (what, found, allowed) in found {
        assert!(allowed.contains(found), "{kind}, {what}: {found:.3}");
    }
}

/// The other rows of a row's query.
fn others<'a>(rows: &'a [Row], row: &Row) -> Vec<&'a Row> {
    rows.iter()
        .skip(row.image * 256)
        .take(256)
        .filter(|other| !std::ptr::eq(*other, row))
        .inspect(|other| assert_eq!(other.image, row.image))
        .collect()
}

/// How many numbers three rows explain, each taken in its turn as the one that explains most of the rest: what someone who has
/// read how rows are mixed looks for.
fn explained(row: &Row, others: &[&Row]) -> f64 {
    let mut left: Vec<usize> = (0..row.descriptor.len()).collect();
    for _ in 0..3 {
        let equal =
            |other: &&&Row| left.iter().filter(|i| other.descriptor[**i] == row.descriptor[**i]).count();
        let best = others.iter().max_by_key(equal).expect("a row");
        left.retain(|i| best.descriptor[*i] != row.descriptor[*i]);
    }
    (row.descriptor.len() - left.len()) as f64
}

#[real_data_test]
fn decoys_of_compact_descriptors_hide_as_well_as_the_document_says(data: &Path) {
    let mut images = images(data);
    for image in &mut images {
        image.features.descriptors = compact(&image.features.descriptors);
    }
    let profile =
        Profile::vlad(Vocabulary::new(images[0].features.descriptors.select(0..8)).expect("eight words"));
    let rows = sealed_rows(&images, &profile);
    let simple = |value: &dyn Fn(&Row) -> f64| -> f64 {
        auc(&rows.iter().map(|row| (value(row), row.decoy)).collect::<Vec<_>>())
    };
    let numbers = |r: &Row| r.descriptor.iter().map(|v| v / 32.0).collect::<Vec<f64>>();
    let norm = simple(&|r| r.descriptor.iter().map(|v| v * v).sum::<f64>().sqrt());
    let sum = simple(&|r| r.descriptor.iter().sum());
    let largest = simple(&|r| r.descriptor.iter().map(|v| v.abs()).fold(0.0, f64::max));
    let nearest = simple(&|r| {
        let distance = |o: &&Row| r.descriptor.iter().zip(&o.descriptor).map(|(a, b)| (a - b).powi(2)).sum();
        -others(&rows, r).iter().map(distance).fold(f64::INFINITY, f64::min)
    });
    let linear = trained(&rows, numbers);
    let products = trained(&rows, |r| {
        let x = numbers(r);
        let pairs = (0..x.len()).flat_map(|i| (i..x.len()).map(move |j| (i, j)));
        pairs.map(|(i, j)| x[i] * x[j] / 8.0).collect()
    });
    let pieces = simple(&|r| explained(r, &others(&rows, r)));
    let mut draw = rng(3);
    let mixed: Vec<(f64, bool)> = (0..rows.len() / 256)
        .flat_map(|image| {
            let real: Vec<&Row> = rows.iter().filter(|r| r.image == image && !r.decoy).collect();
            let parents = sample(&mut draw, real.len(), 3).into_vec();
            let numbers = (0..real[0].descriptor.len()).map(|i| real[parents[i % 3]].descriptor[i]);
            let row = Row { image, descriptor: numbers.collect(), decoy: true };
            let own = real.iter().enumerate().map(|(i, r)| {
                let rest: Vec<&Row> =
                    real.iter().enumerate().filter(|(j, _)| i != *j).map(|(_, r)| *r).collect();
                (explained(r, &rest), false)
            });
            own.chain([(explained(&row, &real), true)]).collect::<Vec<_>>()
        })
        .collect();
    let mixed = auc(&mixed);
    judge(
        "compact descriptors",
        &rows,
        &[
            ("length of the vector", norm, 0.40..0.60),
            ("sum", sum, 0.40..0.60),
            ("largest number", largest, 0.40..0.60),
            ("distance to the nearest row", nearest, 0.40..0.60),
            ("logistic regression trained on decoys", linear, 0.40..0.60),
            ("the same of products of two numbers", products, 0.40..0.70),
            ("search for the rows it is mixed of", pieces, 0.40..0.60),
            // It sees rows that are mixed and no more, or it proves nothing.
            ("the same, of rows mixed without noise", mixed, 0.90..1.01),
        ],
    );
}

/// What it costs that the global descriptor is made from decoys too: each image is looked up by some of its
/// keypoints among all images, which are known by their other keypoints.
#[real_data_test]
fn decoys_cost_in_retrieval_what_the_document_says(data: &Path) {
    let images = images(data);
    let mut rng = rng(2);
    let mut samples = Descriptors::empty(DescriptorKind::ROOT_SIFT);
    for image in &images {
        for i in sample(&mut rng, image.features.descriptors.len(), 400) {
            samples.push(image.features.descriptors.row(i)).expect("a row");
        }
    }
    let vocabulary = Vocabulary::train(samples.view(), 64, &mut rng).expect("enough samples");
    let profile = Profile::vlad(vocabulary.clone());
    const DRAWS: usize = 8;
    for kept in [50, 100, 200] {
        let [mut plain, mut with_decoys] = [0.0; 2];
        for _ in 0..DRAWS {
            let chosen: Vec<Vec<usize>> = images
                .iter()
                .map(|p| sample(&mut rng, p.features.keypoints.len(), kept).into_vec())
                .collect();
            let known: Vec<GlobalDescriptor> = images
                .iter()
                .zip(&chosen)
                .map(|(p, chosen)| {
                    let rest = (0..p.features.keypoints.len()).filter(|i| !chosen.contains(i));
                    vocabulary.aggregate(p.features.descriptors.select(rest).view())
                })
                .collect();
            // One over the rank of the right image.
            let found = |query: &GlobalDescriptor, right: usize| {
                let own = query.similarity(known[right].as_codes());
                1.0 / known.iter().filter(|k| query.similarity(k.as_codes()) >= own).count() as f64
            };
            for (right, (image, chosen)) in images.iter().zip(&chosen).enumerate() {
                let n = (DRAWS * images.len()) as f64;
                let (query, truth) = seal_some(image, chosen, &profile, &mut rng);
                with_decoys += found(query.global(), right) / n;
                // Those that are sent: at the image's border some are dropped.
                let sent = truth.source.iter().flatten().map(|source| chosen[*source]);
                let real = image.features.descriptors.select(sent);
                plain += found(&vocabulary.aggregate(real.view()), right) / n;
            }
        }
        eprintln!("{kept} keypoints: mean reciprocal rank {plain:.2} without decoys, {with_decoys:.2} with");
        assert!(with_decoys > 0.2 && with_decoys > plain - 0.1, "{kept}: {plain} {with_decoys}");
    }
}
