"""`veiloc.Client` and the program's own service, on this machine: what Python asks is answered as the map in memory answers."""

import re
import signal
import socket
import subprocess
import sys
import threading
from collections import deque

import numpy as np
import pytest

import veiloc
from conftest import near


class Service:
    """`veiloc serve` on a free port, until it is stopped."""

    def __init__(self, path, folder, place, *options):
        place.save(folder / "room.vmap")
        words = ["serve", "--map", f"room={folder / 'room.vmap'}", "--listen", "127.0.0.1:0", *options]
        words += ["--admin-listen", "127.0.0.1:0"]
        # Whoever runs the tests in the background ignores SIGINT, and so would a child.
        heed = lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)
        self.process = subprocess.Popen([path, *words], stderr=subprocess.PIPE, text=True, preexec_fn=heed)
        self.said = deque(maxlen=50)
        self.address = next(filter(None, map(self.heard, self.process.stderr)), None)
        assert self.address, "".join(self.said)
        # Its log is read on, or it would wait for a reader.
        threading.Thread(target=self.said.extend, args=(self.process.stderr,), daemon=True).start()

    def heard(self, line):
        self.said.append(line)
        found = re.search(r"serving \S+ on (http://\S+)", line)
        return found and found.group(1)

    def stop(self):
        self.process.send_signal(signal.SIGINT)
        return self.process.wait(60)


@pytest.fixture(scope="module")
def service(rendered, program_path, tmp_path_factory):
    """The rendered room, served to who has a token, and that token."""
    folder = tmp_path_factory.mktemp("service")
    made = subprocess.run(
        [program_path, "token", "new", "phone", "--tokens", folder / "tokens"], capture_output=True, text=True, check=True
    )
    service = Service(program_path, folder, rendered.map, "--tokens", str(folder / "tokens"), "--drain-delay", "0")
    service.token = made.stdout.strip()
    yield service
    assert service.stop() == 0, "".join(service.said)


def assert_same(answer, ours):
    """The same search with the same end: a pose that travels is written as a quaternion, which rounds the last digits."""
    for told, here in [(answer.pose.q, ours.pose.q), (answer.pose.t, ours.pose.t), (answer.covariance, ours.covariance)]:
        np.testing.assert_allclose(told, here, rtol=1e-9, atol=1e-12)
    assert answer.position_sd == pytest.approx(ours.position_sd, rel=1e-9)
    counts = lambda answer: (answer.state, answer.inliers, answer.matches, answer.iterations)
    assert counts(answer) == counts(ours)


@pytest.fixture
def client(service):
    return veiloc.Client(service.address, service.token)


def test_answers_are_those_of_the_map_in_memory(rendered, client):
    profile = client.profile("room")
    assert profile == rendered.map.profile
    found = 0
    for query in rendered.queries:
        sealed = veiloc.seal(rendered.images / query, rendered.camera, profile)
        answer, ours = client.localize("room", sealed), rendered.map.localize(sealed)
        assert_same(answer, ours)
        found += near(answer.pose, rendered.pose(query))
    assert found >= len(rendered.queries) - 1


def test_steps_send_no_more_than_a_trusted_pose_takes(rendered, client):
    profile = client.profile("room")
    sealed = veiloc.seal(rendered.images / rendered.queries[0], rendered.camera, profile)
    answer, steps = client.localize_progressive("room", sealed, profile)
    assert answer.trusted and near(answer.pose, rendered.pose(rendered.queries[0]))
    rows = [step["rows"] for step in steps]
    assert rows == sorted(set(rows)) and rows[0] == 256
    assert [step["outcome"] for step in steps][-1] == "trusted"
    assert "trusted" not in [step["outcome"] for step in steps][:-1]
    assert all(0 < step["bytes"] <= len(sealed) for step in steps)
    # More exact than it gets: everything is sent.
    _, all_steps = client.localize_progressive("room", sealed, profile, position_sd=1e-9)
    assert all_steps[-1]["rows"] == veiloc.describe_query(sealed)["rows"] > rows[-1]
    with pytest.raises(veiloc.InputError, match="position_sd"):
        client.localize_progressive("room", sealed, profile, position_sd=0)


