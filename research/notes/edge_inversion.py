#!/usr/bin/env python3
"""Photographs from their edge images: trains the network of `veiloc_train inversion` on edge images, and judges what it makes.

    edge_inversion.py prepare --photos $VEILOC_DATA/training-photos --out edges
    edge_inversion.py train edges -o out/edges --feature-network alex_shift_tolerant.pth --bf16 --batch 32 --rate 6e-4 --minutes 8
    edge_inversion.py make out/edges.pt edges/judged.txt --out made
    edge_inversion.py judge edges/judged.txt made --feature-network alex_shift_tolerant.pth \\
        --classifier efficientnet-lite0.onnx --detector yolo11n_int8.onnx --csv docs/results/privacy/edge-inversion.csv

- prepare: edges and small photographs of the training, and the list of the images that are judged: queries of places, and
  photographs that are held out, the last by the SHA-256 of their names.
- train: the U-Net of the descriptors' inversion, with an edge image in place of the grid of descriptors, and its loss.
- make: applies the network.
- judge: the metrics of `veiloc eval inversion`, for edge images as they are and for what the network makes of them.

Edge images are those of `study privacy edges`, of images scaled to 512 pixels. Needs OpenCV, and `judge` scikit-image and
ONNX Runtime.
"""

import argparse
import csv
import hashlib
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
import torch
from PIL import Image

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "research/train"), str(ROOT / "research")]

from study.common import names_of  # noqa: E402
from study.privacy import THRESHOLDS  # noqa: E402
from veiloc_train import loop  # noqa: E402
from veiloc_train.inversion import Loss, grid_size, window  # noqa: E402
from veiloc_train.models import inversion, parameters  # noqa: E402

LONGEST = 512
# Photographs need no more than the largest scale of a window.
PHOTO_LONGEST = 320
HELD_OUT, HELD_OUT_OBJECTS = 12, 64
# Queries that are judged, as `veiloc eval inversion --limit` chooses them.
PLACES = {"redkitchen": 10, "herzjesu": 3, "llff-room": 10}
LABELS = {"photos": "held-out photographs", "objects": "held-out photographs of objects", "redkitchen": "RedKitchen",
          "herzjesu": "Herz-Jesu", "llff-room": "llff-room"}  # fmt: skip
SYNSETS = ROOT / "crates/research/attacks/src/image_metrics/synsets.txt"


def scaled(image, longest, method=cv2.INTER_AREA):
    share = min(longest / max(image.shape[:2]), 1.0)
    return cv2.resize(image, [max(1, round(side * share)) for side in image.shape[1::-1]], interpolation=method)


def canny(image):
    """255 on edges."""
    return cv2.Canny(scaled(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), LONGEST), *THRESHOLDS)


def edge_image(found):
    return cv2.GaussianBlur(255 - found, (0, 0), 1.0)


def held_out(names):
    """The last photographs, and the last objects that are not among them, by the SHA-256 of their names."""
    ordered = sorted(names, key=lambda name: hashlib.sha256(name.encode()).hexdigest())
    last = ordered[-HELD_OUT:]
    objects = [name for name in ordered if name.startswith("objects/") and name not in last]
    return last, objects[-HELD_OUT_OBJECTS:]


