"""Bags of ROS 2 (MCAP, SQLite) and ROS 1: images with cameras, and poses from odometry or tf (`pip install 'veiloc[ros]'`)."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import veiloc
from veiloc.ros import messages
from veiloc.ros.geometry import Matrix, Trajectory, Transforms


@dataclass(frozen=True)
class Picture:
    """An image message: its time and topic, the message, and the frame of its camera."""

    stamp: int
    topic: str
    message: Any
    frame: str


def listed(names: Iterable[str]) -> str:
    """Names for a message."""
    return ", ".join(names) or "none"


class Bag:
    """A bag, opened for reading.

    Args:
        path: the folder of a bag, or its file (`.mcap`, `.db3`, `.bag`).
        topics: topics of the images; by default the only one.
        odometry: topic of the poses (`Odometry`, `PoseStamped`, `PoseWithCovarianceStamped`, `TransformStamped`), or the name of a frame
            of tf (`map`, `odom`). Default: the only topic of odometry, or else tf from `map` or `odom`.
        base_from_cam: where the camera is on the robot; by default tf says it.
        base: frame of the robot, with tf.

    Raises:
        Error: the file is no bag or is damaged, or it does not have the topics.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        topics: Sequence[str] = (),
        odometry: str | None = None,
        base_from_cam: Matrix | None = None,
        base: str = "base_link",
        rectified: bool | None = None,
    ) -> None:
        try:
            from rosbags.highlevel import AnyReader
            from rosbags.typesys import Stores, get_typestore
        except ImportError:
            raise veiloc.Error("bags need the package rosbags: pip install 'veiloc[ros]'") from None
        self.path, self.remarks, self._base_from_cam = Path(path), list[str](), base_from_cam
        self._stack = contextlib.ExitStack()
        # Bags of ROS 2 before Iron do not have the definitions of their messages.
        types = get_typestore(Stores.ROS2_HUMBLE)
        try:
            self.reader = self._stack.enter_context(AnyReader([self.path], default_typestore=types))
        except Exception as error:  # Readers of three formats and their libraries.
            raise veiloc.Error(f"{path}: not a bag, or damaged: {error}") from None
        try:
            self._choose(topics, odometry, base, rectified)
        except BaseException:
            self._stack.close()
            raise

    def __enter__(self) -> Bag:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def _of_types(self, types: Sequence[str]) -> dict[str, str]:
        """Topics of some types, with their types."""
        found = {connection.topic: connection.msgtype for connection in self.reader.connections if connection.msgtype in types}
        return dict(sorted(found.items()))

    def _choose(self, topics: Sequence[str], odometry: str | None, base: str, rectified: bool | None) -> None:
        pictures = self._of_types([messages.IMAGE, messages.COMPRESSED])
        if not topics:
            candidates = [topic for topic in pictures if "depth" not in topic.lower()]
            if len(candidates) != 1:
                raise veiloc.Error(f"{self.path}: topics of images: {listed(candidates)}; say which with --topic")
            topics = candidates
        for topic in topics:
            if topic not in pictures:
                raise veiloc.Error(f"{self.path}: no images under {topic!r}; topics of images: {listed(pictures)}")
        self.topics = list(topics)
        self.transforms = self._read_transforms()
        self.cameras = {topic: self._camera(topic, rectified) for topic in self.topics}
        sources = self._of_types(list(messages.POSES))
        frames = self.transforms.frames()
        if odometry is None:
            odometers = [topic for topic, kind in sources.items() if kind == "nav_msgs/msg/Odometry"]
            fixed = next((frame for frame in ("map", "odom") if frame in frames and self.transforms.are_connected(frame, base)), None)
            odometry = odometers[0] if len(odometers) == 1 else fixed
            if odometry is None:
                raise veiloc.Error(
                    f"{self.path}: which poses? Give --odometry with a topic ({listed(sources)}) or a frame of tf ({listed(sorted(frames))})"
                )
        self.source = odometry
        if odometry in sources:
            self.odometry, child = self._read_poses(odometry, sources[odometry])
            self.base = child or base
        elif odometry in frames:
            self.odometry, self.base = Trajectory(), base
            if not self.transforms.are_connected(odometry, base):
                raise veiloc.Error(f"{self.path}: tf does not connect {odometry!r} and {base!r}; its frames: {listed(sorted(frames))}")
        else:
            raise veiloc.Error(f"{self.path}: no poses under {odometry!r}; topics: {listed(sources)}; frames of tf: {listed(sorted(frames))}")
        self.is_tf = odometry not in sources

    def _messages(self, topics: Sequence[str]) -> Iterator[tuple[str, Any]]:
        """Topic and message. Messages that cannot be read are left out and counted; a damaged end of the file ends them."""
        connections = [connection for connection in self.reader.connections if connection.topic in topics]
        if not connections:
            return
        raw, broken = self.reader.messages(connections=connections), 0
        while True:
            try:
                connection, _, data = next(raw)
            except StopIteration:
                break
            except Exception as error:  # Of the decompression and database libraries.
                self._remark(f"the file is damaged, and what comes after is left out: {error}")
                break
            try:
                message = self.reader.deserialize(data, connection.msgtype)
            except Exception:
                broken += 1
                continue
            yield connection.topic, message
        if broken:
            self._remark(f"{broken} messages of {', '.join(topics)} cannot be read and are left out")

    def _remark(self, text: str) -> None:
        if text not in self.remarks:
            self.remarks.append(text)

    def _read_transforms(self) -> Transforms:
        tree, bad = Transforms(), 0
        for topic, message in self._messages(list(self._of_types([messages.TF]))):
            for entry in message.transforms:
                try:
                    transform = messages.transform_of(entry.transform)
                except veiloc.InputError:
                    bad += 1
                    continue
                stamp = None if topic.endswith("tf_static") else messages.stamp_of(entry.header)
                tree.add(entry.header.frame_id, entry.child_frame_id, stamp, transform)
        if bad:
            self._remark(f"{bad} transforms of tf are no rotation and translation, and are left out")
        return tree

    def _read_poses(self, topic: str, kind: str) -> tuple[Trajectory, str | None]:
        poses, base, bad = [], None, 0
        for _, message in self._messages([topic]):
            try:
                poses.append((messages.stamp_of(message.header), messages.transform_of(messages.POSES[kind](message))))
            except veiloc.InputError:
                bad += 1
            base = getattr(message, "child_frame_id", "").lstrip("/") or None
        if bad:
            self._remark(f"{bad} poses of {topic} are no rotation and translation, and are left out")
        if not poses:
            raise veiloc.Error(f"{self.path}: {topic} has no pose that can be read")
        return Trajectory(poses), base

    def _camera(self, topic: str, rectified: bool | None) -> dict[str, Any]:
        name = messages.info_topic(topic)
        for _, message in self._messages([name]):
            try:
                is_rectified = messages.is_rectified(topic) if rectified is None else rectified
                return messages.camera_of(message, rectified=is_rectified)
            except veiloc.InputError as error:
                raise veiloc.Error(f"{self.path}: {name}: {error}") from None
        raise veiloc.Error(f"{self.path}: {topic} has no camera: no message under {name}; record it, too")

    def pictures(self) -> Iterator[Picture]:
        """The images of the chosen topics, in the order of the bag."""
        for topic, message in self._messages(self.topics):
            yield Picture(messages.stamp_of(message.header), topic, message, message.header.frame_id.lstrip("/"))

    @property
    def count(self) -> int:
        """Number of images of the chosen topics."""
        return sum(connection.msgcount for connection in self.reader.connections if connection.topic in self.topics)

    def extrinsics(self, picture: Picture) -> Matrix:
        """Where the camera of an image is on the robot, `base_from_cam`.

        Raises:
            Error: tf does not say it.
        """
        if self._base_from_cam is not None:
            return self._base_from_cam
        if self.base == picture.frame:
            return np.eye(4)
        known = self.transforms.lookup(self.base, picture.frame, picture.stamp)
        if known is None:
            raise veiloc.Error(
                f"{self.path}: tf does not say where the camera {picture.frame!r} is on the robot {self.base!r}: record /tf_static, or give "
                "--base-from-camera x,y,z,qx,qy,qz,qw (0,0,0,0,0,0,1 if the poses are those of the camera)"
            )
        return known

    def poses(self, topic: str) -> Trajectory:
        """The poses of another topic.

        Raises:
            Error: the bag does not have it.
        """
        sources = self._of_types(list(messages.POSES))
        if topic not in sources:
            raise veiloc.Error(f"{self.path}: no poses under {topic!r}; topics: {listed(sources)}")
        return self._read_poses(topic, sources[topic])[0]

    def trajectory(self, stamps: Sequence[int]) -> Trajectory:
        """The poses of the robot at these times, as far as they are known."""
        known = [(stamp, self.odom_from_base(stamp)) for stamp in stamps]
        return Trajectory([(stamp, transform) for stamp, transform in known if transform is not None])

    def odom_from_base(self, stamp: int) -> Matrix | None:
        """The pose of the robot at a time; None when the bag has none near it."""
        return self.transforms.lookup(self.source, self.base, stamp) if self.is_tf else self.odometry.at(stamp)
