"""Robust pose estimation against PoseLib, pycolmap and OpenCV, from points and from lines; arguments and options."""

import multiprocessing

import numpy as np
import pytest

import veiloc
from conftest import CAMERA, Problem, near


@pytest.mark.parametrize("seed", range(5))
def test_points_match_poselib(seed):
    poselib = pytest.importorskip("poselib")
    p = Problem(seed)
    pose, info = veiloc.estimate_absolute_pose(p.points2d, p.points3d, p.camera)
    theirs, their_info = poselib.estimate_absolute_pose(
        p.points2d, p.points3d, p.camera, {"max_reproj_error": 4.0}, {}
    )
    # Both have errors that half a pixel of noise causes.
    assert max(pose.error(veiloc.CameraPose(q=theirs.q, t=theirs.t))) < 0.05
    assert max(p.pose.error(pose)) < 0.05
    assert set(their_info) - {"inliers"} <= set(info) | {"inliers"}, "PoseLib's names"
    assert np.mean(np.asarray(their_info["inliers"]) == info["inliers"]) > 0.95
    assert info["inliers"].dtype == bool and info["inliers"].sum() == info["num_inliers"]


@pytest.mark.parametrize("seed", range(3))
def test_points_match_pycolmap(seed):
    pycolmap = pytest.importorskip("pycolmap")
    p = Problem(seed)
    camera = pycolmap.Camera(model="PINHOLE", width=640, height=480, params=p.camera["params"])
    theirs = pycolmap.estimate_and_refine_absolute_pose(p.points2d, p.points3d, camera)
    pose, _ = veiloc.estimate_absolute_pose(p.points2d, p.points3d, camera)
    rigid = theirs["cam_from_world"]
    R, t = rigid.rotation.matrix(), rigid.translation
    assert max(pose.error(veiloc.CameraPose(R=R, t=t))) < 0.05


@pytest.mark.parametrize("seed", range(3))
def test_points_match_opencv(seed):
    cv2 = pytest.importorskip("cv2")
    camera = {
        "model": "OPENCV",
        "width": 640,
        "height": 480,
        "params": [525.0, 530.0, 318.0, 243.0, -0.1, 0.02, 0.001, -0.0005],
    }
    p = Problem(seed)
    # The same points through a distorted lens; OpenCV's pixels are shifted by half a pixel.
    rotation, _ = cv2.Rodrigues(p.R)
    distortion = np.array(camera["params"][4:])
    pixels, _ = cv2.projectPoints(p.points3d, rotation, p.t, p.K, distortion)
    pixels = pixels.reshape(-1, 2)
    ok, r, t, _ = cv2.solvePnPRansac(p.points3d, pixels, p.K, distortion)
    assert ok
    theirs = veiloc.CameraPose(R=cv2.Rodrigues(r)[0], t=t.ravel())
    pose, _ = veiloc.estimate_absolute_pose(pixels, p.points3d, camera)
    assert max(pose.error(theirs)) < 0.02
    flat = cv2.undistortPoints(pixels[:, None], p.K, distortion, P=p.K).reshape(-1, 2)
    assert np.abs(veiloc.undistort(pixels, camera) - flat).max() < 0.05
    # A part of the image, as OpenCV's cameras take it: the principal point moves.
    part = veiloc.cropped_camera(camera, 100, 40, 400, 300)
    moved = p.K - [[0, 0, 100], [0, 0, 40], [0, 0, 0]]
    inside = cv2.undistortPoints(pixels[:, None] - [100, 40], moved, distortion, P=moved).reshape(-1, 2)
    assert np.abs(veiloc.undistort(pixels - [100, 40], part) - inside).max() < 0.05
    with pytest.raises(veiloc.InputError, match="not within the image of 640 x 480"):
        veiloc.cropped_camera(camera, 300, 0, 400, 300)


@pytest.mark.parametrize("seed", range(5))
def test_lines_and_anchored_lines_find_the_pose(seed):
    p = Problem(seed, count=300)
    pose, info = veiloc.estimate_absolute_pose_lines(p.lines2d, p.points3d, p.camera)
    assert max(p.pose.error(pose)) < 0.2
    assert info["state"] == "trusted"
    anchors, angles = veiloc.anchored_lines(p.points2d, p.camera)
    assert set(anchors) == {0, 1}
    pose, info = veiloc.estimate_absolute_pose_anchored(anchors, angles, p.points3d, p.camera)
    assert max(p.pose.error(pose)) < 0.3
    assert info["covariance"].shape == (6, 6)


