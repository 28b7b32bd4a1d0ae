#!/usr/bin/env python3
"""Makes the tables of docs/results, each by one command, and notes for each the commit, the command and the machine.

    scripts/figures.sh                      # everything that this machine can make; hours
    scripts/figures.sh poses trust/stress.csv      # one page, one table
    scripts/figures.py --list               # the tables, with their commands
    scripts/figures.py --check              # every table has a command here and a line in docs/results/figures.csv

A table is made again unless it was made at this commit with this program and work folder; `--again` makes it in any case. Documents of
commands that ended are kept in the work folder, so a run that was interrupted goes on. Times depend on what else the machine does.
Tables that need a GPU, networks that were trained on one, an older build or another kind of machine are only listed, with their
commands.

`$D`: VEILOC_DATA, `$V`: the program, `$O`: docs/results, `$W`: the work folder, `$P`: this Python, `$R`: target/release.
"""

import argparse
import ast
import csv
import hashlib
import os
import platform
import re
import shutil
import statistics
import string
import subprocess
import sys
import time
from collections import defaultdict
from pathlib import Path

from places import kept_document, write_csv

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "docs/results"
LOG = RESULTS / "figures.csv"
COLUMNS = ["table", "command", "commit", "machine", "minutes"]
SCENES = {"RedKitchen": "redkitchen", "Herz-Jesu": "herzjesu"}
ALL = ["points", "random-lines", "coordinate-permutation", "dcl", "dcl:paper"]
LINES = ["points", "random-lines", "dcl:paper"]
RIGHT = "0.25/2"
# What the scripts of the commands below import, and its package.
PACKAGES = {"PIL": "pillow", "cv2": "opencv-python-headless", "h5py": "h5py", "numpy": "numpy", "onnxruntime": "onnxruntime",
            "poselib": "poselib", "pycolmap": "pycolmap"}  # fmt: skip


class Run:
    """Runs commands of veiloc, and keeps the documents of those that ended."""

    def __init__(self, args):
        self.veiloc, self.data, self.work = args.veiloc, args.data, args.work

    def document(self, *command) -> dict:
        """What a command prints with `--json`."""
        return kept_document(self.veiloc, self.work, *command)

    def made(self, file: Path, *command) -> Path:
        """A file that a command writes; kept, so that it runs once."""
        if not file.exists():
            subprocess.run([self.veiloc, *map(str, command)], check=True, stdout=subprocess.DEVNULL)
        return file

    def scene(self, folder: str) -> list:
        """Options that select a scene: a folder of the data, `lund-door`, or `rendered`."""
        place = self.data / folder
        if folder == "rendered":
            place = self.work / "demo"
            self.made(place / "place.vmap", "demo", "--quiet", "--out", place)
            names = sorted(path.name for path in (place / "images").iterdir())
            lists = {"map": [n for n in names if n.startswith("map-")], "query": [n for n in names if n.startswith("query-")]}
        elif folder == "lund-door":
            # It has no query images: every third image is left out of the map and is a query.
            names = sorted(path.name for path in (place / "images").iterdir())
            lists = {"map": [n for i, n in enumerate(names) if i % 3 != 1], "query": names[1::3]}
        else:
            return ["--posed", place / "posed", "--images", place / "images", "--map-list", place / "map.txt",
                    "--query-list", place / "query.txt"]  # fmt: skip
        for kind, own in lists.items():
            (self.work / f"{folder}-{kind}.txt").write_text("".join(f"{name}\n" for name in own))
        posed = place / ("sparse" if folder == "lund-door" else "posed")
        return ["--posed", posed, "--images", place / "images", "--map-list", self.work / f"{folder}-map.txt",
                "--query-list", self.work / f"{folder}-query.txt"]  # fmt: skip

    def map(self, folder: str) -> Path:
        """The map of a scene, with its self-test."""
        options = self.scene(folder)
        file = self.work / f"{folder}.vmap"
        return self.made(file, "map", "build", "--quiet", *options[:4], "--list", options[5], "-o", file)


FIGURES: dict = {}


def figure(*tables: str):
    """Registers a function that makes tables."""

    def add(make):
        for table in tables:
            FIGURES[table] = (tables, make)
        return make

    return add


def script(command: str, *tables: str, by_hand: str = ""):
    """Registers a command that makes tables; `by_hand` says why it does not run here."""
    for table in tables:
        FIGURES[table] = (tables, by_hand, command)


def number(value, form: str) -> str:
    return "" if value is None else format(value, form)


def percent(share, digits: int = 1) -> str:
    return number(None if share is None else 100 * share, f".{digits}f")


def cm(value) -> str:
    return number(None if value is None else 100 * value, ".2f")


