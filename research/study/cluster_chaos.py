#!/usr/bin/env python3
"""Fault injection under load: kills processes of a cluster on loopback, and counts lost queries.

    VEILOC_DATA=../shared/data research/study/cluster_chaos.py [--veiloc PROGRAM] [--workers 3] [--seconds 20] [--rate R] [--csv FILE]
    research/study/cluster_chaos.py --rendered --seconds 2      # without data: a rendered room

Starts three nats-server, workers with one thread that serve every region, and a gateway. Clients send queries at a steady rate
(--rate; default: half of the measured capacity) and retry the same bytes after a busy answer or a broken connection. Then, one after
the other: a worker is killed (kill -9) and restarted; two thirds of the workers at once; a worker is stopped (SIGTERM); a worker is
suspended (SIGSTOP) for twice --seconds; a worker runs a tenth of the time; a NATS node
is killed with its connections, then another one; the gateway is killed and restarted; a smaller map is published; the first map is
published again while a worker is killed. Prints the p99 before, during and after each event, and checks that equal queries got equal
poses while the map was the same. The last line is `accepted N lost N`: a lost query was sent completely and never answered. Fails
when a query is lost.
"""

import pathlib
import signal
import sys
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent / "cluster"))
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))

from machines import Clients, Cluster, Part, ask, counter, header, percentile, load_scene, row, wait_for  # noqa: E402
from machines import arguments, run_in_turns  # noqa: E402
from places import write_csv  # noqa: E402

CLIENTS = 6
COLUMNS = ["event", "p99 before (ms)", "p99 during (ms)", "p99 after (ms)", "longest (ms)", "queries"]


def measured_rate(cluster, queries, seconds):
    """Capacity of the cluster: answers per second of clients without pauses."""
    clients = Clients(cluster.port, queries, CLIENTS)
    time.sleep(seconds)
    done = clients.stop()
    return len(done.times) / seconds


class FaultInjection:
    """Runs events, and reports the latencies that the clients saw."""

    def __init__(self, cluster, clients, seconds):
        self.cluster, self.clients, self.seconds, self.rows = cluster, clients, seconds, []
        header(*COLUMNS)

    def inject(self, what, act):
        begin = time.monotonic()
        time.sleep(self.seconds)
        acted = time.monotonic()
        act()
        # The effects of the event last for a moment.
        over = max(time.monotonic(), acted + self.seconds / 2)
        time.sleep(over - time.monotonic() + self.seconds)
        end = time.monotonic()
        before, during, after = (self.clients.between(*span) for span in ((begin, acted), (acted, over), (over, end)))
        p99 = [f"{percentile(times, 0.99):.0f}" for times in (before, during, after)]
        self.rows.append([what, *p99, f"{max(before + during + after):.0f}", len(before) + len(during) + len(after)])
        row(*self.rows[-1])


def main():
    parser = arguments(__doc__)
    parser.add_argument("--rendered", action="store_true", help="a rendered room, which needs no data")
    parser.add_argument("--workers", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=20.0, help="seconds of each phase of an event")
    parser.add_argument("--rate", type=float, help="queries per second")
    parser.add_argument("--csv", type=pathlib.Path, help="also write the table there")
    args = parser.parse_args()
    scene = load_scene(args)
    if args.workers < 2:
        parser.error("--workers: must be at least 2, or regions are lost with the only worker")
    cluster = Cluster(scene, scene.map, workers=args.workers, images=scene.images)
    print(f"{len(cluster.nats)} nats-server, {len(cluster.workers)} workers with {cluster.regions} regions each\n", flush=True)
    rate = args.rate or 0.5 * measured_rate(cluster, scene.queries, 5)
    print(f"{rate:.1f} queries per second of {len(scene.queries)} images by {CLIENTS} clients\n", flush=True)
    clients = Clients(cluster.port, scene.queries, CLIENTS, rate)
    faults = FaultInjection(cluster, clients, args.seconds)
    workers, nats = cluster.workers, cluster.nats

    def restarted(parts, end=Part.kill):
        for part in parts:
            end(part)
        time.sleep(args.seconds / 4)
        for part in parts:
            part.start(wait=False)
        for part in parts:
            part.wait()

    several = workers[:max(1, len(workers) * 2 // 3)]
    faults.inject("a worker is killed", lambda: restarted(workers[:1]))
    faults.inject(f"{len(several)} workers are killed at once", lambda: restarted(several))
    faults.inject("a worker is stopped (SIGTERM)", lambda: restarted(workers[1:2], Part.stop))

    def suspended(part):
        part.process.send_signal(signal.SIGSTOP)
        time.sleep(2 * args.seconds)
        part.process.send_signal(signal.SIGCONT)

    faults.inject("a worker is suspended", lambda: suspended(workers[0]))
    faults.inject("a worker is slow", lambda: run_in_turns(workers[0].process, args.seconds))
    faults.inject("a NATS node is killed", lambda: restarted(nats[:1]))
    faults.inject("another NATS node is killed", lambda: restarted(nats[1:2]))
    faults.inject("the gateway is killed", lambda: (cluster.gateway.kill(), cluster.gateway.start()))
    same = {number: len(poses) for number, poses in clients.poses.items()}

    def publish(map_file, meanwhile=lambda: None):
        before = counter(ask(cluster.admin, "/metrics")[1].decode(), "veiloc_cluster_manifests_total")
        cluster.publish(map_file)
        meanwhile()
        taken = lambda: counter(ask(cluster.admin, "/metrics")[1].decode(), "veiloc_cluster_manifests_total") > before
        wait_for(taken, "the new manifest")

    faults.inject("a smaller map is published", lambda: publish(scene.smaller))
    faults.inject("the first map is published again, and a worker is killed", lambda: publish(scene.map, lambda: restarted(workers[-1:])))
    clients.stop()
    metrics = ask(cluster.admin, "/metrics")[1].decode()
    dropped = sum(counter(ask(worker.admin, "/metrics")[1].decode(), "veiloc_worker_cancellations_total", f'state="{state}"')
                  for worker in workers for state in ("queued", "running"))
    codes = cluster.stop()
    print(f"\nstatuses: {clients.statuses}; retried: {clients.retried}")
    hedges = counter(metrics, "veiloc_cluster_hedges_total")
    print(f"hedged messages of the gateway since its last start: {hedges:.0f}; "
          f"jobs cancelled at workers: {dropped:.0f}")
    print(f"queries with equal poses while the map was the same: {sum(n == 1 for n in same.values())} of {len(same)}")
    print(f"exit codes of gateway and workers: {codes}")
    if args.csv:
        write_csv(args.csv, COLUMNS, faults.rows)
    print(f"accepted {clients.accepted} lost {clients.lost}")
    sys.exit(clients.lost > 0 or any(codes) or any(n != 1 for n in same.values()))


if __name__ == "__main__":
    main()
