"""Tables of docs/results/packs.md: what each adversary gets of a query with a pack, and without one."""

from __future__ import annotations

import argparse
import base64
import hashlib
import importlib
import itertools
import json
import math
import random
import statistics
import subprocess
import sys
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from study.common import ROOT, Package, child_seconds, command, names_of, percent
from study.geometry import center, rotation
from study.packs import (BACKGROUND, PICTURES, USES, columns_of, fields_of, looked_up, nearest, numbers, pack_of, packed, pasted_pictures,
                         rows_of_image, with_pack)  # fmt: skip
from study.private_rows import by_attack, places_of, read_lines, write_lines
from study.privacy import photos

PAGE = "packs"
np, Image, ndimage = Package("numpy"), Package("PIL.Image"), Package("scipy.ndimage")
THREE = {"places": ["redkitchen", "herzjesu", "hololens-office"], "queries": (6, "attacked queries of each place, evenly spaced")}
SEALS, FRAMES = "8", "4"
STATISTIC, OF_MAP, SHOWN = "closed-form-consensus", "server-side-points,iterative", "transfer,closed-form-consensus,transfer-graph"
# Adversary: attacks, source of neighbours, whether it has the pose, whether it has the map's images.
ADVERSARIES = {
    "the line alone": ("prior", [], False, False),
    "a statistic of other places": (STATISTIC, ["predicted", "photos"], False, False),
    "images from nearby viewpoints, and neighbours there": (SHOWN, ["transferred"], False, True),
    "the pose; on keypoints that it does not know": (OF_MAP, ["predicted", "map"], True, False),
    "the pose and its map images; the same": ("guided-transfer", [], True, True),
    f"the pose of {FRAMES} images without a session; the same": ("several-frames", [], True, False),
    "eight seals of one image": ("static-camera", [], False, False),
}


@command("packs/adversaries.csv", **THREE)
def adversaries(run):
    """Adversaries under dcl by what is sent; a match query has the descriptors that the pack has of its points. Decoys are left out, as if
    the attacker knew them."""
    of_use = ("keypoints an image", "prior (px)", "attack (px)", "bits", "< 10 px, keypoints an image", "best attack")
    table = run.table("packs/adversaries.csv", "place", "knows", *(f"{sent}: {column}" for sent in USES for column in of_use))
    train = photos(run, "first")
    for place in places_of(run):
        chosen, attacked = place.chosen(2048), place.work / "attacked.jsonl.gz"
        for knows, (attacks, neighbours, has_pose, has_map) in ADVERSARIES.items():
            write_lines(attacked, chosen + (place.map if has_map else []))
            options = ["--neighbours", neighbours[0]] if neighbours else []
            options += ["--train", train if neighbours[1] == "photos" else place.map_keypoints] if len(neighbours) > 1 else []
            options += ["--server-matches", place.sent_problems(2048)] if has_pose else []
            cells, of_map = [], []
            for use in USES.values():
                document = run.json("attack", attacked, "--limit", len(chosen), "--schemes", "dcl", "--attacks", attacks, *options,
                                    *with_pack(run, place.name, use), "--frames", SEALS if attacks == "static-camera" else FRAMES)  # fmt: skip
                found = by_attack(document)["dcl"]
                prior = found["prior"]
                name, best = max(((n, row) for n, row in found.items() if n != "prior" or attacks == "prior"), key=lambda at: at[1]["bits_over_prior"])
                rows = best["keypoints"] / max(1, best["images"])
                cells += [f"{rows:.0f}", f"{prior['median_px']:.0f}", f"{best['median_px']:.0f}", f"{best['bits_over_prior']:.2f}",
                          f"{rows * best['under_10px']:.0f}", name]  # fmt: skip
                for server in document.get("server", []):
                    known = rows / server["measured"] * server["known"]
                    of_map += [f"{known:.0f}", "", f"{server['known_median_px']:.1f}", "", f"{known * server['known_under_10px']:.0f}", "projection"]
            table.add([place.name, knows, *cells])
            if of_map and has_map:
                table.add([place.name, "the pose; on keypoints that its map knows", *of_map])


