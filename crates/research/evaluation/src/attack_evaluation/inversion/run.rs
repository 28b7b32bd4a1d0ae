//! Runs the evaluation.

use std::path::PathBuf;

use veiloc_attacks::DecodedDescriptors;
use veiloc_attacks::image_metrics::{class_named, psnr};
use veiloc_attacks::learned::InputModality;
use veiloc_attacks::learned::inversion::{Grid, InversionNetwork, Reconstruction};
use veiloc_datasets::problem_files::{KeypointImage, keypoints_of_images};
use veiloc_features::{ColourImage, Extractor, Progress, load_colour};
use veiloc_geometry::Pixel;
use veiloc_protocol::ExtractionLimits;

use super::super::neighbours::descriptors;
use super::super::{AttackEvaluation, ServerKnowledge};
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
    /// Their keypoints, where they are known already, such as those of [`Self::server`]: of the window in the middle of
    /// each image that a device sends. Empty: they are extracted.
    pub keypoints: Vec<KeypointImage>,
    /// What a server knows that has localized these keypoints; `None`: no such attacks.
    pub server: Option<ServerKnowledge>,
    /// Schemes and attacks with true neighbours in the order of the table, position networks, neighbours per keypoint, and
    /// the seed of obfuscation and attacks; the attackers set the rest.
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
    let learned = network.features();
    let of_file = evaluation.keypoints.iter().filter_map(|image| Some(image.descriptors.as_ref()?.kind()));
    let mut kinds = of_file.chain(evaluation.keypoints.is_empty().then(|| evaluation.extractor.kind()));
    if let Some(given) = kinds.find(|given| given.name() != learned) {
        return Err(EvalError::Options(format!(
            "{}: it was trained on features {learned}, but these are {}; use --features {learned}",
            network.file().display(),
            given.name()
        )));
    }
    let images = match &evaluation.keypoints[..] {
        [] => keypoints_of_images(&evaluation.images, evaluation.extractor, evaluation.limits, progress)?,
        given => given.to_vec(),
    };
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
        let mut photo = load_colour(path)?;
        if !evaluation.keypoints.is_empty() {
            photo = window(&photo, [image.width, image.height])?;
        }
        let own = given_rows(network, image, &photo)?;
        let original = metrics.prepare(on_grid(&photo, grid), class_named(path))?;
        if let (Some(counts), Some(class)) = (&mut classes, &original.class) {
            counts.add(class);
        }
        let mut tiles = [
            vec![Tile { image: original.image.clone(), boxes: original.objects.clone() }],
            vec![Tile { image: centered_in_wide_view(&original.image, grid), boxes: Vec::new() }],
        ];
        for column in &mut columns {
            let Reconstruction { image: rebuilt, visibility } =
                column.reconstruct(network, at, image, &own, 1)?;
            let seen = metrics.objects(&rebuilt)?;
            let mut scores = metrics.compare(&original, &rebuilt, &seen)?;
            if let Some(corners) = column.private_cells(at, image, grid) {
                scores.private_psnr =
                    Some(psnr(&part(&original.image, corners)?, &part(&rebuilt, corners)?)?);
            }
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

/// What the network is given of each keypoint: its descriptor, its colour, or nothing.
fn given_rows(
    network: &InversionNetwork,
    image: &KeypointImage,
    photo: &ColourImage,
) -> Result<DecodedDescriptors, EvalError> {
    let (count, scale) = (image.keypoints.len(), f64::from(photo.width()) / f64::from(image.width));
    Ok(match network.input() {
        InputModality::Positions => DecodedDescriptors::as_they_are(0, count, std::iter::empty()),
        InputModality::Colour => {
            let at = |x: f64, side: u32| ((x * scale).max(0.0) as usize).min(side as usize - 1);
            let colour = |p: &Pixel| {
                let pixel = at(p.v, photo.height()) * photo.width() as usize + at(p.u, photo.width());
                [0, 1, 2].map(|channel| f32::from(photo.data()[3 * pixel + channel]) / 127.5 - 1.0)
            };
            DecodedDescriptors::as_they_are(3, count, image.keypoints.iter().flat_map(colour))
        }
        _ => descriptors(image)?,
    })
}

/// The window of this size in the middle of an image, which a device sends.
fn window(image: &ColourImage, [width, height]: [u32; 2]) -> Result<ColourImage, EvalError> {
    let corner = |whole: u32, part: u32| (whole.saturating_sub(part) / 2) as usize;
    let (left, upper) = (corner(image.width(), width), corner(image.height(), height));
    let right = (left + width as usize).min(image.width() as usize);
    let lower = (upper + height as usize).min(image.height() as usize);
    part(image, [left, upper, right, lower])
}

/// The part of an image between these pixels: left, upper, right and lower end.
fn part(image: &ColourImage, [left, upper, right, lower]: [usize; 4]) -> Result<ColourImage, EvalError> {
    let rows = image.data().chunks_exact(3 * image.width() as usize).take(lower).skip(upper);
    let data = rows.flat_map(|row| row[3 * left..3 * right].iter().copied()).collect();
    Ok(ColourImage::new((right - left) as u32, (lower - upper) as u32, data)?)
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
