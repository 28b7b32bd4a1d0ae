"""The node runs for real: a bag is played to it, and what it publishes is compared with the true poses.

    pytest bindings/ros2/tests        # needs rclpy (a ROS 2 installation, or the wheels of `.ci/run robots`) and veiloc[ros]

Where tf2 is not installed, a stub of it stands in for the one test of that path.
"""

import contextlib
import sys
import threading
import time
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped
from nav_msgs.msg import Odometry
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CameraInfo, CompressedImage
from std_srvs.srv import Trigger

import veiloc
from veiloc import ros
from veiloc.ros.geometry import inverse
from veiloc.ros.replay import errors, squared_distance
from veiloc.ros.walk import BASE_FROM_CAM, write_walk

sys.path.insert(0, str(Path(__file__).parents[1]))
from veiloc_ros import localizer as module  # noqa: E402

TYPES = {"/camera/image_raw/compressed": CompressedImage, "/camera/camera_info": CameraInfo, "/odom": Odometry}


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    """A map of a rendered room, and a bag of a walk in it with odometry that drifts."""
    folder = tmp_path_factory.mktemp("room")
    mapped, queries = veiloc.render_room(folder, mapped=30, queries=9)
    veiloc.Map.build(mapped, folder, down=[0, 0, -1], metres=True, self_test=False).save(folder / "room.vmap")
    write_walk(queries, folder, folder / "walk", rate=1.0, down=[0, 0, -1])
    return folder


@pytest.fixture
def context():
    rclpy.init()
    yield
    rclpy.try_shutdown()


class Robot(Node):
    """Plays a bag, and collects what the localizer says."""

    def __init__(self):
        super().__init__("robot")
        reliable = QoSProfile(depth=100)
        self.publishers_by_topic = {topic: self.create_publisher(kind, topic, reliable) for topic, kind in TYPES.items()}
        self.initial = self.create_publisher(PoseWithCovarianceStamped, "/initialpose", reliable)
        self.poses, self.transforms, self.statuses = [], [], []
        self.create_subscription(PoseWithCovarianceStamped, "/localizer/pose", self.poses.append, reliable)
        self.create_subscription(TransformStamped, "/localizer/map_to_odom", self.transforms.append, reliable)
        self.create_subscription(DiagnosticArray, "/diagnostics", lambda m: self.statuses.append(m.status[0]), reliable)
        self.localize = self.create_client(Trigger, "/localizer/localize")

    def play(self, bag, until, expected):
        """Plays a bag, image by image; `expected(k)` is waited for after image `k`."""
        images = 0
        for connection, _, data in bag.reader.messages():
            if connection.topic not in TYPES:
                continue
            message = deserialize_message(data, TYPES[connection.topic])
            self.publishers_by_topic[connection.topic].publish(message)
            if connection.topic == "/camera/image_raw/compressed":
                images += 1
                if images == until:
                    return
                wait(lambda: expected(images))
            else:
                time.sleep(0.002)