@command("packs/sessions.csv", places=["redkitchen"], attacked=(3, "attacked images of each place"))
def sessions(run):
    """Several images of one device: positions of keypoints of the map, withheld from the attacker. Rows of match queries are matched by points."""
    table = run.table("packs/sessions.csv", "place", "sent", "anchors fixed in", "motion", "keypoints an image",
                      *(f"{n} images: {what}" for n in (2, 8) for what in ("prior (px)", "attack (px)", "bits", "< 10 px (%)")))  # fmt: skip
    for place in run.places:
        for sent, use in USES.items():
            rows = run.document("eval", "sessions", *run.scene(place), "--schemes", "dcl", "--anchors", "image,world", "--gyro-deg", 0, "--motion",
                                "turning,walking", "--frames", "2,8", "--max-attacked", run.attacked,
                                *([] if use == "none" else ["--send", use.removeprefix("pack:")]))["rows"]  # fmt: skip
            rows = [row for row in rows if row["target"] == "matched" and row["keypoints"]]
            for anchors, motion in dict.fromkeys((row["anchors"], row["motion"]) for row in rows):
                of = {row["frames"]: row for row in rows if (row["anchors"], row["motion"]) == (anchors, motion)}
                cells = [f"{of[2]['keypoints'] / of[2]['images']:.0f}"]
                for n in (2, 8):
                    row = of[n]
                    cells += [f"{row['prior_median_px']:.0f}", f"{row['median_px']:.1f}", f"{row['bits_over_prior']:.2f}", f"{100 * row['under_10px']:.0f}"]
                table.add([place, sent, anchors, motion, *cells])


@command("packs/lying.csv", places=THREE["places"], **PICTURES)
def lying(run):
    """A pack that also has the descriptors of a known picture, in each of its images: whether the picture is in view."""
    table = run.table("packs/lying.csv", "place", "pictures", "pack (kB)", "lying pack (kB)", "matches with the picture in view, median",
                      "matches with another picture in view, median", "most", "named (matches above the most without it)")  # fmt: skip
    for shown in pasted_pictures(run):
        pack = packed(run, shown.place)
        present, absent, sizes = [], [], []
        for k, (image, (number, _)) in enumerate(zip(shown.images, shown.truth)):
            forged = shown.folder / "lying.vpack"
            points = forge(pack, shown.known[number], forged)
            sizes.append(forged.stat().st_size)
            other = next(shown.images[j % len(shown.images)] for j in itertools.count(k + 1) if shown.truth[j % len(shown.truth)][0] != number)
            two = {image["name"]: image, f"other {other['name']}": other | {"name": f"other {other['name']}"}}
            counts = [sum(match is not None and match[0] >= points and explained for match, explained in zip(answer["matches"], answer["explained"]))
                      for _, answer in looked_up(run, forged, shown.folder / "lying.jsonl.gz", two)]  # fmt: skip
            present.append(counts[0])
            absent.append(counts[1])
        table.add([shown.place, len(present), f"{pack.stat().st_size / 1024:.0f}", f"{statistics.median(sizes) / 1024:.0f}", f"{statistics.median(present):.0f}",
                   f"{statistics.median(absent):.0f}", max(absent), sum(count > max(absent) for count in present)])  # fmt: skip


def forge(pack: Path, picture: dict, into: Path) -> int:
    """Writes the pack with the rows of a picture as new points in each image; the number of points before."""
    fields = fields_of(pack)
    points, counts, old = fields[3], np.frombuffer(fields[4], "<u4"), pack_of(pack)["of rows"]
    codes = np.frombuffer(base64.b64decode(picture["descriptors"]), np.uint8).reshape(-1, 64) >> 4
    added, bits = (codes[:, 0::2] | codes[:, 1::2] << 4), max(1, int(points + len(codes) - 1).bit_length())
    of_rows, rows, ends = [], [], np.cumsum(counts)
    for start, end in zip(ends - counts, ends):
        of_rows += [old[start:end], np.arange(points, points + len(codes))]
        rows += [np.frombuffer(fields[6], np.uint8).reshape(-1, 32)[start:end], added]
    of_rows = np.concatenate(of_rows)
    packed_bits = np.packbits((of_rows[:, None] >> np.arange(bits)[::-1] & 1).astype(np.uint8))
    body = b"".join([field(1, 1), field(2, fields[2]), field(3, points + len(codes)), field(4, (counts + len(codes)).astype("<u4").tobytes()),
                     field(5, packed_bits.tobytes()), field(6, np.concatenate(rows).tobytes())])  # fmt: skip
    into.write_bytes(body + field(7, hashlib.sha256(body).digest()[:16]))
    return points


