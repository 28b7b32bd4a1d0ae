#!/usr/bin/env python3
"""What a service of many machines costs, from measured constants: machines, memory, network, tail latency; up to 10^8 images and
10^5 queries a second.

    research/notes/scale_model.py [--csv DIR]                the tables of docs/results/scale.md
    research/notes/scale_model.py --costs COSTS.json         the constants that `study service answer-times --max-keypoints 1024 --costs` gives
    research/notes/scale_model.py --check MEASURED.json      its predictions beside what `study service cluster-throughput` measured
    research/notes/scale_model.py --plot FILE.svg            the table drawn, on log axes
    research/notes/scale_model.py --set pose_ms=25 …         with other constants

Standard library only (and `study`); equal seeds give equal tables. The model is a simulation by events. A machine has processors and threads
that localize; a query waits for a thread, first come first served, and busy threads share the processors equally. A gateway
searches its index for the regions of a query, asks one after the other, and answers; requests take `road_ms` each way. Time of a pose is drawn from what
was measured of single queries (`pose_spread`: factors of the median). A query that finds nothing is asked in as many regions as
a query may be, and each of them costs `negative_ms`. Of the machines that hold a region the less busy of two is asked. A machine
fails, or hangs, at random: what it has, and what it gets until a gateway has put it out, is sent to another one then. What the
constants are, and which command printed each, stands beside them; assumptions are in docs/results/scale.md.
"""

import argparse
import heapq
import json
import math
import random
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from study.log_plot import COLOURS, LogPlot, page  # noqa: E402
from study.common import write_csv  # noqa: E402

CONSTANTS = {
    # Processor time of a query of 1024 rows of RedKitchen that finds its pose, the camera calibrated: `study service answer-times
    # --images 29 --rounds 7 --max-keypoints 1024 --costs`, the median of the least of each query's rounds.
    "pose_ms": 33.0,
    # Factors of the median, equally likely.
    "pose_spread": [0.92, 0.94, 0.97, 1.0, 1.01, 1.04, 1.22],
    # The same of queries of another place, in one region.
    "negative_ms": 54.7,
    "negative_spread": [0.42, 0.68, 0.87, 1.0, 1.16, 1.32, 1.53],
    # The same of queries of another place whose focal length is unknown.
    "unknown_negative_ms": 185.7,
    "unknown_negative_spread": [0.42, 0.63, 0.77, 1.0, 1.09, 1.23, 1.68],
    # Assumed: the share of queries that find nothing, and of these the share with an unknown focal length.
    "negatives": 0.1,
    "unknown": 0.0,
    # Regions in which a query that finds nothing is searched: the default of --regions.
    "regions_of_negative": 3,
    # From the moment that a machine hangs until its queries are sent to another one: the p99 of answers while workers are suspended,
    # docs/results/service/cluster-chaos.csv.
    "out_after_ms": 270,
    # A search among a million images through the index, and among a hundred thousand: docs/results/scale.md.
    "search_ms_at_million": 1.37,
    "search_ms_at_hundred_thousand": 0.67,
    # The gateway's processor time of a query: docs/results/service/cluster-throughput.csv.
    "gateway_ms": 1.3,
    # Assumed: from gateway to worker or back, in one data centre.
    "road_ms": 0.5,
    # Regions that a query is asked in: printed by `study service cluster-throughput`.
    "regions_asked": 1.17,
    # The number of regions of each image: `veiloc map split`.
    "held": 1.45,
    # Bytes an image: of a whole map, and packed at a twentieth (study scale compress).
    "bytes_whole": 215_800,
    "bytes_packed": 10_800,
    # Of an image in the index: its codes and its signs.
    "bytes_index": 4096 + 518 + 40,
    # A sealed query of 1024 rows with the default descriptors (docs/results/features.md), and an answer.
    "bytes_query": 39_000,
    "bytes_answer": 5_000,
    # Assumed, not measured: a machine, what it is loaded to, its failures, images of one map (a town).
    "processors": 16,
    "memory_gb": 64,
    "load": 0.6,
    "copies": 2,
    "failures_a_year": 4.0,
    "away_s": 120.0,
    "hangs_a_year": 12.0,
    "hangs_s": 40.0,
    "town_images": 1_000_000,
}


