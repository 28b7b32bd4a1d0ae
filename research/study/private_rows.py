"""Tables of docs/results/privacy.md: what a server that has found the pose learns of something in front of its map.

A tenth of each query's keypoints, in an upright ellipse, loses its matches with the map, as if a person stood there; errors are measured
on these keypoints. Keypoints and matches of a place are kept in the work folder.
"""

import base64
import copy
import gzip
import hashlib
import itertools
import json
import math
import random
import statistics
import subprocess
import zlib
from pathlib import Path

from study.common import PLACES, Package, command, names_of, read_csv
from study.people import ellipse, pasted, silhouette
from study.places import LAYOUTS

Image = Package("PIL.Image")
PAGE = "privacy"
ATTACKS = "occlusion,server-side-points,iterative"
SHARE = "10"
# Keypoints that are sent, and the percentage of the image in rotated regions.
DEFENCES = {
    "none": (2048, 0), "512 keypoints": (512, 0), "256 keypoints": (256, 0),
    "rotated regions, 20 %": (2048, 20), "rotated regions, 30 %": (2048, 30), "rotated regions, 50 %": (2048, 50),
}  # fmt: skip
UPRIGHT, HALF_HEIGHTS, CELLS = 2.5, (0.12, 0.36), (64, 48)


class Place:
    """Keypoints and matches of a place's queries and map images."""

    def __init__(self, run, name):
        self.run, self.name, self.folder = run, name, run.place(name)
        # Files of problems that this run has written.
        self.sent = set()
        self.work = run.kept() / "private" / name
        self.work.mkdir(parents=True, exist_ok=True)
        self.names = names_of(self.folder / "query.txt"), names_of(self.folder / "map.txt")
        self.problems, keypoints = self.work / "problems.jsonl", self.work / "keypoints.jsonl.gz"
        self.measure(self.folder / "images", [*self.names[0], *self.names[1]], self.work, keypoints)
        images, count = read_lines(keypoints), len(self.names[0])
        self.queries, self.map = images[:count], images[count:]
        with self.problems.open() as lines:
            self.of_queries = [json.loads(line) for line in lines][:count]
        self.map_keypoints = self.work / "map.jsonl.gz"
        write_lines(self.map_keypoints, self.map)

    def measure(self, images, queries, folder, keypoints):
        """Matches and keypoints of these queries with the map; whether they were measured now."""
        if keypoints.exists():
            return False
        listed = folder / "list.txt"
        listed.write_text("".join(f"{name}\n" for name in queries))
        self.run.run("eval", "problems", "--quiet", *self.run.posed(self.name, images), "--map-list", self.folder / "map.txt",
                     "--query-list", listed, "-o", folder / "problems.jsonl", "--keypoints", keypoints)  # fmt: skip
        return True

    def chosen(self, keypoints):
        """The attacked queries, evenly spaced, with their strongest keypoints."""
        most = min(self.run.queries, len(self.queries))
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
        people = sorted(Path(self.run.people).glob("*.png")) if "people" in kind else []
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
        for name in self.names[1]:
            (made / name).parent.mkdir(parents=True, exist_ok=True)
            if not (made / name).exists():
                (made / name).symlink_to((self.folder / "images" / name).resolve())
        shown = copy.copy(self)
        shown.work, shown.problems, keypoints = made.parent, made.parent / "problems.jsonl", made.parent / "queries.jsonl.gz"
        if self.measure(made, names, made.parent, keypoints):
            # What the map's own images see is as before.
            with self.problems.open() as whole, shown.problems.open("a") as problems:
                problems.writelines(list(whole)[len(self.queries) :])
        shown.queries = read_lines(keypoints)
        return shown

    def attack(self, schemes, keypoints=2048, turned=0, attacks=ATTACKS, private=("--private", SHARE)):
        """Rows of `veiloc attack` by scheme and attack, with `hiding_auc` at the occlusion, and the summaries of the server."""
        attacked = self.work / "attacked.jsonl.gz"
        write_lines(attacked, self.chosen(keypoints))
        # The occlusion needs no neighbours.
        neighbours = [] if attacks == "occlusion" else ["--neighbours", "predicted", "--train", self.map_keypoints]
        document = self.run.json("attack", attacked, "--server-matches", self.sent_problems(keypoints), *private, "--rotated-regions", turned,
                                 *neighbours, "--attacks", attacks, "--schemes", ",".join(schemes))  # fmt: skip
        rows = by_attack(document)
        for server in document["server"]:
            rows[server["scheme"]]["server"] = server
        return rows

    def attack_scene(self, schemes, attacks, neighbours, server, with_map, seals):
        """Rows of `veiloc attack` on the scene itself by scheme and attack."""
        attacked, chosen = self.work / "attacked.jsonl.gz", self.chosen(2048)
        write_lines(attacked, chosen + (self.map if with_map else []))
        known = ["--server-matches", self.sent_problems(2048)] if server else []
        return by_attack(self.run.json("attack", attacked, "--limit", len(chosen), "--attacks", attacks, "--schemes", ",".join(schemes),
                                       *neighbours, *known, "--frames", seals))  # fmt: skip

    def poses(self, scheme, keypoints=2048, turned=0):
        """The entry of the scheme, and the median error with lost queries as infinite."""
        problems = self.work / "poses.jsonl"
        with problems.open("w") as file:
            for problem, image in zip(self.of_queries, self.queries):
                keep = matched(problem, image, keypoints)
                if turned:
                    inside = regions(image, turned / 100)
                    keep = [kept and not inside(point) for kept, point in zip(keep, problem["points2d"])]
                file.write(json.dumps(with_matches(problem, keep)) + "\n")
        document = self.run.json(*POSES, problems, "--schemes", scheme)
        return document["schemes"][0], median_error(document)


