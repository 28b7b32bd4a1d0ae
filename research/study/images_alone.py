#!/usr/bin/env python3
"""Maps of images alone against maps of given poses, on places with hold-outs.

    python -m venv venv && venv/bin/pip install numpy pycolmap
    venv/bin/python research/study/images_alone.py VEILOC DATA WORK OUT.csv [PLACE…]

DATA/PLACE has images/, posed/ (COLMAP text) or a complete model sparse/, and map.txt and query.txt; without these every fourth image
is a query. For each place: the map of the images alone, the map of the given poses, and the hold-outs in both maps. Poses in the first
map are moved by the similarity that fits the centres of its map images to the given ones; where the centres do not tell the rotation,
as of a camera that turns on the spot, the orientations do. A query without a pose counts as infinite error.

Queries of the map of images alone have one of two cameras: the one that the map estimated (`map info` prints it; the choice of a
user whose phone took the map images), and the one of the given model, which disagrees with the map by the error of its estimate.

Times are processor time, which other programs on the machine change little; that of pycolmap is what it would take alone.
WORK/PLACE keeps the maps: what is there is not computed again.
"""

import argparse
import json
import resource
import subprocess
import sys
from pathlib import Path

import numpy as np

from places import write_csv
from geometry import center, mean_rotation, rotation, similarity

PLACES = [
    "herzjesu",
    "fountain",
    "entry",
    "lund-door",
    "llff-room",
    "redkitchen",
    "hololens-office",
    "tum-fr1-rpy",
]

# Least error of centres over their extent from which orientations tell the rotation: 5°.
TURNING = np.radians(5)

# A Python for `--python` that adds the processor time of pycolmap to a file: PYTHON FILE are filled in.
TIMED = """#!{python}
import resource, subprocess, sys
done = subprocess.run([{python!r}, *sys.argv[1:]])
usage = resource.getrusage(resource.RUSAGE_CHILDREN)
with open({file!r}, "a") as file:
    print(usage.ru_utime + usage.ru_stime, file=file)
sys.exit(done.returncode)
"""


def given_poses(folder):
    """Camera line and pose of each image of a COLMAP text model."""
    cameras = {}
    for line in (folder / "cameras.txt").read_text().splitlines():
        if line.strip() and not line.startswith("#"):
            number, camera = line.split(maxsplit=1)
            cameras[number] = camera
    poses = {}
    lines = [line for line in (folder / "images.txt").read_text().splitlines() if not line.startswith("#")]
    for words in map(str.split, lines[::2]):
        numbers = list(map(float, words[1:8]))
        poses[words[9]] = (cameras[words[8]], rotation(numbers[:4]), np.array(numbers[4:]))
    return poses


def run(command):
    """Standard output, and processor seconds."""

    def used():
        usage = resource.getrusage(resource.RUSAGE_CHILDREN)
        return usage.ru_utime + usage.ru_stime

    before = used()
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True, check=False)
    # 1: some queries have no trusted pose.
    if done.returncode not in (0, 1, 4):
        sys.exit(f"{' '.join(map(str, command))}\n{done.stderr}")
    print(done.stderr[-4000:], file=sys.stderr)
    return done.stdout, used() - before


def once(file, compute):
    """The JSON value of a file, or else `compute`, kept in it."""
    if not file.exists():
        value = compute()
        file.write_text(json.dumps(value))
    return json.loads(file.read_text())


def place_of(folder):
    """The model, its poses, and the names of map images and queries."""
    model = folder / "posed" if (folder / "posed").is_dir() else folder / "sparse"
    truth = given_poses(model)
    if (folder / "map.txt").exists():
        names, held_out = ((folder / file).read_text().split() for file in ("map.txt", "query.txt"))
    else:
        held_out = sorted(truth)[2::4]
        names = sorted(set(truth) - set(held_out))
    return model, truth, names, held_out


def errors(veiloc, map_file, queries, images, truth, moved):
    """Of each query the error of the centre and of the rotation (degrees), and whether it is trusted."""
    command = [veiloc, "localize", "--map", map_file, "--queries", queries, "--images", images, "--json", "--quiet"]
    found = []
    for query in json.loads(run(command)[0])["queries"]:
        _, r_true, t_true = truth[query["file"]]
        pose = query.get("cam_from_world")
        if pose is None:
            found.append((np.inf, np.inf, False))
            continue
        r = rotation(pose["q"])
        c = center(r, np.array(pose["t"]))
        s, turn, t = moved
        r, c = r @ turn.T, s * turn @ c + t
        angle = np.degrees(np.arccos(np.clip((np.trace(r @ r_true.T) - 1) / 2, -1, 1)))
        found.append((np.linalg.norm(c - center(r_true, t_true)), angle, query["state"] == "trusted"))
    return np.array(found)


