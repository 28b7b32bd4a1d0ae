//! How alike two images of one size are.
//!
//! | measure | what it compares | range |
//! |---|---|---|
//! | [`psnr`] | pixels | decibels, infinite for equal images |
//! | [`ssim`] | mean, spread and correlation in small windows | to 1 for equal images |
//! | [`Lpips`] | layers of a network trained on a million images, weighted by what people call alike | from 0 for equal images |
//! | [`FeatureDistance`] | layers of SuperPoint's encoder, all alike | from 0 for equal images to 1 |
//!
//! PSNR and SSIM are those of scikit-image to the last digits that are printed, LPIPS that of its authors
//! (`scripts/oracle_judge.py`). LPIPS needs two files that nobody may pass on with a program: the user brings them.
#![forbid(unsafe_code)]

mod feature_distance;
mod layers;
mod lpips;
mod psnr;
mod size;
mod ssim;

pub use feature_distance::FeatureDistance;
pub use lpips::{Lpips, LpipsNetwork};
pub use psnr::psnr;
pub use ssim::ssim;
