#!/usr/bin/env python3
"""Plots tables of docs/results/scale.md on log axes: compressed maps, and retrieval.

    scripts/scale_plots.py --compress compress.txt --search search.json     # into docs/images

compress.txt is the output of scripts/compress.sh, search.json that of `veiloc eval retrieval --json`. Standard library only.
"""

import argparse
import json
from pathlib import Path

from log_plot import LogPlot, page

IMAGES = Path(__file__).resolve().parent.parent / "docs/images"


def compressed(text):
    """Median error against bytes per image, for each scene and scheme."""
    plot = LogPlot("Median error of compressed maps", "kB per image", "cm", (0, 3), (-1, 1), width=720)
    lines = {}
    for row in (line.split("|") for line in text.splitlines() if line.startswith("|")):
        cells = [cell.strip() for cell in row[1:-1]]
        if cells[1].isdigit():
            scene, _, kilobytes, _, scheme = cells[:5]
            lines.setdefault((scene, scheme), []).append((float(kilobytes), float(cells[7].split(" cm")[0])))
    for (scene, scheme), points in lines.items():
        if scheme in ("points", "dcl") or scheme.startswith("dcl"):
            plot.line(f"{scene}, {scheme}", sorted(points), dashed=scene == "herzjesu")
    return page([plot])


def searched(document):
    rows = document["rows"]
    largest = max(row["images"] for row in rows)
    plot = LogPlot("Retrieval time", "images", "ms", (3, len(str(largest)) - 1), (-1, 3))
    for name, search in (("exhaustive", "all"), ("index", "index")):
        plot.line(name, [(row["images"], row["median_ms"]) for row in rows if row["search"] == search])
    return page([plot])


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--compress", type=Path, help="output of scripts/compress.sh")
    parser.add_argument("--search", type=Path, help="output of `veiloc eval retrieval --json`")
    args = parser.parse_args()
    if args.compress:
        (IMAGES / "compress.svg").write_text(compressed(args.compress.read_text()))
    if args.search:
        (IMAGES / "search.svg").write_text(searched(json.loads(args.search.read_text())))


if __name__ == "__main__":
    main()
