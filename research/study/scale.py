"""Tables of docs/results/scale.md: compressed maps, regions, retrieval, distributed builds."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from study.common import RESULTS, ROOT, SCENES, Package, cm, command, names_of, read_csv
from study.log_plot import LogPlot, page
from study.trust import out_of_map_rows

np, index, ray, veiloc = Package("numpy"), Package("usearch.index"), Package("ray"), Package("veiloc")
TIMES = [1, 5, 10, 20, 40, 80]
THRESHOLDS = {"redkitchen": ("0.02/2", "0.05/5"), "herzjesu": ("0.1/2", "0.25/5")}
REGIONS = [None, 40, 20]
SIZES = "1000,10000,100000,1000000"
OUTPUT = re.compile(r"^ *(\d+) (\S.*?) +([\d.]+) +([\d.]+) +([\d.]+) +([\d.]+) %$", re.M)


def eval_scene(run, place: str, *options) -> dict:
    return run.document("eval", "scene", *run.scene(place), "--schemes", "points,dcl", "--thresholds", ",".join(THRESHOLDS[place]),
                        "--work", run.kept() / f"scene-{place}", *options)  # fmt: skip


def short(value: float) -> str:
    """Two digits, or all before the point."""
    return f"{value:.0f}" if value >= 10 else f"{value:.2g}"


def schemes_of(*columns):
    return [f"{scheme} {column}" for scheme in ("points", "dcl") for column in columns]


@command("scale/compress.csv", negatives=([], "ratios of which out-of-map images are asked too"))
def compress(run):
    """Poses in smaller maps of RedKitchen and Herz-Jesu.

    With `--negatives 10` also prints how many out-of-map images (no default was chosen with them) are trusted or doubtful in RedKitchen's
    map at a tenth."""
    table = run.table("scale/compress.csv", "scene", "times smaller", "kB an image", "map points",
                      *schemes_of("median (cm)", "within 2 cm (10 cm) and 2° (%)", "trusted"))  # fmt: skip
    for scene, place in SCENES.items():
        for times in TIMES:
            found = eval_scene(run, place, *([] if times == 1 else ["--compress", times]))
            cells = [cell for row in found["schemes"]
                     for cell in (cm(row["median_translation"]), f"{100 * row['recall'][THRESHOLDS[place][0]]:.0f}", row["trusted"])]  # fmt: skip
            of = found["map"]
            table.add([scene, times, f"{of['bytes'] / of['images'] / 1e3:.1f}", of["points"], *cells])
    for times in run.negatives:
        small = run.made(run.kept() / f"redkitchen-{times}.vmap", "map", "compress", run.map("redkitchen"), "--ratio", times)
        for row in out_of_map_rows(run, small, "points,random-lines,dcl"):
            print(f"at 1/{times}, {row['scheme']}: {row['trusted']} trusted and {row['doubtful']} doubtful of {row['queries']}")
    if run.out:
        plots(run)


@command("scale/regions.csv")
def regions(run):
    """RedKitchen cut into regions of at most 40 and 20 images."""
    table = run.table("scale/regions.csv", "map", "regions", "regions that hold an image (mean)", "all regions (MB)", "largest region (MB)",
                      *schemes_of("median (cm)", "median (°)", "trusted"))  # fmt: skip
    for images in REGIONS:
        found = eval_scene(run, "redkitchen", *([] if images is None else ["--regions", images]))
        cells = [cell for row in found["schemes"]
                 for cell in (cm(row["median_translation"]), f"{row['median_rotation_deg']:.2f}", row["trusted"])]  # fmt: skip
        of = found["map"]
        if images is None:
            table.add(["whole", "", "", f"{of['bytes'] / 1e6:.1f}", "", *cells])
        else:
            cut = of["regions"]
            table.add([f"regions of {images}", cut["count"], f"{cut['images_total'] / of['images']:.2f}", f"{cut['bytes'] / 1e6:.1f}",
                       f"{cut['largest_bytes'] / 1e6:.1f}", *cells])  # fmt: skip


@command()
def plots(run):
    """The drawings of the tables compress and retrieval, into docs/images."""
    tables = (run.out or RESULTS) / "scale"
    (ROOT / "docs/images/compress.svg").write_text(compressed_plot(read_csv(tables / "compress.csv")))
    (ROOT / "docs/images/search.svg").write_text(searched_plot(read_csv(tables / "retrieval.csv")))


def compressed_plot(rows):
    """Median error against bytes per image, for each scene and scheme."""
    plot = LogPlot("Median error of compressed maps", "kB per image", "cm", (0, 3), (-1, 1), width=720)
    for scene in dict.fromkeys(row["scene"] for row in rows):
        for column in (column for column in rows[0] if column.endswith(" median (cm)")):
            points = [(float(row["kB an image"]), float(row[column])) for row in rows if row["scene"] == scene]
            plot.line(f"{scene}, {column.removesuffix(' median (cm)')}", sorted(points), dashed=scene == "Herz-Jesu")
    return page([plot])


def searched_plot(rows):
    largest = max(int(row["images"]) for row in rows)
    plot = LogPlot("Retrieval time", "images", "ms", (3, len(str(largest)) - 1), (-1, 3))
    for name, search in (("exhaustive", "every image"), ("index", "index")):
        plot.line(name, [(int(row["images"]), float(row["retrieval (ms)"])) for row in rows if row["compared"] == search])
    return page([plot])


@command("scale/drawn.csv", sizes=(SIZES.removeprefix("1000,"), "numbers of images"))
def drawn(run):
    """The benchmark `search` of veiloc-benches, on drawn scenes of ten images."""
    table = run.table("scale/drawn.csv", "images", "method", "build (s)", "memory beside the descriptors (MB)", "retrieval (ms)",
                      "recall@10 (%)")  # fmt: skip
    # The exhaustive search is of every image; the benchmark prints zeros for what it does not need.
    printed = subprocess.run(["cargo", "bench", "--locked", "-p", "veiloc-benches", "--bench", "search"], check=True,
                             stdout=subprocess.PIPE, text=True, cwd=ROOT, env=dict(os.environ, IMAGES=run.sizes)).stdout  # fmt: skip
    for images, search, build, memory, ms, recall in OUTPUT.findall(printed):
        every = search == "exhaustive"
        table.add([images, "every image" if every else "index", "" if every else short(float(build)),
                   "" if every else f"{float(memory):.0f}", short(float(ms)), "100" if every else recall])  # fmt: skip


WANTED = 10
CANDIDATES = 300  # candidates that veiloc's index re-ranks exactly


def unit(codes: np.ndarray) -> np.ndarray:
    """Rows normalized to length one, float32."""
    rows = codes.astype(np.float32)
    return rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-9)


def exact(queries: np.ndarray, searched: np.ndarray) -> list[set[int]]:
    """The true 10 nearest of each query."""
    parts = [unit(queries) @ unit(searched[at : at + 20000]).T for at in range(0, len(searched), 20000)]
    return [set(row) for row in np.argsort(-np.hstack(parts), axis=1, kind="stable")[:, :WANTED].tolist()]


def binary_codes(rows: np.ndarray) -> np.ndarray:
    """Signs of the rows after random signs and a Hadamard transform, packed; many numbers of a row may be zero, and their own sign says
    nothing."""
    length = 1 << (rows.shape[1] - 1).bit_length()
    flips = np.random.default_rng(0).choice(np.array([-1, 1], np.float32), rows.shape[1])
    codes = []
    for at in range(0, len(rows), 2000):
        values = np.zeros((len(rows[at : at + 2000]), length), np.float32)
        values[:, : rows.shape[1]] = rows[at : at + 2000] * flips
        half = 1
        while half < length:
            pairs = values.reshape(len(values), -1, 2, half)
            values = np.stack([pairs[:, :, 0] + pairs[:, :, 1], pairs[:, :, 0] - pairs[:, :, 1]], axis=2).reshape(len(values), length)
            half *= 2
        codes.append(np.packbits(values >= 0, axis=1))
    return np.concatenate(codes)


class BinaryGraph:
    """A graph over binary codes; the candidates are compared exactly, by usearch too."""

    name, expansions = "usearch, binary codes", (CANDIDATES, 4 * CANDIDATES)

    def __init__(self, searched: np.ndarray) -> None:
        self.searched, self.codes = searched, binary_codes(searched)

    def build(self) -> None:
        self.graph = index.Index(ndim=8 * self.codes.shape[1], metric=index.MetricKind.Hamming, dtype=index.ScalarKind.B1)
        self.graph.add(np.arange(len(self.codes)), self.codes)

    def memory(self) -> int:
        return self.graph.memory_usage

    def search(self, query: np.ndarray, code: np.ndarray) -> np.ndarray:
        among = self.graph.search(code, CANDIDATES, threads=1).keys.astype(np.int64)
        best = index.search(self.searched[among], query, WANTED, index.MetricKind.Cos, exact=True, threads=1)
        return among[best.keys.astype(np.int64)]


class DescriptorGraph:
    """A graph over the descriptors, which it holds."""

    name, expansions = "usearch, descriptors", (64, 512)

    def __init__(self, searched: np.ndarray) -> None:
        self.searched = searched

    def build(self) -> None:
        self.graph = index.Index(ndim=self.searched.shape[1], metric=index.MetricKind.Cos, dtype=index.ScalarKind.I8)
        for at in range(0, len(self.searched), 50000):
            part = np.ascontiguousarray(self.searched[at : at + 50000])
            self.graph.add(np.arange(at, at + len(part)), part)

    def memory(self) -> int:
        return self.graph.memory_usage - self.searched.nbytes

    def search(self, query: np.ndarray, code: np.ndarray) -> np.ndarray:
        return self.graph.search(query, WANTED, threads=1).keys.astype(np.int64)


def drawn_scenes(images: int) -> tuple[np.ndarray, np.ndarray]:
    """Descriptors of scenes of ten images, and 100 queries; a third to a half of a descriptor is common to its scene."""

    def image(scene: int, number: int) -> np.ndarray:
        of_scene = np.random.default_rng([0, scene]).integers(-128, 128, 4096)
        rng = np.random.default_rng([1, number])
        share = rng.uniform(0.6, 0.7)
        own = 0.9 * (share * of_scene + np.sqrt(1 - share * share) * rng.integers(-128, 128, 4096))
        return np.clip(own, -127, 127).astype(np.int8)

    queries = [image(31 * k % -(-images // 10), images + k) for k in range(100)]
    return np.stack([image(i // 10, i) for i in range(images)]), np.stack(queries)


@command(images=(100_000, "number of images"))
def usearch(run):
    """usearch (HNSW) on drawn scenes of ten images, as `cargo bench -p veiloc-benches --bench search` draws them for veiloc's index.

    In two ways: over the descriptors (`i8`, cosine), and over binary codes as veiloc's, the signs after a fixed rotation (`b1`, Hamming),
    with exact re-ranking of as many candidates as in veiloc's index. Both build on all processors and search on one; making the binary
    codes is not counted. `recall@10` is the share of the true 10 nearest (cosine over all descriptors) that is found; a time is the median
    over the queries and includes re-ranking."""
    rows, sizes = [], [run.images]
    everything, queries = drawn_scenes(run.images)
    for size in sizes:
        truth = exact(queries, everything[:size])
        for kind in (BinaryGraph, DescriptorGraph):
            for row in measured(kind, queries, everything[:size], truth):
                rows.append(row)
                print(*row, sep="  ", file=sys.stderr, flush=True)
    table = run.table("usearch.csv", "images", "method", "build (s)", "memory beside the descriptors (MB)", "retrieval (ms)",
                      "recall@10 (%)")  # fmt: skip
    for row in sorted(rows, key=lambda row: row[0]):
        table.add(row)


def measured(kind: type, queries: np.ndarray, searched: np.ndarray, truth: list[set[int]]):
    """The rows of one graph."""
    built, codes = kind(searched), binary_codes(queries)
    started = time.perf_counter()
    built.build()
    build = time.perf_counter() - started
    for expansion in kind.expansions:
        built.graph.expansion_search = expansion
        found, times = 0, []
        for query, code, true_ones in zip(queries, codes, truth):
            started = time.perf_counter()
            keys = built.search(query, code)
            times.append(1e3 * (time.perf_counter() - started))
            found += len(true_ones & set(keys.tolist()))
        yield cells_of(len(searched), f"{kind.name}, expansion {expansion}", build, built.memory(), float(np.median(times)),
                       found / sum(map(len, truth)))  # fmt: skip


def cells_of(images: int, method: str, build, memory, ms: float, recall: float) -> list:
    # Three digits, two of a small number; plain.
    cell = lambda value: "" if value is None else f"{value:.0f}" if value >= 100 else f"{value:.1f}" if value >= 10 else f"{value:.2g}"
    return [images, method, cell(build), cell(memory and memory / 1e6), cell(ms), cell(100 * recall)]


# Stages of the table, as both name them.
ALONE = ["Extracting features", "Matching first pairs", "Matching pairs", "Testing the map"]
MANY = ["features", "first-pairs", "pairs", "self-test"]


def alone(posed, images, names, out):
    stages, began = {}, time.monotonic()
    last = [began, None]

    def record(stage, done, total):
        now = time.monotonic()
        if stage != last[1]:
            if last[1] is not None:
                stages[last[1]] = now - last[0]
            last[:] = [now, stage]

    veiloc.Map.build(posed, images, names=names, progress=record).save(out)
    stages[last[1]] = time.monotonic() - last[0]
    return time.monotonic() - began, stages


@command("scale/build.csv", needs="the Python package, and Ray", room=("redkitchen", "folder of the data"), rounds=3,
         shares=(0, "tasks per stage (default: four for each processor)"))  # fmt: skip
def build(run):
    """A map build with Ray and in a single process on one machine: seconds of each stage, and equal maps.

    Both use all processors: the single process with threads, Ray with processes of one thread each. Ray starts once, before the timing;
    its work folder is empty in each round. The fastest of alternating rounds counts. Fails when the maps differ."""
    table = run.table("scale/build.csv", "build", "total (s)", "features (s)", "first pairs (s)", "pairs (s)",
                      "triangulation and the rest (s)", "self-test (s)")  # fmt: skip
    place = run.place(run.room)
    given, names = (str(place / "posed"), str(place / "images")), names_of(place / "map.txt")
    ray.init(log_to_driver=False, include_dashboard=False)

    def many(out):
        with tempfile.TemporaryDirectory() as work:
            began = time.monotonic()
            built = Package("veiloc.ray").build_map(*given, out, names=names, work=work, shares=run.shares or None)
            return time.monotonic() - began, built.seconds

    with tempfile.TemporaryDirectory() as folder:
        one, other = Path(folder, "alone.vmap"), Path(folder, "many.vmap")
        rounds = []
        for _ in range(run.rounds):
            rounds.append((alone(*given, names, one), many(other)))
            if one.read_bytes() != other.read_bytes():
                sys.exit("the maps differ")
        count = len(veiloc.Map.open(one))
    print(f"{count} images, {os.cpu_count()} processors, byte-identical maps in {run.rounds} rounds")
    for name, names, side in zip(("one process", "Ray"), (ALONE, MANY), zip(*rounds)):
        total, stages = min(side, key=lambda found: found[0])
        *parts, self_test = (stages[stage] for stage in names)
        table.add([name, *(f"{seconds:.1f}" for seconds in (total, *parts, total - sum(parts) - self_test, self_test))])
