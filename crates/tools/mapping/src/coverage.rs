//! Where in a place, and how exactly, a camera is expected to be localized: a grid on the ground.
//!
//! A camera of the map stands at each node at the height of the map's cameras nearby, level but for their usual pitch, and looks
//! in [`HEADINGS`] directions. A map point counts as matched with a probability that falls with the angle between the directions from
//! which the camera and the nearest image of its track see it, and with the ratio of their distances: descriptors change with
//! both. So a point on the other side of a wall, which no image sees from here, does not count.
//!
//! ```text
//! A = Σ p Jᵀ J     J: derivative of the projection (pixels) with respect to rotation and centre, [2, 6]
//! ± = root of the largest eigenvalue of the centre's block of A⁻¹
//! ```
//!
//! Noise of keypoints and the share of points that are really matched are not modelled: the expected ± of images of the map,
//! each predicted without its own observations, is compared with the ± that they got when they were localized in the map
//! without them, and the median ratio scales all predictions.

use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::nalgebra::{Matrix2x3, Matrix3, Matrix6, Rotation3, Vector3};
use veiloc_map::MapModel;

use crate::align;
use crate::calibration::SelfTestTrial;
use crate::coordinate_frames::median;

/// Directions in which a camera looks at each node.
pub const HEADINGS: usize = 12;

/// Map points that are used; of more, evenly spaced ones stand for all.
const MAX_POINTS: usize = 3000;
/// Nodes along the longer side of the grid.
const NODES: usize = 36;
/// Angle between viewing directions at which a match has 1/e of its probability.
const ANGLE: f64 = 30.0;
/// Factor of the distance at which it has.
const RATIO: f64 = 2.0;
/// Share of the matches of images with a trusted pose (the tenth percentile) that a camera needs.
const NEEDED: f64 = 0.5;

/// The expected ± over a place.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Coverage {
    /// Up, a unit vector in the map.
    pub up: Vector3<f64>,
    /// Unit vectors of the grid's two directions, orthogonal to `up`.
    pub axes: [Vector3<f64>; 2],
    /// Distance of neighbouring nodes, map units.
    pub step: f64,
    /// The nodes within reach of the map's images.
    pub nodes: Vec<CoverageNode>,
}

/// A position on the ground.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct CoverageNode {
    /// Where the camera stands, in the map.
    pub position: Vector3<f64>,
    /// Column and row in the grid.
    pub at: [usize; 2],
    /// Expected ± of each heading, map units; `None` where no trusted pose is expected.
    pub sd: [Option<f64>; HEADINGS],
    /// The nearest image of the map.
    pub nearest: usize,
}

impl CoverageNode {
    /// Median ± over the headings that are expected to be localized; `None` if none is.
    pub fn median(&self) -> Option<f64> {
        let localized: Vec<f64> = self.sd.iter().copied().flatten().collect();
        (!localized.is_empty()).then(|| median(localized))
    }

    /// Share of the headings that are expected to be localized, 0 to 1.
    pub fn share(&self) -> f64 {
        self.sd.iter().flatten().count() as f64 / HEADINGS as f64
    }
}

impl Coverage {
    /// The expected ± around the images of a map. `tested` are images with their results when they were localized in the map without
    /// them (`None`: no pose); without any the predictions are not scaled, and a pose needs 30 matches. Empty for a map without
    /// images or points.
    pub fn of(model: &MapModel, tested: &[(usize, Option<&SelfTestTrial>)]) -> Self {
        let scene = Scene::of(model);
        let Some(scene) = scene else {
            return Self {
                up: Vector3::z(),
                axes: [Vector3::x(), Vector3::y()],
                step: 0.0,
                nodes: Vec::new(),
            };
        };
        let measure = Measure::of(model, &scene, tested);
        let (low, step, counts) = scene.grid();
        let mut nodes = Vec::new();
        for row in 0..counts[1] {
            for column in 0..counts[0] {
                let flat = scene.axes[0] * (low[0] + step * column as f64)
                    + scene.axes[1] * (low[1] + step * row as f64);
                let Some((nearest, height)) = scene.standing(&flat) else { continue };
                let position = flat + scene.up * height;
                let chances = scene.chances(&position, None);
                let sd = std::array::from_fn(|heading| {
                    let (expected, sd) = scene.expected(&scene.looking(&position, heading), &chances)?;
                    (expected >= measure.needed).then_some(sd * measure.scale)
                });
                nodes.push(CoverageNode { position, at: [column, row], sd, nearest });
            }
        }
        Self { up: scene.up, axes: scene.axes, step, nodes }
    }

