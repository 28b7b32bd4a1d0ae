"""Tables of docs/results/features.md, and of service.md how much is sent.

Networks are found in the folders of VEILOC_MODELS.
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from study.common import MODEL_FILES, ROOT, SCENES, Package, child_seconds, cm, command, names_of, one_thread
from study.extractors import Colmap, OpenCv, Ours, Wasm, agreement, mutual_matches, warp, warps
from study.geometry import angle, read_posed
from study.training import held_out
from study.trust import stress_table

np, cv2, pycolmap, Image, onnxruntime = (Package(name) for name in ("numpy", "cv2", "pycolmap", "PIL.Image", "onnxruntime"))
# Kind: numbers, bits of each, what the network gets.
KINDS = {
    "sift": (128, 8, "as it is"), "compact": (64, 4, "as it is"), "xfeat": (64, 8, "fitted into the file's size"),
    "xfeat-compact": (48, 4, "as xfeat"), "alike-t": (64, 8, "as it is"), "alike-t-compact": (48, 4, "as it is"),
    "alike": (128, 8, "as it is"), "aliked-t16": (64, 8, "as it is"), "aliked-n16": (128, 8, "as it is"),
    "aliked-n16rot": (128, 8, "as it is"), "aliked-n32": (128, 8, "as it is"), "superpoint": (256, 8, "longest side 1024"),
}  # fmt: skip
MEASURED = [kind for kind in KINDS if kind != "superpoint"]
THRESHOLDS = {"redkitchen": ("0.02/2", "0.05/5"), "herzjesu": ("0.1/2", "0.25/5")}
STRESSED = "alike-t-compact"
SENT = [256, 512, 1024, 2048, 4096]
IMAGES = [("RedKitchen frame-000295, 640 × 480", "redkitchen/images/frame-000295.color.jpg"),
          ("Herz-Jesu 0000.jpg, 1536 × 1024", "herzjesu/images/0000.jpg")]  # fmt: skip


def eval_scene(run, place: str, schemes: str, *options) -> list[dict]:
    thresholds = ",".join(THRESHOLDS[place])
    return run.document("eval", "scene", *run.scene(place), "--schemes", schemes, "--thresholds", thresholds, *options)["schemes"]


@command("features/scenes.csv", "features/kinds.csv", needs=MODEL_FILES, features=MEASURED)
def scenes(run):
    """Poses of RedKitchen and Herz-Jesu with each kind of features, and the kinds."""
    table = run.table("features/scenes.csv", "scene", "features", "scheme", "median error (cm)", "median error (°)",
                      "within 2 cm (10 cm) and 2° (%)", "inliers (%)", "query (bytes)")  # fmt: skip
    bytes_of = {}
    for scene, place in SCENES.items():
        for kind in run.features:
            for row in eval_scene(run, place, "points,dcl", "--features", kind):
                within = f"{100 * row['recall'][THRESHOLDS[place][0]]:.1f}"
                table.add({"scene": scene, "features": kind, "within 2 cm (10 cm) and 2° (%)": within}, row)
                if row["scheme"] == "dcl":
                    bytes_of[kind] = max(row["sealed_bytes"], bytes_of.get(kind, 0))
    kinds = run.table("features/kinds.csv", "`--features`", "numbers", "bits a number", "dcl query of 2048 rows (bytes)", "network input")
    for kind, (numbers, bits, image) in KINDS.items():
        kinds.add([f"`{kind}`", numbers, bits, bytes_of.get(kind, ""), image])


@command("features/learned-stress.csv", needs=MODEL_FILES)
def learned_stress(run):
    """`alike-t-compact` under stress."""
    stress_table(run, "features/learned-stress.csv", "--features", STRESSED)


def folds(run, kind: str) -> Path:
    """Folder of the matches of map images, each held out of its own map."""
    folder = run.kept() / f"folds-{kind}"
    if not folder.exists():
        partial = folder.with_suffix(".partial")
        held_out(run, kind, partial, ["--query-keypoints", 1024])
        partial.rename(folder)
    return folder


@command("features/compact.csv", "features/compact-cost.csv")
def compact(run):
    """RootSIFT beside compact descriptors, on the queries and on map images that are held out of their own map."""
    kinds = ("sift", "compact")
    of = lambda what, unit: [f"{what}, {kind} ({unit})" for kind in kinds]
    table = run.table("features/compact.csv", "queries", *of("points", "cm"), *of("dcl", "cm"), *of("points inliers", "%"))
    cost = run.table("features/compact-cost.csv", "scheme", *of("query of 1024 rows", "bytes"), *of("matching", "ms"))
    for scene, place in SCENES.items():
        found = [eval_scene(run, place, "points,dcl", "--query-keypoints", 1024, "--features", kind) for kind in kinds]
        table.add([f"{scene}, {found[0][0]['queries']} queries", *compared(found)])
        for rows in zip(*found) if place == "redkitchen" else ():
            cost.add([rows[0]["scheme"], *(row["sealed_bytes"] for row in rows), *(f"{row['median_ms']['match']:.1f}" for row in rows)])
    for scene, place in [*SCENES.items(), ("Lund door", "lund-door")]:
        files = [folds(run, kind) / f"{place}.jsonl.gz" for kind in kinds]
        found = [run.document("eval", "pose", file, "--schemes", "points,dcl")["schemes"] for file in files]
        table.add([f"{scene}, folds, {found[0][0]['queries']}", *compared(found)])


def compared(found: list[list[dict]]) -> list[str]:
    """Median errors of points and dcl with each kind, and inliers of points."""
    errors = [cm(row["median_translation"]) for rows in zip(*found) for row in rows]
    return errors + [f"{100 * rows[0]['mean_inlier_ratio']:.1f}" for rows in found]


@command("features/global-poses.csv")
def global_poses(run):
    """Poses with VLAD and with a global descriptor of a network."""
    table = run.table("features/global-poses.csv", "scene", "global descriptor", "scheme", "queries", "localized", "median error (cm)",
                      "median error (°)", "trusted", "trusted wrongly", "inliers (%)", "query (bytes)")  # fmt: skip
    os.environ.setdefault("VEILOC_MODELS", str(run.place("../weights")))
    for scene, place in SCENES.items():
        for model in ("vlad", "xfeat-netvlad"):
            for row in eval_scene(run, place, "points,dcl", "--global", model):
                table.add({"scene": scene, "global descriptor": model}, row)


@command("service/bytes.csv")
def sent_bytes(run):
    """Sealed queries by number of keypoints."""
    kinds = {"compact": "compact", "sift": "RootSIFT"}
    table, sizes = run.table("service/bytes.csv", "keypoints", *(f"dcl, {name} (bytes)" for name in kinds.values())), {}
    image = run.place("herzjesu") / "images/0000.jpg"
    with tempfile.TemporaryDirectory() as work:
        for kind in kinds:
            file, profile, query = (Path(work) / name for name in ("map", "profile", "query"))
            run.run("map", "build", "--quiet", *run.posed("herzjesu"), "--list", run.place("herzjesu") / "map.txt", "--features", kind,
                    "--query-keypoints", 4096, "-o", file)  # fmt: skip
            run.run("map", "profile", "--quiet", file, "-o", profile)
            for number in SENT:
                run.run("seal", "--quiet", image, "--camera", "unknown", "--profile", profile, "--max-keypoints", number, "-o", query)
                sizes[kind, number] = query.stat().st_size
    for number in SENT:
        table.add([number, *(sizes[kind, number] for kind in kinds)])


@command("service/image-bytes.csv")
def image_bytes(run):
    """The same images as JPEG."""
    qualities = (75, 90, 95)
    table = run.table("service/image-bytes.csv", "image", *(f"JPEG quality {quality} (bytes)" for quality in qualities))
    for name, path in IMAGES:
        image = cv2.imread(str(run.place(path)))
        table.add([name, *(len(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]) for quality in qualities)])


EPIPOLAR_PX = 2.0


@command("features/extractors.csv", keypoints=2048, photos=(8, "photographs that are warped"))
def extractors(run):
    """Our SIFT beside pycolmap's and OpenCV's: repeatability and matching score for the same number of keypoints.

    Every extractor gets the same gray images (COLMAP's gray). Two kinds of pairs: an image and its warp by a known homography (rotation
    by 30 degrees, scale 0.7, perspective, a change of light with noise); and two photographs with known poses, where a mutual nearest
    neighbour is correct within 2 px of its epipolar line in both. Printed are the scenes, and the means over the kinds of warps and over
    the scenes."""
    table = run.table("features/extractors.csv", "pairs", "number of pairs", "extractor", "keypoints", "repeatable (%)",
                      "matching score (%)", "correct matches per pair")  # fmt: skip
    binary, n = run.example("veiloc-features", "extract"), run.keypoints
    rivals = [Ours(binary, n), Colmap(n), OpenCv(n)]
    colmap_gray = lambda path: np.ascontiguousarray(pycolmap.Bitmap.read(str(path), False).to_array()).squeeze()
    # {kind of pair: {extractor: rows of (keypoints, repeatability, score, correct)}}
    warped, posed = {}, {}
    for path in sorted(run.place("photos").glob("*.jpg"))[:: max(1, 39 // run.photos)][: run.photos]:
        gray = colmap_gray(path)
        before = [extractor(gray) for extractor in rivals]
        for kind, (homography, size, light) in warps(*gray.shape[::-1]).items():
            image = warp(gray, homography, size, light)
            for rival, own in zip(rivals, before):
                row = len(own[0]), *agreement(own, rival(image), homography, size)
                warped.setdefault(kind, {}).setdefault(rival.name, []).append(row)
    for scene, model, gaps, count in [("redkitchen", "posed", [2, 6], 8), ("herzjesu", "posed", [1, 2], 5), ("lund-door", "sparse", [1, 3], 3)]:
        poses, features = read_posed(run.place(scene) / model), {}
        for pair in pairs_of(sorted(poses), gaps, count):
            for name in pair:
                if name not in features:
                    gray = colmap_gray(run.place(scene) / "images" / name)
                    features[name] = [extractor(gray) for extractor in rivals]
            for rival, a, b in zip(rivals, *(features[name] for name in pair)):
                row = posed_row(a, b, *(poses[name] for name in pair))
                posed.setdefault(scene, {}).setdefault(rival.name, []).append(row)

    def add(title, count, name, values):
        keypoints, repeat, score, correct = np.mean(values, axis=0)
        table.add([title, count, name, f"{keypoints:.0f}", "" if np.isnan(repeat) else f"{100 * repeat:.1f}", f"{100 * score:.1f}",
                   f"{correct:.0f}"])  # fmt: skip

    for scene, found in posed.items():
        for name, values in found.items():
            add(scene, len(values), name, values)
    for title, kinds in {"all warps": warped, "all posed": posed}.items():
        for rival in rivals:
            add(title, "", rival.name, [np.mean(found[rival.name], axis=0) for found in kinds.values()])


def plane_of(points, camera):
    """Undistorted points on the plane z = 1, and the focal lengths; of a camera with at most one radial term."""
    model, _, _, *params = camera.split()
    p = [float(x) for x in params]
    fx, fy, cx, cy, k = (*p[:4], 0.0) if model == "PINHOLE" else (p[0], *p, 0.0)[:5]
    seen = (points - [cx, cy]) / [fx, fy]
    plane = seen.copy()
    for _ in range(20):
        plane = seen / (1 + k * (plane**2).sum(1, keepdims=True))
    return np.c_[plane, np.ones(len(plane))], (fx, fy)


def posed_row(features_a, features_b, pose_a, pose_b):
    """Keypoints, no repeatability, share and number of the matches whose larger distance to the epipolar line of the other point is
    small, in pixels of the undistorted images."""
    (points_a, descriptors_a), (points_b, descriptors_b) = features_a, features_b
    i, j = mutual_matches(descriptors_a, descriptors_b)
    r = pose_b.r @ pose_a.r.T
    t = pose_b.t - r @ pose_a.t
    essential = np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]]) @ r
    (a, focal_a), (b, focal_b) = plane_of(points_a[i, :2], pose_a.camera), plane_of(points_b[j, :2], pose_b.camera)
    in_b, in_a = a @ essential.T, b @ essential
    value = np.abs((b * in_b).sum(1))
    away = [value / np.linalg.norm(line[:, :2] / focal, axis=1) for line, focal in ((in_b, focal_b), (in_a, focal_a))]
    correct = np.maximum(*away) < EPIPOLAR_PX
    return len(points_a), np.nan, correct.mean(), correct.sum()


def pairs_of(names, gaps, count):
    """`count` pairs with each gap, spread evenly over the sequence."""
    pairs = []
    for gap in gaps:
        starts = np.linspace(0, len(names) - 1 - gap, min(count, len(names) - gap)).round().astype(int)
        pairs += [(names[i], names[i + gap]) for i in dict.fromkeys(starts.tolist())]
    return pairs


def gray_image(run, path):
    return cv2.imread(str(run.place(path)), cv2.IMREAD_GRAYSCALE)


FRAME = "redkitchen/images/frame-000000.color.jpg"
# OpenCV's contrast threshold, three times our peak threshold of 0.004; its default finds fewer keypoints.
CONTRAST = (0.012, "OpenCV's contrast threshold")


@command("features/sift-speed.csv", needs="the target wasm32-unknown-unknown, and node", images=([FRAME], "images of the data"), keypoints=2048,
         contrast=CONTRAST, rounds=8, native=(False, "without WebAssembly"),
         extract=([], "builds of the example `extract`, in place of this one"))  # fmt: skip
def sift_speed(run):
    """Our SIFT beside OpenCV's: time with one thread each, in alternating rounds, and repeatability.

    Both get the same gray bytes, double the image first, and return their own best N keypoints. Times are processor times of an extraction
    without reading the image, median of all rounds (a round is the mean of a few; for WebAssembly the median of a few); other load on the
    machine affects them less than wall time. Repeatable, matching score and correct matches are means over four warps. Ours is also built
    for WebAssembly with 128-bit vectors and run by node; its output must equal that of the first build."""
    table = run.table("features/sift-speed.csv", *(["image"] if len(run.images) > 1 else []), "extractor", "time (ms)", "time over OpenCV",
                      "keypoints", "repeatable (%)", "matching score (%)", "correct matches")  # fmt: skip
    builds = run.extract or [run.example("veiloc-features", "extract")]
    rivals = [OpenCv(run.keypoints, contrastThreshold=run.contrast)]
    rivals += [Ours(binary, run.keypoints, name=f"veiloc, {binary}" if len(builds) > 1 else "veiloc") for binary in builds]
    with tempfile.TemporaryDirectory() as folder:
        rivals += [] if run.native else [Wasm(run.keypoints, Path(folder))]
        for path in run.images:
            gray = gray_image(run, path)
            # Not the minimum: our times are differences of two runs, whose minimum is biased.
            median = np.median([[rival.seconds(gray) for rival in rivals] for _ in range(run.rounds)], axis=0)
            chosen = [(warp(gray, *how), how) for how in warps(*gray.shape[::-1]).values()]
            for rival, seconds in zip(rivals, median):
                before = rival(gray)
                if isinstance(rival, Wasm):
                    assert all((a == b).all() for a, b in zip(before, rivals[1](gray))), "other bytes than the native program's"
                repeat, score, correct = np.mean([agreement(before, rival(image), *how[:2]) for image, how in chosen], axis=0)
                image = [f"{Path(path).stem} {gray.shape[1]} x {gray.shape[0]}"] if len(run.images) > 1 else []
                table.add([*image, rival.name, f"{1e3 * seconds:.1f}", f"{seconds / median[0]:.2f}", len(before[0]),
                           f"{100 * repeat:.1f}", f"{100 * score:.1f}", f"{correct:.0f}"])  # fmt: skip


SAME_PX, SAME_SHARE = 0.1, 0.99
# Extractions per timing.
REPEATS = 2


class Network:
    """A network in veiloc, run by one engine: the whole extraction, from the gray image in memory to the bytes of descriptors."""

    def __init__(self, program, model, file, engine, keypoints):
        self.name = "veiloc, " + {"rten": "rten", "onnxruntime": "ONNX Runtime"}[engine]
        self.command, self.keypoints = [program, model, file], keypoints
        library = next((Path(onnxruntime.__file__).parent / "capi").glob("libonnxruntime.*"))
        self.environment = {"VEILOC_ENGINE": engine, "ORT_DYLIB_PATH": str(library)}

    def run(self, what, gray, *job):
        with tempfile.NamedTemporaryFile(suffix=".png") as image:
            cv2.imwrite(image.name, gray)
            return child_seconds([*self.command, what, image.name, self.keypoints, *job], self.environment)

    def seconds(self, gray):
        return (self.run("time", gray, 1 + REPEATS) - self.run("time", gray, 1)) / REPEATS

    def __call__(self, gray):
        with tempfile.NamedTemporaryFile() as out:
            self.run("keypoints", gray, out.name)
            return np.fromfile(out.name, "<f4").reshape(-1, 2), None


class Runtime:
    """ONNX Runtime from PyPI on the same graph: the network only, on an input of the same size."""

    name = "ONNX Runtime from PyPI, the network alone"

    def __init__(self, graph, shape):
        session = onnxruntime.InferenceSession(str(graph), one_thread(), providers=["CPUExecutionProvider"])
        inputs = {session.get_inputs()[0].name: np.random.default_rng(1).random(shape, np.float32)}
        self.job = lambda: session.run(None, inputs)
        self.job()

    def seconds(self, _):
        start = time.process_time()
        for _ in range(REPEATS):
            self.job()
        return (time.process_time() - start) / REPEATS


@command("features/network-speed.csv", needs=MODEL_FILES, weights=("", "folder of the network files (default: weights beside the data)"),
         features=["sift", "xfeat", "alike-t", "alike", "superpoint"], image=(FRAME, "an image of the data"), keypoints=2048,
         contrast=CONTRAST, rounds=8)  # fmt: skip
def network_speed(run):
    """Feature extraction beside other implementations, with one thread each, in alternating rounds.

    SIFT and compact features beside OpenCV's SIFT, and each network, run by rten and by ONNX Runtime in veiloc, beside ONNX Runtime from
    PyPI. Times are processor times, median of all rounds. Both engines must find the same keypoints: fails when less than 99 % of rten's
    have one of ONNX Runtime's within 0.1 px."""
    table = run.table("features/network-speed.csv", "features, input", "program", "time (ms)", "time over the last of its group", "keypoints")
    gray, weights = gray_image(run, run.image), Path(run.weights or run.place("../weights"))
    whole = lambda side, multiple, margin: -(-(side + 2 * margin) // multiple) * multiple
    sides = lambda multiple, margin: tuple(whole(side, multiple, margin) for side in gray.shape)
    networks = [
        ("xfeat", "xfeat/xfeat_800x576.onnx", (1, 1, 576, 800)), ("alike-t", "alike/alike-t.onnx", (1, 3, *sides(32, 96))),
        ("alike", "alike/alike-n.onnx", (1, 3, *sides(32, 96))), ("superpoint", "superpoint/superpoint_v1.onnx", (1, 1, *sides(8, 64))),
    ]  # fmt: skip
    extract = run.example("veiloc-features", "extract")
    layers = run.example("veiloc-features", "layers", "--features", "rten,onnxruntime")
    # The last implementation of a group is the reference.
    groups = {}
    if "sift" in run.features:
        groups["sift"] = [Ours(extract, run.keypoints), Ours(extract, run.keypoints, ["--compact"], "veiloc, compact"),
                          OpenCv(run.keypoints, contrastThreshold=run.contrast)]  # fmt: skip
    for model, file, shape in networks:
        if (weights / file).is_file() and model in run.features:
            own = [Network(layers, model, weights / file, engine, run.keypoints) for engine in ("rten", "onnxruntime")]
            groups[f"{model}, {shape[3]} x {shape[2]}"] = [*own, Runtime(weights / file, shape)]
    times = {(name, rival): [] for name, rivals in groups.items() for rival in rivals}
    for _ in range(run.rounds):
        for (_, rival), seconds in times.items():
            seconds.append(rival.seconds(gray))
    # Not the minimum: our times are differences of two runs, whose minimum is biased.
    median, others = {key: float(np.median(seconds)) for key, seconds in times.items()}, []
    for name, rivals in groups.items():
        found = [None if isinstance(rival, Runtime) else rival(gray)[0][:, :2] for rival in rivals]
        for i, rival in enumerate(rivals):
            seconds = median[name, rival]
            table.add([name, rival.name, f"{1e3 * seconds:.1f}", f"{seconds / median[name, rivals[-1]]:.2f}",
                       "" if found[i] is None else len(found[i])])  # fmt: skip
            # OpenCV has another detector, so its keypoints are not compared.
            if 0 < i < len(rivals) - 1:
                away = np.array([np.square(found[i] - point).sum(1).min() for point in found[0]])
                share = float(np.mean(away < SAME_PX**2))
                print(f"{100 * share:.2f} % within 0.1 px of the first")
                others += [name] if share < SAME_SHARE else []
    if others:
        sys.exit(f"the engines find different keypoints: {', '.join(others)}")


@command("features/seal-frame.csv", needs="tools for phones", frame=("FRAME.pgm", "a gray frame of 1280 x 720"),
         profile=("PLACE.profile", "the profile of any map"))  # fmt: skip
def seal_frame(run):
    """What sealing a frame costs, as scripts/phones/measure.py measures it."""
    write = ["--csv", run.out / "features/seal-frame.csv"] if run.out else []
    subprocess.run([sys.executable, ROOT / "scripts/phones/measure.py", "--frame", run.frame, "--profile", run.profile, "--times", "2",
                    "--rounds", "40", *write], check=True)  # fmt: skip


FOLDS = 5
STRENGTHS = [0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0]


def folder_of(run) -> Path:
    """Folder that caches the vectors."""
    folder = run.kept() / "globals"
    folder.mkdir(exist_ok=True)
    return folder


def gray(path: Path) -> np.ndarray:
    return np.asarray(Image.open(path).convert("RGB"), np.float32) @ np.float32([0.2126, 0.7152, 0.0722]) / 255


def number_of(name: str) -> int:
    return int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "big")


