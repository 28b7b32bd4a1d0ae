#!/usr/bin/env python3
"""Localization by other programs and by veiloc, on the same images and lists.

    python3 -m venv .venv && .venv/bin/pip install -r research/requirements.txt
    .venv/bin/python research/study/peers.py --data $VEILOC_DATA --veiloc target/release/veiloc --work work --csv docs/results/peers/peers.csv

The steps of hloc with COLMAP's parts, for each place: SIFT of pycolmap, triangulation with the given poses from the map images, ten
images by VLAD, mutual nearest neighbours without ratio test, and the pose by pycolmap, by PoseLib (LO-RANSAC of P3P), and by OpenCV
(`solvePnPRansac` with SQPnP). COLMAP's own localization: the queries are matched with the same ten images, with its ratio test and
two-view geometry, and each is registered in the model alone. veiloc: `eval scene` under each scheme. All with the same number of
keypoints at most. With `--learned`, in place of all these: hloc's steps with the features of networks, as hloc does them, and the pose
by PoseLib; `veiloc features` extracts them, with the files in VEILOC_MODELS. A query without a pose counts as infinite error.

Bytes: images as JPEG of quality 90; keypoints with descriptors as two 16-bit coordinates and 128 bytes each, with descriptors of
networks as two bytes a number; queries of veiloc as sent. Times, with `--times`, are medians of a query on this machine: features (one
image after another), match (retrieval and matching), pose.
--work keeps COLMAP's models of the map images, which take most of the time; `--maps-only` makes these alone, so that the queries can be
timed on a machine that does nothing else.
"""

import argparse
import functools
import io
import json
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

import cv2
import h5py
import numpy as np
import poselib
import pycolmap
from PIL import Image

from places import PLACES, write_csv
from geometry import rotation

KEYPOINTS = 2048
RETRIEVED = 10
# Inlier threshold of the other programs, pixels.
MAX_ERROR = 8.0
# Features of networks, as they are called.
NETWORKS = {"alike": "ALIKE", "alike-t": "ALIKE-tiny", "xfeat": "XFeat"}
SENT = {"image": "image", "points": "keypoints, descriptors", "lines": "lines, descriptors"}
COLUMNS = [
    "place", "program", "what leaves the device", "queries", "localized", "within 5 cm and 5° (%)", "within 25 cm and 2° (%)",
    "median error (map units)", "median error (°)", "sent (kB)",
]  # fmt: skip
TIMES = ["features (ms)", "match (ms)", "pose (ms)"]


def read_list(path):
    """Lines of a file."""
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


def by_poselib(camera, p2d, p3d):
    """Pose of matches, or None; `camera` is one of COLMAP's."""
    known = {"model": camera.model.name, "width": camera.width, "height": camera.height, "params": list(camera.params)}
    pose, info = poselib.estimate_absolute_pose(p2d, p3d, known, {"max_reproj_error": MAX_ERROR, "seed": 0}, {})
    return (pose.R, pose.t) if info["num_inliers"] >= 4 else None


def by_pycolmap(camera, p2d, p3d):
    options = pycolmap.AbsolutePoseEstimationOptions()
    options.ransac.max_error = MAX_ERROR
    options.ransac.random_seed = 0
    found = pycolmap.estimate_and_refine_absolute_pose(p2d, p3d, camera, options)
    if found is None:
        return None
    pose = found["cam_from_world"].matrix()
    return pose[:, :3], pose[:, 3]


def by_opencv(camera, p2d, p3d):
    """SQPnP in RANSAC, on undistorted normalized coordinates, then Levenberg-Marquardt on the inliers."""
    normalized = np.ascontiguousarray(camera.cam_from_img(p2d))
    cv2.setRNGSeed(0)
    eye, none = np.eye(3), np.zeros(4)
    good, turn, move, inliers = cv2.solvePnPRansac(
        p3d, normalized, eye, none, iterationsCount=10_000, reprojectionError=MAX_ERROR / camera.mean_focal_length(),
        confidence=0.9999, flags=cv2.SOLVEPNP_SQPNP)  # fmt: skip
    if not good or inliers is None or len(inliers) < 4:
        return None
    own = inliers[:, 0]
    turn, move = cv2.solvePnPRefineLM(p3d[own], normalized[own], eye, none, turn, move)
    return cv2.Rodrigues(turn)[0], move[:, 0]


