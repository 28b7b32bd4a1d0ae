"""`veiloc serve` and clusters on loopback, their clients, and maps and queries for them.

Loopback only, standard library only; a cluster needs nats-server (Debian: nats-server). The maps are cached in the target folder, and
built again when the program cannot open them.
"""

import argparse
import atexit
import hashlib
import http.client
import json
import os
import pathlib
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time

from study.common import ROOT, names_of

MAP = "place"
PROTOBUF = "application/x-protobuf"
LOCALIZE = f"/v1/maps/{MAP}/localize"


def target_dir():
    metadata = subprocess.run(["cargo", "metadata", "--format-version", "1", "--no-deps"], cwd=ROOT, check=True,
                              capture_output=True, text=True).stdout
    return pathlib.Path(json.loads(metadata)["target_directory"])


def data_folder():
    data = os.environ.get("VEILOC_DATA")
    if not data:
        sys.exit("set VEILOC_DATA to the folder of the real images")
    return pathlib.Path(data).resolve()


def camera_of(folder):
    """The first camera of a place, with commas."""
    lines = (folder / "posed" / "cameras.txt").read_text().splitlines()
    return ",".join(next(line for line in lines if line and not line.startswith("#")).split()[1:])


class Program:
    """The program and a temporary folder."""

    def __init__(self, veiloc=None):
        target = target_dir()
        self.target, self.veiloc = target, pathlib.Path(veiloc or target / "release" / "veiloc").resolve()
        if not self.veiloc.exists():
            sys.exit("build the program first: cargo build --release -p veiloc-cli")
        self.work = pathlib.Path(tempfile.mkdtemp(prefix="veiloc-service-"))

    def run(self, *arguments):
        subprocess.run([self.veiloc, "--quiet", *map(str, arguments)], check=True, stdout=subprocess.DEVNULL)

    def can_use(self, made, cached_map):
        """Whether a cache is complete, `made` being its last file, and the program opens its map."""
        if not made.exists():
            return False
        return subprocess.run([self.veiloc, "map", "info", cached_map], capture_output=True).returncode == 0

    def tokens(self, names, path=None):
        """Writes a token file; the token of `phone` is `token-of-phone`. Names with `!` are operators."""
        path = path or self.work / "tokens"
        lines = []
        for name in names:
            role = " operator" if name.endswith("!") else ""
            name = name.rstrip("!")
            lines.append(f"{name} {hashlib.sha256(token(name).encode()).hexdigest()}{role}\n")
        path.write_text("".join(lines))
        return path

    def options(self):
        """All options of this build."""
        help_text = subprocess.run([self.veiloc, "serve", "--help"], check=True, capture_output=True, text=True).stdout
        return set(re.findall(r"--[a-z-]+", help_text))


class RedKitchen(Program):
    """Maps of RedKitchen, and sealed queries of an image that is not in them, and of another place."""

    def __init__(self, veiloc=None):
        super().__init__(veiloc)
        cache = self.target / "service-place"
        self.map, self.smaller, away = cache / "place.vmap", cache / "smaller.vmap", cache / "away.vquery"
        if not self.can_use(away, self.map):
            self.make(cache)
        self.query, self.large, self.away = ((cache / f"{name}.vquery").read_bytes() for name in ("query", "large", "away"))

    def make(self, cache):
        cache.mkdir(parents=True, exist_ok=True)
        kitchen = data_folder() / "redkitchen"
        names = names_of(kitchen / "map.txt")
        self.run("map", "build", "--posed", kitchen / "posed", "--images", kitchen / "images", "--list",
                 kitchen / "map.txt", "--query-keypoints", "4096", "-o", self.map)
        # Without every second image: another file with the same vocabulary and profile.
        self.run("map", "remove", self.map, *names[1::2], "-o", self.smaller)
        self.run("map", "profile", self.map, "-o", cache / "profile")
        camera = camera_of(kitchen)
        photo = kitchen / "images" / names_of(kitchen / "query.txt")[0]
        for name, keypoints in (("query.vquery", 1024), ("large.vquery", 4096)):
            self.run("seal", photo, "--camera", camera, "--profile", cache / "profile", "--scheme", "dcl",
                     "--max-keypoints", str(keypoints), "-o", cache / name)
        # An image of another place.
        away = data_folder() / "herzjesu"
        self.run("seal", away / "images" / names_of(away / "query.txt")[0], "--camera", "unknown", "--profile",
                 cache / "profile", "--scheme", "dcl", "--max-keypoints", "512", "-o", cache / "away.vquery")


