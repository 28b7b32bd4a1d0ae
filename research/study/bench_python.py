#!/usr/bin/env python3
"""Overhead of a call from Python: our Python call, our Rust call and PoseLib's Python call on the same problems.

    python research/study/bench_python.py RUST [--correspondences 1000] [--problems 40] [--rounds 7]

Needs `veiloc` and `poselib`. `RUST` is the program that `cargo build --release -p veiloc-benches --bin time_poses` builds. Problems
are points with noise of 0.5 px and 30 % outliers. Each round times every problem once with each method. A problem's time is its
fastest; ratios are those of the sums.
"""

import argparse
import subprocess
import tempfile
import time

import numpy as np
import poselib

import veiloc

CAMERA = {"model": "PINHOLE", "width": 640, "height": 480, "params": [525.0, 525.0, 320.0, 240.0]}


def problem(rng, count):
    """Pixels `[N, 2]` and points `[N, 3]`."""
    q, t = rng.normal(size=4), rng.normal(size=3)
    pose = veiloc.CameraPose(q, t)
    pixels = rng.uniform([0, 0], [640, 480], (count, 2))
    rays = np.column_stack([(pixels - [320, 240]) / 525, np.ones(count)])
    points = (rays * rng.uniform(2, 8, (count, 1)) - t) @ pose.R
    pixels += rng.normal(scale=0.5, size=pixels.shape)
    wrong = rng.permutation(count)[: int(0.3 * count)]
    pixels[wrong] = rng.uniform([0, 0], [640, 480], (len(wrong), 2))
    return pixels, points


def timed(call, problems):
    """Milliseconds of each problem."""
    times = []
    for pixels, points in problems:
        began = time.perf_counter()
        call(pixels, points)
        times.append(1e3 * (time.perf_counter() - began))
    return np.array(times)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rust")
    parser.add_argument("--correspondences", type=int, default=1000)
    parser.add_argument("--problems", type=int, default=40)
    parser.add_argument("--rounds", type=int, default=7)
    args = parser.parse_args()
    rng = np.random.default_rng(0)
    problems = [problem(rng, args.correspondences) for _ in range(args.problems)]
    folder = tempfile.TemporaryDirectory()
    file = f"{folder.name}/problems.f64"
    np.concatenate([np.hstack(problem).ravel() for problem in problems]).astype("<f8").tofile(file)

    def rust():
        command = [args.rust, file, str(args.correspondences)]
        return np.array(subprocess.run(command, capture_output=True, text=True, check=True).stdout.split(), float)

    ways = {
        "rust": rust,
        "python": lambda: timed(lambda p, x: veiloc.estimate_absolute_pose(p, x, CAMERA), problems),
        "poselib": lambda: timed(
            lambda p, x: poselib.estimate_absolute_pose(p, x, CAMERA, {"max_reproj_error": 4.0}, {}), problems
        ),
    }
    best = {name: np.full(len(problems), np.inf) for name in ways}
    for _ in range(args.rounds):
        for name, way in ways.items():
            best[name] = np.minimum(best[name], way())
    for name, times in best.items():
        print(f"{name:<8} {times.mean():.3f} ms per call, {times.sum() / best['rust'].sum():.3f} x our Rust call")


if __name__ == "__main__":
    main()
