#!/usr/bin/env python3
"""Trains the projection of compact descriptors: RootSIFT to 64 numbers of 4 bits, or the descriptors of a network to 48.

    .venv/bin/python scripts/train_compact.py --images $VEILOC_DATA/training-photos --veiloc target/release/veiloc \
        --out crates/device/features/src/compact/projection.bin
    .venv/bin/python scripts/train_compact.py --images $VEILOC_DATA/training-photos --veiloc target/release/veiloc \
        --features sift,xfeat,alike-t --csv docs/results/features/projection.csv

Linear discriminant analysis. Training images are warped by random homographies, blurred, darkened and given noise; keypoints of an
image and its warped version within 1.5 px of each other are pairs. The projection whitens the differences of pairs (within-class
covariance), and selects the directions in which descriptors of different keypoints differ most (between-class covariance). All numbers
have the same step of the 4 bits, so Euclidean distance discriminates.

File: 64 (48, or `--count`) rows of little endian i16, one for each number of a descriptor, then as many i32. Number `i` of a
descriptor `x` is `(Σ w[i, j] x[j] + o[i]) >> 18`, from -8 to 7, in integers, so that every machine computes the same. For network
descriptors `x[j]` is the byte as a signed number, and the shift is 16.

Also prints the share of keypoints in validation images whose nearest neighbour among the keypoints of 13 images is their partner, for
the original descriptors and for projections to other lengths.
"""

import argparse
import base64
import gzip
import hashlib
import json
import random
import subprocess
import tempfile
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial import cKDTree

import sys
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "research"))
from study.common import write_csv

SHIFT = {"sift": 18, "learned": 16}  # learned descriptors vary less, so their weights are larger
LEVELS = 16
# For each descriptor type; the values for networks were chosen for XFeat and ALIKE on 18 images outside training and validation.
COUNT = {"sift": 64, "learned": 48}  # numbers of the file
SPREADS = {"sift": 2.5, "learned": 3.2}  # standard deviations on either side that the levels cover
FLOOR = {"sift": 0.1, "learned": 0.5}  # added to variances of pairs, in parts of their mean
TRAIN = {"sift": 500, "learned": 200}  # training images
COLUMNS = ["descriptors", "numbers", "bits a number", "bytes", "nearest neighbour right (%)"]
PAIR_PX, RIGHT_PX = 1.5, 3.0
# Largest descriptor distance of a pair; larger distances come from another orientation or scale at the same position. For networks in
# parts of the descriptor length: their numbers have both signs, so different descriptors are farther apart than with RootSIFT.
FARTHEST = {"sift": 230.0, "learned": 0.8}
WARPS = 2


def names_by_hash(folder):
    names = [str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()]
    return sorted(names, key=lambda name: hashlib.sha256(name.encode()).hexdigest())


def warp(image, draw):
    """A random homography, and the warped image with other blur, brightness and noise."""
    height, width = image.shape[:2]
    scale, turn, stretch = 2 ** draw.uniform(-0.7, 0.7), draw.gauss(0, 0.25), 2 ** draw.gauss(0, 0.25)
    cos, sin = np.cos(turn), np.sin(turn)
    affine = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]) @ np.diag([scale * stretch, scale / stretch, 1])
    tilt = np.eye(3)
    tilt[2, :2] = [draw.gauss(0, 0.2) / max(width, height) for _ in range(2)]
    centred = np.array([[1, 0, -width / 2], [0, 1, -height / 2], [0, 0, 1]])
    homography = np.linalg.inv(centred) @ tilt @ affine @ centred
    sampling = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
    out = cv2.warpPerspective(image, homography, (width, height), flags=sampling, borderMode=cv2.BORDER_REFLECT)
    out = 255 * (out.astype(np.float32) / 255) ** (2 ** draw.gauss(0, 0.4)) * 2 ** draw.gauss(0, 0.3) + draw.gauss(0, 15)
    if draw.random() < 0.4:
        out = cv2.GaussianBlur(out, (0, 0), draw.uniform(0.4, 1.5))
    noise = np.random.default_rng(draw.getrandbits(32)).normal(0, draw.uniform(0, 6), out.shape)
    return homography, np.clip(out + noise, 0, 255).astype(np.uint8)


