//! What a device sends of one image under a variant, and what was true.

use std::collections::BTreeMap;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc_attacks::{KnownSegment, Observation};
use veiloc_descriptor::{DescriptorKind, Descriptors};
use veiloc_geometry::{Pencils, Pixel};
use veiloc_obfuscation::{audit, obfuscate_points};
use veiloc_protocol::{Observations, Scheme};
use veiloc_synthetic::problems::normal;

use super::data;
use super::select::select;
use super::variant::Variant;
use veiloc_datasets::problem_files::KeypointImage;
use veiloc_datasets::problem_files::seed_for;

use crate::EvalError;

/// What is sent of one image. Rows are the keypoints that are kept, in the order of the file, then decoys.
pub(super) struct Sent {
    /// `[kept]`: which keypoints of the image.
    pub(super) kept: Vec<usize>,
    /// `[rows]`: where each row's keypoint truly is, before noise and dither; of a decoy, where it was invented.
    pub(super) truth: Vec<Pixel>,
    /// `[rows · dimension]`, and the dimension.
    pub(super) descriptors: (Vec<u8>, usize),
    /// `[rows]`: what is told about positions.
    pub(super) observed: Observations,
    /// The same as an attacker reads it.
    pub(super) observations: Vec<Observation>,
    /// Where the anchors are.
    pub(super) pencils: Pencils,
    /// The scheme, dividing line drawn.
    pub(super) scheme: Scheme,
}

impl Sent {
    /// Draws everything that is drawn from the names of image and seed, so that variants which keep the same keypoints
    /// differ in nothing else.
    pub(super) fn of(
        variant: &Variant,
        image: &KeypointImage,
        ratios: Option<&[f64]>,
        seed: u64,
    ) -> Result<Self, EvalError> {
        let rng = |what: &str| ChaCha8Rng::seed_from_u64(seed_for(seed, &[&image.name, what]));
        let size = (image.width, image.height);
        let scheme = variant.scheme(&mut rng("dividing line"));
        let Scheme::Dcl(layout) = scheme else {
            return Err(EvalError::Options(format!("{scheme} has no anchors")));
        };
        let pencils = Pencils::of_image([size.0, size.1], &layout.layout());
        let kept = select(variant, &image.keypoints, size, &pencils, ratios, &mut rng("selection"));
        let mut truth: Vec<Pixel> = kept.iter().map(|i| image.keypoints[*i]).collect();
        let (bytes, dimension) = data::descriptors(image)?;
        let mut rows: Vec<u8> =
            kept.iter().flat_map(|i| &bytes[i * dimension..(i + 1) * dimension]).copied().collect();
        let mut moved = across(&truth, &pencils, variant.noise, &mut rng("noise"));
        let count = (variant.decoys / 100.0 * kept.len() as f64).round() as usize;
        if count > 0 {
            let kind = DescriptorKind::ROOT_SIFT;
            if dimension != kind.dim() {
                return Err(EvalError::Options(format!(
                    "{}: decoys are made of RootSIFT descriptors, these have dimension {dimension}",
                    image.name
                )));
            }
            let pool = Descriptors::new(kind, rows.clone())
                .map_err(|e| EvalError::DataSet(format!("{}: {e}", image.name)))?;
            let (pixels, descriptors) =
                audit::decoys(&truth, &pool, [size.0, size.1], count, &mut rng("decoys"))
                    .map_err(|source| EvalError::Seal { name: image.name.clone(), source })?;
            truth.extend(&pixels);
            moved.extend(&pixels);
            rows.extend_from_slice(descriptors.as_bytes());
        }
        let observed = obfuscate_points(&moved, size.0, size.1, &scheme, variant.bits, &mut rng("sent"))
            .map_err(|source| EvalError::Seal { name: image.name.clone(), source })?;
        let observations = Observation::of_sent(&observed);
        Ok(Self { kept, truth, descriptors: (rows, dimension), observed, observations, pencils, scheme })
    }

    /// Expected mean square error across the line that `variant` adds to a keypoint's own, pixels squared: its noise, and
    /// the rounding of the angle at the distance from the anchor that the line alone lets expect.
    pub(super) fn added_variance(&self, variant: &Variant, size: (u32, u32)) -> f64 {
        let step = std::f64::consts::PI / f64::from(variant.bits.levels());
        let squares: Vec<f64> = self
            .observations
            .iter()
            .filter_map(|o| KnownSegment::hull(o, size.0, size.1))
            .map(|s| s.expected().powi(2))
            .collect();
        let rounding = squares.iter().sum::<f64>() / squares.len().max(1) as f64 * step * step / 12.0;
        variant.noise * variant.noise + rounding
    }
}