@figure("poses/schemes.csv", "poses/paper.csv", "trust/coverage.csv")
def scenes(run: Run) -> list[tuple]:
    schemes, cover = [], []
    paper = [
        ["paper", "7Scenes RedKitchen", "HLoc, SuperPoint + NN, points", "0.5", "0.14", "95"],
        ["paper", "7Scenes RedKitchen", "random lines", "0.7", "0.20", "94"],
        ["paper", "7Scenes RedKitchen", "dcl:paper", "1.4", "0.42", "84"],
    ]
    cells = [("RedKitchen", "redkitchen", 2048), ("Herz-Jesu", "herzjesu", 2048), ("Herz-Jesu", "herzjesu", 4096),
             ("Lund door", "lund-door", 2048), ("rendered room", "rendered", 2048)]  # fmt: skip
    for scene, folder, keypoints in cells:
        found = run.document("eval", "scene", *run.scene(folder), "--schemes", ",".join(ALL), "--query-keypoints", keypoints,
                             "--thresholds", "0.05/5,0.25/2")  # fmt: skip
        for row in found["schemes"]:
            own = [q for q in found["queries"] if q["scheme"] == row["scheme"]]
            if folder in SCENES.values():
                schemes.append([
                    scene, keypoints, row["scheme"], f"{row['median_hypotheses']:.0f}", row["queries"], row["localized"],
                    row["trusted"], cm(row["median_translation"]), number(row["median_rotation_deg"], ".3f"),
                    row["sealed_bytes"],
                ])  # fmt: skip
            if folder == "redkitchen" and row["scheme"] in LINES:
                paper.append(["veiloc", "RedKitchen seq-01 hold-out", row["scheme"].replace("-", " "), cm(row["median_translation"]),
                              number(row["median_rotation_deg"], ".3f"), percent(row["recall"]["0.05/5"], 0)])  # fmt: skip
            over = [q["center_error_over_sd"] for q in own if q["state"] == "trusted" and q.get("center_error_over_sd") is not None]
            if keypoints == 2048 and row["trusted"]:
                regions = [percent(row[kind][share]) for kind in ("coverage", "coverage_pose") for share in ("50", "90", "99")]
                cover.append([scene, row["scheme"], row["trusted"], *regions, number(statistics.median(over), ".2f")])
    regions = [f"{what} in {share} % region (%)" for what in ("centre", "pose") for share in (50, 90, 99)]
    return [
        (["scene", "keypoints", "scheme", "hypotheses (median)", "queries", "localized", "trusted", "median error (cm)",
          "median error (°)", "query (bytes)"], schemes),
        (["source", "images", "method", "median error (cm)", "median error (°)", "recall at 5 cm and 5° (%)"], paper),
        (["scene", "scheme", "trusted", *regions, "error over ± (median)"], cover),
    ]  # fmt: skip


@figure("poses/collapse.csv")
def collapse(run: Run) -> list[tuple]:
    found = run.document("eval", "scene", *run.scene("redkitchen"), "--schemes", "dcl:paper", "--scores", "msac,likelihood",
                         "--hypotheses", 1000, "--no-prior", "--thresholds", "0.05/5")  # fmt: skip
    names = {"msac": "MSAC on the distance to the line (paper)"}
    rows = []
    for row in found["schemes"]:
        inliers = percent(row["mean_inlier_ratio"]) if row["localized"] else ""
        rows.append([names.get(row["score"], row["score"]), 1000, row["queries"], row["localized"], cm(row["median_translation"]),
                     number(row["median_rotation_deg"], ".3f"), percent(row["recall"]["0.05/5"]), inliers])  # fmt: skip
    return [(["score", "hypotheses", "queries", "localized", "median error (cm)", "median error (°)", "within 5 cm and 5° (%)",
              "inliers (%)"], rows)]  # fmt: skip


@figure("poses/recipes.csv")
def recipes(run: Run) -> list[tuple]:
    rows = []
    for problem in ("redkitchen_nn", "redkitchen_r08", "herzjesu_nn", "herzjesu_r08"):
        threshold = "0.05/5" if problem.startswith("redkitchen") else "0.1/1"
        common = ["eval", "pose", run.data / f"problems/{problem}.jsonl.gz", "--seeds", 5, "--thresholds", threshold, "--schemes",
                  ",".join(LINES), "--recipes"]  # fmt: skip
        searched = run.document(*common, "paper,likelihood,likelihood+prior,vote", "--hypotheses", 1000)["schemes"]
        oracles = run.document(*common, "optimum", "--oracle", "--hypotheses", "adaptive")["schemes"]
        by = {(row["recipe"], row["scheme"]): row for row in [*oracles, *searched]}
        for recipe in dict.fromkeys(name for name, _ in [*((r["recipe"], 0) for r in searched), *((r["recipe"], 0) for r in oracles)]):
            cells = [c for scheme in LINES for row in [by[recipe, scheme]]
                     for c in (percent(row["recall"][threshold]), cm(row["median_translation"]))]  # fmt: skip
            rows.append([problem, recipe, *cells])
    columns = [f"{scheme} {what}" for scheme in LINES for what in ("recall (%)", "median (cm)")]
    return [(["matches of", "recipe", *columns], rows)]


