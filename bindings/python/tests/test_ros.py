"""`veiloc.ros`: messages, covariances, bags, and a robot that is localized from a bag."""

import json
import subprocess
import sys
from types import SimpleNamespace as Message

import numpy as np
import pytest

import veiloc
from conftest import rotation
from veiloc import ros
from veiloc.ros import messages
from veiloc.ros.geometry import Transforms, angle_deg, inverse, matrix, pose, ros_covariance
from veiloc.ros.replay import replay_bag, server_of, summary
from veiloc.ros.walk import BASE_FROM_CAM, write_walk

cv2 = pytest.importorskip("cv2")
pytest.importorskip("rosbags")


def transform(rng, reach=3.0):
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = rotation(rng), rng.uniform(-reach, reach, 3)
    return result


def info(k=(500.0, 510.0, 319.5, 239.5), d=(0.0,) * 5, model="plumb_bob", width=640, height=480, p=None, **more):
    fx, fy, cx, cy = k
    roi = Message(x_offset=0, y_offset=0, width=0, height=0) if "roi" not in more else more["roi"]
    p = p or [fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1, 0]
    return Message(k=[fx, 0, cx, 0, fy, cy, 0, 0, 1], d=list(d), p=p, distortion_model=model, width=width, height=height, roi=roi,
                   binning_x=more.get("binning", 0), binning_y=more.get("binning", 0))  # fmt: skip


@pytest.mark.parametrize(
    ("model", "d", "name"),
    [
        ("plumb_bob", (0.0,) * 5, "PINHOLE"),
        ("plumb_bob", (-0.2, 0.05, 0.001, -0.002, 0.0), "OPENCV"),
        ("plumb_bob", (-0.2, 0.05, 0.001, -0.002, 0.01), "FULL_OPENCV"),
        ("rational_polynomial", (0.1, -0.05, 0.001, -0.002, 0.01, 0.12, -0.04, 0.008), "FULL_OPENCV"),
        ("equidistant", (-0.02, 0.01, -0.003, 0.0004), "OPENCV_FISHEYE"),
    ],
)
def test_cameras_are_those_of_opencv(model, d, name):
    message = info(d=d, model=model)
    camera = ros.camera_of(message)
    assert camera["model"] == name
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform(-0.5, 0.5, (50, 2)), np.ones(50)])
    k = np.array(message.k).reshape(3, 3)
    project = cv2.fisheye.projectPoints if model == "equidistant" else cv2.projectPoints
    if model == "equidistant":
        pixels = project(points.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), k, np.array(d))[0].reshape(-1, 2)
    else:
        pixels = project(points, np.zeros(3), np.zeros(3), k, np.array(d))[0].reshape(-1, 2)
    fx, fy, cx, cy = camera["params"][:4]
    straight = veiloc.undistort(pixels + 0.5, camera)  # OpenCV's pixels count from the centre of the first.
    np.testing.assert_allclose((straight - [cx, cy]) / [fx, fy], points[:, :2], atol=1e-6)


def test_binning_regions_and_rectified_images_change_the_camera():
    # A point at the same ray, in the pixels of the binned region.
    x, y = 0.2, -0.1
    camera = ros.camera_of(info(roi=Message(x_offset=100, y_offset=60, width=400, height=300), binning=2))
    u, v = 500.0 * x + 319.5 + 0.5, 510.0 * y + 239.5 + 0.5
    fx, fy, cx, cy = camera["params"]
    assert (camera["width"], camera["height"]) == (200, 150)
    np.testing.assert_allclose([fx * x + cx, fy * y + cy], [(u - 100) / 2, (v - 60) / 2])
    p = [400.0, 0, 300.0, 0, 0, 400.0, 200.0, 0, 0, 0, 1, 0]
    rectified = ros.camera_of(info(d=(-0.2, 0.05, 0.0, 0.0, 0.0), p=p), rectified=True)
    assert rectified["model"] == "PINHOLE" and rectified["params"] == [400.0, 400.0, 300.5, 200.5]
    assert messages.is_rectified("/front/image_rect_color") and not messages.is_rectified("/rectory/image_raw/compressed")
    assert messages.info_topic("/a/image_raw/compressed") == "/a/camera_info" == messages.info_topic("/a/image_raw")


