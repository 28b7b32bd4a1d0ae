//! The kind of a descriptor: its name, its numbers, and all properties that depend on the kind, in this one file.
//!
//! A kind is a value and not a case of an enum: an extractor described by a file at run time has one too. Measured
//! properties of a kind (its prior, distances between rows of one point) are in [`MEASURED`]; a kind that is not there
//! has cautious defaults.

use crate::{DescriptorError, Encoding, MatchPrior, Name, PriorModel};

/// The extractor of a descriptor, which defines what its bytes mean.
///
/// Descriptors of one kind are vectors of the same number of components and about the same Euclidean length
/// ([`Self::norm`]), compared by Euclidean distance. Kinds are equal when all their parts are: an equal name is not
/// enough.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct DescriptorKind {
    name: Name,
    dim: u16,
    encoding: Encoding,
    norm: u16,
}

/// Measured properties of a kind.
struct Measured {
    kind: DescriptorKind,
    prior: MatchPrior,
    same_point: f64,
}

impl DescriptorKind {
    /// SIFT histograms, L1-normalized, square-rooted (RootSIFT), times 512, rounded, cut at 255. 128 unsigned bytes.
    pub const ROOT_SIFT: Self =
        Self { name: literal("sift"), dim: 128, encoding: Encoding::Unsigned, norm: 512 };

    /// RootSIFT projected to 64 discriminative numbers, 4 bits each in messages (`veiloc_features::Compact`).
    pub const COMPACT: Self =
        Self { name: literal("compact"), dim: 64, encoding: Encoding::Coarse, norm: 374 };

    /// XFeat's 64 numbers, a unit vector times 256 (`veiloc_features::learned`, `models/xfeat.toml`).
    pub const XFEAT: Self = Self { name: literal("xfeat"), dim: 64, encoding: Encoding::Signed, norm: 256 };

    /// The 64 numbers of the smallest ALIKE, a unit vector times 256 (`veiloc_features::learned`,
    /// `models/alike-t.toml`).
    pub const ALIKE_T: Self =
        Self { name: literal("alike-t"), dim: 64, encoding: Encoding::Signed, norm: 256 };

    /// XFeat's numbers projected to 48, 4 bits each in messages (`veiloc_features::learned`,
    /// `models/xfeat-compact.toml`).
    pub const XFEAT_COMPACT: Self =
        Self { name: literal("xfeat-compact"), dim: 48, encoding: Encoding::Coarse, norm: 273 };

    /// The same for the smallest ALIKE (`models/alike-t-compact.toml`).
    pub const ALIKE_T_COMPACT: Self =
        Self { name: literal("alike-t-compact"), dim: 48, encoding: Encoding::Coarse, norm: 273 };

    /// Largest number of components.
    pub const MAX_DIM: usize = 512;
    /// Bytes of a kind in files and messages.
    pub const BYTES: usize = Name::BYTES + 8;

    /// A user-defined kind.
    ///
    /// - `name`: see [`Name::new`]. A name in [`Self::built_in`] means that kind.
    /// - `dim`: components of a vector, 1 to [`Self::MAX_DIM`].
    /// - `norm`: Euclidean length of a vector in code units. An extractor of unit vectors chooses it such that hardly
    ///   any component is clipped; it must normalize vectors without a fixed length.
    ///
    /// # Errors
    /// [`DescriptorError::Name`], [`DescriptorError::Kind`] with the number that is out of range, and
    /// [`DescriptorError::NameTaken`].
    pub fn new(name: &str, dim: usize, encoding: Encoding, norm: u32) -> Result<Self, DescriptorError> {
        Self::from_parts(Name::new(name)?, dim as u64, encoding, norm.into())
    }

