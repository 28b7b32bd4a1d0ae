"""Reconstructs the image from descriptors and their positions: a U-Net, or three of them (`--form invsfm`).

With `--input positions` the network gets no descriptors, with `--input colour` the colour of the pixel of each keypoint in their place.

A training sample is a window of an image with a random scale around that of the whole image. Some keypoints are dropped, and with
`--wrong` some are moved to random positions, like errors of a geometry-recovery attack.
"""

import argparse
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from torch.nn import functional as F

from . import loop
from .data import KeypointImage, find_image, mirrored, read_keypoints, scaled, split
from .export import export
from .models import FORMS, inversion, parameters
from .perceptual import StLpips, unit

#: What the network gets of a keypoint: its descriptor, nothing but the position, the colour of its pixel.
INPUTS = ("descriptors", "positions", "colour")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    loop.add_arguments(parser, steps=100_000, batch=8, rate=3e-4)
    parser.add_argument("--image-folder", type=Path, action="append", required=True,
                        help="folder of the images that the keypoint files name; may be repeated")  # fmt: skip
    parser.add_argument("--form", choices=FORMS, default="unet", help="(%(default)s)")
    parser.add_argument("--input", choices=INPUTS, default=INPUTS[0], help="what the network gets of a keypoint beside its position (%(default)s)")
    parser.add_argument("--width", type=int, default=64, help="channels at the largest resolution (%(default)s)")
    parser.add_argument("--levels", type=int, default=5, help="number of resolutions (%(default)s)")
    parser.add_argument("--side", type=int, default=256, help="cells along the longest side of an image (%(default)s)")
    parser.add_argument("--window", type=int, help="cells of a square training window (default: about two thirds of --side)")
    parser.add_argument("--zoom", type=float, default=1.25, help="largest factor of the random scale of a window (%(default)s)")
    parser.add_argument("--drop", type=float, default=0.5, help="largest share of dropped keypoints (%(default)s)")
    parser.add_argument("--wrong", type=float, default=0.0, help="largest share of misplaced keypoints (%(default)s)")
    parser.add_argument("--feature-network", type=Path, help="file of ST-LPIPS (AlexNet) for a perceptual loss (default: none)")
    parser.add_argument("--feature-weight", type=float, default=1.0, help="(%(default)s)")
    parser.add_argument("--mirror", action="store_true", help="mirror half of the samples; valid for positions, colours and SIFT descriptors")
    parser.add_argument("--bf16", action="store_true", help="convolutions of 16 bits (bfloat16), for GPUs that have them")


def grid_size(width: int, height: int, side: int, multiple: int) -> tuple[int, int]:
    """Columns and rows of the grid: the longer side has `side` cells, each side the nearest multiple, at least one."""
    scale = side / max(width, height)
    return tuple(max(int(np.floor(x * scale / multiple + 0.5)), 1) * multiple for x in (width, height))


