#!/usr/bin/env python3
"""Masks of a region like a person's, one for each image of a list: an upright ellipse of a tenth of the image at random.

For `veiloc eval scene --masks`: the region that docs/results/privacy.md attacks as private is such an ellipse (height over width 2.5,
crates/research/evaluation/src/attack_evaluation/private_region.rs), there of a tenth of the keypoints. Black hides. Equal names give equal masks.

    .venv/bin/python research/notes/person_masks.py --images $VEILOC_DATA/redkitchen/images \
        --list $VEILOC_DATA/redkitchen/query.txt --out masks [--share 0.1]
"""

import argparse
import math
import random
from pathlib import Path

from PIL import Image, ImageDraw

UPRIGHT = 2.5  # height over width


def person(size: tuple[int, int], share: float, draw: random.Random) -> Image.Image:
    """A white image with a black ellipse of this share of its area, wholly inside it."""
    width, height = size
    half_width = math.sqrt(share * width * height / (math.pi * UPRIGHT))
    half_height = min(UPRIGHT * half_width, height / 2)
    half_width = share * width * height / (math.pi * half_height)
    u = draw.uniform(half_width, width - half_width)
    v = draw.uniform(half_height, height - half_height)
    mask = Image.new("L", size, 255)
    ImageDraw.Draw(mask).ellipse((u - half_width, v - half_height, u + half_width, v + half_height), fill=0)
    return mask


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=Path, required=True)
    parser.add_argument("--list", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--share", type=float, default=0.1)
    args = parser.parse_args()
    for line in args.list.read_text().splitlines():
        if not line.strip():
            continue
        name = line.split()[0]
        with Image.open(args.images / name) as image:
            size = image.size
        path = args.out / f"{name}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        person(size, args.share, random.Random(name)).save(path)


if __name__ == "__main__":
    main()