def keypoints(args, features, names, folder):
    """[(keypoints, descriptors) of an image, [(homography, (keypoints, descriptors))] of its warps]"""
    homographies = {}
    for number, name in enumerate(names):
        image = cv2.imread(str(args.images / name))
        if image is None:
            continue
        draw = random.Random(name)
        cv2.imwrite(str(folder / f"{number:04d}_0.png"), image)
        for k in range(1, WARPS + 1):
            homography, warped = warp(image, draw)
            homographies[f"{number:04d}", k] = homography
            cv2.imwrite(str(folder / f"{number:04d}_{k}.png"), warped)
    out = folder / "keypoints.jsonl.gz"
    command = [args.veiloc, "--quiet", "eval", "keypoints", folder, "--features", features, "--max-keypoints", "1024", "-o", out]
    if args.engine:
        command += ["--engine", args.engine]
    subprocess.run(list(map(str, command)), check=True)
    found = {}
    with gzip.open(out) as lines:
        for row in map(json.loads, lines):
            numbers = np.frombuffer(base64.b64decode(row["descriptors"]), np.uint8).astype(np.int16)
            if row["descriptor_encoding"] != "unsigned":
                numbers -= 128
            found[Path(row["name"]).stem] = (np.array(row["keypoints"]).reshape(-1, 2), numbers.reshape(-1, row["descriptor_dim"]))
    both = {}
    for (number, k), homography in homographies.items():
        both.setdefault(number, []).append((homography, found[f"{number}_{k}"]))
    return [(found[f"{number}_0"], warps) for number, warps in both.items()]


def moved(points, homography):
    """Warps points by a homography; points behind the camera are moved far away."""
    ahead = np.c_[points, np.ones(len(points))] @ homography.T
    out = ahead[:, :2] / ahead[:, 2:]
    return np.where((ahead[:, 2:] > 0) & (np.abs(out) < 1e5), out, -1e4)


def pairs(images, farthest):
    """Descriptors of pairs, `[N, numbers]` each; of several keypoints at one position the most similar one."""
    first, second = [], []
    for (points, own), warps in images:
        for homography, (other_points, other) in warps:
            if not len(other_points):
                continue
            tree = cKDTree(other_points)
            for i, near in enumerate(tree.query_ball_point(moved(points, homography), PAIR_PX)):
                if near:
                    away = ((other[near].astype(np.float32) - own[i]) ** 2).sum(1)
                    if away.min() < farthest**2:
                        first.append(own[i])
                        second.append(other[near[int(away.argmin())]])
    return np.array(first, np.float64), np.array(second, np.float64)


def discriminant(first, second, count, floor):
    """Mean, and the `count` discriminant directions `[count, numbers]`, in which pairs have unit variance."""
    apart = first - second
    values, vectors = np.linalg.eigh(apart.T @ apart / len(apart) / 2)
    whiten = vectors @ np.diag((values + floor * values.mean()) ** -0.5) @ vectors.T
    both = np.vstack([first, second])
    _, directions = np.linalg.eigh(whiten @ np.cov(both.T) @ whiten)
    return both.mean(0), directions[:, ::-1][:, :count].T @ whiten


def integers(first, mean, directions, spreads, shift):
    """Weights `[count, numbers]` i16 and offsets `[count]` i32 of the file."""
    step = 2 * spreads * ((first - mean) @ directions.T).std() / LEVELS
    weights = np.round(directions / step * 2**shift)
    assert np.abs(weights).max() < 2**15
    offsets = np.round(-(directions @ mean) / step * 2**shift)
    # The median length of the output, with level centres as multiples of 16: the value of `DescriptorKind::norm`.
    coarse = 16 * project(weights, offsets, first, shift)
    return weights.astype("<i2"), offsets.astype("<i4"), float(np.median(np.linalg.norm(coarse, axis=1)))


