//! Generates problems for the minimal solvers, solves and times them, and writes problems and poses.
//!
//! ```text
//! cargo run --release -p veiloc-benches --bin solver_benchmark -- --family N [--problems 100000] [--passes 3] [--out
//! DIR] ```
//!
//! `study poses solvers` runs this program and PoseLib alternately on the same problems and evaluates both in the
//! same way. With `--out` it writes `problems.f64` (per problem: the vectors of `size` bearings or lines, `size` map
//! points, down in camera and world, true rotation row by row, true translation) and `poses.f64` (per pose: number of
//! the problem, rotation, translation). Time is per problem, the sum over chunks of 500 of each chunk's fastest pass.
#![expect(clippy::print_stdout, reason = "a program whose output is its result")]

use std::hint::black_box;
use std::io::Write;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use veiloc_benches::samples::{FIVE_AND_ONE, Layout, Lines, Sample, Samples, THREE_AND_THREE};
use veiloc_geometry::nalgebra::{Matrix3, Rotation3, Vector2, Vector3};
use veiloc_geometry::{CameraFromWorld, Rigid3};
use veiloc_pose::solvers::{
    ArrayVec, GravityAlignment, p3p, p5lp_radial, p6lp, p6lp_dual_radial, u4lp, up2p,
};

type Failure = Box<dyn std::error::Error>;

#[derive(Debug, Clone, Copy, PartialEq)]
enum Solver {
    P3p,
    P6lp,
    DualRadial,
    Radial,
    U4lp,
    Up2p,
}

/// One family of problems for one solver, and PoseLib's counterpart.
struct Family {
    solver: Solver,
    name: &'static str,
    layout: Layout,
    lines: Lines,
    /// Order in which PoseLib gets the matches.
    order: [usize; 6],
}

const AS_MADE: [usize; 6] = [0, 1, 2, 3, 4, 5];
/// PoseLib's `p6lp` eliminates the translation through its first three lines, so they must not share an anchor.
const SIXTH_THIRD: [usize; 6] = [0, 1, 5, 2, 3, 4];

const fn family(solver: Solver, name: &'static str, layout: Layout, lines: Lines) -> Family {
    let order = if matches!(solver, Solver::DualRadial) { SIXTH_THIRD } else { AS_MADE };
    Family { solver, name, layout, lines, order }
}

const FAMILIES: &[Family] = &[
    family(Solver::P3p, "general", Layout::General, Lines::Random),
    family(Solver::P3p, "near-planar", Layout::NearPlanar, Lines::Random),
    family(Solver::P3p, "narrow", Layout::Narrow, Lines::Random),
    family(Solver::P6lp, "random lines", Layout::General, Lines::Random),
    family(Solver::P6lp, "dcl 3+3, in turns", Layout::General, THREE_AND_THREE),
    family(Solver::P6lp, "dcl, any order", Layout::General, Lines::AnchoredAnywhere),
    family(Solver::P6lp, "near-planar", Layout::NearPlanar, Lines::Random),
    family(Solver::P6lp, "narrow", Layout::Narrow, Lines::Random),
    family(Solver::P6lp, "five nearly concurrent", Layout::NearConcurrent, Lines::Random),
    family(Solver::DualRadial, "dcl 5+1", Layout::General, FIVE_AND_ONE),
    family(Solver::DualRadial, "near-planar", Layout::NearPlanar, FIVE_AND_ONE),
    family(Solver::DualRadial, "narrow", Layout::Narrow, FIVE_AND_ONE),
    family(Solver::Radial, "five of one anchor", Layout::General, FIVE_AND_ONE),
    family(Solver::U4lp, "random lines", Layout::General, Lines::Random),
    family(Solver::U4lp, "dcl, in turns", Layout::General, THREE_AND_THREE),
    family(Solver::U4lp, "near-planar", Layout::NearPlanar, Lines::Random),
    family(Solver::U4lp, "narrow", Layout::Narrow, Lines::Random),
    family(Solver::Up2p, "general", Layout::General, Lines::Random),
    family(Solver::Up2p, "narrow", Layout::Narrow, Lines::Random),
];

