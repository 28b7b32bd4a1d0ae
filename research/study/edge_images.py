#!/usr/bin/env python3
"""Localizes edge images (Canny) with the same pipeline as photographs, beside line schemes on the photographs.

    research/study/edge_images.py --veiloc target/release/veiloc --data $VEILOC_DATA --csv docs/results/privacy/edges.csv

Map and queries of a place are replaced by their edge images, and the queries sent as points. Needs OpenCV (`cv2`).
"""

import argparse
import json
import subprocess
import tempfile
from pathlib import Path

import cv2

from places import write_csv

PLACES = ["llff-room", "redkitchen", "herzjesu"]
THRESHOLDS = (100, 200)


def edges(source, target, names):
    for name in names:
        path = target / name
        path.parent.mkdir(parents=True, exist_ok=True)
        gray = cv2.imread(str(source / name), cv2.IMREAD_GRAYSCALE)
        # Thin lines have no scale; a little blur gives them one.
        found = cv2.GaussianBlur(255 - cv2.Canny(gray, *THRESHOLDS), (0, 0), 1.0)
        cv2.imwrite(str(path), found, [cv2.IMWRITE_JPEG_QUALITY, 95])


def names_of(path):
    return [line.split()[0] for line in path.read_text().splitlines() if line.strip() and not line.startswith("#")]


def scene(args, folder, images, schemes, work):
    found = work / "scene.json"
    subprocess.run(
        [args.veiloc, "eval", "scene", "--quiet", "--posed", folder / "posed", "--images", images, "--map-list",
         folder / "map.txt", "--query-list", folder / "query.txt", "--schemes", schemes, "--thresholds", "0.05/5,0.25/2",
         "--json", found], check=True, stdout=subprocess.DEVNULL)  # fmt: skip
    return json.loads(found.read_text())["schemes"]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--veiloc", default="veiloc")
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--csv", type=Path)
    parser.add_argument("--places", default=",".join(PLACES))
    args = parser.parse_args()
    rows = []
    for place in args.places.split(","):
        folder = args.data / place
        with tempfile.TemporaryDirectory() as work:
            work = Path(work)
            edges(folder / "images", work / "images", names_of(folder / "map.txt") + names_of(folder / "query.txt"))
            for what, images, schemes in [("edge images, points", work / "images", "points"),
                                          ("photographs", folder / "images", "points,dcl")]:  # fmt: skip
                for scheme in scene(args, folder, images, schemes, work):
                    label = what if what != "photographs" else f"photographs, {scheme['scheme']}"
                    recall = scheme["recall"]
                    rows.append([place, label, scheme["queries"], scheme["trusted"], f"{100 * recall['0.05/5']:.0f}",
                                 f"{100 * recall['0.25/2']:.0f}", f"{scheme['median_translation']:.4f}",
                                 f"{scheme['median_rotation_deg']:.3f}"])  # fmt: skip
                    print(*rows[-1], sep="  ", flush=True)
    columns = ["place", "sent", "queries", "trusted", "within 5 cm and 5° (%)", "within 25 cm and 2° (%)",
               "median error (map units)", "median error (°)"]  # fmt: skip
    write_csv(args.csv, columns, rows)


if __name__ == "__main__":
    main()
