"""Poses in NumPy, for the scripts that judge them: rotations, centres and similarities. Quaternions are Hamilton's, w x y z."""

import numpy as np


def rotation(q):
    """Rotation matrix of a quaternion, which need not have length 1."""
    w, x, y, z = np.array(q) / np.linalg.norm(q)
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])


def quaternion(r):
    """Quaternion of a rotation matrix, with w ≥ 0."""
    k = np.array([
        [r[0, 0] - r[1, 1] - r[2, 2], 0, 0, 0],
        [r[0, 1] + r[1, 0], r[1, 1] - r[0, 0] - r[2, 2], 0, 0],
        [r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], r[2, 2] - r[0, 0] - r[1, 1], 0],
        [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], r[0, 0] + r[1, 1] + r[2, 2]],
    ])
    values, vectors = np.linalg.eigh(k / 3)
    x, y, z, w = vectors[:, np.argmax(values)]
    q = np.array([w, x, y, z])
    return q if q[0] >= 0 else -q


def center(r, t):
    """Camera centre of a pose, world to camera."""
    return -r.T @ t


def mean_rotation(rotations):
    """The rotation that is nearest to all of them (chordal mean)."""
    u, _, vt = np.linalg.svd(np.sum(rotations, axis=0))
    return u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt


def similarity(x, y, r=None):
    """Scale, rotation and translation with y = s R x + t, least squares (Umeyama, 1991); `x` and `y` are [N, 3], `r` is the rotation
    if it is known."""
    mx, my = x.mean(0), y.mean(0)
    if r is None:
        u, _, vt = np.linalg.svd((y - my).T @ (x - mx))
        r = u @ np.diag([1, 1, np.sign(np.linalg.det(u @ vt))]) @ vt
    s = ((y - my) * ((x - mx) @ r.T)).sum() / ((x - mx) ** 2).sum()
    return s, r, my - s * r @ mx
