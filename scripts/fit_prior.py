#!/usr/bin/env python3
"""Fits the match prior: a logistic regression on descriptor ratio, votes and track length.

Reads problems.jsonl.gz files. A match is right when its map point reprojects within 4 px of the keypoint under the true pose. Fits by
Newton's method with equal weight for every file, and prints the coefficients and the mean log loss on each file. The coefficients in
the program come from held-out map images, never from queries:

    scripts/training_problems.sh train
    python3 scripts/fit_prior.py --fit train/lund-door.jsonl.gz train/herzjesu.jsonl.gz --check train/redkitchen.jsonl.gz
"""

import argparse
import gzip
import json

import numpy as np

import sys
from pathlib import Path
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "research"))
from study.geometry import rotation

RIGHT_WITHIN_PX = 4.0


def load(path):
    """Evidence `[matches, 3]` (ratio, ln votes, ln track length) and whether each match is right `[matches]`."""
    evidence, right = [], []
    with gzip.open(path, "rt") as lines:
        for line in lines:
            d = json.loads(line)
            assert d["camera"]["model"] == "PINHOLE", "the problems hold undistorted pixels of a pinhole camera"
            fx, fy, cx, cy = d["camera"]["params"]
            pose = d["cam_from_world"]
            p = np.array(d["points3d"]) @ rotation(pose["q"]).T + np.array(pose["t"])
            seen = np.column_stack([fx * p[:, 0] / p[:, 2] + cx, fy * p[:, 1] / p[:, 2] + cy])
            error = np.linalg.norm(seen - np.array(d["points2d"]), axis=1)
            right.append((p[:, 2] > 0) & (error < RIGHT_WITHIN_PX))
            evidence.append(np.column_stack([d["ratio"], np.log(d["votes"]), np.log(d["track_length"])]))
    return np.vstack(evidence), np.concatenate(right)


def fit(designs, ridge=1e-3):
    a = np.vstack([d for d, _ in designs])
    y = np.concatenate([right for _, right in designs])
    weight = np.concatenate([np.full(len(right), 1 / len(right)) for _, right in designs])
    weight *= len(weight) / weight.sum()
    w = np.zeros(a.shape[1])
    for _ in range(50):
        p = 1 / (1 + np.exp(-a @ w))
        gradient = a.T @ (weight * (p - y)) + ridge * w
        hessian = (a * (weight * p * (1 - p))[:, None]).T @ a + ridge * np.eye(len(w))
        step = np.linalg.solve(hessian, gradient)
        w -= step
        if np.abs(step).max() < 1e-10:
            break
    return w


def log_loss(a, y, w):
    z = a @ w
    return float(np.mean(np.logaddexp(0, z) - y * z))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--fit", nargs="+", required=True, metavar="FILE")
    parser.add_argument("--check", nargs="*", default=[], metavar="FILE")
    arguments = parser.parse_args()
    files = [load(path) for path in arguments.fit + arguments.check]
    for name, columns in [("RATIO", 1), ("RATIO_VOTES", 2), ("FULL", 3)]:
        designs = [(np.column_stack([np.ones(len(e)), e[:, :columns]]), y) for e, y in files]
        w = fit(designs[: len(arguments.fit)])
        losses = ", ".join(f"{log_loss(a, y, w):.4f}" for a, y in designs)
        print(f"{name:12s} {np.array2string(w, precision=3)}  log loss {losses}")


if __name__ == "__main__":
    main()