POSES = ["eval", "pose", "--thresholds", "0.05/5,0.25/2"]


def median_error(document):
    """Median error of the position with lost queries as infinite."""
    errors = [query.get("translation_error") for query in document["queries"]]
    return statistics.median(math.inf if error is None else error for error in errors)


def by_attack(document):
    rows = {}
    for row in document["attacks"]:
        rows.setdefault(row["scheme"], {})[row["attack"]] = row
    return rows


def read_lines(path):
    with gzip.open(path, "rt") as lines:
        return [json.loads(line) for line in lines]


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


def places_of(run):
    return [Place(run, name) for name in run.places]


QUERIES = {"queries": (10, "attacked queries of each place, evenly spaced"), "places": PLACES}
FEW = QUERIES | {"queries": (6, QUERIES["queries"][1])}
PEOPLE = {"people": ("people", "folder of people, as `study privacy people` makes")}


@command("privacy/occlusion.csv", **QUERIES)
def occlusion(run):
    """Each scheme, on every place: what the occlusion in the matches tells."""
    table = run.table("privacy/occlusion.csv", "place", "scheme", "queries", "prior (px)", "occlusion (px)", "< 30 px, prior (%)",
                      "< 30 px, occlusion (%)", "bits, occlusion", "bits, best other attack", "AUC of private rows among unexplained ones")  # fmt: skip
    for place in places_of(run):
        for scheme, of_scheme in place.attack(["random-lines", "dcl"]).items():
            prior, found = of_scheme["prior"], of_scheme["occlusion"]
            other = max(row["bits_over_prior"] for name, row in of_scheme.items() if name not in ("prior", "occlusion", "server"))
            table.add([
                place.name, scheme, found["images"], f"{prior['median_px']:.0f}", f"{found['median_px']:.0f}",
                f"{100 * prior['under_30px']:.0f}", f"{100 * found['under_30px']:.0f}",
                f"{found['bits_over_prior']:.2f}", f"{other:.2f}", f"{found['hiding_auc']:.2f}",
            ])  # fmt: skip


