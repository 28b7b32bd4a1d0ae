"""Which small form of a global descriptor keeps the right neighbours: signs after a rotation, or principal components.

Global descriptors (VLAD of 64 words, intra-normalized, 4096 numbers) of the map images of RedKitchen and Herz-Jesu and of
the images of elsewhere, made with NumPy of features that `veiloc features --out-hloc` writes; for each query the best ten
by all numbers are sought by the small forms. Prints the table of docs/decisions/0030.

    VEILOC_DATA=../shared/data python scripts/global_signs.py [PROGRAM]      # needs numpy, h5py
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import h5py
import numpy as np

DATA = Path(os.environ["VEILOC_DATA"])
PROGRAM = sys.argv[1] if len(sys.argv) > 1 else "target/release/veiloc"
WORDS = 64


def descriptors(folder, out):
    command = [PROGRAM, "features", "--max-keypoints", "2048", "--max-size", "1024", "-q", "--out-hloc", out, folder]
    subprocess.run(command, check=True)
    found = {}

    def visit(name, group):
        if isinstance(group, h5py.Group) and "descriptors" in group:
            found[name.split("/")[-1]] = group["descriptors"][()].astype(np.float32).T

    with h5py.File(out) as file:
        file.visititems(visit)
    return found


def listed(place, name, of):
    return [of[line.split()[0].split("/")[-1]] for line in (DATA / place / name).read_text().splitlines() if line.strip()]


def vocabulary(sample, rng):
    words = sample[rng.permutation(len(sample))[:WORDS]]
    for _ in range(12):
        nearest = (sample @ words.T - 0.5 * (words**2).sum(1)).argmax(1)
        words = np.stack([sample[nearest == k].mean(0) if (nearest == k).any() else words[k] for k in range(WORDS)])
    return words


def vlad(rows, words):
    nearest = (rows @ words.T - 0.5 * (words**2).sum(1)).argmax(1)
    sums = np.stack([(rows[nearest == k] - words[k]).sum(0) for k in range(WORDS)])
    length = np.linalg.norm(sums, axis=1, keepdims=True)
    unit = np.where(length > 0, sums / np.maximum(length, 1e-9), 0).ravel()
    return unit / np.linalg.norm(unit)


def hadamard(rows):
    half = 1
    while half < rows.shape[1]:
        pairs = rows.reshape(len(rows), -1, 2, half)
        rows = np.stack([pairs[:, :, 0] + pairs[:, :, 1], pairs[:, :, 0] - pairs[:, :, 1]], 2).reshape(len(rows), -1)
        half *= 2
    return rows / np.sqrt(half)


def best(scores, count):
    return np.argsort(-scores, axis=1, kind="stable")[:, :count]


def main():
    rng = np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as folder:
        kitchen = descriptors(str(DATA / "redkitchen/images"), f"{folder}/k.h5")
        church = descriptors(str(DATA / "herzjesu/images"), f"{folder}/h.h5")
        others = list(descriptors(str(DATA / "training-photos"), f"{folder}/o.h5").values())
    maps = listed("redkitchen", "map.txt", kitchen) + listed("herzjesu", "map.txt", church)
    asked = listed("redkitchen", "query.txt", kitchen) + listed("herzjesu", "query.txt", church)
    sample = np.concatenate([rows[rng.permutation(len(rows))[:500]] for rows in maps + others[:300]])
    words = vocabulary(sample, rng)
    images = np.stack([vlad(rows, words) for rows in maps + others])
    queries = np.stack([vlad(rows, words) for rows in asked])
    truth = best(queries @ images.T, 10)

    print("| form | bytes | of the best ten found | among the first 30 |")
    print("|---|--:|--:|--:|")

    def told(form, size, scores):
        ten, thirty = best(scores, 10), best(scores, 30)
        share = [np.mean([len(set(a) & set(b)) / 10 for a, b in zip(found, truth)]) for found in (ten, thirty)]
        print(f"| {form} | {size} | {100 * share[0]:.1f} % | {100 * share[1]:.1f} % |")

    numbers = images.shape[1]
    signs, order = rng.choice([-1, 1], numbers).astype(np.float32), rng.permutation(numbers)
    rotated, rotated_queries = hadamard((images * signs)[:, order]), hadamard((queries * signs)[:, order])
    for count in (4096, 2048, 1024, 512):
        told(f"signs of {count}", count // 8, rotated_queries[:, :count] @ np.sign(rotated[:, :count]).T)

    half = rng.permutation(len(images))[: len(images) // 2]
    for name, trained in (("all images", images), ("half of them", images[half]), ("the maps' images", images[: len(maps)])):
        mean = trained.mean(0)
        _, values, axes = np.linalg.svd(trained - mean, full_matrices=False)
        for count in (512, 256, 128, 64):
            if count > len(values):
                continue
            a, b = (images - mean) @ axes[:count].T, (queries - mean) @ axes[:count].T
            codes = np.round(a / np.abs(a).max(1, keepdims=True) * 127)
            told(f"components of {name}", count, b @ (codes / np.linalg.norm(codes, axis=1, keepdims=True)).T)


main()