class RenderedScene(Program):
    """The map of the rendered demo scene, and a sealed query of an image that is not in it. Needs no data."""

    def __init__(self, veiloc=None):
        super().__init__(veiloc)
        cache = self.target / "service-rendered"
        self.map, query = cache / "place.vmap", cache / "query.vquery"
        if not self.can_use(query, self.map):
            cache.mkdir(parents=True, exist_ok=True)
            self.run("demo", "--out", cache)
            camera = camera_of(cache)
            self.run("map", "profile", self.map, "-o", cache / "profile")
            self.run("seal", cache / "images" / "query-00.png", "--camera", camera, "--profile", cache / "profile",
                     "-o", query)
        self.query = query.read_bytes()


def token(name):
    return f"token-of-{name}"


class Server:
    """`veiloc serve` on a free loopback port; the log goes to a file unless `stderr` is given."""

    def __init__(self, scene, *more, maps=None, stderr=None, port=None, rate=1000000, quantum=False):
        self.port = port or free_port()
        self.known = scene.options()
        self.admin = free_port() if "--admin-listen" in self.known else None
        maps = maps if maps is not None else ["--map", f"place={scene.map}"]
        command = [scene.veiloc, "serve", *maps, "--listen", f"127.0.0.1:{self.port}", "--rate", str(rate)]
        command += ["--admin-listen", f"127.0.0.1:{self.admin}"] if self.admin else []
        if "--answer-quantum" in self.known and not quantum:
            command += ["--answer-quantum", "0"]
        self.log_path = scene.work / f"server-{self.port}.log"
        self.process = subprocess.Popen([*map(str, command), *map(str, more)], stderr=stderr or open(self.log_path, "w"))
        wait_for(lambda: self.process.poll() is not None or connects(self.port), "the service")
        if self.process.poll() is not None:
            sys.exit(f"the service ended with {self.process.returncode}: {self.log()}")

    def log(self):
        return self.log_path.read_text(errors="replace") if self.log_path.exists() else ""

    def alive(self):
        return self.process.poll() is None

    def stop(self, how=signal.SIGTERM, timeout=60):
        """Sends a signal; returns the exit code, or None when the process had to be killed."""
        if self.alive():
            self.process.send_signal(how)
        try:
            return self.process.wait(timeout)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
            return None


def free_port():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return listener.getsockname()[1]


def connects(port):
    try:
        socket.create_connection(("127.0.0.1", port), timeout=1).close()
        return True
    except OSError:
        return False


def wait_for(condition, what, timeout=60.0, pause=0.01):
    deadline = time.monotonic() + timeout
    while not condition():
        if time.monotonic() > deadline:
            sys.exit(f"timeout while waiting for {what}")
        time.sleep(pause)


