#!/usr/bin/env python3
"""How many queries a second a cluster answers with 1, 2, 4 and 10 workers, and what its road costs beside the direct call.

    VEILOC_DATA=../shared/data scripts/cluster/throughput.py [--veiloc PROGRAM] [--seconds 15] [--workers 1 2 4 10]
        [--json FILE] [--rendered]

*Road*: one client, one query after the other, through HTTP, gateway and NATS to one worker, against the same queries to
`veiloc serve` with the whole map and with the region's map in memory. *Throughput*: as many clients as keep all workers busy;
*busy* is how long the workers' threads were localizing by the clock (`veiloc_busy_seconds_total`), waits for a processor among it:
*share* is that over the machine's processors, and above 1 there are more busy threads than processors. Clients, gateway, NATS and
workers share the machine's cores: with more workers than cores the answers a second cannot grow.
"""

import json
import os
import pathlib
import statistics
import sys
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))

from machines import Clients, Cluster, Server, ask, arguments, counter, header, percentile, place, row, wait_for  # noqa: E402


def one_by_one(port, queries, seconds):
    """Median and p95 of the time of an answer, and all times by query, milliseconds."""
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
    parser.add_argument("--seconds", type=float, default=15.0, help="of each row")
    parser.add_argument("--json", metavar="FILE", help="also write the points for research/notes/scale_model.py --check")
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2, 4, 10])
    args = parser.parse_args()
    town = place(args)

    header("road", "median, ms", "p95, ms", "median beside the direct call, ms")
    direct = Server(town, "--workers", 1, maps=["--map", f"place={town.map}"])
    wait_for(lambda: ask(direct.admin, "/readyz")[0] == 200, "readiness")
    cluster = Cluster(town, town.map, workers=1, images=town.whole)
    # In turns, so that what else the machine does meets both.
    alone, road = [], []
    for _ in range(3):
        alone += one_by_one(direct.port, town.queries, args.seconds / 3)
        road += one_by_one(cluster.port, town.queries, args.seconds / 3)
    direct.stop()
    base = statistics.median(alone)
    for name, times in (("direct: the map in memory", sorted(alone)), ("cluster: one region, the whole map", sorted(road))):
        row(name, f"{statistics.median(times):.1f}", f"{percentile(times, 0.95):.1f}", f"{statistics.median(times) - base:+.1f}")
    text = ask(cluster.admin, "/metrics")[1].decode()
    print(f"\nmessage to a worker and back beside its work, by the gateway's own clock: "
          f"mean {1e3 * histogram_mean(text, 'veiloc_cluster_road_seconds'):.2f} ms over searches and poses\n")
    cluster.stop()

    header("workers", "answers a second", "busy threads", "answers a busy second", "share of all processors", "regions a query")
    points = []
    for workers in args.workers:
        cluster = Cluster(town, town.map, workers=workers, images=town.images)
        clients = Clients(cluster.port, town.queries, 2 * workers + 2)
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
    if args.json:
        measured = {"constants": {"processors": os.cpu_count()}, "points": points}
        pathlib.Path(args.json).write_text(json.dumps(measured) + "\n")


if __name__ == "__main__":
    main()
