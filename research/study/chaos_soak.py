#!/usr/bin/env python3
"""Soak test: all known attacks on the service at once, while well-behaved clients send queries.

    research/study/chaos_soak.py --data $VEILOC_DATA --minutes 30 --csv docs/results/service/chaos.csv \\
        --load-csv docs/results/service/chaos-load.csv [--load 0.7] [--veiloc PROGRAM]

Clients with a token send queries at 70 % (--load) of the measured capacity, first alone, then together with: clients that send byte
by byte or nothing, wrong tokens, a flood of large queries from one token, replaced map files every few seconds (by rename, copied
over, corrupt, truncated), replaced token files (valid, empty, deleted for a moment), a log whose reader pauses or whose disk is full,
and SIGTERM with a restart. The last line is `accepted N lost N`: a query is accepted when its whole body was sent on an
accepted connection, and lost when it then got no answer. The script fails when a query is lost.

Loopback only, standard library only.
"""

import pathlib
import random
import socket
import sys
import threading
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent / "service"))

import http.client  # noqa: E402
import os  # noqa: E402
import signal  # noqa: E402
import shutil  # noqa: E402

from common import LOCALIZE, PROTOBUF, RedKitchen, Server, arguments, ask, free_port, token, wait_for  # noqa: E402
from places import write_csv  # noqa: E402

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
        self.threads = [threading.Thread(target=self.run, args=(i,), daemon=True) for i in range(CLIENTS)]
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


def main():
    parser = arguments(__doc__)
    parser.add_argument("--minutes", type=float, default=30)
    parser.add_argument("--load", type=float, default=0.7,
                        help="rate of the well-behaved clients, as a share of the capacity; next to one flooding token the fair share is 0.5")
    parser.add_argument("--seed", type=int, default=0, help="seed of the random events")
    parser.add_argument("--csv", type=pathlib.Path, help="CSV of the client within its rate")
    parser.add_argument("--load-csv", type=pathlib.Path, help="CSV of the disturbances")
    args = parser.parse_args()
    service = Service(RedKitchen(args.veiloc))
    wait_for(lambda: ask(service.port, "/readyz")[0] == 200, "readiness")
    rate = args.load * capacity(service)
    quiet = WellBehavedClients(service, rate)
    time.sleep(min(60.0, args.minutes * 20))
    quiet.end()
    memory, descriptors = service.facts()
    chaos = Chaos(service, random.Random(args.seed))
    clients = WellBehavedClients(service, rate)
    time.sleep(args.minutes * 60)
    chaos.end()
    clients.end()
    if not service.server.alive():
        sys.exit(f"the service died: {service.server.process.returncode}")
    time.sleep(8)
    after_memory, after_descriptors = service.facts()
    clients_rows = []
    for name, one in (("alone", quiet), ("in the chaos", clients)):
        other = ", ".join(f"{status}: {n}" for status, n in sorted(one.got.items()) if status != 200)
        broken = sum(one.broken.values())
        clients_rows.append([name, one.accepted + broken, one.got.get(200, 0), other or 0, broken, f"{one.percentile(0.5):.0f}",
                             f"{one.percentile(0.99):.0f}"])  # fmt: skip
    load = [[what, n] for what, n in sorted(chaos.counts.items())]
    for row in [*clients_rows, *sorted(clients.broken.items()), *load]:
        print(*row, sep="  ")
    write_csv(args.csv, ["client within its rate", "sent", "answered", "other", "not taken", "p50 (ms)", "p99 (ms)"], clients_rows)
    write_csv(args.load_csv, ["disturbance", "times"], load)
    print(f"memory {memory:.0f} MB before and {after_memory:.0f} MB after, descriptors {descriptors} and {after_descriptors}")
    exits = ", ".join(map(str, service.exits)) or "none"
    print(f"\n{rate:.1f} queries per second ({100 * args.load:.0f} % of capacity); exit codes of {service.restarts} restarts: {exits}")
    service.server.stop(signal.SIGTERM)
    print(f"accepted {clients.accepted} lost {clients.lost}")
    sys.exit(1 if clients.lost else 0)


if __name__ == "__main__":
    main()
