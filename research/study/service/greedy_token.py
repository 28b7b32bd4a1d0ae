#!/usr/bin/env python3
"""One token sends what costs most, at its rate limit of 20 queries per second, while another token behaves like a phone.

    VEILOC_DATA=../shared/data research/study/service/greedy_token.py [--veiloc PROGRAM] [--csv docs/results/service/greedy-token.csv]

Floods: nothing; queries of 4096 rows that are found; images of another place with an unknown focal length, which are not found;
sessions of eight such images. `--veiloc OLD,NEW --names before,now` compares builds. The phone sends four queries per second, without retries.
"""

import csv
import pathlib
import socket
import struct
import threading
import time

from common import LOCALIZE, PROTOBUF, RedKitchen, Server, arguments, ask, header, row, token, wait_for

RIG = LOCALIZE + "-rig"
INTERVAL = 0.25
CLIENTS = 24
COLUMNS = [
    "build", "flood", "phone's queries", "answered", "p50 (ms)", "p99 (ms)", "slowest (ms)", "flood: answered", "flood: refused",
]  # fmt: skip


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
        self.threads = [threading.Thread(target=self.send, args=(server, path, body), daemon=True) for _ in range(CLIENTS)]
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


def main():
    parser = arguments(__doc__)
    parser.add_argument("--csv", type=pathlib.Path)
    parser.add_argument("--names", default="", help="of the builds")
    parser.add_argument("--seconds", type=float, default=30, help="of each flood")
    args = parser.parse_args()
    builds, rows = (args.veiloc or "").split(","), []
    names = args.names.split(",") if args.names else [str(i + 1) for i in range(len(builds))]
    header(*COLUMNS)
    scenes = [RedKitchen(build or None) for build in builds]
    for flood in ("nothing", "4096 rows, found", "another place", "sessions of another place"):
        for name, scene in zip(names, scenes, strict=True):
            path = scene.tokens(["greedy", "phone", "ops!"])
            server = Server(scene, "--tokens", path, rate=20)
            body = {"nothing": None, "4096 rows, found": scene.large}.get(flood, scene.away)
            if "sessions" in flood:
                body = session(body)
            sender = Flood(server, RIG if "sessions" in flood else LOCALIZE, body)
            time.sleep(2 if body else 0)
            times, sent = phone(scene, server, args.seconds)
            sender.stop.set()
            quantile = lambda share: f"{times[min(len(times) - 1, int(share * len(times)))]:.0f}" if times else ""
            rows.append([
                name, flood, sent, len(times), quantile(0.5), quantile(0.99), quantile(1),
                sender.counts.get(200, 0) + sender.counts.get(422, 0), sender.refused(),
            ])  # fmt: skip
            row(*rows[-1])
            server.process.kill()
            server.process.wait()
    if args.csv:
        with args.csv.open("w", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(COLUMNS)
            writer.writerows(rows)
    scene = scenes[-1]
    server = Server(scene, "--tokens", scene.tokens(["greedy", "phone", "ops!"]))
    disconnected(scene, server)
    server.stop(timeout=60)


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
    header("queries of clients that disconnected", "computed")
    row(12, int(done() - before))


if __name__ == "__main__":
    main()
