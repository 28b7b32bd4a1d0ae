#!/usr/bin/env python3
"""Maps of images alone against maps of given poses, on places with hold-outs.

    python -m venv venv && venv/bin/pip install numpy pycolmap
    venv/bin/python scripts/images_alone.py VEILOC DATA WORK OUT.csv [PLACE…]

DATA/PLACE has images/, posed/ (COLMAP text), map.txt and query.txt. For each place: pycolmap alone on the map images (its time), the map
of the images alone, the map of the given poses, and the hold-outs in both, with the camera of posed/. Poses of the first are moved by
the similarity that fits the centres of its map images to the given ones; a query without a pose counts as infinite error.
"""

import csv
import json
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pycolmap

PLACES = ["herzjesu", "fountain", "llff-room", "tum-fr1-rpy", "redkitchen"]


def rotation(w, x, y, z):
    w, x, y, z = np.array([w, x, y, z]) / np.linalg.norm([w, x, y, z])
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def given_poses(folder):
    """Camera line and pose of each image of a COLMAP text model."""
    cameras = {}
    for line in (folder / "cameras.txt").read_text().splitlines():
        if line.strip() and not line.startswith("#"):
            number, camera = line.split(maxsplit=1)
            cameras[number] = camera
    poses = {}
    for words in map(str.split, (folder / "images.txt").read_text().splitlines()):
        if len(words) == 10 and not words[0].startswith("#"):
            numbers = list(map(float, words[1:8]))
            poses[words[9]] = (cameras[words[8]], rotation(*numbers[:4]), np.array(numbers[4:]))
    return poses


def center(r, t):
    return -r.T @ t


def similarity(x, y):
    """Umeyama: y = s R x + t."""
    mx, my = x.mean(0), y.mean(0)
    u, d, vt = np.linalg.svd((y - my).T @ (x - mx))
    sign = np.diag([1, 1, np.sign(np.linalg.det(u @ vt))])
    r = u @ sign @ vt
    s = np.trace(np.diag(d) @ sign) / ((x - mx) ** 2).sum()
    return s, r, my - s * r @ mx


def run(command):
    start = time.time()
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True)
    if done.returncode not in (0, 1, 4):
        sys.exit(done.stderr)
    return done, time.time() - start


def errors(veiloc, map_file, queries, images, truth, moved):
    done, _ = run([veiloc, "localize", "--map", map_file, "--queries", queries, "--images", images, "--json", "--quiet"])
    found = []
    for query in json.loads(done.stdout)["queries"]:
        _, r_true, t_true = truth[query["file"]]
        pose = query.get("cam_from_world")
        if pose is None:
            found.append((np.inf, np.inf, False))
            continue
        r = rotation(*pose["q"])
        c = center(r, np.array(pose["t"]))
        s, turn, t = moved
        r, c = r @ turn.T, s * turn @ c + t
        angle = np.degrees(np.arccos(np.clip((np.trace(r @ r_true.T) - 1) / 2, -1, 1)))
        found.append((np.linalg.norm(c - center(r_true, t_true)), angle, query["state"] == "trusted"))
    return np.array(found)


def main():
    veiloc, data, work, out, *places = sys.argv[1:]
    data, work = Path(data), Path(work)
    rows = []
    for place in places or PLACES:
        folder, kept = data / place, work / place
        shutil.rmtree(kept, ignore_errors=True)
        kept.mkdir(parents=True)
        truth = given_poses(folder / "posed")
        names = (folder / "map.txt").read_text().split()
        held_out = (folder / "query.txt").read_text().split()
        queries = kept / "queries.txt"
        queries.write_text("".join(f"{name} {truth[name][0]}\n" for name in held_out))

        start = time.time()
        database = kept / "alone.db"
        pycolmap.logging.minloglevel = 2
        pycolmap.extract_features(database, folder / "images", image_names=names, camera_mode=pycolmap.CameraMode.SINGLE)
        pycolmap.match_exhaustive(database)
        (kept / "alone").mkdir()
        models = pycolmap.incremental_mapping(database, folder / "images", kept / "alone")
        of_pycolmap = time.time() - start
        registered = max((model.num_reg_images() for model in models.values()), default=0)

        build = [veiloc, "map", "build", "--images", folder / "images", "--list", folder / "map.txt"]
        alone, seconds = run(build + ["--python", sys.executable, "--work", kept / "work", "-o", kept / "alone.vmap"])
        print(alone.stderr, file=sys.stderr)
        _, of_given = run(build + ["--posed", folder / "posed", "-o", kept / "given.vmap"])

        sparse = [pycolmap.Reconstruction(model) for model in sorted((kept / "work/sfm/sparse").iterdir())]
        model = max(sparse, key=lambda model: model.num_reg_images())
        pairs = [
            (image.projection_center(), center(*truth[image.name][1:])) for image in model.images.values() if image.has_pose
        ]
        x, y = np.array([p[0] for p in pairs]), np.array([p[1] for p in pairs])
        moved = similarity(x, y)
        s, r, t = moved
        apart = np.linalg.norm(s * x @ r.T + t - y, axis=1)
        same = (1.0, np.eye(3), np.zeros(3))
        for kind, file, of in [("images alone", "alone.vmap", moved), ("given poses", "given.vmap", same)]:
            found = errors(veiloc, kept / file, queries, folder / "images", truth, of)
            finite = np.isfinite(found[:, 0])
            rows.append(
                {
                    "place": place,
                    "map": kind,
                    "images": len(names),
                    "registered": model.num_reg_images() if kind == "images alone" else len(names),
                    "pycolmap_registered": registered,
                    "map_center_rms": f"{np.sqrt((apart**2).mean()):.5f}" if kind == "images alone" else "0",
                    "seconds": round(seconds if kind == "images alone" else of_given),
                    "pycolmap_seconds": round(of_pycolmap),
                    "queries": len(held_out),
                    "localized": int(finite.sum()),
                    "trusted": int(found[:, 2].sum()),
                    "median_translation": f"{np.median(found[:, 0]):.5f}",
                    "median_rotation_deg": f"{np.median(found[:, 1]):.4f}",
                    "recall_5cm_5deg": f"{((found[:, 0] < 0.05) & (found[:, 1] < 5)).mean():.3f}",
                }
            )
            print(rows[-1], file=sys.stderr)
        with open(out, "w", newline="") as file:
            writer = csv.DictWriter(file, rows[0].keys(), lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)


if __name__ == "__main__":
    main()
