#!/usr/bin/env python3
"""Reference boxes of a detector by ONNX Runtime on a few images, and small detector files for tests.

Writes the references of crates/device/features/tests: `oracle.json` (boxes from another runtime, with its own letterbox and its own
non-maximum suppression) and `*.onnx` (detectors with two classes that find the same two boxes in any image, and invalid ones with one
fault each). The detector file belongs to the user and is not stored in the repository.

    .venv/bin/pip install numpy pillow onnx onnxruntime
    .venv/bin/python research/oracles/detector.py --data $VEILOC_DATA --detector $VEILOC_DATA/../weights/yolo/yolo11n_int8.onnx
"""

import argparse
import ast
import json
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
from onnx import TensorProto, helper
from PIL import Image

PHOTOS = ["01.jpg", "24.jpg", "02928139_3448003521.jpg"]
OUT = Path(__file__).resolve().parents[2] / "crates/device/features/tests/data/detector"
LEAST, SAME = 0.25, 0.5


def axis(old: int, new: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    at = np.clip((np.arange(new) + 0.5) * old / new - 0.5, 0, old - 1)
    low = np.floor(at).astype(int)
    return low, np.minimum(low + 1, old - 1), at - low


def letterbox(image: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, float, tuple[int, int]]:
    """Letterbox: bilinear interpolation without smoothing, centred, padded with gray 114."""
    (height, width), (rows, columns) = size, image.shape[:2]
    scale = min(width / columns, height / rows)
    inner = round(rows * scale), round(columns * scale)
    (a, b, down), (c, d, across) = axis(rows, inner[0]), axis(columns, inner[1])
    upper = image[a][:, c] * (1 - across)[None, :, None] + image[a][:, d] * across[None, :, None]
    lower = image[b][:, c] * (1 - across)[None, :, None] + image[b][:, d] * across[None, :, None]
    fitted = upper * (1 - down)[:, None, None] + lower * down[:, None, None]
    canvas = np.full((height, width, 3), 114.0)
    top, left = (height - inner[0]) // 2, (width - inner[1]) // 2
    canvas[top : top + inner[0], left : left + inner[1]] = fitted
    return (canvas / 255).astype(np.float32).transpose(2, 0, 1)[None], scale, (left, top)


def overlap(a: list[float], b: list[float]) -> float:
    shared = max(0, min(a[2], b[2]) - max(a[0], b[0])) * max(0, min(a[3], b[3]) - max(a[1], b[1]))
    area = lambda c: (c[2] - c[0]) * (c[3] - c[1])
    return shared / (area(a) + area(b) - shared)


def boxes(session: onnxruntime.InferenceSession, path: Path) -> list[dict]:
    tensor = session.get_inputs()[0]
    samples, scale, (left, top) = letterbox(np.asarray(Image.open(path).convert("RGB"), float), tuple(tensor.shape[2:]))
    table = session.run(None, {tensor.name: np.ascontiguousarray(samples)})[0][0]
    found = []
    for x, y, w, h, *scores in table.T:
        best = int(np.argmax(scores))
        if scores[best] >= LEAST:
            corners = [(x - w / 2 - left) / scale, (y - h / 2 - top) / scale, (x + w / 2 - left) / scale, (y + h / 2 - top) / scale]
            found.append({"class": best, "score": float(scores[best]), "corners": [float(c) for c in corners]})
    found.sort(key=lambda f: -f["score"])
    kept: list[dict] = []
    for f in found:
        if not any(k["class"] == f["class"] and overlap(k["corners"], f["corners"]) > SAME for k in kept):
            kept.append(f)
    return kept


def toy(name: str, names: str | None = "{0: 'person', 1: 'car'}", columns: int = 6, side: int | str = 64, nan: bool = False) -> None:
    """A network that finds a person in the left half and a car in the right half of any image."""
    table = np.zeros((1, columns, 3), np.float32)
    table[0, :4, 0], table[0, :4, 1] = [16, 32, 12, 40], [48, 32, 20, 10]
    table[0, 4, 0], table[0, 5, 1] = 0.9, 0.6
    if nan:
        table[0, 4, 2] = np.nan
    graph = helper.make_graph(
        [
            helper.make_node("ReduceMean", ["images"], ["mean"], keepdims=0),
            helper.make_node("Mul", ["mean", "zero"], ["nothing"]),
            helper.make_node("Add", ["table", "nothing"], ["output0"]),
        ],
        name,
        [helper.make_tensor_value_info("images", TensorProto.FLOAT, [1, 3, side, side])],
        [helper.make_tensor_value_info("output0", TensorProto.FLOAT, [1, columns, 3])],
        [
            helper.make_tensor("zero", TensorProto.FLOAT, [], [0.0]),
            helper.make_tensor("table", TensorProto.FLOAT, table.shape, table.flatten().tolist()),
        ],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 12)], ir_version=7)
    if names is not None:
        helper.set_model_props(model, {"names": names})
    onnx.save(model, OUT / f"{name}.onnx")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--detector", type=Path, required=True)
    args = parser.parse_args()
    OUT.mkdir(parents=True, exist_ok=True)
    session = onnxruntime.InferenceSession(str(args.detector), providers=["CPUExecutionProvider"])
    names = ast.literal_eval(session.get_modelmeta().custom_metadata_map["names"])
    found = {photo: boxes(session, args.data / "photos" / photo) for photo in PHOTOS}
    document = {"runtime": f"onnxruntime {onnxruntime.__version__}", "names": [names[i] for i in range(len(names))], "photos": found}
    (OUT / "oracle.json").write_text(json.dumps(document, indent=1) + "\n")
    toy("two-boxes")
    toy("no-names", names=None)
    toy("three-names", names="{0: 'person', 1: 'car', 2: 'dog'}")
    toy("any-size", side="side")
    toy("not-a-number", nan=True)


if __name__ == "__main__":
    main()
