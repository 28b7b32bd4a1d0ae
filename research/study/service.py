"""Tables of docs/results/service.md: load, times, invalid requests, `kill -9`, disturbances of one service. Loopback only."""

import csv
import hashlib
import http.client
import json
import math
import os
import pathlib
import queue
import random
import re
import secrets
import shutil
import signal
import socket
import statistics
import struct
import subprocess
import sys
import threading
import time

from study import cluster  # noqa: F401  its commands are of this page
from study.common import command, names_of
from study.loopback import (
    LOCALIZE, PROTOBUF, Program, RedKitchen, Server, ask, camera_of, data_folder, free_port, percentile, pose, token, wait_for,
)  # fmt: skip


def kitchen(run):
    """RedKitchen's map and queries; the data is found by this process and its children."""
    if run.data:
        os.environ["VEILOC_DATA"] = str(run.data)
    return RedKitchen(run.veiloc)


def is_ready(server):
    wait_for(lambda: ask(server.admin, "/readyz")[0] == 200, "readiness")


@command("service/load.csv", connections="1,4,16,64")
def load(run):
    """Requests a second and times of answers, by number of connections.

    The example `load` of veiloc-service sends a `dcl` query of 1024 keypoints to RedKitchen's map: one worker a core, a queue of 32, and a
    fixed number of requests for each row. Every connection sends its next query when the last one is answered. Client and service share
    the cores."""
    scene, program = kitchen(run), run.example("veiloc-service", "load")
    query = scene.work / "query"
    query.write_bytes(scene.query)
    server = Server(scene, "--queue", "32", "--log", "error")
    is_ready(server)
    words = [program, f"127.0.0.1:{server.port}", "place", query, *run.connections.split(",")]
    printed = subprocess.run(words, check=True, capture_output=True, text=True).stdout
    server.stop()
    table = run.table("service/load.csv", "connections", "requests", "answered", "refused with 503", "other", "lost", "answers a second",
                      "p50 (ms)", "p95 (ms)", "p99 (ms)", "slowest refusal (ms)")  # fmt: skip
    for cells in list(csv.reader(printed.splitlines()))[1:]:
        table.add(cells)


@command("service/overhead.csv", needs="h2load", seconds=(15, "duration of each row"))
def overhead(run):
    """Queries per second, beside the rate that the workers would reach if only the library took time.

    Sends one sealed query of 1024 keypoints repeatedly, with enough clients to keep all workers busy: HTTP/1.1, plain and with TLS.
    *Library* is the service's own measurement of retrieval, matching and pose (`veiloc_stage_seconds`). The number of workers over its
    mean is an upper bound of the rate; *share* is the fraction of it that is reached. Needs `h2load` (Debian: nghttp2-client) and
    `openssl`. Client and service share the machine's cores, so the share is a lower bound."""
    scene, workers = kitchen(run), os.cpu_count()
    table = run.table("service/overhead.csv", "connection", "answers a second", "library, a query (ms)",
                      f"answers a second {workers} workers could give", "share")  # fmt: skip
    query, cert, key = scene.work / "query", scene.work / "cert.pem", scene.work / "key.pem"
    query.write_bytes(scene.query)
    subprocess.run(["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes",
                    "-keyout", key, "-out", cert, "-days", "1", "-subj", "/CN=localhost"], check=True, capture_output=True)  # fmt: skip
    for tls in (False, True):
        server = Server(scene, "--log", "error", *(["--cert", cert, "--key", key] if tls else []))
        is_ready(server)
        url = f"{'https' if tls else 'http'}://127.0.0.1:{server.port}{LOCALIZE}"
        before = library(server)
        words = ["h2load", "--warm-up-time=2", "-D", run.seconds, "-c", 2 * workers, "-m", 1, "-d", query, "-H",
                 f"content-type: {PROTOBUF}", "--h1", url]  # fmt: skip
        output = subprocess.run(list(map(str, words)), capture_output=True, text=True, check=True).stdout
        rate = float(re.search(r"finished in [\d.]+\w*, ([\d.]+) req/s", output)[1])
        good, others = re.search(r"status codes: (\d+) 2xx, (.*)", output).groups()
        after = library(server)
        if not int(good):
            sys.exit(f"no answer: {others}")
        each = (after[0] - before[0]) / (after[1] - before[1])
        table.add(["TLS" if tls else "plain", f"{rate:.1f}", f"{1e3 * each:.1f}", f"{workers / each:.1f}", f"{rate * each / workers:.2f}"])
        server.stop()


