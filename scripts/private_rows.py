#!/usr/bin/env python3
"""Measures what a server that has found the pose learns of something in front of its map, on several places.

    scripts/private_rows.py hole --veiloc target/release/veiloc --data $VEILOC_DATA --work work --csv docs/results/privacy/hole.csv
    scripts/private_rows.py defences … --csv docs/results/privacy/hole-defences.csv
    scripts/private_rows.py persons … --people people --csv docs/results/privacy/persons.csv
    scripts/private_rows.py person-defences … --people people --csv docs/results/privacy/person-defences.csv
    scripts/private_rows.py layouts … --csv docs/results/privacy/layout-private.csv
    scripts/private_rows.py places … --photos photos.jsonl.gz --csv docs/results/privacy/places.csv

Each place is a folder with `posed`, `images`, `map.txt` and `query.txt`. A tenth of each query's keypoints, in an upright
ellipse, loses its matches with the map, as if a person stood there; errors are measured on these keypoints.

- hole: each scheme, on every place.
- persons: the same with regions of 0.3 to 0.6 of the image's height (`person_regions.py`, which also makes --people):
  ellipses, silhouettes, masks of real people, and real people pasted into the images, whose own keypoints are attacked then.
  Rows of other places are kept in the table, and its means are of all.
- person-defences: dcl, the defences on these regions; what they cost is in the table of `defences`.
- defences: dcl, averaged over places: what a device can do about it, and what that costs in poses.
- layouts: layouts of dcl, on every place; the average has a 90 % interval from places drawn with replacement.
- places: every realistic adversary under dcl, on the static scene itself. `photos.jsonl.gz` has keypoints of other places, as
  `veiloc eval keypoints` writes them.

Keypoints and matches of a place are kept in --work.
"""

import argparse
import base64
import copy
import csv
import gzip
import itertools
import json
import math
import random
import statistics
import subprocess
import zlib
from pathlib import Path

from PIL import Image

from person_regions import ellipse, pasted, silhouette
from places import LAYOUTS, PLACES, write_csv

ATTACKS = "hole,server-side-points,iterative"
SHARE = "10"
# Keypoints that are sent, and the percentage of the image in turned regions.
DEFENCES = {
    "none": (2048, 0), "512 keypoints": (512, 0), "256 keypoints": (256, 0),
    "turned regions, 20 %": (2048, 20), "turned regions, 30 %": (2048, 30), "turned regions, 50 %": (2048, 50),
}  # fmt: skip
UPRIGHT, HALF_HEIGHTS, CELLS = 2.5, (0.12, 0.36), (64, 48)


