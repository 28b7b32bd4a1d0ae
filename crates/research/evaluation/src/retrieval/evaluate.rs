//! Retrieval of every query among databases of several sizes, exhaustively and through the index.

use std::fs::File;
use std::io::{self, BufWriter, Write as _};
use std::path::{Path, PathBuf};
use std::time::Instant;

use rayon::prelude::*;
use serde::Serialize;
use veiloc_descriptor::{GlobalDescriptor, GlobalIndex, Vocabulary};
use veiloc_features::{Extractor, FeatureError, Limits, Progress, extract_image};
use veiloc_map::MapFile;

use crate::EvalError;
use crate::retrieval::synthetic_descriptors::extend_with_synthetic;

/// Inputs and options.
#[derive(Clone)]
pub struct RetrievalEvaluation {
    /// The query images.
    pub queries: Vec<PathBuf>,
    /// Images of other scenes, added to the images of the map.
    pub distractors: Vec<PathBuf>,
    /// Database sizes, in the order of the table. If smaller than the map, its first images are used.
    pub sizes: Vec<usize>,
    /// Number of retrieved images.
    pub retrieve: usize,
    /// Seed of the synthetic descriptors.
    pub seed: u64,
    /// A folder for `searched.npy` and `queries.npy`: the global descriptors, int8, one row per image, for other
    /// indexes.
    pub save: Option<PathBuf>,
}

/// Results of one search method on one database size.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct RetrievalRow {
    /// Number of images in the database.
    pub images: usize,
    /// Number of images with real, not synthetic, global descriptors.
    pub real: usize,
    /// Search method: `all` is exhaustive, `index` uses the index.
    pub search: &'static str,
    /// Seconds to build the index, on all processors; 0 without one.
    pub build_seconds: f64,
    /// Bytes of the global descriptors and the index in memory.
    pub bytes: usize,
    /// Milliseconds per search on one processor, median over the queries.
    pub median_ms: f64,
    /// Recall: share of the images found by exhaustive search that this search finds.
    pub recall: f64,
    /// Share of the retrieved images that belong to the map.
    pub map_share: f64,
}

/// Searches the images of a map for each query, among other images up to each database size. Except for times, the
/// results do not depend on the number of threads.
///
/// # Errors
/// [`EvalError`]: an image cannot be read, the options select nothing, or the global descriptors of the map are not
/// computed from local features.
pub fn evaluate_retrieval(
    map: &MapFile,
    extractor: &dyn Extractor,
    evaluation: &RetrievalEvaluation,
    progress: &dyn Progress,
) -> Result<Vec<RetrievalRow>, EvalError> {
    let Some(vocabulary) = map.profile().vocabulary() else {
        return Err(EvalError::Options(
            "the map's global descriptors are computed from whole images; give a map with global descriptors of local features".to_owned(),
        ));
    };
    let largest = evaluation.sizes.iter().copied().max().unwrap_or(0);
    let nothing = || EvalError::Options("no images to search, or no queries".to_owned());
    if evaluation.sizes.contains(&0) || largest == 0 {
        return Err(nothing());
    }
    let limits = map.profile().limits();
    let limits = Limits { max_keypoints: limits.max_keypoints as usize, max_side: limits.max_image_side };
    let globals = |what: &str, images: &[PathBuf]| -> Result<Vec<GlobalDescriptor>, EvalError> {
        progress.start(what, images.len());
        let of_image = |path: &PathBuf| -> Result<GlobalDescriptor, FeatureError> {
            let image = extract_image(path, None, extractor, limits)?;
            progress.advance(1);
            Ok(vocabulary.aggregate(image.features.descriptors.view()))
        };
        let all = images.par_iter().map(of_image).collect::<Result<Vec<_>, _>>();
        progress.finish();
        all.map_err(EvalError::Features)
    };
    let codes = vocabulary.global_len();
    let queries = globals("Describing queries", &evaluation.queries)?;
    if queries.is_empty() {
        return Err(nothing());
    }
    let distractors = globals("Describing other images", &evaluation.distractors)?;
    let mut all: Vec<i8> =
        (0..map.image_count()).flat_map(|image| map.image(image).global()).copied().collect();
    all.extend(distractors.iter().flat_map(GlobalDescriptor::as_codes));
    let real = all.len() / codes;
    if largest > real {
        progress.start("Generating descriptors", 1);
        extend_with_synthetic(&mut all, (codes, block_of(vocabulary)), largest, evaluation.seed);
        progress.advance(1);
        progress.finish();
    }
    if let Some(folder) = &evaluation.save {
        let rows: Vec<i8> = queries.iter().flat_map(GlobalDescriptor::as_codes).copied().collect();
        for (name, values) in [("searched.npy", &all[..largest * codes]), ("queries.npy", &rows)] {
            let path = folder.join(name);
            save_npy(&path, values, codes).map_err(|source| EvalError::Io { path, source })?;
        }
    }
    let mut rows = Vec::new();
    progress.start("Searching", evaluation.sizes.len());
    for images in &evaluation.sizes {
        let database = Database { all: &all[..images * codes], codes, of_map: map.image_count(), real };
        rows.extend(database.rows(&queries, evaluation.retrieve));
        progress.advance(1);
    }
    progress.finish();
    Ok(rows)
}

