"""Predicts positions along lines from all rows of a query.

The loss is the cross entropy of the bin that holds the keypoint, on images that are obfuscated again for each batch. The validation
gives the gain over the prior-only baseline in bits, and errors.
"""

import argparse
import math
import sys

import numpy as np
import torch

from . import bins as cuts
from . import loop
from .data import KeypointImage, mirrored, read_keypoints, scaled, split
from .export import export
from .models import INPUTS, Positions, parameters
from .schemes import Scheme, sent

#: Bins of a row. Outputs are smooth, so more bins do not help.
BINS = 64
#: Sides of a crop are at least this share of the image's sides.
MIN_CROP_SIDE = 0.5
#: A crop with fewer keypoints is replaced by the whole image.
MIN_KEYPOINTS = 48


def add_arguments(parser: argparse.ArgumentParser) -> None:
    loop.add_arguments(parser, steps=20_000, batch=4, rate=1e-3)
    schemes = "dcl (also dcl:horizontal, dcl:angle=…,s=…), random-lines or coordinate-permutation"
    parser.add_argument("--scheme", default="dcl", help=f"{schemes} (%(default)s)")
    parser.add_argument("--input", choices=INPUTS, default="set", help="input of the network: all rows, one row, or its line only (%(default)s)")
    parser.add_argument("--rows", type=int, default=512, help="keypoints sampled from an image (%(default)s)")
    parser.add_argument("--width", type=int, default=192, help="width of the transformer (%(default)s)")
    parser.add_argument("--heads", type=int, default=6, help="(%(default)s)")
    parser.add_argument("--layers", type=int, default=4, help="(%(default)s)")
    parser.add_argument("--waves", type=int, default=12, help="cosines along each axis (%(default)s)")
    parser.add_argument("--dropout", type=float, default=0.1, help="(%(default)s)")
    parser.add_argument("--mirror", action="store_true", help="mirror half of the samples; only valid for SIFT descriptors")


def draw(image: KeypointImage, most: int, mirror: bool, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, tuple[int, int]]:
    """At most `most` keypoints of a random crop, optionally mirrored: positions, descriptors, size of the crop."""
    size = np.array([image.width, image.height])
    corner = np.zeros(2)
    kept = np.arange(len(image.keypoints))
    if rng.random() < 0.5:
        part = np.clip(np.ceil(rng.uniform(MIN_CROP_SIDE, 1.0, 2) * size), 1, size).astype(int)
        at = rng.integers(0, size - part + 1)
        within = np.flatnonzero(((image.keypoints >= at) & (image.keypoints < at + part)).all(axis=1))
        if len(within) >= MIN_KEYPOINTS:
            corner, size, kept = at, part, within
    kept = rng.permutation(kept)[:most]
    places, descriptors = image.keypoints[kept] - corner, image.descriptors[kept]
    if mirror and rng.random() < 0.5:
        places = np.stack([size[0] - places[:, 0], places[:, 1]], axis=1)
        descriptors = mirrored(descriptors)
    return places, descriptors, (int(size[0]), int(size[1]))


