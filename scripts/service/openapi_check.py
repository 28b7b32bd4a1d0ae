#!/usr/bin/env python3
"""The API description, and real answers held to it.

    scripts/service/openapi_check.py [--veiloc PROGRAM]

Starts `veiloc serve` on a rendered place, fetches `/v1/openapi.json`, and fails when

- openapi-spec-validator finds a fault in it;
- an answer has a status, a content type or a header that the description does not have, lacks a header that it has, or
  is not of the form that it gives (jsonschema);
- two requests have one name, or a refusal does not carry its own.

Provoked is each status that one can provoke; of those that are left (they need a bug, or files that break at the right
moment) the description alone is looked at. The two packages come from PyPI, into an environment of their own in a
temporary folder.
"""

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

from common import LOCALIZE, PROTOBUF, RenderedPlace, Server, arguments, ask, in_threads, token

NEEDED = ["openapi-spec-validator", "jsonschema"]
RIG = "/v1/maps/place/localize-rig"
PROFILE = "/v1/maps/place/profile"
# What nobody can provoke from outside: a bug.
NOT_PROVOKED = {("/v1/maps", "500"), ("/v1/maps/{name}/localize", "500"), ("/v1/maps/{name}/localize-rig", "500")}


def packages():
    """Makes both packages importable, in an environment of their own."""
    folder = tempfile.mkdtemp(prefix="veiloc-openapi-")
    subprocess.run([sys.executable, "-m", "venv", folder], check=True)
    subprocess.run([f"{folder}/bin/pip", "install", "--quiet", "--disable-pip-version-check", *NEEDED], check=True)
    sys.path[:0] = [str(path) for path in pathlib.Path(folder).glob("lib/python*/site-packages")]


class Checker:
    """The description, and what was found not to be as it says."""

    def __init__(self, document):
        from jsonschema import Draft202012Validator

        self.document, self.faults, self.seen, self.ids = document, [], {}, set()
        self.validator = Draft202012Validator

    def fault(self, what):
        self.faults.append(what)

    def errors(self, schema, value):
        # References begin at the document's root.
        whole = {**schema, "components": self.document["components"]}
        return [error.message for error in self.validator(whole).iter_errors(value)]

    def template(self, path):
        path = path.split("?")[0]
        for template in self.document["paths"]:
            if re.fullmatch(re.sub(r"\{\w+\}", "[^/]+", template), path):
                return template
        return None

    def answer(self, method, path, status, headers, body):
        """Holds one answer to the description."""
        what = f"{method} {path} {status}"
        template = self.template(path)
        if template is None:
            return self.fault(f"{what}: the address is not described")
        item = self.document["paths"][template]
        # 405 is described with the methods that there are.
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
            self.fault(f"{what}: a name that another request had")
        self.ids.add(headers.get("veiloc-request-id"))
        content = described.get("content", {})
        kind = headers.get("content-type", "").split("; charset")[0].split("; version=1.0.0")[0]
        if not content and not body:
            return None
        if kind not in content:
            return self.fault(f"{what}: content type {kind} is not described, but {list(content)}")
        if "json" in kind:
            value = json.loads(body)
            for error in self.errors(content[kind]["schema"], value):
                self.fault(f"{what}: {kind}: {error}")
            if kind == "application/problem+json":
                if value.get("instance") != f"urn:veiloc:request:{headers['veiloc-request-id']}":
                    self.fault(f"{what}: it does not carry its own name")
        self.seen[template, kind] = self.seen.get((template, kind), 0) + 1
        return None


