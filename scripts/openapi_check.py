#!/usr/bin/env python3
"""Checks real answers of the service against its OpenAPI description.

    scripts/openapi_check.py [--veiloc PROGRAM]

Starts `veiloc serve` with a rendered scene, fetches `/v1/openapi.json`, and fails when

- openapi-spec-validator finds a fault in it;
- the description does not have the status or the content type of an answer, the answer lacks a described header, or its body
  does not match the schema (jsonschema);
- two requests have the same id, or a problem document does not carry the id of its request.

The script provokes each status that a client can provoke. The others need a bug, or a file that breaks at the right moment; for
them it only validates the description. The two packages come from PyPI, into a virtual environment in a temporary folder.
"""

import base64
import http.client
import json
import pathlib
import re
import socket
import struct
import subprocess
import sys
import tempfile
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "research"))

from study.loopback import LOCALIZE, PROTOBUF, RenderedScene, Server, arguments, ask, in_threads, token  # noqa: E402

NEEDED = ["openapi-spec-validator", "jsonschema"]
RIG = "/v1/maps/place/localize-rig"
PROFILE = "/v1/maps/place/profile"
GEOPOSE = "/geopose"
ANCHORS = "/v1/maps/place/anchors"
REFERENCE = ["--geo-reference", "place=47.3769,8.5417,455"]
JSON = "application/json"
# Only a bug gives these.
NOT_PROVOKED = {("/v1/maps", "500"), ("/v1/maps/{name}/localize", "500"), ("/v1/maps/{name}/localize-rig", "500"), ("/geopose", "500"),
                ("/v1/maps/{name}/anchors", "500"), ("/v1/maps/{name}/anchors/{anchor}", "500")}


def packages():
    """Installs both packages into a virtual environment and makes them importable."""
    folder = tempfile.mkdtemp(prefix="veiloc-openapi-")
    subprocess.run([sys.executable, "-m", "venv", folder], check=True)
    subprocess.run([f"{folder}/bin/pip", "install", "--quiet", "--disable-pip-version-check", *NEEDED], check=True)
    sys.path[:0] = [str(path) for path in pathlib.Path(folder).glob("lib/python*/site-packages")]


class Checker:
    """The description, and the faults that were found."""

    def __init__(self, document):
        from jsonschema import Draft202012Validator

        self.document, self.faults, self.seen, self.ids = document, [], {}, set()
        self.validator = Draft202012Validator

    def fault(self, what):
        self.faults.append(what)

    def errors(self, schema, value):
        # References are relative to the root of the document.
        whole = {**schema, "components": self.document["components"]}
        return [error.message for error in self.validator(whole).iter_errors(value)]

    def template(self, path):
        path = path.split("?")[0]
        for template in self.document["paths"]:
            if re.fullmatch(re.sub(r"\{\w+\}", "[^/]+", template), path):
                return template
        return None

    def answer(self, method, path, status, headers, body):
        """Checks one answer against the description."""
        what = f"{method} {path} {status}"
        template = self.template(path)
        if template is None:
            return self.fault(f"{what}: the path is not described")
        item = self.document["paths"][template]
        # The description of 405 is with the existing methods.
        operation = item.get(method.lower()) or next(iter(item.values()))
        described = operation["responses"].get(str(status))
        self.seen[template, str(status)] = self.seen.get((template, str(status)), 0) + 1
        if described is None:
            return self.fault(f"{what}: the status is not described")
        headers = {name.lower(): value for name, value in headers.items()}
        for name, header in described.get("headers", {}).items():
            if name not in headers:
                self.fault(f"{what}: no header {name}")
            for error in self.errors(header["schema"], headers.get(name, "")):
                self.fault(f"{what}: header {name}: {error}")
        if headers.get("veiloc-request-id") in self.ids:
            self.fault(f"{what}: another request had the same id")
        self.ids.add(headers.get("veiloc-request-id"))
        content = described.get("content", {})
        kind = headers.get("content-type", "").split("; charset")[0].split("; version=1.0.0")[0]
        if not content and not body:
            return None
        if kind not in content:
            return self.fault(f"{what}: content type {kind} is not described; described are {list(content)}")
        if "json" in kind:
            value = json.loads(body)
            for error in self.errors(content[kind]["schema"], value):
                self.fault(f"{what}: {kind}: {error}")
            if kind == "application/problem+json":
                if value.get("instance") != f"urn:veiloc:request:{headers['veiloc-request-id']}":
                    self.fault(f"{what}: it does not carry the id of its request")
        self.seen[template, kind] = self.seen.get((template, kind), 0) + 1
        return None


