#!/usr/bin/env python3
"""Writes tables of docs/results/privacy.md, each by one command.

    P="research/study/privacy_tables.py --veiloc target/release/veiloc --data $VEILOC_DATA --work work"
    $P schemes --networks networks --csv docs/results/privacy/schemes.csv --summary docs/results/privacy/adversaries.csv
    $P out-of-map --networks networks --csv docs/results/privacy/out-of-map.csv
    $P masks --masks masks --csv docs/results/privacy/masks.csv
    $P sessions --csv docs/results/privacy/sessions.csv
    $P orientation --csv docs/results/privacy/orientation.csv
    $P paper --csv docs/results/privacy/paper.csv
    $P scene --csv docs/results/privacy/scene.csv
    $P seals --csv docs/results/privacy/seals.csv
    $P session-poses --csv docs/results/privacy/session-poses.csv
    $P false-neighbours --csv docs/results/privacy/false-neighbours.csv
    $P steps --csv docs/results/privacy/steps.csv
    $P keypoints --csv docs/results/privacy/keypoints.csv
    $P baseline --csv docs/results/privacy/baseline.csv

- schemes: every adversary under every scheme, six queries of RedKitchen and of Herz-Jesu; the oracle on two of each.
- out-of-map: outsiders on the last twelve of the training photos, by the SHA-256 of their names.
- masks: RedKitchen with and without the masks of `research/notes/person_masks.py`.
- sessions: several images of a place, by motion of the camera and frame of the anchors.
- orientation: sessions whose orientations are wrong.
- paper: the paper's attack on the keypoints of `problems`, beside the paper's figures.
- scene: the paper's synthetic scene.
- seals: several seals of one image, and several images of a camera at rest, from the keypoints of `problems`.

--networks has `neighbours.toml` and `SCHEME.toml`, as `research/train` writes them; without it, adversaries with networks are
left out. --work keeps keypoints of training photos, and the documents of commands that ended: a table that was interrupted goes
on. Delete it to measure again.
"""

import argparse
import hashlib
import subprocess
from pathlib import Path

from places import PLACES, kept_document, write_csv

PROBLEMS = {"RedKitchen": "redkitchen", "Herz-Jesu": "herzjesu"}
SCHEMES = ["random-lines", "coordinate-permutation", "dcl"]
# Training photos that a statistic learns from, and those that are attacked.
FIRST, LAST = 400, 12
ATTACKED = 6
# Adversaries whose layouts of the graph are worth their time, and their attacked queries.
SLOW = {"map-server": 6, "true-neighbours": 2}
FRAMES = [2, 3, 5, 8]
# Frame of the anchors, orientation error, motions.
SESSIONS = [
    ("image", 0, "turning,walking,resting"), ("world", 0, "turning,walking,resting,visiting"), ("world", 0.1, "turning,walking"),
    ("world", 0.5, "turning"), ("gravity", 0, "turning,walking,visiting"),
]  # fmt: skip
# Name, error of each orientation, drift.
ORIENTATIONS = [
    ("none", 0, 0), ("0.1° a frame", 0.1, 0), ("0.5° a frame", 0.5, 0), ("1° a frame", 1, 0), ("drift of 0.05° a frame", 0, 0.05),
    ("drift of 0.2° a frame", 0, 0.2),
]  # fmt: skip
KNOWLEDGE = {
    "outsider-statistic": ("outsider", "a statistic of descriptors of 400 out-of-map images"),
    "outsider-neighbours": ("outsider", "a network of neighbours, trained on {} out-of-map images"),
    "outsider-network": ("outsider", "a network from rows to positions, trained on {} out-of-map images"),
    "map-server": ("operator or anyone", "images from nearby viewpoints"),
    "pose-server": ("server", "the pose; measured on what its map does not show"),
    "pose-server-images": ("server", "the pose and its map images; the same keypoints"),
    "several-frames": ("server", "poses of 8 queries (Herz-Jesu 2), anchors fixed in each image"),
    "several-seals": ("anyone", "eight seals of one image"),
    "true-neighbours": ("oracle", "the true neighbours of every keypoint"),
}  # fmt: skip
OUTSIDERS = ["outsider-statistic", "outsider-neighbours", "outsider-network"]