class ObfuscatedBatch:
    """Obfuscated images as one batch, as an attacker has them; the true bin is -1 for padding and for rows with one bin."""

    def __init__(self, drawn: list[tuple], scheme: Scheme, rng: np.random.Generator):
        rows = max(len(places) for places, _, _ in drawn)
        self.bins, self.truth_places, self.sizes = [], [], []
        dimension = drawn[0][1].shape[1]
        descriptors = np.zeros((len(drawn), rows, dimension), np.float32)
        where = np.full((len(drawn), rows, BINS, 2), 0.5, np.float32)
        guess = np.full((len(drawn), rows, BINS), -math.log(BINS), np.float32)
        truth = np.full((len(drawn), rows), -1, np.int64)
        present = np.zeros((len(drawn), rows), bool)
        for i, (places, own, size) in enumerate(drawn):
            n = len(places)
            bins = cuts.cut(sent(places, size, scheme, rng), BINS)
            found = bins.normalized(size)
            b = found.shape[1]
            descriptors[i, :n] = scaled(own)
            where[i, :n, :b], guess[i, :n, :b] = found, bins.guess
            where[i, :n, b:], guess[i, :n, b:] = found[:, -1:], cuts.NEVER
            truth[i, :n], present[i, :n] = bins.holding(places), True
            self.bins.append(bins)
            self.truth_places.append(places)
            self.sizes.append(size)
        tensors = [torch.from_numpy(x) for x in (descriptors, where, guess, truth, present)]
        self.descriptors, self.places, self.guess, self.truth, self.present = tensors

    def to(self, device: str) -> "ObfuscatedBatch":
        for name in ("descriptors", "places", "guess", "truth", "present"):
            setattr(self, name, getattr(self, name).to(device))
        return self

    def shares(self, network: Positions) -> torch.Tensor:
        """Log probability of each bin. `[images, N, B]`"""
        logits = network(self.descriptors, self.places, self.guess, self.present)
        return torch.log_softmax(self.guess + logits, dim=-1)

    def gain(self, shares: torch.Tensor) -> torch.Tensor:
        """Log ratio of the probability of the true bin to its prior, for each row with a true bin."""
        held = self.truth.clamp(min=0).unsqueeze(-1)
        gain = (shares - torch.log_softmax(self.guess, dim=-1)).gather(-1, held).squeeze(-1)
        return gain[self.truth >= 0]


class Validation:
    """Validation on whole images, with the same obfuscation every time."""

    def __init__(self, images: list[KeypointImage], network: Positions, args: argparse.Namespace, scheme: Scheme):
        rng = np.random.default_rng(0)
        self.network = network
        self.sent = []
        for image in images:
            order = rng.permutation(len(image.keypoints))[:1024]
            drawn = (image.keypoints[order], image.descriptors[order], (image.width, image.height))
            self.sent.append(ObfuscatedBatch([drawn], scheme, rng).to(args.device))

    def __call__(self) -> dict[str, float]:
        gains, errors, guesses = [], [], []
        for sent_image in self.sent:
            shares = sent_image.shares(self.network)
            gains.append(sent_image.gain(shares).cpu())
            bins, truth = sent_image.bins[0], sent_image.truth_places[0]
            b = bins.places.shape[1]
            for log, found in ((shares[0, :, :b], errors), (sent_image.guess[0, :, :b], guesses)):
                share = torch.softmax(log.double(), dim=-1).cpu().numpy()
                mean = (share[..., None] * bins.places).sum(axis=1)
                found.append(np.linalg.norm(mean - truth, axis=1) / max(sent_image.sizes[0]))
        bits = torch.cat(gains).mean().item() / math.log(2.0)
        error, guess = np.concatenate(errors), np.concatenate(guesses)
        # The first one selects the best checkpoint (smaller is better).
        return {
            "minus_bits": -bits,
            "median_error": float(np.median(error)), "median_guess": float(np.median(guess)),
            "mean_error": float(error.mean()), "mean_guess": float(guess.mean()),
        }  # fmt: skip


def run(args: argparse.Namespace) -> None:
    loop.setup(args)
    scheme = Scheme.parse(args.scheme)
    training, validation = split(read_keypoints(args.keypoints, args.images), args.validation)
    if args.mirror and training[0].features != "sift":
        sys.exit(f"--mirror is only for descriptors of kind sift, and these are of kind {training[0].features}")
    dimension = training[0].descriptors.shape[1]
    network = Positions(dimension, args.input, args.waves, args.width, args.heads, args.layers, args.dropout)
    print(f"{parameters(network)} parameters, {len(training)} + {len(validation)} images of {dimension} numbers")

    def drawn(rng: np.random.Generator) -> ObfuscatedBatch:
        chosen = rng.integers(len(training), size=args.batch)
        return ObfuscatedBatch([draw(training[i], args.rows, args.mirror, rng) for i in chosen], scheme, rng)

    def loss(batch: ObfuscatedBatch) -> torch.Tensor:
        batch = batch.to(args.device)
        return -batch.gain(batch.shares(network)).mean()

    network.to(args.device)
    trained = loop.train(loop.Task(network, drawn, loss, Validation(validation, network, args, scheme)), args)
    export(trained, args.out, "positions", training[0].features, dimension, scheme=args.scheme, input=args.input)
