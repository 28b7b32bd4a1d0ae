//! Loops in plain Rust that are compiled once per instruction set.

use crate::backend::{Backend, Kind};

/// A computation whose loops the compiler vectorizes.
///
/// `run` must be `#[inline(always)]`, and so must everything that it calls in its loops: only then is it compiled for
/// the instruction set of the calling function.
pub(crate) trait Kernel {
    /// The result.
    type Output;

    /// Runs the computation.
    fn run(self) -> Self::Output;
}

/// Runs the copy of `kernel` compiled for `backend`.
#[inline]
pub(crate) fn run<K: Kernel>(backend: Backend, kernel: K) -> K::Output {
    match backend.kind() {
        Kind::Portable => kernel.run(),
        // SAFETY: the backend's value proves that the CPU has these features (see `Backend`).
        #[cfg(target_arch = "x86_64")]
        Kind::Avx2 => unsafe { avx2(kernel) },
        // SAFETY: as above.
        #[cfg(target_arch = "x86_64")]
        Kind::Avx512Vnni => unsafe { avx512(kernel) },
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn avx2<K: Kernel>(kernel: K) -> K::Output {
    kernel.run()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,avx512f,avx512bw,avx512vl")]
fn avx512<K: Kernel>(kernel: K) -> K::Output {
    kernel.run()
}