def field(number: int, value) -> bytes:
    """A field of a message: fixed32 of a number, otherwise bytes."""
    if isinstance(value, int):
        return bytes([number << 3 | 5]) + value.to_bytes(4, "little")
    size, length = len(value), b""
    while size >= 0x80:
        size, length = size >> 7, length + bytes([size & 0x7F | 0x80])
    return bytes([number << 3 | 2]) + length + bytes([size]) + value


# Shares of an image that show something else, from its left side.
COVERED = (0.0, 0.25, 0.5, 0.75)
# Fields of a sealed query that belong to its rows: their number, positions, descriptors, global descriptor, candidates.
OF_ROWS = (10, 15, 16, 17, 26)


@dataclass
class SentImage:
    """An image of which a part is covered, as it is sent; `fields` is None where it is not sealed."""

    covered: float
    #: Keypoints, and what the pack says of them.
    image: dict
    answer: dict
    fields: dict | None


def covered_images(run, place: str, use: str) -> list[SentImage]:
    """Queries of a place, of which a share is covered by photographs of elsewhere, sealed with this use of the pack."""
    folder, names, draw = run.kept() / "covered" / place, names_of(run.place(place) / "query.txt"), random.Random(8)
    names = [names[i * len(names) // run.queries] for i in range(min(run.queries, len(names)))] if len(names) > run.queries else names
    photos = sorted(run.place("training-photos").glob("*/*.jpg"))
    (folder / "images").mkdir(parents=True, exist_ok=True)
    for number, name in enumerate(names):
        for covered, photo in zip(COVERED, draw.sample(photos, len(COVERED))):
            with Image.open(run.place(place) / "images" / name) as file, Image.open(photo) as other:
                image, other = file.convert("RGB"), other.convert("RGB").resize(file.size, Image.LANCZOS)
            if covered:
                image.paste(other.crop((0, 0, int(covered * image.width), image.height)), (0, 0))
            image.save(folder / "images" / f"{number:02}-{covered}.png")
    keypoints = run.made(folder / "keypoints.jsonl.gz", "eval", "keypoints", folder / "images", "--max-keypoints", 4096)
    profile = run.made(run.kept() / f"{place}.vprofile", "map", "profile", run.map(place))
    out = folder / use.replace(":", "-")
    run.printed("seal", folder / "images", "--profile", profile, "--camera", "unknown", "-o", f"{out}/", *with_pack(run, place, use))
    files = {f"{file.stem}.png": file for file in out.glob("*.vquery")}
    return [SentImage(float(image["name"].split("-")[1].removesuffix(".png")), image, answer, fields_of(files[image["name"]]) if image["name"] in files else None)
            for image, answer in looked_up(run, packed(run, place), keypoints, {image["name"]: image for image in read_lines(keypoints)})]  # fmt: skip


@command("packs/counts.csv", **THREE | {"queries": 12})
def counts(run):
    """What the number of rows tells of the part of the view that is of the place; and what else queries of one place differ in."""
    table = run.table("packs/counts.csv", "place", "sent", "images", "not sealed", "classes (bits)", "classes tell of the covered share (bits of 2)",
                      "correlation of class and real rows", "correlation of class and covered share", "different heads beside the class")  # fmt: skip
    for place in run.places:
        for sent, use in USES.items():
            images = covered_images(run, place, use)
            size = lambda image: image.fields[10] if image.fields else 0
            pairs = [(size(image), image.covered) for image in images]
            sealed = [image for image in images if image.fields]
            heads = {tuple(sorted((key, value) for key, value in image.fields.items() if key not in OF_ROWS)) for image in sealed}
            real = [min(image.fields[10], len(image.answer["explained"])) if use == "none" else len(real_rows(image, use)) for image in sealed]
            correlation = lambda a, b: f"{np.corrcoef(a, b)[0, 1]:.2f}" if len(set(a)) > 1 and len(set(b)) > 1 else ""
            table.add([place, sent, len(images), len(images) - len(sealed), f"{entropy(size for size, _ in pairs):.2f}", f"{information(pairs):.2f}",
                       correlation([image.fields[10] for image in sealed], real), correlation(*zip(*pairs)), len(heads)])  # fmt: skip


def entropy(values) -> float:
    """Bits of the distribution of these values."""
    counted = Counter(values)
    return sum(n / counted.total() * math.log2(counted.total() / n) for n in counted.values())


def information(pairs) -> float:
    """Mutual information of pairs in bits, less what as many pairs of independent values would show in the mean."""
    a, b = zip(*pairs)
    shown = entropy(a) + entropy(b) - entropy(pairs)
    return max(0.0, shown - (len(set(a)) - 1) * (len(set(b)) - 1) / (2 * len(pairs) * math.log(2)))


def real_rows(sent: SentImage, use: str) -> set:
    """What real rows of a query have: their descriptors, or their points with the codes of their weights."""
    if use == "pack:matches":
        rows = zip(sent.answer["matches"], sent.answer["explained"])
        return {(match[0], code_of(match[1])) for match, explained in rows if match is not None and explained}
    codes = np.frombuffer(base64.b64decode(sent.image["descriptors"]), np.uint8).reshape(-1, 64) >> 4
    return {row.tobytes() for row in (codes[:, 0::2] | codes[:, 1::2] << 4)[np.array(sent.answer["explained"], bool)]}


def code_of(probability: float) -> int:
    """The code of a weight."""
    return int(min(15, max(1, round(2 * math.log(probability / (1 - probability))) + 8)))


@command("packs/decoys.csv", **THREE | {"queries": 12})
def decoys(run):
    """Decoys of the place among the rows of a query: a logistic regression, trained on every second image, tells real rows from them."""
    table = run.table("packs/decoys.csv", "place", "sent", "images", "rows", "decoys (%)", "AUC within an image", "AUC over images",
                      "correlation of the number of real rows")  # fmt: skip
    for place in run.places:
        pack = pack_of(packed(run, place))
        background = numbers(np.frombuffer(BACKGROUND.read_bytes(), np.uint8).reshape(-1, 32))
        for sent, use in list(USES.items())[1:]:
            images = [image for image in covered_images(run, place, use) if image.fields]
            inputs, real = [], []
            for image in images:
                known = real_rows(image, use)
                if use == "pack:matches":
                    candidates = candidates_of(image.fields)
                    real.append(np.array([row in known for row in candidates]))
                    inputs.append(of_candidates(np.array(candidates), pack))
                else:
                    codes = np.frombuffer(image.fields[16], np.uint8).reshape(-1, 32)
                    real.append(np.array([row.tobytes() in known for row in codes]))
                    inputs.append(of_descriptors(numbers(codes), pack, background))
            # An image without decoys has none to tell.
            kept = [i for i, rows in enumerate(real) if 0 < rows.sum() < len(rows)]
            inputs, real = [inputs[i] for i in kept], [real[i] for i in kept]
            judged = logistic(inputs[0::2], real[0::2], inputs[1::2])
            truth = real[1::2]
            within = statistics.mean(auc(*pair) for pair in zip(judged, truth))
            share = np.corrcoef([rows.mean() for rows in judged], [rows.mean() for rows in truth])[0, 1]
            table.add([place, sent, len(real), sum(map(len, real)), percent(1 - np.concatenate(real).mean()), f"{within:.2f}",
                       f"{auc(np.concatenate(judged), np.concatenate(truth)):.2f}", f"{share:.2f}"])  # fmt: skip


def candidates_of(fields: dict) -> list:
    """Point and code of the weight of each row of a match query."""
    width = max(1, (fields[25] - 1).bit_length())
    bits = np.unpackbits(np.frombuffer(fields[26], np.uint8))[: (width + 4) * fields[10]].reshape(fields[10], width + 4)
    return [(int(point), int(code)) for point, code in zip(bits[:, :width] @ (1 << np.arange(width)[::-1]), bits[:, width:] @ (8, 4, 2, 1))]


def of_candidates(candidates, pack: dict):
    """Numbers of each row of a match query: weight, images that see its point, other rows of the point, and how many of its images see
    points of many rows."""
    points, codes = candidates.T
    images = np.repeat(np.arange(len(pack["images"])), pack["images"])
    sees = np.zeros((len(pack["images"]), pack["points"]), bool)
    sees[images, pack["of rows"]] = True
    named = sees[:, points]
    support = named @ codes / codes.sum()
    return np.stack([codes, named.sum(0), np.bincount(points, minlength=pack["points"])[points], (named * support[:, None]).max(0), named.T @ support], 1)


def of_descriptors(rows, pack: dict, background):
    """Numbers of each described row: its length, its distances to the place, to the background and to the nearest other row, and its
    energies in groups of principal components of the query."""
    there, elsewhere = nearest(rows, pack["rows"]), nearest(rows, background)
    squares = (rows**2).sum(1)
    between = np.maximum(squares[:, None] + squares - 2 * rows @ rows.T, 0)
    np.fill_diagonal(between, np.inf)
    centred = rows - rows.mean(0)
    parts = centred @ np.linalg.eigh(centred.T @ centred)[1]
    energies = np.log1p((parts**2).reshape(len(rows), -1, 8).sum(2))
    return np.column_stack([np.sqrt(squares), there, elsewhere, there / elsewhere, np.sqrt(between.min(1)), energies])


def logistic(inputs: list, real: list, judged: list) -> list:
    """Probabilities that rows are real, by a logistic regression of numbers and their squares, scaled within each image."""
    scaled = [(rows - rows.mean(0)) / (rows.std(0) + 1e-9) for rows in [*inputs, *judged]]
    with_squares = [np.column_stack([np.ones(len(rows)), rows, np.minimum(rows**2, 9)]) for rows in scaled]
    x, y = np.concatenate(with_squares[: len(inputs)]), np.concatenate(real)
    weights = np.zeros(x.shape[1])
    for _ in range(20):
        found = 1 / (1 + np.exp(-x @ weights))
        slope = x.T @ (y - found) - weights
        weights += np.linalg.solve(x.T * (found * (1 - found)) @ x + np.eye(len(weights)), slope)
    return [1 / (1 + np.exp(-rows @ weights)) for rows in with_squares[len(inputs) :]]


def auc(scores, real) -> float:
    """How often a real row has a higher score than a decoy; ties count half."""
    ranks = np.unique(scores, return_inverse=True, return_counts=True)
    middle = (np.cumsum(ranks[2]) - (ranks[2] - 1) / 2)[ranks[1]]
    count = real.sum()
    return float((middle[real].sum() - count * (count + 1) / 2) / (count * (len(real) - count)))


PHONES = ROOT / "scripts/phones"


@command("packs/times.csv", needs="qemu-user, gcc-aarch64-linux-gnu and the target aarch64-unknown-linux-gnu", **THREE | {"queries": 4},
         built=("", "folder with seal_frame and seal_frame-aarch64 instead of building them"))  # fmt: skip
def times(run):
    """Filter and matching on a device: what a seal of matches costs beyond a seal of all descriptors. Processor time of one thread on one core,
    medians; instructions on aarch64 are counted under qemu, for the first query. Build profile `phone`."""
    sys.path.append(str(PHONES))
    measure = importlib.import_module("measure")
    target = run.kept() / "measure"
    target.mkdir(exist_ok=True)
    plugin = target / "instructions.so"
    measure.run("gcc", "-shared", "-fPIC", "-O2", PHONES / "instructions.c", "-o", plugin)
    names = ("seal_frame", "seal_frame-aarch64")
    program, on_arm = [Path(run.built) / name for name in names] if run.built else [measure.example(target), measure.example(target, measure.ARM)]
    table = run.table("packs/times.csv", "place", "frames", "rows of the pack", "prepare the pack (ms)",
                      *(f"{what} ({unit})" for unit in ("ms", "million instructions, aarch64") for what in ("all descriptors", "matches", "filter and matching")))  # fmt: skip
    for place in run.places:
        listed, pack = names_of(run.place(place) / "query.txt"), packed(run, place)
        profile = run.made(run.kept() / f"{place}.vprofile", "map", "profile", run.map(place))
        ms, instructions, prepared = [], [], []
        for i in range(run.queries):
            frame = target / f"{place}-{i}.pgm"
            with Image.open(run.place(place) / "images" / listed[i * len(listed) // run.queries]) as file:
                file.convert("L").save(frame)
            seal = lambda published, times: ["taskset", "-c", "0", program, frame, published, times]
            if subprocess.run(list(map(str, seal(pack, 1))), capture_output=True).returncode:
                continue  # It does not show the place.
            ms.append([250 * (child_seconds(seal(published, 5)) - child_seconds(seal(published, 1))) for published in (profile, pack)])
            given = [argparse.Namespace(frame=frame, profile=published) for published in (profile, pack)]
            prepared.append(float(measure.sealed(program, given[1], 1, 1)[0]["preparation_milliseconds"]))
            instructions = instructions or [measure.counted(on_arm, of, plugin)[0]["total"] / 1e6 for of in given]
        of_all, of_matches = np.median(ms, 0)
        table.add([place, len(ms), len(pack_of(pack)["of rows"]), f"{min(prepared):.0f}", f"{of_all:.0f}", f"{of_matches:.0f}", f"{of_matches - of_all:.0f}",
                   *(f"{n:.0f}" for n in (*instructions, instructions[1] - instructions[0]))])  # fmt: skip


@command("packs/inversion.csv", needs="PyTorch and a network (--network)", **THREE | {"places": ["redkitchen", "herzjesu"]},
         network=("", "checkpoint of `veiloc_train inversion`"), width=16, levels=4, side=128, show=("", "folder for pictures"))  # fmt: skip
def inversion(run):
    """What an inversion network makes of descriptors: of the image's own, of the pack at random positions, and of a match query, whose descriptors
    are those that the pack has of its points; compared with the user's image, and with the map image of the nearest pose."""
    sys.path.append(str(ROOT / "research/train"))
    torch, tools = importlib.import_module("torch"), importlib.import_module("veiloc_train.inversion")
    torch.set_num_threads(1)
    network = importlib.import_module("veiloc_train.models").inversion("unet", 64, run.width, run.levels)
    network.load_state_dict(torch.load(run.network, map_location="cpu", weights_only=False)["state"]["weights"])
    network.eval()
    table = run.table("packs/inversion.csv", "place", "shown", "images", "keypoints", "PSNR to the user's image (dB)", "SSIM to the user's image",
                      "PSNR to the nearest map image (dB)", "SSIM to the nearest map image")  # fmt: skip
    for place in places_of(run):
        pack, draw = pack_of(packed(run, place.name)), np.random.default_rng(3)
        chosen, scores = {image["name"]: image for image in place.chosen(2048)}, {}
        problems = {problem["name"]: problem for problem in map(json.loads, place.problems.open())}
        for image, answer in looked_up(run, packed(run, place.name), place.work / "keypoints.jsonl.gz", chosen):
            size = (image["width"], image["height"])
            grid = tools.grid_size(*size, run.side, 1 << (run.levels - 1))
            photo = lambda name: photograph(run, place.name, name, size, grid)
            user, near = photo(image["name"]), photo(nearest_view(problems[image["name"]], problems, place.names[1]))
            sent = columns_of(answer)[:, 1]
            at, own = np.asarray(image["keypoints"]) / size * grid, rows_of_image(image)
            points = np.array([match[0] if match else 0 for match in answer["matches"]])[sent]
            rows, shown = pack_rows(pack, points)
            shown_rows = pack["rows"][shown]
            inputs = {
                "all descriptors at their true positions": (at, own),
                "explained rows at their true positions": (at[columns_of(answer)[:, 0]], own[columns_of(answer)[:, 0]]),
                "matches at their true positions, descriptors of the pack": (at[sent], rows),
                "the pack's rows of the view at random positions": (draw.random((len(shown_rows), 2)) * grid, shown_rows),
                "no descriptor": (np.zeros((0, 2)), np.zeros((0, 64), np.float32)),
            }
            made = {}
            for name, (places, descriptors) in inputs.items():
                scaled = torch.from_numpy(descriptors / np.maximum(np.linalg.norm(descriptors, axis=1, keepdims=True), 1e-9) * 8).float()
                cells = torch.from_numpy(tools.cells_of(places, (grid[1], grid[0])))
                with torch.no_grad():
                    made[name] = network(tools.features(cells, scaled, 1, (grid[1], grid[0])))[0].permute(1, 2, 0).clamp(0, 1).numpy()
                scores.setdefault(name, []).append((len(places), *similarity(made[name], user), *similarity(made[name], near)))
            scores.setdefault("the nearest map image itself", []).append((0, *similarity(near, user), math.inf, 1))
            if run.show:
                strip = np.concatenate([user, near, *made.values()], 1)
                Image.fromarray((255 * strip).astype(np.uint8)).save(Path(run.show) / f"{place.name}-{len(scores['no descriptor'])}.png")
        for name, of in scores.items():
            count, *means = (statistics.mean(values) for values in zip(*of))
            cells = [f"{means[0]:.2f}", f"{means[1]:.3f}", f"{means[2]:.2f}", f"{means[3]:.3f}"]
            is_photo = name == "the nearest map image itself"
            table.add([place.name, name, len(of), *(["", *cells[:2], "", ""] if is_photo else [f"{count:.0f}", *cells])])


def photograph(run, place: str, name: str, size, grid):
    """The window of an image that is sent, in the size of a grid, 0 to 1."""
    with Image.open(run.place(place) / "images" / name) as file:
        left, top = ((whole - part) // 2 for whole, part in zip(file.size, size))
        cut = file.convert("RGB").crop((left, top, left + size[0], top + size[1])).resize(grid, Image.BILINEAR, reducing_gap=2.0)
    return np.asarray(cut, np.float32) / 255


def nearest_view(problem: dict, problems: dict, names: list) -> str:
    """The map image with the nearest camera of those that look into this direction."""
    def camera(of):
        turn = rotation(of["cam_from_world"]["q"])
        return center(turn, np.array(of["cam_from_world"]["t"])), turn[2]

    here, axis = camera(problem)
    views = ((name, *camera(problems[name])) for name in names if name in problems)
    return min((np.linalg.norm(at - here) + 100 * (ahead @ axis < 0.8), name) for name, at, ahead in views)[1]


def pack_rows(pack: dict, points):
    """Rows of the pack for these points, from the image with most of them where it has them, and all rows of this image."""
    ends, named = np.cumsum(pack["images"]), np.zeros(pack["points"], bool)
    named[points] = True
    images = [np.arange(end - count, end) for count, end in zip(pack["images"], ends)]
    images.sort(key=lambda rows: -named[pack["of rows"][rows]].sum())
    row_of = np.full(pack["points"], -1)
    for rows in reversed(images):
        row_of[pack["of rows"][rows]] = rows
    return pack["rows"][row_of[points]], images[0]


def similarity(a, b) -> tuple:
    """PSNR, and SSIM of the gray images with Gaussian windows of 1.5 pixels."""
    psnr = -10 * math.log10(float(((a - b) ** 2).mean()))
    gray = lambda image: image @ np.array([0.299, 0.587, 0.114])
    blur = lambda image: ndimage.gaussian_filter(image, 1.5, truncate=3.5)
    a, b = gray(a), gray(b)
    ma, mb = blur(a), blur(b)
    va, vb, both = blur(a * a) - ma**2, blur(b * b) - mb**2, blur(a * b) - ma * mb
    return psnr, float(((2 * ma * mb + 1e-4) * (2 * both + 9e-4) / ((ma**2 + mb**2 + 1e-4) * (va + vb + 9e-4))).mean())
