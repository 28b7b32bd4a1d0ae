"""SIFT by veiloc, pycolmap and OpenCV: extractors with one thread, and how well their features of an image agree with those of its warp.

An extractor maps a gray image to keypoints `[N, 4]` (u, v, scale, orientation; COLMAP's pixels) and descriptors `[N, 128]`, its own best
N. All descriptors are compared as RootSIFT.
"""

import os
import subprocess
import tempfile
import time
from pathlib import Path

from study.common import ROOT, Package, child_seconds

np, cv2, pycolmap = Package("numpy"), Package("cv2"), Package("pycolmap")
REPEAT_PX, CORRECT_PX, MARGIN_PX = 1.5, 3.0, 8
# Extractions per timing.
REPEATS = 4


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

    def __init__(self, budget, **options):
        cv2.setNumThreads(1)
        self.budget = budget
        self.sift = cv2.SIFT_create(nfeatures=budget, enable_precise_upscale=True, **options)

    def __call__(self, gray):
        found, descriptors = self.sift.detectAndCompute(gray, None)
        found, descriptors = found[: self.budget], descriptors[: self.budget]
        # OpenCV puts (0, 0) at the centre of the first pixel, and its size is a diameter.
        keypoints = np.array([[k.pt[0] + 0.5, k.pt[1] + 0.5, k.size / 2, np.deg2rad(k.angle)] for k in found])
        sums = np.maximum(descriptors.sum(1, keepdims=True), 1e-9)
        return keypoints, np.minimum(np.round(512 * np.sqrt(descriptors / sums)), 255)

    def seconds(self, gray):
        start = time.process_time()
        for _ in range(REPEATS):
            self.sift.detectAndCompute(gray, None)
        return (time.process_time() - start) / REPEATS


class Ours:
    """The example `extract` of veiloc-features."""

    def __init__(self, binary, budget, extra=(), name="veiloc"):
        self.binary, self.budget, self.extra, self.name = binary, budget, list(extra), name

    def run(self, gray, out, repeats):
        """Processor seconds of a run with this number of additional extractions."""
        with tempfile.NamedTemporaryFile(suffix=".png") as image:
            cv2.imwrite(image.name, gray, [cv2.IMWRITE_PNG_COMPRESSION, 1])
            return child_seconds([self.binary, "--max", self.budget, "--repeat", repeats, *self.extra, image.name, out])

    def __call__(self, gray):
        with tempfile.NamedTemporaryFile() as out:
            self.run(gray, out.name, 0)
            return parsed(Path(out.name).read_bytes())

    def seconds(self, gray):
        return (self.run(gray, "-", 1 + REPEATS) - self.run(gray, "-", 1)) / REPEATS


def parsed(raw):
    """The format of crates/device/features/examples/extract.rs."""
    n = int(np.frombuffer(raw, "<u4", 1)[0])
    rows = np.frombuffer(raw, "<f4", 5 * n, 4).reshape(n, 5)
    return rows[:, :4].astype(float), np.frombuffer(raw, np.uint8, -1, 4 + 20 * n).reshape(n, -1).astype(float)


class Wasm:
    def __init__(self, keypoints, folder):
        node = subprocess.run(["node", "--version"], check=True, capture_output=True, text=True).stdout
        self.name = f"veiloc as WebAssembly with `simd128`, node {node.strip().removeprefix('v').split('.')[0]}"
        self.keypoints, self.folder = keypoints, folder
        (folder / "src").mkdir()
        (folder / "Cargo.toml").write_text(WASM_MANIFEST % (ROOT / "crates/device/features"))
        (folder / "src/lib.rs").write_text(WASM_LIBRARY)
        (folder / "run.mjs").write_text(WASM_RUN)
        (folder / "Cargo.lock").write_bytes((ROOT / "Cargo.lock").read_bytes())
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

    def __call__(self, gray):
        return parsed(self.run(gray, 1)[1])

    def seconds(self, gray):
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


def mutual_matches(a, b):
    similarity = (a @ b.T) * 2 - (a**2).sum(1)[:, None] - (b**2).sum(1)[None, :]
    best_b, best_a = similarity.argmax(1), similarity.argmax(0)
    index = np.arange(len(a))
    mutual = best_a[best_b] == index
    return index[mutual], best_b[mutual]


def agreement(before, after, homography, size):
    """Features of an image and of its warp: the share of keypoints that are found again, among those that the warp leaves inside the
    image, within 1.5 px of their warped position; the share of mutual nearest neighbours within 3 px of it, and their number."""
    (points_a, descriptors_a), (points_b, descriptors_b) = before, after
    moved = np.c_[points_a[:, :2], np.ones(len(points_a))] @ homography.T
    moved = moved[:, :2] / moved[:, 2:]
    inside = ((moved > MARGIN_PX) & (moved < np.array(size) - MARGIN_PX)).all(1)
    nearest = [((point - points_b[:, :2]) ** 2).sum(1).min() for point in moved[inside]]
    i, j = mutual_matches(descriptors_a, descriptors_b)
    correct = np.linalg.norm(moved[i] - points_b[j, :2], axis=1) < CORRECT_PX
    return np.mean(np.array(nearest) <= REPEAT_PX**2), correct.mean(), correct.sum()
