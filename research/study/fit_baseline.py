#!/usr/bin/env python3
"""Fits the answers from a single line alone (`crates/research/attacks/src/prior.rs`) on images of other places.

    veiloc eval keypoints $VEILOC_DATA/training-photos --list 400.txt -o photos.jsonl.gz
    research/study/fit_baseline.py photos.jsonl.gz

For each scheme and answer: the mean over images of the median error, relative to the image's diagonal, and the mean of log2 of
the error. The best answer of each column is the baseline of that measure. Needs NumPy.

    research/study/fit_baseline.py --csv docs/results/privacy/baseline.csv redkitchen=redkitchen.jsonl.gz herzjesu=herzjesu.jsonl.gz

compares these answers on the queries of places with the mean point of the line, which was the baseline before. The files are
those of `veiloc eval problems … --keypoints`.
"""

import argparse
import gzip
import json
from pathlib import Path

import numpy as np

from places import write_csv

SHARES = np.round(np.arange(0.40, 0.76, 0.02), 2)
BITS_FLOOR_PX = 1.0


def half_lines(points, width, height):
    """Anchor, direction, length and true distance on the half-lines of the paper's layout."""
    anchors = np.where(points[:, :1] < width / 2, [[width / 2, 0.0]], [[width / 2, float(height)]])
    toward = points - anchors
    distance = np.linalg.norm(toward, axis=1)
    direction = toward / np.maximum(distance, 1e-9)[:, None]
    ends = np.where(direction > 0, [width, height], 0) - anchors
    with np.errstate(divide="ignore", invalid="ignore"):
        length = np.nanmin(np.where(direction != 0, ends / direction, np.inf), axis=1)
    return anchors, direction, length, distance


def dcl(points, width, height, rng):
    anchors, direction, length, _ = half_lines(points, width, height)
    # A wedge widens with the distance, so a share of its area is the square of a share of its length.
    at = lambda share: anchors + (np.sqrt(share) * length)[:, None] * direction
    return {f"share {s:.2f}": at(s) for s in SHARES} | {"mean": anchors + (2 / 3 * length)[:, None] * direction}


def random_lines(points, width, height, rng):
    turn = rng.uniform(0, np.pi, len(points))
    direction = np.stack([np.cos(turn), np.sin(turn)], 1)
    with np.errstate(divide="ignore"):
        ends = np.stack([-points / direction, ([width, height] - points) / direction])
    near, far = np.minimum(*ends).max(1), np.maximum(*ends).min(1)
    at = lambda share: points + (near + share * (far - near))[:, None] * direction
    return {f"share {s:.2f}": at(s) for s in SHARES}


def permutation(points, width, height, rng):
    order = rng.permutation(len(points))[: len(points) // 2 * 2].reshape(-1, 2)
    sent, true = [], []
    for first, second in order:
        axis = rng.integers(2)
        a, b = points[first].copy(), points[second].copy()
        a[axis], b[axis] = b[axis], a[axis]
        sent += [a, b]
        true += [first, second]
    sent, middle = np.array(sent), np.array([width / 2, height / 2])
    answers = {
        "mean of both lines": (sent + middle) / 2,
        "crossing": sent,
        "middle of the shorter line": np.where([width > height, width <= height], sent, middle),
    }
    answers |= {f"{w:.1f} of the crossing": w * sent + (1 - w) * middle for w in (0.6, 0.7, 0.8, 0.9)}
    return answers, points[true]


def images(path, most):
    with gzip.open(path, "rt") as lines:
        for _, line in zip(range(most), lines):
            image = json.loads(line)
            yield np.array(image["keypoints"], float).reshape(-1, 2), image["width"], image["height"]


SCHEMES = [("dcl", dcl), ("random-lines", random_lines), ("coordinate-permutation", permutation)]


def errors(points, width, height, make, rng):
    """Error of each keypoint by answer, pixels, at most the diagonal."""
    answers = make(points, width, height, rng)
    answers, truth = answers if isinstance(answers, tuple) else (answers, points)
    diagonal = np.hypot(width, height)
    return {name: np.clip(np.linalg.norm(at - truth, axis=1), BITS_FLOOR_PX, diagonal) for name, at in answers.items()}


# Scheme: the mean point, the best answer for bits, the best answer for medians.
CHOSEN = {
    "dcl": ("mean", "share 0.52", "share 0.58"),
    "coordinate-permutation": ("mean of both lines", "crossing", "0.8 of the crossing"),
}


def compare(files, most, path):
    rng, rows = np.random.default_rng(0), []
    for name, file in (entry.split("=", 1) for entry in files):
        for scheme, make in SCHEMES:
            if scheme not in CHOSEN:
                continue
            mean, for_bits, for_pixels = CHOSEN[scheme]
            found = []
            for points, width, height in images(file, most):
                error = errors(np.unique(points, axis=0), width, height, make, rng)
                gain = np.log2(error[mean] / error[for_bits]).mean()
                found.append((gain, np.median(error[mean]), np.median(error[for_pixels])))
            gain, before, after = np.mean(found, axis=0)
            rows.append([name, scheme, len(found), f"{gain:.2f}", f"{before:.0f}", f"{after:.0f}"])
            print(*rows[-1], sep="  ")
    columns = ["place", "scheme", "images", "best answer over the mean point (bits)", "mean point (px)", "best answer (px)"]
    write_csv(path, columns, rows)


def fit(file, most):
    rng, found, best = np.random.default_rng(0), {}, {}
    for points, width, height in images(file, most):
        if len(points) < 20:
            continue
        diagonal = np.hypot(width, height)
        for scheme, make in SCHEMES:
            for name, error in errors(points, width, height, make, rng).items():
                values = np.median(error) / diagonal, np.log2(error / diagonal).mean()
                found.setdefault((scheme, name), []).append(values)
    for (scheme, name), values in found.items():
        median, bits = np.mean(values, axis=0)
        print(f"{scheme:24} {name:28} median {100 * median:6.2f} % of the diagonal   log2 of the error {bits:+.3f}")
        for measure, value in (("median", median), ("bits", bits)):
            if (scheme, measure) not in best or value < best[scheme, measure][0]:
                best[scheme, measure] = value, name
    for (scheme, measure), (_, name) in best.items():
        print(f"best of {scheme} for {measure}: {name}")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("keypoints", nargs="+", help="as written by `veiloc eval keypoints`; with --csv NAME=FILE")
    parser.add_argument("--images", type=int, default=400, help="at most this many images of a file")
    parser.add_argument("--csv", type=Path)
    args = parser.parse_args()
    if args.csv:
        compare(args.keypoints, args.images, args.csv)
    else:
        fit(args.keypoints[0], args.images)


if __name__ == "__main__":
    main()
