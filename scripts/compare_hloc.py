#!/usr/bin/env python3
"""Compares hloc's localize_sfm with `veiloc localize` on the same features and the same pairs.

    cargo build --release --features hloc
    python3 -m venv .venv && .venv/bin/pip install h5py numpy pycolmap
    .venv/bin/python scripts/compare_hloc.py $VEILOC_DATA/redkitchen

Reimplements the steps of hloc's localize_sfm with pycolmap and without torch: mutual nearest neighbours of each query and map image
(hloc's NN-mutual), the points of the map image's keypoints, and pycolmap's estimate_and_refine_absolute_pose on all pairs with a
threshold of 12 pixels. Both sides use the same feature file (`veiloc features --out-hloc`) and the same map (`veiloc map build
--features-file`, `veiloc map export --colmap`). By default every query is matched with every map image, so the pairs are equal; with
`--retrieve N` each side ranks map images by VLAD of the same descriptors, here with another vocabulary, and takes N.
Times are those of one query without feature extraction: matching and pose; hloc's matching runs in NumPy here.
"""

import argparse
import json
import subprocess
import tempfile
import time
from pathlib import Path

import h5py
import numpy as np
import pycolmap


def features_of(file, name):
    """Keypoints in COLMAP's pixels (as hloc's get_keypoints with its shift of half a pixel), and descriptors in rows."""
    group = file[name]
    return group["keypoints"][()].astype(np.float64) + 0.5, group["descriptors"][()].astype(np.float32).T


def mutual_nearest(a, b):
    similarity = a @ b.T
    forward, backward = similarity.argmax(1), similarity.argmax(0)
    rows = np.arange(len(a))
    keep = backward[forward] == rows
    return rows[keep], forward[keep]


def vlad(descriptors, words):
    """VLAD: residuals to the nearest word, signed square root, unit length."""
    nearest = (descriptors @ words.T - (words**2).sum(1) / 2).argmax(1)
    sums = np.stack([(descriptors[nearest == k] - word).sum(0) for k, word in enumerate(words)])
    sums = np.sign(sums) * np.sqrt(np.abs(sums))
    return sums.ravel() / np.linalg.norm(sums)


def vocabulary(samples, count=64, rounds=15):
    words = samples[np.random.default_rng(0).choice(len(samples), count, replace=False)]
    for _ in range(rounds):
        nearest = (samples @ words.T - (words**2).sum(1) / 2).argmax(1)
        words = np.stack([samples[nearest == k].mean(0) if (nearest == k).any() else words[k] for k in range(count)])
    return words


def points_of(image):
    """The point id of each keypoint, -1 for none."""
    return np.array([p.point3D_id if p.has_point3D() else -1 for p in image.points2D])


def localize(keypoints, descriptors, camera, map_images, model):
    """hloc's pose_from_cluster: one correspondence for each distinct pair of keypoint and point."""
    start = time.perf_counter()
    pairs = set()
    for own, points in map_images:
        query, other = mutual_nearest(descriptors, own)
        pairs.update((q, p) for q, p in zip(query, points[other]) if p != -1)
    matched = time.perf_counter()
    rows = sorted(pairs)
    pixels = np.array([keypoints[q] for q, _ in rows])
    points = np.array([model.points3D[p].xyz for _, p in rows])
    options = pycolmap.AbsolutePoseEstimationOptions()
    options.ransac.max_error = 12.0
    found = pycolmap.estimate_and_refine_absolute_pose(pixels, points, camera, options)
    done = time.perf_counter()
    return found and found["cam_from_world"], 1e3 * (matched - start), 1e3 * (done - matched)


def errors(estimate, truth):
    if estimate is None:
        return np.inf, np.inf
    center = lambda pose: -pose.rotation.matrix().T @ pose.translation
    angle = (estimate.rotation * truth.rotation.inverse()).angle()
    return float(np.linalg.norm(center(estimate) - center(truth))), float(np.degrees(angle))


