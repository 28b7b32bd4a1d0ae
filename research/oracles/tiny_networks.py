#!/usr/bin/env python3
"""Writes tiny ONNX networks for tests of reading and running networks.

    python research/oracles/tiny_networks.py        # needs the package onnx

Writes crates/research/attacks/tests/data/learned/*.onnx with their descriptions, and the two networks of the image metrics. Their
computation is so simple that the tests contain the expected outputs. Also writes
crates/device/features/tests/data/learned/made-up.onnx, with the structure of ALIKE and few channels.
"""

import pathlib

import numpy as np
from onnx import TensorProto, helper, numpy_helper

CRATES = pathlib.Path(__file__).resolve().parents[2] / "crates"
DATA = CRATES / "research/attacks/tests/data"


def made_up(shape, seed, scale):
    """Pseudo-random numbers from -scale/2 to scale/2; the tests have the same formula."""
    i = np.arange(int(np.prod(shape)), dtype=np.uint64)
    x = ((i + seed * 7919) * np.uint64(2_654_435_761) % (1 << 32)) / float(1 << 32) - 0.5
    return (x * scale).astype(np.float32).reshape(shape)


def write(path, inputs, outputs, nodes, **tensors):
    def values(of):
        return [helper.make_tensor_value_info(name, TensorProto.FLOAT, sides) for name, sides in of.items()]

    held = [numpy_helper.from_array(np.asarray(value), name) for name, value in tensors.items()]
    graph = helper.make_graph(nodes, path.stem, values(inputs), values(outputs), held)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    path.write_bytes(model.SerializeToString())


def node(kind, inputs, output, **attributes):
    return helper.make_node(kind, inputs.split(), [output], **attributes)


def describe(name, kind, features, dimension, model=None, **more):
    lines = ["version = 1", f'kind = "{kind}"', f'model = "{model or name}.onnx"', f'features = "{features}"', f"dimension = {dimension}"]
    lines += [f'{key} = "{value}"' if isinstance(value, str) else f"{key} = {value}" for key, value in more.items()]
    (DATA / f"learned/{name}.toml").write_text("\n".join(lines) + "\n")


def inversion():
    """The colour of a cell is a linear map of its features; its visibility grows with its number of keypoints."""
    grid = {"features": [1, 129, "H", "W"]}
    image, visible = {"image": [1, 3, "H", "W"]}, {"visible": [1, 1, "H", "W"]}
    kernel = made_up((3, 129, 1, 1), 1, 0.5)
    conv = node("Conv", "features kernel", "colours", kernel_shape=[1, 1])
    colours = node("Sigmoid", "colours", "image")
    full = [node("Slice", "features from to channel", "full"), node("Sigmoid", "full", "visible")]
    ends = {name: np.array([value], np.int64) for name, value in [("from", 128), ("to", 129), ("channel", 1)]}
    write(DATA / "learned/inversion.onnx", grid, image | visible, [conv, colours, *full], kernel=kernel, **ends)
    describe("inversion", "inversion", "sift", 128, side=32, multiple=4)
    plain = DATA / "learned/plain.onnx"
    write(plain, grid, image, [conv, colours], kernel=kernel)
    describe("plain", "inversion", "sift", 128, side=32, multiple=4)
    # The colour at the keypoints of a cell, gray where there are none; and white where there are keypoints.
    own = {"features": [1, 4, "H", "W"]}
    half, gray = 0.5 * np.eye(3, 4, dtype=np.float32).reshape(3, 4, 1, 1), np.full(3, 0.5, np.float32)
    write(DATA / "learned/colour.onnx", own, image, [node("Conv", "features half gray", "image", kernel_shape=[1, 1])], half=half, gray=gray)
    describe("colour", "inversion", "sift", 3, side=32, multiple=4, input="colour")
    bright = node("Concat", "features features features", "image", axis=1)
    write(DATA / "learned/places.onnx", {"features": [1, 1, "H", "W"]}, image, [bright])
    describe("places", "inversion", "sift", 0, side=32, multiple=4, input="positions")
    # A network with logarithms of zero, and one whose image has half the sides.
    nan = [conv, node("Log", "colours", "image")]
    write(DATA / "learned/nan.onnx", grid, image, nan, kernel=kernel)
    describe("nan", "inversion", "sift", 128, side=32, multiple=4)
    half = [conv, node("AveragePool", "colours", "image", kernel_shape=[2, 2], strides=[2, 2])]
    write(DATA / "learned/half.onnx", grid, {"image": [1, 3, "h", "w"]}, half, kernel=kernel)
    describe("half", "inversion", "sift", 128, side=32, multiple=4)


