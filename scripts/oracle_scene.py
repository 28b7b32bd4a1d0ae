#!/usr/bin/env python3
"""Reference localization of a scene with pycolmap's features and PoseLib's P3P.

The same evaluation as `veiloc eval scene --schemes points`, by independent programs on the same split: pycolmap SIFT, triangulation
with the given poses, VLAD retrieval of the top images, mutual nearest neighbours without ratio test, and PoseLib's LO-RANSAC on points.
Prints the reference figures in docs/results/poses.md.

    python3 -m venv .venv && .venv/bin/pip install -r scripts/requirements.txt
    .venv/bin/python scripts/oracle_scene.py --posed $VEILOC_DATA/redkitchen/posed \
        --images $VEILOC_DATA/redkitchen/images --map-list $VEILOC_DATA/redkitchen/map.txt \
        --query-list $VEILOC_DATA/redkitchen/query.txt --keypoints 2048 --thresholds 0.05/5
"""

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import poselib
import pycolmap


def read_list(path):
    return [line.strip() for line in Path(path).read_text().splitlines() if line.strip()]


def read_cameras(posed):
    cameras = {}
    for line in (Path(posed) / "cameras.txt").read_text().splitlines():
        if line.strip() and not line.startswith("#"):
            f = line.split()
            cameras[int(f[0])] = {
                "model": f[1], "width": int(f[2]), "height": int(f[3]), "params": [float(x) for x in f[4:]],
            }
    return cameras


def read_poses(posed):
    """name -> (qvec wxyz, tvec, camera id); the second line of each image is its 2D points."""
    lines = [l for l in (Path(posed) / "images.txt").read_text().split("\n") if not l.startswith("#")]
    poses = {}
    for line in lines[0::2]:
        f = line.split()
        if len(f) >= 10:
            poses[" ".join(f[9:])] = (np.array(f[1:5], float), np.array(f[5:8], float), int(f[8]))
    return poses


def rotation(q):
    w, x, y, z = q / np.linalg.norm(q)
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])


def mutual_nearest(a, b):
    """Index pairs of mutual nearest neighbours of two descriptor arrays, [M, 2]."""
    similarity = a @ b.T
    forward, backward = similarity.argmax(1), similarity.argmax(0)
    rows = np.arange(len(a))
    keep = backward[forward] == rows
    return np.stack([rows[keep], forward[keep]], 1)


def train_vocabulary(samples, k, rng, rounds=20):
    centers = samples[rng.choice(len(samples), k, replace=False)]
    for _ in range(rounds):
        nearest = ((samples**2).sum(1)[:, None] - 2 * samples @ centers.T + (centers**2).sum(1)).argmin(1)
        for j in range(k):
            members = samples[nearest == j]
            if len(members):
                centers[j] = members.mean(0)
    return centers


