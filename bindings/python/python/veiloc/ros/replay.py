"""Localizes a recorded walk as the node does, and compares with its odometry or with true poses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

import veiloc
from veiloc.ros import messages
from veiloc.ros.bag import Bag, Picture
from veiloc.ros.geometry import Matrix, Trajectory, angle_deg, inverse, pose
from veiloc.ros.localizer import Frame, Localizer, MapServer, Outcome, Pace, Server, ServiceServer
from veiloc.ros.made import Made

SPREAD = 10**8
"""Longest time between the images of several cameras that are asked together, nanoseconds."""
REGIONS = {"50": 5.348, "90": 10.645, "99": 16.812}
"""Quantiles of the squared Mahalanobis distance with six degrees of freedom."""


@dataclass
class Replayed:
    """What a replay found."""

    outcomes: list[Outcome]
    """An entry for each question."""
    corrected: list[tuple[int, Matrix | None]]
    """The pose of the robot in the map by the correction that was known at the time, at each time of the true poses or of the images."""
    odometry: list[tuple[int, Matrix]]
    """The pose of the robot in the odometry frame at these times."""
    truth: Trajectory | None
    """True poses of the robot in the map."""
    remarks: list[str] = field(default_factory=list)

    def write_tum(self, path: Path) -> None:
        """Writes the corrected poses: `time x y z qx qy qz qw`, the robot in the map."""
        lines = ["# time x y z qx qy qz qw: the robot in the map, metres\n"]
        for stamp, map_from_base in self.corrected:
            if map_from_base is not None:
                numbers = [*map_from_base[:3, 3], *pose(map_from_base).xyzw]
                lines.append(f"{stamp // 10**9}.{stamp % 10**9:09d} {' '.join(f'{float(number):.9g}' for number in numbers)}\n")
        path.write_text("".join(lines))

    def write_mcap(self, folder: Path) -> None:
        """Writes a bag with `/veiloc/pose` (`PoseWithCovarianceStamped` of the trusted answers) and `/tf` (`map → odom`)."""
        from rosbags.rosbag2 import StoragePlugin, Writer

        made = Made()
        store, t = made.store, made.types
        kinds = {"/veiloc/pose": "geometry_msgs/msg/PoseWithCovarianceStamped", "/tf": "tf2_msgs/msg/TFMessage"}
        odometry = dict(self.odometry)
        with Writer(folder, version=8, storage_plugin=StoragePlugin.MCAP) as writer:
            connections = {topic: writer.add_connection(topic, kind, typestore=store) for topic, kind in kinds.items()}
            for outcome in self.outcomes:
                if outcome.state == "trusted" and outcome.map_from_base is not None and outcome.covariance is not None:
                    value = t["geometry_msgs/msg/PoseWithCovariance"](pose=made.pose(outcome.map_from_base), covariance=outcome.covariance.ravel())
                    message = t[kinds["/veiloc/pose"]](header=made.header(outcome.stamp, "map"), pose=value)
                    writer.write(connections["/veiloc/pose"], outcome.stamp, store.serialize_cdr(message, kinds["/veiloc/pose"]))
            for stamp, map_from_base in self.corrected:
                if map_from_base is not None:
                    message = made.tf(stamp, "map", "odom", map_from_base @ inverse(odometry[stamp]))
                    writer.write(connections["/tf"], stamp, store.serialize_cdr(message, kinds["/tf"]))


def server_of(
    map_file: str | Path | None, server: str | None = None, map_name: str | None = None, token: str | None = None, certificates: bytes | None = None
) -> tuple[MapServer | ServiceServer, veiloc.Profile]:
    """A map file of this process, or a map of a service, with its profile.

    Raises:
        Error: the map cannot be opened, the service cannot be reached, or it was given without the name of a map.
    """
    if map_file is not None:
        opened = veiloc.Map.open(map_file)
        return MapServer(opened), opened.profile
    if server is None or not map_name:
        raise veiloc.InputError("a service needs the name of a map, too")
    client = veiloc.Client(server, token, certificates=certificates)
    return ServiceServer(client, map_name), client.profile(map_name)


def replay_bag(
    bag: Bag,
    server: Server,
    sealer: veiloc.Sealer,
    *,
    truth: str | None = None,
    rate: float = 1.0,
    min_translation: float = 0.3,
    min_rotation_deg: float = 15.0,
    gravity_sd_deg: float | None = 2.0,
    metres_per_unit: float | None = None,
    latency: float = 0.5,
    alignment: veiloc.Alignment | None = None,
    progress: Callable[[str, int, int], object] | None = None,
) -> Replayed:
    """Replays a bag.

    Args:
        bag: the bag; with several topics of images, their cameras are a rig.
        server, sealer, gravity_sd_deg, metres_per_unit, alignment: as for `Localizer`.
        truth: topic of the true poses of the robot in the map.
        rate, min_translation, min_rotation_deg: when to ask (`Pace`).
        latency: seconds of the bag after which an answer is there.
        progress: a callable of (stage, done, total).

    Raises:
        Error: the bag does not have the topic of `truth`.
    """
    if alignment is None:
        alignment = veiloc.Alignment(metres_per_unit=metres_per_unit)
    localizer = Localizer(server, sealer, alignment, metres_per_unit, gravity_sd_deg)
    known = None if truth is None else bag.poses(truth)
    pace, outcomes, corrections = Pace(rate, min_translation, min_rotation_deg), list[Outcome](), list[tuple[int, Matrix]]()
    waiting: dict[str, Picture] = {}
    times, done, total = list[int](), 0, bag.count
    for picture in bag.pictures():
        done += 1
        if progress is not None:
            progress("images of the bag", done, total)
        times.append(picture.stamp)
        waiting[picture.topic] = picture
        together = list(waiting.values())
        if len(together) < len(bag.topics) or max(p.stamp for p in together) - min(p.stamp for p in together) > SPREAD:
            continue
        base = bag.odom_from_base(picture.stamp)
        if not pace.is_due(picture.stamp, base, alignment.state):
            continue
        waiting = {}
        pace.asked(picture.stamp, base)
        if base is not None:
            alignment.moved(pose(inverse(base)))
        try:
            frames = [Frame(p.stamp, messages.image_of(p.message), bag.cameras[p.topic], bag.extrinsics(p)) for p in together]
        except veiloc.ImageError as error:
            outcomes.append(Outcome(picture.stamp, "unusable-image", text=str(error)))
            continue
        outcomes.append(localizer.ask(frames, bag.trajectory([p.stamp for p in together])))
        if localizer.map_from_odom is not None:
            corrections.append((picture.stamp + int(1e9 * latency), localizer.map_from_odom))
    # From the first image on: before it nothing could be known.
    stamps = sorted(set(times)) if known is None else [stamp for stamp in known.stamps if times and stamp >= times[0]]
    corrected, odometry, at = list[tuple[int, Matrix | None]](), list[tuple[int, Matrix]](), 0
    for stamp in stamps:
        base = bag.odom_from_base(stamp)
        if base is None:
            continue
        while at < len(corrections) and corrections[at][0] <= stamp:
            at += 1
        odometry.append((stamp, base))
        corrected.append((stamp, corrections[at - 1][1] @ base if at else None))
    return Replayed(outcomes, corrected, odometry, known, bag.remarks)


def errors(found: Matrix, true: Matrix) -> tuple[float, float]:
    """Distance (metres) and angle (degrees) between two poses."""
    return float(np.linalg.norm(found[:3, 3] - true[:3, 3])), angle_deg(inverse(true) @ found)


def squared_distance(outcome: Outcome, true: Matrix) -> float:
    """Squared Mahalanobis distance of a pose from the true one, by its covariance in the order of ROS."""
    assert outcome.map_from_base is not None and outcome.covariance is not None
    turn = true[:3, :3] @ outcome.map_from_base[:3, :3].T
    q = veiloc.CameraPose(R=turn).q
    axis = q[1:] * (2.0 if q[0] > 1 - 1e-9 else 2 * np.arccos(min(1.0, q[0])) / np.linalg.norm(q[1:]))
    step = np.concatenate([true[:3, 3] - outcome.map_from_base[:3, 3], axis])
    return float(step @ np.linalg.solve(outcome.covariance, step))


def own_truth(found: Replayed) -> Trajectory | None:
    """The odometry, moved onto the trusted answers by the transform that most of them agree on: to compare with when nothing better is
    there.
    """
    odometry = dict(found.odometry)
    trusted = [o for o in found.outcomes if o.state == "trusted" and o.map_from_base is not None and o.stamp in odometry]
    candidates = [o.map_from_base @ inverse(odometry[o.stamp]) for o in trusted if o.map_from_base is not None]
    if not candidates:
        return None
    centre = np.median([c[:3, 3] for c in candidates], axis=0)
    best = min(candidates, key=lambda c: float(np.linalg.norm(c[:3, 3] - centre)))
    return Trajectory([(stamp, best @ base) for stamp, base in found.odometry])


def summary(found: Replayed) -> dict[str, Any]:
    """Counts and errors of a replay, for people and as JSON."""
    states = [outcome.state for outcome in found.outcomes]
    answered = [outcome for outcome in found.outcomes if outcome.sealed_bytes]
    result: dict[str, Any] = {"asked": len(states)}
    result |= {state: states.count(state) for state in sorted(set(states))}
    if answered:
        result["bytes of a query, median"] = int(np.median([outcome.sealed_bytes for outcome in answered]))
        result["processor time to seal, median (ms)"] = round(float(np.median([outcome.seal_ms for outcome in answered])), 1)
        result["wait for an answer, median (ms)"] = round(float(np.median([outcome.wait_ms for outcome in answered])), 1)
    truth, kind = found.truth, "true poses"
    if truth is None:
        truth, kind = own_truth(found), "odometry"
    if truth is None:
        return result
    of = [(outcome, truth.at(outcome.stamp)) for outcome in found.outcomes if outcome.state == "trusted" and outcome.map_from_base is not None]
    pairs = [(outcome, true) for outcome, true in of if true is not None]
    off = [errors(outcome.map_from_base, true) for outcome, true in pairs if outcome.map_from_base is not None]
    result["compared with"] = kind
    if off:
        result["trusted answers off by, median and most (m)"] = [round(float(np.median([e[0] for e in off])), 3), round(max(e[0] for e in off), 3)]
        result["trusted answers off by, median and most (°)"] = [round(float(np.median([e[1] for e in off])), 2), round(max(e[1] for e in off), 2)]
        squared = [squared_distance(outcome, true) for outcome, true in pairs]
        for region, limit in REGIONS.items():
            result[f"trusted answers in their {region} % region (%)"] = round(100 * sum(s <= limit for s in squared) / len(squared), 1)
    later = [(c, truth.at(stamp)) for stamp, c in found.corrected]
    both = [errors(c, true) for c, true in later if c is not None and true is not None]
    if both:
        result["wrong corrections (robot off by more than 25 cm or 2°)"] = sum(e[0] > 0.25 or e[1] > 2 for e in both)
        within = sum(e[0] <= 0.1 and e[1] <= 2 for e in both)
        result["robot in the map within 10 cm and 2° (% of the time)"] = round(100 * within / len(later), 1)
        result["robot in the map off by, median and most (m)"] = [round(float(np.median([e[0] for e in both])), 3), round(max(e[0] for e in both), 3)]
        result["robot in the map off by, median and most (°)"] = [round(float(np.median([e[1] for e in both])), 2), round(max(e[1] for e in both), 2)]
    return result