def run(args, *command) -> dict:
    return kept_document(args.veiloc, args.work, *command)


def scene_of(args, place: str) -> list:
    folder = args.data / place
    return ["--posed", folder / "posed", "--images", folder / "images", "--map-list", folder / "map.txt", "--query-list",
            folder / "query.txt"]  # fmt: skip


def photos(args, part: str) -> Path:
    """Keypoints of the first or the last training photos by the SHA-256 of their names."""
    folder, file = args.data / "training-photos", args.work / f"{part}.jsonl.gz"
    if not file.exists():
        args.work.mkdir(parents=True, exist_ok=True)
        names = sorted((str(path.relative_to(folder)) for path in folder.rglob("*.jpg")),
                       key=lambda name: hashlib.sha256(name.encode()).hexdigest())  # fmt: skip
        listed = args.work / f"{part}.txt"
        listed.write_text("".join(f"{name}\n" for name in (names[:FIRST] if part == "first" else names[-LAST:])))
        subprocess.run([args.veiloc, "eval", "keypoints", "--quiet", folder, "--list", listed, "-o", file], check=True)
    return file


def adversaries(args, data: list, names: list[str], *options) -> dict:
    """Rows by adversary and scheme, in the order of the names."""
    files = sorted(args.networks.glob("*.toml")) if args.networks else []
    positions = [file for file in files if file.stem in SCHEMES]
    networks = {
        "outsider-neighbours": ["--model", *(file for file in files if file.stem == "neighbours")],
        "outsider-network": ["--positions", *positions],
    }  # fmt: skip
    rows = {}
    groups = [(ATTACKED, ["--quick"], [name for name in names if name not in SLOW])]
    groups += [(SLOW[name], [], [name]) for name in names if name in SLOW]
    for attacked, quick, own in groups:
        own = [name for name in own if len(networks.get(name, "--")) > 1]
        if own:
            found = run(args, "eval", "adversaries", *data, "--train", photos(args, "first"), "--adversaries", ",".join(own),
                        *quick, *([] if "--keypoints" in data else ["--max-attacked", attacked]),
                        *(word for name in own for word in networks.get(name, [])), *options)  # fmt: skip
            rows |= {(row["adversary"], row["scheme"]): row for row in found["rows"]}
    return {key: row for name in names for key, row in rows.items() if key[0] == name}


def attack_name(row: dict) -> str:
    return f"{row['attack']}, {row['frames']}" if row.get("frames") is not None else row["attack"]


def precision(row: dict) -> str:
    """Share of the neighbours that are true."""
    return f"{100 * row['precision']:.1f}" if row.get("precision") is not None else ""


def schemes(args):
    kitchen, church = (adversaries(args, scene_of(args, place), list(KNOWLEDGE)) for place in PROBLEMS.values())
    table = []
    for key, row in kitchen.items():
        other = church[key]
        table.append([
            *key, attack_name(row), precision(row), f"{row['prior_median_px']:.0f}", f"{row['median_px']:.1f}",
            f"{100 * row['under_10px']:.1f}", f"{100 * row['under_30px']:.1f}", f"{row['bits_over_prior']:.2f}",
            attack_name(other), precision(other), f"{other['prior_median_px']:.0f}", f"{other['median_px']:.1f}",
            f"{other['bits_over_prior']:.2f}",
        ])  # fmt: skip
    of = lambda place, *columns: [f"{place}: {column}" for column in columns]
    columns = ["adversary", "scheme",
               *of("RedKitchen", "best attack", "true neighbours (%)", "prior (px)", "median (px)", "< 10 px (%)", "< 30 px (%)",
                   "bits"),
               *of("Herz-Jesu", "best attack", "true neighbours (%)", "prior (px)", "median (px)", "bits")]  # fmt: skip
    write_csv(args.csv, columns, table)
    shown = []
    for adversary, (who, knows) in KNOWLEDGE.items():
        if (adversary, "dcl") not in kitchen:
            continue
        cells = []
        for place in (kitchen, church):
            row = place[adversary, "dcl"]
            digits = 1 if row["median_px"] < 10 else 0
            cells += [f"{row['median_px']:.{digits}f}", f"{row['prior_median_px']:.0f}", f"{row['bits_over_prior']:.2f}"]
        lines = [f"{place[adversary, 'random-lines']['bits_over_prior']:.2f}" for place in (kitchen, church)]
        shown.append([who, knows.format(args.trained_on), *cells, *lines])
    of_dcl = [f"{place}, {column}" for place in PROBLEMS for column in ("dcl median (px)", "prior (px)", "dcl (bits)")]
    columns = ["adversary", "knows beside the query", *of_dcl, *(f"{place}, random lines (bits)" for place in PROBLEMS)]
    write_csv(args.summary, columns, shown)


