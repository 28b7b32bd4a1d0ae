"""`veiloc.Client` with the program's service on this machine: answers equal those of the map in memory."""

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
from conftest import near, seal


class Service:
    """`veiloc serve` on a free port."""

    def __init__(self, path, folder, map, *options):
        map.save(folder / "room.vmap")
        words = ["serve", "--map", f"room={folder / 'room.vmap'}", "--listen", "127.0.0.1:0", *options]
        words += ["--admin-listen", "127.0.0.1:0", "--answer-quantum", "0"]
        # A background test run ignores SIGINT, and child processes inherit that.
        reset_sigint = lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)
        self.process = subprocess.Popen([path, *words], stderr=subprocess.PIPE, text=True, preexec_fn=reset_sigint)
        self.log = deque(maxlen=50)
        self.address = next(filter(None, (self.address_in(line) for line in self.process.stderr)), None)
        assert self.address, "".join(self.log)
        # The log must be read further, or the service blocks on a full pipe.
        threading.Thread(target=self.log.extend, args=(self.process.stderr,), daemon=True).start()

    def address_in(self, line):
        self.log.append(line)
        found = re.search(r"serving \S+ on (http://\S+)", line)
        return found and found.group(1)

    def stop(self):
        self.process.send_signal(signal.SIGINT)
        return self.process.wait(60)


@pytest.fixture(scope="module")
def service(rendered, program_path, tmp_path_factory):
    """Serves the rendered room; its attribute `token` is a valid token."""
    folder = tmp_path_factory.mktemp("service")
    created = subprocess.run(
        [program_path, "token", "new", "phone", "--tokens", folder / "tokens"], capture_output=True, text=True, check=True
    )
    service = Service(program_path, folder, rendered.map, "--packs", "--tokens", str(folder / "tokens"), "--drain-delay", "0")
    service.token = created.stdout.strip()
    yield service
    assert service.stop() == 0, "".join(service.log)


def assert_same(answer, local):
    """The same answer, except that the service sends the pose as a quaternion, which rounds the last digits."""
    pairs = [(answer.pose.q, local.pose.q), (answer.pose.t, local.pose.t), (answer.covariance, local.covariance)]
    for remote, expected in pairs:
        np.testing.assert_allclose(remote, expected, rtol=1e-9, atol=1e-12)
    assert answer.position_sd == pytest.approx(local.position_sd, rel=1e-9)
    counts = lambda answer: (answer.state, answer.inliers, answer.matches, answer.hypotheses)
    assert counts(answer) == counts(local)


@pytest.fixture
def client(service):
    return veiloc.Client(service.address, service.token)


def test_answers_equal_those_of_the_map_in_memory(rendered, client):
    profile = client.profile("room")
    assert profile == rendered.map.profile
    found = 0
    for query in rendered.queries:
        sealed = seal(rendered.images / query, rendered.camera, profile)
        answer, local = client.localize("room", sealed), rendered.map.localize(sealed)
        assert_same(answer, local)
        found += near(answer.pose, rendered.pose(query))
    assert found >= len(rendered.queries) - 1


def test_progressive_localization_stops_at_a_trusted_pose(rendered, client):
    profile = client.profile("room")
    sealed = seal(rendered.images / rendered.queries[0], rendered.camera, profile)
    answer, steps = client.localize_progressive("room", sealed, profile)
    assert answer.trusted and near(answer.pose, rendered.pose(rendered.queries[0]))
    rows = [step["rows"] for step in steps]
    assert rows == sorted(set(rows)) and rows[0] == 256
    assert [step["outcome"] for step in steps][-1] == "trusted"
    assert "trusted" not in [step["outcome"] for step in steps][:-1]
    assert all(0 < step["bytes"] <= len(sealed) for step in steps)
    # No pose reaches this accuracy, so all rows are sent.
    _, all_steps = client.localize_progressive("room", sealed, profile, position_sd=1e-9)
    assert all_steps[-1]["rows"] == veiloc.describe_query(sealed)["rows"] > rows[-1]
    with pytest.raises(veiloc.InputError, match="position_sd"):
        client.localize_progressive("room", sealed, profile, position_sd=0)