    /// Share of all headings of all nodes that are expected to be localized, 0 to 1.
    pub fn share(&self) -> f64 {
        self.nodes.iter().map(CoverageNode::share).sum::<f64>() / self.nodes.len().max(1) as f64
    }

    /// The connected parts of the ground where a camera is expected to be localized in no direction, largest first: indices of
    /// nodes.
    pub fn weak_parts(&self) -> Vec<Vec<usize>> {
        let weak = |node: &CoverageNode| node.sd.iter().all(Option::is_none);
        let mut of_node: std::collections::BTreeMap<[usize; 2], usize> = std::collections::BTreeMap::new();
        of_node.extend(
            self.nodes.iter().enumerate().filter(|(_, node)| weak(node)).map(|(i, node)| (node.at, i)),
        );
        let mut parts = Vec::new();
        while let Some((at, _)) = of_node.first_key_value() {
            let mut open = vec![*at];
            let mut part = Vec::new();
            while let Some([x, y]) = open.pop() {
                let Some(node) = of_node.remove(&[x, y]) else { continue };
                part.push(node);
                open.extend([[x + 1, y], [x, y + 1]]);
                open.extend(x.checked_sub(1).map(|x| [x, y]));
                open.extend(y.checked_sub(1).map(|y| [x, y]));
            }
            parts.push(part);
        }
        parts.sort_by_key(|part| std::cmp::Reverse(part.len()));
        parts
    }
}

/// A map point with the places from which it is seen.
struct Target {
    position: Vector3<f64>,
    /// Image, unit direction from the point to its camera, and distance.
    seen: Vec<(u32, Vector3<f64>, f64)>,
}

struct Scene {
    up: Vector3<f64>,
    axes: [Vector3<f64>; 2],
    targets: Vec<Target>,
    /// Map points for each target.
    weight: f64,
    centers: Vec<Vector3<f64>>,
    /// Median distance from an image to its points.
    depth: f64,
    /// Median pitch of the images' optical axes above the horizontal plane, radians.
    pitch: f64,
    focal: f64,
    /// Half the width and height of the image at depth 1.
    half: [f64; 2],
}

impl Scene {
    fn of(model: &MapModel) -> Option<Self> {
        let camera = model.cameras.get(model.images.first()?.camera)?.pinhole();
        let stride = model.points.len().div_ceil(MAX_POINTS).max(1);
        let centers: Vec<Vector3<f64>> =
            model.images.iter().map(|image| image.cam_from_world.center().coords).collect();
        let mut depths = Vec::new();
        let mut targets = Vec::new();
        for point in model.points.iter().step_by(stride) {
            let position = point.position.coords;
            let mut seen = Vec::with_capacity(point.track.len());
            for observation in &point.track {
                let offset = centers.get(observation.image as usize)? - position;
                depths.push(offset.norm());
                seen.push((observation.image, offset.normalize(), offset.norm()));
            }
            targets.push(Target { position, seen });
        }
        if targets.is_empty() {
            return None;
        }
        // Images that all look in one direction are taken as upright.
        let up = align::MapUp::of(model).map_or_else(
            || -model.images.iter().map(|image| axis(&image.cam_from_world, 1)).sum::<Vector3<f64>>(),
            |up| up.direction,
        );
        let up = up.try_normalize(1e-9)?;
        let side = if up.x.abs() < 0.8 { Vector3::x() } else { Vector3::y() };
        let first = (side - up * up.dot(&side)).normalize();
        let pitches =
            model.images.iter().map(|image| axis(&image.cam_from_world, 2).dot(&up).clamp(-1.0, 1.0).asin());
        Some(Self {
            axes: [first, up.cross(&first)],
            up,
            targets,
            weight: stride as f64,
            depth: median(depths),
            pitch: median(pitches.collect()),
            focal: camera.mean_focal(),
            half: [
                0.5 * f64::from(camera.width) / camera.focal[0],
                0.5 * f64::from(camera.height) / camera.focal[1],
            ],
            centers,
        })
    }