    fn from_parts(name: Name, dim: u64, encoding: Encoding, norm: u64) -> Result<Self, DescriptorError> {
        if !(1..=Self::MAX_DIM as u64).contains(&dim) {
            return Err(DescriptorError::Kind { field: "dim", value: dim, allowed: "1 to 512" });
        }
        if !(dim * u64::from(encoding.bits())).is_multiple_of(8) {
            return Err(DescriptorError::Kind {
                field: "dim",
                value: dim,
                allowed: "even, for numbers of 4 bits",
            });
        }
        let largest = u64::from(encoding.max_magnitude());
        if norm == 0 || norm * norm > dim * largest * largest {
            let allowed = "1 to the length of the largest vector of such bytes";
            return Err(DescriptorError::Kind { field: "norm", value: norm, allowed });
        }
        let kind = Self { name, dim: dim as u16, encoding, norm: norm as u16 };
        match Self::built_in().find(|known| known.name == name) {
            Some(known) if known != kind => {
                Err(DescriptorError::NameTaken { name: name.as_str().to_owned() })
            }
            _ => Ok(kind),
        }
    }

    /// The built-in kinds.
    pub fn built_in() -> impl Iterator<Item = Self> {
        MEASURED.iter().map(|m| m.kind)
    }

    /// The name on the command line, in files and in reports.
    pub fn name(&self) -> &str {
        self.name.as_str()
    }

    /// Components of a vector, equal to the bytes of one descriptor except in messages.
    pub const fn dim(self) -> usize {
        self.dim as usize
    }

    /// Bytes of one descriptor in messages: [`Self::dim`], or half of it for [`Encoding::Coarse`].
    pub const fn packed_len(self) -> usize {
        self.dim() * self.encoding.bits() as usize / 8
    }

    /// Representation of its numbers.
    pub const fn encoding(self) -> Encoding {
        self.encoding
    }

    /// Euclidean length of a vector, code units. Rows of another length are not rejected.
    pub const fn norm(self) -> u32 {
        self.norm as u32
    }

    /// For files and messages: name padded with zeros `[32]`, then little endian `u16` dim, `u8` encoding (0 unsigned,
    /// 1 signed, 2 coarse), `u8` 0, `u16` norm, `u16` 0.
    pub fn to_bytes(self) -> [u8; Self::BYTES] {
        let mut bytes = [0; Self::BYTES];
        bytes[..32].copy_from_slice(&self.name.to_bytes());
        bytes[32..34].copy_from_slice(&self.dim.to_le_bytes());
        bytes[34] = self.encoding.code();
        bytes[36..38].copy_from_slice(&self.norm.to_le_bytes());
        bytes
    }

    /// Reads the output of [`Self::to_bytes`]; nothing else is accepted.
    ///
    /// # Errors
    /// As [`Self::new`]; [`DescriptorError::Kind`] also for bytes that must be zero.
    pub fn from_bytes(bytes: &[u8; Self::BYTES]) -> Result<Self, DescriptorError> {
        let (name, rest) =
            bytes.split_first_chunk::<{ Name::BYTES }>().expect("a kind is longer than a name");
        let two = |at: usize| u16::from_le_bytes([rest[at], rest[at + 1]]);
        let refused =
            |field, value: u16, allowed| DescriptorError::Kind { field, value: value.into(), allowed };
        let encoding = Encoding::from_code(rest[2])
            .ok_or_else(|| refused("encoding", rest[2].into(), "0 (unsigned), 1 (signed) or 2 (coarse)"))?;
        if rest[3] != 0 || two(6) != 0 {
            return Err(refused("reserved", u16::from(rest[3]) | two(6), "0"));
        }
        Self::from_parts(Name::from_bytes(name)?, two(0).into(), encoding, two(4).into())
    }

    fn measured(self) -> Option<&'static Measured> {
        MEASURED.iter().find(|m| m.kind == self)
    }

    /// Prior of its matches, before geometry. For a kind without measurements: RootSIFT's slopes halved about the same
    /// middle, so that the ratio orders matches but decides little.
    pub fn match_prior(self) -> MatchPrior {
        self.measured().map_or(UNMEASURED_PRIOR, |m| m.prior)
    }

    /// The same for the name of a kind, as in files of matches.
    pub fn match_prior_of(name: &str) -> MatchPrior {
        MEASURED.iter().find(|m| m.kind.name() == name).map_or(UNMEASURED_PRIOR, |m| m.prior)
    }

    /// Maximum squared distance, squared code units, for a keypoint where a map point projects to be taken for that
    /// point without a ratio test.
    pub fn same_point_distance(self) -> u32 {
        let part = self.measured().map_or(SAME_POINT, |m| m.same_point);
        (f64::from(self.norm) * part).powi(2) as u32
    }

    /// Whether decoys can be blended from its rows: with fewer than 16 numbers blended rows are recognizable, and
    /// queries of few keypoints of such a kind are never sent.
    pub const fn can_be_blended(self) -> bool {
        self.dim() >= BLEND_MIN_DIM
    }
}

