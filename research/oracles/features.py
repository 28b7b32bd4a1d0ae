#!/usr/bin/env python3
"""Compares our SIFT with pycolmap's and OpenCV's: repeatability and matching score for the same number of keypoints.

Every extractor gets the same gray images (COLMAP's gray, saved as PNG) and returns its own best N keypoints; all descriptors are
compared as RootSIFT. Two kinds of pairs:

- an image and its warp by a known homography (rotation by 30 degrees, scale 0.7, perspective, a change of light
  with noise). Repeatable: the share of keypoints, among those that the warp leaves inside the image, with a keypoint
  of the other image within 1.5 px of their warped position. Correct: a mutual nearest neighbour within 3 px.
- two photographs with known poses. Correct: a mutual nearest neighbour within 2 px of its epipolar line in both.

The matching score is the share of mutual nearest neighbours that are correct. Printed are the scenes, and the means over the kinds
of warps and over the scenes.

    cargo build --release -p veiloc-features --example extract
    python3 -m venv .venv && .venv/bin/pip install -r research/requirements.txt
    .venv/bin/python research/oracles/features.py --extract target/release/examples/extract --data $VEILOC_DATA \\
        --csv docs/results/features/extractors.csv

With `--fixture crates/device/features/tests/data` it instead writes a small synthetic image and the features of pycolmap and OpenCV in
it, as references for crates/device/features/tests/it/oracle.rs.
"""

import argparse
import subprocess
import tempfile
from pathlib import Path

import cv2
import numpy as np
import pycolmap

import sys
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "study"))
from places import write_csv

COLUMNS = ["pairs", "number of pairs", "extractor", "keypoints", "repeatable (%)", "matching score (%)", "correct matches per pair"]
WARPS = 4
REPEAT_PX = 1.5
CORRECT_PX = 3.0
EPIPOLAR_PX = 2.0


# Extractors: gray uint8 image -> (keypoints [N, 4]: u, v, scale, orientation; descriptors [N, 128] float).


class Colmap:
    name = "pycolmap"

    def __init__(self, budget):
        options = pycolmap.FeatureExtractionOptions()
        options.use_gpu = False
        options.num_threads = 1
        options.sift.max_num_features = budget
        self.budget = budget
        self.extractor = pycolmap.Sift(options, pycolmap.Device.cpu)

    def __call__(self, gray):
        keypoints, descriptors = self.extractor.extract(np.ascontiguousarray(gray))
        # COLMAP prefers the largest scales; it stops after the scale at which the budget is full.
        order = np.argsort(-keypoints[:, 2], kind="stable")[: self.budget]
        return keypoints[order], np.round(descriptors[order] * 512.0)


class OpenCv:
    name = "opencv"

    def __init__(self, budget):
        self.budget = budget
        self.sift = cv2.SIFT_create(nfeatures=budget, enable_precise_upscale=True)

    def __call__(self, gray):
        found, descriptors = self.sift.detectAndCompute(gray, None)
        found, descriptors = found[: self.budget], descriptors[: self.budget]
        # OpenCV puts (0, 0) at the centre of the first pixel, and its size is a diameter.
        keypoints = np.array([[k.pt[0] + 0.5, k.pt[1] + 0.5, k.size / 2, np.deg2rad(k.angle)] for k in found])
        sums = np.maximum(descriptors.sum(1, keepdims=True), 1e-9)
        return keypoints, np.minimum(np.round(512 * np.sqrt(descriptors / sums)), 255)


class Ours:
    name = "veiloc"

    def __init__(self, binary, budget, extra=(), rank=None, name=None):
        self.binary, self.budget, self.extra, self.rank = binary, budget, list(extra), rank
        self.name = name or self.name

    def __call__(self, gray):
        with tempfile.TemporaryDirectory() as folder:
            image, out = f"{folder}/gray.png", f"{folder}/features.bin"
            cv2.imwrite(image, gray, [cv2.IMWRITE_PNG_COMPRESSION, 1])
            budget = str(100000 if self.rank else self.budget)
            subprocess.run([self.binary, "--max", budget, *self.extra, image, out], check=True)
            keypoints, descriptors = read_raw(out)
        if self.rank:
            order = np.argsort(-self.rank(keypoints), kind="stable")[: self.budget]
            keypoints, descriptors = keypoints[order], descriptors[order]
        return keypoints[:, :4], descriptors.astype(float)


