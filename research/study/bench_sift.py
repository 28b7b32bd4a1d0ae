#!/usr/bin/env python3
"""Benchmarks our SIFT against OpenCV's: time with one thread each, in alternating rounds, and repeatability.

Both get the same gray bytes, double the image first, and return their own best N keypoints. OpenCV's contrast threshold is the same
as ours (its default finds fewer keypoints: `--contrast 0.04`). Times are processor times of an extraction without reading the image,
median of all rounds (a round is the mean of a few; for WebAssembly the median of a few); other load on the machine affects them less
than wall time. Repeatable is the share of keypoints, among those that a warp leaves inside the image, with a keypoint of the other
image within 1.5 px of their warped position. Correct are the mutual nearest neighbours within 3 px; score is their share. All are
means over four warps: a rotation by 30 degrees, a scale of 0.7, a perspective, and a change of light with noise.

    cargo build --release -p veiloc-features --example extract
    python3 -m venv .venv && .venv/bin/pip install numpy opencv-python-headless
    .venv/bin/python research/study/bench_sift.py --extract target/release/examples/extract \\
        $VEILOC_DATA/redkitchen/images/frame-000000.color.jpg --wasm --csv docs/results/features/sift-speed.csv

`--extract` may be repeated to measure several builds. With `--wasm` ours is also built for WebAssembly with 128-bit vectors and run
by node; its output must equal that of the first `--extract`. This needs the target wasm32-unknown-unknown.
"""

import argparse
import os
import subprocess
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np

from places import write_csv
from timing import child_seconds

COLUMNS = ["extractor", "time (ms)", "time over OpenCV", "keypoints", "repeatable (%)", "matching score (%)", "correct matches"]
REPEAT_PX = 1.5
CORRECT_PX = 3.0
MARGIN_PX = 8
# Extractions per timing.
REPEATS = 4
REPOSITORY = Path(__file__).resolve().parents[2]


def parsed(raw):
    """Points and descriptors in the format of crates/device/features/examples/extract.rs."""
    n = int(np.frombuffer(raw, "<u4", 1)[0])
    rows = np.frombuffer(raw, "<f4", 5 * n, 4).reshape(n, 5)
    return rows[:, :2].astype(float), np.frombuffer(raw, np.uint8, -1, 4 + 20 * n).reshape(n, -1).astype(float)


class Ours:
    def __init__(self, binary, keypoints, extra=(), name="veiloc"):
        self.name, self.binary, self.keypoints, self.extra = name, binary, keypoints, extra

    def run(self, image, out, repeats):
        """Processor seconds of a run with this number of additional extractions."""
        return child_seconds([self.binary, "--max", self.keypoints, "--repeat", repeats, *self.extra, image, out])

    def features(self, gray, folder):
        image, out = folder / "gray.png", folder / "features.bin"
        cv2.imwrite(str(image), gray)
        self.run(image, out, 0)
        return parsed(out.read_bytes())

    def seconds(self, gray, folder):
        image = folder / "gray.png"
        cv2.imwrite(str(image), gray)
        return (self.run(image, "-", 1 + REPEATS) - self.run(image, "-", 1)) / REPEATS


class Wasm:
    def __init__(self, keypoints, folder):
        node = subprocess.run(["node", "--version"], check=True, capture_output=True, text=True).stdout
        self.name = f"veiloc as WebAssembly with `simd128`, node {node.strip().removeprefix('v').split('.')[0]}"
        self.keypoints, self.folder = keypoints, folder
        (folder / "src").mkdir()
        (folder / "Cargo.toml").write_text(WASM_MANIFEST % (REPOSITORY / "crates/device/features"))
        (folder / "src/lib.rs").write_text(WASM_LIBRARY)
        (folder / "run.mjs").write_text(WASM_RUN)
        (folder / "Cargo.lock").write_bytes((REPOSITORY / "Cargo.lock").read_bytes())
        flags = '--cfg getrandom_backend="custom" -C target-feature=+simd128'
        environment = {**os.environ, "RUSTFLAGS": flags, "CARGO_TARGET_DIR": str(folder / "target")}
        command = ["cargo", "build", "--release", "--quiet", "--target", "wasm32-unknown-unknown"]
        subprocess.run(command, cwd=folder, env=environment, check=True)
        self.program = folder / "target/wasm32-unknown-unknown/release/sift.wasm"

    def run(self, gray, repeats):
        image, out = self.folder / "gray", self.folder / "features.bin"
        image.write_bytes(gray.tobytes())
        height, width = gray.shape
        command = ["node", self.folder / "run.mjs", self.program, image, width, height, self.keypoints, out, repeats]
        printed = subprocess.run(map(str, command), check=True, capture_output=True).stdout
        return float(printed) / 1e3, out.read_bytes()

    def features(self, gray, _):
        return parsed(self.run(gray, 1)[1])

    def seconds(self, gray, _):
        return self.run(gray, 3 * REPEATS)[0]


