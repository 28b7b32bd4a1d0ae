#!/usr/bin/env python3
"""Reference outputs of networks by ONNX Runtime, layer by layer.

    .venv/bin/pip install numpy pillow onnx onnxruntime torch
    .venv/bin/python research/oracles/networks.py write --weights $VEILOC_DATA/../weights
    cargo build --release -p veiloc-features --example layers --features rten
    .venv/bin/python research/oracles/networks.py compare --weights $VEILOC_DATA/../weights --layers target/release/examples/layers

`write` writes crates/device/features/tests/data/learned: `oracle.json` (sample values of layers, keypoints and descriptors of one
synthetic image) and networks with weights from a formula. `compare` prints the largest difference of each whole layer (for timings see
`study features network-speed`). Networks that are published as weights only are compared when they are exported (`export_onnx.py`).
"""

import argparse
import json
import subprocess
import sys
import tempfile
from collections import OrderedDict
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import torch
import torch.nn.functional as F

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from study.common import one_thread  # noqa: E402

DATA = Path(__file__).resolve().parents[2] / "crates/device/features/tests/data/learned"
MARGIN = 32
BORDER = 4
XFEAT = (800 - 2 * MARGIN, 576 - 2 * MARGIN)
KEPT = 60


def drawn(width: int, height: int) -> np.ndarray:
    """Blocks with noise, by integer formulas, so that both sides have the same image."""
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    a, b = x // 11, y // 13
    block = (a * 7 + b * 11 + (a ^ b) * 37) % 160
    return ((block + (x * 7 + y * 13 + x * y) % 31 + x % 50).astype(np.float32) / np.float32(255)).astype(np.float32)


