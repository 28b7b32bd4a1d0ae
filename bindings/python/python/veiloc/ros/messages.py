"""Messages of ROS as values of this package: images, cameras, transforms. Any object with the fields of the message will do, those of
`rclpy` and of `rosbags` among them.
"""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import numpy.typing as npt

from veiloc import ImageError, InputError
from veiloc.ros.geometry import Matrix, matrix

IMAGE = "sensor_msgs/msg/Image"
COMPRESSED = "sensor_msgs/msg/CompressedImage"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
TF = "tf2_msgs/msg/TFMessage"
POSES = {
    "nav_msgs/msg/Odometry": lambda message: message.pose.pose,
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda message: message.pose.pose,
    "geometry_msgs/msg/PoseStamped": lambda message: message.pose,
    "geometry_msgs/msg/TransformStamped": lambda message: message.transform,
}
"""Types of messages with a pose, and where it is in them."""

_CHANNELS = {"mono8": 1, "8UC1": 1, "rgb8": 3, "bgr8": 3, "8UC3": 3, "rgba8": 4, "bgra8": 4}
"""Channels of one byte. `8UC3` is OpenCV's, blue first."""
_LUMA = {"yuv422": 1, "uyvy": 1, "yuv422_yuy2": 0, "yuyv": 0}
"""Two bytes a pixel, and which of them is the brightness."""


def stamp_of(header: Any) -> int:
    """The time of a header, nanoseconds."""
    return int(header.stamp.sec) * 10**9 + int(header.stamp.nanosec)


def transform_of(pose: Any) -> Matrix:
    """A `Pose` or `Transform` as a matrix: the pose of the child in its frame.

    Raises:
        InputError: a number is not finite, or the quaternion is zero.
    """
    p = pose.position if hasattr(pose, "position") else pose.translation
    q = pose.orientation if hasattr(pose, "orientation") else pose.rotation
    return matrix([p.x, p.y, p.z], [q.x, q.y, q.z, q.w])


def image_of(message: Any) -> npt.NDArray[np.uint8]:
    """The pixels of an `Image` or a `CompressedImage`, `[H, W]` (brightness) or `[H, W, 3]` (red, green, blue).

    Raises:
        ImageError: the encoding is not read, or there are too few bytes.
    """
    data = np.frombuffer(message.data, np.uint8) if isinstance(message.data, (bytes, bytearray)) else np.asarray(message.data, np.uint8)
    if not hasattr(message, "encoding"):
        return _decoded(data.tobytes(), message.format)
    height, width, step, encoding = message.height, message.width, message.step, message.encoding

    def rows(per_pixel: int) -> npt.NDArray[np.uint8]:
        if step < width * per_pixel or len(data) < step * (height - 1) + width * per_pixel or height == 0 or width == 0:
            raise ImageError(f"an image of {width} × {height} pixels ({encoding}) has {len(data)} bytes in rows of {step}: too few")
        whole = data[: step * height] if len(data) >= step * height else np.pad(data, (0, step * height - len(data)))
        return whole.reshape(height, step)[:, : width * per_pixel]

    if encoding in _CHANNELS:
        channels = _CHANNELS[encoding]
        pixels = rows(channels).reshape(height, width, channels)
        if channels == 1:
            return np.ascontiguousarray(pixels[:, :, 0])
        order = [0, 1, 2] if encoding.startswith("rgb") else [2, 1, 0]
        return np.ascontiguousarray(pixels[:, :, order])
    if encoding in ("mono16", "16UC1"):
        wide = np.ascontiguousarray(rows(2)).view(">u2" if message.is_bigendian else "<u2")
        # Cameras of 10 or 12 bits leave the upper bits empty.
        top = max(8, int(wide.max()).bit_length())
        return (wide >> (top - 8)).astype(np.uint8)
    if encoding in _LUMA:
        return np.ascontiguousarray(rows(2)[:, _LUMA[encoding] :: 2])
    if encoding in ("nv12", "nv21"):
        return np.ascontiguousarray(rows(1))
    remedy = "; debayer it first (image_proc)" if encoding.startswith("bayer") else ""
    raise ImageError(f"images with the encoding {encoding!r} are not read{remedy}; read are {', '.join(_CHANNELS)}, mono16, yuv422 and nv12")


