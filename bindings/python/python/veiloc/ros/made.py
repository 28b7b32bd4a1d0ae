"""Messages of ROS that are written to bags, of the types of `rosbags`."""

from __future__ import annotations

from typing import Any

from veiloc.ros.geometry import Matrix, pose


class Made:
    """Makes messages, and serializes them."""

    def __init__(self) -> None:
        from rosbags.typesys import Stores, get_typestore

        self.store: Any = get_typestore(Stores.ROS2_HUMBLE)
        self.types = self.store.types

    def header(self, stamp: int, frame: str) -> Any:
        """A header."""
        time = self.types["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
        return self.types["std_msgs/msg/Header"](stamp=time, frame_id=frame)

    def _parts(self, transform: Matrix, kind: str) -> tuple[Any, Any]:
        x, y, z, w = (float(c) for c in pose(transform).xyzw)
        px, py, pz = (float(c) for c in transform[:3, 3])
        return self.types[f"geometry_msgs/msg/{kind}"](x=px, y=py, z=pz), self.types["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w)

    def pose(self, transform: Matrix) -> Any:
        """A `Pose`."""
        position, orientation = self._parts(transform, "Point")
        return self.types["geometry_msgs/msg/Pose"](position=position, orientation=orientation)

    def tf(self, stamp: int, parent: str, child: str, transform: Matrix) -> Any:
        """A `TFMessage` with one transform."""
        translation, rotation = self._parts(transform, "Vector3")
        moved = self.types["geometry_msgs/msg/Transform"](translation=translation, rotation=rotation)
        stamped = self.types["geometry_msgs/msg/TransformStamped"]
        return self.types["tf2_msgs/msg/TFMessage"](transforms=[stamped(header=self.header(stamp, parent), child_frame_id=child, transform=moved)])