def request(checker, port, method, path, body=None, user=None, **headers):
    """Sends a request, checks the answer, and returns its status and headers."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    sent = {name.replace("_", "-"): value for name, value in headers.items()}
    if user:
        sent["authorization"] = f"Bearer {token(user)}"
    connection.request(method, path, body, sent)
    response = connection.getresponse()
    answer = response.read()
    checker.answer(method, path, response.status, dict(response.getheaders()), answer)
    connection.close()
    return response.status, dict(response.getheaders())


def announced(checker, port, path, length, begun=b"", more="", kind=PROTOBUF, method="POST", user="phone"):
    """Announces a body, and sends nothing or only a part of it."""
    stream = socket.create_connection(("127.0.0.1", port), timeout=60)
    head = f"{method} {path} HTTP/1.1\r\nhost: x\r\nauthorization: Bearer {token(user)}\r\n"
    stream.sendall(f"{head}content-type: {kind}\r\ncontent-length: {length}\r\n{more}\r\n".encode() + begun)
    response = http.client.HTTPResponse(stream)
    response.begin()
    checker.answer(method, path, response.status, dict(response.getheaders()), response.read())
    stream.close()


def provoke(checker, scene, server):
    """Provokes each kind of successful answer, and most refusals."""
    query, port = scene.query, server.port
    for form in ("application/json", PROTOBUF):
        request(checker, port, "POST", LOCALIZE, query, "phone", content_type=PROTOBUF, accept=form)
    rig = rig_of(query)
    for form in ("application/json", PROTOBUF):
        request(checker, port, "POST", RIG, rig, "phone", content_type="application/octet-stream", accept=form)
    other_profile = bytearray(query)
    other_profile[8] ^= 1  # in the profile's id
    blank = blanked(query)
    for path, good, kind, made_of in ((LOCALIZE, query, PROTOBUF, bytes), (RIG, rig, PROTOBUF, rig_of),
                                      (GEOPOSE, geopose_of(query), JSON, geopose_of)):
        post = lambda body=good, user="phone", path=path, kind=kind, **headers: request(
            checker, port, "POST", path, body, user, **{"content_type": kind, **headers})
        post(good[: len(good) // 2])
        post(veiloc_near="nowhere")
        post(user="unknown")
        post(path=path.replace("place", "other"))
        post(made_of(bytes(other_profile)))
        announced(checker, port, path, 1 << 40, more="expect: 100-continue\r\n", kind=kind)
        announced(checker, port, path, len(good), begun=good[:100], kind=kind)
        post(content_type="text/plain")
        post(content_encoding="gzip")
        post(made_of(blank))
        request(checker, port, "GET", path, None, "phone")
    request(checker, port, "GET", "/v1/maps", None, "phone")
    request(checker, port, "GET", "/v1/maps")
    request(checker, port, "POST", "/v1/maps", b"")
    _, headers = request(checker, port, "GET", PROFILE, None, "phone")
    request(checker, port, "GET", PROFILE, None, "phone", if_none_match=headers["etag"])
    request(checker, port, "GET", PROFILE, None, "unknown")
    request(checker, port, "GET", PROFILE.replace("place", "other"), None, "phone")
    request(checker, port, "GET", PROFILE.replace("place", "broken"), None, "phone")
    request(checker, port, "POST", PROFILE, b"")
    for path in ("/v1/openapi.json", "/healthz", "/readyz"):
        request(checker, port, "GET", path)
        request(checker, port, "POST", path, b"")
    request(checker, port, "GET", "/metrics", None, "operator")
    request(checker, port, "GET", "/metrics", None, "phone")
    request(checker, port, "GET", "/metrics")
    request(checker, port, "POST", "/metrics", b"")


def provoke_anchors(checker, scene, server):
    """Provokes answers about content anchors, which stay beside the map until the end."""
    door, port = f"{ANCHORS}/door", server.port
    anchor = {"map_from_anchor": {"q": [1, 0, 0, 0], "t": [1, 2, 3]}, "content": {"text": "mind the step"}}
    good = json.dumps(anchor).encode()
    put = lambda body=good, user="editor", path=door, **headers: request(
        checker, port, "PUT", path, body, user, **{"content_type": JSON, **headers})
    file = scene.map.with_suffix(".anchors.json")
    file.unlink(missing_ok=True)
    for path, user in ((door, "editor"), (door, "editor"), (door, "phone"), (door, "unknown"), (door.replace("place", "other"), "editor"),
                       (door.replace("place", "broken"), "editor")):
        put(path=path, user=user)
    put(b"{")
    put(content_type="text/plain")
    put(if_match='"another"')
    announced(checker, port, door, len(good), begun=good[:20], kind=JSON, method="PUT", user="editor")
    for path in (ANCHORS, door):
        _, headers = request(checker, port, "GET", path, None, "phone")
        request(checker, port, "GET", path, None, "phone", if_none_match=headers["etag"])
        request(checker, port, "GET", path.replace("place", "broken"), None, "phone")
        request(checker, port, "GET", path.replace("place", "other"), None, "phone")
        request(checker, port, "GET", path)
        request(checker, port, "POST", path, b"")
    request(checker, port, "DELETE", door, None, "editor")
    file.write_text(json.dumps({"version": 1, "anchors": [{"name": str(i), **anchor} for i in range(1000)]}))
    put()
    file.unlink()


def varint(data, at):
    """A number of the wire format at this place, and where it ends."""
    value = shift = 0
    while True:
        value |= (data[at] & 127) << shift
        at, shift = at + 1, shift + 7
        if data[at - 1] < 128:
            return value, at


def blanked(query):
    """The query with all descriptors equal, so that nothing matches."""
    at = 0
    while at < len(query):
        key, at = varint(query, at)
        length, start = varint(query, at) if key & 7 in (0, 2) else (0, at + (4 if key & 7 == 5 else 8))
        at = start + (length if key & 7 == 2 else 0)
        if key >> 3 == 16:
            return query[:start] + bytes([45]) * length + query[at:]
    raise ValueError("a query without descriptors")


def provoke_load(checker, scene):
    """Provokes refusals that depend on load, rate limits, timeouts and the operator's files."""
    tokens = scene.tokens(["phone", "operator!"], scene.work / "few-tokens")
    # No machine localizes within the timeout, and more requests come than it holds.
    busy = Server(scene, "--tokens", tokens, "--threads", "1", "--queue", "1", "--request-timeout", "0.005", *REFERENCE)
    posts = ((LOCALIZE, scene.query, PROTOBUF), (RIG, rig_of(scene.query), PROTOBUF), (GEOPOSE, geopose_of(scene.query), JSON))
    for path, body, kind in posts:
        ask_busy = lambda i, path=path, body=body, kind=kind: request(
            checker, busy.port, "POST", path, body, "phone", content_type=kind)
        for thread in in_threads(32, ask_busy):
            thread.join()
    busy.stop()
    limited = Server(scene, "--tokens", tokens, *REFERENCE, rate=1)
    request(checker, limited.port, "GET", "/v1/maps", None, "phone")
    for path in ("/v1/maps", PROFILE, ANCHORS, f"{ANCHORS}/door"):
        request(checker, limited.port, "GET", path, None, "phone")
    for path, body, kind in posts:
        request(checker, limited.port, "POST", path, body, "phone", content_type=kind)
    limited.stop()
    shut = Server(scene, "--tokens", tokens, "--tokens-max-stale", "0", "--watch", "0.2")
    # Without a geographic reference.
    request(checker, shut.port, "POST", GEOPOSE, geopose_of(scene.query), "phone", content_type=JSON)
    tokens.write_text("")
    time.sleep(1.0)
    for path in ("/v1/maps", "/metrics", "/readyz"):
        request(checker, shut.port, "GET", path, None, "phone")
    shut.stop()


