//! Minimal solvers, time per sample. `p6lp` on the same scenes is the reference for the solvers that replace it.
//!
//! ```text
//! cargo bench -p veiloc-benches --bench solvers
//! ```
//!
//! Each iteration solves another of 8192 samples, so that branches stay unpredictable. For a comparison with PoseLib
//! see `study poses solvers`.

use std::cell::Cell;

use divan::Bencher;
use veiloc_benches::samples::{FIVE_AND_ONE, Layout, Lines, Sample, Samples, THREE_AND_THREE};
use veiloc_geometry::nalgebra::{Rotation3, Vector3};
use veiloc_pose::solvers::{
    ArrayVec, GravityAlignment, p3p, p5lp_radial, p6lp, p6lp_dual_radial, u4lp, up2p,
};

const SAMPLES: usize = 8192;

fn main() {
    divan::main();
}

/// Solves the samples in turn.
fn each<S>(bencher: Bencher, lines: Lines, prepare: impl Fn(&Sample) -> S, solve: impl Fn(&S) -> usize) {
    let samples: Vec<S> =
        Samples::new(1, Layout::General, lines).take(SAMPLES).map(|s| prepare(&s)).collect();
    let next = Cell::new(0);
    bencher.bench_local(|| {
        next.set((next.get() + 1) % SAMPLES);
        solve(&samples[next.get()])
    });
}

fn first<T: Copy, const N: usize>(all: &[T; 6]) -> [T; N] {
    std::array::from_fn(|i| all[i])
}

fn gravity(s: &Sample) -> GravityAlignment {
    GravityAlignment::new(&s.down_in_camera, &s.down_in_world).expect("unit vectors")
}

fn lines_of(kind: &str) -> Lines {
    match kind {
        "dcl 5+1" => FIVE_AND_ONE,
        "dcl 3+3" => THREE_AND_THREE,
        _ => Lines::Random,
    }
}

#[divan::bench(sample_size = 1024)]
fn p3p_sample(bencher: Bencher) {
    let prepare = |s: &Sample| (first(&s.bearings), first(&s.points));
    each(bencher, Lines::Random, prepare, |(bearings, points)| p3p(bearings, points, &mut ArrayVec::new()));
}

#[divan::bench(sample_size = 1024)]
fn up2p_sample(bencher: Bencher) {
    let prepare = |s: &Sample| (first(&s.bearings), first(&s.points), gravity(s));
    each(bencher, Lines::Random, prepare, |(bearings, points, gravity)| {
        up2p(bearings, points, gravity, &mut ArrayVec::new())
    });
}

#[divan::bench(sample_size = 1024, args = ["random lines", "dcl 3+3", "dcl 5+1"])]
fn p6lp_sample(bencher: Bencher, kind: &str) {
    each(
        bencher,
        lines_of(kind),
        |s| (s.lines, s.points),
        |(lines, points)| p6lp(lines, points, &mut ArrayVec::new()),
    );
}

#[divan::bench(sample_size = 1024, args = ["random lines", "dcl 3+3"])]
fn u4lp_sample(bencher: Bencher, kind: &str) {
    let prepare = |s: &Sample| (first(&s.lines), first(&s.points), gravity(s));
    each(bencher, lines_of(kind), prepare, |(lines, points, gravity)| {
        u4lp(lines, points, gravity, &mut ArrayVec::new())
    });
}

#[divan::bench(sample_size = 1024)]
fn p6lp_dual_radial_sample(bencher: Bencher) {
    let prepare = |s: &Sample| {
        let inward = first(&s.half_planes).map(|h| h.inward);
        (s.half_planes[0].axis, inward, s.half_planes[5], s.points)
    };
    each(bencher, FIVE_AND_ONE, prepare, |(anchor, inward, sixth, points)| {
        p6lp_dual_radial(anchor, inward, sixth, points, &mut ArrayVec::new())
    });
}

#[divan::bench(sample_size = 1024)]
fn p5lp_radial_sample(bencher: Bencher) {
    let prepare = |s: &Sample| {
        let ray = s.half_planes[0].axis;
        let turn = Rotation3::rotation_between(&ray, &Vector3::z()).expect("not opposite");
        let turned = |v: Vector3<f64>| (turn * v).xy();
        (first(&s.half_planes).map(|h| turned(h.inward)), first(&s.points))
    };
    each(bencher, FIVE_AND_ONE, prepare, |(directions, points)| {
        p5lp_radial(directions, points, &mut ArrayVec::new())
    });
}
