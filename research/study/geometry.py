"""Poses in NumPy: rotations, centres, similarities, COLMAP's text files. Quaternions are Hamilton's, w x y z."""

from __future__ import annotations

from dataclasses import dataclass

from study.common import Package

np = Package("numpy")


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


@dataclass
class Posed:
    """A camera (COLMAP's model, width, height and parameters) and its pose, world to camera."""

    camera: str
    r: np.ndarray
    t: np.ndarray

    @property
    def center(self):
        return center(self.r, self.t)


def read_posed(folder):
    """The cameras of the images of a COLMAP text model, by name."""
    content = lambda file: [line for line in (folder / file).read_text().splitlines() if not line.startswith("#")]
    cameras = dict(line.split(maxsplit=1) for line in content("cameras.txt") if line.strip())
    found = {}
    for words in (line.split(maxsplit=9) for line in content("images.txt")[::2]):
        if len(words) == 10:
            numbers = list(map(float, words[1:8]))
            found[words[9].strip()] = Posed(cameras[words[8]].strip(), rotation(numbers[:4]), np.array(numbers[4:]))
    return found


def write_posed(folder, images, ids=None):
    """A COLMAP text model without points, of {name: Posed}; images are numbered from 1, or have these ids."""
    folder.mkdir(parents=True, exist_ok=True)
    cameras, lines = {}, []
    for i, (name, posed) in zip(ids or range(1, len(images) + 1), images.items()):
        camera = cameras.setdefault(posed.camera, len(cameras) + 1)
        numbers = " ".join(repr(float(x)) for x in [*quaternion(posed.r), *posed.t])
        lines.append(f"{i} {numbers} {camera} {name}\n\n")
    (folder / "cameras.txt").write_text("".join(f"{i} {camera}\n" for camera, i in cameras.items()))
    (folder / "images.txt").write_text("".join(lines))


def angle(a, b):
    """Angle between two rotations, degrees; from the chord, which is exact for small ones."""
    return np.degrees(2 * np.arcsin(min(1.0, np.linalg.norm(a @ b.T - np.eye(3)) / np.sqrt(8))))


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