class Machine:
    """Processors that all busy threads share equally, and a queue before the threads."""

    def __init__(self, processors, threads):
        self.processors, self.threads = processors, threads
        self.busy, self.waiting, self.last, self.turn = {}, [], 0.0, 0

    def rate(self):
        return min(1.0, self.processors / len(self.busy)) if self.busy else 0.0

    def advance(self, now):
        done = (now - self.last) * self.rate()
        for job in self.busy:
            self.busy[job] -= done
        self.last = now

    def add(self, now, job, work):
        self.advance(now)
        if len(self.busy) < self.threads:
            self.busy[job] = work
        else:
            self.waiting.append((job, work))
        self.turn += 1

    def next_end(self):
        return self.last + max(0.0, min(self.busy.values())) / self.rate() if self.busy else math.inf

    def take(self, now):
        """The job that ends now."""
        self.advance(now)
        ended = min(self.busy, key=self.busy.get)
        del self.busy[ended]
        if self.waiting:
            job, work = self.waiting.pop(0)
            self.busy[job] = work
        self.turn += 1
        return ended


class Town:
    """One map's machines, asked by a stream of queries or by clients who each wait for their answer."""

    def __init__(self, constants, seed):
        self.c, self.random = constants, random.Random(seed)
        self.events, self.count, self.now = [], 0, 0.0
        self.times = []

    def at(self, when, what, *of):
        self.count += 1
        heapq.heappush(self.events, (when, self.count, what, of))

    def watch(self, machine):
        """Looks again when its next job should end, if nothing else happened to it before."""
        if machine.busy:
            self.at(machine.next_end(), "ends", machine, machine.turn)

    def give(self, machine, job, work):
        machine.add(self.now, job, work)
        self.watch(machine)

    def kind(self):
        """What a query is: `pose`, `negative` or `unknown_negative`."""
        if self.random.random() >= self.c["negatives"]:
            return "pose"
        return "unknown_negative" if self.random.random() < self.c["unknown"] else "negative"

    def pose_work(self, kind="pose"):
        return self.c[f"{kind}_ms"] * self.random.choice(self.c[f"{kind}_spread"])

    def regions(self, kind="pose"):
        """How many: 1, and another one as often as it takes for the mean; all that are allowed if nothing is found."""
        if kind != "pose":
            return self.c["regions_of_negative"]
        more = self.c["regions_asked"] - 1.0
        return 1 + int(more) + (self.random.random() < more % 1)

    def run(self, until, step):
        while self.events and self.events[0][0] <= until:
            self.now, _, what, of = heapq.heappop(self.events)
            if what == "ends":
                machine, turn = of
                if machine.turn == turn:
                    job = machine.take(self.now)
                    self.watch(machine)
                    step(job, "worked")
            else:
                step(of[0], what)


def of_town(constants, images, rate, machines, seconds=20.0, seed=1):
    """Times of answers, milliseconds, of one map on this number of machines that each hold any region with `copies` of each: of
    all queries, and of those that began while a machine was hanging and not yet put out."""
    c = constants
    town = Town(c, seed)
    all_machines = [Machine(c["processors"], c["processors"]) for _ in range(machines)]
    search = search_ms(c, images)
    # Machines that are put out; and those that hang and are not put out yet, with the jobs that they were given.
    jobs, away, hanging = {}, set(), {}
    during = []

    def pick():
        """The less busy of two of a region's copies."""
        some = [m for m in town.random.sample(range(machines), min(machines, c["copies"])) if m not in away] or [
            m for m in range(machines) if m not in away] or [0]
        two = town.random.sample(some, min(2, len(some)))
        return min(two, key=lambda m: len(all_machines[m].busy) + len(all_machines[m].waiting))

    def send(number, work):
        machine = pick()
        if machine in hanging:
            hanging[machine].append(number)
        else:
            town.give(all_machines[machine], number, work)

    def fail(seconds_away):
        machine = town.random.randrange(machines)
        if machine in away or machine in hanging:
            return
        broken = all_machines[machine]
        hanging[machine] = [*broken.busy, *(job for job, _ in broken.waiting)]
        broken.busy, broken.waiting, broken.turn = {}, [], broken.turn + 1
        town.at(town.now + c["out_after_ms"], "out", machine)
        town.at(town.now + c["out_after_ms"] + 1000.0 * seconds_away, "back", machine)

    def arrive():
        town.at(town.now + town.random.expovariate(rate / 1000.0), "query", None)

    def step(number, what):
        if what == "query":
            number = town.count
            kind = town.kind()
            jobs[number] = {"begun": town.now, "kind": kind, "left": town.regions(kind), "hung": bool(hanging)}
            town.at(town.now + c["gateway_ms"] + search + c["road_ms"], "arrived", number)
            arrive()
        elif what == "fails":
            dies = town.random.random() < c["failures_a_year"] / (c["failures_a_year"] + c["hangs_a_year"])
            fail(c["away_s"] if dies else c["hangs_s"])
            town.at(town.now + town.random.expovariate(1.0 / mean_between), "fails", None)
        elif what == "out":
            away.add(number)
            for job in hanging.pop(number):
                town.at(town.now, "arrived", job)
        elif what == "back":
            away.discard(number)
        elif what == "arrived":
            send(number, town.pose_work(jobs[number]["kind"]))
        else:
            job = jobs[number]
            job["left"] -= 1
            if job["left"]:
                town.at(town.now + 2 * c["road_ms"], "arrived", number)
            else:
                if town.now > 2000.0:
                    town.times.append(town.now + c["road_ms"] - job["begun"])
                    if job["hung"]:
                        during.append(town.times[-1])
                del jobs[number]

    mean_between = 365 * 86_400_000.0 / ((c["failures_a_year"] + c["hangs_a_year"]) * machines)
    town.at(town.random.expovariate(1.0 / mean_between), "fails", None)
    # One failure is seen in any case: a year has many, twenty seconds mostly none.
    town.at(1000.0 * seconds / 2, "fails", None)
    arrive()
    town.run(1000.0 * seconds, step)
    return sorted(town.times), sorted(during)


