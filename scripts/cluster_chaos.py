#!/usr/bin/env python3
"""A cluster on loopback that loses its parts under load, and what becomes of the queries.

    VEILOC_DATA=../shared/data scripts/cluster_chaos.py [--veiloc PROGRAM] [--workers 3] [--seconds 20] [--rate R]
    scripts/cluster_chaos.py --rendered --seconds 2      # without data: a rendered room

Three nats-server, workers that hold every region with a thread each, a gateway; clients at a steady rate (--rate; default: half
of what the cluster was measured to answer) that send the same bytes again when told to or when a connection breaks. Then, one
after the other: a worker is killed (kill -9) and started again; all but a third of the workers are, at once; a worker is asked
to end (SIGTERM); one NATS node is killed, with whoever was connected to it, then another one; the gateway is killed and started
again; a smaller map is published; the first one is again, and a worker is killed while the others take it. Prints of each the
p99 before, during and after, checks that equal bytes got equal poses as long as the map was the same, and prints, last,
`accepted N lost N`: queries that were sent whole and never answered. Fails when one is lost.
"""

import pathlib
import sys
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent / "cluster"))

from machines import Clients, Cluster, Part, ask, counter, header, percentile, place, row, wait_for  # noqa: E402
from machines import arguments  # noqa: E402

CLIENTS = 6


def measured_rate(cluster, queries, seconds):
    """Answers a second when nobody pauses."""
    clients = Clients(cluster.port, queries, CLIENTS)
    time.sleep(seconds)
    done = clients.stop()
    return len(done.times) / seconds


class Scenes:
    """What happens, and what the clients saw of it."""

    def __init__(self, cluster, clients, seconds):
        self.cluster, self.clients, self.seconds = cluster, clients, seconds
        header("what happens", "p99 before, ms", "during", "after", "longest", "asked in all")

    def play(self, what, act):
        begin = time.monotonic()
        time.sleep(self.seconds)
        acted = time.monotonic()
        act()
        # What it set going takes a moment to be over.
        over = max(time.monotonic(), acted + self.seconds / 2)
        time.sleep(over - time.monotonic() + self.seconds)
        end = time.monotonic()
        before, during, after = (self.clients.between(*span) for span in ((begin, acted), (acted, over), (over, end)))
        p99 = [f"{percentile(times, 0.99):.0f}" for times in (before, during, after)]
        row(what, *p99, f"{max(before + during + after):.0f}", len(before) + len(during) + len(after))


def main():
    parser = arguments(__doc__)
    parser.add_argument("--rendered", action="store_true", help="a rendered room, which needs no data")
    parser.add_argument("--workers", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=20.0, help="of each part of each scene")
    parser.add_argument("--rate", type=float, help="queries a second")
    args = parser.parse_args()
    town = place(args)
    if args.workers < 2:
        parser.error("--workers: a region that one worker alone holds is lost with it")
    cluster = Cluster(town, town.map, workers=args.workers, images=town.images)
    print(f"{len(cluster.nats)} nats-server, {len(cluster.workers)} workers with {cluster.regions} regions each\n", flush=True)
    rate = args.rate or 0.5 * measured_rate(cluster, town.queries, 5)
    print(f"{rate:.1f} queries a second of {len(town.queries)} images by {CLIENTS} clients\n", flush=True)
    clients = Clients(cluster.port, town.queries, CLIENTS, rate)
    scenes = Scenes(cluster, clients, args.seconds)
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
    scenes.play("a worker is killed", lambda: restarted(workers[:1]))
    scenes.play(f"{len(several)} are at once", lambda: restarted(several))
    scenes.play("a worker is told to end", lambda: restarted(workers[1:2], Part.stop))
    scenes.play("a NATS node is killed", lambda: restarted(nats[:1]))
    scenes.play("another one is", lambda: restarted(nats[1:2]))
    scenes.play("the gateway is killed", lambda: (cluster.gateway.kill(), cluster.gateway.start()))
    same = {number: len(poses) for number, poses in clients.poses.items()}

    def publish(map_file, meanwhile=lambda: None):
        before = counter(ask(cluster.admin, "/metrics")[1].decode(), "veiloc_cluster_manifests_total")
        cluster.publish(map_file)
        meanwhile()
        taken = lambda: counter(ask(cluster.admin, "/metrics")[1].decode(), "veiloc_cluster_manifests_total") > before
        wait_for(taken, "the new manifest")

    scenes.play("a smaller map is published", lambda: publish(town.smaller))
    scenes.play("the first one is again, and a worker killed", lambda: publish(town.map, lambda: restarted(workers[-1:])))
    clients.stop()
    metrics = ask(cluster.admin, "/metrics")[1].decode()
    dropped = sum(counter(ask(worker.admin, "/metrics")[1].decode(), "veiloc_cancelled_total", f'when="{when}"')
                  for worker in workers for when in ("waiting", "working"))
    codes = cluster.stop()
    print(f"\nstatuses: {clients.statuses}; sent again: {clients.retried}")
    hedges = counter(metrics, "veiloc_cluster_hedges_total")
    print(f"messages sent again by the gateway before an answer, since it was started: {hedges:.0f}; "
          f"dropped by workers as answered by others: {dropped:.0f}")
    print(f"queries with one pose each as long as the map was the same: {sum(n == 1 for n in same.values())} of {len(same)}")
    print(f"exit codes of gateway and workers at the end: {codes}")
    print(f"accepted {clients.accepted} lost {clients.lost}")
    sys.exit(clients.lost > 0 or any(codes) or any(n != 1 for n in same.values()))


if __name__ == "__main__":
    main()