@command("privacy/occlusion-defences.csv", **FEW)
def occlusion_defences(run):
    """dcl, averaged over places: what a device can do about the occlusion, and what that costs in poses."""
    table = run.table("privacy/occlusion-defences.csv", "defence", "bits, mean of places", "bits, range", "AUC, mean of places",
                      "recall lost at 5 cm and 5° (points)", "recall lost at 25 cm and 2° (points)", "worst place (points)",
                      "median error over none")  # fmt: skip
    places, base, layout = places_of(run), {}, "dcl:paper"
    for name, (keypoints, turned) in DEFENCES.items():
        found = []
        for place in places:
            row = place.attack([layout], keypoints, turned, "occlusion")
            of_occlusion = next(iter(row.values()))["occlusion"]
            pose, median = place.poses(layout, keypoints, turned)
            before, best = base.setdefault(place.name, (pose, median))
            lost = [100 * (before["recall"][t] - pose["recall"][t]) for t in ("0.05/5", "0.25/2")]
            found.append((of_occlusion["bits_over_prior"], of_occlusion["hiding_auc"], *lost, median / best))
        bits, auc, near, far, ratio = zip(*found)
        table.add([
            name, f"{statistics.mean(bits):.2f}", f"{min(bits):.2f} to {max(bits):.2f}", f"{statistics.mean(auc):.2f}",
            f"{statistics.mean(near):.1f}", f"{statistics.mean(far):.1f}", f"{max(far):.1f}",
            f"{statistics.geometric_mean(ratio):.2f}",
        ])  # fmt: skip


REGIONS = ["ellipses", "silhouettes", "people", "people, pasted"]


@command("privacy/persons.csv", needs="a segmentation network", **QUERIES, **PEOPLE)
def persons(run):
    """The occlusion with regions of the size of people: ellipses, silhouettes, masks of real people, and real people pasted into the images,
    whose own keypoints are attacked then. With --out, rows of places that are not measured are kept, and the means are of all."""
    columns = ["place", "regions", "scheme", "queries", "private rows (%)", "prior (px)", "occlusion (px)", "bits, occlusion",
               "AUC of private rows among unexplained ones"]  # fmt: skip
    path, rows = run.out and run.out / "privacy/persons.csv", []
    if path and path.exists():
        rows = [list(row.values()) for row in read_csv(path) if row["place"] not in [*run.places, "mean of places"]]
    for place in places_of(run):
        for kind in REGIONS:
            shown, private = place.region(kind)
            for scheme, found in shown.attack(["random-lines", "dcl"], private=private).items():
                prior, of_occlusion = found["prior"], found["occlusion"]
                rows.append([
                    place.name, kind, scheme, of_occlusion["images"], f"{100 * found['server']['measured']:.1f}",
                    f"{prior['median_px']:.0f}", f"{of_occlusion['median_px']:.0f}", f"{of_occlusion['bits_over_prior']:.2f}",
                    f"{of_occlusion['hiding_auc']:.2f}",
                ])  # fmt: skip
                print(*rows[-1], sep="  ", flush=True)
    table = run.table("privacy/persons.csv", *columns)
    for row in sorted(rows, key=lambda row: PLACES.index(row[0])):
        table.add(row)
    for kind, scheme in itertools.product(REGIONS, ["random-lines", "dcl"]):
        bits, auc = zip(*((float(row[7]), float(row[8])) for row in rows if row[1:3] == [kind, scheme]))
        table.add(["mean of places", kind, scheme, "", "", "", "", f"{statistics.mean(bits):.2f}", f"{statistics.mean(auc):.2f}"])


@command("privacy/person-defences.csv", needs="a segmentation network", **PEOPLE,
         **FEW | {"places": ["llff-room", "fountain", "entry", "herzjesu"]})  # fmt: skip
def person_defences(run):
    """dcl, the defences on regions of the size of people; what they cost is in the table of occlusion-defences."""
    table = run.table("privacy/person-defences.csv", "regions", "defence", "bits, mean of places", "bits, range", "AUC, mean of places")
    places = places_of(run)
    for kind in REGIONS:
        shown = [place.region(kind) for place in places]
        for name, (keypoints, turned) in DEFENCES.items():
            found = [next(iter(view.attack(["dcl:paper"], keypoints, turned, "occlusion", private).values()))["occlusion"] for view, private in shown]
            bits, auc = zip(*((row["bits_over_prior"], row["hiding_auc"]) for row in found))
            table.add([kind, name, f"{statistics.mean(bits):.2f}", f"{min(bits):.2f} to {max(bits):.2f}", f"{statistics.mean(auc):.2f}"])


