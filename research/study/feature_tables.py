#!/usr/bin/env python3
"""Writes tables of docs/results/features.md, and of service.md how much is sent, each by one command.

    P="research/study/feature_tables.py --veiloc target/release/veiloc --data $VEILOC_DATA --work work"
    $P scenes --csv docs/results/features/scenes.csv --kinds-csv docs/results/features/kinds.csv
    $P stress --csv docs/results/features/learned-stress.csv
    $P compact --csv docs/results/features/compact.csv --cost-csv docs/results/features/compact-cost.csv
    $P globals --csv docs/results/features/global-poses.csv
    $P bytes --csv docs/results/service/bytes.csv
    $P image-bytes --csv docs/results/service/image-bytes.csv

- scenes: poses of RedKitchen and Herz-Jesu with each kind of features, and the kinds. --features selects kinds.
- stress: `alike-t-compact` under stress.
- compact: RootSIFT beside compact descriptors, on the queries and on map images that are held out of their own map.
- globals: poses with VLAD and with a global descriptor of a network.
- bytes: sealed queries by number of keypoints.
- image-bytes: the same images as JPEG. Needs OpenCV.

Networks are found in the folders of VEILOC_MODELS. --work keeps the documents of commands that ended: a table that was interrupted
goes on. Delete it to measure again.
"""

import argparse
import os
import subprocess
import tempfile
from pathlib import Path

from places import write_csv
from privacy_tables import PROBLEMS, run, scene_of

# Kind: numbers, bits of each, what the network gets.
KINDS = {
    "sift": (128, 8, "as it is"), "compact": (64, 4, "as it is"), "xfeat": (64, 8, "fitted into the file's size"),
    "xfeat-compact": (48, 4, "as xfeat"), "alike-t": (64, 8, "as it is"), "alike-t-compact": (48, 4, "as it is"),
    "alike": (128, 8, "as it is"), "superpoint": (256, 8, "longest side 1024"),
}  # fmt: skip
MEASURED = [kind for kind in KINDS if kind != "superpoint"]
THRESHOLDS = {"redkitchen": ("0.02/2", "0.05/5"), "herzjesu": ("0.1/2", "0.25/5")}
STRESSED = "alike-t-compact"
SENT = [256, 512, 1024, 2048, 4096]
IMAGES = [("RedKitchen frame-000295, 640 × 480", "redkitchen/images/frame-000295.color.jpg"),
          ("Herz-Jesu 0000.jpg, 1536 × 1024", "herzjesu/images/0000.jpg")]  # fmt: skip


def eval_scene(args, place: str, schemes: str, *options) -> list[dict]:
    thresholds = ",".join(THRESHOLDS[place])
    return run(args, "eval", "scene", *scene_of(args, place), "--schemes", schemes, "--thresholds", thresholds, *options)["schemes"]


def cm(value) -> str:
    return "" if value is None else f"{100 * value:.2f}"


def scenes(args):
    table, bytes_of = [], {}
    for scene, place in PROBLEMS.items():
        for kind in args.features.split(","):
            for row in eval_scene(args, place, "points,dcl", "--features", kind):
                table.append([scene, kind, row["scheme"], cm(row["median_translation"]), f"{row['median_rotation_deg']:.3f}",
                              f"{100 * row['recall'][THRESHOLDS[place][0]]:.1f}", f"{100 * row['mean_inlier_ratio']:.1f}",
                              row["sealed_bytes"]])  # fmt: skip
                if row["scheme"] == "dcl":
                    bytes_of[kind] = max(row["sealed_bytes"], bytes_of.get(kind, 0))
    columns = ["scene", "features", "scheme", "median error (cm)", "median error (°)", "within 2 cm (10 cm) and 2° (%)", "inliers (%)",
               "query (bytes)"]  # fmt: skip
    write_csv(args.csv, columns, table)
    kinds = [[f"`{kind}`", numbers, bits, bytes_of.get(kind, ""), image] for kind, (numbers, bits, image) in KINDS.items()]
    write_csv(args.kinds_csv, ["`--features`", "numbers", "bits a number", "dcl query of 2048 rows (bytes)", "network input"], kinds)


def stress(args):
    table = []
    for scene, place in PROBLEMS.items():
        within = "0.05/5" if place == "redkitchen" else "0.25/2"
        rows = run(args, "eval", "stress", *scene_of(args, place), "--query-keypoints", 1024, "--schemes", "points,dcl", "--features",
                   STRESSED)["rows"]  # fmt: skip
        found = {(row["scheme"], row["stress"]): row for row in rows}
        for condition in dict.fromkeys(row["stress"] for row in rows):
            cells = []
            for scheme in ("points", "dcl"):
                row = found[scheme, condition]
                cells += [f"{100 * row['recall'][within]:.1f}", cm(row["median_translation"]), row["trusted"], row["trusted_wrong"]]
            table.append([scene, condition, *cells])
    columns = ["within (%)", "median (cm)", "trusted", "trusted wrongly"]
    write_csv(args.csv, ["scene", "stress", *(f"{scheme} {column}" for scheme in ("points", "dcl") for column in columns)], table)