def ask(port, path="/healthz", body=None, user=None, timeout=20.0, method=None):
    """Sends one request on a new connection; returns status, body and headers, with status None when there was no answer."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=timeout)
    headers = {"authorization": f"Bearer {token(user)}"} if user else {}
    if body is not None:
        headers["content-type"] = PROTOBUF
    try:
        connection.request(method or ("GET" if body is None else "POST"), path, body, headers)
        response = connection.getresponse()
        return response.status, response.read(), dict(response.getheaders())
    except (OSError, http.client.HTTPException):
        return None, b"", {}
    finally:
        connection.close()


def pose(body):
    """The answer without its times; it must be equal for equal queries."""
    answer = json.loads(body)
    answer.pop("ms", None)
    return json.dumps(answer, sort_keys=True)


def in_threads(count, work):
    """Starts `work(i)` in `count` threads; returns the threads."""
    threads = [threading.Thread(target=work, args=(i,), daemon=True) for i in range(count)]
    for thread in threads:
        thread.start()
    return threads


def arguments(doc):
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--veiloc", help="the program to test (default: the release build of this repository)")
    parser.add_argument("--data", action=DataFolder, help="folder of the real photographs (default: VEILOC_DATA)")
    return parser


class DataFolder(argparse.Action):
    """Sets VEILOC_DATA, which this process and its children read."""

    def __call__(self, parser, options, value, name=None):
        os.environ["VEILOC_DATA"] = value
        setattr(options, self.dest, value)


class Part:
    """A process of the cluster; its log is a file."""

    def __init__(self, cluster, name, command, ready, wait=True):
        self.cluster, self.name, self.command, self.ready = cluster, name, [str(word) for word in command], ready
        self.log = cluster.work / f"{name}.log"
        self.process = None
        # No process is left running, however the script ends.
        atexit.register(self.end)
        self.start(wait)

    def end(self):
        if self.process and self.process.poll() is None:
            self.kill()

    def start(self, wait=True):
        self.process = subprocess.Popen(self.command, stdout=open(self.log, "a"), stderr=subprocess.STDOUT)
        if wait:
            self.wait()

    def wait(self):
        wait_for(lambda: self.process.poll() is not None or self.ready(), f"{self.name} ({self.log})")
        if self.process.poll() is not None:
            sys.exit(f"{self.name} ended: {self.log.read_text()[-2000:]}")

    def kill(self):
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()

    def stop(self, timeout=60):
        """Sends SIGTERM; returns the exit code, or None when the process had to be killed."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
        try:
            return self.process.wait(timeout)
        except subprocess.TimeoutExpired:
            self.kill()
            return None


class Cluster:
    """All processes; the gateway's address stays the same after a restart."""

    def __init__(self, program, map_file, workers=2, images=None, nats=3, threads=1, queue=32, gateway=True, more=()):
        if not shutil.which("nats-server"):
            sys.exit("nats-server is missing: apt-get install nats-server")
        self.program, self.work, self.images = program, program.work, images
        self.store = self.work / "store"
        self.threads, self.queue = threads, queue
        self.publish(map_file)
        self.nats = self.bus(nats)
        self.workers = [self.worker(i) for i in range(workers)]
        self.gateway = self.serve(more) if gateway else None

    def bus(self, count):
        """Starts `count` NATS nodes, each with routes to all."""
        ports, routes = [free_port() for _ in range(count)], [free_port() for _ in range(count)]
        self.servers = ",".join(f"nats://127.0.0.1:{port}" for port in ports)
        settings = self.work / "nats.conf"
        settings.write_text("max_payload: 8388608\n")
        nodes = []
        for i in range(count):
            command = ["nats-server", "--config", settings, "--addr", "127.0.0.1", "--port", ports[i], "--name", f"nats-{i}"]
            if count > 1:
                command += ["--cluster_name", "veiloc", "--cluster", f"nats://127.0.0.1:{routes[i]}", "--routes",
                            ",".join(f"nats-route://127.0.0.1:{route}" for route in routes)]
            nodes.append(Part(self, f"nats-{i}", command, lambda port=ports[i]: connects(port)))
        return nodes

    def publish(self, map_file):
        """Splits a map into regions and publishes them."""
        regions = self.work / "regions"
        images = ["--images", self.images] if self.images else []
        self.program.run("map", "split", map_file, "--name", MAP, "--out", regions, *images)
        self.program.run("map", "publish", regions, self.store)
        self.regions = len(json.loads((regions / "manifest.json").read_text())["regions"])

    def worker(self, i, more=(), wait=True):
        admin = free_port()
        command = [self.program.veiloc, "worker", "--nats", self.servers, "--store", self.store, "--cache",
                   self.work / f"cache-{i}", "--map", MAP, "--workers", self.threads, "--queue", self.queue,
                   "--admin-listen", f"127.0.0.1:{admin}", "--watch", 1, *(more or ["--drain-after", 3])]
        part = Part(self, f"worker-{i}", command, lambda: ask(admin, "/readyz")[0] == 200, wait)
        part.admin = admin
        return part

    def serve(self, more=(), name="gateway", rate=1000000):
        port, admin = free_port(), free_port()
        if name == "gateway":
            self.port, self.admin = port, admin
        command = [self.program.veiloc, "serve", "--cluster", self.servers, "--cluster-map", MAP, "--store", self.store,
                   "--cache", self.work / f"cache-{name}", "--listen", f"127.0.0.1:{port}", "--admin-listen",
                   f"127.0.0.1:{admin}", "--rate", rate, "--watch", 1, "--drain-delay", 0, "--answer-quantum", 0, *more]
        part = Part(self, name, command, lambda: ask(admin, "/readyz")[0] == 200)
        part.port, part.admin = port, admin
        return part

    def stop(self):
        """Stops all processes; returns the exit codes of gateway and workers."""
        parts = [self.gateway, *self.workers] if self.gateway else self.workers
        codes = [part.stop() for part in parts if part.process.poll() is None]
        for server in self.nats:
            server.stop(5)
        return codes


