#!/usr/bin/env python3
"""Reference keypoints and descriptors of ALIKED: PyTorch with torchvision's deformable convolution.

    .venv/bin/pip install -e research/train torchvision onnxruntime
    .venv/bin/python research/oracles/aliked.py write
    VEILOC_MODELS=… .venv/bin/python research/oracles/aliked.py compare aliked-n16.pth IMAGE target/release/veiloc

`write` writes crates/device/features/tests/data/learned: a network of ALIKED's structure with few channels and weights from a formula
(`made-up-aliked.onnx`, its head), and `made-up-aliked.json`, its keypoints and descriptors of one synthetic image. `compare` compares
keypoints and descriptors of an image with the program's, for real weights. The layers follow the paper (Zhao et al., IEEE Transactions on
Instrumentation and Measurement 2023) and share no code with the export but the reader of the file.
"""

import argparse
import base64
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from torchvision.ops import deform_conv2d

sys.path.insert(0, str(Path(__file__).resolve().parent))
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "scripts"))

from networks import DATA, drawn, nms  # noqa: E402
from tiny_networks import drawn as formula  # noqa: E402

MARGIN, BORDER, RADIUS, THRESHOLD, TEMPERATURE = 96, 4, 2, 0.2, 0.1
SIZE, KEPT = (150, 110), 60
#: Of the made-up network.
WIDTHS, SAMPLES = (4, 6, 8, 8), 5


