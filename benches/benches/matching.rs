//! Nearest neighbours of descriptors: 1024 queries against 20 000 rows of 128 bytes, one thread.
//!
//! `cargo bench -p veiloc-benches --bench matching`. The references are the portable version of the kernels, and matrix
//! products in f32 (crate `gemm`) followed by the same search for the two best. All are checked to agree before they
//! are timed; the ratio of their best times is printed first. For less noise use an idle machine and, on Linux,
//! `taskset -c 1`.
#![expect(
    unsafe_code,
    reason = "the rival's function is unsafe; it runs on no other machine than the benchmark's"
)]
#![expect(clippy::print_stdout, reason = "a benchmark talks")]

use std::{hint::black_box, sync::LazyLock, time::Instant};

use divan::Bencher;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc_descriptor::{
    DescriptorKind, Descriptors, MatchOptions, Vocabulary, match_descriptors, two_nearest,
};
use veiloc_simd::{Backend, BestTwo, PackedRows, best_two};

const DIM: usize = 128;
const QUERIES: usize = 1024;
const ROWS: usize = 20_000;

static QUERY: LazyLock<Descriptors> = LazyLock::new(|| random_descriptors(QUERIES, 1));
static DATABASE: LazyLock<Descriptors> = LazyLock::new(|| random_descriptors(ROWS, 2));

fn main() {
    compare();
    divan::main();
}

/// Checks that all versions agree, and prints the ratios of their times.
fn compare() {
    let (query, database) = (QUERY.as_bytes(), DATABASE.as_bytes());
    let expected = search(Backend::PORTABLE, query, database);
    let mut times: Vec<_> = Backend::available()
        .into_iter()
        .map(|backend| {
            assert_eq!(search(backend, query, database), expected, "{}", backend.name());
            (backend.name(), best_ms(|| search(backend, query, database)))
        })
        .collect();
    let floats = FloatRows::new(query, database);
    let wrong =
        floats.search().iter().zip(&expected).filter(|(f, e)| f.0 != e.map_or(0, |e| e.index)).count();
    assert!(wrong == 0, "products in f32 are exact for bytes, yet {wrong} neighbours differ");
    times.push(("gemm f32", best_ms(|| floats.search())));
    let fastest = times.iter().map(|t| t.1).fold(f64::INFINITY, f64::min);
    println!("two nearest of {QUERIES} x {ROWS} x {DIM}, one thread, best of 5:");
    for (name, ms) in times {
        println!("  {name:<12} {ms:8.2} ms  {:6.2} x the fastest", ms / fastest);
    }
}

fn best_ms<T>(mut work: impl FnMut() -> T) -> f64 {
    let time = |_| {
        let start = Instant::now();
        black_box(work());
        start.elapsed().as_secs_f64() * 1e3
    };
    (0..5).map(time).fold(f64::INFINITY, f64::min)
}

fn search(backend: Backend, query: &[u8], database: &[u8]) -> Vec<Option<BestTwo>> {
    best_two(query, &PackedRows::new(backend, database, DIM))
}

/// Packing and search by all backends.
#[divan::bench(args = Backend::available().into_iter().map(Backend::name))]
fn one_thread(bencher: Bencher<'_, '_>, name: &str) {
    let backend = Backend::available().into_iter().find(|b| b.name() == name).expect("one of the arguments");
    bencher.bench(|| search(backend, QUERY.as_bytes(), DATABASE.as_bytes()));
}

/// Packing of the database only.
#[divan::bench]
fn packing() -> PackedRows {
    PackedRows::new(Backend::best(), DATABASE.as_bytes(), DIM)
}

#[divan::bench]
fn gemm_f32(bencher: Bencher<'_, '_>) {
    let floats = FloatRows::new(QUERY.as_bytes(), DATABASE.as_bytes());
    bencher.bench(|| floats.search());
}

/// The public function, with all threads.
#[divan::bench]
fn all_threads() -> usize {
    two_nearest(QUERY.view(), DATABASE.view()).len()
}