def continued(gray: np.ndarray, multiple: int) -> np.ndarray:
    pads = []
    for side in gray.shape:
        whole = -(-(side + 2 * MARGIN) // multiple) * multiple
        first = (whole - side) // 2
        pads.append((first, whole - side - first))
    return np.pad(gray, pads, mode="symmetric")


class Names(OrderedDict):
    """Layers by name, in the order of the outputs."""

    def keep(self, name, value):
        self[name] = value
        return value


def xfeat(path: Path, image: np.ndarray, inner: list[str]) -> tuple[Names, list[str]]:
    model = onnx.load(path)
    outputs = [output.name for output in model.graph.output]
    model.graph.output.extend([onnx.ValueInfoProto(name=name) for name in inner])
    session = onnxruntime.InferenceSession(model.SerializeToString(), one_thread())
    names = outputs + inner
    return Names(zip(names, map(torch.from_numpy, session.run(names, {"input": image})))), outputs


def xfeat_inner(path: Path) -> list[str]:
    """Some intermediate layers: the sums where scales are joined, and every sixth convolution."""
    nodes = onnx.load(path).graph.node
    sums = [n.output[0] for n in nodes if n.op_type == "Add"]
    ends = [n.output[0] for n in nodes if n.op_type == "Relu"]
    return sums + ends[::6]


def nms(scores: torch.Tensor, radius: int, rounds: int) -> torch.Tensor:
    """simple_nms of github.com/magicleap/SuperGluePretrainedNetwork."""
    pool = lambda x: F.max_pool2d(x, 2 * radius + 1, stride=1, padding=radius)
    kept = scores == pool(scores)
    for _ in range(rounds):
        near = pool(kept.float()) > 0
        rest = torch.where(near, torch.zeros_like(scores), scores)
        kept = kept | ((rest == pool(rest)) & ~near)
    return kept


def peaks(scores: torch.Tensor, size: tuple[int, int], radius: int, rounds: int, threshold: float) -> np.ndarray:
    """x, y in the network's input, strongest first; only those inside the image and not on its border."""
    height, width = scores.shape[-2:]
    kept = (nms(scores, radius, rounds) & (scores > threshold))[0, 0].numpy()
    (left, upper) = ((width - size[0]) // 2, (height - size[1]) // 2)
    inside = np.zeros_like(kept)
    inside[upper + BORDER : upper + size[1] - BORDER, left + BORDER : left + size[0] - BORDER] = True
    y, x = np.nonzero(kept & inside)
    return np.stack([x, y], 1), np.array([left, upper])


def by_strength(points: np.ndarray, strength: np.ndarray) -> np.ndarray:
    return np.argsort(-strength, kind="stable")[:KEPT]


def sampled(dense: torch.Tensor, grid: torch.Tensor, mode: str, corners: bool) -> np.ndarray:
    values = F.grid_sample(dense, grid[None, None], mode=mode, align_corners=corners)[0, :, 0]
    return F.normalize(values, dim=0).T.numpy()


def pixels(logits: torch.Tensor) -> torch.Tensor:
    """Softmax over 64 positions and "no keypoint", rearranged to pixels."""
    shares = torch.softmax(logits, 1)[:, :-1]
    b, _, h, w = shares.shape
    return shares.permute(0, 2, 3, 1).reshape(b, h, w, 8, 8).permute(0, 1, 3, 2, 4).reshape(b, 1, h * 8, w * 8)


def keypoints_of_xfeat(layers: Names, outputs: list[str], size: tuple[int, int]) -> tuple[np.ndarray, ...]:
    """detectAndCompute of github.com/verlab/accelerated_features."""
    feats, logits, reliability = (layers[name] for name in outputs)
    scores = pixels(logits.permute(0, 3, 1, 2))
    points, offset = peaks(scores, size, 2, 0, 0.05)
    height, width = scores.shape[-2:]
    grid = torch.from_numpy(points / [width - 1, height - 1] * 2 - 1).float()
    factor = F.grid_sample(reliability, grid[None, None], mode="bilinear", align_corners=False)[0, 0, 0].numpy()
    strength = scores[0, 0].numpy()[points[:, 1], points[:, 0]] * factor
    order = by_strength(points, strength)
    dense = F.normalize(feats.permute(0, 3, 1, 2), dim=1)
    return (points - offset + 0.5)[order], strength[order], sampled(dense, grid[order], "bicubic", False)


def xfeat_input(size: tuple[int, int]) -> np.ndarray:
    gray = drawn(*size).astype(float)
    gray = ((gray - gray.mean()) / np.sqrt(gray.var() + 1e-5)).astype(np.float32)
    return continued(gray, 1)[None, None]


def runs(folder: Path):
    """Name, file, input, layers, keypoints."""
    path = folder / "xfeat/xfeat_800x576.onnx"
    layers, outputs = xfeat(path, xfeat_input(XFEAT), xfeat_inner(path))
    yield "xfeat", path, xfeat_input(XFEAT), layers, keypoints_of_xfeat(layers, outputs, XFEAT), XFEAT


def write(folder: Path) -> None:
    rng = np.random.default_rng(1)
    document = {}
    for name, _, _, layers, (points, strength, vectors), size in runs(folder):
        entry = {"size": size, "layers": {}}
        for layer, value in layers.items():
            flat = value.detach().numpy().ravel()
            at = np.sort(rng.choice(flat.size, 24, replace=False))
            entry["layers"][layer] = {
                "shape": list(value.shape),
                "largest": float(np.abs(flat).max()),
                "mean": float(flat.astype(float).mean()),
                "at": at.tolist(),
                "values": [float(f"{v:.7g}") for v in flat[at]],
            }
        entry["keypoints"] = np.round(np.c_[points, strength], 6).tolist()
        entry["descriptors"] = np.round(vectors[:, :: max(1, vectors.shape[1] // 8)], 6).tolist()
        document[name] = entry
        print(f"{name}: {len(layers)} layers, {len(points)} keypoints")
    lines = [f"{json.dumps(name)}: {json.dumps(entry)}" for name, entry in document.items()]
    (DATA / "oracle.json").write_text("{\n" + ",\n".join(lines) + "\n}\n")
    small_network("corners.onnx", {"strides": [1, 1], "dilations": [1, 1]})
    small_network("corners-plain.onnx", {})  # optional in ONNX


def small_network(name: str, plain: dict) -> None:
    """An ONNX network of any size that finds corners by a formula and describes them by patches, for tests of the command line:
    scores are the smaller eigenvalue's like (the product over the sum of the squared gradients), descriptors 25 gray values four
    pixels apart, less their mean."""
    from onnx import TensorProto, helper, numpy_helper

    gradients = np.zeros((2, 1, 3, 3), np.float32)
    gradients[0, 0] = np.outer([1, 2, 1], [-1, 0, 1])
    gradients[1, 0] = gradients[0, 0].T
    box = np.ones((1, 1, 7, 7), np.float32) / 49
    smooth = np.outer(*[np.array([1, 2, 3, 2, 1], np.float32) / 9] * 2)[None, None].astype(np.float32)
    patch = np.zeros((25, 1, 17, 17), np.float32)
    patch[np.arange(25), 0, np.arange(25) // 5 * 4, np.arange(25) % 5 * 4] = 1
    patch -= patch.mean(0, keepdims=True)
    tensors = {"gradients": gradients, "box": box, "smooth": smooth, "patch": patch, "little": np.float32([1e-3])}
    tensors["split"] = np.array([1, 1], np.int64)
    node = helper.make_node
    nodes = [
        node("Conv", ["image", "gradients"], ["g"], pads=[1] * 4, **plain),
        node("Split", ["g", "split"], ["gx", "gy"], axis=1),
        node("Mul", ["gx", "gx"], ["xx"]),
        node("Mul", ["gy", "gy"], ["yy"]),
        node("Mul", ["gx", "gy"], ["xy"]),
        *[node("Conv", [name, "box"], ["s" + name], pads=[3] * 4, **plain) for name in ["xx", "yy", "xy"]],
        node("Mul", ["sxx", "syy"], ["product"]),
        node("Mul", ["sxy", "sxy"], ["crossed"]),
        node("Sub", ["product", "crossed"], ["determinant"]),
        node("Add", ["sxx", "syy"], ["sum"]),
        node("Add", ["sum", "little"], ["trace"]),
        node("Div", ["determinant", "trace"], ["scores"]),
        node("Conv", ["image", "smooth"], ["calm"], pads=[2] * 4, **plain),
        node("Conv", ["calm", "patch"], ["descriptors"], pads=[8] * 4, **plain),
    ]
    image = helper.make_tensor_value_info("image", TensorProto.FLOAT, [1, 1, "h", "w"])
    outputs = [
        helper.make_tensor_value_info("scores", TensorProto.FLOAT, [1, 1, "h", "w"]),
        helper.make_tensor_value_info("descriptors", TensorProto.FLOAT, [1, 25, "h", "w"]),
    ]
    graph = helper.make_graph(nodes, "corners", [image], outputs, [numpy_helper.from_array(v, k) for k, v in tensors.items()])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    onnx.checker.check_model(model)
    (DATA / name).write_bytes(model.SerializeToString())


def ours(program: Path, model: str, file: Path, image: np.ndarray, layers: list[str]) -> list[np.ndarray]:
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "in").write_bytes(np.ascontiguousarray(image, np.float32).tobytes())
        sides = [str(side) for side in image.shape[1:]]
        command = [program, model, file, "run", Path(folder) / "in", *sides, folder, *layers]
        shapes = subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()
        return [
            np.fromfile(Path(folder) / f"{i}.f32", np.float32).reshape(json.loads(shape)) for i, shape in enumerate(shapes)
        ]


def compare(args: argparse.Namespace) -> None:
    print("| network | layer | numbers | largest number | largest difference |\n|---|---|--:|--:|--:|")
    for name, file, image, layers, _, _ in runs(args.weights):
        # Outputs by index, because some names are numbers.
        names = [str(i) if i < 3 else layer for i, layer in enumerate(layers)]
        for (layer, theirs), own in zip(layers.items(), ours(args.layers, name, file, image, names)):
            theirs = theirs.detach().numpy()
            assert theirs.shape == own.shape, (name, layer)
            off = float(np.abs(theirs - own).max())
            print(f"| {name} | {layer} | {own.size} | {np.abs(theirs).max():.3g} | {off:.1e} |")


def write_global(weights: Path) -> None:
    """Reference values of `xfeat-netvlad`. The image of 640 x 480 pixels is centred in XFeat's input, with reflected padding above and
    below."""
    open_ = lambda name: onnxruntime.InferenceSession(str(weights / name))
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    jobs = parser.add_subparsers(dest="job", required=True)
    for name in ["write", "compare"]:
        job = jobs.add_parser(name)
        job.add_argument("--weights", type=Path, required=True, help="folder of the network files")
        if name == "compare":
            job.add_argument("--layers", type=Path, required=True, help="the example `layers` of veiloc-features")
    args = parser.parse_args()
    if args.job == "compare":
        return compare(args)
    write(args.weights)
    write_global(args.weights)


if __name__ == "__main__":
    main()
