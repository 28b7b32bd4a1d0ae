#!/usr/bin/env python3
"""PSNR and SSIM by scikit-image, LPIPS and the distance of features by NumPy, for ours to be held against.

    .venv/bin/pip install numpy scikit-image
    .venv/bin/python scripts/oracle_judge.py

Writes crates/research/attacks/tests/data/image_metrics/oracle.json: what the measures say of drawn images, a few for each size. Images and the weights of
the networks are made by formulas in whole numbers, so that both sides have the very same and no file need be passed on. LPIPS is
written here from its authors' program (`lpips/lpips.py`, `pretrained_networks.py`), layer by layer, in double precision.
"""

import json
from pathlib import Path

import numpy as np
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

OUT = Path(__file__).parent.parent / "crates/research/attacks/tests/data/image_metrics/oracle.json"
SIZES = [(96, 80), (131, 67)]
SHIFT = np.array([-0.030, -0.088, -0.188])
SCALE = np.array([0.458, 0.448, 0.450])
ALEX = [  # number, from, to, side, zeros, stride; None: pool of 3 every 2
    (0, 3, 64, 11, 2, 4), None, (3, 64, 192, 5, 2, 1), None,
    (6, 192, 384, 3, 1, 1), (8, 384, 256, 3, 1, 1), (10, 256, 256, 3, 1, 1),
]
SUPERPOINT = [
    ("1a", 1, 64), ("1b", 64, 64), ("2a", 64, 64), ("2b", 64, 64),
    ("3a", 64, 128), ("3b", 128, 128), ("4a", 128, 128), ("4b", 128, 128),
]


def drawn(width: int, height: int, kind: int) -> np.ndarray:
    """Blocks with noise, `[height, width, 3]`; kinds 1 and 2 differ from 0 a little, and in everything."""
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


def made_up(count: int, seed: int, scale: float) -> np.ndarray:
    """Numbers from -scale / 2 to scale / 2 by a formula."""
    i = np.arange(count, dtype=np.uint64) + np.uint64(seed * 7919)
    return (((i * np.uint64(2654435761)) % np.uint64(2**32)).astype(np.float64) / 2**32 - 0.5) * scale


def kernel(to: int, frm: int, side: int, seed: int) -> np.ndarray:
    inputs = frm * side * side
    return made_up(to * inputs, seed, 4 / np.sqrt(inputs)).astype(np.float32).astype(np.float64).reshape(to, frm, side, side)


def bias(to: int, seed: int) -> np.ndarray:
    return made_up(to, seed + 100, 0.2).astype(np.float32).astype(np.float64)


def convolved(x: np.ndarray, k: np.ndarray, b: np.ndarray, zeros: int, stride: int) -> np.ndarray:
    side = k.shape[2]
    x = np.pad(x, ((0, 0), (zeros, zeros), (zeros, zeros)))
    windows = np.lib.stride_tricks.sliding_window_view(x, (side, side), axis=(1, 2))[:, ::stride, ::stride]
    return np.maximum(np.einsum("chwij,ocij->ohw", windows, k, optimize=True) + b[:, None, None], 0)


def pooled(x: np.ndarray, side: int, stride: int) -> np.ndarray:
    windows = np.lib.stride_tricks.sliding_window_view(x, (side, side), axis=(1, 2))[:, ::stride, ::stride]
    return windows.max(axis=(3, 4))


def unit(x: np.ndarray) -> np.ndarray:
    return x / (np.sqrt((x**2).sum(axis=0, keepdims=True)) + 1e-10)


def alex(image: np.ndarray) -> list:
    x = ((image / 127.5 - 1 - SHIFT) / SCALE).transpose(2, 0, 1)
    layers = []
    for part in ALEX:
        if part is None:
            x = pooled(x, 3, 2)
            continue
        number, frm, to, side, zeros, stride = part
        x = convolved(x, kernel(to, frm, side, number), bias(to, number), zeros, stride)
        layers.append(x)
    return layers


def lpips(a: np.ndarray, b: np.ndarray) -> float:
    total = 0.0
    for at, (x, y) in enumerate(zip(alex(a), alex(b))):
        weights = np.abs(made_up(x.shape[0], at + 1, 2.0)).astype(np.float32).astype(np.float64)
        total += float(((unit(x) - unit(y)) ** 2 * weights[:, None, None]).sum(axis=0).mean())
    return total


def superpoint(image: np.ndarray) -> list:
    x = (image @ np.array([0.2126, 0.7152, 0.0722]) / 255)[None]
    layers = []
    for at, (name, frm, to) in enumerate(SUPERPOINT):
        x = convolved(x, kernel(to, frm, 3, 20 + at), bias(to, 20 + at), 1, 1)
        if name.endswith("b"):
            layers.append(x)
            if name != "4b":
                x = pooled(x, 2, 2)
    return layers


def feature_distance(a: np.ndarray, b: np.ndarray) -> float:
    def apart(x, y):
        cosine = (unit(x) * unit(y)).sum(axis=0)
        none = (x == 0).all(axis=0) & (y == 0).all(axis=0)
        return float(np.where(none, 0.0, np.maximum(1 - cosine, 0)).mean())

    return float(np.mean([apart(x, y) for x, y in zip(superpoint(a), superpoint(b))]))


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
                "lpips_made_up": lpips(first, other),
                "feature_distance_made_up": feature_distance(first, other),
            })
            print(rows[-1])
    OUT.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