@figure("poses/data-sets.csv")
def data_sets(run: Run) -> list[tuple]:
    """A rendered place in the files of each data set: what a reader with the data runs, from end to end."""
    rows = []
    for layout in ("7scenes", "cambridge", "aachen", "aachen-v1.1"):
        root = run.work / layout
        if not root.exists():
            subprocess.run([run.veiloc, "synth", "export", "--quiet", "--layout", layout, "--out", root], check=True)
        truth = ["--truth", root / "queries/poses.txt"] if layout.startswith("aachen") else []
        found = run.document("eval", "dataset", layout.removesuffix("-v1.1"), "--root", root, "--jobs", 1, *truth)
        for row in found["schemes"]:
            best = list(row["recall"])[0]
            rows.append([layout, row.get("condition", ""), row["scheme"], row["queries"], row["localized"], cm(row["median_translation"]),
                         number(row["median_rotation_deg"], ".3f"), best, percent(row["recall"][best])])  # fmt: skip
    return [(["layout", "condition", "scheme", "queries", "localized", "median error (cm)", "median error (°)",
              "smallest threshold (m/°)", "within it (%)"], rows)]  # fmt: skip


@figure("poses/ablations.csv")
def ablations(run: Run) -> list[tuple]:
    """The paper's ablations: more partitions, and halves that lie beside each other."""
    names = {"points": "points", "random-lines": "random lines", "dcl:paper": "dcl:paper", "dcl:s=2": "dcl, s = 2", "dcl:s=3": "dcl, s = 3",
             "dcl:horizontal": "dcl, halves side by side"}  # fmt: skip
    rows = []
    for scene, folder in SCENES.items():
        found = run.document("eval", "scene", *run.scene(folder), "--schemes", ",".join(names), "--thresholds", "0.05/5,0.25/2")
        for row, name in zip(found["schemes"], names.values()):
            rows.append([scene, name, row["queries"], row["localized"], row["trusted"], cm(row["median_translation"]),
                         number(row["median_rotation_deg"], ".3f"), percent(row["recall"]["0.05/5"]), percent(row["recall"][RIGHT])])  # fmt: skip
    return [(["scene", "scheme", "queries", "localized", "trusted", "median error (cm)", "median error (°)", "within 5 cm and 5° (%)",
              "within 25 cm and 2° (%)"], rows)]  # fmt: skip


@figure("trust/out-of-map.csv")
def out_of_map(run: Run) -> list[tuple]:
    rows = []
    for scene, folder, schemes in [("RedKitchen", "redkitchen", ALL), ("Herz-Jesu", "herzjesu", ALL), ("Lund door", "lund-door", LINES),
                                   ("rendered room", "rendered", LINES)]:  # fmt: skip
        found = run.document("eval", "negatives", "--map", run.map(folder), "--images", run.data / "training-photos", "--split", "final",
                             "--schemes", ",".join(schemes))  # fmt: skip
        for row in found["rows"]:
            rows.append([scene, row["scheme"], row["negatives"], row["trusted"], row["doubtful"], row["not_found"],
                         number(row["log_evidence"]["99"], ".1f"), number(row["log_evidence"]["100"], ".1f")])  # fmt: skip
    return [(["map", "scheme", "negative queries", "trusted", "doubtful", "not found", "log evidence, 99 % quantile",
              "log evidence, largest"], rows)]  # fmt: skip


def stressed(run: Run, folder: str, *options) -> dict:
    """Rows of `eval stress` by scheme and condition."""
    found = run.document("eval", "stress", *run.scene(folder), *options)
    return {(row["scheme"], row["stress"]): row for row in found["rows"]}


@figure("trust/stress.csv")
def stress(run: Run) -> list[tuple]:
    rows = []
    for scene, folder in SCENES.items():
        found = stressed(run, folder, "--query-keypoints", 1024, "--schemes", "points,dcl")
        within = "0.05/5" if folder == "redkitchen" else RIGHT
        for condition in dict.fromkeys(condition for _, condition in found):
            cells = []
            for scheme in ("points", "dcl"):
                row = found[scheme, condition]
                cells += [percent(row["recall"][within]), cm(row["median_translation"]), row["trusted"], row["trusted_wrong"]]
            rows.append([scene, condition, *cells])
    columns = ["within (%)", "median (cm)", "trusted", "trusted wrongly"]
    return [(["scene", "stress", *(f"{scheme} {column}" for scheme in ("points", "dcl") for column in columns)], rows)]