ESTIMATORS = {
    "hloc's steps, pycolmap": by_pycolmap, "hloc's steps, PoseLib": by_poselib, "hloc's steps, OpenCV SQPnP": by_opencv,
}  # fmt: skip


def error(pose, truth):
    """Angle in degrees and distance of the centres; infinite without a pose."""
    if pose is None:
        return np.inf, np.inf
    (r, t), (r_true, t_true) = pose, truth
    # The angle from the chord: exact for small angles, where the arc cosine of the trace is not.
    angle = np.degrees(2 * np.arcsin(min(1.0, np.linalg.norm(r @ r_true.T - np.eye(3)) / np.sqrt(8))))
    return angle, np.linalg.norm(r.T @ t - r_true.T @ t_true)


def row(place, program, sent, errors, times, size):
    """A row of the table; `errors` are [N, 2] degrees and map units, `times` medians in ms, `size` in bytes."""
    errors = np.array(errors)
    share = lambda angle, distance: f"{100 * np.mean((errors[:, 0] <= angle) & (errors[:, 1] <= distance)):.1f}"
    number = lambda value, form: "" if value is None or not np.isfinite(value) else format(value, form)
    found = [
        place, program, SENT[sent], len(errors), int(np.isfinite(errors[:, 0]).sum()), share(5, 0.05), share(2, 0.25),
        number(np.median(errors[:, 1]), ".4f"), number(np.median(errors[:, 0]), ".3f"), f"{size / 1000:.0f}",
        *(number(t, ".0f") for t in times),
    ]  # fmt: skip
    print(*found, sep="  ", flush=True)
    return found


def jpeg_bytes(path):
    """Size of an image as a phone would send it."""
    out = io.BytesIO()
    with Image.open(path) as image:
        image.convert("RGB").save(out, "JPEG", quality=90)
    return out.tell()


def features(database_path, names):
    """Keypoints [N, 2] and unit descriptors [N, 128] of a database's images."""
    database = pycolmap.Database.open(database_path)
    keypoints, descriptors = {}, {}
    for name in names:
        image = database.read_image_with_name(name)
        keypoints[name] = database.read_keypoints(image.image_id)[:, :2].astype(float)
        d = database.read_descriptors(image.image_id)
        d = np.asarray(getattr(d, "data", d)).astype(np.float32)
        descriptors[name] = d / np.linalg.norm(d, axis=1, keepdims=True)
    database.close()
    return keypoints, descriptors


def triangulated(work, images_folder, names, poses, camera, extract_and_match):
    """COLMAP's database and model of the map images with the given poses, in `work`; kept from an earlier run."""
    database_path, out = work / "map.db", work / "triangulated"
    if (out / "points3D.bin").exists():
        return database_path, out
    shutil.rmtree(work, ignore_errors=True)
    out.mkdir(parents=True)
    model = work / "posed"
    model.mkdir()
    extract_and_match(database_path, names)
    (model / "points3D.txt").write_text("")
    # COLMAP needs the ids of its database: images are not extracted in the order of the list.
    database = pycolmap.Database.open(database_path)
    images = sorted((database.read_image_with_name(n) for n in names), key=lambda i: i.image_id)
    database.close()
    params = " ".join(map(repr, camera["params"]))
    (model / "cameras.txt").write_text(
        f"{images[0].camera_id} {camera['model']} {camera['width']} {camera['height']} {params}\n")
    with open(model / "images.txt", "w") as f:
        for image in images:
            q, t, _ = poses[image.name]
            numbers = " ".join(map(repr, [*q.tolist(), *t.tolist()]))
            f.write(f"{image.image_id} {numbers} {image.camera_id} {image.name}\n\n")
    pycolmap.triangulate_points(pycolmap.Reconstruction(model), database_path, images_folder, out)
    return database_path, out


