//! The instruction set of a kernel: detected once, passed as a value.

/// An instruction set that was detected on this machine.
///
/// The value is the proof of support: it is only returned by [`Backend::best`] and [`Backend::available`], or is
/// [`Backend::PORTABLE`], so code with a value may run its instructions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Backend {
    kind: Kind,
    /// Whether there are dot products of bytes (FEAT_DotProd); all other loops are the portable ones.
    #[cfg(target_arch = "aarch64")]
    dotprod: bool,
}

/// The supported instruction sets, slowest first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    Portable,
    #[cfg(target_arch = "x86_64")]
    Avx2,
    #[cfg(target_arch = "x86_64")]
    Avx512Vnni,
}

impl Backend {
    /// Plain Rust, on every machine; the reference for tests of the others.
    pub const PORTABLE: Self = Self::of(Kind::Portable);

    const fn of(kind: Kind) -> Self {
        Self {
            kind,
            #[cfg(target_arch = "aarch64")]
            dotprod: false,
        }
    }

    /// The fastest available one. The CPU detection is cached, so a call costs a load and a branch.
    ///
    /// A build with `VEILOC_BACKEND=portable` or `avx2` in its environment takes nothing faster than that, for comparisons
    /// (`scripts/phones/measure.py`).
    pub fn best() -> Self {
        let built_for = option_env!("VEILOC_BACKEND");
        if matches!(built_for, Some("portable")) {
            return Self::PORTABLE;
        }
        #[cfg(target_arch = "x86_64")]
        {
            if has_avx512_vnni() && !matches!(built_for, Some("avx2")) {
                return Self::of(Kind::Avx512Vnni);
            }
            if has_avx2() {
                return Self::of(Kind::Avx2);
            }
        }
        #[cfg(target_arch = "aarch64")]
        if std::arch::is_aarch64_feature_detected!("dotprod") {
            return Self { dotprod: true, ..Self::PORTABLE };
        }
        Self::PORTABLE
    }

    /// All available ones, slowest first; the first is always [`Backend::PORTABLE`].
    pub fn available() -> Vec<Self> {
        #[cfg_attr(
            not(any(target_arch = "x86_64", target_arch = "aarch64")),
            expect(unused_mut, reason = "only these have more than one")
        )]
        let mut all = vec![Self::PORTABLE];
        #[cfg(target_arch = "x86_64")]
        {
            if has_avx2() {
                all.push(Self::of(Kind::Avx2));
            }
            if has_avx512_vnni() {
                all.push(Self::of(Kind::Avx512Vnni));
            }
        }
        #[cfg(target_arch = "aarch64")]
        if Self::best() != Self::PORTABLE {
            all.push(Self::best());
        }
        all
    }

    /// Its name in logs and benchmarks.
    pub const fn name(self) -> &'static str {
        #[cfg(target_arch = "aarch64")]
        if self.dotprod {
            return "dotprod";
        }
        match self.kind {
            Kind::Portable => "portable",
            #[cfg(target_arch = "x86_64")]
            Kind::Avx2 => "avx2",
            #[cfg(target_arch = "x86_64")]
            Kind::Avx512Vnni => "avx512-vnni",
        }
    }

    /// The value that kernels dispatch on.
    pub(crate) const fn kind(self) -> Kind {
        self.kind
    }

    /// Whether dot products of bytes have an instruction.
    #[cfg(target_arch = "aarch64")]
    pub(crate) const fn has_dotprod(self) -> bool {
        self.dotprod
    }
}

#[cfg(target_arch = "x86_64")]
fn has_avx2() -> bool {
    is_x86_feature_detected!("avx2") && is_x86_feature_detected!("popcnt")
}

#[cfg(target_arch = "x86_64")]
fn has_avx512_vnni() -> bool {
    has_avx2()
        && is_x86_feature_detected!("avx512f")
        && is_x86_feature_detected!("avx512bw")
        && is_x86_feature_detected!("avx512vl")
        && is_x86_feature_detected!("avx512vnni")
}