/// One direction, and both directions in one pass, with all threads, for one retrieved image (1024 x 2000).
#[divan::bench(args = [false, true])]
fn one_image(bencher: Bencher<'_, '_>, mutual: bool) {
    let options = MatchOptions::default().with_mutual(mutual);
    bencher.bench(|| match_descriptors(QUERY.view(), DATABASE.view().rows(0..2000), &options));
}

#[divan::bench]
fn vlad_1024(bencher: Bencher<'_, '_>) {
    let vocabulary = Vocabulary::new(DATABASE.select(0..64)).expect("64 words");
    bencher.bench(|| vocabulary.aggregate(QUERY.view()));
}

#[divan::bench(sample_count = 3)]
fn train_64_words_from_20000() -> Vocabulary {
    Vocabulary::train(DATABASE.view(), 64, &mut ChaCha8Rng::seed_from_u64(1)).expect("enough samples")
}

/// The reference: rows as f32, squared distances by matrix products over blocks of the database.
struct FloatRows {
    query: Vec<f32>,
    database: Vec<f32>,
    query_norms: Vec<f32>,
    database_norms: Vec<f32>,
}

impl FloatRows {
    fn new(query: &[u8], database: &[u8]) -> Self {
        let floats = |bytes: &[u8]| bytes.iter().map(|&b| f32::from(b)).collect::<Vec<_>>();
        let norms = |bytes: &[u8]| {
            let squares = |row: &[u8]| row.iter().map(|&b| f32::from(b).powi(2)).sum();
            bytes.chunks_exact(DIM).map(squares).collect::<Vec<f32>>()
        };
        Self {
            query: floats(query),
            database: floats(database),
            query_norms: norms(query),
            database_norms: norms(database),
        }
    }

    /// Index and squared distance of the nearest, squared distance of the second.
    fn search(&self) -> Vec<(u32, f32, f32)> {
        const BLOCK: usize = 512;
        let mut best = vec![(0, f32::INFINITY, f32::INFINITY); self.query_norms.len()];
        let mut dots = vec![0.0; self.query_norms.len() * BLOCK];
        let blocks = self.database.chunks(BLOCK * DIM).zip(self.database_norms.chunks(BLOCK)).enumerate();
        for (block, (rows, norms)) in blocks {
            products(&self.query, rows, &mut dots[..self.query_norms.len() * norms.len()]);
            let queries = dots.chunks_exact(norms.len()).zip(&self.query_norms).zip(&mut best);
            for ((dots, query_norm), best) in queries {
                for (index, (dot, norm)) in dots.iter().zip(norms).enumerate() {
                    let distance = query_norm + norm - 2.0 * dot;
                    if distance < best.1 {
                        *best = ((block * BLOCK + index) as u32, distance, best.1);
                    } else {
                        best.2 = best.2.min(distance);
                    }
                }
            }
        }
        best
    }
}

/// `dots[N, M] = query[N, DIM] * rows[M, DIM]^T`
fn products(query: &[f32], rows: &[f32], dots: &mut [f32]) {
    let (n, m) = (query.len() / DIM, rows.len() / DIM);
    assert_eq!(dots.len(), n * m);
    let dim = DIM as isize;
    // SAFETY: all three shapes were checked against their slices.
    unsafe {
        gemm::gemm(
            n,
            m,
            DIM,
            dots.as_mut_ptr(),
            1,
            m as isize,
            false,
            query.as_ptr(),
            1,
            dim,
            rows.as_ptr(),
            dim,
            1,
            0.0,
            1.0,
            false,
            false,
            false,
            gemm::Parallelism::None,
        );
    }
}

fn random_descriptors(count: usize, seed: u64) -> Descriptors {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut bytes = Vec::with_capacity(count * DIM);
    for _ in 0..count {
        let histogram: [f32; DIM] = std::array::from_fn(|_| rng.random_range(0.0_f32..1.0).powi(3));
        let total: f32 = histogram.iter().sum();
        bytes.extend(histogram.map(|h| ((h / total).sqrt() * 512.0).round().min(255.0) as u8));
    }
    Descriptors::new(DescriptorKind::ROOT_SIFT, bytes).expect("whole rows")
}
