#!/usr/bin/env python3
"""Border bits: what a learner can tell from a sent descriptor about where its keypoint is (rule L11 of docs/reference/privacy-rules.md).

A descriptor whose patch reaches over the image's border may show the border. For each way to treat such keypoints
(`cut`, `sent`, `whole`: crates/device/obfuscation/examples/sent_rows.rs), out-of-map images are sealed as a device does.
A network learns on the rows of one half of the images, and is judged on the other half, chosen by a hash of their
names. It is given the 128 bytes of a row and sums, zeros and mirror symmetries of their cells. It answers in which of 17
zones of the sealed image the keypoint is: nearer to one of the four sides than 8, 16, 32 or 64 pixels, or farther in
than that. Each way has a network of its own: one learned on descriptors that were cut would look for the wrong things.

Border bits are the mean over judged rows of log2(q / p): q what the network gives to the row's true zone, p the share of
that zone among rows of images learned on, which takes an empty margin into account. A lower bound of the mutual
information of descriptor and zone, in bits a row; it holds whatever content tells of the zone, too. `band` are the bits
of the distance alone, without the side. Also the judged rows within 16 pixels of the border: their share and their bits
of the distance. `margin` is what everybody knows without a descriptor: the bits of p, of the distance, over keypoints
spread evenly. The standard error is over images. How sharp the answers are is chosen on a fifth of the images learned
on, so that a network that found nothing says nothing.

The same network then answers for images of mapped places at their own size (map lists only), p being the place's own
shares. With --keypoints the positions are written for `veiloc attack` too, whose guess shows what an empty margin gives.

    cargo build --release -p veiloc-obfuscation --example sent_rows
    python3 -m venv .venv && .venv/bin/pip install -r research/requirements.txt
    .venv/bin/python research/notes/border.py --sent-rows target/release/examples/sent_rows --data $VEILOC_DATA
"""

import argparse
import hashlib
import json
import subprocess
import tempfile
import warnings
from pathlib import Path

import numpy as np
from sklearn.exceptions import ConvergenceWarning
from sklearn.neural_network import MLPClassifier

BANDS = [8, 16, 32, 64]
ZONES = 4 * len(BANDS) + 1
INSIDE = ZONES - 1
PLACES = ["redkitchen", "herzjesu"]
WAYS = ["cut", "sent", "whole"]


class Rows:
    """Sent rows of many images: descriptors `[N, 128]`, positions `[N, 2]`, sizes `[N, 2]`, number of the image `[N]`."""

    def __init__(self, program, way, images, folder):
        outs = [Path(folder) / f"{i}.bin" for i in range(len(images))]
        pairs = [str(path) for pair in zip(images, outs) for path in pair]
        for at in range(0, len(pairs), 200):
            subprocess.run([program, way, *pairs[at : at + 200]], check=True)
        descriptors, pixels, sizes, image = [], [], [], []
        for i, out in enumerate(outs):
            data = out.read_bytes()
            n, width, height = np.frombuffer(data, "<u4", 3)
            pixels.append(np.frombuffer(data, "<f4", 2 * n, 12).reshape(n, 2))
            descriptors.append(np.frombuffer(data, np.uint8, 128 * n, 12 + 8 * n).reshape(n, 128))
            sizes.append(np.tile([width, height], (n, 1)))
            image.append(np.full(n, i))
            out.unlink()
        self.descriptors, self.pixels = np.concatenate(descriptors), np.concatenate(pixels)
        self.sizes, self.image = np.concatenate(sizes), np.concatenate(image)
        sides = np.concatenate([self.pixels, self.sizes - self.pixels], axis=1)
        band = np.digitize(sides.min(1), BANDS)
        self.zone = np.where(band < len(BANDS), 4 * band + sides.argmin(1), INSIDE)


