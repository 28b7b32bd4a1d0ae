#!/usr/bin/env python3
"""What a map of many places costs and how far it can be believed, as it grows: the city of docs/results/scale.md.

    cargo build --release
    research/notes/city.py --data $VEILOC_DATA --out CITY --csv docs/results/scale/city.csv \\
        --queries-csv docs/results/scale/city-queries.csv                     everything; two hours of two processors
    research/notes/city.py --out CITY --table                                 only the tables, of what there is
    research/notes/city.py --out CITY --plot docs/images/city.svg             only the drawing

Renders a city (`veiloc synth city`, rooms that look alike among them), puts the two real places beside it in one world, and
builds maps of more and more of it: the real places alone, then with the rooms of --steps, then with all, with out-of-map images
that show no place of it, and at last without the rooms that look like another. Every map gets all queries: those of rooms
that it does not have must not be trusted anywhere, least of all in a room that looks like theirs. What was computed is kept in
CITY; a run that was interrupted goes on there. Standard library only.
"""

import argparse
import json
import math
import os
import resource
import struct
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "research"))

from study.log_plot import LogPlot, page  # noqa: E402
from study.common import write_csv  # noqa: E402

# Where the other places lie in the city's world, metres: far from its rooms and from each other.
ASIDE = {"redkitchen": (-1000.0, 0.0, 0.0), "herzjesu": (0.0, -1000.0, 0.0)}
# Metres between out-of-map images, of which none sees what another one does.
APART = 200.0
SCHEMES = ["points", "dcl"]
ALIKE = "absent, one that looks alike is there"


def main():
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--out", type=Path, required=True, help="folder of everything")
    words.add_argument("--veiloc", default=str(ROOT / "target/release/veiloc"), help="the program (default: the release build)")
    words.add_argument("--data", type=Path, default=os.environ.get("VEILOC_DATA"), help="folder of the real images (default: VEILOC_DATA)")
    words.add_argument("--csv", type=Path, help="CSV of what maps cost")
    words.add_argument("--queries-csv", type=Path, help="CSV of the queries")
    words.add_argument("--rooms", type=int, default=250, help="rooms of the city (default 250)")
    words.add_argument("--views", type=int, default=40, help="images of a room in the map (default 40)")
    words.add_argument("--queries", type=int, default=3, help="queries of a room (default 3)")
    words.add_argument("--steps", default="0,22,75", help="rooms of the smaller maps (default 0,22,75)")
    words.add_argument("--keypoints", type=int, default=1024, help="keypoints of a map image at most (default 1024)")
    words.add_argument("--table", action="store_true", help="print the tables of what there is, and compute nothing")
    words.add_argument("--plot", type=Path, help="draw what there is, and compute nothing")
    args = words.parse_args()
    if args.plot:
        args.plot.write_text(drawing(rows_of(args.out)))
        return
    if not args.table:
        compute(args)
    rows = rows_of(args.out)
    for path, (columns, table) in ((args.csv, costs(rows)), (args.queries_csv, answers(rows))):
        write_csv(path, columns, table)
        for row in [columns, *table]:
            print(*row, sep="  ")