def vectors(run, model: str, paths: list[Path], words: list[Path]) -> np.ndarray:
    """Quantized global descriptors as they are sent, normalized. `[images, numbers]`"""
    out = folder_of(run) / f"{model}-{len(paths)}.f32"
    if not out.exists():
        lists = {"list": paths, "words": words}
        for name, content in lists.items():
            (folder_of(run) / name).write_text("".join(f"{path}\n" for path in content))
        how = ["vlad", folder_of(run) / "words", folder_of(run) / "list"] if model == "vlad" else [model, "vectors", folder_of(run) / "list"]
        environment = dict(os.environ, VEILOC_MODELS=str(Path(run.weights or run.place("../weights"))))
        command = [run.example("veiloc-features", "globals"), *how, out]
        output = subprocess.run(command, check=True, env=environment, capture_output=True, text=True).stdout
        (folder_of(run) / f"{model}.log").write_text(output)
    all_ = np.fromfile(out, np.float32).reshape(len(paths), -1)
    if model != "vlad":
        all_ = np.clip(np.round(all_ * 32 * all_.shape[1] ** 0.5), -127, 127)
    return all_ / np.maximum(np.linalg.norm(all_, axis=1, keepdims=True), 1e-12)


def retrieval(run, all_: np.ndarray, index: dict, photos: list[Path]):
    """Rows of a scene without and with the photos. A map image is right when it is within a distance and an angle of the query."""
    for title, scene, near, degrees in [("RedKitchen", "redkitchen", 0.2, 15), ("Herz-Jesu", "herzjesu", 5.0, 30)]:
        folder = run.place(scene)
        known = read_posed(folder / "posed")
        names, queries = names_of(folder / "map.txt"), names_of(folder / "query.txt")
        at = lambda name: index[folder / "images" / name]
        for others in [[], photos]:
            candidates = [at(name) for name in names] + [index[path] for path in others]
            ranks, of_five = [], []
            for query in queries:
                own = known[query]
                is_right = lambda name: np.linalg.norm(known[name].center - own.center) < near and angle(known[name].r, own.r) < degrees
                right = np.array([is_right(name) for name in names] + [False] * len(others))
                if right.any():
                    order = np.argsort(-(all_[candidates] @ all_[at(query)]), kind="stable")
                    ranks.append(1 + int(np.argmax(right[order])))
                    of_five.append(right[order[:5]].mean())
            r = np.array(ranks)
            shares = [(r == 1).mean(), (r <= 5).mean(), np.mean(of_five)]
            yield [title, r.size, len(candidates), f"{(1 / r).mean():.3f}", *(f"{100 * share:.1f}" for share in shares)]


