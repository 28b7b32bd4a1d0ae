//! The demo's attack: the paper's geometry recovery with an oracle's neighbours, beside the guess it must beat.

use std::fmt::Write as _;
use std::time::Instant;

use rand::SeedableRng;
use rand_chacha::ChaCha20Rng;
use veiloc_attacks::{
    ClosedFormOptions, ErrorSummary, NeighbourLists, Observation, bits_over_prior, closed_form, errors_px,
    prior_only,
};
use veiloc_geometry::Pixel;
use veiloc_map::MapFile;
use veiloc_mapping::Progress;
use veiloc_obfuscation::{extract, seal_with_truth};
use veiloc_query::{Observations, Scheme};

use crate::demo::DemoOptions;
use crate::demo::place::{RenderedPlace, picture};
use crate::error::EvalError;
use crate::metrics::{mean, median};
use crate::report::{AttackRow, PRIOR_ONLY, QueryPanel, SchemePanel};
use crate::seeds::seed_for;

/// Neighbours of a keypoint, as in the paper.
const NEIGHBOURS: usize = 20;

/// Name of the paper's attack in tables and documents.
const CLOSED_FORM: &str = "closed-form";

/// Rows of the table, and the pictures for the report.
pub(crate) struct Attacked {
    pub(crate) rows: Vec<AttackRow>,
    pub(crate) panels: Vec<QueryPanel>,
}

/// Queries whose pictures the report shows.
const SHOWN: usize = 2;

struct Tally {
    errors: Vec<f64>,
    ms: Vec<f64>,
}

/// Attacks every hidden view under every scheme that hides positions.
pub(crate) fn attack_all(
    place: &RenderedPlace,
    map: &MapFile,
    options: &DemoOptions,
    progress: &dyn Progress,
) -> Result<Attacked, EvalError> {
    let profile = map.profile();
    let schemes: Vec<Scheme> = options.schemes.iter().copied().filter(|s| s.hides_positions()).collect();
    let tally = || Tally { errors: Vec::new(), ms: Vec::new() };
    let mut tallies: Vec<[Tally; 2]> = schemes.iter().map(|_| [tally(), tally()]).collect();
    let mut panels = Vec::new();
    let mut size = (place.camera.width, place.camera.height);

    progress.start("Attacking queries", place.query_list.len());
    for (index, name) in place.query_list.iter().enumerate() {
        let path = place.images.join(name);
        let (features, camera) = extract(&path, &place.camera, profile)?;
        let mut panel = QueryPanel {
            name: name.clone(),
            picture: picture(&path)?,
            keypoints: features.keypoints.iter().map(|k| k.pixel).collect(),
            schemes: Vec::new(),
        };
        for (scheme, [attack, guess]) in schemes.iter().zip(&mut tallies) {
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
            guess.ms.push(started.elapsed().as_secs_f64() * 1e3);
            let neighbours = NeighbourLists::nearest(&pixels, NEIGHBOURS);
            let started = Instant::now();
            let recovered: Vec<Pixel> =
                closed_form(&observed, &neighbours, width, height, &ClosedFormOptions::default())?
                    .iter()
                    .map(|r| r.pixel)
                    .collect();
            attack.ms.push(started.elapsed().as_secs_f64() * 1e3);
            guess.errors.extend(errors_px(guessed.iter().copied(), &pixels));
            attack.errors.extend(errors_px(recovered.iter().copied(), &pixels));
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

    let images = place.query_list.len();
    let mut rows = Vec::new();
    for (scheme, [attack, guess]) in schemes.iter().zip(&tallies) {
        let bits = bits_over_prior(&attack.errors, &guess.errors, size.0, size.1);
        rows.push(row(*scheme, PRIOR_ONLY, images, guess, None));
        rows.push(row(*scheme, CLOSED_FORM, images, attack, Some(bits)));
    }
    Ok(Attacked { rows, panels })
}

fn row(
    scheme: Scheme,
    attack: &str,
    images: usize,
    tally: &Tally,
    bits_over_prior: Option<f64>,
) -> AttackRow {
    let summary = ErrorSummary::of(&tally.errors);
    AttackRow {
        scheme: scheme.to_string(),
        attack: attack.to_owned(),
        images,
        mean_px: mean(&tally.errors),
        median_px: summary.median_px,
        under_30px: summary.under_30px,
        bits_over_prior,
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
        "{:<24}{:<14}{:>9}{:>11}{:>11}{:>14}{:>9}\n",
        "scheme", "attack", "mean px", "median px", "< 30 px", "bits gained", "ms"
    );
    let width = text.trim_end().chars().count();
    text.push_str(&"─".repeat(width));
    text.push('\n');
    for r in rows {
        let _ = writeln!(
            text,
            "{:<24}{:<14}{:>9.1}{:>11.1}{:>9.1} %{:>14}{:>9.2}",
            r.scheme,
            r.attack,
            r.mean_px,
            r.median_px,
            100.0 * r.under_30px,
            r.bits_over_prior.map_or("—".to_owned(), |b| format!("{b:.2}")),
            r.ms
        );
    }
    text
}
