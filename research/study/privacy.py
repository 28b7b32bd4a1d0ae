"""Tables of docs/results/privacy.md: adversaries, sessions, the paper's attack, edge images, the baseline.

Adversaries with networks need `--networks`, a folder with `neighbours.toml` and `SCHEME.toml`, as `research/train` writes them; without
it they are left out.
"""

import gzip
import json
import random
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from study import differences, hidden_people, people, private_rows, tilt  # noqa: F401  they register commands of this page
from study.common import PLACES, ROOT, SCENES, Package, cm, command, names_of
from study.private_rows import FIRST, photos

np, cv2 = Package("numpy"), Package("cv2")
SCHEMES = ["random-lines", "coordinate-permutation", "dcl"]
ATTACKED = 6
# Adversaries whose layouts of the graph are worth their time, and their attacked queries.
SLOW = {"map-server": 6, "true-neighbours": 2}
FRAMES = [2, 3, 5, 8]
# Frame of the anchors, orientation error, motions.
SESSIONS = [
    ("image", 0, "turning,walking,static"), ("world", 0, "turning,walking,static,visiting"), ("world", 0.1, "turning,walking"),
    ("world", 0.5, "turning"), ("gravity", 0, "turning,walking,visiting"),
]  # fmt: skip
# Name, error of each orientation, drift.
ORIENTATIONS = [
    ("none", 0, 0), ("0.1° a frame", 0.1, 0), ("0.5° a frame", 0.5, 0), ("1° a frame", 1, 0), ("drift of 0.05° a frame", 0, 0.05),
    ("drift of 0.2° a frame", 0, 0.2),
]  # fmt: skip
KNOWLEDGE = {
    "query-only-statistic": ("query only", "a statistic of descriptors of 400 out-of-map images"),
    "query-only-neighbours": ("query only", "a network of neighbours, trained on {} out-of-map images"),
    "query-only-network": ("query only", "a network from rows to positions, trained on {} out-of-map images"),
    "map-server": ("operator or anyone", "images from nearby viewpoints"),
    "pose-server": ("server", "the pose; on keypoints without a map point"),
    "pose-server-images": ("server", "the pose and its map images; the same keypoints"),
    "several-frames": ("server", "poses of 8 queries (Herz-Jesu 2), anchors fixed in each image"),
    "several-seals": ("anyone", "eight seals of one image"),
    "true-neighbours": ("oracle", "the true neighbours of every keypoint"),
}  # fmt: skip
QUERY_ONLY = ["query-only-statistic", "query-only-neighbours", "query-only-network"]
GPU = "networks that a GPU trains"
NETWORKS = {"networks": ("networks", "folder of trained networks")}


def adversaries(run, data: list, names: list[str], *options, networks=None) -> dict:
    """Rows by adversary and scheme, in the order of the names."""
    files = sorted(Path(networks).resolve().glob("*.toml")) if networks else []
    models = {
        "query-only-neighbours": ["--model", *(file for file in files if file.stem == "neighbours")],
        "query-only-network": ["--positions", *(file for file in files if file.stem in SCHEMES)],
    }  # fmt: skip
    rows = {}
    groups = [(ATTACKED, ["--quick"], [name for name in names if name not in SLOW])]
    groups += [(SLOW[name], [], [name]) for name in names if name in SLOW]
    for attacked, quick, own in groups:
        own = [name for name in own if len(models.get(name, "--")) > 1]
        if own:
            found = run.document("eval", "adversaries", *data, "--train", photos(run, "first"), "--adversaries", ",".join(own),
                                 *quick, *([] if "--keypoints" in data else ["--max-attacked", attacked]),
                                 *(word for name in own for word in models.get(name, [])), *options)  # fmt: skip
            rows |= {(row["adversary"], row["scheme"]): row for row in found["rows"]}
    return {key: row for name in names for key, row in rows.items() if key[0] == name}


def attack_name(row: dict) -> str:
    return f"{row['attack']}, {row['frames']}" if row.get("frames") is not None else row["attack"]


def precision(row: dict) -> str:
    """Share of the neighbours that are true."""
    return f"{100 * row['precision']:.1f}" if row.get("precision") is not None else ""