impl std::fmt::Display for DescriptorKind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(self.name())
    }
}

impl std::fmt::Debug for DescriptorKind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} ({} {:?}, length {})", self.name, self.dim, self.encoding, self.norm)
    }
}

const fn literal(text: &str) -> Name {
    match Name::checked(text) {
        Some(name) => name,
        None => panic!("a name written in this file"),
    }
}

/// Share of the norm: 200 of RootSIFT's 512. Half of all verified matches are nearer than about 150, keypoints of other
/// places rarely nearer than 300.
const SAME_POINT: f64 = 0.390_625;

/// See [`DescriptorKind::can_be_blended`].
const BLEND_MIN_DIM: usize = 16;

const fn model(offset: f64, ratio: f64, log_votes: f64, log_track_length: f64) -> PriorModel {
    PriorModel { offset, ratio, log_votes, log_track_length }
}

/// RootSIFT's slopes halved.
const UNMEASURED_PRIOR: MatchPrior = MatchPrior {
    ratio: model(4.26, -6.25, 0.0, 0.0),
    ratio_votes: model(3.66, -5.69, 0.28, 0.0),
    full: model(3.66, -5.69, 0.28, 0.0),
};

/// Learned kinds, fitted on held-out map images of three places together (`study features match-prior`). The length of tracks
/// is left out: its effect differs between places. Distances between descriptors of one point were not measured.
const fn learned(kind: DescriptorKind, ratio: PriorModel, ratio_votes: PriorModel) -> Measured {
    let prior = MatchPrior { ratio, ratio_votes, full: ratio_votes };
    Measured { kind, prior, same_point: SAME_POINT }
}

/// Projections of them, fitted in the same way. `same_point`: nearer than 99 % of the nearest keypoints of another
/// image, as `study features projection` prints.
const fn projected(
    kind: DescriptorKind,
    same_point: f64,
    ratio: PriorModel,
    ratio_votes: PriorModel,
) -> Measured {
    Measured { same_point, ..learned(kind, ratio, ratio_votes) }
}

