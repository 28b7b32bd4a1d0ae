//! Internal: vectorized kernels and memory-mapped files behind safe functions, with the only unsafe code of the libraries.
//!
//! - [`PackedRows`], [`best_two`], [`best_two_with_columns`]: exact brute-force nearest neighbours of byte vectors.
//! - [`dot_u8`], [`dot_i8`]: one dot product.
//! - [`hamming`]: number of differing bits; [`hamming_of_three_bits`]: distances of numbers of three bits from signs.
//! - [`hadamard`]: the Hadamard transform.
//! - [`pose`]: scores and normal equations of camera poses.
//! - [`sift`]: the loops of feature extraction.
//! - `MappedFile`: a file as one slice; not on WebAssembly, which has no files to map.
//!
//! Every kernel has a portable version without intrinsics ([`Backend::PORTABLE`]), which is also used on machines other
//! than x86-64. On aarch64 it is vector code, because NEON belongs to every such machine and the compiler vectorizes the
//! loops as it does for AVX2; one loop that it does not vectorize well (interleaved rows of the doubled image) has NEON
//! intrinsics, and dot products of bytes have an instruction of their own where the processor has it. Blur, doubling and differences execute 1.1 to 1.3 times the instructions of their arithmetic, loads and
//! stores; all loops of SIFT 3 to 6 times fewer than a build without vectors (`examples/sift_kernels.rs`, counted by
//! `scripts/phones/instructions.c`). All results are equal on every backend and machine, bit for bit; tests compare each
//! one with naive loops, and hashes of the results with those of other machines.
//!
//! Callers select a [`Backend`] once ([`Backend::best`]) and pass plain slices; shapes are documented for each
//! function.
//!
//! # Example
//! ```
//! use veiloc_simd::{Backend, PackedRows, best_two};
//!
//! // Three rows of two bytes each; the nearest one to the query is the second.
//! let rows = PackedRows::new(Backend::best(), &[0, 0, 10, 0, 0, 20], 2);
//! let nearest = best_two(&[9, 1], &rows)[0].expect("there are rows");
//! assert_eq!((nearest.index, nearest.distance), (1, 1 + 1));
//! ```
#![deny(unsafe_op_in_unsafe_fn)]
#![expect(
    unsafe_code,
    reason = "vector loads, calls into code for detected CPU features, and memory maps live here alone"
)]

mod approx;
mod backend;
mod dispatch;
mod dot;
mod hadamard;
mod hamming;
#[cfg(not(target_family = "wasm"))]
mod mapped;
mod packed;
pub mod pose;
mod scan;
pub mod sift;
mod tile;

pub use backend::Backend;
pub use dot::{dot_i8, dot_u8};
pub use hadamard::hadamard;
pub use hamming::{hamming, hamming_of_three_bits};
#[cfg(not(target_family = "wasm"))]
pub use mapped::{MappedFile, open_regular_file};
pub use packed::{MAX_DIM, PackedRows};
pub use scan::{BestTwo, ColumnBest, best_two, best_two_with_columns};
