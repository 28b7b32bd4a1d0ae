"""Robots: what the ROS 2 node `veiloc_ros` does, without ROS, and bags.

- `Localizer`: seals the images of a robot's cameras, asks a map (`MapServer`) or a service (`ServiceServer`), and joins the answers with
  the odometry; `Pace` says when to ask.
- `camera_of`, `image_of`, `transform_of`: messages as values of this package.
- `ros_covariance`: the covariance of an answer in the order of ROS.
- `Bag`, `write_frames`: bags of ROS 2 and ROS 1.

From the command line: `python -m veiloc.ros --help`. Guide: `docs/guide/robots.md`.
"""

from veiloc.ros.bag import Bag, Picture
from veiloc.ros.frames import write_frames
from veiloc.ros.geometry import Trajectory, Transforms, inverse, matrix, pose, ros_covariance
from veiloc.ros.localizer import Frame, Localizer, MapServer, Outcome, Pace, Rough, ServiceServer
from veiloc.ros.messages import camera_of, image_of, stamp_of, transform_of

__all__ = [
    "Bag",
    "Frame",
    "Localizer",
    "MapServer",
    "Outcome",
    "Pace",
    "Picture",
    "Rough",
    "ServiceServer",
    "Trajectory",
    "Transforms",
    "camera_of",
    "image_of",
    "inverse",
    "matrix",
    "pose",
    "ros_covariance",
    "stamp_of",
    "transform_of",
    "write_frames",
]
