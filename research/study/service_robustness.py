#!/usr/bin/env python3
"""Makes the tables of docs/results/service.md about invalid requests and about `kill -9`. Standard library only, loopback only.

    cargo build --release
    research/study/service_robustness.py --data $VEILOC_DATA --csv docs/results/service/bad-requests.csv \\
        --killed-csv docs/results/service/killed.csv [--requests 1000] [--kills 60] [--veiloc PROGRAM]

The map is of RedKitchen; the query image is not in it. Processes are killed by SIGKILL, so they cannot clean up. The script checks
the state afterwards, and exits with 1 when an invariant is violated.
"""

import argparse
import hashlib
import http.client
import json
import os
import pathlib
import queue
import random
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent / "service"))

from common import PROTOBUF, first_words, target_dir  # noqa: E402
from places import write_csv  # noqa: E402

KILLED = ["`kill -9` during", "kills", "answered or found: old map", "answered or found: new map", "interrupted", "wrong or lost"]
TOKEN = "a-token-for-a-test-on-loopback-only"


class RedKitchen:
    """A map, a smaller map to replace it, and a sealed query for both."""

    def __init__(self, veiloc, data, work):
        self.veiloc, self.work = veiloc, work
        kitchen = data / "redkitchen"
        names = first_words(kitchen / "map.txt")
        self.map, self.smaller = work / "place.vmap", work / "smaller.vmap"
        self.run("map", "build", "--posed", kitchen / "posed", "--images", kitchen / "images", "--list",
                 kitchen / "map.txt", "--query-keypoints", "1024", "-o", self.map)
        # Without every second image: another file with the same vocabulary and profile.
        self.removed = names[1::2]
        self.run("map", "remove", self.map, *self.removed, "-o", self.smaller)
        self.run("map", "profile", self.map, "-o", work / "profile")
        camera_lines = (kitchen / "posed" / "cameras.txt").read_text().splitlines()
        camera = ",".join(next(l for l in camera_lines if not l.startswith("#")).split()[1:])
        photo = kitchen / "images" / first_words(kitchen / "query.txt")[0]
        self.run("seal", photo, "--camera", camera, "--profile", work / "profile", "--scheme", "dcl", "-o", work / "query")
        self.query = (work / "query").read_bytes()
        (work / "tokens").write_text(f"phone {hashlib.sha256(TOKEN.encode()).hexdigest()}\n")

    def run(self, *arguments):
        subprocess.run([self.veiloc, "--quiet", *map(str, arguments)], check=True, stdout=subprocess.DEVNULL)


class Server:
    """`veiloc serve` on a free loopback port."""

    def __init__(self, scene, path, port=0, *more):
        self.log = open(scene.work / "server.log", "w+")
        self.process = subprocess.Popen(
            [scene.veiloc, "serve", "--map", f"place={path}", "--listen", f"127.0.0.1:{port}", "--tokens",
             scene.work / "tokens", "--rate", "1000000", *more], stderr=self.log)
        deadline = time.monotonic() + 30
        while not (found := re.search(r"serving.*:(\d+)\n", pathlib.Path(self.log.name).read_text())):
            if self.process.poll() is not None or time.monotonic() > deadline:
                sys.exit("the server did not start:\n" + pathlib.Path(self.log.name).read_text())
            time.sleep(0.005)
        self.port = int(found[1])

    def kill(self, how=signal.SIGKILL):
        self.process.send_signal(how)
        self.process.wait()
        self.log.close()


