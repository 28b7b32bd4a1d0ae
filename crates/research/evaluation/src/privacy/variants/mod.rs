//! `veiloc eval tradeoff`: variants of dcl, each judged by what attackers get out of it and by the poses it still gives.
//!
//! A variant ([`Variant`]) says what a device might do differently: send fewer keypoints, coarser angles, decoys. Poses
//! and attacks work on the very same rows. Errors are those of keypoints that are sent; what is not sent is not leaked,
//! so beside shares stand absolute numbers: keypoints of an image that an attack puts near the truth.

mod data;
mod document;
mod localization;

mod privacy;
mod select;
mod sent;
mod table;
mod variant;

use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use crate::EvalError;
use crate::privacy::spread::spread;
use crate::results::metrics::Threshold;
use crate::results::{QueryResult, summarize};
use data::{Data, Query};
use privacy::{Attackers, Judgement};
use rayon::prelude::*;
use sent::Sent;
use veiloc_attacks::{Descriptors, KnownImage, NeighbourPredictor, Transfer, transfer};
use veiloc_datasets::problem_files::json_lines;
use veiloc_datasets::problem_files::{KeypointImage, read_keypoints};
use veiloc_features::Progress;
use veiloc_pose::PoseOptions;

pub use document::{AttackFigures, LocalizationFigures, TradeoffDocument, VariantFigures};

pub use table::tradeoff_table;
pub use variant::{DividingLine, Keep, Variant, VariantError};

/// What to evaluate.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct TradeoffEvaluation {
    /// All keypoints of images, with descriptors.
    pub keypoints: PathBuf,
    /// Matches of the same images, with true poses; images without serve the map of `transfer` only.
    pub problems: PathBuf,
    /// More images of the map that `transfer` takes positions from, beside the others of [`Self::keypoints`].
    pub map: Vec<PathBuf>,
    /// Images that teach the predictor of neighbours; those named as a query are left out. Empty: nothing is predicted.
    pub train: Vec<PathBuf>,
    /// Variants, in the order of the table.
    pub variants: Vec<Variant>,
    /// How many images are attacked, spread evenly over the queries; `None` for all. Poses are estimated for all.
    pub attacked: Option<usize>,
    /// Neighbours a keypoint.
    pub k: usize,
    /// Percent of the oracle's neighbours that are replaced at random, one graph attack each.
    pub corrupt: Vec<f64>,
    /// Thresholds of the recall columns.
    pub thresholds: Vec<Threshold>,
    /// Robust estimation.
    pub pose: PoseOptions,
    /// Whether matches are weighted by what their ratio, votes and track length say.
    pub use_prior: bool,
    /// Whether the estimator's noise is raised by what the variant adds on average.
    pub tell_noise: bool,
    /// First seed of every random choice; attacks use this one alone.
    pub seed: u64,
    /// Seeds that poses are estimated with, at least one.
    pub seeds: u64,
}

impl TradeoffEvaluation {
    /// `dcl` as it is on these files, every image attacked, one seed.
    pub fn new(keypoints: PathBuf, problems: PathBuf) -> Self {
        Self {
            keypoints,
            problems,
            map: Vec::new(),
            train: Vec::new(),
            variants: vec![Variant::default()],
            attacked: None,
            k: 20,
            corrupt: vec![0.0, 30.0, 50.0],
            thresholds: Vec::new(),
            pose: PoseOptions::default(),
            use_prior: true,
            tell_noise: true,
            seed: 0,
            seeds: 1,
        }
    }
}

/// Judges every variant.
///
/// # Errors
/// [`EvalError`] when a file cannot be read, files do not belong together, descriptors are missing, or nothing was
/// asked for. An image that cannot be localized is a result, not an error.
pub fn evaluate_tradeoff(
    evaluation: &TradeoffEvaluation,
    progress: &dyn Progress,
) -> Result<TradeoffDocument, EvalError> {
    if evaluation.variants.is_empty() || evaluation.seeds == 0 || evaluation.attacked == Some(0) {
        return Err(EvalError::Options("no variant, seed or image to evaluate".to_owned()));
    }
    let data = data::read(&evaluation.keypoints, &evaluation.problems)?;
    let map = map_images(&data, &evaluation.map)?;
    let teachers = teachers(&data, &evaluation.train)?;
    let attacked = spread(data.queries.len(), evaluation.attacked);
    let world = World { evaluation, data: &data, map: &map, transfers: Mutex::default() };

    let steps = attacked.len() + data.queries.len();
    progress.start("Judging variants", evaluation.variants.len() * steps);
    let mut variants = Vec::new();
    for variant in &evaluation.variants {
        let predictor = predictor(variant, &teachers, evaluation)?;
        let judged: Vec<(usize, usize, Judgement)> = attacked
            .par_iter()
            .map(|&q| {
                let judged = world.attack(variant, q, predictor.as_ref());
                progress.advance(1);
                judged
            })
            .collect::<Result<_, _>>()?;
        let located: Vec<Vec<QueryResult>> = data
            .queries
            .par_iter()
            .map(|query| {
                let results = world.localize(variant, query);
                progress.advance(1);
                results
            })
            .collect::<Result<_, _>>()?;
        let located: Vec<&QueryResult> = located.iter().flatten().collect();
        let summary = summarize(&located, &evaluation.thresholds);
        variants.push(VariantFigures::of(variant, &data.queries, &attacked, &judged, &summary, &located));
    }
    progress.finish();
    let name = json_lines::display_name;
    Ok(TradeoffDocument {
        version: 1,
        command: "eval tradeoff",
        data: vec![name(&evaluation.keypoints), name(&evaluation.problems)],
        queries: data.queries.len(),
        attacked: attacked.len(),
        map_images: map.len(),
        train_images: teachers.len(),
        k: evaluation.k,
        tell_noise: evaluation.tell_noise,
        thresholds: evaluation.thresholds.iter().map(ToString::to_string).collect(),
        seed: evaluation.seed,
        seeds: evaluation.seeds,
        variants,
    })
}

