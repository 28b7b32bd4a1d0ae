"""Tables of docs/results/packs.md: what stays on a device that has the pack of the place, and what that costs."""

from __future__ import annotations

import base64
import itertools
import json
import random
import statistics
from dataclasses import dataclass
from pathlib import Path

from study.common import PLACES, ROOT, Package, command, names_of, percent
from study.geometry import rotation
from study.places import LAYOUTS, is_right, rows_of
from study.private_rows import by_attack, places_of, read_lines, write_lines

np, Image, ImageFilter = Package("numpy"), Package("PIL.Image"), Package("PIL.ImageFilter")

USES = {"all descriptors": "none", "explained rows": "pack:explained", "matches": "pack:matches"}
BACKGROUND = ROOT / "crates/device/obfuscation/src/pack/background.bin"
ROWS = 20480
# A match is true within this distance of its point under the true pose, pixels.
TRUE_PX = 3.0


@command(photos=("photographs", "folder of photographs that may be used by anyone"), into=(str(BACKGROUND), "file to write"))
def background(run):
    """Makes the background: an equal share of compact descriptors of each photograph, every second one also at half its size, shuffled."""
    random_rows, rows = np.random.default_rng(1), []
    photos = sorted(path for path in Path(run.photos).iterdir() if path.suffix.lower() in (".jpg", ".jpeg", ".png", ".webp"))
    copies = run.kept() / "background"
    copies.mkdir(exist_ok=True)
    for i, photo in enumerate(photos):
        for side in [1024, 480][: 1 + i % 2]:
            with Image.open(photo) as file:
                image = file.convert("RGB")
            factor = min(1, side / max(image.size), 1 if side == 1024 else 0.5)
            image.resize([max(1, round(factor * s)) for s in image.size], Image.LANCZOS).save(copies / f"{i:04}-{side}.png")
    images = read_lines(run.made(run.kept() / "background.jsonl.gz", "eval", "keypoints", copies))
    left = ROWS
    for place, image in enumerate(sorted(images, key=lambda image: len(image["keypoints"]))):
        codes = np.frombuffer(base64.b64decode(image["descriptors"]), np.uint8).reshape(-1, 64) >> 4
        share = min(len(codes), left // (len(images) - place))
        rows.append(codes[random_rows.permutation(len(codes))[:share]])
        left -= share
    codes = random_rows.permutation(np.concatenate(rows))
    Path(run.into).write_bytes((codes[:, 0::2] | codes[:, 1::2] << 4).tobytes())
    print(f"{len(photos)} photographs, {len(codes)} rows")


@command("packs/poses.csv", places=PLACES)
def poses(run):
    """Poses without a pack, of explained rows, and of matches that the device made; bytes of a query, and the server's times."""
    table = run.table("packs/poses.csv", "place", "scheme", "sent", "queries", "found", "within 5 cm and 5° (%)", "within 25 cm and 2° (%)",
                      "median error (map units)", "median error (°)", "trusted", "trusted beyond 25 cm or 2°", "rows", "query (bytes)",
                      "device (ms)", "server without pose (ms)", "pose (ms)")  # fmt: skip
    for place in run.places:
        found = rows_of(run.document("eval", "scene", *run.scene(place), "--schemes", "points,dcl", "--thresholds", "0.05/5,0.25/2",
                                     "--conditions", ",".join(USES.values())))  # fmt: skip
        for scheme, (use, condition) in itertools.product(("points", "dcl"), USES.items()):
            row, queries = found[scheme, condition, None]
            sent, trusted = [q for q in queries if q.get("sent_rows")], [q for q in queries if q.get("state") == "trusted"]
            median = lambda values: statistics.median(values) if values else 0
            ms = lambda *stages: f"{median([sum(q['ms'].get(stage, 0) for stage in stages) for q in sent]):.1f}"
            table.add({
                "place": place, "sent": use, "found": row["localized"], "trusted": len(trusted),
                "trusted beyond 25 cm or 2°": sum(not is_right(q) for q in trusted),
                "rows": f"{median([q['sent_rows'] for q in sent]):.0f}", "query (bytes)": f"{median([q['sent_bytes'] for q in sent]):.0f}",
                "device (ms)": ms("seal"), "server without pose (ms)": ms("decode", "retrieve", "match"), "pose (ms)": ms("pose"),
            }, row)  # fmt: skip


@command("packs/layouts.csv", places=["hololens-office", "tum-fr1-rpy"])
def layouts(run):
    """Layouts with matches that the device made, on the two hard places."""
    schemes = {"slanted strips": "dcl", "paper": "dcl:paper"} | {name: text for name, text in LAYOUTS.items() if name != "slanted strips"}
    table = run.table("packs/layouts.csv", "place", "layout", "found", "within 5 cm and 5° (%)", "within 25 cm and 2° (%)",
                      "median error (map units)", "median error (°)", "trusted", "trusted beyond 25 cm or 2°")  # fmt: skip
    for place in run.places:
        document = run.document("eval", "scene", *run.scene(place), "--schemes", ",".join(schemes.values()), "--thresholds", "0.05/5,0.25/2",
                                "--conditions", "pack:matches")  # fmt: skip
        for name, row in zip(schemes, document["schemes"]):
            trusted = [q for q in document["queries"] if q["scheme"] == row["scheme"] and q.get("state") == "trusted"]
            own = {"place": place, "layout": name, "found": row["localized"], "trusted": len(trusted)}
            table.add(own | {"trusted beyond 25 cm or 2°": sum(not is_right(q) for q in trusted)}, row)


PEOPLE = {"people": ("people", "folder of people cut out of photographs (`study privacy people`)"), "queries": (12, "queries of each place"), "places": PLACES}


@command("packs/rows.csv", needs="a segmentation network", **PEOPLE)
def rows(run):
    """Rows that stay on the device: of people who are pasted into the queries, of what matches nothing, of true matches; by kind of pack."""
    table = run.table("packs/rows.csv", "place", "pack (kB)", "one mean a point (kB)", "people's rows", "true matches", "other rows",
                      *(f"{what}, {use} (%)" for use in ("explained", "matches", "means") for what in ("people at home", "true kept", "others at home")))  # fmt: skip
    for place in places_of(run):
        shown = place.region("people, pasted")[0]
        pack = packed(run, place.name)
        with_people = looked_up(run, pack, shown.work / "queries.jsonl.gz", {image["name"]: image for image in shown.chosen(2048)})
        masks = place.work / "people,-pasted/masks"
        people, kept, others = [], [], []
        for image, answer in with_people:
            people.append(columns_of(answer)[hidden_by(masks / f"{image['name']}.png", image)])
        problems = {problem["name"]: problem for problem in place.of_queries}
        for image, answer in looked_up(run, pack, place.work / "keypoints.jsonl.gz", {image["name"]: image for image in place.queries}):
            is_true = true_rows(image, problems[image["name"]])
            kept.append(columns_of(answer)[is_true])
            others.append(columns_of(answer)[~is_true])
        people, kept, others = np.concatenate(people), np.concatenate(kept), np.concatenate(others)
        size, points = pack.stat().st_size / 1024, pack_of(pack)["points"]
        cells = [place.name, f"{size:.0f}", f"{points * 32 / 1024:.0f}", len(people), len(kept), len(others)]
        means = Means(pack)
        of_means = [means.explains(place, shown.chosen(2048), masks, problems)]
        for use in range(2):
            cells += [percent(1 - people[:, use].mean()), percent(kept[:, use].mean()), percent(1 - others[:, use].mean())]
        table.add([*cells, *(percent(share) for share in of_means[0])])


def packed(run, place: str) -> Path:
    """The pack of a place."""
    return run.made(run.kept() / f"{place}.vpack", "map", "pack", run.map(place))


def looked_up(run, pack: Path, keypoints: Path, chosen: dict):
    """The chosen images of a file of keypoints, each with what the pack says about it."""
    selected = keypoints.with_name(f"selected-{keypoints.name}")
    write_lines(selected, list(chosen.values()))
    answers = keypoints.with_suffix(".answers.jsonl")
    run.run("eval", "pack", "--quiet", selected, "--pack", pack, "-o", answers)
    with answers.open() as lines:
        return list(zip(chosen.values(), map(json.loads, lines)))


def columns_of(answer: dict):
    """Of each keypoint, whether it is sent as an explained row, and as a match."""
    explained = np.array(answer["explained"], bool)
    return np.stack([explained, explained & np.array([match is not None for match in answer["matches"]], bool)], 1)


def hidden_by(mask: Path, image: dict):
    """Which keypoints of an image lie where its mask is black; of the window in its middle that is sent."""
    with Image.open(mask) as file:
        black = np.asarray(file.convert("L")) < 128
    at = np.asarray(image["keypoints"]).astype(int)
    return black[at[:, 1].clip(0, black.shape[0] - 1), at[:, 0].clip(0, black.shape[1] - 1)]


def true_rows(image: dict, problem: dict):
    """Which keypoints have a match that is true under the true pose."""
    seen = np.asarray(problem["points3d"]) @ rotation(problem["cam_from_world"]["q"]).T + problem["cam_from_world"]["t"]
    focal_x, focal_y, u, v = problem["camera"]["params"]
    at = seen[:, :2] / seen[:, 2:] * [focal_x, focal_y] + [u, v]
    right = (np.hypot(*(at - np.asarray(problem["points2d"])).T) < TRUE_PX) & (seen[:, 2] > 0)
    known = {(round(a, 3), round(b, 3)) for (a, b), is_right in zip(problem["points2d"], right) if is_right}
    return np.array([(round(a, 3), round(b, 3)) in known for a, b in image["keypoints"]])


def fields_of(file: Path) -> dict:
    """The fields of a pack or a sealed query by number, as docs/reference/wire-format.md says: numbers and bytes."""
    data, at, found = file.read_bytes(), 0, {}

    def varint():
        nonlocal at
        value = 0
        for shift in itertools.count(0, 7):
            value, at = value | (data[at] & 0x7F) << shift, at + 1
            if data[at - 1] < 0x80:
                return value

    while at < len(data):
        key = varint()
        if key & 7 == 5:
            found[key >> 3], at = int.from_bytes(data[at : at + 4], "little"), at + 4
            continue
        size = varint()
        found[key >> 3], at = data[at : at + size], at + size
    return found


def pack_of(file: Path) -> dict:
    """Numbers of points, points of rows and rows of a pack."""
    found = fields_of(file)
    points, count = found[3], len(found[6]) // 32
    width = max(1, (points - 1).bit_length())
    bits = np.unpackbits(np.frombuffer(found[5], np.uint8))[: width * count].reshape(count, width)
    return {"points": points, "images": np.frombuffer(found[4], "<u4").astype(int), "of rows": bits @ (1 << np.arange(width)[::-1]), "rows": numbers(np.frombuffer(found[6], np.uint8).reshape(count, 32))}


def numbers(codes):
    """Compact descriptors as numbers, of two codes a byte."""
    return 16.0 * np.stack([codes & 15, codes >> 4], -1).reshape(len(codes), 64).astype(np.float32) - 120


def rows_of_image(image: dict):
    """Compact descriptors of a file of keypoints as numbers: one byte 16 c + 8 each."""
    codes = np.frombuffer(base64.b64decode(image["descriptors"]), np.uint8).reshape(len(image["keypoints"]), 64)
    return 16.0 * (codes >> 4).astype(np.float32) - 120


def nearest(rows, database):
    """Distance of each row to its nearest row of the database."""
    squares = (database**2).sum(1)
    parts = [np.sqrt(np.maximum(((part**2).sum(1)[:, None] + squares - 2 * part @ database.T).min(1), 0)) for part in np.array_split(rows, len(rows) // 512 + 1)]
    return np.concatenate(parts)


class Means:
    """A smaller pack: the mean descriptor of each point, by the ratio alone, at the ratio that keeps nine of ten true matches."""

    def __init__(self, file: Path):
        pack = pack_of(file)
        sums = np.zeros((pack["points"], 64))
        np.add.at(sums, pack["of rows"], pack["rows"])
        self.rows = (374 * sums / np.linalg.norm(sums, axis=1, keepdims=True)).astype(np.float32)
        self.background = numbers(np.frombuffer(BACKGROUND.read_bytes(), np.uint8).reshape(-1, 32))

    def ratios(self, image: dict):
        rows = rows_of_image(image)
        return nearest(rows, self.rows) / nearest(rows, self.background)

    def explains(self, place, with_people, masks, problems):
        """Shares: people's rows at home, true matches kept, other rows at home."""
        people = np.concatenate([self.ratios(image)[hidden_by(masks / f"{image['name']}.png", image)] for image in with_people])
        kept, others = [], []
        for image in place.chosen(2048):
            ratios, is_true = self.ratios(image), true_rows(image, problems[image["name"]])
            kept.append(ratios[is_true])
            others.append(ratios[~is_true])
        kept, others = np.concatenate(kept), np.concatenate(others)
        most = np.quantile(kept, 0.9)
        return [(people > most).mean(), (kept <= most).mean(), (others > most).mean()]


@command("packs/occlusion.csv", needs="a segmentation network", **PEOPLE)
def occlusion(run):
    """The occlusion of the map by people who are pasted into the queries, with all descriptors, explained rows, and matches."""
    table = run.table("packs/occlusion.csv", "place", "sent", "queries", "people's rows an image", "prior (px)", "occlusion (px)", "bits", "AUC")
    for place in places_of(run):
        shown, private = place.region("people, pasted")
        attacked = shown.work / "attacked.jsonl.gz"
        write_lines(attacked, shown.chosen(2048))
        for sent, use in USES.items():
            document = run.json("attack", attacked, "--server-matches", shown.sent_problems(2048), *private, "--attacks", "occlusion", "--schemes", "dcl",
                                *with_pack(run, place.name, use))  # fmt: skip
            found = by_attack(document)["dcl"]
            prior, attack, auc = found["prior"], found["occlusion"], found["occlusion"].get("hiding_auc")
            table.add([place.name, sent, attack["images"], f"{attack['keypoints'] / attack['images']:.1f}", f"{prior['median_px']:.0f}",
                       f"{attack['median_px']:.0f}", f"{attack['bits_over_prior']:.2f}", "" if auc is None else f"{auc:.2f}"])  # fmt: skip


def with_pack(run, place: str, use: str) -> list:
    """Options of an attack on queries with this use of the pack of a place."""
    return [] if use == "none" else ["--pack", packed(run, place), "--send", use.removeprefix("pack:")]


@command("packs/elsewhere.csv", places=PLACES, photographs=(200, "photographs of elsewhere"))
def elsewhere(run):
    """Photographs of elsewhere: how many are not sealed with the pack of a place, what is sent of the others, and whether a pose is trusted."""
    table = run.table("packs/elsewhere.csv", "place", "photographs", "sent", "not sealed (%)", "found", "trusted")
    # Those that chose no constant are not the fourth ones.
    photos = [path for i, path in enumerate(sorted(run.place("training-photos").glob("*/*.jpg"))) if i % 4 != 3]
    folder = run.kept() / "elsewhere"
    folder.mkdir(exist_ok=True)
    for photo in random.Random(5).sample(photos, run.photographs):
        (folder / f"{photo.parent.name}-{photo.name}").unlink(missing_ok=True)
        (folder / f"{photo.parent.name}-{photo.name}").symlink_to(photo)
    for place in run.places:
        found = rows_of(run.document("eval", "scene", "--map", run.map(place), "--schemes", "dcl", "--negatives", folder, "--conditions",
                                     "negatives,negatives+pack:explained,negatives+pack:matches"))  # fmt: skip
        for use, condition in USES.items():
            queries = found["dcl", "negatives" if condition == "none" else f"negatives+{condition}", None][1]
            sealed = [q for q in queries if q.get("sent_rows")]
            states = [q.get("state") for q in queries]
            table.add([place, len(queries), use, percent(1 - len(sealed) / len(queries), 0), len(queries) - states.count("not-found"), states.count("trusted")])


PICTURES = {"pictures": (14, "pictures of each place"), "known": (360, "pictures that the attacker knows"), "share": (0.25, "height of a picture over the image's")}


@dataclass
class PastedPictures:
    """Queries of a place in which a known picture hangs."""

    place: str
    folder: Path
    #: Keypoints of the queries, and of each the number of its picture and the box of it: left, top, right, bottom, width of the image.
    images: list
    truth: list
    #: Keypoints of the known pictures by number.
    known: dict


def pasted_pictures(run):
    """Known pictures, pasted into queries of each place."""
    photos = sorted(run.place("training-photos").glob("*/*.jpg"))
    draw = random.Random(4)
    known = draw.sample(photos, run.known)
    work = run.kept() / "pictures"
    (work / "known").mkdir(parents=True, exist_ok=True)
    for i, photo in enumerate(known):
        link = work / "known" / f"{i:04}.jpg"
        link.unlink(missing_ok=True)
        link.symlink_to(photo)
    images = read_lines(run.made(work / "known.jsonl.gz", "eval", "keypoints", work / "known", "--max-keypoints", "300"))
    by_number = {int(Path(image["name"]).stem): image for image in images}
    # Places share the draws, so all are drawn, in this order.
    for place in PLACES:
        names = names_of(run.place(place) / "query.txt")
        shown, truth = work / place, []
        (shown / "images").mkdir(parents=True, exist_ok=True)
        for k in range(run.pictures):
            i = draw.randrange(len(known) // 2)
            with Image.open(run.place(place) / "images" / names[k % len(names)]) as file, Image.open(known[i]) as picture:
                image, picture = file.convert("RGB"), picture.convert("RGBA")
            high = int(run.share * image.height)
            picture = picture.resize((max(8, picture.width * high // picture.height), high), Image.LANCZOS)
            picture = picture.rotate(draw.uniform(-15, 15), expand=True, resample=Image.BICUBIC).filter(ImageFilter.GaussianBlur(0.6))
            at = [draw.randint(0, max(1, whole - part)) for whole, part in zip(image.size, picture.size)]
            image.paste(picture, tuple(at), picture)
            image.save(shown / "images" / f"{k:02}.jpg", quality=88)
            box = (*at, at[0] + picture.width, at[1] + picture.height, image.width)
            truth.append((i, box))
        if place in run.places:
            file = shown / "keypoints.jsonl.gz"
            file.unlink(missing_ok=True)
            yield PastedPictures(place, shown, read_lines(run.made(file, "eval", "keypoints", shown / "images")), truth, by_number)


@command("packs/pictures.csv", places=PLACES, **PICTURES)
def pictures(run):
    """A known picture that hangs in view is named by descriptors alone: each row votes for the picture that is clearly nearest."""
    table = run.table("packs/pictures.csv", "place", "pictures", "named, all descriptors", "named, explained rows", "the picture's rows that match")
    for shown in pasted_pictures(run):
        pack, file = packed(run, shown.place), shown.folder / "keypoints.jsonl.gz"
        database = np.concatenate([rows_of_image(image) for image in shown.known.values()])
        owner = np.concatenate([np.full(len(image["keypoints"]), number) for number, image in shown.known.items()])
        named, matching = [0, 0], 0
        for (image, answer), (i, box) in zip(looked_up(run, pack, file, {image["name"]: image for image in shown.images}), shown.truth):
            distances = np.sqrt(np.maximum(((d := rows_of_image(image)) ** 2).sum(1)[:, None] + (database**2).sum(1) - 2 * d @ database.T, 0))
            best = distances.argmin(1)
            least = distances[np.arange(len(d)), best]
            distances[owner[None, :] == owner[best][:, None]] = np.inf
            votes = least < 0.85 * distances.min(1)
            sent = columns_of(answer)
            for use, rows in enumerate([np.ones(len(d), bool), sent[:, 0]]):
                counts = np.bincount(owner[best[votes & rows]], minlength=run.known)
                named[use] += bool(counts.max()) and counts.argmax() == i
            u, v = np.asarray(image["keypoints"]).T * (box[4] / image["width"])
            inside = (u > box[0]) & (u < box[2]) & (v > box[1]) & (v < box[3])
            matching += int((sent[:, 1] & inside).sum())
        table.add([shown.place, run.pictures, *named, matching])


# Its commands are of this page, and it needs what is above.
from study import pack_adversaries  # noqa: E402, F401
