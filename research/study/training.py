"""What is fitted on images of other places: the projection of compact descriptors, and the match prior."""

import base64
import gzip
import hashlib
import json
import random
import shutil
import tempfile
from pathlib import Path

from study.common import MODEL_FILES, Package, command
from study.geometry import rotation

PAGE = "features"
np, cv2, spatial = Package("numpy"), Package("cv2"), Package("scipy.spatial")
SHIFT = {"sift": 18, "learned": 16}  # learned descriptors vary less, so their weights are larger
LEVELS = 16
# For each descriptor type; the values for networks were chosen for XFeat and ALIKE on 18 images outside training and validation.
COUNT = {"sift": 64, "learned": 48}  # numbers of the file
SPREADS = {"sift": 2.5, "learned": 3.2}  # standard deviations on either side that the levels cover
FLOOR = {"sift": 0.1, "learned": 0.5}  # added to variances of pairs, in parts of their mean
TRAIN = {"sift": 500, "learned": 200}  # training images
PAIR_PX, RIGHT_PX = 1.5, 3.0
# Largest descriptor distance of a pair; larger distances come from another orientation or scale at the same position. For networks in
# parts of the descriptor length: their numbers have both signs, so different descriptors are farther apart than with RootSIFT.
FARTHEST = {"sift": 230.0, "learned": 0.8}
WARPS = 2


def images_of(run):
    return Path(run.images or run.place("training-photos"))


def names_by_hash(folder):
    names = [str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()]
    return sorted(names, key=lambda name: hashlib.sha256(name.encode()).hexdigest())


def warp(image, draw):
    """A random homography, and the warped image with other blur, brightness and noise."""
    height, width = image.shape[:2]
    scale, turn, stretch = 2 ** draw.uniform(-0.7, 0.7), draw.gauss(0, 0.25), 2 ** draw.gauss(0, 0.25)
    cos, sin = np.cos(turn), np.sin(turn)
    affine = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]) @ np.diag([scale * stretch, scale / stretch, 1])
    tilt = np.eye(3)
    tilt[2, :2] = [draw.gauss(0, 0.2) / max(width, height) for _ in range(2)]
    centred = np.array([[1, 0, -width / 2], [0, 1, -height / 2], [0, 0, 1]])
    homography = np.linalg.inv(centred) @ tilt @ affine @ centred
    sampling = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
    out = cv2.warpPerspective(image, homography, (width, height), flags=sampling, borderMode=cv2.BORDER_REFLECT)
    out = 255 * (out.astype(np.float32) / 255) ** (2 ** draw.gauss(0, 0.4)) * 2 ** draw.gauss(0, 0.3) + draw.gauss(0, 15)
    if draw.random() < 0.4:
        out = cv2.GaussianBlur(out, (0, 0), draw.uniform(0.4, 1.5))
    noise = np.random.default_rng(draw.getrandbits(32)).normal(0, draw.uniform(0, 6), out.shape)
    return homography, np.clip(out + noise, 0, 255).astype(np.uint8)


def keypoints(run, features, names, folder):
    """[(keypoints, descriptors) of an image, [(homography, (keypoints, descriptors))] of its warps]"""
    homographies = {}
    for number, name in enumerate(names):
        image = cv2.imread(str(images_of(run) / name))
        if image is None:
            continue
        draw = random.Random(name)
        cv2.imwrite(str(folder / f"{number:04d}_0.png"), image)
        for k in range(1, WARPS + 1):
            homography, warped = warp(image, draw)
            homographies[f"{number:04d}", k] = homography
            cv2.imwrite(str(folder / f"{number:04d}_{k}.png"), warped)
    out = folder / "keypoints.jsonl.gz"
    engine = ["--engine", run.engine] if run.engine else []
    run.run("--quiet", "eval", "keypoints", folder, "--features", features, "--max-keypoints", 1024, "-o", out, *engine)
    found = {}
    with gzip.open(out) as lines:
        for row in map(json.loads, lines):
            numbers = np.frombuffer(base64.b64decode(row["descriptors"]), np.uint8).astype(np.int16)
            if row["descriptor_encoding"] != "unsigned":
                numbers -= 128
            found[Path(row["name"]).stem] = (np.array(row["keypoints"]).reshape(-1, 2), numbers.reshape(-1, row["descriptor_dim"]))
    both = {}
    for (number, k), homography in homographies.items():
        both.setdefault(number, []).append((homography, found[f"{number}_{k}"]))
    return [(found[f"{number}_0"], warps) for number, warps in both.items()]