def made_up() -> dict[str, torch.Tensor]:
    """Tensors by name, as in the authors' files. Offsets of a few pixels."""
    shapes, before, dim = {}, 3, 8
    for block, own in enumerate(WIDTHS, 1):
        for conv, inputs in ((1, before), (2, own)):
            name = f"block{block}.conv{conv}"
            if block > 2:
                shapes |= {f"{name}.offset_conv.weight": (18, inputs, 3, 3), f"{name}.offset_conv.bias": (18,)}
                name += ".regular_conv"
            shapes |= {f"{name}.weight": (own, inputs, 3, 3)}
            shapes |= {f"block{block}.bn{conv}.{end}": (own,) for end in ("weight", "bias", "running_mean", "running_var")}
        if block > 1:
            shapes |= {f"block{block}.downsample.weight": (own, before, 1, 1), f"block{block}.downsample.bias": (own,)}
        shapes[f"conv{block}.weight"] = (dim // 4, own, 1, 1)
        before = own
    for number, (inputs, outputs, side) in {0: (dim, 8, 1), 2: (8, 4, 3), 4: (4, 4, 3), 6: (4, 1, 3)}.items():
        shapes[f"score_head.{number}.weight"] = (outputs, inputs, side, side)
    twice = 2 * SAMPLES
    shapes |= {"desc_head.offset_conv.0.weight": (twice, dim, 3, 3), "desc_head.offset_conv.0.bias": (twice,)}
    shapes |= {"desc_head.offset_conv.2.weight": (twice, twice, 1, 1), "desc_head.offset_conv.2.bias": (twice,)}
    shapes |= {"desc_head.sf_conv.weight": (dim, dim, 1, 1), "desc_head.agg_weights": (SAMPLES, dim, dim)}
    tensors = {}
    for seed, (name, shape) in enumerate(shapes.items(), 1):
        fan = int(np.prod(shape[1:])) if len(shape) > 1 else 1
        scale, shift = (4 / np.sqrt(fan), 0) if len(shape) > 1 else (0.4, 0)
        if name.endswith("running_var") or ".bn" in name and name.endswith(".weight"):
            scale, shift = 0.4, 1
        if name.endswith(("offset_conv.bias", "offset_conv.2.bias")):
            scale = 6
        tensors[name] = torch.from_numpy(formula(shape, np.float32(scale), np.float32(shift), 300 + seed))
    return tensors


class Reference:
    """The network as the paper describes it, from the tensors of a file."""

    def __init__(self, tensors: dict[str, torch.Tensor]):
        self.of = tensors

    def conv(self, name: str, x: torch.Tensor) -> torch.Tensor:
        if f"{name}.offset_conv.weight" in self.of:
            offsets = F.conv2d(x, self.of[f"{name}.offset_conv.weight"], self.of[f"{name}.offset_conv.bias"], padding=1)
            most = max(x.shape[2:]) / 4
            return deform_conv2d(x, offsets.clamp(-most, most), self.of[f"{name}.regular_conv.weight"], padding=(1, 1))
        weight = self.of[f"{name}.weight"]
        return F.conv2d(x, weight, self.of.get(f"{name}.bias"), padding=weight.shape[2] // 2)

    def normalized(self, name: str, x: torch.Tensor) -> torch.Tensor:
        mean, var, weight, bias = (self.of[f"{name}.{end}"] for end in ("running_mean", "running_var", "weight", "bias"))
        return F.batch_norm(x, mean, var, weight, bias)

    def maps(self, image: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Scores and features of all pixels."""
        x, levels = image, []
        for number, pool in enumerate((1, 2, 4, 4), 1):
            x = F.avg_pool2d(x, pool)
            y = F.selu(self.normalized(f"block{number}.bn1", self.conv(f"block{number}.conv1", x)))
            y = self.normalized(f"block{number}.bn2", self.conv(f"block{number}.conv2", y))
            x = F.selu(y + self.conv(f"block{number}.downsample", x) if number > 1 else y)
            level = F.selu(self.conv(f"conv{number}", x))
            levels.append(F.interpolate(level, image.shape[2:], mode="bilinear", align_corners=True))
        joined = y = torch.cat(levels, 1)
        for number in (0, 2, 4, 6):
            y = self.conv(f"score_head.{number}", F.selu(y) if number else y)
        return torch.sigmoid(y), F.normalize(joined, dim=1)

    def keypoints(self, scores: torch.Tensor) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Maxima, the strongest first: position (integers are pixel centres), pixel and score."""
        kept = (nms(scores, RADIUS, 2) & (scores > THRESHOLD))[0, 0].numpy()
        scores = scores[0, 0].numpy()
        y, x = np.nonzero(kept)
        order = np.argsort(-scores[y, x], kind="stable")
        pixels, padded = np.stack([x, y], 1)[order], np.pad(scores, RADIUS)
        side = 2 * RADIUS + 1
        patches = np.stack([padded[y : y + side, x : x + side].ravel() for x, y in pixels])
        weights = np.exp((patches - patches.max(1, keepdims=True)) / TEMPERATURE)
        weights /= weights.sum(1, keepdims=True)
        offsets = np.stack(np.meshgrid(np.arange(side), np.arange(side)), -1).reshape(-1, 2) - RADIUS
        return pixels + weights @ offsets, pixels, scores[pixels[:, 1], pixels[:, 0]]

    def descriptors(self, features: torch.Tensor, keypoints: np.ndarray) -> np.ndarray:
        """One keypoint after the other. `[N, dim]`"""
        height, width = features.shape[2:]
        first, second = ({e: self.of[f"desc_head.offset_conv.{n}.{e}"] for e in ("weight", "bias")} for n in (0, 2))
        weights, vectors = self.of["desc_head.agg_weights"], []
        around = F.pad(features, (1, 1, 1, 1))
        for x, y in keypoints:
            column, row = int(x), int(y)
            patch = around[:, :, row : row + 3, column : column + 3]
            offsets = F.conv2d(F.selu(F.conv2d(patch, **first)), **second).clamp(-max(height, width) / 4, max(height, width) / 4)
            at = torch.tensor([x, y], dtype=torch.float32)[:, None] + offsets.reshape(2, -1)
            grid = (2 * at / torch.tensor([[width - 1.0], [height - 1.0]]) - 1).T[None, None]
            values = F.grid_sample(features, grid, align_corners=True)[0, :, 0]  # [C, M]
            values = F.selu(self.of["desc_head.sf_conv.weight"][:, :, 0, 0] @ values)
            vectors.append(sum(values[:, m] @ weights[m] for m in range(len(weights))))
        return F.normalize(torch.stack(vectors), dim=1).numpy()

    def extract(self, gray: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions in the image (its corner is at 0, 0), scores and descriptors, the strongest first."""
        pads = []
        for side in gray.shape:
            whole = -(-(side + 2 * MARGIN) // 32) * 32
            pads.append(((whole - side) // 2, whole - side - (whole - side) // 2))
        whole = np.pad(gray, pads, mode="symmetric")
        with torch.no_grad():
            scores, features = self.maps(torch.from_numpy(whole)[None, None].repeat(1, 3, 1, 1))
            points, pixels, strength = self.keypoints(scores)
            inner = pixels - [pads[1][0], pads[0][0]]
            size = np.array(gray.shape[::-1])
            inside = ((inner >= BORDER) & (inner < size - BORDER)).all(1)
            points, strength = points[inside], strength[inside]
            return points - [pads[1][0], pads[0][0]] + 0.5, strength, self.descriptors(features, points)


def write() -> None:
    import export_onnx

    tensors = made_up()
    with tempfile.TemporaryDirectory() as folder:
        torch.save(tensors, Path(folder) / "made-up.pth")
        sys.argv = ["export_onnx.py", "aliked", f"{folder}/made-up.pth", str(DATA / "made-up-aliked.onnx")]
        export_onnx.main()
    points, strength, vectors = Reference(tensors).extract(drawn(*SIZE))
    print(f"{len(points)} keypoints, scores {strength.min():.3f} to {strength.max():.3f}")
    entry = {"size": SIZE, "keypoints": np.round(np.c_[points, strength], 6)[:KEPT].tolist()}
    entry["descriptors"] = np.round(vectors, 6)[:KEPT].tolist()
    (DATA / "made-up-aliked.json").write_text(json.dumps({"made-up-aliked": entry}) + "\n")


def compare(args: argparse.Namespace) -> None:
    from PIL import Image

    gray = np.asarray(Image.open(args.image).convert("RGB"), np.float64) @ [0.2126, 0.7152, 0.0722] / 255
    points, _, vectors = Reference(torch.load(args.weights, map_location="cpu", weights_only=True)).extract(gray.astype(np.float32))
    command = [args.veiloc, "-q", "eval", "keypoints", args.image, "--features", args.weights.stem, "-o", "-"]
    entry = json.loads(subprocess.run([*command, "--max-keypoints", "8192"], check=True, capture_output=True).stdout)
    own = np.array(entry["keypoints"])
    rows = np.frombuffer(base64.b64decode(entry["descriptors"]), np.uint8).reshape(len(own), -1) - 128.0
    near = np.abs(points[:, None] - own[None]).max(2)
    found = near.min(1) < 0.01
    rows = rows[near.argmin(1)] / np.linalg.norm(rows[near.argmin(1)], axis=1, keepdims=True)
    cosine = (rows * vectors).sum(1)[found]
    print(f"{args.weights.stem}: {len(points)} keypoints, {len(own)} of the program, {100 * found.mean():.2f} % of them within 0.01 px")
    print(f"descriptors: smallest cosine {cosine.min():.5f}, median {np.median(cosine):.5f} (the program rounds to bytes)")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    jobs = parser.add_subparsers(dest="job", required=True)
    jobs.add_parser("write")
    job = jobs.add_parser("compare")
    for name in ("weights", "image", "veiloc"):
        job.add_argument(name, type=Path)
    args = parser.parse_args()
    write() if args.job == "write" else compare(args)


if __name__ == "__main__":
    main()