def attack_cells(row: dict) -> list[str]:
    return [attack_name(row), precision(row), f"{row['prior_median_px']:.0f}", f"{row['median_px']:.1f}",
            f"{100 * row['under_10px']:.1f}", f"{100 * row['under_30px']:.1f}", f"{row['bits_over_prior']:.2f}"]  # fmt: skip


ATTACK = ["best attack", "true neighbours (%)", "prior (px)", "median (px)", "< 10 px (%)", "< 30 px (%)", "bits"]


@command("privacy/schemes.csv", "privacy/adversaries.csv", needs=GPU, **NETWORKS,
         trained_on=("1479", "number of images that the networks have learned from"))  # fmt: skip
def schemes(run):
    """Every adversary under every scheme, six queries of RedKitchen and of Herz-Jesu; the oracle on two of each."""
    found = {name: adversaries(run, run.scene(place), list(KNOWLEDGE), networks=run.networks) for name, place in SCENES.items()}
    kitchen, church = found.values()
    few = [*range(4), 6]
    table = run.table("privacy/schemes.csv", "adversary", "scheme", *(f"RedKitchen: {column}" for column in ATTACK),
                      *(f"Herz-Jesu: {ATTACK[i]}" for i in few))  # fmt: skip
    for key, row in kitchen.items():
        other = attack_cells(church[key])
        table.add([*key, *attack_cells(row), *(other[i] for i in few)])
    of_dcl = [f"{place}, {column}" for place in SCENES for column in ("dcl median (px)", "prior (px)", "dcl (bits)")]
    shown = run.table("privacy/adversaries.csv", "adversary", "knows beside the query", *of_dcl,
                      *(f"{place}, random lines (bits)" for place in SCENES))  # fmt: skip
    for adversary, (who, knows) in KNOWLEDGE.items():
        if (adversary, "dcl") not in kitchen:
            continue
        cells = []
        for place in (kitchen, church):
            row = place[adversary, "dcl"]
            digits = 1 if row["median_px"] < 10 else 0
            cells += [f"{row['median_px']:.{digits}f}", f"{row['prior_median_px']:.0f}", f"{row['bits_over_prior']:.2f}"]
        lines = [f"{place[adversary, 'random-lines']['bits_over_prior']:.2f}" for place in (kitchen, church)]
        shown.add([who, knows.format(run.trained_on), *cells, *lines])


@command("privacy/out-of-map.csv", needs=GPU, **NETWORKS)
def out_of_map(run):
    """Query-only adversaries on the last twelve of the training photos, by the SHA-256 of their names."""
    table = run.table("privacy/out-of-map.csv", "adversary", "scheme", *ATTACK)
    found = adversaries(run, ["--keypoints", photos(run, "last")], [*QUERY_ONLY, "several-seals"], networks=run.networks)
    for key, row in found.items():
        table.add([*key, *attack_cells(row)])


@command("privacy/masks.csv", masks=("", "folder of the masks (default: drawn by research/notes/person_masks.py)"))
def masks(run):
    """RedKitchen with and without masks of people."""
    words = {
        "query-only-statistic": "query only, statistic", "map-server": "images from nearby", "pose-server": "a server that has the pose",
        "pose-server-images": "the same with the map's images", "several-frames": "eight frames",
        "several-seals": "eight seals",
    }  # fmt: skip
    folder = Path(run.masks) if run.masks else run.kept() / "masks"
    if not run.masks:
        place = run.place("redkitchen")
        subprocess.run([sys.executable, ROOT / "research/notes/person_masks.py", "--images", place / "images", "--list",
                        place / "query.txt", "--out", folder], check=True)  # fmt: skip
    data = run.scene("redkitchen")
    without = adversaries(run, data, list(words), "--schemes", "dcl")
    with_masks = adversaries(run, data, list(words), "--schemes", "dcl", "--masks", folder)
    table = run.table("privacy/masks.csv", "adversary", "without masks (bits)", "with masks (bits)")
    for (name, scheme), row in without.items():
        table.add([words[name], f"{row['bits_over_prior']:.2f}", f"{with_masks[name, scheme]['bits_over_prior']:.2f}"])