@figure("trust/search.csv")
def search(run: Run) -> list[tuple]:
    rows = []
    for scene, folder in SCENES.items():
        for (_, condition), row in stressed(run, folder, "--optimum", "--schemes", "dcl").items():
            rows.append([scene, condition, percent(row["recall"][RIGHT]), cm(row["median_translation"]), cm(row["median_position_sd"]),
                         row["trusted"], row["trusted_wrong"], row["doubtful"], row["not_found"],
                         percent(row["optimum"]["recall"][RIGHT]), row["search_failures"]])  # fmt: skip
    return [(["scene", "stress", "within 25 cm and 2° (%)", "median error (cm)", "median ± (cm)", "trusted", "trusted wrongly",
              "doubtful", "not found", "within 25 cm and 2°, optimum (%)", "lost by the search"], rows)]  # fmt: skip


@figure("trust/focal.csv")
def focal(run: Run) -> list[tuple]:
    rows = []
    for scene, folder in SCENES.items():
        found = stressed(run, folder, "--stress", "focal-1,focal-3,focal-10,focal-30", "--schemes", ",".join(LINES))
        for condition in ("none", "focal-1", "focal-3", "focal-10", "focal-30"):
            for scheme in LINES:
                row = found[scheme, condition]
                rows.append([scene, condition.removeprefix("focal-").replace("none", "0"), scheme, percent(row["recall"][RIGHT]),
                             cm(row["median_translation"]), cm(row["median_position_sd"]), row["trusted"], row["trusted_wrong"],
                             row["doubtful"]])  # fmt: skip
    return [(["scene", "focal length wrong by (%)", "scheme", "within 25 cm and 2° (%)", "median error (cm)", "median ± (cm)", "trusted",
              "trusted wrongly", "doubtful"], rows)]  # fmt: skip


@figure("trust/gravity.csv")
def gravity(run: Run) -> list[tuple]:
    rows = []
    options = ["--stress", "half-hidden,sparse-map", "--schemes", ",".join(LINES)]
    known = {"no": stressed(run, "redkitchen", *options), "yes": stressed(run, "redkitchen", *options, "--gravity", 0.5)}
    for condition in ("none", "half-hidden", "sparse-map"):
        for scheme in LINES:
            for name, found in known.items():
                row = found[scheme, condition]
                rows.append([condition, scheme, name, percent(row["recall"][RIGHT]), cm(row["median_translation"]),
                             number(row["median_rotation_deg"], ".3f"), row["trusted"], row["trusted_wrong"], row["doubtful"],
                             row["not_found"]])  # fmt: skip
    return [(["stress", "scheme", "gravity", "within 25 cm and 2° (%)", "median error (cm)", "median error (°)", "trusted",
              "trusted wrongly", "doubtful", "not found"], rows)]  # fmt: skip


@figure("trust/frames.csv")
def frames(run: Run) -> list[tuple]:
    rows = []
    for condition in ("none", "half-hidden", "sparse-map"):
        found = run.document("eval", "rig", *run.scene("redkitchen"), "--stress", condition)
        for row in found["schemes"]:
            # The recipe is "4 frames".
            rows.append([condition, row["scheme"], row["recipe"].split()[0], row["queries"], row["localized"], row["trusted"],
                         cm(row["median_translation"]), number(row["median_rotation_deg"], ".3f"), percent(row["recall"][RIGHT])])  # fmt: skip
    return [(["stress", "scheme", "images", "queries", "localized", "trusted", "median error (cm)", "median error (°)",
              "within 25 cm and 2° (%)"], rows)]  # fmt: skip


GPU = "networks that a GPU trains"
PHONE = "tools for phones"
OLD = "a build of an earlier commit"
NATS = "nats-server"
KITCHEN = "--posed $D/redkitchen/posed --images $D/redkitchen/images --map-list $D/redkitchen/map.txt --query-list $D/redkitchen/query.txt"
TABLES = "$P scripts/privacy_tables.py --veiloc $V --data $D --work $W/privacy"
ROWS = "$P scripts/private_rows.py --veiloc $V --data $D --work $W/private"
FEATURES = "$P scripts/feature_tables.py --veiloc $V --data $D --work $W/features"
SCALE = "$P scripts/scale_tables.py --veiloc $V --data $D --work $W/scale"
BUILD = "cargo build --release --locked -q"
NETWORKS = "files of XFeat and ALIKE in VEILOC_MODELS"

script("$P scripts/places.py --veiloc $V --data $D --csv $O/places/places.csv --lost $O/places/lost.csv", "places/places.csv",
       "places/lost.csv")  # fmt: skip
script("$P scripts/places.py --veiloc $V --data $D --places llff-room,fountain,entry,hololens-office --schemes points,dcl --features "
       "alike-t-compact --csv $O/places/alike.csv", "places/alike.csv", by_hand=NETWORKS)  # fmt: skip
script("$P scripts/peers.py --veiloc $V --data $D --work $W/peers --times --csv $O/peers/peers.csv", "peers/peers.csv")
script("$P scripts/peers.py --veiloc $V --data $D --work $W/peers --places hololens-office,llff-room,fountain,entry,redkitchen,herzjesu --times "
       "--learned alike --csv $O/peers/learned.csv", "peers/learned.csv", by_hand=NETWORKS)  # fmt: skip