STAGES = ("retrieve", "match", "pose")


def library(server):
    """Seconds spent in the library so far, and number of localizations."""
    text = ask(server.admin, "/metrics")[1].decode()
    read = lambda what, stage: float(re.search(rf'veiloc_stage_seconds_{what}{{stage="{stage}"}} (\S+)', text)[1])
    return sum(read("sum", stage) for stage in STAGES), read("count", "pose")


@command(requests=(5000, "requests to each service"))
def tokens(run):
    """Cost of the token lookup: time of a request with 1 token in the file, and with 30 000 (median and p99, milliseconds).

    One loopback connection, requests one after the other. The token is the last one of the file. The two services take turns, so that
    other load on the machine affects both."""
    scene, services = kitchen(run), []
    for count in (1, 30_000):
        names = [secrets.token_hex(32) for _ in range(count)]
        file = scene.work / f"tokens-{count}"
        file.write_text("".join(f"t{i} {hashlib.sha256(name.encode()).hexdigest()}\n" for i, name in enumerate(names)))
        server = Server(scene, "--tokens", file)
        services.append((count, server, http.client.HTTPConnection("127.0.0.1", server.port), names[-1], []))
    for i in range(run.requests):
        for _, _, connection, name, times in services:
            begun = time.perf_counter()
            connection.request("GET", "/v1/maps", headers={"authorization": f"Bearer {name}"})
            response = connection.getresponse()
            response.read()
            assert response.status == 200, response.status
            if i >= run.requests // 10:
                times.append(1e3 * (time.perf_counter() - begun))
    for count, server, _, _, times in services:
        print(count, f"{statistics.median(times):.2f}", f"{statistics.quantiles(times, n=100)[98]:.2f}")
        server.stop()


OTHER_PLACES = {"redkitchen": "hololens-office", "herzjesu": "redkitchen"}
QUANTA = [0, 0.25, 0.5, 1]


@command("service/answer-times.csv", places=["redkitchen"], images=(20, "queries of each place"), rounds=(2, "answers to each query"),
         max_keypoints=(0, "keypoints of a query (default: as many as the profile wants)"),
         costs=("", "also write the processor time of each query there, milliseconds, for research/notes/scale_model.py --costs"))  # fmt: skip
