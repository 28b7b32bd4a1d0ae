"""Rigid transforms as 4 × 4 matrices, trajectories, and covariances in the order of ROS.

`a_from_b` is the transform of points of frame `b` into frame `a`: the pose of `b` in `a`. Lengths are metres, stamps nanoseconds.
"""

from __future__ import annotations

import bisect
from collections.abc import Iterable, Sequence

import numpy as np
import numpy.typing as npt

from veiloc import CameraPose

Matrix = npt.NDArray[np.float64]


def matrix(translation: npt.ArrayLike, xyzw: npt.ArrayLike) -> Matrix:
    """A transform from a translation and a quaternion `[x, y, z, w]` of any length.

    Raises:
        InputError: a number is not finite, or the quaternion is zero.
    """
    x, y, z, w = np.asarray(xyzw, float)
    return CameraPose(q=[w, x, y, z], t=translation).matrix


def inverse(transform: Matrix) -> Matrix:
    """The inverse of a rigid transform."""
    result = np.eye(4)
    result[:3, :3] = transform[:3, :3].T
    result[:3, 3] = -transform[:3, :3].T @ transform[:3, 3]
    return result


def pose(transform: Matrix) -> CameraPose:
    """The transform as a `CameraPose`."""
    return CameraPose(R=transform[:3, :3], t=transform[:3, 3])


def angle_deg(transform: Matrix) -> float:
    """Angle of the rotation, degrees."""
    return float(2 * np.degrees(np.arccos(min(1.0, abs(float(pose(transform).q[0]))))))


def cross(v: npt.ArrayLike) -> Matrix:
    """The matrix `[v]ₓ` of the cross product."""
    x, y, z = np.asarray(v, float)
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def ros_covariance(covariance: Matrix, cam_from_map: Matrix, cam_from_base: Matrix) -> Matrix:
    """Covariance of the pose of the base in the map, as `geometry_msgs/PoseWithCovariance` has it.

    Args:
        covariance: of `cam_from_map` as an `Answer` has it, `[6, 6]`: rotation in the camera frame, then translation.
        cam_from_map: pose of the camera, metres.
        cam_from_base: the fixed transform between camera and base.

    Returns:
        `[6, 6]`: position x, y, z, then rotation about the fixed axes X, Y, Z of the map.

    A step `(ω, v)` of `cam_from_map` turns `base` in the map by `-Rᵀ ω` and moves it by `Rᵀ (t × ω - v)`, where `R` is the rotation of
    `cam_from_map` and `t` the position of the base in the camera frame.
    """
    to_map = cam_from_map[:3, :3].T
    jacobian = np.zeros((6, 6))
    jacobian[:3, :3] = to_map @ cross(cam_from_base[:3, 3])
    jacobian[:3, 3:] = -to_map
    jacobian[3:, :3] = -to_map
    return jacobian @ covariance @ jacobian.T