def registered(model, database_path, names):
    """COLMAP's own localization: the pose of each query, registered alone, or None; and its time in ms."""
    database = pycolmap.Database.open(database_path)
    ids = {name: database.read_image_with_name(name).image_id for name in names}
    cache = pycolmap.DatabaseCache.create(database, pycolmap.DatabaseCacheOptions())
    database.close()
    reconstruction = pycolmap.Reconstruction(model)
    mapper = pycolmap.IncrementalMapper(cache)
    mapper.begin_reconstruction(reconstruction)
    options = pycolmap.IncrementalMapperOptions()
    options.abs_pose_refine_focal_length = options.abs_pose_refine_extra_params = False
    options.random_seed = 0
    poses, times = {}, []
    for name in names:
        started = time.time()
        # An image without matches has no correspondences in the cache.
        good = ids[name] in reconstruction.images and mapper.register_next_image(options, ids[name])
        times.append(1e3 * (time.time() - started))
        poses[name] = None
        if good:
            image = reconstruction.image(ids[name])
            pose = image.cam_from_world().matrix()
            poses[name] = (pose[:, :3], pose[:, 3])
            reconstruction.deregister_frame(image.frame_id)
    mapper.end_reconstruction(True)
    return poses, times


def reader_of(camera):
    """How COLMAP reads images of this camera."""
    return pycolmap.ImageReaderOptions(camera_model=camera["model"], camera_params=",".join(map(str, camera["params"])))


class Place:
    """Images, cameras and poses of a place; `kept` is the folder of COLMAP's models."""

    def __init__(self, folder, kept):
        self.folder, self.kept, self.images = folder, kept, folder / "images"
        self.cameras, self.poses = read_cameras(folder / "posed"), read_poses(folder / "posed")
        self.map, self.queries = read_list(folder / "map.txt"), read_list(folder / "query.txt")
        self.camera = self.cameras[self.poses[self.map[0]][2]]

    def truth(self, name):
        q, t, _ = self.poses[name]
        return rotation(q), t

    def camera_of(self, name):
        own = self.cameras[self.poses[name][2]]
        return pycolmap.Camera(model=own["model"], width=own["width"], height=own["height"], params=own["params"])

    def image_bytes(self):
        return np.median([jpeg_bytes(self.images / name) for name in self.queries])


def by_steps(place, model, keypoints, descriptors, estimators):
    """hloc's steps after extraction: retrieval, matches with the model, pose. Errors and times of each estimator, the time of
    matching (ms), and the retrieved pairs."""
    rng = np.random.default_rng(0)
    reconstruction = pycolmap.Reconstruction(model)
    point_of = {
        image.name: np.array([p.point3D_id if p.has_point3D() else -1 for p in image.points2D], dtype=np.int64)
        for image in reconstruction.images.values()
    }
    xyz = {i: p.xyz for i, p in reconstruction.points3D.items()}
    samples = np.concatenate([descriptors[n] for n in place.map])
    centers = train_vocabulary(samples[rng.permutation(len(samples))[:50_000]], 64, rng)
    vlads = np.stack([vlad(descriptors[n], centers) for n in place.map])

    errors, times = {name: [] for name in estimators}, {name: [] for name in estimators}
    match_times, image_pairs = [], []
    for name in place.queries:
        known = place.camera_of(name)
        started = time.time()
        top = np.argsort(-(vlads @ vlad(descriptors[name], centers)), kind="stable")[:RETRIEVED]
        pairs = set()
        for other in (place.map[j] for j in top):
            image_pairs.append((name, other))
            ids = point_of.get(other)
            if ids is not None:
                found = mutual_nearest(descriptors[name], descriptors[other])
                pairs |= {(int(a), int(ids[b])) for a, b in found if ids[b] >= 0}
        match_times.append(1e3 * (time.time() - started))
        pairs = sorted(pairs)
        p2d = np.array([keypoints[name][a] for a, _ in pairs]).reshape(-1, 2)
        p3d = np.array([xyz[b] for _, b in pairs]).reshape(-1, 3)
        for program, estimate in estimators.items():
            started = time.time()
            pose = estimate(known, p2d, p3d) if len(pairs) >= 4 else None
            times[program].append(1e3 * (time.time() - started))
            errors[program].append(error(pose, place.truth(name)))
    return errors, {program: np.median(each) for program, each in times.items()}, np.median(match_times), image_pairs


