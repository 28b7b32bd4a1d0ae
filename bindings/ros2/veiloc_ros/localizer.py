"""The node `localizer`: where the robot is in a veiloc map.

It seals images on the robot, asks a service or a map file, and publishes

- `~/pose` (`PoseWithCovarianceStamped`): the pose of the robot in the map by each trusted answer, at the stamp of its image;
- tf `map → odom` (REP 105), from all answers that agree; also as `~/map_to_odom` (`TransformStamped`);
- `/diagnostics`: state, doubts, ages, times.

`/initialpose` gives a rough position, `~/localize` (`std_srvs/Trigger`) asks at once. Only trusted poses move `map → odom`.
The work is done by `veiloc.ros.Localizer`; this file is its border to ROS.
"""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass
from typing import Any

import numpy as np
import rclpy
import rclpy.duration
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from rclpy.time import Time
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from std_srvs.srv import Trigger

import veiloc
from veiloc.ros import Frame, Localizer, Outcome, Pace, Rough, Trajectory, camera_of, image_of, inverse, matrix, pose, stamp_of, transform_of
from veiloc.ros.messages import info_topic, is_rectified
from veiloc.ros.replay import server_of

try:
    import tf2_ros
except ImportError:  # The wheels of PyPI have no tf2; a ROS installation has.
    tf2_ros = None

PARAMETERS: dict[str, tuple[Any, str]] = {
    "map_file": ("", "Map file to localize in: nothing leaves the robot. Or give server and map_name."),
    "server": ("", "Address of a service, https://…: it gets sealed queries."),
    "map_name": ("", "Name of the map at the service."),
    "token_file": ("", "File with the token of the service, if it needs one."),
    "certificates": ("", "PEM file of CA certificates to trust in addition to the system's."),
    "image_topics": (["/camera/image_raw/compressed"], "Topics of images, one for each camera; CompressedImage if the name ends with "
                     "compressed, otherwise Image. Several cameras are a rig."),  # fmt: skip
    "camera_info_topics": ([""], "Topics of CameraInfo in the same order; empty: camera_info beside the image."),
    "base_from_camera": ([0.0], "Where each camera is on the robot: 7 numbers x y z qx qy qz qw a camera. A single number: tf says it."),
    "odometry_topic": ("/odom", "Topic of nav_msgs/Odometry; empty: tf from odom_frame to base_frame."),
    "map_frame": ("map", "Frame of the map."),
    "odom_frame": ("odom", "Frame of the odometry."),
    "base_frame": ("base_link", "Frame of the robot."),
    "publish_tf": (True, "Broadcast map → odom on tf. Nothing else may publish it (amcl: tf_broadcast: false)."),
    "tf_rate": (20.0, "How often map → odom is published, Hz."),
    "transform_tolerance": (0.1, "How far map → odom is dated into the future, seconds, as in amcl."),
    "rate": (1.0, "Most questions a second."),
    "min_translation": (0.3, "Once the map is found, ask again after the robot moved this far, metres …"),
    "min_rotation_deg": (15.0, "… or turned this far, degrees …"),
    "max_age": (10.0, "… or after this many seconds."),
    "trusted_only": (True, "Publish only trusted poses on ~/pose. Doubtful poses never move map → odom."),
    "gravity_sd_deg": (2.0, "Standard deviation of the vertical of the odometry, degrees; 0 does not use it (ramps with wheel odometry)."),
    "drift": (0.01, "Standard deviation of the odometry's position after a metre, metres."),
    "rotation_drift_deg": (0.1, "The same of its rotation, degrees."),
    "metres_per_unit": (0.0, "Metres of a unit of the map; 0: as the map says."),
    "max_keypoints": (0, "Most keypoints to send; 0: as the map wants."),
    "use_pack": (False, "Fetch the pack of the map, and send only what the place knows."),
}
"""Name, default and description."""


@dataclass
class Camera:
    """One camera: its topic, and what is known of it."""

    topic: str
    intrinsics: dict[str, Any] | None = None
    base_from_cam: Any = None
    problem: str = "no CameraInfo yet"
    newest: Any = None