def wait(condition, seconds=60.0):
    """Waits for what must come; the time is only for a test that fails."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not come"
        time.sleep(0.01)


def spin(executor):
    """Spins until the test ends."""
    with contextlib.suppress(ExternalShutdownException):
        executor.spin()


class Running:
    """A localizer and a robot, each in an executor of its own."""

    def __init__(self, **parameters):
        self.node = module.LocalizerNode(parameter_overrides=[Parameter(name, value=value) for name, value in parameters.items()])
        self.robot = Robot()
        self.executors = [MultiThreadedExecutor(num_threads=4), SingleThreadedExecutor()]
        for executor, node in zip(self.executors, (self.node, self.robot)):
            executor.add_node(node)
            threading.Thread(target=spin, args=(executor,), daemon=True).start()
        topics = [publisher for topic, publisher in self.robot.publishers_by_topic.items() if topic != "/odom" or parameters.get("odometry_topic", topic)]
        wait(lambda: all(publisher.get_subscription_count() for publisher in topics))

    def __enter__(self):
        return self

    def __exit__(self, *_):
        for executor in self.executors:
            executor.shutdown()
        self.node.destroy_node()
        self.robot.destroy_node()


MOUNTED = [0.1, 0.0, 0.3, -0.5, 0.5, -0.5, 0.5]


def transform_of(message):
    return ros.transform_of(message.pose.pose if hasattr(message, "pose") else message.transform)


def test_a_walk_is_localized(context, room):
    with ros.Bag(room / "walk") as bag, Running(map_file=str(room / "room.vmap"), base_from_camera=MOUNTED, rate=100.0) as running:
        robot, truth, node = running.robot, bag.poses("/ground_truth"), running.node
        wait(lambda: robot.statuses)
        assert "no CameraInfo yet" in robot.statuses[-1].message and not robot.transforms
        robot.play(bag, until=None, expected=lambda images: sum(node.counts.values()) >= images)
        wait(lambda: len(robot.poses) == node.counts["trusted"])
        assert node.counts["trusted"] >= 7, node.counts
        squared = []
        for message in robot.poses:
            stamp = ros.stamp_of(message.header)
            assert message.header.frame_id == "map"
            metres, degrees = errors(transform_of(message), truth.at(stamp))
            assert metres < 0.1 and degrees < 2
            covariance = np.array(message.pose.covariance).reshape(6, 6)
            found = ros.Outcome(stamp, "trusted", map_from_base=transform_of(message), covariance=covariance)
            squared.append(squared_distance(found, truth.at(stamp)))
        # The order of the covariance, its frame and its size: a wrong one is off by orders of magnitude.
        assert np.median(squared) < 16.8, squared
        # map → odom places the odometry of the last image where the robot is.
        wait(lambda: robot.transforms)
        last = robot.transforms[-1]
        assert (last.header.frame_id, last.child_frame_id) == ("map", "odom")
        stamp = truth.stamps[-1]
        metres, degrees = errors(transform_of(last) @ bag.odom_from_base(stamp), truth.at(stamp))
        assert metres < 0.1 and degrees < 2
        assert ros.stamp_of(last.header) >= stamp, "dated to the odometry, and into the future"
        wait(lambda: robot.statuses[-1].level == b"\x00")
        values = {value.key: value.value for value in robot.statuses[-1].values}
        assert values["alignment"] == "aligned" and int(values["bytes sent"]) > 1000


def test_initialpose_and_localize(context, room):
    with ros.Bag(room / "walk") as bag, Running(map_file=str(room / "room.vmap"), base_from_camera=MOUNTED, rate=0.001) as running:
        robot, truth, node = running.robot, bag.poses("/ground_truth"), running.node
        robot.play(bag, until=2, expected=lambda images: sum(node.counts.values()) >= 1)
        assert sum(node.counts.values()) == 1, "once in a thousand seconds"
        initial = PoseWithCovarianceStamped()
        initial.header.frame_id = "elsewhere"
        robot.initial.publish(initial)
        initial.header.frame_id = "map"
        x, y, z = truth.transforms[1][:3, 3]
        initial.pose.pose.position.x, initial.pose.pose.position.y, initial.pose.pose.position.z = x, y, z
        initial.pose.covariance[0] = initial.pose.covariance[7] = 1.0
        robot.initial.publish(initial)
        # It asks again at once, with the next image.
        wait(lambda: node.localizer.rough is not None or sum(node.counts.values()) > 1)
        before = sum(node.counts.values())
        robot.play(bag, until=None, expected=lambda images: images < 9 or sum(node.counts.values()) > before)
        assert node.localizer.rough is None, "the map was found"
        assert node.localizer.alignment.state != "searching"
        request = robot.localize.call_async(Trigger.Request())
        robot.play(bag, until=None, expected=lambda images: True)
        wait(request.done)
        assert request.result().success and request.result().message.startswith("trusted")


def test_a_late_answer_is_placed_at_its_image(context, room):
    """The answer of a service comes when the robot is elsewhere: `map → odom` is as if it had come at once."""
    with ros.Bag(room / "walk") as bag, Running(map_file=str(room / "room.vmap"), base_from_camera=MOUNTED, rate=100.0) as running:
        robot, node, truth = running.robot, running.node, bag.poses("/ground_truth")
        server, gate = node.localizer.server, threading.Event()

        class Late:
            def localize(self, query, near):
                answer = server.localize(query, near)
                gate.wait(60)
                return answer

        node.localizer.server = Late()
        # All images and the odometry of the whole walk, before the first answer.
        robot.play(bag, until=None, expected=lambda images: True)
        wait(lambda: node.odometry.stamps and node.odometry.stamps[-1] >= truth.stamps[-1] and node.last is None)
        gate.set()
        wait(lambda: robot.poses)
        first = robot.poses[0]
        stamp = ros.stamp_of(first.header)
        assert stamp < truth.stamps[-1] - 10**9, "seconds ago"
        metres, degrees = errors(transform_of(first), truth.at(stamp))
        assert metres < 0.1 and degrees < 2
        moved = np.linalg.norm(truth.at(stamp)[:3, 3] - truth.transforms[-1][:3, 3])
        assert moved > 0.3


def test_wrong_answers_and_doubtful_ones_do_not_move_the_robot(context, room):
    with ros.Bag(room / "walk") as bag, Running(map_file=str(room / "room.vmap"), base_from_camera=MOUNTED, rate=100.0) as running:
        robot, node, truth = running.robot, running.node, bag.poses("/ground_truth")
        server, asked = node.localizer.server, []
        queries = []

        class Lying:
            """Every fourth answer is that of another image."""

            def localize(self, query, near):
                queries.append(query)
                asked.append(len(queries) % 4 == 0)
                return server.localize(queries[0] if asked[-1] else query, near)

        node.localizer.server = Lying()
        robot.play(bag, until=None, expected=lambda images: sum(node.counts.values()) >= images)
        assert sum(asked) == 2
        wait(lambda: robot.transforms and node.localizer.alignment.contradicting >= 1)
        stamp = truth.stamps[-1]
        metres, degrees = errors(node.localizer.map_from_odom @ bag.odom_from_base(stamp), truth.at(stamp))
        assert metres < 0.1 and degrees < 2


class StubTf(ModuleType):
    """What the node uses of tf2_ros, on a bag's tree of frames. A ROS installation has the real one."""

    def __init__(self, tree):
        super().__init__("tf2_ros")
        sent = self.sent = []

        class Buffer:
            def lookup_transform(self, target, source, stamp, timeout):
                found = tree.lookup(target, source, stamp.nanoseconds)
                if found is None:
                    raise LookupError(f"{target} from {source}")
                message = TransformStamped()
                t, q = message.transform.translation, message.transform.rotation
                t.x, t.y, t.z = (float(c) for c in found[:3, 3])
                q.x, q.y, q.z, q.w = (float(c) for c in ros.pose(found).xyzw)
                return message

        class TransformBroadcaster:
            def __init__(self, node):
                pass

            def sendTransform(self, message):  # noqa: N802
                sent.append(message)

        self.Buffer, self.TransformListener, self.TransformBroadcaster = Buffer, lambda buffer, node: None, TransformBroadcaster