# A library with two functions, as a web page would use it.
WASM_MANIFEST = """
[package]
name = "sift"
version = "0.0.0"
edition = "2024"
[lib]
crate-type = ["cdylib"]
[dependencies]
veiloc-features = { path = "%s" }
[profile.release]
lto = "thin"
codegen-units = 4
[workspace]
"""
WASM_LIBRARY = """
use veiloc_features::{GrayImage, SiftOptions, extract_sift};

#[unsafe(no_mangle)]
pub extern "C" fn room(bytes: usize) -> *mut u8 {
    Vec::leak(vec![0; bytes]).as_mut_ptr()
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn extract(gray: *const u8, width: u32, height: u32, keypoints: usize, out: *mut u8) -> usize {
    let gray = unsafe { std::slice::from_raw_parts(gray, (width * height) as usize) };
    let image = GrayImage::from_luma8(width, height, gray).expect("whole");
    let mut options = SiftOptions::default();
    options.max_keypoints = keypoints;
    let features = extract_sift(&image, &options);
    let mut bytes = (features.keypoints.len() as u32).to_le_bytes().to_vec();
    for k in &features.keypoints {
        for value in [k.pixel.u as f32, k.pixel.v as f32, k.scale, k.orientation, k.response] {
            bytes.extend(value.to_le_bytes());
        }
    }
    bytes.extend(features.descriptors.as_bytes());
    unsafe { std::ptr::copy_nonoverlapping(bytes.as_ptr(), out, bytes.len()) };
    bytes.len()
}
"""
WASM_RUN = """
import { readFileSync, writeFileSync } from 'node:fs';
const [,, program, gray, width, height, keypoints, out, repeats] = process.argv;
const { instance } = await WebAssembly.instantiate(readFileSync(program), {});
const { room, extract, memory } = instance.exports;
const bytes = readFileSync(gray);
const input = room(bytes.length), output = room(4 + 148 * +keypoints);
new Uint8Array(memory.buffer, input, bytes.length).set(bytes);
const times = [];
let length = 0;
for (let i = 0; i < +repeats; i++) {
    const start = process.cpuUsage();
    length = extract(input, +width, +height, +keypoints, output);
    const used = process.cpuUsage(start);
    times.push((used.user + used.system) / 1e3);
}
writeFileSync(out, new Uint8Array(memory.buffer, output, length));
console.log(times.sort((a, b) => a - b)[times.length >> 1]);
"""


class OpenCv:
    name = "opencv"

    def __init__(self, keypoints, contrast):
        self.keypoints = keypoints
        self.sift = cv2.SIFT_create(nfeatures=keypoints, contrastThreshold=contrast, enable_precise_upscale=True)

    def features(self, gray, _):
        found, descriptors = self.sift.detectAndCompute(gray, None)
        found, descriptors = found[: self.keypoints], descriptors[: self.keypoints]
        # OpenCV puts (0, 0) at the centre of the first pixel.
        points = np.array([[k.pt[0] + 0.5, k.pt[1] + 0.5] for k in found])
        sums = np.maximum(descriptors.sum(1, keepdims=True), 1e-9)
        return points, np.minimum(np.round(512 * np.sqrt(descriptors / sums)), 255)

    def seconds(self, gray, _):
        start = time.process_time()
        for _ in range(REPEATS):
            self.sift.detectAndCompute(gray, None)
        return (time.process_time() - start) / REPEATS


def warps(width, height):
    """(homography in pixels whose first has its centre at (0.5, 0.5), size, whether the light changes)."""
    centre = np.array([[1, 0, -width / 2], [0, 1, -height / 2], [0, 0, 1.0]])
    c, s = np.cos(np.pi / 6), np.sin(np.pi / 6)
    about = {
        "turn": np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]),
        "tilt": np.array([[0.9, 0.08, 0], [-0.05, 0.95, 0], [2.5e-4, -1.5e-4, 1]]),
        "shift": np.array([[1, 0, 3.37], [0, 1, -2.21], [0, 0, 1]]),
    }
    turn, tilt, shift = (np.linalg.inv(centre) @ about[name] @ centre for name in about)
    small = np.diag([0.7, 0.7, 1.0]), (round(0.7 * width), round(0.7 * height)), False
    return [(turn, (width, height), False), small, (tilt, (width, height), False), (shift, (width, height), True)]


