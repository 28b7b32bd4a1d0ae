#!/usr/bin/env python3
"""Writes reference values of PSNR and SSIM by scikit-image.

    .venv/bin/pip install numpy scikit-image
    .venv/bin/python research/oracles/image_metrics.py

Writes crates/research/attacks/tests/data/image_metrics/oracle.json: the metrics of synthetic images, a few for each size. Integer
formulas generate the images, so that both sides have the same images without files.
"""

import json
from pathlib import Path

import numpy as np
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

OUT = Path(__file__).resolve().parents[2] / "crates/research/attacks/tests/data/image_metrics/oracle.json"
SIZES = [(96, 80), (131, 67)]


def drawn(width: int, height: int, kind: int) -> np.ndarray:
    """Blocks with noise, `[height, width, 3]`; kind 1 differs from 0 slightly, kind 2 completely."""
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    a, b = x // 11, y // 13
    block = (a * 7 + b * 11 + (a ^ b) * 37) % 160
    colours = [(block + (x * 7 + y * 13 + x * y * (c + 1)) % 31 + (x * (c + 2)) % 50) % 256 for c in range(3)]
    image = np.stack(colours, axis=2)
    if kind == 1:
        image = np.clip(image + (x[..., None] * 5 + y[..., None] * 3) % 23 - 11, 0, 255)
    if kind == 2:
        image = (image[::-1, ::-1] * 3 + 40) % 256
    return image.astype(np.uint8)


def main() -> None:
    rows = []
    for width, height in SIZES:
        first = drawn(width, height, 0)
        for kind in (1, 2):
            other = drawn(width, height, kind)
            rows.append({
                "size": [width, height],
                "kind": kind,
                "sums": [int(first.sum()), int(other.sum())],
                "psnr": float(peak_signal_noise_ratio(first, other, data_range=255)),
                "ssim": float(structural_similarity(
                    first, other, data_range=255, channel_axis=2, gaussian_weights=True, sigma=1.5,
                    use_sample_covariance=False)),
            })
            print(rows[-1])
    OUT.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