def out_of_map(args):
    found = adversaries(args, ["--keypoints", photos(args, "last")], [*OUTSIDERS, "several-seals"])
    table = [[*key, attack_name(row), precision(row), f"{row['prior_median_px']:.0f}", f"{row['median_px']:.1f}",
              f"{100 * row['under_10px']:.1f}", f"{100 * row['under_30px']:.1f}", f"{row['bits_over_prior']:.2f}"]
             for key, row in found.items()]  # fmt: skip
    columns = ["adversary", "scheme", "best attack", "true neighbours (%)", "prior (px)", "median (px)", "< 10 px (%)",
               "< 30 px (%)", "bits"]  # fmt: skip
    write_csv(args.csv, columns, table)


def masks(args):
    words = {
        "outsider-statistic": "outsider, statistic", "map-server": "images from nearby", "pose-server": "a server that has the pose",
        "pose-server-images": "the same with the map's images", "several-frames": "eight frames",
        "several-seals": "eight seals",
    }  # fmt: skip
    data = scene_of(args, "redkitchen")
    without = adversaries(args, data, list(words), "--schemes", "dcl")
    with_masks = adversaries(args, data, list(words), "--schemes", "dcl", "--masks", args.masks)
    table = [[words[name], f"{row['bits_over_prior']:.2f}", f"{with_masks[name, scheme]['bits_over_prior']:.2f}"]
             for (name, scheme), row in without.items()]  # fmt: skip
    write_csv(args.csv, ["adversary", "without masks (bits)", "with masks (bits)"], table)


def bits_of(rows: list[dict], **like) -> str:
    """The best attack among rows with these values."""
    bits = [row["bits_over_prior"] for row in rows if all(row[key] == value for key, value in like.items())]
    bits = [value for value in bits if value is not None]
    return f"{max(bits):.2f}" if bits else ""


def eval_sessions(args, frames, *options) -> list[dict]:
    return run(args, "eval", "sessions", *scene_of(args, "redkitchen"), "--schemes", "dcl", "--max-attacked", args.attacked,
               "--frames", ",".join(map(str, frames)), *options)["rows"]  # fmt: skip


def sessions(args):
    rows = eval_sessions(args, FRAMES, "--anchors", "image,world,gravity", "--gyro-deg", 0, "--motion",
                         "turning,walking,resting,visiting")  # fmt: skip
    rows += eval_sessions(args, FRAMES, "--anchors", "world", "--gyro-deg", "0.1,0.5", "--motion", "turning,walking")
    table = []
    for anchors, error, motions in SESSIONS:
        for motion in motions.split(","):
            like = {"anchors": anchors, "gyro_deg": error, "motion": motion}
            cells = [bits_of(rows, **like, target=target, frames=n) for target in ("private", "matched") for n in FRAMES]
            table.append([anchors, "" if anchors == "image" else f"{error:g}", motion, *cells])
    columns = ["anchors fixed in", "orientation error (°)", "motion",
               *(f"{target}, {n} images (bits)" for target in ("private", "matched") for n in FRAMES)]  # fmt: skip
    write_csv(args.csv, columns, table)


def orientation(args):
    frames, table = [2, 4, 8, 16, 29], []
    options = ["--anchors", "world", "--motion", "turning"]
    rows = eval_sessions(args, frames, *options, "--gyro-deg", "0,0.1,0.5,1", "--drift-deg", 0)
    rows += eval_sessions(args, frames, *options, "--gyro-deg", 0, "--drift-deg", "0.05,0.2")
    for name, gyro, drift in ORIENTATIONS:
        like = {"gyro_deg": gyro, "drift_deg": drift}
        table.append([name, *(bits_of(rows, **like, target=target, frames=n) for target in ("private", "matched") for n in frames)])
    columns = ["orientation error about each axis",
               *(f"{target}, {n} images (bits)" for target in ("private", "matched") for n in frames)]  # fmt: skip
    write_csv(args.csv, columns, table)