def bits_of(rows: list[dict], **like) -> str:
    """The best attack among rows with these values."""
    bits = [row["bits_over_prior"] for row in rows if all(row[key] == value for key, value in like.items())]
    bits = [value for value in bits if value is not None]
    return f"{max(bits):.2f}" if bits else ""


def eval_sessions(run, frames, *options) -> list[dict]:
    return run.document("eval", "sessions", *run.scene("redkitchen"), "--schemes", "dcl", "--max-attacked", run.attacked,
                        "--frames", ",".join(map(str, frames)), *options)["rows"]  # fmt: skip


IN_SESSION = {"attacked": (5, "attacked images in a session")}


@command("privacy/sessions.csv", **IN_SESSION)
def sessions(run):
    """Several images of a place, by motion of the camera and frame of the anchors."""
    rows = eval_sessions(run, FRAMES, "--anchors", "image,world,gravity", "--gyro-deg", 0, "--motion", "turning,walking,static,visiting")
    rows += eval_sessions(run, FRAMES, "--anchors", "world", "--gyro-deg", "0.1,0.5", "--motion", "turning,walking")
    table = run.table("privacy/sessions.csv", "anchors fixed in", "orientation error (°)", "motion",
                      *(f"{target}, {n} images (bits)" for target in ("private", "matched") for n in FRAMES))  # fmt: skip
    for anchors, error, motions in SESSIONS:
        for motion in motions.split(","):
            like = {"anchors": anchors, "gyro_deg": error, "motion": motion}
            cells = [bits_of(rows, **like, target=target, frames=n) for target in ("private", "matched") for n in FRAMES]
            table.add([anchors, "" if anchors == "image" else f"{error:g}", motion, *cells])


@command("privacy/orientation.csv", **IN_SESSION)
def orientation(run):
    """Sessions whose orientations are wrong."""
    frames, options = [2, 4, 8, 16, 29], ["--anchors", "world", "--motion", "turning"]
    rows = eval_sessions(run, frames, *options, "--gyro-deg", "0,0.1,0.5,1", "--drift-deg", 0)
    rows += eval_sessions(run, frames, *options, "--gyro-deg", 0, "--drift-deg", "0.05,0.2")
    table = run.table("privacy/orientation.csv", "orientation error about each axis",
                      *(f"{target}, {n} images (bits)" for target in ("private", "matched") for n in frames))  # fmt: skip
    for name, gyro, drift in ORIENTATIONS:
        like = {"gyro_deg": gyro, "drift_deg": drift}
        table.add([name, *(bits_of(rows, **like, target=target, frames=n) for target in ("private", "matched") for n in frames)])


def attacks(run, *words) -> list[dict]:
    return run.document("attack", *words)["attacks"]


def keypoints_of(run, name: str) -> Path:
    return run.place(f"problems/{SCENES[name]}_keypoints.jsonl.gz")


@command("privacy/scene.csv")
def scene(run):
    """The paper's synthetic scene."""
    table = run.table("privacy/scene.csv", "scheme", "attack", "mean (px)", "median (px)", "< 5 px (%)", "< 10 px (%)", "< 30 px (%)",
                      "bits", "time (ms)")  # fmt: skip
    for row in attacks(run, "--synthetic", 1500, "--attacks", "prior,closed-form,closed-form-informed,graph"):
        if row["attack"] == "closed-form-informed" and row["scheme"] != "dcl":
            continue
        is_prior = row["attack"] == "prior"
        shares = [f"{100 * row[key]:.1f}" for key in ("under_5px", "under_10px", "under_30px")]
        table.add([row["scheme"], row["attack"], f"{row['mean_px']:.1f}", f"{row['median_px']:.1f}", *shares,
                   "0" if is_prior else f"{row['bits_over_prior']:.2f}", "" if is_prior else f"{float('%.2g' % row['ms']):g}"])  # fmt: skip


