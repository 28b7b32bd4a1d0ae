#!/usr/bin/env python3
"""Compares the poses of layouts of dcl on every place: as it is, half hidden, and in a sparse map (decision 0049).

    scripts/layout_poses.py --veiloc target/release/veiloc --data $VEILOC_DATA --work work --csv docs/results/privacy/layout-poses.csv

Only the pose stage runs, on the matches of `private_rows.py`, which are kept in --work. Half hidden: without the matches in the
left half of the image. Sparse map: of every tenth map image. A lost query counts as infinite; a cell in which points or any
layout loses half of the queries is left out of the mean.
"""

import argparse
import json
import math
import statistics
import subprocess
from pathlib import Path

from places import LAYOUTS, PLACES, write_csv
from private_rows import Place, with_matches

SCHEMES = {"points": "points", "paper": "dcl:paper"} | LAYOUTS


def half(problem, image):
    return with_matches(problem, [point[0] >= image["width"] / 2 for point in problem["points2d"]])


def sparse(place):
    """Problems with a map of every tenth image; `None` where it cannot be built."""
    out, names = place.work / "sparse.jsonl", place.names("map.txt")[::10]
    if not out.exists():
        listed = place.work / "sparse.txt"
        listed.write_text("".join(f"{name}\n" for name in names))
        made = subprocess.run(
            [place.args.veiloc, "eval", "problems", "--quiet", "--posed", place.folder / "posed", "--images",
             place.folder / "images", "--map-list", listed, "--query-list", place.folder / "query.txt", "-o", out],
            capture_output=True)  # fmt: skip
        if made.returncode:
            return None
    return [json.loads(line) for line in out.read_text().splitlines()]


def cell(place, name, problems):
    """Median error by scheme, with recall at 25 cm and 2° and the number of trusted poses."""
    path = place.work / f"{name.replace(' ', '-')}.jsonl"
    found = path.with_suffix(".poses.json")
    if not found.exists():
        path.write_text("".join(json.dumps(problem) + "\n" for problem in problems))
        place.run("eval", "pose", "--quiet", path, "--schemes", ",".join(SCHEMES.values()), "--recipes", "default",
                  "--thresholds", "0.05/5,0.25/2", "--json", found)  # fmt: skip
    document, rows = json.loads(found.read_text()), {}
    for (label, _), scheme in zip(SCHEMES.items(), document["schemes"]):
        of = [q for q in document["queries"] if q["scheme"] == scheme["scheme"]]
        errors = [q.get("translation_error") for q in of]
        median = statistics.median(math.inf if e is None else e for e in errors)
        lost = sum(e is None for e in errors) / len(errors)
        rows[label] = median, lost, 100 * scheme["recall"]["0.25/2"], scheme["trusted"], len(of)
    return rows


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--veiloc", default="veiloc")
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--csv", type=Path)
    parser.add_argument("--places", default=",".join(PLACES))
    args = parser.parse_args()
    table, ratios = [], {label: [] for label in SCHEMES}
    for name in args.places.split(","):
        place = Place(args, name)
        cells = {"as it is": place.of_queries}
        cells["half hidden"] = [half(p, image) for p, image in zip(place.of_queries, place.queries)]
        if problems := sparse(place):
            cells["sparse map"] = problems
        for what, problems in cells.items():
            rows = cell(place, what, problems)
            counted = all(lost < 0.5 and math.isfinite(median) for median, lost, *_ in rows.values())
            for label, (median, _, recall, trusted, queries) in rows.items():
                ratio = median / rows["points"][0] if counted else None
                if counted:
                    ratios[label].append(ratio)
                table.append([name, what, label, queries, f"{recall:.0f}", trusted, f"{median:.4f}",
                              "" if ratio is None else f"{ratio:.2f}"])  # fmt: skip
                print(*table[-1], sep="  ", flush=True)
    for label, of in ratios.items():
        table.append(["geometric mean", "", label, "", "", "", "", f"{statistics.geometric_mean(of):.2f}"])
        print(*table[-1], sep="  ")
    columns = ["place", "cell", "layout", "queries", "within 25 cm and 2° (%)", "trusted", "median error (map units)",
               "error over points"]  # fmt: skip
    write_csv(args.csv, columns, table)


if __name__ == "__main__":
    main()
