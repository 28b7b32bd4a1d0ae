//! Loops that are plain Rust and compiled once per instruction set.

use crate::backend::{Backend, Kind};

/// Work whose loops the compiler turns into vector instructions.
///
/// `run` must be `#[inline(always)]`, and so must all that it calls in its loops: only then do they get the instructions
/// of the function that they end up in.
pub(crate) trait Kernel {
    /// What comes of it.
    type Output;

    /// Does the work.
    fn run(self) -> Self::Output;
}

/// Runs the copy of `kernel` that is compiled for `backend`.
#[inline]
pub(crate) fn run<K: Kernel>(backend: Backend, kernel: K) -> K::Output {
    match backend.kind() {
        Kind::Portable => kernel.run(),
        // SAFETY: the backend's value is the evidence that the CPU has these features (see `Backend`).
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
