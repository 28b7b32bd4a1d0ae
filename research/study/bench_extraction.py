#!/usr/bin/env python3
"""Benchmarks feature extraction against other implementations, with one thread each, in alternating rounds.

Compares SIFT and compact features with OpenCV's SIFT (as in `bench_sift.py`), and each network, run by rten and by ONNX Runtime in
veiloc, with ONNX Runtime from PyPI on the same graph. For veiloc the time is that of the whole extraction, from the gray image in
memory to the bytes of descriptors; for PyPI it is that of the network only, on an input of the same size. Times are processor times,
median of all rounds (a round is the mean of a few extractions), without reading the image or the network.

Both engines must find the same keypoints: the script prints the share of rten's keypoints with one of ONNX Runtime's within 0.1 px,
and fails if it is below 99 %.

    cargo build --release -p veiloc-features --example extract
    cargo build --release -p veiloc-features --example layers --features rten,onnxruntime
    .venv/bin/pip install numpy opencv-python-headless onnxruntime
    .venv/bin/python research/study/bench_extraction.py --extract target/release/examples/extract --layers target/release/examples/layers \\
        --weights $VEILOC_DATA/../weights --rounds 8 --csv docs/results/features/network-speed.csv \\
        $VEILOC_DATA/redkitchen/images/frame-000000.color.jpg
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np
import onnxruntime

import bench_sift
from places import write_csv
from timing import child_seconds, one_thread

COLUMNS = ["features, input", "program", "time (ms)", "time over the last of its group", "keypoints"]
SAME_PX, SAME_SHARE = 0.1, 0.99
# Extractions per timing.
REPEATS = 2


def library():
    """Path of ONNX Runtime's library in its wheel."""
    found = sorted((Path(onnxruntime.__file__).parent / "capi").glob("libonnxruntime.*"))
    if not found:
        raise SystemExit("the wheel of onnxruntime has no library")
    return str(found[0])


class Sift:
    """An implementation of `bench_sift`."""

    def __init__(self, rival):
        self.rival, self.name = rival, rival.name

    def seconds(self, image, folder):
        return self.rival.seconds(image, folder)

    def found(self, image, folder):
        return self.rival.features(image, folder)[0]


class Ours:
    """A network in veiloc, run by one engine."""

    def __init__(self, program, model, file, engine, keypoints):
        self.name = "veiloc, " + {"rten": "rten", "onnxruntime": "ONNX Runtime"}[engine]
        self.command, self.keypoints = [program, model, file], keypoints
        self.environment = {"VEILOC_ENGINE": engine, "ORT_DYLIB_PATH": library()}

    def run(self, *job):
        return child_seconds([*self.command, *job], self.environment)

    def seconds(self, _, folder):
        job = ["time", folder / "gray.png", self.keypoints]
        return (self.run(*job, 1 + REPEATS) - self.run(*job, 1)) / REPEATS

    def found(self, _, folder):
        self.run("keypoints", folder / "gray.png", self.keypoints, folder / "keypoints.f32")
        return np.fromfile(folder / "keypoints.f32", "<f4").reshape(-1, 2)


class Runtime:
    """The network only."""

    name = "ONNX Runtime from PyPI, the network alone"

    def __init__(self, graph, shape):
        session = onnxruntime.InferenceSession(str(graph), one_thread(), providers=["CPUExecutionProvider"])
        inputs = {session.get_inputs()[0].name: np.random.default_rng(1).random(shape, np.float32)}
        self.job = lambda: session.run(None, inputs)
        self.job()

    def seconds(self, *_):
        start = time.process_time()
        for _ in range(REPEATS):
            self.job()
        return (time.process_time() - start) / REPEATS

    def found(self, *_):
        return None