# Adversaries that layouts are compared under.
LAYOUT_ADVERSARIES = ["upright occlusion", "wide occlusion", "pose, iterative", "eight seals", "nearby images", "statistic", "sessions"]
# Private regions: at least two an image, and this number a place.
LEAST_SEEDS, REGIONS_OF_PLACE = 2, 16
# A layout is admitted when no adversary has less than this share of its error under the paper's, or more of the rows under 30 px.
LEAST_ERROR, MOST_SHARE = 0.9, 0.03
# Sessions are slow: one place, and not the layouts that are outside of the limits without them.
SESSION_PLACE, SESSION_FRAMES = "redkitchen", "8"
NO_SESSIONS = ("stripes 138", "stripes 115", "upright strips, 0.5", "upright strips, 0.75", "slanted strips B")
ALSO = [
    "slanted strips A=dcl:axis=126:sectors=24:anchors=0.3/-0.42+-0.47/0.65",
    "slanted strips B=dcl:axis=126:sectors=24:anchors=0.35/-0.49+-0.41/0.57",
    "slanted strips C=dcl:axis=126:sectors=24:anchors=0.35/-0.49+-0.53/0.73",
]
ALSO_OPTION = {"also": (ALSO, "more layouts, NAME=LAYOUT")}
# Training photos that a statistic learns from, and those that are attacked.
FIRST, LAST = 400, 12
PHOTOS = {"photos": ("", "keypoints of other places, as `veiloc eval keypoints` writes them (default: of training photos)")}


def photos(run, part: str) -> Path:
    """Keypoints of the first or the last training photos by the SHA-256 of their names."""
    folder = run.place("training-photos")
    names = sorted((str(path.relative_to(folder)) for path in folder.rglob("*.jpg")),
                   key=lambda name: hashlib.sha256(name.encode()).hexdigest())  # fmt: skip
    listed = run.listed(part, names[:FIRST] if part == "first" else names[-LAST:])
    return run.made(run.kept() / f"{part}.jsonl.gz", "eval", "keypoints", folder, "--list", listed)


@command("privacy/layout-private.csv", "privacy/layout-private-means.csv",
         sessions=(6, "images that sessions are attacked on"), **ALSO_OPTION, **PHOTOS, **QUERIES | {"queries": 8})  # fmt: skip
def layout_private(run):
    """Layouts of dcl by the rule of decision 0058, in absolute errors.

    Private regions are upright, as a person, or wide, as a screen or a name plate: the same in images that are turned by a quarter, so
    that the attacker looks for wide regions too. Seals, nearby images and the statistic are measured on all rows, the others on private
    ones."""
    compared, found = {"paper": "dcl:paper"} | LAYOUTS | dict(also.split("=", 1) for also in run.also), {}
    rows = run.table("privacy/layout-private.csv", "place", "layout", "adversary", "baseline (px)", "attacker (px)",
                     "attacker < 30 px (%)", "bits")  # fmt: skip
    for place in places_of(run):
        for adversary, trials in layout_attacks(place, compared):
            for name, layout in compared.items():
                if layout not in trials[0]:
                    continue
                answers = [attacker(trial[layout]) for trial in trials]
                prior, error, share, bits = (statistics.mean(answer[k] for answer in answers) for k in range(4))
                found.setdefault((name, adversary), []).append((error, share, bits))
                rows.add([place.name, name, adversary, f"{prior:.1f}", f"{error:.1f}", f"{100 * share:.1f}", f"{bits:.2f}"])
    means = {of: (statistics.geometric_mean(error for error, *_ in all_of), statistics.mean(share for _, share, _ in all_of),
                  statistics.mean(bits for *_, bits in all_of)) for of, all_of in found.items()}  # fmt: skip
    table = run.table("privacy/layout-private-means.csv", "layout", *LAYOUT_ADVERSARIES, "outside the limits")
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
        table.add([name, *cells, "reference" if name == "paper" else "; ".join(beyond) or "none"])