def attacks(args, *command) -> list[dict]:
    return run(args, "attack", *command)["attacks"]


def keypoints(args, name: str) -> Path:
    return args.data / "problems" / f"{PROBLEMS[name]}_keypoints.jsonl.gz"


def scene(args):
    table = []
    for row in attacks(args, "--synthetic", 1500, "--attacks", "prior,closed-form,closed-form-informed,graph"):
        if row["attack"] == "closed-form-informed" and row["scheme"] != "dcl":
            continue
        is_prior = row["attack"] == "prior"
        shares = [f"{100 * row[key]:.1f}" for key in ("under_5px", "under_10px", "under_30px")]
        table.append([row["scheme"], row["attack"], f"{row['mean_px']:.1f}", f"{row['median_px']:.1f}", *shares,
                      "0" if is_prior else f"{row['bits_over_prior']:.2f}", "" if is_prior else f"{float('%.2g' % row['ms']):g}"])  # fmt: skip
    columns = ["scheme", "attack", "mean (px)", "median (px)", "< 5 px (%)", "< 10 px (%)", "< 30 px (%)", "bits", "time (ms)"]
    write_csv(args.csv, columns, table)


def seals(args):
    found = []
    for noise in (0, 0.4):
        rows = attacks(args, keypoints(args, "RedKitchen"), "--schemes", "dcl", "--attacks", "resting-camera", "--frames",
                       "2,8,32", "--limit", 6, "--resting-noise", noise)  # fmt: skip
        found.append({row["frames"]: row for row in rows if row["attack"] == "resting-camera"})
    cells = lambda row: [f"{row['median_px']:.1f}", f"{100 * row['under_10px']:.1f}", f"{row['bits_over_prior']:.2f}"]
    table = [[n, *cells(found[0][n]), *cells(found[1][n])] for n in (2, 8, 32)]
    columns = ["seals or images", "seals of one image: median (px)", "seals: < 10 px (%)", "seals: bits",
               "new images: median (px)", "new images: < 10 px (%)", "new images: bits"]  # fmt: skip
    write_csv(args.csv, columns, table)


def paper(args):
    table = [["paper", "7Scenes", scheme, mean, ""] for scheme, mean in
             (("random-lines", "6.137"), ("coordinate-permutation", "10.56"), ("dcl:paper", "330.4"))]  # fmt: skip
    for name, few, all_of_dcl in (("RedKitchen", 4, 22), ("Herz-Jesu", 2, 8)):
        for of_schemes, limit in (("random-lines,coordinate-permutation", few), ("dcl:paper", all_of_dcl)):
            rows = attacks(args, keypoints(args, name), "--limit", limit, "--schemes", of_schemes, "--attacks", "closed-form")
            mean = {(row["scheme"], row["attack"]): row["mean_px"] for row in rows}
            for scheme in of_schemes.split(","):
                table.append(["veiloc", f"{name}, {limit} images", scheme, f"{mean[scheme, 'closed-form']:.1f}",
                              f"{mean[scheme, 'prior']:.1f}"])  # fmt: skip
    columns = ["source", "images", "scheme", "closed-form attack, mean (px)", "prior-only baseline, mean (px)"]
    write_csv(args.csv, columns, table)


def session_poses(args):
    table = []
    for name, place in PROBLEMS.items():
        # What several images tell is in the table of sessions; here they are few, for their poses.
        found = run(args, "eval", "sessions", *scene_of(args, place), "--schemes", "dcl", "--anchors", "image,world,gravity",
                    "--motion", "turning", "--gyro-deg", 0, "--frames", 2, "--max-attacked", 1)  # fmt: skip
        for row in found["frames"]:
            table.append([name, row["anchors"], f"{row['keypoints']:.0f}", row["queries"], row["trusted"],
                          f"{100 * row['median_translation']:.2f}", f"{row['median_rotation_deg']:.3f}"])  # fmt: skip
    columns = ["scene", "anchors fixed in", "keypoints", "queries", "trusted", "median error (cm)", "median error (°)"]
    write_csv(args.csv, columns, table)


