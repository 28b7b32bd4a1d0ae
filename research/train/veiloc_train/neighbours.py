"""Predicts which descriptors belong to neighbouring keypoints: embeddings with large dot products for neighbours.

The loss is the cross entropy between the uniform distribution over a keypoint's nearest neighbours and the softmax of its dot products
with all other keypoints of the sample (InfoNCE with several positives).
"""

import argparse

import numpy as np
import torch

from . import loop
from .data import KeypointImage, read_keypoints, scaled, split
from .export import export
from .models import Neighbours, parameters


def add_arguments(parser: argparse.ArgumentParser) -> None:
    loop.add_arguments(parser, steps=20_000, batch=4, rate=1e-3)
    parser.add_argument("--nearest", type=int, default=20, help="number of neighbours of a keypoint (%(default)s)")
    parser.add_argument("--rows", type=int, default=512, help="keypoints sampled from an image (%(default)s)")
    parser.add_argument("--width", type=int, default=192, help="width of the transformer (%(default)s)")
    parser.add_argument("--outputs", type=int, default=96, help="length of an embedding (%(default)s)")
    parser.add_argument("--heads", type=int, default=6, help="(%(default)s)")
    parser.add_argument("--layers", type=int, default=4, help="(%(default)s)")
    parser.add_argument("--dropout", type=float, default=0.1, help="(%(default)s)")


def nearest(keypoints: np.ndarray, count: int) -> np.ndarray:
    """The nearest other keypoints of each, unsorted. `[N, count]`"""
    count = min(count, len(keypoints) - 1)
    squares = (keypoints**2).sum(axis=1)
    away = squares[:, None] + squares[None] - 2.0 * keypoints @ keypoints.T
    np.fill_diagonal(away, np.inf)
    return np.argpartition(away, count - 1, axis=1)[:, :count]


def targets(near: np.ndarray, order: np.ndarray, total: int) -> np.ndarray:
    """Target distribution over the sampled neighbours of each sampled keypoint; zeros if none was sampled. `[n, n]`"""
    index_in_sample = np.full(total, -1)
    index_in_sample[order] = np.arange(len(order))
    row = np.repeat(np.arange(len(order)), near.shape[1])
    column = index_in_sample[near[order]].reshape(-1)
    shares = np.zeros((len(order), len(order)), np.float32)
    shares[row[column >= 0], column[column >= 0]] = 1.0
    return shares / np.maximum(shares.sum(axis=1, keepdims=True), 1.0)


def cross_entropy(network: Neighbours, descriptors: torch.Tensor, present: torch.Tensor, shares: torch.Tensor) -> torch.Tensor:
    """`[images, N, D]`, `[images, N]`, `[images, N, N]`"""
    embedded = network(descriptors, present)
    logits = embedded @ embedded.transpose(1, 2) * network.log_scale.exp()
    itself = torch.eye(logits.shape[1], dtype=torch.bool, device=logits.device)
    logs = torch.log_softmax(logits.masked_fill(itself | ~present[:, None, :], -1e9), dim=-1)
    rows = shares.sum(dim=-1) > 0.0
    return -(shares * logs).sum(dim=-1)[rows].mean()


class Validation:
    """Validation on whole images: share of the true nearest neighbours among the same number of largest dot products."""

    def __init__(self, images: list[KeypointImage], network: Neighbours, args: argparse.Namespace):
        rng = np.random.default_rng(0)
        self.network, self.images = network, []
        for image in images:
            order = rng.permutation(len(image.keypoints))[:1024]
            near = nearest(image.keypoints[order], args.nearest)
            descriptors = torch.from_numpy(scaled(image.descriptors[order]))[None].to(args.device)
            self.images.append((descriptors, torch.from_numpy(near).to(args.device)))

    def __call__(self) -> dict[str, float]:
        found, chance = [], []
        for descriptors, near in self.images:
            embedded = self.network(descriptors)[0]
            products = (embedded @ embedded.T).fill_diagonal_(-2.0)
            best = products.topk(near.shape[1], dim=1).indices
            hits = (best.unsqueeze(2) == near.unsqueeze(1)).any(dim=1).float()
            found.append(hits.mean().item())
            chance.append(near.shape[1] / (len(near) - 1))
        return {"minus_recall": -float(np.mean(found)), "chance": float(np.mean(chance))}


def run(args: argparse.Namespace) -> None:
    loop.setup(args)
    training, validation = split(read_keypoints(args.keypoints, args.images, args.nearest + 2), args.validation)
    dimension = training[0].descriptors.shape[1]
    network = Neighbours(dimension, args.outputs, args.width, args.heads, args.layers, args.dropout)
    print(f"{parameters(network)} parameters, {len(training)} + {len(validation)} images of {dimension} numbers")
    known: dict[int, np.ndarray] = {}

    def drawn(rng: np.random.Generator) -> list[torch.Tensor]:
        orders = []
        chosen = rng.integers(len(training), size=args.batch)
        for i in chosen:
            if i not in known:
                known[i] = nearest(training[i].keypoints, args.nearest).astype(np.int32)
            orders.append(rng.permutation(len(training[i].keypoints))[: args.rows])
        most = max(map(len, orders))
        descriptors = np.zeros((args.batch, most, dimension), np.float32)
        shares = np.zeros((args.batch, most, most), np.float32)
        present = np.zeros((args.batch, most), bool)
        for row, (i, order) in enumerate(zip(chosen, orders)):
            n = len(order)
            descriptors[row, :n] = scaled(training[i].descriptors[order])
            shares[row, :n, :n] = targets(known[i], order, len(training[i].keypoints))
            present[row, :n] = True
        return [torch.from_numpy(x) for x in (descriptors, present, shares)]

    def loss(batch: list[torch.Tensor]) -> torch.Tensor:
        return cross_entropy(network, *(x.to(args.device) for x in batch))

    network.to(args.device)
    trained = loop.train(loop.Task(network, drawn, loss, Validation(validation, network, args)), args)
    export(trained, args.out, "neighbours", training[0].features, dimension)
