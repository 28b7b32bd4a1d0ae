#!/usr/bin/env python3
"""Reference outputs of networks that segment people, by LiteRT, and a small network with random weights for tests.

Writes crates/device/features/tests/data/segmenter: `tiny.tflite`, with every operator that veiloc reads; `red.tflite`, which takes what is
red for people; and `oracle.json`: the outputs of the first, those of MediaPipe's files, and the mean confidence in 16 x 16 parts of
photographs. MediaPipe's files are the user's and are not stored.

    .venv/bin/pip install ai-edge-litert pillow
    .venv/bin/python research/oracles/segmenter.py --data $VEILOC_DATA --weights $VEILOC_DATA/../weights/mediapipe
"""

import argparse
import json
from pathlib import Path

import flatbuffers
import numpy as np
from ai_edge_litert import schema_py_generated as schema
from ai_edge_litert.interpreter import Interpreter
from PIL import Image

OUT = Path(__file__).resolve().parents[2] / "crates/device/features/tests/data/segmenter"
PHOTOS = ["photos/29.jpg", "training-photos/nature/388016.jpg"]
Kind = schema.BuiltinOperator


class Maker:
    """A graph whose every step reads the result of the one before."""

    def __init__(self, seed: int):
        self.draw, self.model, self.graph = np.random.default_rng(seed), schema.ModelT(), schema.SubGraphT()
        self.model.version, self.model.buffers, self.model.operatorCodes = 3, [schema.BufferT()], []
        self.graph.tensors, self.graph.operators = [], []

    def tensor(self, sides: list[int], data: np.ndarray | None = None) -> int:
        tensor = schema.TensorT()
        tensor.shape = list(sides)
        kinds = {None: schema.TensorType.FLOAT32, "float16": schema.TensorType.FLOAT16, "int32": schema.TensorType.INT32}
        tensor.type, tensor.name = kinds[data if data is None else str(data.dtype)], str(len(self.graph.tensors))
        if data is not None:
            buffer = schema.BufferT()
            buffer.data = np.frombuffer(data.tobytes(), np.uint8)
            self.model.buffers.append(buffer)
            tensor.buffer = len(self.model.buffers) - 1
        self.graph.tensors.append(tensor)
        return len(self.graph.tensors) - 1

    def step(self, kind: int, inputs: list[int], sides: list[int], options=None, custom: tuple[str, bytes] | None = None) -> int:
        code = schema.OperatorCodeT()
        code.builtinCode, code.deprecatedBuiltinCode, code.version = kind, min(kind, 127), 1
        operator, output = schema.OperatorT(), self.tensor(sides)
        if custom:
            code.customCode = custom[0]
            operator.customOptions = np.frombuffer(custom[1], np.uint8)
        self.model.operatorCodes.append(code)
        operator.opcodeIndex, operator.inputs, operator.outputs = len(self.model.operatorCodes) - 1, inputs, [output]
        if options is not None:
            operator.builtinOptionsType = getattr(schema.BuiltinOptions, type(options).__name__.removesuffix("T"))
            operator.builtinOptions = options
        self.graph.operators.append(operator)
        return output

    def weights(self, sides: list[int]) -> int:
        """Random 16-bit weights, as floats."""
        size = 1.5 / np.sqrt(np.prod(sides[1:]))
        half = self.tensor(sides, self.draw.normal(0, size, sides).astype(np.float16))
        return self.step(Kind.DEQUANTIZE, [half], sides)

    def conv(self, image: int, kernel: list[int], sides: list[int], stride: int, same: bool, depthwise: bool = False) -> int:
        options = schema.DepthwiseConv2DOptionsT() if depthwise else schema.Conv2DOptionsT()
        options.padding, options.strideW, options.strideH = int(not same), stride, stride
        if depthwise:
            options.depthMultiplier = 1
        kind = Kind.DEPTHWISE_CONV_2D if depthwise else Kind.CONV_2D
        return self.step(kind, [image, self.weights(kernel), self.weights([sides[3]])], sides, options)

    def file(self, image: int, result: int) -> bytes:
        self.graph.inputs, self.graph.outputs = [image], [self.step(Kind.LOGISTIC, [result], [1, 32, 32, 1])]
        self.model.subgraphs = [self.graph]
        builder = flatbuffers.Builder(1 << 14)
        builder.Finish(self.model.Pack(builder), b"TFL3")
        return bytes(builder.Output())