@pytest.mark.parametrize("layout", ["dcl", "dcl:horizontal", "dcl:angle=30", "dcl:s=2"])
def test_obfuscated_keypoints_give_the_pose(layout):
    camera = {**CAMERA, "params": [525.0, 525.0, 320.0, 240.0]}
    p = Problem(2, count=300, camera=camera)
    sent = veiloc.obfuscate(p.points2d, 640, 480, layout)
    assert sent["kind"] == "anchored"
    pose, _ = veiloc.estimate_absolute_pose_anchored(
        sent["anchors"], sent["angles"], p.points3d, camera, layout=layout, layout_focal=sent["layout_focal"]
    )
    assert near(pose, p.pose, 0.3, 0.03)
    for scheme, repeat in [("random-lines", 1), ("coordinate-permutation", 2)]:
        sent = veiloc.obfuscate(p.points2d, 640, 480, scheme)
        keypoints = np.repeat(np.arange(len(p.points2d)), repeat)
        pose, _ = veiloc.estimate_absolute_pose_lines(
            sent["lines"].reshape(-1, 3), p.points3d[keypoints], camera, keypoints=keypoints
        )
        assert near(pose, p.pose, 0.3, 0.03)


def test_lines_of_one_anchor_leave_a_free_direction():
    p = Problem(1)
    anchors, angles = veiloc.anchored_lines(p.points2d, p.camera)
    of = anchors == 1
    lines = anchors[of], angles[of]
    _, info = veiloc.estimate_absolute_pose_anchored(*lines, p.points3d[of], p.camera)
    assert info["state"] == "doubtful" and "one anchor" in info["doubts"][0].text
    assert np.isinf(info["covariance"][3, 3]) and np.linalg.norm(info["free_direction"]) == pytest.approx(1)


def test_equal_seeds_give_equal_poses_for_all_array_layouts(problem):
    p = problem
    pose, _ = veiloc.estimate_absolute_pose(p.points2d, p.points3d, p.camera)
    for points2d, points3d in [
        (p.points2d.tolist(), p.points3d.tolist()),
        (np.asfortranarray(p.points2d), np.ascontiguousarray(p.points3d[::-1])[::-1]),
    ]:
        again, _ = veiloc.estimate_absolute_pose(points2d, points3d, "PINHOLE,640,480,525,530,318,243")
        assert again == pose
    other, _ = veiloc.estimate_absolute_pose(p.points2d, p.points3d, p.camera, {"seed": 5})
    assert max(other.error(pose)) < 0.01


def test_poselib_option_names_and_unknown_options(problem):
    p = problem
    call = lambda **options: veiloc.estimate_absolute_pose(p.points2d, p.points3d, p.camera, options)
    _, info = call(min_iterations=50, max_iterations=50, success_prob=0.99, seed=1)
    assert info["iterations"] == 50
    _, info = call(score="msac", max_reproj_error=4.0)
    assert info["num_inliers"] > 100
    for options, words in [
        ({"max_reproj_error": 4.0}, "noise_px"),
        ({"score": "msac", "noise_px": 1.0}, "max_reproj_error"),
        ({"progressive_sampling": True}, "prior="),
        ({"max_iteration": 5}, "max_iterations"),
        ({"success_prob": 2.0}, "confidence"),
        ({"max_iterations": "many"}, "max_iterations: many is not a valid value"),
        ({"score": "best"}, "likelihood"),
    ]:
        with pytest.raises(veiloc.InputError, match=words):
            call(**options)
    with pytest.raises(veiloc.InputError, match="loss_type"):
        veiloc.estimate_absolute_pose(p.points2d, p.points3d, p.camera, {}, {"loss_type": "HUBER"})


@pytest.mark.parametrize(
    "camera, words",
    [
        ({**CAMERA, "params": [1.0, 2.0]}, "takes 4 parameters"),
        ({**CAMERA, "model": "SPHERICAL"}, "not supported"),
        ({**CAMERA, "focal": 3}, "focal"),
        ({"model": "PINHOLE"}, "width"),
        ({**CAMERA, "width": -1}, "width"),
        (17, "model"),
        ("PINHOLE,640", "does not read as"),
    ],
)
def test_invalid_cameras_are_refused(problem, camera, words):
    with pytest.raises(veiloc.InputError, match=words):
        veiloc.estimate_absolute_pose(problem.points2d, problem.points3d, camera)


def test_camera_text_has_commas_or_spaces(problem):
    fields = [CAMERA["model"], CAMERA["width"], CAMERA["height"], *CAMERA["params"]]
    poses = [
        veiloc.estimate_absolute_pose(problem.points2d, problem.points3d, camera)[0]
        for camera in (CAMERA, ",".join(map(str, fields)), " ".join(map(str, fields)))
    ]
    assert poses[0] == poses[1] == poses[2]


