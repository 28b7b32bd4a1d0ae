//! Positions for a report's drawings, collected while the attacks run.

use image::RgbImage;
use veiloc_attacks::{NeighbourLists, Observation};
use veiloc_geometry::Pixel;
use veiloc_protocol::{Observations, Scheme};

use crate::attack_evaluation::{Attack, AttackTrial};

/// Errors of all keypoints, and the recovered positions of the first images.
#[derive(Debug, Clone, Default)]
pub struct ShownImages {
    /// Maximum number of images with positions.
    pub max_shown: usize,
    /// For each row of the document, in its order, the relative error of the offsets to neighbouring keypoints
    /// ([`relative_offset_error`]); unsorted.
    pub offset_errors: Vec<Vec<f64>>,
    /// The images with positions.
    pub shown: Vec<ShownImage>,
    /// Number of keypoints of all images.
    pub keypoints: usize,
    /// True neighbours of the current image.
    near: Option<NeighbourLists>,
}

/// One image with its recovered positions.
#[derive(Debug, Clone)]
pub struct ShownImage {
    /// Group in the document's `data`, and index in the group.
    pub at: (usize, usize),
    /// Name of the image.
    pub name: String,
    /// Width and height, pixels.
    pub size: (u32, u32),
    /// `[N]`, its keypoints, pixels.
    pub truth: Vec<Pixel>,
    /// One entry per scheme.
    pub schemes: Vec<ShownScheme>,
    /// The image itself, with this size; `None` if it is not shown.
    pub photograph: Option<RgbImage>,
}

/// The image under one scheme.
#[derive(Debug, Clone)]
pub struct ShownScheme {
    /// Obfuscation scheme.
    pub scheme: Scheme,
    /// The sent observations.
    pub sent: Observations,
    /// Standard deviation of the positions at which each line intersects its neighbours' lines, pixels along the
    /// line.
    pub crossings: Vec<f64>,
    /// Attacks at the first share of replaced neighbours.
    pub attacks: Vec<ShownAttack>,
}

/// One attack's answers.
#[derive(Debug, Clone)]
pub struct ShownAttack {
    /// Attack.
    pub attack: Attack,
    /// `[N]`, recovered keypoints, pixels.
    pub answers: Vec<Pixel>,
    /// `[N]`, pixels.
    pub errors: Vec<f64>,
}

impl ShownImages {
    /// Collects the positions of this many images.
    pub fn with_limit(max_shown: usize) -> Self {
        Self { max_shown, ..Self::default() }
    }

    /// Adds an attack on an image, in the order of the evaluation.
    pub fn add(&mut self, trial: &AttackTrial<'_>) {
        let truth = &trial.image.keypoints;
        // Each image begins with the first row.
        if trial.row == 0 {
            self.keypoints += truth.len();
            self.near = None;
            if self.shown.len() < self.max_shown {
                self.shown.push(ShownImage::new(trial));
            }
        }
        if let Some(shown) = self.shown.last_mut().filter(|shown| shown.at == trial.at) {
            shown.add(trial);
        }
        let near = self.near.get_or_insert_with(|| NeighbourLists::nearest(truth, OFFSET_NEIGHBOURS));
        let errors = relative_offset_error(truth, trial.answers, near);
        if self.offset_errors.len() <= trial.row {
            self.offset_errors.resize(trial.row + 1, Vec::new());
        }
        self.offset_errors[trial.row].extend(errors);
    }
}

impl ShownImage {
    fn new(trial: &AttackTrial<'_>) -> Self {
        Self {
            at: trial.at,
            name: trial.image.name.clone(),
            size: (trial.image.width, trial.image.height),
            truth: trial.image.keypoints.clone(),
            schemes: Vec::new(),
            photograph: None,
        }
    }

    fn add(&mut self, trial: &AttackTrial<'_>) {
        let context = trial.context;
        if self.schemes.last().is_none_or(|s| s.scheme != context.scheme()) {
            let crossings = context.neighbours().map(|near| crossing_spread(context.observations(), &near));
            self.schemes.push(ShownScheme {
                scheme: context.scheme(),
                sent: context.sent().clone(),
                // Without neighbours nothing intersects.
                crossings: crossings.unwrap_or_default(),
                attacks: Vec::new(),
            });
        }
        let Some(scheme) = self.schemes.last_mut() else { return };
        if scheme.attacks.iter().all(|a| a.attack != trial.attack) {
            scheme.attacks.push(ShownAttack {
                attack: trial.attack,
                answers: trial.answers.to_vec(),
                errors: trial.errors.to_vec(),
            });
        }
    }
}

/// Number of neighbours whose offsets are compared.
const OFFSET_NEIGHBOURS: usize = 8;