def false_neighbours(args):
    shares = [0, 10, 20, 30, 40, 50]
    attacked = {"synthetic": ["--synthetic", 1500]}
    attacked |= {name: [keypoints(args, name), "--limit", limit] for name, limit in (("RedKitchen", 4), ("Herz-Jesu", 2))}
    found = {}
    for name, data in attacked.items():
        rows = attacks(args, *data, "--schemes", "dcl", "--attacks", "graph", "--corrupt", ",".join(map(str, shares)))
        found[name] = {round(row["corrupt"]): row for row in rows if row["attack"] == "graph"}
    table = [[share, *(f"{rows[share][key]:.1f}" for rows in found.values() for key in ("mean_px", "median_px"))] for share in shares]
    columns = ["false neighbours (%)", *(f"{name}, {key} (px)" for name in found for key in ("mean", "median"))]
    write_csv(args.csv, columns, table)


def scene_rows(args, place: str, *options) -> list[dict]:
    return run(args, "eval", "scene", *scene_of(args, place), *options)["schemes"]


def error_of(row: dict) -> list[str]:
    return [f"{100 * row['median_translation']:.2f}", f"{row['median_rotation_deg']:.3f}"]


def steps(args):
    table = []
    for name, place in PROBLEMS.items():
        options = ["--schemes", ",".join(["points", *SCHEMES]), "--query-keypoints", 1024]
        both = zip(scene_rows(args, place, *options), scene_rows(args, place, *options, "--progressive"))
        for whole, parts in both:
            counts = [f"{row[key] / unit:.0f}" for key, unit in (("mean_rows", 1), ("mean_bytes", 1000), ("mean_exposed", 1))
                      for row in (whole, parts)]  # fmt: skip
            table.append([name, whole["scheme"], *counts, *error_of(whole), *error_of(parts)])
    of = lambda what: [f"{what}, {how}" for how in ("whole", "in steps")]
    columns = ["scene", "scheme", *of("rows"), *of("kB"), *of("exposed rows"),
               *(f"median ({unit}), {how}" for how in ("whole", "in steps") for unit in ("cm", "°"))]  # fmt: skip
    write_csv(args.csv, columns, table)


def fewer_keypoints(args):
    table = []
    for name, place in PROBLEMS.items():
        for number in (2048, 256):
            (row,) = scene_rows(args, place, "--schemes", "dcl", "--query-keypoints", number)
            table.append([name, number, row["queries"], row["localized"], row["trusted"], *error_of(row)])
    columns = ["scene", "keypoints sent", "queries", "localized", "trusted", "median error (cm)", "median error (°)"]
    write_csv(args.csv, columns, table)


def baseline(args):
    import fit_baseline

    files = []
    for place in PLACES:
        file, partial = (args.work / f"{part}{place}-keypoints.jsonl.gz" for part in ("", "partial-"))
        if not file.exists():
            args.work.mkdir(parents=True, exist_ok=True)
            subprocess.run([args.veiloc, "eval", "problems", "--quiet", *scene_of(args, place), "--keypoints", partial, "-o",
                            args.work / "problems.jsonl"], check=True, stdout=subprocess.DEVNULL)  # fmt: skip
            partial.rename(file)
        files.append(f"{place}={file}")
    fit_baseline.compare(files, FIRST, args.csv)


def main():
    commands = {"schemes": schemes, "out-of-map": out_of_map, "masks": masks, "sessions": sessions, "orientation": orientation,
                "paper": paper, "scene": scene, "seals": seals, "session-poses": session_poses,
                "false-neighbours": false_neighbours, "steps": steps, "keypoints": fewer_keypoints, "baseline": baseline}  # fmt: skip
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=commands)
    parser.add_argument("--veiloc", default="veiloc")
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--csv", type=Path)
    parser.add_argument("--summary", type=Path, help="second CSV of `schemes`: each adversary by its best attack")
    parser.add_argument("--masks", type=Path, help="folder of the masks, for `masks`")
    parser.add_argument("--networks", type=Path, help="folder of trained networks")
    parser.add_argument("--trained-on", default="1479", help="number of images that the networks have learned from")
    parser.add_argument("--attacked", type=int, default=5, help="attacked images in a session")
    args = parser.parse_args()
    commands[args.what](args)


if __name__ == "__main__":
    main()
