//! Image retrieval: exhaustive search, and the index of binary codes.
//!
//! `cargo bench -p veiloc-benches --bench search`; `IMAGES=10000,100000,1000000` for other sizes than ten thousand
//! (each image takes 4 kB). The reference is exhaustive search over all global descriptors. The candidates of the index
//! are re-ranked exactly. Prints recall@10, the build time on all processors, the time of a search on one thread, and
//! the memory in addition to the descriptors.
//!
//! Global descriptors are random, in scenes of ten images whose descriptors agree by a third to a half, as those of
//! rooms and facades do. `study scale usearch` compares the index with usearch (HNSW) on them.
#![expect(clippy::print_stdout, reason = "a benchmark prints its results")]

use std::{hint::black_box, time::Instant};

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use veiloc_descriptor::{GlobalDescriptor, GlobalIndex};

const CODES: usize = 4096;
const QUERIES: usize = 100;
const WANTED: usize = 10;
const IMAGES_PER_SCENE: usize = 10;

fn main() {
    let sizes = std::env::var("IMAGES").unwrap_or_else(|_| "10000".to_owned());
    println!("the {WANTED} nearest of N images, {QUERIES} queries, one thread:");
    println!(
        "{:>9} {:<18} {:>9} {:>9} {:>10} {:>10}",
        "images", "search", "build s", "MB more", "median ms", "recall@10"
    );
    for images in sizes.split(',').map(|n| n.trim().parse::<usize>().expect("IMAGES holds numbers")) {
        compare(images);
    }
}

fn compare(images: usize) {
    let all: Vec<i8> =
        (0..images).into_par_iter().flat_map_iter(|i| image_of(i / IMAGES_PER_SCENE, i as u64)).collect();
    let queries: Vec<GlobalDescriptor> = (0..QUERIES)
        .map(|q| {
            GlobalDescriptor::new(image_of(q * 31 % images.div_ceil(IMAGES_PER_SCENE), (q + images) as u64))
        })
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
    let print_row = |search: &str, seconds: f64, bytes: usize, ms: f64, found: &[Vec<usize>]| {
        let right = found.iter().zip(&truth).flat_map(|(f, t)| f.iter().map(|i| t.contains(i)));
        let recall =
            right.filter(|is_right| *is_right).count() as f64 / (QUERIES * WANTED.min(images)) as f64;
        println!(
            "{images:>9} {search:<18} {seconds:>9.2} {:>9.1} {ms:>10.3} {:>8.1} %",
            bytes as f64 / 1e6,
            100.0 * recall
        );
    };
    print_row("exhaustive", 0.0, 0, every_ms, &truth);

    let start = Instant::now();
    let index = GlobalIndex::new(&all, CODES);
    let seconds = start.elapsed().as_secs_f64();
    let among = GlobalIndex::candidates_for(WANTED);
    let (found, ms) = timed(&mut |query| best(query, &mut index.candidates(query, among).into_iter()));
    print_row("binary-code index", seconds, index.byte_count(), ms, &found);
}

/// An image of a scene: a third to a half of its descriptor is common to the scene.
fn image_of(scene: usize, image: u64) -> Vec<i8> {
    let mut of_scene = ChaCha8Rng::seed_from_u64(scene as u64);
    let mut own = ChaCha8Rng::seed_from_u64(image ^ 0x5eed_0000_0000);
    let share = own.random_range(0.6..0.7_f32);
    let rest = (1.0 - share * share).sqrt();
    let number = |rng: &mut ChaCha8Rng| f32::from(rng.random::<i8>());
    (0..CODES)
        .map(|_| (0.9 * (share * number(&mut of_scene) + rest * number(&mut own))).clamp(-127.0, 127.0) as i8)
        .collect()
}
