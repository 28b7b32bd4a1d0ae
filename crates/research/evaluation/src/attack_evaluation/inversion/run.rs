//! Runs the evaluation.

use std::path::PathBuf;

use veiloc_attacks::DecodedDescriptors;
use veiloc_attacks::image_metrics::class_named;
use veiloc_attacks::learned::inversion::{Grid, InversionNetwork, PositionKnowledge, Reconstruction};
use veiloc_datasets::problem_files::{KeypointImage, keypoints_of_images};
use veiloc_features::{ColourImage, Extractor, Progress, load_colour};
use veiloc_protocol::{ExtractionLimits, Scheme};

use super::contact_sheet::{ContactSheet, Tile};
use super::document::{ClassesRow, Column, InversionDocument, NetworkRow, ReconstructionRow};
use super::image_metrics::ImageMetrics;
use super::pixels::on_grid;
use super::recovered::{RealisticAttackOptions, RecoveredImage, RecoveredImages, attack};
use super::visibility::VisibilityScores;
use crate::EvalError;
use crate::attack_evaluation::descriptors;

/// Side of the wide view, relative to the image.
const WIDE: u32 = 2;
/// Gray value outside the image in the wide view of the original.
const BEYOND: u8 = 128;

/// Inputs and options.
pub struct InversionEvaluation<'a> {
    /// Image files that no network was trained on.
    pub images: Vec<PathBuf>,
    /// Schemes, in the order of the table.
    pub schemes: Vec<Scheme>,
    /// The inversion network.
    pub network: &'a InversionNetwork,
    /// The extractor, of the kind that the network was trained on.
    pub extractor: &'a dyn Extractor,
    /// Maximum number of keypoints and maximum image size.
    pub limits: ExtractionLimits,
    /// Resources of attackers without an oracle.
    pub realistic: RealisticAttackOptions,
    /// Neighbours per keypoint.
    pub k: usize,
    /// Seed of obfuscation and attacks.
    pub seed: u64,
    /// Number of images on the contact sheets, from the first.
    pub shown: usize,
}

/// One input of the network.
struct Job {
    column: Column,
    input: Input,
}

enum Input {
    /// Positions, by image.
    Positions(Vec<RecoveredImage>),
    /// The sent observations, by image.
    Lines(Vec<RecoveredImage>),
    Unordered,
    Nothing,
}

/// Runs the evaluation; also returns the contact sheets of the images and of the wide view.
///
/// # Errors
/// [`EvalError`] when a file is not an image, an attack cannot run, or the network was trained on other features.
pub fn evaluate_inversion(
    evaluation: &InversionEvaluation<'_>,
    metrics: &ImageMetrics,
    progress: &dyn Progress,
) -> Result<(InversionDocument, [ContactSheet; 2]), EvalError> {
    let network = evaluation.network;
    let (learned, given) = (network.features(), evaluation.extractor.kind());
    if learned != given.name() {
        return Err(EvalError::Options(format!(
            "{}: it was trained on features {learned}, but these are {}; use --features {learned}",
            network.file().display(),
            given.name()
        )));
    }
    let images = keypoints_of_images(&evaluation.images, evaluation.extractor, evaluation.limits, progress)?;
    let originals = evaluation.images.iter().map(|path| load_colour(path)).collect::<Result<Vec<_>, _>>()?;
    let how = (evaluation.k, evaluation.seed);
    let attacked = attack(&images, &evaluation.schemes, &evaluation.realistic, how, progress)?;
    let mut jobs = Vec::new();
    for scheme in &evaluation.schemes {
        if scheme.hides_positions() {
            let own = || attacked.iter().filter(|a| a.scheme == *scheme);
            jobs.extend(own().map(Job::of));
            jobs.extend(own().next().map(Job::lines));
        } else {
            jobs.push(Job::points(*scheme, &images));
        }
    }
    jobs.push(Job::without_positions("bag", Input::Unordered));
    jobs.push(Job::without_positions("nothing", Input::Nothing));

    progress.start("Reconstructing images", images.len() * jobs.len());
    let mut rows: Vec<Vec<ReconstructionRow>> = jobs.iter().map(|_| Vec::new()).collect();
    let mut visibility_scores = vec![VisibilityScores::default(); jobs.len()];
    let mut classes = metrics.classifier.is_some().then(ClassesRow::default);
    let mut sheets = [ContactSheet::default(), ContactSheet::default()];
    for sheet in &mut sheets {
        sheet.columns.push("original".to_owned());
    }
    let wide: Vec<bool> = jobs.iter().map(|job| matches!(job.input, Input::Positions(_))).collect();
    for (job, wide) in jobs.iter().zip(&wide) {
        let name = format!("{} {}", job.column.scheme, job.column.attack);
        if *wide {
            sheets[1].columns.push(name.clone());
        }
        sheets[0].columns.push(name);
    }
    for (i, image) in images.iter().enumerate() {
        let grid = network.grid([image.width, image.height]);
        let original = metrics.prepare(on_grid(&originals[i], grid), class_named(&evaluation.images[i]))?;
        if let (Some(counts), Some(class)) = (&mut classes, &original.class) {
            counts.add(class);
        }
        let mut lines = [
            vec![Tile { image: original.image.clone(), boxes: original.objects.clone() }],
            vec![Tile { image: centered_in_wide_view(&original.image, grid), boxes: Vec::new() }],
        ];
        let own = descriptors(image)?;
        for ((job, rows), visibility_scores) in jobs.iter().zip(&mut rows).zip(&mut visibility_scores) {
            let Reconstruction { image: rebuilt, visibility } = job.image(network, i, image, &own, 1)?;
            let seen = metrics.objects(&rebuilt)?;
            let scores = metrics.compare(&original, &rebuilt, &seen)?;
            rows.push(job.column.row((i, &image.name), &scores));
            if let (Some(visibility), Some(errors)) = (visibility, &job.column.errors) {
                visibility_scores.add(&visibility, &errors[i], f64::from(image.width) / grid.width as f64);
            }
            if i < evaluation.shown {
                lines[0].push(Tile { image: rebuilt, boxes: seen });
                if matches!(job.input, Input::Positions(_)) {
                    let wide = job.image(network, i, image, &own, WIDE)?.image;
                    lines[1].push(Tile { image: wide, boxes: Vec::new() });
                }
            }
            progress.advance(1);
        }
        if i < evaluation.shown {
            for (sheet, line) in sheets.iter_mut().zip(lines) {
                sheet.rows.push(line);
            }
        }
    }
    progress.finish();
    let document = InversionDocument {
        version: 1,
        command: "eval inversion",
        images: images.len(),
        k: evaluation.k,
        seed: evaluation.seed,
        network: NetworkRow::from(network),
        classes,
        summary: jobs
            .iter()
            .zip(&rows)
            .zip(&visibility_scores)
            .map(|((job, rows), visibility_scores)| job.column.summary(rows, visibility_scores))
            .collect(),
        rows: rows.into_iter().flatten().collect(),
    };
    Ok((document, sheets))
}