def moved(points, homography):
    """Warps points by a homography; points behind the camera are moved far away."""
    ahead = np.c_[points, np.ones(len(points))] @ homography.T
    out = ahead[:, :2] / ahead[:, 2:]
    return np.where((ahead[:, 2:] > 0) & (np.abs(out) < 1e5), out, -1e4)


def pairs(images, farthest):
    """Descriptors of pairs, `[N, numbers]` each; of several keypoints at one position the most similar one."""
    first, second = [], []
    for (points, own), warps in images:
        for homography, (other_points, other) in warps:
            if not len(other_points):
                continue
            tree = spatial.cKDTree(other_points)
            for i, near in enumerate(tree.query_ball_point(moved(points, homography), PAIR_PX)):
                if near:
                    away = ((other[near].astype(np.float32) - own[i]) ** 2).sum(1)
                    if away.min() < farthest**2:
                        first.append(own[i])
                        second.append(other[near[int(away.argmin())]])
    return np.array(first, np.float64), np.array(second, np.float64)


def discriminant(first, second, count, floor):
    """Mean, and the `count` discriminant directions `[count, numbers]`, in which pairs have unit variance."""
    apart = first - second
    values, vectors = np.linalg.eigh(apart.T @ apart / len(apart) / 2)
    whiten = vectors @ np.diag((values + floor * values.mean()) ** -0.5) @ vectors.T
    both = np.vstack([first, second])
    _, directions = np.linalg.eigh(whiten @ np.cov(both.T) @ whiten)
    return both.mean(0), directions[:, ::-1][:, :count].T @ whiten


def integers(first, mean, directions, spreads, shift):
    """Weights `[count, numbers]` i16 and offsets `[count]` i32 of the file."""
    step = 2 * spreads * ((first - mean) @ directions.T).std() / LEVELS
    weights = np.round(directions / step * 2**shift)
    assert np.abs(weights).max() < 2**15
    offsets = np.round(-(directions @ mean) / step * 2**shift)
    # The median length of the output, with level centres as multiples of 16: the value of `DescriptorKind::norm`.
    coarse = 16 * project(weights, offsets, first, shift)
    return weights.astype("<i2"), offsets.astype("<i4"), float(np.median(np.linalg.norm(coarse, axis=1)))


