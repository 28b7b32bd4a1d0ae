//! Runs it all.

use std::path::PathBuf;

use veiloc_datasets::problem_files::{KeypointImage, keypoints_of_images};
use veiloc_features::detector::Detection;
use veiloc_features::{ColourImage, Extractor, Progress, load_colour};
use veiloc_geometry::Pixel;
use veiloc_protocol::{ExtractionLimits, Scheme};

use super::attacked::{Answer, Attacked, Realistic, attack};
use super::beliefs::PosePriors;
use super::document::{Column, EvaluationDocument, RebuiltRow};
use super::judges::Judges;
use super::sheet::{Sheet, Tile};
use crate::EvalError;
use crate::inversion::inverter::{Inverter, Known};
use crate::inversion::network::{Grid, Sees};
use crate::inversion::pixels::{on_grid, to_image};

/// How much larger the wide view is than the image.
const WIDE: u32 = 2;
/// What is beyond the image in the wide view of the original.
const BEYOND: u8 = 128;

/// What to evaluate.
pub struct InversionEvaluation<'a> {
    /// Files of images that no network learned from.
    pub images: Vec<PathBuf>,
    /// Schemes, in the order of the table.
    pub schemes: Vec<Scheme>,
    /// Networks; one that is given places at least. Others are used where they fit: of lines under their scheme, of a bag.
    pub networks: &'a [Inverter],
    /// What makes the features, as in training.
    pub extractor: &'a dyn Extractor,
    /// How many keypoints, and how large an image.
    pub limits: ExtractionLimits,
    /// What attackers have who are told nothing.
    pub realistic: Realistic,
    /// Neighbours a keypoint.
    pub k: usize,
    /// Seed of obfuscation and attacks.
    pub seed: u64,
    /// Images on the contact sheets, from the first.
    pub shown: usize,
}

/// Something that is put through a network.
struct Job<'a> {
    column: Column,
    network: &'a Inverter,
    input: Input,
}

enum Input {
    /// Places, by image.
    Places(Vec<Answer>),
    /// What was sent, by image.
    Lines(Vec<Answer>),
    Bag,
    Nothing,
}

/// Of networks that are given the same, one would go unused.
fn refuse_alike(networks: &[Inverter]) -> Result<(), EvalError> {
    let given = |network: &Inverter| match network.shape().sees {
        Sees::Lines => format!("lines of {}", network.scheme()),
        sees @ (Sees::Places | Sees::Bag) => sees.name().to_owned(),
    };
    for (i, network) in networks.iter().enumerate() {
        if networks[..i].iter().any(|earlier| given(earlier) == given(network)) {
            return Err(EvalError::TwoNetworks(given(network)));
        }
    }
    Ok(())
}

/// Evaluates; also the contact sheets, of the images and of the wide view.
///
/// # Errors
/// [`EvalError`] when a file is no image, an attack cannot run, networks are missing or do not fit the features.
pub fn evaluate_inversion(
    evaluation: &InversionEvaluation<'_>,
    judges: &Judges,
    progress: &dyn Progress,
) -> Result<(EvaluationDocument, [Sheet; 2]), EvalError> {
    let of = |sees: Sees| evaluation.networks.iter().filter(move |n| n.shape().sees == sees);
    let placed = of(Sees::Places).next().ok_or(EvalError::NoNetwork)?;
    refuse_alike(evaluation.networks)?;
    let images = keypoints_of_images(&evaluation.images, evaluation.extractor, evaluation.limits, progress)?;
    let originals = evaluation.images.iter().map(|path| load_colour(path)).collect::<Result<Vec<_>, _>>()?;
    let how = (evaluation.k, evaluation.seed);
    let attacked = attack(&images, &evaluation.schemes, &evaluation.realistic, how, progress)?;
    let mut jobs = Vec::new();
    for scheme in &evaluation.schemes {
        if scheme.hides_positions() {
            let own = || attacked.iter().filter(|a| a.scheme == *scheme);
            jobs.extend(own().map(|a| Job::of(a, placed)));
            if let (Some(network), Some(any)) =
                (of(Sees::Lines).find(|n| n.scheme() == *scheme), own().next())
            {
                let column = Column { scheme: scheme.to_string(), attack: "lines", by: None, errors: None };
                jobs.push(Job { column, network, input: Input::Lines(any.images.clone()) });
            }
        } else {
            jobs.push(Job::points(*scheme, &images, placed));
        }
    }
    if let Some(network) = of(Sees::Bag).next() {
        jobs.push(Job::told_nothing("bag", network, Input::Bag));
    }
    jobs.push(Job::told_nothing("nothing", placed, Input::Nothing));

    progress.start("Making images", images.len() * jobs.len());
    let mut rows: Vec<Vec<RebuiltRow>> = jobs.iter().map(|_| Vec::new()).collect();
    let mut beliefs = vec![PosePriors::default(); jobs.len()];
    let mut sheets = [Sheet::default(), Sheet::default()];
    for sheet in &mut sheets {
        sheet.columns.push("original".to_owned());
    }
    let wide: Vec<bool> = jobs.iter().map(|job| matches!(job.input, Input::Places(_))).collect();
    for (job, wide) in jobs.iter().zip(&wide) {
        let name = format!("{} {}", job.column.scheme, job.column.attack);
        if *wide {
            sheets[1].columns.push(name.clone());
        }
        sheets[0].columns.push(name);
    }
    for (i, image) in images.iter().enumerate() {
        let size = [image.width, image.height];
        let mut lines = [Vec::new(), Vec::new()];
        // Most networks have one grid: the original on it, and what is found there.
        let mut held: Option<(Grid, ColourImage, Vec<Detection>)> = None;
        for ((job, rows), beliefs) in jobs.iter().zip(&mut rows).zip(&mut beliefs) {
            let grid = job.network.shape().grid(size);
            let (original, objects) =
                if let Some((_, original, objects)) = held.take().filter(|h| h.0 == grid) {
                    (original, objects)
                } else {
                    let original = to_image(&on_grid(&originals[i], grid), grid);
                    let objects = judges.objects(&original)?;
                    (original, objects)
                };
            if lines[0].is_empty() {
                lines[1].push(Tile { image: amid(&original, grid), boxes: Vec::new() });
                lines[0].push(Tile { image: original.clone(), boxes: objects.clone() });
            }
            let rebuilt = job.image(i, image, 1)?;
            let seen = judges.objects(&rebuilt)?;
            let scores = judges.judge(&original, &objects, &rebuilt, &seen)?;
            rows.push(job.column.row((i, &image.name), &scores));
            job.believes(i, image, beliefs)?;
            if i < evaluation.shown {
                lines[0].push(Tile { image: rebuilt, boxes: seen });
                if matches!(job.input, Input::Places(_)) {
                    lines[1].push(Tile { image: job.image(i, image, WIDE)?, boxes: Vec::new() });
                }
            }
            held = Some((grid, original, objects));
            progress.advance(1);
        }
        if i < evaluation.shown {
            for (sheet, line) in sheets.iter_mut().zip(lines) {
                sheet.rows.push(line);
            }
        }
    }
    progress.finish();
    let document = EvaluationDocument {
        version: 1,
        command: "eval inversion",
        images: images.len(),
        k: evaluation.k,
        seed: evaluation.seed,
        networks: evaluation.networks.iter().map(Into::into).collect(),
        summary: jobs
            .iter()
            .zip(&rows)
            .zip(&beliefs)
            .map(|((job, rows), beliefs)| job.column.summary(rows, beliefs))
            .collect(),
        rows: rows.into_iter().flatten().collect(),
    };
    Ok((document, sheets))
}

