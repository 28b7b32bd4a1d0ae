//! Which images of a map look like a query: everything compared, the index of signs, and a graph of a kept library.
//!
//! `cargo bench -p veiloc-benches --bench search`; `IMAGES=10000,100000,1000000` for other sizes than ten thousand (each
//! image takes 4 kB). The rivals are comparing every global descriptor, and HNSW (crate `instant-distance`) over the same
//! signs; the candidates of index and graph are compared code by code. What each finds of the true ten, the time to make
//! it ready on all processors and of a search on one, and its memory beside the descriptors are printed.
//!
//! Global descriptors are drawn: places of ten images each, whose descriptors agree by a third to a half, as those of
//! rooms and facades do. `veiloc eval search` measures the index on real ones.
#![expect(clippy::print_stdout, reason = "a benchmark talks")]

use std::{hint::black_box, time::Instant};

use instant_distance::{Builder, HnswMap, Point, Search};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use veiloc_descriptor::{GlobalDescriptor, GlobalIndex};

const CODES: usize = 4096;
const QUERIES: usize = 100;
const WANTED: usize = 10;
const OF_A_PLACE: usize = 10;

fn main() {
    let sizes = std::env::var("IMAGES").unwrap_or_else(|_| "10000".to_owned());
    println!("the best {WANTED} of N images, {QUERIES} queries, one thread:");
    println!(
        "{:>9} {:<18} {:>9} {:>9} {:>10} {:>7}",
        "images", "search", "ready s", "MB more", "median ms", "kept"
    );
    for images in sizes.split(',').map(|n| n.trim().parse::<usize>().expect("IMAGES holds numbers")) {
        compare(images);
    }
}

fn compare(images: usize) {
    let all: Vec<i8> =
        (0..images).into_par_iter().flat_map_iter(|i| image_of(i / OF_A_PLACE, i as u64)).collect();
    let queries: Vec<GlobalDescriptor> = (0..QUERIES)
        .map(|q| GlobalDescriptor::new(image_of(q * 31 % images.div_ceil(OF_A_PLACE), (q + images) as u64)))
        .collect();
    let codes_of = |i: usize| &all[i * CODES..][..CODES];
    let best = |query: &GlobalDescriptor, among: &mut dyn Iterator<Item = usize>| {
        let found = query.most_similar(among.map(|i| (i, codes_of(i))), WANTED);
        found.into_iter().map(|(i, _)| i).collect::<Vec<_>>()
    };
    let timed = |search: &mut dyn FnMut(&GlobalDescriptor) -> Vec<usize>| {
        let mut ms = Vec::new();
        let mut one = |query: &GlobalDescriptor| {
            let start = Instant::now();
            let found = black_box(search(query));
            ms.push(start.elapsed().as_secs_f64() * 1e3);
            found
        };
        let found: Vec<Vec<usize>> = queries.iter().map(&mut one).collect();
        ms.sort_by(f64::total_cmp);
        (found, ms[ms.len() / 2])
    };
    let (truth, every_ms) = timed(&mut |query| best(query, &mut (0..images)));
    let told = |search: &str, seconds: f64, bytes: usize, ms: f64, found: &[Vec<usize>]| {
        let kept = found.iter().zip(&truth).flat_map(|(f, t)| f.iter().map(|i| t.contains(i)));
        let share = kept.filter(|k| *k).count() as f64 / (QUERIES * WANTED.min(images)) as f64;
        println!(
            "{images:>9} {search:<18} {seconds:>9.2} {:>9.1} {ms:>10.3} {:>6.1} %",
            bytes as f64 / 1e6,
            100.0 * share
        );
    };
    told("all", 0.0, 0, every_ms, &truth);

    let start = Instant::now();
    let index = GlobalIndex::new(&all, CODES);
    let seconds = start.elapsed().as_secs_f64();
    let among = GlobalIndex::candidates_for(WANTED);
    let (found, ms) = timed(&mut |query| best(query, &mut index.candidates(query, among).into_iter()));
    told("index of signs", seconds, index.byte_count(), ms, &found);

    let start = Instant::now();
    let signs = |codes: &[i8]| Signs::of(&GlobalDescriptor::new(codes.to_vec()));
    let points: Vec<Signs> = all.par_chunks_exact(CODES).map(signs).collect();
    let graph: HnswMap<Signs, usize> =
        Builder::default().ef_construction(100).ef_search(among).seed(1).build(points, (0..images).collect());
    let seconds = start.elapsed().as_secs_f64();
    let mut search = Search::default();
    let (found, ms) = timed(&mut |query| {
        let point = Signs::of(query);
        let near: Vec<usize> =
            graph.search(&point, &mut search).take(among).map(|item| *item.value).collect();
        best(query, &mut near.into_iter())
    });
    // Its signs, and 64 neighbours of 4 bytes on the lowest layer.
    told("graph (HNSW)", seconds, images * (CODES / 8 + 4 * 64), ms, &found);
}

/// An image of a place: a third to a half of it is the place's.
fn image_of(place: usize, image: u64) -> Vec<i8> {
    let mut of_place = ChaCha8Rng::seed_from_u64(place as u64);
    let mut own = ChaCha8Rng::seed_from_u64(image ^ 0x5eed_0000_0000);
    let share = own.random_range(0.6..0.7_f32);
    let rest = (1.0 - share * share).sqrt();
    let number = |rng: &mut ChaCha8Rng| f32::from(rng.random::<i8>());
    (0..CODES)
        .map(|_| (0.9 * (share * number(&mut of_place) + rest * number(&mut own))).clamp(-127.0, 127.0) as i8)
        .collect()
}

/// Signs as the graph compares them.
#[derive(Clone)]
struct Signs([u64; CODES / 64]);

impl Signs {
    fn of(global: &GlobalDescriptor) -> Self {
        let bytes = global.to_signs();
        let mut words = [0; CODES / 64];
        for (word, bytes) in words.iter_mut().zip(bytes.as_chunks::<8>().0) {
            *word = u64::from_le_bytes(*bytes);
        }
        Self(words)
    }
}

impl Point for Signs {
    fn distance(&self, other: &Self) -> f32 {
        let mut differing = [0];
        veiloc_simd::hamming(&self.0, &other.0, &mut differing);
        differing[0] as f32
    }
}