def mirror_symmetry(descriptors):
    """Cosines of parts of a descriptor and the mirror images of other parts, `[N, 36]`: a mirrored border shows in them."""
    cells = descriptors.reshape(-1, 4, 4, 8).astype(np.float32)
    k = np.arange(8)
    # Turned over the horizontal axis, the vertical one, and the two diagonals.
    over = {name: cells[..., (turn - k) % 8] for name, turn in [("h", 0), ("v", 4), ("d", 2), ("a", 6)]}
    found = []

    def compare(a, b):
        a, b = (part.reshape(len(cells), -1) for part in (a, b))
        found.append((a * b).sum(1) / np.sqrt((a * a).sum(1) * (b * b).sum(1) + 1e-3))

    for a, b in [(0, 1), (1, 2), (2, 3), (0, 3), ([0, 1], [3, 2]), (0, 0), (1, 1), (2, 2), (3, 3)]:
        compare(cells[:, a], over["h"][:, b])
        compare(cells[:, :, a], over["v"][:, :, b])
    compare(cells, over["d"].transpose(0, 2, 1, 3))
    compare(cells, over["a"].transpose(0, 2, 1, 3)[:, ::-1, ::-1])
    for a, b in [(0, 1), (1, 2), (2, 3), (0, 2), (1, 3)]:
        compare(cells[:, a, b], over["d"][:, b, a])
        compare(cells[:, 3 - a, b], over["a"][:, 3 - b, a])
    for y, x in [(0, 0), (3, 3)]:
        compare(cells[:, y, x], over["d"][:, y, x])
    for y, x in [(0, 3), (3, 0)]:
        compare(cells[:, y, x], over["a"][:, y, x])
    return np.stack(found, axis=1)