def answer_times(run):
    """Whether the time of an answer shows if a query was localized (rule L12).

    Queries of a place and as many images of another place are sent to the service, each several times in random order, one after the
    other: with the camera as calibrated, and with an unknown focal length. Measured is the processor time of each answer, which other
    programs disturb little; with a quantum it is rounded up to whole quanta, as the service does with the time since receipt. AUC:
    probability that an answer without a trusted pose comes later than one with a trusted pose; equal times count half."""
    table = run.table("service/answer-times.csv", "place", "focal length", "found", "not found", "found, median (ms)",
                      "not found, median (ms)", "found, p99 (ms)", "not found, p99 (ms)", "AUC",
                      *(f"AUC, quantum {quantum} s" for quantum in QUANTA[1:]))  # fmt: skip
    costs = {}
    for name in run.places:
        scene = Program(run.veiloc)
        own, away, scene.map = run.place(name), run.place(OTHER_PLACES[name]), scene.work / "place.vmap"
        scene.run("map", "build", *run.posed(name), "--list", own / "map.txt", "-o", scene.map)
        scene.run("map", "profile", scene.map, "-o", scene.work / "profile")
        server = Server(scene, "--log", "error")
        is_ready(server)
        for focal in ("calibrated", "unknown"):
            queries = [query for folder in (own, away) for query in sealed(run, scene, folder, focal)]
            found, taken = times(server, queries, run.rounds)
            yes, no = ([ms for i, all_ms in taken.items() if found[i] == outcome for ms in all_ms] for outcome in (True, False))
            for outcome in (True, False):
                least = [round(min(all_ms), 2) for i, all_ms in taken.items() if found[i] == outcome]
                costs[f"{name}, {focal}, {'found' if outcome else 'not found'}"] = sorted(least)
            whole = lambda values, quantum: [math.ceil(ms / 1e3 / quantum) if quantum else ms for ms in values]
            table.add([
                name, focal, len(yes) // run.rounds, len(no) // run.rounds,
                *(f"{percentile(sorted(answers), q):.0f}" for q in (0.5, 0.99) for answers in (yes, no)),
                *(f"{auc(whole(yes, quantum), whole(no, quantum)):.2f}" for quantum in QUANTA),
            ])  # fmt: skip
        server.stop()
    if run.costs:
        pathlib.Path(run.costs).write_text(json.dumps(costs, indent=1))


def sealed(run, scene, folder, focal):
    """Sealed queries of images of a place, evenly spaced."""
    names = names_of(folder / "query.txt")
    count = min(run.images, len(names))
    limit, out, queries = ["--max-keypoints", run.max_keypoints] if run.max_keypoints else [], scene.work / "query.vquery", []
    for i in range(count):
        scene.run("seal", folder / "images" / names[i * len(names) // count], "--camera", camera_of(folder), "--focal-known", focal,
                  "--profile", scene.work / "profile", *limit, "-o", out)  # fmt: skip
        queries.append(out.read_bytes())
        out.unlink()
    return queries


def processor_ms(process):
    """Processor time of all threads so far."""
    tasks = pathlib.Path(f"/proc/{process}/task").iterdir()
    return sum(int((task / "schedstat").read_text().split()[0]) for task in tasks) / 1e6


def times(server, queries, rounds):
    """Whether each query was localized with trust, and the milliseconds of its answers."""
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=600)
    order = [i for i in range(len(queries)) for _ in range(rounds)]
    random.Random(1).shuffle(order)
    found, taken = {}, {i: [] for i in range(len(queries))}
    for i in order:
        before = processor_ms(server.process.pid)
        connection.request("POST", LOCALIZE, queries[i], {"content-type": PROTOBUF, "accept": "application/json"})
        found[i] = json.loads(connection.getresponse().read()).get("state") == "trusted"
        taken[i].append(processor_ms(server.process.pid) - before)
    connection.close()
    return found, taken


def auc(first, second):
    """Probability that a value of `second` is larger than one of `first`; equal values count half."""
    larger = sum((b > a) + 0.5 * (b == a) for a in first for b in second)
    return larger / (len(first) * len(second))


RIG = LOCALIZE + "-rig"
INTERVAL = 0.25
FLOODING = 24


def session(query, frames=8):
    """A session of equal images, each 0.1 map units beside the one before."""
    parts = [
        struct.pack("<9d", 1, 0, 0, 0, 0.1 * i, 0, 0, 0.5 if i else 0, 0.01 if i else 0)
        + struct.pack("<I", len(query)) + query
        for i in range(frames)
    ]  # fmt: skip
    return b"vqrig1\n" + bytes([frames]) + b"".join(parts)


class Flood:
    """Clients that send as fast as they are answered, of one token."""

    def __init__(self, server, path, body):
        self.counts, self.stop, self.lock = {}, threading.Event(), threading.Lock()
        self.threads = [threading.Thread(target=self.send, args=(server, path, body), daemon=True) for _ in range(FLOODING)]
        for thread in self.threads if body else []:
            thread.start()

    def send(self, server, path, body):
        while not self.stop.is_set():
            status, _, _ = ask(server.port, path, body, "greedy", timeout=70)
            with self.lock:
                self.counts[status] = self.counts.get(status, 0) + 1
            if status in (429, 503):
                time.sleep(0.2)

    def refused(self):
        return sum(count for status, count in self.counts.items() if status not in (200, 422))