script("$P scripts/trust_places.py --veiloc $V --data $D --work $W/maps --stress dark,motion,half-hidden,low-resolution,few-keypoints "
       "--stress-csv $O/trust/places-stress.csv", "trust/places-stress.csv")  # fmt: skip
script("$P scripts/trust_places.py --veiloc $V --data $D --work $W/maps --every 8 --negatives-csv $O/trust/places-negatives.csv",
       "trust/places-negatives.csv")  # fmt: skip
script("$P scripts/twins.py --veiloc $V --data $D --csv $O/trust/twins.csv", "trust/twins.csv")
script("$P scripts/wrong_cameras.py --veiloc $V --data $D --work $W/maps --every 3 --csv $O/trust/camera.csv", "trust/camera.csv")
script(f"{TABLES} schemes --networks networks --csv $O/privacy/schemes.csv --summary $O/privacy/adversaries.csv", "privacy/schemes.csv",
       "privacy/adversaries.csv", by_hand=GPU)  # fmt: skip
script(f"{TABLES} out-of-map --networks networks --csv $O/privacy/out-of-map.csv", "privacy/out-of-map.csv", by_hand=GPU)
script("$P research/notes/person_masks.py --images $D/redkitchen/images --list $D/redkitchen/query.txt --out $W/masks && "
       f"{TABLES} masks --masks $W/masks --csv $O/privacy/masks.csv", "privacy/masks.csv")  # fmt: skip
script(f"{ROWS} hole --csv $O/privacy/hole.csv", "privacy/hole.csv")
script(f"{ROWS} persons --people people --csv $O/privacy/persons.csv", "privacy/persons.csv", by_hand="a segmentation network")
script(f"{ROWS} defences --queries 6 --csv $O/privacy/hole-defences.csv", "privacy/hole-defences.csv")
script(f"{ROWS} person-defences --people people --queries 6 --places llff-room,fountain,entry,herzjesu --csv $O/privacy/person-defences.csv",
       "privacy/person-defences.csv", by_hand="a segmentation network")  # fmt: skip
ALSO = ('--also "slanted strips A=dcl:axis=126:sectors=24:anchors=0.3/-0.42+-0.47/0.65" '
        '--also "slanted strips B=dcl:axis=126:sectors=24:anchors=0.35/-0.49+-0.41/0.57" '
        '--also "slanted strips C=dcl:axis=126:sectors=24:anchors=0.35/-0.49+-0.53/0.73"')  # fmt: skip
script(f"{ROWS} layouts --queries 8 --photos photos.jsonl.gz {ALSO} --csv $O/privacy/layout-private.csv "
       "--means $O/privacy/layout-private-means.csv", "privacy/layout-private.csv", "privacy/layout-private-means.csv",
       by_hand="keypoints of other photographs")  # fmt: skip
script(f"$P scripts/layout_poses.py --veiloc $V --data $D --work $W/layouts {ALSO} --csv $O/privacy/layout-poses.csv "
       "--means $O/privacy/layout-pose-means.csv", "privacy/layout-poses.csv", "privacy/layout-pose-means.csv")  # fmt: skip
script(f"{ROWS} places --queries 6 --photos photos.jsonl.gz --csv $O/privacy/places.csv", "privacy/places.csv", by_hand=GPU)
script("veiloc eval inversion", "privacy/inversion.csv", "privacy/inversion-paper.csv", by_hand=GPU)
script("$P scripts/edge_images.py --veiloc $V --data $D --csv $O/privacy/edges.csv", "privacy/edges.csv")
script("research/notes/edge_inversion.py", "privacy/edge-inversion.csv", by_hand=GPU)
script("$P scripts/phones/measure.py --frame FRAME.pgm --profile PLACE.profile --times 2 --rounds 40 --csv $O/features/seal-frame.csv",
       "features/seal-frame.csv", by_hand=PHONE)  # fmt: skip
script("python -m veiloc_train neighbours", "features/predictors.csv", by_hand=GPU)
script("$P scripts/bench_search.py --usearch-up-to 100000 --csv $O/scale/usearch.csv", "scale/usearch.csv", by_hand=OLD)
script("$P research/notes/scale_model.py --csv $O/scale && $P research/notes/scale_model.py --plot docs/images/scale.svg", "scale/model.csv",
       "scale/model-negatives.csv")  # fmt: skip
script("veiloc eval crb --problems 500", "poses/bound.csv", by_hand=OLD)
script("$P scripts/service/greedy_token.py --veiloc OLD,NEW", "service/greedy-token.csv", by_hand=OLD)
script("$P scripts/service/answer_times.py --veiloc $V --places redkitchen --images 20 --rounds 2 --csv $O/service/answer-times.csv",
       "service/answer-times.csv")  # fmt: skip
