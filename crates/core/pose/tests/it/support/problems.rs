//! Reads `problems.jsonl.gz` and obfuscates its keypoints: for the real-data test and the `problems` example.

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader};

use rand::Rng;
use rand_chacha::ChaCha8Rng;
use serde_json::Value;
use veiloc_descriptor::MatchEvidence;
use veiloc_geometry::frames::World;
use veiloc_geometry::{CameraFromWorld, Intrinsics, Pencils, Pinhole, Pixel, PixelLine, Point3};
use veiloc_pose::Correspondences;

pub(crate) type Failure = Box<dyn std::error::Error>;

/// One query with its true pose.
pub(crate) struct Query {
    pub(crate) camera: Pinhole,
    pub(crate) pixels: Vec<Pixel>,
    /// Matches with equal positions in the file belong to one keypoint, as the format defines.
    pub(crate) keypoints: Vec<usize>,
    pub(crate) points: Vec<Point3<World>>,
    pub(crate) truth: CameraFromWorld,
    pub(crate) evidence: Vec<MatchEvidence>,
}

/// The schemes in a few lines: dither of half a pixel, angles in 12 bits, one line per keypoint.
pub(crate) fn obfuscate(query: &Query, scheme: &str, rng: &mut ChaCha8Rng) -> Correspondences {
    if scheme == "points" {
        return Correspondences::Points { pixels: query.pixels.clone() };
    }
    let pencils = Pencils::paper(query.camera.width, query.camera.height);
    let step = std::f64::consts::PI / 4096.0;
    let quantized = |angle: f64| ((angle / step).floor() + 0.5) * step;
    let mut known = BTreeMap::new();
    let drawn: Vec<(Pixel, f64)> = query
        .pixels
        .iter()
        .zip(&query.keypoints)
        .map(|(p, keypoint)| {
            *known.entry(*keypoint).or_insert_with(|| {
                let dither = Pixel::new(p.u + rng.random_range(-0.5..0.5), p.v + rng.random_range(-0.5..0.5));
                (dither, rng.random_range(0.0..std::f64::consts::PI))
            })
        })
        .collect();
    if scheme == "lines" {
        return Correspondences::Lines {
            lines: drawn.iter().map(|(p, a)| PixelLine::through(*p, quantized(*a))).collect(),
        };
    }
    let anchored = |p: Pixel| {
        let anchor = pencils.anchor_of(p);
        (anchor, quantized(pencils.angle_of(anchor, p)))
    };
    let lines = drawn.iter().map(|(p, _)| anchored(*p)).collect();
    Correspondences::Anchored { pencils, lines }
}

/// All queries of a file.
pub(crate) fn read(path: impl AsRef<std::path::Path>) -> Result<Vec<Query>, Failure> {
    let file = BufReader::new(flate2::read::MultiGzDecoder::new(std::fs::File::open(path)?));
    file.lines().map(|line| query(&serde_json::from_str(&line?)?)).collect()
}

fn query(line: &Value) -> Result<Query, Failure> {
    let numbers = |v: &Value| -> Vec<f64> {
        v.as_array().map(|a| a.iter().filter_map(Value::as_f64).collect()).unwrap_or_default()
    };
    let rows = |v: &Value| -> Vec<Vec<f64>> {
        v.as_array().map(|a| a.iter().map(numbers).collect()).unwrap_or_default()
    };
    let size = |key: &str| line["camera"][key].as_u64().ok_or("camera without size");
    let model = line["camera"]["model"].as_str().ok_or("camera without model")?;
    let camera = Intrinsics::new(
        model,
        size("width")? as u32,
        size("height")? as u32,
        &numbers(&line["camera"]["params"]),
    )?;
    let pose = &line["cam_from_world"];
    let (q, t) = (numbers(&pose["q"]), numbers(&pose["t"]));
    let truth = CameraFromWorld::from_quaternion(q.as_slice().try_into()?, t.as_slice().try_into()?)
        .ok_or("bad pose")?;
    let mut known = BTreeMap::new();
    let keypoints = rows(&line["points2d"])
        .iter()
        .map(|p| {
            let next = known.len();
            *known.entry([p[0].to_bits(), p[1].to_bits()]).or_insert(next)
        })
        .collect();
    let pixels = rows(&line["points2d"])
        .iter()
        .map(|p| camera.undistort_pixel(Pixel::new(p[0], p[1])).ok_or("pixel without ray"))
        .collect::<Result<_, _>>()?;
    let points: Vec<_> = rows(&line["points3d"]).iter().map(|p| Point3::new(p[0], p[1], p[2])).collect();
    let of = |key: &str| numbers(&line[key]);
    let (ratio, votes, track_length) = (of("ratio"), of("votes"), of("track_length"));
    let count = |list: &[f64], i: usize| list.get(i).map(|c| *c as u32);
    let evidence = (0..points.len())
        .map(|i| MatchEvidence {
            ratio: ratio.get(i).copied().unwrap_or(1.0),
            votes: count(&votes, i),
            track_length: count(&track_length, i),
        })
        .collect();
    Ok(Query { camera: camera.pinhole(), pixels, keypoints, points, truth, evidence })
}