def request(checker, port, method, path, body=None, who=None, **headers):
    """Asks, holds the answer to the description, and returns its status and headers."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    sent = {name.replace("_", "-"): value for name, value in headers.items()}
    if who:
        sent["authorization"] = f"Bearer {token(who)}"
    connection.request(method, path, body, sent)
    response = connection.getresponse()
    answer = response.read()
    checker.answer(method, path, response.status, dict(response.getheaders()), answer)
    connection.close()
    return response.status, dict(response.getheaders())


def announced(checker, port, path, length, begun=b"", more=""):
    """A body that is announced and does not come, or not all of it."""
    stream = socket.create_connection(("127.0.0.1", port), timeout=60)
    head = f"POST {path} HTTP/1.1\r\nhost: x\r\nauthorization: Bearer {token('phone')}\r\n"
    stream.sendall(f"{head}content-type: {PROTOBUF}\r\ncontent-length: {length}\r\n{more}\r\n".encode() + begun)
    response = http.client.HTTPResponse(stream)
    response.begin()
    checker.answer("POST", path, response.status, dict(response.getheaders()), response.read())
    stream.close()


def provoke(checker, place, server):
    """One answer of each kind that a service in order gives, and of most refusals."""
    query, port = place.query, server.port
    for form in ("application/json", PROTOBUF):
        request(checker, port, "POST", LOCALIZE, query, "phone", content_type=PROTOBUF, accept=form)
    rig = rig_of(query)
    for form in ("application/json", PROTOBUF):
        request(checker, port, "POST", RIG, rig, "phone", content_type="application/octet-stream", accept=form)
    elsewhere = bytearray(query)
    elsewhere[8] ^= 1  # in the profile's id
    blank = blanked(query)
    for path, good in ((LOCALIZE, query), (RIG, rig)):
        post = lambda body=good, who="phone", path=path, **headers: request(
            checker, port, "POST", path, body, who, **{"content_type": PROTOBUF, **headers})
        post(good[: len(good) // 2])
        post(veiloc_near="nowhere")
        post(who="nobody")
        post(path=path.replace("place", "elsewhere"))
        post(bytes(elsewhere) if path == LOCALIZE else rig_of(bytes(elsewhere)))
        announced(checker, port, path, 1 << 40, more="expect: 100-continue\r\n")
        announced(checker, port, path, len(good), begun=good[:100])
        post(content_type="text/plain")
        post(content_encoding="gzip")
        post(blank if path == LOCALIZE else rig_of(blank))
        request(checker, port, "GET", path, None, "phone")
    request(checker, port, "GET", "/v1/maps", None, "phone")
    request(checker, port, "GET", "/v1/maps")
    request(checker, port, "POST", "/v1/maps", b"")
    _, headers = request(checker, port, "GET", PROFILE, None, "phone")
    request(checker, port, "GET", PROFILE, None, "phone", if_none_match=headers["etag"])
    request(checker, port, "GET", PROFILE, None, "nobody")
    request(checker, port, "GET", PROFILE.replace("place", "elsewhere"), None, "phone")
    request(checker, port, "GET", PROFILE.replace("place", "broken"), None, "phone")
    request(checker, port, "POST", PROFILE, b"")
    for path in ("/v1/openapi.json", "/healthz", "/readyz"):
        request(checker, port, "GET", path)
        request(checker, port, "POST", path, b"")
    request(checker, port, "GET", "/metrics", None, "operator")
    request(checker, port, "GET", "/metrics", None, "phone")
    request(checker, port, "GET", "/metrics")
    request(checker, port, "POST", "/metrics", b"")


def blanked(query):
    """The same query with all descriptors alike: nothing of it matches."""
    # Field 16: its key is 0x82 0x01, then a varint of three bytes for more than 16383 bytes.
    at = query.index(b"\x82\x01")
    length = (query[at + 2] & 127) | (query[at + 3] & 127) << 7 | (query[at + 4] & 127) << 14
    return query[: at + 5] + bytes([45]) * length + query[at + 5 + length :]


def provoke_load(checker, place):
    """Refusals that depend on how much there is to do, on allowances, on time, and on the operator's files."""
    tokens = place.tokens(["phone", "operator!"], place.work / "few-tokens")
    slow = ["--workers", "1", "--queue", "1", "--hypotheses", "20000"]
    busy = Server(place, "--tokens", tokens, *slow, "--request-timeout", "1")
    for path, body in ((LOCALIZE, place.query), (RIG, rig_of(place.query))):
        ask_busy = lambda i, path=path, body=body: request(
            checker, busy.port, "POST", path, body, "phone", content_type=PROTOBUF)
        for thread in in_threads(8, ask_busy):
            thread.join()
    busy.stop()
    limited = Server(place, "--tokens", tokens, rate=1)
    request(checker, limited.port, "GET", "/v1/maps", None, "phone")
    for method, path, body in (("GET", "/v1/maps", None), ("GET", PROFILE, None), ("POST", LOCALIZE, place.query),
                               ("POST", RIG, rig_of(place.query))):
        request(checker, limited.port, method, path, body, "phone", content_type=PROTOBUF)
    limited.stop()
    shut = Server(place, "--tokens", tokens, "--stale-tokens", "0", "--watch", "0.2")
    tokens.write_text("")
    time.sleep(1.0)
    for path in ("/v1/maps", "/metrics", "/readyz"):
        request(checker, shut.port, "GET", path, None, "phone")
    shut.stop()


def rig_of(query):
    """A session of one image, whose camera is where the rig is."""
    return b"vqrig1\n\x01" + struct.pack("<9d", 1, *[0] * 8) + struct.pack("<I", len(query)) + query


def main():
    place = RenderedPlace(arguments(__doc__).parse_args().veiloc)
    packages()
    from openapi_spec_validator import validate
    broken = place.work / "broken.vmap"
    broken.write_bytes(b"no map")
    maps = ["--map", f"place={place.map}", "--map", f"broken={broken}"]
    server = Server(place, "--tokens", place.tokens(["phone", "operator!"]), "--body-timeout", "2", maps=maps)
    document = json.loads(ask(server.port, "/v1/openapi.json")[1])
    validate(document)
    print(f"openapi-spec-validator: in order, {len(document['paths'])} addresses")
    checker = Checker(document)
    try:
        provoke(checker, place, server)
    finally:
        server.stop()
    provoke_load(checker, place)

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
    print(f"answers held to the description: {len(checker.ids)}, faults: {len(checker.faults)}")
    for fault in checker.faults:
        print(fault, file=sys.stderr)
    return 1 if checker.faults or left or unseen else 0


if __name__ == "__main__":
    sys.exit(main())
