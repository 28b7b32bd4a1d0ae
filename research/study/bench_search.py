#!/usr/bin/env python3
"""Compares the retrieval index of large maps with usearch (HNSW), on the same global descriptors and queries.

    pip install numpy usearch
    cargo build --release
    research/study/bench_search.py --map redkitchen.vmap --images redkitchen/images --query-list redkitchen/query.txt \
        --distractors training-photos --csv docs/results/scale/usearch.csv

`veiloc eval retrieval --save` searches, and writes its descriptors and queries; then usearch runs the same queries, in two ways: over
the descriptors (`i8`, cosine), and over binary codes as veiloc's, the signs after a fixed rotation (`b1`, Hamming), with exact
re-ranking of as many candidates as in veiloc's index. Both build on all processors and search on one; making the binary codes is not
counted for usearch. `recall@10` is the share of the true 10 nearest (cosine over all descriptors) that is
found; a time is the median over the queries and includes re-ranking.

    research/study/bench_search.py --drawn 100000

runs usearch alone on drawn scenes of ten images, as `cargo bench -p veiloc-benches --bench search` draws them for veiloc's index.
"""

import argparse
import csv
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from usearch.index import Index, MetricKind, ScalarKind, search

WANTED = 10
CANDIDATES = 300  # candidates that veiloc's index re-ranks exactly
IMAGES, METHOD, BUILD = "images", "method", "build (s)"
MEMORY, TIME, RECALL = "memory beside the descriptors (MB)", "retrieval (ms)", "recall@10 (%)"
COLUMNS = [IMAGES, METHOD, BUILD, MEMORY, TIME, RECALL]


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
        self.graph = Index(ndim=8 * self.codes.shape[1], metric=MetricKind.Hamming, dtype=ScalarKind.B1)
        self.graph.add(np.arange(len(self.codes)), self.codes)

    def memory(self) -> int:
        return self.graph.memory_usage

    def search(self, query: np.ndarray, code: np.ndarray) -> np.ndarray:
        among = self.graph.search(code, CANDIDATES, threads=1).keys.astype(np.int64)
        best = search(self.searched[among], query, WANTED, MetricKind.Cos, exact=True, threads=1)
        return among[best.keys.astype(np.int64)]


class DescriptorGraph:
    """A graph over the descriptors, which it holds."""

    name, expansions = "usearch, descriptors", (64, 512)

    def __init__(self, searched: np.ndarray) -> None:
        self.searched = searched

    def build(self) -> None:
        self.graph = Index(ndim=self.searched.shape[1], metric=MetricKind.Cos, dtype=ScalarKind.I8)
        for at in range(0, len(self.searched), 50000):
            part = np.ascontiguousarray(self.searched[at : at + 50000])
            self.graph.add(np.arange(at, at + len(part)), part)

    def memory(self) -> int:
        return self.graph.memory_usage - self.searched.nbytes

    def search(self, query: np.ndarray, code: np.ndarray) -> np.ndarray:
        return self.graph.search(query, WANTED, threads=1).keys.astype(np.int64)


def usearch(kind: type, queries: np.ndarray, searched: np.ndarray, truth: list[set[int]]) -> list[dict]:
    """The rows of one graph."""
    built, codes = kind(searched), binary_codes(queries)
    started = time.perf_counter()
    built.build()
    build = time.perf_counter() - started
    rows = []
    for expansion in kind.expansions:
        built.graph.expansion_search = expansion
        found, times = 0, []
        for query, code, true_ones in zip(queries, codes, truth):
            started = time.perf_counter()
            keys = built.search(query, code)
            times.append(1e3 * (time.perf_counter() - started))
            found += len(true_ones & set(keys.tolist()))
        recall = found / sum(map(len, truth))
        method = f"{kind.name}, expansion {expansion}"
        rows.append(row(len(searched), method, build, built.memory(), float(np.median(times)), recall))
        print(rows[-1], file=sys.stderr, flush=True)
    return rows


