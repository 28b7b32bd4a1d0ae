//! The demo's attacks: the paper's geometry recovery and the layout of the whole graph, both with an oracle's
//! neighbours, beside the guess they must beat.

use std::fmt::Write as _;
use std::time::Instant;

use rand::SeedableRng;
use rand_chacha::ChaCha20Rng;
use veiloc_attacks::{
    ClosedFormOptions, ErrorSummary, GraphOptions, NeighbourLists, Observation, bits_over_prior, closed_form,
    errors_px, graph, prior_only,
};
use veiloc_geometry::Pixel;
use veiloc_map::MapFile;
use veiloc_mapping::Progress;
use veiloc_obfuscation::{extract, seal_with_truth};
use veiloc_query::{Observations, Scheme};

use crate::demo::DemoOptions;
use crate::demo::place::{RenderedPlace, image};
use crate::error::EvalError;
use crate::metrics::{mean, median};
use crate::report::{AttackRow, PRIOR_ONLY, QueryPanel, SchemePanel};
use crate::seeds::seed_for;

/// Neighbours of a keypoint, as in the paper.
const NEIGHBOURS: usize = 20;

/// Name of the paper's attack in tables and documents.
const CLOSED_FORM: &str = "closed-form";

/// Name of the graph attack in tables and documents.
const GRAPH: &str = "graph";

/// Rows of the table, and the images for the report.
pub(crate) struct Attacked {
    pub(crate) rows: Vec<AttackRow>,
    pub(crate) panels: Vec<QueryPanel>,
}

/// Queries whose images the report shows, and that the graph attack works on: it takes seconds an image.
const SHOWN: usize = 2;

/// Errors of one attack on one scheme, those of the guess on the same keypoints, and milliseconds an image.
#[derive(Default)]
struct Tally {
    errors: Vec<f64>,
    guessed: Vec<f64>,
    ms: Vec<f64>,
}

impl Tally {
    fn add(&mut self, recovered: &[Pixel], guessed: &[Pixel], truth: &[Pixel], started: Instant) {
        self.ms.push(started.elapsed().as_secs_f64() * 1e3);
        self.errors.extend(errors_px(recovered.iter().copied(), truth));
        self.guessed.extend(errors_px(guessed.iter().copied(), truth));
    }
}

/// What is tried on every scheme, in the order of the table.
const ATTACKS: [&str; 3] = [PRIOR_ONLY, CLOSED_FORM, GRAPH];