/// Rows of one query: its index, the keypoints that were kept, and how many rows with decoys.
type Rows = (usize, Vec<usize>, usize);

/// What is the same for all variants.
struct World<'a> {
    evaluation: &'a TradeoffEvaluation,
    data: &'a Data,
    map: &'a [(String, KnownImage)],
    /// What the map tells about these rows of this query: it does not depend on lines, so variants share it.
    transfers: Mutex<HashMap<Rows, Arc<Transfer>>>,
}

impl World<'_> {
    /// Rows that are no decoys, decoys, and what attackers make of them.
    fn attack(
        &self,
        variant: &Variant,
        q: usize,
        predictor: Option<&NeighbourPredictor>,
    ) -> Result<(usize, usize, Judgement), EvalError> {
        let query = &self.data.queries[q];
        let sent = Sent::of(variant, &query.image, Some(&query.ratios), self.evaluation.seed)?;
        let transfer = self.transfer(q, &sent)?;
        let attackers = Attackers {
            k: self.evaluation.k,
            corrupt: &self.evaluation.corrupt,
            transfer: transfer.as_deref(),
            predictor,
            seed: self.evaluation.seed,
        };
        let judged = privacy::judge(&sent, &query.image, &attackers)?;
        Ok((sent.kept.len(), sent.truth.len() - sent.kept.len(), judged))
    }

    /// `None` without an image of the map.
    fn transfer(&self, q: usize, sent: &Sent) -> Result<Option<Arc<Transfer>>, EvalError> {
        let image = &self.data.queries[q].image;
        let key = (q, sent.kept.clone(), sent.truth.len());
        let lock = || self.transfers.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(known) = lock().get(&key) {
            return Ok(Some(Arc::clone(known)));
        }
        let others: Vec<KnownImage> =
            self.map.iter().filter(|(name, _)| *name != image.name).map(|(_, p)| p.clone()).collect();
        if others.is_empty() {
            return Ok(None);
        }
        let (bytes, dimension) = &sent.descriptors;
        let descriptors = Descriptors::new(bytes, *dimension)?;
        let size = (image.width, image.height);
        let found = Arc::new(transfer(&descriptors, &others, size, MAP_IMAGES, 1)?);
        lock().insert(key, Arc::clone(&found));
        Ok(Some(found))
    }

    fn localize(&self, variant: &Variant, query: &Query) -> Result<Vec<QueryResult>, EvalError> {
        let e = self.evaluation;
        let size = (query.image.width, query.image.height);
        (e.seed..e.seed.saturating_add(e.seeds))
            .map(|seed| {
                let sent = Sent::of(variant, &query.image, Some(&query.ratios), seed)?;
                let mut pose = e.pose.clone();
                if e.tell_noise {
                    pose.noise_px = pose.noise_px.hypot(sent.added_variance(variant, size).sqrt());
                }
                Ok(localization::localize(query, &sent, e.use_prior, &pose, seed))
            })
            .collect()
    }
}

/// Images of the map from which a server takes positions over: those with most mutual matches.
const MAP_IMAGES: usize = 5;

/// Every image that a server might have, by name; queries among them know nothing of themselves.
fn map_images(data: &Data, files: &[PathBuf]) -> Result<Vec<(String, KnownImage)>, EvalError> {
    let mut images: Vec<KeypointImage> = data.queries.iter().map(|q| q.image.clone()).collect();
    images.extend(data.others.iter().cloned());
    for file in files {
        images.extend(read_keypoints(file)?);
    }
    let all = |p: &KeypointImage| (0..p.keypoints.len()).collect::<Vec<_>>();
    images.into_iter().map(|p| Ok((p.name.clone(), data::known(&p, &all(&p))?))).collect()
}

fn teachers(data: &Data, files: &[PathBuf]) -> Result<Vec<KeypointImage>, EvalError> {
    let mut images = Vec::new();
    for file in files {
        images.extend(read_keypoints(file)?);
    }
    images.retain(|p| data.queries.iter().all(|q| q.image.name != p.name));
    if images.is_empty() && !files.is_empty() {
        return Err(EvalError::Options(
            "every training image is named as one that is attacked; train on other images".to_owned(),
        ));
    }
    Ok(images)
}

/// The predictor of an attacker who knows the variant: learned from keypoints thinned out in the same way, without
/// decoys and without knowing what of its images a map knows.
fn predictor(
    variant: &Variant,
    teachers: &[KeypointImage],
    evaluation: &TradeoffEvaluation,
) -> Result<Option<NeighbourPredictor>, EvalError> {
    if teachers.is_empty() {
        return Ok(None);
    }
    let honest = Variant { decoys: 0.0, ..variant.clone() };
    let images = teachers
        .par_iter()
        .map(|p| data::known(p, &Sent::of(&honest, p, None, evaluation.seed)?.kept))
        .collect::<Result<Vec<_>, _>>()?;
    Ok(Some(NeighbourPredictor::fit(&images, evaluation.k)?))
}
