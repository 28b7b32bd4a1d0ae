#!/usr/bin/env python3
"""Writes tables of docs/results/scale.md, each by one command.

    P="scripts/scale_tables.py --veiloc target/release/veiloc --data $VEILOC_DATA --work work"
    $P compress --csv docs/results/scale/compress.csv
    $P regions --csv docs/results/scale/regions.csv
    $P retrieval --csv docs/results/scale/retrieval.csv
    $P drawn --csv docs/results/scale/drawn.csv

- compress: poses in smaller maps of RedKitchen and Herz-Jesu. With `--negatives 10` also prints how many out-of-map images (no
  default was chosen with them) are trusted or doubtful in RedKitchen's map at a tenth.
- regions: RedKitchen cut into regions of at most 40 and 20 images.
- retrieval: RedKitchen's map images among out-of-map images and images drawn from them. --sizes are the numbers of images.
- drawn: the benchmark `search` of veiloc-benches, on drawn scenes of ten images; cargo builds it.

--work keeps the documents of commands that ended: a table that was interrupted goes on. Delete it to measure again.
"""

import argparse
import os
import re
import subprocess
from pathlib import Path

from places import write_csv
from privacy_tables import PROBLEMS, run, scene_of

TIMES = [1, 5, 10, 20, 40, 80]
THRESHOLDS = {"redkitchen": ("0.02/2", "0.05/5"), "herzjesu": ("0.1/2", "0.25/5")}
REGIONS = [None, 40, 20]
SIZES = "1000,10000,100000,1000000"
OUTPUT = re.compile(r"^ *(\d+) (\S.*?) +([\d.]+) +([\d.]+) +([\d.]+) +([\d.]+) %$", re.M)


def eval_scene(args, place: str, *options) -> dict:
    return run(args, "eval", "scene", *scene_of(args, place), "--schemes", "points,dcl", "--thresholds", ",".join(THRESHOLDS[place]),
               "--work", args.work / f"scene-{place}", *options)  # fmt: skip


def short(value: float) -> str:
    """Two digits, or all before the point."""
    return f"{value:.0f}" if value >= 10 else f"{value:.2g}"


def compress(args):
    table = []
    for scene, place in PROBLEMS.items():
        for times in TIMES:
            found = eval_scene(args, place, *([] if times == 1 else ["--compress", times]))
            cells = [cell for row in found["schemes"]
                     for cell in (f"{100 * row['median_translation']:.2f}", f"{100 * row['recall'][THRESHOLDS[place][0]]:.0f}",
                                  row["trusted"])]  # fmt: skip
            of = found["map"]
            table.append([scene, times, f"{of['bytes'] / of['images'] / 1e3:.1f}", of["points"], *cells])
    of = lambda scheme: [f"{scheme} median (cm)", f"{scheme} within 2 cm (10 cm) and 2° (%)", f"{scheme} trusted"]
    write_csv(args.csv, ["scene", "times smaller", "kB an image", "map points", *of("points"), *of("dcl")], table)
    for times in args.negatives:
        small = args.work / f"redkitchen-{times}.vmap"
        if not small.exists():
            whole = args.work / "redkitchen.vmap"
            subprocess.run([args.veiloc, "map", "compress", "--quiet", redkitchen(args, whole), "--ratio", str(times), "-o", small],
                           check=True, stdout=subprocess.DEVNULL)  # fmt: skip
        found = run(args, "eval", "negatives", "--map", small, "--images", args.data / "training-photos", "--split", "final")
        for row in found["rows"]:
            print(f"at 1/{times}, {row['scheme']}: {row['trusted']} trusted and {row['doubtful']} doubtful of {row['negatives']}")


def redkitchen(args, file: Path) -> Path:
    """The map of RedKitchen; made once."""
    if not file.exists():
        args.work.mkdir(parents=True, exist_ok=True)
        subprocess.run([args.veiloc, "map", "build", "--quiet", *scene_of(args, "redkitchen")[:4], "--list",
                        args.data / "redkitchen/map.txt", "-o", file], check=True, stdout=subprocess.DEVNULL)  # fmt: skip
    return file


def regions(args):
    table = []
    for images in REGIONS:
        found = eval_scene(args, "redkitchen", *([] if images is None else ["--regions", images]))
        cells = [cell for row in found["schemes"]
                 for cell in (f"{100 * row['median_translation']:.2f}", f"{row['median_rotation_deg']:.2f}", row["trusted"])]  # fmt: skip
        of = found["map"]
        if images is None:
            table.append(["whole", "", "", f"{of['bytes'] / 1e6:.1f}", "", *cells])
        else:
            cut = of["regions"]
            table.append([f"regions of {images}", cut["count"], f"{cut['images_total'] / of['images']:.2f}",
                          f"{cut['bytes'] / 1e6:.1f}", f"{cut['largest_bytes'] / 1e6:.1f}", *cells])  # fmt: skip
    of = lambda scheme: [f"{scheme} median (cm)", f"{scheme} median (°)", f"{scheme} trusted"]
    columns = ["map", "regions", "regions that hold an image (mean)", "all regions (MB)", "largest region (MB)", *of("points"), *of("dcl")]
    write_csv(args.csv, columns, table)


def retrieval(args):
    kitchen = args.data / "redkitchen"
    found = run(args, "eval", "retrieval", "--map", redkitchen(args, args.work / "redkitchen.vmap"), "--images", kitchen / "images",
                "--query-list", kitchen / "query.txt", "--distractors", args.data / "training-photos", "--sizes", args.sizes)  # fmt: skip
    table = []
    for row in found["rows"]:
        every = row["search"] == "all"
        table.append([row["images"], "every image" if every else "index", "" if every else short(row["build_seconds"]),
                      f"{row['bytes'] / 1e6:.0f}", short(row["median_ms"]), "100" if every else f"{100 * row['recall']:.1f}",
                      f"{100 * row['map_share']:.1f}"])  # fmt: skip
    columns = ["images", "compared", "build of the index (s)", "memory (MB)", "retrieval (ms)", "recall@10 (%)",
               "images of the map among the ten (%)"]  # fmt: skip
    write_csv(args.csv, columns, table)


def drawn(args):
    # The exhaustive search is of every image; the benchmark prints zeros for what it does not need.
    printed = subprocess.run(["cargo", "bench", "--locked", "-p", "veiloc-benches", "--bench", "search"], check=True,
                             stdout=subprocess.PIPE, text=True, cwd=Path(__file__).resolve().parent.parent,
                             env=dict(os.environ, IMAGES=args.sizes.removeprefix("1000,"))).stdout  # fmt: skip
    table = []
    for images, search, build, memory, ms, recall in OUTPUT.findall(printed):
        every = search == "exhaustive"
        table.append([images, "every image" if every else "index", "" if every else short(float(build)),
                      "" if every else f"{float(memory):.0f}", short(float(ms)), "100" if every else recall])  # fmt: skip
    write_csv(args.csv, ["images", "method", "build (s)", "memory beside the descriptors (MB)", "retrieval (ms)", "recall@10 (%)"], table)


def main():
    commands = {"compress": compress, "regions": regions, "drawn": drawn}
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=commands)
    parser.add_argument("--veiloc", default="veiloc")
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--csv", type=Path)
    parser.add_argument("--sizes", default=SIZES, help="numbers of images of `retrieval` and `drawn`, which leaves out a thousand")
    parser.add_argument("--negatives", type=int, nargs="*", default=[], help="ratios of `compress` with out-of-map images")
    args = parser.parse_args()
    commands[args.what](args)


if __name__ == "__main__":
    main()