class Trajectory:
    """Poses by time, interpolated.

    Args:
        poses: stamps (nanoseconds) and transforms, in any order.
        max_gap: longest time between two poses that are interpolated, seconds; further poses count within a tenth of it.
        keep: seconds of the newest poses that are kept; all by default.
    """

    def __init__(self, poses: Iterable[tuple[int, Matrix]] = (), *, max_gap: float = 0.5, keep: float | None = None) -> None:
        self.max_gap, self.keep = int(1e9 * max_gap), keep
        self.stamps: list[int] = []
        self.transforms: list[Matrix] = []
        for stamp, transform in sorted(poses, key=lambda entry: entry[0]):
            self.add(stamp, transform)

    def add(self, stamp: int, transform: Matrix) -> None:
        """Adds a pose. When time jumps back by more than a second, as when a bag starts again, the old ones are dropped."""
        if self.stamps and stamp < self.stamps[-1] - 10**9:
            self.stamps, self.transforms = [], []
        at = bisect.bisect_left(self.stamps, stamp)
        if at < len(self.stamps) and self.stamps[at] == stamp:
            self.transforms[at] = transform
            return
        self.stamps.insert(at, stamp)
        self.transforms.insert(at, transform)
        if self.keep is not None:
            old = bisect.bisect_left(self.stamps, self.stamps[-1] - int(1e9 * self.keep))
            del self.stamps[:old], self.transforms[:old]

    def at(self, stamp: int) -> Matrix | None:
        """The pose at a time; None when none is near enough."""
        after = bisect.bisect_left(self.stamps, stamp)
        if after < len(self.stamps) and self.stamps[after] == stamp:
            return self.transforms[after]
        near = [k for k in (after - 1, after) if 0 <= k < len(self.stamps)]
        if len(near) == 2 and self.stamps[after] - self.stamps[after - 1] <= self.max_gap:
            share = (stamp - self.stamps[after - 1]) / (self.stamps[after] - self.stamps[after - 1])
            return interpolated(self.transforms[after - 1], self.transforms[after], share)
        distances = [(abs(self.stamps[k] - stamp), k) for k in near]
        if distances and min(distances)[0] <= self.max_gap // 10:
            return self.transforms[min(distances)[1]]
        return None

    def __len__(self) -> int:
        return len(self.stamps)


def interpolated(a: Matrix, b: Matrix, share: float) -> Matrix:
    """The transform between two, `share` of the way from `a` to `b`, by slerp."""
    p, q = pose(a).q, pose(b).q
    dot = float(p @ q)
    if dot < 0:
        q, dot = -q, -dot
    angle = np.arccos(min(1.0, dot))
    weights = [1 - share, share] if angle < 1e-9 else np.sin(angle * np.array([1 - share, share])) / np.sin(angle)
    mixed = weights[0] * p + weights[1] * q
    return CameraPose(q=mixed, t=(1 - share) * a[:3, 3] + share * b[:3, 3]).matrix


class Transforms:
    """A tree of frames, as tf has it: each frame has one parent, and a transform that is fixed or a trajectory."""

    def __init__(self) -> None:
        self.parents: dict[str, tuple[str, Trajectory | Matrix]] = {}

    def add(self, parent: str, child: str, stamp: int | None, parent_from_child: Matrix) -> None:
        """Adds a transform; `stamp` None for one that is fixed."""
        parent, child = parent.lstrip("/"), child.lstrip("/")
        if stamp is None:
            self.parents[child] = (parent, parent_from_child)
            return
        known = self.parents.get(child)
        if known is None or known[0] != parent or not isinstance(known[1], Trajectory):
            known = (parent, Trajectory())
            self.parents[child] = known
        assert isinstance(known[1], Trajectory)
        known[1].add(stamp, parent_from_child)

    def frames(self) -> set[str]:
        """All frames."""
        return set(self.parents) | {parent for parent, _ in self.parents.values()}

    def _path(self, frame: str) -> list[str]:
        path = [frame]
        while path[-1] in self.parents and self.parents[path[-1]][0] not in path:
            path.append(self.parents[path[-1]][0])
        return path

    def are_connected(self, target: str, source: str) -> bool:
        """Whether there is a path between two frames."""
        return bool(set(self._path(target.lstrip("/"))) & set(self._path(source.lstrip("/"))))

    def lookup(self, target: str, source: str, stamp: int) -> Matrix | None:
        """`target_from_source` at a time; None when the frames are not connected, or a transform is not known at that time."""
        target, source = target.lstrip("/"), source.lstrip("/")
        up, down = self._path(target), self._path(source)
        common = next((frame for frame in down if frame in up), None)
        if common is None:
            return None

        def to_common(path: Sequence[str]) -> Matrix | None:
            result = np.eye(4)
            for frame in path[: path.index(common)]:
                known = self.parents[frame][1]
                step = known.at(stamp) if isinstance(known, Trajectory) else known
                if step is None:
                    return None
                result = step @ result
            return result

        from_source, from_target = to_common(down), to_common(up)
        if from_source is None or from_target is None:
            return None
        return inverse(from_target) @ from_source
