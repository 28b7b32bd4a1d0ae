//! Our solutions against those of PoseLib and of a brute-force scan, on the problems that `research/oracles/poses.py`
//! wrote to `data/poselib.json`.

use serde_json::Value;
use veiloc_geometry::nalgebra::{Matrix3, Vector2, Vector3};
use veiloc_geometry::{CameraFromWorld, PlaneLine, PlanePoint, Point3};
use veiloc_pose::solvers::{
    ArrayVec, GravityAlignment, HalfPlane, p3p, p5lp_radial, p6lp, p6lp_dual_radial, u4lp, up2p,
};

/// A pose as in the fixture; `t` has two numbers for radial ones.
type Pose = (Matrix3<f64>, Vec<f64>);

fn problems(solver: &str) -> Vec<Value> {
    let fixture: Value =
        serde_json::from_str(include_str!("../../data/solvers/poselib.json")).expect("valid JSON");
    fixture[solver].as_array().expect("problems").clone()
}

fn rows<const N: usize>(value: &Value) -> Vec<[f64; N]> {
    serde_json::from_value::<Vec<Vec<f64>>>(value.clone())
        .expect("rows of numbers")
        .into_iter()
        .map(|row| row.try_into().expect("rows of the right length"))
        .collect()
}

fn array<T, const N: usize, const K: usize>(value: &Value, make: impl Fn([f64; N]) -> T) -> [T; K] {
    rows::<N>(value).into_iter().map(make).collect::<Vec<T>>().try_into().ok().expect("a full sample")
}

fn poses(problem: &Value) -> Vec<Pose> {
    problem["poses"]
        .as_array()
        .expect("poses")
        .iter()
        .map(|pose| {
            let r: Vec<[f64; 3]> = rows(&pose["r"]);
            (Matrix3::from_fn(|i, j| r[i][j]), serde_json::from_value(pose["t"].clone()).expect("numbers"))
        })
        .collect()
}

fn plain(poses: &[CameraFromWorld]) -> Vec<Pose> {
    poses.iter().map(|p| (*p.rotation().matrix(), p.translation().iter().copied().collect())).collect()
}

fn gravity(problem: &Value) -> GravityAlignment {
    let down = |name: &str| -> Vector3<f64> {
        Vector3::from(serde_json::from_value::<[f64; 3]>(problem[name].clone()).expect("a direction"))
    };
    GravityAlignment::new(&down("down_in_camera"), &down("down_in_world")).expect("two directions")
}

/// Every pose of the oracle must be among ours, and hardly any of ours may be missing in the oracle.
fn compare(solver: &str, solve: impl Fn(&Value) -> Vec<Pose>) {
    let same = |a: &Pose, b: &Pose| {
        (a.0 - b.0).norm() < 1e-5 && a.1.iter().zip(&b.1).all(|(x, y)| (x - y).abs() < 1e-4 * (1.0 + y.abs()))
    };
    let (mut theirs, mut only_ours) = (0, 0);
    for (index, problem) in problems(solver).iter().enumerate() {
        let (expected, found) = (poses(problem), solve(problem));
        for pose in &expected {
            assert!(found.iter().any(|p| same(p, pose)), "{solver} {index}: {pose:?} is not among {found:?}");
        }
        theirs += expected.len();
        only_ours += found.iter().filter(|p| !expected.iter().any(|e| same(p, e))).count();
    }
    assert!(theirs >= 40, "{solver}: only {theirs} poses compared");
    assert!(only_ours * 50 <= theirs, "{solver}: {only_ours} poses that the oracle does not have");
}

#[test]
fn p3p_agrees_with_poselib() {
    compare("p3p", |problem| {
        let mut out = ArrayVec::new();
        let points = array(&problem["points"], |[x, y, z]| Point3::new(x, y, z));
        p3p(&array(&problem["bearings"], |b: [f64; 3]| Vector3::from(b)), &points, &mut out);
        plain(&out)
    });
}

#[test]
fn p6lp_agrees_with_poselib() {
    compare("p6lp", |problem| {
        let mut out = ArrayVec::new();
        let points = array(&problem["points"], |[x, y, z]| Point3::new(x, y, z));
        let lines =
            array(&problem["lines"], |l: [f64; 3]| PlaneLine::from_normal(Vector3::from(l)).expect("a line"));
        p6lp(&lines, &points, &mut out);
        plain(&out)
    });
}

#[test]
fn p5lp_radial_agrees_with_poselib() {
    compare("p5lp_radial", |problem| {
        let mut out = ArrayVec::new();
        let points = array(&problem["points"], |[x, y, z]| Point3::new(x, y, z));
        p5lp_radial(&array(&problem["directions"], |u: [f64; 2]| Vector2::from(u)), &points, &mut out);
        out.iter().map(|p| (*p.rotation.matrix(), p.offset.iter().copied().collect())).collect()
    });
}

#[test]
fn up2p_agrees_with_poselib() {
    compare("up2p", |problem| {
        let mut out = ArrayVec::new();
        let points = array(&problem["points"], |[x, y, z]| Point3::new(x, y, z));
        let bearings = array(&problem["bearings"], |b: [f64; 3]| Vector3::from(b));
        up2p(&bearings, &points, &gravity(problem), &mut out);
        plain(&out)
    });
}

#[test]
fn u4lp_agrees_with_a_scan_of_all_angles() {
    compare("u4lp", |problem| {
        let mut out = ArrayVec::new();
        let points = array(&problem["points"], |[x, y, z]| Point3::new(x, y, z));
        let lines =
            array(&problem["lines"], |l: [f64; 3]| PlaneLine::from_normal(Vector3::from(l)).expect("a line"));
        u4lp(&lines, &points, &gravity(problem), &mut out);
        plain(&out)
    });
}

#[test]
fn p6lp_dual_radial_agrees_with_poselibs_p6lp() {
    compare("p6lp_dual_radial", |problem| {
        let mut out = ArrayVec::new();
        let points = array(&problem["points"], |[x, y, z]| Point3::new(x, y, z));
        let [first, second] = array(&problem["anchors"], |[x, y]| PlanePoint::new(x, y));
        let [a, b, c, d, e, last] = array(&problem["directions"], |v: [f64; 2]| Vector2::from(v));
        let sixth = HalfPlane::of_half_line(second, last);
        let inward = [a, b, c, d, e].map(|v| HalfPlane::of_half_line(first, v).inward);
        p6lp_dual_radial(&first.homogeneous(), &inward, &sixth, &points, &mut out);
        plain(&out)
    });
}
