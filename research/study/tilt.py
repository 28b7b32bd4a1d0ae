"""What the direction of gravity tells about where on their half-lines keypoints lie; a command of the page privacy."""

import json
import re

from study.common import PLACES, Package, command, number
from study.geometry import read_posed
from study.places import LAYOUTS

PAGE = "privacy"
np = Package("numpy")
# The default layout: axis of the strips (degrees), their number in a circle, anchors in heights from the middle.
AXIS, STRIPS, *WORDS = re.fullmatch(r"dcl:axis=(.+):sectors=(.+):anchors=(.+)/(.+)\+(.+)/(.+)", LAYOUTS["slanted strips"]).groups()
AXIS, STRIPS, ANCHORS = float(AXIS), int(STRIPS), [[float(word) for word in WORDS[:2]], [float(word) for word in WORDS[2:]]]
GRID, BINS = (12, 16), range(-90, 91, 10)


def views(run, place: str) -> list:
    """Image size, focal length, principal point, gravity in the camera, and keypoints (pixels) of at most 60 images."""
    posed = read_posed(run.place(place) / "posed")
    listed = run.listed(f"tilt-{place}", sorted(posed)[:: max(1, len(posed) // 60)])
    file = run.made(run.kept() / f"tilt-{place}.jsonl", "eval", "keypoints", run.place(place) / "images", "--list", listed,
                    "--max-keypoints", 1024, "--max-size", 5000)  # fmt: skip
    # Photographs are upright on average.
    down = np.mean([view.r[1] for view in posed.values()], axis=0)
    found = []
    for line in file.read_text().splitlines():
        image = json.loads(line)
        view = posed[image["name"]]
        model, *words = view.camera.split()
        width, height, focal, *rest = map(float, words)
        middle = np.array(rest[:2] if model in ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL") else rest[1:3])
        gravity = view.r @ (down / np.linalg.norm(down))
        found.append(((width, height), focal, middle, gravity, np.array(image["keypoints"], float).reshape(len(image["keypoints"]), -1)[:, :2]))
    return found


def rays(at, focal, middle):
    ray = np.concatenate([(at - middle) / focal, np.ones((len(at), 1))], 1)
    return ray / np.linalg.norm(ray, axis=1, keepdims=True)


def anchor_of(ray):
    across = ray[:, 1] * np.cos(np.radians(AXIS)) - ray[:, 0] * np.sin(np.radians(AXIS))
    return np.floor(np.arctan2(across, ray[:, 2]) * STRIPS / (2 * np.pi)).astype(int) % 2


def elevation(ray, gravity):
    """Degrees above the horizon."""
    return np.degrees(-np.arcsin(np.clip(ray @ gravity, -1, 1)))


def learned(places: list) -> tuple:
    """Where keypoints are in an image, and how many more than pixels there are at each elevation; each image of a place counts as much."""
    where, keypoints, pixels = np.ones(GRID), np.ones(len(BINS) - 1), np.ones(len(BINS) - 1)
    for place in places:
        for size, focal, middle, gravity, at in place:
            where += np.histogram2d(at[:, 1], at[:, 0], bins=GRID, range=((0, size[1]), (0, size[0])))[0] / len(place)
            grid = np.stack(np.meshgrid((np.arange(32) + 0.5) / 32 * size[0], (np.arange(24) + 0.5) / 24 * size[1]), -1).reshape(-1, 2)
            for sums, points in ((keypoints, at), (pixels, grid)):
                sums += np.histogram(elevation(rays(points, focal, middle), gravity), list(BINS))[0] / len(place)
    return where, (keypoints + 5) / (pixels / pixels.sum() * keypoints.sum() + 5)


def errors(view, where, rate) -> list:
    """Errors of the best answer from each half-line, without and with gravity, in pixels of an image of 480 rows."""
    (width, height), focal, middle, gravity, at = view
    ends = np.array([width, height]) / 2 + np.array(ANCHORS) * height
    found = []
    for point, own in zip(at[::4], anchor_of(rays(at, focal, middle))[::4]):
        truth = np.linalg.norm(point - ends[own])
        along = np.arange(1, 3 * max(width, height), max(2, width / 200))
        line = ends[own] + along[:, None] * (point - ends[own]) / truth
        inside = (line > 0).all(1) & (line < [width, height]).all(1)
        ray = rays(line, focal, middle)
        inside &= anchor_of(ray) == own
        if inside.sum() < 2:
            continue
        line, along, ray = line[inside], along[inside], ray[inside]
        rows, columns = (line[:, 1] / height * GRID[0]).astype(int), (line[:, 0] / width * GRID[1]).astype(int)
        weights = where[rows, columns]
        tilted = weights * np.interp(elevation(ray, gravity), np.add(BINS[1:], BINS[:-1]) / 2, rate)
        # The weighted median has the least expected error.
        answers = [along[np.searchsorted(sums, sums[-1] / 2)] for sums in (np.cumsum(weights), np.cumsum(tilted))]
        found.append([max(1.0, abs(answer - truth) / height * 480) for answer in answers])
    return found


@command("privacy/tilt.csv", places=PLACES)
def tilt(run):
    """The best answer from each half-line of the default layout, without and with the direction of gravity; learned on other places."""
    table = run.table("privacy/tilt.csv", "place", "images", "median error (px)", "with gravity (px)", "under 30 px (%)",
                      "with gravity, under 30 px (%)", "gain by gravity (bits)")  # fmt: skip
    seen = {place: views(run, place) for place in run.places}
    for place, own in seen.items():
        priors = learned([views for other, views in seen.items() if other != place])
        error = np.concatenate([errors(view, *priors) for view in own])
        near = 100 * (error < 30).mean(axis=0)
        gain = np.log2(error[:, 0] / error[:, 1]).mean()
        cells = [number(x, ".1f") for pair in (np.median(error, axis=0), near) for x in pair]
        table.add([place, len(own), *cells, f"{gain:.2f}"])