class LocalizerNode(Node):
    """The node. Callbacks keep the newest image of each camera; one worker thread seals, asks and waits."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("localizer", **kwargs)
        for name, (default, text) in PARAMETERS.items():
            self.declare_parameter(name, default, ParameterDescriptor(description=text))
        self.lock = threading.Lock()
        self.wake = threading.Condition(self.lock)
        self.odometry = Trajectory(keep=60.0)
        self.last: Outcome | None = None
        self.trusted_stamp: int | None = None
        self.counts: dict[str, int] = {}
        self.wanted = self.stopping = False
        self.worker: threading.Thread | None = None
        self.asked_by_service = 0

        who, profile, pack = self._server()
        unit = self.value("metres_per_unit") or None
        drift = (self.value("drift"), self.value("rotation_drift_deg"))
        sealer = veiloc.Sealer(profile, max_keypoints=self.value("max_keypoints") or None, send_gravity=self.value("gravity_sd_deg") > 0, pack=pack)
        alignment = veiloc.Alignment(metres_per_unit=unit, drift=drift[0], rotation_drift_deg=drift[1])
        self.localizer = Localizer(who, sealer, alignment, unit, self.value("gravity_sd_deg") or None, drift)
        self.pace = Pace(self.value("rate"), self.value("min_translation"), self.value("min_rotation_deg"), self.value("max_age"))
        self.cameras = self._cameras()
        self._tf()

        reliable = QoSProfile(depth=5)
        self.pose_publisher = self.create_publisher(PoseWithCovarianceStamped, "~/pose", reliable)
        self.transform_publisher = self.create_publisher(TransformStamped, "~/map_to_odom", reliable)
        self.diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", reliable)
        images, rest = MutuallyExclusiveCallbackGroup(), ReentrantCallbackGroup()
        infos = self.value("camera_info_topics")
        # A node that takes images takes them best effort: that suits publishers of both kinds.
        for number, camera in enumerate(self.cameras):
            kind = CompressedImage if camera.topic.endswith("compressed") else Image
            self.create_subscription(kind, camera.topic, lambda message, camera=camera: self._image(camera, message), qos_profile_sensor_data,
                                     callback_group=images)  # fmt: skip
            info = infos[number] if number < len(infos) and infos[number] else info_topic(camera.topic)
            self.create_subscription(CameraInfo, info, lambda message, camera=camera: self._info(camera, message), qos_profile_sensor_data,
                                     callback_group=images)  # fmt: skip
        if self.value("odometry_topic"):
            quality = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
            self.create_subscription(Odometry, self.value("odometry_topic"), self._odometer, quality, callback_group=images)
        self.create_subscription(PoseWithCovarianceStamped, "/initialpose", self._initial, reliable, callback_group=rest)
        self.create_service(Trigger, "~/localize", self._localize, callback_group=rest)
        self.create_timer(1.0 / self.value("tf_rate"), self._publish_transform, callback_group=rest)
        self.create_timer(1.0, self._publish_diagnostics, callback_group=rest)
        self.worker = threading.Thread(target=self._work, name="localizer", daemon=True)
        self.worker.start()

    def value(self, name: str) -> Any:
        """The value of a parameter."""
        return self.get_parameter(name).value

    def _server(self) -> tuple[Any, Any, Any]:
        map_file, server, map_name = self.value("map_file"), self.value("server"), self.value("map_name")
        if bool(map_file) == bool(server):
            raise veiloc.InputError("give the parameter map_file, or server with map_name")
        if map_file:
            who, profile = server_of(map_file)
            pack = who.map.pack() if self.value("use_pack") else None
            return who, profile, pack
        token = None
        if self.value("token_file"):
            with open(self.value("token_file")) as file:
                token = file.read().strip()
        certificates = None
        if self.value("certificates"):
            with open(self.value("certificates"), "rb") as file:
                certificates = file.read()
        who, profile = server_of(None, server, map_name, token, certificates)
        pack = who.client.pack(map_name) if self.value("use_pack") else None
        return who, profile, pack

    def _cameras(self) -> list[Camera]:
        cameras = [Camera(topic) for topic in self.value("image_topics") if topic]
        if not cameras:
            raise veiloc.InputError("image_topics names no topic")
        given = list(self.value("base_from_camera"))
        if len(given) > 1:
            if len(given) != 7 * len(cameras):
                raise veiloc.InputError(f"base_from_camera has {len(given)} numbers; {len(cameras)} cameras need 7 each")
            for camera, at in zip(cameras, range(0, len(given), 7)):
                camera.base_from_cam = matrix(given[at : at + 3], given[at + 3 : at + 7])
        elif tf2_ros is None:
            raise veiloc.InputError("without tf2_ros give the parameter base_from_camera")
        return cameras

    def _tf(self) -> None:
        self.buffer = self.broadcaster = None
        if tf2_ros is not None:
            self.buffer = tf2_ros.Buffer()
            self.listener = tf2_ros.TransformListener(self.buffer, self)
            if self.value("publish_tf"):
                self.broadcaster = tf2_ros.TransformBroadcaster(self)
        elif not self.value("odometry_topic"):
            raise veiloc.InputError("without tf2_ros give the parameter odometry_topic")
        elif self.value("publish_tf"):
            self.get_logger().warning("tf2_ros is not installed: map → odom is on ~/map_to_odom only")

    # What comes in.

    def _info(self, camera: Camera, message: CameraInfo) -> None:
        try:
            camera.intrinsics, camera.problem = camera_of(message, rectified=is_rectified(camera.topic)), ""
        except veiloc.InputError as error:
            camera.problem = str(error)

    def _odometer(self, message: Odometry) -> None:
        try:
            transform = transform_of(message.pose.pose)
        except veiloc.InputError:
            return
        with self.wake:
            self.odometry.add(stamp_of(message.header), transform)
            self.wake.notify_all()

    def _image(self, camera: Camera, message: Any) -> None:
        with self.wake:
            camera.newest = message
            self.wake.notify_all()

    def _initial(self, message: PoseWithCovarianceStamped) -> None:
        """A rough position: the map is searched there, and what was known of the odometry is forgotten."""
        frame = message.header.frame_id.lstrip("/")
        if frame != self.value("map_frame"):
            self.get_logger().warning(f"/initialpose in the frame {frame!r} is ignored; it must be {self.value('map_frame')!r}")
            return
        try:
            map_from_base = transform_of(message.pose.pose)
        except veiloc.InputError as error:
            self.get_logger().warning(f"/initialpose is ignored: {error}")
            return
        variances = [message.pose.covariance[0], message.pose.covariance[7]]
        sd = math.sqrt(max(0.25, *(v for v in variances if math.isfinite(v))))
        with self.wake:
            now = self.odometry.transforms[-1] if len(self.odometry) else None
            self.localizer.rough = Rough(map_from_base, sd, now)
            self.localizer.alignment.reset()
            self.wanted = True
            self.wake.notify_all()

    def _localize(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Asks about the next image, and waits for the answer."""
        with self.wake:
            before, self.wanted = self.asked_by_service, True
            self.wake.notify()
            done = self.wake.wait_for(lambda: self.asked_by_service != before or self.stopping, timeout=30.0)
            last = self.last
        if not done or last is None:
            response.success, response.message = False, "no image came: " + self._problems()
            return response
        response.success, response.message = last.state == "trusted", f"{last.state}: {last.text}" if last.text else last.state
        return response

    # The work.

    def _work(self) -> None:
        while True:
            with self.wake:
                self.wake.wait_for(lambda: self.stopping or self._is_ready())
                if self.stopping:
                    return
                frames = [(camera, camera.newest) for camera in self.cameras]
                for camera in self.cameras:
                    camera.newest = None
                forced, self.wanted = self.wanted, False
                stamp = max(stamp_of(message.header) for _, message in frames)
                odometry = Trajectory(zip(self.odometry.stamps, self.odometry.transforms))
            self._add_tf_odometry(odometry, [stamp_of(message.header) for _, message in frames])
            base = odometry.at(stamp)
            if not forced and not self.pace.is_due(stamp, base, self.localizer.alignment.state):
                continue
            self.pace.asked(stamp, base)
            outcome = self._ask(frames, odometry, stamp)
            if not self.context.ok():  # The node was stopped meanwhile.
                return
            with self.wake:
                self.last = outcome
                self.counts[outcome.state] = self.counts.get(outcome.state, 0) + 1
                self.asked_by_service += 1
                if outcome.state == "trusted":
                    self.trusted_stamp = outcome.stamp
                self.wake.notify_all()
            self._publish_pose(outcome)

    def _is_ready(self) -> bool:
        """Whether there is a new image of each camera, and odometry that reaches it."""
        if any(camera.newest is None or camera.intrinsics is None for camera in self.cameras):
            return False
        if not self.value("odometry_topic"):
            return True
        newest = max(stamp_of(camera.newest.header) for camera in self.cameras)
        return bool(self.odometry.stamps) and self.odometry.stamps[-1] >= newest

    def _add_tf_odometry(self, odometry: Trajectory, stamps: list[int]) -> None:
        if self.value("odometry_topic") or self.buffer is None:
            return
        for stamp in stamps:
            known = self._lookup(self.value("odom_frame"), self.value("base_frame"), stamp)
            if known is not None:
                odometry.add(stamp, known)

    def _lookup(self, target: str, source: str, stamp: int) -> Any:
        """`target_from_source` by tf; waits a quarter of a second for it."""
        try:
            timeout = rclpy.duration.Duration(seconds=0.25)
            found = self.buffer.lookup_transform(target, source, Time(nanoseconds=stamp), timeout)
            return transform_of(found.transform)
        except Exception:  # Types of tf2's exceptions differ between releases.
            return None

    def _ask(self, taken: list[tuple[Camera, Any]], odometry: Trajectory, stamp: int) -> Outcome:
        frames = []
        for camera, message in taken:
            mounted = camera.base_from_cam
            if mounted is None:
                mounted = self._lookup(self.value("base_frame"), message.header.frame_id, stamp_of(message.header))
            if mounted is None:
                text = f"tf does not connect {self.value('base_frame')!r} and the camera {message.header.frame_id!r}"
                return Outcome(stamp, "unusable-image", text=text)
            try:
                frames.append(Frame(stamp_of(message.header), image_of(message), camera.intrinsics, mounted))
            except veiloc.ImageError as error:
                return Outcome(stamp, "unusable-image", text=f"{camera.topic}: {error}")
        now = odometry.at(stamp)
        if now is not None:
            self.localizer.alignment.moved(pose(inverse(now)))
        try:
            return self.localizer.ask(frames, odometry)
        except Exception as error:  # The thread must not end; the operator sees it in the diagnostics.
            self.get_logger().error(f"{type(error).__name__}: {error}")
            return Outcome(stamp, "failed", text=str(error))

    # What goes out.

    def _publish_pose(self, outcome: Outcome) -> None:
        if outcome.map_from_base is None or (self.value("trusted_only") and outcome.state != "trusted"):
            return
        if outcome.covariance is None or not np.isfinite(outcome.covariance).all():
            return
        message = PoseWithCovarianceStamped()
        message.header.stamp = Time(nanoseconds=outcome.stamp).to_msg()
        message.header.frame_id = self.value("map_frame")
        p, q = message.pose.pose.position, message.pose.pose.orientation
        p.x, p.y, p.z = (float(c) for c in outcome.map_from_base[:3, 3])
        q.x, q.y, q.z, q.w = (float(c) for c in pose(outcome.map_from_base).xyzw)
        message.pose.covariance = [float(c) for c in outcome.covariance.ravel()]
        self.pose_publisher.publish(message)

    def _publish_transform(self) -> None:
        map_from_odom = self.localizer.map_from_odom
        if map_from_odom is None:
            return
        message = TransformStamped()
        message.header.stamp = Time(nanoseconds=self._newest() + int(1e9 * self.value("transform_tolerance"))).to_msg()
        message.header.frame_id, message.child_frame_id = self.value("map_frame"), self.value("odom_frame")
        t, q = message.transform.translation, message.transform.rotation
        t.x, t.y, t.z = (float(c) for c in map_from_odom[:3, 3])
        q.x, q.y, q.z, q.w = (float(c) for c in pose(map_from_odom).xyzw)
        self.transform_publisher.publish(message)
        if self.broadcaster is not None:
            self.broadcaster.sendTransform(message)

    def _newest(self) -> int:
        """The time of the odometry, or without its topic that of the clock, nanoseconds."""
        with self.lock:
            return self.odometry.stamps[-1] if len(self.odometry) else self.get_clock().now().nanoseconds

    def _lag(self) -> float:
        """How far the odometry is behind the images, seconds."""
        with self.lock:
            waiting = [stamp_of(camera.newest.header) for camera in self.cameras if camera.newest is not None]
            return 1e-9 * (max(waiting) - self.odometry.stamps[-1]) if waiting and self.odometry.stamps else 0.0

    def _problems(self) -> str:
        texts = [f"{camera.topic}: {camera.problem or 'no image yet'}" for camera in self.cameras if camera.problem or self.last is None]
        if self.value("odometry_topic") and not len(self.odometry):
            texts.append(f"{self.value('odometry_topic')}: no odometry yet")
        return "; ".join(texts) or "nothing new"

    def _publish_diagnostics(self) -> None:
        alignment, last, age = self.localizer.alignment, self.last, 0.0
        if self.trusted_stamp is not None:
            age = 1e-9 * (self._newest() - self.trusted_stamp)
        status = DiagnosticStatus(name=f"{self.get_name()}: position in the map", hardware_id=self.value("server") or self.value("map_file"))
        if last is None:
            status.level, status.message = DiagnosticStatus.STALE, self._problems()
        elif self._lag() > 2.0:
            status.level, status.message = DiagnosticStatus.ERROR, f"the odometry is {self._lag():.1f} s behind the images; compare their clocks"
        elif last.state in ("failed", "no-service", "no-odometry", "unusable-image"):
            status.level, status.message = DiagnosticStatus.ERROR, f"{last.state}: {last.text}"
        elif alignment.state == "aligned" and age > 3 * self.value("max_age"):
            status.level, status.message = DiagnosticStatus.WARN, f"no trusted answer for {age:.0f} s: the odometry alone says where the robot is"
        elif alignment.state == "aligned" and last.update in ("used", "doubtful-agrees"):
            status.level, status.message = DiagnosticStatus.OK, "in the map"
        else:
            status.level = DiagnosticStatus.WARN
            status.message = f"{alignment.state}; last answer {last.state}{': ' + last.text if last.text else ''}"
        values: dict[str, Any] = {"alignment": alignment.state, "answers used": alignment.used, "answers that contradict": alignment.contradicting}
        values |= {f"answers {state}": count for state, count in sorted(self.counts.items())}
        if last is not None:
            values |= {"state": last.state, "doubts": last.text, "update": last.update, "bytes sent": last.sealed_bytes}
            values |= {"processor time to seal (ms)": round(last.seal_ms, 1), "wait for the answer (ms)": round(last.wait_ms, 1)}
            if last.answer is not None:
                values |= {"position ± (map units)": last.answer.position_sd, "inliers": last.answer.inliers, "matches": last.answer.matches}
        if self.trusted_stamp is not None:
            values["age of the last trusted answer (s)"] = round(age, 1)
        status.values = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
        message = DiagnosticArray(status=[status])
        message.header.stamp = self.get_clock().now().to_msg()
        self.diagnostics.publish(message)

    def destroy_node(self) -> None:
        with self.wake:
            self.stopping = True
            self.wake.notify_all()
        if self.worker is not None:
            self.worker.join(timeout=5.0)
        super().destroy_node()


def main(arguments: list[str] | None = None) -> int:
    """Runs the node until it is stopped."""
    rclpy.init(args=arguments)
    try:
        node = LocalizerNode()
    except (veiloc.Error, OSError) as error:
        rclpy.logging.get_logger("localizer").fatal(str(error))
        rclpy.try_shutdown()
        return 1
    executor = MultiThreadedExecutor(num_threads=4)
    executor.add_node(node)
    try:
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
