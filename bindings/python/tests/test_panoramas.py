"""A place of panoramas alone: pycolmap computes their poses as rigs, and a panorama is localized in the map."""

import json

import numpy as np
import pytest

import veiloc

WIDTH = 1536


def similarity(a, b):
    """Scale, rotation and translation of points `a`, `[N, 3]`, to points `b` (Umeyama, PAMI 1991)."""
    mean_a, mean_b = a.mean(0), b.mean(0)
    u, s, vt = np.linalg.svd((b - mean_b).T @ (a - mean_a))
    signs = np.diag([1, 1, np.linalg.det(u @ vt)])
    R = u @ signs @ vt
    scale = np.trace(np.diag(s) @ signs) / ((a - mean_a) ** 2).sum()
    return scale, R, mean_b - scale * R @ mean_a


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    pytest.importorskip("pycolmap")
    folder = tmp_path_factory.mktemp("panoramas")
    mapped, queries = veiloc.render_room(folder, mapped=7, queries=2, panorama_width=WIDTH)
    names = [name for name, _, _ in mapped]
    built = veiloc.Map.from_images(folder, folder / "work", names=names, panoramas=True)
    return folder, built, mapped, queries


def test_panoramas_become_rigs_with_exact_relative_poses(place):
    _, built, mapped, _ = place
    poses = built.poses
    centers = {}
    for name, pose in poses.items():
        folder, face, image = name.split("/")
        assert folder == f"panoramas-{WIDTH}" and face in {"front", "right", "back", "left", "up"}
        centers.setdefault(image.removesuffix(".jpg"), {})[face] = pose
    assert len(centers) == len(mapped)
    found = np.array([centers[name]["front"].center for name, _, _ in mapped])
    truth = np.array([pose.center for _, _, pose in mapped])
    scale, R, t = similarity(found, truth)
    assert np.linalg.norm(scale * found @ R.T + t - truth, axis=1).max() < 0.01, "metres"
    for name, _, pose in mapped:
        faces = centers[name]
        rotation = faces["front"].R @ R.T @ pose.R.T
        assert np.degrees(np.arccos((np.trace(rotation) - 1) / 2)) < 0.2
        relative = faces["right"].R @ faces["front"].R.T
        assert np.allclose(relative, [[0, 0, -1], [0, 1, 0], [1, 0, 0]], atol=1e-6)
        assert np.ptp([face.center for face in faces.values()], axis=0).max() < 1e-6 * scale


def test_a_panorama_is_localized_in_a_map_of_panoramas(place, program):
    folder, built, mapped, queries = place
    built.save(folder / "place.vmap")
    program("map", "profile", folder / "place.vmap", "-o", folder / "place.profile")
    names = [f"panoramas-{WIDTH}/front/{name}.jpg" for name, _, _ in mapped]
    poses = built.poses
    found = np.array([poses[name].center for name in names])
    scale, R, t = similarity(found, np.array([pose.center for _, _, pose in mapped]))
    for name, _, truth in queries:
        sealed = folder / "sealed"
        program("seal", folder / name, "--panorama", "--profile", folder / "place.profile", "-o", sealed)
        rig = sealed / name.removesuffix(".png") / "rig.json"
        answer = json.loads(program("localize", "--map", folder / "place.vmap", "--rig", rig, "--json"))
        assert answer["state"] == "trusted"
        pose = veiloc.CameraPose(q=answer["cam_from_world"]["q"], t=answer["cam_from_world"]["t"])
        assert np.linalg.norm(scale * R @ pose.center + t - truth.center) < 0.02, "metres"
