#!/usr/bin/env python3
"""Measures what a server that has found the pose learns of something in front of its map, on several places.

    scripts/private_rows.py --veiloc target/release/veiloc --data $VEILOC_DATA --csv docs/results/privacy/hole.csv

Each place is a folder with `posed`, `images`, `map.txt` and `query.txt`. A tenth of each query's keypoints, in an upright
ellipse, loses its matches with the map, as if a person stood there; errors are measured on these keypoints.
"""

import argparse
import json
import subprocess
import tempfile
from pathlib import Path

from places import PLACES, write_csv

COLUMNS = [
    "place", "scheme", "queries", "prior (px)", "hole (px)", "< 30 px, hole (%)", "bits, hole",
    "bits, best other attack", "AUC of private rows among unexplained ones",
]  # fmt: skip


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--veiloc", default="veiloc")
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--csv", type=Path)
    parser.add_argument("--places", default=",".join(PLACES))
    parser.add_argument("--schemes", default="random-lines,dcl")
    parser.add_argument("--queries", type=int, default=10, help="attacked queries of each place, evenly spaced")
    args = parser.parse_args()
    rows = []
    for place in args.places.split(","):
        folder = args.data / place
        with tempfile.NamedTemporaryFile(suffix=".json") as file:
            subprocess.run(
                [args.veiloc, "eval", "adversaries", "--posed", folder / "posed", "--images", folder / "images",
                 "--map-list", folder / "map.txt", "--query-list", folder / "query.txt",
                 "--adversaries", "pose-server-private", "--schemes", args.schemes,
                 "--max-attacked", str(args.queries), "--json", file.name],
                check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)  # fmt: skip
            document = json.loads(Path(file.name).read_text())
        for row in document["rows"]:
            hole = next(attack for attack in row["attacks"] if attack["attack"] == "hole")
            other = max(a["bits_over_prior"] for a in row["attacks"] if a["attack"] != "hole")
            under = f"{100 * row['under_30px']:.0f}" if row["attack"] == "hole" else ""
            rows.append([
                place, row["scheme"], row["images"], f"{row['prior_median_px']:.0f}", f"{hole['median_px']:.0f}", under,
                f"{hole['bits_over_prior']:.2f}", f"{other:.2f}", f"{row['hiding_auc']:.2f}",
            ])  # fmt: skip
            print(*rows[-1], sep="  ", flush=True)
    write_csv(args.csv, COLUMNS, rows)


if __name__ == "__main__":
    main()