def warped(gray, homography, size, light):
    """Sampled four times as densely, then averaged, so that shrinking does not alias."""
    half = np.array([[1, 0, -0.5], [0, 1, -0.5], [0, 0, 1.0]])
    dense = half @ np.diag([4.0, 4.0, 1.0]) @ homography @ np.linalg.inv(half)
    large = (4 * size[0], 4 * size[1])
    out = cv2.warpPerspective(gray, dense, large, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    out = cv2.resize(out, size, interpolation=cv2.INTER_AREA).astype(float)
    if light:
        out = 255 * (out / 255) ** 1.4 * 0.8 + np.random.default_rng(1).normal(0, 4, out.shape)
    return np.clip(np.round(out), 0, 255).astype(np.uint8)


def agreement(before, after, homography, size):
    """Share repeated, share of matches that are correct, their number."""
    (points_a, rows_a), (points_b, rows_b) = before, after
    moved = np.c_[points_a, np.ones(len(points_a))] @ homography.T
    moved = moved[:, :2] / moved[:, 2:]
    inside = ((moved > MARGIN_PX) & (moved < np.array(size) - MARGIN_PX)).all(1)
    nearest = [((point - points_b) ** 2).sum(1).min() for point in moved[inside]]
    similarity = 2 * rows_a @ rows_b.T - (rows_a**2).sum(1)[:, None] - (rows_b**2).sum(1)[None]
    to_b, to_a = similarity.argmax(1), similarity.argmax(0)
    mutual = to_a[to_b] == np.arange(len(rows_a))
    correct = np.linalg.norm(moved[mutual] - points_b[to_b[mutual]], axis=1) < CORRECT_PX
    return np.mean(np.array(nearest) < REPEAT_PX**2), correct.mean(), correct.sum()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("images", nargs="+", type=Path)
    parser.add_argument("--extract", action="append", required=True, help="the example binary of crates/device/features")
    parser.add_argument("--keypoints", type=int, default=2048)
    parser.add_argument("--contrast", type=float, default=0.012, help="OpenCV's, three times our peak threshold of 0.004")
    parser.add_argument("--rounds", type=int, default=8)
    parser.add_argument("--csv", type=Path)
    parser.add_argument("--wasm", action="store_true", help="build and measure WebAssembly too")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    rivals = [OpenCv(arguments.keypoints, arguments.contrast)]
    several = len(arguments.extract) > 1
    rivals += [Ours(binary, arguments.keypoints, name=f"veiloc, {binary}" if several else "veiloc") for binary in arguments.extract]
    with tempfile.TemporaryDirectory() as folder:
        if arguments.wasm:
            rivals.append(Wasm(arguments.keypoints, Path(folder)))
        measure(rivals, arguments)


def measure(rivals, arguments):
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        for path in arguments.images:
            gray = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
            times = [[rival.seconds(gray, folder) for rival in rivals] for _ in range(arguments.rounds)]
            # Not the minimum: our times are differences of two runs, whose minimum is biased.
            median = np.median(times, axis=0)
            height, width = gray.shape
            chosen = [(warp, warped(gray, *warp)) for warp in warps(width, height)]
            for rival, seconds in zip(rivals, median):
                before = rival.features(gray, folder)
                if isinstance(rival, Wasm):
                    native = rivals[1].features(gray, folder)
                    assert all((a == b).all() for a, b in zip(before, native)), "other bytes than the native program's"
                found = [agreement(before, rival.features(image, folder), w[0], w[1]) for w, image in chosen]
                repeat, score, correct = np.mean(found, axis=0)
                image = [f"{path.stem} {width} x {height}"] if len(arguments.images) > 1 else []
                rows.append([*image, rival.name, f"{1e3 * seconds:.1f}", f"{seconds / median[0]:.2f}", len(before[0]),
                             f"{100 * repeat:.1f}", f"{100 * score:.1f}", f"{correct:.0f}"])  # fmt: skip
                print(*rows[-1], sep="  ", flush=True)
    write_csv(arguments.csv, [*(["image"] if len(arguments.images) > 1 else []), *COLUMNS], rows)


if __name__ == "__main__":
    main()
