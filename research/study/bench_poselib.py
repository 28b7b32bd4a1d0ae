#!/usr/bin/env python3
"""Benchmarks our minimal solvers against PoseLib's: the same problems, in alternating rounds, with the same criteria.

For each family of problems, `solver_benchmark` (crate veiloc-benches) generates and solves the problems and writes both; here
PoseLib's C++ functions solve the same problems. A small C loop, compiled by this script, calls them in the shared object of the
`poselib` wheel, so the time of Python is not measured. Each side's time is the sum over chunks of 500 problems of the fastest pass over
the chunk, and the smallest of all rounds.

u4lp and p6lp_dual_radial have no counterpart in PoseLib. They are compared with its p6lp on the same scene; for u4lp this means two
more lines instead of the vertical. PoseLib's p6lp eliminates the translation with its first three lines; dual-radial samples are
ordered so that this works, and "any order" shows the other case. PoseLib's up2p rotates both verticals for every sample; ours
rotates them once for all samples.

Criteria for both sides:
  poses     returned per problem
  valid     share of the returned poses that fulfil the equations and have every point in front of the camera (on its half-line for
            p5lp_radial). PoseLib's line solvers leave this check to the caller
  truth     share of the problems with a pose within 1e-6 of the true one, and within 1e-3:
            ||R - R_true|| + ||t - t_true||, with map points one to eight units away

    python3 -m venv .venv && .venv/bin/pip install numpy poselib==2.0.5
    cargo build --release -p veiloc-benches --bin solver_benchmark
    .venv/bin/python research/study/bench_poselib.py [--problems 100000] [--rounds 5] [--only WORD] [--csv FILE]
"""

import argparse
import ctypes
import json
import os
import subprocess
import tempfile
from pathlib import Path

import numpy as np
import poselib

from places import write_csv

SHIM = r"""
#include <stdint.h>
#include <time.h>

/* std::vector<T>: begin, end, end of capacity. Eigen::Vector3d: three doubles. */
typedef struct { char *begin, *end, *room; } vector;
typedef int (*solver)(const vector *, const vector *, vector *);
typedef int (*gravity_solver)(const vector *, const vector *, const double *, const double *, vector *);

static vector view(const double *at, int n) {
    vector v = {(char *)at, (char *)(at + 3 * n), (char *)(at + 3 * n)};
    return v;
}

static int one(void *f, int gravity, const double *row, int n, vector *out) {
    vector x = view(row, n), points = view(row + 3 * n, n);
    out->end = out->begin;
    return gravity ? ((gravity_solver)f)(&x, &points, row + 6 * n, row + 6 * n + 3, out)
                   : ((solver)f)(&x, &points, out);
}

/* Nanoseconds of `passes` passes over `count` problems: each chunk's fastest, summed. */
double measure(void *f, int gravity, const double *rows, long count, int n, int passes) {
    static vector out;
    double total = 0.0;
    long stride = 6 * n + 18;
    for (long from = 0; from < count; from += 500) {
        long to = from + 500 < count ? from + 500 : count;
        double best = 1e300;
        for (int pass = 0; pass < passes; pass++) {
            struct timespec a, b;
            clock_gettime(CLOCK_MONOTONIC, &a);
            for (long i = from; i < to; i++)
                one(f, gravity, rows + i * stride, n, &out);
            clock_gettime(CLOCK_MONOTONIC, &b);
            double ns = 1e9 * (double)(b.tv_sec - a.tv_sec) + (double)(b.tv_nsec - a.tv_nsec);
            best = ns < best ? ns : best;
        }
        total += best;
    }
    return total;
}

/* Rows of (problem, q, t) in `poses`; returns their number. The size of a pose follows from the vector. */
long solve(void *f, int gravity, const double *rows, long count, int n, double *poses, long room) {
    static vector out;
    long stride = 6 * n + 18, filled = 0;
    for (long i = 0; i < count; i++) {
        one(f, gravity, rows + i * stride, n, &out);
        /* Quaternion and translation, padded to the alignment of the quaternion. */
        for (char *at = out.begin; at < out.end && filled < room; at += SIZE_OF_POSE, filled++) {
            poses[8 * filled] = (double)i;
            for (int k = 0; k < 7; k++) poses[8 * filled + 1 + k] = ((double *)at)[k];
        }
    }
    return filled;
}

/* Bytes of what one problem returned. */
long bytes(void *f, int gravity, const double *row, int n) {
    static vector out;
    one(f, gravity, row, n, &out);
    return out.end - out.begin;
}
"""