def compute(args):
    if args.data is None:
        sys.exit("set VEILOC_DATA or --data to the folder of the real images")
    data = args.data.resolve()
    city = args.out / "city"
    if not (city / "query.txt").is_file():
        run([args.veiloc, "synth", "city", "--out", city, "--rooms", args.rooms, "--map-views", args.views,
             "--query-views", args.queries])
    lists = world(args.out, city, data)
    (args.out / "queries.txt").write_text("\n".join(lists["queries"]) + "\n")
    steps = [int(step) for step in args.steps.split(",") if int(step) < args.rooms]
    maps = [(f"{rooms}", lists["real"] + lists["map"][: rooms * args.views]) for rooms in [*steps, args.rooms]]
    maps.append(("elsewhere", lists["real"] + lists["map"] + lists["elsewhere"]))
    # What should embarrass it: rooms that are missing, each of which looks like one that is there.
    maps.append(("without", lists["real"] + [name for name in lists["map"] if not is_alike(place_of(name))]))
    for name, images in maps:
        result = args.out / f"result-{name}.json"
        if result.is_file():
            continue
        names = args.out / f"map-{name}.txt"
        names.write_text("\n".join(images) + "\n")
        # Two rooms that look alike would be refused as one room in two frames. One query at a time: its time is in the table.
        taken = run([args.veiloc, "eval", "scene", "--posed", args.out / "posed", "--images", args.out / "images", "--map-list", names,
                     "--query-list", args.out / "queries.txt", "--no-coordinate-frame-check", "--max-keypoints", args.keypoints, "--query-keypoints", 1024,
                     "--schemes", ",".join(SCHEMES), "--thresholds", "0.02/2,0.05/5", "--work", args.out / "work",
                     "--keep-map", args.out / f"map-{name}.vmap", "--json", args.out / "part.json"])
        document = json.loads((args.out / "part.json").read_text())
        document["city"] = taken | {"elsewhere": len(lists["elsewhere"]) if name == "elsewhere" else 0}
        (args.out / "part.json").write_text(json.dumps(document))
        (args.out / "part.json").rename(result)


def run(command):
    """Runs it; seconds it took, and the most memory that any command so far had."""
    words = [str(word) for word in command]
    print("$", " ".join(words), file=sys.stderr, flush=True)
    started = time.monotonic()
    subprocess.run(words, check=True, stdout=subprocess.DEVNULL)
    return {"seconds": time.monotonic() - started, "memory_kb": resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss}


def world(out, city, data):
    """One COLMAP model of all places, in OUT/posed; all images under OUT/images. Returns names: `map`, `queries`, `real`,
    `elsewhere`."""
    images = out / "images"
    images.mkdir(parents=True, exist_ok=True)
    link(images / "city", city / "images")
    cameras, poses = [], []
    lists = {"map": prefixed(city / "map.txt", "city/"), "queries": prefixed(city / "query.txt", "city/"), "real": []}
    place(city / "posed", "city/", (0.0, 0.0, 0.0), cameras, poses)
    for name, aside in ASIDE.items():
        link(images / name, data / name / "images")
        place(data / name / "posed", f"{name}/", aside, cameras, poses)
        lists["real"] += prefixed(data / name / "map.txt", f"{name}/")
        lists["queries"] += prefixed(data / name / "query.txt", f"{name}/")
    link(images / "elsewhere", data / "training-photos")
    strange = sorted(path for path in (data / "training-photos").rglob("*") if path.suffix.lower() in (".jpg", ".png"))
    lists["elsewhere"] = [f"elsewhere/{path.relative_to(data / 'training-photos')}" for path in strange]
    sizes = {}
    for index, (path, name) in enumerate(zip(strange, lists["elsewhere"], strict=True)):
        size = size_of(path)
        if size not in sizes:
            width, height = size
            cameras.append(f"SIMPLE_PINHOLE {width} {height} {1.2 * max(size)} {width / 2} {height / 2}")
            sizes[size] = len(cameras)
        x, y = 10_000.0 + APART * (index % 50), APART * (index // 50)
        poses.append(f"1 0 0 0 {-x} {-y} 0 {sizes[size]} {name}")
    folder = out / "posed"
    folder.mkdir(exist_ok=True)
    (folder / "cameras.txt").write_text("".join(f"{k} {camera}\n" for k, camera in enumerate(cameras, 1)))
    (folder / "images.txt").write_text("".join(f"{k} {pose}\n\n" for k, pose in enumerate(poses, 1)))
    (folder / "points3D.txt").write_text("")
    return lists


def link(at, to):
    if not at.exists():
        at.symlink_to(to.resolve())


def prefixed(path, prefix):
    return [prefix + line.strip() for line in path.read_text().splitlines() if line.strip()]


def place(posed, prefix, aside, cameras, poses):
    """Adds the cameras and images of a COLMAP model, its world moved."""
    numbers = {}
    for line in content(posed / "cameras.txt"):
        number, camera = line.split(maxsplit=1)
        cameras.append(camera)
        numbers[number] = len(cameras)
    # The second line of an image lists its points, which are not needed, and may be empty.
    lines = [line for line in (posed / "images.txt").read_text().split("\n") if not line.startswith("#")]
    for line in lines[::2]:
        if not line.strip():
            continue
        words = line.split(maxsplit=9)
        q, t = [float(w) for w in words[1:5]], [float(w) for w in words[5:8]]
        # x_cam = R (x - aside) + t
        moved = [a - b for a, b in zip(t, rotated(q, aside), strict=True)]
        poses.append(" ".join([*words[1:5], *map(repr, moved), str(numbers[words[8]]), prefix + words[9]]))


def content(path):
    return [line for line in path.read_text().splitlines() if line.strip() and not line.startswith("#")]


def rotated(q, v):
    length = math.sqrt(sum(x * x for x in q))
    w, *u = [x / length for x in q]

    def cross(a, b):
        return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]

    twice = [2 * x for x in cross(u, v)]
    return [x + w * y + z for x, y, z in zip(v, twice, cross(u, twice), strict=True)]


