//! `problems.jsonl`: 2D–3D correspondence sets with their true poses, the input of `eval pose`.

use std::path::Path;

use serde::{Deserialize, Serialize};
use veiloc_descriptor::DescriptorKind;
use veiloc_descriptor::{MatchEvidence, match_probability};
use veiloc_geometry::frames::World;
use veiloc_geometry::nalgebra::Vector3;
use veiloc_geometry::{CameraFromWorld, Intrinsics, Pinhole, Pixel, Point3};
use veiloc_pose::{Gravity, MatchViewpoint};

use crate::error::DatasetError;
use crate::problem_files::json_lines;

/// One query: matches between its keypoints and map points, and its true pose.
#[derive(Debug, Clone)]
pub struct Problem {
    /// Name of the query.
    pub name: String,
    /// The camera without distortion; [`Self::keypoints`] are pixels of this camera.
    pub camera: Pinhole,
    /// The distinct keypoints, undistorted.
    pub keypoints: Vec<Pixel>,
    /// Match to keypoint: `[matches]`, indices into [`Self::keypoints`].
    pub keypoint_of_match: Vec<usize>,
    /// Match to map point: `[matches]`.
    pub points: Vec<Point3<World>>,
    /// The true pose.
    pub cam_from_world: CameraFromWorld,
    /// Name of the matched features: it selects the model of the matches' prior.
    pub features: String,
    /// Nearest over second-nearest descriptor distance, `[matches]`.
    pub ratio: Option<Vec<f64>>,
    /// Retrieved images that propose the pair, `[matches]`.
    pub votes: Option<Vec<u32>>,
    /// Map images that see the point, `[matches]`.
    pub track_length: Option<Vec<u32>>,
    /// Viewpoint from which the proposing map image of each match saw the point, `[matches]`.
    pub seen_from: Option<Vec<MatchViewpoint>>,
    /// Direction of gravity, if the file has one: `gravity_in_camera` as the device measured it, and
    /// `gravity_in_world`, the same direction in the map, −z by default. Both point down; any length but zero.
    pub gravity: Option<Gravity>,
}

/// One line of the file as JSON. All lists have one entry per match.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ProblemLine {
    /// Name of the query.
    pub name: String,
    /// The camera, by COLMAP's names.
    pub camera: CameraLine,
    /// Keypoints `[u, v]`, pixels.
    pub points2d: Vec<[f64; 2]>,
    /// Map points, map units.
    pub points3d: Vec<[f64; 3]>,
    /// The true pose.
    pub cam_from_world: PoseLine,
    /// Name of the features that were matched; `sift` when it is not given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub features: Option<String>,
    /// Nearest over second-nearest descriptor distance.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ratio: Option<Vec<f64>>,
    /// Retrieved images that propose the pair.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub votes: Option<Vec<u32>>,
    /// Map images that see the point.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub track_length: Option<Vec<u32>>,
    /// Camera centre (map units) and focal length (pixels) of the map image that proposes the match: `[x, y, z,
    /// focal]`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seen_from: Option<Vec<[f64; 4]>>,
    /// Down direction as the device measured it, any length.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gravity_in_camera: Option<[f64; 3]>,
    /// Down direction in the map; −z by default.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gravity_in_world: Option<[f64; 3]>,
}

/// A camera in a problem line.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CameraLine {
    /// Name of the model.
    pub model: String,
    /// Pixels.
    pub width: u32,
    /// Pixels.
    pub height: u32,
    /// In the order of COLMAP.
    pub params: Vec<f64>,
}

/// A pose in a problem line.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PoseLine {
    /// `qw qx qy qz`.
    pub q: [f64; 4],
    /// Map units.
    pub t: [f64; 3],
}

impl Problem {
    /// Prior probability that each match is right, `[matches]`; `None` if the file has no ratio.
    pub fn prior(&self) -> Option<Vec<f64>> {
        let ratios = self.ratio.as_ref()?;
        let prior = DescriptorKind::match_prior_of(&self.features);
        let at = |counts: &Option<Vec<u32>>, i: usize| counts.as_ref().map(|c| c[i]);
        let evidence = |(i, &ratio)| MatchEvidence {
            ratio,
            votes: at(&self.votes, i),
            track_length: at(&self.track_length, i),
        };
        Some(ratios.iter().enumerate().map(evidence).map(|e| match_probability(&prior, &e)).collect())
    }
}