def networks(arguments, size):
    """(model, file, input shape for an image of this size) of each network whose file exists."""
    weights, (width, height) = arguments.weights, size
    whole = lambda side, multiple, margin: -(-(side + 2 * margin) // multiple) * multiple
    sides = lambda multiple, margin: (whole(height, multiple, margin), whole(width, multiple, margin))
    rows = [
        ("xfeat", weights / "xfeat/xfeat_800x576.onnx", (1, 1, 576, 800)),
        ("alike-t", weights / "alike/alike-t.onnx", (1, 3, *sides(32, 96))),
        ("alike", weights / "alike/alike-n.onnx", (1, 3, *sides(32, 96))),
    ]
    rows.append(("superpoint", weights / "superpoint/superpoint_v1.onnx", (1, 1, *sides(8, 64))))
    chosen = arguments.features.split(",")
    return [row for row in rows if row[1].is_file() and row[0] in chosen]


def rivals_of(arguments, gray):
    """{features: implementations}; the last one is the reference."""
    ours = lambda name, extra: Sift(bench_sift.Ours(arguments.extract, arguments.keypoints, extra, name))
    groups = {}
    if "sift" in arguments.features.split(","):
        sift = [ours("veiloc", []), ours("veiloc, compact", ["--compact"])]
        groups["sift"] = [*sift, Sift(bench_sift.OpenCv(arguments.keypoints, arguments.contrast))]
    for model, file, shape in networks(arguments, gray.shape[::-1]):
        own = [Ours(arguments.layers, model, file, engine, arguments.keypoints) for engine in ("rten", "onnxruntime")]
        groups[f"{model}, {shape[3]} x {shape[2]}"] = [*own, Runtime(file, shape)]
    return groups


def same(first, second):
    """Share of the first points that have one of the second points near."""
    away = [np.square(second - point).sum(1).min() for point in first]
    return float(np.mean(np.array(away) < SAME_PX**2))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("image", type=Path)
    parser.add_argument("--extract", required=True, help="the example `extract` of veiloc-features")
    parser.add_argument("--layers", required=True, help="the example `layers` of veiloc-features, built with ONNX Runtime")
    parser.add_argument("--weights", type=Path, required=True, help="folder of the network files")
    parser.add_argument("--features", default="sift,xfeat,alike-t,alike,superpoint")
    parser.add_argument("--keypoints", type=int, default=2048)
    parser.add_argument("--contrast", type=float, default=0.012, help="OpenCV's, three times our peak threshold of 0.004")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--csv", type=Path)
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    gray = cv2.imread(str(arguments.image), cv2.IMREAD_GRAYSCALE)
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        cv2.imwrite(str(folder / "gray.png"), gray)
        groups = rivals_of(arguments, gray)
        times = {(name, rival): [] for name, rivals in groups.items() for rival in rivals}
        for _ in range(arguments.rounds):
            for (name, rival), seconds in times.items():
                seconds.append(rival.seconds(gray, folder))
        # Not the minimum: our times are differences of two runs, whose minimum is biased.
        median = {key: float(np.median(seconds)) for key, seconds in times.items()}
        others, rows = [], []
        for name, rivals in groups.items():
            found = [rival.found(gray, folder) for rival in rivals]
            for i, rival in enumerate(rivals):
                time_of = median[name, rival]
                keypoints = "" if found[i] is None else len(found[i])
                # OpenCV has another detector, so its keypoints are not compared.
                alike = None if i in (0, len(rivals) - 1) else same(found[0], found[i])
                if alike is not None and alike < SAME_SHARE:
                    others.append(name)
                rows.append([name, rival.name, f"{1e3 * time_of:.1f}", f"{time_of / median[name, rivals[-1]]:.2f}", keypoints])
                share = [] if alike is None else [f"{100 * alike:.2f} % within 0.1 px of the first"]
                print(*rows[-1], *share, sep="  ", flush=True)
    write_csv(arguments.csv, COLUMNS, rows)
    if others:
        sys.exit(f"the engines find different keypoints: {', '.join(others)}")


if __name__ == "__main__":
    main()
