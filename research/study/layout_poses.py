#!/usr/bin/env python3
"""Compares the poses of layouts of dcl on every place, by the rule of decision 0058.

    research/study/layout_poses.py --veiloc target/release/veiloc --data $VEILOC_DATA --work work --csv docs/results/privacy/layout-poses.csv \\
        --means docs/results/privacy/layout-pose-means.csv

Only the pose stage runs, on the matches of `private_rows.py`, which are kept in --work. A cell is a place as it is, with the left
or the right half of each image hidden, or with a map of every tenth image where one can be built.

The figure of a cell is the median error of the position over that of points; a lost query counts as infinite. A cell in which
points lose half of the queries is left out; a layout that loses half of them where points do not has the figure LOST.
"""

import argparse
import json
import math
import statistics
import subprocess
from pathlib import Path

from places import LAYOUTS, PLACES, kept_document, write_csv
from private_rows import Place, with_matches

SCHEMES = {"points": "points", "paper": "dcl:paper"} | LAYOUTS
LOST = 100


def hidden(problem, image, left):
    """The problem without the matches of one half of its image."""
    return with_matches(problem, [(u >= image["width"] / 2) == left for u, _ in problem["points2d"]])


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


def cells(place):
    """Problems of each cell of a place."""
    both = list(zip(place.of_queries, place.queries))
    found = {"as it is": place.of_queries}
    found["left half hidden"] = [hidden(problem, image, True) for problem, image in both]
    found["right half hidden"] = [hidden(problem, image, False) for problem, image in both]
    if problems := sparse(place):
        found["sparse map"] = problems
    return found


def poses(place, path, scheme):
    """Median error with lost queries as infinite, recall at 25 cm and 2°, trusted poses, queries."""
    document = kept_document(place.args.veiloc, place.work / "poses", "eval", "pose", path, "--schemes", scheme, "--recipes",
                             "default", "--thresholds", "0.05/5,0.25/2")  # fmt: skip
    errors = [query.get("translation_error") for query in document["queries"]]
    median = statistics.median(math.inf if error is None else error for error in errors)
    entry = document["schemes"][0]
    return median, 100 * entry["recall"]["0.25/2"], entry["trusted"], len(errors)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--veiloc", default="veiloc")
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--csv", type=Path)
    parser.add_argument("--means", type=Path, help="CSV of the means over places")
    parser.add_argument("--places", default=",".join(PLACES))
    parser.add_argument("--also", action="append", default=[], metavar="NAME=LAYOUT", help="one more layout")
    args = parser.parse_args()
    schemes = SCHEMES | dict(also.split("=", 1) for also in args.also)
    table, figures = [], {label: [] for label in schemes}
    for name in args.places.split(","):
        place = Place(args, name)
        for cell, problems in cells(place).items():
            path = place.work / f"{cell.replace(' ', '-')}.jsonl"
            path.write_text("".join(json.dumps(problem) + "\n" for problem in problems))
            rows = {label: poses(place, path, scheme) for label, scheme in schemes.items()}
            of_points = rows["points"][0]
            for label, (median, recall, trusted, queries) in rows.items():
                figure = min(LOST, median / of_points) if math.isfinite(of_points) else None
                if figure is not None:
                    figures[label].append((cell, figure, recall, 100 * trusted / queries, trusted))
                table.append([name, cell, label, queries, f"{recall:.0f}", trusted,
                              f"{median:.4f}" if math.isfinite(median) else "", "" if figure is None else f"{figure:.2f}"])  # fmt: skip
                print(*table[-1], sep="  ", flush=True)
    write_csv(args.csv, ["place", "cell", "layout", "queries", "within 25 cm and 2° (%)", "trusted", "median error (map units)",
                         "error over points"], table)  # fmt: skip
    names = ["as it is", "left half hidden", "right half hidden", "sparse map"]
    means = []
    for label, of in figures.items():
        mean = lambda cell: f"{statistics.geometric_mean(figure for name, figure, *_ in of if cell in ('', name)):.2f}"
        recall, share, trusted = ([row[k] for row in of] for k in (2, 3, 4))
        means.append([label, mean(""), *map(mean, names), f"{statistics.mean(recall):.1f}", f"{statistics.mean(share):.1f}",
                      sum(trusted)])  # fmt: skip
        print(*means[-1], sep="  ")
    write_csv(args.means, ["layout", "error over points, all cells", *names, "within 25 cm and 2° (%)", "trusted (%)",
                           "trusted poses"], means)  # fmt: skip


if __name__ == "__main__":
    main()
