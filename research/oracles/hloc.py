#!/usr/bin/env python3
"""Tests our hloc files against h5py: writes reference files, and reads files that we wrote.

    python -m venv venv && venv/bin/pip install h5py numpy
    venv/bin/python research/oracles/hloc.py fixtures     writes crates/tools/mapping/tests/data/importers/hloc
    venv/bin/python research/oracles/hloc.py read FILE    reads a file of features or matches, and prints its content

`fixtures` writes files in the form of hloc's extract_features, match_features and global descriptors: groups nested by the image's
name, `libver="latest"`, float16 with `as_half`, the attribute `uncertainty`, pairs under the new and the old names; and other valid
forms (float32 and float64, gzip with shuffle in chunks, h5py's older default format). Values are a formula of the index, which
crates/tools/mapping/tests/it/importers/hloc/oracle.rs also has.
"""

import sys
from pathlib import Path

import h5py
import numpy as np

DATA = Path(__file__).resolve().parents[2] / "crates/tools/mapping/tests/data/importers/hloc"
IMAGES = ["db/a.jpg", "db/sub/b.jpg", "query.png"]


def numbers(count, factor, modulus):
    """Multiples of 1/64 below 16, which float16 holds exactly."""
    return (np.arange(count) * factor % modulus) / 64


def features(image, count=5, dim=8):
    shift = 3 * IMAGES.index(image)
    return {
        "keypoints": numbers(2 * count, 37, 1024).reshape(count, 2) + shift,
        "descriptors": (numbers(dim * count, 29, 128) - 1).reshape(dim, count),
        "scores": numbers(count, 11, 64),
        "image_size": np.array([640, 480 + shift]),
    }


def write_features(path, dtype, packed=False, **options):
    with h5py.File(path, "w", **options) as file:
        for image in IMAGES:
            group = file.create_group(image)
            for name, values in features(image).items():
                if values.dtype.kind == "f":
                    values = values.astype(dtype)
                kind = {"chunks": True, "compression": "gzip", "shuffle": True} if packed else {}
                group.create_dataset(name, data=values, **kind)
            group["keypoints"].attrs["uncertainty"] = 1.5


def fixtures():
    DATA.mkdir(parents=True, exist_ok=True)
    write_features(DATA / "feats-half.h5", np.float16, libver="latest")
    write_features(DATA / "feats-single-packed.h5", np.float32, packed=True)
    write_features(DATA / "feats-double-v114.h5", np.float64, packed=True, libver=("v114", "v114"))
    write_features(DATA / "feats-packed-latest.h5", np.float16, packed=True, libver="latest")
    with h5py.File(DATA / "matches.h5", "w", libver="latest") as file:
        new = file.create_group("query.png/db-a.jpg")
        new.create_dataset("matches0", data=np.array([3, -1, 0, -1, 4], np.int16))
        new.create_dataset("matching_scores0", data=np.array([0.5, 0, 0.25, 0, 1], np.float16))
        old = file.create_group("query.png_db-sub-b.jpg")
        old.create_dataset("matches0", data=np.array([-1, 2], np.int32))
    with h5py.File(DATA / "globals.h5", "w", libver="latest") as file:
        for image in IMAGES:
            vector = numbers(16, 13, 64) + IMAGES.index(image)
            file.create_group(image).create_dataset("global_descriptor", data=vector.astype(np.float16))
    # A group that contains itself.
    with h5py.File(DATA / "cycle.h5", "w") as file:
        file.create_group("a")["b"] = file["/"]


def read(path):
    """`NAME DTYPE SHAPE FIRST LAST SUM` of each dataset, and its attributes."""
    def describe(name, item):
        if isinstance(item, h5py.Dataset):
            values = item[()].astype(np.float64).ravel()
            ends = (values[0], values[-1]) if len(values) else (0.0, 0.0)
            shape = "x".join(map(str, item.shape))
            print(name, item.dtype, shape, *(f"{v:.6f}" for v in (*ends, values.sum())), dict(item.attrs))

    with h5py.File(path, "r") as file:
        file.visititems(describe)


if __name__ == "__main__":
    fixtures() if sys.argv[1] == "fixtures" else read(sys.argv[2])
