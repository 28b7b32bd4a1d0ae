"""Tables of docs/results/service.md: clusters on loopback, whose processes are killed, suspended, replaced. Need nats-server.

Without data, `--rendered` takes a rendered room.
"""

import http.client
import json
import os
import pathlib
import signal
import statistics
import subprocess
import sys
import threading
import time

from study.common import ROOT, command
from study.loopback import (
    LOCALIZE, PROTOBUF, Clients, Cluster, Kitchen, Part, Rendered, Server, ask, counter, percentile, run_in_turns, token, wait_for,
)  # fmt: skip

PAGE = "service"
NATS = "nats-server"
OLD = "a build of an earlier commit"
SCENE = {"rendered": (False, "a rendered room, which needs no data")}


def load_scene(run, program=None):
    if run.data:
        os.environ["VEILOC_DATA"] = str(run.data)
    return (Rendered if run.rendered else Kitchen)(program or run.veiloc)


def metrics(part):
    return ask(part.admin, "/metrics")[1].decode()


CLIENTS = 6


@command("service/cluster-chaos.csv", needs=NATS, workers=6, seconds=(6.0, "seconds of each phase of an event"),
         rate=(0.0, "queries per second (default: half of the measured capacity)"), **SCENE)  # fmt: skip
def cluster_chaos(run):
    """Fault injection under load: kills processes of a cluster, and counts lost queries.

    Starts three nats-server, workers with one thread that serve every region, and a gateway. Clients send queries at a steady rate and
    retry the same bytes after a busy answer or a broken connection. Then, one after the other: a worker is killed (kill -9) and
    restarted; two thirds of the workers at once; a worker is stopped (SIGTERM); a worker is suspended (SIGSTOP) for twice --seconds; a
    worker runs a tenth of the time; a NATS node is killed with its connections, then another one; the gateway is killed and restarted; a
    smaller map is published; the first map is published again while a worker is killed. Checks that equal queries got equal poses while
    the map was the same. The last line is `accepted N lost N`: a lost query was sent completely and never answered. Fails when a query is
    lost."""
    if run.workers < 2:
        sys.exit("--workers: must be at least 2, or regions are lost with the only worker")
    scene = load_scene(run)
    cluster = Cluster(scene, scene.map, workers=run.workers, images=scene.images)
    print(f"{len(cluster.nats)} nats-server, {len(cluster.workers)} workers with {cluster.regions} regions each\n", flush=True)
    rate = run.rate or 0.5 * measured_rate(cluster, scene.queries, 5)
    print(f"{rate:.1f} queries per second of {len(scene.queries)} images by {CLIENTS} clients\n", flush=True)
    clients = Clients(cluster.port, scene.queries, CLIENTS, rate)
    workers, nats = cluster.workers, cluster.nats
    table = run.table("service/cluster-chaos.csv", "event", "p99 before (ms)", "p99 during (ms)", "p99 after (ms)", "longest (ms)", "queries")

    def inject(what, act):
        begin = time.monotonic()
        time.sleep(run.seconds)
        acted = time.monotonic()
        act()
        # The effects of the event last for a moment.
        over = max(time.monotonic(), acted + run.seconds / 2)
        time.sleep(over - time.monotonic() + run.seconds)
        spans = [clients.between(*span) for span in ((begin, acted), (acted, over), (over, time.monotonic()))]
        p99 = [f"{percentile(times, 0.99):.0f}" for times in spans]
        table.add([what, *p99, f"{max(sum(spans, [])):.0f}", sum(map(len, spans))])

    def restarted(parts, end=Part.kill):
        for part in parts:
            end(part)
        time.sleep(run.seconds / 4)
        for part in parts:
            part.start(wait=False)
        for part in parts:
            part.wait()

    several = workers[:max(1, len(workers) * 2 // 3)]
    inject("a worker is killed", lambda: restarted(workers[:1]))
    inject(f"{len(several)} workers are killed at once", lambda: restarted(several))
    inject("a worker is stopped (SIGTERM)", lambda: restarted(workers[1:2], Part.stop))

    def suspended(part):
        part.process.send_signal(signal.SIGSTOP)
        time.sleep(2 * run.seconds)
        part.process.send_signal(signal.SIGCONT)

    inject("a worker is suspended", lambda: suspended(workers[0]))
    inject("a worker is slow", lambda: run_in_turns(workers[0].process, run.seconds))
    inject("a NATS node is killed", lambda: restarted(nats[:1]))
    inject("another NATS node is killed", lambda: restarted(nats[1:2]))
    inject("the gateway is killed", lambda: (cluster.gateway.kill(), cluster.gateway.start()))
    same = {number: len(poses) for number, poses in clients.poses.items()}

    def publish(map_file, meanwhile=lambda: None):
        manifests = lambda: counter(metrics(cluster), "veiloc_cluster_manifests_total")
        before = manifests()
        cluster.publish(map_file)
        meanwhile()
        wait_for(lambda: manifests() > before, "the new manifest")

    inject("a smaller map is published", lambda: publish(scene.smaller))
    inject("the first map is published again, and a worker is killed", lambda: publish(scene.map, lambda: restarted(workers[-1:])))
    clients.stop()
    hedges = counter(metrics(cluster), "veiloc_cluster_hedges_total")
    dropped = sum(counter(metrics(worker), "veiloc_worker_cancellations_total", f'state="{state}"')
                  for worker in workers for state in ("queued", "running"))  # fmt: skip
    codes = cluster.stop()
    print(f"\nstatuses: {clients.statuses}; retried: {clients.retried}")
    print(f"hedged messages of the gateway since its last start: {hedges:.0f}; jobs cancelled at workers: {dropped:.0f}")
    print(f"queries with equal poses while the map was the same: {sum(n == 1 for n in same.values())} of {len(same)}")
    print(f"exit codes of gateway and workers: {codes}")
    print(f"accepted {clients.accepted} lost {clients.lost}")
    return clients.lost > 0 or any(codes) or any(n != 1 for n in same.values())


def measured_rate(cluster, queries, seconds):
    """Capacity of the cluster: answers per second of clients without pauses."""
    clients = Clients(cluster.port, queries, CLIENTS)
    time.sleep(seconds)
    done = clients.stop()
    return len(done.times) / seconds
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


@command("service/cluster-hung.csv", needs=OLD, names=(["now"], "names of the programs"), workers=["2", "4"],
         seconds=(40.0, "seconds of each phase"), rate=(3.0, "queries per second"), **SCENE)  # fmt: skip
def cluster_hung(run):
    """Workers that hang, that are slow, and that are all gone: what queries of a cluster see.

    For each number of workers (one thread each, all regions), queries are sent at a steady rate, each on a connection of its own and once
    (no retries), while all workers run; while one is suspended (SIGSTOP) for --seconds; and while one runs one tenth of the time, as with a
    strict limit of its processor. Then, without queries: the time until the gateway's /readyz is 503 after all were suspended, and 200
    again after they continue. *Put out after* is the time from the signal until the gateway counts the worker as `out`.
    Runs against any build, to compare versions. Fails when a query is not answered with 200, 409 or 422, or the gateway stays ready
    without workers."""
    lost, readiness = 0, []
    table = run.table("service/cluster-hung.csv", "program", "workers", "phase", "answered", "p50 (ms)", "p99 (ms)", "longest (ms)",
                      "over 2 s", "put out after (s)")  # fmt: skip
    for program, name in zip(str(run.veiloc).split(","), run.names, strict=True):
        scene = load_scene(run, program)
        for workers in map(int, run.workers):
            cluster = Cluster(scene, scene.map, workers=workers, images=scene.images, nats=1)
            time.sleep(1)
            victim = cluster.workers[0].process

            def phase(what, act):
                """Sends queries while `act` runs; returns the number of queries without an answer."""
                stream = Stream(cluster.port, scene.queries, run.rate)
                noticed = act()
                sent, times = stream.stop()
                table.add([name, workers, what, f"{len(times)} of {sent}", f"{statistics.median(times or [0]):.0f}",
                           f"{percentile(times, 0.99):.0f}", f"{max(times, default=0):.0f}", sum(took > 2000 for took in times),
                           noticed or ""])  # fmt: skip
                return sent - len(times)

            def suspended():
                victim.send_signal(signal.SIGSTOP)
                begun = time.monotonic()
                noticed = seconds_until(lambda: gateway_value(cluster, OUT) > 0, run.seconds)
                time.sleep(max(0.0, begun + run.seconds - time.monotonic()))
                victim.send_signal(signal.SIGCONT)
                return noticed and f"{noticed:.2f}"

            def all_suspended():
                """The time until the gateway is not ready, and ready again when the workers continue."""
                ready = lambda status: lambda: ask(cluster.admin, "/readyz")[0] == status
                for how, status in ((signal.SIGSTOP, 503), (signal.SIGCONT, 200)):
                    for worker in cluster.workers:
                        worker.process.send_signal(how)
                    yield seconds_until(ready(status), 15)

            try:
                lost += phase("all run", lambda: time.sleep(min(run.seconds, 20.0)))
                lost += phase("one suspended", suspended)
                time.sleep(2)
                lost += phase("one slow", lambda: run_in_turns(victim, run.seconds))
                readiness.append((name, workers, *all_suspended()))
            finally:
                for worker in cluster.workers:
                    worker.process.send_signal(signal.SIGCONT)
                cluster.stop()
    for name, workers, *both in readiness:
        print(f"{name}, {workers} workers:", *("-" if took is None else f"{took:.2f}" for took in both),
              "s until not ready after all were suspended, and ready after they continued")  # fmt: skip
    print(f"\nqueries without an answer: {lost}")
    return lost > 0 or any(took is None for _, _, *both in readiness for took in both)


COPIES = 2


class PlacedCluster(Cluster):
    """A cluster whose workers divide the regions among them."""

    def worker(self, i, wait=True):
        part = super().worker(i, ["--replicas", COPIES, "--settle", 3, "--name", f"worker-{i}", "--drain-after", 1], wait)
        part.loaded_before = 0
        return part


def values(worker):
    text = ask(worker.admin, "/metrics")[1].decode()
    # The index is one of the objects of each worker.
    return counter(text, "veiloc_object_loads_total") - 1, counter(text, "veiloc_objects_loaded") - 1


@command("service/cluster-placement.csv", needs=NATS, seconds=(8.0, "least seconds of each step"), images=(4, "images of a region"), **SCENE)
def cluster_placement(run):
    """Workers that join, leave and die under load: regions that move, beside the least possible, and queries that are lost.

    The map is cut into small regions, and workers run with `--replicas 2 --settle 3`. Three workers run; then, with clients that send
    queries all the time, a fourth and a fifth join, one leaves (SIGTERM), one is killed, one is killed and started again at once, and two
    join at the same time. After each step it waits until every region has two copies again. *Moved* is the number of regions that workers
    loaded (`veiloc_object_loads_total`, without indexes), beside what any placement must load to get two copies of each region again: the
    copies that were lost; for workers that join, their mean share, rounded down. Fails when an accepted query is lost, a region does not
    get two copies, or more than half as many regions again move."""
    scene = load_scene(run)
    cluster = PlacedCluster(scene, scene.map, workers=3, images=run.images, nats=2)
    regions, failed, gone, clients = cluster.regions, [], [], None
    table = run.table("service/cluster-placement.csv", "step", "workers", "regions", "moved", "lost copies, or mean share of who joins",
                      "two copies again after (s)", "queries", "lost")  # fmt: skip

    def is_settled():
        # Two copies of each: no worker holds more than what is placed on it, and the gateway sees two of the rarest.
        wanted = min(COPIES, len(cluster.workers))
        copies = counter(metrics(cluster), "veiloc_cluster_copies", 'map="place"')
        return copies >= wanted and sum(int(values(worker)[1]) for worker in cluster.workers) == wanted * regions

    def step(name, act, least):
        loads = {worker.name: values(worker)[0] for worker in cluster.workers}
        lost_before, begin = clients.lost, time.monotonic()
        # Workers that were started again count from zero.
        fresh = act()
        wait_for(is_settled, "two copies of each region")
        settled = time.monotonic() - begin
        time.sleep(max(0.0, run.seconds - settled))
        moved = sum(int(values(worker)[0] - (0 if worker.name in fresh else loads.get(worker.name, 0))) for worker in cluster.workers)
        times = clients.between(begin, time.monotonic())
        least = least()
        table.add([name, len(cluster.workers), regions, moved, least, f"{settled:.1f}", len(times), clients.lost - lost_before])
        if moved > least * 1.5 + 1:
            failed.append(name)

    def join(*numbers):
        parts = [cluster.worker(number, wait=False) for number in numbers]
        for part in parts:
            part.wait()
        cluster.workers += parts
        return [part.name for part in parts]

    def leave(kill=False):
        worker = cluster.workers.pop(0)
        gone.append(int(values(worker)[1]))
        worker.kill() if kill else worker.stop()
        return []

    def restart():
        worker = cluster.workers[0]
        gone.append(int(values(worker)[1]))
        worker.kill()
        worker.start()
        return [worker.name]

    try:
        wait_for(is_settled, "two copies of each region")
        clients = Clients(cluster.port, scene.queries, count=3, rate=9)
        share = lambda joined: lambda: joined * (COPIES * regions // len(cluster.workers))
        step("a worker joins", lambda: join(3), share(1))
        step("another one joins", lambda: join(4), share(1))
        step("a worker leaves (SIGTERM)", leave, lambda: gone[-1])
        step("a worker is killed", lambda: leave(kill=True), lambda: gone[-1])
        step("a worker is killed and started again", restart, lambda: gone[-1])
        step("two workers join", lambda: join(5, 6), share(2))
    finally:
        if clients:
            clients.stop()
        cluster.stop()
    print(f"\naccepted {clients.accepted}, lost {clients.lost}, sent again {clients.retried}")
    for name in failed:
        print(f"more regions moved than needed: {name}")
    return clients.lost > 0 or bool(failed)


@command("service/rolling-update.csv", needs=OLD, old="", new="", seconds=(3.0, "seconds of each step"),
         rendered=(True, SCENE["rendered"][1]))  # fmt: skip
def rolling_update(run):
    """A cluster whose machines are replaced by another release, one by one, under load; and back (`--old PROGRAM --new PROGRAM`).

    Three workers that hold all regions and one gateway run the old program, and clients send queries all the time. First workers, then
    the gateway are replaced by the new one: SIGTERM, and the new program when the old one has ended, with --seconds between two of them.
    Then the gateway returns to the old one, and two workers after it, and the gateway is updated again. So every pair of releases is used
    both ways. The gateway is a single one, so clients send queries again while it is away. Fails when an accepted query is lost, or equal
    queries get different poses."""
    programs = {"old": pathlib.Path(run.old).resolve(), "new": pathlib.Path(run.new).resolve()}
    scene = load_scene(run, programs["old"])
    cluster = Cluster(scene, scene.map, workers=3, images=scene.images, nats=2)
    clients, runs = None, {part.name: "old" for part in [*cluster.workers, cluster.gateway]}
    table = run.table("service/rolling-update.csv", "step", "workers", "gateway", "queries")

    def step(name, part=None, which=None):
        begin = time.monotonic()
        if part:
            code = part.stop()
            if code != 0:
                sys.exit(f"{part.name} ended with {code}: {part.log}")
            part.command[0] = str(programs[which])
            part.start()
            runs[part.name] = which
        time.sleep(run.seconds)
        times = clients.between(begin, time.monotonic())
        count = ", ".join(f"{sum(runs[worker.name] == which for worker in cluster.workers)} {which}" for which in programs)
        table.add([name, count, runs["gateway"], len(times)])

    try:
        clients = Clients(cluster.port, scene.queries, count=3, rate=12)
        step("before")
        for worker in cluster.workers:
            step(f"{worker.name} is updated", worker, "new")
        step("the gateway is updated", cluster.gateway, "new")
        step("the gateway returns", cluster.gateway, "old")
        for worker in cluster.workers[:2]:
            step(f"{worker.name} returns", worker, "old")
        step("the gateway is updated first", cluster.gateway, "new")
    finally:
        if clients:
            clients.stop()
        cluster.stop()
    different = sum(len(poses) > 1 for poses in clients.poses.values())
    print(f"\naccepted {clients.accepted}, lost {clients.lost}, sent again {clients.retried}, queries with different poses {different}")
    return clients.lost > 0 or different > 0


RATE = 5
# Two bursts of five are paid back in a second.
SETTLE = 3.0


def flood(ports, seconds):
    """Requests to all ports at the same time, each as fast as it answers; returns answers and refusals a second."""
    counts, stop = {}, time.monotonic() + SETTLE + seconds
    counted_from, lock = time.monotonic() + SETTLE, threading.Lock()

    def client(port):
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
        while time.monotonic() < stop:
            connection.request("GET", "/v1/maps", headers={"authorization": f"Bearer {token('phone')}"})
            response = connection.getresponse()
            response.read()
            if time.monotonic() >= counted_from:
                with lock:
                    counts[response.status] = counts.get(response.status, 0) + 1
            # Enough to use every place that becomes free.
            time.sleep(0.01)
        connection.close()

    threads = [threading.Thread(target=client, args=(port,)) for port in ports]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    unexpected = set(counts) - {200, 429}
    if unexpected:
        sys.exit(f"unexpected answers: {unexpected}")
    return counts.get(200, 0) / seconds, counts.get(429, 0) / seconds


@command("service/shared-rates.csv", needs=OLD, names=(["now"], "names of the programs"), seconds=(15.0, "seconds of each measurement"),
         rendered=(True, SCENE["rendered"][1]), check=(False, "fail when the rate does not hold over both gateways"))  # fmt: skip
def shared_rates(run):
    """One token at two gateways: how many answers a second it gets from both together (`--veiloc OLD,NEW --names before,now`).

    Two gateways with `--rate 5` and `--rate-fail closed` where the program has it, one worker. A client sends to both as fast as they
    answer, or to one of them, for --seconds each; the first seconds, in which bursts are used and paid back, are not counted. Then one
    gateway is killed and the client sends to the other. Requests are answered with the list of maps, which costs the same rate as a query
    and no localization. Runs against any build, to compare versions; a build without shared rates gives twice as much. With --check it
    fails when two gateways give more or less than 5 ± 10 % together."""
    table, holds = run.table("service/shared-rates.csv", "program", "requests go to", "answers a second", "refused with 429 a second"), True
    for program, name in zip(str(run.veiloc).split(","), run.names, strict=True):
        scene = load_scene(run, program)
        more = ["--tokens", scene.tokens(["phone"]), "--burst", RATE]
        if "--rate-fail" in scene.options():
            more += ["--rate-fail", "closed"]
        cluster = Cluster(scene, scene.map, workers=1, images=scene.images, nats=2, gateway=False)
        try:
            first, second = (cluster.serve(more, name=f"gateway-{i}", rate=RATE) for i in range(2))

            def measure(what, ports):
                answered, refused = flood(ports, run.seconds)
                table.add([name, what, f"{answered:.2f}", f"{refused:.0f}"])
                return answered

            both = measure("both gateways", [first.port, second.port])
            one = measure("one of two", [first.port])
            second.kill()
            # Until it is silent.
            time.sleep(5)
            measure("one, the other was killed", [first.port])
            holds = holds and all(0.9 * RATE <= rate <= 1.1 * RATE for rate in (both, one))
        finally:
            cluster.stop()
    return run.check and not holds


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


@command("service/cluster-latency.csv", "service/cluster-throughput.csv", "scale/model-check.csv", needs=NATS, workers=["1", "2", "4"],
         seconds=(15.0, "duration of each row"), **SCENE)  # fmt: skip
def cluster_throughput(run):
    """Throughput of a cluster by number of workers, and its latency beside a service without a cluster; and the model of
    research/notes/scale_model.py checked by both.

    *Latency*: one client sends one query after the other through HTTP, gateway and NATS to one worker, and the same queries to
    `veiloc serve` with the whole map in memory. *Throughput*: enough clients to keep all workers busy. *Busy threads* is the wall time
    that the workers' threads spent localizing (`veiloc_busy_seconds_total`), with waits for a processor. Clients, gateway, NATS and
    workers share the machine's cores, so with more workers than cores the throughput cannot grow."""
    scene = load_scene(run)
    table = run.table("service/cluster-latency.csv", "path", "median (ms)", "p95 (ms)")
    direct = Server(scene, "--workers", 1, maps=["--map", f"place={scene.map}"])
    wait_for(lambda: ask(direct.admin, "/readyz")[0] == 200, "readiness")
    cluster = Cluster(scene, scene.map, workers=1, images=scene.whole)
    # In turns, so that other load on the machine affects both.
    alone, clustered = [], []
    for _ in range(3):
        alone += one_by_one(direct.port, scene.queries, run.seconds / 3)
        clustered += one_by_one(cluster.port, scene.queries, run.seconds / 3)
    direct.stop()
    for name, times in (("`veiloc serve`", sorted(alone)), ("gateway, NATS, one worker", sorted(clustered))):
        table.add([name, f"{statistics.median(times):.1f}", f"{percentile(times, 0.95):.1f}"])
    mean = histogram_mean(metrics(cluster), "veiloc_cluster_round_trip_seconds")
    print(f"\nround trip to a worker without its computation, measured by the gateway: mean {1e3 * mean:.2f} ms over searches and poses\n")
    cluster.stop()

    table, points = run.table("service/cluster-throughput.csv", "workers", "answers a second"), []
    for workers in map(int, run.workers):
        cluster = Cluster(scene, scene.map, workers=workers, images=scene.images)
        clients = Clients(cluster.port, scene.queries, 2 * workers + 2)
        time.sleep(2)
        before, begin = busy(cluster), time.monotonic()
        time.sleep(run.seconds)
        took, end = busy(cluster) - before, time.monotonic()
        done = len([1 for started, lasted in clients.times if begin <= started + lasted < end])
        clients.stop()
        table.add([workers, f"{done / (end - begin):.1f}"])
        busy_threads = took / (end - begin)
        print(f"  {busy_threads:.2f} busy threads, {done / took:.1f} answers per busy second, {busy_threads / os.cpu_count():.2f} "
              f"of all processors, {histogram_mean(metrics(cluster), 'veiloc_cluster_regions'):.2f} regions per query")  # fmt: skip
        cluster.stop()
        points.append({"workers": workers, "clients": 2 * workers + 2, "rate": round(done / (end - begin), 1)})
    measured = scene.work / "cluster.json"
    measured.write_text(json.dumps({"constants": {"processors": os.cpu_count()}, "points": points}) + "\n")
    if run.out:
        subprocess.run([sys.executable, ROOT / "research/notes/scale_model.py", "--check", measured, "--csv", run.out / "scale"], check=True)