def search_ms(c, images):
    """By the power of the number of images that the two measured ones tell."""
    million = c["search_ms_at_million"]
    return million * (images / 1e6) ** math.log10(million / c["search_ms_at_hundred_thousand"])


def machines_of(c, images, rate, bytes_an_image):
    """Machines of one map: for what must be in memory, and for the work."""
    memory = images * (bytes_an_image * c["held"] + c["bytes_index"]) * c["copies"]
    work = rate * (work_of_query(c) + search_ms(c, images)) / 1000.0
    by_memory = memory / (c["memory_gb"] * 1e9)
    by_work = work / (c["processors"] * c["load"])
    return max(c["copies"], math.ceil(max(by_memory, by_work))), by_memory, by_work


def work_of_query(c):
    """Mean processor time for poses, milliseconds."""
    def one(kind, regions):
        return c[f"{kind}_ms"] * regions * mean(c[f"{kind}_spread"])

    negative = (1 - c["unknown"]) * one("negative", c["regions_of_negative"]) + c["unknown"] * one("unknown_negative", c["regions_of_negative"])
    return (1 - c["negatives"]) * one("pose", c["regions_asked"]) + c["negatives"] * negative


def mean_regions(c):
    return (1 - c["negatives"]) * c["regions_asked"] + c["negatives"] * c["regions_of_negative"]


def mean(values):
    return sum(values) / len(values)


def percentile(times, share):
    return times[min(len(times) - 1, int(share * len(times)))] if times else float("nan")


def rows(c, seed):
    """Of each size and rate: what it takes."""
    for images in (10**4, 10**5, 10**6, 10**7, 10**8):
        for rate in (10, 1000, 100_000):
            towns = max(1, math.ceil(images / c["town_images"]))
            own_images, own_rate = images / towns, rate / towns
            for kind in ("whole", "packed"):
                machines, by_memory, by_work = machines_of(c, own_images, own_rate, c[f"bytes_{kind}"])
                # A large town is simulated by a part of it with as many queries a machine.
                simulated = min(machines, 24)
                times, _ = of_town(c, own_images, own_rate * simulated / machines, simulated, min(40.0, max(4.0, 40_000 * machines / simulated / own_rate / 40)), seed)
                yield {
                    "images": images, "rate": rate, "map": kind, "maps": towns, "machines": machines * towns,
                    "limited_by": "memory" if by_memory > by_work else "work" if by_work > c["copies"] else "copies",
                    "memory_tb": images * (c[f"bytes_{kind}"] * c["held"] + c["bytes_index"]) * c["copies"] / 1e12,
                    "gigabits": 8 * rate * (c["bytes_query"] * (1 + mean_regions(c)) + c["bytes_answer"]) / 1e9,
                    "p50": percentile(times, 0.5), "p99": percentile(times, 0.99), "simulated": len(times),
                    "failures_a_day": machines * towns * (c["failures_a_year"] + c["hangs_a_year"]) / 365,
                }


def negatives(c, seed):
    """10^8 images, packed, and 10^5 queries a second, with several shares of queries that find nothing."""
    towns = math.ceil(10**8 / c["town_images"])
    images, rate = 10**8 / towns, 10**5 / towns
    for share, unknown in ((0.0, 0.0), (0.1, 0.0), (0.1, 1.0), (0.5, 0.0), (0.5, 1.0)):
        own = dict(c, negatives=share, unknown=unknown)
        machines, _, _ = machines_of(own, images, rate, own["bytes_packed"])
        times, during = of_town(own, images, rate, machines, 20.0, seed)
        yield [
            f"{100 * share:.0f}", ("unknown" if unknown else "calibrated") if share else "", f"{work_of_query(own):.1f}", machines * towns,
            f"{percentile(times, 0.5):.0f}", f"{percentile(times, 0.99):.0f}", f"{percentile(during, 0.5):.0f}", f"{percentile(during, 0.99):.0f}",
        ]


