#!/usr/bin/env python3
"""Minimal problems and PoseLib's solutions to them: the fixture that `crates/solvers/tests/oracle.rs` checks.

Random exact problems of a 640 x 480 camera for p3p, p6lp and p5lp_radial (the last in a camera whose optical axis is
the ray of DCL's first anchor), solved by PoseLib, an independent implementation. For p6lp, PoseLib eliminates the
translation through the first three lines; the problems of two anchors are ordered so that it can.

    python3 -m venv .venv && .venv/bin/pip install numpy poselib
    .venv/bin/python scripts/oracle_poses.py > crates/solvers/tests/data/poselib.json
"""

import json

import numpy as np
import poselib

FOCAL, CENTER, SIZE = 525.0, np.array([320.0, 240.0]), np.array([640.0, 480.0])
PROBLEMS = 40


def random_rotation(rng):
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q *= np.sign(np.diag(r))
    return q * np.linalg.det(q)


def numbers(array):
    return np.asarray(array, dtype=float).tolist()


def scene(rng, pixels):
    """A pose, and map points that project to the pixels: R, t, X [n, 3], rays [n, 3]."""
    r = random_rotation(rng)
    t = rng.uniform(-3, 3, size=3)
    rays = np.column_stack([(pixels - CENTER) / FOCAL, np.ones(len(pixels))])
    depths = rng.uniform(1, 8, size=len(pixels))
    return r, t, (rays * depths[:, None] - t) @ r, rays


def pose(p):
    return {"r": numbers(p.R), "t": numbers(p.t)}


def in_front(p, x):
    return bool(np.all((x @ p.R.T + p.t)[:, 2] > 0))


def p3p_problem(rng):
    _, _, x, rays = scene(rng, rng.uniform(0, 1, size=(3, 2)) * SIZE)
    bearings = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    return {"bearings": numbers(bearings), "points": numbers(x), "poses": [pose(p) for p in poselib.p3p(bearings, x)]}


def p6lp_problem(rng, anchored):
    pixels = rng.uniform(0, 1, size=(6, 2)) * SIZE
    if anchored:
        anchors = np.array([[320.0, 0.0], [320.0, 480.0]])
        side = np.array([0, 1, 0, 1, 0, 1])  # PoseLib's first three lines must not share an anchor
        pixels[:, 0] = np.where(side == 0, pixels[:, 0] / 2, 320 + pixels[:, 0] / 2)
        along = pixels - anchors[side]
    else:
        angle = rng.uniform(0, np.pi, size=6)
        along = np.column_stack([np.cos(angle), np.sin(angle)])
    _, _, x, rays = scene(rng, pixels)
    lines = np.cross(rays, rays + np.column_stack([along / FOCAL, np.zeros(6)]))
    lines /= np.linalg.norm(lines, axis=1, keepdims=True)
    poses = [p for p in poselib.p6lp(lines, x) if in_front(p, x)]
    return {"lines": numbers(lines), "points": numbers(x), "poses": [pose(p) for p in poses]}


def p5lp_radial_problem(rng):
    """Half-lines from the principal point: the directions are those of the projections themselves."""
    r = random_rotation(rng)
    t = rng.uniform(-3, 3, size=3)
    seen = rng.uniform([-3, -3, -2], [3, 3, 5], size=(5, 3))
    x = (seen - t) @ r
    u = seen[:, :2] / np.linalg.norm(seen[:, :2], axis=1, keepdims=True)
    # PoseLib's lines pass through the origin: (-v, u, 0); it does not know on which half the point lies.
    lines = np.column_stack([-u[:, 1], u[:, 0], np.zeros(5)])
    poses = []
    for p in poselib.p5lp_radial(lines, x):
        across = (x @ p.R.T + p.t)[:, :2]
        if np.all(np.sum(across * u, axis=1) > 0):
            poses.append({"r": numbers(p.R), "t": numbers(p.t[:2])})
    return {"directions": numbers(u), "points": numbers(x), "poses": poses}


def main():
    rng = np.random.default_rng(20260101)
    print(json.dumps({
        "poselib": poselib.__version__,
        "p3p": [p3p_problem(rng) for _ in range(PROBLEMS)],
        "p6lp": [p6lp_problem(rng, anchored=i % 2 == 1) for i in range(PROBLEMS)],
        "p5lp_radial": [p5lp_radial_problem(rng) for _ in range(PROBLEMS)],
    }))


if __name__ == "__main__":
    main()