V3 = "RKSt6vectorIN5Eigen6MatrixIdLi3ELi1ELi0ELi3ELi1EEESaIS3_EES7_"
POSES = "PS0_INS_10CameraPoseESaI{}_EE"
SYMBOLS = {
    "p3p": "_ZN7poselib3p3pE" + V3 + POSES.format("S8"),
    "p6lp": "_ZN7poselib4p6lpE" + V3 + POSES.format("S8"),
    "p5lp_radial": "_ZN7poselib11p5lp_radialE" + V3 + POSES.format("S8"),
    "up2p": "_ZN7poselib4up2pE" + V3 + "RKS3_S9_" + POSES.format("SA"),
}


class Rival:
    """PoseLib's functions in the wheel's shared object."""

    def __init__(self, folder):
        library = ctypes.CDLL(poselib._core.__file__)
        self.functions = {name: ctypes.cast(library[symbol], ctypes.c_void_p) for name, symbol in SYMBOLS.items()}
        # The first call finds the size of a pose, which depends on the compiler's alignment; the second uses it.
        probe = self.compile(folder, 64)
        self.size_of_pose = self.probe(probe)
        self.shim = self.compile(folder, self.size_of_pose)

    @staticmethod
    def compile(folder, size_of_pose):
        source, target = os.path.join(folder, "shim.c"), os.path.join(folder, f"shim{size_of_pose}.so")
        with open(source, "w") as file:
            file.write(SHIM)
        subprocess.run(
            ["cc", "-O2", "-shared", "-fPIC", f"-DSIZE_OF_POSE={size_of_pose}", source, "-o", target], check=True)
        shim = ctypes.CDLL(target)
        pointer, number = np.ctypeslib.ndpointer(np.float64, flags="C"), ctypes.c_long
        shim.measure.restype = ctypes.c_double
        shim.measure.argtypes = [ctypes.c_void_p, ctypes.c_int, pointer, number, ctypes.c_int, ctypes.c_int]
        shim.solve.restype = number
        shim.solve.argtypes = [ctypes.c_void_p, ctypes.c_int, pointer, number, ctypes.c_int, pointer, number]
        shim.bytes.restype = number
        shim.bytes.argtypes = [ctypes.c_void_p, ctypes.c_int, pointer, ctypes.c_int]
        return shim

    def probe(self, shim):
        rng = np.random.default_rng(1)
        while True:
            x = rng.uniform([-0.6, -0.4, 1], [0.6, 0.4, 1], size=(3, 3))
            points = x * rng.uniform(1, 8, size=(3, 1))
            x /= np.linalg.norm(x, axis=1, keepdims=True)
            poses = len(poselib.p3p(x, points))
            if poses > 1:
                row = np.concatenate([x.ravel(), points.ravel(), np.zeros(18)])
                size = shim.bytes(self.functions["p3p"], 0, row, 3) / poses
                assert size in (56, 64, 96), f"a pose of {size} bytes"
                return int(size)

    def measure(self, name, rows, size, passes):
        return self.shim.measure(self.functions[name], name == "up2p", rows, len(rows), size, passes) / len(rows)

    def solve(self, name, rows, size):
        """Rows of (problem, R row by row, t)."""
        found = np.empty((9 * len(rows), 8))
        found = found[:self.shim.solve(
            self.functions[name], name == "up2p", rows, len(rows), size, found, len(found))]
        w, x, y, z = found[:, 1:5].T
        rotation = np.stack([
            w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y),
            2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x),
            2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z], axis=1)
        return np.column_stack([found[:, 0], rotation, found[:, 5:8]])