impl Solver {
    /// Name of our solver, the PoseLib solver to compare with, and the sample size of the latter.
    fn names(self) -> (&'static str, &'static str, usize) {
        match self {
            Self::P3p => ("p3p", "p3p", 3),
            Self::P6lp => ("p6lp", "p6lp", 6),
            Self::DualRadial => ("p6lp_dual_radial", "p6lp", 6),
            Self::Radial => ("p5lp_radial", "p5lp_radial", 5),
            // PoseLib has no counterpart: it gets the same scene with two more lines instead of the vertical.
            Self::U4lp => ("u4lp", "p6lp", 6),
            Self::Up2p => ("up2p", "up2p", 2),
        }
    }
}

fn main() -> Result<(), Failure> {
    let (mut number, mut problems, mut passes, mut out) = (None, 100_000, 3, None);
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        let value = words.next().ok_or("every option takes a value")?;
        match word.as_str() {
            "--family" => number = Some(value.parse::<usize>()?),
            "--problems" => problems = value.parse()?,
            "--passes" => passes = value.parse()?,
            "--out" => out = Some(PathBuf::from(value)),
            _ => return Err(format!("unknown option {word}").into()),
        }
    }
    let Some(number) = number else {
        println!("{}", FAMILIES.len());
        return Ok(());
    };
    let family = FAMILIES.get(number).ok_or("no such family")?;
    // Six lines of one anchor determine no pose, so they are not drawn.
    let drawn = |s: &Sample| {
        family.lines != Lines::AnchoredAnywhere
            || !s.half_planes.iter().all(|h| h.axis == s.half_planes[0].axis)
    };
    let samples: Vec<Sample> = Samples::new(1000 + number as u64, family.layout, family.lines)
        .filter(drawn)
        .take(problems)
        .collect();
    let (nanoseconds, poses) = solve(family.solver, &samples, passes);
    let (solver, rival, size) = family.solver.names();
    println!(
        r#"{{"solver": "{solver}", "rival": "{rival}", "problems": "{}", "size": {size}, "count": {}, "ns": {nanoseconds}}}"#,
        family.name,
        samples.len(),
    );
    if let Some(directory) = out {
        std::fs::create_dir_all(&directory)?;
        write(directory.join("problems.f64"), samples.iter().flat_map(|s| row(family, s, size)))?;
        write(directory.join("poses.f64"), poses.into_iter().flatten())?;
    }
    Ok(())
}

/// Time per problem, and all poses as rows of thirteen numbers.
fn solve(solver: Solver, samples: &[Sample], passes: usize) -> (f64, Vec<[f64; 13]>) {
    match solver {
        Solver::P3p => {
            let made = samples.iter().map(|s| (first::<_, 3>(&s.bearings), first::<_, 3>(&s.points)));
            run(made, passes, |(bearings, points), out| {
                p3p(bearings, points, out);
            })
        }
        Solver::P6lp => run(samples.iter().map(|s| (s.lines, s.points)), passes, |(lines, points), out| {
            p6lp(lines, points, out);
        }),
        Solver::DualRadial => {
            let made = samples.iter().map(|s| {
                let inward = first::<_, 5>(&s.half_planes).map(|h| h.inward);
                (s.half_planes[0].axis, inward, s.half_planes[5], s.points)
            });
            run(made, passes, |(anchor, inward, sixth, points), out| {
                p6lp_dual_radial(anchor, inward, sixth, points, out);
            })
        }
        Solver::Radial => {
            let made = samples.iter().map(|s| (directions(s), first::<_, 5>(&s.points)));
            run_any(
                made,
                passes,
                |(directions, points), out: &mut ArrayVec<_, 4>| {
                    p5lp_radial(directions, points, out);
                },
                |p| Rigid3::new(p.rotation, Vector3::new(p.offset.x, p.offset.y, 0.0)),
            )
        }
        Solver::U4lp => {
            let made =
                samples.iter().map(|s| (first::<_, 4>(&s.lines), first::<_, 4>(&s.points), gravity(s)));
            run(made, passes, |(lines, points, gravity), out| {
                u4lp(lines, points, gravity, out);
            })
        }
        Solver::Up2p => {
            let made =
                samples.iter().map(|s| (first::<_, 2>(&s.bearings), first::<_, 2>(&s.points), gravity(s)));
            run(made, passes, |(bearings, points, gravity), out| {
                up2p(bearings, points, gravity, out);
            })
        }
    }
}