def tiny() -> bytes:
    make = Maker(7)
    image = make.tensor([1, 32, 32, 3])
    first = make.conv(image, [8, 3, 3, 3], [1, 16, 16, 8], 2, True)
    first = make.step(Kind.HARD_SWISH, [first], [1, 16, 16, 8])
    deep = make.conv(first, [1, 5, 5, 8], [1, 8, 8, 8], 2, True, depthwise=True)
    deep = make.step(Kind.RELU, [deep], [1, 8, 8, 8])
    pool = schema.Pool2DOptionsT()
    pool.padding, pool.strideW, pool.strideH, pool.filterWidth, pool.filterHeight = 1, 8, 8, 8, 8
    mean = make.step(Kind.AVERAGE_POOL_2D, [deep], [1, 1, 1, 8], pool)
    mean = make.step(Kind.LOGISTIC, [make.conv(mean, [8, 1, 1, 8], [1, 1, 1, 8], 1, False)], [1, 1, 1, 8])
    deep = make.step(Kind.MUL, [deep, mean], [1, 8, 8, 8], schema.MulOptionsT())
    reduce = schema.ReducerOptionsT()
    reduce.keepDims = True
    mean = make.step(Kind.MEAN, [deep, make.tensor([2], np.array([1, 2], np.int32))], [1, 1, 1, 8], reduce)
    deep = make.step(Kind.MUL, [deep, mean], [1, 8, 8, 8], schema.MulOptionsT())
    resize = schema.ResizeBilinearOptionsT()
    resize.halfPixelCenters = True
    deep = make.step(Kind.RESIZE_BILINEAR, [deep, make.tensor([2], np.array([16, 16], np.int32))], [1, 16, 16, 8], resize)
    both = make.step(Kind.ADD, [first, deep], [1, 16, 16, 8], schema.AddOptionsT())
    both = make.conv(both, [1, 3, 3, 8], [1, 16, 16, 8], 1, True, depthwise=True)
    # Padding "same" (1), and the strides.
    custom = ("Convolution2DTransposeBias", np.array([1, 2, 2], np.int32).tobytes())
    both = make.step(Kind.CUSTOM, [both, make.weights([1, 2, 2, 8]), make.weights([1])], [1, 32, 32, 1], custom=custom)
    return make.file(image, both)


def red() -> bytes:
    """Marks what is red, as if it was a person."""
    make = Maker(0)
    image, kernel = make.tensor([1, 32, 32, 3]), make.tensor([1, 1, 1, 3], np.array([40, -40, -40], np.float16))
    kernel, bias = make.step(Kind.DEQUANTIZE, [kernel], [1, 1, 1, 3]), make.tensor([1], np.array([-20], np.float16))
    inputs = [image, kernel, make.step(Kind.DEQUANTIZE, [bias], [1])]
    options = schema.Conv2DOptionsT()
    options.padding, options.strideW, options.strideH = 1, 1, 1
    return make.file(image, make.step(Kind.CONV_2D, inputs, [1, 32, 32, 1], options))


def run(network: bytes, image: np.ndarray | None = None) -> np.ndarray:
    """The output `[height, width]`; without an image, for a drawn head and shoulders, in colours that differ by rows and columns."""
    interpreter = Interpreter(model_content=network)
    interpreter.allocate_tensors()
    given = interpreter.get_input_details()[0]
    _, height, width, _ = given["shape"]
    if image is None:
        y, x, channel = np.mgrid[:height, :width, :3]
        (v, u), shade = (y / height, x / width), (x * 5 + y * 3) % 16 / 64
        head = ((u - 0.5) / 0.13) ** 2 + ((v - 0.35) / 0.2) ** 2 < 1
        body = ((u - 0.5) / 0.35) ** 2 + ((v - 1) / 0.45) ** 2 < 1
        shown = np.where(head, 0.75 - 0.15 * channel, np.where(body, 0.1 + 0.15 * channel, 0.6))
        image = (shown + shade).astype(np.float32)
    interpreter.set_tensor(given["index"], image[None])
    interpreter.invoke()
    return interpreter.get_tensor(interpreter.get_output_details()[0]["index"])[0, :, :, 0]


def area_means(image: np.ndarray) -> np.ndarray:
    """256 rows, each the mean of those that it covers."""
    sums = np.concatenate([np.zeros_like(image[:1]), image.cumsum(0)])
    at = np.arange(257) * len(image) / 256
    low = np.minimum(at.astype(int), len(image) - 1)
    share = (at - low)[:, None, None]
    borders = sums[low] * (1 - share) + sums[low + 1] * share
    return np.diff(borders, axis=0) * 256 / len(image)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--weights", type=Path, required=True)
    args = parser.parse_args()
    OUT.mkdir(parents=True, exist_ok=True)
    (OUT / "tiny.tflite").write_bytes(tiny())
    (OUT / "red.tflite").write_bytes(red())
    rounded = lambda values: [round(float(value), 5) for value in values.flatten()]
    oracle = {"tiny.tflite": rounded(run(tiny())[::3, ::3])}
    for name in ("selfie_segmentation.tflite", "selfie_segmentation_landscape.tflite"):
        oracle[name] = rounded(run((args.weights / name).read_bytes())[::15, ::15])
    square = (args.weights / "selfie_segmentation.tflite").read_bytes()
    for name in PHOTOS:
        with Image.open(args.data / name) as file:
            photo = area_means(area_means(np.asarray(file.convert("RGB")) / 255.0).transpose(1, 0, 2)).transpose(1, 0, 2)
        oracle[name] = rounded(run(square, photo.astype(np.float32)).reshape(16, 16, 16, 16).mean((1, 3)))
    (OUT / "oracle.json").write_text(json.dumps(oracle) + "\n")


if __name__ == "__main__":
    main()
