"""Publishes and fetches regions with a local S3 (moto) behind a proxy that injects faults; see docs/reference/map-format.md.

    pip install "moto[server,s3]" boto3
    cargo build -p veiloc-cli --features clouds
    python3 scripts/storage_s3.py target/debug/veiloc place.vmap [--images 20]

Publishes the map's regions, publishes them again (nothing is sent), and fetches them (byte-identical). The program must retry after
503 (slow down) and broken connections, and upload large objects in parts. Then each fault must give an error: other bytes under an
object's name, a truncated object, a missing object, an invalid pointer, an unknown key, a wrong secret, no permission to write, a
wrong region, an unknown bucket, no server. The error must name the bucket and the remedy, without retries where they do not help;
nothing may reach the folder, and no secret may be printed. The last line is `all checks passed`.
"""
import argparse
import http.client
import json
import logging
import os
import shutil
import socket
import subprocess
import tempfile
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Lock, Thread

import boto3
from moto.server import ThreadedMotoServer

BUCKET = "maps"
URL = f"s3://{BUCKET}/of mine"
SECRET = "sEcReT-of-the-bucket"
# Error codes and messages of S3.
WRONG = {
    "InvalidAccessKeyId": (403, "The AWS Access Key Id you provided does not exist in our records."),
    "SignatureDoesNotMatch": (403, "The request signature we calculated does not match the signature you provided."),
    "ExpiredToken": (400, "The provided token has expired."),
    "AccessDenied": (403, "Access Denied"),
    "AuthorizationHeaderMalformed": (400, "The region 'us-east-1' is wrong; expecting 'eu-west-1'"),
    "SlowDown": (503, "Please reduce your request rate."),
}


class FaultProxy:
    """A proxy in front of the storage that injects faults and counts requests."""

    def __init__(self, host, port):
        self.lock, self.faults, self.requests, self.parts, self.refused = Lock(), {}, 0, 0, 0
        proxy = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def log_message(self, *_):
                pass

            def handle(self):
                try:
                    super().handle()
                except OSError:
                    # The client has closed the connection, as programs do after an error.
                    self.close_connection = True

            def answer(self):
                body = self.rfile.read(int(self.headers.get("content-length") or 0))
                fault = proxy.fault(self.command, self.path)
                if fault == "breaks":
                    self.close_connection = True
                    return
                if fault:
                    status, message = WRONG[fault]
                    content = f"<?xml version='1.0'?><Error><Code>{fault}</Code><Message>{message}</Message></Error>".encode()
                    headers = [("content-type", "application/xml")]
                else:
                    connection = http.client.HTTPConnection(host, port, timeout=60)
                    connection.request(self.command, self.path, body, dict(self.headers))
                    response = connection.getresponse()
                    status, content, headers = response.status, response.read(), response.getheaders()
                    connection.close()
                self.send_response(status)
                length = str(len(content))
                for name, value in headers:
                    if name.lower() in ("content-length", "transfer-encoding", "connection"):
                        if self.command == "HEAD" and name.lower() == "content-length":
                            length = value
                        continue
                    self.send_header(name, value)
                self.send_header("content-length", length)
                self.end_headers()
                if self.command != "HEAD":
                    self.wfile.write(content)

            do_GET = do_PUT = do_POST = do_HEAD = do_DELETE = answer

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.server.daemon_threads = True
        self.address = f"http://127.0.0.1:{self.server.server_address[1]}"
        Thread(target=self.server.serve_forever, daemon=True).start()

    def fault(self, method, path):
        """The fault of this request: each request fails the configured number of times, then it succeeds."""
        with self.lock:
            self.requests += 1
            self.parts += "partNumber=" in path
            what, times, methods = self.faults.get("now", (None, 0, ()))
            if not what or method not in methods:
                return None
            key = (method, path)
            seen = self.faults.setdefault(key, 0)
            self.faults[key] += 1
            if seen < times:
                self.refused += 1
                return what
            return None

    def set_fault(self, what, times=10**9, methods=("GET", "HEAD", "PUT", "POST")):
        with self.lock:
            self.faults = {"now": (what, times, methods)}
            self.refused = 0

    def clear_faults(self):
        with self.lock:
            self.faults = {}


