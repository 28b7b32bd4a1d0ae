"""Shared fixtures: problems with ground truth, and real images if they are present."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import veiloc

CAMERA = {"model": "PINHOLE", "width": 640, "height": 480, "params": [525.0, 530.0, 318.0, 243.0]}


def rotation(rng, max_angle=np.pi):
    """A random rotation matrix with an angle of at most `max_angle`."""
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    angle = rng.uniform(0, max_angle)
    k = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def near(pose, truth, degrees=2.0, units=0.1):
    """Whether a pose is within `degrees` and `units` (map units) of the ground truth."""
    off = pose.error(truth)
    return off[0] < degrees and off[1] < units


def seal(image, camera, profile, gravity=None, **options):
    """The sealed query of one image on its own."""
    sealer = veiloc.Sealer(profile, **options)
    return sealer.seal(sealer.extract(image, camera, gravity=gravity))


class Problem:
    """World points and their pixels under a known pose, with outliers."""

    def __init__(self, seed, count=200, noise=0.5, outliers=0.3, camera=CAMERA):
        rng = np.random.default_rng(seed)
        self.camera = camera
        self.R, self.t = rotation(rng), rng.normal(size=3)
        fx, fy, cx, cy = camera["params"]
        self.exact = rng.uniform([0, 0], [camera["width"], camera["height"]], (count, 2))
        depth = rng.uniform(2, 8, count)
        rays = np.column_stack([(self.exact - [cx, cy]) / [fx, fy], np.ones(count)])
        self.bearings = rays / np.linalg.norm(rays, axis=1, keepdims=True)
        self.points3d = (rays * depth[:, None] - self.t) @ self.R
        self.points2d = self.exact + noise * rng.normal(size=(count, 2))
        wrong = rng.permutation(count)[: int(outliers * count)]
        self.points2d[wrong] = rng.uniform([0, 0], [camera["width"], camera["height"]], (len(wrong), 2))
        self.inliers = np.ones(count, bool)
        self.inliers[wrong] = False
        self.pose = veiloc.CameraPose(R=self.R, t=self.t)
        self.K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        self.lines2d = self._lines(rng)

    def _lines(self, rng):
        angles = rng.uniform(0, np.pi, len(self.points2d))
        normals = np.column_stack([-np.sin(angles), np.cos(angles)])
        return np.column_stack([normals, -(normals * self.points2d).sum(1)])

    def errors(self, R, t):
        """Rotation error in degrees and translation error in map units."""
        return self.pose.error(veiloc.CameraPose(R=np.asarray(R), t=np.asarray(t)))


@pytest.fixture
def problem():
    return Problem(7)


@pytest.fixture(scope="session")
def redkitchen():
    """Folder of the real images; without them the test is skipped."""
    data = os.environ.get("VEILOC_DATA")
    if not data or not (Path(data) / "redkitchen").is_dir():
        pytest.skip("VEILOC_DATA does not name a folder with redkitchen")
    return Path(data) / "redkitchen"


def evenly_spaced(names, count):
    """`count` of the names, evenly spaced."""
    return names[:: max(1, len(names) // count)][:count]


@pytest.fixture(scope="session")
def program_path():
    """Path of the package's program."""
    path = shutil.which("veiloc", path=str(Path(sys.executable).parent))
    assert path, "the package installs a program beside the interpreter"
    return path


@pytest.fixture(scope="session")
def program(program_path):
    """Runs the package's program and returns its stdout; an unexpected exit code fails the test."""

    def run(*words, codes=(0,)):
        done = subprocess.run([program_path, *map(str, words)], capture_output=True, text=True)
        assert done.returncode in codes, done.stderr
        return done.stdout

    return run


class MappedScene:
    """A mapped scene and query images with ground truth."""

    def __init__(self, images, views, mapped, queries, **options):
        self.images, self.queries = images, queries
        self.views = {name: (camera, pose) for name, camera, pose in views}
        self.mapped = [(name, *self.views[name]) for name in mapped]
        self.map = veiloc.Map.build(self.mapped, images, self_test=False, **options)
        self.camera = self.views[queries[0]][0]

    def pose(self, name):
        return self.views[name][1]


@pytest.fixture(scope="session")
def rendered(tmp_path_factory):
    """A rendered room; it needs no data."""
    folder = tmp_path_factory.mktemp("rendered")
    mapped, queries = veiloc.render_room(folder)
    names = lambda views: [view[0] for view in views]
    return MappedScene(folder, mapped + queries, names(mapped), names(queries), down=[0, 0, -1])


@pytest.fixture(scope="session")
def kitchen(redkitchen):
    """A part of 7Scenes RedKitchen."""
    posed = veiloc.ColmapModel.open(redkitchen / "posed")
    names = lambda file, count: evenly_spaced((redkitchen / file).read_text().split(), count)
    mapped, queries = names("map.txt", 28), names("query.txt", 6)
    views = [(name, posed.camera(name), posed.pose(name)) for name in mapped + queries]
    return MappedScene(redkitchen / "images", views, mapped, queries)