def phone(scene, server, seconds):
    """Sends without waiting for answers; returns the milliseconds of all answers, and the number of queries."""
    times, lock, threads = [], threading.Lock(), []

    def one():
        started = time.monotonic()
        status, _, _ = ask(server.port, LOCALIZE, scene.query, "phone", timeout=70)
        if status == 200:
            with lock:
                times.append((time.monotonic() - started) * 1e3)

    for _ in range(int(seconds / INTERVAL)):
        threads.append(threading.Thread(target=one, daemon=True))
        threads[-1].start()
        time.sleep(INTERVAL)
    for thread in threads:
        thread.join(70)
    return sorted(times), len(threads)


@command("service/greedy-token.csv", needs="a build of an earlier commit (--veiloc OLD,NEW --names before,now)",
         names=([], "of the builds"), seconds=(30.0, "of each flood"))  # fmt: skip
def greedy_token(run):
    """One token sends what costs most, at its rate limit of 20 queries per second, while another token behaves like a phone.

    Floods: nothing; queries of 4096 rows that are found; images of another place with an unknown focal length, which are not found;
    sessions of eight such images. The phone sends four queries per second, without retries. At the end: are queries of clients that
    disconnect at once still computed?"""
    builds = str(run.veiloc).split(",")
    table = run.table("service/greedy-token.csv", "build", "flood", "phone's queries", "answered", "p50 (ms)", "p99 (ms)", "slowest (ms)",
                      "flood: answered", "flood: refused")  # fmt: skip
    if run.data:
        os.environ["VEILOC_DATA"] = str(run.data)
    scenes = [RedKitchen(build) for build in builds]
    for flood in ("nothing", "4096 rows, found", "another place", "sessions of another place"):
        for name, scene in zip(run.names or map(str, range(1, 1 + len(builds))), scenes, strict=True):
            server = Server(scene, "--tokens", scene.tokens(["greedy", "phone", "ops!"]), rate=20)
            body = {"nothing": None, "4096 rows, found": scene.large}.get(flood, scene.away)
            if "sessions" in flood:
                body = session(body)
            sender = Flood(server, RIG if "sessions" in flood else LOCALIZE, body)
            time.sleep(2 if body else 0)
            answers, sent = phone(scene, server, run.seconds)
            sender.stop.set()
            quantiles = [f"{percentile(answers, share):.0f}" if answers else "" for share in (0.5, 0.99, 1)]
            table.add([name, flood, sent, len(answers), *quantiles, sender.counts.get(200, 0) + sender.counts.get(422, 0), sender.refused()])
            server.stop(signal.SIGKILL)
    server = Server(scene, "--tokens", scene.tokens(["greedy", "phone", "ops!"]))
    disconnected(scene, server)
    server.stop()


def disconnected(scene, server):
    """Clients that disconnect at once, after a query and the start of a next request: is the query still computed?"""
    def done():
        text = ask(server.port, "/metrics", user="ops")[1].decode()
        return sum(float(line.split()[-1]) for line in text.splitlines() if line.startswith("veiloc_localizations_total"))

    wait_for(lambda: "veiloc_workers_busy 0" in ask(server.port, "/metrics", user="ops")[1].decode(), "idle workers")
    before = done()
    head = f"POST {LOCALIZE} HTTP/1.1\r\nhost: x\r\nauthorization: Bearer {token('phone')}\r\n" \
           f"content-type: {PROTOBUF}\r\ncontent-length: {len(scene.large)}\r\n\r\n"
    for _ in range(12):
        stream = socket.create_connection(("127.0.0.1", server.port))
        stream.sendall(head.encode() + scene.large + b"GET /healthz HTTP/1.1\r\nhost: x\r\n\r\n")
        stream.close()
    time.sleep(1)
    wait_for(lambda: "veiloc_workers_busy 0" in ask(server.port, "/metrics", user="ops")[1].decode(), "idle workers")
    print(f"12 queries of clients that disconnected: {int(done() - before)} computed")


