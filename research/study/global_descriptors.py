"""Retrieval quality of global descriptors, and what they reveal beyond the rows of a query.

    global_descriptors.py write --weights DIR
    global_descriptors.py measure --globals target/release/examples/globals --data DIR --weights DIR --folder DIR [--photos N]
        [--csv FILE] [--leak-csv FILE]

`write` writes the reference values of `xfeat-netvlad` for the tests, with ONNX Runtime. `measure` computes VLAD of RootSIFT and
`xfeat-netvlad` with veiloc, for the scenes and for N training images (chosen by a hash of their names; one eighth trains VLAD's
vocabulary). It prints for both:

- retrieval: the rank of the first right map image of each query, without and with the training images as distractors;
- attribute inference: what linear regression predicts about an image from its vector, cross-validated in five folds: whether a
  detector finds a person, brightness, contrast, its collection, and the other vector.

The folder caches the vectors.
"""

import argparse
import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import onnxruntime
from PIL import Image

from places import write_csv

FOLDS = 5
RETRIEVAL = [
    "global descriptor", "scene", "queries", "map images", "mean reciprocal rank", "first right (%)", "one of 5 right (%)",
    "of 5 right (%)",
]  # fmt: skip
LEAK = [
    "linear reader of", "person: ROC AUC", "standard error", "brightness explained (%)", "contrast explained (%)", "collection right (%)",
]  # fmt: skip


def gray(path: Path) -> np.ndarray:
    return np.asarray(Image.open(path).convert("RGB"), np.float32) @ np.float32([0.2126, 0.7152, 0.0722]) / 255


def write(args: argparse.Namespace) -> None:
    """The image of 640 x 480 pixels is centred in XFeat's input, with reflected padding above and below."""
    sys.path.append(str(Path(__file__).resolve().parents[1] / "oracles"))
    from networks import DATA, drawn  # needs PyTorch

    open_ = lambda name: onnxruntime.InferenceSession(str(args.weights / name))
    image = drawn(640, 480)
    whole = np.pad((image - image.mean(dtype=float)) / np.sqrt(image.var(dtype=float) + 1e-5), ((80, 80), (0, 0)), "symmetric")
    features = open_("xfeat/xfeat_640x640.onnx").run(["output_feats"], {"input": whole[None, None].astype(np.float32)})[0]
    given = {"input": np.ascontiguousarray(features[:, 10:70].transpose(0, 3, 1, 2)), "input.1": np.repeat(image[None, None], 3, 1)}
    joined = open_("xfeat-netvlad/xfeat_nv.onnx").run(None, given)[0]
    vector = open_("xfeat-netvlad/netvlad.onnx").run(None, {"input": joined})[0][0].astype(float)
    vector /= np.linalg.norm(vector)
    at = np.sort(np.random.default_rng(1).choice(vector.size, 64, replace=False))
    document = {"largest": float(np.abs(vector).max()), "at": at.tolist(), "values": [float(f"{v:.7g}") for v in vector[at]]}
    (DATA / "xfeat-netvlad.json").write_text(json.dumps(document) + "\n")


def number_of(name: str) -> int:
    return int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "big")


def vectors(args: argparse.Namespace, model: str, paths: list[Path], words: list[Path]) -> np.ndarray:
    """Quantized global descriptors as they are sent, normalized. `[images, numbers]`"""
    out = args.folder / f"{model}-{len(paths)}.f32"
    if not out.exists():
        lists = {"list": paths, "words": words}
        for name, content in lists.items():
            (args.folder / name).write_text("".join(f"{path}\n" for path in content))
        how = ["vlad", args.folder / "words", args.folder / "list"] if model == "vlad" else [model, "vectors", args.folder / "list"]
        environment = dict(os.environ, VEILOC_MODELS=str(args.weights))
        output = subprocess.run([args.globals, *how, out], check=True, env=environment, capture_output=True, text=True).stdout
        (args.folder / f"{model}.log").write_text(output)
    all_ = np.fromfile(out, np.float32).reshape(len(paths), -1)
    if model != "vlad":
        all_ = np.clip(np.round(all_ * 32 * all_.shape[1] ** 0.5), -127, 127)
    return all_ / np.maximum(np.linalg.norm(all_, axis=1, keepdims=True), 1e-12)


def poses(file: Path) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """{name: (rotation, centre)} from COLMAP's images.txt."""
    found = {}
    lines = [line for line in file.read_text().splitlines() if not line.startswith("#")]
    for line in lines[::2]:
        _, w, x, y, z, *t, _, name = line.split(maxsplit=9)
        w, x, y, z = (float(v) for v in (w, x, y, z))
        turn = np.array([
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ])
        found[name] = turn, -turn.T @ np.array([float(v) for v in t])
    return found


