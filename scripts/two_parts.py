#!/usr/bin/env python3
"""Photographs of two places in one folder: `veiloc map build --components` writes a map of each.

    python -m venv venv && venv/bin/pip install numpy pycolmap
    venv/bin/python scripts/two_parts.py VEILOC DATA WORK OUT.csv [PLACE PLACE]

DATA/PLACE as for scripts/images_alone.py. The map images of both are copied into one folder. Each map is assigned to the place of most of
its images; the hold-outs of this place are localized in it with the camera that the map estimated, and poses are moved by the
similarity that fits the centres of its images to the given ones.
"""

import json
import shutil
import sys
from pathlib import Path

import numpy as np
from images_alone import center, errors, given_poses, place_of, run, similarity, summary, write_csv


def main():
    veiloc, data, work, out, *places = sys.argv[1:]
    places, work = places or ["fountain", "entry"], Path(work)
    images = work / "images"
    images.mkdir(parents=True, exist_ok=True)
    given = {}
    for place in places:
        _, truth, names, held_out = place_of(Path(data) / place)
        given[place] = truth, names, held_out
        for name in names:
            shutil.copy(Path(data) / place / "images" / name, images / f"{place}-{name}")
    run([veiloc, "map", "build", "--images", images, "--python", sys.executable, "--components", "-o", work / "place.vmap"])
    rows = []
    for file in [work / "place.vmap", *sorted(work.glob("place-*.vmap"))]:
        run([veiloc, "map", "export", file, "--colmap", work / "export", "--text"])
        posed = given_poses(work / "export")
        of = {place: [name for name in posed if name.startswith(f"{place}-")] for place in places}
        place = max(of, key=lambda place: len(of[place]))
        truth, names, held_out = given[place]
        centers = lambda name: (center(*posed[name][1:]), center(*truth[name.removeprefix(f"{place}-")][1:]))
        pairs = [centers(name) for name in of[place]]
        moved = similarity(np.array([p[0] for p in pairs]), np.array([p[1] for p in pairs]))
        (camera,) = {camera for camera, _, _ in posed.values()}
        queries = work / "queries.txt"
        queries.write_text("".join(f"{name} {camera}\n" for name in held_out))
        found = errors(veiloc, file, queries, Path(data) / place / "images", truth, moved)
        rows.append(
            {
                "map": file.name,
                "place": place,
                "images": len(posed),
                "of the place": len(names),
                "of the other place": len(posed) - len(of[place]),
                **summary(found),
            }
        )
        print(json.dumps(rows[-1]), file=sys.stderr)
    write_csv(out, rows)


if __name__ == "__main__":
    main()