impl<'a> Job<'a> {
    fn of(attacked: &Attacked, network: &'a Inverter) -> Self {
        let errors = Some(attacked.images.iter().map(|answer| answer.errors.clone()).collect());
        let (scheme, by) = (attacked.scheme.to_string(), attacked.by.clone());
        let column = Column { scheme, attack: attacked.attack, by, errors };
        Self { column, network, input: Input::Places(attacked.images.clone()) }
    }

    fn points(scheme: Scheme, images: &[KeypointImage], network: &'a Inverter) -> Self {
        let errors = Some(images.iter().map(|image| vec![0.0; image.keypoints.len()]).collect());
        let column = Column { scheme: scheme.to_string(), attack: "none", by: None, errors };
        let answer = |image: &KeypointImage| Answer { places: image.keypoints.clone(), ..Answer::default() };
        Self { column, network, input: Input::Places(images.iter().map(answer).collect()) }
    }

    fn told_nothing(name: &str, network: &'a Inverter, input: Input) -> Self {
        let column = Column { scheme: name.to_owned(), attack: "none", by: None, errors: None };
        Self { column, network, input }
    }

    /// Adds what the network believes of the places that it is given for an image, where it judges places.
    fn believes(&self, at: usize, image: &KeypointImage, to: &mut PosePriors) -> Result<(), EvalError> {
        let (Input::Places(answers), Some(errors)) = (&self.input, &self.column.errors) else {
            return Ok(());
        };
        if let Some(beliefs) = self.network.beliefs(image, &answers[at].places)? {
            let cells = self.network.shape().grid([image.width, image.height]).width;
            to.add(&beliefs, &errors[at], f64::from(image.width) / cells as f64);
        }
        Ok(())
    }

    /// What the network makes of an image, in a view so many times as wide and high.
    fn image(&self, at: usize, image: &KeypointImage, times: u32) -> Result<ColourImage, EvalError> {
        let nowhere: Vec<Pixel>;
        let known = match &self.input {
            Input::Places(answers) => Known::Places(&answers[at].places),
            Input::Lines(answers) => Known::Lines(&answers[at].sent),
            Input::Bag => Known::Nothing,
            Input::Nothing => {
                nowhere = Vec::new();
                Known::Places(&nowhere)
            }
        };
        self.network.invert(image, known, times)
    }
}

/// The original in the middle of the wide view.
fn amid(image: &ColourImage, grid: Grid) -> ColourImage {
    let times = WIDE as usize;
    let (width, height) = (times * grid.width, times * grid.height);
    let mut data = vec![BEYOND; 3 * width * height];
    let (left, upper) = ((width - grid.width) / 2, (height - grid.height) / 2);
    for (row, line) in image.data().chunks_exact(3 * grid.width).enumerate() {
        data[3 * ((upper + row) * width + left)..][..line.len()].copy_from_slice(line);
    }
    ColourImage::new(width as u32, height as u32, data).expect("three bytes a pixel")
}