def worker(program, settings, proxy, folder):
    """A worker fetches its regions from the storage; if the storage is unreachable, it starts with its cache."""
    if not shutil.which("nats-server"):
        print("skipped: a worker (nats-server is missing: apt-get install nats-server)")
        return
    with socket.socket() as one, socket.socket() as two:
        for listener in (one, two):
            listener.bind(("127.0.0.1", 0))
        bus, admin = (listener.getsockname()[1] for listener in (one, two))
    settings_of_bus = Path(folder, "nats.conf")
    settings_of_bus.write_text("max_payload: 8388608\n")
    nats = subprocess.Popen(["nats-server", "-c", settings_of_bus, "-a", "127.0.0.1", "-p", str(bus)], stderr=subprocess.DEVNULL)
    command = [program, "worker", "--nats", f"nats://127.0.0.1:{bus}", "--store", URL, "--map", "place", "--cache",
               Path(folder, "cache"), "--admin-listen", f"127.0.0.1:{admin}", "--workers", "1"]
    log = Path(folder, "worker.log")
    try:
        for what in ("", "breaks"):
            if what:
                proxy.set_fault(what)
            started = time.monotonic()
            with open(log, "w") as out:
                running = subprocess.Popen(command, env=settings, stderr=out)
            ready = False
            while not ready and running.poll() is None and time.monotonic() < started + 90:
                time.sleep(0.1)
                try:
                    connection = http.client.HTTPConnection("127.0.0.1", admin, timeout=5)
                    connection.request("GET", "/readyz")
                    ready = connection.getresponse().status == 200
                except OSError:
                    pass
            took = time.monotonic() - started
            running.kill()
            running.wait()
            assert ready, log.read_text()
            assert ("taken from the cache" in log.read_text()) == bool(what) and SECRET not in log.read_text(), log.read_text()
            print(f"a worker is ready after {took:.1f} s" + (" while the storage is unreachable" if what else ""))
    finally:
        nats.kill()
        nats.wait()
        proxy.clear_faults()


