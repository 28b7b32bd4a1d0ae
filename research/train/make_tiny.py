#!/usr/bin/env python3
"""Writes tiny networks with random weights, and PyTorch's outputs, for the program's tests of its runner.

    python make_tiny.py

Writes crates/research/attacks/tests/data/networks: a network of each kind, and `expected.json` with inputs and outputs. The files are
reproducible with the same release of PyTorch.
"""

import argparse
import json
from pathlib import Path

import torch

from veiloc_train import models
from veiloc_train.export import export

FOLDER = Path(__file__).resolve().parents[2] / "crates/research/attacks/tests/data/networks"
DIMENSION = 128


def shaken(network: torch.nn.Module) -> torch.nn.Module:
    """Replaces initial statistics and zero-initialized layers by random values."""
    for module in network.modules():
        if isinstance(module, torch.nn.BatchNorm2d):
            torch.nn.init.uniform_(module.running_mean, -0.2, 0.2)
            torch.nn.init.uniform_(module.running_var, 0.5, 2.0)
            torch.nn.init.uniform_(module.weight, 0.5, 1.5)
            torch.nn.init.uniform_(module.bias, -0.2, 0.2)
        elif isinstance(module, models.UNet):
            torch.nn.init.uniform_(module.last.weight, -2.0, 2.0)
    if isinstance(network, models.Positions):
        torch.nn.init.uniform_(network.encoder.last.weight, -0.3, 0.3)
        torch.nn.init.uniform_(network.encoder.last.bias, -0.3, 0.3)
    return network.eval()


def descriptors(count: int) -> torch.Tensor:
    """Rows of squared length `DIMENSION`, the last one zero. `[count, DIMENSION]`"""
    rows = torch.rand(count, DIMENSION) ** 3
    rows = rows / rows.norm(dim=1, keepdim=True) * DIMENSION**0.5
    rows[-1] = 0.0
    return rounded(rows, 4)


def rounded(x: torch.Tensor, digits: int) -> torch.Tensor:
    """Rounds numbers so that a short decimal text represents them."""
    return torch.round(x * 10**digits) / 10**digits


def features(height: int, width: int) -> torch.Tensor:
    """A grid in which a third of the cells are filled."""
    grid = torch.zeros(1, DIMENSION + 1, height, width)
    cells = torch.randperm(height * width)[: height * width // 3]
    rows = descriptors(len(cells))
    grid[0, :-1, cells // width, cells % width] = rows.T
    counts = torch.randint(1, 4, (len(cells),)).float()
    grid[0, -1, cells // width, cells % width] = rounded(torch.log1p(counts), 4)
    return grid


def spread(rows: int, bins: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Positions and log probabilities of bins; the last row has two bins and padding."""
    places = rounded(torch.rand(1, rows, bins, 2), 4)
    guess = rounded(torch.log_softmax(torch.randn(1, rows, bins), dim=-1), 4)
    places[0, -1, 2:] = places[0, -1, 1]
    guess[0, -1, :2] = rounded(torch.tensor([0.5, 0.5]).log(), 4)
    guess[0, -1, 2:] = -1e9
    return places, guess


def plain(tensor: torch.Tensor) -> dict:
    return {"shape": list(tensor.shape), "data": [float(f"{x:.7g}") for x in tensor.flatten().tolist()]}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=FOLDER)
    out = parser.parse_args().out
    torch.manual_seed(20240607)
    made = {
        "inversion": models.Inversion(DIMENSION, width=4, levels=2),
        "invsfm": models.InvSfm(DIMENSION, width=3, levels=2),
        "positions": models.Positions(DIMENSION, "set", waves=8, width=16, heads=2, layers=1),
        "neighbours": models.Neighbours(DIMENSION, outputs=12, width=16, heads=2, layers=1),
    }
    places, guess = spread(5, 6)
    grid = features(4, 6)
    given = {
        "inversion": {"features": grid},
        "invsfm": {"features": grid},
        "positions": {"descriptors": descriptors(5)[None], "places": places, "guess": guess},
        "neighbours": {"descriptors": descriptors(6)[None]},
    }
    expected = {}
    for name, network in made.items():
        shaken(network)
        with torch.no_grad():
            answers = network(*given[name].values())
        names = {"inversion": ["image"], "invsfm": ["image", "visible"], "positions": ["logits"]}
        answers = answers if isinstance(answers, tuple) else (answers,)
        expected[name] = {
            "inputs": {key: plain(value) for key, value in given[name].items()},
            "outputs": {k: plain(v) for k, v in zip(names.get(name, ["embedding"]), answers)},
        }
        more = {}
        kind = "inversion" if name == "invsfm" else name
        if kind == "inversion":
            more = {"side": 32, "multiple": 2, "visible": name == "invsfm"}
        elif kind == "positions":
            more = {"scheme": "dcl", "input": "set"}
        export(network, out / name, kind, "sift", DIMENSION, **more)
    (out / "expected.json").write_text(json.dumps(expected, separators=(",", ":")) + "\n")


if __name__ == "__main__":
    main()