TOKEN = token("phone")


def started(scene, path, port=None):
    return Server(scene, "--tokens", scene.tokens(["phone"]), maps=["--map", f"place={path}"], port=port, quantum=True)


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


def check(condition, what):
    if not condition:
        sys.exit(f"violated: {what}")


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


@command("service/bad-requests.csv", "service/killed.csv", requests=(1000, "requests during which the server is killed five times"),
         kills=(60, "killed map writes, and killed reloads"), seed=(0, "seed of the kill times"))  # fmt: skip
def robustness(run):
    """Invalid requests, and `kill -9` of map writes, reloads and requests.

    Processes are killed by SIGKILL, so they cannot clean up. The state is checked afterwards; fails when an invariant is violated."""
    scene, rng = kitchen(run), random.Random(run.seed)
    table = run.table("service/bad-requests.csv", "sent", "answered", "after (s)")
    for cells in bad_requests(scene):
        table.add(cells)
    table = run.table("service/killed.csv", "`kill -9` during", "kills", "answered or found: old map", "answered or found: new map",
                      "interrupted", "wrong or lost")  # fmt: skip
    table.add(killed_writes(scene, run.kills, rng))
    table.add(killed_reloads(scene, run.kills, rng))
    table.add(killed_requests(scene, run.requests, rng))


def removed(scene):
    """The images that the smaller map lacks."""
    return names_of(data_folder() / "redkitchen/map.txt")[1::2]


def bad_requests(scene):
    server = started(scene, scene.map)
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
    server.stop()
    return rows


def killed_writes(scene, kills, rng):
    """Kills `map remove` at a random time; the file must be the old or the new map. Returns a row of the table, whose `wrong or lost`
    is 0 because the checks end the script otherwise."""
    live = scene.work / "live.vmap"
    old, new = scene.map.read_bytes(), scene.smaller.read_bytes()
    command = [scene.veiloc, "--quiet", "map", "remove", live, *removed(scene)]
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
        server = started(scene, path)
        poses[path] = pose(localize(server.port, scene.query)[1])
        server.stop(signal.SIGKILL)
    check(poses[scene.map] != poses[scene.smaller], "the two maps give different poses")
    outcomes = {"old": 0, "new": 0, "none": 0}
    for i in range(kills):
        target = (scene.smaller, scene.map)[i % 2]
        before = (scene.map, scene.smaller)[i % 2]
        server = started(scene, live)
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
        server.stop(signal.SIGKILL)
        asking.join()
        if got and got[0][0] == 200:
            answer = pose(got[0][1])
            check(answer in poses.values(), "the answer is from neither map")
            outcomes["new" if answer == poses[target] else "old"] += 1
            check(answer in (poses[target], poses[before]), "the answer is from neither map")
        else:
            outcomes["none"] += 1
        server = started(scene, live)
        status, body = localize(server.port, scene.query)
        check(status == 200 and pose(body) == poses[target], "a restarted server answers with the new map")
        server.stop(signal.SIGKILL)
    return ["hot reload with a query under way", kills, outcomes["old"], outcomes["new"], outcomes["none"], 0]


def killed_requests(scene, requests, rng):
    """Requests of eight clients while the server is killed and restarted; the clients retry broken requests."""
    server = started(scene, scene.map)
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
        server.stop(signal.SIGKILL)
        server = started(scene, scene.map, port)
        restarts += 1
    for thread in threads:
        thread.join()
    check(not wrong, f"{len(wrong)} answers differ from the first")
    check(count["answered"] == requests, "every request is answered in the end")
    server.stop()
    print(f"{requests} requests of 8 clients: {count['refused']} refused by the service")
    return [f"{requests} requests of 8 clients, one map", restarts, "", count["answered"], count["broken"], len(wrong)]


