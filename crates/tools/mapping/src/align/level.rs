//! The up direction of a map as its images show it.
//!
//! Photographs are mostly taken with a level horizontal axis, so the direction that is most orthogonal to these axes is
//! vertical. A phone held upright stores its image on its side, and a map does not know which of its images are: each one
//! may have any of four quarter turns, and the direction for which most images have one of them decides.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc_geometry::nalgebra::{Matrix3, Vector3};
use veiloc_map::MapModel;

use crate::coordinate_frames::median;
use crate::error::MappingError;

/// The up direction that the images of a map show.
#[derive(Debug, Clone, Copy)]
#[non_exhaustive]
pub struct ImagesUp {
    /// Unit vector in the map.
    pub direction: Vector3<f64>,
    /// Standard deviation of each of its two angles, degrees.
    pub sd_deg: f64,
    /// Median angle between the horizontal axes of the images and the horizontal plane, degrees.
    pub tilt_deg: f64,
    /// Images that are stored on their side.
    pub on_side: usize,
}

/// The up direction of a map, from its gravity or from its images.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MapUp {
    /// Unit vector in the map.
    pub direction: Vector3<f64>,
    /// Standard deviation of each of its two angles, degrees.
    pub sd_deg: f64,
}

impl MapUp {
    /// The opposite of the direction of gravity that a map has, or, for lack of it, of the images; `None` if they do not show
    /// it.
    pub fn of(model: &MapModel) -> Option<Self> {
        Self::of_gravity(model).or_else(|| {
            let found = up_of_images(model).ok()?;
            Some(Self { direction: found.direction, sd_deg: found.sd_deg })
        })
    }

    /// The opposite of the direction of gravity that a map has.
    pub fn of_gravity(model: &MapModel) -> Option<Self> {
        let direction = -Vector3::from(model.down?.in_world());
        Some(Self { direction, sd_deg: KNOWN_DOWN_SD_DEG })
    }
}

/// Standard deviation of a direction of gravity that a map has: of an AR capture, or of who gave it. Degrees.
const KNOWN_DOWN_SD_DEG: f64 = 1.0;
/// Images that vote, and pairs of them that propose directions.
const MAX_IMAGES: usize = 400;
const MAX_PAIRS: usize = 300;
/// Tilt of photographs, degrees.
const USUAL_TILT_DEG: f64 = 6.0;
/// The lower edge of an image is at most 60 degrees from down.
const MIN_COS: f64 = 0.5;
/// Weight of an image as it is stored, on its side to the left (most phones), to the right, and upside down.
const WEIGHTS: [f64; 4] = [1.0, 0.95, 0.9, 0.85];
/// Second over first eigenvalue of the scatter of horizontal axes, below which they lie on a line.
const MIN_PLANE: f64 = 0.02;
/// Another direction with this share of the votes is as good ...
const RIVAL_VOTES: f64 = 0.85;
/// ... unless the horizontal axes are spread this much better for the first.
const CLEARER_PLANE: f64 = 5.0;
/// Angle from which on two directions are different ones, degrees.
const DIFFERENT_DEG: f64 = 30.0;
/// Least standard deviation: images tilt together, as their photographer does. Degrees.
const LEAST_SD_DEG: f64 = 1.0;

/// A direction, down, with what the images say about it.
struct Candidate {
    down: Vector3<f64>,
    votes: f64,
}

/// How an image agrees with a direction of gravity, in the quarter turn that agrees best.
struct Vote {
    horizontal: Vector3<f64>,
    tilt: f64,
    weight: f64,
    is_on_side: bool,
}

/// The vote of an image for a direction of gravity; `None` if none of its edges is below. The axes of the image, right and
/// down, are in the map.
fn vote([right, below]: &[Vector3<f64>; 2], down: &Vector3<f64>) -> Option<Vote> {
    let turns = [(*below, right), (*right, below), (-right, below), (-below, right)];
    let votes = turns.into_iter().zip(WEIGHTS).filter_map(|((vertical, horizontal), of_turn)| {
        let tilt = horizontal.dot(down).clamp(-1.0, 1.0).asin().to_degrees();
        let weight = of_turn * (-0.5 * (tilt / USUAL_TILT_DEG).powi(2)).exp();
        let is_on_side = !std::ptr::eq(horizontal, right);
        (vertical.dot(down) > MIN_COS).then_some(Vote { horizontal: *horizontal, tilt, weight, is_on_side })
    });
    votes.max_by(|a, b| a.weight.total_cmp(&b.weight))
}