def drawn(images: int) -> tuple[np.ndarray, np.ndarray]:
    """Descriptors of scenes of ten images, and 100 queries; a third to a half of a descriptor is common to its scene."""

    def image(scene: int, number: int) -> np.ndarray:
        of_scene = np.random.default_rng([0, scene]).integers(-128, 128, 4096)
        rng = np.random.default_rng([1, number])
        share = rng.uniform(0.6, 0.7)
        own = 0.9 * (share * of_scene + np.sqrt(1 - share * share) * rng.integers(-128, 128, 4096))
        return np.clip(own, -127, 127).astype(np.int8)

    queries = [image(31 * k % -(-images // 10), images + k) for k in range(100)]
    return np.stack([image(i // 10, i) for i in range(images)]), np.stack(queries)


def row(images: int, method: str, build: float | None, memory: int | None, ms: float, recall: float) -> dict:
    cells = [images, method, "" if build is None else short(build), "" if memory is None else short(memory / 1e6), short(ms),
             short(100 * recall)]  # fmt: skip
    return dict(zip(COLUMNS, cells))


def short(value: float) -> str:
    """Three digits, two of a small number; plain."""
    return f"{value:.0f}" if value >= 100 else f"{value:.1f}" if value >= 10 else f"{value:.2g}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--veiloc", default="target/release/veiloc")
    parser.add_argument("--map")
    parser.add_argument("--images")
    parser.add_argument("--query-list")
    parser.add_argument("--distractors")
    parser.add_argument("--sizes", default="10000,100000,1000000")
    parser.add_argument("--usearch-up-to", type=int, default=1_000_000, help="run usearch only up to this size")
    parser.add_argument("--json", help="also write the document of `veiloc eval retrieval` to this file, for research/study/scale_plots.py")
    parser.add_argument("--csv", help="also write the table to this file, after each graph")
    parser.add_argument("--drawn", type=int, help="drawn scenes with this number of images in place of a map's")
    args = parser.parse_args()
    if args.drawn:
        searched, queries = drawn(args.drawn)
        truth = exact(queries, searched)
        return table([row for kind in (BinaryGraph, DescriptorGraph) for row in usearch(kind, queries, searched, truth)])
    if not (args.map and args.images):
        parser.error("give --map and --images, or --drawn")
    with tempfile.TemporaryDirectory() as folder:
        command = [args.veiloc, "eval", "retrieval", "--map", args.map, "--images", args.images, "--sizes", args.sizes,
                   "--save", folder, "--json"]
        command += ["--query-list", args.query_list] if args.query_list else []
        command += ["--distractors", args.distractors] if args.distractors else []
        text = subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout
        if args.json:
            Path(args.json).write_bytes(text)
        everything = np.load(Path(folder) / "searched.npy", mmap_mode="r")
        queries = np.load(Path(folder) / "queries.npy")
        rows = []
        for own in json.loads(text)["rows"]:
            every = own["search"] == "all"
            beside = own["bytes"] - own["images"] * everything.shape[1]
            method = "every image" if every else "index"
            rows.append(row(own["images"], method, None if every else own["build_seconds"], None if every else beside,
                            own["median_ms"], own["recall"]))  # fmt: skip
        write(rows, args.csv)
        for size in sorted({row[IMAGES] for row in rows}):
            if size > args.usearch_up_to:
                continue
            searched = everything[:size]
            truth = exact(queries, searched)
            for kind in (BinaryGraph, DescriptorGraph):
                rows += usearch(kind, queries, searched, truth)
                write(rows, args.csv)
    table(rows)


def table(rows: list[dict]) -> None:
    print(f"{IMAGES:>9} {METHOD:<36} {BUILD:>9} {'MB':>8} {'ms':>8} {'recall':>8}")
    for own in rows:
        print(f"{own[IMAGES]:>9} {own[METHOD]:<36} {own[BUILD]:>9} {own[MEMORY]:>8} {own[TIME]:>8} {own[RECALL]:>8}")


def write(rows: list[dict], path: str | None) -> None:
    rows.sort(key=lambda row: row[IMAGES])
    if path:
        with open(path, "w", newline="") as file:
            writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)


if __name__ == "__main__":
    main()