def layout_attacks(place, compared):
    """Each adversary with its trials, one a seed: rows by layout and attack."""
    schemes, run = list(compared.values()), lambda *options: attack_rows(place, *options)
    chosen = place.chosen(2048)
    count = str(len(chosen))
    queries, with_map, turned = (place.work / f"{what}-{count}.jsonl.gz" for what in ("attacked", "attacked-with-map", "turned"))
    write_lines(queries, chosen)
    write_lines(with_map, chosen + place.map)
    problems = place.sent_problems(2048)
    given = ["--server-matches", problems, "--private", SHARE, "--neighbours", "predicted", "--train", place.map_keypoints]
    seeds = range(1, 1 + max(LEAST_SEEDS, math.ceil(REGIONS_OF_PLACE / len(chosen))))
    private = [run(queries, schemes, *given, "--attacks", "occlusion,server-side-points,iterative", "--seed", str(seed)) for seed in seeds]
    pick = lambda trial, *attacks: {scheme: {name: row for name, row in rows.items() if name in ("prior", *attacks)}
                                    for scheme, rows in trial.items()}  # fmt: skip
    yield "upright occlusion", [pick(trial, "occlusion") for trial in private]
    yield "pose, iterative", [pick(trial, "server-side-points", "iterative") for trial in private]
    # Images, problems and layouts a quarter turn to the left: upright regions of the program are wide ones then.
    known, size = place.work / "turned-problems.jsonl", chosen[0]
    write_lines(turned, [turned_image(image) for image in chosen])
    with problems.open() as lines, known.open("w") as out:
        out.writelines(json.dumps(turned_problem(json.loads(line))) + "\n" for line in lines)
    of_turned = {turned_layout(scheme, size["width"], size["height"]): scheme for scheme in schemes}
    trials = [run(turned, list(of_turned), "--server-matches", known, "--private", SHARE, "--attacks", "occlusion", "--seed", str(seed))
              for seed in seeds]  # fmt: skip
    yield "wide occlusion", [{of_turned[scheme]: rows for scheme, rows in trial.items()} for trial in trials]
    yield "eight seals", [run(queries, schemes, "--attacks", "static-camera", "--frames", "8")]
    yield "nearby images", [run(with_map, schemes, "--limit", count, "--attacks", "transfer")]
    yield "statistic", [run(queries, schemes, "--neighbours", "predicted", "--train", place.run.photos or photos(place.run, "first"),
                            "--attacks", "learned-prior,closed-form-consensus")]  # fmt: skip
    if place.name == SESSION_PLACE:
        yield "sessions", session_rows(place, [scheme for name, scheme in compared.items() if name not in NO_SESSIONS])


def attack_rows(place, file, schemes, *options):
    rows = {}
    for scheme in schemes:
        document = place.run.document("attack", file, *options, "--schemes", scheme)
        rows[scheme] = {row["attack"]: row for row in document["attacks"]}
    return rows


def session_rows(place, schemes):
    """Private rows of several images of a session, each layout by its best method, for a camera that turns and one that walks;
    shares are of 10 px here."""
    document = place.run.document(
        "eval", "sessions", *place.run.scene(place.name), "--anchors",
        "world", "--gyro-deg", "0", "--motion", "turning,walking", "--frames", SESSION_FRAMES, "--max-attacked",
        place.run.sessions, "--schemes", ",".join(schemes))  # fmt: skip
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
    "the pose; on keypoints without a map point": ("server-side-points,iterative", "map", True, False),
    "the pose and its map images; the same": ("guided-transfer", "oracle", True, True),
    "eight seals of one image": ("static-camera", "oracle", False, False),
}


@command("privacy/places.csv", **PHOTOS, **FEW)
def places(run):
    """Every realistic adversary under dcl, on the static scene itself."""
    rng, scheme, all_places = random.Random(0), "dcl:paper", places_of(run)
    table = run.table("privacy/places.csv", "scheme", "knows", *(place.name for place in all_places), "mean of places (bits)")
    for adversary, (attacks, neighbours, server, with_map) in ADVERSARIES.items():
        cells, bits = [], []
        for place in all_places:
            options = {
                "photos": ["--neighbours", "predicted", "--train", run.photos or photos(run, "first")],
                "map": ["--neighbours", "predicted", "--train", place.map_keypoints],
                "transferred": ["--neighbours", "transferred"], "oracle": [],
            }[neighbours]  # fmt: skip
            found = next(iter(place.attack_scene([scheme], attacks, options, server, with_map, 8).values()))
            best = max((row for name, row in found.items() if name != "prior"), key=lambda r: r["bits_over_prior"])
            bits.append(best["bits_over_prior"])
            cells.append(f"{best['median_px']:.0f} / {found['prior']['median_px']:.0f} ({bits[-1]:+.2f})")
        means = sorted(statistics.mean(rng.choices(bits, k=len(bits))) for _ in range(2000))
        table.add([scheme.removesuffix(":paper"), adversary, *cells,
                   f"{statistics.mean(bits):+.2f} ({means[100]:+.2f} to {means[1899]:+.2f})"])  # fmt: skip