CLIENTS = 4


class Service:
    """The service on a fixed port, which can be restarted; a thread reads its log and can be paused."""

    def __init__(self, scene):
        self.scene, self.port = scene, free_port()
        self.live = scene.work / "live.vmap"
        shutil.copyfile(scene.map, self.live)
        self.tokens = scene.tokens(["phone", "greedy", "ops!"])
        # A thread that changes files holds this lock, and so does a start of the service, which needs valid files.
        self.files = threading.Lock()
        self.reading = threading.Event()
        self.reading.set()
        self.restarts, self.exits, self.restarting = 0, [], False
        self.start()

    def start(self, full_disk=False):
        if full_disk:
            with open("/dev/full", "w") as full:
                self.serve(full)
            return
        read, write = os.pipe()
        self.serve(write)
        os.close(write)
        threading.Thread(target=self.read_log, args=(read,), daemon=True).start()

    def serve(self, stderr):
        self.server = Server(self.scene, "--tokens", self.tokens, "--request-timeout", "10", "--drain-delay", "1",
                             maps=["--map", f"place={self.live}"], stderr=stderr, port=self.port)

    def read_log(self, pipe):
        while True:
            self.reading.wait()
            try:
                if not os.read(pipe, 65536):
                    break
            except OSError:
                break
        os.close(pipe)

    def restart(self, full_disk):
        self.restarting = True
        self.exits.append(self.server.stop(timeout=60))
        self.restarts += 1
        self.start(full_disk)
        self.restarting = False

    def facts(self):
        """Resident memory in MB and open descriptors."""
        process = pathlib.Path(f"/proc/{self.server.process.pid}")
        memory = next(l for l in (process / "status").read_text().splitlines() if l.startswith("VmRSS"))
        return int(memory.split()[1]) / 1024, len(list((process / "fd").iterdir()))


class WellBehavedClients:
    """Well-behaved clients: each sends a query at a fixed rate."""

    def __init__(self, service, rate):
        self.service, self.every = service, CLIENTS / rate
        self.lock, self.times, self.got = threading.Lock(), [], {}
        self.accepted = self.lost = 0
        self.broken = {}
        self.stop = threading.Event()
        self.threads = [threading.Thread(target=self.run, args=(i,), daemon=True) for i in range(FLOODING)]
        for thread in self.threads:
            thread.start()

    def run(self, i):
        connection, due = None, time.monotonic() + i * self.every / CLIENTS
        headers = {"authorization": f"Bearer {token('phone')}", "content-type": PROTOBUF}
        while not self.stop.is_set():
            time.sleep(max(0.0, due - time.monotonic()))
            started, sent, status, error = time.monotonic(), False, None, None
            fresh, restarting = connection is None, self.service.restarting
            try:
                connection = connection or http.client.HTTPConnection("127.0.0.1", self.service.port, timeout=60)
                connection.request("POST", LOCALIZE, self.service.scene.query, headers)
                sent = True
                response = connection.getresponse()
                response.read()
                status = response.status
                if response.getheader("connection", "") == "close":
                    connection.close()
                    connection = None
            except (OSError, http.client.HTTPException) as why:
                error = why
                if connection:
                    connection.close()
                connection = None
            with self.lock:
                if status is not None:
                    self.accepted += 1
                    self.got[status] = self.got.get(status, 0) + 1
                    if status == 200:
                        self.times.append((time.monotonic() - started) * 1e3)
                elif sent and (fresh or time.monotonic() - started > 0.5):
                    # The query was accepted and never answered: this must not happen.
                    self.accepted += 1
                    self.lost += 1
                else:
                    cause = self.cause(error, fresh, restarting or self.service.restarting)
                    self.broken[cause] = self.broken.get(cause, 0) + 1
            due = max(due + self.every, time.monotonic())

    @staticmethod
    def cause(error, fresh, restarting):
        """Why a query was not accepted. The client can retry it."""
        when = "in a restart" if restarting else "while it ran"
        if isinstance(error, ConnectionRefusedError):
            return f"connection refused, {when}"
        if not fresh:
            return f"the service had closed an idle connection, {when}"
        return f"connection closed before the whole query was sent ({type(error).__name__}), {when}"

    def end(self):
        self.stop.set()
        for thread in self.threads:
            thread.join(90)
        self.times.sort()

    def percentile(self, share):
        return self.times[round((len(self.times) - 1) * share)] if self.times else float("nan")