def vlad(descriptors, centers):
    nearest = ((centers**2).sum(1) - 2 * descriptors @ centers.T).argmin(1)
    v = np.zeros_like(centers)
    np.add.at(v, nearest, descriptors - centers[nearest])
    v /= np.maximum(np.linalg.norm(v, axis=1, keepdims=True), 1e-9)
    return v.ravel() / max(np.linalg.norm(v), 1e-9)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--posed", required=True)
    parser.add_argument("--images", required=True)
    parser.add_argument("--map-list", required=True)
    parser.add_argument("--query-list", required=True)
    parser.add_argument("--keypoints", type=int, default=2048)
    parser.add_argument("--retrieve", type=int, default=10)
    parser.add_argument("--max-error", type=float, default=8.0, help="inlier threshold of PoseLib, pixels")
    parser.add_argument("--thresholds", default="0.05/5")
    args = parser.parse_args()

    cameras, poses = read_cameras(args.posed), read_poses(args.posed)
    map_names, query_names = read_list(args.map_list), read_list(args.query_list)
    pycolmap.logging.minloglevel = 2
    pycolmap.set_random_seed(0)
    rng = np.random.default_rng(0)
    work = Path(tempfile.mkdtemp(prefix="oracle-scene-"))

    # Features of all images, with the known intrinsics.
    options = pycolmap.FeatureExtractionOptions(use_gpu=False)
    options.sift.max_num_features = args.keypoints
    camera = cameras[poses[map_names[0]][2]]
    reader = pycolmap.ImageReaderOptions(
        camera_model=camera["model"], camera_params=",".join(map(str, camera["params"])))
    started = time.time()
    database_path = work / "all.db"
    pycolmap.extract_features(
        database_path, args.images, image_names=map_names + query_names, camera_mode=pycolmap.CameraMode.SINGLE,
        reader_options=reader, extraction_options=options, device=pycolmap.Device.cpu)
    database = pycolmap.Database.open(database_path)
    keypoints, descriptors = {}, {}
    for image in database.read_all_images():
        keypoints[image.name] = database.read_keypoints(image.image_id)[:, :2].astype(float)
        d = database.read_descriptors(image.image_id)
        d = np.asarray(getattr(d, "data", d)).astype(np.float32)
        descriptors[image.name] = d / np.linalg.norm(d, axis=1, keepdims=True)
    database.close()
    print(f"features: {time.time() - started:.1f} s, {np.mean([len(k) for k in keypoints.values()]):.0f} an image",
          file=sys.stderr)

    # Map: triangulation under the given poses, from the map images only.
    started = time.time()
    map_database = work / "map.db"
    pycolmap.extract_features(
        map_database, args.images, image_names=map_names, camera_mode=pycolmap.CameraMode.SINGLE,
        reader_options=reader, extraction_options=options, device=pycolmap.Device.cpu)
    pycolmap.match_exhaustive(
        map_database, matching_options=pycolmap.FeatureMatchingOptions(use_gpu=False), device=pycolmap.Device.cpu)
    model = work / "posed"
    model.mkdir()
    (model / "points3D.txt").write_text("")
    # COLMAP needs the ids of its database: images are not extracted in the order of the list.
    database = pycolmap.Database.open(map_database)
    images = sorted((database.read_image_with_name(n) for n in map_names), key=lambda i: i.image_id)
    database.close()
    (model / "cameras.txt").write_text(
        f"{images[0].camera_id} {camera['model']} {camera['width']} {camera['height']} "
        f"{' '.join(map(repr, camera['params']))}\n")
    with open(model / "images.txt", "w") as f:
        for image in images:
            name = image.name
            q, t, _ = poses[name]
            c = image.camera_id
            f.write(f"{image.image_id} {' '.join(map(repr, q.tolist()))} {' '.join(map(repr, t.tolist()))} {c} {name}\n\n")
    reconstruction = pycolmap.Reconstruction(model)
    out = work / "triangulated"
    out.mkdir()
    reconstruction = pycolmap.triangulate_points(reconstruction, map_database, args.images, out)
    tracks = [p.track.length() for p in reconstruction.points3D.values()]
    errors = [p.error for p in reconstruction.points3D.values()]
    print(f"map: {time.time() - started:.1f} s, {len(tracks)} points, mean track {np.mean(tracks):.2f}, "
          f"mean reprojection error {np.mean(errors):.3f} px", file=sys.stderr)
    # Point ids per keypoint of each map image.
    point_of = {}
    for image in reconstruction.images.values():
        ids = np.array([p.point3D_id if p.has_point3D() else -1 for p in image.points2D], dtype=np.int64)
        point_of[image.name] = ids
    xyz = {i: p.xyz for i, p in reconstruction.points3D.items()}

    # Retrieval.
    samples = np.concatenate([descriptors[n] for n in map_names])
    samples = samples[rng.permutation(len(samples))[:50_000]]
    centers = train_vocabulary(samples, 64, rng)
    vlads = np.stack([vlad(descriptors[n], centers) for n in map_names])

    results = []
    for name in query_names:
        q, t, c = poses[name]
        top = np.argsort(-(vlads @ vlad(descriptors[name], centers)), kind="stable")[: args.retrieve]
        pairs = set()
        for j in top:
            ids = point_of.get(map_names[j])
            if ids is None:
                continue
            for a, b in mutual_nearest(descriptors[name], descriptors[map_names[j]]):
                if ids[b] >= 0:
                    pairs.add((int(a), int(ids[b])))
        pairs = sorted(pairs)
        p2d = np.array([keypoints[name][a] for a, _ in pairs])
        p3d = np.array([xyz[b] for _, b in pairs])
        started = time.time()
        pose, info = poselib.estimate_absolute_pose(
            p2d, p3d, cameras[c], {"max_reproj_error": args.max_error, "seed": 0}, {})
        ms = 1e3 * (time.time() - started)
        R, R_true = pose.R, rotation(q)
        # The angle from the chord: exact for small angles, where the arc cosine of the trace is not.
        angle = np.degrees(2 * np.arcsin(min(1.0, np.linalg.norm(R @ R_true.T - np.eye(3)) / np.sqrt(8))))
        distance = np.linalg.norm(R.T @ pose.t - R_true.T @ t)
        results.append((angle, distance, info["inlier_ratio"], ms, len(pairs)))
    r = np.array(results)
    recall = {}
    for threshold in args.thresholds.split(","):
        dt, da = map(float, threshold.split("/"))
        recall[threshold] = float(np.mean((r[:, 0] <= da) & (r[:, 1] <= dt)))
    print(json.dumps({
        "scheme": "points (pycolmap SIFT, PoseLib P3P)", "keypoints": args.keypoints, "queries": len(r),
        "median_rotation_deg": float(np.median(r[:, 0])), "median_translation": float(np.median(r[:, 1])),
        "recall": recall, "mean_inlier_ratio": float(r[:, 2].mean()), "median_matches": float(np.median(r[:, 4])),
        "median_ms": {"pose": float(np.median(r[:, 3]))},
    }))


if __name__ == "__main__":
    main()