/// Moves keypoints across their half-lines by normal noise; keypoints of one position together, none over the dividing
/// line.
fn across(pixels: &[Pixel], pencils: &Pencils, noise: f64, rng: &mut impl Rng) -> Vec<Pixel> {
    if noise == 0.0 {
        return pixels.to_vec();
    }
    let mut drawn: BTreeMap<[u64; 2], Pixel> = BTreeMap::new();
    pixels
        .iter()
        .map(|&p| {
            *drawn.entry([p.u.to_bits(), p.v.to_bits()]).or_insert_with(|| {
                let anchor = pencils.anchor_of(p);
                let Some(line) = pencils.line(anchor, pencils.angle_of(anchor, p)) else { return p };
                let along = line.direction();
                let step = noise * normal(rng);
                [step, -step]
                    .map(|s| Pixel::new(p.u - s * along.y, p.v + s * along.x))
                    .into_iter()
                    .find(|q| pencils.anchor_of(*q) == anchor)
                    .unwrap_or(p)
            })
        })
        .collect()
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use veiloc_protocol::{AnchoredLine, DualAnchors};

    /// 400 keypoints with descriptors drawn at random; two of them at one position.
    pub(in crate::privacy::variants) fn image() -> KeypointImage {
        let mut image = veiloc_datasets::problem_files::synthetic_image(400, 4);
        image.keypoints[7] = image.keypoints[8];
        let mut rng = ChaCha8Rng::seed_from_u64(9);
        image.descriptors = Some(((0..400 * 128).map(|_| rng.random_range(0..90)).collect(), 128));
        image
    }

    fn sent(text: &str) -> Sent {
        Sent::of(&text.parse().expect("well written"), &image(), None, 0).expect("it can be sent")
    }

    /// Deviation of the truth from its line: root mean square, pixels.
    fn off_line(sent: &Sent) -> f64 {
        let squares: f64 =
            sent.observations.iter().zip(&sent.truth).map(|(o, p)| o.distance(*p).powi(2)).sum();
        (squares / sent.truth.len() as f64).sqrt()
    }

    #[test]
    fn lines_are_off_by_as_much_as_is_asked_for() {
        // The dither is uniform over a pixel: variance 1/12 along any direction.
        let dither = 1.0 / 12.0_f64;
        for text in ["dcl", "noise=4", "bits=7", "bits=6+noise=2", "line=random+s=2+bits=8"] {
            let (variant, sent) = (text.parse::<Variant>().expect("well written"), sent(text));
            let expected = (dither + sent.added_variance(&variant, (640, 480))).sqrt();
            let measured = off_line(&sent);
            assert!((measured / expected - 1.0).abs() < 0.12, "{text}: {measured} against {expected}");
        }
        let rows = sent("noise=4").observations;
        assert_eq!(rows[7], rows[8], "one position, one line");
    }

    #[test]
    fn codes_are_as_coarse_as_asked_for() {
        for bits in [6, 9, 12] {
            let Observations::Anchored { pencils, lines } = sent(&format!("bits={bits}")).observed else {
                unreachable!("dcl sends half-lines")
            };
            let step = std::f64::consts::PI / f64::from(1_u32 << bits);
            let anchors = DualAnchors::vertical(640, 480);
            let code = |l: &AnchoredLine| {
                let line = pencils.along(l.anchor, l.angle).expect("in sight");
                anchors.angle_of(l.anchor, line.at(100.0)) / step - 0.5
            };
            assert!(lines.iter().all(|l| (code(l) - code(l).round()).abs() < 1e-6), "{bits}");
        }
    }

    #[test]
    fn decoys_come_on_top_of_what_is_sent_without_them() {
        let (plain, with) = (sent("random=200"), sent("random=200+decoys=50"));
        assert_eq!((plain.truth.len(), with.truth.len()), (200, 300));
        assert_eq!(plain.kept, with.kept);
        assert_eq!(plain.truth, with.truth[..200]);
        assert_eq!(with.descriptors.0.len(), 300 * 128);
        assert_eq!(plain.descriptors.0, with.descriptors.0[..200 * 128]);
        let inside = |p: &Pixel| (0.0..640.0).contains(&p.u) && (0.0..480.0).contains(&p.v);
        assert!(with.truth.iter().all(inside));
    }
}