def _decoded(data: bytes, form: str) -> npt.NDArray[np.uint8]:
    if "compressedDepth" in form:
        raise ImageError("a depth image has no texture: give the topic of the colour or infrared camera")
    try:
        from PIL import Image
    except ImportError:
        raise ImageError("compressed images need Pillow: pip install 'veiloc[ros]'") from None
    try:
        with Image.open(io.BytesIO(data), formats=("JPEG", "PNG", "WEBP")) as image:
            return np.array(image.convert("L" if image.mode in ("L", "1", "I;16") else "RGB"))
    except Exception as error:  # Pillow's decoders raise many types.
        raise ImageError(f"a compressed image ({form!r}) cannot be decoded: {error}") from None


def camera_of(info: Any, *, rectified: bool = False) -> dict[str, Any]:
    """The camera of a `CameraInfo`, as a dictionary for `Sealer.extract`.

    Pixels of ROS count from the centre of the first one, those of this package from its corner: half a pixel is added. Binning and the
    region of interest are applied.

    Args:
        info: the message.
        rectified: the image is rectified (`image_rect`): its camera is the matrix `p`, without distortion.

    Raises:
        InputError: the camera is not calibrated, or its model is not known.
    """
    k = [float(number) for number in info.k]
    d = [float(number) for number in info.d]
    if not np.isfinite([*k, *d]).all():
        raise InputError("CameraInfo: a number is not finite")
    p = [float(number) for number in info.p]
    fx, fy, cx, cy = (p[0], p[5], p[2], p[6]) if rectified else (k[0], k[4], k[2], k[5])
    if not (fx > 0 and fy > 0):
        raise InputError("CameraInfo: the camera is not calibrated (a focal length is 0); calibrate it (camera_calibration), or give a camera")
    width, height, roi = int(info.width), int(info.height), info.roi
    if roi.width and roi.height:
        width, height, cx, cy = int(roi.width), int(roi.height), cx - roi.x_offset, cy - roi.y_offset
    # The corner of the first pixel is 0; binning scales from there.
    cx, cy = cx + 0.5, cy + 0.5
    bx, by = max(1, int(info.binning_x)), max(1, int(info.binning_y))
    fx, cx, width, fy, cy, height = fx / bx, cx / bx, width // bx, fy / by, cy / by, height // by
    model = info.distortion_model.strip().lower()
    pinhole = [fx, fy, cx, cy]
    while len(d) > 8 and d[-1] == 0:  # Thin prism and tilt, which have no model here.
        d.pop()
    if rectified or not any(d):
        name, params = "PINHOLE", pinhole
    elif model in ("plumb_bob", "radtan", "rational_polynomial", "") and len(d) in (4, 5, 8):
        k1, k2, p1, p2, *more = d
        k3, k4, k5, k6 = [*more, 0.0, 0.0, 0.0, 0.0][:4]
        if k3 or k4 or k5 or k6:
            name, params = "FULL_OPENCV", [*pinhole, k1, k2, p1, p2, k3, k4, k5, k6]
        else:
            name, params = "OPENCV", [*pinhole, k1, k2, p1, p2]
    elif model in ("equidistant", "fisheye") and len(d) >= 4:
        name, params = "OPENCV_FISHEYE", [*pinhole, *d[:4]]
    else:
        raise InputError(
            f"CameraInfo: the distortion model {info.distortion_model!r} with {len(d)} numbers is not known; known are plumb_bob (4 or 5), "
            "rational_polynomial (8) and equidistant (4). Rectify the images (image_proc) and give their topic"
        )
    return {"model": name, "width": width, "height": height, "params": params}


def is_rectified(topic: str) -> bool:
    """Whether a topic is of rectified images by its name: `image_proc` calls them `image_rect`, `image_rect_color`."""
    return "rect" in topic.rsplit("/compressed", 1)[0].rsplit("/", 1)[-1]


def info_topic(topic: str) -> str:
    """The topic of the camera of an image topic, as `image_transport` has it: `camera_info` beside it."""
    base = topic.rsplit("/compressed", 1)[0]
    return f"{base.rsplit('/', 1)[0]}/camera_info"
