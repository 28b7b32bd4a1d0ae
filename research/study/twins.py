#!/usr/bin/env python3
"""Localizes queries in a map that holds a part of the scene twice, and counts in which of both places they are found.

    research/study/twins.py --veiloc target/release/veiloc --data $VEILOC_DATA --csv docs/results/trust/twins.csv

The twin is made of copies of map images whose poses are moved by ten map units: `8 of 24` copies every third of the 24
images nearest to the queries, `24 of 24` all of them, `8 in a row` eight neighbours.
"""

import argparse
import json
import math
import subprocess
import tempfile
from pathlib import Path

from places import write_csv
from wrong_cameras import centre, read_posed, rotation

SHIFT = [10.0, 0.0, 0.0]
COLUMNS = ["scene", "twin", "scheme", "queries", "trusted in the right place", "trusted in the twin", "doubtful", "other"]


def twins(block: list[str]) -> dict[str, list[str]]:
    return {"none": [], "8 of 24": block[1::3], "24 of 24": block, "8 in a row": block[8:16]}


def moved(q, t):
    r = rotation(q)
    return [t[i] - sum(r[i][k] * SHIFT[k] for k in range(3)) for i in range(3)]


def write_scene(folder: Path, images: Path, poses, names, copied):
    """A folder with both: `posed`, and `images` with links to the images."""
    (folder / "posed").mkdir(parents=True)
    cameras, lines = {}, []
    entries = [(f"a/{n}", n, poses[n][1]) for n in names] + [(f"b/{n}", n, moved(*poses[n][:2])) for n in copied]
    for number, (name, source, t) in enumerate(entries, 1):
        q, _, camera = poses[source]
        camera = cameras.setdefault(" ".join(camera), len(cameras) + 1)
        lines.append(f"{number} {' '.join(map(repr, [*q, *t]))} {camera} {name}\n\n")
        link = folder / "images" / name
        link.parent.mkdir(parents=True, exist_ok=True)
        link.symlink_to((images / source).resolve())
    (folder / "posed" / "cameras.txt").write_text("".join(f"{n} {text}\n" for text, n in cameras.items()))
    (folder / "posed" / "images.txt").write_text("".join(lines))
    (folder / "posed" / "points3D.txt").write_text("")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--veiloc", default="veiloc")
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--csv", type=Path)
    parser.add_argument("--scene", default="redkitchen")
    parser.add_argument("--schemes", default="points,dcl")
    args = parser.parse_args()
    scene = args.data / args.scene
    poses = read_posed(scene / "posed")
    names, queries = [
        [line.split()[0] for line in (scene / f"{which}.txt").read_text().splitlines() if line.strip()]
        for which in ("map", "query")
    ]
    rows = []
    asked = [centre(*poses[query][:2]) for query in queries]
    to_queries = {name: min(math.dist(centre(*poses[name][:2]), at) for at in asked) for name in names}
    near = set(sorted(names, key=to_queries.get)[:24])
    for twin, copied in twins([name for name in names if name in near]).items():
        with tempfile.TemporaryDirectory() as folder:
            folder = Path(folder)
            write_scene(folder, scene / "images", poses, names, copied)
            subprocess.run([args.veiloc, "map", "build", "--quiet", "--no-frame-check", "--posed", folder / "posed",
                            "--images", folder / "images", "-o", folder / "map.vmap"],
                           check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)  # fmt: skip
            (folder / "queries.txt").write_text("".join(f"{n} {' '.join(poses[n][2])}\n" for n in queries))
            for scheme in args.schemes.split(","):
                # Exit codes above 0 tell that some queries are doubtful or not found.
                document = json.loads(subprocess.run(
                    [args.veiloc, "localize", "--quiet", "--map", folder / "map.vmap", "--queries",
                     folder / "queries.txt", "--images", scene / "images", "--scheme", scheme, "--json"],
                    stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True).stdout)  # fmt: skip
                counts = {"right": 0, "twin": 0, "doubtful": 0, "other": 0}
                for query in document["queries"]:
                    pose, (q, t, _) = query.get("cam_from_world"), poses[query["file"]]
                    if query["state"] != "trusted":
                        counts["doubtful" if query["state"] == "doubtful" else "other"] += 1
                        continue
                    found = centre(pose["q"], pose["t"])
                    distance = [math.dist(found, centre(q, of)) for of in (t, moved(q, t))]
                    counts["right" if distance[0] < 0.25 else "twin" if distance[1] < 0.25 else "other"] += 1
                rows.append([args.scene, twin, scheme, len(queries), *counts.values()])
                print(*rows[-1], sep="  ", flush=True)
    write_csv(args.csv, COLUMNS, rows)


if __name__ == "__main__":
    main()