script("$P scripts/cluster/throughput.py --veiloc $V --seconds 15 --workers 1 2 4 --csv $O/service/cluster-throughput.csv "
       "--latency-csv $O/service/cluster-latency.csv --json $W/cluster.json && "
       "$P research/notes/scale_model.py --check $W/cluster.json --csv $O/scale", "service/cluster-latency.csv",
       "service/cluster-throughput.csv", "scale/model-check.csv", by_hand=NATS)  # fmt: skip
script("$P scripts/cluster_chaos.py --veiloc $V --workers 6 --seconds 6 --csv $O/service/cluster-chaos.csv", "service/cluster-chaos.csv",
       by_hand=NATS)  # fmt: skip
script("$P scripts/cluster/hung_workers.py --workers 2 4", "service/cluster-hung.csv", by_hand=OLD)
script("$P scripts/bench_pose_stage.py --veiloc $V --data $D --rounds 3 --csv $O/poses/time.csv", "poses/time.csv")
script(f"{BUILD} -p veiloc-benches --bin solver_benchmark && $P scripts/bench_poselib.py --binary $R/solver_benchmark --csv $O/poses/solvers.csv",
       "poses/solvers.csv")  # fmt: skip
for part in ("sessions", "orientation", "paper", "scene", "seals", "session-poses", "false-neighbours", "steps", "keypoints", "baseline"):
    script(f"{TABLES} {part} --csv $O/privacy/{part}.csv", f"privacy/{part}.csv")
script(f"{BUILD} -p veiloc-features --example extract && $P scripts/oracle_features.py --extract $R/examples/extract --data $D "
       "--csv $O/features/extractors.csv", "features/extractors.csv")  # fmt: skip
script(f"{BUILD} -p veiloc-features --example extract && $P scripts/bench_sift.py --rounds 8 --wasm --extract $R/examples/extract "
       "--csv $O/features/sift-speed.csv $D/redkitchen/images/frame-000000.color.jpg", "features/sift-speed.csv",
       by_hand="the target wasm32-unknown-unknown, and node")  # fmt: skip
script(f"{FEATURES} scenes --csv $O/features/scenes.csv --kinds-csv $O/features/kinds.csv", "features/scenes.csv", "features/kinds.csv",
       by_hand=NETWORKS)  # fmt: skip
script(f"{FEATURES} stress --csv $O/features/learned-stress.csv", "features/learned-stress.csv", by_hand=NETWORKS)
script(f"{FEATURES} compact --csv $O/features/compact.csv --cost-csv $O/features/compact-cost.csv", "features/compact.csv",
       "features/compact-cost.csv")  # fmt: skip
script("$P scripts/train_compact.py --images $D/training-photos --veiloc $V --features sift,xfeat,alike-t "
       "--csv $O/features/projection.csv", "features/projection.csv", by_hand=NETWORKS)  # fmt: skip
script(f"{BUILD} -p veiloc-features --example extract && {BUILD} -p veiloc-features --example layers --features rten,onnxruntime && "
       "$P scripts/bench_extraction.py --rounds 8 --extract $R/examples/extract --layers $R/examples/layers --weights $D/../weights "
       "--csv $O/features/network-speed.csv $D/redkitchen/images/frame-000000.color.jpg", "features/network-speed.csv",
       by_hand=NETWORKS)  # fmt: skip
script(f"{BUILD} -p veiloc-features --example globals && $P scripts/global_descriptors.py measure --globals $R/examples/globals "
       "--data $D --weights $D/../weights --folder $W/globals --photos 480 --csv $O/features/global.csv "
       "--leak-csv $O/features/global-leak.csv", "features/global.csv", "features/global-leak.csv")  # fmt: skip
script(f"VEILOC_MODELS=$D/../weights {FEATURES} globals --csv $O/features/global-poses.csv", "features/global-poses.csv")
script(f"{SCALE} compress --csv $O/scale/compress.csv && $P scripts/scale_plots.py", "scale/compress.csv")
script("$P research/notes/city.py --veiloc $V --data $D --out $W/city --csv $O/scale/city.csv --queries-csv $O/scale/city-queries.csv && "
       "$P research/notes/city.py --out $W/city --plot docs/images/city.svg", "scale/city.csv", "scale/city-queries.csv")  # fmt: skip
script("veiloc eval retrieval", "scale/retrieval.csv", by_hand=OLD)
script(f"{SCALE} drawn --csv $O/scale/drawn.csv", "scale/drawn.csv")
script(f"{SCALE} regions --csv $O/scale/regions.csv", "scale/regions.csv")
script("$P scripts/ray_times.py --data $D --rounds 3 --csv $O/scale/build.csv", "scale/build.csv", by_hand="the Python package, and Ray")
script(f"{BUILD} -p veiloc-service --example load && $P scripts/service/load.py --veiloc $V --data $D --load $R/examples/load "
       "--csv $O/service/load.csv", "service/load.csv")  # fmt: skip
