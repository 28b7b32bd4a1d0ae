#!/usr/bin/env python3
"""Benchmarks pose estimation against PoseLib's P3P LO-RANSAC: the same matches, one thread each, in alternating rounds.

PoseLib gets the keypoints and its own defaults (inlier threshold 4 px), because it has no robust estimator for lines; veiloc gets the
obfuscated keypoints of each scheme. A query's time is the fastest of all rounds. Recall is at the thresholds of the tables: 5 cm /
5 degrees on RedKitchen, 10 cm / 1 degree on Herz-Jesu.

    python3 -m venv .venv && .venv/bin/pip install numpy poselib==2.0.5
    cargo build --release
    .venv/bin/python research/study/bench_pose_stage.py --data $VEILOC_DATA --rounds 3 --csv docs/results/poses/time.csv

`--veiloc OLD,NEW` compares two builds: both run in every round, and their rows are numbered. Instead of `--data`, files of matches
may be named.
"""

import argparse
import gzip
import json
import os
import statistics
import subprocess
import tempfile
import time
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import poselib

from places import write_csv
from geometry import rotation

PROBLEMS = ["herzjesu_nn", "redkitchen_nn", "herzjesu_r08", "redkitchen_r08"]
COLUMNS = [
    "matches of", "pipeline", "matches (median)", "pose, median (ms)", "time over PoseLib", "median error (cm)", "recall (%)",
]  # fmt: skip
SCHEMES = ["points", "random-lines", "dcl"]


def ours(veiloc, file, seed):
    """For each scheme: milliseconds, translation error and rotation error of every query."""
    with tempfile.NamedTemporaryFile(suffix=".json") as out:
        subprocess.run(
            [veiloc, "-q", "eval", "pose", file, "--schemes", ",".join(SCHEMES), "--recipes", "default",
             "--seed", str(seed), "--json", out.name],
            check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )
        document = json.load(open(out.name))
    rows = {scheme: [] for scheme in SCHEMES}
    for query in document["queries"]:
        error = [query[key] if query[key] is not None else float("inf")
                 for key in ("translation_error", "rotation_error_deg")]
        rows[query["scheme"]].append((query["ms"]["pose"], *error))
    return {scheme: np.array(values) for scheme, values in rows.items()}


def theirs(problems):
    rows = []
    for problem in problems:
        camera = problem["camera"]
        points2d, points3d = np.array(problem["points2d"]), np.array(problem["points3d"])
        started = time.perf_counter()
        pose, _ = poselib.estimate_absolute_pose(points2d, points3d, camera, {"max_reproj_error": 4.0}, {})
        ms = 1e3 * (time.perf_counter() - started)
        truth = rotation(problem["cam_from_world"]["q"])
        center = -truth.T @ np.array(problem["cam_from_world"]["t"])
        turn = np.clip((np.trace(truth @ pose.R.T) - 1) / 2, -1, 1)
        rows.append((ms, np.linalg.norm(-pose.R.T @ pose.t - center), np.degrees(np.arccos(turn))))
    return np.array(rows)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("files", nargs="*", type=Path, help="matches as `problems` has them")
    parser.add_argument("--data", type=Path, help="measures the four files of this folder's `problems`")
    parser.add_argument("--csv", type=Path)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--veiloc", default="target/release/veiloc", help="the program, or several with commas")
    arguments = parser.parse_args()
    if not arguments.files and not arguments.data:
        parser.error("name files, or the folder of the data with --data")
    files = arguments.files or [arguments.data / f"problems/{name}.jsonl.gz" for name in PROBLEMS]
    programs = arguments.veiloc.split(",")
    number = {program: f" {i + 1}" if len(programs) > 1 else "" for i, program in enumerate(programs)}
    table = []
    for file in files:
        with gzip.open(file, "rt") as lines:
            problems = [json.loads(line) for line in lines]
        bounds = (0.05, 5.0) if file.name.startswith("redkitchen") else (0.1, 1.0)
        rounds = []
        for seed in range(arguments.rounds):
            found = {"PoseLib P3P, points": theirs(problems)}
            for program in programs:
                own = ours(program, file, seed)
                found |= {f"veiloc, {scheme}{number[program]}": own[scheme] for scheme in SCHEMES}
            rounds.append(found)
        size = np.median([len(p["points2d"]) for p in problems])
        baseline = None
        for name in rounds[0]:
            all_rounds = np.stack([r[name] for r in rounds])
            ms = float(np.median(all_rounds[:, :, 0].min(axis=0)))
            baseline = baseline or ms
            error = statistics.median(np.median(all_rounds[:, :, 1], axis=1))
            hits = (all_rounds[:, :, 1] <= bounds[0]) & (all_rounds[:, :, 2] <= bounds[1])
            table.append([file.name.split(".")[0], name, int(size), f"{ms:.2f}", f"{ms / baseline:.2f}", f"{100 * error:.2f}",
                          f"{100 * hits.mean():.1f}"])  # fmt: skip
            print(*table[-1], sep="  ", flush=True)
    write_csv(arguments.csv, COLUMNS, table)


if __name__ == "__main__":
    main()