class Clients:
    """Well-behaved clients of one address. Each sends its queries in turn, and retries the same bytes after a busy answer or a
    broken connection, until `timeout`. A query is accepted when its whole body was sent on an accepted connection; an accepted
    query is lost when it never gets an answer (200, or a refusal because no pose was found)."""

    def __init__(self, port, queries, count, rate=None, timeout=60.0):
        self.port, self.queries, self.timeout = port, queries, timeout
        self.every = count / rate if rate else 0.0
        self.lock, self.stopping = threading.Lock(), threading.Event()
        self.accepted = self.lost = self.retried = self.wrong = 0
        self.times, self.statuses = [], {}
        self.poses = {}
        self.threads = [threading.Thread(target=self.run, args=(i, count), daemon=True) for i in range(count)]
        for thread in self.threads:
            thread.start()

    def run(self, i, count):
        connection, due, turn = None, time.monotonic() + i * self.every / count, i
        while not self.stopping.is_set():
            if self.every:
                time.sleep(max(0.0, due - time.monotonic()))
                due += self.every
            number = turn % len(self.queries)
            turn += count
            started, sent, answered, tries = time.monotonic(), False, False, 0
            while not answered and time.monotonic() - started < self.timeout:
                tries += 1
                status, body, taken, connection, pause = self.send(connection, self.queries[number])
                sent = sent or taken
                answered = status in (200, 409, 422)
                with self.lock:
                    self.statuses[status] = self.statuses.get(status, 0) + 1
                if not answered:
                    time.sleep(pause)
            with self.lock:
                self.retried += tries - 1
                if sent:
                    self.accepted += 1
                    self.lost += not answered
                    self.times.append((started, time.monotonic() - started))
                if answered:
                    self.compare(number, status, body)
        if connection:
            connection.close()

    def send(self, connection, query):
        taken = False
        try:
            connection = connection or http.client.HTTPConnection("127.0.0.1", self.port, timeout=self.timeout)
            connection.request("POST", LOCALIZE, query, {"content-type": PROTOBUF})
            taken = True
            response = connection.getresponse()
            body = response.read()
            pause = float(response.getheader("retry-after") or 0.2)
            if response.getheader("connection", "") == "close":
                connection.close()
                connection = None
            return response.status, body, taken, connection, pause
        except (OSError, http.client.HTTPException):
            if connection:
                connection.close()
            return None, b"", taken, None, 0.1

    def compare(self, number, status, body):
        """Collects the answers of each query; equal queries must get equal poses from all workers."""
        value = json.loads(body)["cam_from_world"]["q"] if status == 200 else status
        self.poses.setdefault(number, set()).add(str(value))

    def stop(self):
        self.stopping.set()
        for thread in self.threads:
            thread.join(self.timeout + 5)
        return self

    def between(self, begin, end):
        """Sorted times of the queries that started in this interval, milliseconds."""
        with self.lock:
            return sorted(1e3 * took for started, took in self.times if begin <= started < end)