def of_colmap(place, work, maps_only=False):
    """Rows of the other programs with COLMAP's SIFT; `work` is a folder for the queries."""
    pycolmap.set_random_seed(0)
    options = pycolmap.FeatureExtractionOptions(use_gpu=False)
    options.sift.max_num_features = KEYPOINTS
    matching = pycolmap.FeatureMatchingOptions(use_gpu=False)

    def extract(database_path, names):
        pycolmap.extract_features(
            database_path, place.images, image_names=names, camera_mode=pycolmap.CameraMode.SINGLE,
            reader_options=reader_of(place.camera), extraction_options=options, device=pycolmap.Device.cpu)  # fmt: skip

    def extract_and_match(database_path, names):
        extract(database_path, names)
        pycolmap.match_exhaustive(database_path, matching_options=matching, device=pycolmap.Device.cpu)

    map_database, model = triangulated(place.kept, place.images, place.map, place.poses, place.camera, extract_and_match)
    if maps_only:
        return []
    database_path = shutil.copy(map_database, work / "all.db")
    feature_times = []
    for name in place.queries:
        started = time.time()
        extract(database_path, [name])
        feature_times.append(1e3 * (time.time() - started))
    keypoints, descriptors = features(database_path, place.map + place.queries)
    errors, times, match_time, image_pairs = by_steps(place, model, keypoints, descriptors, ESTIMATORS)

    listed = work / "pairs.txt"
    listed.write_text("".join(f"{a} {b}\n" for a, b in image_pairs))
    started = time.time()
    pycolmap.match_image_pairs(database_path, matching_options=matching, device=pycolmap.Device.cpu,
                               pairing_options=pycolmap.ImportedPairingOptions(match_list_path=listed))  # fmt: skip
    of_pairs = 1e3 * (time.time() - started) / len(place.queries)
    found, register_times = registered(model, database_path, place.queries)
    size = place.image_bytes()
    rows = []
    of_points = np.median([len(keypoints[name]) for name in place.queries]) * (4 + 128)
    for program in ESTIMATORS:
        each = np.median(feature_times), match_time, times[program]
        rows.append(row(place.folder.name, program, "image", errors[program], each, size))
        if program == "hloc's steps, PoseLib":
            rows.append(row(place.folder.name, f"{program}, features on the device", "points", errors[program], each, of_points))
    own = [error(found[name], place.truth(name)) for name in place.queries]
    each = np.median(feature_times), of_pairs, np.median(register_times)
    rows.append(row(place.folder.name, "COLMAP, registration", "image", own, each, size))
    return rows