def fields():
    """Centres of 4 x 3 fields of 80 pixels in an image of 320 x 240 pixels, in normalized coordinates."""
    return np.array([[(80 * x + 40) / 320, (80 * y + 40 - 120) / 320 + 0.5] for y in range(3) for x in range(4)], np.float32)


def positions():
    """A descriptor encodes the field of its keypoint; places near the field's centre are likelier."""
    inputs = {"descriptors": [1, "N", 12], "places": [1, "N", "B", 2], "guess": [1, "N", "B"]}
    nodes = [
        node("MatMul", "descriptors middles", "middle"),
        node("Unsqueeze", "middle bins", "middles_of_bins"),
        node("Sub", "places middles_of_bins", "off"),
        node("Mul", "off off", "square"),
        node("ReduceSum", "square last", "distance", keepdims=0),
        node("Mul", "distance factor", "near"),
        # The share of a keypoint in no bin is zero.
        node("Exp", "guess", "share"),
        node("Add", "near share", "logits"),
    ]
    tensors = dict(middles=fields() / np.sqrt(np.float32(12)), bins=np.array([2], np.int64), last=np.array([3], np.int64))
    write(DATA / "learned/positions.onnx", inputs, {"logits": [1, "N", "B"]}, nodes, factor=np.float32(-50), **tensors)
    describe("positions", "positions", "made-up", 12, scheme="dcl:paper", input="row")
    # An untrained network.
    zero = [node("Mul", "guess nothing", "small"), node("Mul", "small nothing", "logits")]
    keep = [node("ReduceSum", "descriptors", "d", keepdims=0), node("ReduceSum", "places", "p", keepdims=0)]
    write(DATA / "learned/untrained.onnx", inputs, {"logits": [1, "N", "B"]}, zero + keep, nothing=np.float32(0))
    describe("untrained", "positions", "made-up", 12, scheme="dcl:paper", input="set")


def neighbours():
    """Embeddings on a quarter of a sphere by the field of each descriptor: near fields are likelier neighbours."""
    x = fields() - 0.5
    rows = np.concatenate([x, np.ones((12, 1), np.float32)], axis=1)
    nodes = [node("MatMul", "descriptors rows", "long")]
    nodes += [node("ReduceL2", "long", "length", axes=[-1], keepdims=1), node("Div", "long length", "embedding")]
    write(DATA / "learned/neighbours.onnx", {"descriptors": [1, "N", 12]}, {"embedding": [1, "N", 3]}, nodes, rows=rows)
    describe("neighbours", "neighbours", "made-up", 12)
    # The network uses only a few of the 128 numbers of a descriptor.
    few = np.eye(128, 8, dtype=np.float32)
    nodes = [node("MatMul", "descriptors rows", "long"), node("Tanh", "long", "embedding")]
    write(DATA / "learned/embedding.onnx", {"descriptors": [1, "N", 128]}, {"embedding": [1, "N", 8]}, nodes, rows=few)
    describe("embedding", "neighbours", "sift", 128)


def judges():
    sides = [1, 3, "H", "W"]
    nodes = [node("Sub", "a b", "off"), node("Mul", "off off", "square"), node("ReduceMean", "square", "distance", keepdims=0)]
    write(DATA / "image_metrics/distance.onnx", {"a": sides, "b": sides}, {"distance": []}, nodes)
    # Class 10 for red, 20 for green and 30 for blue in the centre; the other classes by their number, with much lower scores.
    weights = np.zeros((3, 1000), np.float32)
    weights[[0, 1, 2], [10, 20, 30]] = 1
    bias = -10 - np.arange(1000, dtype=np.float32) / 1000
    bias[[10, 20, 30]] = 0
    nodes = [node("ReduceMean", "image", "mean", axes=[2, 3], keepdims=0), node("Gemm", "mean weights bias", "logits")]
    inputs, outputs = {"image": [1, 3, 224, 224]}, {"logits": [1, 1000]}
    write(DATA / "image_metrics/classifier.onnx", inputs, outputs, nodes, weights=weights, bias=bias)