def test_session_frames_localize_as_a_rig(rendered, client):
    session, sealer = veiloc.Session(), veiloc.Sealer(client.profile("room"))
    frames = []
    for query in rendered.queries[:2]:
        pose = rendered.pose(query)
        extracted = sealer.extract(rendered.images / query, rendered.camera, orientation=pose.q)
        sealed = sealer.in_session(session).seal(extracted)
        assert near(client.localize("room", sealed).pose, pose), "one frame by itself"
        frames.append((sealed, pose))
    answer = client.localize_rig("room", frames)
    # The rig frame is the world frame, so the camera poses on the rig are their true poses.
    assert near(answer.pose, veiloc.CameraPose())
    assert_same(answer, rendered.map.localize_rig(frames))
    with pytest.raises(veiloc.InputError, match="frames"):
        client.localize_rig("room", [(b"", 1)])


def test_frames_of_a_rig_are_of_one_session(rendered, client):
    """Images that look all around a room: those of one session are localized together, others are refused before they are sent."""
    sealer, views = veiloc.Sealer(client.profile("room")), [*rendered.queries, *(name for name, *_ in rendered.mapped)]
    extracted = lambda name: sealer.extract(rendered.images / name, rendered.camera, orientation=rendered.pose(name).q)
    session = veiloc.Session()
    of_session, alone = [
        [(seal(extracted(name)), rendered.pose(name)) for name in views]
        for seal in (sealer.in_session(session).seal, sealer.seal)
    ]
    assert session.frames == len(views)
    assert near(client.localize_rig("room", of_session).pose, veiloc.CameraPose())
    for mixed in (alone, [of_session[0], alone[1]]):
        with pytest.raises(veiloc.InputError, match="one session"):
            client.localize_rig("room", mixed)


def test_position_hint_and_trusted_only(rendered, client):
    query = rendered.queries[0]
    sealed = seal(rendered.images / query, rendered.camera, client.profile("room"))
    truth = rendered.pose(query)
    answer = client.localize("room", sealed, near=[*truth.center, 0.5], trusted_only=True)
    assert answer.trusted and near(answer.pose, truth)
    with pytest.raises(veiloc.Error, match="deviation|standard|above 0"):
        client.localize("room", sealed, near=[0, 0, 0, -1])


def test_refusals_have_status_and_name(rendered, service, client, tmp_path_factory):
    sealed = seal(rendered.images / rendered.queries[0], rendered.camera, client.profile("room"))
    with pytest.raises(veiloc.RefusedError) as refused:
        client.localize("hall", sealed)
    assert (refused.value.status, refused.value.name) == (404, "unknown-map")
    for token in [None, "guess"]:
        with pytest.raises(veiloc.RefusedError) as refused:
            veiloc.Client(service.address, token).profile("room")
        assert refused.value.status == 401
    other = rendered.map.remove(rendered.map.image_names[:2], retrain=True, self_test=False)
    of_other = seal(rendered.images / rendered.queries[0], rendered.camera, other.profile)
    with pytest.raises(veiloc.WrongProfileError):
        client.localize("room", of_other)
    # An out-of-map image: another room.
    folder = tmp_path_factory.mktemp("out-of-map")
    _, ((name, camera, _),) = veiloc.render_room(folder, mapped=0, queries=1, seed=77)
    out_of_map = seal(folder / name, camera, client.profile("room"))
    with pytest.raises(veiloc.NotLocalizedError):
        client.localize("room", out_of_map)
    with pytest.raises(veiloc.QueryError):
        client.localize("room", b"no query")


def test_busy_service_reports_retry_after(rendered, service, program_path, tmp_path):
    slow = Service(program_path, tmp_path, rendered.map, "--rate", "1", "--burst", "1", "--drain-delay", "0")
    try:
        no_retries = veiloc.Client(slow.address, retries=0)
        with pytest.raises(veiloc.BusyError) as busy:
            for _ in range(20):
                no_retries.profile("room")
        assert busy.value.retry_after is not None and busy.value.retry_after <= 60
        # A client that waits as long as the service requests gets its answer.
        assert veiloc.Client(slow.address, retries=4).profile("room") == rendered.map.profile
    finally:
        assert slow.stop() == 0


