//! From positions to rows: dither, then line, then quantization. Shared by sealing and by evaluation.

use std::collections::BTreeMap;

use rand::Rng;
use rand::seq::SliceRandom;
use veiloc_geometry::{Pencils, Pinhole, Pixel};
use veiloc_protocol::{
    AnchoredRow, AngleBits, AngleForm, DclLayout, DualAnchors, LayoutTurn, LineRow, PositionRow, Rows, Scheme,
};

use crate::SealError;
use crate::grid::AngleGrid;
use crate::rule::{FrameRule, Told};

/// Positions without repetition, and which of them each keypoint has.
///
/// An extractor gives several features with one position when it finds several orientations there, and a list of
/// matches repeats a keypoint. Two different lines for one position would cross in it (rule L7), so dither, line and
/// permutation partner belong to the place, not to the feature.
pub(crate) struct Places {
    /// Each position once, in order of first appearance.
    pub(crate) pixels: Vec<Pixel>,
    /// `[N]`: the place of each keypoint.
    pub(crate) of: Vec<usize>,
}

impl Places {
    pub(crate) fn new(positions: impl IntoIterator<Item = Pixel>) -> Self {
        let mut known = BTreeMap::new();
        let mut places = Self { pixels: Vec::new(), of: Vec::new() };
        for pixel in positions {
            // Adding zero turns −0 into 0, so that equal numbers have equal bits.
            let key = [(pixel.u + 0.0).to_bits(), (pixel.v + 0.0).to_bits()];
            let place = *known.entry(key).or_insert(places.pixels.len());
            if place == places.pixels.len() {
                places.pixels.push(pixel);
            }
            places.of.push(place);
        }
        places
    }
}

/// Moves a position by up to half a pixel each way, so that one on a lattice cannot be named (rule L2).
pub(crate) fn dither<R: Rng + ?Sized>(pixel: Pixel, rng: &mut R) -> Pixel {
    let mut step = || rng.random::<f64>() - 0.5;
    Pixel::new(pixel.u + step(), pixel.v + step())
}

/// One row per place, of a frame for itself. `dithered` are positions in an image of this camera, whose principal point is the
/// image's centre.
///
/// The error names the index of a place.
///
/// # Panics
/// For a camera without size or focal length.
pub(crate) fn lift<R: Rng + ?Sized>(
    dithered: &[Pixel],
    camera: &Pinhole,
    scheme: Scheme,
    bits: AngleBits,
    rng: &mut R,
) -> Result<Rows, SealError> {
    let center = [f64::from(camera.width) / 2.0, f64::from(camera.height) / 2.0];
    let from_center = |p: &Pixel| [p.u - center[0], p.v - center[1]];
    let positions = |places: &[[f64; 2]]| each(places, |&[u, v]| PositionRow::new(u, v));
    match scheme {
        Scheme::Points => {
            let places: Vec<_> = dithered.iter().map(from_center).collect();
            Ok(Rows::Points(positions(&places)?))
        }
        Scheme::RandomLines => {
            // All directions are drawn before any position is looked at (rule L9).
            let angles: Vec<u16> =
                (0..dithered.len()).map(|_| rng.random_range(0..bits.levels()) as u16).collect();
            let places: Vec<_> = angles.into_iter().zip(dithered.iter().map(from_center)).collect();
            Ok(Rows::RandomLines(each(&places, |&(angle, [u, v])| LineRow::through(bits, angle, u, v))?))
        }
        Scheme::CoordinatePermutation => {
            let mut places: Vec<_> = dithered.iter().map(from_center).collect();
            permute(&mut places, center, rng);
            Ok(Rows::CoordinatePermutation(positions(&places)?))
        }
        Scheme::Dcl(layout) => {
            let rule = FrameRule::default();
            let lifter = DclLift::new(layout, camera, &rule, bits);
            Ok(Rows::Dcl(dithered.iter().map(|p| lifter.row(*p, lifter.told(*p))).collect()))
        }
    }
}

/// What makes a row of `dcl` of a position.
pub(crate) struct DclLift<'a> {
    pencils: Pencils,
    grid: Option<&'a AngleGrid>,
    bits: AngleBits,
    form: AngleForm,
    /// How angles are told over the half circle.
    half_lines: Option<DualAnchors>,
    height: f64,
}