def drawn(shape, scale, shift, seed):
    """Numbers about `shift`."""
    i = np.arange(int(np.prod(shape)), dtype=np.uint64)
    mixed = (i + np.uint64(seed * 7919)) * np.uint64(0x9E3779B97F4A7C15)
    mixed = ((mixed ^ (mixed >> np.uint64(29))) * np.uint64(0xBF58476D1CE4E5B9)) >> np.uint64(40)
    x = mixed.astype(np.float32) / np.float32(1 << 24) - np.float32(0.5)
    return (x * np.float32(scale) + np.float32(shift)).reshape(shape)


def alike():
    """Four blocks at full size, a half, an eighth and a thirty-second, joined at full size by one convolution."""
    nodes, tensors = [], {}

    def conv(name, inputs, kernel, bias=None):
        tensors[f"{name}.kernel"] = kernel
        if bias is not None:
            tensors[f"{name}.bias"] = bias
        side = kernel.shape[2]
        given = f"{inputs} {name}.kernel" + ("" if bias is None else f" {name}.bias")
        nodes.append(node("Conv", given, name, kernel_shape=[side, side], pads=[side // 2] * 4, strides=[1, 1], dilations=[1, 1]))

    last, before, levels = "image", 3, []
    for block, size in enumerate([1, 2, 8, 32], 1):
        name = f"block{block}"
        if block > 1:
            by = 2 if block == 2 else 4
            nodes.append(node("MaxPool", last, f"{name}.pooled", kernel_shape=[by, by], strides=[by, by]))
            last = f"{name}.pooled"
        whole, given = last, before
        for number in (1, 2):
            # A normalization whose factors are one is folded into the convolution.
            seed = 10 * block + number
            bias = drawn((8,), 0.2, 0, seed + 5) - drawn((8,), 0.1, 0, seed + 7) / np.sqrt(np.float32(1 + 1e-5))
            kernel = drawn((8, given, 3, 3), 1.2, 0, seed) / np.sqrt(np.float32(1 + 1e-5))
            conv(f"{name}.conv{number}", last, kernel, bias)
            last, given = f"{name}.conv{number}", 8
            if number == 1:
                nodes.append(node("Relu", last, f"{name}.relu1"))
                last = f"{name}.relu1"
        if block > 1:
            conv(f"{name}.aside", whole, drawn((8, before, 1, 1), 1, 0, 80 + block), drawn((8,), 0.1, 0, 90 + block))
            nodes.append(node("Add", f"{last} {name}.aside", f"{name}.sum"))
            last = f"{name}.sum"
        nodes.append(node("Relu", last, name))
        last, before = name, 8
        conv(f"conv{block}", name, drawn((4, 8, 1, 1), 2, 0, 100 + block))
        nodes.append(node("Relu", f"conv{block}", f"level{block}"))
        levels.append(f"level{block}")
        if size > 1:
            tensors[f"scales{block}"] = np.array([1, 1, size, size], np.float32)
            resize = dict(mode="linear", coordinate_transformation_mode="align_corners")
            nodes.append(helper.make_node("Resize", [levels.pop(), "", f"scales{block}"], [f"large{block}"], **resize))
            levels.append(f"large{block}")
    nodes.append(node("Concat", " ".join(levels), "joined", axis=1))
    head = drawn((17, 16, 1, 1), 2, 0, 200)
    conv("odds", "joined", head[16:])
    conv("descriptors", "joined", head[:16])
    nodes.append(node("Sigmoid", "odds", "scores"))
    inputs = {"image": [1, 3, "H", "W"]}
    outputs = {"scores": [1, 1, "H", "W"], "descriptors": [1, 16, "H", "W"]}
    write(CRATES / "device/features/tests/data/learned/made-up.onnx", inputs, outputs, nodes, **tensors)


if __name__ == "__main__":
    alike()
    inversion()
    positions()
    neighbours()
    judges()