def test_profiles_are_cached_and_revalidated(rendered, service, tmp_path):
    for _ in range(2):
        client = veiloc.Client(service.address, service.token, cache=tmp_path / "cache")
        assert client.profile("room") == rendered.map.profile
    assert any((tmp_path / "cache").rglob("*")), "the cache is empty"


def test_packs_are_fetched_cached_and_compared(rendered, service, program_path, tmp_path):
    own, query = rendered.map.pack(), rendered.queries[0]
    for _ in range(2):
        client = veiloc.Client(service.address, service.token, cache=tmp_path / "cache", pack_ids={"room": own.id})
        pack = client.pack("room")
        assert pack == own
    sealed = seal(rendered.images / query, rendered.camera, pack.profile, pack=pack)
    answer = client.localize("room", sealed)
    assert_same(answer, rendered.map.localize(sealed))
    assert answer.trusted and near(answer.pose, rendered.pose(query))
    answer, steps = client.localize_progressive("room", sealed, pack.profile)
    assert answer.trusted and steps[-1]["outcome"] == "trusted"
    with pytest.raises(veiloc.ServiceError, match=own.id):
        veiloc.Client(service.address, service.token, pack_ids={"room": "0" * 32}).pack("room")
    with pytest.raises(veiloc.QueryError):
        veiloc.Client(service.address, pack_ids={"room": "no id"})
    without = Service(program_path, tmp_path, rendered.map, "--drain-delay", "0")
    try:
        with pytest.raises(veiloc.RefusedError) as refused:
            veiloc.Client(without.address).pack("room")
        assert refused.value.status == 404
    finally:
        assert without.stop() == 0


WAITING = """
import sys, veiloc
print("begun", flush=True)
try:
    veiloc.Client(sys.argv[1], retries=0).profile("room")
except KeyboardInterrupt:
    print("stopped", flush=True)
"""


def test_content_anchors_are_written_and_sorted(rendered, service, program_path, tmp_path):
    words = ["token", "new", "writer", "--anchors", "--tokens", tmp_path / "tokens"]
    created = subprocess.run([program_path, *words], capture_output=True, text=True, check=True)
    own = Service(program_path, tmp_path, rendered.map, "--tokens", str(tmp_path / "tokens"), "--drain-delay", "0")
    client = veiloc.Client(own.address, created.stdout.strip())
    client.put_anchor("room", "far", q=[1, 0, 0, 0], t=[9, 0, 0], content={"text": "é", "n": 1.5})
    client.put_anchor("room", "near", q=np.array([0, 1, 0, 0]), t=(1, 2, 2))
    assert [anchor["name"] for anchor in client.anchors("room")] == ["far", "near"]
    near, far = client.anchors("room", near=(1, 0, 0))
    assert (near["name"], near["distance"], near["content"]) == ("near", 8**0.5, None)
    assert (far["content"], far["owner"], far["map_from_anchor"]["t"]) == ({"text": "é", "n": 1.5}, "writer", [9, 0, 0])
    for wrong in [{"q": [0, 0, 0, 0]}, {"t": [0, 0, float("nan")]}, {"content": float("nan")}, {"content": "x" * 5000}]:
        with pytest.raises(veiloc.InputError):
            client.put_anchor("room", "wrong", **{"q": [1, 0, 0, 0], "t": [0, 0, 0], **wrong})
    client.delete_anchor("room", "far")
    with pytest.raises(veiloc.RefusedError) as refused:
        client.delete_anchor("room", "far")
    assert (refused.value.status, refused.value.name) == (404, "unknown-anchor")
    with pytest.raises(veiloc.RefusedError, match="anchors"):
        veiloc.Client(service.address, service.token).delete_anchor("room", "far")
    assert own.stop() == 0


def test_ctrl_c_ends_an_unanswered_request():
    with socket.create_server(("127.0.0.1", 0)) as silent_server:
        reset_sigint = lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)
        command = [sys.executable, "-c", WAITING, "http://127.0.0.1:%d" % silent_server.getsockname()[1]]
        child = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, preexec_fn=reset_sigint)
        assert child.stdout.readline() == "begun\n"
        connection, _ = silent_server.accept()
        with connection:
            assert connection.recv(4) == b"GET ", "the request was sent, and the client waits"
            child.send_signal(signal.SIGINT)
            out, _ = child.communicate(timeout=30)
    assert out == "stopped\n"