def read_raw(path):
    """The format of crates/device/features/examples/extract.rs."""
    raw = Path(path).read_bytes()
    n = int(np.frombuffer(raw, "<u4", 1)[0])
    return (
        np.frombuffer(raw, "<f4", 5 * n, 4).reshape(n, 5).astype(float),
        np.frombuffer(raw, np.uint8, 128 * n, 4 + 20 * n).reshape(n, 128),
    )


# Images.


def colmap_gray(path):
    return np.ascontiguousarray(pycolmap.Bitmap.read(str(path), False).to_array()).squeeze()


def warps(width, height):
    """name -> (homography in COLMAP pixels, size of the warped image, light)."""
    centre = np.array([[1, 0, -width / 2], [0, 1, -height / 2], [0, 0, 1.0]])
    back = np.linalg.inv(centre)
    c, s = np.cos(np.pi / 6), np.sin(np.pi / 6)
    tilt = np.array([[0.9, 0.08, 0], [-0.05, 0.95, 0], [2.5e-4, -1.5e-4, 1]])
    return {
        "rotation 30": (back @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ centre, (width, height), False),
        "scale 0.7": (np.diag([0.7, 0.7, 1.0]), (round(0.7 * width), round(0.7 * height)), False),
        "perspective": (back @ tilt @ centre, (width, height), False),
        "light, noise": (back @ np.array([[1, 0, 3.37], [0, 1, -2.21], [0, 0, 1]]) @ centre, (width, height), True),
    }


def warp(gray, homography, size, light):
    """The warped image. Sampled four times as densely, then averaged, so that shrinking does not alias."""
    half = np.array([[1, 0, -0.5], [0, 1, -0.5], [0, 0, 1.0]])  # COLMAP's pixels to OpenCV's
    dense = half @ np.diag([4.0, 4.0, 1.0]) @ homography @ np.linalg.inv(half)
    out = cv2.warpPerspective(
        gray, dense, (4 * size[0], 4 * size[1]), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
    )
    out = cv2.resize(out, size, interpolation=cv2.INTER_AREA).astype(float)
    if light:
        out = 255 * (out / 255) ** 1.4 * 0.8 + np.random.default_rng(1).normal(0, 4, out.shape)
    return np.clip(np.round(out), 0, 255).astype(np.uint8)


def apply(homography, points):
    moved = np.c_[points, np.ones(len(points))] @ homography.T
    return moved[:, :2] / moved[:, 2:]


# Poses.


def read_text(path):
    return [line for line in Path(path).read_text().split("\n") if not line.startswith("#")]


def read_posed(folder):
    """name -> (R, t, camera), camera = (fx, fy, cx, cy, k)."""
    cameras = {}
    for line in read_text(folder / "cameras.txt"):
        f = line.split()
        if f:
            p = [float(x) for x in f[4:]]
            cameras[f[0]] = {
                "SIMPLE_PINHOLE": lambda: (p[0], p[0], p[1], p[2], 0.0),
                "PINHOLE": lambda: (*p[:4], 0.0),
                "SIMPLE_RADIAL": lambda: (p[0], p[0], p[1], p[2], p[3]),
            }[f[1]]()
    poses = {}
    for line in read_text(folder / "images.txt")[0::2]:
        f = line.split()
        if len(f) >= 10:
            w, x, y, z = np.array(f[1:5], float) / np.linalg.norm(np.array(f[1:5], float))
            rotation = np.array([
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
            ])
            poses[f[9]] = (rotation, np.array(f[5:8], float), cameras[f[8]])
    return poses


def undistorted(points, camera):
    """On the plane z = 1."""
    fx, fy, cx, cy, k = camera
    seen = (points - [cx, cy]) / [fx, fy]
    plane = seen.copy()
    for _ in range(20):
        plane = seen / (1 + k * (plane**2).sum(1, keepdims=True))
    return plane