/// Attacks every hidden view under every scheme that hides positions.
pub(crate) fn attack_all(
    place: &RenderedPlace,
    map: &MapFile,
    options: &DemoOptions,
    progress: &dyn Progress,
) -> Result<Attacked, EvalError> {
    let profile = map.profile();
    let schemes: Vec<Scheme> = options.schemes.iter().copied().filter(|s| s.hides_positions()).collect();
    let mut tallies: Vec<[Tally; 3]> = schemes.iter().map(|_| Default::default()).collect();
    let mut panels = Vec::new();
    let mut size = (place.camera.width, place.camera.height);

    progress.start("Attacking queries", place.query_list.len());
    for (index, name) in place.query_list.iter().enumerate() {
        let path = place.images.join(name);
        let (features, camera) = extract(&path, &place.camera, profile)?;
        let mut panel = QueryPanel {
            name: name.clone(),
            image: image(&path)?,
            keypoints: features.keypoints.iter().map(|k| k.pixel).collect(),
            schemes: Vec::new(),
        };
        for (scheme, [guess, crossing, layout]) in schemes.iter().zip(&mut tallies) {
            let mut rng = ChaCha20Rng::seed_from_u64(seed_for(options.seed, &[name, &scheme.to_string()]));
            let (query, truth) =
                seal_with_truth(features.clone(), &camera, &profile.with_scheme(*scheme), &mut rng)
                    .map_err(|source| EvalError::Seal { name: name.clone(), source })?;
            // Decoys hide nothing; to recover one is no success.
            let real: Vec<usize> = (0..query.len()).filter(|&i| truth.source[i].is_some()).collect();
            let pixels: Vec<Pixel> = real.iter().map(|&i| truth.pixels[i]).collect();
            let (width, height) = (query.camera().width, query.camera().height);
            size = (width, height);
            let sent = query.observations();
            let read = Observation::of_sent(&sent);
            let observed: Vec<Observation> = real.iter().map(|&i| read[i]).collect();

            let started = Instant::now();
            let guessed = prior_only(&observed, width, height);
            guess.add(&guessed, &guessed, &pixels, started);
            let neighbours = NeighbourLists::nearest(&pixels, NEIGHBOURS);
            let started = Instant::now();
            let recovered: Vec<Pixel> =
                closed_form(&observed, &neighbours, width, height, &ClosedFormOptions::default())?
                    .iter()
                    .map(|r| r.pixel)
                    .collect();
            crossing.add(&recovered, &guessed, &pixels, started);
            if index < SHOWN {
                let started = Instant::now();
                let answer =
                    graph(&observed, &neighbours, width, height, &GraphOptions::default(), &mut rng)?;
                layout.add(&answer.pixels, &guessed, &pixels, started);
            }
            panel.schemes.push(SchemePanel {
                scheme: scheme.to_string(),
                sent: select(&sent, &real),
                truth: pixels,
                recovered,
                guessed,
                size: (width, height),
            });
        }
        if index < SHOWN {
            panels.push(panel);
        }
        progress.advance(1);
    }
    progress.finish();

    let mut rows = Vec::new();
    for (scheme, tallies) in schemes.iter().zip(&tallies) {
        rows.extend(ATTACKS.iter().zip(tallies).map(|(attack, tally)| row(*scheme, attack, tally, size)));
    }
    Ok(Attacked { rows, panels })
}

fn row(scheme: Scheme, attack: &str, tally: &Tally, (width, height): (u32, u32)) -> AttackRow {
    let summary = ErrorSummary::of(&tally.errors);
    AttackRow {
        scheme: scheme.to_string(),
        attack: attack.to_owned(),
        images: tally.ms.len(),
        mean_px: mean(&tally.errors),
        median_px: summary.median_px,
        under_30px: summary.under_30px,
        bits_over_prior: (attack != PRIOR_ONLY)
            .then(|| bits_over_prior(&tally.errors, &tally.guessed, width, height)),
        ms: median(&tally.ms),
    }
}

fn select(sent: &Observations, rows: &[usize]) -> Observations {
    fn pick<T: Copy>(all: &[T], rows: &[usize]) -> Vec<T> {
        rows.iter().map(|&i| all[i]).collect()
    }
    match sent {
        Observations::Points(pixels) => Observations::Points(pick(pixels, rows)),
        Observations::Lines(lines) => Observations::Lines(pick(lines, rows)),
        Observations::EitherLine(pairs) => Observations::EitherLine(pick(pairs, rows)),
        Observations::Anchored { anchors, lines } => {
            Observations::Anchored { anchors: *anchors, lines: pick(lines, rows) }
        }
    }
}

/// The attacks as a table for people.
pub fn attack_table(rows: &[AttackRow]) -> String {
    let mut text = format!(
        "{:<24}{:<14}{:>7}{:>9}{:>11}{:>11}{:>13}{:>10}\n",
        "scheme", "attack", "views", "mean px", "median px", "< 30 px", "bits gained", "ms"
    );
    let width = text.trim_end().chars().count();
    text.push_str(&"─".repeat(width));
    text.push('\n');
    for r in rows {
        let _ = writeln!(
            text,
            "{:<24}{:<14}{:>7}{:>9.1}{:>11.1}{:>9.1} %{:>13}{:>10.2}",
            r.scheme,
            r.attack,
            r.images,
            r.mean_px,
            r.median_px,
            100.0 * r.under_30px,
            r.bits_over_prior.map_or("—".to_owned(), |b| format!("{b:.2}")),
            r.ms
        );
    }
    text
}