    /// Low corner, step and counts of a grid over the images and what is near them.
    fn grid(&self) -> ([f64; 2], f64, [usize; 2]) {
        let range = |axis: usize| {
            let along = self.centers.iter().map(|center| self.axes[axis].dot(center));
            let (low, high) =
                along.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), x| (l.min(x), h.max(x)));
            (low - self.reach(), high + self.reach())
        };
        let (x, y) = (range(0), range(1));
        let step = (x.1 - x.0).max(y.1 - y.0) / NODES as f64;
        let count = |(low, high): (f64, f64)| ((high - low) / step).round() as usize + 1;
        ([x.0, y.0], step, [count(x), count(y)])
    }

    /// How far from an image of the map a camera may stand: predictions far from all images mean little.
    fn reach(&self) -> f64 {
        0.5 * self.depth
    }

    /// The nearest image, and the height at which a camera stands: that of the images nearby. `None` beyond reach.
    fn standing(&self, flat: &Vector3<f64>) -> Option<(usize, f64)> {
        const NEARBY: usize = 5;
        let mut distances: Vec<(f64, usize)> = self
            .centers
            .iter()
            .enumerate()
            .map(|(image, center)| {
                let offset = center - flat;
                ((offset - self.up * self.up.dot(&offset)).norm(), image)
            })
            .collect();
        distances.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (distance, nearest) = *distances.first()?;
        let heights = distances.iter().take(NEARBY).map(|(_, image)| self.up.dot(&self.centers[*image]));
        (distance <= self.reach()).then(|| (nearest, median(heights.collect())))
    }

    /// A level camera with the usual pitch, looking in one of the directions.
    fn looking(&self, position: &Vector3<f64>, heading: usize) -> CameraFromWorld {
        let angle = std::f64::consts::TAU * heading as f64 / HEADINGS as f64;
        let ahead = self.axes[0] * angle.cos() + self.axes[1] * angle.sin();
        let forward = ahead * self.pitch.cos() + self.up * self.pitch.sin();
        let right = ahead.cross(&self.up);
        let rows =
            Matrix3::from_rows(&[right.transpose(), forward.cross(&right).transpose(), forward.transpose()]);
        let rotation = Rotation3::from_matrix_unchecked(rows);
        CameraFromWorld::new(rotation, -(rotation * position))
    }

    /// Probability of each target to be matched from a position in whatever direction the camera looks; `but`: without this image.
    fn chances(&self, position: &Vector3<f64>, but: Option<u32>) -> Vec<f64> {
        let chance = |target: &Target| {
            let offset = position - target.position;
            let distance = offset.norm();
            if distance <= 0.0 {
                return 0.0;
            }
            let direction = offset / distance;
            let of = |(_, seen, far): &(u32, Vector3<f64>, f64)| {
                let angle = direction.dot(seen).clamp(-1.0, 1.0).acos().to_degrees() / ANGLE;
                let ratio = (distance / far).ln() / RATIO.ln();
                (-angle * angle - ratio * ratio).exp()
            };
            target.seen.iter().filter(|seen| Some(seen.0) != but).map(of).fold(0.0, f64::max)
        };
        self.targets.iter().map(chance).collect()
    }

    /// Expected number of matches of a camera, and its unscaled ±; `None` if they do not determine the pose.
    fn expected(&self, camera: &CameraFromWorld, chances: &[f64]) -> Option<(f64, f64)> {
        let rotation = camera.rotation().matrix();
        let (mut information, mut expected) = (Matrix6::zeros(), 0.0);
        for (target, chance) in self.targets.iter().zip(chances).filter(|(_, chance)| **chance > 0.01) {
            let x = rotation * target.position + camera.translation();
            if x.z <= 0.0 || x.x.abs() > self.half[0] * x.z || x.y.abs() > self.half[1] * x.z {
                continue;
            }
            let (u, v, depth) = (x.x / x.z, x.y / x.z, x.z);
            // Derivative with respect to the point in the camera, which a rotation ω and a shift v of the frame move by ω × x + v.
            let d = Matrix2x3::new(1.0, 0.0, -u, 0.0, 1.0, -v) * (self.focal / depth);
            let turn = -d * x.cross_matrix();
            let mut j = veiloc_geometry::nalgebra::Matrix2x6::zeros();
            j.fixed_view_mut::<2, 3>(0, 0).copy_from(&turn);
            j.fixed_view_mut::<2, 3>(0, 3).copy_from(&d);
            information += j.transpose() * j * (*chance * self.weight);
            expected += chance * self.weight;
        }
        let covariance = information.cholesky()?.inverse();
        let sd = covariance.fixed_view::<3, 3>(3, 3).into_owned().symmetric_eigenvalues().max().sqrt();
        sd.is_finite().then_some((expected, sd))
    }
}

