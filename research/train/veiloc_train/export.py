"""Writes ONNX files, each with a description file for the program."""

import json
import warnings
from pathlib import Path

import torch
from torch import nn

OPSET = 17
#: Names of inputs and outputs, with their dynamic axes.
INPUTS = {
    "inversion": {"features": {2: "height", 3: "width"}},
    "positions": {
        "descriptors": {1: "keypoints"}, "places": {1: "keypoints", 2: "bins"}, "guess": {1: "keypoints", 2: "bins"},
    },
    "neighbours": {"descriptors": {1: "keypoints"}},
}  # fmt: skip
OUTPUTS = {
    "inversion": {"image": {2: "height", 3: "width"}},
    "positions": {"logits": {1: "keypoints", 2: "bins"}},
    "neighbours": {"embedding": {1: "keypoints"}},
}
VISIBLE = {"visible": {2: "height", 3: "width"}}


def example(kind: str, dimension: int, multiple: int = 16) -> tuple[torch.Tensor, ...]:
    """Example inputs."""
    if kind == "inversion":
        return (torch.randn(1, dimension + 1, 2 * multiple, 3 * multiple),)
    descriptors = torch.randn(1, 7, dimension)
    if kind == "neighbours":
        return (descriptors,)
    guess = torch.log_softmax(torch.randn(1, 7, 5), dim=-1)
    return descriptors, torch.rand(1, 7, 5, 2), guess


def onnx_graph(network: nn.Module, inputs, path: Path, names: dict, results: dict) -> None:
    """Exports a network in evaluation mode; batch normalizations are folded into the convolutions before them."""
    network = network.eval()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.onnx.export(
            network,
            tuple(inputs),
            str(path),
            input_names=list(names),
            output_names=list(results),
            dynamic_axes={name: axes for name, axes in (names | results).items() if axes},
            opset_version=OPSET,
            dynamo=False,
        )


def describe(path: Path, fields: dict) -> None:
    """Writes the description file: TOML with plain values."""
    lines = [f"{name} = {json.dumps(value)}\n" for name, value in fields.items()]
    path.write_text("".join(lines))


def export(network: nn.Module, stem: Path, kind: str, features: str, dimension: int, **more) -> None:
    """Writes `stem`.onnx and `stem`.toml. `more`: additional fields of the description."""
    stem.parent.mkdir(parents=True, exist_ok=True)
    results = OUTPUTS[kind] | (VISIBLE if more.pop("visible", False) else {})
    given = example(kind, dimension, more.get("multiple", 16))
    network = network.to("cpu")
    onnx_graph(network, given, stem.with_suffix(".onnx"), INPUTS[kind], results)
    fields = {"version": 1, "kind": kind, "model": f"{stem.name}.onnx", "features": features, "dimension": dimension}
    describe(stem.with_suffix(".toml"), fields | more)