def test_invalid_arrays_are_refused(problem):
    p = problem
    call = veiloc.estimate_absolute_pose
    holes = p.points2d.copy()
    holes[3, 1] = np.nan
    for points2d, points3d, words in [
        (p.points2d[:2], p.points3d[:2], "3"),
        (p.points2d[:5], p.points3d, "points"),
        (p.points2d, p.points2d, r"points3d: must be an array \[N, 3\] of numbers, not \[200, 2\]"),
        (holes, p.points3d, "point 3 is not finite"),
        (p.points2d + 1j, p.points3d, "not complex"),
        ("pixels", p.points3d, "points2d"),
        (np.zeros((0, 2)), np.zeros((0, 3)), "3"),
        (p.points2d, np.full((200, 3), np.inf), "point"),
    ]:
        with pytest.raises(veiloc.InputError, match=words):
            call(points2d, points3d, p.camera)
    with pytest.raises(veiloc.InputError, match="lines2d: line 0"):
        veiloc.estimate_absolute_pose_lines(np.zeros((10, 3)), np.zeros((10, 3)), p.camera)
    with pytest.raises(veiloc.InputError, match="anchors: 7"):
        veiloc.estimate_absolute_pose_anchored([7] * 10, [0.5] * 10, np.zeros((10, 3)), p.camera)


def test_random_matches_are_not_localized():
    rng = np.random.default_rng(0)
    pixels, points = rng.uniform(0, 480, (60, 2)), rng.normal(size=(60, 3))
    with pytest.raises(veiloc.NotLocalizedError):
        veiloc.estimate_absolute_pose(pixels, points, CAMERA)


def test_optional_inputs(problem):
    p = problem
    gravity = (p.R @ [0, 0, -1.0], [0, 0, -1.0])
    center = p.pose.center
    pose, _ = veiloc.estimate_absolute_pose_lines(
        p.lines2d,
        p.points3d,
        p.camera,
        gravity=gravity,
        position=(*center, 0.5),
        prior=np.where(p.inliers, 0.9, 0.1),
        keypoints=np.arange(len(p.points2d)),
        focal="exif",
    )
    assert max(p.pose.error(pose)) < 0.3
    for wrong in [{"gravity": (1, 2)}, {"position": (0, 0, 0)}, {"prior": [2.0] * 200}, {"focal": "guess"}]:
        with pytest.raises(veiloc.InputError):
            veiloc.estimate_absolute_pose_lines(p.lines2d, p.points3d, p.camera, **wrong)


def test_camera_pose_follows_poselib():
    q, t = np.array([0.9, 0.1, -0.2, 0.3]), [1.0, 2.0, 3.0]
    pose = veiloc.CameraPose(2 * q, t)
    assert np.allclose(pose.q, q / np.linalg.norm(q)) and np.allclose(pose.t, t)
    assert np.allclose(pose.R @ pose.R.T, np.eye(3)) and np.allclose(pose.Rt, np.column_stack([pose.R, pose.t]))
    assert np.allclose(pose.center, -pose.R.T @ pose.t)
    assert max(veiloc.CameraPose(R=pose.R, t=t).error(pose)) < 1e-9
    poselib = pytest.importorskip("poselib")
    theirs = poselib.CameraPose()
    theirs.q, theirs.t = pose.q, pose.t
    assert np.allclose(theirs.R, pose.R) and np.allclose(theirs.Rt, pose.Rt)
    for wrong in [{"q": [0, 0, 0, 0]}, {"R": np.zeros((3, 3))}, {"q": [1, 0, 0, 0], "R": np.eye(3)}, {"q": [1, 2]}]:
        with pytest.raises(veiloc.InputError):
            veiloc.CameraPose(**wrong)


def pose_of(seed):
    p = Problem(seed)
    return veiloc.estimate_absolute_pose(p.points2d, p.points3d, p.camera)[0]


def test_estimation_in_a_forked_process():
    """A forked child does not have its parent's threads, so its calls must not wait for one of them."""
    expected = [np.concatenate([p.q, p.t]) for p in map(pose_of, range(4))]
    with multiprocessing.get_context("fork").Pool(2) as pool:
        found = pool.map_async(numbers_of_pose, range(4)).get(timeout=60)
    assert (np.array(found) == expected).all()


def numbers_of_pose(seed):
    pose = pose_of(seed)
    return np.concatenate([pose.q, pose.t])