def run_in_turns(process, seconds, period=0.5, share=0.1):
    """Lets a process run for a share of the time, as a strict limit of its processor does."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        process.send_signal(signal.SIGSTOP)
        time.sleep(period * (1 - share))
        process.send_signal(signal.SIGCONT)
        time.sleep(period * share)


def percentile(times, share):
    return times[min(len(times) - 1, int(share * len(times)))] if times else float("nan")


class ClusterScene(Program):
    """A map, a smaller map with the same profile, and sealed queries of images in neither; built once and cached."""

    def __init__(self, veiloc, cache, count):
        super().__init__(veiloc)
        cache = self.target / cache
        self.map, self.smaller = cache / "place.vmap", cache / "smaller.vmap"
        if not self.can_use(cache / "done", self.map):
            cache.mkdir(parents=True, exist_ok=True)
            self.make(cache, count)
            (cache / "done").touch()
        self.queries = [path.read_bytes() for path in sorted(cache.glob("*.vquery"))]

    def seal(self, cache, images, folder):
        self.run("map", "profile", self.map, "-o", cache / "profile")
        camera = camera_of(folder)
        for i, image in enumerate(images):
            self.run("seal", image, "--camera", camera, "--profile", cache / "profile", "--max-keypoints", 1024, "-o",
                     cache / f"{i:02}.vquery")


class Kitchen(ClusterScene):
    """RedKitchen: 83 images, in regions of 30."""

    images, whole = 30, 1000

    def __init__(self, veiloc):
        super().__init__(veiloc, "cluster-kitchen", 12)

    def make(self, cache, count):
        kitchen = data_folder() / "redkitchen"
        names = names_of(kitchen / "map.txt")
        self.run("map", "build", "--posed", kitchen / "posed", "--images", kitchen / "images", "--list",
                 kitchen / "map.txt", "-o", self.map)
        self.run("map", "remove", self.map, *names[1::2], "-o", self.smaller)
        images = [kitchen / "images" / name for name in names_of(kitchen / "query.txt")[:count]]
        self.seal(cache, images, kitchen)


class Rendered(ClusterScene):
    """A rendered room: 24 images, in regions of 8. It builds much faster than the demo."""

    images, whole = 8, 1000

    def __init__(self, veiloc):
        super().__init__(veiloc, "cluster-room", 4)

    def make(self, cache, count):
        room = cache / "room"
        # Removes files of an interrupted run.
        shutil.rmtree(room, ignore_errors=True)
        self.run("synth", "city", "--rooms", 1, "--map-views", 24, "--query-views", count, "--width", 480, "--out", room)
        names = names_of(room / "map.txt")
        self.run("map", "build", "--posed", room / "posed", "--images", room / "images", "--list", room / "map.txt",
                 "--max-keypoints", 1024, "-o", self.map)
        self.run("map", "remove", self.map, *names[1::2], "-o", self.smaller)
        self.seal(cache, [room / "images" / name for name in names_of(room / "query.txt")], room)


def counter(text, name, labels=""):
    """Value of a metric in the exported text; 0 when it is missing."""
    start = f"{name}{{{labels}}} " if labels else f"{name} "
    return sum(float(line.rsplit(" ", 1)[1]) for line in text.splitlines() if line.startswith(start))