script("$P scripts/service/throughput.py --veiloc $V --data $D --csv $O/service/overhead.csv", "service/overhead.csv", by_hand="h2load")
script("$P scripts/service_robustness.py --veiloc $V --data $D --csv $O/service/bad-requests.csv --killed-csv $O/service/killed.csv",
       "service/bad-requests.csv", "service/killed.csv")  # fmt: skip
script("$P scripts/chaos_soak.py --veiloc $V --data $D --minutes 30 --csv $O/service/chaos.csv --load-csv $O/service/chaos-load.csv",
       "service/chaos.csv", "service/chaos-load.csv")  # fmt: skip
script("CSV=$O/service/fuzz.csv fuzz/run.sh 120", "service/fuzz.csv", by_hand="cargo-fuzz and a nightly compiler")
script("$P scripts/images_alone.py $V $D $W/alone $O/mapping/images-alone.csv", "mapping/images-alone.csv")
script("$P scripts/video_map.py $V $D/redkitchen $W/video $O/mapping/video.csv", "mapping/video.csv", by_hand="imageio-ffmpeg")
script("$P scripts/pose_formats.py maps $V $D/redkitchen $W/formats $O/mapping/formats.csv", "mapping/formats.csv",
       by_hand="COLMAP and evo")  # fmt: skip
script("$P scripts/map_merges.py $V $D $W/merges $O/mapping/merges.csv", "mapping/merges.csv")
script("$P scripts/gps_place.py $V $D $W/gps $O/mapping/gps.csv", "mapping/gps.csv")
script("$P scripts/cluster/placement.py --seconds 8 --veiloc $V --csv $O/service/cluster-placement.csv",
       "service/cluster-placement.csv", by_hand=NATS)  # fmt: skip
script("$P scripts/cluster/shared_rates.py --rendered --seconds 15 --veiloc OLD,NEW --names before,now --csv $O/service/shared-rates.csv",
       "service/shared-rates.csv", by_hand=OLD)  # fmt: skip
script("$P scripts/cluster/rolling_update.py OLD NEW --rendered --seconds 3 --csv $O/service/rolling-update.csv",
       "service/rolling-update.csv", by_hand=OLD)  # fmt: skip
script(f"{FEATURES} bytes --csv $O/service/bytes.csv", "service/bytes.csv")
script(f"{FEATURES} image-bytes --csv $O/service/image-bytes.csv", "service/image-bytes.csv")


def machine() -> str:
    """The kind of machine: processor, cores, vector instructions, memory."""
    text = Path("/proc/cpuinfo").read_text() if Path("/proc/cpuinfo").exists() else ""
    kind = re.search(r"^model name\s*:\s*(.*)$", text, re.M)
    vector = next((name for name in ("avx512f", "avx2", "asimd") if re.search(rf"\b{name}\b", text)), "")
    gib = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    name = re.sub(r"\((R|TM)\)|CPU|@.*", "", kind.group(1)).strip() if kind else platform.processor()
    return " ".join(f"{name} {platform.machine()}, {os.cpu_count()} cores, {vector}, {gib:.0f} GiB".split())


def git(*command) -> str:
    return subprocess.run(["git", "-C", ROOT, *command], check=True, capture_output=True, text=True).stdout.strip()


def logged() -> dict[str, list[str]]:
    if not LOG.exists():
        return {}
    with LOG.open(newline="") as file:
        return {row[0]: row for row in list(csv.reader(file))[1:]}


def note(table: str, command: str, commit: str, minutes: float):
    """Writes the line of a table in the log."""
    rows = logged()
    rows[table] = [table, f"`{command}`", commit, machine(), f"{minutes:.0f}"]
    write_csv(LOG, COLUMNS, [rows[name] for name in sorted(rows)])


def make(run: Run, table: str, args, commit: str) -> bool:
    """Makes a table and those of the same command; whether it was done."""
    tables, *how = FIGURES[table]
    mark = run.work / f"done-{tables[0].replace('/', '-')}"
    if mark.exists() and not args.again:
        return True
    if len(how) == 2 and how[0]:
        print(f"{', '.join(tables)}: not here, it needs {how[0]}: {how[1]}", flush=True)
        return False
    print(f"{', '.join(tables)} …", flush=True)
    started = time.monotonic()
    for name in tables:
        (RESULTS / name).parent.mkdir(exist_ok=True)
    if len(how) == 1:
        for name, (columns, rows) in zip(tables, how[0](run)):
            write_csv(RESULTS / name, columns, rows)
        command = f"scripts/figures.sh {tables[0]}"
    else:
        command = how[1]
        known = {"D": args.data, "V": args.veiloc, "O": RESULTS, "W": run.work, "P": sys.executable, "R": ROOT / "target/release"}
        subprocess.run(["bash", "-ec", string.Template(command).safe_substitute(known)], check=True, cwd=ROOT)
    minutes = (time.monotonic() - started) / 60
    for name in tables:
        note(name, command, commit, minutes)
    mark.write_text("")
    print(f"{', '.join(tables)}: {minutes:.1f} minutes", flush=True)
    return True


