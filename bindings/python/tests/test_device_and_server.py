"""Device and server side: poses from Python equal those of the program bit for bit, on a rendered room and on real images."""

import json
import pickle
import threading
from pathlib import Path

import numpy as np
import pytest

import veiloc
from conftest import Problem, near, seal


@pytest.fixture(params=["rendered", "kitchen"])
def scene(request):
    return request.getfixturevalue(request.param)


def test_poses_equal_those_of_the_program(scene, program, tmp_path):
    scene.map.save(tmp_path / "scene.vmap")
    opened = veiloc.Map.open(tmp_path / "scene.vmap")
    sealed, file = {}, lambda query: f"{query.replace('/', '-')}.vquery"
    for query in scene.queries:
        sealed[query] = seal(scene.images / query, scene.camera, opened.profile)
        (tmp_path / file(query)).write_bytes(sealed[query])
    files = sorted(tmp_path.glob("*.vquery"))
    found = program("localize", "--map", tmp_path / "scene.vmap", *files, "--json", codes=(0, 4))
    by_file = {entry["file"].rsplit("/", 1)[-1]: entry for entry in json.loads(found)["queries"]}
    assert len(by_file) == len(scene.queries) >= 3
    found_near = 0
    for query, data in sealed.items():
        answer, theirs = opened.localize(data), by_file[file(query)]
        pose = theirs["cam_from_world"]
        # The pose goes through a matrix, which may change the last digit; the documents below are equal to the bit.
        np.testing.assert_allclose([*answer.pose.q, *answer.pose.t], [*pose["q"], *pose["t"]], rtol=1e-12, atol=1e-14)
        assert answer.position_sd == theirs["position_sd"] and answer.state == theirs["state"]
        assert (answer.covariance == np.array(theirs["covariance"])).all()
        ours = answer.to_dict()
        assert ours == json.loads(answer.to_json())
        del ours["ms"], theirs["ms"], theirs["file"]
        assert ours == theirs, "the same document, field by field"
        assert answer.pose == scene.map.localize(data).pose, "the map in memory is the one in the file"
        found_near += near(answer.pose, scene.pose(query))
    assert found_near >= len(scene.queries) - 1


def test_map_info_of_the_program_matches(rendered, program, tmp_path):
    rendered.map.save(tmp_path / "ours.vmap")
    opened = veiloc.Map.open(tmp_path / "ours.vmap")
    info = json.loads(program("map", "info", tmp_path / "ours.vmap", "--json"))
    assert info["images"] == len(opened) and info["points"] == len(opened.points)
    assert info["profile"] == opened.profile.id and info["down"] == list(opened.down)
    assert info["is_metric"] is opened.is_metric is False
    words = info["main_camera"]["camera"].split(",")
    cameras = list(opened.cameras.values())
    assert info["main_camera"]["images"] == len(cameras) == len(opened), "one camera"
    assert all([c["model"], str(c["width"]), str(c["height"])] == words[:3] for c in cameras)
    assert list(map(float, words[3:])) == list(cameras[0]["params"])


def test_metres_are_known_if_they_are_given(rendered, tmp_path):
    names = rendered.map.image_names[:4]
    metric = veiloc.Map.build(rendered.mapped, rendered.images, names=names, metres=True, self_test=False)
    assert metric.is_metric and metric.remove(names[:1], self_test=False).is_metric
    metric.save(tmp_path / "metric.vmap")
    assert veiloc.Map.open(tmp_path / "metric.vmap").is_metric


def test_map_in_which_nothing_can_be_localized_is_refused(rendered):
    wrong = [(name, camera.replace(",330,", ",495,"), pose) for name, camera, pose in rendered.mapped]
    with pytest.raises(veiloc.MapError, match="nothing can be localized(.|\n)*about 1.5. times the correct one"):
        veiloc.Map.build(wrong, rendered.images)
    broken = veiloc.Map.build(wrong, rendered.images, keep_broken=True)
    assert any("focal length seems to be wrong" in warning for warning in broken.warnings)
    with pytest.raises(veiloc.MapError, match="nothing can be localized"):
        broken.remove(broken.image_names[:1])


