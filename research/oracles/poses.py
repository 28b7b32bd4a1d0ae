#!/usr/bin/env python3
"""Writes minimal problems and reference solutions for `crates/core/pose/tests/it/solvers/oracle.rs`.

Random exact problems of a 640 x 480 camera for p3p, p6lp, p5lp_radial (in a camera whose optical axis is the ray of DCL's first anchor)
and up2p, solved by PoseLib, an independent implementation. PoseLib's p6lp eliminates the translation with the first three lines; the
problems with two anchors are ordered so that this works. p6lp_dual_radial is also solved by PoseLib's p6lp, without the poses that put
a point on the wrong half of its line. u4lp has no counterpart in PoseLib; its reference is a scan of all angles about the vertical for
sign changes of a determinant, refined by bisection.

    python3 -m venv .venv && .venv/bin/pip install numpy poselib
    .venv/bin/python research/oracles/poses.py > crates/core/pose/tests/data/solvers/poselib.json
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


def rounded(r, t):
    """A pose with nine digits, as the test compares it."""
    return {"r": numbers(np.round(r, 9)), "t": numbers(np.round(t, 9))}


def pose(p):
    return rounded(p.R, p.t)


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
    # PoseLib's lines pass through the origin: (-v, u, 0); it does not use the half on which the point lies.
    lines = np.column_stack([-u[:, 1], u[:, 0], np.zeros(5)])
    poses = []
    for p in poselib.p5lp_radial(lines, x):
        across = (x @ p.R.T + p.t)[:, :2]
        if np.all(np.sum(across * u, axis=1) > 0):
            poses.append(rounded(p.R, p.t[:2]))
    return {"directions": numbers(u), "points": numbers(x), "poses": poses}


def axes_about(down):
    """A rotation that takes the direction to the y axis."""
    y = down / np.linalg.norm(down)
    x = np.cross(y, np.eye(3)[np.argmin(np.abs(y))])
    x /= np.linalg.norm(x)
    return np.stack([x, y, np.cross(x, y)])


def verticals(rng, r):
    """Down in the world and in the camera, and the rotations that take them to PoseLib's y axis."""
    world = random_rotation(rng)[0]
    camera = r @ world
    return world, camera, axes_about(world), axes_about(camera)


def up2p_problem(rng):
    r, _, x, rays = scene(rng, rng.uniform(0, 1, size=(2, 2)) * SIZE)
    bearings = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    world, camera, world_y, camera_y = verticals(rng, r)
    poses = []
    for p in poselib.up2p(bearings @ camera_y.T, x @ world_y.T):
        r, t = camera_y.T @ p.R @ world_y, camera_y.T @ p.t
        if np.all(np.sum((x @ r.T + t) * bearings, axis=1) > 0):
            poses.append(rounded(r, t))
    return {"down_in_camera": numbers(camera), "down_in_world": numbers(world), "bearings": numbers(bearings),
            "points": numbers(x), "poses": poses}


def u4lp_problem(rng, anchored):
    pixels = rng.uniform(0, 1, size=(4, 2)) * SIZE
    angle = rng.uniform(0, np.pi, size=4)
    along = np.column_stack([np.cos(angle), np.sin(angle)])
    if anchored:
        side = np.array([0, 1, 0, 1])
        pixels[:, 0] = np.where(side == 0, pixels[:, 0] / 2, 320 + pixels[:, 0] / 2)
        along = pixels - np.array([[320.0, 0.0], [320.0, 480.0]])[side]
    r, _, x, rays = scene(rng, pixels)
    lines = np.cross(rays, rays + np.column_stack([along / FOCAL, np.zeros(4)]))
    lines /= np.linalg.norm(lines, axis=1, keepdims=True)
    world, camera, world_y, camera_y = verticals(rng, r)

    def rotation(angle):
        c, s = np.cos(angle), np.sin(angle)
        return camera_y.T @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ world_y

    def system(angle):
        """[l_i | l_i . R X_i]: singular where one t serves all four lines."""
        return np.column_stack([lines, np.sum(lines * (x @ rotation(angle).T), axis=1)])

    def value(angle):
        return np.linalg.det(system(angle))

    poses = []
    grid = np.linspace(0, 2 * np.pi, 20001)
    values = [value(a) for a in grid]
    for low, high, at_low, at_high in zip(grid, grid[1:], values, values[1:]):
        if at_low * at_high > 0:
            continue
        for _ in range(60):
            middle = (low + high) / 2
            if value(middle) * at_low > 0:
                low = middle
            else:
                high = middle
        r = rotation(low)
        t = np.linalg.lstsq(lines, -system(low)[:, 3], rcond=None)[0]
        if np.all((x @ r.T + t)[:, 2] > 0):
            poses.append(rounded(r, t))
    return {"down_in_camera": numbers(camera), "down_in_world": numbers(world), "lines": numbers(lines),
            "points": numbers(x), "poses": poses}


def p6lp_dual_radial_problem(rng):
    """The sixth half-line is of the second anchor; the third line given to PoseLib is that one."""
    pixels = rng.uniform(0, 1, size=(6, 2)) * SIZE
    side = np.array([0, 0, 0, 0, 0, 1])
    pixels[:, 0] = np.where(side == 0, pixels[:, 0] / 2, 320 + pixels[:, 0] / 2)
    anchors = (np.array([[320.0, 0.0], [320.0, 480.0]]) - CENTER) / FOCAL
    _, _, x, rays = scene(rng, pixels)
    origins, directions = anchors[side], rays[:, :2] - anchors[side]
    starts = np.column_stack([origins, np.ones(6)])
    lines = np.cross(starts, np.column_stack([directions, np.zeros(6)]))
    lines /= np.linalg.norm(lines, axis=1, keepdims=True)
    order = [0, 1, 5, 2, 3, 4]
    poses = []
    for p in poselib.p6lp(lines[order], x[order]):
        seen = x @ p.R.T + p.t
        along = np.sum((seen[:, :2] - origins * seen[:, 2:]) * directions, axis=1)
        if np.all(seen[:, 2] > 0) and np.all(along > 0):
            poses.append(pose(p))
    return {"anchors": numbers(anchors), "directions": numbers(directions), "points": numbers(x), "poses": poses}


def main():
    rng = np.random.default_rng(20260101)
    print(json.dumps({
        "poselib": poselib.__version__,
        "p3p": [p3p_problem(rng) for _ in range(PROBLEMS)],
        "p6lp": [p6lp_problem(rng, anchored=i % 2 == 1) for i in range(PROBLEMS)],
        "p5lp_radial": [p5lp_radial_problem(rng) for _ in range(PROBLEMS)],
        "up2p": [up2p_problem(rng) for _ in range(PROBLEMS)],
        "u4lp": [u4lp_problem(rng, anchored=i % 2 == 1) for i in range(PROBLEMS)],
        "p6lp_dual_radial": [p6lp_dual_radial_problem(rng) for _ in range(PROBLEMS)],
    }))


if __name__ == "__main__":
    main()