def epipolar_error(points_a, points_b, pose_a, pose_b):
    """The larger of both distances to the epipolar line of the other point, pixels (of the undistorted images)."""
    (ra, ta, camera_a), (rb, tb, camera_b) = pose_a, pose_b
    r = rb @ ra.T
    t = tb - r @ ta
    essential = np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]]) @ r
    a = np.c_[undistorted(points_a, camera_a), np.ones(len(points_a))]
    b = np.c_[undistorted(points_b, camera_b), np.ones(len(points_b))]
    in_b, in_a = a @ essential.T, b @ essential
    value = np.abs((b * in_b).sum(1))
    return np.maximum(
        value / np.linalg.norm(in_b[:, :2] / camera_b[:2], axis=1),
        value / np.linalg.norm(in_a[:, :2] / camera_a[:2], axis=1),
    )


# Measures.


def mutual_matches(a, b):
    similarity = (a @ b.T) * 2 - (a**2).sum(1)[:, None] - (b**2).sum(1)[None, :]
    best_b, best_a = similarity.argmax(1), similarity.argmax(0)
    index = np.arange(len(a))
    mutual = best_a[best_b] == index
    return index[mutual], best_b[mutual]


def near(points, others, radius):
    """Whether each point has a point of the other set within the radius."""
    hit = np.zeros(len(points), bool)
    for start in range(0, len(points), 512):
        part = points[start : start + 512]
        square = ((part[:, None] - others[None]) ** 2).sum(2)
        hit[start : start + 512] = square.min(1) <= radius**2
    return hit


def homography_row(features_a, features_b, homography, size):
    (points_a, descriptors_a), (points_b, descriptors_b) = features_a, features_b
    moved = apply(homography, points_a[:, :2])
    margin = 8
    inside = ((moved > margin) & (moved < np.array(size) - margin)).all(1)
    repeat = near(moved[inside], points_b[:, :2], REPEAT_PX).mean()
    i, j = mutual_matches(descriptors_a, descriptors_b)
    correct = np.linalg.norm(moved[i] - points_b[j, :2], axis=1) < CORRECT_PX
    return len(points_a), repeat, correct.mean(), correct.sum()


def posed_row(features_a, features_b, pose_a, pose_b):
    (points_a, descriptors_a), (points_b, descriptors_b) = features_a, features_b
    i, j = mutual_matches(descriptors_a, descriptors_b)
    correct = epipolar_error(points_a[i, :2], points_b[j, :2], pose_a, pose_b) < EPIPOLAR_PX
    return len(points_a), np.nan, correct.mean(), correct.sum()


def pairs_of(names, gaps, count):
    """`count` pairs with each gap, spread evenly over the sequence."""
    pairs = []
    for gap in gaps:
        starts = np.linspace(0, len(names) - 1 - gap, min(count, len(names) - gap)).round().astype(int)
        pairs += [(names[i], names[i + gap]) for i in dict.fromkeys(starts.tolist())]
    return pairs


