"""The minimal solvers: the true pose is among the solutions, which equal PoseLib's where it has the solver."""

import numpy as np
import pytest

import veiloc
from conftest import Problem, rotation

poselib = pytest.importorskip("poselib")


def nearest(poses, problem):
    return min((max(problem.pose.error(p)) for p in poses), default=np.inf)


def plane_lines(problem):
    return problem.lines2d @ problem.K


def same(ours, theirs):
    """Whether both sets of poses are equal, in any order."""
    theirs = [veiloc.CameraPose(q=p.q, t=p.t) for p in theirs]
    near = lambda a, others: any(max(a.error(b)) < 1e-4 for b in others)
    return all(near(a, theirs) for a in ours) and all(near(b, ours) for b in theirs)


@pytest.mark.parametrize("seed", range(20))
def test_p3p_matches_poselib(seed):
    p = Problem(seed, count=3, noise=0, outliers=0)
    ours = veiloc.p3p(p.bearings, p.points3d)
    assert nearest(ours, p) < 1e-6
    assert same(ours, poselib.p3p(p.bearings, p.points3d))


@pytest.mark.parametrize("seed", range(20))
def test_p6lp_finds_the_pose(seed):
    p = Problem(seed, count=6, noise=0, outliers=0)
    lines = plane_lines(p)
    ours = veiloc.p6lp(lines, p.points3d)
    assert nearest(ours, p) < 1e-4
    # PoseLib also returns poses with points behind the camera, and each solver sometimes misses a pose.
    lines = lines / np.linalg.norm(lines, axis=1, keepdims=True)
    theirs = [veiloc.CameraPose(q=q.q, t=q.t) for q in poselib.p6lp(lines, p.points3d)]
    assert not theirs or nearest(theirs, p) > 1e-2 or any(max(a.error(b)) < 1e-2 for a in ours for b in theirs)


@pytest.mark.parametrize("seed", range(10))
def test_upright_solvers_find_the_pose(seed):
    p = Problem(seed, count=4, noise=0, outliers=0)
    down_in_world = np.array([0.1, -0.2, -1.0])
    down_in_camera = p.R @ down_in_world
    assert nearest(veiloc.up2p(p.bearings[:2], p.points3d[:2], down_in_camera, down_in_world), p) < 1e-6
    assert nearest(veiloc.u4lp(plane_lines(p), p.points3d, down_in_camera, down_in_world), p) < 1e-6


def test_up2p_default_vertical_matches_poselib():
    rng = np.random.default_rng(3)
    angle = 0.7
    c, s = np.cos(angle), np.sin(angle)
    R, t = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]), np.array([0.3, -0.2, 0.5])
    rays = np.column_stack([rng.uniform(-0.5, 0.5, (2, 2)), np.ones(2)])
    points = (rays * rng.uniform(2, 5, (2, 1)) - t) @ R
    bearings = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    ours = veiloc.up2p(bearings, points)
    assert min(max(veiloc.CameraPose(R=R, t=t).error(p)) for p in ours) < 1e-6
    assert same(ours, poselib.up2p(bearings, points))


@pytest.mark.parametrize("seed", range(10))
def test_radial_solvers_find_the_pose(seed):
    p = Problem(seed, count=6, noise=0, outliers=0)
    seen = p.points3d @ p.R.T + p.t
    found = veiloc.p5lp_radial(seen[:5, :2], p.points3d[:5])
    turns = [p.pose.error(veiloc.CameraPose(R=pose.R, t=[*pose.t[:2], p.t[2]])) for pose in found]
    assert min(map(max, turns)) < 1e-5
    assert all(pose.t[2] == 0 for pose in found)
    # Five half-planes of one anchor, and one of another.
    anchor, other = np.array([0.0, -0.5, 1.0]), np.array([0.0, 0.5, 1.0])
    rays = seen / seen[:, 2:]
    found = veiloc.p6lp_dual_radial(anchor, rays[:5] - anchor, other, rays[5] - other, p.points3d)
    assert nearest(found, p) < 1e-4


def test_degenerate_samples_have_no_poses():
    nothing = np.zeros((6, 3))
    assert veiloc.p6lp(nothing, nothing) == []
    assert veiloc.p3p(np.full((3, 3), np.nan), np.zeros((3, 3))) == []
    assert veiloc.p5lp_radial(np.zeros((5, 2)), np.zeros((5, 3))) == []


def test_invalid_shapes_are_refused():
    with pytest.raises(veiloc.InputError, match=r"bearings: must have 3 rows, not 4"):
        veiloc.p3p(np.eye(4)[:, :3], np.eye(3))
    with pytest.raises(veiloc.InputError, match=r"points3d: must be an array \[N, 3\]"):
        veiloc.p3p(np.eye(3), np.zeros(9))
    with pytest.raises(veiloc.InputError, match="not zero"):
        veiloc.up2p(np.eye(3)[:2], np.eye(3)[:2], [0, 0, 0])
    assert rotation(np.random.default_rng(0)).shape == (3, 3)