def persons(run, paths: list[Path]) -> np.ndarray:
    """The detector's largest person score for each image, with gray letterbox padding."""
    cache = folder_of(run) / f"persons-{len(paths)}.npy"
    if cache.exists():
        return np.load(cache)
    session = onnxruntime.InferenceSession(str(Path(run.weights or run.place("../weights")) / "yolo/yolo11n_int8.onnx"))
    scores = []
    for path in paths:
        image = Image.open(path).convert("RGB")
        scale = 320 / max(image.size)
        image = image.resize([max(1, round(side * scale)) for side in image.size], Image.BILINEAR)
        square = np.full((320, 320, 3), 114, np.float32)
        square[: image.height, : image.width] = np.asarray(image)
        output = session.run(None, {session.get_inputs()[0].name: square.transpose(2, 0, 1)[None] / np.float32(255)})[0][0]
        scores.append(float(output[4].max()))
    np.save(cache, scores)
    return np.array(scores)


def ridge(kernel: np.ndarray, targets: np.ndarray, fold: np.ndarray) -> np.ndarray:
    """Cross-validated predictions of ridge regression; the strength is chosen within the training folds."""
    def fitted(train: np.ndarray, test: np.ndarray, strength: float) -> np.ndarray:
        mean = targets[train].mean(0)
        own = kernel[np.ix_(train, train)]
        weights = np.linalg.solve(own + strength * np.trace(own) / len(train) * np.eye(len(train)), targets[train] - mean)
        return mean + kernel[np.ix_(test, train)] @ weights

    predicted = np.zeros_like(targets, dtype=float)
    for held in range(FOLDS):
        train, test = np.flatnonzero(fold != held), np.flatnonzero(fold == held)
        inner, outer = train[fold[train] % 2 == 0], train[fold[train] % 2 == 1]
        lost = [((fitted(inner, outer, s) - targets[outer]) ** 2).sum() for s in STRENGTHS]
        predicted[test] = fitted(train, test, STRENGTHS[int(np.argmin(lost))])
    return predicted