def size_of(path):
    """Width and height of a JPEG or PNG file."""
    data = path.read_bytes()
    if data.startswith(b"\x89PNG"):
        return struct.unpack(">II", data[16:24])
    at = 2
    while True:
        marker, length = struct.unpack(">HH", data[at : at + 4])
        if 0xFFC0 <= marker <= 0xFFCF and marker not in (0xFFC4, 0xFFC8, 0xFFCC):
            height, width = struct.unpack(">HH", data[at + 5 : at + 9])
            return width, height
        at += 2 + length


# ---- What it came to.


def place_of(name):
    """The room, or the real place, of an image."""
    return "/".join(name.split("/")[:2]) if name.startswith("city/") else name.split("/")[0]


def is_alike(place):
    """Rooms 4, 9, 14 … look like the room before them."""
    return int(place[-4:]) % 5 == 4


def kind_of(place, there):
    if place not in there:
        alike = f"city/room{int(place[-4:]) - 1:04d}" if is_alike(place) else None
        return ALIKE if alike in there else "absent"
    if not place.startswith("city/"):
        return place
    return "rooms that look alike" if int(place[-4:]) % 5 in (3, 4) else "other rooms"


def rows_of(out):
    """One of each map: its size, and for each scheme and kind of query the numbers of queries, poses and trusted poses."""
    rows = []
    for result in out.glob("result-*.json"):
        document = json.loads(result.read_text())
        name = result.stem.removeprefix("result-")
        names = (out / f"map-{name}.txt").read_text().split("\n")
        there = {place_of(image) for image in names if image}
        counts = {}
        for query in document["queries"]:
            kind = kind_of(place_of(query["name"]), there)
            counts.setdefault((query["scheme"], kind), []).append(query)
        rows.append({"name": name, "images": document["map"]["images"], "map": document["map"], "counts": counts, "city": document["city"]})
    return sorted(rows, key=lambda row: row["images"])


def is_right(query, metres=0.05, degrees=5.0):
    t, r = query["translation_error"], query["rotation_error_deg"]
    return t is not None and t <= metres and r <= degrees


