#!/usr/bin/env python3
"""Writes tables of docs/results/privacy.md that need one attack only.

    scripts/privacy_tables.py paper --veiloc target/release/veiloc --data $VEILOC_DATA --csv docs/results/privacy/paper.csv

- paper: the paper's attack on the keypoints of `problems`, beside the paper's figures.
"""

import argparse
import json
import subprocess
import tempfile
from pathlib import Path

from places import write_csv

PROBLEMS = {"RedKitchen": "redkitchen", "Herz-Jesu": "herzjesu"}


def attacks(args, *command) -> list[dict]:
    """The rows of `veiloc attack`."""
    with tempfile.TemporaryDirectory() as work:
        found = Path(work) / "found.json"
        subprocess.run([args.veiloc, "attack", *map(str, command), "--quiet", "--json", found], check=True, stdout=subprocess.DEVNULL)
        return json.loads(found.read_text())["attacks"]


def keypoints(args, name: str) -> Path:
    return args.data / "problems" / f"{PROBLEMS[name]}_keypoints.jsonl.gz"


def paper(args):
    table = [["paper", "7Scenes", scheme, mean, ""] for scheme, mean in
             (("random-lines", "6.137"), ("coordinate-permutation", "10.56"), ("dcl", "330.4"))]  # fmt: skip
    for name, few, all_of_dcl in (("RedKitchen", 4, 22), ("Herz-Jesu", 2, 8)):
        for schemes, limit in (("random-lines,coordinate-permutation", few), ("dcl", all_of_dcl)):
            rows = attacks(args, keypoints(args, name), "--limit", limit, "--schemes", schemes, "--attacks", "closed-form")
            mean = {(row["scheme"], row["attack"]): row["mean_px"] for row in rows}
            for scheme in schemes.split(","):
                table.append(["veiloc", f"{name}, {limit} images", scheme, f"{mean[scheme, 'closed-form']:.1f}",
                              f"{mean[scheme, 'prior']:.1f}"])  # fmt: skip
    columns = ["source", "images", "scheme", "closed-form attack, mean (px)", "prior-only baseline, mean (px)"]
    write_csv(args.csv, columns, table)


def main():
    commands = {"paper": paper}
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=commands)
    parser.add_argument("--veiloc", default="veiloc")
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--csv", type=Path)
    args = parser.parse_args()
    commands[args.what](args)


if __name__ == "__main__":
    main()