def project(weights, offsets, descriptors, shift):
    """`[N, count]`, -7.5 to 7.5: centres of the levels."""
    sums = descriptors.astype(np.int64) @ weights.astype(np.int64).T + offsets.astype(np.int64)
    return np.clip(sums >> shift, -LEVELS // 2, LEVELS // 2 - 1).astype(np.float32) + 0.5


def found(images, encode, others=12):
    """Share of keypoints with a partner whose nearest neighbour, among the warped and other images, is this partner."""
    draw = np.random.default_rng(1)
    encoded = [encode(own[1]) for own, _ in images]
    right = total = 0
    for number, ((points, _), warps) in enumerate(images):
        for homography, (other_points, other) in warps:
            drawn = [n for n in draw.permutation(len(images)) if n != number][:others]
            pool = np.vstack([encode(other)] + [encoded[n] for n in drawn])
            nearest = ((pool**2).sum(1) - 2 * encoded[number] @ pool.T).argmin(1)
            at = moved(points, homography)
            has = spatial.cKDTree(other_points).query(at)[0] < PAIR_PX
            own = has & (nearest < len(other_points))
            off = np.linalg.norm(other_points[nearest[own]] - at[own], axis=1)
            right, total = right + int((off < RIGHT_PX).sum()), total + int(has.sum())
    return right / total


def distances(images, encode, length):
    """Prints distances of descriptors: of one keypoint in two images, and to the nearest descriptor of another image."""
    draw = np.random.default_rng(2)
    encoded = [encode(own[1]) for own, _ in images]
    same, apart = [], []
    for number, ((points, _), warps) in enumerate(images):
        other_image = encoded[(number + 1) % len(images)]
        drawn = encoded[number][draw.permutation(len(encoded[number]))[:200]]
        apart.append(np.sqrt(((drawn[:, None] - other_image[None]) ** 2).sum(2)).min(1))
        for homography, (other_points, other) in warps:
            if len(other_points):
                off, nearest = spatial.cKDTree(other_points).query(moved(points, homography))
                near = off < PAIR_PX
                same.append(np.linalg.norm(encoded[number][near] - encode(other)[nearest[near]], axis=1))
    same, apart = np.concatenate(same), np.concatenate(apart)
    for what, values, parts in [("of one place", same, (50, 75, 90)), ("nearest of another image", apart, (1, 5, 50))]:
        percentiles = ", ".join(f"{part} % below {np.percentile(values, part):.0f} ({np.percentile(values, part) / length:.3f})" for part in parts)
        print(f"   distances, {what}: {percentiles}")


@command("features/projection.csv", needs=MODEL_FILES,
         features=(["sift", "xfeat", "alike-t"], "sift, a model of `veiloc models` whose file VEILOC_MODELS finds, or a .toml"),
         images=("", "folder of images of other places (default: training-photos of the data)"),
         train=(0, "number of training images, the first by a hash of their names; 500 for sift, 200 for a network"),
         judge=(30, "number of validation images, the last by that hash"),
         count=(0, "numbers of the file, an even number; 64 of sift, 48 of a network"),
         into=("", "file for the projection of one kind of features"), engine=("", "engine that runs the network (default: rten)"))  # fmt: skip
def projection(run):
    """Trains the projection of compact descriptors: RootSIFT to 64 numbers of 4 bits, or the descriptors of a network to 48.

    Linear discriminant analysis. Training images are warped by random homographies, blurred, darkened and given noise; keypoints of an
    image and its warped version within 1.5 px of each other are pairs. The projection whitens the differences of pairs (within-class
    covariance), and selects the directions in which descriptors of different keypoints differ most (between-class covariance). All
    numbers have the same step of the 4 bits, so Euclidean distance discriminates. For RootSIFT of the program:
    `--features sift --into crates/device/features/src/compact/projection.bin`.

    File: 64 (48, or `--count`) rows of little endian i16, one for each number of a descriptor, then as many i32. Number `i` of a
    descriptor `x` is `(Σ w[i, j] x[j] + o[i]) >> 18`, from -8 to 7, in integers, so that every machine computes the same. For network
    descriptors `x[j]` is the byte as a signed number, and the shift is 16.

    The table has the share of keypoints in validation images whose nearest neighbour among the keypoints of 13 images is their partner,
    for the original descriptors and for projections to other lengths."""
    if run.into and len(run.features) > 1:
        raise SystemExit("--into takes the projection of one kind of features")
    table = run.table("features/projection.csv", "descriptors", "numbers", "bits a number", "bytes", "nearest neighbour right (%)")
    names = names_by_hash(images_of(run))
    for features in run.features:
        which = features if features in FARTHEST else "learned"
        farthest, shift, train = FARTHEST[which], SHIFT[which], run.train or TRAIN[which]
        with tempfile.TemporaryDirectory() as folder:
            folders = [Path(folder) / name for name in ("train", "judge")]
            for path in folders:
                path.mkdir()
            learned = keypoints(run, features, names[:train], folders[0])
            if which == "learned":
                farthest *= np.median(np.concatenate([np.linalg.norm(own[1].astype(float), axis=1) for own, _ in learned]))
            first, second = pairs(learned, farthest)
            judged = keypoints(run, features, names[-run.judge :], folders[1])
        add = lambda *row: table.add([*row[:-1], f"{100 * row[-1]:.1f}"])
        print(f"{len(first)} pairs of {train} images")
        own, chosen = first.shape[1], run.count or COUNT[which]
        add(features, own, 8, own, found(judged, lambda x: x.astype(np.float32)))
        for count in sorted(count for count in {32, 48, 64, 96, chosen} if count <= own):
            mean, directions = discriminant(first, second, count, FLOOR[which])
            weights, offsets, length = integers(first, mean, directions, SPREADS[which], shift)
            plain = found(judged, lambda x: ((x - mean) @ directions.T).astype(np.float32))
            add(f"{features}, projected", count, "not cut", "", plain)
            add(f"{features}, projected", count, 4, count // 2, found(judged, lambda x: project(weights, offsets, x, shift)))
            if count == chosen:
                print(f"   their median length is {length:.0f}")
                distances(judged, lambda x: 16 * project(weights, offsets, x, shift), length)
                if run.into:
                    Path(run.into).write_bytes(weights.tobytes() + offsets.tobytes())


HELD_OUT = ["lund-door", "redkitchen", "herzjesu"]


def held_out(run, features: str, folder: Path, more=()):
    """Matches of map images, each held out once, and all keypoints of the same images with descriptors, for `attack` and for training:
    every third block of consecutive images is held out, fold after fold."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in HELD_OUT:
        place, is_door = run.place(name), name == "lund-door"
        names = sorted(path.name for path in (place / "images").iterdir()) if is_door else (place / "map.txt").read_text().split()
        block = 4 if name == "redkitchen" else 1
        with tempfile.TemporaryDirectory() as work:
            kinds = {"": Path(work) / "fold.jsonl", "_keypoints": Path(work) / "fold_keypoints.jsonl"}
            outs = {kind: gzip.open(folder / f"{name}{kind}.jsonl.gz", "wb") for kind in kinds}
            for fold in range(3):
                lists = [[n for i, n in enumerate(names) if (i // block % 3 == fold) == is_query] for is_query in (False, True)]
                listed = [run.listed(f"{what}-{name}", own) for what, own in zip(("map", "query"), lists)]
                run.run("-q", "eval", "problems", "--features", features, "--posed", place / ("sparse" if is_door else "posed"),
                        "--images", place / "images", "--map-list", listed[0], "--query-list", listed[1], "-o", kinds[""],
                        "--keypoints", kinds["_keypoints"], *more)  # fmt: skip
                for kind, out in outs.items():
                    with kinds[kind].open("rb") as file:
                        shutil.copyfileobj(file, out)
            for out in outs.values():
                out.close()


@command(features="sift", into=("train", "folder of the files"), more=("", "further options of `veiloc eval problems`"))
def training_problems(run):
    """Correspondence sets of map images, each held out once, on which priors and defaults are chosen. Query lists stay unused, for the
    final results."""
    held_out(run, run.features, Path(run.into), run.more.split())


RIGHT_WITHIN_PX = 4.0


def evidence_of(path):
    """Evidence `[matches, 3]` (ratio, ln votes, ln track length) and whether each match is right `[matches]`."""
    evidence, right = [], []
    with gzip.open(path, "rt") as lines:
        for line in lines:
            d = json.loads(line)
            assert d["camera"]["model"] == "PINHOLE", "the problems hold undistorted pixels of a pinhole camera"
            fx, fy, cx, cy = d["camera"]["params"]
            pose = d["cam_from_world"]
            p = np.array(d["points3d"]) @ rotation(pose["q"]).T + np.array(pose["t"])
            seen = np.column_stack([fx * p[:, 0] / p[:, 2] + cx, fy * p[:, 1] / p[:, 2] + cy])
            error = np.linalg.norm(seen - np.array(d["points2d"]), axis=1)
            right.append((p[:, 2] > 0) & (error < RIGHT_WITHIN_PX))
            evidence.append(np.column_stack([d["ratio"], np.log(d["votes"]), np.log(d["track_length"])]))
    return np.vstack(evidence), np.concatenate(right)


def fitted_to(designs, ridge=1e-3):
    a = np.vstack([d for d, _ in designs])
    y = np.concatenate([right for _, right in designs])
    weight = np.concatenate([np.full(len(right), 1 / len(right)) for _, right in designs])
    weight *= len(weight) / weight.sum()
    w = np.zeros(a.shape[1])
    for _ in range(50):
        p = 1 / (1 + np.exp(-a @ w))
        gradient = a.T @ (weight * (p - y)) + ridge * w
        hessian = (a * (weight * p * (1 - p))[:, None]).T @ a + ridge * np.eye(len(w))
        step = np.linalg.solve(hessian, gradient)
        w -= step
        if np.abs(step).max() < 1e-10:
            break
    return w


def log_loss(a, y, w):
    z = a @ w
    return float(np.mean(np.logaddexp(0, z) - y * z))


@command(fit=([], "files of training-problems"), check=([], "files on which only the loss is printed"))
def match_prior(run):
    """Fits the match prior: a logistic regression on descriptor ratio, votes and track length.

    A match is right when its map point reprojects within 4 px of the keypoint under the true pose. Fits by Newton's method with equal
    weight for every file, and prints the coefficients and the mean log loss on each file. The coefficients in the program come from
    held-out map images, never from queries: `--fit train/lund-door.jsonl.gz,train/herzjesu.jsonl.gz --check train/redkitchen.jsonl.gz`."""
    files = [evidence_of(path) for path in run.fit + run.check]
    for name, columns in [("RATIO", 1), ("RATIO_VOTES", 2), ("FULL", 3)]:
        designs = [(np.column_stack([np.ones(len(e)), e[:, :columns]]), y) for e, y in files]
        w = fitted_to(designs[: len(run.fit)])
        losses = ", ".join(f"{log_loss(a, y, w):.4f}" for a, y in designs)
        print(f"{name:12s} {np.array2string(w, precision=3)}  log loss {losses}")