def test_frames_of_a_session_are_asked_together(rendered, client):
    profile, session = client.profile("room"), veiloc.Session()
    frames = []
    for query in rendered.queries[:2]:
        pose = rendered.pose(query)
        sealed = session.seal(rendered.images / query, rendered.camera, profile, orientation=pose.q)
        assert near(client.localize("room", sealed).pose, pose), "one frame by itself"
        frames.append((sealed, pose))
    answer = client.localize_rig("room", frames)
    # Each camera stands in the rig's frame, the world's own, where it truly stands.
    assert near(answer.pose, veiloc.CameraPose())
    assert_same(answer, rendered.map.localize_rig(frames))
    with pytest.raises(veiloc.InputError, match="frames"):
        client.localize_rig("room", [(b"", 1)])


def test_what_is_said_beside_a_query(rendered, client):
    query = rendered.queries[0]
    sealed = veiloc.seal(rendered.images / query, rendered.camera, client.profile("room"))
    truth = rendered.pose(query)
    answer = client.localize("room", sealed, near=[*truth.center, 0.5], trusted_only=True)
    assert answer.trusted and near(answer.pose, truth)
    with pytest.raises(veiloc.Error, match="deviation|standard|above 0"):
        client.localize("room", sealed, near=[0, 0, 0, -1])


def test_refusals_have_names(rendered, service, client, tmp_path_factory):
    sealed = veiloc.seal(rendered.images / rendered.queries[0], rendered.camera, client.profile("room"))
    with pytest.raises(veiloc.RefusedError) as refused:
        client.localize("hall", sealed)
    assert (refused.value.status, refused.value.name) == (404, "unknown-map")
    for token in [None, "guess"]:
        with pytest.raises(veiloc.RefusedError) as refused:
            veiloc.Client(service.address, token).profile("room")
        assert refused.value.status == 401
    other = rendered.map.remove(rendered.map.image_names[:2], retrain=True, self_test=False)
    of_other = veiloc.seal(rendered.images / rendered.queries[0], rendered.camera, other.profile)
    with pytest.raises(veiloc.WrongProfileError):
        client.localize("room", of_other)
    # Another room: nothing in it is in the map.
    folder = tmp_path_factory.mktemp("elsewhere")
    _, ((name, camera, _),) = veiloc.render_place(folder, mapped=0, queries=1, seed=77)
    elsewhere = veiloc.seal(folder / name, camera, client.profile("room"))
    with pytest.raises(veiloc.NotLocalizedError):
        client.localize("room", elsewhere)
    with pytest.raises(veiloc.QueryError):
        client.localize("room", b"no query")


def test_a_busy_service_says_when_to_ask_again(rendered, service, program_path, tmp_path):
    slow = Service(program_path, tmp_path, rendered.map, "--rate", "1", "--burst", "1", "--drain-delay", "0")
    try:
        hasty = veiloc.Client(slow.address, retries=0)
        with pytest.raises(veiloc.BusyError) as busy:
            for _ in range(20):
                hasty.profile("room")
        assert busy.value.retry_after is not None and busy.value.retry_after <= 60
        # Who waits as asked is answered.
        assert veiloc.Client(slow.address, retries=4).profile("room") == rendered.map.profile
    finally:
        assert slow.stop() == 0


def test_profiles_are_kept_and_asked_for_again(rendered, service, tmp_path):
    for _ in range(2):
        keeping = veiloc.Client(service.address, service.token, cache=tmp_path / "kept")
        assert keeping.profile("room") == rendered.map.profile
    assert any((tmp_path / "kept").rglob("*")), "nothing was kept"


WAITING = """
import sys, veiloc
print("begun", flush=True)
try:
    veiloc.Client(sys.argv[1], retries=0).profile("room")
except KeyboardInterrupt:
    print("stopped", flush=True)
"""


def test_ctrl_c_ends_a_request_that_nobody_answers():
    with socket.create_server(("127.0.0.1", 0)) as deaf:
        heed = lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)
        words = [sys.executable, "-c", WAITING, "http://127.0.0.1:%d" % deaf.getsockname()[1]]
        child = subprocess.Popen(words, stdout=subprocess.PIPE, text=True, preexec_fn=heed)
        assert child.stdout.readline() == "begun\n"
        connection, _ = deaf.accept()
        with connection:
            assert connection.recv(4) == b"GET ", "it asks, and waits"
            child.send_signal(signal.SIGINT)
            out, _ = child.communicate(timeout=30)
    assert out == "stopped\n"
