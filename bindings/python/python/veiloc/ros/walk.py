"""A bag of a robot that walks along posed images: for trials, tests and measurements of what odometry with drift becomes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import veiloc
from veiloc.ros.geometry import Matrix, Trajectory, inverse, matrix
from veiloc.ros.made import Made

BASE_FROM_CAM = matrix([0.1, 0.0, 0.3], [-0.5, 0.5, -0.5, 0.5])
"""The camera looks along the robot's x axis, 30 cm above its base (REP 103: `x` forward, `z` up; optical frames `z` forward, `y` down)."""

_MODELS = {"OPENCV": "plumb_bob", "FULL_OPENCV": "rational_polynomial", "OPENCV_FISHEYE": "equidistant"}


def upright(down: npt.ArrayLike) -> Matrix:
    """The rotation of a world whose gravity points along `down` into one whose `z` is up."""
    z = -np.asarray(down, float)
    z /= np.linalg.norm(z)
    x = np.eye(3)[int(np.argmin(abs(z)))]
    x = x - (x @ z) * z
    x /= np.linalg.norm(x)
    result = np.eye(4)
    result[:3, :3] = [x, np.cross(z, x), z]
    return result


def write_walk(
    posed: str | Path | Sequence[tuple[str, Any, veiloc.CameraPose]],
    images: str | Path,
    out: str | Path,
    *,
    names: Sequence[str] | None = None,
    rate: float = 5.0,
    drift: float = 0.01,
    drift_deg: float = 0.1,
    storage: str = "mcap",
    down: npt.ArrayLike | None = None,
) -> dict[str, Any]:
    """Writes a bag: images with their camera, odometry that drifts (also as tf), and the true poses (`/ground_truth`).

    Args:
        posed: images with poses in metres, of any format that `veiloc.read_posed` reads, or a list of (name, camera, CameraPose); the robot takes
            them in the order of their names.
        images: folder of the images.
        out: the folder of the bag; it must not exist.
        names: images that the bag has, in the order of the walk; the robot walks past all of them. Default: all.
        rate: images of the walk per second.
        drift: the odometry's distances are too long by this share.
        drift_deg: its heading turns by this many degrees a metre.
        storage: `"mcap"` or `"sqlite3"`.
        down: direction of gravity in the frame of the poses. Default: what is down in the images, on average.

    Returns:
        `images`, `metres` (of the path), `seconds`, `down`.
    """
    from rosbags.rosbag2 import StoragePlugin, Writer

    listed = list(veiloc.read_posed(posed, images)[0] if isinstance(posed, (str, Path)) else posed)
    listed.sort(key=lambda entry: entry[0])
    if down is None:
        mean = np.mean([cam_from_world.R[1] for _, _, cam_from_world in listed], axis=0)
        down = mean / np.linalg.norm(mean)
    to_map = upright(down)
    cam_from_base = inverse(BASE_FROM_CAM)
    stamps = {name: 1_700_000_000 * 10**9 + round(1e9 * k / rate) for k, (name, _, _) in enumerate(listed)}
    truth = [(stamps[name], to_map @ cam_from_world.inverse().matrix @ cam_from_base) for name, _, cam_from_world in listed]
    odometry, path = _drifted(truth, drift, drift_deg)
    made = Made()
    store, types = made.store, made.types
    between = Trajectory(odometry, max_gap=10.0)

    plugin = {"mcap": StoragePlugin.MCAP, "sqlite3": StoragePlugin.SQLITE3}[storage]
    kinds = {
        "/camera/image_raw/compressed": "sensor_msgs/msg/CompressedImage",
        "/camera/camera_info": "sensor_msgs/msg/CameraInfo",
        "/odom": "nav_msgs/msg/Odometry",
        "/tf": "tf2_msgs/msg/TFMessage",
        "/tf_static": "tf2_msgs/msg/TFMessage",
        "/ground_truth": "geometry_msgs/msg/PoseStamped",
    }
    wanted = set(stamps if names is None else names)
    unknown = sorted(wanted - set(stamps))
    if unknown:
        raise veiloc.InputError(f"{unknown[0]} has no pose")
    with Writer(Path(out), version=8, storage_plugin=plugin) as writer:
        connections = {topic: writer.add_connection(topic, kind, typestore=store) for topic, kind in kinds.items()}

        def write(topic: str, stamp: int, message: Any) -> None:
            writer.write(connections[topic], stamp, store.serialize_cdr(message, kinds[topic]))

        start, end = truth[0][0], truth[-1][0]
        write("/tf_static", start, made.tf(start, "base_link", "camera_optical", BASE_FROM_CAM))
        zero36 = np.zeros(36)
        still = types["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0)
        twist = types["geometry_msgs/msg/TwistWithCovariance"](
            twist=types["geometry_msgs/msg/Twist"](linear=still, angular=still), covariance=zero36
        )
        images_at = {stamps[name]: (name, camera) for name, camera, _ in listed if name in wanted}
        true_at = dict(truth)
        # Odometry at 20 Hz, and at the images.
        for stamp in sorted({*range(start, end + 1, 50_000_000), *stamps.values()}):
            odom_from_base = between.at(stamp)
            assert odom_from_base is not None
            covariance = types["geometry_msgs/msg/PoseWithCovariance"](pose=made.pose(odom_from_base), covariance=zero36)
            odometer = types["nav_msgs/msg/Odometry"](
                header=made.header(stamp, "odom"), child_frame_id="base_link", pose=covariance, twist=twist
            )
            write("/odom", stamp, odometer)
            write("/tf", stamp, made.tf(stamp, "odom", "base_link", odom_from_base))
            if stamp in true_at:
                true = types["geometry_msgs/msg/PoseStamped"](header=made.header(stamp, "map"), pose=made.pose(true_at[stamp]))
                write("/ground_truth", stamp, true)
            if stamp in images_at:
                name, camera = images_at[stamp]
                data = np.frombuffer((Path(images) / name).read_bytes(), np.uint8)
                form = "jpeg" if data[:2].tobytes() == b"\xff\xd8" else "png"
                write("/camera/camera_info", stamp, _camera_info(types, made.header(stamp, "camera_optical"), camera))
                picture = types["sensor_msgs/msg/CompressedImage"](header=made.header(stamp, "camera_optical"), format=form, data=data)
                write("/camera/image_raw/compressed", stamp, picture)
    return {"images": len(images_at), "metres": path, "seconds": 1e-9 * (end - start), "down": [float(c) for c in np.asarray(down)]}


def _drifted(truth: list[tuple[int, Matrix]], drift: float, drift_deg: float) -> tuple[list[tuple[int, Matrix]], float]:
    """The poses in a frame that begins at the first one (level, as odometry does), with distances that are too long and a heading that
    turns; and the length of the true path.
    """
    first = truth[0][1]
    yaw = np.arctan2(first[1, 0], first[0, 0])
    level = np.eye(4)
    level[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    level[:3, 3] = first[:3, 3]
    local = [(stamp, inverse(level) @ transform) for stamp, transform in truth]
    moved, path, result = local[0][1].copy(), 0.0, []
    for k, (stamp, transform) in enumerate(local):
        step = transform[:3, 3] - local[max(0, k - 1)][1][:3, 3]
        path += float(np.linalg.norm(step))
        turn = np.radians(drift_deg * path)
        heading = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
        position = moved[:3, 3] + (1 + drift) * heading @ step
        moved = np.eye(4)
        moved[:3, :3], moved[:3, 3] = heading @ transform[:3, :3], position
        result.append((stamp, moved))
    return result, path


def _camera_info(types: Any, header: Any, camera: Any) -> Any:
    if isinstance(camera, str):
        name, width, height, *numbers = camera.replace(",", " ").split()
        camera = {"model": name, "width": int(width), "height": int(height), "params": list(map(float, numbers))}
    model, params = camera["model"], [float(value) for value in camera["params"]]
    if model == "SIMPLE_PINHOLE":
        params = [params[0], *params]
    elif model in ("SIMPLE_RADIAL", "RADIAL"):
        k1, k2 = [*params[3:], 0.0][:2]
        params = [params[0], *params[:3], k1, k2, 0.0, 0.0]
    fx, fy, cx, cy, *d = params
    if model not in ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", *_MODELS):
        raise veiloc.InputError(f"a camera of the model {model} has no CameraInfo")
    # Pixels of ROS count from the centre of the first one.
    k = np.array([fx, 0, cx - 0.5, 0, fy, cy - 0.5, 0, 0, 1])
    p = np.array([fx, 0, cx - 0.5, 0, 0, fy, cy - 0.5, 0, 0, 0, 1, 0])
    roi = types["sensor_msgs/msg/RegionOfInterest"](x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
    return types["sensor_msgs/msg/CameraInfo"](
        header=header, height=camera["height"], width=camera["width"], distortion_model=_MODELS.get(model, "plumb_bob"),
        d=np.array([*d, *[0.0] * max(0, (4 if model == "OPENCV_FISHEYE" else 5) - len(d))]), k=k, r=np.eye(3).ravel(), p=p, binning_x=0, binning_y=0, roi=roi,
    )  # fmt: skip
