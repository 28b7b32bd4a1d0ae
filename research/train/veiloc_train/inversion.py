"""Reconstructs the image from descriptors and their positions: a U-Net, or three of them (`--form invsfm`).

A training sample is a window of an image with a random scale around that of the whole image. Some keypoints are dropped, and with
`--wrong` some are moved to random positions, like errors of a geometry-recovery attack.
"""

import argparse
import io
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from torch.nn import functional as F

from . import loop
from .data import KeypointImage, find_image, read_keypoints, scaled, split
from .export import export
from .models import FORMS, inversion, parameters
from .perceptual import StLpips, unit


def add_arguments(parser: argparse.ArgumentParser) -> None:
    loop.add_arguments(parser, steps=100_000, batch=8, rate=3e-4)
    parser.add_argument("--image-folder", type=Path, action="append", required=True,
                        help="folder of the images that the keypoint files name; may be repeated")  # fmt: skip
    parser.add_argument("--form", choices=FORMS, default="unet", help="(%(default)s)")
    parser.add_argument("--width", type=int, default=64, help="channels at the largest resolution (%(default)s)")
    parser.add_argument("--levels", type=int, default=5, help="number of resolutions (%(default)s)")
    parser.add_argument("--side", type=int, default=256, help="cells along the longest side of an image (%(default)s)")
    parser.add_argument("--window", type=int, help="cells of a square training window (default: about two thirds of --side)")
    parser.add_argument("--zoom", type=float, default=1.25, help="largest factor of the random scale of a window (%(default)s)")
    parser.add_argument("--drop", type=float, default=0.5, help="largest share of dropped keypoints (%(default)s)")
    parser.add_argument("--wrong", type=float, default=0.0, help="largest share of misplaced keypoints (%(default)s)")
    parser.add_argument("--feature-network", type=Path, help="file of ST-LPIPS (AlexNet) for a perceptual loss (default: none)")
    parser.add_argument("--feature-weight", type=float, default=1.0, help="(%(default)s)")


def grid_size(width: int, height: int, side: int, multiple: int) -> tuple[int, int]:
    """Columns and rows of the grid: the longer side has `side` cells, each side the nearest multiple, at least one."""
    scale = side / max(width, height)
    return tuple(max(int(np.floor(x * scale / multiple + 0.5)), 1) * multiple for x in (width, height))


def features(places: np.ndarray, descriptors: np.ndarray, shape: tuple[int, int], share: np.ndarray | None = None) -> np.ndarray:
    """The input grid. `[D + 1, H, W]`

    `places`: positions `[N, 2]` in cells; `descriptors`: scaled. A cell holds the weighted sum of its descriptors, divided by
    max(1, total weight); the last channel is ln(1 + total weight)."""
    height, width = shape
    share = np.ones(len(places), np.float32) if share is None else share.astype(np.float32)
    column, row = np.floor(places).astype(int).T
    cell = np.clip(row, 0, height - 1) * width + np.clip(column, 0, width - 1)
    sums = np.zeros((height * width, descriptors.shape[1] + 1), np.float32)
    np.add.at(sums, cell, np.concatenate([descriptors * share[:, None], share[:, None]], axis=1))
    total = sums[:, -1:].copy()
    sums[:, :-1] /= np.maximum(total, 1.0)
    sums[:, -1:] = np.log1p(total)
    return np.ascontiguousarray(sums.T.reshape(-1, height, width))


