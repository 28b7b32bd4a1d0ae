//! Synthetic features, cameras and profiles for the tests of this crate.
#![allow(dead_code)] // each test binary uses its own part

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc_descriptor::{DescriptorKind, Descriptors, Vocabulary};
use veiloc_features::{Features, Keypoint};
use veiloc_geometry::nalgebra::Vector2;
use veiloc_geometry::{Anchor, Intrinsics, Pixel};
use veiloc_obfuscation::{Extracted, Orientation, SealError, SealOptions, SealTruth, Sealer, Session};
use veiloc_protocol::{AnchoredLine, Observations, Profile, Scheme, SealedQuery};

pub(crate) fn rng(seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed)
}

/// A camera that is its own canonical camera: positions pass through unchanged.
pub(crate) fn camera() -> Intrinsics {
    "SIMPLE_PINHOLE,640,480,512,320,240".parse().expect("valid")
}

pub(crate) fn profile() -> Profile {
    Profile::vlad(Vocabulary::new(random_descriptors(8, &mut rng(99))).expect("eight words"))
}

/// Seal options of a device with this scheme.
pub(crate) fn options(scheme: &str) -> SealOptions {
    match scheme.parse::<Scheme>().expect("a scheme") {
        Scheme::Points => SealOptions::unprotected_points(),
        other => SealOptions::new(other).expect("it hides positions"),
    }
}

/// Seals features on their own.
pub(crate) fn seal(
    features: Features,
    camera: &Intrinsics,
    profile: &Profile,
    options: &SealOptions,
    rng: &mut ChaCha8Rng,
) -> Result<SealedQuery, SealError> {
    Sealer::new(profile, options.clone())?.seal(Extracted::new(features, *camera), rng)
}

/// As [`seal`], with the ground truth.
pub(crate) fn seal_with_truth(
    features: Features,
    camera: &Intrinsics,
    profile: &Profile,
    options: &SealOptions,
    rng: &mut ChaCha8Rng,
) -> Result<(SealedQuery, SealTruth), SealError> {
    Sealer::new(profile, options.clone())?.seal_with_truth(Extracted::new(features, *camera), rng)
}

/// Seals the next features of a session, with the ground truth.
pub(crate) fn seal_in(
    session: &mut Session,
    features: Features,
    camera: &Intrinsics,
    profile: &Profile,
    options: &SealOptions,
    held: &Orientation,
    rng: &mut ChaCha8Rng,
) -> Result<(SealedQuery, SealTruth), SealError> {
    let extracted = Extracted::new(features, *camera).with_orientation(*held);
    Sealer::new(profile, options.clone())?.in_session(session).seal_with_truth(extracted, rng)
}

/// RootSIFT-like: sparse, of length 512 in code units.
pub(crate) fn random_descriptors(count: usize, rng: &mut ChaCha8Rng) -> Descriptors {
    let mut bytes = Vec::with_capacity(count * 128);
    for _ in 0..count {
        let values: Vec<f64> = (0..128).map(|_| rng.random::<f64>().powi(3)).collect();
        let norm = values.iter().map(|v| v * v).sum::<f64>().sqrt();
        bytes.extend(values.iter().map(|v| (v / norm * 512.0).round().min(255.0) as u8));
    }
    Descriptors::new(DescriptorKind::ROOT_SIFT, bytes).expect("whole rows")
}

/// Features at these positions, in order of falling strength.
pub(crate) fn features_at(pixels: &[Pixel], seed: u64) -> Features {
    let mut rng = rng(seed);
    let keypoints = pixels
        .iter()
        .enumerate()
        .map(|(i, &pixel)| Keypoint {
            pixel,
            scale: rng.random_range(1.0..8.0),
            orientation: rng.random_range(-3.0..3.0),
            response: 1.0 / (1.0 + i as f32),
        })
        .collect();
    Features { keypoints, descriptors: random_descriptors(pixels.len(), &mut rng), global: None }
}

pub(crate) fn uniform_pixels(count: usize, seed: u64) -> Vec<Pixel> {
    let mut rng = rng(seed);
    (0..count).map(|_| Pixel::new(rng.random_range(2.0..638.0), rng.random_range(2.0..478.0))).collect()
}