class Chaos:
    """The attacks, each in its own threads, until `end`."""

    def __init__(self, service, rng):
        self.service, self.rng = service, rng
        self.stop, self.counts, self.lock = threading.Event(), {}, threading.Lock()
        jobs = [self.slow] * 20 + [self.wrong] * 2 + [self.flood] * 20 + [self.maps, self.tokens, self.log, self.stops]
        self.threads = [threading.Thread(target=job, daemon=True) for job in jobs]
        for thread in self.threads:
            thread.start()

    def count(self, what, n=1):
        with self.lock:
            self.counts[what] = self.counts.get(what, 0) + n

    def pause(self, seconds):
        return self.stop.wait(seconds)

    def slow(self):
        head = f"POST {LOCALIZE} HTTP/1.1\r\nhost: x\r\nauthorization: Bearer {token('phone')}\r\ncontent-length: 100000\r\n"
        while not self.pause(self.rng.uniform(0, 2)):
            try:
                stream = socket.create_connection(("127.0.0.1", self.service.port), timeout=30)
                data = b"" if self.rng.random() < 0.3 else (head + "\r\n" * self.rng.choice([0, 1])).encode()
                for byte in data:
                    stream.sendall(bytes([byte]))
                    if self.pause(0.02):
                        break
                stream.recv(4096)
                stream.close()
            except OSError:
                pass
            self.count("slow or silent clients")

    def wrong(self):
        while not self.pause(0.02):
            self.count(f"wrong token: {ask(self.service.port, LOCALIZE, b'x', 'unknown', timeout=20)[0] or 'no connection'}")

    def flood(self):
        while not self.pause(self.rng.uniform(0.5, 1.5)):
            status = ask(self.service.port, LOCALIZE, self.service.scene.large, "greedy", timeout=60)[0]
            self.count(f"flood of large queries: {'answered' if status == 200 else status or 'no connection'}")

    def maps(self):
        live, scene = self.service.live, self.service.scene
        old, new = scene.map.read_bytes(), scene.smaller.read_bytes()
        fresh = scene.work / "fresh.vmap"
        while not self.pause(3):
            kind = self.rng.choice(["renamed", "copied over", "corrupt", "truncated"])
            whole = self.rng.choice([old, new])
            data = whole
            if kind == "corrupt":
                data = bytearray(whole)
                data[self.rng.randrange(len(data))] ^= 0x40
            elif kind == "truncated":
                data = whole[:self.rng.randrange(len(whole))]
            with self.service.files:
                if kind == "copied over":
                    live.write_bytes(data)
                else:
                    fresh.write_bytes(data)
                    fresh.replace(live)
            self.count(f"map file {'replaced by rename' if kind == 'renamed' else kind}")

    def tokens(self):
        path, good = self.service.tokens, self.service.tokens.read_text()
        while not self.pause(5):
            kind = self.rng.choice(["valid", "empty", "deleted"])
            with self.service.files:
                if kind == "empty":
                    path.write_text("")
                elif kind == "deleted":
                    path.unlink()
            self.count(f"tokens {kind}")
            self.pause(3)
            # Replaced by rename, so that the service never reads half of the file.
            fresh = path.with_suffix(".new")
            fresh.write_text(good)
            with self.service.files:
                fresh.replace(path)

    def log(self):
        while not self.pause(20):
            self.service.reading.clear()
            self.count("log reader stopped")
            self.pause(10)
            self.service.reading.set()

    def stops(self):
        while not self.pause(45):
            path, scene = self.service.tokens, self.service.scene
            with self.service.files:
                scene.tokens(["phone", "greedy", "ops!"], path.with_suffix(".start")).replace(path)
                shutil.copyfile(scene.map, scene.work / "start.vmap")
                (scene.work / "start.vmap").replace(self.service.live)
                full_disk = self.rng.random() < 0.3
                self.service.restart(full_disk)
            self.count("SIGTERM and restart" + (" with the log on a full disk" if full_disk else ""))

    def end(self):
        self.stop.set()
        self.service.reading.set()
        for thread in self.threads:
            thread.join(90)