def right_share(places: np.ndarray, right: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Share of the keypoints of each cell that are at their true position; NaN for an empty cell. `[1, H, W]`"""
    height, width = shape
    column, row = np.floor(places).astype(int).T
    cell = np.clip(row, 0, height - 1) * width + np.clip(column, 0, width - 1)
    counts, rights = (np.bincount(cell, w, height * width) for w in (None, right.astype(np.float64)))
    with np.errstate(invalid="ignore"):
        return (rights / counts).astype(np.float32).reshape(1, height, width)


def misplaced(places: np.ndarray, share: float, shape: tuple[int, int], rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Moves a share of the keypoints to random positions; also returns which are at their true position."""
    right = rng.random(len(places)) >= share
    anywhere = rng.random(places.shape) * [shape[1], shape[0]]
    return np.where(right[:, None], places, anywhere), right


class Photographs:
    """Image pixels by name; caches the bytes of the files."""

    def __init__(self, folders: list[Path]):
        self.folders = folders
        self.read: dict[str, bytes] = {}

    def window(self, image: KeypointImage, box: tuple[float, float, float, float], shape: tuple[int, int]) -> np.ndarray:
        """A part of an image (`box` in the pixels of its keypoints), resized to `shape`. `[3, H, W]`, 0 to 1."""
        if image.name not in self.read:
            self.read[image.name] = find_image(self.folders, image.name).read_bytes()
        with Image.open(io.BytesIO(self.read[image.name])) as opened:
            picture = opened.convert("RGB")
        scale = (picture.width / image.width, picture.height / image.height)
        box = tuple(min(max(x * scale[i % 2], 0.0), picture.size[i % 2]) for i, x in enumerate(box))
        small = picture.resize((shape[1], shape[0]), Image.Resampling.BILINEAR, box=box, reducing_gap=2.0)
        return np.asarray(small, np.float32).transpose(2, 0, 1) / 255.0


class WindowSampler:
    """Samples windows of images."""

    def __init__(self, images: list[KeypointImage], photographs: Photographs, args: argparse.Namespace, multiple: int):
        self.images, self.photographs, self.args, self.multiple = images, photographs, args, multiple
        window = args.window or round(args.side * 2 / 3 / multiple) * multiple
        self.window = max(window // multiple, 1) * multiple

    def one(self, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Features, shares of right positions, image."""
        args, window = self.args, self.window
        image = self.images[rng.integers(len(self.images))]
        size = np.array([image.width, image.height])
        scale = args.side / size.max() * args.zoom ** rng.uniform(-1.0, 1.0)
        scale = max(scale, window / size.min())
        corner = rng.random(2) * (size - window / scale)
        places = (image.keypoints - corner) * scale
        kept = np.flatnonzero(((places >= 0) & (places < window)).all(axis=1))
        kept = kept[rng.random(len(kept)) >= rng.uniform(0.0, args.drop)]
        shape = (window, window)
        places, right = misplaced(places[kept], rng.uniform(0.0, args.wrong), shape, rng)
        grid = features(places, scaled(image.descriptors[kept]), shape)
        box = (*corner, *(corner + window / scale))
        return grid, right_share(places, right, shape), self.photographs.window(image, box, shape)

    def batch(self, rng: np.random.Generator) -> list[torch.Tensor]:
        drawn = [self.one(rng) for _ in range(self.args.batch)]
        return [torch.from_numpy(np.stack(x)) for x in zip(*drawn)]

    def whole(self, image: KeypointImage, rng: np.random.Generator) -> list[torch.Tensor]:
        """A whole image, as in the program, with half of the share `--wrong` misplaced."""
        width, height = grid_size(image.width, image.height, self.args.side, self.multiple)
        places = image.keypoints * [width / image.width, height / image.height]
        shape = (height, width)
        places, right = misplaced(places, 0.5 * self.args.wrong, shape, rng)
        grid = features(places, scaled(image.descriptors), shape)
        picture = self.photographs.window(image, (0, 0, image.width, image.height), shape)
        return [torch.from_numpy(x)[None].to(self.args.device) for x in (grid, right_share(places, right, shape), picture)]


class Loss:
    """Mean absolute difference of pixels, and a perceptual loss; for `invsfm` on both images, with the loss of visibility."""

    def __init__(self, network: torch.nn.Module, args: argparse.Namespace):
        self.network, self.form, self.weight = network, args.form, args.feature_weight
        self.backbone = StLpips.of_file(args.feature_network).to(args.device) if args.feature_network else None

    def of_image(self, made: torch.Tensor, image: torch.Tensor) -> torch.Tensor:
        loss = (made - image).abs().mean()
        if self.backbone is not None:
            pairs = zip(self.backbone.layers(made, 3), self.backbone.layers(image, 3))
            loss = loss + self.weight * sum((unit(a) - unit(b)).square().sum(dim=1).mean() for a, b in pairs) / 3.0
        return loss

    def __call__(self, grid: torch.Tensor, right: torch.Tensor, image: torch.Tensor) -> torch.Tensor:
        if self.form == "unet":
            return self.of_image(self.network(grid), image)
        logits, coarse, refined = self.network.stages(grid)
        filled = ~right.isnan()
        visibility = F.binary_cross_entropy_with_logits(logits[filled], right[filled]) if filled.any() else 0.0
        return self.of_image(refined, image) + 0.5 * self.of_image(coarse, image) + 0.2 * visibility


def run(args: argparse.Namespace) -> None:
    loop.setup(args)
    multiple = 1 << (args.levels - 1)
    training, validation = split(read_keypoints(args.keypoints, args.images), args.validation)
    dimension = training[0].descriptors.shape[1]
    network = inversion(args.form, dimension, args.width, args.levels).to(args.device)
    photographs = Photographs(args.image_folder)
    draws = WindowSampler(training, photographs, args, multiple)
    loss = Loss(network, args)
    print(f"{parameters(network)} parameters, {len(training)} + {len(validation)} images of {dimension} numbers, windows of {draws.window}")

    def validate() -> dict[str, float]:
        rng = np.random.default_rng(0)
        losses, differences, decibels, certain = [], [], [], []
        for image in validation:
            grid, right, picture = draws.whole(image, rng)
            losses.append(loss(grid, right, picture).item())
            made = network(grid)
            if args.form == "invsfm":
                made, visible = made
                filled = ~right.isnan()
                certain.append(((visible > 0.5) == (right > 0.5))[filled].float().mean().item())
            differences.append((made - picture).abs().mean().item())
            decibels.append(-10.0 * torch.log10((made - picture).square().mean()).item())
        figures = {"validation_loss": np.mean(losses), "l1": np.mean(differences), "psnr": np.mean(decibels)}
        if certain:
            figures["visible"] = np.mean(certain)
        return {name: float(value) for name, value in figures.items()}

    trained = loop.train(loop.Task(network, draws.batch, lambda batch: loss(*(x.to(args.device) for x in batch)), validate), args)
    more = {"side": args.side, "multiple": multiple, "visible": args.form == "invsfm"}
    export(trained, args.out, "inversion", training[0].features, dimension, **more)