/// Pearson's correlation.
pub(crate) fn correlation(pairs: &[(f64, f64)]) -> f64 {
    let n = pairs.len() as f64;
    let (mx, my) = pairs.iter().fold((0.0, 0.0), |(a, b), (x, y)| (a + x / n, b + y / n));
    let (sxy, sxx, syy) = pairs.iter().fold((0.0, 0.0, 0.0), |(a, b, c), (x, y)| {
        (a + (x - mx) * (y - my), b + (x - mx).powi(2), c + (y - my).powi(2))
    });
    sxy / (sxx * syy).sqrt()
}

/// The paper's layout in the image, computed independently of the library: vertical midline, the first anchor in the
/// middle of the top edge for the left half, the second in the middle of the bottom edge for the right half.
pub(crate) struct ImageAnchors {
    size: [f64; 2],
}

impl ImageAnchors {
    pub(crate) fn new(width: u32, height: u32) -> Self {
        Self { size: [width, height].map(f64::from) }
    }

    pub(crate) fn position(&self, anchor: Anchor) -> Pixel {
        let [width, height] = self.size;
        Pixel::new(width / 2.0, if anchor == Anchor::FIRST { 0.0 } else { height })
    }

    /// Distance from the dividing line, positive on the first anchor's side.
    pub(crate) fn signed_side(&self, pixel: Pixel) -> f64 {
        self.size[0] / 2.0 - pixel.u
    }

    pub(crate) fn anchor_of(&self, pixel: Pixel) -> Anchor {
        if self.signed_side(pixel) >= 0.0 { Anchor::FIRST } else { Anchor::SECOND }
    }

    /// The angle in `[0, π]` at the anchor, from the direction towards the centre, turning into the anchor's own side.
    pub(crate) fn angle_of(&self, anchor: Anchor, pixel: Pixel) -> f64 {
        let from = self.position(anchor);
        let (toward, own) = Self::axes(anchor);
        let x = Vector2::new(pixel.u - from.u, pixel.v - from.v);
        own.dot(&x).max(0.0).atan2(toward.dot(&x))
    }

    /// Unit direction of the half-line with this angle.
    #[expect(clippy::unused_self, reason = "it is an angle of these anchors")]
    pub(crate) fn ray_direction(&self, anchor: Anchor, angle: f64) -> Vector2<f64> {
        let (toward, own) = Self::axes(anchor);
        toward * angle.cos() + own * angle.sin()
    }

    /// Towards the centre, and into the own side.
    fn axes(anchor: Anchor) -> (Vector2<f64>, Vector2<f64>) {
        let sign = if anchor == Anchor::FIRST { 1.0 } else { -1.0 };
        (Vector2::new(0.0, sign), Vector2::new(-sign, 0.0))
    }
}

/// `(anchor index, angle)` of each row of a dcl query of the default layout, the angle as [`ImageAnchors::angle_of`].
pub(crate) fn angles(observations: &Observations) -> Vec<(usize, f64)> {
    match observations {
        Observations::Anchored { pencils, lines } => {
            let [width, height] = pencils.size().map(|side| side as u32);
            let anchors = ImageAnchors::new(width, height);
            let angle = |l: &AnchoredLine| {
                let line = pencils.along(l.anchor, l.angle).expect("it meets the image");
                anchors.angle_of(l.anchor, line.at(100.0))
            };
            lines.iter().map(|l| (l.anchor.index(), angle(l))).collect()
        }
        other => panic!("{other:?} are not of dcl"),
    }
}

/// Field numbers of a sealed query.
pub(crate) const POSITIONS: usize = 15;
pub(crate) const DESCRIPTORS: usize = 16;

/// The content of a length-delimited field.
pub(crate) fn bytes_of_field(message: &[u8], field: usize) -> &[u8] {
    let mut at = 0;
    let varint = |at: &mut usize| {
        let (mut value, mut shift) = (0, 0);
        loop {
            value |= usize::from(message[*at] & 0x7F) << shift;
            *at += 1;
            shift += 7;
            if message[*at - 1] < 0x80 {
                return value;
            }
        }
    };
    loop {
        let key = varint(&mut at);
        let (number, kind) = (key >> 3, key & 7);
        if kind == 5 {
            at += 4;
            continue;
        }
        let length = varint(&mut at);
        if number == field {
            return &message[at..at + length];
        }
        at += length;
    }
}