@command("privacy/seals.csv")
def seals(run):
    """Several seals of one image, and several images of a camera at rest, from the keypoints of `problems`."""
    found = []
    for noise in (0, 0.4):
        rows = attacks(run, keypoints_of(run, "RedKitchen"), "--schemes", "dcl", "--attacks", "static-camera", "--frames",
                       "2,8,32", "--limit", 6, "--static-noise", noise)  # fmt: skip
        found.append({row["frames"]: row for row in rows if row["attack"] == "static-camera"})
    table = run.table("privacy/seals.csv", "seals or images", "seals of one image: median (px)", "seals: < 10 px (%)", "seals: bits",
                      "new images: median (px)", "new images: < 10 px (%)", "new images: bits")  # fmt: skip
    cells = lambda row: [f"{row['median_px']:.1f}", f"{100 * row['under_10px']:.1f}", f"{row['bits_over_prior']:.2f}"]
    for n in (2, 8, 32):
        table.add([n, *cells(found[0][n]), *cells(found[1][n])])


@command("privacy/paper.csv")
def paper(run):
    """The paper's attack on the keypoints of `problems`, beside the paper's figures."""
    table = run.table("privacy/paper.csv", "source", "images", "scheme", "closed-form attack, mean (px)", "prior-only baseline, mean (px)")
    for scheme, mean in (("random-lines", "6.137"), ("coordinate-permutation", "10.56"), ("dcl:paper", "330.4")):
        table.add(["paper", "7Scenes", scheme, mean, ""])
    for name, few, all_of_dcl in (("RedKitchen", 4, 22), ("Herz-Jesu", 2, 8)):
        for of_schemes, limit in (("random-lines,coordinate-permutation", few), ("dcl:paper", all_of_dcl)):
            rows = attacks(run, keypoints_of(run, name), "--limit", limit, "--schemes", of_schemes, "--attacks", "closed-form")
            mean = {(row["scheme"], row["attack"]): f"{row['mean_px']:.1f}" for row in rows}
            for scheme in of_schemes.split(","):
                table.add(["veiloc", f"{name}, {limit} images", scheme, mean[scheme, "closed-form"], mean[scheme, "prior"]])


@command("privacy/session-poses.csv")
def session_poses(run):
    """Poses of sessions, by frame of the anchors."""
    table = run.table("privacy/session-poses.csv", "scene", "anchors fixed in", "keypoints", "queries", "trusted", "median error (cm)",
                      "median error (°)")  # fmt: skip
    for name, place in SCENES.items():
        # What several images tell is in the table of sessions; here they are few, for their poses.
        found = run.document("eval", "sessions", *run.scene(place), "--schemes", "dcl", "--anchors", "image,world,gravity",
                             "--motion", "turning", "--gyro-deg", 0, "--frames", 2, "--max-attacked", 1)  # fmt: skip
        for row in found["frames"]:
            table.add({"scene": name, "anchors fixed in": row["anchors"], "keypoints": f"{row['keypoints']:.0f}"}, row)


@command("privacy/false-neighbours.csv")
def false_neighbours(run):
    """The graph attack with neighbours of which a share is false."""
    shares = [0, 10, 20, 30, 40, 50]
    attacked = {"synthetic": ["--synthetic", 1500]}
    attacked |= {name: [keypoints_of(run, name), "--limit", limit] for name, limit in (("RedKitchen", 4), ("Herz-Jesu", 2))}
    found = {}
    for name, data in attacked.items():
        rows = attacks(run, *data, "--schemes", "dcl", "--attacks", "graph", "--corrupt", ",".join(map(str, shares)))
        found[name] = {round(row["corrupt"]): row for row in rows if row["attack"] == "graph"}
    table = run.table("privacy/false-neighbours.csv", "false neighbours (%)",
                      *(f"{name}, {key} (px)" for name in found for key in ("mean", "median")))  # fmt: skip
    for share in shares:
        table.add([share, *(f"{rows[share][key]:.1f}" for rows in found.values() for key in ("mean_px", "median_px"))])


def scene_rows(run, place: str, *options) -> list[dict]:
    return run.document("eval", "scene", *run.scene(place), *options)["schemes"]


