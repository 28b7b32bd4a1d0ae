"""NetVLAD as hloc has it, in NumPy, with weights that are drawn, against ours.

    oracle_netvlad.py write
    oracle_netvlad.py compare --globals target/release/examples/globals --image FILE [--folder DIR]

`write` makes the files of `crates/device/features/tests/data/learned` that its tests read: `netvlad.mat` with few channels, the same unpacked,
files that are refused, and `netvlad.json`, the layers and the vector of a drawn image. `compare` makes the network in its full
size (0.6 GB), with drawn weights, and prints for each convolution and the vector how far ours is from NumPy's. No weights that
were learned are in either.
"""

import argparse
import json
import os
import resource
import subprocess
import tempfile
from pathlib import Path

import numpy as np
import scipy.io
from PIL import Image

DATA = Path(__file__).resolve().parent.parent / "crates/device/features/tests/data/learned"
# VGG16's convolutions among its layers, and where it halves the image.
CONVOLUTIONS = [0, 2, 5, 7, 10, 12, 14, 17, 19, 21, 24, 26, 28]
HALVED = [2, 7, 14, 21]
FULL = [64, 64, 128, 128, 256, 256, 256, 512, 512, 512, 512, 512, 512]
SMALL = [4, 4, 5, 5, 6, 6, 6, 8, 8, 8, 8, 8, 8]
MEAN = [123.5, 116.75, 104.25]


def drawn(width: int, height: int) -> np.ndarray:
    """The image of `tests/common/mod.rs`."""
    y, x = np.mgrid[:height, :width]
    a, b = x // 11, y // 13
    return (((a * 7 + b * 11 + (a ^ b) * 37) % 160 + (x * 7 + y * 13 + x * y) % 31 + x % 50) / 255).astype(np.float32)


def weights(channels: list[int], words: int, numbers: int, seed: int) -> dict:
    """Single precision, in MATLAB's order of sides."""
    rng = np.random.default_rng(seed)
    draw = lambda *sides, scale: (rng.uniform(-1, 1, sides) * scale).astype(np.float32)
    tensors = {}
    for layer, before, own in zip(CONVOLUTIONS, [3, *channels], channels):
        tensors[layer] = draw(3, 3, before, own, scale=(6 / (9 * before)) ** 0.5), draw(1, own, scale=0.3)
    dim = channels[-1]
    tensors[30] = draw(dim, words, scale=8.0), draw(dim, words, scale=0.5)
    rng = np.random.default_rng(seed + 1)
    whitening = rng.standard_normal((1, 1, dim * words, numbers), np.float32)
    tensors[33] = whitening, draw(1, numbers, scale=0.1)
    return tensors


def as_structs(tensors: dict) -> dict:
    """As the authors' network is saved: a cell of structs, with much beside the weights."""
    layers = np.empty((1, 35), object)
    for at in range(35):
        layer = {"type": "conv", "name": f"layer{at}", "pad": np.ones((1, 4)), "rememberOutput": True, "opts": np.empty((0, 0), object)}
        if at in tensors:
            cell = np.empty((1, 2), object)
            cell[0, 0], cell[0, 1] = tensors[at]
            layer |= {"weights": cell, "learningRate": np.array([[1.0, 2.0]]), "stride": np.array([[1, 1]], np.int32)}
        layers[0, at] = layer
    mean = np.broadcast_to(np.float32(MEAN), (4, 5, 3)).copy()
    return {"net": {"layers": layers, "meta": {"normalization": {"averageImage": mean, "imageSize": np.array([[224.0, 224, 3]])}}}}


def convolved(image: np.ndarray, kernel: np.ndarray, bias: np.ndarray) -> np.ndarray:
    """`[C, H, W]`, one pixel of zeros around it. `kernel`: `[3, 3, in, out]`."""
    channels, height, width = image.shape
    padded = np.pad(image, ((0, 0), (1, 1), (1, 1)))
    out = np.repeat(bias.ravel()[:, None], height * width, 1).astype(image.dtype)
    for y in range(3):
        for x in range(3):
            shifted = padded[:, y : y + height, x : x + width].reshape(channels, -1)
            out += kernel[y, x].T.astype(image.dtype) @ shifted
    return out.reshape(-1, height, width)


def unit(values: np.ndarray, axis: int = 0) -> np.ndarray:
    return values / np.maximum(np.linalg.norm(values, axis=axis, keepdims=True), 1e-12)