def capacity(service):
    """Capacity: answers per second of connections that keep all workers busy."""
    clients = WellBehavedClients(service, 10_000)
    time.sleep(8)
    clients.end()
    return clients.got.get(200, 0) / 8


@command("service/chaos.csv", "service/chaos-load.csv", minutes=30.0, seed=(0, "seed of the random events"),
         load=(0.7, "rate of the clients, as a share of the capacity; next to one flooding token the fair share is 0.5"))  # fmt: skip
def chaos(run):
    """Soak test: all known attacks on the service at once, while well-behaved clients send queries.

    Clients with a token send queries at a share of the measured capacity, first alone, then together with: clients that send byte by byte
    or nothing, wrong tokens, a flood of large queries from one token, replaced map files every few seconds (by rename, copied over,
    corrupt, truncated), replaced token files (valid, empty, deleted for a moment), a log whose reader pauses or whose disk is full, and
    SIGTERM with a restart. The last line is `accepted N lost N`: a query is accepted when its whole body was sent on an accepted
    connection, and lost when it then got no answer. Fails when a query is lost."""
    service = Service(kitchen(run))
    wait_for(lambda: ask(service.port, "/readyz")[0] == 200, "readiness")
    rate = run.load * capacity(service)
    quiet = WellBehavedClients(service, rate)
    time.sleep(min(60.0, run.minutes * 20))
    quiet.end()
    memory, descriptors = service.facts()
    disturbances = Chaos(service, random.Random(run.seed))
    clients = WellBehavedClients(service, rate)
    time.sleep(run.minutes * 60)
    disturbances.end()
    clients.end()
    if not service.server.alive():
        sys.exit(f"the service died: {service.server.process.returncode}")
    time.sleep(8)
    after_memory, after_descriptors = service.facts()
    table = run.table("service/chaos.csv", "client within its rate", "sent", "answered", "other", "not taken", "p50 (ms)", "p99 (ms)")
    for name, one in (("alone", quiet), ("in the chaos", clients)):
        other = ", ".join(f"{status}: {n}" for status, n in sorted(one.got.items()) if status != 200)
        broken = sum(one.broken.values())
        table.add([name, one.accepted + broken, one.got.get(200, 0), other or 0, broken, f"{one.percentile(0.5):.0f}",
                   f"{one.percentile(0.99):.0f}"])  # fmt: skip
    for cause in sorted(clients.broken.items()):
        print(*cause, sep="  ")
    table = run.table("service/chaos-load.csv", "disturbance", "times")
    for what in sorted(disturbances.counts.items()):
        table.add(what)
    print(f"memory {memory:.0f} MB before and {after_memory:.0f} MB after, descriptors {descriptors} and {after_descriptors}")
    exits = ", ".join(map(str, service.exits)) or "none"
    print(f"\n{rate:.1f} queries per second ({100 * run.load:.0f} % of capacity); exit codes of {service.restarts} restarts: {exits}")
    service.server.stop(signal.SIGTERM)
    print(f"accepted {clients.accepted} lost {clients.lost}")
    return clients.lost > 0
