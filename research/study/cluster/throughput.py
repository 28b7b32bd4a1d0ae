#!/usr/bin/env python3
"""Throughput of a cluster with 1, 2, 4 and 10 workers, and its latency overhead against a service without a cluster.

    VEILOC_DATA=../shared/data research/study/cluster/throughput.py [--veiloc PROGRAM] [--seconds 15] [--workers 1 2 4 10]
        [--csv FILE] [--latency-csv FILE] [--json FILE] [--rendered]

*Latency*: one client sends one query after the other through HTTP, gateway and NATS to one worker, and the same queries to
`veiloc serve` with the whole map in memory. *Throughput*: enough clients to keep all workers busy. *Busy threads* is the wall time
that the workers' threads spent localizing (`veiloc_busy_seconds_total`), with waits for a processor; *share* is this over the
machine's processors, and above 1 there are more busy threads than processors. Clients, gateway, NATS and workers share the
machine's cores, so with more workers than cores the throughput cannot grow.
"""

import json
import os
import pathlib
import statistics
import sys
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))

from machines import Clients, Cluster, Server, ask, arguments, counter, header, percentile, load_scene, row, wait_for  # noqa: E402
from places import write_csv  # noqa: E402


def one_by_one(port, queries, seconds):
    """Sorted times of the answers, milliseconds, without the first round of queries."""
    clients = Clients(port, queries, 1)
    time.sleep(seconds)
    return sorted(1e3 * took for _, took in clients.stop().times[len(queries):])


def busy(cluster):
    texts = [ask(worker.admin, "/metrics")[1].decode() for worker in cluster.workers]
    return sum(counter(text, "veiloc_busy_seconds_total") for text in texts)


def histogram_mean(text, name):
    return counter(text, f"{name}_sum") / max(1.0, counter(text, f"{name}_count"))


def main():
    parser = arguments(__doc__)
    parser.add_argument("--rendered", action="store_true", help="a rendered room, which needs no data")
    parser.add_argument("--seconds", type=float, default=15.0, help="duration of each row")
    parser.add_argument("--csv", type=pathlib.Path, help="also write the answers a second there")
    parser.add_argument("--latency-csv", type=pathlib.Path, help="also write the latency there")
    parser.add_argument("--json", metavar="FILE", help="also write the points for research/notes/scale_model.py --check")
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2, 4, 10])
    args = parser.parse_args()
    scene = load_scene(args)

    header("latency", "median, ms", "p95, ms", "median over direct, ms")
    direct = Server(scene, "--workers", 1, maps=["--map", f"place={scene.map}"])
    wait_for(lambda: ask(direct.admin, "/readyz")[0] == 200, "readiness")
    cluster = Cluster(scene, scene.map, workers=1, images=scene.whole)
    # In turns, so that other load on the machine affects both.
    alone, clustered = [], []
    for _ in range(3):
        alone += one_by_one(direct.port, scene.queries, args.seconds / 3)
        clustered += one_by_one(cluster.port, scene.queries, args.seconds / 3)
    direct.stop()
    base, latency = statistics.median(alone), []
    for name, times in (("`veiloc serve`", sorted(alone)), ("gateway, NATS, one worker", sorted(clustered))):
        latency.append([name, f"{statistics.median(times):.1f}", f"{percentile(times, 0.95):.1f}"])
        row(*latency[-1], f"{statistics.median(times) - base:+.1f}")
    if args.latency_csv:
        write_csv(args.latency_csv, ["path", "median (ms)", "p95 (ms)"], latency)
    text = ask(cluster.admin, "/metrics")[1].decode()
    print(f"\nround trip to a worker without its computation, measured by the gateway: "
          f"mean {1e3 * histogram_mean(text, 'veiloc_cluster_round_trip_seconds'):.2f} ms over searches and poses\n")
    cluster.stop()

    header("workers", "answers per second", "busy threads", "answers per busy second", "share of all processors", "regions per query")
    points = []
    for workers in args.workers:
        cluster = Cluster(scene, scene.map, workers=workers, images=scene.images)
        clients = Clients(cluster.port, scene.queries, 2 * workers + 2)
        time.sleep(2)
        before, begin = busy(cluster), time.monotonic()
        time.sleep(args.seconds)
        took, end = busy(cluster) - before, time.monotonic()
        done = len([1 for started, lasted in clients.times if begin <= started + lasted < end])
        clients.stop()
        text = ask(cluster.admin, "/metrics")[1].decode()
        row(workers, f"{done / (end - begin):.1f}", f"{took / (end - begin):.2f}", f"{done / took:.1f}",
            f"{took / (end - begin) / os.cpu_count():.2f}", f"{histogram_mean(text, 'veiloc_cluster_regions'):.2f}")
        cluster.stop()
        points.append({"workers": workers, "clients": 2 * workers + 2, "rate": round(done / (end - begin), 1)})
    if args.csv:
        write_csv(args.csv, ["workers", "answers a second"], [[point["workers"], f"{point['rate']:.1f}"] for point in points])
    if args.json:
        measured = {"constants": {"processors": os.cpu_count()}, "points": points}
        pathlib.Path(args.json).write_text(json.dumps(measured) + "\n")


if __name__ == "__main__":
    main()
