"""Distributed builds: the map is byte-identical to the map that one process builds."""

import os
import pickle
import signal
import threading
import time
from pathlib import Path

import pytest
import ray

import veiloc
import veiloc.ray


@pytest.fixture(scope="module")
def cluster():
    ray.init(num_cpus=2, log_to_driver=False, include_dashboard=False)
    yield
    ray.shutdown()


def write_model(room, folder):
    """Writes the room's cameras and poses as a COLMAP text model, which the tasks read."""
    folder.mkdir(parents=True)
    cameras, images = [], []
    for number, (name, camera, pose) in enumerate(room.mapped, 1):
        cameras.append(f"{number} {camera.replace(',', ' ')}\n")
        numbers = " ".join(repr(float(x)) for x in [*pose.q, *pose.t])
        images.append(f"{number} {numbers} {number} {name}\n\n")
    (folder / "cameras.txt").write_text("".join(cameras))
    (folder / "images.txt").write_text("".join(images))
    (folder / "points3D.txt").write_text("")
    return folder


@pytest.fixture(scope="module")
def reference(rendered, tmp_path_factory):
    """The model, the image folder, and the bytes of the map that one process builds."""
    folder = tmp_path_factory.mktemp("reference")
    posed = write_model(rendered, folder / "posed")
    built = veiloc.Map.build(posed, rendered.images)
    built.save(folder / "reference.vmap")
    return posed, rendered.images, (folder / "reference.vmap").read_bytes()


def test_ray_build_is_byte_identical_to_local_build(cluster, reference, tmp_path):
    posed, images, expected = reference
    reports = []
    built = veiloc.ray.build_map(
        posed,
        images,
        tmp_path / "many.vmap",
        work=tmp_path / "work",
        shares=5,
        progress=lambda *step: reports.append(step),
    )
    assert (tmp_path / "many.vmap").read_bytes() == expected
    assert list(built.seconds) == ["features", "first-pairs", "pairs", "build", "self-test", "write"]
    for stage in ("features", "first-pairs", "pairs", "self-test"):
        assert (stage, 5, 5) in reports
    assert built.map.tested is not None
    assert not (tmp_path / "work" / "untested.vmap").exists()


def processes_of_ray(name):
    """Processes that run a task with this name, which Ray writes into the process title."""
    found = []
    for process in Path("/proc").iterdir():
        if process.name.isdigit():
            try:
                title = (process / "cmdline").read_bytes().decode(errors="replace")
            except OSError:
                continue
            if title.startswith("ray::") and name in title:
                found.append(int(process.name))
    return found


def test_killed_tasks_are_retried(cluster, reference, tmp_path):
    posed, images, expected = reference
    killed = []
    over = threading.Event()

    def kill():
        while len(killed) < 2 and not over.is_set():
            for process in processes_of_ray("_prepare"):
                # Stopped first: Ray aborts the driver when it learns of the death before it has read an answer of the process.
                os.kill(process, signal.SIGSTOP)
                time.sleep(0.3)
                os.kill(process, signal.SIGKILL)
                killed.append(process)
            time.sleep(0.005)

    killer = threading.Thread(target=kill)
    killer.start()
    try:
        veiloc.ray.build_map(posed, images, tmp_path / "many.vmap", work=tmp_path / "work", shares=4, retries=5)
    finally:
        over.set()
        killer.join()
    assert len(killed) >= 2
    assert (tmp_path / "many.vmap").read_bytes() == expected


def test_task_errors_are_raised_as_veiloc_errors(cluster, reference, tmp_path):
    posed, images, _ = reference
    names = veiloc.ColmapModel.open(posed).image_names
    with pytest.raises(veiloc.ImageError, match="nowhere.png"):
        veiloc.ray.build_map(
            posed, images, tmp_path / "many.vmap", work=tmp_path / "work", names=[*names, "nowhere.png"]
        )
    assert not (tmp_path / "many.vmap").exists()


def test_prepare_and_self_test_shares_without_ray(reference, tmp_path):
    posed, images, expected = reference
    work = tmp_path / "work"
    for stage in veiloc.ray.STAGES:
        counts = [veiloc.prepare(posed, images, work, stage, (part, 3)) for part in range(3)]
        assert sum(done for done, _ in counts) == counts[0][1] > 0
    built = veiloc.Map.build(posed, images, self_test=False, work=work)
    shares = [pickle.loads(pickle.dumps(built.self_test_share((part, 3)))) for part in range(3)]
    tested = built.with_self_test(shares[::-1])
    tested.save(tmp_path / "shares.vmap")
    assert (tmp_path / "shares.vmap").read_bytes() == expected
    with pytest.raises(veiloc.InputError, match="shares"):
        built.with_self_test(shares[:2])
    with pytest.raises(veiloc.InputError, match="shares"):
        built.with_self_test([*shares, shares[0]])


@pytest.mark.parametrize(("stage", "share", "what"), [("features", (3, 3), "share"), ("walls", (0, 1), "stage")])
def test_invalid_stage_or_share_is_refused(reference, tmp_path, stage, share, what):
    posed, images, _ = reference
    with pytest.raises(veiloc.InputError, match=what):
        veiloc.prepare(posed, images, tmp_path / "work", stage, share)