impl<'a> DclLift<'a> {
    pub(crate) fn new(layout: DclLayout, camera: &Pinhole, rule: &'a FrameRule, bits: AngleBits) -> Self {
        let form = AngleForm::needed(layout, rule.turn);
        let half_lines = match (form, layout) {
            (AngleForm::HalfCircle, DclLayout::Halves(halves)) => {
                Some(halves.anchors(camera.width, camera.height))
            }
            _ => None,
        };
        let pencils = pencils(layout, camera, rule.turn);
        Self { pencils, grid: rule.grid.as_ref(), bits, form, half_lines, height: f64::from(camera.height) }
    }

    /// What is said of a position.
    pub(crate) fn told(&self, pixel: Pixel) -> Told {
        let anchor = match &self.half_lines {
            Some(anchors) => anchors.anchor_of(pixel),
            None => self.pencils.anchor_of(pixel),
        };
        let angle = self.pencils.angle_of(anchor, pixel);
        Told { anchor, angle: self.grid.map_or(angle, |grid| grid.middle(anchor, angle)) }
    }

    /// The row that says it. `pixel`: some pixel that was told so.
    pub(crate) fn row(&self, pixel: Pixel, Told { anchor, angle }: Told) -> AnchoredRow {
        let angle = match &self.half_lines {
            Some(anchors) => {
                // Any pixel of the half-plane has the angle of its half-line.
                let own = self.told(pixel) == Told { anchor, angle } && self.grid.is_none();
                let line = if own { None } else { self.pencils.along(anchor, angle) };
                anchors.angle_of(anchor, line.map_or(pixel, |line| line.at(self.height)))
            }
            None => angle,
        };
        AnchoredRow::new(self.form, self.bits, anchor, angle)
    }
}

/// The pencils of a layout in the device's camera.
pub(crate) fn pencils(layout: DclLayout, camera: &Pinhole, turn: LayoutTurn) -> Pencils {
    layout.pencils(camera, turn).expect("the camera has a size and a focal length")
}

/// Rows of all places, or the first that has none.
fn each<P, T>(places: &[P], row: impl Fn(&P) -> Option<T>) -> Result<Vec<T>, SealError> {
    places.iter().enumerate().map(|(index, p)| row(p).ok_or(SealError::TooFar { index })).collect()
}

/// Pairs all places at random and exchanges one coordinate within each pair, `u` or `v` by the toss of a coin.
///
/// Of an odd number, the last three form a ring and pass the coordinate on. A single place has nobody to exchange
/// with and gets a coordinate drawn uniformly from the image.
fn permute<R: Rng + ?Sized>(places: &mut [[f64; 2]], center: [f64; 2], rng: &mut R) {
    if let [only] = places {
        let axis = usize::from(rng.random::<bool>());
        only[axis] = (rng.random::<f64>() * 2.0 - 1.0) * center[axis];
        return;
    }
    let mut order: Vec<usize> = (0..places.len()).collect();
    order.shuffle(rng);
    let mut rest = order.as_slice();
    while !rest.is_empty() {
        let (ring, after) = rest.split_at(if rest.len() == 3 { 3 } else { 2 });
        let axis = usize::from(rng.random::<bool>());
        let first = places[ring[0]][axis];
        for pair in ring.windows(2) {
            places[pair[0]][axis] = places[pair[1]][axis];
        }
        places[ring[ring.len() - 1]][axis] = first;
        rest = after;
    }
}

/// Row `i` of the result is row `order[i]` of `rows`.
pub(crate) fn select(rows: &Rows, order: impl Iterator<Item = usize> + Clone) -> Rows {
    match rows {
        Rows::Points(r) => Rows::Points(order.map(|i| r[i]).collect()),
        Rows::RandomLines(r) => Rows::RandomLines(order.map(|i| r[i]).collect()),
        Rows::CoordinatePermutation(r) => Rows::CoordinatePermutation(order.map(|i| r[i]).collect()),
        Rows::Dcl(r) => Rows::Dcl(order.map(|i| r[i]).collect()),
    }
}
