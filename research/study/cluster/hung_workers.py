#!/usr/bin/env python3
"""Workers that hang, that are slow, and that are all gone: what queries of a cluster see.

    VEILOC_DATA=../shared/data research/study/cluster/hung_workers.py [--veiloc PROGRAM] [--workers 2 4] [--seconds 40] [--rate 3]
    research/study/cluster/hung_workers.py --rendered --seconds 4 --workers 2      # without data: a rendered room

For each number of workers (one thread each, all regions), queries are sent at a steady rate, each on a connection of its own and once
(no retries), in these phases:

- *before*: all workers run;
- *stopped*: one worker is suspended (SIGSTOP) for --seconds, then continued;
- *slow*: one worker runs one tenth of the time (SIGSTOP and SIGCONT in turns), as with a strict limit of its processor;
- *all stopped*, without queries: the time until the gateway's /readyz is 503, and 200 again after they continue.

Prints answered queries and their times. *Put out after* is the time from the signal until the gateway counts the worker as `out`
(`-`: never). Runs against any build, to compare versions. Fails when a query is not answered with 200, 409 or 422, or the gateway
stays ready without workers.
"""

import http.client
import pathlib
import signal
import statistics
import sys
import threading
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))

from machines import LOCALIZE, Cluster, arguments, ask, header, load_scene, percentile, row, run_in_turns  # noqa: E402
from common import PROTOBUF  # noqa: E402

OUT = 'veiloc_cluster_members{map="place",state="out"} '


class Stream:
    """Queries at a steady rate, whatever the answers do."""

    def __init__(self, port, queries, rate):
        self.port, self.queries, self.rate = port, queries, rate
        self.results, self.threads, self.stopping = [], [], threading.Event()
        self.thread = threading.Thread(target=self.run)
        self.thread.start()

    def run(self):
        begun, number = time.monotonic(), 0
        while not self.stopping.is_set():
            thread = threading.Thread(target=self.send, args=(self.queries[number % len(self.queries)],))
            thread.start()
            self.threads.append(thread)
            number += 1
            time.sleep(max(0.0, begun + number / self.rate - time.monotonic()))

    def send(self, query):
        begun = time.monotonic()
        try:
            connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=60)
            connection.request("POST", LOCALIZE, query, {"content-type": PROTOBUF})
            response = connection.getresponse()
            response.read()
            status = response.status
            connection.close()
        except (OSError, http.client.HTTPException) as error:
            status = type(error).__name__
        self.results.append((status, 1e3 * (time.monotonic() - begun)))

    def stop(self):
        """Waits for all answers; returns how many there are, and the sorted times of the good ones, milliseconds."""
        self.stopping.set()
        for thread in [self.thread, *self.threads]:
            thread.join()
        return len(self.results), sorted(took for status, took in self.results if status in (200, 409, 422))


def gateway_value(cluster, start):
    lines = ask(cluster.admin, "/metrics")[1].decode().splitlines()
    return next((float(line.removeprefix(start)) for line in lines if line.startswith(start)), 0.0)


def seconds_until(condition, most):
    begun = time.monotonic()
    while time.monotonic() < begun + most:
        if condition():
            return time.monotonic() - begun
        time.sleep(0.02)
    return None


def phase(cluster, scene, args, name, act=lambda: "-"):
    """Sends queries while `act` runs; prints a row; returns the number of queries without an answer."""
    stream = Stream(cluster.port, scene.queries, args.rate)
    noticed = act()
    sent, times = stream.stop()
    late = sum(took > 2000 for took in times)
    row(f"{len(cluster.workers)}", name, f"{len(times)} of {sent}", f"{statistics.median(times or [0]):.0f}",
        f"{percentile(times, 0.99):.0f}", f"{max(times, default=0):.0f}", late, noticed)
    return sent - len(times)


def main():
    parser = arguments(__doc__)
    parser.add_argument("--rendered", action="store_true", help="a rendered room, which needs no data")
    parser.add_argument("--workers", type=int, nargs="+", default=[2, 4])
    parser.add_argument("--seconds", type=float, default=40.0, help="seconds of each phase")
    parser.add_argument("--rate", type=float, default=3.0, help="queries per second")
    args = parser.parse_args()
    scene = load_scene(args)
    header("workers", "phase", "answered", "p50, ms", "p99, ms", "longest", "over 2 s", "put out after, s")
    lost, readiness = 0, []
    for workers in args.workers:
        cluster = Cluster(scene, scene.map, workers=workers, images=scene.images, nats=1)
        time.sleep(1)
        victim = cluster.workers[0]

        def stopped():
            victim.process.send_signal(signal.SIGSTOP)
            begun = time.monotonic()
            noticed = seconds_until(lambda: gateway_value(cluster, OUT) > 0, args.seconds)
            time.sleep(max(0.0, begun + args.seconds - time.monotonic()))
            victim.process.send_signal(signal.SIGCONT)
            return "-" if noticed is None else f"{noticed:.2f}"

        def slow():
            run_in_turns(victim.process, args.seconds)
            return "-"

        def calm():
            time.sleep(min(args.seconds, 20.0))
            return "-"

        try:
            lost += phase(cluster, scene, args, "before", calm)
            lost += phase(cluster, scene, args, "stopped", stopped)
            time.sleep(2)
            lost += phase(cluster, scene, args, "slow", slow)
            ready = lambda status: lambda: ask(cluster.admin, "/readyz")[0] == status
            for worker in cluster.workers:
                worker.process.send_signal(signal.SIGSTOP)
            gone = seconds_until(ready(503), 15)
            for worker in cluster.workers:
                worker.process.send_signal(signal.SIGCONT)
            back = seconds_until(ready(200), 15)
            readiness.append((workers, gone, back))
        finally:
            for worker in cluster.workers:
                worker.process.send_signal(signal.SIGCONT)
            cluster.stop()
    print()
    header("workers", "not ready after all were stopped, s", "ready after they continued, s")
    for workers, gone, back in readiness:
        row(workers, *("-" if took is None else f"{took:.2f}" for took in (gone, back)))
    print(f"\nqueries without an answer: {lost}")
    sys.exit(lost > 0 or any(gone is None or back is None for _, gone, back in readiness))


if __name__ == "__main__":
    main()