def of_learned(kind, veiloc, place, work, maps_only=False):
    """Rows of hloc's steps with the features of a network."""

    def extracted(names):
        """Keypoints in COLMAP's pixels, unit descriptors, and the time of an image, ms."""
        listed, out = work / "names.txt", work / "features.h5"
        listed.write_text("".join(f"{name}\n" for name in names))
        started = time.time()
        subprocess.run([veiloc, "features", "--quiet", "--features", kind, "--max-keypoints", str(KEYPOINTS), "--list", listed,
                        "--out-hloc", out, place.images], check=True)  # fmt: skip
        spent = 1e3 * (time.time() - started) / len(names)
        keypoints, descriptors = {}, {}
        with h5py.File(out) as file:
            for name in names:
                # hloc's files have the centre of the first pixel at 0, COLMAP at 0.5.
                keypoints[name] = file[name]["keypoints"][:].astype(float) + 0.5
                d = file[name]["descriptors"][:].T.astype(np.float32)
                descriptors[name] = d / np.linalg.norm(d, axis=1, keepdims=True)
        return keypoints, descriptors, spent

    # Once for the model and the queries, if the model is there already.
    of_map = functools.cache(lambda: extracted(place.map))

    def extract_and_match(database_path, names):
        pycolmap.Database.open(database_path).close()
        pycolmap.import_images(database_path, place.images, camera_mode=pycolmap.CameraMode.SINGLE, image_names=names,
                               options=reader_of(place.camera))  # fmt: skip
        keypoints, descriptors, _ = of_map()
        database = pycolmap.Database.open(database_path)
        ids = {name: database.read_image_with_name(name).image_id for name in names}
        for name in names:
            database.write_keypoints(ids[name], keypoints[name].astype(np.float32))
        pairs = [(a, b) for i, a in enumerate(names) for b in names[:i]]
        for a, b in pairs:
            database.write_matches(ids[a], ids[b], mutual_nearest(descriptors[a], descriptors[b]).astype(np.uint32))
        database.close()
        listed = work / "map-pairs.txt"
        listed.write_text("".join(f"{a} {b}\n" for a, b in pairs))
        pycolmap.verify_matches(database_path, listed)

    pycolmap.set_random_seed(0)
    kept = place.kept.with_name(f"{place.kept.name}-{kind}")
    _, model = triangulated(kept, place.images, place.map, place.poses, place.camera, extract_and_match)
    if maps_only:
        return []
    keypoints, descriptors, spent = extracted(place.queries)
    for known, own in zip((keypoints, descriptors), of_map()):
        known.update(own)
    program = f"hloc's steps with {NETWORKS[kind]}, PoseLib"
    errors, times, match_time, _ = by_steps(place, model, keypoints, descriptors, {program: by_poselib})
    each = spent, match_time, times[program]
    of_points = np.median([keypoints[n].shape[0] * (4 + 2 * descriptors[n].shape[1]) for n in place.queries])
    return [
        row(place.folder.name, program, "image", errors[program], each, place.image_bytes()),
        row(place.folder.name, f"{program}, features on the device", "points", errors[program], each, of_points),
    ]


def of_veiloc(veiloc, place, work):
    folder = place.folder
    found = work / "scene.json"
    subprocess.run(
        [veiloc, "eval", "scene", "--quiet", "--posed", folder / "posed", "--images", folder / "images", "--map-list",
         folder / "map.txt", "--query-list", folder / "query.txt", "--schemes", "points,random-lines,dcl", "--thresholds",
         "0.05/5,0.25/2", "--query-keypoints", str(KEYPOINTS), "--json", found],
        check=True, stdout=subprocess.DEVNULL)  # fmt: skip
    document = json.loads(found.read_text())
    rows = []
    for scheme in document["schemes"]:
        queries = [q for q in document["queries"] if q["scheme"] == scheme["scheme"]]
        known = lambda value: np.inf if value is None else value
        errors = [(known(q.get("rotation_error_deg")), known(q.get("translation_error"))) for q in queries]
        ms = scheme["median_ms"]
        match = ms["retrieve"] + ms["match"]
        sent = "points" if scheme["scheme"] == "points" else "lines"
        rows.append(row(folder.name, f"veiloc, {scheme['scheme']}", sent, errors, (ms["extract"], match, ms["pose"]),
                        scheme["sealed_bytes"]))  # fmt: skip
    return rows


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--veiloc", default="veiloc")
    parser.add_argument("--places", default=",".join(PLACES))
    parser.add_argument("--learned", default="", help=f"these networks in place of the other programs: {', '.join(NETWORKS)}")
    parser.add_argument("--csv", type=Path)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--maps-only", action="store_true")
    parser.add_argument("--times", action="store_true", help="write times too: for a machine that does nothing else")
    args = parser.parse_args()
    pycolmap.logging.minloglevel = 2
    rows = []
    for place in args.places.split(","):
        place = Place(args.data / place, args.work / place)
        with tempfile.TemporaryDirectory() as work:
            if args.learned:
                for kind in args.learned.split(","):
                    rows += of_learned(kind, args.veiloc, place, Path(work), args.maps_only)
            else:
                rows += of_colmap(place, Path(work), args.maps_only)
                if not args.maps_only:
                    rows += of_veiloc(args.veiloc, place, Path(work))
        # After each place, so that an interrupted run shows what it has.
        if rows:
            end = None if args.times else -len(TIMES)
            write_csv(args.csv, [*COLUMNS, *TIMES][:end], [row[:end] for row in rows])


if __name__ == "__main__":
    main()
