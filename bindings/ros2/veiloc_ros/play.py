"""Plays a bag to the localizer and prints what it says, where `ros2 bag play` is not installed: `python -m veiloc_ros.play BAG`."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

import veiloc
from veiloc.ros import Bag

TYPES = {f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}": kind for kind in (CameraInfo, CompressedImage, Image, Odometry)}
WAIT = 60.0
"""Seconds to wait for the localizer before and for its last answer after the bag."""


class Player(Node):
    """Publishes the images, cameras and odometry of a bag, and counts answers."""

    def __init__(self, bag: Bag) -> None:
        super().__init__("player")
        self.bag, self.poses, self.transforms = bag, list[Any](), list[Any]()
        # Deep enough for a walk: a robot's camera may drop images, a trial should not.
        quality = QoSProfile(depth=100)
        self.publishers_by_topic = {
            connection.topic: self.create_publisher(TYPES[connection.msgtype], connection.topic, quality)
            for connection in bag.reader.connections
            if connection.msgtype in TYPES
        }
        self.create_subscription(PoseWithCovarianceStamped, "/localizer/pose", self.poses.append, quality)
        self.create_subscription(TransformStamped, "/localizer/map_to_odom", self.transforms.append, quality)

    def wait(self, condition: Any) -> bool:
        """Spins until a condition holds; False when it does not in time."""
        end = time.monotonic() + WAIT
        while not condition():
            if time.monotonic() > end:
                return False
            rclpy.spin_once(self, timeout_sec=0.05)
        return True

    def play(self, speed: float) -> None:
        """Plays the bag at its own pace times `speed`."""
        began, start = time.monotonic(), self.bag.reader.start_time
        for connection, stamp, data in self.bag.reader.messages():
            if connection.topic not in self.publishers_by_topic:
                continue
            due = began + 1e-9 * (stamp - start) / speed
            while time.monotonic() < due:
                rclpy.spin_once(self, timeout_sec=max(0.0, due - time.monotonic()))
            self.publishers_by_topic[connection.topic].publish(deserialize_message(data, TYPES[connection.msgtype]))


def main() -> int:
    """Plays a bag; fails when there is no localizer, or it found nothing."""
    parser = argparse.ArgumentParser(prog="python -m veiloc_ros.play", description=__doc__)
    parser.add_argument("bag", type=Path)
    parser.add_argument("--speed", type=float, default=1.0, help="1 is the pace of the recording")
    args = parser.parse_args()
    rclpy.init()
    try:
        with Bag(args.bag) as bag:
            player = Player(bag)
            if not player.wait(lambda: all(publisher.get_subscription_count() for publisher in player.publishers_by_topic.values())):
                print("no localizer takes the topics of this bag: " + ", ".join(player.publishers_by_topic))
                return 1
            player.play(args.speed)
            player.wait(lambda: player.poses and player.transforms)
    except veiloc.Error as error:
        print(f"error: {error}")
        return 1
    finally:
        rclpy.try_shutdown()
    if not player.transforms:
        print("the localizer did not find the map")
        return 1
    translation = player.transforms[-1].transform.translation
    print(f"{len(player.poses)} trusted poses; map → odom at ({translation.x:.2f}, {translation.y:.2f}, {translation.z:.2f}) m")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
