//! Runs the evaluation.

use std::path::PathBuf;

use veiloc_attacks::image_metrics::class_named;
use veiloc_attacks::learned::inversion::{Grid, InversionNetwork, Reconstruction};
use veiloc_datasets::problem_files::{KeypointImage, keypoints_of_images};
use veiloc_features::{ColourImage, Extractor, Progress, load_colour};
use veiloc_protocol::ExtractionLimits;

use super::super::AttackEvaluation;
use super::super::neighbours::descriptors;
use super::column::Column;
use super::contact_sheet::{ContactSheet, Tile};
use super::document::{ClassesRow, InversionDocument, NetworkRow};
use super::image_metrics::ImageMetrics;
use super::pixels::on_grid;
use super::recovered::columns;
use crate::EvalError;

/// Side of the wide view, relative to the image.
const WIDE: u32 = 2;
/// Gray value outside the image in the wide view of the original.
const BEYOND: u8 = 128;

/// Inputs and options.
pub struct InversionEvaluation<'a> {
    /// Image files that no network was trained on.
    pub images: Vec<PathBuf>,
    /// Schemes in the order of the table, position networks, neighbours per keypoint, and the seed of obfuscation and
    /// attacks; the attackers set the rest.
    pub attack: AttackEvaluation,
    /// Keypoint files of other scenes: training data of the statistic of descriptor co-occurrence.
    pub train: Vec<PathBuf>,
    /// Images of the scene with keypoints, as a server has them in its map.
    pub map: Vec<KeypointImage>,
    /// The inversion network.
    pub network: &'a InversionNetwork,
    /// The extractor, of the kind that the network was trained on.
    pub extractor: &'a dyn Extractor,
    /// Maximum number of keypoints and maximum image size.
    pub limits: ExtractionLimits,
    /// Number of images on the contact sheets, from the first.
    pub shown: usize,
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
    let mut columns = columns(evaluation, &images, progress)?;
    let mut sheets = [false, true].map(|is_wide| {
        let shown = columns.iter().filter(|column| !is_wide || column.positions().is_some());
        let titles = std::iter::once("original".to_owned()).chain(shown.map(Column::name));
        ContactSheet { columns: titles.collect(), rows: Vec::new() }
    });
    let mut classes = metrics.classifier.is_some().then(ClassesRow::default);

    progress.start("Reconstructing images", images.len() * columns.len());
    for (at, (image, path)) in images.iter().zip(&evaluation.images).enumerate() {
        let grid = network.grid([image.width, image.height]);
        let cell = f64::from(image.width) / grid.width as f64;
        let original = metrics.prepare(on_grid(&load_colour(path)?, grid), class_named(path))?;
        if let (Some(counts), Some(class)) = (&mut classes, &original.class) {
            counts.add(class);
        }
        let mut tiles = [
            vec![Tile { image: original.image.clone(), boxes: original.objects.clone() }],
            vec![Tile { image: centered_in_wide_view(&original.image, grid), boxes: Vec::new() }],
        ];
        let own = descriptors(image)?;
        for column in &mut columns {
            let Reconstruction { image: rebuilt, visibility } =
                column.reconstruct(network, at, image, &own, 1)?;
            let seen = metrics.objects(&rebuilt)?;
            let scores = metrics.compare(&original, &rebuilt, &seen)?;
            column.add(&image.name, &scores, visibility.as_deref(), cell);
            if at < evaluation.shown {
                tiles[0].push(Tile { image: rebuilt, boxes: seen });
                if column.positions().is_some() {
                    let wide = column.reconstruct(network, at, image, &own, WIDE)?.image;
                    tiles[1].push(Tile { image: wide, boxes: Vec::new() });
                }
            }
            progress.advance(1);
        }
        if at < evaluation.shown {
            sheets.iter_mut().zip(tiles).for_each(|(sheet, tiles)| sheet.rows.push(tiles));
        }
    }
    progress.finish();
    let document = InversionDocument {
        version: 1,
        command: "eval inversion",
        images: images.len(),
        k: evaluation.attack.k,
        seed: evaluation.attack.seed,
        network: NetworkRow::from(network),
        classes,
        summary: columns.iter().map(Column::summary).collect(),
        rows: columns.into_iter().flat_map(|column| column.rows).collect(),
    };
    Ok((document, sheets))
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