/// Reads all problems of a `problems.jsonl` or `problems.jsonl.gz`.
///
/// # Errors
/// [`DatasetError`] naming file and line when a line is not a problem: unequal lengths, an impossible camera, a number
/// that is not finite.
pub fn read_problems(path: &Path) -> Result<Vec<Problem>, DatasetError> {
    json_lines::read::<ProblemLine>(path)?
        .into_iter()
        .map(|(number, line)| {
            problem(line).map_err(|reason| DatasetError::Line { path: path.to_owned(), line: number, reason })
        })
        .collect()
}

fn problem(line: ProblemLine) -> Result<Problem, String> {
    let n = line.points2d.len();
    let mut lengths = vec![("points3d", line.points3d.len())];
    lengths.extend(line.ratio.as_ref().map(|v| ("ratio", v.len())));
    lengths.extend(line.votes.as_ref().map(|v| ("votes", v.len())));
    lengths.extend(line.track_length.as_ref().map(|v| ("track_length", v.len())));
    lengths.extend(line.seen_from.as_ref().map(|v| ("seen_from", v.len())));
    if let Some((what, m)) = lengths.into_iter().find(|(_, m)| *m != n) {
        return Err(format!("{what} has {m} entries, but points2d has {n}"));
    }
    let camera =
        Intrinsics::new(&line.camera.model, line.camera.width, line.camera.height, &line.camera.params)
            .map_err(|e| e.to_string())?;
    let cam_from_world = CameraFromWorld::from_quaternion(line.cam_from_world.q, line.cam_from_world.t)
        .ok_or("cam_from_world is not a finite pose")?;
    // A keypoint may be matched to several map points; it is still one keypoint with one line (L7).
    let mut index: std::collections::BTreeMap<[u64; 2], usize> = std::collections::BTreeMap::new();
    let mut keypoints = Vec::new();
    let mut keypoint_of_match = Vec::with_capacity(n);
    for (i, [u, v]) in line.points2d.into_iter().enumerate() {
        let key = [u.to_bits(), v.to_bits()];
        let known = if let Some(known) = index.get(&key) {
            *known
        } else {
            let pixel = camera
                .undistort_pixel(Pixel::new(u, v))
                .ok_or_else(|| format!("points2d[{i}] = ({u}, {v}) has no ray in this camera"))?;
            keypoints.push(pixel);
            index.insert(key, keypoints.len() - 1);
            keypoints.len() - 1
        };
        keypoint_of_match.push(known);
    }
    let points: Vec<Point3<World>> = line.points3d.iter().map(|p| Point3::new(p[0], p[1], p[2])).collect();
    if let Some(i) = points.iter().position(|p| !p.is_finite()) {
        return Err(format!("points3d[{i}] is not finite"));
    }
    if let Some(i) = line.ratio.iter().flatten().position(|r| !(r.is_finite() && *r >= 0.0)) {
        return Err(format!("ratio[{i}] is not a ratio"));
    }
    if let Some(i) =
        line.seen_from.iter().flatten().position(|s| !(s.iter().all(|v| v.is_finite()) && s[3] > 0.0))
    {
        return Err(format!("seen_from[{i}] is not a camera; give x, y, z and a focal length above 0"));
    }
    let seen_from = |[x, y, z, focal_px]: [f64; 4]| MatchViewpoint { center: Point3::new(x, y, z), focal_px };
    let gravity = gravity(line.gravity_in_camera, line.gravity_in_world)?;
    Ok(Problem {
        name: line.name,
        camera: camera.pinhole(),
        keypoints,
        keypoint_of_match,
        points,
        cam_from_world,
        features: line.features.unwrap_or_else(|| DescriptorKind::ROOT_SIFT.name().to_owned()),
        ratio: line.ratio,
        votes: line.votes,
        track_length: line.track_length,
        seen_from: line.seen_from.map(|all| all.into_iter().map(seen_from).collect()),
        gravity,
    })
}

/// Default down direction of a map: z points up in most surveyed maps.
const DOWN: [f64; 3] = [0.0, 0.0, -1.0];