def test_map_add_remove_and_svg(rendered):
    model, names = rendered.map, rendered.map.image_names
    assert len(model) == len(names) == len(model.poses) == len(rendered.mapped)
    assert model.poses[names[0]] == rendered.pose(names[0])
    assert model.points.shape[1] == 3 and len(model.points) > 300
    assert model._repr_svg_().startswith("<svg") and 'class="camera map"' in model._repr_svg_()
    smaller = model.remove(names[:2], self_test=False)
    assert len(smaller) == len(names) - 2 and smaller.profile == model.profile
    again = smaller.add(rendered.mapped, rendered.images, names=names[:1], self_test=False)
    assert len(again) == len(names) - 1
    with pytest.raises(veiloc.MapError, match="nowhere.png"):
        model.remove(["nowhere.png"])
    with pytest.raises(veiloc.ImageError, match="skip_bad=True"):
        smaller.add(rendered.mapped, rendered.images, names=["nowhere.png"])
    assert model.tested is None
    tested = model.self_test(images=4, schemes=["dcl"])
    assert tested["dcl"]["images"] == 4 and tested["dcl"]["localized"] >= 2


def test_seal_options_masks_and_schemes(rendered):
    model, camera, image = rendered.map, rendered.camera, rendered.images / rendered.queries[0]
    profile, truth = model.profile, rendered.pose(rendered.queries[0])
    assert veiloc.Profile.from_bytes(bytes(profile)) == profile == pickle.loads(pickle.dumps(profile))
    first, second = (seal(image, camera, profile, max_keypoints=256) for _ in range(2))
    assert first != second, "everything random comes from the system"
    info = veiloc.describe_query(first)
    assert info["scheme"] == "dcl" and info["rows"] == 256 and info["bytes"] == len(first)
    image_module = pytest.importorskip("PIL.Image")
    rgb = np.asarray(image_module.open(image).convert("RGB"))
    for array in [rgb, np.asfortranarray(rgb), rgb.mean(axis=2).astype(np.float32) / 255]:
        answer = model.localize(seal(array, camera, profile))
        assert near(answer.pose, truth)
    with pytest.raises(veiloc.InputError, match="divide"):
        seal(rgb.mean(axis=2).astype(np.float32), camera, profile)
    with pytest.raises(veiloc.Error, match="max_keypoints is 0"):
        seal(image, camera, profile, max_keypoints=0)
    hidden = np.zeros(rgb.shape[:2], bool)
    hidden[:, :120] = True
    other = np.where(hidden[..., None], 255 - rgb, rgb)
    sealer = veiloc.Sealer(profile)
    assert len({len(sealer.extract(image, camera, mask=hidden)) for image in [rgb, other]}) == 1
    keypoints = veiloc.extract(rgb, mask=hidden)["keypoints"]
    assert len(keypoints) and keypoints[:, 0].min() > 120
    assert len(keypoints) < len(veiloc.extract(image)["keypoints"])
    # The network of the tests takes what is red for people.
    network = Path(__file__).parents[3] / "crates/device/features/tests/data/segmenter/red.tflite"
    assert veiloc.people_mask(rgb, network) is veiloc.people_mask(image, str(network)) is None
    red = rgb.copy()
    red[50:100, 60:130] = [250, 10, 20]
    people = veiloc.people_mask(red, network)
    assert people[50:100, 60:130].all() and 70 * 50 <= people.sum() < 2 * 70 * 50
    assert len(sealer.extract(red, camera, mask=people))
    with pytest.raises(veiloc.ImageError, match="selfie_segmentation.tflite"):
        veiloc.people_mask(rgb, image)
    with pytest.raises(veiloc.InputError, match="uint8"):
        veiloc.people_mask(rgb[..., 0], network)
    for scheme in ["random-lines", "coordinate-permutation", "points", "dcl:horizontal"]:
        sealed = seal(rgb, camera, profile, scheme=scheme)
        assert veiloc.describe_query(sealed)["scheme"] == scheme
        assert near(model.localize(sealed).pose, truth)
    down = truth.R @ [0, 0, -1]
    answer = model.localize(seal(image, camera, profile, gravity=[*down, 1.0]))
    assert answer.gravity == "used"
    for send, use in [(True, "used"), (False, None)]:
        sealer = veiloc.Sealer(profile, send_gravity=send)
        extracted = sealer.extract(image, camera, down=down)
        assert len(extracted) > 256
        sealed = sealer.in_session(veiloc.Session()).seal(extracted)
        assert model.localize(sealed).gravity == use
        with pytest.raises(veiloc.InputError, match="sealed already"):
            sealer.seal(extracted)


