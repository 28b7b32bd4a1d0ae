"""Workers on Ray answer as a service does: the same poses, refusals and lengths."""

import hashlib
import http.client
import http.server
import json
import os
import signal
import struct
import threading
import time

import pytest

pytest.importorskip("starlette", reason="Ray Serve is not installed")
import ray
from conftest import near, seal
from ray import serve
from test_ray import processes_of_ray

import veiloc
import veiloc.ray_serve

TOKEN = "secret"
WITHOUT_TIMES = lambda document: {key: value for key, value in document.items() if key != "ms"}


@pytest.fixture(scope="module")
def store(rendered, tmp_path_factory):
    """A published map of one region, and its id."""
    folder = tmp_path_factory.mktemp("store")
    rendered.map.save(folder / "region.vmap")
    region = hashlib.sha256((folder / "region.vmap").read_bytes()).hexdigest()
    manifest = json.dumps({"map": "room", "regions": [{"sha256": region}]}).encode()
    name = hashlib.sha256(manifest).hexdigest()
    (folder / "objects").mkdir()
    (folder / "manifests").mkdir()
    (folder / "region.vmap").rename(folder / "objects" / region)
    (folder / "manifests" / f"{name}.json").write_bytes(manifest)
    (folder / "room.json").write_text(json.dumps({"version": 1, "map": "room", "manifest": name}))
    (folder / "tokens").write_text(f"gateway {hashlib.sha256(TOKEN.encode()).hexdigest()} gateway\n")
    return folder, region


@pytest.fixture(scope="module")
def port(store):
    ray.init(num_cpus=4, log_to_driver=False, include_dashboard=False)
    with http.server.HTTPServer(("127.0.0.1", 0), None) as free:
        port = free.server_port
    serve.start(http_options={"host": "127.0.0.1", "port": port})
    serve.run(veiloc.ray_serve.application(store[0], tokens=store[0] / "tokens", replicas=2, regions=2), route_prefix="/")
    yield port
    serve.shutdown()
    ray.shutdown()


def ask(port, path, body, **headers):
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=30)
    connection.request("POST", path, body, {"authorization": f"Bearer {TOKEN}", **headers})
    response = connection.getresponse()
    answer = response.read()
    connection.close()
    return response.status, answer


def query_of(room):
    return seal(room.images / room.queries[0], room.camera, room.map.profile)


def test_answers_and_refusals_are_those_of_a_worker(rendered, store, port):
    path = f"/v1/maps/room/regions/{store[1]}/localize"
    query = query_of(rendered)
    status, body = ask(port, path, query)
    assert (status, len(body)) == (200, 4096)
    expected = rendered.map.localize(query)
    assert WITHOUT_TIMES(json.loads(body)) == WITHOUT_TIMES(expected.to_dict())
    assert near(expected.pose, rendered.pose(rendered.queries[0]))
    for wrong, (to, what, headers) in {
        401: (path, query, {"authorization": "Bearer other"}),
        404: (path.replace(store[1], "0" * 64), query, {}),
        400: (path, b"no query", {}),
    }.items():
        status, body = ask(port, to, what, **headers)
        assert (status, len(body)) == (wrong, 4096)
        assert json.loads(body)["status"] == wrong
    assert ask(port, path.replace("room", "hall"), query)[0] == 404
    assert ask(port, path, query, **{"veiloc-near": "1,2"})[0] == 400


def test_rig_is_answered(rendered, store, port):
    query = query_of(rendered)
    frame = struct.pack("<9dI", 1, 0, 0, 0, 0, 0, 0, 0, 0, len(query)) + query
    status, body = ask(port, f"/v1/maps/room/regions/{store[1]}/localize-rig", b"vqrig1\n\x01" + frame)
    assert status == 200
    assert json.loads(body)["state"] == "trusted"


def test_protobuf_answers_are_read_by_the_client(rendered):
    """The client refuses any other encoding than the service's."""
    query = query_of(rendered)
    expected = rendered.map.localize(query)
    profile = bytes(rendered.map.profile)

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_POST(self):
            self.rfile.read(int(self.headers["content-length"]))
            self.answer("application/x-protobuf", veiloc.ray_serve.answer_bytes(expected))

        def do_GET(self):
            self.answer("application/x-protobuf", profile)

        def answer(self, kind, body):
            self.send_response(200)
            self.send_header("content-type", kind)
            self.send_header("content-length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *args):
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        answer = veiloc.Client(f"http://127.0.0.1:{server.server_port}").localize("room", query)
        server.shutdown()
    assert WITHOUT_TIMES(answer.to_dict()) == WITHOUT_TIMES(expected.to_dict())


def test_killed_replica_loses_no_query_that_is_sent_again(rendered, store, port):
    path = f"/v1/maps/room/regions/{store[1]}/localize"
    query = query_of(rendered)
    replicas = processes_of_ray("ServeReplica:default:regions")
    assert len(replicas) == 2
    os.kill(replicas[0], signal.SIGKILL)
    for _ in range(6):
        for _ in range(20):
            if ask(port, path, query)[0] == 200:
                break
            time.sleep(0.5)
        else:
            pytest.fail("no answer in ten seconds")
