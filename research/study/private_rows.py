#!/usr/bin/env python3
"""Measures what a server that has found the pose learns of something in front of its map, on several places.

    research/study/private_rows.py hole --veiloc target/release/veiloc --data $VEILOC_DATA --work work --csv docs/results/privacy/hole.csv
    research/study/private_rows.py defences … --csv docs/results/privacy/hole-defences.csv
    research/study/private_rows.py persons … --people people --csv docs/results/privacy/persons.csv
    research/study/private_rows.py person-defences … --people people --csv docs/results/privacy/person-defences.csv
    research/study/private_rows.py layouts … --photos photos.jsonl.gz --csv docs/results/privacy/layout-private.csv \\
        --means docs/results/privacy/layout-private-means.csv
    research/study/private_rows.py places … --photos photos.jsonl.gz --csv docs/results/privacy/places.csv

Each place is a folder with `posed`, `images`, `map.txt` and `query.txt`. A tenth of each query's keypoints, in an upright
ellipse, loses its matches with the map, as if a person stood there; errors are measured on these keypoints.

- hole: each scheme, on every place.
- persons: the same with regions of 0.3 to 0.6 of the image's height (`person_regions.py`, which also makes --people):
  ellipses, silhouettes, masks of real people, and real people pasted into the images, whose own keypoints are attacked then.
  Rows of other places are kept in the table, and its means are of all.
- person-defences: dcl, the defences on these regions; what they cost is in the table of `defences`.
- defences: dcl, averaged over places: what a device can do about it, and what that costs in poses.
- layouts: layouts of dcl by the rule of decision 0058, in absolute errors. Private regions are upright, as a person, or wide, as a
  screen or a name plate: the same in images that are turned by a quarter, so that the attacker looks for wide regions too.
  Seals, nearby images and the statistic are measured on all rows, the others on private ones.
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
from places import LAYOUTS, PLACES, kept_document, write_csv

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


# Adversaries that layouts are compared under.
LAYOUT_ADVERSARIES = ["upright hole", "wide hole", "pose, iterative", "eight seals", "nearby images", "statistic", "sessions"]
# Private regions: at least two an image, and this number a place.
LEAST_SEEDS, REGIONS_OF_PLACE = 2, 16
# A layout is admitted when no adversary has less than this share of its error under the paper's, or more of the rows under 30 px.
LEAST_ERROR, MOST_SHARE = 0.9, 0.03
# Sessions are slow: one place, and not the layouts that are outside of the limits without them.
SESSION_PLACE, SESSION_FRAMES = "redkitchen", "8"
NO_SESSIONS = ("stripes 138", "stripes 115", "upright strips, 0.5", "upright strips, 0.75", "slanted strips B")


def layouts(places, args):
    compared = {"paper": "dcl:paper"} | LAYOUTS | dict(also.split("=", 1) for also in args.also)
    rows, found = [], {}
    for place in places:
        for adversary, trials in layout_attacks(place, compared, args):
            for name, layout in compared.items():
                if layout not in trials[0]:
                    continue
                answers = [attacker(trial[layout]) for trial in trials]
                prior, error, share, bits = (statistics.mean(answer[k] for answer in answers) for k in range(4))
                found.setdefault((name, adversary), []).append((error, share, bits))
                rows.append([place.name, name, adversary, f"{prior:.1f}", f"{error:.1f}", f"{100 * share:.1f}", f"{bits:.2f}"])
                print(*rows[-1], sep="  ", flush=True)
    write_csv(args.csv, ["place", "layout", "adversary", "baseline (px)", "attacker (px)", "attacker < 30 px (%)", "bits"], rows)
    means = {of: (statistics.geometric_mean(error for error, *_ in all_of), statistics.mean(share for _, share, _ in all_of),
                  statistics.mean(bits for *_, bits in all_of)) for of, all_of in found.items()}  # fmt: skip
    table = []
    for name in compared:
        cells, beyond = [], []
        for adversary in LAYOUT_ADVERSARIES:
            if (name, adversary) not in means:
                cells.append("")
                continue
            (error, share, bits), (reference, share_of_paper, _) = means[name, adversary], means["paper", adversary]
            cells.append(f"{error:.1f} px, {100 * share:.1f} %, {bits:+.2f}")
            if error < LEAST_ERROR * reference or share > share_of_paper + MOST_SHARE:
                beyond.append(f"{adversary} ({error / reference - 1:+.0%}, {100 * (share - share_of_paper):+.1f} points)")
        table.append([name, *cells, "reference" if name == "paper" else "; ".join(beyond) or "none"])
        print(*table[-1], sep="  ")
    write_csv(args.means, ["layout", *LAYOUT_ADVERSARIES, "outside the limits"], table)


def layout_attacks(place, compared, args):
    """Each adversary with its trials, one a seed: rows by layout and attack."""
    schemes, run = list(compared.values()), lambda *options: attack_rows(place, args, *options)
    chosen = place.chosen(2048)
    count = str(len(chosen))
    queries, with_map, turned = (place.work / f"{what}-{count}.jsonl.gz" for what in ("attacked", "attacked-with-map", "turned"))
    write_lines(queries, chosen)
    write_lines(with_map, chosen + place.map)
    problems = place.sent_problems(2048)
    given = ["--server-matches", problems, "--private", SHARE, "--neighbours", "predicted", "--train", place.map_keypoints]
    seeds = range(1, 1 + max(LEAST_SEEDS, math.ceil(REGIONS_OF_PLACE / len(chosen))))
    private = [run(queries, schemes, *given, "--attacks", "hole,server-side-points,iterative", "--seed", str(seed)) for seed in seeds]
    pick = lambda trial, *attacks: {scheme: {name: row for name, row in rows.items() if name in ("prior", *attacks)}
                                    for scheme, rows in trial.items()}  # fmt: skip
    yield "upright hole", [pick(trial, "hole") for trial in private]
    yield "pose, iterative", [pick(trial, "server-side-points", "iterative") for trial in private]
    # Images, problems and layouts a quarter turn to the left: upright regions of the program are wide ones then.
    known, size = place.work / "turned-problems.jsonl", chosen[0]
    write_lines(turned, [turned_image(image) for image in chosen])
    with problems.open() as lines, known.open("w") as out:
        out.writelines(json.dumps(turned_problem(json.loads(line))) + "\n" for line in lines)
    of_turned = {turned_layout(scheme, size["width"], size["height"]): scheme for scheme in schemes}
    trials = [run(turned, list(of_turned), "--server-matches", known, "--private", SHARE, "--attacks", "hole", "--seed", str(seed))
              for seed in seeds]  # fmt: skip
    yield "wide hole", [{of_turned[scheme]: rows for scheme, rows in trial.items()} for trial in trials]
    yield "eight seals", [run(queries, schemes, "--attacks", "resting-camera", "--frames", "8")]
    yield "nearby images", [run(with_map, schemes, "--limit", count, "--attacks", "transfer")]
    if args.photos:
        yield "statistic", [run(queries, schemes, "--neighbours", "predicted", "--train", args.photos, "--attacks",
                                "learned-prior,closed-form-consensus")]  # fmt: skip
    if place.name == SESSION_PLACE:
        yield "sessions", session_rows(place, args, [scheme for name, scheme in compared.items() if name not in NO_SESSIONS])


def attack_rows(place, args, file, schemes, *options):
    rows = {}
    for scheme in schemes:
        document = kept_document(args.veiloc, place.work / "layouts", "attack", file, *options, "--schemes", scheme)
        rows[scheme] = {row["attack"]: row for row in document["attacks"]}
    return rows


def session_rows(place, args, schemes):
    """Private rows of several images of a session, each layout by its best method, for a camera that turns and one that walks;
    shares are of 10 px here."""
    document = kept_document(
        args.veiloc, place.work / "layouts", "eval", "sessions", "--posed", place.folder / "posed", "--images",
        place.folder / "images", "--map-list", place.folder / "map.txt", "--query-list", place.folder / "query.txt", "--anchors",
        "world", "--gyro-deg", "0", "--motion", "turning,walking", "--frames", SESSION_FRAMES, "--max-attacked",
        str(args.sessions), "--schemes", ",".join(schemes))  # fmt: skip
    trials = {}
    for row in document["rows"]:
        if row["target"] == "private" and row["median_px"] is not None:
            of = trials.setdefault(row["motion"], {}).setdefault(row["scheme"], {})
            of["prior"] = {"median_px": row["prior_median_px"], "under_30px": 0.0}
            of[row["method"]] = row | {"under_30px": row["under_10px"]}
    # The program may write a scheme in another way.
    return [dict(zip(schemes, rows.values(), strict=True)) for rows in trials.values()]


def attacker(rows):
    """Median error of the baseline, and the better of it and the attacks: median error, share under 30 px, bits."""
    prior, attacks = rows["prior"], [row for name, row in rows.items() if name != "prior"]
    return (prior["median_px"], min(row["median_px"] for row in rows.values()), max(row["under_30px"] for row in rows.values()),
            max(row["bits_over_prior"] for row in attacks))  # fmt: skip


def turned_image(image):
    width = image["width"]
    keypoints = [[v, width - u] for u, v in image["keypoints"]]
    return image | {"width": image["height"], "height": width, "keypoints": keypoints}


def turned_problem(problem):
    camera, half = problem["camera"], math.sqrt(0.5)
    width, (fx, fy, cx, cy) = camera["width"], camera["params"]
    (w, x, y, z), (tx, ty, tz) = problem["cam_from_world"]["q"], problem["cam_from_world"]["t"]
    turned = {
        "camera": camera | {"width": camera["height"], "height": width, "params": [fy, fx, cy, width - cx]},
        "cam_from_world": {"q": [half * (w + z), half * (x + y), half * (y - x), half * (z - w)], "t": [ty, -tx, tz]},
        "points2d": [[v, width - u] for u, v in problem["points2d"]],
    }
    return problem | turned


def turned_layout(layout, width, height):
    """The layout that joins the keypoints of turned images to the same anchors."""
    if layout == "dcl:paper":
        layout = "dcl:axis=90:sectors=2:anchors=0/-0.5+0/0.5"
    parts = dict(part.split("=") for part in layout.split(":")[1:])
    axis, anchors = float(parts["axis"]) - 90, [tuple(map(float, at.split("/"))) for at in parts["anchors"].split("+")]
    anchors = [(y * height / width, -x * height / width) for x, y in anchors]
    if axis < 0:
        # The axis of the opposite direction, about which sectors count the other way.
        axis, anchors = axis + 180, anchors[::-1]
    at = "+".join(f"{round(x, 3) + 0:g}/{round(y, 3) + 0:g}" for x, y in anchors)
    return f"dcl:axis={axis:g}:sectors={parts['sectors']}:anchors={at}"


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


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["hole", "persons", "defences", "person-defences", "layouts", "places"])
    parser.add_argument("--veiloc", default="veiloc")
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--csv", type=Path)
    parser.add_argument("--places", default=",".join(PLACES))
    parser.add_argument("--photos", type=Path, help="keypoints of other places, for `places` and `layouts`")
    parser.add_argument("--people", type=Path, help="folder of people, for `persons`")
    parser.add_argument("--means", type=Path, help="CSV of the means over places, for `layouts`")
    parser.add_argument("--also", action="append", default=[], metavar="NAME=LAYOUT", help="one more layout, for `layouts`")
    parser.add_argument("--sessions", type=int, default=6, help="images that sessions are attacked on, for `layouts`")
    parser.add_argument("--queries", type=int, default=10, help="attacked queries of each place, evenly spaced")
    args = parser.parse_args()
    places = [Place(args, name) for name in args.places.split(",")]
    commands = {"hole": hole, "persons": persons, "defences": defences, "person-defences": person_defences,
                "layouts": layouts, "places": every_place}  # fmt: skip
    commands[args.what](places, args)


if __name__ == "__main__":
    main()