/// The up direction by the images of a map.
///
/// # Errors
/// [`MappingError::Alignment`]: the images look in one direction, or do not tell whether they are stored on their side.
pub fn up_of_images(model: &MapModel) -> Result<ImagesUp, MappingError> {
    let refuse = |reason: &str| Err(MappingError::Alignment { reason: reason.to_owned() });
    let step = model.images.len().div_ceil(MAX_IMAGES).max(1);
    let axes: Vec<[Vector3<f64>; 2]> = (model.images.iter().step_by(step))
        .map(|image| [0, 1].map(|row| image.cam_from_world.rotation().matrix().row(row).transpose()))
        .collect();
    let mut candidates = candidates(&axes);
    candidates.sort_by(|a, b| b.votes.total_cmp(&a.votes));
    let Some(best) = candidates.first() else {
        return refuse(
            "the map has too few images to show which direction is down; give this direction with --down",
        );
    };
    let (found, plane) = refined(&axes, &best.down);
    if plane < MIN_PLANE {
        return refuse(
            "all images look in one direction, so they do not determine gravity; give it with --down",
        );
    }
    let is_other =
        |other: &&Candidate| other.down.dot(&found.direction).abs() < DIFFERENT_DEG.to_radians().cos();
    if let Some(other) = candidates.iter().find(is_other)
        && other.votes > RIVAL_VOTES * best.votes
        && plane < CLEARER_PLANE * refined(&axes, &other.down).1
    {
        return refuse(
            "its images do not tell whether they are stored upright or on their side; give the direction of gravity with \
             --down",
        );
    }
    Ok(found)
}

/// Directions that two images propose, with their votes.
fn candidates(axes: &[[Vector3<f64>; 2]]) -> Vec<Candidate> {
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let mut directions = Vec::new();
    if axes.len() > 1 {
        for _ in 0..MAX_PAIRS {
            let [i, j] = [0; 2].map(|_| rng.random_range(0..axes.len()));
            for (a, b) in [(0, 0), (1, 1), (0, 1), (1, 0)] {
                directions.extend(axes[i][a].cross(&axes[j][b]).try_normalize(0.05));
            }
        }
    }
    directions.extend(axes.iter().map(|axes| axes[1]).sum::<Vector3<f64>>().try_normalize(1e-9));
    let both = directions.into_iter().flat_map(|down| [down, -down]);
    let candidate = |down: Vector3<f64>| {
        let votes = axes.iter().filter_map(|axes| Some(vote(axes, &down)?.weight)).sum();
        Candidate { down, votes }
    };
    both.map(candidate).collect()
}

/// The direction that is most orthogonal to the horizontal axes, and how well these span a plane.
fn refined(axes: &[[Vector3<f64>; 2]], start: &Vector3<f64>) -> (ImagesUp, f64) {
    let mut down = *start;
    let mut plane = 0.0;
    let mut sd_deg = f64::INFINITY;
    for _ in 0..5 {
        let votes: Vec<Vote> = axes
            .iter()
            .filter_map(|axes| vote(axes, &down))
            .filter(|v| v.tilt.abs() < 3.0 * USUAL_TILT_DEG)
            .collect();
        let scatter: Matrix3<f64> = votes.iter().map(|v| v.horizontal * v.horizontal.transpose()).sum();
        let eigen = scatter.symmetric_eigen();
        let mut order = [0, 1, 2];
        order.sort_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]));
        let [least, middle, most] = order.map(|k| eigen.eigenvalues[k]);
        plane = if most > 0.0 { middle / most } else { 0.0 };
        if plane < MIN_PLANE {
            break;
        }
        let found: Vector3<f64> = eigen.eigenvectors.column(order[0]).into_owned();
        down = if found.dot(&down) < 0.0 { -found } else { found };
        // Neighbouring images tilt alike: a quarter of them count as independent.
        let variance = least / (votes.len() as f64 - 2.0).max(1.0);
        sd_deg = (2.0 * (variance / middle).sqrt()).to_degrees().hypot(LEAST_SD_DEG);
    }
    let votes: Vec<Vote> = axes.iter().filter_map(|axes| vote(axes, &down)).collect();
    let tilt_deg = median(votes.iter().map(|v| v.tilt.abs()).collect());
    let on_side = votes.iter().filter(|v| v.is_on_side).count();
    (ImagesUp { direction: -down, sd_deg, tilt_deg, on_side }, plane)
}