def cells_of(places: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Number of the cell of each position `[N, 2]`, in the order of rows."""
    column, row = np.floor(places).astype(np.int64).T
    return np.clip(row, 0, shape[0] - 1) * shape[1] + np.clip(column, 0, shape[1] - 1)


def features(cells: torch.Tensor, descriptors: torch.Tensor, images: int, shape: tuple[int, int]) -> torch.Tensor:
    """The input grids of some images. `[images, D + 1, H, W]`

    `cells`: numbers of the cells, continued from one image to the next; `descriptors`: scaled. A cell holds the mean of its descriptors;
    the last channel is ln(1 + their number)."""
    total = images * shape[0] * shape[1]
    counts = torch.bincount(cells, minlength=total).to(descriptors.dtype)
    grid = descriptors.new_zeros(total, descriptors.shape[1] + 1)
    grid[:, :-1].index_add_(0, cells, descriptors / counts[cells, None])
    grid[:, -1] = torch.log1p(counts)
    return grid.reshape(images, *shape, -1).permute(0, 3, 1, 2)


def right_share(cells: torch.Tensor, right: torch.Tensor, images: int, shape: tuple[int, int]) -> torch.Tensor:
    """Share of the keypoints of each cell that are at their true position; NaN for an empty cell. `[images, 1, H, W]`"""
    total = images * shape[0] * shape[1]
    counts, rights = (torch.bincount(cells, w, minlength=total).float() for w in (None, right.float()))
    return (rights / counts).reshape(images, 1, *shape)


def misplaced(places: np.ndarray, share: float, shape: tuple[int, int], rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Moves a share of the keypoints to random positions; also returns which are at their true position."""
    right = rng.random(len(places)) >= share
    anywhere = rng.random(places.shape) * [shape[1], shape[0]]
    return np.where(right[:, None], places, anywhere), right


def pixels(folders: list[Path], name: str, longest: int | None = None, size: tuple[int, int] | None = None) -> torch.Tensor:
    """An image, resized to `size` (width, height), or so that its longer side is at most `longest`. `[3, H, W]`, 0 to 255."""
    with Image.open(find_image(folders, name)) as opened:
        photo = opened.convert("RGB")
    if size is None:
        scale = min(longest / max(photo.size), 1.0)
        size = tuple(max(round(x * scale), 1) for x in photo.size)
    small = photo.resize(size, Image.Resampling.BILINEAR, reducing_gap=2.0)
    return torch.from_numpy(np.array(small)).permute(2, 0, 1)


def window(photo: torch.Tensor, box: np.ndarray, side: int) -> torch.Tensor:
    """The part of a photo in a box (left, top, right, bottom, as shares of its sides; mirrored if right < left), each pixel the mean
    of four samples. `[1, 3, side, side]`, 0 to 1."""
    along = (torch.arange(2 * side, device=photo.device) + 0.5) / (2 * side)
    x, y = (2.0 * (float(box[i]) + along * float(box[i + 2] - box[i])) - 1.0 for i in (0, 1))
    places = torch.stack([x.expand(2 * side, -1), y[:, None].expand(-1, 2 * side)], dim=-1)
    twice = F.grid_sample(photo[None].float(), places[None], mode="bilinear", padding_mode="border", align_corners=False)
    return F.avg_pool2d(twice, 2) / 255.0


def rows_of(image: KeypointImage, args: argparse.Namespace) -> np.ndarray:
    """What the network gets of each keypoint of an image, by `--input`. `[N, D]`, `[N, 0]` or `[N, 3]`, float32"""
    if args.input == "descriptors":
        return scaled(image.descriptors)
    if args.input == "positions":
        return np.zeros((len(image.keypoints), 0), np.float32)
    with Image.open(find_image(args.image_folder, image.name)) as opened:
        photo = np.asarray(opened.convert("RGB"))
    column, row = np.floor(image.keypoints * [photo.shape[1] / image.width, photo.shape[0] / image.height]).astype(np.int64).T
    return photo[row, column].astype(np.float32) / 127.5 - 1.0


@dataclass(frozen=True)
class Windows:
    """Windows as a worker samples them: everything but descriptors and pixels, which are on the device."""

    #: Number of the image of each window.
    images: np.ndarray
    #: As for `window`.
    boxes: np.ndarray
    #: Number of each keypoint among those of all images, its cell, whether it is at its true position, whether it is mirrored.
    keypoints: torch.Tensor
    cells: torch.Tensor
    right: torch.Tensor
    mirrored: torch.Tensor


class WindowSampler:
    """Samples windows of images."""

    def __init__(self, images: list[KeypointImage], args: argparse.Namespace, multiple: int):
        self.images, self.args = images, args
        side = args.window or round(args.side * 2 / 3 / multiple) * multiple
        self.window = max(side // multiple, 1) * multiple
        self.first = np.cumsum([0] + [len(image.keypoints) for image in images])
        dimension = images[0].descriptors.shape[1]
        reordered = args.mirror and args.input == "descriptors"
        self.mirrored_order = torch.from_numpy(mirrored(np.arange(dimension)[None])[0].copy()).to(args.device) if reordered else None

    def load(self) -> None:
        """Loads descriptors and pixels into the device's memory."""
        device, longest = self.args.device, 2 * self.args.side
        self.descriptors = torch.cat([torch.from_numpy(rows_of(x, self.args)).half().to(device) for x in self.images])
        with ThreadPoolExecutor() as pool:
            read = pool.map(lambda x: pixels(self.args.image_folder, x.name, longest), self.images)
            self.pixels = [photo.to(device) for photo in read]

    def one(self, rng: np.random.Generator) -> tuple:
        args, side = self.args, self.window
        number = rng.integers(len(self.images))
        image = self.images[number]
        size = np.array([image.width, image.height])
        scale = args.side / size.max() * args.zoom ** rng.uniform(-1.0, 1.0)
        scale = max(scale, side / size.min())
        corner = rng.random(2) * (size - side / scale)
        places = (image.keypoints - corner) * scale
        kept = np.flatnonzero(((places >= 0) & (places < side)).all(axis=1))
        kept = kept[rng.random(len(kept)) >= rng.uniform(0.0, args.drop)]
        box = np.concatenate([corner / size, (corner + side / scale) / size])
        places = places[kept]
        is_mirrored = args.mirror and rng.random() < 0.5
        if is_mirrored:
            places, box = np.stack([side - places[:, 0], places[:, 1]], axis=1), box[[2, 1, 0, 3]]
        places, right = misplaced(places, rng.uniform(0.0, args.wrong), (side, side), rng)
        return number, box, self.first[number] + kept, cells_of(places, (side, side)), right, np.full(len(kept), is_mirrored)

    def batch(self, rng: np.random.Generator) -> Windows:
        drawn = [self.one(rng) for _ in range(self.args.batch)]
        numbers, boxes, keypoints, cells, right, is_mirrored = zip(*drawn)
        cells = [x + i * self.window**2 for i, x in enumerate(cells)]
        rows = (torch.from_numpy(np.concatenate(x)) for x in (keypoints, cells, right, is_mirrored))
        return Windows(np.array(numbers), np.stack(boxes), *rows)

    def on_device(self, windows: Windows) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Grids, shares of right positions, images."""
        device, count, shape = self.args.device, len(windows.images), (self.window, self.window)
        cells = windows.cells.to(device)
        descriptors = self.descriptors[windows.keypoints.to(device)].float()
        if self.mirrored_order is not None:
            descriptors = torch.where(windows.mirrored.to(device)[:, None], descriptors[:, self.mirrored_order], descriptors)
        photos = [window(self.pixels[i], box, self.window) for i, box in zip(windows.images, windows.boxes)]
        return features(cells, descriptors, count, shape), right_share(cells, windows.right.to(device), count, shape), torch.cat(photos)


class WholeImage:
    """A whole image, as in the program, with half of the share `--wrong` misplaced."""

    def __init__(self, image: KeypointImage, args: argparse.Namespace, multiple: int):
        rng = np.random.default_rng(0)
        width, height = grid_size(image.width, image.height, args.side, multiple)
        self.shape, self.device = (height, width), args.device
        places, right = misplaced(image.keypoints * [width / image.width, height / image.height], 0.5 * args.wrong, self.shape, rng)
        self.cells, self.right = torch.from_numpy(cells_of(places, self.shape)), torch.from_numpy(right)
        self.descriptors = torch.from_numpy(rows_of(image, args))
        self.photo = pixels(args.image_folder, image.name, size=(width, height))

    def on_device(self) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        cells, right, descriptors, photo = (x.to(self.device) for x in (self.cells, self.right, self.descriptors, self.photo))
        return features(cells, descriptors, 1, self.shape), right_share(cells, right, 1, self.shape), photo[None] / 255.0


class Loss:
    """Mean absolute difference of pixels, and a perceptual loss; for `invsfm` on both images, with the loss of visibility."""

    def __init__(self, network: torch.nn.Module, args: argparse.Namespace):
        self.network, self.form, self.weight = network, args.form, args.feature_weight
        self.backbone = StLpips.of_file(args.feature_network).to(args.device) if args.feature_network else None

    def of_image(self, made: torch.Tensor, image: torch.Tensor) -> torch.Tensor:
        loss = (made.float() - image).abs().mean()
        if self.backbone is not None:
            pairs = zip(self.backbone.layers(made, 3), self.backbone.layers(image, 3))
            loss = loss + self.weight * sum((unit(a.float()) - unit(b.float())).square().sum(dim=1).mean() for a, b in pairs) / 3.0
        return loss

    def __call__(self, grid: torch.Tensor, right: torch.Tensor, image: torch.Tensor) -> torch.Tensor:
        if self.form == "unet":
            return self.of_image(self.network(grid), image)
        logits, coarse, refined = self.network.stages(grid)
        filled = ~right.isnan()
        visibility = F.binary_cross_entropy_with_logits(logits[filled].float(), right[filled]) if filled.any() else 0.0
        return self.of_image(refined, image) + 0.5 * self.of_image(coarse, image) + 0.2 * visibility


def run(args: argparse.Namespace) -> None:
    loop.setup(args)
    multiple = 1 << (args.levels - 1)
    training, validation = split(read_keypoints(args.keypoints, args.images), args.validation)
    if args.mirror and args.input == "descriptors" and training[0].features != "sift":
        sys.exit(f"--mirror is only for descriptors of kind sift, and these are of kind {training[0].features}")
    dimension = {"descriptors": training[0].descriptors.shape[1], "positions": 0, "colour": 3}[args.input]
    network = inversion(args.form, dimension, args.width, args.levels).to(args.device, memory_format=torch.channels_last)
    draws = WindowSampler(training, args, multiple)
    draws.load()
    whole = [WholeImage(image, args, multiple) for image in validation]
    loss = Loss(network, args)
    print(f"{parameters(network)} parameters, {len(training)} + {len(validation)} images of {dimension} numbers, windows of {draws.window}")

    def half_precision() -> torch.autocast:
        return torch.autocast(torch.device(args.device).type, torch.bfloat16, enabled=args.bf16)

    def loss_of(windows: Windows) -> torch.Tensor:
        sampled = draws.on_device(windows)
        with half_precision():
            return loss(*sampled)

    def validate() -> dict[str, float]:
        losses, differences, decibels, certain = [], [], [], []
        for image in whole:
            grid, right, photo = image.on_device()
            with half_precision():
                losses.append(loss(grid, right, photo).item())
                made = network(grid)
            if args.form == "invsfm":
                made, visible = made
                filled = ~right.isnan()
                certain.append(((visible > 0.5) == (right > 0.5))[filled].float().mean().item())
            made = made.float()
            differences.append((made - photo).abs().mean().item())
            decibels.append(-10.0 * torch.log10((made - photo).square().mean()).item())
        figures = {"validation_loss": np.mean(losses), "l1": np.mean(differences), "psnr": np.mean(decibels)}
        if certain:
            figures["visible"] = np.mean(certain)
        return {name: float(value) for name, value in figures.items()}

    trained = loop.train(loop.Task(network, draws.batch, loss_of, validate), args)
    more = {"side": args.side, "multiple": multiple, "visible": args.form == "invsfm"}
    if args.input != "descriptors":
        more["input"] = args.input
    export(trained.to(memory_format=torch.contiguous_format), args.out, "inversion", training[0].features, dimension, **more)
