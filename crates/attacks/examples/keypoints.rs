//! Attacks every scheme on keypoint files (`keypoints.jsonl.gz`, DESIGN's format) and prints a table.
//!
//! `cargo run --release -p veiloc-attacks --example keypoints -- FILE… [--pictures N]`
//! Without a file: the paper's synthetic scene, 1500 evenly spread keypoints in 640 x 480.
#![expect(clippy::print_stdout, reason = "an example talks to its terminal")]

use std::error::Error;
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::time::Instant;

use flate2::read::GzDecoder;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc_attacks::{
    ClosedFormOptions, ErrorSummary, NeighbourLists, Observation, bits_over_prior, closed_form, errors_px,
    lift, prior_only,
};
use veiloc_geometry::{DualAnchors, Pixel};

/// One picture's keypoints.
#[derive(serde::Deserialize)]
struct Picture {
    width: u32,
    height: u32,
    keypoints: Vec<[f64; 2]>,
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut files = Vec::new();
    let mut pictures = 20;
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        if argument == "--pictures" {
            pictures = arguments.next().ok_or("--pictures needs a number")?.parse()?;
        } else {
            files.push(argument);
        }
    }
    if files.is_empty() {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let keypoints =
            (0..1500).map(|_| [rng.random_range(0.0..640.0), rng.random_range(0.0..480.0)]).collect();
        table("1500 evenly spread keypoints", &[Picture { width: 640, height: 480, keypoints }])?;
    }
    for file in files {
        table(&file, &read(&file, pictures)?)?;
    }
    Ok(())
}

fn read(file: &str, pictures: usize) -> Result<Vec<Picture>, Box<dyn Error>> {
    let lines = BufReader::new(GzDecoder::new(File::open(file)?)).lines();
    lines.take(pictures).map(|line| Ok(serde_json::from_str(&line?)?)).collect()
}

fn table(title: &str, pictures: &[Picture]) -> Result<(), Box<dyn Error>> {
    println!("{title}: {} pictures, K = 20 true neighbours", pictures.len());
    println!(
        "{:<22} {:<20} {:>8} {:>8} {:>6} {:>6} {:>6} {:>7} {:>7}",
        "scheme", "attack", "mean px", "median", "<5px", "<10px", "<30px", "bits", "ms"
    );
    for scheme in ["random-lines", "coordinate-permutation", "dcl"] {
        let mut errors: [Vec<f64>; 3] = Default::default();
        let mut bits = [0.0; 3];
        let mut ms = [0.0; 3];
        for (p, picture) in pictures.iter().enumerate() {
            let mut rng = ChaCha8Rng::seed_from_u64(p as u64);
            let truth: Vec<Pixel> = picture.keypoints.iter().map(|k| Pixel::new(k[0], k[1])).collect();
            let (w, h) = (picture.width, picture.height);
            let sent: Vec<Observation> = match scheme {
                "random-lines" => lift::random_lines(&truth, &mut rng),
                "dcl" => lift::dual_convergent(&truth, &DualAnchors::vertical(w, h)),
                _ => lift::coordinate_permutation(&truth, &mut rng),
            };
            let lists = NeighbourLists::nearest(&truth, 20);
            let mut guess_errors = Vec::new();
            for attack in 0..3 {
                let start = Instant::now();
                let answers: Vec<Pixel> = match attack {
                    0 => prior_only(&sent, w, h),
                    k => {
                        let options = if k == 1 {
                            ClosedFormOptions::default()
                        } else {
                            ClosedFormOptions::in_picture()
                        };
                        closed_form(&sent, &lists, w, h, &options)?.iter().map(|r| r.pixel).collect()
                    }
                };
                ms[attack] += start.elapsed().as_secs_f64() * 1e3 / pictures.len() as f64;
                let e = errors_px(answers, &truth);
                if attack == 0 {
                    guess_errors.clone_from(&e);
                }
                bits[attack] += bits_over_prior(&e, &guess_errors, w, h) / pictures.len() as f64;
                errors[attack].extend(e);
            }
        }
        for (k, attack) in ["prior-only", "closed-form", "closed-form-in-picture"].iter().enumerate() {
            let s = ErrorSummary::of(&errors[k]);
            println!(
                "{scheme:<22} {attack:<20} {:>8.1} {:>8.1} {:>5.1}% {:>5.1}% {:>5.1}% {:>+7.2} {:>7.2}",
                s.mean_px,
                s.median_px,
                100.0 * s.under_5px,
                100.0 * s.under_10px,
                100.0 * s.under_30px,
                bits[k],
                ms[k]
            );
        }
    }
    Ok(())
}