def netvlad(tensors: dict, gray: np.ndarray, kind: type) -> tuple[dict, np.ndarray]:
    """`extractors/netvlad.py` of hloc: convolutions before their negative numbers are taken out, and the vector."""
    image = np.clip(np.repeat(gray[None].astype(kind), 3, 0) * 255, 0, 255) - np.array(MEAN, kind)[:, None, None]
    layers = {}
    for at in CONVOLUTIONS:
        image = convolved(image, *tensors[at])
        layers["features" if at == 28 else f"conv{at}"] = image
        if at < 28:
            image = np.maximum(image, 0)
        if at in HALVED:
            channels, height, width = image.shape
            image = image[:, : height // 2 * 2, : width // 2 * 2]
            image = image.reshape(channels, height // 2, 2, width // 2, 2).max((2, 4))
    x = unit(image.reshape(image.shape[0], -1))
    scores = tensors[30][0].T.astype(kind) @ x
    shares = np.exp(scores - scores.max(0))
    shares /= shares.sum(0)
    # Centers are stored with the other sign.
    residuals = x @ shares.T + tensors[30][1].astype(kind) * shares.sum(1)
    vector = unit(unit(residuals).ravel())
    whitening, bias = tensors[33]
    return layers, unit(vector @ whitening[0, 0].astype(kind) + bias.ravel())


def write() -> None:
    tensors = weights(SMALL, 4, 6, 7)
    structs = as_structs(tensors)
    scipy.io.savemat(DATA / "netvlad.mat", structs, do_compression=True)
    a = np.arange(6, dtype=np.float32).reshape(2, 3) / 4
    inner = np.empty((1, 3), object)
    inner[0, 0], inner[0, 1], inner[0, 2] = a, "words", np.array([[1.0, 2.0, 300.0]])
    many = np.array([(1.5, "x"), (2.5, "y")], dtype=[("value", object), ("text", object)])
    plain = {"a": a, "s": {"cells": inner, "whole": np.array([[7]], np.int32), "yes": True}, "many": many}
    scipy.io.savemat(DATA / "plain.mat", plain)
    scipy.io.savemat(DATA / "packed.mat", plain, do_compression=True)
    scipy.io.savemat(DATA / "complex.mat", {"z": np.array([[1 + 2j]])})
    scipy.io.savemat(DATA / "sparse.mat", {"s": scipy.sparse.eye(3, format="csc")})
    size = [100, 84]
    layers, vector = netvlad(tensors, drawn(*size), np.float64)
    document = {"size": size, "layers": {}, "vector": np.round(vector, 8).tolist()}
    rng = np.random.default_rng(1)
    for name, value in layers.items():
        at = np.sort(rng.choice(value.size, 12, replace=False))
        document["layers"][name] = {
            "shape": [1, *value.shape],
            "largest": float(np.abs(value).max()),
            "mean": float(value.mean()),
            "at": at.tolist(),
            "values": [float(f"{v:.8g}") for v in value.ravel()[at]],
        }
    (DATA / "netvlad.json").write_text(json.dumps(document) + "\n")


def compare(args: argparse.Namespace) -> None:
    folder = args.folder or Path(tempfile.mkdtemp())
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "VGG16-NetVLAD-Pitts30K.mat"
    tensors = weights(FULL, 64, 4096, 7)
    if not file.exists():
        scipy.io.savemat(file, as_structs(tensors), do_compression=True)
    print(f"{file.stat().st_size / 1e6:.0f} MB")
    gray = np.asarray(Image.open(args.image).convert("RGB"), np.float32) @ np.float32([0.2126, 0.7152, 0.0722]) / 255
    height, width = gray.shape
    assert max(height, width) <= 1024, "larger images are made smaller, and not here"
    layers, vector = netvlad(tensors, gray, np.float32)
    (folder / "in").write_bytes(np.repeat(gray[None], 3, 0).astype(np.float32).tobytes())
    (folder / "list").write_text(f"{args.image}\n")
    environment = dict(os.environ, VEILOC_MODELS=str(folder))
    run = [args.globals, "netvlad", "run", folder / "in", "3", str(height), str(width), folder, *layers]
    subprocess.run(run, check=True, env=environment, capture_output=True)
    print("| layer | numbers | largest number | largest difference |\n|---|--:|--:|--:|")
    for at, (name, theirs) in enumerate(layers.items()):
        own = np.fromfile(folder / f"{at}.f32", np.float32).reshape(theirs.shape)
        print(f"| {name} | {own.size} | {np.abs(theirs).max():.3g} | {np.abs(own - theirs).max():.1e} |")
    run = [args.globals, "netvlad", "vectors", folder / "list", folder / "vectors"]
    told = subprocess.run(run, check=True, env=environment, capture_output=True, text=True)
    own = np.fromfile(folder / "vectors", np.float32)
    print(f"| vector | {own.size} | {np.abs(vector).max():.3g} | {np.abs(own - vector).max():.1e} |")
    print(f"cosine {float(own @ vector):.7f}\n{told.stdout}")
    print(f"{resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1e6:.2f} GB of memory at most")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    jobs = parser.add_subparsers(dest="job", required=True)
    jobs.add_parser("write")
    job = jobs.add_parser("compare")
    job.add_argument("--globals", type=Path, required=True, help="the example `globals` of veiloc-features")
    job.add_argument("--image", type=Path, required=True)
    job.add_argument("--folder", type=Path, help="where the file of weights is made, and kept")
    args = parser.parse_args()
    write() if args.job == "write" else compare(args)


if __name__ == "__main__":
    main()