def inputs(descriptors):
    """What the network sees of a row."""
    parts = []
    for some in np.array_split(descriptors, len(descriptors) // 50_000 + 1):
        cells = some.reshape(-1, 16, 8).astype(np.float32)
        length = np.sqrt((cells**2).sum(2))
        square = length.reshape(-1, 4, 4)
        parts.append(np.concatenate([
            some.astype(np.float32), length, (cells == 0).sum(2), np.sort(length, axis=1)[:, :8],
            square.sum(1), square.sum(2), mirror_symmetry(some),
        ], axis=1, dtype=np.float32))
    return np.concatenate(parts)


def shares(zones):
    return (np.bincount(zones, minlength=ZONES) + 0.5) / (len(zones) + 0.5 * ZONES)


def tempered(answer, prior, sharpness):
    logs = sharpness * np.log(answer.clip(1e-9)) + (1 - sharpness) * np.log(prior)
    answer = np.exp(logs - logs.max(1, keepdims=True))
    return answer / answer.sum(1, keepdims=True)


def bits(answer, prior, zones):
    return np.log2(answer[np.arange(len(zones)), zones] / prior[zones])


def of_bands(x):
    """Shares of zones to shares of bands: the sides of each put together."""
    return np.concatenate([x[..., :INSIDE].reshape(*x.shape[:-1], -1, 4).sum(-1), x[..., INSIDE:]], axis=-1)


def even_bands(sizes):
    """Shares of the bands among positions spread evenly over images of these sizes, `[N, 5]`."""
    left = [np.prod((sizes - 2.0 * reach).clip(0), axis=1) for reach in [0, *BANDS]] + [np.zeros(len(sizes))]
    return (-np.diff(np.stack(left, axis=1), axis=1) / left[0][:, None]).clip(1e-9)


class Learner:
    def __init__(self, rows, learn, choose, epochs, seed):
        train, check = inputs(rows.descriptors[learn]), inputs(rows.descriptors[choose])
        self.mean, self.sd = train.mean(0), train.std(0) + 1e-6
        train, check = (train - self.mean) / self.sd, (check - self.mean) / self.sd
        self.prior = shares(rows.zone[learn | choose])
        rng = np.random.default_rng(seed)
        network = MLPClassifier((256, 128), batch_size=1024, alpha=1e-3, learning_rate_init=5e-4, random_state=seed)
        best, zones = -np.inf, rows.zone[learn]
        for _ in range(epochs):
            order = rng.permutation(len(train))
            network.partial_fit(train[order], zones[order], classes=np.arange(ZONES))
            answer = network.predict_proba(check)
            for sharpness in (0, 0.1, 0.2, 0.35, 0.5, 0.7, 0.85, 1):
                found = bits(tempered(answer, self.prior, sharpness), self.prior, rows.zone[choose]).mean()
                if found > best:
                    weights = [w.copy() for w in network.coefs_], [w.copy() for w in network.intercepts_]
                    best, self.sharpness, self.weights = found, sharpness, weights
        network.coefs_, network.intercepts_ = self.weights
        self.network = network

    def judge(self, rows, chosen, prior=None):
        """Bits of zone and band with their standard error, share and bits of the rows nearest to the border."""
        prior = self.prior if prior is None else prior
        own = (inputs(rows.descriptors[chosen]) - self.mean) / self.sd
        answer = tempered(self.network.predict_proba(own), self.prior, self.sharpness) * (prior / self.prior)
        answer /= answer.sum(1, keepdims=True)
        zones, image = rows.zone[chosen], rows.image[chosen]
        zone = bits(answer, prior, zones)
        band = bits(of_bands(answer), of_bands(prior), zones // 4)
        sums = np.array([band[image == i].sum() for i in np.unique(image)])
        error = sums.std() * np.sqrt(len(sums)) / len(band)
        near = zones < 8
        margin = np.log2(of_bands(prior) / even_bands(rows.sizes[chosen]))[np.arange(len(zones)), zones // 4].mean()
        return zone.mean(), band.mean(), error, near.mean(), band[near].mean() if near.any() else np.nan, margin


def write_keypoints(rows, chosen, path):
    with open(path, "w") as out:
        for i in np.unique(rows.image[chosen]):
            of = np.flatnonzero(rows.image == i)
            width, height = (int(side) for side in rows.sizes[of[0]])
            record = {"name": f"{i}", "width": width, "height": height, "keypoints": rows.pixels[of].tolist()}
            out.write(json.dumps(record) + "\n")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sent-rows", required=True, help="the program crates/device/obfuscation/examples/sent_rows.rs")
    parser.add_argument("--data", type=Path, required=True, help="the folder of the real images")
    parser.add_argument("--ways", default=",".join(WAYS))
    parser.add_argument("--every", type=int, default=1, help="every so manieth image only")
    parser.add_argument("--rows", type=float, default=0.4, help="share of an image's rows that is looked at")
    parser.add_argument("--epochs", type=int, default=7)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keypoints", type=Path, help="writes WAY.jsonl of the judged images into this folder")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore", ConvergenceWarning)

    root = arguments.data / "training-photos"
    images = sorted(p for p in root.rglob("*") if p.suffix.lower() in (".jpg", ".jpeg", ".png"))[:: arguments.every]
    digit = np.array([hashlib.sha256(str(p.relative_to(root)).encode()).digest()[0] % 10 for p in images])
    print("| images | keypoints at the border | rows an image | zone | band | ± | rows within 16 px | band bits of these | margin |")
    print("|---|---|--:|--:|--:|--:|--:|--:|--:|")

    def line(name, way, count, found):
        zone, band, error, near, near_bits, margin = found
        print(f"| {name} | {way} | {count:.0f} | {zone:.4f} | {band:.4f} | {error:.4f} | {100 * near:.1f} % "
              f"| {near_bits:+.3f} | {margin:.3f} |", flush=True)

    for way in arguments.ways.split(","):
        with tempfile.TemporaryDirectory() as folder:
            rows = Rows(arguments.sent_rows, way, images, folder)
            looked_at = np.random.default_rng(arguments.seed).random(len(rows.image)) < arguments.rows
            half = digit[rows.image]
            judged = looked_at & (half >= 5)
            learner = Learner(rows, looked_at & (half < 4), looked_at & (half == 4), arguments.epochs, arguments.seed)
            line("out of the map", way, len(rows.image) / len(images), learner.judge(rows, judged))
            if arguments.keypoints:
                write_keypoints(rows, half >= 5, arguments.keypoints / f"{way}.jsonl")
            for place in PLACES:
                names = (arguments.data / place / "map.txt").read_text().split()
                own = Rows(arguments.sent_rows, way, [arguments.data / place / "images" / n for n in names], folder)
                all_rows = np.ones(len(own.image), bool)
                line(place, way, len(own.image) / len(names), learner.judge(own, all_rows, shares(own.zone)))


if __name__ == "__main__":
    main()