@command("privacy/steps.csv")
def steps(run):
    """Queries that are sent in steps, beside whole ones."""
    of = lambda what: [f"{what}, {how}" for how in ("whole", "in steps")]
    table = run.table("privacy/steps.csv", "scene", "scheme", *of("rows"), *of("kB"), *of("exposed rows"),
                      *(f"median ({unit}), {how}" for how in ("whole", "in steps") for unit in ("cm", "°")))  # fmt: skip
    for name, place in SCENES.items():
        options = ["--schemes", ",".join(["points", *SCHEMES]), "--query-keypoints", 1024]
        for both in zip(scene_rows(run, place, *options), scene_rows(run, place, *options, "--progressive")):
            counts = [f"{row[key] / unit:.0f}" for key, unit in (("mean_rows", 1), ("mean_bytes", 1000), ("mean_exposed", 1))
                      for row in both]  # fmt: skip
            table.add([name, both[0]["scheme"], *counts,
                       *(cell for row in both for cell in (cm(row["median_translation"]), f"{row['median_rotation_deg']:.3f}"))])  # fmt: skip


@command("privacy/keypoints.csv")
def keypoints(run):
    """Poses with fewer keypoints."""
    table = run.table("privacy/keypoints.csv", "scene", "keypoints sent", "queries", "localized", "trusted", "median error (cm)",
                      "median error (°)")  # fmt: skip
    for name, place in SCENES.items():
        for count in (2048, 256):
            (row,) = scene_rows(run, place, "--schemes", "dcl", "--query-keypoints", count)
            table.add({"scene": name, "keypoints sent": count}, row)


THRESHOLDS = (100, 200)


def edge_files(source, target, names):
    for name in names:
        path = target / name
        path.parent.mkdir(parents=True, exist_ok=True)
        gray = cv2.imread(str(source / name), cv2.IMREAD_GRAYSCALE)
        # Thin lines have no scale; a little blur gives them one.
        found = cv2.GaussianBlur(255 - cv2.Canny(gray, *THRESHOLDS), (0, 0), 1.0)
        cv2.imwrite(str(path), found, [cv2.IMWRITE_JPEG_QUALITY, 95])


@command("privacy/edges.csv", places=["llff-room", "redkitchen", "herzjesu"])
def edges(run):
    """Edge images (Canny) with the same pipeline as photographs, beside line schemes on the photographs: map and queries of a place are
    replaced by their edge images, and the queries sent as points."""
    table = run.table("privacy/edges.csv", "place", "sent", "queries", "trusted", "within 5 cm and 5° (%)", "within 25 cm and 2° (%)",
                      "median error (map units)", "median error (°)")  # fmt: skip
    for place in run.places:
        folder = run.place(place)
        with tempfile.TemporaryDirectory() as work:
            edge_files(folder / "images", Path(work), names_of(folder / "map.txt") + names_of(folder / "query.txt"))
            for what, images, of in [("edge images", Path(work), "points"), ("photographs", folder / "images", "points,dcl")]:
                found = run.json("eval", "scene", *run.scene(place, images), "--schemes", of, "--thresholds", "0.05/5,0.25/2")
                for row in found["schemes"]:
                    recall = {f"within {text} (%)": f"{100 * row['recall'][key]:.0f}"
                              for text, key in (("5 cm and 5°", "0.05/5"), ("25 cm and 2°", "0.25/2"))}  # fmt: skip
                    table.add({"place": place, "sent": f"{what}, {row['scheme']}"} | recall, row)