def row(name, both, match, pose, threshold):
    t, r = np.array(both).T
    recall = np.mean((t <= threshold[0]) & (r <= threshold[1]))
    return (f"| {name} | {100 * recall:.1f} % | {100 * np.median(t):.2f} cm | {np.median(r):.3f}° | "
            f"{100 * t.max():.1f} cm | {np.median(match):.0f} ms | {np.median(pose):.0f} ms |")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", type=Path, help="folder with posed/, images/, map.txt and query.txt")
    parser.add_argument("--veiloc", default="target/release/veiloc")
    parser.add_argument("--features", default="sift")
    parser.add_argument("--keypoints", default="1024")
    parser.add_argument("--threshold", default="0.05/5")
    parser.add_argument("--retrieve", type=int, help="map images per query (default: all)")
    args = parser.parse_args()
    scene, threshold = args.scene, [float(x) for x in args.threshold.split("/")]
    lines = lambda name: [x.strip() for x in (scene / name).read_text().splitlines() if x.strip()]
    map_names, query_names = lines("map.txt"), lines("query.txt")
    retrieve = args.retrieve or len(map_names)
    truth = pycolmap.Reconstruction(str(scene / "posed"))
    known = {image.name: image for image in truth.images.values()}
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)

        def veiloc(*words):
            done = subprocess.run([args.veiloc, "-q", *map(str, words)], stdout=subprocess.PIPE, text=True)
            # Exit codes 4 (doubtful) and 1 (not localized) are counted below.
            assert done.returncode in (0, 1, 4), (words, done.returncode)
            return done.stdout

        veiloc("features", scene / "images", "--features", args.features, "--max-keypoints", args.keypoints,
               "--out-hloc", folder / "feats.h5")
        kind = ["--features", args.features, "--features-file", folder / "feats.h5"]
        veiloc("map", "build", "--posed", scene / "posed", "--images", scene / "images", "--list", scene / "map.txt",
               "--max-keypoints", args.keypoints, "--query-keypoints", args.keypoints, "-o", folder / "place.vmap", *kind)
        veiloc("map", "export", folder / "place.vmap", "--colmap", folder / "sfm")
        camera_words = lambda c: f"{c.model.name} {c.width} {c.height} {' '.join(map(repr, map(float, c.params)))}"
        (folder / "queries.txt").write_text(
            "".join(f"{n} {camera_words(known[n].camera)}\n" for n in query_names))

        model = pycolmap.Reconstruction(str(folder / "sfm"))
        by_name = {image.name: image for image in model.images.values()}
        rows = []
        with h5py.File(folder / "feats.h5") as file:
            mapped = []
            for name in map_names:
                keypoints, descriptors = features_of(file, name)
                own = np.array([p.xy for p in by_name[name].points2D])
                assert np.abs(own - keypoints).max() < 1e-3, "the map's keypoints are those of the file, in its order"
                mapped.append((descriptors, points_of(by_name[name])))
            words = vocabulary(np.concatenate([own[::8] for own, _ in mapped]))
            globals_ = np.stack([vlad(own, words) for own, _ in mapped])
            both, match, pose = [], [], []
            for name in query_names:
                keypoints, descriptors = features_of(file, name)
                ranked = np.argsort(-globals_ @ vlad(descriptors, words))[:retrieve]
                paired = [mapped[i] for i in ranked]
                found, m, p = localize(keypoints, descriptors, known[name].camera, paired, model)
                both.append(errors(found, known[name].cam_from_world()))
                match.append(m)
                pose.append(p)
            rows.append(row("hloc's steps, pycolmap", both, match, pose, threshold))
        for scheme in ("points", "dcl"):
            document = json.loads(veiloc(
                "localize", "--map", folder / "place.vmap", "--queries", folder / "queries.txt", "--images",
                scene / "images", "--scheme", scheme, "--retrieve", retrieve, "--json", *kind))
            both, match, pose = [], [], []
            for query in document["queries"]:
                estimate = None
                if "cam_from_world" in query:
                    w, x, y, z = query["cam_from_world"]["q"]
                    estimate = pycolmap.Rigid3d(pycolmap.Rotation3d([x, y, z, w]), query["cam_from_world"]["t"])
                both.append(errors(estimate, known[query["file"]].cam_from_world()))
                match.append(query["ms"].get("retrieve", 0) + query["ms"].get("match", 0))
                pose.append(query["ms"].get("pose", 0))
            rows.append(row(f"veiloc, {scheme}", both, match, pose, threshold))
    print(f"{len(query_names)} queries, {retrieve} of {len(map_names)} map images each, {args.features}, {args.keypoints} keypoints\n")
    print(f"| | within {100 * threshold[0]:g} cm, {threshold[1]:g}° | median | median | worst | matching | pose |")
    print("|---|--:|--:|--:|--:|--:|--:|")
    print("\n".join(rows))


if __name__ == "__main__":
    main()