def summary(found):
    """The columns of hold-outs, from `errors`; no median if fewer than half are localized."""
    median = lambda column, form: format(value, form) if np.isfinite(value := np.median(found[:, column])) else ""
    return {
        "queries": len(found),
        "localized": int(np.isfinite(found[:, 0]).sum()),
        "trusted": int(found[:, 2].sum()),
        "within 5 cm and 5° (%)": f"{100 * ((found[:, 0] < 0.05) & (found[:, 1] < 5)).mean():.0f}",
        "within 25 cm and 2° (%)": f"{100 * ((found[:, 0] < 0.25) & (found[:, 1] < 2)).mean():.0f}",
        "median error (map units)": median(0, ".4f"),
        "median error (°)": median(1, ".3f"),
    }


def write_rows(path, rows):
    """A table of dictionaries with equal keys."""
    write_csv(Path(path), list(rows[0]), [list(row.values()) for row in rows])


def fitted(x, y, turn=None):
    """The similarity of centres, and their distances after it."""
    s, r, t = similarity(x, y, turn)
    return (s, r, t), np.linalg.norm(s * x @ r.T + t - y, axis=1)


def rows_of(veiloc, folder, kept):
    model, truth, names, held_out = place_of(folder)
    images = folder / "images"
    kept.mkdir(parents=True, exist_ok=True)
    listed = kept / "map.txt"
    listed.write_text("".join(f"{name}\n" for name in names))

    build = [veiloc, "map", "build", "--images", images, "--list", listed]

    def alone():
        python, times = kept / "python", kept / "python.txt"
        times.unlink(missing_ok=True)
        python.write_text(TIMED.format(python=sys.executable, file=str(times.absolute())))
        python.chmod(0o755)
        of_images = ["--python", python.absolute(), "--work", kept / "work", "-o", kept / "alone.vmap"]
        return run(build + of_images)[1], sum(map(float, times.read_text().split()))

    seconds, of_pycolmap = once(kept / "alone.json", alone)
    of_given = once(kept / "given.json", lambda: run(build + ["--posed", model, "-o", kept / "given.vmap"])[1])

    import pycolmap  # Other scripts use this file without it.

    sparse = [pycolmap.Reconstruction(model) for model in sorted((kept / "work/sfm/sparse").iterdir())]
    largest = max(sparse, key=lambda model: model.num_reg_images())
    posed = [image for image in largest.images.values() if image.has_pose]
    x = np.array([image.projection_center() for image in posed])
    y = np.array([center(*truth[image.name][1:]) for image in posed])
    moved, apart = fitted(x, y)
    # The extent in the second direction; about the first one, centres on a line tell no rotation.
    extent = np.linalg.svd(y - y.mean(0), compute_uv=False)[1] / np.sqrt(len(y))
    if np.sqrt((apart**2).mean()) > TURNING * extent:
        moved, apart = fitted(x, y, mean_rotation([truth[image.name][1].T @ image.cam_from_world().rotation.matrix() for image in posed]))
    info = json.loads(run([veiloc, "map", "info", kept / "alone.vmap", "--images", "--json"])[0])
    estimated = {image["camera"].replace(",", " ") for image in info["image_list"]}
    if len(estimated) != 1:
        sys.exit(f"{folder.name}: {len(estimated)} cameras")
    (estimated,) = estimated
    print(f"{folder.name}: {estimated}; given {truth[names[0]][0]}", file=sys.stderr)

    rows = []
    same = (1.0, np.eye(3), np.zeros(3))
    kinds = [
        ("images alone", "its own", "alone.vmap", moved),
        ("images alone", "given", "alone.vmap", moved),
        ("given poses", "given", "given.vmap", same),
    ]
    for kind, camera, file, of in kinds:
        queries = kept / "queries.txt"
        of_query = {name: estimated if camera == "its own" else truth[name][0] for name in held_out}
        queries.write_text("".join(f"{name} {of_query[name]}\n" for name in held_out))
        found = errors(veiloc, kept / file, queries, images, truth, of)
        is_alone = kind == "images alone"
        rows.append(
            {
                "place": folder.name,
                "map of": kind,
                "camera of queries": camera,
                "images": len(names),
                "registered": largest.num_reg_images() if is_alone else len(names),
                "processor time (s)": round(seconds if is_alone else of_given),
                "of this pycolmap (s)": round(of_pycolmap) if is_alone else "",
                "centres of map images, RMS (map units)": f"{np.sqrt((apart**2).mean()):.4f}" if is_alone else "",
                **summary(found),
            }
        )
        print(rows[-1], file=sys.stderr)
    return rows


def arguments(description, *names):
    """The arguments of the command line, in this order; `places` is a list. Prints the description for `--help`."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in names:
        parser.add_argument(name, nargs="*" if name == "places" else None)
    return vars(parser.parse_args()).values()


def main():
    veiloc, data, work, out, places = arguments(__doc__, "veiloc", "data", "work", "out", "places")
    rows = []
    for place in places or PLACES:
        rows += rows_of(veiloc, Path(data) / place, Path(work) / place)
        if rows:
            write_rows(out, rows)


if __name__ == "__main__":
    main()