def median(values):
    ordered = sorted(values)
    return ordered[len(ordered) // 2] if ordered else float("nan")


def figures(queries):
    trusted = [query for query in queries if query.get("state") == "trusted"]
    return {
        "queries": len(queries),
        "right": sum(is_right(query) for query in queries),
        "trusted": len(trusted),
        # Half a metre is another place, or another room.
        "wrong": sum(not is_right(query, 0.5, 10.0) for query in trusted),
        "error": median([query["translation_error"] for query in queries if query["translation_error"] is not None]),
        # The server's part.
        "ms": median([sum(query["ms"].get(stage, 0.0) for stage in ("decode", "retrieve", "match", "pose")) for query in queries]),
    }


def costs(rows):
    """Columns and rows of what the maps cost that hold the real places and more and more rooms."""
    table = []
    for row in (row for row in rows if row["name"].isdigit()):
        ms = [f"{figures(queries_there(row, scheme))['ms']:.0f}" for scheme in SCHEMES]
        facts = row["map"]
        table.append([row["images"], facts["points"], f"{facts['bytes'] / 1e9:.2f}", f"{facts['build_seconds']:.0f}",
                      f"{row['city']['memory_kb'] / 1e6:.1f}", *ms])  # fmt: skip
    columns = ["map images", "map points", "map (GB)", "build (s)", "peak memory (GB)", *(f"query, {scheme} (ms)" for scheme in SCHEMES)]
    return columns, table


def answers(rows):
    """Columns and rows of what queries get of each map."""
    table, largest = [], max((row["images"] for row in rows if row["name"].isdigit()), default=0)
    for row in sorted(rows, key=lambda row: row["name"] == "without"):
        titles = {"redkitchen": "RedKitchen", "herzjesu": "Herz-Jesu", "rooms that look alike": "rooms of the map",
                  "other rooms": "rooms of the map", "absent": "rooms that the map lacks",
                  ALIKE: "rooms that the map lacks"}  # fmt: skip
        about = ""
        if row["name"] == "elsewhere":
            about = f"{row['city']['elsewhere']} out-of-map images included"
        elif row["name"] == "without":
            lacking = {place_of(query["name"]) for (_, kind), queries in row["counts"].items() if kind == ALIKE for query in queries}
            about, titles = f"without the {len(lacking)} rooms that look like another", {ALIKE: "rooms that look like a mapped one"}
        elif row["images"] == largest:
            # Only here both of a pair can be compared.
            titles |= {"rooms that look alike": "rooms that look alike", "other rooms": "other rooms of the map"}
        queries = {}
        for (scheme, kind), of in row["counts"].items():
            if kind in titles:
                queries.setdefault((titles[kind], scheme), []).extend(of)
        for title in (title for title in dict.fromkeys(titles.values()) if (title, SCHEMES[0]) in queries):
            cells = []
            for scheme in SCHEMES:
                f = figures(queries[title, scheme])
                absent = title in ("rooms that the map lacks", "rooms that look like a mapped one")
                found = ["", ""] if absent else [f"{100 * f['right'] / f['queries']:.1f}", f"{100 * f['error']:.2f}"]
                cells += [*found, f["trusted"], f["wrong"]]
            table.append([row["images"], about, title, f["queries"], *cells])
    columns = [f"{scheme} {what}" for scheme in SCHEMES
               for what in ("within 5 cm and 5° (%)", "median (cm)", "trusted", "trusted wrongly")]  # fmt: skip
    return ["map images", "map", "queries of", "queries", *columns], table


def drawing(rows):
    """What a map costs, and what a query does, against its images; on log axes."""
    grown = [row for row in rows if row["name"].isdigit()]
    most = math.ceil(math.log10(max(row["images"] for row in grown)))
    cost = LogPlot("What the map costs", "images", "seconds, GB", (2, most), (-3, 3))
    for name, of in [("build, s", lambda row: row["map"]["build_seconds"]), ("file, GB", lambda row: row["map"]["bytes"] / 1e9),
                     ("most memory, GB", lambda row: row["city"]["memory_kb"] / 1e6)]:
        cost.line(name, [(row["images"], of(row)) for row in grown])
    per_query = LogPlot("What a query takes and gives", "images", "ms, cm", (2, most), (-1, 2))
    for scheme in SCHEMES:
        there = [(row["images"], figures(queries_there(row, scheme))) for row in grown]
        per_query.line(f"{scheme}, ms", [(images, f["ms"]) for images, f in there])
        per_query.line(f"{scheme}, cm", [(images, 100 * f["error"]) for images, f in there], dashed=True)
    return page([cost, per_query])


def queries_there(row, scheme):
    """The queries whose place is in the map."""
    kinds = [queries for (of, kind), queries in row["counts"].items() if of == scheme and not kind.startswith("absent")]
    return [query for queries in kinds for query in queries]


if __name__ == "__main__":
    main()