def measure(extractors, data, photos):
    """(kind of pair, extractor name) -> rows of (keypoints, repeatability, score, correct)."""
    table = {}

    def add(kind, values):
        for extractor, row in values:
            table.setdefault(kind, {}).setdefault(extractor.name, []).append(row)

    for path in sorted((data / "photos").glob("*.jpg"))[:: max(1, 39 // photos)][:photos]:
        gray = colmap_gray(path)
        height, width = gray.shape
        before = [extractor(gray) for extractor in extractors]
        for kind, (homography, size, light) in warps(width, height).items():
            warped = warp(gray, homography, size, light)
            add(kind, [
                (extractor, homography_row(features, extractor(warped), homography, size))
                for extractor, features in zip(extractors, before)
            ])
    scenes = {
        "redkitchen": ("redkitchen/images", "redkitchen/posed", [2, 6], 8),
        "herzjesu": ("herzjesu/images", "herzjesu/posed", [1, 2], 5),
        "lund-door": ("lund-door/images", "lund-door/sparse", [1, 3], 3),
    }
    for scene, (images, posed, gaps, count) in scenes.items():
        poses = read_posed(data / posed)
        features = {}
        for pair in pairs_of(sorted(poses), gaps, count):
            for name in pair:
                if name not in features:
                    gray = colmap_gray(data / images / name)
                    features[name] = [extractor(gray) for extractor in extractors]
            add(scene, [
                (extractor, posed_row(a, b, poses[pair[0]], poses[pair[1]]))
                for extractor, a, b in zip(extractors, features[pair[0]], features[pair[1]])
            ])
    return table


def rows_of(table):
    """Rows of the result: each scene, then the mean over the kinds of warps and over the scenes."""
    def row(title, number, name, means):
        keypoints, repeat, score, correct = means
        return [title, number, name, f"{keypoints:.0f}", "" if np.isnan(repeat) else f"{100 * repeat:.1f}", f"{100 * score:.1f}",
                f"{correct:.0f}"]  # fmt: skip

    kinds = list(table)
    out = [row(kind, len(values), name, np.mean(values, axis=0)) for kind in kinds[WARPS:] for name, values in table[kind].items()]
    for title, chosen in {"all warps": kinds[:WARPS], "all posed": kinds[WARPS:]}.items():
        for name in table[chosen[0]]:
            out.append(row(title, "", name, np.mean([np.mean(table[kind][name], axis=0) for kind in chosen], axis=0)))
    return out


# Reference files of the Rust tests.


def drawn_image():
    """Discs, squares and lines of random gray on smooth noise, 240 x 180."""
    rng = np.random.default_rng(7)
    height, width, dense = 180, 240, 4
    image = cv2.resize(rng.uniform(60, 190, (12, 16)), (width * dense, height * dense), interpolation=cv2.INTER_CUBIC)
    for i in range(90):
        x, y = int(rng.uniform(0, width * dense)), int(rng.uniform(0, height * dense))
        size, gray = int(rng.uniform(2, 14) * dense), rng.uniform(0, 255)
        if i % 3 == 0:
            cv2.circle(image, (x, y), size, gray, -1)
        elif i % 3 == 1:
            box = cv2.boxPoints(((x, y), (2 * size, size), rng.uniform(0, 90)))
            cv2.fillPoly(image, [box.round().astype(np.int32)], gray)
        else:
            x2, y2 = x + int(rng.uniform(-40, 40) * dense), y + int(rng.uniform(-40, 40) * dense)
            cv2.line(image, (x, y), (x2, y2), gray, size // 2)
    image = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
    image = cv2.GaussianBlur(image, (0, 0), 0.5) + rng.normal(0, 1.5, (height, width))
    return np.clip(np.round(image), 0, 255).astype(np.uint8)


def write_fixture(folder):
    gray = drawn_image()
    cv2.imwrite(str(folder / "drawn.png"), gray, [cv2.IMWRITE_PNG_COMPRESSION, 9])
    for extractor in [Colmap(300), OpenCv(300)]:
        keypoints, descriptors = extractor(gray)
        raw = np.uint32(len(keypoints)).tobytes()
        raw += np.c_[keypoints, np.zeros(len(keypoints))].astype("<f4").tobytes()
        raw += descriptors.astype(np.uint8).tobytes()
        (folder / f"drawn_{extractor.name}.bin").write_bytes(raw)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--extract", help="the example binary of crates/device/features")
    parser.add_argument("--data", type=Path, help="the folder with the photographs")
    parser.add_argument("--keypoints", type=int, default=2048)
    parser.add_argument("--photos", type=int, default=8)
    parser.add_argument("--csv", type=Path)
    parser.add_argument("--fixture", type=Path, help="write the reference files of the Rust tests into this folder")
    parser.add_argument("--rankings", action="store_true", help="compare rankings of our keypoints instead")
    arguments = parser.parse_args()
    n = arguments.keypoints
    if arguments.fixture:
        return write_fixture(arguments.fixture)
    if arguments.rankings:
        # The columns are u, v, scale, orientation, response; response is peak * scale.
        extractors = [
            Ours(arguments.extract, n, rank=lambda k: k[:, 4] / k[:, 2], name="peak"),
            Ours(arguments.extract, n, rank=lambda k: k[:, 4], name="peak * scale"),
            Ours(arguments.extract, n, rank=lambda k: k[:, 4] * k[:, 2], name="peak * scale^2"),
            Ours(arguments.extract, n, rank=lambda k: k[:, 4] * k[:, 2] ** 2, name="peak * scale^3"),
            Ours(arguments.extract, n, rank=lambda k: k[:, 2], name="scale"),
        ]
    else:
        extractors = [Ours(arguments.extract, n), Colmap(n), OpenCv(n)]
    rows = rows_of(measure(extractors, arguments.data, arguments.photos))
    for row in rows:
        print(*row, sep="  ")
    write_csv(arguments.csv, COLUMNS, rows)


if __name__ == "__main__":
    main()
