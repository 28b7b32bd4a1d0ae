#!/usr/bin/env python3
"""Two halves of a place in different gauges, joined by `veiloc map merge`.

    python -m venv venv && venv/bin/pip install numpy
    venv/bin/python research/study/map_merges.py VEILOC DATA WORK OUT.csv [PLACE…]

DATA/PLACE as for research/study/images_alone.py. The map images are cut into the first and the second half of the walk (by name). The poses
of the second half are transformed by a random similarity (scale 0.2 to 5, any rotation), a map is made of each half, and the second
is merged into the first, with `--keep-loose`; *refused*: without that option nothing is written. The errors are those of the
similarity that the command prints, against the inverse of the true one: its scale, its rotation, and the RMS distance of the second
half's camera centres from their true place. The hold-outs are localized in the first half, in the merged map, and in a map of all
images with the given poses.
"""

import json
import sys
from pathlib import Path

import numpy as np
from images_alone import arguments, errors, place_of, run, summary, write_rows
from geometry import center, quaternion

PLACES = ["redkitchen", "herzjesu", "hololens-office"]
SEEDS = [1, 2, 3]
SAME = (1.0, np.eye(3), np.zeros(3))


def gauge(seed):
    """A random similarity: scale, rotation, translation."""
    random = np.random.default_rng(seed)
    q, r = np.linalg.qr(random.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    q[:, 0] *= np.linalg.det(q)
    return np.exp(random.uniform(np.log(0.2), np.log(5))), q, random.normal(size=3) * 10


def write_posed(folder, truth, names, moved):
    """A COLMAP text model without points, its poses in another gauge."""
    folder.mkdir(parents=True, exist_ok=True)
    scale, turn, shift = moved
    cameras = sorted({truth[name][0] for name in names})
    (folder / "cameras.txt").write_text("".join(f"{i} {camera}\n" for i, camera in enumerate(cameras, 1)))
    lines = []
    for i, name in enumerate(names, 1):
        camera, r, t = truth[name]
        c = scale * turn @ center(r, t) + shift
        r = r @ turn.T
        numbers = " ".join(repr(float(x)) for x in [*quaternion(r), *(-r @ c)])
        lines.append(f"{i} {numbers} {1 + cameras.index(camera)} {name}\n\n")
    (folder / "images.txt").write_text("".join(lines))


def main():
    veiloc, data, work, out, places = arguments(__doc__, "veiloc", "data", "work", "out", "places")
    rows = []
    for place in places or PLACES:
        folder, kept = Path(data) / place, Path(work) / place
        _, truth, names, held_out = place_of(folder)
        names = sorted(names)
        halves = names[: len(names) // 2], names[len(names) // 2 :]
        build = [veiloc, "map", "build", "--images", folder / "images", "--work", kept / "work"]
        queries = kept / "queries.txt"
        first, whole, second = (kept / file for file in ("first.vmap", "whole.vmap", "second.vmap"))
        for chosen, file in [(names, whole), (halves[0], first)]:
            write_posed(kept / file.stem, truth, chosen, SAME)
            run(build + ["--posed", kept / file.stem, "-o", file])
        queries.write_text("".join(f"{name} {truth[name][0]}\n" for name in held_out))
        localized = lambda file: errors(veiloc, file, queries, folder / "images", truth, SAME)
        for kind, file, count in [("all images, given poses", whole, len(names)), ("the first half", first, len(halves[0]))]:
            rows.append({"place": place, "map": kind, "images": count, **dict.fromkeys(MERGED, ""), **summary(localized(file))})
        for seed in SEEDS:
            scale, turn, shift = gauge(seed)
            write_posed(kept / "second", truth, halves[1], (scale, turn, shift))
            run(build + ["--posed", kept / "second", "-o", second])
            merged = kept / "merged.vmap"
            document = json.loads(run([veiloc, "map", "merge", first, second, "-o", merged, "--keep-loose", "--json"])[0])
            found = document["alignment"]
            s, r, t = found["scale"], np.array(found["rotation"]), np.array(found["translation"])
            true = np.array([center(*truth[name][1:]) for name in halves[1]])
            there = scale * true @ turn.T + shift
            apart = np.linalg.norm(s * there @ r.T + t - true, axis=1)
            angle = np.degrees(np.arccos(np.clip((np.trace(r @ turn) - 1) / 2, -1, 1)))
            loose = any(warning["name"] == "loose-merge" for warning in document["warnings"])
            off = [f"{100 * (s * scale - 1):.3f}", f"{angle:.4f}", f"{np.sqrt((apart**2).mean()):.4f}"]
            values = [found["localized"], "yes" if loose else "no", *off]
            rows.append(
                {
                    "place": place,
                    "map": f"the halves merged, gauge {seed}",
                    "images": document["images"],
                    **dict(zip(MERGED, values)),
                    **summary(localized(merged)),
                }
            )
            print(rows[-1], file=sys.stderr)
            write_rows(out, rows)


MERGED = ["images that agree", "refused", "error of scale (%)", "error of rotation (°)", "centres of the second half, RMS (map units)"]

if __name__ == "__main__":
    main()