def evenly(names, most):
    return [names[i * len(names) // most] for i in range(min(most, len(names)))]


def write_small(folder, out, name):
    """Edges and a small version of a photograph."""
    image = cv2.imread(str(folder / name))
    for kind, content, suffix in (("photos", scaled(image, PHOTO_LONGEST), ".webp"), ("edges", canny(image), ".png")):
        path = (out / kind / name).with_suffix(suffix)
        path.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(path), content)


def prepare(args):
    names = sorted(str(path.relative_to(args.photos)) for path in args.photos.rglob("*.jpg"))
    last, objects = held_out(names)
    training = [name for name in names if name not in last and name not in objects]
    with ThreadPoolExecutor(args.threads) as pool:
        list(pool.map(lambda name: write_small(args.photos, args.out, name), training))
    (args.out / "training.txt").write_text("".join(f"{name}\n" for name in training))
    parts = (("photos", last), ("objects", objects))
    lines = [f"{kind}\t{(args.photos / name).resolve()}\n" for kind, own in parts for name in own]
    for place, most in PLACES.items():
        folder = args.photos.parent / place
        chosen = evenly(names_of(folder / "query.txt"), most)
        lines += [f"{place}\t{(folder / 'images' / name).resolve()}\n" for name in chosen]
    (args.out / "judged.txt").write_text("".join(lines))


class Windows:
    """Windows of the training images; pixels are on the device."""

    def __init__(self, folder, names, args, multiple):
        self.args = args
        self.window = round(args.side * 2 / 3 / multiple) * multiple
        with ThreadPoolExecutor() as pool:
            self.edges, self.photos = zip(*pool.map(lambda name: of_name(folder, name), names))
        self.sizes = [(edges.shape[2], edges.shape[1]) for edges in self.edges]

    def load(self):
        self.edges, self.photos = ([x.to(self.args.device) for x in part] for part in (self.edges, self.photos))

    def one(self, rng):
        side, number = self.window, int(rng.integers(len(self.sizes)))
        size = np.array(self.sizes[number])
        # A random scale around that of the whole image on the grid, so that a window fits.
        scale = max(self.args.side / size.max() * self.args.zoom ** rng.uniform(-1.0, 1.0), side / size.min())
        corner = rng.random(2) * (size - side / scale)
        box = np.concatenate([corner / size, (corner + side / scale) / size])
        return number, box[[2, 1, 0, 3]] if rng.random() < 0.5 else box

    def batch(self, rng):
        return [self.one(rng) for _ in range(self.args.batch)]

    def on_device(self, drawn):
        of = lambda images: torch.cat([window(images[number], box, self.window) for number, box in drawn])
        return 1.0 - of(self.edges), of(self.photos)


def of_name(folder, name):
    edges = edge_image(cv2.imread(str(folder / "edges" / name) + ".png", cv2.IMREAD_GRAYSCALE))
    photo = cv2.cvtColor(cv2.imread(str(folder / "photos" / name) + ".webp"), cv2.COLOR_BGR2RGB)
    return torch.from_numpy(edges)[None], torch.from_numpy(photo).permute(2, 0, 1).contiguous()


def on_grid(image, side, multiple):
    """An image on the network's grid, by area."""
    return cv2.resize(image, grid_size(image.shape[1], image.shape[0], side, multiple), interpolation=cv2.INTER_AREA)


def network_input(edges, side, multiple):
    return 1.0 - torch.from_numpy(on_grid(edges, side, multiple))[None, None].float() / 255.0


def train(args):
    loop.setup(args)
    cv2.setNumThreads(1)
    multiple = 1 << (args.levels - 1)
    folder = args.prepared
    names = sorted(str(path.relative_to(folder / "edges").with_suffix("")) for path in (folder / "edges").rglob("*.png"))
    order = np.random.default_rng(0).permutation(len(names))
    count = min(args.validation, len(names) // 2)
    held, own = ([names[i] for i in part] for part in (order[:count], order[count:][: args.images]))
    network = inversion("unet", 0, args.width, args.levels).to(args.device, memory_format=torch.channels_last)
    windows = Windows(folder, own, args, multiple)
    windows.load()
    whole = []
    for edges, photo in (of_name(folder, name) for name in held):
        grid = network_input(edges[0].numpy(), args.side, multiple)
        photo = cv2.resize(photo.permute(1, 2, 0).numpy(), grid.shape[:1:-1], interpolation=cv2.INTER_AREA)
        whole.append((grid.to(args.device), torch.from_numpy(photo).permute(2, 0, 1)[None].float().to(args.device) / 255.0))
    loss = Loss(network, args)
    print(f"{parameters(network)} parameters, {len(own)} + {len(held)} images, windows of {windows.window}")

    def half_precision():
        return torch.autocast(torch.device(args.device).type, torch.bfloat16, enabled=args.bf16)

    def loss_of(drawn):
        grid, photo = windows.on_device(drawn)
        with half_precision():
            return loss(grid, None, photo)

    def validate():
        losses, decibels = [], []
        for grid, photo in whole:
            with half_precision():
                losses.append(loss(grid, None, photo).item())
                made = network(grid).float()
            decibels.append(-10.0 * torch.log10((made - photo).square().mean()).item())
        return {"validation_loss": float(np.mean(losses)), "psnr": float(np.mean(decibels))}

    trained = loop.train(loop.Task(network, windows.batch, loss_of, validate), args)
    saved = {"network": trained.to("cpu").state_dict(), "width": args.width, "levels": args.levels, "side": args.side}
    torch.save(saved, args.out.with_suffix(".pt"))


def judged(path):
    """Kind, file and name of the output."""
    for line in path.read_text().splitlines():
        kind, file = line.split("\t")
        yield kind, Path(file), f"{kind}/{Path(file).stem}.png"


def make(args):
    saved = torch.load(args.network, map_location="cpu", weights_only=True)
    network = inversion("unet", 0, saved["width"], saved["levels"])
    network.load_state_dict(saved["network"])
    network.eval()
    multiple = 1 << (saved["levels"] - 1)
    for _, file, name in judged(args.list):
        grid = network_input(edge_image(canny(cv2.imread(str(file)))), saved["side"], multiple)
        with torch.no_grad():
            made = network(grid)[0].permute(1, 2, 0).numpy()
        path = args.out / name
        path.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(path), cv2.cvtColor((255 * made).round().astype(np.uint8), cv2.COLOR_RGB2BGR))


class Judge:
    """The metrics of `veiloc eval inversion` (crates/research/evaluation/src/attack_evaluation/inversion)."""

    CROP, CLASSIFIED = 0.875, 224

    def __init__(self, args):
        import ast

        import onnxruntime
        from veiloc_train.perceptual import StLpips

        self.perceptual = StLpips.of_file(args.feature_network)
        session = lambda path: onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
        self.classifier, self.detector = session(args.classifier), session(args.detector)
        self.synsets = SYNSETS.read_text().split()
        self.names = ast.literal_eval(self.detector.get_modelmeta().custom_metadata_map["names"])
        self.least = args.min_score

    def similarity(self, original, made):
        from skimage.metrics import peak_signal_noise_ratio, structural_similarity

        tensor = lambda image: torch.from_numpy(image).permute(2, 0, 1)[None].float() / 255.0
        with torch.no_grad():
            distance = self.perceptual(tensor(original), tensor(made)).item()
        ssim = structural_similarity(original, made, data_range=255, channel_axis=2, gaussian_weights=True, sigma=1.5,
                                     use_sample_covariance=False)  # fmt: skip
        return peak_signal_noise_ratio(original, made, data_range=255), ssim, distance

    def classes(self, image):
        """The five likeliest classes."""
        square = self.CROP * min(image.shape[:2])
        left, upper = ((side - square) / 2 for side in image.shape[1::-1])
        box = (left, upper, left + square, upper + square)
        crop = Image.fromarray(image).resize((self.CLASSIFIED, self.CLASSIFIED), Image.Resampling.BILINEAR, box=box)
        values = (np.asarray(crop, np.float32).transpose(2, 0, 1)[None] - 127.0) / 128.0
        return list(np.argsort(-self.classifier.run(None, {"image": values})[0][0], kind="stable")[:5])

    def objects(self, image):
        """Class and corners of each object."""
        height, width = self.detector.get_inputs()[0].shape[2:]
        scale = min(width / image.shape[1], height / image.shape[0])
        inner = [round(side * scale) for side in image.shape[1::-1]]
        left, upper = (width - inner[0]) // 2, (height - inner[1]) // 2
        box = np.full((height, width, 3), 114, np.uint8)
        box[upper : upper + inner[1], left : left + inner[0]] = cv2.resize(image, inner, interpolation=cv2.INTER_LINEAR)
        values = (box.astype(np.float32) / 255.0).transpose(2, 0, 1)[None]
        table = self.detector.run(None, {self.detector.get_inputs()[0].name: values})[0][0]
        scores = table[4:].max(axis=0)
        found = []
        for i in np.argsort(-scores):
            if scores[i] < self.least:
                break
            x, y, w, h = table[:4, i]
            corners = np.array([x - w / 2 - left, y - h / 2 - upper, x + w / 2 - left, y + h / 2 - upper]) / scale
            own = (int(table[4:, i].argmax()), corners)
            if not any(own[0] == kind and overlap(own[1], box_of) > 0.5 for kind, box_of in found):
                found.append(own)
        return found

    def class_of(self, file, original):
        """The class in the name of the file, or else the classifier's answer for the original."""
        synset = file.name[:9]
        return self.synsets.index(synset) if synset in self.synsets else self.classes(original)[0]


def overlap(a, b):
    side = lambda low, high: max(high - low, 0.0)
    shared = side(max(a[0], b[0]), min(a[2], b[2])) * side(max(a[1], b[1]), min(a[3], b[3]))
    every = sum(side(c[0], c[2]) * side(c[1], c[3]) for c in (a, b)) - shared
    return shared / every if every > 0.0 else 0.0


def found_again(objects, seen):
    """Objects of the original that are detected again: same class, boxes that overlap by half; each detection counts once."""
    left, count = list(seen), 0
    for kind, corners in objects:
        best = max(left, key=lambda other: overlap(corners, other[1]) if other[0] == kind else 0.0, default=None)
        if best is not None and best[0] == kind and overlap(corners, best[1]) >= 0.5:
            left.remove(best)
            count += 1
    return count


def judge(args):
    judge, rows = Judge(args), {}
    for kind, file, name in judged(args.list):
        image = cv2.imread(str(file))
        made = cv2.cvtColor(cv2.imread(str(args.made / name)), cv2.COLOR_BGR2RGB)
        size = made.shape[1::-1]
        shrunk = lambda x: cv2.resize(x, size, interpolation=cv2.INTER_AREA)
        original = shrunk(cv2.cvtColor(image, cv2.COLOR_BGR2RGB))
        edges = cv2.cvtColor(shrunk(edge_image(canny(image))), cv2.COLOR_GRAY2RGB)
        label, objects = judge.class_of(file, original), judge.objects(original)
        for what, shown in (("photographs", original), ("edge images", edges), ("inverted edge images", made)):
            likeliest = judge.classes(shown)
            similarity = judge.similarity(original, shown) if what != "photographs" else (np.nan,) * 3
            again = found_again(objects, judge.objects(shown))
            rows.setdefault((kind, what), []).append((*similarity, likeliest[0] == label, label in likeliest, len(objects), again))
    columns = ["images", "shown", "number", "PSNR (dB)", "SSIM", "ST-LPIPS", "top 1", "top 5", "objects", "objects found again"]
    table = []
    for (kind, what), own in rows.items():
        psnr, ssim, distance = np.mean([row[:3] for row in own], axis=0)
        metrics = ["", "", ""] if what == "photographs" else [f"{psnr:.2f}", f"{ssim:.3f}", f"{distance:.3f}"]
        table.append([LABELS[kind], what, len(own), *metrics, *(int(sum(row[i] for row in own)) for i in range(3, 7))])
        print(*table[-1], sep="  ")
    if args.csv:
        with args.csv.open("w", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows([columns, *table])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True)
    command = commands.add_parser("prepare")
    command.add_argument("--photos", type=Path, required=True)
    command.add_argument("--out", type=Path, required=True)
    command.add_argument("--threads", type=int)
    command.set_defaults(run=prepare)
    command = commands.add_parser("train")
    command.add_argument("prepared", type=Path)
    loop.add_arguments(command, steps=100_000, batch=8, rate=3e-4, of_keypoints=False)
    command.add_argument("--width", type=int, default=64)
    command.add_argument("--levels", type=int, default=5)
    command.add_argument("--side", type=int, default=256)
    command.add_argument("--zoom", type=float, default=1.25)
    command.add_argument("--feature-network", type=Path)
    command.add_argument("--feature-weight", type=float, default=1.0)
    command.add_argument("--bf16", action="store_true")
    command.set_defaults(run=train, form="unet")
    command = commands.add_parser("make")
    command.add_argument("network", type=Path)
    command.add_argument("list", type=Path)
    command.add_argument("--out", type=Path, required=True)
    command.set_defaults(run=make)
    command = commands.add_parser("judge")
    command.add_argument("list", type=Path)
    command.add_argument("made", type=Path)
    command.add_argument("--feature-network", type=Path, required=True)
    command.add_argument("--classifier", type=Path, required=True)
    command.add_argument("--detector", type=Path, required=True)
    command.add_argument("--min-score", type=float, default=0.25)
    command.add_argument("--csv", type=Path)
    command.set_defaults(run=judge)
    args = parser.parse_args()
    args.run(args)


if __name__ == "__main__":
    main()