def held_out(args, kind: str) -> Path:
    """Folder of the matches of map images, each held out of its own map."""
    folder = args.work / f"folds-{kind}"
    if not folder.exists():
        partial = folder.with_suffix(".partial")
        environment = dict(os.environ, VEILOC_DATA=str(args.data), VEILOC=str(args.veiloc))
        script = Path(__file__).resolve().parents[2] / "scripts/training_problems.sh"
        subprocess.run([script, partial, kind, "--query-keypoints", "1024"], check=True, env=environment, stdout=subprocess.DEVNULL)
        partial.rename(folder)
    return folder


def compact(args):
    table, kinds, cost = [], ("sift", "compact"), []
    for scene, place in PROBLEMS.items():
        found = [eval_scene(args, place, "points,dcl", "--query-keypoints", 1024, "--features", kind) for kind in kinds]
        table.append([f"{scene}, {found[0][0]['queries']} queries", *compared(found)])
        if place == "redkitchen":
            for rows in zip(*found):
                cost.append([rows[0]["scheme"], *(row["sealed_bytes"] for row in rows),
                             *(f"{row['median_ms']['match']:.1f}" for row in rows)])  # fmt: skip
    for scene, place in [*PROBLEMS.items(), ("Lund door", "lund-door")]:
        files = [held_out(args, kind) / f"{place}.jsonl.gz" for kind in kinds]
        found = [run(args, "eval", "pose", file, "--schemes", "points,dcl")["schemes"] for file in files]
        table.append([f"{scene}, folds, {found[0][0]['queries']}", *compared(found)])
    of = lambda what, unit: [f"{what}, {kind} ({unit})" for kind in kinds]
    write_csv(args.csv, ["queries", *of("points", "cm"), *of("dcl", "cm"), *of("points inliers", "%")], table)
    write_csv(args.cost_csv, ["scheme", *of("query of 1024 rows", "bytes"), *of("matching", "ms")], cost)


def compared(found: list[list[dict]]) -> list[str]:
    """Median errors of points and dcl with each kind, and inliers of points."""
    errors = [cm(row["median_translation"]) for rows in zip(*found) for row in rows]
    return errors + [f"{100 * rows[0]['mean_inlier_ratio']:.1f}" for rows in found]


def global_poses(args):
    table = []
    for scene, place in PROBLEMS.items():
        for model in ("vlad", "xfeat-netvlad"):
            for row in eval_scene(args, place, "points,dcl", "--global", model):
                table.append([scene, model, row["scheme"], row["queries"], row["localized"], cm(row["median_translation"]),
                              f"{row['median_rotation_deg']:.3f}", row["trusted"], row["trusted_wrong"],
                              f"{100 * row['mean_inlier_ratio']:.1f}", row["sealed_bytes"]])  # fmt: skip
    columns = ["scene", "global descriptor", "scheme", "queries", "localized", "median error (cm)", "median error (°)", "trusted",
               "trusted wrongly", "inliers (%)", "query (bytes)"]  # fmt: skip
    write_csv(args.csv, columns, table)


def sent_bytes(args):
    args.work.mkdir(parents=True, exist_ok=True)
    folder, kinds, sizes = args.data / "herzjesu", {"compact": "compact", "sift": "RootSIFT"}, {}
    with tempfile.TemporaryDirectory() as work:
        for kind in kinds:
            file, profile, query = (Path(work) / name for name in ("map", "profile", "query"))
            subprocess.run([args.veiloc, "map", "build", "--quiet", "--posed", folder / "posed", "--images", folder / "images",
                            "--list", folder / "map.txt", "--features", kind, "--query-keypoints", "4096", "-o", file],
                           check=True, stdout=subprocess.DEVNULL)  # fmt: skip
            subprocess.run([args.veiloc, "map", "profile", "--quiet", file, "-o", profile], check=True, stdout=subprocess.DEVNULL)
            for number in SENT:
                subprocess.run([args.veiloc, "seal", "--quiet", folder / "images/0000.jpg", "--camera", "unknown", "--profile", profile,
                                "--max-keypoints", str(number), "-o", query], check=True, stdout=subprocess.DEVNULL)  # fmt: skip
                sizes[kind, number] = query.stat().st_size
    table = [[number, *(sizes[kind, number] for kind in kinds)] for number in SENT]
    write_csv(args.csv, ["keypoints", *(f"dcl, {name} (bytes)" for name in kinds.values())], table)


def image_bytes(args):
    import cv2

    table, qualities = [], (75, 90, 95)
    for name, path in IMAGES:
        image = cv2.imread(str(args.data / path))
        sizes = [len(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]) for quality in qualities]
        table.append([name, *sizes])
    write_csv(args.csv, ["image", *(f"JPEG quality {quality} (bytes)" for quality in qualities)], table)


def main():
    commands = {"scenes": scenes, "stress": stress, "compact": compact, "globals": global_poses, "bytes": sent_bytes,
                "image-bytes": image_bytes}  # fmt: skip
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=commands)
    parser.add_argument("--veiloc", default="veiloc")
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--csv", type=Path)
    parser.add_argument("--kinds-csv", type=Path, help="second CSV of `scenes`: the kinds of features")
    parser.add_argument("--cost-csv", type=Path, help="second CSV of `compact`: bytes and time")
    parser.add_argument("--features", default=",".join(MEASURED), help="kinds of `scenes`")
    args = parser.parse_args()
    commands[args.what](args)


if __name__ == "__main__":
    main()