/// Relative error of the offsets to neighbouring keypoints: the median, over the true neighbours of a keypoint, of
/// the error of the offset divided by its length. 0 for a common translation, 1 if all positions coincide; infinite
/// without an answer or neighbours.
///
/// An error in pixels does not show whether a layout is correct up to translation or bending; such a layout suffices
/// to reconstruct an image.
fn relative_offset_error(truth: &[Pixel], answers: &[Pixel], near: &NeighbourLists) -> Vec<f64> {
    let of = |i: usize| {
        let mut off: Vec<f64> = near
            .of(i)
            .iter()
            .map(|&j| {
                let (true_offset, offset) = (
                    truth[j as usize].vector() - truth[i].vector(),
                    answers[j as usize].vector() - answers[i].vector(),
                );
                let share = (offset - true_offset).norm() / true_offset.norm().max(1.0);
                if share.is_nan() { f64::INFINITY } else { share }
            })
            .collect();
        off.sort_unstable_by(f64::total_cmp);
        off.get(off.len() / 2).copied().unwrap_or(f64::INFINITY)
    };
    (0..truth.len().min(answers.len()).min(near.len())).map(of).collect()
}

/// The paper's Fig. 4 (d): for each line `i` the standard deviation, over its neighbours `j`, of the position `t_ij`
/// along it at which the two lines intersect, pixels. Parallel neighbours are ignored; `NaN` if none is left.
///
/// For two candidate lines the first one is used.
fn crossing_spread(observations: &[Observation], neighbours: &NeighbourLists) -> Vec<f64> {
    let line = |i: usize| observations.get(i).and_then(|o| o.lines()[0]);
    let spread = |i: usize| {
        let own = line(i)?;
        let along: Vec<f64> = neighbours
            .of(i)
            .iter()
            .filter_map(|&j| own.intersection(&line(j as usize)?))
            .map(|p| p.vector().dot(&own.direction()))
            .collect();
        let n = along.len() as f64;
        let mean = along.iter().sum::<f64>() / n;
        Some((along.iter().map(|t| (t - mean).powi(2)).sum::<f64>() / n).sqrt())
    };
    (0..observations.len().min(neighbours.len())).map(|i| spread(i).unwrap_or(f64::NAN)).collect()
}

#[cfg(test)]
mod tests {
    use veiloc_geometry::{Pencils, PixelLine};

    use super::*;

    #[test]
    fn translation_gives_zero_bending() {
        let truth: Vec<Pixel> =
            (0..100).map(|i| Pixel::new(f64::from(i % 10) * 20.0, f64::from(i / 10) * 20.0)).collect();
        let near = NeighbourLists::nearest(&truth, OFFSET_NEIGHBOURS);
        let bent = |to: fn(&Pixel) -> Pixel| {
            let answers: Vec<Pixel> = truth.iter().map(to).collect();
            relative_offset_error(&truth, &answers, &near)
        };
        assert!(bent(|p| Pixel::new(p.u + 300.0, p.v - 50.0)).iter().all(|b| *b < 1e-9));
        assert!(bent(|_| Pixel::new(320.0, 0.0)).iter().all(|b| (b - 1.0).abs() < 1e-9));
        assert!(bent(|p| Pixel::new(1.2 * p.u, 1.2 * p.v)).iter().all(|b| (b - 0.2).abs() < 1e-9));
        assert!(bent(|_| Pixel::new(f64::NAN, 0.0)).iter().all(|b| b.is_infinite()));
    }

    #[test]
    fn lines_of_one_anchor_intersect_in_one_point() {
        let pencils = Pencils::paper(640, 480);
        let ray = |u: f64, v: f64| {
            let p = Pixel::new(u, v);
            let anchor = pencils.anchor_of(p);
            Observation::anchored(&pencils, anchor, pencils.angle_of(anchor, p))
        };
        let sent = [ray(100.0, 200.0), ray(120.0, 220.0), ray(90.0, 260.0), ray(330.0, 240.0)];
        let lists = NeighbourLists::from_lists(&[vec![1, 2], vec![1], vec![0, 3], vec![]]).expect("lists");
        let spread = crossing_spread(&sent, &lists);
        // The last two intersect at the anchor (320, 0) and at (340.98859, -23.72624).
        assert!(spread[0] < 1e-6 && (spread[2] - 15.838681).abs() < 1e-5, "{spread:?}");
        assert!(
            spread[1].is_nan() && spread[3].is_nan(),
            "a line is parallel to itself, and without neighbours there is no spread: {spread:?}"
        );
        // Computed by hand: a horizontal line, intersected at u = 0 and u = 10.
        let level = |u: f64, angle: f64| Observation::Line(PixelLine::through(Pixel::new(u, 5.0), angle));
        let sent = [level(3.0, 0.0), level(0.0, 1.0), level(10.0, 2.0)];
        let lists = NeighbourLists::from_lists(&[vec![1, 2], vec![], vec![]]).expect("lists");
        assert!((crossing_spread(&sent, &lists)[0] - 5.0).abs() < 1e-9);
    }
}