def rig_of(query):
    """A rig of one camera, at the rig's origin."""
    return b"vqrig1\n\x01" + struct.pack("<9d", 1, *[0] * 8) + struct.pack("<I", len(query)) + query


def geopose_of(query):
    """A GeoPose request with a query."""
    privacy = {"dataRetention": [], "dataAcceptableUse": [], "dataSanitizationApplied": ["dcl"], "dataSanitizationRequested": []}
    reading = {"timestamp": 1700000000000, "sensorId": "0", "privacy": privacy, "sequenceNumber": 0, "imageFormat": "VEILOC_SEALED_QUERY",
               "size": [640, 480], "imageBytes": base64.b64encode(query).decode()}
    return json.dumps({"id": "query", "timestamp": 1700000000000, "type": "geopose", "sensors": [{"id": "0", "type": "camera"}],
                       "sensorReadings": {"cameraReadings": [reading]}}).encode()


def main():
    scene = RenderedScene(arguments(__doc__).parse_args().veiloc)
    packages()
    from openapi_spec_validator import validate
    broken = scene.work / "broken.vmap"
    broken.write_bytes(b"no map")
    maps = ["--map", f"place={scene.map}", "--map", f"broken={broken}"]
    server = Server(scene, "--tokens", scene.tokens(["phone", "operator!", "editor+"]), "--body-timeout", "2", *REFERENCE, maps=maps)
    document = json.loads(ask(server.port, "/v1/openapi.json")[1])
    validate(document)
    print(f"openapi-spec-validator: valid, {len(document['paths'])} paths")
    checker = Checker(document)
    try:
        provoke(checker, scene, server)
        provoke_anchors(checker, scene, server)
    finally:
        server.stop()
    provoke_load(checker, scene)

    described, forms = set(), set()
    for template, item in document["paths"].items():
        for operation in item.values():
            for status, response in operation["responses"].items():
                described.add((template, status))
                forms.update((template, kind) for kind in response.get("content", {}))
    left = described - set(checker.seen) - NOT_PROVOKED
    unseen = forms - set(checker.seen)
    print(f"statuses described: {len(described)}, provoked: {len(described & set(checker.seen))}")
    print(f"content types described: {len(forms)}, seen: {len(forms & set(checker.seen))}")
    for what in sorted(left) + sorted(unseen):
        print(f"not provoked: {what[0]} {what[1]}")
    print(f"answers checked against the description: {len(checker.ids)}, faults: {len(checker.faults)}")
    for fault in checker.faults:
        print(fault, file=sys.stderr)
    return 1 if checker.faults or left or unseen else 0


if __name__ == "__main__":
    sys.exit(main())