/// Writes `[N, columns]` in NumPy's format version 1.0: a header with a multiple of 64 bytes, then the rows.
fn save_npy(path: &Path, values: &[i8], columns: usize) -> io::Result<()> {
    let shape = format!(
        "{{'descr': '|i1', 'fortran_order': False, 'shape': ({}, {columns}), }}",
        values.len() / columns
    );
    // Ten bytes precede it and a line feed ends it.
    let header = format!("{shape}{}\n", " ".repeat(63 - (shape.len() + 10) % 64));
    let mut file = BufWriter::new(File::create(path)?);
    file.write_all(b"\x93NUMPY\x01\x00")?;
    file.write_all(&(header.len() as u16).to_le_bytes())?;
    file.write_all(header.as_bytes())?;
    for part in values.chunks(1 << 16) {
        file.write_all(&part.iter().map(|value| *value as u8).collect::<Vec<u8>>())?;
    }
    file.flush()
}

/// Number of codes per visual word.
const fn block_of(vocabulary: &Vocabulary) -> usize {
    vocabulary.global_len() / vocabulary.len()
}

/// A database.
struct Database<'a> {
    /// `[N, codes]`
    all: &'a [i8],
    codes: usize,
    /// Number of images of the map, which are the first.
    of_map: usize,
    real: usize,
}

impl Database<'_> {
    fn rows(&self, queries: &[GlobalDescriptor], count: usize) -> [RetrievalRow; 2] {
        let images = self.all.len() / self.codes;
        let row = |search,
                   build_seconds,
                   bytes,
                   found: &[Vec<usize>],
                   ms: &mut Vec<f64>,
                   true_ones: &[Vec<usize>]| {
            ms.sort_by(f64::total_cmp);
            let share = |holds: &dyn Fn(usize, usize) -> bool| {
                let all = found.iter().enumerate().flat_map(|(q, own)| own.iter().map(move |i| (q, *i)));
                let (good, count) =
                    all.fold((0, 0), |(good, count), (q, i)| (good + usize::from(holds(q, i)), count + 1));
                f64::from(good as u32) / f64::from((count as u32).max(1))
            };
            RetrievalRow {
                images,
                real: self.real.min(images),
                search,
                build_seconds,
                bytes,
                median_ms: ms.get(ms.len() / 2).copied().unwrap_or(f64::NAN),
                recall: share(&|q, i| true_ones[q].contains(&i)),
                map_share: share(&|_, i| i < self.of_map),
            }
        };
        let timed = |search: &dyn Fn(&GlobalDescriptor) -> Vec<usize>| -> (Vec<Vec<usize>>, Vec<f64>) {
            let one = |query: &GlobalDescriptor| {
                let started = Instant::now();
                let found = search(query);
                (found, started.elapsed().as_secs_f64() * 1e3)
            };
            queries.iter().map(one).unzip()
        };
        let (exact, mut exact_ms) = timed(&|query| self.best(query, 0..images, count));
        let started = Instant::now();
        let index = GlobalIndex::new(self.all, self.codes);
        let built = started.elapsed().as_secs_f64();
        let (indexed, mut ms) = timed(&|query| {
            self.best(query, index.candidates(query, GlobalIndex::candidates_for(count)).into_iter(), count)
        });
        [
            row("all", 0.0, self.all.len(), &exact, &mut exact_ms, &exact),
            row("index", built, self.all.len() + index.byte_count(), &indexed, &mut ms, &exact),
        ]
    }

    /// The best of these images, by comparing all codes.
    fn best(&self, query: &GlobalDescriptor, among: impl Iterator<Item = usize>, count: usize) -> Vec<usize> {
        let found = query
            .most_similar(among.map(|image| (image, &self.all[image * self.codes..][..self.codes])), count);
        found.into_iter().map(|(image, _)| image).collect()
    }
}