class Place:
    """Keypoints and matches of a place's queries and map images."""

    def __init__(self, args, name):
        self.args, self.name, self.folder = args, name, args.data / name
        # Files of problems that this run has written.
        self.sent = set()
        self.work = args.work / name
        self.work.mkdir(parents=True, exist_ok=True)
        self.problems, keypoints = self.work / "problems.jsonl", self.work / "keypoints.jsonl.gz"
        names = [self.names("query.txt"), self.names("map.txt")]
        if not keypoints.exists():
            listed = self.work / "list.txt"
            listed.write_text("".join(f"{name}\n" for names_of in names for name in names_of))
            self.run("eval", "problems", "--quiet", "--posed", self.folder / "posed", "--images", self.folder / "images",
                     "--map-list", self.folder / "map.txt", "--query-list", listed, "-o", self.problems,
                     "--keypoints", keypoints)  # fmt: skip
        with gzip.open(keypoints, "rt") as lines:
            images = [json.loads(line) for line in lines]
        self.queries, self.map = images[: len(names[0])], images[len(names[0]) :]
        with self.problems.open() as lines:
            self.of_queries = [json.loads(line) for line in lines][: len(names[0])]
        self.map_keypoints = self.work / "map.jsonl.gz"
        write_lines(self.map_keypoints, self.map)

    def names(self, file):
        lines = (self.folder / file).read_text().splitlines()
        return [line.split()[0] for line in lines if line.strip() and not line.startswith("#")]

    def run(self, *command):
        subprocess.run([self.args.veiloc, *command], check=True, stdout=subprocess.DEVNULL)

    def chosen(self, keypoints):
        """The attacked queries, evenly spaced, with their strongest keypoints."""
        most = min(self.args.queries, len(self.queries))
        return [strongest(self.queries[i * len(self.queries) // most], keypoints) for i in range(most)]

    def sent_problems(self, keypoints):
        """File of the problems, without matches of weaker keypoints of queries."""
        path, of_queries = self.work / f"sent-{keypoints}.jsonl", {query["name"] for query in self.queries}
        if path in self.sent:
            return path
        self.sent.add(path)
        with path.open("w") as file, self.problems.open() as lines:
            for problem, image in zip(map(json.loads, lines), self.queries + self.map):
                if len(image["keypoints"]) > keypoints and image["name"] in of_queries:
                    problem = with_matches(problem, matched(problem, image, keypoints))
                file.write(json.dumps(problem) + "\n")
        return path

    def region(self, kind):
        """A view of this place whose attacked queries have private regions of this kind, and the options that name them."""
        if kind == "tenth":
            return self, ["--private", SHARE]
        folder, shown = self.work / kind.replace(" ", "-"), self
        people = sorted(self.args.people.glob("*.png")) if "people" in kind else []
        # Keypoints are those of the window that is sent, in the middle of the image.
        sizes = {query["name"]: (query["width"], query["height"]) for query in self.chosen(2048)}
        names, made = list(sizes), folder / "images"
        for name, size in sizes.items():
            draw = random.Random(f"{kind} {name}")
            mask_file = folder / "masks" / f"{name}.png"
            mask_file.parent.mkdir(parents=True, exist_ok=True)
            with Image.open(self.folder / "images" / name) as image:
                if people:
                    with_person, mask = pasted(image, people, draw)
                    corner = [(whole - part) // 2 for whole, part in zip(image.size, size)]
                    mask = mask.crop((*corner, corner[0] + size[0], corner[1] + size[1]))
                else:
                    mask = {"ellipses": ellipse, "silhouettes": silhouette}[kind](size, draw)
                if kind == "people, pasted":
                    (made / name).parent.mkdir(parents=True, exist_ok=True)
                    with_person.save(made / name, quality=95)
            mask.save(mask_file)
        if kind == "people, pasted":
            shown = self.with_queries(names, made)
        return shown, ["--private-masks", folder / "masks"]

    def with_queries(self, names, made):
        """This place with these images as its queries, from another folder."""
        for name in self.names("map.txt"):
            (made / name).parent.mkdir(parents=True, exist_ok=True)
            if not (made / name).exists():
                (made / name).symlink_to((self.folder / "images" / name).resolve())
        shown = copy.copy(self)
        shown.work = made.parent
        shown.problems, keypoints, listed = made.parent / "problems.jsonl", made.parent / "queries.jsonl.gz", made.parent / "list.txt"
        if not keypoints.exists():
            listed.write_text("".join(f"{name}\n" for name in names))
            self.run("eval", "problems", "--quiet", "--posed", self.folder / "posed", "--images", made, "--map-list",
                     self.folder / "map.txt", "--query-list", listed, "-o", shown.problems, "--keypoints", keypoints)  # fmt: skip
            # What the map's own images see is as before.
            with self.problems.open() as whole, shown.problems.open("a") as problems:
                problems.writelines(list(whole)[len(self.queries) :])
        with gzip.open(keypoints, "rt") as lines:
            shown.queries = [json.loads(line) for line in lines]
        return shown

    def attack(self, schemes, keypoints=2048, turned=0, attacks=ATTACKS, private=("--private", SHARE)):
        """Rows of `veiloc attack` by scheme and attack, with `hiding_auc` at the hole, and the summaries of the server."""
        attacked, found = self.work / "attacked.jsonl.gz", self.work / "found.json"
        chosen = self.chosen(keypoints)
        write_lines(attacked, chosen)
        problems = self.sent_problems(keypoints)
        # The hole needs no neighbours.
        neighbours = [] if attacks == "hole" else ["--neighbours", "predicted", "--train", self.map_keypoints]
        self.run("attack", attacked, "--quiet", "--server-matches", problems, *private, "--turned-regions", str(turned), *neighbours,
                 "--attacks", attacks, "--schemes", ",".join(schemes), "--json", found)  # fmt: skip
        document, rows = json.loads(found.read_text()), {}
        for row in document["attacks"]:
            rows.setdefault(row["scheme"], {})[row["attack"]] = row
        for server in document["server"]:
            rows[server["scheme"]]["server"] = server
        return rows

    def attack_scene(self, schemes, attacks, neighbours, server, with_map, seals):
        """Rows of `veiloc attack` on the scene itself by scheme and attack."""
        attacked, found, chosen = self.work / "attacked.jsonl.gz", self.work / "found.json", self.chosen(2048)
        write_lines(attacked, chosen + (self.map if with_map else []))
        known = ["--server-matches", self.sent_problems(2048)] if server else []
        self.run("attack", attacked, "--quiet", "--limit", str(len(chosen)), "--attacks", attacks, "--schemes",
                 ",".join(schemes), *neighbours, *known, "--frames", str(seals),
                 "--json", found)  # fmt: skip
        rows = {}
        for row in json.loads(found.read_text())["attacks"]:
            rows.setdefault(row["scheme"], {})[row["attack"]] = row
        return rows

    def poses(self, scheme, keypoints=2048, turned=0):
        """The entry of the scheme, and the median error with lost queries as infinite."""
        problems, found = self.work / "poses.jsonl", self.work / "poses.json"
        with problems.open("w") as file:
            for problem, image in zip(self.of_queries, self.queries):
                keep = matched(problem, image, keypoints)
                if turned:
                    inside = regions(image, turned / 100)
                    keep = [kept and not inside(point) for kept, point in zip(keep, problem["points2d"])]
                file.write(json.dumps(with_matches(problem, keep)) + "\n")
        self.run("eval", "pose", "--quiet", problems, "--schemes", scheme, "--recipes", "default", "--thresholds",
                 "0.05/5,0.25/2", "--json", found)  # fmt: skip
        document = json.loads(found.read_text())
        errors = [query.get("translation_error") for query in document["queries"]]
        return document["schemes"][0], statistics.median(math.inf if e is None else e for e in errors)


def write_lines(path, images):
    with gzip.open(path, "wt", compresslevel=1) as file:
        for image in images:
            file.write(json.dumps(image) + "\n")


def strongest(image, count):
    """The image with its first, strongest keypoints."""
    all_rows = base64.b64decode(image["descriptors"])
    row = len(all_rows) // max(1, len(image["keypoints"]))
    kept = image["keypoints"][:count]
    return image | {"keypoints": kept, "descriptors": base64.b64encode(all_rows[: row * len(kept)]).decode()}


def matched(problem, image, count):
    """Which matches are of the strongest keypoints."""
    at = {(round(u, 2), round(v, 2)) for u, v in image["keypoints"][:count]}
    return [(round(u, 2), round(v, 2)) in at for u, v in problem["points2d"]]


def with_matches(problem, keep):
    lists = ("points2d", "points3d", "ratio", "votes", "track_length", "seen_from")
    pick = lambda values: [value for value, kept in zip(values, keep) if kept]
    return problem | {key: pick(problem[key]) for key in lists if key in problem}


def regions(image, share):
    """Whether a point lies in random upright ellipses that cover this share of the image, as in `private_region.rs`."""
    rng = random.Random(zlib.crc32(image["name"].encode()))
    width, height = image["width"], image["height"]
    cells = [((i % CELLS[0] + 0.5) * width / CELLS[0], (i // CELLS[0] + 0.5) * height / CELLS[1])
             for i in range(CELLS[0] * CELLS[1])]  # fmt: skip
    ellipses, left = [], (1 - share) * len(cells)
    is_in = lambda p, e: math.hypot((p[0] - e[0]) * UPRIGHT, p[1] - e[1]) <= e[2]
    while len(cells) > left:
        ellipses.append((rng.uniform(0, width), rng.uniform(0, height), rng.uniform(*HALF_HEIGHTS) * height))
        cells = [cell for cell in cells if not is_in(cell, ellipses[-1])]
    return lambda point: any(is_in(point, ellipse) for ellipse in ellipses)


def hole(places, args):
    rows = []
    for place in places:
        for scheme, of_scheme in place.attack(["random-lines", "dcl"]).items():
            prior, found = of_scheme["prior"], of_scheme["hole"]
            other = max(row["bits_over_prior"] for name, row in of_scheme.items() if name not in ("prior", "hole", "server"))
            rows.append([
                place.name, scheme, found["images"], f"{prior['median_px']:.0f}", f"{found['median_px']:.0f}",
                f"{100 * prior['under_30px']:.0f}", f"{100 * found['under_30px']:.0f}",
                f"{found['bits_over_prior']:.2f}", f"{other:.2f}", f"{found['hiding_auc']:.2f}",
            ])  # fmt: skip
            print(*rows[-1], sep="  ", flush=True)
    columns = ["place", "scheme", "queries", "prior (px)", "hole (px)", "< 30 px, prior (%)", "< 30 px, hole (%)",
               "bits, hole", "bits, best other attack", "AUC of private rows among unexplained ones"]  # fmt: skip
    write_csv(args.csv, columns, rows)


def defences(places, args):
    rows, base, layout = [], {}, "dcl:paper"
    for name, (keypoints, turned) in DEFENCES.items():
        found = []
        for place in places:
            row = place.attack([layout], keypoints, turned, "hole")
            of_hole = next(iter(row.values()))["hole"]
            pose, median = place.poses(layout, keypoints, turned)
            base.setdefault(place.name, (pose, median))
            before, best = base[place.name]
            lost = [100 * (before["recall"][t] - pose["recall"][t]) for t in ("0.05/5", "0.25/2")]
            found.append((of_hole["bits_over_prior"], of_hole["hiding_auc"], *lost, median / best))
        bits, auc, near, far, ratio = zip(*found)
        rows.append([
            name, f"{statistics.mean(bits):.2f}", f"{min(bits):.2f} to {max(bits):.2f}", f"{statistics.mean(auc):.2f}",
            f"{statistics.mean(near):.1f}", f"{statistics.mean(far):.1f}", f"{max(far):.1f}",
            f"{statistics.geometric_mean(ratio):.2f}",
        ])  # fmt: skip
        print(*rows[-1], sep="  ", flush=True)
    columns = ["defence", "bits, mean of places", "bits, range", "AUC, mean of places",
               "recall lost at 5 cm and 5° (points)", "recall lost at 25 cm and 2° (points)", "worst place (points)",
               "median error over none"]  # fmt: skip
    write_csv(args.csv, columns, rows)


REGIONS = ["ellipses", "silhouettes", "people", "people, pasted"]


def kept_rows(path, measured):
    """Rows of a table that are not measured again."""
    if not path or not path.exists():
        return []
    with path.open(newline="") as file:
        return [row for row in list(csv.reader(file))[1:] if row[0] not in measured]


def persons(places, args):
    rows = kept_rows(args.csv, [place.name for place in places] + ["mean of places"])
    for place in places:
        for kind in REGIONS:
            shown, private = place.region(kind)
            for scheme, found in shown.attack(["random-lines", "dcl"], private=private).items():
                prior, of_hole = found["prior"], found["hole"]
                rows.append([
                    place.name, kind, scheme, of_hole["images"], f"{100 * found['server']['measured']:.1f}",
                    f"{prior['median_px']:.0f}", f"{of_hole['median_px']:.0f}", f"{of_hole['bits_over_prior']:.2f}",
                    f"{of_hole['hiding_auc']:.2f}",
                ])  # fmt: skip
                print(*rows[-1], sep="  ", flush=True)
    rows.sort(key=lambda row: PLACES.index(row[0]))
    for kind, scheme in itertools.product(REGIONS, ["random-lines", "dcl"]):
        bits, auc = zip(*((float(row[7]), float(row[8])) for row in rows if row[1:3] == [kind, scheme]))
        rows.append(["mean of places", kind, scheme, "", "", "", "", f"{statistics.mean(bits):.2f}", f"{statistics.mean(auc):.2f}"])
        print(*rows[-1], sep="  ", flush=True)
    columns = ["place", "regions", "scheme", "queries", "private rows (%)", "prior (px)", "hole (px)", "bits, hole",
               "AUC of private rows among unexplained ones"]  # fmt: skip
    write_csv(args.csv, columns, rows)


def person_defences(places, args):
    rows = []
    for kind in REGIONS:
        regions = [place.region(kind) for place in places]
        for name, (keypoints, turned) in DEFENCES.items():
            found = []
            for shown, private in regions:
                row = next(iter(shown.attack(["dcl:paper"], keypoints, turned, "hole", private).values()))["hole"]
                found.append((row["bits_over_prior"], row["hiding_auc"]))
            bits, auc = zip(*found)
            rows.append([kind, name, f"{statistics.mean(bits):.2f}", f"{min(bits):.2f} to {max(bits):.2f}",
                         f"{statistics.mean(auc):.2f}"])  # fmt: skip
            print(*rows[-1], sep="  ", flush=True)
    write_csv(args.csv, ["regions", "defence", "bits, mean of places", "bits, range", "AUC, mean of places"], rows)


def layouts(places, args):
    compared, rows, gains = ["dcl:paper", *LAYOUTS.values()], [], {}
    for place in places:
        found = place.attack(compared)
        for layout, of_layout in zip(compared, found.values()):
            # An attack that is worse than the baseline is no gain.
            bits = {name: of_layout[name]["bits_over_prior"] for name in ("hole", "iterative")}
            of_seals = place.attack_scene([layout], "resting-camera", [], False, False, 8)
            bits["seals"] = next(iter(of_seals.values()))["resting-camera"]["bits_over_prior"]
            gains.setdefault(layout, []).append({name: max(0.0, gain) for name, gain in bits.items()})
            rows.append([place.name, label(layout), *(f"{gain:.2f}" for gain in bits.values()),
                         f"{of_layout['hole']['hiding_auc']:.2f}"])  # fmt: skip
            print(*rows[-1], sep="  ", flush=True)
    rng = random.Random(0)
    for layout in compared:
        cells = []
        for name in ("hole", "iterative", "seals"):
            more = [own[name] - paper[name] for own, paper in zip(gains[layout], gains["dcl:paper"])]
            means = sorted(statistics.mean(rng.choices(more, k=len(more))) for _ in range(2000))
            cells.append(f"{statistics.mean(more):+.2f} ({means[100]:+.2f} to {means[1899]:+.2f})")
        rows.append(["more than the paper's", label(layout), *cells, ""])
        print(*rows[-1], sep="  ", flush=True)
    write_csv(args.csv, ["place", "layout", "hole (bits)", "iterative (bits)", "eight seals (bits)", "AUC of the hole"], rows)


# Adversary: attacks, neighbours, whether it has the pose and the map's images.
ADVERSARIES = {
    "the query and a statistic of other places": ("learned-prior,closed-form-consensus", "photos", False, False),
    "images from nearby viewpoints": ("transfer", "transferred", False, True),
    "the pose; what its map does not show": ("server-side-points,iterative", "map", True, False),
    "the pose and its map images; the same": ("guided-transfer", "oracle", True, True),
    "eight seals of one image": ("resting-camera", "oracle", False, False),
}


def every_place(places, args):
    rows, rng = [], random.Random(0)
    for scheme in ("dcl:paper",):
        for adversary, (attacks, neighbours, server, with_map) in ADVERSARIES.items():
            cells, bits = [], []
            for place in places:
                options = {
                    "photos": ["--neighbours", "predicted", "--train", args.photos],
                    "map": ["--neighbours", "predicted", "--train", place.map_keypoints],
                    "transferred": ["--neighbours", "transferred"], "oracle": [],
                }[neighbours]  # fmt: skip
                found = next(iter(place.attack_scene([scheme], attacks, options, server, with_map, 8).values()))
                best = max((row for name, row in found.items() if name != "prior"), key=lambda r: r["bits_over_prior"])
                bits.append(best["bits_over_prior"])
                cells.append(f"{best['median_px']:.0f} / {found['prior']['median_px']:.0f} ({bits[-1]:+.2f})")
                print(scheme, adversary, place.name, cells[-1], sep="  ", flush=True)
            means = sorted(statistics.mean(rng.choices(bits, k=len(bits))) for _ in range(2000))
            rows.append([scheme.removesuffix(":paper"), adversary, *cells,
                         f"{statistics.mean(bits):+.2f} ({means[100]:+.2f} to {means[1899]:+.2f})"])  # fmt: skip
    write_csv(args.csv, ["scheme", "knows", *(place.name for place in places), "mean of places (bits)"], rows)


def label(layout):
    return next((name for name, text in LAYOUTS.items() if text == layout), "paper")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["hole", "persons", "defences", "person-defences", "layouts", "places"])
    parser.add_argument("--veiloc", default="veiloc")
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--csv", type=Path)
    parser.add_argument("--places", default=",".join(PLACES))
    parser.add_argument("--photos", type=Path, help="keypoints of other places, for `places`")
    parser.add_argument("--people", type=Path, help="folder of people, for `persons`")
    parser.add_argument("--queries", type=int, default=10, help="attacked queries of each place, evenly spaced")
    args = parser.parse_args()
    places = [Place(args, name) for name in args.places.split(",")]
    commands = {"hole": hole, "persons": persons, "defences": defences, "person-defences": person_defences,
                "layouts": layouts, "places": every_place}  # fmt: skip
    commands[args.what](places, args)


if __name__ == "__main__":
    main()