fn gravity(in_camera: Option<[f64; 3]>, in_world: Option<[f64; 3]>) -> Result<Option<Gravity>, String> {
    let direction = |what: &str, v: [f64; 3]| {
        let v = Vector3::from(v);
        let is_direction = v.norm().is_finite() && v.norm() > 0.0;
        is_direction.then_some(v).ok_or_else(|| format!("{what} is not a direction"))
    };
    match (in_camera, in_world) {
        (Some(camera), world) => Ok(Some(Gravity::from_accelerometer(
            direction("gravity_in_camera", camera)?,
            direction("gravity_in_world", world.unwrap_or(DOWN))?,
        ))),
        (None, Some(_)) => Err("gravity_in_world is given without gravity_in_camera".to_owned()),
        (None, None) => Ok(None),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: &str = r#"{"name":"q","camera":{"model":"PINHOLE","width":640,"height":480,"params":[500,500,320,240]},"points2d":[[1,2],[1,2],[3,4]],"points3d":[[0,0,1],[0,1,1],[1,0,1]],"cam_from_world":{"q":[1,0,0,0],"t":[0,0,0]},"ratio":[0.5,0.6,0.7]}"#;

    fn read(text: &str) -> Result<Vec<Problem>, DatasetError> {
        let dir = tempfile::tempdir().expect("temporary folder");
        let path = dir.path().join("p.jsonl");
        std::fs::write(&path, text).expect("written");
        read_problems(&path)
    }

    #[test]
    fn keypoint_with_two_map_points_is_one_keypoint() {
        let problem = &read(GOOD).expect("well formed")[0];
        assert_eq!(problem.keypoints.len(), 2);
        assert_eq!(problem.keypoint_of_match, [0, 0, 1]);
    }

    /// [`GOOD`] with more fields.
    fn with(fields: &str) -> String {
        GOOD.replacen('{', &format!("{{{fields},"), 1)
    }

    #[test]
    fn gravity_points_down_and_defaults_to_minus_z() {
        let gravity = |fields: &str| read(&with(fields)).expect("well formed")[0].gravity;
        let felt = gravity("\"gravity_in_camera\":[0,9.81,0]").expect("given");
        assert_eq!((felt.in_camera.y, felt.in_world), (9.81, Vector3::new(0.0, 0.0, -1.0)));
        let felt = gravity("\"gravity_in_camera\":[0,1,0],\"gravity_in_world\":[0,1,0]").expect("given");
        assert_eq!(felt.in_world, Vector3::y());
        assert!(read(GOOD).expect("well formed")[0].gravity.is_none());
    }

    #[test]
    fn prior_depends_on_feature_kind() {
        let prior = |fields: &str| read(&with(fields)).expect("well formed")[0].prior().expect("ratios");
        let of = |kind: DescriptorKind| prior(&format!("\"features\":\"{}\"", kind.name()));
        assert_eq!(read(GOOD).expect("well formed")[0].prior(), Some(of(DescriptorKind::ROOT_SIFT)));
        assert!(of(DescriptorKind::COMPACT)[0] > of(DescriptorKind::ROOT_SIFT)[0]);
        assert!(prior("\"features\":\"unheard-of\"")[0] < of(DescriptorKind::ROOT_SIFT)[0]);
    }

    #[test]
    fn invalid_lines_are_reported_with_number() {
        let cases = [
            (GOOD.replace("[0,0,1],", ""), "points3d has 2 entries"),
            (GOOD.replace("\"q\":[1,0,0,0]", "\"q\":[0,0,0,0]"), "not a finite pose"),
            (GOOD.replace("PINHOLE", "SPHERICAL"), "SPHERICAL"),
            (GOOD.replace("[0.5,", "[-1,"), "ratio[0]"),
            (GOOD.replace("[3,4]", "[3]"), "invalid length"),
            ("{".to_owned(), "EOF"),
            (with("\"gravity_in_camera\":[0,0,0]"), "gravity_in_camera is not a direction"),
            (with("\"gravity_in_camera\":[0,1]"), "invalid length"),
            (with("\"gravity_in_camera\":[0,1,0],\"gravity_in_world\":[0,0,0]"), "gravity_in_world is not"),
            (with("\"gravity_in_world\":[0,0,-1]"), "without gravity_in_camera"),
        ];
        for (text, expected) in cases {
            let error = read(&format!("{GOOD}\n\n{text}\n")).expect_err(expected).to_string();
            assert!(error.contains(":3: ") && error.contains(expected), "{error}");
        }
        assert!(matches!(read(""), Err(DatasetError::Empty { .. })));
        assert!(matches!(read_problems(Path::new("no/such/file")), Err(DatasetError::Io { .. })));
    }
}