LOST = 100


def hidden(problem, image, left):
    """The problem without the matches of one half of its image."""
    return with_matches(problem, [(u >= image["width"] / 2) == left for u, _ in problem["points2d"]])


def pose_cells(place):
    """Problems of each cell of a place: as it is, with a half of each image hidden, with a map of every tenth image where one can be
    built."""
    both = list(zip(place.of_queries, place.queries))
    found = {"as it is": place.of_queries}
    found["left half hidden"] = [hidden(problem, image, True) for problem, image in both]
    found["right half hidden"] = [hidden(problem, image, False) for problem, image in both]
    out, listed = place.work / "sparse.jsonl", place.work / "sparse.txt"
    listed.write_text("".join(f"{name}\n" for name in place.names[1][::10]))
    try:
        place.run.made(out, "eval", "problems", *place.run.posed(place.name), "--map-list", listed, "--query-list",
                       place.folder / "query.txt")  # fmt: skip
    except subprocess.CalledProcessError:
        return found
    return found | {"sparse map": [json.loads(line) for line in out.read_text().splitlines()]}


@command("privacy/layout-poses.csv", "privacy/layout-pose-means.csv", **ALSO_OPTION, **QUERIES)
def layout_poses(run):
    """Poses of layouts of dcl on every place, by the rule of decision 0058: the pose stage alone, on matches of the private rows.

    The figure of a cell is the median error of the position over that of points; a lost query counts as infinite. A cell in which
    points lose half of the queries is left out; a layout that loses half of them where points do not has the figure LOST."""
    schemes = {"points": "points", "paper": "dcl:paper"} | LAYOUTS | dict(also.split("=", 1) for also in run.also)
    figures = {label: [] for label in schemes}
    table = run.table("privacy/layout-poses.csv", "place", "cell", "layout", "queries", "within 25 cm and 2° (%)", "trusted",
                      "median error (map units)", "error over points")  # fmt: skip
    for place in places_of(run):
        for cell, problems in pose_cells(place).items():
            path = place.work / f"{cell.replace(' ', '-')}.jsonl"
            path.write_text("".join(json.dumps(problem) + "\n" for problem in problems))
            of_points = None
            for label, scheme in schemes.items():
                document = run.document(*POSES[:2], path, "--schemes", scheme, *POSES[2:])
                median, entry, queries = median_error(document), document["schemes"][0], len(document["queries"])
                of_points = median if of_points is None else of_points
                recall, trusted = 100 * entry["recall"]["0.25/2"], entry["trusted"]
                figure = min(LOST, median / of_points) if math.isfinite(of_points) else None
                if figure is not None:
                    figures[label].append((cell, figure, recall, 100 * trusted / queries, trusted))
                table.add([place.name, cell, label, queries, f"{recall:.0f}", trusted, f"{median:.4f}" if math.isfinite(median) else "",
                           "" if figure is None else f"{figure:.2f}"])  # fmt: skip
    names = ["as it is", "left half hidden", "right half hidden", "sparse map"]
    means = run.table("privacy/layout-pose-means.csv", "layout", "error over points, all cells", *names, "within 25 cm and 2° (%)",
                      "trusted (%)", "trusted poses")  # fmt: skip
    for label, of in figures.items():
        mean = lambda cell: f"{statistics.geometric_mean(figure for name, figure, *_ in of if cell in ('', name)):.2f}"
        recall, share, trusted = ([row[k] for row in of] for k in (2, 3, 4))
        means.add([label, mean(""), *map(mean, names), f"{statistics.mean(recall):.1f}", f"{statistics.mean(share):.1f}", sum(trusted)])
