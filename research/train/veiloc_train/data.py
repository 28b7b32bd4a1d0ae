"""Reads keypoint files of `veiloc eval keypoints`, and finds their images."""

import base64
import gzip
import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class KeypointImage:
    """An image with keypoints and descriptors."""

    name: str
    width: int
    height: int
    #: `[N, 2]`: u, v in pixels, from the image corner.
    keypoints: np.ndarray
    #: `[N, D]` numbers.
    descriptors: np.ndarray
    #: Kind of the descriptors, as for --features of the program.
    features: str


def read_keypoints(paths: list[Path], most: int | None = None, need: int = 2) -> list[KeypointImage]:
    """Reads all images of these files with at least `need` keypoints inside the image, at most `most`."""
    images = []
    for image in map(inside, (json.loads(line) for path in paths for line in lines_of(path))):
        if len(image.keypoints) >= need:
            images.append(image)
        if most is not None and len(images) >= most:
            break
    if not images:
        sys.exit(f"no image with {need} keypoints in {', '.join(map(str, paths))}")
    kinds = sorted({(image.features, image.descriptors.shape[1]) for image in images})
    if len(kinds) > 1:
        sys.exit("the descriptors are of different kinds: " + ", ".join(f"{name} of {length} numbers" for name, length in kinds))
    return images


def lines_of(path: Path) -> Iterator[str]:
    """The lines of a text file, plain or gzipped."""
    opened = gzip.open if path.suffix == ".gz" else open
    with opened(path, "rt") as lines:
        yield from lines


def inside(fields: dict) -> KeypointImage:
    """Decodes an image, without keypoints outside of it."""
    width, height, dimension = fields["width"], fields["height"], fields["descriptor_dim"]
    keypoints = np.asarray(fields["keypoints"], dtype=np.float64).reshape(-1, 2)
    descriptors = np.frombuffer(base64.b64decode(fields["descriptors"]), dtype=np.uint8).reshape(-1, dimension)
    if len(keypoints) != len(descriptors):
        sys.exit(f"{fields['name']}: {len(keypoints)} keypoints and {len(descriptors)} descriptors")
    features = fields.get("features", "sift")
    encoding = fields.get("descriptor_encoding", "unsigned" if (features, dimension) == ("sift", 128) else None)
    if encoding is None:
        sys.exit(f"{fields['name']}: descriptors of {dimension} numbers need features and descriptor_encoding")
    if encoding != "unsigned":
        descriptors = descriptors.astype(np.int16) - 128
    kept = ((keypoints >= 0) & (keypoints < [width, height])).all(axis=1)
    return KeypointImage(fields["name"], width, height, keypoints[kept], descriptors[kept], features)


def scaled(descriptors: np.ndarray) -> np.ndarray:
    """Scales each row to squared length D, the input form of the networks; rows of zeros stay zero. `[N, D]` float32"""
    rows = descriptors.astype(np.float32)
    norms = np.linalg.norm(rows, axis=1, keepdims=True)
    return rows / np.maximum(norms, 1e-12) * np.float32(rows.shape[1] ** 0.5)


def mirrored(descriptors: np.ndarray) -> np.ndarray:
    """SIFT descriptors of the mirrored image. `[N, 128]`

    A descriptor has 4 rows, 4 columns and 8 directions in the keypoint's own axes. In the mirrored image the order of the rows and the
    sense of the directions are reversed.
    """
    if descriptors.shape[1] != 128:
        raise ValueError("only SIFT's 128 numbers can be mirrored")
    cells = descriptors.reshape(-1, 4, 4, 8)[:, ::-1]
    return cells[..., (-np.arange(8)) % 8].reshape(-1, 128)


def split(images: list[KeypointImage], validation: int, seed: int = 0) -> tuple[list[KeypointImage], list[KeypointImage]]:
    """Splits images into training and validation images. The split depends only on the sorted names and the seed."""
    validation = min(validation, len(images) // 2)
    order = np.random.default_rng(seed).permutation(len(images))
    held_out = {int(i) for i in order[:validation]}
    ordered = sorted(images, key=lambda image: image.name)
    return [x for i, x in enumerate(ordered) if i not in held_out], [x for i, x in enumerate(ordered) if i in held_out]


def find_image(folders: list[Path], name: str) -> Path:
    """Path of the image with this name in one of the folders."""
    for folder in folders:
        if (folder / name).is_file():
            return folder / name
    sys.exit(f"{name} is in none of {', '.join(map(str, folders))}")