fn axis(camera: &CameraFromWorld, row: usize) -> Vector3<f64> {
    camera.rotation().matrix().row(row).transpose()
}

/// What the predictions of the map's own images say.
struct Measure {
    /// The ± that images got, over their prediction.
    scale: f64,
    /// Expected matches from which on a trusted pose is expected.
    needed: f64,
}

impl Measure {
    fn of(model: &MapModel, scene: &Scene, tested: &[(usize, Option<&SelfTestTrial>)]) -> Self {
        let calibration =
            model.self_test.as_ref().and_then(|test| test.schemes.first()).map(|scheme| scheme.calibration);
        let (mut ratios, mut matches) = (Vec::new(), Vec::new());
        for (image, trial) in tested {
            let (Some(trial), Some(of)) = (trial.filter(|trial| trial.trusted), model.images.get(*image))
            else {
                continue;
            };
            let chances = scene.chances(&scene.centers[*image], Some(*image as u32));
            let Some((expected, predicted)) = scene.expected(&of.cam_from_world, &chances) else { continue };
            let covariance = calibration.map_or(trial.covariance, |calibration| {
                calibration.apply(&trial.covariance, &trial.camera_covariance)
            });
            let got = veiloc_geometry::deviations::position_sd(&covariance);
            if got.is_finite() && predicted > 0.0 {
                ratios.push(got / predicted);
                matches.push(expected);
            }
        }
        if ratios.is_empty() {
            return Self { scale: 1.0, needed: 30.0 };
        }
        matches.sort_by(f64::total_cmp);
        Self { scale: median(ratios), needed: NEEDED * matches[matches.len() / 10] }
    }
}

#[cfg(test)]
mod tests {
    use veiloc_descriptor::{DescriptorKind, Descriptors, GlobalDescriptor, Vocabulary};
    use veiloc_map::{BuildSettings, MapImage, MapPoint, Observation};
    use veiloc_protocol::Profile;

    use super::*;

    /// Level cameras (y down) in a row along x that look along z, at points of a wall at `z = depth`.
    fn row_of_cameras(depth: f64) -> MapModel {
        let words = Descriptors::new(DescriptorKind::ROOT_SIFT, vec![30; 128]).expect("words");
        let profile = Profile::vlad(Vocabulary::new(words).expect("a vocabulary"));
        let mut model = MapModel::empty(profile, BuildSettings::default());
        model.cameras = vec!["PINHOLE,640,480,500,500,320,240".parse().expect("a camera")];
        for i in 0..6_u32 {
            let center = Vector3::new(f64::from(i), 0.0, 0.0);
            model.images.push(MapImage {
                name: format!("{i}.jpg"),
                camera: 0,
                cam_from_world: CameraFromWorld::new(Rotation3::identity(), -center),
                keypoints: Vec::new(),
                descriptors: Descriptors::empty(DescriptorKind::ROOT_SIFT),
                global: GlobalDescriptor::new(Vec::new()),
                point_of_keypoint: Vec::new(),
            });
        }
        for i in 0..600_u32 {
            let (x, y) = (-2.0 + 0.1 * f64::from(i % 90), -1.0 + 0.3 * f64::from(i / 90));
            let position = Vector3::new(x, y, depth + 0.3 * f64::from(i % 3));
            let track = (0..6).filter(|image| (f64::from(*image) - x).abs() < 2.0);
            let track = track.map(|image| Observation { image, keypoint: i }).collect::<Vec<_>>();
            if !track.is_empty() {
                let position = veiloc_geometry::Point3::from_vector(position);
                model.points.push(MapPoint { position, track, error: 0.5 });
            }
        }
        model.down = Some(veiloc_map::GravityDirection::new([0.0, 1.0, 0.0]).expect("a direction"));
        model
    }

