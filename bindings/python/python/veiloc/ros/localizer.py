"""Localizes a robot: seals its images, asks a map or a service, and joins the answers with the odometry.

No ROS is needed here; the node `veiloc_ros` and `python -m veiloc.ros replay` call it.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

import veiloc
from veiloc.ros.geometry import Matrix, Trajectory, angle_deg, inverse, pose, ros_covariance


class Server(Protocol):
    """Who localizes sealed queries."""

    def localize(self, query: bytes, near: npt.ArrayLike | None) -> veiloc.Answer:
        """The answer to one image."""

    def localize_rig(self, frames: Sequence[tuple[bytes, veiloc.CameraPose, float, float]], near: npt.ArrayLike | None) -> veiloc.Answer:
        """The answer to the images of several cameras."""


@dataclass(frozen=True)
class MapServer:
    """A map of this process: nothing leaves the robot."""

    map: veiloc.Map

    def localize(self, query: bytes, near: npt.ArrayLike | None) -> veiloc.Answer:
        return self.map.localize(query, position=near)

    def localize_rig(self, frames: Sequence[tuple[bytes, veiloc.CameraPose, float, float]], near: npt.ArrayLike | None) -> veiloc.Answer:
        return self.map.localize_rig(frames, position=near)


@dataclass(frozen=True)
class ServiceServer:
    """A service: it gets sealed queries, and a rough position if one was given."""

    client: veiloc.Client
    name: str

    def localize(self, query: bytes, near: npt.ArrayLike | None) -> veiloc.Answer:
        return self.client.localize(self.name, query, near=near)

    def localize_rig(self, frames: Sequence[tuple[bytes, veiloc.CameraPose, float, float]], near: npt.ArrayLike | None) -> veiloc.Answer:
        return self.client.localize_rig(self.name, frames, near=near)


@dataclass(frozen=True)
class Frame:
    """An image of one camera: when it was taken, its camera as for `Sealer.extract`, and where the camera is on the robot."""

    stamp: int
    image: Any
    camera: Any
    base_from_cam: Matrix
    mask: Any = None


@dataclass(frozen=True)
class Outcome:
    """What came of one question."""

    stamp: int
    """Time of the newest image, nanoseconds."""
    state: str
    """`"trusted"`, `"doubtful"`, `"not-found"`, `"not-this-place"`, `"no-odometry"`, `"unusable-image"` or `"no-service"`."""
    update: str = ""
    """What the answer did to the transform (`Alignment.add`)."""
    text: str = ""
    """The doubts of the answer, or why there is none."""
    map_from_base: Matrix | None = None
    """The pose of the robot by this answer alone, metres."""
    covariance: Matrix | None = None
    """Of `map_from_base` in the order of ROS; None where the answer leaves a direction free."""
    answer: veiloc.Answer | None = None
    sealed_bytes: int = 0
    seal_ms: float = 0.0
    """Processor time of all threads for features and sealing."""
    wait_ms: float = 0.0
    """From the sealed query to the answer."""


@dataclass
class Rough:
    """A rough position of the robot, until the map is found: `map_from_base` at the time when the odometry was `odom_from_base`."""

    map_from_base: Matrix
    sd: float
    odom_from_base: Matrix | None

    def near(self, odom_from_base: Matrix | None, metres: float) -> list[float]:
        """Position and standard deviation now, map units."""
        now = self.map_from_base
        if self.odom_from_base is not None and odom_from_base is not None:
            now = now @ inverse(self.odom_from_base) @ odom_from_base
        return [*(now[:3, 3] / metres), self.sd / metres]


@dataclass
class Localizer:
    """A robot in a map.

    Args:
        server: who localizes.
        sealer: seals images for this map.
        alignment: joins the answers.
        metres_per_unit: metres of a unit of the map; for rigs and rough positions in maps without a metric scale.
        gravity_sd_deg: standard deviation of the vertical of the odometry, degrees; None sends no gravity. The odometry's z is up
            (REP 103).
        drift: position and rotation (degrees) by which the odometry may drift in a metre, for cameras that do not expose together.
    """

    server: Server
    sealer: veiloc.Sealer
    alignment: veiloc.Alignment = field(default_factory=veiloc.Alignment)
    metres_per_unit: float | None = None
    gravity_sd_deg: float | None = 2.0
    drift: tuple[float, float] = (0.01, 0.05)
    rough: Rough | None = None

    def __post_init__(self) -> None:
        # One session for all images of a walk: no keypoint is sent under two anchors.
        self._sealer = self.sealer.in_session(veiloc.Session())

    @property
    def map_from_odom(self) -> Matrix | None:
        """The correction of the odometry: `map → odom` of REP 105, metres; None before the first trusted answer."""
        transform = self.alignment.odom_from_map
        return None if transform is None else transform.inverse().matrix

    def ask(self, frames: Sequence[Frame], odometry: Trajectory) -> Outcome:
        """Seals the images of one moment, one for each camera, and takes the answer.

        An answer that comes late is placed where the robot was when it took the images: only the stamps count.
        """
        stamp = max(frame.stamp for frame in frames)
        bases = [odometry.at(frame.stamp) for frame in frames]
        now = odometry.at(stamp)
        known = [base for base in bases if base is not None]
        if now is None or len(known) != len(frames):
            return Outcome(stamp, "no-odometry", text="there is no odometry at the time of the image; compare the clocks of camera and odometry")
        began, sealed = time.process_time(), []
        try:
            for frame, odom_from_base in zip(frames, known):
                sealed.append(self._seal(frame, odom_from_base))
        except veiloc.NotThisPlaceError as error:
            return Outcome(stamp, "not-this-place", text=str(error))
        except veiloc.Error as error:
            return Outcome(stamp, "unusable-image", text=str(error))
        spent, size = 1e3 * (time.process_time() - began), sum(map(len, sealed))
        asked = time.perf_counter()
        metres = self.metres_per_unit or 1.0
        near = None if self.rough is None else self.rough.near(now, metres)
        try:
            if len(frames) == 1:
                answer = self.server.localize(sealed[0], near)
                cam_from_base = inverse(frames[0].base_from_cam)
            else:
                answer = self.server.localize_rig(self._rig(frames, sealed, known, now, metres), near)
                cam_from_base = np.eye(4)
        except veiloc.NotLocalizedError as error:
            return self._without(stamp, "not-found", error, size, spent, asked)
        except veiloc.Error as error:
            return self._without(stamp, "no-service", error, size, spent, asked)
        wait = 1e3 * (time.perf_counter() - asked)
        cam_from_odom = cam_from_base @ inverse(now)
        update = self.alignment.add(answer, pose(cam_from_odom))
        if answer.trusted and update == "used":
            self.rough = None
        base, covariance = self._base(answer, cam_from_base)
        text = "; ".join(str(doubt) for doubt in answer.doubts)
        if update == "unknown-unit":
            text = "the map has no metric scale: give metres_per_unit, or align the map (veiloc map align)"
        return Outcome(stamp, answer.state, update, text, base, covariance, answer, size, spent, wait)

    def _seal(self, frame: Frame, odom_from_base: Matrix) -> bytes:
        cam_from_odom = inverse(odom_from_base @ frame.base_from_cam)
        down = -cam_from_odom[:3, 2]
        extracted = self.sealer.extract(
            frame.image,
            frame.camera,
            mask=frame.mask,
            orientation=pose(cam_from_odom).q,
            gravity=None if self.gravity_sd_deg is None else [*down, self.gravity_sd_deg],
        )
        return self._sealer.seal(extracted)

    def _rig(
        self, frames: Sequence[Frame], sealed: Sequence[bytes], bases: Sequence[Matrix], now: Matrix, metres: float
    ) -> list[tuple[bytes, veiloc.CameraPose, float, float]]:
        """The queries with the poses of their cameras on the robot as it stands at `now`."""
        rig = []
        for frame, query, odom_from_base in zip(frames, sealed, bases):
            cam_from_rig = inverse(odom_from_base @ frame.base_from_cam) @ now
            path = float(np.linalg.norm(odom_from_base[:3, 3] - now[:3, 3]))
            cam_from_rig[:3, 3] /= metres
            rig.append((query, pose(cam_from_rig), self.drift[1] * path, self.drift[0] * path / metres))
        return rig

    def _base(self, answer: veiloc.Answer, cam_from_base: Matrix) -> tuple[Matrix | None, Matrix | None]:
        metres = self.metres_per_unit or answer.metres_per_unit
        if answer.pose is None or answer.covariance is None or metres is None:
            return None, None
        cam_from_map = answer.pose.matrix
        cam_from_map[:3, 3] *= metres
        units = np.array([1.0, 1.0, 1.0, metres, metres, metres])
        covariance = np.asarray(answer.covariance) * np.outer(units, units)
        if not np.isfinite(covariance).all():  # A direction is free.
            return inverse(cam_from_map) @ cam_from_base, None
        return inverse(cam_from_map) @ cam_from_base, ros_covariance(covariance, cam_from_map, cam_from_base)

    @staticmethod
    def _without(stamp: int, state: str, error: Exception, size: int, spent: float, asked: float) -> Outcome:
        return Outcome(stamp, state, text=str(error), sealed_bytes=size, seal_ms=spent, wait_ms=1e3 * (time.perf_counter() - asked))


@dataclass
class Pace:
    """When to ask: at most `rate` times a second, and once the map is found only after the robot moved or turned enough, or after
    `max_age` seconds.
    """

    rate: float = 1.0
    min_translation: float = 0.3
    min_rotation_deg: float = 15.0
    max_age: float = 10.0
    _stamp: int | None = None
    _base: Matrix | None = None

    def is_due(self, stamp: int, odom_from_base: Matrix | None, state: str) -> bool:
        """Whether to ask about an image of this time; `state` is that of the alignment."""
        if self._stamp is None or odom_from_base is None or stamp < self._stamp:
            return True
        seconds = 1e-9 * (stamp - self._stamp)
        if seconds * self.rate < 1:
            return False
        if state != "aligned" or self._base is None or seconds >= self.max_age:
            return True
        moved = inverse(self._base) @ odom_from_base
        return float(np.linalg.norm(moved[:3, 3])) >= self.min_translation or angle_deg(moved) >= self.min_rotation_deg

    def asked(self, stamp: int, odom_from_base: Matrix | None) -> None:
        """Remembers a question."""
        self._stamp, self._base = stamp, odom_from_base