def test_packs_are_files(rendered, tmp_path):
    pack = rendered.map.pack()
    assert pack.profile == rendered.map.profile and pack.images <= len(rendered.map) and pack.points > 300
    (tmp_path / "room.vpack").write_bytes(bytes(pack))
    others = [veiloc.Pack.open(tmp_path / "room.vpack"), veiloc.Pack.from_bytes(bytes(pack)), pickle.loads(pickle.dumps(pack))]
    assert {pack, *others} == {pack} and pack == rendered.map.pack() and len(pack.id) == 32 and pack.id in repr(pack)
    damaged = bytearray(bytes(pack))
    damaged[len(damaged) // 2] ^= 1
    for data in [b"", b"nothing", bytes(pack)[:-1], bytes(damaged), bytes(rendered.map.profile)]:
        with pytest.raises(veiloc.QueryError):
            veiloc.Pack.from_bytes(data)
    with pytest.raises(veiloc.QueryError, match="none.vpack"):
        veiloc.Pack.open(tmp_path / "none.vpack")


def test_pack_of_the_program_is_that_of_the_map(rendered, program, tmp_path):
    rendered.map.save(tmp_path / "room.vmap")
    program("map", "pack", tmp_path / "room.vmap", "-o", tmp_path / "room.vpack")
    assert (tmp_path / "room.vpack").read_bytes() == bytes(rendered.map.pack())


def test_queries_sealed_with_a_pack_are_localized(scene):
    model, pack, found = scene.map, scene.map.pack(), {"matches": 0, "explained": 0}
    for query in scene.queries:
        image, truth = scene.images / query, scene.pose(query)
        all_descriptors = seal(image, scene.camera, pack.profile)
        assert veiloc.describe_query(all_descriptors)["pack"] is None
        for send, id in [("matches", pack.id), ("explained", None)]:
            sealed = seal(image, scene.camera, pack.profile, pack=pack, send=send)
            assert veiloc.describe_query(sealed)["pack"] == id
            # No descriptor: a fifth of the bytes of each row at most.
            rows = [len(q) / veiloc.describe_query(q)["rows"] for q in (sealed, all_descriptors)]
            assert 5 * rows[0] < rows[1] if id else len(sealed) <= len(all_descriptors)
            answer = model.localize(sealed)
            found[send] += answer.trusted and near(answer.pose, truth)
    assert min(found.values()) >= len(scene.queries) - 1, found


def test_device_refuses_other_packs_and_images(rendered):
    model, camera, image = rendered.map, rendered.camera, rendered.images / rendered.queries[0]
    pack = model.pack()
    assert veiloc.describe_query(seal(image, camera, pack.profile, pack=pack))["pack"] == pack.id, "the default"
    other = model.remove(model.image_names[:2], retrain=True, self_test=False)
    with pytest.raises(veiloc.QueryError, match="another map"):
        veiloc.Sealer(other.profile, pack=pack)
    for options in [{"send": "explained"}, {"send": "matches"}, {"pack": pack, "send": "all"}]:
        with pytest.raises(veiloc.InputError, match="send"):
            veiloc.Sealer(pack.profile, **options)
    # Of a map with other points the server refuses the query.
    smaller = model.remove(model.image_names[:2], self_test=False)
    assert smaller.profile == pack.profile and smaller.pack() != pack
    with pytest.raises(veiloc.WrongProfileError, match="pack"):
        smaller.localize(seal(image, camera, pack.profile, pack=pack))
    # Two squares have fewer keypoints than a place must explain.
    squares = np.full((300, 400), 200, np.uint8)
    squares[140:160, [*range(140, 160), *range(280, 300)]] = 30
    with pytest.raises(veiloc.NotThisPlaceError, match="does not show this place"):
        seal(squares, camera, pack.profile, pack=pack)


def test_session_resumes_from_bytes(rendered):
    session, sealer, frames = veiloc.Session(), veiloc.Sealer(rendered.map.profile), []
    for query in rendered.queries[:2]:
        pose = rendered.pose(query)
        image = rendered.images / query
        extracted = sealer.extract(image, rendered.camera, orientation=pose.q)
        frames.append((sealer.in_session(session).seal(extracted), pose))
        session = veiloc.Session.from_bytes(bytes(session))
    assert session.frames == 2
    # The rig frame is the world frame, so the camera poses on the rig are their true poses.
    answer = rendered.map.localize_rig(frames)
    assert len(answer.frames) == 2
    assert near(answer.pose, veiloc.CameraPose())
    with pytest.raises(veiloc.InputError, match="frames"):
        rendered.map.localize_rig([(b"", 1)])
    with pytest.raises(veiloc.InputError, match="at least one"):
        rendered.map.localize_rig([])
    with pytest.raises(veiloc.Error):
        veiloc.Session.from_bytes(b"nothing")


def test_invalid_inputs_raise_specific_errors(rendered, tmp_path):
    model, camera, image = rendered.map, rendered.camera, rendered.images / rendered.queries[0]
    sealed = seal(image, camera, model.profile)
    for data in [b"nothing", b"", sealed[: len(sealed) // 2], bytes(1000)]:
        with pytest.raises(veiloc.QueryError):
            model.localize(data)
    with pytest.raises(veiloc.QueryError, match="none"):
        veiloc.Profile.open(tmp_path / "none")
    with pytest.raises(veiloc.ImageError, match="none.jpg"):
        seal(tmp_path / "none.jpg", camera, model.profile)
    with pytest.raises(veiloc.ImageError):
        seal(image, "PINHOLE,100,100,90,90,50,50", model.profile)
    with pytest.raises(veiloc.QueryError, match="scheme"):
        seal(image, camera, model.profile, scheme="lines")
    with pytest.raises(veiloc.InputError, match="image"):
        seal(np.zeros((4, 4, 2), np.int16), camera, model.profile)
    with pytest.raises(veiloc.InputError, match='no EXIF; pass camera=, or camera="unknown"'):
        seal(np.zeros((300, 400), np.uint8), None, model.profile)
    with pytest.raises(veiloc.ImageError, match='no EXIF; pass camera=, or camera="unknown"'):
        seal(image, None, model.profile)
    with pytest.raises(veiloc.MapError, match="none.vmap"):
        veiloc.Map.open(tmp_path / "none.vmap")
    other = model.remove(model.image_names[:2], retrain=True, self_test=False)
    with pytest.raises(veiloc.WrongProfileError):
        other.localize(sealed)
    with pytest.raises(veiloc.Error):
        seal(np.full((300, 400), 128, np.uint8), camera, model.profile)


def test_progress_callback_is_called_and_can_cancel(rendered):
    build = lambda progress: veiloc.Map.build(
        rendered.mapped, rendered.images, self_test=False, progress=progress
    )
    reports = []
    build(lambda stage, done, total: reports.append((stage, done, total)))
    assert len({stage for stage, _, _ in reports}) >= 2
    assert all(0 <= done <= total for _, done, total in reports)

    def enough(stage, done, total):
        raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        build(enough)


def test_pose_estimation_releases_the_gil():
    p = Problem(0, count=2000, outliers=0.9)
    count, done = 0, threading.Event()

    def spin():
        nonlocal count
        while not done.is_set():
            count += 1

    thread = threading.Thread(target=spin)
    thread.start()
    try:
        veiloc.estimate_absolute_pose(p.points2d, p.points3d, p.camera, {"fixed_iterations": 5000})
    finally:
        done.set()
        thread.join()
    assert count > 1000


def test_attack_and_audit_reports(rendered):
    image = rendered.images / rendered.queries[0]
    options = {"attacks": ["closed-form"], "max_keypoints": 256, "schemes": ["random-lines", "dcl"]}
    found = veiloc.attack([image], **options)
    rows = {(row["scheme"], row["attack"]): row["median_px"] for row in found["attacks"]}
    assert rows["random-lines", "closed-form"] < rows["dcl", "closed-form"]
    assert "closed-form" in veiloc.attack_names()
    with pytest.raises(veiloc.InputError, match="not an attack"):
        veiloc.attack([image], attacks=["guessing"])
    report = veiloc.audit([image], **options)
    assert report["command"] == "audit" and report["inputs"]["strongest"]
    with pytest.raises(veiloc.ImageError):
        veiloc.attack([rendered.images / "none.png"])