@command(orders=(3, "random orders of the other images"))
def session_scenes(run):
    """What a session recognizes: images of other places after two of one, and images of that place after many of others (decision 0046).

    Two images of Herz-Jesu are sealed in a session, without orientation. A session allows two starts for one place, so:
    - other places: each of 60 other images (39 photographs, seven of Fountain, Entry and RedKitchen each), on a copy of the session;
      each that is refused was taken for Herz-Jesu.
    - the same place: each other image of Herz-Jesu, on a copy; each that is sealed gets a third start.
    - after others: the same once the session has seen the 60 images, in random order; images of Fountain and of Entry beyond the
      second are counted too."""
    images_of = lambda place: [run.place(place) / "images" / name for name in names_of(run.place(place) / "map.txt")]
    own, others = images_of("herzjesu"), sorted(run.place("photos").glob("*.jpg"))
    for images in map(images_of, ("fountain", "entry", "redkitchen")):
        others += [images[i * len(images) // 7] for i in range(7)]
    with tempfile.TemporaryDirectory() as work:
        profile, first, copied, going = (Path(work) / name for name in ("profile", "session", "copy", "going"))
        run.run("map", "profile", run.map("herzjesu"), "-o", profile, "--quiet")

        def is_sealed(session: Path, image: Path) -> bool:
            found = subprocess.run([run.veiloc, "seal", image, "--profile", profile, "--camera", "unknown", "--session", session,
                                    "-o", Path(work) / "query", "--quiet"], capture_output=True, text=True)  # fmt: skip
            if found.returncode and "images of this scene" not in found.stderr:
                raise RuntimeError(found.stderr)
            return found.returncode == 0

        def on_copies(session: Path, images: list[Path]) -> int:
            return sum(is_sealed(Path(shutil.copy(session, copied)), image) for image in images)

        assert all(is_sealed(first, image) for image in (own[0], own[3]))
        rest = [image for image in own if image not in (own[0], own[3])]
        print(f"other places: {len(others) - on_copies(first, others)} of {len(others)} refused", flush=True)
        print(f"the same place: {on_copies(first, rest)} of {len(rest)} sealed", flush=True)
        for seed in range(run.orders):
            shutil.copy(first, going)
            order, starts, third = others.copy(), {}, 0
            random.Random(seed).shuffle(order)
            for image in order:
                place = image.parent.parent.name
                if is_sealed(going, image) and place in ("fountain", "entry"):
                    starts[place] = starts.get(place, 0) + 1
                    third += starts[place] > 2
            print(f"after others, order {seed}: {on_copies(going, rest)} of {len(rest)} sealed; Fountain and Entry beyond two: "
                  f"{third} sealed; {going.stat().st_size} bytes", flush=True)  # fmt: skip


# The answers from a single line alone (`crates/research/attacks/src/prior.rs`).
SHARES, BITS_FLOOR_PX = [share / 100 for share in range(40, 76, 2)], 1.0


def half_lines(points, width, height):
    """Anchor, direction, length and true distance on the half-lines of the paper's layout."""
    anchors = np.where(points[:, :1] < width / 2, [[width / 2, 0.0]], [[width / 2, float(height)]])
    toward = points - anchors
    distance = np.linalg.norm(toward, axis=1)
    direction = toward / np.maximum(distance, 1e-9)[:, None]
    ends = np.where(direction > 0, [width, height], 0) - anchors
    with np.errstate(divide="ignore", invalid="ignore"):
        length = np.nanmin(np.where(direction != 0, ends / direction, np.inf), axis=1)
    return anchors, direction, length, distance


def dcl(points, width, height, rng):
    anchors, direction, length, _ = half_lines(points, width, height)
    # A wedge widens with the distance, so a share of its area is the square of a share of its length.
    at = lambda share: anchors + (np.sqrt(share) * length)[:, None] * direction
    return {f"share {s:.2f}": at(s) for s in SHARES} | {"mean": anchors + (2 / 3 * length)[:, None] * direction}


def random_lines(points, width, height, rng):
    turn = rng.uniform(0, np.pi, len(points))
    direction = np.stack([np.cos(turn), np.sin(turn)], 1)
    with np.errstate(divide="ignore"):
        ends = np.stack([-points / direction, ([width, height] - points) / direction])
    near, far = np.minimum(*ends).max(1), np.maximum(*ends).min(1)
    at = lambda share: points + (near + share * (far - near))[:, None] * direction
    return {f"share {s:.2f}": at(s) for s in SHARES}


def permutation(points, width, height, rng):
    order = rng.permutation(len(points))[: len(points) // 2 * 2].reshape(-1, 2)
    sent, true = [], []
    for first, second in order:
        axis = rng.integers(2)
        a, b = points[first].copy(), points[second].copy()
        a[axis], b[axis] = b[axis], a[axis]
        sent += [a, b]
        true += [first, second]
    sent, middle = np.array(sent), np.array([width / 2, height / 2])
    answers = {
        "mean of both lines": (sent + middle) / 2,
        "crossing": sent,
        "middle of the shorter line": np.where([width > height, width <= height], sent, middle),
    }
    answers |= {f"{w:.1f} of the crossing": w * sent + (1 - w) * middle for w in (0.6, 0.7, 0.8, 0.9)}
    return answers, points[true]


def images(path, most):
    with gzip.open(path, "rt") as lines:
        for _, line in zip(range(most), lines):
            image = json.loads(line)
            yield np.array(image["keypoints"], float).reshape(-1, 2), image["width"], image["height"]
ANSWERS = [("dcl", dcl), ("random-lines", random_lines), ("coordinate-permutation", permutation)]


def errors(points, width, height, make, rng):
    """Error of each keypoint by answer, pixels, at most the diagonal."""
    answers = make(points, width, height, rng)
    answers, truth = answers if isinstance(answers, tuple) else (answers, points)
    diagonal = np.hypot(width, height)
    return {name: np.clip(np.linalg.norm(at - truth, axis=1), BITS_FLOOR_PX, diagonal) for name, at in answers.items()}
# Scheme: the mean point, the best answer for bits, the best answer for medians.
CHOSEN = {
    "dcl": ("mean", "share 0.52", "share 0.58"),
    "coordinate-permutation": ("mean of both lines", "crossing", "0.8 of the crossing"),
}


@command("privacy/baseline.csv", places=PLACES, images=(FIRST, "at most this many images of a place"))
def baseline(run):
    """The best answers from a single line, beside the mean point of the line."""
    rng = np.random.default_rng(0)
    table = run.table("privacy/baseline.csv", "place", "scheme", "images", "best answer over the mean point (bits)", "mean point (px)",
                      "best answer (px)")  # fmt: skip
    for place in run.places:
        file = run.kept() / f"{place}-keypoints.jsonl.gz"
        run.made(run.kept() / f"{place}-problems.jsonl", "eval", "problems", *run.scene(place), "--keypoints", file)
        for scheme, make in ANSWERS:
            if scheme not in CHOSEN:
                continue
            mean, for_bits, for_pixels = CHOSEN[scheme]
            found = []
            for points, width, height in images(file, run.images):
                error = errors(np.unique(points, axis=0), width, height, make, rng)
                gain = np.log2(error[mean] / error[for_bits]).mean()
                found.append((gain, np.median(error[mean]), np.median(error[for_pixels])))
            gain, before, after = np.mean(found, axis=0)
            table.add([place, scheme, len(found), f"{gain:.2f}", f"{before:.0f}", f"{after:.0f}"])


@command(images=(400, "at most this many images"), keypoints=("", "as `veiloc eval keypoints` writes them (default: of training photos)"))
def fit_baseline(run):
    """Fits the answers from a single line: for each scheme and answer the mean over images of the median error, relative to the image's
    diagonal, and the mean of log2 of the error. The best answer of each column is the baseline of that measure."""
    rng, found, best = np.random.default_rng(0), {}, {}
    for points, width, height in images(run.keypoints or photos(run, "first"), run.images):
        if len(points) < 20:
            continue
        diagonal = np.hypot(width, height)
        for scheme, make in ANSWERS:
            for name, error in errors(points, width, height, make, rng).items():
                values = np.median(error) / diagonal, np.log2(error / diagonal).mean()
                found.setdefault((scheme, name), []).append(values)
    for (scheme, name), values in found.items():
        median, bits = np.mean(values, axis=0)
        print(f"{scheme:24} {name:28} median {100 * median:6.2f} % of the diagonal   log2 of the error {bits:+.3f}")
        for measure, value in (("median", median), ("bits", bits)):
            if (scheme, measure) not in best or value < best[scheme, measure][0]:
                best[scheme, measure] = value, name
    for (scheme, measure), (_, name) in best.items():
        print(f"best of {scheme} for {measure}: {name}")