def project(weights, offsets, descriptors, shift):
    """`[N, count]`, -7.5 to 7.5: centres of the levels."""
    sums = descriptors.astype(np.int64) @ weights.astype(np.int64).T + offsets.astype(np.int64)
    return np.clip(sums >> shift, -LEVELS // 2, LEVELS // 2 - 1).astype(np.float32) + 0.5


def found(images, encode, others=12):
    """Share of keypoints with a partner whose nearest neighbour, among the warped and other images, is this partner."""
    draw = np.random.default_rng(1)
    encoded = [encode(own[1]) for own, _ in images]
    right = total = 0
    for number, ((points, _), warps) in enumerate(images):
        for homography, (other_points, other) in warps:
            drawn = [n for n in draw.permutation(len(images)) if n != number][:others]
            pool = np.vstack([encode(other)] + [encoded[n] for n in drawn])
            nearest = ((pool**2).sum(1) - 2 * encoded[number] @ pool.T).argmin(1)
            at = moved(points, homography)
            has = cKDTree(other_points).query(at)[0] < PAIR_PX
            own = has & (nearest < len(other_points))
            off = np.linalg.norm(other_points[nearest[own]] - at[own], axis=1)
            right, total = right + int((off < RIGHT_PX).sum()), total + int(has.sum())
    return right / total


def distances(images, encode, length):
    """Prints distances of descriptors: of one keypoint in two images, and to the nearest descriptor of another image."""
    draw = np.random.default_rng(2)
    encoded = [encode(own[1]) for own, _ in images]
    same, apart = [], []
    for number, ((points, _), warps) in enumerate(images):
        other_image = encoded[(number + 1) % len(images)]
        drawn = encoded[number][draw.permutation(len(encoded[number]))[:200]]
        apart.append(np.sqrt(((drawn[:, None] - other_image[None]) ** 2).sum(2)).min(1))
        for homography, (other_points, other) in warps:
            if len(other_points):
                off, nearest = cKDTree(other_points).query(moved(points, homography))
                near = off < PAIR_PX
                same.append(np.linalg.norm(encoded[number][near] - encode(other)[nearest[near]], axis=1))
    same, apart = np.concatenate(same), np.concatenate(apart)
    for what, values, parts in [("of one place", same, (50, 75, 90)), ("nearest of another image", apart, (1, 5, 50))]:
        percentiles = ", ".join(f"{part} % below {np.percentile(values, part):.0f} ({np.percentile(values, part) / length:.3f})" for part in parts)
        print(f"   distances, {what}: {percentiles}")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=Path, required=True)
    parser.add_argument("--veiloc", type=Path, required=True)
    parser.add_argument("--features", default="sift",
                        help="sift, a model of `veiloc models` whose file VEILOC_MODELS finds, or a .toml; several with commas")
    parser.add_argument("--train", type=int,
                        help="number of training images, the first by a hash of their names; 500 for sift, 200 for a network")
    parser.add_argument("--judge", type=int, default=30, help="number of validation images, the last by that hash")
    parser.add_argument("--count", type=int, help="numbers of the file, an even number; 64 of sift, 48 of a network")
    parser.add_argument("--out", type=Path, help="file for the projection")
    parser.add_argument("--csv", type=Path)
    parser.add_argument("--engine", help="engine that runs the network (default: rten)")
    args = parser.parse_args()
    if args.out and "," in args.features:
        parser.error("--out takes the projection of one kind of features")
    names, rows = names_by_hash(args.images), []
    for features in args.features.split(","):
        rows += projections(args, features, names)
    write_csv(args.csv, COLUMNS, rows)


def projections(args, features, names):
    """Trains and judges projections of one kind of features; rows of the table."""
    which = features if features in FARTHEST else "learned"
    farthest, shift, train = FARTHEST[which], SHIFT[which], args.train or TRAIN[which]
    with tempfile.TemporaryDirectory() as folder:
        folders = [Path(folder) / name for name in ("train", "judge")]
        for path in folders:
            path.mkdir()
        learned = keypoints(args, features, names[:train], folders[0])
        if which == "learned":
            farthest *= np.median(np.concatenate([np.linalg.norm(own[1].astype(float), axis=1) for own, _ in learned]))
        first, second = pairs(learned, farthest)
        judged = keypoints(args, features, names[-args.judge :], folders[1])
    rows = []

    def add(*row):
        rows.append([*row[:-1], f"{100 * row[-1]:.1f}"])
        print(*rows[-1], sep="  ", flush=True)

    print(f"{len(first)} pairs of {train} images")
    own = first.shape[1]
    add(features, own, 8, own, found(judged, lambda x: x.astype(np.float32)))
    chosen = args.count or COUNT[which]
    for count in sorted(count for count in {32, 48, 64, 96, chosen} if count <= own):
        mean, directions = discriminant(first, second, count, FLOOR[which])
        weights, offsets, length = integers(first, mean, directions, SPREADS[which], shift)
        plain = found(judged, lambda x: ((x - mean) @ directions.T).astype(np.float32))
        add(f"{features}, projected", count, "not cut", "", plain)
        add(f"{features}, projected", count, 4, count // 2, found(judged, lambda x: project(weights, offsets, x, shift)))
        if count == chosen:
            print(f"   their median length is {length:.0f}")
            distances(judged, lambda x: 16 * project(weights, offsets, x, shift), length)
            if args.out:
                args.out.write_bytes(weights.tobytes() + offsets.tobytes())
    return rows


if __name__ == "__main__":
    main()