/// The built-in kinds. `same_point` is a share of the norm.
static MEASURED: &[Measured] = &[
    Measured {
        kind: DescriptorKind::ROOT_SIFT,
        // Fitted by `study features match-prior`; see crate::prior for the data.
        prior: MatchPrior {
            ratio: model(8.521, -12.493, 0.0, 0.0),
            ratio_votes: model(7.310, -11.384, 0.557, 0.0),
            full: model(7.490, -11.347, 0.581, -0.143),
        },
        same_point: SAME_POINT,
    },
    Measured {
        kind: DescriptorKind::COMPACT,
        // Fitted like RootSIFT's, on its own problems (`study features training-problems --features compact`).
        prior: MatchPrior {
            ratio: model(9.629, -13.448, 0.0, 0.0),
            ratio_votes: model(8.103, -12.039, 0.653, 0.0),
            full: model(8.685, -11.891, 0.748, -0.507),
        },
        // Half of all pairs are nearer than 155, keypoints of other places rarely nearer than 310.
        same_point: 0.748,
    },
    learned(DescriptorKind::XFEAT, model(6.145, -8.166, 0.0, 0.0), model(2.182, -4.496, 1.348, 0.0)),
    learned(DescriptorKind::ALIKE_T, model(11.288, -13.494, 0.0, 0.0), model(7.158, -9.479, 1.338, 0.0)),
    projected(
        DescriptorKind::XFEAT_COMPACT,
        0.80,
        model(6.802, -8.950, 0.0, 0.0),
        model(2.553, -4.896, 1.329, 0.0),
    ),
    projected(
        DescriptorKind::ALIKE_T_COMPACT,
        0.79,
        model(11.755, -13.935, 0.0, 0.0),
        model(7.018, -9.279, 1.455, 0.0),
    ),
];

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn root_sift_is_called_sift() {
        let kind = DescriptorKind::ROOT_SIFT;
        assert_eq!((kind.name(), kind.dim(), kind.norm()), ("sift", 128, 512));
        assert_eq!(kind.same_point_distance(), 200 * 200);
        assert!(kind.can_be_blended());
        let mut bytes = [0; 40];
        bytes[..4].copy_from_slice(b"sift");
        (bytes[32], bytes[37]) = (128, 2);
        assert_eq!(kind.to_bytes(), bytes, "files contain this");
    }

    #[test]
    fn user_defined_kind_has_default_figures() {
        let kind = DescriptorKind::new("superpoint", 256, Encoding::Signed, 512).expect("a kind");
        assert!(kind.can_be_blended());
        assert_ne!(kind.match_prior(), DescriptorKind::ROOT_SIFT.match_prior());
        let middle = |prior: MatchPrior| -prior.full.offset / prior.full.ratio;
        let (own, sift) = (middle(kind.match_prior()), middle(DescriptorKind::ROOT_SIFT.match_prior()));
        assert!((own - sift).abs() < 0.03, "{own} {sift}");
        assert_eq!(DescriptorKind::match_prior_of("superpoint"), kind.match_prior());
        assert_eq!(DescriptorKind::match_prior_of("compact"), DescriptorKind::COMPACT.match_prior());
        let projected = DescriptorKind::ALIKE_T_COMPACT;
        assert_eq!(DescriptorKind::match_prior_of("alike-t-compact"), projected.match_prior());
        assert_ne!(projected.match_prior(), DescriptorKind::ALIKE_T.match_prior());
        assert_eq!((projected.packed_len(), projected.same_point_distance()), (24, 46513));
        let tiny = DescriptorKind::new("colour", 3, Encoding::Unsigned, 200).expect("a kind");
        assert!(!tiny.can_be_blended());
    }

    #[test]
    fn error_names_the_fault_of_an_invalid_kind() {
        let field = |dim, encoding, norm| match DescriptorKind::new("own", dim, encoding, norm) {
            Err(DescriptorError::Kind { field, .. }) => Some(field),
            Err(other) => panic!("{other}"),
            Ok(_) => None,
        };
        assert_eq!(field(0, Encoding::Unsigned, 1), Some("dim"));
        assert_eq!(field(513, Encoding::Unsigned, 1), Some("dim"));
        assert_eq!(field(512, Encoding::Unsigned, 0), Some("norm"));
        assert_eq!(field(512, Encoding::Unsigned, u32::MAX), Some("norm"));
        assert_eq!(field(4, Encoding::Signed, 257), Some("norm"));
        assert_eq!(field(4, Encoding::Signed, 256), None);
        let taken = DescriptorKind::new("sift", 64, Encoding::Unsigned, 512);
        assert!(matches!(taken, Err(DescriptorError::NameTaken { .. })), "{taken:?}");
        assert_eq!(DescriptorKind::new("sift", 128, Encoding::Unsigned, 512), Ok(DescriptorKind::ROOT_SIFT));
    }

    proptest! {
        #[test]
        fn bytes_are_canonical(at in 0_usize..40, value: u8, dim in 1_usize..=512, signed: bool) {
            let encoding = if signed { Encoding::Signed } else { Encoding::Unsigned };
            let kind = DescriptorKind::new("own-kind", dim, encoding, 100).expect("a kind");
            prop_assert_eq!(DescriptorKind::from_bytes(&kind.to_bytes()), Ok(kind));
            let mut bytes = kind.to_bytes();
            bytes[at] = value;
            if let Ok(read) = DescriptorKind::from_bytes(&bytes) {
                prop_assert_eq!(read.to_bytes(), bytes);
            }
        }
    }
}
