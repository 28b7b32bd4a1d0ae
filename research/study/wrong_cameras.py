#!/usr/bin/env python3
"""Localizes queries whose camera parameters are wrong, and counts poses that are trusted and not within their ±.

    research/study/wrong_cameras.py --veiloc target/release/veiloc --data $VEILOC_DATA --work maps \
        --csv docs/results/trust/camera.csv

Builds a map of each scene with its self-test in `--work` (kept for the next run). `cx 5 %` means that the principal
point of the query's camera is 5 % of the image's width too far right; `k1 -0.2` that a first radial term is given which
the lens does not have; `fy 0.9` that the vertical focal length is 0.9 of the true one, and `f 1.03` that both are 1.03 of it.
"""

import argparse
import json
import math
import statistics
import subprocess
from pathlib import Path

from places import write_csv

SCENES = ["redkitchen", "herzjesu", "hololens-office", "tum-fr1-rpy", "llff-room", "fountain", "entry"]
ERRORS = ["none", "cx 1 %", "cx 2 %", "cx 5 %", "cx 10 %", "fy 0.9", "k1 -0.2", "f 1.03", "f 0.8", "f 1.3"]
COLUMNS = [
    "scene", "scheme", "camera error", "queries", "trusted", "doubtful", "trusted, centre beyond 3 ±",
    "trusted, orientation beyond 3 ±", "trusted beyond 25 cm or 2°", "median error (map units)", "median error (°)",
]  # fmt: skip


def rotation(q):
    w, x, y, z = q
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]


def centre(q, t):
    r = rotation(q)
    return [-sum(r[k][i] * t[k] for k in range(3)) for i in range(3)]


def angle(p, q):
    a, b = rotation(p), rotation(q)
    trace = sum(a[i][j] * b[i][j] for i in range(3) for j in range(3))
    return math.degrees(math.acos(max(-1.0, min(1.0, (trace - 1) / 2))))


def read_posed(folder: Path):
    """Name of each image to its rotation, translation and camera, from COLMAP's text files."""
    cameras, poses = {}, {}
    for line in (folder / "cameras.txt").read_text().splitlines():
        if line and not line.startswith("#"):
            number, *rest = line.split()
            cameras[number] = rest
    for line in (folder / "images.txt").read_text().splitlines():
        words = line.split()
        if len(words) == 10 and not line.startswith("#") and "." in words[9]:
            numbers = [float(w) for w in words[1:8]]
            poses[words[9]] = (numbers[:4], numbers[4:], cameras[words[8]])
    return poses


def spoiled(camera, error: str) -> str:
    """The camera with one of ERRORS."""
    model, width, height, *text = camera
    params = [float(p) for p in text]
    if error != "none":
        what, value = error.split()[:2]
        number = float(value)
        if model in ("SIMPLE_PINHOLE", "SIMPLE_RADIAL"):
            f, cx, cy, k = (*params, 0.0)[:4]
            model, params = "OPENCV", [f, f, cx, cy, k, 0.0, 0.0, 0.0]
        elif model == "PINHOLE":
            model, params = "OPENCV", [*params, 0.0, 0.0, 0.0, 0.0]
        elif model != "OPENCV":
            raise SystemExit(f"camera model {model} is not supported here")
        if what == "cx":
            params[2] += number / 100 * int(width)
        elif what == "fy":
            params[1] *= number
        elif what == "f":
            params[0] *= number
            params[1] *= number
        else:
            params[4] += number
    return " ".join([model, width, height, *(repr(p) for p in params)])


def run(args, scene: str, scheme: str, error: str, every: int):
    folder = args.data / scene
    poses = read_posed(folder / "posed")
    names = [line.split()[0] for line in (folder / "query.txt").read_text().splitlines() if line.strip()][::every]
    queries = args.work / "queries.txt"
    queries.write_text("".join(f"{name} {spoiled(poses[name][2], error)}\n" for name in names))
    command = [args.veiloc, "localize", "--quiet", "--map", args.work / f"{scene}.vmap", "--queries", queries,
               "--images", folder / "images", "--scheme", scheme, "--json"]  # fmt: skip
    # Exit codes above 0 tell that some queries are doubtful or not found.
    document = json.loads(subprocess.run(command, stdout=subprocess.PIPE, text=True).stdout)
    errors, turns, states, beyond = [], [], [], [0, 0, 0]
    for query in document["queries"]:
        states.append(query["state"])
        pose = query.get("cam_from_world")
        if pose is None:
            errors.append(math.inf)
            turns.append(math.inf)
            continue
        q, t, _ = poses[query["file"]]
        errors.append(math.dist(centre(pose["q"], pose["t"]), centre(q, t)))
        turns.append(angle(pose["q"], q))
        if query["state"] == "trusted":
            beyond[0] += errors[-1] > 3 * query["position_sd"]
            beyond[1] += turns[-1] > 3 * query["confidence"]["rotation_sd_deg"]
            beyond[2] += errors[-1] > 0.25 or turns[-1] > 2
    return [
        scene, scheme, error, len(names), states.count("trusted"), states.count("doubtful"), *beyond,
        f"{statistics.median(errors):.4g}", f"{statistics.median(turns):.2g}",
    ]  # fmt: skip


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--veiloc", default="veiloc")
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--csv", type=Path)
    parser.add_argument("--scenes", default=",".join(SCENES))
    parser.add_argument("--schemes", default="points,dcl")
    parser.add_argument("--every", type=int, default=1, help="take every n-th query")
    args = parser.parse_args()
    args.work.mkdir(parents=True, exist_ok=True)
    rows = []
    for scene in args.scenes.split(","):
        folder, built = args.data / scene, args.work / f"{scene}.vmap"
        if not built.exists():
            subprocess.run([args.veiloc, "map", "build", "--quiet", "--posed", folder / "posed", "--images",
                            folder / "images", "--list", folder / "map.txt", "-o", built],
                           check=True, stdout=subprocess.DEVNULL)  # fmt: skip
        for scheme in args.schemes.split(","):
            for error in ERRORS:
                rows.append(run(args, scene, scheme, error, args.every))
                print(*rows[-1], sep="  ", flush=True)
    write_csv(args.csv, COLUMNS, rows)


if __name__ == "__main__":
    main()