impl Job {
    fn of(attacked: &RecoveredImages) -> Self {
        let errors = Some(attacked.images.iter().map(|answer| answer.errors.clone()).collect());
        let (scheme, by) = (attacked.scheme.to_string(), attacked.by.clone());
        let column = Column { scheme, attack: attacked.attack, by, errors };
        Self { column, input: Input::Positions(attacked.images.clone()) }
    }

    fn lines(attacked: &RecoveredImages) -> Self {
        let scheme = attacked.scheme.to_string();
        let column = Column { scheme, attack: "lines", by: None, errors: None };
        Self { column, input: Input::Lines(attacked.images.clone()) }
    }

    fn points(scheme: Scheme, images: &[KeypointImage]) -> Self {
        let errors = Some(images.iter().map(|image| vec![0.0; image.keypoints.len()]).collect());
        let column = Column { scheme: scheme.to_string(), attack: "none", by: None, errors };
        let answer = |image: &KeypointImage| RecoveredImage {
            positions: image.keypoints.clone(),
            ..RecoveredImage::default()
        };
        Self { column, input: Input::Positions(images.iter().map(answer).collect()) }
    }

    fn without_positions(name: &str, input: Input) -> Self {
        let column = Column { scheme: name.to_owned(), attack: "none", by: None, errors: None };
        Self { column, input }
    }

    /// The network's output for an image; `times`: side of the view relative to the image.
    fn image(
        &self,
        network: &InversionNetwork,
        at: usize,
        image: &KeypointImage,
        descriptors: &DecodedDescriptors,
        times: u32,
    ) -> Result<Reconstruction, EvalError> {
        let size = [image.width, image.height];
        let known = match &self.input {
            Input::Positions(answers) => PositionKnowledge::Positions(&answers[at].positions),
            Input::Lines(answers) => PositionKnowledge::Lines(&answers[at].sent),
            Input::Unordered => PositionKnowledge::None,
            Input::Nothing => {
                let none = DecodedDescriptors::new(&[], descriptors.dimension())?;
                return Ok(network.invert(&none, size, PositionKnowledge::Positions(&[]), times)?);
            }
        };
        Ok(network.invert(descriptors, size, known, times)?)
    }
}

/// The original in the centre of the wide view.
fn centered_in_wide_view(image: &ColourImage, grid: Grid) -> ColourImage {
    let times = WIDE as usize;
    let (width, height) = (times * grid.width, times * grid.height);
    let mut data = vec![BEYOND; 3 * width * height];
    let (left, upper) = ((width - grid.width) / 2, (height - grid.height) / 2);
    for (row, line) in image.data().chunks_exact(3 * grid.width).enumerate() {
        data[3 * ((upper + row) * width + left)..][..line.len()].copy_from_slice(line);
    }
    ColourImage::new(width as u32, height as u32, data).expect("three bytes a pixel")
}
