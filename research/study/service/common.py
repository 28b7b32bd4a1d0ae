"""Shared code of the scenarios in this folder: maps, `veiloc serve`, and clients.

Each scenario reproduces one attack on the service and reports how the service behaves. It runs against any build, to compare
versions:

    scripts/service/stuck_log.py [--veiloc PROGRAM] [--data FOLDER]

Loopback only, standard library only. The maps are cached in the target folder, and built again when the
program cannot open them.
"""

import argparse
import hashlib
import http.client
import json
import os
import pathlib
import re
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time

ROOT = pathlib.Path(__file__).resolve().parents[3]
PROTOBUF = "application/x-protobuf"
LOCALIZE = "/v1/maps/place/localize"


def target_dir():
    metadata = subprocess.run(["cargo", "metadata", "--format-version", "1", "--no-deps"], cwd=ROOT, check=True,
                              capture_output=True, text=True).stdout
    return pathlib.Path(json.loads(metadata)["target_directory"])


def first_words(path):
    lines = path.read_text().splitlines()
    return [line.split()[0] for line in lines if line and not line.startswith("#")]


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
        data = os.environ.get("VEILOC_DATA")
        if not data:
            sys.exit("set VEILOC_DATA or --data to the folder of the real photographs")
        cache.mkdir(parents=True, exist_ok=True)
        kitchen = pathlib.Path(data).resolve() / "redkitchen"
        names = first_words(kitchen / "map.txt")
        self.run("map", "build", "--posed", kitchen / "posed", "--images", kitchen / "images", "--list",
                 kitchen / "map.txt", "--query-keypoints", "4096", "-o", self.map)
        # Without every second image: another file with the same vocabulary and profile.
        self.run("map", "remove", self.map, *names[1::2], "-o", self.smaller)
        self.run("map", "profile", self.map, "-o", cache / "profile")
        camera_lines = (kitchen / "posed" / "cameras.txt").read_text().splitlines()
        camera = ",".join(next(l for l in camera_lines if not l.startswith("#")).split()[1:])
        photo = kitchen / "images" / first_words(kitchen / "query.txt")[0]
        for name, keypoints in (("query.vquery", 1024), ("large.vquery", 4096)):
            self.run("seal", photo, "--camera", camera, "--profile", cache / "profile", "--scheme", "dcl",
                     "--max-keypoints", str(keypoints), "-o", cache / name)
        # An image of another place.
        away = pathlib.Path(data).resolve() / "herzjesu"
        self.run("seal", away / "images" / first_words(away / "query.txt")[0], "--camera", "unknown", "--profile",
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
            camera_lines = (cache / "posed" / "cameras.txt").read_text().splitlines()
            camera = ",".join(next(l for l in camera_lines if not l.startswith("#")).split()[1:])
            self.run("map", "profile", self.map, "-o", cache / "profile")
            self.run("seal", cache / "images" / "query-00.png", "--camera", camera, "--profile", cache / "profile",
                     "-o", query)
        self.query = query.read_bytes()


def token(name):
    return f"token-of-{name}"


class Server:
    """`veiloc serve` on a free loopback port; the log goes to a file unless `stderr` is given."""

    def __init__(self, scene, *more, maps=None, stderr=None, port=None, nofile=None, rate=1000000):
        self.port = port or free_port()
        self.known = scene.options()
        self.admin = free_port() if "--admin-listen" in self.known else None
        maps = maps if maps is not None else ["--map", f"place={scene.map}"]
        command = [scene.veiloc, "serve", *maps, "--listen", f"127.0.0.1:{self.port}", "--rate", str(rate)]
        command += ["--admin-listen", f"127.0.0.1:{self.admin}"] if self.admin else []
        if "--answer-quantum" in self.known and "--answer-quantum" not in more:
            command += ["--answer-quantum", "0"]
        if nofile:
            command = ["sh", "-c", f'ulimit -n {nofile}; exec "$@"', "sh", *command]
        self.log_path = scene.work / f"server-{self.port}.log"
        self.process = subprocess.Popen([*map(str, command), *map(str, more)], stderr=stderr or open(self.log_path, "w"))
        wait_for(lambda: self.process.poll() is not None or connects(self.port), "the service")
        if self.process.poll() is not None:
            raise Ended(self.process.returncode, self.log())

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


class Ended(Exception):
    """The service did not start."""


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


def row(*cells):
    print("| " + " | ".join(str(cell) for cell in cells) + " |", flush=True)


def header(*cells):
    row(*cells)
    print("|" + "---|" * len(cells), flush=True)