def test_cameras_that_are_not_known_are_refused():
    for message, part in [
        (info(k=(0.0, 0.0, 0.0, 0.0)), "not calibrated"),
        (info(d=(0.1,) * 14, model="thin_prism"), "thin_prism"),
        (info(d=(0.1, 0.1, 0.0), model="plumb_bob"), "3 numbers"),
        (info(d=(np.nan,) * 5), "not finite"),
    ]:
        with pytest.raises(veiloc.InputError, match=part):
            ros.camera_of(message)


def image(encoding, data, width=4, height=3, step=None, big=0):
    data = np.asarray(data, np.uint8).ravel()
    return Message(encoding=encoding, data=data, width=width, height=height, step=step or len(data) // height, is_bigendian=big)


def test_encodings_of_images():
    gray = np.arange(12, dtype=np.uint8).reshape(3, 4) * 20
    colour = np.stack([gray, gray + 1, gray + 2], axis=2)
    padded = np.pad(gray, ((0, 0), (0, 5)), constant_values=99)
    for message, expected in [
        (image("mono8", gray), gray),
        (image("mono8", padded, step=9), gray),
        (image("rgb8", colour), colour),
        (image("bgr8", colour), colour[:, :, ::-1]),
        (image("bgra8", np.dstack([colour, gray])), colour[:, :, ::-1]),
        (image("uyvy", np.stack([gray * 0 + 7, gray], axis=2)), gray),
        (image("yuyv", np.stack([gray, gray * 0 + 7], axis=2)), gray),
        (image("nv12", np.concatenate([gray.ravel(), [9] * 4]), step=4), gray),
        (image("mono16", (gray.astype(np.uint16) << 4).astype(">u2").view(np.uint8), step=8, big=1), gray),
    ]:
        np.testing.assert_array_equal(ros.image_of(message), expected, err_msg=message.encoding)
    for message, part in [
        (image("bayer_rggb8", gray), "debayer"),
        (image("32FC1", gray), "32FC1"),
        (image("mono8", gray, height=300, step=4), "too few"),
        (image("rgb8", gray, step=4), "too few"),
        (Message(format="jpeg", data=np.zeros(20, np.uint8)), "decoded"),
        (Message(format="16UC1; compressedDepth", data=b"xx"), "depth"),
    ]:
        with pytest.raises(veiloc.ImageError, match=part):
            ros.image_of(message)


def test_covariance_in_the_order_of_ros_agrees_with_finite_differences():
    rng = np.random.default_rng(3)
    for _ in range(20):
        cam_from_map, cam_from_base = transform(rng), transform(rng, 0.5)

        def base(step):
            turn = cv2.Rodrigues(step[:3])[0]
            moved = np.eye(4)
            moved[:3, :3], moved[:3, 3] = turn @ cam_from_map[:3, :3], turn @ cam_from_map[:3, 3] + step[3:]
            return inverse(moved) @ cam_from_base

        h, jacobian, here = 1e-6, np.zeros((6, 6)), inverse(cam_from_map) @ cam_from_base
        for k in range(6):
            there = base(h * np.eye(6)[k])
            # REP 103: rotation about the fixed axes of the map, after the position.
            jacobian[:3, k] = (there[:3, 3] - here[:3, 3]) / h
            turn = there[:3, :3] @ here[:3, :3].T
            jacobian[3:, k] = np.array([turn[2, 1], turn[0, 2], turn[1, 0]]) / h
        root = rng.normal(size=(6, 6))
        covariance = root @ root.T
        ours = ros_covariance(covariance, cam_from_map, cam_from_base)
        np.testing.assert_allclose(ours, jacobian @ covariance @ jacobian.T, rtol=1e-4, atol=1e-4)


def test_poses_and_their_inverse():
    rng = np.random.default_rng(4)
    made = transform(rng)
    as_pose = pose(made)
    np.testing.assert_allclose(as_pose.matrix, made, atol=1e-12)
    np.testing.assert_allclose(as_pose.inverse().matrix, np.linalg.inv(made), atol=1e-12)
    np.testing.assert_allclose(as_pose.inverse().t, as_pose.center, atol=1e-12)
    np.testing.assert_array_equal(np.roll(as_pose.xyzw, 1), as_pose.q)
    np.testing.assert_allclose(matrix(as_pose.t, -3 * as_pose.xyzw), made, atol=1e-12)


def test_trajectories_are_interpolated_and_forget():
    quarter = matrix([1, 0, 0], [0, 0, np.sin(np.pi / 4), np.cos(np.pi / 4)])
    known = ros.Trajectory([(10**9, quarter), (0, np.eye(4))], max_gap=1.0, keep=3.0)
    middle = known.at(5 * 10**8)
    assert angle_deg(middle) == pytest.approx(45) and middle[0, 3] == pytest.approx(0.5)
    assert known.at(10**9 + 5 * 10**7) is not None, "within a tenth of the gap"
    assert known.at(2 * 10**9) is None and ros.Trajectory().at(0) is None
    known.add(4 * 10**9, quarter)
    assert known.stamps == [10**9, 4 * 10**9], "older than three seconds"
    known.add(10**8, quarter)
    assert known.stamps == [10**8], "the bag begins again"


def test_tf_follows_a_chain_and_its_absence():
    rng = np.random.default_rng(5)
    a, b, c = (transform(rng) for _ in range(3))
    tree = Transforms()
    tree.add("odom", "base_link", 7, a)
    tree.add("base_link", "mast", None, b)
    tree.add("/mast", "/camera", None, c)
    np.testing.assert_allclose(tree.lookup("odom", "camera", 7), a @ b @ c)
    np.testing.assert_allclose(tree.lookup("camera", "base_link", 7), inverse(b @ c), atol=1e-12)
    assert tree.lookup("odom", "camera", 10**10) is None and tree.lookup("map", "camera", 7) is None
    tree.add("camera", "odom", None, a)  # A loop, as no tf has it, ends.
    assert tree.lookup("map", "camera", 7) is None


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    """Two bags of a walk through a rendered room: one with the images of the map, one with further images, and odometry that drifts."""
    folder = tmp_path_factory.mktemp("room")
    mapped, queries = veiloc.render_room(folder, mapped=30, queries=9)
    write_walk(mapped, folder, folder / "mapped", storage="sqlite3", drift=0.0, drift_deg=0.0, down=[0, 0, -1])
    write_walk(queries, folder, folder / "walk", rate=1.0, down=[0, 0, -1])
    return folder


def run(*words, code=0):
    done = subprocess.run([sys.executable, "-m", "veiloc.ros", *map(str, words)], capture_output=True, text=True)
    assert done.returncode == code, done.stderr
    return done.stdout if code == 0 else done.stderr


@pytest.fixture(scope="module")
def place(room):
    """A map of the first bag."""
    lines = run("frames", room / "mapped", "--odometry", "/ground_truth", "--out", room / "frames", "--json").splitlines()
    found = json.loads(lines[-1])
    assert found == {"images": 30, "of": 30, "remarks": [], "down": [0, 0, -1], "metres": True}
    assert json.loads(lines[0]) == {"stage": "images of the bag", "total": 30} and json.loads(lines[-2]) == {"done": 30}
    built = veiloc.Map.build(room / "frames/posed", room / "frames/images", down=[0, 0, -1], metres=True, self_test=False)
    built.save(room / "room.vmap")
    return room / "room.vmap"


def test_a_robot_is_localized_from_a_bag(room, place):
    document = json.loads(run("replay", room / "walk", "--map", place, "--truth", "/ground_truth", "--out", room / "walk.tum", "--mcap",
                              room / "found", "--json"))  # fmt: skip
    assert document["asked"] == 9 and document["trusted"] >= 7
    assert document["wrong corrections (robot off by more than 25 cm or 2°)"] == 0
    assert document["trusted answers off by, median and most (m)"][0] < 0.02
    assert document["trusted answers in their 99 % region (%)"] >= 75
    # What was written can be read: as a trajectory, and as a bag whose tf leads from the map to the robot.
    lines = (room / "walk.tum").read_text().splitlines()
    assert lines[0].startswith("#") and all(len(line.split()) == 8 for line in lines[1:]) and len(lines) >= 8
    from rosbags.highlevel import AnyReader

    with AnyReader([room / "found"]) as bag:
        found = [bag.deserialize(data, c.msgtype) for c, _, data in bag.messages() if c.topic == "/veiloc/pose"]
    assert len(found) == document["trusted"] and all(message.header.frame_id == "map" for message in found)
    covariance = found[0].pose.covariance.reshape(6, 6)
    np.testing.assert_allclose(covariance, covariance.T, rtol=1e-9, atol=1e-15)
    assert (np.linalg.eigvalsh(covariance) > 0).all()


def test_a_rig_of_two_bag_topics_and_late_answers(room, place):
    """The same image twice as two cameras is a rig; an answer after a second is placed at the stamp of its image."""
    with ros.Bag(room / "walk") as bag:
        server, profile = server_of(place)
        late = replay_bag(bag, server, veiloc.Sealer(profile), truth="/ground_truth", latency=1.0)
        early = replay_bag(bag, server, veiloc.Sealer(profile), truth="/ground_truth", latency=0.0)
        for replayed in (early, late):
            assert summary(replayed)["wrong corrections (robot off by more than 25 cm or 2°)"] == 0
        known = lambda replayed: sum(transform is not None for _, transform in replayed.corrected)
        assert known(late) == known(early) - 1, "one image later"
        pictures = list(bag.pictures())[:2]
        frames = [
            ros.Frame(p.stamp, ros.image_of(p.message), bag.cameras[p.topic], bag.extrinsics(p)) for p in pictures
        ]
        odometry = bag.trajectory([p.stamp for p in pictures])
        outcome = ros.Localizer(server, veiloc.Sealer(profile)).ask(frames, odometry)
        assert outcome.state == "trusted" and outcome.update == "used"
        truth = bag.poses("/ground_truth").at(pictures[1].stamp)
        assert np.linalg.norm(outcome.map_from_base[:3, 3] - truth[:3, 3]) < 0.05


def test_only_trusted_answers_move_the_robot(room, place):
    opened = veiloc.Map.open(place)
    with ros.Bag(room / "walk") as bag:
        picture = next(bag.pictures())
        frame = ros.Frame(picture.stamp, ros.image_of(picture.message), bag.cameras[picture.topic], BASE_FROM_CAM)
        localizer = ros.Localizer(ros.MapServer(opened), veiloc.Sealer(opened.profile))
        gray = ros.Frame(picture.stamp, np.full((300, 400), 128, np.uint8), frame.camera, BASE_FROM_CAM)
        assert localizer.ask([gray], bag.odometry).state == "unusable-image"
        noise = np.random.default_rng(0).integers(0, 255, (300, 400), np.uint8)
        outcome = localizer.ask([ros.Frame(picture.stamp, noise, frame.camera, BASE_FROM_CAM)], bag.odometry)
        assert outcome.state != "trusted" and localizer.map_from_odom is None
        assert localizer.ask([frame], ros.Trajectory()).state == "no-odometry"
        assert localizer.ask([frame], bag.odometry).update == "used" and localizer.map_from_odom is not None


def test_a_rough_position_moves_with_the_odometry():
    rough = ros.Rough(matrix([1, 2, 0], [0, 0, 0, 1]), 0.5, matrix([5, 0, 0], [0, 0, 0, 1]))
    assert rough.near(matrix([6, 0, 0], [0, 0, 0, 1]), 2.0) == [1.0, 1.0, 0.0, 0.25]
    assert rough.near(None, 1.0) == [1.0, 2.0, 0.0, 0.5]


def test_pace():
    pace = ros.Pace(rate=2.0, min_translation=0.5, min_rotation_deg=10.0, max_age=5.0)
    at = lambda x, deg=0.0: matrix([x, 0, 0], [0, 0, np.sin(np.radians(deg) / 2), np.cos(np.radians(deg) / 2)])
    assert pace.is_due(0, at(0), "aligned")
    pace.asked(0, at(0))
    second = 10**9
    assert not pace.is_due(second // 4, at(3), "searching"), "twice a second at most"
    assert pace.is_due(second // 2, at(0), "searching") and pace.is_due(second // 2, at(0), "tentative")
    assert not pace.is_due(second, at(0.4, 9), "aligned")
    assert pace.is_due(second, at(0.6), "aligned") and pace.is_due(second, at(0, 11), "aligned")
    assert pace.is_due(5 * second, at(0), "aligned") and pace.is_due(-second, at(0), "aligned")


def test_alignment_ignores_what_is_wrong(rendered):
    sealer = veiloc.Sealer(rendered.map.profile)
    name = rendered.queries[0]
    answer = rendered.map.localize(sealer.seal(sealer.extract(rendered.images / name, rendered.camera)))
    assert answer.trusted
    odom = rendered.pose(name)
    unit = veiloc.Alignment()
    assert unit.add(answer, odom) == "unknown-unit" and unit.odom_from_map is None and unit.covariance is None
    alignment = veiloc.Alignment(metres_per_unit=1.0)
    assert alignment.state == "searching"
    assert [alignment.add(answer, odom) for _ in range(2)] == ["used", "used"] and alignment.state == "aligned"
    degrees, metres = alignment.odom_from_map.error(veiloc.CameraPose())
    assert degrees < 1 and metres < 0.05
    far = veiloc.CameraPose(q=odom.q, t=odom.t + [3.0, 0, 0])
    assert alignment.add(answer, far) == "contradicts" and alignment.contradicting == 1
    assert alignment.cam_from_map(odom).error(rendered.pose(name))[1] < 0.05
    assert alignment.covariance.shape == (6, 6)
    alignment.reset()
    assert alignment.state == "searching" and alignment.used == 0
    for wrong in ({"drift": -1.0}, {"metres_per_unit": 0.0}, {"position_floor": float("nan")}):
        with pytest.raises(veiloc.InputError):
            veiloc.Alignment(**wrong)


def test_bags_that_cannot_be_used_say_why(room, tmp_path):
    data = (room / "walk" / "walk.mcap").read_bytes()
    (tmp_path / "text.mcap").write_text("no bag")
    (tmp_path / "empty.db3").write_bytes(b"")
    (tmp_path / "short.mcap").write_bytes(data[: len(data) // 2])
    for path, part in [
        (tmp_path / "text.mcap", "not a bag"),
        (tmp_path / "empty.db3", "not a bag"),
        (tmp_path / "none.mcap", "not a bag"),
        (tmp_path, "not a bag"),
        (tmp_path / "short.mcap", "not a bag, or damaged"),
    ]:
        error = run("frames", path, "--out", tmp_path / "out", code=1)
        assert error.startswith("error: ") and part in error and "Traceback" not in error, error
    for options, part in [
        (["--topic", "/other"], "topics of images: /camera/image_raw/compressed"),
        (["--odometry", "/imu"], "topics: /ground_truth, /odom; frames of tf: base_link, camera_optical, odom"),
    ]:
        assert part in run("frames", room / "walk", "--out", tmp_path / "out", *options, code=1)
    assert "give --map FILE" in run("replay", room / "walk", code=1)
    assert "no poses under '/no'" in run("replay", room / "walk", "--map", room / "room.vmap", "--truth", "/no", code=1)


def test_odd_messages_are_left_out_and_counted(room, tmp_path):
    """A pose that is no rotation, an image that is none, and one of another size."""
    from rosbags.highlevel import AnyReader
    from rosbags.rosbag2 import StoragePlugin, Writer

    with AnyReader([room / "walk"]) as source, Writer(tmp_path / "odd", version=8, storage_plugin=StoragePlugin.MCAP) as writer:
        store, connections, seen = source.typestore, {}, 0
        for connection, stamp, data in source.messages():
            if connection.topic not in connections:
                connections[connection.topic] = writer.add_connection(connection.topic, connection.msgtype, typestore=store)
            message = source.deserialize(data, connection.msgtype)
            if connection.topic == "/odom" and seen == 1:
                message.pose.pose.orientation.w = float("nan")
            if connection.topic == "/camera/image_raw/compressed":
                seen += 1
                if seen == 2:
                    message.data = np.zeros(100, np.uint8)
                if seen == 3:
                    message.data = np.frombuffer(cv2.imencode(".png", np.zeros((20, 30), np.uint8))[1].tobytes(), np.uint8)
            writer.write(connections[connection.topic], stamp, store.serialize_cdr(message, connection.msgtype))
    with ros.Bag(tmp_path / "odd") as bag:
        found = ros.write_frames(bag, tmp_path / "frames", min_translation=0.0, min_rotation_deg=0.0)
    assert found["images"] == 7 and found["of"] == 9
    assert [text.split(":")[0] for text in found["remarks"]][-2:] == ["1 images are left out"] * 2
    assert "30 × 20 pixels, and their camera 400 × 300" in " ".join(found["remarks"])
    assert any("poses of /odom are no rotation" in text for text in found["remarks"])


def test_bags_without_a_camera_on_the_robot_are_refused(room, tmp_path):
    with ros.Bag(room / "walk", base="cart", odometry="/ground_truth") as bag, pytest.raises(veiloc.Error, match="--base-from-camera"):
        ros.write_frames(bag, tmp_path / "frames")
    with ros.Bag(room / "walk", base_from_cam=BASE_FROM_CAM) as bag:
        assert ros.write_frames(bag, tmp_path / "frames")["images"] == 9
    with ros.Bag(room / "walk", odometry="odom") as bag:
        assert ros.write_frames(bag, tmp_path / "by-tf")["images"] == 9