def main(program, place, images):
    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0)
    server.start()
    proxy = FaultProxy(*server.get_host_and_port())
    settings = {
        "AWS_ENDPOINT": proxy.address,
        "AWS_ALLOW_HTTP": "true",
        "AWS_ACCESS_KEY_ID": "key",
        "AWS_SECRET_ACCESS_KEY": SECRET,
        "AWS_REGION": "us-east-1",
    }
    storage = boto3.client("s3", endpoint_url=proxy.address, region_name="us-east-1", aws_access_key_id="key",
                           aws_secret_access_key=SECRET)
    storage.create_bucket(Bucket=BUCKET)

    def run(*words):
        started = time.monotonic()
        done = subprocess.run([program, *map(str, words)], env=os.environ | settings, capture_output=True, text=True, check=False)
        assert SECRET not in done.stdout + done.stderr, "a secret was printed"
        return done, time.monotonic() - started

    def document(*words):
        done, seconds = run(*words, "--json")
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout), seconds

    def key(path):
        return f"of mine/{path}"

    with tempfile.TemporaryDirectory() as folder:
        regions, back = Path(folder, "regions"), Path(folder, "back")
        split, _ = document("map", "split", place, "--images", images, "--name", "place", "--out", regions)
        objects = len(split["regions"]) + 2
        published, seconds = document("map", "publish", regions, URL)
        assert published["objects_sent"] == objects and published["bytes_sent"] == split["bytes"], published
        largest = max(region["bytes"] for region in split["regions"])
        assert (proxy.parts > 0) == (largest > 8 << 20), (proxy.parts, largest)
        print(f"published {objects} objects, {split['bytes'] / 1e6:.1f} MB in {seconds:.1f} s; {proxy.parts} parts of objects over "
              f"8 MB (the largest has {largest / 1e6:.1f} MB)")
        again, seconds = document("map", "publish", regions, URL)
        assert again["objects_sent"] == 0 and again["objects_existing"] == objects, again
        print(f"published again: nothing sent, {seconds:.1f} s")

        def fetch_all(target):
            fetched, seconds = document("map", "fetch", URL, "place", "--out", target)
            assert fetched["objects_fetched"] == objects and fetched["manifest"] == split["manifest"], fetched
            files = sorted(p.relative_to(regions) for p in regions.rglob("*") if p.is_file())
            assert files == sorted(p.relative_to(target) for p in target.rglob("*") if p.is_file()), files
            assert all((regions / f).read_bytes() == (target / f).read_bytes() for f in files)
            return seconds

        print(f"fetched {objects} objects in {fetch_all(back):.1f} s: byte-identical")

        for what, times in (("SlowDown", 3), ("breaks", 1)):
            proxy.set_fault(what, times)
            seconds = fetch_all(Path(folder, f"back-{what}"))
            print(f"{what}, {times} times for each read: fetched in {seconds:.1f} s ({proxy.refused} refusals)")
            proxy.set_fault(what, times)
            # The URL must not hold the fault's name: the program takes a reply with such a word for an error.
            target_url = f"s3://{BUCKET}/through {times}"
            sent, seconds = document("map", "publish", regions, target_url)
            assert sent["objects_sent"] == objects, sent
            print(f"{what}, {times} times for each request: published in {seconds:.1f} s ({proxy.refused} refusals)")
            proxy.clear_faults()

        name = split["regions"][0]["sha256"]
        good = (regions / "objects" / name).read_bytes()

        def refused(why, *expected, within=30.0, words=("map", "fetch", URL, "place", "--out", "refused")):
            target = Path(folder, "refused")
            done, seconds = run(*(target if word == "refused" else word for word in words))
            message = " ".join(done.stderr.split())
            assert done.returncode == 1 and all(part in message for part in expected), (why, done.returncode, done.stderr)
            assert not (target / "manifest.json").exists() and not (target / "objects" / name).exists(), why
            assert seconds < within, (why, seconds)
            print(f"{why}: refused in {seconds:.1f} s\n    {message[:400]}")

        wrong = bytearray(good)
        wrong[len(wrong) // 2] ^= 1
        storage.put_object(Bucket=BUCKET, Key=key(f"objects/{name}"), Body=bytes(wrong))
        refused("a changed byte", name)
        storage.put_object(Bucket=BUCKET, Key=key(f"objects/{name}"), Body=good[:-1])
        refused("a truncated object", name)
        again, _ = document("map", "publish", regions, URL)
        assert again["objects_sent"] == 1, again
        print("published again: the truncated object was sent again")
        storage.delete_object(Bucket=BUCKET, Key=key(f"objects/{name}"))
        refused("a missing object", "veiloc map publish")
        pointer = storage.get_object(Bucket=BUCKET, Key=key("place.json"))["Body"].read()
        storage.put_object(Bucket=BUCKET, Key=key("place.json"),
                           Body=json.dumps({"version": 1, "map": "place", "manifest": "../" * 20 + "0000"}).encode())
        refused("an invalid pointer", "no pointer")
        storage.put_object(Bucket=BUCKET, Key=key("place.json"), Body=pointer)

        publish = ("map", "publish", regions, f"s3://{BUCKET}/new")
        for what, remedy in (("InvalidAccessKeyId", "AWS_ACCESS_KEY_ID"), ("SignatureDoesNotMatch", "AWS_SECRET_ACCESS_KEY"),
                             ("ExpiredToken", "AWS_SESSION_TOKEN"), ("AccessDenied", "may"),
                             ("AuthorizationHeaderMalformed", "AWS_REGION")):
            proxy.set_fault(what)
            refused(f"reading: {what}", f"s3://{BUCKET}/", remedy, within=3.0)
            proxy.set_fault(what, methods=("PUT", "POST"))
            refused(f"writing: {what}", f"s3://{BUCKET}/", remedy, within=3.0, words=publish)
        proxy.clear_faults()
        document("map", "publish", regions, URL)
        worker(program, settings | {"PATH": os.environ["PATH"]}, proxy, folder)
        refused("reading: no such bucket", "s3://nowhere/x/", "bucket", within=3.0,
                words=("map", "fetch", "s3://nowhere/x", "place", "--out", "refused"))
        refused("writing: no such bucket", "s3://nowhere/x/", "bucket", within=3.0,
                words=("map", "publish", regions, "s3://nowhere/x"))
        settings["AWS_ENDPOINT"] = "http://127.0.0.1:9"
        refused("no server", f"s3://{BUCKET}/", "AWS_ENDPOINT", within=60.0)
        del settings["AWS_ACCESS_KEY_ID"], settings["AWS_SECRET_ACCESS_KEY"]
        settings["AWS_METADATA_ENDPOINT"] = "http://127.0.0.1:9"
        refused("no credentials", f"s3://{BUCKET}/", "AWS_ACCESS_KEY_ID", within=60.0)
    server.stop()
    print("all checks passed")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("map")
    parser.add_argument("--images", type=int, default=20, help="most images of a region")
    args = parser.parse_args()
    main(args.program, args.map, args.images)