MODEL_COLUMNS = ["images", "queries a second", "maps are", "maps", "machines", "limited by", "memory (TB)", "network (Gbit/s)", "p50 (ms)", "p99 (ms)",
                 "machines that fail or hang, a day"]
CHECK_COLUMNS = ["workers", "processor time of an answer, measured (ms)", "model (ms)", "model over measurement"]
NEGATIVES_COLUMNS = ["queries that find nothing (%)", "their focal length", "processor time of a query (ms)", "machines", "p50 (ms)", "p99 (ms)",
                     "p50 while a machine hangs (ms)", "p99 while a machine hangs (ms)"]


def tables(c, seed, folder):
    """Prints both tables, and writes them to a folder if one is given."""
    model = ([row["images"], row["rate"], row["map"], row["maps"], row["machines"], row["limited_by"], f"{row['memory_tb']:.3g}", f"{row['gigabits']:.3g}",
              f"{row['p50']:.0f}", f"{row['p99']:.0f}", f"{row['failures_a_day']:.2g}"] for row in rows(c, seed) if row["images"] in (10**4, 10**6, 10**8))
    for name, columns, lines in (("model.csv", MODEL_COLUMNS, model), ("model-negatives.csv", NEGATIVES_COLUMNS, negatives(c, seed))):
        write(folder, name, columns, list(lines))


def write(folder, name, columns, lines):
    """Prints a table, and writes it to a file of the folder if one is given."""
    for line in [columns, *lines]:
        print("| " + " | ".join(str(cell) for cell in line) + " |", flush=True)
    print()
    if folder:
        write_csv(Path(folder) / name, columns, lines)


def costs(path):
    """The constants for the processor time of queries, from what `study service answer-times` measured."""
    measured = json.loads(Path(path).read_text())
    for name, key in (("pose", "redkitchen, calibrated, found"), ("negative", "redkitchen, calibrated, not found"),
                      ("unknown_negative", "redkitchen, unknown, not found")):
        times = sorted(measured[key])
        median = percentile(times, 0.5)
        # The middle of each seventh.
        spread = [round(percentile(times, (2 * i + 1) / 14) / median, 2) for i in range(7)]
        print(f'    "{name}_ms": {median},\n    "{name}_spread": {spread},')


def check(c, measured, folder):
    """Beside what was measured of a cluster and not fitted to: queries that all find their pose."""
    model = c["pose_ms"] * mean(c["pose_spread"]) * c["regions_asked"] + c["gateway_ms"]
    lines = [[point["workers"], f"{point['processor_ms']:.1f}", f"{model:.1f}", f"{model / point['processor_ms']:.2f}"] for point in measured]
    write(folder, "model-check.csv", CHECK_COLUMNS, lines)


def plot(c, seed, path):
    """Machines against images, a line for each rate and map, on log axes."""
    lines = {}
    for row in rows(c, seed):
        lines.setdefault((row["rate"], row["map"]), []).append((row["images"], row["machines"]))
    drawn = LogPlot("Machines against images", "images", "machines", (4, 8), (0, 5))
    colours = {10: COLOURS[0], 1000: COLOURS[1], 100_000: COLOURS[2]}
    for (rate, kind), points in lines.items():
        drawn.line(f"{rate}/s, {kind}", points, colours[rate], dashed=kind != "whole")
    with open(path, "w") as file:
        file.write(page([drawn]))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", metavar="MEASURED.json")
    parser.add_argument("--costs", metavar="COSTS.json")
    parser.add_argument("--csv", metavar="DIR", help="also write the tables there")
    parser.add_argument("--plot", metavar="FILE.svg")
    parser.add_argument("--set", nargs="*", default=[], metavar="NAME=NUMBER")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    constants = dict(CONSTANTS)
    for item in given.set:
        name, _, number = item.partition("=")
        if name not in constants or name.endswith("_spread"):
            parser.error(f"no constant {name!r}; there are {', '.join(n for n in constants if not n.endswith('_spread'))}")
        constants[name] = float(number) if "." in number else int(number)
    if given.costs:
        costs(given.costs)
    elif given.check:
        with open(given.check) as file:
            check(constants, json.load(file), given.csv)
    elif given.plot:
        plot(constants, given.seed, given.plot)
    else:
        tables(constants, given.seed, given.csv)


if __name__ == "__main__":
    main()