def localize(port, query, timeout=60):
    """Status and body of one query."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=timeout)
    try:
        headers = {"content-type": PROTOBUF, "authorization": f"Bearer {TOKEN}"}
        connection.request("POST", "/v1/maps/place/localize", query, headers)
        response = connection.getresponse()
        return response.status, response.read()
    finally:
        connection.close()


def pose(body):
    """The answer without its times; it must be equal for equal queries."""
    answer = json.loads(body)
    answer.pop("ms", None)
    return json.dumps(answer, sort_keys=True)


def check(condition, what):
    if not condition:
        sys.exit(f"violated: {what}")


# ---------------------------------------------------------------- requests that must not succeed

def raw(port, chunks, pause=0.0, timeout=60.0):
    """Sends chunks until an answer arrives; returns the status, or how the connection ended, and the time."""
    started = time.monotonic()
    stream = socket.create_connection(("127.0.0.1", port), timeout=timeout)
    stream.setblocking(False)
    answer = b""

    def look():
        nonlocal answer
        try:
            got = stream.recv(1 << 16)
            answer += got
            return True
        except BlockingIOError:
            return False
        except ConnectionError:
            return True

    try:
        for chunk in chunks:
            view = memoryview(chunk)
            while view:
                try:
                    view = view[stream.send(view):]
                except BlockingIOError:
                    time.sleep(0.001)
                except ConnectionError:
                    view = view[:0]
                if look():
                    raise StopIteration
            time.sleep(pause)
    except StopIteration:
        pass
    while not answer and time.monotonic() - started < timeout and not look():
        time.sleep(0.005)
    took = time.monotonic() - started
    stream.close()
    status = re.match(rb"HTTP/1.1 (\d+)", answer)
    problem = re.search(rb"urn:veiloc:problem:([a-z-]+)", answer)
    outcome = f"{status[1].decode()}" if status else "closed without a word"
    return outcome + (f" `{problem[1].decode()}`" if problem else ""), took


def head(length=None, token=TOKEN, kind=PROTOBUF, target="/v1/maps/place/localize", method="POST"):
    lines = [f"{method} {target} HTTP/1.1", "host: localhost"]
    lines += [f"content-type: {kind}"] if kind else []
    lines += [f"authorization: Bearer {token}"] if token else []
    lines += ["transfer-encoding: chunked"] if length is None else [f"content-length: {length}"]
    return ("\r\n".join(lines) + "\r\n\r\n").encode()


def bytewise(data):
    return (data[i:i + 1] for i in range(len(data)))


def endless():
    """A chunked body of 64 MiB."""
    block = b"10000\r\n" + bytes(0x10000) + b"\r\n"
    for _ in range(1024):
        yield block


def bad_requests(scene):
    server = Server(scene, scene.map)
    port, query = server.port, scene.query
    rng = random.Random(0)
    flipped = bytearray(query)
    flipped[len(query) // 2 - 1000] ^= 0x40
    whole = lambda body, **more: [head(len(body), **more) + body]
    table = [
        ("no bytes", whole(b""), 0, "400"),
        ("1000 random bytes", whole(rng.randbytes(1000)), 0, "400"),
        ("a query cut in half", whole(query[:len(query) // 2]), 0, "400"),
        ("a query and four bytes more", whole(query + b"\x7d\x01\x02\x03"), 0, "400"),
        ("one bit of a descriptor turned", whole(bytes(flipped)), 0, None),
        ("half a query, then silence", [head(len(query)) + query[:1000]], 0, "408"),
        ("1 MiB announced and sent", whole(bytes(1 << 20)), 0, "413"),
        ("1 TiB announced", [head(1 << 40) + bytes(1000)], 0, "413"),
        ("64 MiB in chunks, length not announced", [head(), *endless()], 0, "413"),
        ("a length that is no number", [head("many") + query], 0, "400"),
        ("head at one byte a second", bytewise(head(len(query))), 1.0, "408"),
        ("body at one byte a second", [head(len(query)), *bytewise(query[:100])], 1.0, "408"),
        ("no token", whole(query, token=None), 0, "401"),
        ("a wrong token", whole(query, token="guess"), 0, "401"),
        ("no token, 1 MiB", whole(bytes(1 << 20), token=None), 0, "401"),
        ("metrics with a client's token", [head(0, method="GET", target="/metrics")], 0, "403"),
        ("JSON for a query", whole(b"{}", kind="application/json"), 0, "415"),
        ("a map that is not there", whole(query, target="/v1/maps/..%2Fplace/localize"), 0, "404"),
        ("bytes that are no HTTP", [b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03\r\n\r\n"], 0, "400"),
        ("a head of 100 kB", [b"GET /healthz HTTP/1.1\r\nx: " + b"y" * 100_000 + b"\r\n\r\n"], 0, "431"),
    ]
    results = [None] * len(table)

    def one(i):
        results[i] = raw(port, table[i][1], table[i][2])

    threads = [threading.Thread(target=one, args=(i,)) for i in range(len(table))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    rows = [[what, outcome, f"{took:.1f}"] for (what, *_), (outcome, took) in zip(table, results)]
    for (what, _, _, expected), (outcome, took) in zip(table, results):
        print(f"{what}  {outcome}  {took:.1f} s")
        silent = expected in ("408", "431", "400") and outcome.startswith("closed")
        check(expected is None or outcome.startswith(expected) or silent, f"{what}: {outcome}, expected {expected}")
    status, _ = localize(port, query)
    check(status == 200, f"a valid query afterwards got {status}")
    memory = re.search(r"VmHWM:\s+(\d+) kB", pathlib.Path(f"/proc/{server.process.pid}/status").read_text())
    print(f"A valid query afterwards: {status}. Peak memory of the server: {int(memory[1]) / 1024:.0f} MB.")
    server.kill(signal.SIGTERM)
    return rows


# ---------------------------------------------------------------- kill -9

def killed_writes(scene, kills, rng):
    """Kills `map remove` at a random time; the file must be the old or the new map. Returns a row of the table, whose `wrong or lost`
    is 0 because the checks end the script otherwise."""
    live = scene.work / "live.vmap"
    old, new = scene.map.read_bytes(), scene.smaller.read_bytes()
    command = [scene.veiloc, "--quiet", "map", "remove", live, *scene.removed]
    shutil.copyfile(scene.map, live)
    started = time.monotonic()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    took = time.monotonic() - started
    check(live.read_bytes() == new, "equal changes give equal bytes")
    counts = {"old": 0, "new": 0}
    unfinished, successful = 0, 0
    for _ in range(kills):
        shutil.copyfile(scene.map, live)
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        time.sleep(rng.uniform(0, took * 1.05))
        process.kill()
        process.wait()
        now = live.read_bytes()
        check(now in (old, new), "a killed write left half a map")
        counts["new" if now == new else "old"] += 1
        scene.run("map", "info", live)
        left = [p for p in scene.work.iterdir() if p.name.startswith(".") or p.suffix == ".tmp"]
        unfinished += bool(left)
        # Files that the killed write left must not disturb the next write.
        subprocess.run(command if now == old else [scene.veiloc, "--quiet", "map", "info", live], check=True,
                       stdout=subprocess.DEVNULL)
        check(live.read_bytes() == new, "the write after a killed one")
        successful += 1
        for path in left:
            path.unlink(missing_ok=True)
    print(f"a map write ({took:.1f} s): {unfinished} times an unfinished temporary file was left; the next write succeeded {successful} times")
    return ["map write", kills, counts["old"], counts["new"], "", 0]


def killed_reloads(scene, kills, rng):
    """Kills the server at a random time after its map was replaced by rename."""
    live = scene.work / "served.vmap"
    shutil.copyfile(scene.map, live)
    poses = {}
    for path in (scene.map, scene.smaller):
        server = Server(scene, path)
        poses[path] = pose(localize(server.port, scene.query)[1])
        server.kill()
    check(poses[scene.map] != poses[scene.smaller], "the two maps give different poses")
    outcomes = {"old": 0, "new": 0, "none": 0}
    for i in range(kills):
        target = (scene.smaller, scene.map)[i % 2]
        before = (scene.map, scene.smaller)[i % 2]
        server = Server(scene, live)
        fresh = scene.work / "fresh.vmap"
        shutil.copyfile(target, fresh)
        os.replace(fresh, live)
        server.process.send_signal(signal.SIGHUP)
        got = []

        def ask():
            try:
                got.append(localize(server.port, scene.query))
            except OSError:
                pass

        asking = threading.Thread(target=ask)
        asking.start()
        time.sleep(rng.uniform(0, 0.12))
        server.kill()
        asking.join()
        if got and got[0][0] == 200:
            answer = pose(got[0][1])
            check(answer in poses.values(), "the answer is from neither map")
            outcomes["new" if answer == poses[target] else "old"] += 1
            check(answer in (poses[target], poses[before]), "the answer is from neither map")
        else:
            outcomes["none"] += 1
        server = Server(scene, live)
        status, body = localize(server.port, scene.query)
        check(status == 200 and pose(body) == poses[target], "a restarted server answers with the new map")
        server.kill()
    return ["hot reload with a query under way", kills, outcomes["old"], outcomes["new"], outcomes["none"], 0]


def killed_requests(scene, requests, rng):
    """Requests of eight clients while the server is killed and restarted; the clients retry broken requests."""
    server = Server(scene, scene.map)
    port = server.port
    expected = pose(localize(port, scene.query)[1])
    todo = queue.Queue()
    for i in range(requests):
        todo.put(i)
    lock = threading.Lock()
    count = {"answered": 0, "broken": 0, "refused": 0}

    def client():
        while True:
            try:
                job = todo.get_nowait()
            except queue.Empty:
                return
            while True:
                try:
                    status, body = localize(port, scene.query)
                except (OSError, http.client.HTTPException):
                    with lock:
                        count["broken"] += 1
                    time.sleep(0.05)
                    continue
                if status == 200:
                    check_pose(body, job)
                    break
                with lock:
                    count["refused"] += 1
                time.sleep(0.05)

    wrong = []

    def check_pose(body, job):
        with lock:
            count["answered"] += 1
            if pose(body) != expected:
                wrong.append(job)

    threads = [threading.Thread(target=client) for _ in range(8)]
    for thread in threads:
        thread.start()
    restarts = 0
    for share in sorted(rng.uniform(0.05, 0.95) for _ in range(5)):
        while count["answered"] < share * requests:
            time.sleep(0.002)
        server.kill()
        server = Server(scene, scene.map, port)
        restarts += 1
    for thread in threads:
        thread.join()
    check(not wrong, f"{len(wrong)} answers differ from the first")
    check(count["answered"] == requests, "every request is answered in the end")
    server.kill(signal.SIGTERM)
    print(f"{requests} requests of 8 clients: {count['refused']} refused by the service")
    return [f"{requests} requests of 8 clients, one map", restarts, "", count["answered"], count["broken"], len(wrong)]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--veiloc", type=pathlib.Path, help="the program to test (default: the release build of this repository)")
    parser.add_argument("--requests", type=int, default=1000, help="requests during which the server is killed five times")
    parser.add_argument("--kills", type=int, default=60, help="killed map writes, and killed reloads")
    parser.add_argument("--seed", type=int, default=0, help="seed of the kill times")
    parser.add_argument("--data", default=os.environ.get("VEILOC_DATA"), help="folder of the real photographs (default: VEILOC_DATA)")
    parser.add_argument("--csv", type=pathlib.Path, help="CSV of invalid requests")
    parser.add_argument("--killed-csv", type=pathlib.Path, help="CSV of `kill -9`")
    arguments = parser.parse_args()
    data = arguments.data
    if not data:
        sys.exit("set VEILOC_DATA or --data to the folder of the real photographs")
    veiloc = arguments.veiloc or target_dir() / "release" / "veiloc"
    if not veiloc.exists():
        sys.exit("build the program first: cargo build --release")
    rng = random.Random(arguments.seed)
    with tempfile.TemporaryDirectory() as work:
        scene = RedKitchen(veiloc, pathlib.Path(data).resolve(), pathlib.Path(work))
        write_csv(arguments.csv, ["sent", "answered", "after (s)"], bad_requests(scene))
        rows = []
        for row in (killed_writes(scene, arguments.kills, rng), killed_reloads(scene, arguments.kills, rng),
                    killed_requests(scene, arguments.requests, rng)):  # fmt: skip
            print(*row, sep="  ", flush=True)
            rows.append(row)
        write_csv(arguments.killed_csv, KILLED, rows)


if __name__ == "__main__":
    main()