def judge(rows, size, poses, solver):
    """Poses per problem, share of valid poses, share of true poses found within 1e-6 and within 1e-3."""
    count = len(rows)
    # u4lp gets only the first four of the six lines of PoseLib's p6lp.
    used = 4 if solver == "u4lp" else size
    vectors = rows[:, :3 * size].reshape(count, size, 3)[:, :used]
    points = rows[:, 3 * size:6 * size].reshape(count, size, 3)[:, :used]
    truth = rows[:, 6 * size + 6:]
    problem = poses[:, 0].astype(int)
    r, t = poses[:, 1:10].reshape(-1, 3, 3), poses[:, 10:].copy()
    if solver == "p5lp_radial":
        t[:, 2] = 0
    with np.errstate(all="ignore"):
        error = np.linalg.norm(poses[:, 1:10] - truth[problem, :9], axis=1)
        error += np.linalg.norm(t - truth[problem, 9:], axis=1)
        best = np.full(count, np.inf)
        np.fmin.at(best, problem, error)
        seen = np.einsum("nij,nkj->nki", r, points[problem]) + t[:, None, :]
        v = vectors[problem]
        length = np.linalg.norm(seen, axis=2)
        if solver in ("p3p", "up2p"):
            off = np.linalg.norm(np.cross(v, seen), axis=2)
            front = np.sum(v * seen, axis=2) > 0
        elif solver == "p5lp_radial":
            off = np.abs(np.sum(v * seen, axis=2))
            front = v[:, :, 1] * seen[:, :, 0] - v[:, :, 0] * seen[:, :, 1] > 0
        else:
            off = np.abs(np.sum(v * seen, axis=2))
            front = seen[:, :, 2] > 0
        orthonormal = np.abs(r @ r.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2)) < 1e-6
        valid = np.all((off < 1e-6 * (1 + length)) & front, axis=1) & orthonormal
    return {
        "poses": len(poses) / count,
        "valid": float(valid.mean()) if len(poses) else float("nan"),
        "truth": float((best < 1e-6).mean()),
        "coarse": float((best < 1e-3).mean()),
    }


def ours(binary, family, problems, passes, out=None):
    words = [binary, "--family", str(family), "--problems", str(problems), "--passes", str(passes)]
    result = subprocess.run(words + (["--out", out] if out else []), check=True, capture_output=True, text=True)
    return json.loads(result.stdout)


COLUMNS = [
    "solver", "PoseLib solver", "problems", "poses", "poses, PoseLib", "valid (%)", "valid, PoseLib (%)", "truth at 1e-6 (%)",
    "truth at 1e-6, PoseLib (%)", "truth at 1e-3 (%)", "truth at 1e-3, PoseLib (%)", "time (ns)", "time, PoseLib (ns)",
    "time over PoseLib",
]  # fmt: skip


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--problems", type=int, default=100_000)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--passes", type=int, default=3)
    parser.add_argument("--only", default="", help="only families whose solver or problems contain this text")
    parser.add_argument("--binary", default=os.path.join(
        os.environ.get("CARGO_TARGET_DIR", "target"), "release", "solver_benchmark"))
    parser.add_argument("--csv", type=Path)
    options = parser.parse_args()
    families = int(subprocess.run([options.binary], check=True, capture_output=True, text=True).stdout)
    results = []
    with tempfile.TemporaryDirectory() as folder:
        rival = Rival(folder)
        for family in range(families):
            about = ours(options.binary, family, 1, 1)
            if options.only not in about["solver"] + " " + about["problems"]:
                continue
            about = ours(options.binary, family, options.problems, 1, folder)
            size, name = about["size"], about["rival"]
            rows = np.fromfile(os.path.join(folder, "problems.f64")).reshape(-1, 6 * size + 18)
            poses = np.fromfile(os.path.join(folder, "poses.f64")).reshape(-1, 13)
            times = [], []
            for _ in range(options.rounds):
                times[0].append(ours(options.binary, family, options.problems, options.passes)["ns"])
                times[1].append(rival.measure(name, rows, size, options.passes))
            about["ns"], about["ns_poselib"] = min(times[0]), min(times[1])
            about["ratio"] = about["ns"] / about["ns_poselib"]
            about["ours"] = judge(rows, size, poses, about["solver"])
            about["poselib"] = judge(rows, size, rival.solve(name, rows, size), name)
            results.append(row(about))
            print(*results[-1], sep="  ", flush=True)
    write_csv(options.csv, COLUMNS, results)


def row(about):
    a, b = about["ours"], about["poselib"]
    both = lambda key, factor, form: [format(factor * a[key], form), format(factor * b[key], form)]
    return [f"`{about['solver']}`", f"`{about['rival']}`", about["problems"], *both("poses", 1, ".2f"), *both("valid", 100, ".2f"),
            *both("truth", 100, ".3f"), *both("coarse", 100, ".3f"), f"{about['ns']:.0f}", f"{about['ns_poselib']:.0f}",
            f"{about['ratio']:.2f}"]  # fmt: skip


if __name__ == "__main__":
    main()
