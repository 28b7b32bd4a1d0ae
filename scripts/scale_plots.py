#!/usr/bin/env python3
"""Draws tables of docs/results/scale.md on log axes: small maps, and search.

    scripts/scale_plots.py --compress compress.txt --search search.json     # into docs/images

compress.txt is what scripts/compress.sh prints, search.json what `veiloc eval search --json` writes. Standard library only.
"""

import argparse
import json
from pathlib import Path

from log_plot import LogPlot, page

IMAGES = Path(__file__).resolve().parent.parent / "docs/images"


def compressed(text):
    """Median errors against bytes: of each place and scheme."""
    plot = LogPlot("Median error of small maps", "kB an image", "cm", (0, 3), (-1, 1), width=720)
    lines = {}
    for row in (line.split("|") for line in text.splitlines() if line.startswith("|")):
        cells = [cell.strip() for cell in row[1:-1]]
        if cells[1].isdigit():
            place, _, kilobytes, _, scheme = cells[:5]
            lines.setdefault((place, scheme), []).append((float(kilobytes), float(cells[7].split(" cm")[0])))
    for (place, scheme), points in lines.items():
        if scheme in ("points", "dcl") or scheme.startswith("dcl"):
            plot.line(f"{place}, {scheme}", sorted(points), dashed=place == "herzjesu")
    return page([plot])


def searched(document):
    rows = document["rows"]
    most = max(row["images"] for row in rows)
    plot = LogPlot("A search among images", "images", "ms", (3, len(str(most)) - 1), (-1, 3))
    for name, search in (("all compared", "all"), ("index", "index")):
        plot.line(name, [(row["images"], row["median_ms"]) for row in rows if row["search"] == search])
    return page([plot])


def main():
    words = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    words.add_argument("--compress", type=Path, help="what scripts/compress.sh printed")
    words.add_argument("--search", type=Path, help="the document of `veiloc eval search --json`")
    asked = words.parse_args()
    if asked.compress:
        (IMAGES / "compress.svg").write_text(compressed(asked.compress.read_text()))
    if asked.search:
        (IMAGES / "search.svg").write_text(searched(json.loads(asked.search.read_text())))


if __name__ == "__main__":
    main()
