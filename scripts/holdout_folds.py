#!/usr/bin/env python3
"""Localizes every map image of a place once, held out in three folds: figures to choose settings by.

The query list is never touched, so that it stays fit for the final figures.

    cargo build --release
    scripts/holdout_folds.py $VEILOC_DATA/redkitchen --block 4
    scripts/holdout_folds.py $VEILOC_DATA/herzjesu --block 1
"""

import argparse
import json
import statistics
import subprocess
import tempfile
from pathlib import Path


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("place", type=Path, help="folder with posed/, images/ and map.txt")
    parser.add_argument("--block", type=int, default=1, help="neighbours held out together: a walk wants more than 1")
    parser.add_argument("--folds", type=int, default=3)
    parser.add_argument("--schemes", default="points,dcl")
    parser.add_argument("--veiloc", default="target/release/veiloc")
    arguments = parser.parse_args()

    names = [line.strip() for line in (arguments.place / "map.txt").read_text().splitlines() if line.strip()]
    errors = {}
    with tempfile.TemporaryDirectory() as folder:
        lists = {kind: Path(folder) / f"{kind}.txt" for kind in ("map", "query")}
        for fold in range(arguments.folds):
            held = [n for i, n in enumerate(names) if (i // arguments.block) % arguments.folds == fold]
            lists["query"].write_text("\n".join(held))
            lists["map"].write_text("\n".join(n for n in names if n not in held))
            document = Path(folder) / "result.json"
            subprocess.run([
                arguments.veiloc, "-q", "eval", "scene", "--posed", arguments.place / "posed",
                "--images", arguments.place / "images", "--map-list", lists["map"], "--query-list", lists["query"],
                "--schemes", arguments.schemes, "--json", document,
            ], check=True, stdout=subprocess.DEVNULL)
            for query in json.loads(document.read_text())["queries"]:
                # Not localized is infinitely wrong.
                error = [query[key] if query[key] is not None else float("inf")
                         for key in ("translation_error", "rotation_error_deg")]
                errors.setdefault(query["scheme"], []).append((*error, query["inliers"]))
    for scheme, rows in errors.items():
        translation, rotation, inliers = (statistics.median(column) for column in zip(*rows))
        print(f"{scheme}: {len(rows)} queries, median {100 * translation:.2f} cm / {rotation:.3f} deg, "
              f"{inliers:.0f} inliers (map units taken for metres)")


if __name__ == "__main__":
    main()
