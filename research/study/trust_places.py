#!/usr/bin/env python3
"""Counts trusted poses under stress, and of out-of-map images, on several places with the same command.

    research/study/trust_places.py --veiloc target/release/veiloc --data $VEILOC_DATA --work maps \
        --stress-csv docs/results/trust/places-stress.csv --negatives-csv docs/results/trust/places-negatives.csv --every 8

Builds a map of each place with its self-test in `--work` (kept for the next run). The out-of-map images are those of
`training-photos` in the half that chose no constant; `--every N` takes each Nth of all. A pose is wrong beyond 25 cm (map units) or 2°.
"""

import argparse
import json
import subprocess
from pathlib import Path

from places import PLACES, write_csv

STRESS_COLUMNS = [
    "place", "stress", "scheme", "queries", "within 5 cm and 5° (%)", "within 25 cm and 2° (%)",
    "median error (map units)", "trusted", "trusted wrongly", "of these beyond 3 ±", "trusted, centre beyond 3 ±",
    "trusted, orientation beyond 3 ±",
]  # fmt: skip
NEGATIVES_COLUMNS = [
    "place", "scheme", "negative queries", "trusted", "doubtful", "not found", "log evidence, 99 % quantile",
    "log evidence, largest",
]  # fmt: skip


def document(*command) -> dict:
    # Exit codes above 0 tell that some queries are doubtful or not found.
    return json.loads(subprocess.run([*map(str, command), "--json", "-"], stdout=subprocess.PIPE, text=True).stdout)


def number(value, form: str) -> str:
    return "" if value is None else format(value, form)


def stress_rows(place: str, found: dict) -> list[list]:
    rows = []
    for row in found["rows"]:
        own = [
            q for q in found["queries"]
            if q["scheme"] == row["scheme"] and q["stress"] == row["stress"] and q["state"] == "trusted"
        ]  # fmt: skip
        moved = [q for q in own if q["center_error_over_sd"] is None or q["center_error_over_sd"] > 3]
        turned = [q for q in own if q["rotation_error_deg"] > 3 * (q["rotation_sd_deg"] or 0)]
        wrong = [q for q in own if q["translation_error"] > 0.25 or q["rotation_error_deg"] > 2]
        beyond = [q for q in wrong if q in moved or q in turned]
        rows.append([
            place, row["stress"], row["scheme"], row["queries"], f"{100 * row['recall']['0.05/5']:.1f}",
            f"{100 * row['recall']['0.25/2']:.1f}", number(row["median_translation"], ".4g"), row["trusted"],
            len(wrong), len(beyond), len(moved), len(turned),
        ])  # fmt: skip
    return rows


def negative_rows(place: str, found: dict) -> list[list]:
    return [
        [
            place, row["scheme"], row["negatives"], row["trusted"], row["doubtful"], row["not_found"],
            number(row["log_evidence"]["99"], ".1f"), number(row["log_evidence"]["100"], ".1f"),
        ]
        for row in found["rows"]
    ]  # fmt: skip


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--veiloc", default="veiloc")
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--stress-csv", type=Path)
    parser.add_argument("--negatives-csv", type=Path)
    parser.add_argument("--places", default=",".join(PLACES))
    parser.add_argument("--schemes", default="points,dcl")
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--stress", default="dark,motion,half-hidden,low-resolution,sparse-map,few-keypoints")
    args = parser.parse_args()
    args.work.mkdir(parents=True, exist_ok=True)
    photos = sorted((args.data / "training-photos").rglob("*.jpg"))
    names = [str(photo.relative_to(args.data / "training-photos")) for photo in photos[:: args.every]]
    (args.work / "negatives.txt").write_text("\n".join(names))
    stressed, negatives = [], []
    for place in args.places.split(","):
        folder, built = args.data / place, args.work / f"{place}.vmap"
        posed = ["--posed", folder / "posed", "--images", folder / "images"]
        if args.stress_csv:
            found = document(
                args.veiloc, "eval", "stress", "-q", *posed, "--map-list", folder / "map.txt", "--query-list",
                folder / "query.txt", "--schemes", args.schemes, "--stress", args.stress,
            )  # fmt: skip
            stressed += stress_rows(place, found)
            write_csv(args.stress_csv, STRESS_COLUMNS, stressed)
        if args.negatives_csv:
            if not built.exists():
                subprocess.run([args.veiloc, "map", "build", "--quiet", *posed, "--list", folder / "map.txt", "-o",
                                built], check=True, stdout=subprocess.DEVNULL)  # fmt: skip
            found = document(
                args.veiloc, "eval", "negatives", "-q", "--map", built, "--images", args.data / "training-photos",
                "--list", args.work / "negatives.txt", "--split", "final", "--schemes", args.schemes,
            )  # fmt: skip
            negatives += negative_rows(place, found)
            write_csv(args.negatives_csv, NEGATIVES_COLUMNS, negatives)
        print(place, flush=True)


if __name__ == "__main__":
    main()