def test_tf_gives_odometry_and_cameras(context, room, monkeypatch):
    with ros.Bag(room / "walk") as bag:
        stub = StubTf(bag.transforms)
        monkeypatch.setattr(module, "tf2_ros", stub)
        with Running(map_file=str(room / "room.vmap"), odometry_topic="", rate=100.0) as running:
            robot, node, truth = running.robot, running.node, bag.poses("/ground_truth")
            robot.play(bag, until=None, expected=lambda images: sum(node.counts.values()) >= images)
            assert node.counts["trusted"] >= 7, node.counts
            wait(lambda: stub.sent)
            stamp = truth.stamps[-1]
            metres, degrees = errors(transform_of(stub.sent[-1]) @ bag.odom_from_base(stamp), truth.at(stamp))
            assert metres < 0.1 and degrees < 2 and stub.sent[-1].child_frame_id == "odom"
        monkeypatch.setattr(module, "tf2_ros", StubTf(ros.Transforms()))
        with Running(map_file=str(room / "room.vmap"), rate=100.0) as running:
            running.robot.play(bag, until=None, expected=lambda images: sum(running.node.counts.values()) >= images)
            assert set(running.node.counts) == {"unusable-image"} and "tf does not connect" in running.node.last.text


@pytest.mark.parametrize(
    ("parameters", "part"),
    [
        ({}, "map_file, or server"),
        ({"map_file": "a.vmap", "server": "https://b"}, "map_file, or server"),
        ({"map_file": "none.vmap"}, "none.vmap"),
        ({"server": "https://127.0.0.1:9"}, "name of a map"),
        ({"image_topics": [""]}, "names no topic"),
        ({"base_from_camera": [1.0, 2.0]}, "2 numbers"),
        ({"base_from_camera": [0.0] * 7}, "is not a rotation"),
        ({"odometry_topic": "", "base_from_camera": MOUNTED}, "odometry_topic"),
        ({"drift": -1.0}, "standard deviation"),
    ],
)
def test_parameters_that_cannot_work_stop_the_node(context, room, parameters, part, monkeypatch):
    monkeypatch.setattr(module, "tf2_ros", None)
    if set(parameters) & {"image_topics", "base_from_camera", "drift"}:
        parameters = {"map_file": str(room / "room.vmap"), **parameters}
    with pytest.raises((veiloc.Error, OSError), match=part):
        module.LocalizerNode(parameter_overrides=[Parameter(name, value=value) for name, value in parameters.items()])


def test_every_parameter_is_described(context, room):
    node = module.LocalizerNode(parameter_overrides=[Parameter("map_file", value=str(room / "room.vmap")), Parameter("base_from_camera", value=MOUNTED)])
    assert all(node.describe_parameter(name).description for name in module.PARAMETERS)
    np.testing.assert_allclose(node.cameras[0].base_from_cam, BASE_FROM_CAM)
    np.testing.assert_allclose(inverse(BASE_FROM_CAM) @ BASE_FROM_CAM, np.eye(4), atol=1e-15)
    node.destroy_node()
