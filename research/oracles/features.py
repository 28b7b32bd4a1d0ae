#!/usr/bin/env python3
"""Writes a small synthetic image and the features of pycolmap and OpenCV in it, as references for
crates/device/features/tests/it/oracle.rs. `study features extractors` compares them on photographs.

    python3 -m venv .venv && .venv/bin/pip install -r research/requirements.txt
    .venv/bin/python research/oracles/features.py crates/device/features/tests/data
"""

import sys
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from study.extractors import Colmap, OpenCv  # noqa: E402


def drawn_image():
    """Discs, squares and lines of random gray on smooth noise, 240 x 180."""
    rng = np.random.default_rng(7)
    height, width, dense = 180, 240, 4
    image = cv2.resize(rng.uniform(60, 190, (12, 16)), (width * dense, height * dense), interpolation=cv2.INTER_CUBIC)
    for i in range(90):
        x, y = int(rng.uniform(0, width * dense)), int(rng.uniform(0, height * dense))
        size, gray = int(rng.uniform(2, 14) * dense), rng.uniform(0, 255)
        if i % 3 == 0:
            cv2.circle(image, (x, y), size, gray, -1)
        elif i % 3 == 1:
            box = cv2.boxPoints(((x, y), (2 * size, size), rng.uniform(0, 90)))
            cv2.fillPoly(image, [box.round().astype(np.int32)], gray)
        else:
            x2, y2 = x + int(rng.uniform(-40, 40) * dense), y + int(rng.uniform(-40, 40) * dense)
            cv2.line(image, (x, y), (x2, y2), gray, size // 2)
    image = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
    image = cv2.GaussianBlur(image, (0, 0), 0.5) + rng.normal(0, 1.5, (height, width))
    return np.clip(np.round(image), 0, 255).astype(np.uint8)


def write_fixture(folder):
    gray = drawn_image()
    cv2.imwrite(str(folder / "drawn.png"), gray, [cv2.IMWRITE_PNG_COMPRESSION, 9])
    for extractor in [Colmap(300), OpenCv(300)]:
        keypoints, descriptors = extractor(gray)
        raw = np.uint32(len(keypoints)).tobytes()
        raw += np.c_[keypoints, np.zeros(len(keypoints))].astype("<f4").tobytes()
        raw += descriptors.astype(np.uint8).tobytes()
        (folder / f"drawn_{extractor.name}.bin").write_bytes(raw)


if __name__ == "__main__":
    write_fixture(Path(sys.argv[1]))