def roc_auc(scores: np.ndarray, labels: np.ndarray) -> float:
    """Area under the ROC curve."""
    order = np.argsort(np.argsort(scores)) + 1
    positive = labels.sum()
    return float((order[labels].sum() - positive * (positive + 1) / 2) / (positive * (len(labels) - positive)))


def roc_auc_error(right: float, labels: np.ndarray) -> float:
    """Standard error of `roc_auc` (Hanley and McNeil, Radiology 1982)."""
    one, other = labels.sum(), len(labels) - labels.sum()
    a, b = right / (2 - right) - right**2, 2 * right**2 / (1 + right) - right**2
    return float(((right * (1 - right) + (one - 1) * a + (other - 1) * b) / (one * other)) ** 0.5)


def explained_variance(targets: np.ndarray, predicted: np.ndarray) -> float:
    """Share of the variance that is predicted (R²)."""
    return float(1 - ((targets - predicted) ** 2).sum() / ((targets - targets.mean(0)) ** 2).sum())


@command("features/global.csv", "features/global-leak.csv", photos=480,
         weights=("", "folder of the network files (default: weights beside the data)"))  # fmt: skip
def global_(run):
    """Retrieval quality of global descriptors, and what they reveal beyond the rows of a query.

    VLAD of RootSIFT and `xfeat-netvlad`, for the scenes and for N training images (chosen by a hash of their names; one eighth trains
    VLAD's vocabulary):
    - retrieval: the rank of the first right map image of each query, without and with the training images as distractors;
    - attribute inference: what linear regression predicts about an image from its vector, cross-validated in five folds: whether a
      detector finds a person, brightness, contrast, its collection, and the other vector."""
    table = run.table("features/global.csv", "global descriptor", "scene", "queries", "map images", "mean reciprocal rank",
                      "first right (%)", "one of 5 right (%)", "of 5 right (%)")  # fmt: skip
    leak = run.table("features/global-leak.csv", "linear reader of", "person: ROC AUC", "standard error", "brightness explained (%)",
                     "contrast explained (%)", "collection right (%)")  # fmt: skip
    photos = sorted(run.place("training-photos").glob("*/*.jpg"), key=lambda path: number_of(path.name))[: run.photos]
    words, held = photos[: len(photos) // 8], photos[len(photos) // 8 :]
    scenes = [path for scene in SCENES.values() for path in sorted((run.place(scene) / "images").glob("*.jpg"))]
    paths = scenes + held
    index = {path: at for at, path in enumerate(paths)}
    models = {model: vectors(run, model, paths, words) for model in ["vlad", "xfeat-netvlad"]}
    for model, all_ in models.items():
        for row in retrieval(run, all_, index, held):
            table.add([model, *row])
    own = {model: all_[len(scenes) :] for model, all_ in models.items()}
    kernels = {model: all_ @ all_.T for model, all_ in own.items()}
    # A regression on both vectors: the mean of both kernels, normalized to the same trace.
    centred = {m: k - k.mean(0) - k.mean(1)[:, None] + k.mean() for m, k in kernels.items()}
    kernels = {m: k / np.trace(k) for m, k in centred.items()}
    kernels["both"] = sum(kernels.values()) / 2
    fold, pixels = np.array([number_of(f"fold {path.name}") % FOLDS for path in held]), [gray(path) for path in held]
    label = persons(run, held) > 0.5
    light = np.array([image.mean() for image in pixels])
    contrast = np.array([image.std() for image in pixels])
    collection = np.array([[path.parent.name == name for name in ["objects", "nature", "streets"]] for path in held], float)
    print(f"{len(held)} images, {label.sum()} with a person")
    for model, kernel in kernels.items():
        person = roc_auc(ridge(kernel, label.astype(float), fold), label)
        brightness, spread = (explained_variance(t, ridge(kernel, t, fold)) for t in [light, contrast])
        chosen = (ridge(kernel, collection, fold).argmax(1) == collection.argmax(1)).mean()
        shares = [f"{100 * share:.1f}" for share in [brightness, spread, chosen]]
        leak.add([model, f"{person:.3f}", f"{roc_auc_error(person, label):.3f}", *shares])
    leak.add(["chance", "0.5", "", "0", "0", f"{100 * collection.mean(0).max():.1f}"])
    turned = label[np.random.default_rng(1).permutation(len(label))]
    print(f"permuted labels: person {roc_auc(ridge(kernels['both'], turned.astype(float), fold), turned):.3f}")
    for a, b in [("vlad", "xfeat-netvlad"), ("xfeat-netvlad", "vlad")]:
        print(f"{a} predicts {explained_variance(own[b], ridge(kernels[a], own[b], fold)):.1%} of the variance of {b}")
