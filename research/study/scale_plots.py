#!/usr/bin/env python3
"""Plots tables of docs/results/scale.md on log axes: compressed maps, and retrieval.

    research/study/scale_plots.py     # docs/results/scale/compress.csv and retrieval.csv into docs/images

Standard library only.
"""

import csv
from pathlib import Path

from log_plot import LogPlot, page

DOCS = Path(__file__).resolve().parents[2] / "docs"


def rows_of(name):
    with (DOCS / f"results/scale/{name}.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def compressed(rows):
    """Median error against bytes per image, for each scene and scheme."""
    plot = LogPlot("Median error of compressed maps", "kB per image", "cm", (0, 3), (-1, 1), width=720)
    for scene in dict.fromkeys(row["scene"] for row in rows):
        for scheme in ("points", "dcl"):
            points = [(float(row["kB an image"]), float(row[f"{scheme} median (cm)"])) for row in rows if row["scene"] == scene]
            plot.line(f"{scene}, {scheme}", sorted(points), dashed=scene == "Herz-Jesu")
    return page([plot])


def searched(rows):
    largest = max(int(row["images"]) for row in rows)
    plot = LogPlot("Retrieval time", "images", "ms", (3, len(str(largest)) - 1), (-1, 3))
    for name, search in (("exhaustive", "every image"), ("index", "index")):
        plot.line(name, [(int(row["images"]), float(row["retrieval (ms)"])) for row in rows if row["compared"] == search])
    return page([plot])


def main():
    (DOCS / "images/compress.svg").write_text(compressed(rows_of("compress")))
    (DOCS / "images/search.svg").write_text(searched(rows_of("retrieval")))


if __name__ == "__main__":
    main()
