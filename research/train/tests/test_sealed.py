"""Candidates of rows against queries that the program seals; VEILOC_PROGRAM names the program."""

import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from veiloc_train import data, schemes

ROOT = Path(__file__).resolve().parents[3]
SIZE = np.array([512.0, 384.0])


@pytest.fixture(scope="module")
def program():
    if "VEILOC_PROGRAM" not in os.environ:
        pytest.skip("VEILOC_PROGRAM names no program")
    return os.environ["VEILOC_PROGRAM"]


@pytest.fixture(scope="module")
def image(program, tmp_path_factory):
    """A folder with an image of random blocks, and its keypoints."""
    folder = tmp_path_factory.mktemp("sealed")
    y, x = np.mgrid[:384, :512]
    noise = np.random.default_rng(0).integers(0, 200, (384 // 12, 512 // 16))
    gray = noise[y // 12, x // 16] + 25 * np.sin(x / 5.0) * np.cos(y / 7.0) + 27
    (folder / "images").mkdir()
    Image.fromarray(gray.astype(np.uint8)).convert("RGB").save(folder / "images/a.png")
    run(program, "eval", "keypoints", folder / "images", "--features", "sift", "--max-keypoints", "8000", "-o", folder / "k.jsonl")
    return folder, data.inside(json.loads((folder / "k.jsonl").read_text()))


def run(*command):
    subprocess.run([str(word) for word in command], check=True, capture_output=True)


@pytest.mark.parametrize("name", ["dcl", "dcl:horizontal", "dcl:angle=30,s=2", "random-lines", "coordinate-permutation"])
def test_keypoints_lie_on_the_candidates_of_their_rows(program, image, name, monkeypatch):
    folder, known = image
    monkeypatch.syspath_prepend(str(ROOT / "proto"))
    import read_sealed_query as reader

    out = folder / name.replace(":", "-")
    profile = ROOT / "crates/core/protocol/tests/data/sift.profile"
    # The camera is already canonical, so the image is not rectified.
    camera = "SIMPLE_PINHOLE,512,384,512,256,192"
    run(program, "seal", folder / "images", "--profile", profile, "-o", out, "--camera", camera, "--scheme", name)
    message = reader.fields(next(out.rglob("*.vquery")).read_bytes())
    assert message["angle_bits"] == schemes.ANGLE_BITS
    assert [32 * message["camera_width"], 32 * message["camera_height"]] == SIZE.tolist()
    widths = {"dcl": [1, 13], "random-lines": [12, 16], "coordinate-permutation": [16, 16]}[name.partition(":")[0]]
    codes = unpacked(message["positions"], widths, message["rows"])
    scheme = schemes.Scheme.parse(name)
    if scheme.kind == "dcl":
        rows = schemes.half_lines_of_rows(codes[:, 0] == 0, codes[:, 1], SIZE, scheme, 2 ** (message["camera_focal"] / 4))
    elif scheme.kind == "random-lines":
        rows = schemes.lines_of_rows(codes[:, 0], (codes[:, 1] - 32768) / 4, SIZE)
    else:
        rows = schemes.crosses_of_rows((codes - 32768) / 4, SIZE)
    # Rows are shuffled; the descriptor identifies the keypoint of a row.
    of = {bytes(row): i for i, row in enumerate(known.descriptors)}
    sent = np.frombuffer(message["descriptors"], np.uint8).reshape(message["rows"], -1)
    pairs = np.array([(row, of[bytes(d)]) for row, d in enumerate(sent) if bytes(d) in of])
    assert len(pairs) > 100
    keypoints, empty = known.keypoints[pairs[:, 1]], rows.empty()[pairs[:, 0]]
    origin, direction = rows.origin[pairs[:, 0]], rows.direction[pairs[:, 0]]
    near, far = (np.where(empty, 0, x[pairs[:, 0]]) for x in (rows.near, rows.far))
    t = np.clip(((keypoints[:, None] - origin) * direction).sum(-1), near, far)
    away = np.linalg.norm(origin + t[..., None] * direction - keypoints[:, None], axis=-1)
    away = np.where(empty, np.inf, away).min(axis=1)
    # Dither of half a pixel and rounding; a few decoys may have a keypoint's descriptor.
    assert np.quantile(away, 0.98) < 0.9, np.quantile(away, [0.5, 0.98, 1.0])


def unpacked(packed: bytes, widths: list[int], rows: int) -> np.ndarray:
    """Unpacks integers with these bit widths, most significant bit first. `[rows, len(widths)]`"""
    bits = np.unpackbits(np.frombuffer(packed, np.uint8))
    ends = np.cumsum([0, *widths * rows])
    values = [int("".join(map(str, bits[a:b])), 2) for a, b in zip(ends[:-1], ends[1:])]
    return np.array(values).reshape(rows, len(widths))