def retrieval(all_: np.ndarray, index: dict, data: Path, photos: list[Path]) -> list[list]:
    """Rows of a scene without and with the photos. A map image is right when it is within a distance and an angle of the query."""
    rows = []
    for title, scene, near, degrees in [("RedKitchen", "redkitchen", 0.2, 15), ("Herz-Jesu", "herzjesu", 5.0, 30)]:
        known = poses(data / scene / "posed/images.txt")
        lists = {kind: (data / scene / f"{kind}.txt").read_text().split() for kind in ["map", "query"]}
        at = lambda name: index[data / scene / "images" / name]
        for others in [[], photos]:
            candidates = [at(name) for name in lists["map"]] + [index[path] for path in others]
            ranks, of_five = [], []
            for query in lists["query"]:
                turn, centre = known[query]
                def is_right(name: str) -> bool:
                    other, away = known[name]
                    angle = np.degrees(np.arccos(np.clip((np.trace(other.T @ turn) - 1) / 2, -1, 1)))
                    return bool(np.linalg.norm(away - centre) < near and angle < degrees)
                right = np.array([is_right(name) for name in lists["map"]] + [False] * len(others))
                if right.any():
                    order = np.argsort(-(all_[candidates] @ all_[at(query)]), kind="stable")
                    ranks.append(1 + int(np.argmax(right[order])))
                    of_five.append(right[order[:5]].mean())
            r = np.array(ranks)
            shares = [(r == 1).mean(), (r <= 5).mean(), np.mean(of_five)]
            rows.append([title, r.size, len(candidates), f"{(1 / r).mean():.3f}", *(f"{100 * share:.1f}" for share in shares)])
    return rows


def persons(args: argparse.Namespace, paths: list[Path]) -> np.ndarray:
    """The detector's largest person score for each image, with gray letterbox padding."""
    cache = args.folder / f"persons-{len(paths)}.npy"
    if cache.exists():
        return np.load(cache)
    session = onnxruntime.InferenceSession(str(args.weights / "yolo/yolo11n_int8.onnx"))
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


def folds(paths: list[Path]) -> np.ndarray:
    return np.array([number_of(f"fold {path.name}") % FOLDS for path in paths])


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


STRENGTHS = [0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0]


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


def measure(args: argparse.Namespace) -> None:
    args.folder.mkdir(parents=True, exist_ok=True)
    photos = sorted((args.data / "training-photos").glob("*/*.jpg"), key=lambda path: number_of(path.name))[: args.photos]
    words, held = photos[: len(photos) // 8], photos[len(photos) // 8 :]
    scenes = [path for scene in ["redkitchen", "herzjesu"] for path in sorted((args.data / scene / "images").glob("*.jpg"))]
    paths = scenes + held
    index = {path: at for at, path in enumerate(paths)}
    models = {model: vectors(args, model, paths, words) for model in ["vlad", "xfeat-netvlad"]}
    found = [[model, *row] for model, all_ in models.items() for row in retrieval(all_, index, args.data, held)]
    for row in found:
        print(*row, sep="  ")
    write_csv(args.csv, RETRIEVAL, found)
    own = {model: all_[len(scenes) :] for model, all_ in models.items()}
    kernels = {model: all_ @ all_.T for model, all_ in own.items()}
    # A regression on both vectors: the mean of both kernels, normalized to the same trace.
    centred = {m: k - k.mean(0) - k.mean(1)[:, None] + k.mean() for m, k in kernels.items()}
    kernels = {m: k / np.trace(k) for m, k in centred.items()}
    kernels["both"] = sum(kernels.values()) / 2
    fold, pixels = folds(held), [gray(path) for path in held]
    scores = persons(args, held)
    label = scores > 0.5
    light = np.array([image.mean() for image in pixels])
    contrast = np.array([image.std() for image in pixels])
    collection = np.array([[path.parent.name == name for name in ["objects", "nature", "streets"]] for path in held], float)
    print(f"{len(held)} images, {label.sum()} with a person")
    rng, leak = np.random.default_rng(1), []
    for model, kernel in kernels.items():
        person = roc_auc(ridge(kernel, label.astype(float), fold), label)
        brightness, spread = (explained_variance(t, ridge(kernel, t, fold)) for t in [light, contrast])
        chosen = (ridge(kernel, collection, fold).argmax(1) == collection.argmax(1)).mean()
        shares = [f"{100 * share:.1f}" for share in [brightness, spread, chosen]]
        leak.append([model, f"{person:.3f}", f"{roc_auc_error(person, label):.3f}", *shares])
    leak.append(["chance", "0.5", "", "0", "0", f"{100 * collection.mean(0).max():.1f}"])
    for row in leak:
        print(*row, sep="  ")
    write_csv(args.leak_csv, LEAK, leak)
    turned = label[rng.permutation(len(label))]
    print(f"permuted labels: person {roc_auc(ridge(kernels['both'], turned.astype(float), fold), turned):.3f}")
    for a, b in [("vlad", "xfeat-netvlad"), ("xfeat-netvlad", "vlad")]:
        print(f"{a} predicts {explained_variance(own[b], ridge(kernels[a], own[b], fold)):.1%} of the variance of {b}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    jobs = parser.add_subparsers(dest="job", required=True)
    for name in ["write", "measure"]:
        job = jobs.add_parser(name)
        job.add_argument("--weights", type=Path, required=True, help="folder of the network files")
        if name == "measure":
            job.add_argument("--globals", type=Path, required=True, help="the example `globals` of veiloc-features")
            job.add_argument("--data", type=Path, required=True, help="folder of the real images")
            job.add_argument("--folder", type=Path, required=True, help="folder that caches the vectors")
            job.add_argument("--photos", type=int, default=720)
            job.add_argument("--csv", type=Path, help="CSV of retrieval")
            job.add_argument("--leak-csv", type=Path, help="CSV of what a linear reader learns")
    args = parser.parse_args()
    write(args) if args.job == "write" else measure(args)


if __name__ == "__main__":
    main()