def imported(script: Path) -> set[str]:
    """Modules that a script imports when it starts, without those of Python and the project's own, whose imports count too."""
    names = set()
    for line in ast.parse(script.read_text()).body:
        if isinstance(line, ast.Import):
            names.update(alias.name.split(".")[0] for alias in line.names)
        elif isinstance(line, ast.ImportFrom):
            names.add(line.module.split(".")[0])
    found = set()
    for name in names - set(sys.stdlib_module_names):
        folders = (script.parent, ROOT / "scripts", ROOT / "scripts/service")
        own = [file for folder in folders if (file := folder / f"{name}.py").exists()]
        found |= imported(own[0]) if own else {name}
    return found


def check() -> list[str]:
    """What is wrong with the list of tables and the log."""
    files = {str(path.relative_to(RESULTS)) for path in RESULTS.rglob("*.csv")} - {LOG.name}
    rows = logged()
    wrong = [f"{name}: scripts/figures.py has no command for it" for name in sorted(files - set(FIGURES))]
    wrong += [f"{name}: scripts/figures.py makes it, and it is not in docs/results" for name in sorted(set(FIGURES) - files)]
    wrong += [f"{name}: no line in docs/results/{LOG.name}" for name in sorted(files - set(rows))]
    wrong += [f"{name}: a line in docs/results/{LOG.name}, and no such table" for name in sorted(set(rows) - files)]
    commands = {how[1] for _, *how in FIGURES.values() if len(how) == 2 and not how[0]}
    scripts = sorted({file for command in commands for file in re.findall(r"[\w/]+\.py", command)})
    needed = {file: sorted(imported(ROOT / file) - set(PACKAGES)) for file in scripts}
    wrong += [f"{file} imports {', '.join(names)}, which PACKAGES lacks" for file, names in needed.items() if names]
    return wrong


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="*", help="pages or tables (default: all)")
    parser.add_argument("--veiloc", type=Path, default=ROOT / "target/release/veiloc")
    parser.add_argument("--data", type=Path, default=os.environ.get("VEILOC_DATA"))
    parser.add_argument("--work", type=Path, default=ROOT / "target/figures")
    parser.add_argument("--again", action="store_true", help="make tables that were made at this commit once more")
    parser.add_argument("--list", action="store_true")
    parser.add_argument("--check", action="store_true")
    parser.add_argument("--packages", action="store_true", help="print the packages that scripts/figures.sh installs")
    args = parser.parse_args()
    if args.check:
        wrong = check()
        print("\n".join(wrong), file=sys.stderr)
        sys.exit(bool(wrong))
    if args.packages:
        print(*PACKAGES.values())
        return
    pages = defaultdict(list)
    for table in FIGURES:
        pages[table.split("/")[0]].append(table)
    unknown = [name for name in args.what if name not in FIGURES and name not in pages]
    if unknown:
        sys.exit(f"no page or table {', '.join(unknown)}: {', '.join(pages)}, or a table of --list")
    chosen = [table for name in args.what or pages for table in pages.get(name, [name])]
    if args.list:
        for table in chosen:
            _, *how = FIGURES[table]
            print(table, how[1] if len(how) == 2 else f"scripts/figures.sh {table}", *([f"({how[0]})"] if len(how) == 2 and how[0] else []))
        return
    if args.data is None:
        sys.exit("set VEILOC_DATA or --data to the folder of the real images")
    args.data, args.veiloc = Path(args.data).resolve(), args.veiloc.resolve()
    if not args.veiloc.exists() or shutil.which(args.veiloc) is None:
        sys.exit(f"no program {args.veiloc}: cargo build --release --features full, or --veiloc PROGRAM")
    commit = git("rev-parse", "--short=8", "HEAD")
    # A document belongs to the program that wrote it.
    args.work = args.work.resolve() / hashlib.sha256(args.veiloc.read_bytes()).hexdigest()[:12]
    args.work.mkdir(parents=True, exist_ok=True)
    run = Run(args)
    started = time.monotonic()
    done, failed = [], []
    for table in dict.fromkeys(FIGURES[table][0][0] for table in chosen):
        try:
            done.append(make(run, table, args, commit))
        except subprocess.CalledProcessError as error:
            # The next tables take hours, and do not need this one.
            print(f"{table}: failed: {error}", file=sys.stderr, flush=True)
            failed.append(table)
    subprocess.run([sys.executable, ROOT / "scripts/result_tables.py"], check=True)
    print(f"{sum(done)} of {len(done) + len(failed)} commands ran, {(time.monotonic() - started) / 60:.0f} minutes")
    if failed:
        sys.exit(f"failed: {', '.join(failed)}; made again by the same command")


if __name__ == "__main__":
    main()