    fn heading(coverage: &Coverage, along: Vector3<f64>) -> usize {
        let of = |heading: usize| {
            let angle = std::f64::consts::TAU * heading as f64 / HEADINGS as f64;
            (coverage.axes[0] * angle.cos() + coverage.axes[1] * angle.sin()).dot(&along)
        };
        (0..HEADINGS).max_by(|a, b| of(*a).total_cmp(&of(*b))).expect("headings")
    }

    #[test]
    fn camera_is_localized_where_it_sees_points_as_images_do() {
        let coverage = Coverage::of(&row_of_cameras(4.0), &[]);
        assert!((coverage.up + Vector3::y()).norm() < 1e-9, "{}", coverage.up);
        let (ahead, back) = (heading(&coverage, Vector3::z()), heading(&coverage, -Vector3::z()));
        let near = |x: f64, z: f64| {
            let far = |node: &&CoverageNode| (node.position - Vector3::new(x, 0.0, z)).norm();
            coverage.nodes.iter().min_by(|a, b| far(a).total_cmp(&far(b))).expect("nodes")
        };
        let middle = near(2.5, 0.0);
        let sd = middle.sd[ahead].expect("it looks at the wall");
        assert!(middle.sd[back].is_none(), "nothing is behind it");
        assert!(sd > 0.0 && sd < 0.05, "{sd}");
        // Nearer to the wall it is more exact, and farther less.
        let (close, far) = (near(2.5, 1.0), near(2.5, -1.5));
        let (close, far) = (close.sd[ahead].expect("a pose"), far.sd[ahead].expect("a pose"));
        assert!(close < sd && sd < far, "{close} {sd} {far}");
        assert!(coverage.nodes.iter().all(|node| node.position.z < 2.2), "within reach of the images");
        let weak = coverage.nodes.iter().filter(|node| node.median().is_none()).count();
        assert_eq!(coverage.weak_parts().iter().map(Vec::len).sum::<usize>(), weak);
        assert!(weak < coverage.nodes.len() / 2, "most of the ground sees the wall: {weak}");
        assert!(coverage.share() > 0.05 && coverage.share() < 0.5, "{}", coverage.share());
    }

    #[test]
    fn points_seen_from_the_other_side_do_not_count() {
        let model = row_of_cameras(4.0);
        let scene = Scene::of(&model).expect("a scene");
        let this_side = scene.chances(&Vector3::new(2.5, 0.0, 0.0), None);
        let other_side = scene.chances(&Vector3::new(2.5, 0.0, 8.0), None);
        assert!(this_side.iter().copied().fold(0.0, f64::max) > 0.9);
        assert!(other_side.iter().all(|chance| *chance < 1e-3), "{other_side:?}");
    }

    #[test]
    fn predictions_are_scaled_by_the_images_of_the_map() {
        let model = row_of_cameras(4.0);
        let plain = Coverage::of(&model, &[]);
        let of = |sd: f64| {
            let mut covariance = [[0.0; 6]; 6];
            (0..6).for_each(|i| covariance[i][i] = sd * sd);
            SelfTestTrial {
                step: [0.0; 6],
                covariance,
                camera_covariance: [[0.0; 6]; 6],
                trusted: true,
                noise_px: 1.0,
                camera_evidence: None,
                looks_like: None,
            }
        };
        let median_of = |sd: f64| {
            let trial = of(sd);
            let tested: Vec<_> = (0..6).map(|image| (image, Some(&trial))).collect();
            let coverage = Coverage::of(&model, &tested);
            median(coverage.nodes.iter().flat_map(|node| node.sd).flatten().collect())
        };
        let (one, three) = (median_of(0.1), median_of(0.3));
        assert!((three / one - 3.0).abs() < 1e-9, "{one} {three}");
        assert!(!plain.nodes.is_empty());
        let empty = MapModel { points: Vec::new(), ..model };
        assert!(Coverage::of(&empty, &[]).nodes.is_empty());
    }
}