fn run<S, const N: usize>(
    samples: impl Iterator<Item = S>,
    passes: usize,
    solve: impl Fn(&S, &mut ArrayVec<CameraFromWorld, N>),
) -> (f64, Vec<[f64; 13]>) {
    run_any(samples, passes, solve, |p| *p)
}

fn run_any<S, P, const N: usize>(
    samples: impl Iterator<Item = S>,
    passes: usize,
    solve: impl Fn(&S, &mut ArrayVec<P, N>),
    pose: impl Fn(&P) -> CameraFromWorld,
) -> (f64, Vec<[f64; 13]>) {
    let samples: Vec<S> = samples.collect();
    let mut out = ArrayVec::new();
    let mut total = Duration::ZERO;
    for chunk in samples.chunks(500) {
        let fastest = (0..passes).map(|_| {
            let start = Instant::now();
            for sample in chunk {
                out.clear();
                solve(black_box(sample), &mut out);
                black_box(&out);
            }
            start.elapsed()
        });
        total += fastest.min().unwrap_or_default();
    }
    let mut rows = Vec::new();
    for (number, sample) in samples.iter().enumerate() {
        out.clear();
        solve(sample, &mut out);
        rows.extend(out.iter().map(|p| {
            let mut row = [number as f64; 13];
            row[1..].copy_from_slice(&twelve(&pose(p)));
            row
        }));
    }
    (total.as_nanos() as f64 / samples.len().max(1) as f64, rows)
}

/// The input of PoseLib's solver for a problem, and the true pose.
fn row(family: &Family, s: &Sample, size: usize) -> Vec<f64> {
    let mut row = Vec::with_capacity(6 * size + 18);
    for &i in &family.order[..size] {
        let vector = match family.solver {
            Solver::P3p | Solver::Up2p => s.bearings[i],
            Solver::Radial => {
                let u = directions(s)[i].normalize();
                Vector3::new(-u.y, u.x, 0.0)
            }
            _ => *s.lines[i].normal(),
        };
        row.extend(vector.iter());
    }
    for &i in &family.order[..size] {
        row.extend(s.points[i].coords.iter());
    }
    row.extend(s.down_in_camera.iter().chain(&s.down_in_world));
    let truth = if family.solver == Solver::Radial {
        let turn = turn_of(s);
        let t = turn * s.truth.translation();
        Rigid3::new(turn * s.truth.rotation(), Vector3::new(t.x, t.y, 0.0))
    } else {
        s.truth
    };
    row.extend(twelve(&truth));
    row
}

/// Rotation row by row, then translation.
fn twelve(pose: &CameraFromWorld) -> [f64; 12] {
    let (r, t): (&Matrix3<f64>, _) = (pose.rotation().matrix(), pose.translation());
    std::array::from_fn(|k| if k < 9 { r[(k / 3, k % 3)] } else { t[k - 9] })
}

fn write(path: PathBuf, numbers: impl Iterator<Item = f64>) -> std::io::Result<()> {
    let mut file = std::io::BufWriter::new(std::fs::File::create(path)?);
    for number in numbers {
        file.write_all(&number.to_le_bytes())?;
    }
    file.flush()
}

fn first<T: Copy, const N: usize>(all: &[T; 6]) -> [T; N] {
    std::array::from_fn(|i| all[i])
}

fn gravity(s: &Sample) -> GravityAlignment {
    GravityAlignment::new(&s.down_in_camera, &s.down_in_world).expect("unit vectors")
}

/// The rotation that makes the ray of the first match's anchor the optical axis.
fn turn_of(s: &Sample) -> Rotation3<f64> {
    Rotation3::rotation_between(&s.half_planes[0].axis, &Vector3::z()).expect("not opposite")
}

/// Directions of the first five half-lines in that rotated camera.
fn directions(s: &Sample) -> [Vector2<f64>; 5] {
    let turn = turn_of(s);
    first::<_, 5>(&s.half_planes).map(|h| (turn * h.inward).xy())
}
